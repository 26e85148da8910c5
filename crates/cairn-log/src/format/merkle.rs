//! RFC 6962 Merkle trees: hashing, roots, and the verification of proofs.
//!
//! Verification follows the iterative form of RFC 9162 (2.1.3.2 and 2.1.4.2),
//! with the proof's length fixed by index and sizes before a hash is looked at.
//!
//! Roots at any past size and proofs are made from the hashes of full subtrees, so they cost a logarithm, not a walk
//! over the log. Where those hashes are kept is the source's business ([`Subtrees`]): a registry has them in tiles on
//! disk; for tests, `Tree` has them in memory, 64 bytes a leaf.

use crate::format::digest::{Digest, DigestError};

/// Why a proof proves nothing.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProofError {
    /// A hash of another length than 32 bytes.
    #[error("hash in a proof: {0}")]
    Hash(#[from] DigestError),
    /// An empty tree holds no leaf.
    #[error("a tree of size 0 includes nothing")]
    EmptyTree,
    /// The leaf lies beyond the tree.
    #[error("index {index} lies outside a tree of size {size}")]
    IndexBeyondSize {
        /// The leaf's index.
        index: u64,
        /// The tree's size.
        size: u64,
    },
    /// Consistency goes from the smaller tree to the larger.
    #[error("cannot prove consistency from size {from} back to size {to}")]
    Backwards {
        /// The first size.
        from: u64,
        /// The second size.
        to: u64,
    },
    /// Every tree is consistent with the empty one, so such a proof says nothing.
    #[error("consistency from size 0 to size {to} proves nothing; start from a tree that you have seen")]
    FromEmpty {
        /// The second size.
        to: u64,
    },
    /// Missing or left-over hashes.
    #[error("expected {expected} hashes in the proof, got {got}")]
    Length {
        /// How many this index and these sizes need.
        expected: usize,
        /// How many there were.
        got: usize,
    },
    /// The proof leads to another root.
    #[error("{which} root: the proof leads to {got}, expected {expected}")]
    RootMismatch {
        /// `tree`, `first` or `second`.
        which: &'static str,
        /// The root claimed.
        expected: Digest,
        /// The root computed.
        got: Digest,
    },
}

/// `H(0x00 | data)`.
pub fn leaf_hash(data: &[u8]) -> Digest {
    Digest::of_parts(&[&[0], data])
}

/// `H(0x01 | left | right)`.
pub fn node_hash(left: &Digest, right: &Digest) -> Digest {
    Digest::of_parts(&[&[1], left.as_bytes(), right.as_bytes()])
}

/// Root of the empty tree: `SHA-256("")`.
pub fn empty_root() -> Digest {
    Digest::of("")
}

/// Root over leaf hashes, in order.
pub fn root(leaf_hashes: &[Digest]) -> Digest {
    let mut tree = Frontier::default();
    leaf_hashes.iter().for_each(|hash| tree.push(*hash));
    tree.root()
}

/// Verifies that `leaf_hash` is leaf `index` of the tree of `size` leaves with this `root`.
///
/// # Errors
/// [`ProofError`]: size 0, index at or beyond the size, missing or left-over hashes, another root.
pub fn verify_inclusion(
    leaf_hash: &Digest,
    index: u64,
    size: u64,
    proof: &[Digest],
    root: &Digest,
) -> Result<(), ProofError> {
    if size == 0 {
        return Err(ProofError::EmptyTree);
    }
    if index >= size {
        return Err(ProofError::IndexBeyondSize { index, size });
    }
    let (inner, border) = decompose(index, size);
    expect_length(inner + border, proof.len())?;
    let (inner_part, border_part) = proof.split_at(inner);
    let got = chain_border(chain_inner(*leaf_hash, inner_part, index), border_part);
    expect_root("tree", root, got)
}

/// Verifies that the tree of `to` leaves with root `to_root` begins with the `from` leaves under `from_root`.
///
/// # Errors
/// [`ProofError`]: `from` is 0 or larger than `to`, missing or left-over hashes, another root. Equal sizes need
/// equal roots and an empty proof.
pub fn verify_consistency(
    from: u64,
    to: u64,
    proof: &[Digest],
    from_root: &Digest,
    to_root: &Digest,
) -> Result<(), ProofError> {
    if from > to {
        return Err(ProofError::Backwards { from, to });
    }
    if from == 0 {
        return Err(ProofError::FromEmpty { to });
    }
    if from == to {
        expect_length(0, proof.len())?;
        return expect_root("second", to_root, *from_root);
    }
    let (inner, border) = decompose(from - 1, to);
    // `from < to`, so they differ above the trailing zeros of `from`: inner > shift.
    let shift = from.trailing_zeros() as usize;
    let inner = inner - shift;
    // Where the first tree is one full subtree, its root is the seed and is not sent.
    let whole = from.is_power_of_two();
    expect_length(usize::from(!whole) + inner + border, proof.len())?;
    let (seed, rest) = if whole { (*from_root, proof) } else { (proof[0], &proof[1..]) };
    let mask = (from - 1) >> shift;
    let (inner_part, border_part) = rest.split_at(inner);
    let first = chain_border(chain_inner_right(seed, inner_part, mask), border_part);
    expect_root("first", from_root, first)?;
    let second = chain_border(chain_inner(seed, inner_part, mask), border_part);
    expect_root("second", to_root, second)
}

/// Splits a leaf's path: the part below the point where it leaves the right border, and the part along it.
fn decompose(index: u64, size: u64) -> (usize, usize) {
    let inner = 64 - (index ^ (size - 1)).leading_zeros();
    let border = index.checked_shr(inner).unwrap_or(0).count_ones();
    (inner as usize, border as usize)
}

fn chain_inner(seed: Digest, proof: &[Digest], index: u64) -> Digest {
    proof.iter().enumerate().fold(seed, |hash, (level, sibling)| {
        if (index >> level) & 1 == 0 { node_hash(&hash, sibling) } else { node_hash(sibling, &hash) }
    })
}

fn chain_inner_right(seed: Digest, proof: &[Digest], index: u64) -> Digest {
    proof.iter().enumerate().fold(
        seed,
        |hash, (level, sibling)| {
            if (index >> level) & 1 == 1 { node_hash(sibling, &hash) } else { hash }
        },
    )
}

fn chain_border(seed: Digest, proof: &[Digest]) -> Digest {
    proof.iter().fold(seed, |hash, sibling| node_hash(sibling, &hash))
}

fn expect_length(expected: usize, got: usize) -> Result<(), ProofError> {
    if expected == got { Ok(()) } else { Err(ProofError::Length { expected, got }) }
}

fn expect_root(which: &'static str, expected: &Digest, got: Digest) -> Result<(), ProofError> {
    if *expected == got { Ok(()) } else { Err(ProofError::RootMismatch { which, expected: *expected, got }) }
}

/// The hashes of the full subtrees along a tree's right edge: enough to append leaves and to tell the root.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Frontier {
    size: u64,
    /// Largest subtree first.
    peaks: Vec<Digest>,
}

impl Frontier {
    /// The frontier of `size` leaves with these full subtrees, largest first.
    pub fn of(size: u64, peaks: Vec<Digest>) -> Self {
        Self { size, peaks }
    }

    /// Appends a leaf hash.
    pub fn push(&mut self, leaf_hash: Digest) {
        let mut hash = leaf_hash;
        // Every trailing one of the size is a full subtree that the new leaf completes to one twice as large.
        for _ in 0..self.size.trailing_ones() {
            let Some(left) = self.peaks.pop() else { break };
            hash = node_hash(&left, &hash);
        }
        self.peaks.push(hash);
        self.size += 1;
    }

    /// How many leaves.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Hashes of the full subtrees, largest first.
    pub fn peaks(&self) -> &[Digest] {
        &self.peaks
    }

    /// The root over all leaves.
    pub fn root(&self) -> Digest {
        let mut smaller_first = self.peaks.iter().rev();
        let Some(last) = smaller_first.next() else { return empty_root() };
        smaller_first.fold(*last, |right, left| node_hash(left, &right))
    }
}

/// What proofs are made of: the hashes of a tree's full subtrees, wherever they are kept.
pub trait Subtrees {
    /// What may go wrong with fetching one.
    type Error: From<ProofError>;

    /// How many leaves there are.
    fn size(&self) -> u64;

    /// Hash of the full subtree over leaves `index * 2^level .. (index + 1) * 2^level`.
    ///
    /// # Errors
    /// Where it cannot be had.
    fn node(&self, level: u32, index: u64) -> Result<Digest, Self::Error>;
}

/// Root of the tree when it had `size` leaves.
///
/// # Errors
/// [`ProofError::IndexBeyondSize`] for a size that it has not reached, and the source's.
pub fn root_at<S: Subtrees>(tree: &S, size: u64) -> Result<Digest, S::Error> {
    reached(tree, size)?;
    subtree(tree, 0, size)
}

/// Proof that leaf `index` lies in the tree of `size` leaves (RFC 6962, 2.1.1).
///
/// # Errors
/// [`ProofError`] for an empty tree, an index beyond `size`, or a size not reached, and the source's.
pub fn prove_inclusion<S: Subtrees>(tree: &S, index: u64, size: u64) -> Result<Vec<Digest>, S::Error> {
    reached(tree, size)?;
    if size == 0 {
        return Err(ProofError::EmptyTree.into());
    }
    if index >= size {
        return Err(ProofError::IndexBeyondSize { index, size }.into());
    }
    let (mut lo, mut hi) = (0, size);
    let mut proof = Vec::new();
    while hi - lo > 1 {
        let middle = lo + split(hi - lo);
        if index < middle {
            proof.push(subtree(tree, middle, hi)?);
            hi = middle;
        } else {
            proof.push(subtree(tree, lo, middle)?);
            lo = middle;
        }
    }
    proof.reverse();
    Ok(proof)
}

/// Proof that the tree of `to` leaves begins with the tree of `from` leaves (RFC 6962, 2.1.2).
///
/// # Errors
/// [`ProofError`] for `from` 0 or beyond `to`, or a size not reached, and the source's.
pub fn prove_consistency<S: Subtrees>(tree: &S, from: u64, to: u64) -> Result<Vec<Digest>, S::Error> {
    reached(tree, to)?;
    if from > to {
        return Err(ProofError::Backwards { from, to }.into());
    }
    if from == 0 {
        return Err(ProofError::FromEmpty { to }.into());
    }
    let (mut lo, mut hi) = (0, to);
    let mut proof = Vec::new();
    while hi != from {
        let middle = lo + split(hi - lo);
        if from <= middle {
            proof.push(subtree(tree, middle, hi)?);
            hi = middle;
        } else {
            proof.push(subtree(tree, lo, middle)?);
            lo = middle;
        }
    }
    // The first tree itself, unless it is what the verifier holds already.
    if lo != 0 {
        proof.push(subtree(tree, lo, hi)?);
    }
    proof.reverse();
    Ok(proof)
}

fn reached<S: Subtrees>(tree: &S, size: u64) -> Result<(), ProofError> {
    if size > tree.size() {
        return Err(ProofError::IndexBeyondSize { index: size, size: tree.size() });
    }
    Ok(())
}

/// Root over leaves `lo..hi`, which a split of RFC 6962 gave: `lo` is a multiple of the next power of two.
fn subtree<S: Subtrees>(tree: &S, lo: u64, hi: u64) -> Result<Digest, S::Error> {
    let count = hi - lo;
    if count == 0 {
        return Ok(empty_root());
    }
    if count.is_power_of_two() {
        let level = count.trailing_zeros();
        return tree.node(level, lo >> level);
    }
    let middle = lo + split(count);
    Ok(node_hash(&subtree(tree, lo, middle)?, &subtree(tree, middle, hi)?))
}

/// Largest power of two below `count`, for `count` of at least 2.
fn split(count: u64) -> u64 {
    1 << (63 - (count - 1).leading_zeros())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::testing::Tree;

    /// RFC 6962's recursive definition, word for word, as the reference.
    fn by_definition(leaves: &[Digest]) -> Digest {
        match leaves {
            [] => empty_root(),
            [one] => *one,
            many => {
                let mut k = 1;
                while k * 2 < many.len() {
                    k *= 2;
                }
                node_hash(&by_definition(&many[..k]), &by_definition(&many[k..]))
            }
        }
    }

    fn grown(count: u64) -> (Tree, Vec<Digest>) {
        let leaves: Vec<_> = (0..count).map(|i| leaf_hash(&i.to_be_bytes())).collect();
        let mut tree = Tree::new();
        for leaf in &leaves {
            tree.push(*leaf);
        }
        (tree, leaves)
    }

    #[test]
    fn roots_follow_the_definition_at_every_size() {
        let (tree, leaves) = grown(70);
        for size in 0..=70 {
            assert_eq!(tree.root_at(size).unwrap(), by_definition(&leaves[..size as usize]), "size {size}");
        }
        assert!(tree.root_at(71).is_err());
    }

    #[test]
    fn a_frontier_has_the_root_of_the_whole_tree() {
        let leaves: Vec<Digest> = (0..70_u8).map(|i| leaf_hash(&[i])).collect();
        let mut frontier = Frontier::default();
        for (i, leaf) in leaves.iter().enumerate() {
            assert_eq!(frontier.root(), by_definition(&leaves[..i]));
            frontier.push(*leaf);
        }
        assert_eq!((frontier.root(), frontier.size()), (by_definition(&leaves), 70));
    }

    #[test]
    fn every_proof_of_a_small_log_verifies_and_no_other_index_does() {
        let (tree, leaves) = grown(40);
        for size in 1..=40 {
            let root = tree.root_at(size).unwrap();
            for index in 0..size {
                let proof = tree.prove_inclusion(index, size).unwrap();
                verify_inclusion(&leaves[index as usize], index, size, &proof, &root).unwrap();
                let other = (index + 1) % size;
                if other != index {
                    assert!(verify_inclusion(&leaves[index as usize], other, size, &proof, &root).is_err());
                }
            }
            for from in 1..=size {
                let proof = tree.prove_consistency(from, size).unwrap();
                let from_root = tree.root_at(from).unwrap();
                verify_consistency(from, size, &proof, &from_root, &root).unwrap();
                if from < size {
                    assert!(verify_consistency(from, size, &proof, &root, &from_root).is_err());
                    assert!(verify_consistency(from, size, &[], &from_root, &root).is_err());
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_proven_is_refused() {
        let (tree, _) = grown(5);
        assert_eq!(tree.prove_inclusion(0, 0), Err(ProofError::EmptyTree));
        assert_eq!(tree.prove_inclusion(5, 5), Err(ProofError::IndexBeyondSize { index: 5, size: 5 }));
        assert!(tree.prove_inclusion(0, 6).is_err());
        assert_eq!(tree.prove_consistency(0, 5), Err(ProofError::FromEmpty { to: 5 }));
        assert_eq!(tree.prove_consistency(4, 3), Err(ProofError::Backwards { from: 4, to: 3 }));
        assert!(tree.prove_consistency(1, 6).is_err());
    }

    #[test]
    fn sizes_near_the_end_of_u64_do_not_panic() {
        let hash = leaf_hash(b"x");
        for (index, size) in [(u64::MAX - 1, u64::MAX), (0, u64::MAX), (u64::MAX, u64::MAX), (1 << 63, u64::MAX)] {
            assert!(verify_inclusion(&hash, index, size, &[hash; 64], &hash).is_err());
        }
        for (from, to) in [(1 << 63, u64::MAX), (u64::MAX - 1, u64::MAX), (1, u64::MAX)] {
            assert!(verify_consistency(from, to, &[hash; 64], &hash, &hash).is_err());
        }
    }
}
