//! Two hundred and fifty-six entries at a time: the leaves that the envelopes make,
//! those of the entry bundle, and the hashes of the tile, held to each other.
//!
//! Three witnesses to every leaf. A record's envelope is the best of them, since its
//! owner signed; a map leaf is signed by the registry; for an erased record there are only
//! the bundle and the tile, and the tile above says which of the two was changed.

use std::collections::HashMap;

use cairn_log::format::{
    Digest, Leaf, NoteVerifier, RecordKind,
    leaf::LEAF_LEN,
    map::{MapKey, keys_of},
    map_leaf::MapLeaf,
    merkle::{self, Frontier},
    packs::{self, Slot},
    record::Seen,
    tile::{TILE_WIDTH, TileKind, TilePath},
};

use super::{
    files::{CHUNK, ENTRY, Files},
    options::Stock,
    record::{self, Replacing, Sound},
    tiles,
};
use crate::{code::Code, report::Findings};

/// What every chunk is checked against.
pub(super) struct Context<'a> {
    pub(super) files: &'a Files,
    pub(super) origin: Option<&'a str>,
    pub(super) key: Option<&'a NoteVerifier>,
    pub(super) stock: Option<&'a Stock>,
    /// Record replaced by a rotation -> key id of its owner.
    pub(super) rotated: HashMap<Digest, Digest>,
    /// The tree over all chunks before the one in which the published tree ends; empty until that one's turn.
    pub(super) before: Frontier,
    /// Size of the published tree.
    pub(super) size: u64,
    /// Root of the published tree.
    pub(super) root: Option<Digest>,
    /// Entries that are there; at least the published ones where none is lost.
    pub(super) extent: u64,
}

/// What was found in a chunk.
#[derive(Default)]
pub(super) struct Chunk {
    pub(super) index: u64,
    pub(super) hashes: Vec<Digest>,
    /// What each leaf says; as many as hashes.
    pub(super) said: Vec<Said>,
    pub(super) findings: Findings,
    /// Indices of records that replace others, or take them back.
    pub(super) replacing: Vec<(u64, Replacing)>,
    /// Digests that records name and files of the folder have.
    pub(super) in_stock: u64,
}

/// What a leaf says to the map and to the log's rules.
pub(super) enum Said {
    /// A record, erased or not.
    Record { kind: RecordKind, keys: Vec<MapKey>, owner: Digest, seen: Option<Seen> },
    /// The map's root over all leaves before.
    Map { root: Digest },
    /// A record that cannot be read.
    Unknown,
}

type Bytes = [u8; LEAF_LEN];

/// Checks the chunk at `index`.
pub(super) fn check(context: &Context<'_>, index: u64) -> Chunk {
    let width = context.extent.saturating_sub(index * CHUNK).min(CHUNK) as usize;
    let mut chunk = Chunk { index, ..Chunk::default() };
    let entries = entries(context.files, index, width);
    let tile = tiles::widest(context.files, TileKind::Hashes(0), index, 32);
    let tile: Vec<Digest> =
        tile.iter().flat_map(|(_, bytes)| bytes.as_chunks::<32>().0).map(|h| Digest::from_bytes(*h)).collect();
    let bytes = envelope_file(context, index, width, &mut chunk.findings);
    let (slots, broken) = packs::parse_whole(&bytes);
    if let Some(cause) = broken.as_ref().filter(|_| slots.len() < width || context.is_full(index)) {
        let place = context.files.name_envelopes(index);
        chunk.findings.add(Code::StoreEnvelopeFile, place, format!("{width} frames"), cause);
    } else if slots.len() < width && !bytes.is_empty() {
        let place = context.files.name_envelopes(index);
        chunk.findings.add(Code::StoreEnvelopeFile, place, format!("{width} frames"), slots.len());
    }
    let mut leaves = Vec::with_capacity(width);
    for at in 0..width {
        let candidates = Candidates { entry: entries[at], tile: tile.get(at).copied() };
        let (hash, leaf, said) = one(context, &mut chunk, at, slots.get(at), &candidates, &tile);
        chunk.hashes.push(hash);
        chunk.said.push(said);
        leaves.push(leaf);
    }
    compare_entries(context, index, &leaves, &mut chunk.findings);
    tiles::compare(context.files, 0, index, &chunk.hashes, context.size, &mut chunk.findings);
    chunk
}

/// What the bundle and the tile say of one leaf.
struct Candidates {
    entry: Option<Bytes>,
    tile: Option<Digest>,
}

impl Candidates {
    fn entry_is_the_tiles(&self) -> bool {
        self.entry.is_some_and(|entry| self.tile == Some(merkle::leaf_hash(&entry)))
    }

    /// The leaf where nothing better is known: the bundle's, else the tile's hash.
    fn fallback(&self) -> (Digest, Option<Bytes>) {
        match (self.entry, self.tile) {
            (Some(entry), _) => (merkle::leaf_hash(&entry), Some(entry)),
            (None, tile) => (tile.unwrap_or(Digest::from_bytes([0; 32])), None),
        }
    }

    /// The leaf where the bundle is not believed: the tile's hash, else the bundle's.
    fn tile_first(&self) -> (Digest, Option<Bytes>) {
        self.tile.map_or_else(|| self.fallback(), |hash| (hash, None))
    }
}

impl Context<'_> {
    /// Whether all entries of the chunk are there.
    fn is_full(&self, index: u64) -> bool {
        (index + 1) * CHUNK <= self.extent
    }
}

/// One leaf: its hash, its bytes where they are known, and what it says.
fn one(
    context: &Context<'_>,
    chunk: &mut Chunk,
    at: usize,
    slot: Option<&Slot>,
    candidates: &Candidates,
    tile: &[Digest],
) -> (Digest, Option<Bytes>, Said) {
    let index = chunk.index * CHUNK + at as u64;
    let place = || format!("{}, record {index}", context.files.name_envelopes(chunk.index));
    let unknown = |(hash, leaf)| (hash, leaf, Said::Unknown);
    match slot {
        Some(Slot::Record(json)) => match record::check(json, context.origin, context.key.map(NoteVerifier::key)) {
            Err(fault) => {
                chunk.findings.add(fault.code, place(), fault.expected, fault.got);
                unknown(candidates.fallback())
            }
            Ok(sound) if candidates.entry_is_the_tiles() && candidates.entry != Some(sound.leaf) => {
                let expected = "the record that the log has at this index";
                chunk.findings.add(Code::StoreEnvelope, place(), expected, "another record");
                unknown(candidates.fallback())
            }
            Ok(sound) => (merkle::leaf_hash(&sound.leaf), Some(sound.leaf), read(context, chunk, index, sound)),
        },
        Some(Slot::Erased(keys)) => match candidates.entry.and_then(|entry| Leaf::decode(&entry).ok()) {
            Some(leaf) if candidates.entry_is_the_tiles() || !tile_is_right(context, chunk, at, candidates, tile) => {
                let said = Said::Record { kind: leaf.kind, keys: keys.clone(), owner: leaf.owner, seen: None };
                (leaf.hash(), candidates.entry, said)
            }
            _ => unknown(candidates.tile_first()),
        },
        Some(Slot::MapLeaf) | None => match map_leaf(context, index, candidates.entry.as_ref()) {
            Ok(root) => (candidates.fallback().0, candidates.entry, Said::Map { root }),
            // A file that is short was named as a whole.
            Err(_) if slot.is_none() => unknown(candidates.fallback()),
            Err(cause) if candidates.entry_is_the_tiles() => {
                let is_record = candidates.entry.is_some_and(|entry| Leaf::decode(&entry).is_ok());
                if is_record {
                    let expected = "the record that the log has at this index";
                    chunk.findings.add(Code::StoreEnvelopeFile, place(), expected, "an empty frame");
                } else {
                    let path = TilePath { kind: TileKind::Entries, index: chunk.index, width: TILE_WIDTH };
                    let place = format!("{}, entry {index}", context.files.name_tile(&path));
                    chunk.findings.add(Code::StoreMapLeaf, place, "a map leaf signed by the log", cause);
                }
                unknown(candidates.fallback())
            }
            Err(_) => unknown(candidates.tile_first()),
        },
    }
}

/// Whether, of a tile and a bundle that contradict each other about leaf `at`, the tile is right: the tile above tells,
/// and in the chunk where the published tree ends its root.
fn tile_is_right(context: &Context<'_>, chunk: &Chunk, at: usize, candidates: &Candidates, tile: &[Digest]) -> bool {
    let Some(entry) = candidates.entry else { return true };
    let mut other = tile.to_vec();
    other[at] = merkle::leaf_hash(&entry);
    if (chunk.index + 1) * CHUNK > context.size {
        let published = context.size.saturating_sub(chunk.index * CHUNK) as usize;
        let leads_to_root = |hashes: &[Digest]| {
            let mut tree = context.before.clone();
            hashes.iter().take(published).for_each(|hash| tree.push(*hash));
            Some(tree.root()) == context.root
        };
        return leads_to_root(tile) && !leads_to_root(&other);
    }
    let (above, position) = (chunk.index / CHUNK, (chunk.index % CHUNK) as usize);
    let parent = tiles::widest(context.files, TileKind::Hashes(1), above, 32);
    let parent = parent.as_ref().and_then(|(_, bytes)| bytes.as_chunks::<32>().0.get(position));
    let (Some(parent), true) = (parent, tile.len() == CHUNK as usize) else { return false };
    *merkle::root(tile).as_bytes() == *parent && *merkle::root(&other).as_bytes() != *parent
}

/// What a sound record says.
fn read(context: &Context<'_>, chunk: &mut Chunk, index: u64, sound: Sound) -> Said {
    let Sound { record, replacing, .. } = sound;
    let replaced = record.replaces.and_then(|replaces| context.rotated.get(&replaces).copied());
    chunk.replacing.extend(replacing.map(|r| (index, r)));
    if let Some(stock) = context.stock.and_then(|stock| stock.scenes.get(&record.scene)) {
        let digests = &record.digests;
        let named = [digests.marked_field, digests.detector, digests.training_configuration, digests.photographs];
        chunk.in_stock += named.into_iter().flatten().filter(|digest| stock.contains(digest)).count() as u64;
    }
    let place = || format!("{}, record {index}", context.files.name_envelopes(chunk.index));
    if record.seen.size > index {
        chunk.findings.add(Code::StoreRecordSeen, place(), format!("at most {index}"), record.seen.size);
    }
    if record.kind == RecordKind::Rotation && replaced.is_none() {
        chunk.findings.add(Code::StoreRecordRule, place(), "a rotation of a record of this log", "one of none");
        return Said::Unknown;
    }
    let (kind, owner) = (record.kind, record.owner_key.id());
    Said::Record { kind, keys: keys_of(&record, replaced), owner, seen: Some(record.seen) }
}

/// The root in a map leaf that holds: its form, that its statement is about the leaves before it, and the signature.
///
/// # Errors
/// What is wrong.
fn map_leaf(context: &Context<'_>, index: u64, entry: Option<&Bytes>) -> Result<Digest, String> {
    let leaf = MapLeaf::decode(entry.ok_or("no entry")?).map_err(|e| e.to_string())?;
    let checked = match (context.origin, context.key) {
        (Some(origin), Some(key)) => leaf.verify(origin, index, key.key()),
        (Some(origin), None) => leaf.verify_statement(origin, index),
        (None, _) => Ok(()),
    };
    checked.map(|()| leaf.root).map_err(|e| e.to_string())
}

/// The entries of the widest bundle that can be read; each none where it is not 162 bytes long.
fn entries(files: &Files, index: u64, width: usize) -> Vec<Option<Bytes>> {
    let bundle = tiles::widest(files, TileKind::Entries, index, ENTRY).map(|(_, bytes)| bytes).unwrap_or_default();
    let mut entries: Vec<Option<Bytes>> = (bundle.as_chunks::<ENTRY>().0.iter())
        .map(|e| (e[..2] == (LEAF_LEN as u16).to_be_bytes()).then(|| e[2..].try_into().ok()).flatten())
        .collect();
    entries.resize(width, None);
    entries
}

/// Holds every stored bundle of the chunk to the leaves; the newest must be there.
fn compare_entries(context: &Context<'_>, index: u64, leaves: &[Option<Bytes>], findings: &mut Findings) {
    let (files, kind) = (context.files, TileKind::Entries);
    let needed = TilePath::in_tree(kind, index, context.size).map_or(0, |tile| tile.width);
    let mut widest = 0;
    for path in tiles::stored(files, kind, index).filter(|path| usize::from(path.width) <= leaves.len()) {
        let name = files.name_tile(&path);
        match files.tile(&path) {
            Ok(None) => continue,
            Err(cause) => findings.add(Code::StoreEntry, name, "a bundle of entries", cause),
            Ok(Some(bytes)) if bytes.len() != usize::from(path.width) * ENTRY => {
                findings.add(Code::StoreEntry, name, usize::from(path.width) * ENTRY, format!("{} bytes", bytes.len()));
            }
            Ok(Some(bytes)) => {
                let same = |(entry, leaf): (&[u8; ENTRY], &Option<Bytes>)| {
                    leaf.is_some_and(|leaf| entry[..2] == (LEAF_LEN as u16).to_be_bytes() && entry[2..] == leaf)
                };
                if let Some(at) = bytes.as_chunks::<ENTRY>().0.iter().zip(leaves).position(|pair| !same(pair)) {
                    let place = format!("{name}, entry {}", index * CHUNK + at as u64);
                    findings.add(Code::StoreEntry, place, "the leaf that the log has there", "another");
                }
            }
        }
        widest = path.width;
    }
    if widest < needed {
        let path = TilePath { kind, index, width: needed };
        findings.add(Code::StoreEntry, files.name_tile(&path), format!("{needed} entries"), "no file");
    }
}

/// The file of envelopes; empty, and named, where it cannot be read.
fn envelope_file(context: &Context<'_>, index: u64, width: usize, findings: &mut Findings) -> Vec<u8> {
    let (bytes, got) = match context.files.envelopes(index) {
        Ok(Some(bytes)) if bytes.is_empty() && width > 0 => (bytes, "an empty file".to_owned()),
        Ok(Some(bytes)) => return bytes,
        Ok(None) => (Vec::new(), "no file".to_owned()),
        Err(cause) => (Vec::new(), cause),
    };
    findings.add(Code::StoreEnvelopeFile, context.files.name_envelopes(index), format!("{width} frames"), got);
    bytes
}
