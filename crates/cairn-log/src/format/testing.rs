//! What only tests use: a whole tree in memory, and tiles cut from it.

use super::{
    digest::Digest,
    merkle::{ProofError, Subtrees, empty_root, node_hash, prove_consistency, prove_inclusion, root_at},
    tile::{MAX_LEVEL, TileKind, TilePath},
};

/// An append-only RFC 6962 tree that proves about itself at any of its sizes.
#[derive(Debug, Clone, Default)]
pub struct Tree {
    /// `levels[k][i]` is the hash of the full subtree over leaves `i * 2^k .. (i + 1) * 2^k`.
    levels: Vec<Vec<Digest>>,
}

impl Tree {
    /// The empty tree.
    pub fn new() -> Self {
        Self::default()
    }

    /// How many leaves.
    pub fn size(&self) -> u64 {
        self.levels.first().map_or(0, |leaves| leaves.len() as u64)
    }

    /// Appends a leaf hash; gives its index.
    pub fn push(&mut self, leaf_hash: Digest) -> u64 {
        let index = self.size();
        let mut hash = leaf_hash;
        for level in 0.. {
            if self.levels.len() == level {
                self.levels.push(Vec::new());
            }
            let row = &mut self.levels[level];
            row.push(hash);
            if row.len() % 2 == 1 {
                break;
            }
            hash = node_hash(&row[row.len() - 2], &row[row.len() - 1]);
        }
        index
    }

    /// Hash of leaf `index`, if there is one.
    pub fn leaf(&self, index: u64) -> Option<Digest> {
        self.levels.first()?.get(usize::try_from(index).ok()?).copied()
    }

    /// Hashes of level `level` (0: leaves), full subtrees only: what tiles are cut from.
    pub fn level(&self, level: usize) -> &[Digest] {
        self.levels.get(level).map_or(&[], Vec::as_slice)
    }

    /// Root over all leaves.
    pub fn root(&self) -> Digest {
        // All of the tree's own subtrees are there.
        self.root_at(self.size()).unwrap_or_else(|_| empty_root())
    }

    /// Root of the tree when it had `size` leaves.
    ///
    /// # Errors
    /// [`ProofError::IndexBeyondSize`] for a size that it has not reached.
    pub fn root_at(&self, size: u64) -> Result<Digest, ProofError> {
        root_at(self, size)
    }

    /// As [`prove_inclusion`].
    ///
    /// # Errors
    /// [`ProofError`] for an empty tree, an index beyond `size`, or a size not reached.
    pub fn prove_inclusion(&self, index: u64, size: u64) -> Result<Vec<Digest>, ProofError> {
        prove_inclusion(self, index, size)
    }

    /// As [`prove_consistency`].
    ///
    /// # Errors
    /// [`ProofError`] for `from` 0 or beyond `to`, or a size not reached.
    pub fn prove_consistency(&self, from: u64, to: u64) -> Result<Vec<Digest>, ProofError> {
        prove_consistency(self, from, to)
    }
}

impl Subtrees for Tree {
    type Error = ProofError;

    fn size(&self) -> u64 {
        Self::size(self)
    }

    fn node(&self, level: u32, index: u64) -> Result<Digest, ProofError> {
        let found = usize::try_from(index).ok().and_then(|at| self.level(level as usize).get(at));
        found.copied().ok_or(ProofError::IndexBeyondSize { index, size: self.size() })
    }
}

impl TilePath {
    /// All tiles of a tree of `size` leaves, entries aside: level by level, from the left.
    pub fn all(size: u64) -> impl Iterator<Item = Self> {
        (0..=MAX_LEVEL)
            .flat_map(move |level| (0..).map_while(move |index| Self::in_tree(TileKind::Hashes(level), index, size)))
    }

    /// The tile's bytes, cut from a tree; none where the tree, at `size` leaves, does not hold all of it, and for entries.
    pub fn cut(&self, tree: &Tree, size: u64) -> Option<Vec<u8>> {
        let TileKind::Hashes(level) = self.kind else { return None };
        let held = Self::in_tree(self.kind, self.index, size.min(tree.size()))?;
        if self.width > held.width {
            return None;
        }
        let first = usize::try_from(self.first()?).ok()?;
        let hashes = tree.level(8 * usize::from(level)).get(first..first + usize::from(self.width))?;
        Some(hashes.iter().flat_map(|hash| *hash.as_bytes()).collect())
    }
}
