//! RFC 6962 Merkle trees: hashing, roots, and the verification of proofs.
//!
//! Verification follows the iterative form of RFC 9162 (2.1.3.2 and 2.1.4.2),
//! with the proof's length fixed by index and sizes before a hash is looked at.
//! Making proofs is [`Tree`]'s business, in a file of its own: verifiers do
//! without it.

use crate::digest::{Digest, DigestError};

pub use crate::tree::{Subtrees, Tree, prove_consistency, prove_inclusion, root_at};

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
    let mut tree = Tree::new();
    for hash in leaf_hashes {
        tree.push(*hash);
    }
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
