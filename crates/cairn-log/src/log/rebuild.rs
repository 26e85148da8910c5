//! Making the working state again from what is public: leaves and envelopes.
//!
//! Everything in the store follows from them, so that losing it, or finding it damaged, loses no record; only which nonces
//! erased records had used is forgotten, so that from then on none is good that one of them can have used. What was acknowledged and not published yet is there as well: its envelopes
//! were flushed before anything was signed, and the map leaf behind them follows from origin, index and root. Each map leaf
//! on the way must commit to the very map that comes out, and the root at the published size must be the one that was signed.
//! Until that is known no public file that is there is written over.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::Path,
    sync::Arc,
};

use super::{
    commit::{self, StoredBuckets},
    error::RegistryError,
    layout,
    nonce::NONCE_LIFETIME,
    reload, seal, tiles,
};
use crate::{
    format::{
        digest::Digest,
        key::OwnerKey,
        leaf::Leaf,
        map::{MapEntry, MapKey, keys_of},
        map_leaf::{Entry, MapLeaf},
        merkle::{self, Subtrees as _},
        packs::{self, Slot},
        record::RecordKind,
        signed::SignedRecord,
        tile::{TILE_WIDTH, TileKind, TilePath, decode_entries, encode_entries},
    },
    log::{
        map::BucketMap,
        store::{Change, DiskStore, Store, StoreError, TieredStore, await_closed},
    },
};
use cairn_durable::{Disk, Files, LockFile, RealDisk};

const WIDTH: u64 = TILE_WIDTH as u64;
/// Packs between two reports of progress.
const PACKS_AT_ONCE: u64 = 64;
/// Public files that differ from what the records give and are kept in memory until it is known who is right.
const MOST_WRONG: usize = 4096;

/// What was made again.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Rebuilt {
    /// Entries of the log.
    pub size: u64,
    /// Records among them, erased ones included.
    pub records: u64,
    /// Entries that were durable and not published yet.
    pub unpublished: u64,
    /// Tiles and bundles that were missing or differed, and were written again.
    pub tiles: u64,
    /// Slots behind the last whole round that were left out, one that is cut short included: of a round that was never
    /// acknowledged, unless the disk has lost some of what it had flushed.
    pub left_out: u64,
}

/// As [`super::Registry::rebuild`].
pub(super) fn rebuild(
    path: &Path,
    key: &OwnerKey,
    origin: &str,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Rebuilt, RegistryError> {
    let _lock = LockFile::take(&path.join(layout::LOCK))?;
    let (working, new) = (path.join(layout::WORKING), path.join(layout::REBUILT));
    if working.exists() {
        return Err(refuse(&working.display().to_string(), "is there; move it away first".into()));
    }
    // A seal that was left is on what is not there any more.
    drop(seal::Seal::break_open(path)?);
    cairn_durable::remove(&new)?;
    let store = DiskStore::open(&new)?;
    let disk = Box::new(RealDisk::new(path));
    let rebuilt = rebuild_store(Box::new(store), disk, layout::REBUILT_RUNS, layout::ENOUGH, key, origin, progress)?;
    await_closed(&new.join("db")).map_err(|e| StoreError::new("close", new.display(), e))?;
    cairn_durable::rename(&new, &working)?;
    Ok(rebuilt)
}

/// As [`super::Registry::rebuild_store`].
pub(super) fn rebuild_store(
    store: Box<dyn Store>,
    disk: Box<dyn Disk>,
    runs: &'static str,
    enough: usize,
    key: &OwnerKey,
    origin: &str,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Rebuilt, RegistryError> {
    let files = Arc::new(Files::new(disk));
    let store = TieredStore::open(store, files.clone(), runs, layout::COLD, enough)?;
    let Some((_, published)) = reload::published(&files, key, origin)? else {
        return Err(refuse(layout::CHECKPOINT, "is missing: nothing says what this log signed".into()));
    };
    let mut making = Making {
        store: &store,
        files: &files,
        key,
        origin,
        published: published.size,
        filed: published.size - published.size % WIDTH,
        tree: tiles::TileTree::load(files.clone(), 0)?,
        map: BucketMap::new(),
        batch: Batch::default(),
        owners: HashSet::new(),
        nonces_from: 0,
        bundle: Vec::new(),
        wrong: Vec::new(),
        done: Rebuilt::default(),
    };
    for number in 0.. {
        if !making.take_pack(number)? {
            break;
        }
        making.compare_tiles()?;
        store.tidy(&|| false)?;
        if number % PACKS_AT_ONCE == 0 {
            progress(making.done.size, published.size);
        }
    }
    let (size, root) = (making.done.size, merkle::root_at(&making.tree, published.size.min(making.done.size))?);
    if size < published.size || root != published.root {
        let what = format!("gives {size} entries and root {root} at the published size {}", published.size);
        return Err(refuse("envelopes", format!("{what}, published is root {}", published.root)));
    }
    making.compare_tiles()?;
    files.replace(&making.wrong)?;
    making.finish()?;
    store.tidy(&|| false)?;
    progress(size, published.size);
    Ok(Rebuilt { unpublished: size - published.size, ..making.done })
}

/// A working state on its way.
struct Making<'a> {
    store: &'a TieredStore,
    files: &'a Files,
    key: &'a OwnerKey,
    origin: &'a str,
    /// Entries under the published checkpoint.
    published: u64,
    /// Of those, the ones in full tiles and bundles.
    filed: u64,
    tree: tiles::TileTree,
    map: BucketMap,
    batch: Batch,
    /// Key ids of all owners so far: whom an erased rotation ended shows only by trying.
    owners: HashSet<Digest>,
    /// Behind the newest erased record: one issued at a smaller size it may have used.
    nonces_from: u64,
    /// Leaves since the last full bundle.
    bundle: Vec<Vec<u8>>,
    /// Public files that differ from what the records give, and what these give.
    wrong: Vec<(String, Vec<u8>)>,
    done: Rebuilt,
}

/// Entries since the last map leaf.
#[derive(Default)]
struct Batch {
    leaves: Vec<Vec<u8>>,
    rows: Vec<Change>,
    map: BTreeMap<MapKey, Vec<MapEntry>>,
    owners: HashMap<Digest, Digest>,
}

impl Making<'_> {
    /// Takes in 256 entries, or what there is of them; whether there can be more.
    fn take_pack(&mut self, number: u64) -> Result<bool, RegistryError> {
        let path = layout::pack(number);
        let Some(pack) = self.files.read(&path, packs::MAX_PACK)? else { return Ok(false) };
        let (slots, torn) = packs::parse_whole(&pack);
        let (first, leaves) = (number * WIDTH, self.bundle(number)?);
        let mut taken = 0;
        for (at, slot) in slots.iter().enumerate() {
            let index = first + at as u64;
            match self.take(index, slot, leaves.get(at).map(Vec::as_slice)) {
                Ok(()) => taken += 1,
                // Behind what is published a round may have been cut short, anywhere in it.
                Err(RegistryError::Rebuild { .. }) if index >= self.published => break,
                Err(e) => return Err(e),
            }
        }
        if taken == WIDTH {
            return Ok(true);
        }
        let end = first + taken;
        if end < self.published {
            let what = torn.map_or_else(|| format!("ends before entry {end}"), |e| e.to_string());
            return Err(refuse(&path, what));
        }
        // With those of the round that these would have completed.
        self.done.left_out = slots.len() as u64 - taken + u64::from(torn.is_some()) + self.batch.leaves.len() as u64;
        Ok(false)
    }

    /// The published leaves of a bundle; none where its file is missing: records' follow from their envelopes.
    fn bundle(&self, number: u64) -> Result<Vec<Vec<u8>>, RegistryError> {
        let Some(path) = TilePath::in_tree(TileKind::Entries, number, self.published) else { return Ok(Vec::new()) };
        let path = layout::public(&path);
        let Some(bundle) = self.files.read(&path, 1 << 20)? else { return Ok(Vec::new()) };
        let leaves = decode_entries(&bundle).map_err(|e| refuse(&path, e.to_string()))?;
        Ok(leaves.into_iter().map(<[u8]>::to_vec).collect())
    }

    fn take(&mut self, index: u64, slot: &Slot, published: Option<&[u8]>) -> Result<(), RegistryError> {
        let refuse = |what: String| refuse(&format!("entry {index}"), what);
        let leaf = match slot {
            // Nothing but zeros is what a file system may leave of bytes that were not flushed.
            Slot::MapLeaf if self.batch.leaves.is_empty() => return Err(refuse("a map leaf behind no record".into())),
            Slot::MapLeaf => return self.close(index, published),
            Slot::Record(json) => self.take_record(index, json)?,
            Slot::Erased(keys) => {
                let leaf = published.ok_or_else(|| refuse("it is erased, and its leaf is missing".into()))?;
                let leaf = Leaf::decode(leaf).map_err(|e| refuse(e.to_string()))?;
                self.list(index, &leaf, keys);
                self.nonces_from = index + 1;
                if leaf.kind == RecordKind::Rotation
                    && let Some(ended) = self.owners.iter().find(|id| keys.contains(&MapKey::ended(id))).copied()
                {
                    self.retire(ended, index);
                }
                leaf
            }
        };
        if self.owner_of(&leaf.record)?.is_some() {
            return Err(refuse(format!("record {} is in the log before", leaf.record)));
        }
        let bytes = leaf.encode();
        if published.is_some_and(|published| published != bytes) {
            return Err(refuse("its published leaf is not its envelope's".into()));
        }
        if leaf.kind == RecordKind::Revocation {
            self.retire(leaf.owner, index);
        }
        self.owners.insert(leaf.owner);
        self.batch.owners.insert(leaf.record, leaf.owner);
        self.batch.leaves.push(bytes.to_vec());
        Ok(())
    }

    fn take_record(&mut self, index: u64, json: &[u8]) -> Result<Leaf, RegistryError> {
        let refuse = |what: String| refuse(&format!("entry {index}"), what);
        let signed = SignedRecord::parse(json).map_err(|e| refuse(e.to_string()))?;
        let (envelope, record, leaf) = signed.into_parts();
        if record.origin != self.origin {
            return Err(refuse(format!("of log {:?}, this is {:?}", record.origin, self.origin)));
        }
        if envelope.signature_by(&self.key.public()).is_none() {
            return Err(refuse("the registry's signature is missing or does not verify".into()));
        }
        let replaced = match record.replaces.filter(|_| record.kind == RecordKind::Rotation) {
            Some(digest) => Some(self.owner_of(&digest)?.ok_or_else(|| refuse(format!("{digest} is not in the log")))?),
            None => None,
        };
        self.list(index, &leaf, &keys_of(&record, replaced));
        if let Some(ended) = replaced {
            self.retire(ended, index);
        }
        if index + NONCE_LIFETIME >= self.published {
            self.batch.rows.push((layout::nonce(index), Some(record.nonce.as_bytes().to_vec())));
        }
        Ok(leaf)
    }

    fn list(&mut self, index: u64, leaf: &Leaf, keys: &[MapKey]) {
        let entry = MapEntry { index, leaf_hash: leaf.hash() };
        for key in keys {
            self.batch.map.entry(*key).or_default().push(entry);
            self.batch.rows.push(commit::entry_row(key, &entry));
        }
        self.batch.rows.push(layout::numbered(layout::index_of(&leaf.record), index));
    }

    fn retire(&mut self, owner: Digest, index: u64) {
        self.batch.rows.push(layout::numbered(layout::retired(&owner), index));
    }

    /// Key id of a record's owner.
    fn owner_of(&self, record: &Digest) -> Result<Option<Digest>, RegistryError> {
        if let Some(owner) = self.batch.owners.get(record) {
            return Ok(Some(*owner));
        }
        let Some(index) = reload::number_at(self.store, &layout::index_of(record), || format!("index of {record}"))?
        else {
            return Ok(None);
        };
        // From where it was looked for is not yet known to be right: whether it is, the roots will say.
        let recent = index.checked_sub(self.done.size - self.bundle.len() as u64);
        let leaf = match recent.and_then(|at| self.bundle.get(at as usize)) {
            Some(leaf) => leaf.clone(),
            None => reload::leaf_bytes(self.store, self.files, index)?,
        };
        match Entry::decode(&leaf) {
            Ok(Entry::Record(leaf)) => Ok(Some(leaf.owner)),
            _ => Err(refuse(&format!("entry {index}"), "it is named as a record and is none".into())),
        }
    }

    /// Ends a batch with its map leaf, which must commit to the map that came out.
    fn close(&mut self, index: u64, published: Option<&[u8]>) -> Result<(), RegistryError> {
        let refuse = |what: String| refuse(&format!("entry {index}"), what);
        let batch = std::mem::take(&mut self.batch);
        let staged = self.map.stage(&StoredBuckets(self.store), &batch.map)?;
        let leaf = match published {
            None => MapLeaf::sign(self.origin, index, staged.root, self.key),
            Some(bytes) => MapLeaf::decode(bytes).map_err(|e| refuse(e.to_string()))?,
        };
        leaf.verify(self.origin, index, &self.key.public()).map_err(|e| refuse(e.to_string()))?;
        if leaf.root != staged.root {
            return Err(refuse(format!("commits to a map with root {}, the records give {}", leaf.root, staged.root)));
        }
        let mut rows = batch.rows;
        rows.extend(commit::staged_rows(&staged));
        self.done.records += batch.leaves.len() as u64;
        for leaf in batch.leaves.into_iter().chain([leaf.encode().to_vec()]) {
            let index = self.tree.push(merkle::leaf_hash(&leaf));
            if index >= self.filed {
                rows.push((layout::leaf(index), Some(leaf.clone())));
            }
            self.done.size = index + 1;
            self.bundle.push(leaf);
            if self.bundle.len() as u64 == WIDTH {
                let leaves = std::mem::take(&mut self.bundle);
                if index < self.filed {
                    let path = TilePath { kind: TileKind::Entries, index: index / WIDTH, width: TILE_WIDTH };
                    let bundle = encode_entries(leaves.iter().map(Vec::as_slice));
                    self.compare(&path, bundle.map_err(|e| refuse(e.to_string()))?)?;
                }
            }
        }
        self.store.put(rows)?;
        self.map.apply(&staged);
        Ok(())
    }

    /// Holds the tiles that are full under the published checkpoint to their files; writes what is not as it should be.
    fn compare_tiles(&mut self) -> Result<(), RegistryError> {
        let within = |level: u8, index: u64| {
            TilePath::in_tree(TileKind::Hashes(level), index, self.filed).filter(|held| held.width == TILE_WIDTH)
        };
        let fresh = self.tree.fresh().into_iter();
        let full: Vec<_> = fresh.filter_map(|(name, hashes)| Some((within(name.0, name.1)?, (name, hashes)))).collect();
        for (path, (_, hashes)) in &full {
            self.compare(path, tiles::bytes_of(hashes))?;
        }
        self.tree.filed(&full.into_iter().map(|(_, tile)| tile).collect::<Vec<_>>());
        Ok(())
    }

    /// Holds a public file to what it should be. A missing one is written at once; one that differs may be right.
    fn compare(&mut self, path: &TilePath, bytes: Vec<u8>) -> Result<(), RegistryError> {
        let path = layout::public(path);
        match self.files.read(&path, u64::from(u32::MAX))? {
            Some(there) if there == bytes => return Ok(()),
            Some(_) if self.wrong.len() == MOST_WRONG => {
                return Err(refuse(
                    &path,
                    format!("more than {MOST_WRONG} public files are not those of these records"),
                ));
            }
            Some(_) => self.wrong.push((path, bytes)),
            None => self.files.replace(&[(path, bytes)])?,
        }
        self.done.tiles += 1;
        Ok(())
    }

    /// What makes the store one that a start accepts: last of all.
    fn finish(&self) -> Result<(), RegistryError> {
        let root = merkle::root_at(&self.tree, self.tree.size())?;
        let mut rows = layout::identity(self.origin, &self.key.public(), self.tree.size(), &root);
        rows.push(layout::numbered(layout::FILED.to_vec(), self.filed));
        rows.push(layout::numbered(layout::NONCES_FROM.to_vec(), self.nonces_from));
        self.store.put(rows)?;
        Ok(self.store.flush()?)
    }
}

fn refuse(place: &str, what: String) -> RegistryError {
    RegistryError::Rebuild { place: place.to_owned(), what }
}
