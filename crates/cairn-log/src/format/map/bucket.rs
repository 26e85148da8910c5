//! One bucket of the registry's map: the keys that begin with the same
//! [`BUCKET_BITS`] bits, as rows of the store and as a subtree.

use std::collections::BTreeMap;

use super::{
    EMPTY, ListError, ListState, MapEntry, MapKey, MapProof, ProofEnd,
    buckets::{BUCKET_BITS, Row as StoredRow, bucket_of},
    leaf_hash, node_hash,
};
use crate::digest::Digest;

/// A subtree by its hash, and by what is needed to collapse it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Node {
    /// No key.
    #[default]
    Empty,
    /// Exactly one key.
    Leaf(Digest),
    /// More than one.
    Inner(Digest),
}

impl Node {
    pub(super) fn hash(self) -> Digest {
        match self {
            Self::Empty => EMPTY,
            Self::Leaf(hash) | Self::Inner(hash) => hash,
        }
    }

    /// The node over two others: a single key stays what it is.
    pub(super) fn over(left: Self, right: Self) -> Self {
        match (left, right) {
            (one, Self::Empty) if !matches!(one, Self::Inner(_)) => one,
            (Self::Empty, one) if !matches!(one, Self::Inner(_)) => one,
            _ => Self::Inner(node_hash(&left.hash(), &right.hash())),
        }
    }
}

/// Why stored bytes are not the bucket that they should be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BucketError {
    /// Cut short within a list.
    #[error(transparent)]
    List(#[from] ListError),
    /// More than a list.
    #[error("{got} bytes behind the list of key {key}")]
    Behind {
        /// The key.
        key: MapKey,
        /// How many bytes.
        got: usize,
    },
    /// A key of another bucket, or out of order.
    #[error("key {key} is out of order or belongs to another bucket")]
    Order {
        /// The key.
        key: MapKey,
    },
}

/// A bucket's keys, ascending, with their lists.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Bucket(Vec<(MapKey, ListState)>);

impl Bucket {
    /// Appends entries to lists, whose rows go into `stored`; gives the bucket's root before and after.
    pub(super) fn append<'a>(
        &mut self,
        changes: impl Iterator<Item = (&'a MapKey, &'a Vec<MapEntry>)>,
        stored: &mut Vec<StoredRow>,
    ) -> (Node, Node) {
        let values = self.0.iter().map(|(key, list)| (*key, list.root()));
        let mut values: BTreeMap<MapKey, Change> = values.map(|(key, value)| (key, (Some(value), value))).collect();
        for (key, entries) in changes {
            let list = self.list_mut(key);
            entries.iter().for_each(|entry| list.append(entry));
            values.entry(*key).or_insert((None, EMPTY)).1 = list.root();
            let mut bytes = Vec::new();
            list.encode(&mut bytes);
            stored.push((*key, bytes));
        }
        let rows: Vec<(MapKey, Change)> = values.into_iter().collect();
        both(&rows, BUCKET_BITS)
    }

    /// The list of `key`, made where there is none.
    fn list_mut(&mut self, key: &MapKey) -> &mut ListState {
        let at = match self.0.binary_search_by_key(key, |row| row.0) {
            Ok(at) => at,
            Err(at) => {
                self.0.insert(at, (*key, ListState::default()));
                at
            }
        };
        &mut self.0[at].1
    }

    pub(super) fn list(&self, key: &MapKey) -> Option<&ListState> {
        let at = self.0.binary_search_by_key(key, |row| row.0).ok()?;
        Some(&self.0[at].1)
    }

    pub(super) fn decode(stored: Vec<StoredRow>, bucket: u32) -> Result<Self, BucketError> {
        let mut rows: Vec<(MapKey, ListState)> = Vec::with_capacity(stored.len());
        for (key, bytes) in stored {
            if bucket_of(&key) != bucket || rows.last().is_some_and(|last| last.0 >= key) {
                return Err(BucketError::Order { key });
            }
            let (list, behind) = ListState::decode(&bytes)?;
            if !behind.is_empty() {
                return Err(BucketError::Behind { key, got: behind.len() });
            }
            rows.push((key, list));
        }
        Ok(Self(rows))
    }

    /// The bucket as a subtree.
    pub(super) fn subtree(&self) -> Subtree {
        Subtree(self.0.iter().map(|(key, list)| (*key, list.root())).collect())
    }
}

/// A key and its value.
type Row = (MapKey, Digest);

/// A key's value before a change, if it had one, and after.
type Change = (Option<Digest>, Digest);

/// A bucket's keys and values.
pub(super) struct Subtree(Vec<Row>);

impl Subtree {
    /// The one key and value of a bucket that has no more.
    pub(super) fn only(&self) -> Option<Row> {
        if let [one] = self.0.as_slice() { Some(*one) } else { None }
    }

    /// Goes on with a proof whose siblings lead from the map's root to this bucket's.
    pub(super) fn prove(&self, key: &MapKey, mut siblings: Vec<Digest>) -> MapProof {
        let mut rows = self.0.as_slice();
        let end = loop {
            match rows {
                [] => break ProofEnd::Empty,
                [(only, _)] if only == key => break ProofEnd::Own,
                [(only, value)] => break ProofEnd::Other { key: *only, value: *value },
                _ => {
                    let depth = siblings.len();
                    let (left, right) = split(rows, depth);
                    let (next, sibling) = if key.bit(depth) { (right, left) } else { (left, right) };
                    siblings.push(node(sibling, depth + 1).hash());
                    rows = next;
                }
            }
        };
        MapProof { siblings, end }
    }
}

/// The subtree at `depth` over keys that share the bits above it.
fn node(rows: &[Row], depth: usize) -> Node {
    match rows {
        [] => Node::Empty,
        [(key, value)] => Node::Leaf(leaf_hash(key, value)),
        // Two different keys part at bit 255 at the latest.
        _ => {
            let (left, right) = split(rows, depth);
            Node::over(node(left, depth + 1), node(right, depth + 1))
        }
    }
}

/// The subtree before and after a change; what did not change is hashed once.
fn both(rows: &[(MapKey, Change)], depth: usize) -> (Node, Node) {
    match rows {
        [] => (Node::Empty, Node::Empty),
        [(key, (before, after))] => {
            let top = Node::Leaf(leaf_hash(key, after));
            match before {
                Some(before) if before == after => (top, top),
                Some(before) => (Node::Leaf(leaf_hash(key, before)), top),
                None => (Node::Empty, top),
            }
        }
        _ => {
            let (left, right) = split(rows, depth);
            let (left, right) = (both(left, depth + 1), both(right, depth + 1));
            let after = Node::over(left.1, right.1);
            let same = (left.0, right.0) == (left.1, right.1);
            (if same { after } else { Node::over(left.0, right.0) }, after)
        }
    }
}

/// Rows on the left of a node, and on its right.
type Sides<'a, T> = (&'a [(MapKey, T)], &'a [(MapKey, T)]);

/// Parts rows at bit `depth` of their keys.
fn split<T>(rows: &[(MapKey, T)], depth: usize) -> Sides<'_, T> {
    rows.split_at(rows.partition_point(|(key, _)| !key.bit(depth)))
}
