//! Hostile input: every reader is fed mutations of good input, seeded; it may refuse, and what it takes it must write
//! back to something that it reads the same. None may panic.

use cairn_registry::{
    Answer, Checkpoint, Digest, Entry, Envelope, Leaf, MapEntry, MapKey, MapLeaf, MapProof, MapTree, Note,
    NoteVerifier, OwnerKey, OwnerRecord, PublicKey, TlogProof,
    answer::{AnswerError, AsOf, Format, List, ListedRecord, MAX_ANSWER_BYTES, MapPart},
    map::ListState,
    record::{Digests, Identity, RecordKind, Seen, VERSION},
    tile::{TilePath, decode_entries, encode_entries},
};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const ROUNDS: usize = 3000;

fn mutated(random: &mut ChaCha8Rng, good: &[u8]) -> Vec<u8> {
    let mut bytes = good.to_vec();
    for _ in 0..random.random_range(1..4) {
        let at = random.random_range(0..=bytes.len());
        match random.random_range(0..5) {
            0 => bytes.truncate(at),
            1 => bytes.insert(at, random.random()),
            2 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
            3 if at < bytes.len() => drop(bytes.remove(at)),
            // Doubles a stretch: repeated fields, lines, hashes.
            _ => {
                let from = random.random_range(0..=at);
                let stretch = bytes[from..at].to_vec();
                bytes.splice(at..at, stretch);
            }
        }
    }
    bytes
}

fn envelope() -> Envelope {
    let key = OwnerKey::from_seed(&[1; 32]);
    let record = OwnerRecord {
        version: VERSION,
        kind: RecordKind::Contribution,
        origin: "log".into(),
        scene: "fern".into(),
        scene_salt: Digest::of("salt"),
        identity: Identity { number: 1, contributor: "Ada".into() },
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

/// Feeds `read` with mutations; `read` gives what it would write for what it took. Tells how many were taken.
fn feed(good: &[u8], read: impl Fn(&[u8]) -> Option<Vec<u8>>) -> usize {
    let mut random = ChaCha8Rng::seed_from_u64(good.len() as u64);
    assert!(read(good).is_some(), "the good input itself");
    let mut taken = 0;
    for _ in 0..ROUNDS {
        let input = mutated(&mut random, good);
        if let Some(written) = read(&input) {
            taken += 1;
            assert_eq!(read(&written).as_ref(), Some(&written), "{}", String::from_utf8_lossy(&input));
        }
    }
    taken
}

fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

#[test]
fn no_reader_panics_and_each_reads_what_it_writes() {
    let key = OwnerKey::from_seed(&[1; 32]);
    let envelope = envelope();
    let note = Checkpoint::new("log", 1234, Digest::of("root")).sign(&key).unwrap();
    let checkpoint = note.to_string();
    let proof =
        TlogProof { extra: None, index: 3, hashes: vec![Digest::of("a"); 3], checkpoint: checkpoint.clone() }.to_text();
    let vkey = NoteVerifier::new("log", key.public()).unwrap().to_string();
    let entries = encode_entries([b"one".as_slice(), b"", b"three"]).unwrap();

    let taken = feed(envelope.to_json().as_bytes(), |b| Some(Envelope::parse(b).ok()?.to_json().into_bytes()));
    assert!(taken > 0, "labels and signatures may be anything before they are verified");
    feed(&envelope.payload, |b| serde_json::to_vec(&OwnerRecord::parse(b).ok()?).ok());
    feed(checkpoint.as_bytes(), |b| Some(Note::parse(text(b)?).ok()?.to_string().into_bytes()));
    feed(note.text.as_bytes(), |b| Some(Checkpoint::parse_text(text(b)?).ok()?.to_text().into_bytes()));
    feed(proof.as_bytes(), |b| Some(TlogProof::parse(text(b)?).ok()?.to_text().into_bytes()));
    feed(vkey.as_bytes(), |b| Some(text(b)?.parse::<NoteVerifier>().ok()?.to_string().into_bytes()));
    feed(key.public().to_string().as_bytes(), |b| Some(text(b)?.parse::<PublicKey>().ok()?.to_string().into_bytes()));
    feed(b"tile/3/x001/234.p/17", |b| Some(text(b)?.parse::<TilePath>().ok()?.to_string().into_bytes()));
    feed(&Leaf::of(&envelope).unwrap().encode(), |b| Some(Leaf::decode(b).ok()?.encode().to_vec()));
    feed(&entries, |b| encode_entries(decode_entries(b).ok()?).ok());
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
    let map_leaf = MapLeaf::sign("log", 9, map.root(), &OwnerKey::from_seed(&[1; 32])).encode();
    Answer {
        format: Format::V1,
        origin: "log".into(),
        scene: "fern".into(),
        view: Some(Digest::of("photograph")),
        checkpoint: "checkpoint\n".into(),
        as_of: Some(AsOf { checkpoint: "older\n".into(), consistency: hashes.clone() }),
        map: Some(MapPart { index: 9, leaf: map_leaf, inclusion: hashes.clone() }),
        lists,
        records: vec![ListedRecord { index: 3, leaf: leaf.encode(), inclusion: hashes, envelope: Some(envelope) }],
    }
}

#[test]
fn answers_and_maps_are_read_as_strictly() {
    let answer = answer();
    feed(answer.to_json().as_bytes(), |b| Some(Answer::parse(b).ok()?.to_json().into_bytes()));
    for list in &answer.lists {
        let proof = serde_json::to_vec(&list.proof).unwrap();
        feed(&proof, |b| serde_json::to_vec(&serde_json::from_slice::<MapProof>(b).ok()?).ok());
    }
    feed(&answer.map.as_ref().unwrap().leaf, |b| Some(Entry::decode(b).ok()?.encode().to_vec()));
    let mut list = ListState::default();
    (0..11).for_each(|index| list.append(&MapEntry { index, leaf_hash: Digest::of("leaf") }));
    let mut bytes = Vec::new();
    list.encode(&mut bytes);
    feed(&bytes, |b| {
        let mut written = Vec::new();
        ListState::decode(b).ok()?.0.encode(&mut written);
        Some(written)
    });
    let large = vec![b' '; MAX_ANSWER_BYTES + 1];
    assert_eq!(Answer::parse(&large), Err(AnswerError::TooLarge { got: MAX_ANSWER_BYTES + 1 }));
}

#[test]
fn a_mutated_record_is_never_taken_for_the_owners() {
    let good = envelope();
    let json = good.to_json();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut opened = 0;
    for _ in 0..ROUNDS {
        let Ok(envelope) = Envelope::parse(&mutated(&mut random, json.as_bytes())) else { continue };
        if let Ok((record, _)) = OwnerRecord::open(&envelope) {
            opened += 1;
            assert_eq!((&envelope.payload, &envelope.payload_type), (&good.payload, &good.payload_type));
            assert_eq!(Ok(record), OwnerRecord::parse(&good.payload));
        }
    }
    assert!(opened > 0, "mutations of labels leave the record as it is");
}

#[test]
fn noise_is_refused() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..ROUNDS {
        let mut noise = vec![0; random.random_range(0..300)];
        random.fill_bytes(&mut noise);
        assert!(Envelope::parse(&noise).is_err());
        assert!(OwnerRecord::parse(&noise).is_err());
        let text = String::from_utf8_lossy(&noise);
        assert!(Note::parse(&text).is_err());
        assert!(TlogProof::parse(&text).is_err());
        assert!(text.parse::<TilePath>().is_err());
    }
}
