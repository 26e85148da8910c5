//! Everything here that reads bytes from outside, as functions of bytes: what the property tests and the fuzz targets
//! of `fuzz/` share.
//!
//! A reader may refuse; what it takes it must write back to something that it reads the same.
#![allow(dead_code)] // Every binary that takes these uses its own part.

use std::{fs, io::Write as _, os::unix::fs::OpenOptionsExt as _};

use cairn_log::keys::{Unlock, load_key};
use cairn_log::{
    Answer, Checkpoint, Digest, Entry, Envelope, Leaf, MapEntry, MapKey, MapLeaf, MapProof, MapTree, Note,
    NoteVerifier, OwnerKey, OwnerRecord, PublicKey, TlogProof,
    format::{
        answer::{AsOf, Format, List, ListedRecord, MapPart},
        map::ListState,
        packs::{self, PackError, Slot},
        record::{Digests, Identity, RecordKind, Seen, VERSION},
        tile::{TilePath, decode_entries, encode_entries},
    },
};

/// One reader.
pub struct Target {
    pub name: &'static str,
    /// Input that it takes.
    pub good: fn() -> Vec<Vec<u8>>,
    /// What it may allocate at its peak: bytes for each byte of input, and bytes beside.
    pub limit: (usize, usize),
    /// Reads; panics where the reader breaks its word.
    pub read: fn(&[u8]),
}

/// Text is copied, split into lines and decoded, and an error holds some of it.
const TEXT: (usize, usize) = (12, 8 << 10);
/// Each extension line becomes a string of its own, 24 bytes for two of input, while the list grows by doubling.
const LINES: (usize, usize) = (60, 8 << 10);
/// Fields that a JSON reader does not know are kept as trees until they are dropped: 32 bytes for each `0,`, while the
/// list grows by doubling. At most 64 KiB of it are read.
const JSON: (usize, usize) = (100, 16 << 10);

/// Records come as envelopes within the answer, whose unknown fields are kept for a moment.
const ANSWER: (usize, usize) = (100, 64 << 10);

/// All readers.
pub const TARGETS: [Target; 15] = [
    Target { name: "note", good: || vec![bytes(&checkpoint()), cosigned()], limit: TEXT, read: note },
    Target { name: "checkpoint", good: || vec![bytes(&checkpoint_text())], limit: LINES, read: checkpoint_of },
    Target {
        name: "tlog-proof",
        good: || vec![bytes(&proof(None)), bytes(&proof(Some(vec![7; 40])))],
        limit: TEXT,
        read: tlog_proof,
    },
    Target { name: "tile path", good: tile_paths, limit: TEXT, read: tile_path },
    // A slice of 16 bytes for each entry of at least 2, while the list grows by doubling.
    Target { name: "entry bundle", good: entry_bundles, limit: (40, 8 << 10), read: entry_bundle },
    Target { name: "DSSE envelope", good: || vec![bytes(&envelope().to_json())], limit: JSON, read: dsse },
    Target { name: "owner record", good: || vec![envelope().payload, full_record()], limit: JSON, read: owner_record },
    Target { name: "leaf", good: leaves, limit: (0, 4096), read: leaf },
    Target { name: "vkey", good: || vec![bytes(&vkey())], limit: TEXT, read: vkey_of },
    Target { name: "public key", good: || vec![bytes(&key().public().to_string())], limit: TEXT, read: public_key },
    Target {
        name: "key file",
        good: || vec![key().to_pem().unwrap().as_bytes().to_vec()],
        limit: (12, 64 << 10),
        read: key_file,
    },
    // At most 256 slots of 32 bytes, while the list grows by doubling, and their bytes once more.
    Target { name: "pack", good: packs_of_slots, limit: (4, 32 << 10), read: pack },
    Target { name: "map proof", good: map_proofs, limit: JSON, read: map_proof },
    Target { name: "complete answer", good: || vec![bytes(&answer().to_json())], limit: ANSWER, read: complete_answer },
    Target { name: "map list", good: map_lists, limit: (4, 8 << 10), read: map_list },
];

/// The target called `name`.
pub fn target(name: &str) -> &'static Target {
    TARGETS.iter().find(|target| target.name == name).unwrap()
}

pub fn key() -> OwnerKey {
    OwnerKey::from_seed(&[1; 32])
}

/// A contribution, signed by its owner.
pub fn envelope() -> Envelope {
    let key = key();
    let record = OwnerRecord {
        version: VERSION,
        kind: RecordKind::Contribution,
        origin: "log".into(),
        scene: "fern".into(),
        scene_salt: Digest::of("salt"),
        identity: Identity::numbered(1, "Ada"),
        owner_key: key.public(),
        digests: Digests { photographs: Some(Digest::of("photographs")), ..Digests::default() },
        seed: Some(7),
        purpose: "credit".into(),
        nonce: Digest::of("nonce"),
        seen: Seen { size: 3, root: Digest::of("root") },
        replaces: None,
        views: None,
    };
    record.seal(&key).unwrap()
}

/// The body of a record with every field set.
fn full_record() -> Vec<u8> {
    let mut record = OwnerRecord::parse(&envelope().payload).unwrap();
    let some = |what: &str| Some(Digest::of(what));
    record.kind = RecordKind::Claim;
    record.digests = Digests {
        marked_field: some("field"),
        detector: some("detector"),
        hidden_signal: some("signal"),
        photographs: some("photographs"),
        base_field: some("base field"),
        share_table: some("share table"),
        training_configuration: some("configuration"),
    };
    record.replaces = some("another");
    serde_json::to_vec(&record).unwrap()
}

fn bytes(text: &str) -> Vec<u8> {
    text.as_bytes().to_vec()
}

fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

fn checkpoint() -> String {
    Checkpoint::new("log", 1234, Digest::of("root")).sign(&key()).unwrap().to_string()
}

fn checkpoint_text() -> String {
    Checkpoint::new("log", 1234, Digest::of("root")).to_text()
}

/// A checkpoint with many signature lines, one of them of another type.
fn cosigned() -> Vec<u8> {
    let mut note = Note::parse(&checkpoint()).unwrap();
    for number in 2..9 {
        note.sign(&format!("witness-{number}"), &OwnerKey::from_seed(&[number; 32])).unwrap();
    }
    note.signatures[2].signature.extend([9; 8]);
    note.to_string().into_bytes()
}

fn proof(extra: Option<Vec<u8>>) -> String {
    TlogProof { extra, index: 3, hashes: vec![Digest::of("a"); 11], checkpoint: checkpoint() }.to_text()
}

fn vkey() -> String {
    NoteVerifier::new("log", key().public()).unwrap().to_string()
}

fn tile_paths() -> Vec<Vec<u8>> {
    ["tile/3/x001/234.p/17", "tile/entries/000", "tile/63/x018/x446/x744/x073/x709/x551/615"].map(bytes).to_vec()
}

fn leaves() -> Vec<Vec<u8>> {
    let map = MapLeaf::sign("log", 7, Digest::of("map"), &key());
    vec![Leaf::of(&envelope()).unwrap().encode().to_vec(), map.encode().to_vec()]
}

fn packs_of_slots() -> Vec<Vec<u8>> {
    let mut keys = vec![MapKey::scene("a"), MapKey::scene("b")];
    keys.sort_unstable();
    let slots = [Slot::Record(envelope().to_json().into_bytes()), Slot::MapLeaf, Slot::Erased(keys), Slot::MapLeaf];
    vec![slots.iter().flat_map(Slot::to_frame).collect(), vec![0; 4 * 300]]
}

/// A map of 20 scenes.
fn map() -> MapTree {
    let mut map = MapTree::new();
    for scene in 0..20 {
        map.append(MapKey::scene(&scene.to_string()), &MapEntry { index: scene, leaf_hash: Digest::of("leaf") });
    }
    map
}

fn map_proofs() -> Vec<Vec<u8>> {
    let proof = |scene: &str| serde_json::to_vec(&map().prove(&MapKey::scene(scene))).unwrap();
    vec![proof("3"), proof("absent"), proof("nowhere")]
}

/// An answer with one of everything, in which nothing is true.
fn answer() -> Answer {
    let (envelope, hashes) = (envelope(), vec![Digest::of("a"); 2]);
    let leaf = Leaf::of(&envelope).unwrap();
    let entry = MapEntry { index: 3, leaf_hash: leaf.hash() };
    let mut map = MapTree::new();
    (0..5_u8).for_each(|i| map.append(MapKey::about(&Digest::of([i])), &entry));
    let mut lists: Vec<List> = (0..8_u8)
        .map(|i| MapKey::about(&Digest::of([i])))
        .map(|key| List { key, entries: vec![entry; usize::from(map.get(&key).is_some())], proof: map.prove(&key) })
        .collect();
    lists.sort_by_key(|list| list.key);
    let map_leaf = MapLeaf::sign("log", 9, map.root(), &key()).encode();
    Answer {
        format: Format::V3,
        origin: "log".into(),
        scene: "fern".into(),
        view: Some(Digest::of("photograph")),
        checkpoint: "checkpoint\n".into(),
        as_of: Some(AsOf { checkpoint: "older\n".into(), consistency: hashes.clone() }),
        map: Some(MapPart { index: 9, leaf: map_leaf, inclusion: hashes.clone() }),
        lists,
        records: vec![ListedRecord {
            index: 3,
            leaf: leaf.encode(),
            inclusion: hashes,
            envelope: Some(envelope.clone()),
        }],
        shares: Some(envelope),
    }
}

fn map_lists() -> Vec<Vec<u8>> {
    let mut list = ListState::default();
    (0..11).for_each(|index| list.append(&MapEntry { index, leaf_hash: Digest::of("leaf") }));
    let mut bytes = Vec::new();
    list.encode(&mut bytes);
    vec![bytes]
}

fn entry_bundles() -> Vec<Vec<u8>> {
    let leaf = Leaf::of(&envelope()).unwrap().encode();
    vec![
        encode_entries([b"one".as_slice(), b"", b"three"]).unwrap(),
        encode_entries([&leaf[..]; 20]).unwrap(),
        vec![0; 512],
    ]
}

/// Holds a reader to its word: what it took and wrote it reads again, and writes the same.
fn reads_what_it_writes(input: &[u8], read: impl Fn(&[u8]) -> Option<Vec<u8>>) {
    if let Some(written) = read(input) {
        assert_eq!(read(&written).as_deref(), Some(written.as_slice()), "taken, but not read again as written");
    }
}

pub fn note(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(Note::parse(text(b)?).ok()?.to_string().into_bytes()));
    if let Some(parsed) = text(input).and_then(|t| Note::parse(t).ok()) {
        // A verdict, whichever; and for us only over the text that was signed.
        let known = [NoteVerifier::new("log", key().public()).unwrap()];
        if parsed.verify(&known).is_ok() {
            assert_eq!(parsed.text, checkpoint_text(), "a text that nobody signed verifies");
        }
    }
}

pub fn checkpoint_of(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(Checkpoint::parse_text(text(b)?).ok()?.to_text().into_bytes()));
}

pub fn tlog_proof(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(TlogProof::parse(text(b)?).ok()?.to_text().into_bytes()));
}

pub fn tile_path(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(text(b)?.parse::<TilePath>().ok()?.to_string().into_bytes()));
    if let Some(Ok(path)) = text(input).map(str::parse::<TilePath>) {
        // One spelling, and none that climbs out of the folder that it is served from.
        assert_eq!(path.to_string().as_bytes(), input);
        assert!(!path.to_string().contains(".."));
        assert!((1..=256).contains(&path.width));
        let _ = path.first();
    }
}

pub fn entry_bundle(input: &[u8]) {
    if let Ok(entries) = decode_entries(input) {
        assert_eq!(encode_entries(entries).as_deref(), Ok(input));
    }
}

pub fn dsse(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(Envelope::parse(b).ok()?.to_json().into_bytes()));
    let Ok(parsed) = Envelope::parse(input) else { return };
    if let Ok((record, _)) = OwnerRecord::open(&parsed) {
        assert_eq!(parsed.payload, envelope().payload, "a body that its owner never signed is opened");
        assert_eq!(record.owner_key, key().public());
    }
}

pub fn owner_record(input: &[u8]) {
    reads_what_it_writes(input, |b| serde_json::to_vec(&OwnerRecord::parse(b).ok()?).ok());
}

pub fn leaf(input: &[u8]) {
    if let Ok(entry) = Entry::decode(input) {
        assert_eq!(entry.encode(), input);
        // Each sort is read as itself alone.
        assert_ne!(Leaf::decode(input).is_ok(), MapLeaf::decode(input).is_ok());
    } else {
        assert!(Leaf::decode(input).is_err() && MapLeaf::decode(input).is_err());
    }
}

pub fn pack(input: &[u8]) {
    if let Ok((slots, length)) = packs::parse(input, 256) {
        let frames: Vec<u8> = slots.iter().flat_map(Slot::to_frame).collect();
        assert_eq!(frames, input[..length]);
        for number in [0, 1, 255] {
            let read_at = |offset: u64, length: usize| -> Result<Vec<u8>, PackError> {
                Ok(input.iter().skip(offset as usize).take(length).copied().collect())
            };
            let nth = packs::nth(number, read_at);
            assert!(slots.len() <= number || nth == Ok(slots.get(number).cloned()), "{nth:?}");
        }
    }
}

/// Whatever came, no key that is not in the map is proven to be there, and none that is, not to be.
pub fn map_proof(input: &[u8]) {
    reads_what_it_writes(input, |b| serde_json::to_vec(&serde_json::from_slice::<MapProof>(b).ok()?).ok());
    if let Ok(proof) = serde_json::from_slice::<MapProof>(input) {
        let (root, there, absent) = (map().root(), MapKey::scene("3"), MapKey::scene("absent"));
        assert!(proof.verify(&there, None, &root).is_err());
        assert!(proof.verify(&absent, Some(Digest::of("value")), &root).is_err());
    }
}

pub fn vkey_of(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(text(b)?.parse::<NoteVerifier>().ok()?.to_string().into_bytes()));
}

pub fn public_key(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(text(b)?.parse::<PublicKey>().ok()?.to_string().into_bytes()));
    if let Ok(bytes) = <&[u8; 32]>::try_from(input) {
        let _ = PublicKey::from_bytes(bytes);
    }
}

pub fn complete_answer(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(Answer::parse(b).ok()?.to_json().into_bytes()));
}

pub fn map_list(input: &[u8]) {
    reads_what_it_writes(input, |b| {
        let mut written = Vec::new();
        ListState::decode(b).ok()?.0.encode(&mut written);
        Some(written)
    });
}

/// As PEM, and as a file.
pub fn key_file(input: &[u8]) {
    reads_what_it_writes(input, |b| Some(OwnerKey::from_pem(text(b)?).ok()?.to_pem().ok()?.as_bytes().to_vec()));
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut open = fs::OpenOptions::new();
    open.write(true).mode(0o600).open(file.path()).unwrap().write_all(input).unwrap();
    if let Err(refused) = load_key(file.path(), &Unlock::Nothing) {
        assert!(refused.to_string().contains(&file.path().display().to_string()), "{refused}");
    }
}
