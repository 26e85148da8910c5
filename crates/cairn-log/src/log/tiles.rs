//! The log's Merkle tree as the registry keeps it: full tiles in files, the right edge in memory.
//!
//! A tile (256 hashes, C2SP tlog-tiles) holds eight levels of the tree in one: what lies between its
//! hashes and its root is worked out when it is asked for. So ten million leaves take a few
//! kilobytes of memory beside the cache, a start reads the tiles along the right edge and nothing else, and a
//! proof reads one tile a level of tiles.

use std::{
    collections::BTreeMap,
    num::NonZeroUsize,
    sync::{Arc, Mutex, PoisonError},
};

use lru::LruCache;

use super::{
    error::{RegistryError, inconsistent},
    layout,
};
use crate::format::{
    digest::Digest,
    merkle::{self, ProofError, Subtrees},
    tile::{TILE_WIDTH, TileKind, TilePath},
};
use cairn_durable::Files;

const WIDTH: usize = TILE_WIDTH as usize;
/// Levels of the tree in a tile.
const LEVELS: u32 = 8;
/// Full tiles kept in memory, 8 KiB each.
const CACHED: NonZeroUsize = NonZeroUsize::new(512).unwrap();

/// A tile's hashes.
pub(super) type Hashes = Arc<[Digest]>;
/// A full tile: its level among tiles, and its index there.
pub(super) type TileName = (u8, u64);

/// The tree.
pub(super) struct TileTree {
    size: u64,
    /// For every level of tiles the hashes of its last, partial tile: fewer than 256.
    edge: Vec<Vec<Digest>>,
    /// Full tiles that are not in files yet.
    fresh: BTreeMap<TileName, Hashes>,
    cache: Mutex<LruCache<TileName, Hashes>>,
    files: Arc<Files>,
}

impl TileTree {
    /// The tree over the first `filed` leaves (a multiple of 256), all of whose full tiles are in files.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] names the tile that is missing or damaged.
    pub(super) fn load(files: Arc<Files>, filed: u64) -> Result<Self, RegistryError> {
        let mut tree = Self {
            size: filed,
            edge: Vec::new(),
            fresh: BTreeMap::new(),
            cache: Mutex::new(LruCache::new(CACHED)),
            files,
        };
        for level in 1.. {
            let count = filed.checked_shr(LEVELS * u32::from(level)).unwrap_or(0);
            if count == 0 {
                break;
            }
            let first = count - count % u64::from(TILE_WIDTH);
            let below = (first..count).map(|index| Ok(merkle::root(&tree.read(level - 1, index)?)));
            let hashes = below.collect::<Result<_, RegistryError>>()?;
            tree.edge.resize(usize::from(level), Vec::new());
            tree.edge.push(hashes);
        }
        Ok(tree)
    }

    /// Appends a leaf hash; gives its index.
    pub(super) fn push(&mut self, leaf_hash: Digest) -> u64 {
        let index = self.size;
        self.size += 1;
        let (mut hash, mut count) = (leaf_hash, self.size);
        for level in 0_u8.. {
            let at = usize::from(level);
            if self.edge.len() == at {
                self.edge.push(Vec::new());
            }
            self.edge[at].push(hash);
            if self.edge[at].len() < WIDTH {
                break;
            }
            let full: Hashes = std::mem::take(&mut self.edge[at]).into();
            hash = merkle::root(&full);
            count /= u64::from(TILE_WIDTH);
            self.fresh.insert((level, count - 1), full);
        }
        index
    }

    /// Hash of leaf `index`.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for an index that is not there.
    pub(super) fn leaf(&self, index: u64) -> Result<Digest, RegistryError> {
        self.node(0, index)
    }

    /// The full tiles that are not in files yet, lowest level first.
    pub(super) fn fresh(&self) -> Vec<(TileName, Hashes)> {
        self.fresh.iter().map(|(name, hashes)| (*name, hashes.clone())).collect()
    }

    /// Takes note that tiles are in files now.
    pub(super) fn filed(&mut self, tiles: &[(TileName, Hashes)]) {
        for (name, _) in tiles {
            self.fresh.remove(name);
        }
    }

    /// The bytes of the tile at `path` as the tree of `size` leaves has it; none where that does not hold all of it.
    ///
    /// # Errors
    /// [`RegistryError::Inconsistent`] for a damaged file.
    pub(super) fn tile(&self, path: &TilePath, size: u64) -> Result<Option<Vec<u8>>, RegistryError> {
        let TileKind::Hashes(level) = path.kind else { return Ok(None) };
        let held = TilePath::in_tree(path.kind, path.index, size.min(self.size));
        if held.is_none_or(|held| path.width > held.width) {
            return Ok(None);
        }
        let hashes = self.hashes(level, path.index)?;
        Ok(hashes.get(..usize::from(path.width)).map(bytes_of))
    }

    fn hashes(&self, level: u8, index: u64) -> Result<Hashes, RegistryError> {
        if let Some(hashes) = self.fresh.get(&(level, index)) {
            return Ok(hashes.clone());
        }
        let count = self.size.checked_shr(LEVELS * u32::from(level)).unwrap_or(0);
        if index == count / u64::from(TILE_WIDTH) {
            return Ok(self.edge.get(usize::from(level)).map_or_else(|| [].into(), |edge| edge.as_slice().into()));
        }
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(hashes) = cache.get(&(level, index)) {
            return Ok(hashes.clone());
        }
        drop(cache);
        let hashes = self.read(level, index)?;
        cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        cache.put((level, index), hashes.clone());
        Ok(hashes)
    }

    /// A full tile from its file.
    fn read(&self, level: u8, index: u64) -> Result<Hashes, RegistryError> {
        let path = layout::public(&TilePath { kind: TileKind::Hashes(level), index, width: TILE_WIDTH });
        let bytes = self.files.read(&path, (WIDTH * Digest::LEN) as u64)?;
        let bytes = bytes.ok_or_else(|| inconsistent(&path, "the file is missing".into()))?;
        if bytes.len() != WIDTH * Digest::LEN {
            let what = format!("{} bytes, a full tile has {}", bytes.len(), WIDTH * Digest::LEN);
            return Err(inconsistent(&path, what));
        }
        let (hashes, _) = bytes.as_chunks::<{ Digest::LEN }>();
        Ok(hashes.iter().map(|hash| Digest::from_bytes(*hash)).collect())
    }
}

impl Subtrees for TileTree {
    type Error = RegistryError;

    fn size(&self) -> u64 {
        self.size
    }

    fn node(&self, level: u32, index: u64) -> Result<Digest, RegistryError> {
        let beyond = || ProofError::IndexBeyondSize { index, size: self.size };
        // Levels beyond a tile's own lie between the hashes of the tile above.
        let (tiles, within) = (level / LEVELS, level % LEVELS);
        let first = index.checked_shl(within).ok_or_else(beyond)?;
        let tile = self.hashes(tiles as u8, first / u64::from(TILE_WIDTH))?;
        let at = (first % u64::from(TILE_WIDTH)) as usize;
        let hashes = tile.get(at..at + (1 << within)).ok_or_else(beyond)?;
        Ok(merkle::root(hashes))
    }
}

/// A tile's bytes: its hashes one after the other.
pub(super) fn bytes_of(hashes: &[Digest]) -> Vec<u8> {
    hashes.iter().flat_map(|hash| *hash.as_bytes()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        format::{
            merkle::{leaf_hash, prove_consistency, prove_inclusion, root_at},
            testing::Tree,
        },
        log::store::FaultyStore,
    };

    fn file(tree: &mut TileTree) {
        let fresh = tree.fresh();
        let files: Vec<_> = (fresh.iter())
            .map(|((level, index), hashes)| {
                let path = TilePath { kind: TileKind::Hashes(*level), index: *index, width: TILE_WIDTH };
                (layout::public(&path), bytes_of(hashes))
            })
            .collect();
        tree.files.replace(&files).unwrap();
        tree.filed(&fresh);
    }

    #[test]
    fn it_says_what_the_tree_in_memory_says_filed_or_not_and_loaded_again() {
        let store = FaultyStore::new();
        let files = || Arc::new(Files::new(Box::new(store.clone())));
        let (mut plain, mut tiles) = (Tree::new(), TileTree::load(files(), 0).unwrap());
        assert_eq!(root_at(&tiles, 0).unwrap(), plain.root());
        for count in [1_u64, 255, 256, 257, 511, 512, 66_000] {
            while tiles.size() < count {
                let hash = leaf_hash(&tiles.size().to_be_bytes());
                assert_eq!(tiles.push(hash), plain.push(hash));
            }
            if count == 512 {
                file(&mut tiles);
            }
        }
        let compare = |tiles: &TileTree| {
            for size in [1, 2, 3, 255, 256, 257, 300, 512, 513, 65_535, 65_536, 65_537, 65_999, 66_000] {
                assert_eq!(root_at(tiles, size).unwrap(), plain.root_at(size).unwrap(), "{size}");
                for index in [0, 1.min(size - 1), size / 3, size / 2, size - 1] {
                    let proof = prove_inclusion(tiles, index, size).unwrap();
                    assert_eq!(proof, plain.prove_inclusion(index, size).unwrap(), "{index} of {size}");
                    if index > 0 {
                        let proof = prove_consistency(tiles, index, size).unwrap();
                        assert_eq!(proof, plain.prove_consistency(index, size).unwrap(), "{index} to {size}");
                    }
                }
            }
            assert!(prove_inclusion(tiles, 66_000, 66_000).is_err() && root_at(tiles, 66_001).is_err());
            for path in TilePath::all(66_000) {
                assert_eq!(tiles.tile(&path, 66_000).unwrap(), path.cut(&plain, 66_000), "{path}");
            }
        };
        compare(&tiles);
        file(&mut tiles);
        assert!(tiles.fresh().is_empty());
        compare(&tiles);
        let mut again = TileTree::load(files(), 66_000 - 66_000 % 256).unwrap();
        while again.size() < 66_000 {
            again.push(leaf_hash(&again.size().to_be_bytes()));
        }
        compare(&again);
    }

    #[test]
    fn a_tile_that_is_missing_or_short_is_named() {
        let store = FaultyStore::new();
        let mut tiles = TileTree::load(Arc::new(Files::new(Box::new(store.clone()))), 0).unwrap();
        for i in 0..600_u64 {
            tiles.push(leaf_hash(&i.to_be_bytes()));
        }
        file(&mut tiles);
        store.tamper_file("public/tile/0/001", |bytes| bytes.truncate(8191));
        let said = prove_inclusion(&tiles, 300, 600).unwrap_err().to_string();
        assert!(said.contains("public/tile/0/001"), "{said}");
        Files::new(Box::new(store.clone())).remove("public/tile/0/000").unwrap();
        let loaded = TileTree::load(Arc::new(Files::new(Box::new(store))), 512);
        let said = loaded.err().map(|e| e.to_string()).unwrap_or_default();
        assert!(said.contains("public/tile/0/000"), "{said}");
    }
}
