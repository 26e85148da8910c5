//! The log as a whole: chunk by chunk in order, its root, the roots of its map, and what
//! a record may not say given what came before it.

use std::collections::{HashMap, HashSet};

use cairn_log::format::{
    Checkpoint, Digest, Envelope, MapEntry, MapKey, MapTree, OwnerRecord, RecordKind,
    merkle::{self, Frontier},
    packs::{self, Slot},
    tile::{TILE_WIDTH, TileKind},
};
use rayon::prelude::*;

use super::{
    chunk::{self, Chunk, Context, Said},
    files::{CHUNK, ENTRY, Files, StoreError},
    options::StoreOptions,
    record::Replacing,
    replaced::{self, Endings, owners_of},
    report::Tally,
    tail, tiles,
};
use crate::{code::Code, report::Findings};

/// Checks everything under `public/` but the checkpoint, and everything under `envelopes/`.
pub(super) fn check(
    files: &Files,
    options: &StoreOptions<'_>,
    checkpoint: Option<&Checkpoint>,
    tally: &mut Tally,
    findings: &mut Findings,
) -> Result<(), StoreError> {
    let size = checkpoint.map_or(0, |c| c.size);
    let key = options.pinned.or(options.found);
    let origin = checkpoint.map(|c| c.origin.as_str()).or(key.map(|key| key.name()));
    let extent = extent(files, size);
    let mut context = Context {
        files,
        origin,
        key,
        stock: options.stock,
        rotated: HashMap::new(),
        before: Frontier::default(),
        size,
        root: checkpoint.map(|c| c.root),
        extent,
    };
    context.rotated = owners_of(&context, &rotated(&context)).into_iter().map(|(r, (_, o))| (r, o)).collect();
    let mut pass = Pass { size, ..Pass::default() };
    // Enough at a time to keep every core busy, few enough to fit: a chunk is 34 MB at the very most.
    let window = 2 * rayon::current_num_threads() as u64;
    let (chunks, mut first) = (extent.div_ceil(CHUNK), 0);
    // The chunk in which the published tree ends has a window of its own: the root decides what is right there.
    let end = size / CHUNK;
    while first < chunks {
        let last = if first < end { (first + window).min(chunks).min(end) } else { (first + 1).min(chunks) };
        if first == end {
            context.before = pass.tree.clone();
        }
        let checked: Vec<Chunk> = (first..last).into_par_iter().map(|at| chunk::check(&context, at)).collect();
        for chunk in checked {
            pass.take(&context, chunk, tally, findings);
        }
        first = last;
    }
    pass.stack.finish(files, size, findings);
    pass.finish(&context, checkpoint, tally, findings);
    replaced::check(&context, &pass.replacing, &pass.endings, findings);
    tail::check(&context, chunks, findings)
}

/// How many entries there are: the published ones, and those that were on their way behind them. Stops at the first
/// chunk of which there is neither bundle nor envelopes, so that no forged size makes the audit endless.
fn extent(files: &Files, size: u64) -> u64 {
    let mut extent = 0;
    for index in 0.. {
        let bundle = tiles::widest(files, TileKind::Entries, index, ENTRY).map_or(0, |(path, _)| path.width);
        let published = size.saturating_sub(index * CHUNK).min(CHUNK);
        let width = u64::from(bundle).max(published);
        if width == 0 || (bundle == 0 && !matches!(files.envelopes(index), Ok(Some(_)))) {
            break;
        }
        extent = index * CHUNK + width;
        if width < CHUNK {
            break;
        }
    }
    extent
}

/// The records that rotations replace: the map lists a rotation under their owners' keys, which it does not name.
fn rotated(context: &Context<'_>) -> HashSet<Digest> {
    let of_chunk = |index: u64| -> Vec<Digest> {
        let Some((_, bundle)) = tiles::widest(context.files, TileKind::Entries, index, ENTRY) else {
            return Vec::new();
        };
        let entries = bundle.as_chunks::<ENTRY>().0;
        let rotations: Vec<usize> =
            (0..entries.len()).filter(|at| entries[*at][3] == RecordKind::Rotation.code()).collect();
        if rotations.is_empty() {
            return Vec::new();
        }
        let bytes = context.files.envelopes(index).ok().flatten().unwrap_or_default();
        let (slots, _) = packs::parse_whole(&bytes);
        let replaced = |at: usize| match slots.get(at)? {
            Slot::Record(json) => OwnerRecord::parse(&Envelope::parse(json).ok()?.payload).ok()?.replaces,
            Slot::Erased(_) | Slot::MapLeaf => None,
        };
        rotations.into_iter().filter_map(replaced).collect()
    };
    (0..context.extent.div_ceil(CHUNK)).into_par_iter().flat_map_iter(of_chunk).collect()
}

/// What is carried from one chunk to the next.
#[derive(Default)]
struct Pass {
    size: u64,
    stack: tiles::Stack,
    tree: Frontier,
    /// The root at the published size.
    published: Option<Digest>,
    map: MapTree,
    /// Sizes at which the log was signed, and half of each root: enough against accidents and
    /// 2^64 tries, at half the memory.
    sizes: Vec<(u64, [u8; 16])>,
    state: MapState,
    /// Chunks that hold erased records, since the newest map leaf that held.
    erased: Vec<u64>,
    /// Whether the published log ends in a map leaf.
    ends_in_map: bool,
    replacing: Vec<(u64, Replacing)>,
    /// How keys ended, by the map keys under which their ends are listed.
    endings: Endings,
}

/// Whether the map can still be recomputed.
#[derive(Default)]
enum MapState {
    #[default]
    Right,
    /// A record's keys are not known from this index on.
    Unknown(u64),
    /// A root was another; all behind it are, too.
    Wrong,
}

impl Pass {
    fn take(&mut self, context: &Context<'_>, chunk: Chunk, tally: &mut Tally, findings: &mut Findings) {
        let place = |index: u64| format!("{}, record {index}", context.files.name_envelopes(index / CHUNK));
        findings.append(chunk.findings);
        tally.in_stock += chunk.in_stock;
        self.replacing.extend(chunk.replacing);
        for ((index, hash), said) in (chunk.index * CHUNK..).zip(&chunk.hashes).zip(chunk.said) {
            match said {
                Said::Unknown => {
                    if matches!(self.state, MapState::Right) {
                        self.state = MapState::Unknown(index);
                    }
                }
                Said::Map { root } => self.map_leaf(context, index, &root, tally, findings),
                Said::Record { kind, keys, owner, seen } => {
                    tally.records += 1;
                    if self.map.get(&MapKey::ended(&owner)).is_some() {
                        let got = format!("one by key {owner}, which an earlier record ended");
                        findings.add(Code::StoreRecordRule, place(index), "a record by a key that is good", got);
                    } else {
                        replaced::note(&mut self.endings, kind, &keys, index, owner);
                    }
                    match seen {
                        Some(seen) if !self.was_signed(seen.size, &seen.root) => {
                            let got = format!("size {} with root {}", seen.size, seen.root);
                            let expected = "a checkpoint that this log signed before";
                            findings.add(Code::StoreRecordSeen, place(index), expected, got);
                        }
                        Some(_) => {}
                        None => {
                            tally.erased += 1;
                            if self.erased.last() != Some(&chunk.index) {
                                self.erased.push(chunk.index);
                            }
                        }
                    }
                    for key in keys {
                        self.map.append(key, &MapEntry { index, leaf_hash: *hash });
                    }
                }
            }
            self.tree.push(*hash);
            if self.tree.size() == self.size {
                self.published = Some(self.tree.root());
            }
            if self.sizes.last().is_some_and(|(size, _)| *size == index + 1) {
                let root = self.tree.root();
                if let Some(last) = self.sizes.last_mut() {
                    last.1.copy_from_slice(&root.as_bytes()[..16]);
                }
            }
        }
        if chunk.hashes.len() == usize::from(TILE_WIDTH) {
            self.stack.push(merkle::root(&chunk.hashes), context.files, self.size, findings);
        }
    }

    fn was_signed(&self, size: u64, root: &Digest) -> bool {
        if size == 0 {
            return *root == merkle::empty_root();
        }
        let at = self.sizes.binary_search_by_key(&size, |(size, _)| *size);
        at.is_ok_and(|at| self.sizes[at].1 == root.as_bytes()[..16])
    }

    fn map_leaf(
        &mut self,
        context: &Context<'_>,
        index: u64,
        root: &Digest,
        tally: &mut Tally,
        findings: &mut Findings,
    ) {
        tally.map_leaves += 1;
        self.sizes.push((index + 1, [0; 16]));
        self.ends_in_map |= index + 1 == self.size;
        if !matches!(self.state, MapState::Right) {
            return;
        }
        let got = self.map.root();
        if got == *root {
            self.erased.clear();
            tally.map_checked += 1;
            return;
        }
        self.state = MapState::Wrong;
        // The keys of erased records stand nowhere else, so one of them may have been changed.
        let mut places: Vec<String> = self.erased.iter().map(|at| context.files.name_envelopes(*at)).collect();
        places.push(format!("map leaf {index}"));
        let expected = format!("root {root}, as logged");
        findings.add(Code::StoreMapRoot, places.join(", "), expected, format!("{got} over the {index} leaves before"));
    }

    fn finish(
        &self,
        context: &Context<'_>,
        checkpoint: Option<&Checkpoint>,
        tally: &mut Tally,
        findings: &mut Findings,
    ) {
        tally.map_keys = self.map.len();
        let place = context.files.name_public("checkpoint");
        if let MapState::Unknown(index) = self.state {
            let place = format!("{}, record {index}", context.files.name_envelopes(index / CHUNK));
            findings.add(Code::StoreMapUnchecked, place, "keys of every record", "a record that does not hold");
        }
        let Some(checkpoint) = checkpoint else { return };
        match self.published {
            None if self.size == 0 => {}
            None => {
                let expected = format!("{} entries", self.size);
                findings.add(Code::StoreRoot, place, expected, format!("{} of them", self.tree.size()));
            }
            Some(root) if root != checkpoint.root => {
                findings.add(Code::StoreRoot, place, format!("root {}", checkpoint.root), root);
            }
            Some(root) => {
                let got = format!("size {}, root {root}", self.size);
                findings.add(Code::StoreRootVerified, place, "", got);
            }
        }
        let whole = matches!(self.state, MapState::Right);
        if self.size > 0 && !self.ends_in_map && whole && self.published.is_some() {
            let place = format!("entry {}", self.size - 1);
            findings.add(Code::StoreMapLeaf, place, "a map leaf as the published log's last", "none");
        }
        if whole && tally.map_leaves > 0 {
            let got = format!("{} roots over {} keys", tally.map_checked, tally.map_keys);
            findings.add(Code::StoreMapVerified, "map", "", got);
        }
        if tally.records > 0 && !findings.has_class(super::Class::Records) {
            let got = format!("{} records, {} of them erased", tally.records, tally.erased);
            findings.add(Code::StoreRecordsVerified, "registry/envelopes", "", got);
        }
    }
}
