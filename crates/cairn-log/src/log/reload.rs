//! Reading at the start: what the root rests on, and what the last stop may have left half done.
//!
//! A start costs the tiles along the right edge, the leaves that are in no full tile yet, and the tops of
//! the map's buckets; not a walk over the log. What lies further in was signed for when it was written, and whoever
//! reads it checks it then ([`super::Registry::check`] and auditors read all).

use std::{collections::HashMap, sync::Arc};

use super::{
    anchor::{Anchor, Standing},
    error::{RegistryError, inconsistent},
    layout,
    nonce::NONCE_LIFETIME,
    shared::{Published, Publisher, State, Writer},
    tiles::TileTree,
};
use crate::{
    format::{
        checkpoint::Checkpoint,
        digest::Digest,
        key::OwnerKey,
        leaf::LEAF_LEN,
        map_leaf::Entry,
        merkle::{self, leaf_hash},
        note::{Note, NoteVerifier, check_name},
        packs::{self, Slot},
        tile::{TILE_WIDTH, TileKind, TilePath, decode_entries},
    },
    log::{
        map::{BucketMap, BucketTop},
        store::Store,
    },
};
use cairn_durable::Files;

/// Entries of the store read at a time.
const PAGE: usize = 4096;

/// Bytes of a leaf in its bundle.
const ENTRY: usize = 2 + LEAF_LEN;

/// Largest checkpoint file that is read, bytes: it has a line for every witness.
const MAX_CHECKPOINT: u64 = 1 << 16;

/// What was found.
pub(super) struct Loaded {
    pub(super) state: State,
    pub(super) writer: Writer,
    pub(super) publisher: Publisher,
    /// See [`layout::NONCES_FROM`].
    pub(super) nonces_from: u64,
    /// How the log stands to its anchor, where it has one.
    pub(super) standing: Standing,
}

/// Reads the log and refuses it where it contradicts what was signed; makes an empty one in an empty store. Nothing is signed
/// for others to see, and nothing taken away behind the log's end, before the anchor is where the log is.
pub(super) fn reload(
    store: &dyn Store,
    files: &Arc<Files>,
    key: &OwnerKey,
    origin: &str,
    anchor: Option<&Anchor>,
) -> Result<Loaded, RegistryError> {
    check_name(origin)?;
    match store.get(layout::FORMAT)? {
        Some(format) => {
            expect("format", layout::FORMAT_VERSION, Some(format))?;
            expect("origin", origin, store.get(layout::ORIGIN)?)?;
            expect("registry key", &key.public().to_string(), store.get(layout::REGISTRY_KEY)?)?;
        }
        None => create(store, key, origin)?,
    }
    let filed = number_at(store, layout::FILED, || "filed leaves".into())?.unwrap_or(0);
    let mut tree = TileTree::load(files.clone(), filed)?;
    read_tail(store, &mut tree)?;
    let (size, root) = hold_to_signed(store, &tree)?;
    let published = published(files, key, origin)?;
    if let Some((_, known)) = &published {
        extends(&tree, size, known)?;
    }
    let standing = anchor.map_or(Ok(Standing::Behind), |anchor| anchor.hold(&tree, size, files, origin))?;
    let map = read_map(store)?;
    hold_to_map_leaf(store, files, size, &map, key, origin)?;
    let writer = Writer { pack_length: pack_length(files, size)?, used: read_nonces(store, size)? };
    // Also where nothing changed: what was read may be written and not yet durable.
    store.flush()?;
    let checkpoint = Checkpoint::new(origin, size, root).sign(key)?.to_string();
    let cosigned = published.as_ref().filter(|(note, _)| is_cosigned(note));
    let cosigned = cosigned.map(|(note, known)| (known.size, note.clone()));
    Ok(Loaded {
        state: State { tree, map, size, root, checkpoint, cosigned },
        writer,
        publisher: Publisher {
            filed,
            published: published.map(|(checkpoint, known)| Published { size: known.size, checkpoint }),
        },
        nonces_from: number_at(store, layout::NONCES_FROM, || "first size of good nonces".into())?.unwrap_or(0),
        standing,
    })
}

fn create(store: &dyn Store, key: &OwnerKey, origin: &str) -> Result<(), RegistryError> {
    if let Some((key, _)) = store.scan(&[], &[], 1)?.first() {
        let what = format!("begins with {key:?}, but no format version is there");
        return Err(inconsistent("first entry", what));
    }
    store.put(layout::identity(origin, &key.public(), 0, &merkle::empty_root()))?;
    store.flush()?;
    Ok(())
}

/// Pushes the leaves that are in no full tile yet.
fn read_tail(store: &dyn Store, tree: &mut TileTree) -> Result<(), RegistryError> {
    loop {
        let page = store.scan(layout::LEAVES, &merkle::Subtrees::size(tree).to_be_bytes(), PAGE)?;
        if page.is_empty() {
            return Ok(());
        }
        for (key, leaf) in page {
            let index = merkle::Subtrees::size(tree);
            let found = key.strip_prefix(layout::LEAVES).and_then(layout::number);
            if found != Some(index) {
                return Err(inconsistent(&format!("leaf {index}"), format!("missing, {found:?} follows")));
            }
            if leaf.len() != LEAF_LEN {
                let what = format!("{} bytes, expected {LEAF_LEN}", leaf.len());
                return Err(inconsistent(&format!("leaf {index}"), what));
            }
            tree.push(leaf_hash(&leaf));
        }
    }
}

/// Size and root, which must be what was signed last or was about to be.
fn hold_to_signed(store: &dyn Store, tree: &TileTree) -> Result<(u64, Digest), RegistryError> {
    let size = merkle::Subtrees::size(tree);
    let root = merkle::root_at(tree, size)?;
    let signed = store.get(layout::SIGNED)?.as_deref().and_then(layout::parse_signed);
    let Some((signed_size, signed_root)) = signed else {
        return Err(inconsistent("last signed checkpoint", "missing or not 40 bytes".into()));
    };
    if signed_size != size {
        let what = format!("{size} leaves, a checkpoint over {signed_size} was signed");
        return Err(inconsistent("leaves", what));
    }
    if root != signed_root {
        let what = format!("root over the first {size} is {root}, {signed_root} was signed");
        return Err(inconsistent("leaves", what));
    }
    Ok((size, root))
}

/// The checkpoint that monitors were shown last: this log's own word, also where the store forgot it.
pub(super) fn published(
    files: &Files,
    key: &OwnerKey,
    origin: &str,
) -> Result<Option<(String, Checkpoint)>, RegistryError> {
    let Some(bytes) = files.read(layout::CHECKPOINT, MAX_CHECKPOINT)? else { return Ok(None) };
    let refuse = |what: String| inconsistent(layout::CHECKPOINT, what);
    let note = String::from_utf8(bytes).map_err(|e| refuse(e.to_string()))?;
    let verifier = NoteVerifier::new(origin, key.public())?;
    let checkpoint = Checkpoint::verify(&note, &verifier).map_err(|e| refuse(e.to_string()))?;
    Ok(Some((note, checkpoint)))
}

/// Whether a tree of `size` leaves goes on from a known checkpoint.
pub(super) fn extends(tree: &TileTree, size: u64, known: &Checkpoint) -> Result<(), RegistryError> {
    let what = if known.size > size {
        format!("{size} leaves, known is a checkpoint over {}", known.size)
    } else {
        let root = merkle::root_at(tree, known.size)?;
        if root == known.root {
            return Ok(());
        }
        format!("root at size {} is {root}, known is {}", known.size, known.root)
    };
    Err(inconsistent("leaves", what))
}

/// The map, from what stands at the roots of its buckets.
fn read_map(store: &dyn Store) -> Result<BucketMap, RegistryError> {
    let mut tops = Vec::new();
    let mut from = Vec::new();
    loop {
        let page = store.scan(layout::TOPS, &from, PAGE)?;
        let Some((key, _)) = page.last() else { break };
        // The next key behind the last one.
        from = [&key[layout::TOPS.len()..], &[0]].concat();
        for (key, value) in page {
            let bucket = key[layout::TOPS.len()..].try_into().map(u32::from_be_bytes);
            let bucket = bucket.map_err(|_| inconsistent("map", format!("key {key:?}")))?;
            let top = BucketTop::decode(bucket, &value);
            tops.push((bucket, top.map_err(|e| inconsistent(&format!("map, bucket {bucket}"), e.to_string()))?));
        }
    }
    Ok(BucketMap::from_tops(tops.into_iter()))
}

/// The log's last leaf must be this registry's word on the very map that the store holds.
fn hold_to_map_leaf(
    store: &dyn Store,
    files: &Files,
    size: u64,
    map: &BucketMap,
    key: &OwnerKey,
    origin: &str,
) -> Result<(), RegistryError> {
    let Some(index) = size.checked_sub(1) else { return Ok(()) };
    let refuse = |what: String| inconsistent(&format!("leaf {index}"), what);
    let leaf = match Entry::decode(&leaf_bytes(store, files, index)?).map_err(|e| refuse(e.to_string()))? {
        Entry::Map(leaf) => leaf,
        Entry::Record(_) => return Err(refuse("the log's last one is no map leaf".into())),
    };
    leaf.verify(origin, index, &key.public()).map_err(|e| refuse(e.to_string()))?;
    if leaf.root != map.root() {
        return Err(inconsistent("map", format!("root {}, the log's last leaf says {}", map.root(), leaf.root)));
    }
    Ok(())
}

/// A leaf from the store, or from its bundle once that is full.
pub(super) fn leaf_bytes(store: &dyn Store, files: &Files, index: u64) -> Result<Vec<u8>, RegistryError> {
    if let Some(leaf) = store.get(&layout::leaf(index))? {
        return Ok(leaf);
    }
    let width = u64::from(TILE_WIDTH);
    let path = layout::public(&TilePath { kind: TileKind::Entries, index: index / width, width: TILE_WIDTH });
    // Every leaf has the same length, and so a place of its own.
    let (at, length) = ((index % width) * ENTRY as u64, ENTRY);
    let entry = files.read_at(&path, at, length)?.filter(|entry| entry.len() == length);
    let missing = || inconsistent(&format!("leaf {index}"), format!("neither in the store nor in {path}"));
    let entry = entry.ok_or_else(missing)?;
    match decode_entries(&entry).map_err(|e| inconsistent(&path, e.to_string()))?.as_slice() {
        [leaf] => Ok(leaf.to_vec()),
        _ => Err(inconsistent(&path, format!("no leaf of {LEAF_LEN} bytes at its entry {}", index % width))),
    }
}

/// Nonces that are used and would still be good otherwise.
fn read_nonces(store: &dyn Store, size: u64) -> Result<HashMap<Digest, u64>, RegistryError> {
    let mut used = HashMap::new();
    let mut from = size.saturating_sub(NONCE_LIFETIME);
    loop {
        let page = store.scan(layout::NONCES, &from.to_be_bytes(), PAGE)?;
        if page.is_empty() {
            return Ok(used);
        }
        for (key, value) in page {
            let index = key.strip_prefix(layout::NONCES).and_then(layout::number);
            let nonce = Digest::try_from(value.as_slice());
            let (Some(index), Ok(nonce)) = (index, nonce) else {
                return Err(inconsistent("nonces", format!("entry {key:?} of {} bytes", value.len())));
            };
            used.insert(nonce, index);
            from = index + 1;
        }
    }
}

/// Bytes of the pack that the next entry goes into; what a crash left behind them is overwritten.
fn pack_length(files: &Files, size: u64) -> Result<u64, RegistryError> {
    let (number, held) = (size / u64::from(TILE_WIDTH), (size % u64::from(TILE_WIDTH)) as usize);
    if held == 0 { Ok(0) } else { Ok(held_slots(files, number, held)?.1 as u64) }
}

/// The first `held` slots of a pack, all of which have to be there, and how many bytes they take.
pub(super) fn held_slots(files: &Files, number: u64, held: usize) -> Result<(Vec<Slot>, usize), RegistryError> {
    let path = layout::pack(number);
    let pack = files.read(&path, packs::MAX_PACK)?.ok_or_else(|| inconsistent(&path, "the file is missing".into()))?;
    let (slots, length) = packs::parse(&pack, held).map_err(|e| inconsistent(&path, e.to_string()))?;
    if slots.len() != held {
        return Err(inconsistent(&path, format!("{} entries, {held} expected", slots.len())));
    }
    Ok((slots, length))
}

/// Takes away what a round left in packs that did not come to its end: somebody may want it erased when nobody
/// knows of it any more.
pub(super) fn cut_packs(files: &Files, size: u64, length: u64) -> Result<(), RegistryError> {
    let current = size / u64::from(TILE_WIDTH);
    if length > 0 {
        let path = layout::pack(current);
        let whole = files.open(&path)?.map_or(Ok(0), |file| file.size())?;
        if whole > length {
            files.append(&path, length, &[])?;
        }
    }
    for number in current + u64::from(length > 0).. {
        let path = layout::pack(number);
        if files.open(&path)?.is_none() {
            return Ok(());
        }
        files.remove(&path)?;
    }
    Ok(())
}

pub(super) fn number_at(
    store: &dyn Store,
    key: &[u8],
    place: impl Fn() -> String,
) -> Result<Option<u64>, RegistryError> {
    let Some(bytes) = store.get(key)? else { return Ok(None) };
    match layout::number(&bytes) {
        Some(number) => Ok(Some(number)),
        None => Err(inconsistent(&place(), format!("{} bytes, expected 8", bytes.len()))),
    }
}

fn expect(what: &'static str, expected: &str, got: Option<Vec<u8>>) -> Result<(), RegistryError> {
    let got = String::from_utf8_lossy(&got.unwrap_or_default()).into_owned();
    if got == expected {
        return Ok(());
    }
    Err(RegistryError::WrongStore { what, expected: expected.to_owned(), got })
}

/// Signature lines of a note beyond the log's own.
pub(super) fn is_cosigned(note: &str) -> bool {
    Note::parse(note).is_ok_and(|note| note.signatures.len() > 1)
}
