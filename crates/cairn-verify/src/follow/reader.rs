//! Hashes of a log's tree, read from its tiles; and what those say about two sizes at once.

use std::collections::BTreeMap;

use cairn_log::format::{
    Digest,
    leaf::LEAF_LEN,
    merkle,
    tile::{TILE_WIDTH, TileKind, TilePath},
};

use super::fetch::{Fetch, FollowError};

/// Most tiles that are kept, so that a log cannot fill the memory: those of two sizes' borders are fewer.
const MAX_KEPT: usize = 1024;

/// Reads the tiles of one log as it is at `size`, each once.
pub(super) struct Reader<'a> {
    log: &'a dyn Fetch,
    size: u64,
    kept: BTreeMap<Place, Vec<Digest>>,
}

/// Level and index.
type Place = (u8, u64);

impl<'a> Reader<'a> {
    pub(super) fn new(log: &'a dyn Fetch, size: u64) -> Self {
        Self { log, size, kept: BTreeMap::new() }
    }

    /// Paths and bytes of the tiles that were read: the evidence.
    pub(super) fn into_files(self) -> Vec<(String, Vec<u8>)> {
        let file = |((level, index), hashes): (Place, Vec<Digest>)| {
            let width = hashes.len() as u16;
            let path = TilePath { kind: TileKind::Hashes(level), index, width }.to_string();
            (path, hashes.iter().flat_map(|h| *h.as_bytes()).collect())
        };
        self.kept.into_iter().map(file).collect()
    }

    /// Roots at `from` and at `to`, both made of the same hashes: where the second is the one signed, so is every hash in it,
    /// and then the first is what this log was at `from`.
    pub(super) fn roots(&mut self, from: u64, to: u64) -> Result<(Digest, Digest), FollowError> {
        self.both(0, to, from)
    }

    /// Hashes of the full subtrees that the tree of `size` leaves is made of, largest first.
    pub(super) fn peaks(&mut self, size: u64) -> Result<Vec<Digest>, FollowError> {
        let mut peaks = Vec::new();
        let mut first = 0;
        for height in (0..64).rev().filter(|height| size >> height & 1 == 1) {
            peaks.push(self.full(height, first >> height)?);
            first += 1 << height;
        }
        Ok(peaks)
    }

    /// Roots over `lo..middle` and `lo..hi`.
    fn both(&mut self, lo: u64, hi: u64, middle: u64) -> Result<(Digest, Digest), FollowError> {
        if middle == hi {
            let hash = self.range(lo, hi)?;
            return Ok((hash, hash));
        }
        let split = lo + split(hi - lo);
        if middle <= split {
            let (first, left) = self.both(lo, split, middle)?;
            let right = self.range(split, hi)?;
            return Ok((first, merkle::node_hash(&left, &right)));
        }
        let left = self.range(lo, split)?;
        let (first, right) = self.both(split, hi, middle)?;
        Ok((merkle::node_hash(&left, &first), merkle::node_hash(&left, &right)))
    }

    fn range(&mut self, lo: u64, hi: u64) -> Result<Digest, FollowError> {
        let width = hi - lo;
        if width.is_power_of_two() {
            return self.full(width.trailing_zeros(), lo / width);
        }
        let split = lo + split(width);
        let (left, right) = (self.range(lo, split)?, self.range(split, hi)?);
        Ok(merkle::node_hash(&left, &right))
    }

    /// The full subtree `index` of height `height`.
    fn full(&mut self, height: u32, index: u64) -> Result<Digest, FollowError> {
        let (level, above) = ((height / 8) as u8, height % 8);
        let first = index << above;
        let tile = self.tile(level, first / u64::from(TILE_WIDTH))?;
        let at = (first % u64::from(TILE_WIDTH)) as usize;
        let hashes = tile.get(at..at + (1 << above)).ok_or_else(|| FollowError::Missing {
            path: format!("hash {} of level {}", first, 8 * u32::from(level)),
        })?;
        Ok(merkle::root(hashes))
    }

    fn tile(&mut self, level: u8, index: u64) -> Result<&[Digest], FollowError> {
        let kind = TileKind::Hashes(level);
        if !self.kept.contains_key(&(level, index)) {
            let path = TilePath::in_tree(kind, index, self.size)
                .ok_or_else(|| FollowError::Missing { path: format!("tile {index} of level {level}") })?;
            let bytes = tile(self.log, path)?;
            if self.kept.len() >= MAX_KEPT {
                self.kept.clear();
            }
            let hashes = bytes.as_chunks::<32>().0.iter().map(|h| Digest::from_bytes(*h)).collect();
            self.kept.insert((level, index), hashes);
        }
        Ok(self.kept.get(&(level, index)).map_or(&[], Vec::as_slice))
    }
}

/// A tile's or bundle's bytes, exactly as many as its width asks for. A log may drop partial tiles once the full one is there.
pub(super) fn tile(log: &dyn Fetch, path: TilePath) -> Result<Vec<u8>, FollowError> {
    let each = match path.kind {
        TileKind::Hashes(_) => 32,
        TileKind::Entries => 2 + LEAF_LEN,
    };
    let needed = each * usize::from(path.width);
    let full = TilePath { width: TILE_WIDTH, ..path };
    let mut bytes = log.fetch(&path.to_string(), needed)?;
    if bytes.is_none() && path != full {
        bytes = log.fetch(&full.to_string(), each * usize::from(TILE_WIDTH))?;
    }
    let mut bytes = bytes.ok_or_else(|| FollowError::Missing { path: path.to_string() })?;
    if bytes.len() < needed {
        return Err(FollowError::Short { path: path.to_string(), expected: needed, got: bytes.len() });
    }
    bytes.truncate(needed);
    Ok(bytes)
}

/// Largest power of two below `n`.
fn split(n: u64) -> u64 {
    1 << (63 - (n - 1).leading_zeros())
}
