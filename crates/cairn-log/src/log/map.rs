//! The registry's map: keys in the store, a row each; the tree above buckets of them in memory.
//!
//! A batch reads the buckets of its keys and works out the paths above them, so its cost does
//! not grow with the map but for the buckets' own size (10 million keys: 38 a bucket); it writes the rows of its keys only,
//! and what then stands at the buckets' roots. Nothing is changed before the caller
//! has stored what [`BucketMap::stage`] gives: a batch that fails leaves the
//! map as it was. Keys are hashes of what contributors choose, so somebody may aim many at one
//! bucket; that makes dear only the batches that touch this one of 2^18.

use std::collections::BTreeMap;

use super::store::StoreError;
use crate::format::{
    digest::Digest,
    map::{EMPTY, ListError, ListState, MapEntry, MapKey, MapProof, ProofEnd, leaf_hash, node_hash},
};

/// Bits of a key that name its bucket.
pub const BUCKET_BITS: usize = 18;

const BUCKETS: u32 = 1 << BUCKET_BITS;

/// Nodes in one piece of memory.
const CHUNK: usize = 16;

/// Version byte of a stored [`BucketTop`].
const TOP_VERSION: u8 = 1;

/// A key, and its list as [`ListState::encode`] writes it.
pub type Row = (MapKey, Vec<u8>);

/// Where a bucket's keys lie.
pub trait Buckets {
    /// The rows stored last for the keys of a bucket, ascending by key.
    ///
    /// # Errors
    /// [`StoreError`] where the store cannot tell.
    fn load(&self, bucket: u32) -> Result<Vec<Row>, StoreError>;
}

/// What stands at a bucket's root: stored beside the bucket, so that a start reads no bucket.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BucketTop(Node);

/// Why the map cannot be read or written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Stored bytes are not this bucket.
    #[error("map bucket {bucket}: {source}; restore the newest backup")]
    Bucket {
        /// The bucket's number.
        bucket: u32,
        /// What is wrong.
        source: BucketError,
    },
    /// The bucket is not the one that the tree above it was made over.
    #[error("map bucket {bucket} is not the one under the map's root; restore the newest backup")]
    Inconsistent {
        /// The bucket's number.
        bucket: u32,
    },
    /// The stored top of a bucket cannot be read.
    #[error("map bucket {bucket}, stored root: {got} bytes or an unknown version; restore the newest backup")]
    Top {
        /// The bucket's number.
        bucket: u32,
        /// How many bytes there are.
        got: usize,
    },
}

/// A batch that is planned and not yet part of the map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Staged {
    /// The root that the map will have.
    pub root: Digest,
    /// What to store: the changed keys' rows, ascending.
    pub rows: Vec<Row>,
    /// And what then stands at the roots of their buckets, ascending by bucket.
    pub tops: Vec<(u32, BucketTop)>,
    /// Changed nodes of the tree in memory.
    nodes: BTreeMap<u32, Node>,
}

/// The tree above the buckets: 33 bytes a node, about 18 MB where every bucket is in use.
///
/// Numbered as a heap: the root is 1, the children of `i` are `2i` and `2i + 1`, bucket `b` is `2^18 + b`.
#[derive(Debug, Clone)]
pub struct BucketMap {
    chunks: Vec<Option<Box<[Node; CHUNK]>>>,
}

impl BucketTop {
    /// `version 1 | kind (1: one key, 2: more) | hash 32`.
    pub fn encode(&self) -> [u8; 34] {
        let mut bytes = [0; 34];
        bytes[0] = TOP_VERSION;
        bytes[1] = if matches!(self.0, Node::Inner(_)) { 2 } else { 1 };
        bytes[2..].copy_from_slice(self.0.hash().as_bytes());
        bytes
    }

    /// Reads the stored top of `bucket`.
    ///
    /// # Errors
    /// [`MapError::Top`].
    pub fn decode(bucket: u32, bytes: &[u8]) -> Result<Self, MapError> {
        let refuse = MapError::Top { bucket, got: bytes.len() };
        let Some(([TOP_VERSION, kind], hash)) = bytes.split_first_chunk::<2>() else { return Err(refuse) };
        match (kind, Digest::try_from(hash)) {
            (1, Ok(hash)) => Ok(Self(Node::Leaf(hash))),
            (2, Ok(hash)) => Ok(Self(Node::Inner(hash))),
            _ => Err(refuse),
        }
    }
}

impl Default for BucketMap {
    fn default() -> Self {
        Self::new()
    }
}

impl BucketMap {
    /// The empty map.
    pub fn new() -> Self {
        Self { chunks: vec![None; 2 * BUCKETS as usize / CHUNK] }
    }

    /// The map over stored buckets, by their tops, in any order. Numbers of 2^18 and more name no bucket and are
    /// passed over.
    pub fn from_tops(tops: impl Iterator<Item = (u32, BucketTop)>) -> Self {
        let mut map = Self::new();
        for (bucket, top) in tops.filter(|(bucket, _)| *bucket < BUCKETS) {
            map.set(BUCKETS + bucket, top.0);
        }
        for chunk in (0..BUCKETS as usize / CHUNK).rev() {
            // Where nothing stands below, nothing is made for the sake of empty nodes.
            if map.chunks[2 * chunk].is_none() && map.chunks[2 * chunk + 1].is_none() {
                continue;
            }
            for id in (chunk * CHUNK..(chunk + 1) * CHUNK).rev().map(|id| id as u32).filter(|id| *id > 0) {
                map.set(id, Node::over(map.node(2 * id), map.node(2 * id + 1)));
            }
        }
        map
    }

    /// The map's root; 32 zero bytes without any key.
    pub fn root(&self) -> Digest {
        self.node(1).hash()
    }

    /// Plans a batch: new entries by key, each key's in log order and behind those that it has.
    ///
    /// # Errors
    /// [`MapError`]; nothing is changed in any case.
    pub fn stage(&self, buckets: &dyn Buckets, changes: &BTreeMap<MapKey, Vec<MapEntry>>) -> Result<Staged, MapError> {
        let (mut rows, mut tops) = (Vec::new(), Vec::new());
        let mut nodes = BTreeMap::new();
        let mut changes = changes.iter().filter(|(_, entries)| !entries.is_empty()).peekable();
        while let Some((key, _)) = changes.peek() {
            let number = bucket_of(key);
            let mut bucket = self.load(buckets, number)?;
            // Keys are in order, so those of one bucket are neighbours.
            let of_bucket = std::iter::from_fn(|| changes.next_if(|(key, _)| bucket_of(key) == number));
            let (before, top) = bucket.append(of_bucket, &mut rows);
            // A bucket that was changed in the store must not find its way under a new signature.
            if before != self.node(BUCKETS + number) {
                return Err(MapError::Inconsistent { bucket: number });
            }
            nodes.insert(BUCKETS + number, top);
            tops.push((number, BucketTop(top)));
        }
        let mut level: Vec<u32> = nodes.keys().copied().collect();
        for _ in 0..BUCKET_BITS {
            level.iter_mut().for_each(|id| *id /= 2);
            level.dedup();
            for id in &level {
                let child = |id: u32| nodes.get(&id).copied().unwrap_or_else(|| self.node(id));
                let node = Node::over(child(2 * id), child(2 * id + 1));
                nodes.insert(*id, node);
            }
        }
        let root = nodes.get(&1).copied().unwrap_or_else(|| self.node(1)).hash();
        Ok(Staged { root, rows, tops, nodes })
    }

    /// Makes a batch part of the map, once its rows are stored. It MUST have been staged on the map as it is.
    pub fn apply(&mut self, staged: &Staged) {
        for (id, node) in &staged.nodes {
            self.set(*id, *node);
        }
    }

    /// A key's list, if it has one, and the proof of its root as value or of its absence.
    ///
    /// # Errors
    /// [`MapError`]; a proof that would not verify is not given out.
    pub fn prove(&self, buckets: &dyn Buckets, key: &MapKey) -> Result<(Option<ListState>, MapProof), MapError> {
        let mut siblings = Vec::new();
        let mut id = 1;
        while let (Node::Inner(_), true) = (self.node(id), id < BUCKETS) {
            let next = 2 * id + u32::from(key.bit(siblings.len()));
            siblings.push(self.node(next ^ 1).hash());
            id = next;
        }
        if self.node(id) == Node::Empty {
            return Ok((None, MapProof { siblings, end: ProofEnd::Empty }));
        }
        let number = self.bucket_below(id);
        let bucket = self.load(buckets, number)?;
        let subtree = bucket.subtree();
        let proof = if id < BUCKETS {
            let only = subtree.only().ok_or(MapError::Inconsistent { bucket: number })?;
            let end = if only.0 == *key { ProofEnd::Own } else { ProofEnd::Other { key: only.0, value: only.1 } };
            MapProof { siblings, end }
        } else {
            Subtree::prove(&subtree, key, siblings)
        };
        let list = bucket.0.get(key).cloned();
        let verified = proof.verify(key, list.as_ref().map(ListState::root), &self.root());
        verified.map_err(|_| MapError::Inconsistent { bucket: number })?;
        Ok((list, proof))
    }

    /// The bucket of the only key below a node that has only one.
    fn bucket_below(&self, mut id: u32) -> u32 {
        while id < BUCKETS {
            id *= 2;
            if self.node(id) == Node::Empty {
                id += 1;
            }
        }
        id - BUCKETS
    }

    fn load(&self, buckets: &dyn Buckets, number: u32) -> Result<Bucket, MapError> {
        let stored = buckets.load(number)?;
        if stored.is_empty() != (self.node(BUCKETS + number) == Node::Empty) {
            return Err(MapError::Inconsistent { bucket: number });
        }
        Bucket::decode(stored, number).map_err(|source| MapError::Bucket { bucket: number, source })
    }

    fn node(&self, id: u32) -> Node {
        let (chunk, at) = (id as usize / CHUNK, id as usize % CHUNK);
        self.chunks[chunk].as_ref().map_or(Node::Empty, |nodes| nodes[at])
    }

    fn set(&mut self, id: u32, node: Node) {
        let (chunk, at) = (id as usize / CHUNK, id as usize % CHUNK);
        self.chunks[chunk].get_or_insert_with(Default::default)[at] = node;
    }
}

/// The bucket of a key: its first 18 bits.
fn bucket_of(key: &MapKey) -> u32 {
    let [a, b, c, ..] = *key.as_bytes();
    u32::from_be_bytes([0, a, b, c]) >> (24 - BUCKET_BITS)
}

/// The first three bytes of the first key of a bucket; none for numbers of 2^18 and more.
pub(super) fn first_key(bucket: u32) -> Option<[u8; 3]> {
    let [_, a, b, c] = (bucket << (24 - BUCKET_BITS)).to_be_bytes();
    (bucket < BUCKETS).then_some([a, b, c])
}

/// A subtree by its hash, and by what is needed to collapse it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Node {
    /// No key.
    #[default]
    Empty,
    /// Exactly one key.
    Leaf(Digest),
    /// More than one.
    Inner(Digest),
}

impl Node {
    fn hash(self) -> Digest {
        match self {
            Self::Empty => EMPTY,
            Self::Leaf(hash) | Self::Inner(hash) => hash,
        }
    }

    /// The node over two others: a single key stays what it is.
    fn over(left: Self, right: Self) -> Self {
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
struct Bucket(BTreeMap<MapKey, ListState>);

impl Bucket {
    /// Appends entries to lists, whose rows go into `stored`; gives the bucket's root before and after.
    fn append<'a>(
        &mut self,
        changes: impl Iterator<Item = (&'a MapKey, &'a Vec<MapEntry>)>,
        stored: &mut Vec<Row>,
    ) -> (Node, Node) {
        let values = self.0.iter().map(|(key, list)| (*key, list.root()));
        let mut values: BTreeMap<MapKey, Change> = values.map(|(key, value)| (key, (Some(value), value))).collect();
        for (key, entries) in changes {
            let list = self.0.entry(*key).or_default();
            entries.iter().for_each(|entry| list.append(entry));
            values.entry(*key).or_insert((None, EMPTY)).1 = list.root();
            let mut bytes = Vec::new();
            list.encode(&mut bytes);
            stored.push((*key, bytes));
        }
        let rows: Vec<(MapKey, Change)> = values.into_iter().collect();
        both(&rows, BUCKET_BITS)
    }

    fn decode(stored: Vec<Row>, bucket: u32) -> Result<Self, BucketError> {
        let mut rows = BTreeMap::new();
        for (key, bytes) in stored {
            if bucket_of(&key) != bucket || rows.last_key_value().is_some_and(|(last, _)| *last >= key) {
                return Err(BucketError::Order { key });
            }
            let (list, behind) = ListState::decode(&bytes)?;
            if !behind.is_empty() {
                return Err(BucketError::Behind { key, got: behind.len() });
            }
            rows.insert(key, list);
        }
        Ok(Self(rows))
    }

    /// The bucket as a subtree.
    fn subtree(&self) -> Subtree {
        Subtree(self.0.iter().map(|(key, list)| (*key, list.root())).collect())
    }
}

/// A key and its value.
type KeyValue = (MapKey, Digest);

/// A key's value before a change, if it had one, and after.
type Change = (Option<Digest>, Digest);

/// A bucket's keys and values.
struct Subtree(Vec<KeyValue>);

impl Subtree {
    /// The one key and value of a bucket that has no more.
    fn only(&self) -> Option<KeyValue> {
        if let [one] = self.0.as_slice() { Some(*one) } else { None }
    }

    /// Goes on with a proof whose siblings lead from the map's root to this bucket's.
    fn prove(&self, key: &MapKey, mut siblings: Vec<Digest>) -> MapProof {
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
fn node(rows: &[KeyValue], depth: usize) -> Node {
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
