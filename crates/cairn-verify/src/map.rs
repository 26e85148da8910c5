//! The verifiable map, computed anew: an implementation of its own, which shares no
//! line with the registry's, so that a mistake in one cannot hide in the other.
//!
//! Key: `SHA-256(label | 0x00 | fields)`, each field behind its length (u64, big-endian).
//! Value of a key: RFC 6962 tree hash over its entries in log order, an entry being
//! `index u64 BE | leaf hash`. Tree: sparse, binary, over the key's bits from the
//! most significant; empty subtree 32 zero bytes; one key alone
//! `SHA-256(0x02 | key | value)` wherever it stands; else `SHA-256(0x03 | left | right)`.
//!
//! Takes about 200 bytes a key; hashes are worked out when a root is asked for.

use cairn_log::format::{Digest, OwnerRecord, RecordKind, dsse::pae, merkle};

/// A key of the map.
pub(crate) type Key = [u8; 32];

/// Type of the statement that a map leaf signs.
pub(crate) const STATEMENT_TYPE: &str = "application/vnd.cairn.map-root.v1+json";

const EMPTY: Digest = Digest::from_bytes([0; 32]);

/// PAE of the statement that the map over the first `size` leaves has this root.
pub(crate) fn statement(origin: &str, size: u64, root: &Digest) -> Vec<u8> {
    // A string always serialises.
    let origin = serde_json::to_string(origin).unwrap_or_default();
    pae(
        STATEMENT_TYPE,
        format!(r#"{{"version":1,"kind":"map","origin":{origin},"size":{size},"root":"{root}"}}"#).as_bytes(),
    )
}

/// The keys under which a record is found, sorted. `replaced_owner`: key id of the owner of the record that a rotation
/// replaces.
pub(crate) fn keys_of(record: &OwnerRecord, replaced_owner: Option<&Digest>) -> Vec<Key> {
    let mut keys = vec![key("cairn map scene v1", &[record.scene.as_bytes()])];
    for view in record.views.iter().flatten() {
        keys.push(key("cairn map view v1", &[record.scene.as_bytes(), view.as_bytes()]));
    }
    match record.kind {
        RecordKind::Revocation => keys.push(ended(&record.owner_key.id())),
        RecordKind::Rotation => keys.extend(replaced_owner.map(ended)),
        RecordKind::Claim | RecordKind::Contribution | RecordKind::Training | RecordKind::Dispute => {}
    }
    keys.extend(record.replaces.iter().map(|replaced| key("cairn map about v1", &[replaced.as_bytes()])));
    keys.sort_unstable();
    keys.dedup();
    keys
}

/// The key under which the record is found that ended an owner's key.
pub(crate) fn ended(key_id: &Digest) -> Key {
    key("cairn map ended v1", &[key_id.as_bytes()])
}

fn key(label: &str, fields: &[&[u8]]) -> Key {
    let mut bytes = [label.as_bytes(), &[0]].concat();
    for field in fields {
        bytes.extend_from_slice(&(field.len() as u64).to_be_bytes());
        bytes.extend_from_slice(field);
    }
    *Digest::of(bytes).as_bytes()
}

/// An RFC 6962 tree of which only the roots of its full subtrees are kept.
#[derive(Debug, Clone, Default)]
pub(crate) struct Frontier {
    size: u64,
    /// Largest first; as many as `size` has one bits.
    peaks: Vec<Digest>,
}

impl Frontier {
    /// A tree of `size` leaves, of which these are the full subtrees' roots.
    pub(crate) fn of(size: u64, peaks: Vec<Digest>) -> Self {
        Self { size, peaks }
    }

    pub(crate) fn push(&mut self, leaf: Digest) {
        let mut hash = leaf;
        for _ in 0..self.size.trailing_ones() {
            let Some(left) = self.peaks.pop() else { break };
            hash = merkle::node_hash(&left, &hash);
        }
        self.peaks.push(hash);
        self.size += 1;
    }

    pub(crate) fn size(&self) -> u64 {
        self.size
    }

    pub(crate) fn root(&self) -> Digest {
        let mut peaks = self.peaks.iter().rev();
        let Some(last) = peaks.next() else { return merkle::empty_root() };
        peaks.fold(*last, |right, left| merkle::node_hash(left, &right))
    }
}

/// What stands at a place of the tree. Indices are 32 bits: 2^31 keys would take 400 GB.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Empty,
    Inner(u32),
    Leaf(u32),
}

#[derive(Debug)]
struct Inner {
    children: [Place; 2],
    /// Absent while something below it changed.
    hash: Option<Digest>,
}

#[derive(Debug)]
struct Leaf {
    key: Key,
    entries: Frontier,
    hash: Option<Digest>,
}

/// The map over the leaves so far.
#[derive(Debug)]
pub(crate) struct Map {
    root: Place,
    inner: Vec<Inner>,
    leaves: Vec<Leaf>,
}

impl Default for Map {
    fn default() -> Self {
        Self { root: Place::Empty, inner: Vec::new(), leaves: Vec::new() }
    }
}

impl Map {
    /// How many keys.
    pub(crate) fn len(&self) -> usize {
        self.leaves.len()
    }

    /// Adds the log's leaf `index` under `key`.
    pub(crate) fn add(&mut self, key: &Key, index: u64, leaf_hash: &Digest) {
        let entry = merkle::leaf_hash(&[&index.to_be_bytes()[..], leaf_hash.as_bytes()].concat());
        let (mut place, mut parent, mut depth) = (self.root, None, 0);
        while let Place::Inner(at) = place {
            let node = &mut self.inner[at as usize];
            node.hash = None;
            let side = bit(key, depth);
            (place, parent, depth) = (node.children[side], Some((at, side)), depth + 1);
        }
        if let Place::Leaf(at) = place {
            let leaf = &mut self.leaves[at as usize];
            if leaf.key == *key {
                leaf.entries.push(entry);
                leaf.hash = None;
                return;
            }
        }
        let mut entries = Frontier::default();
        entries.push(entry);
        let new = Place::Leaf(self.leaves.len() as u32);
        self.leaves.push(Leaf { key: *key, entries, hash: None });
        let subtree = match place {
            Place::Leaf(other) => self.fork(new, key, Place::Leaf(other), self.leaves[other as usize].key, depth),
            Place::Empty | Place::Inner(_) => new,
        };
        match parent {
            None => self.root = subtree,
            Some((at, side)) => self.inner[at as usize].children[side] = subtree,
        }
    }

    /// Inner nodes from `depth` to the first bit in which two keys differ.
    fn fork(&mut self, a: Place, a_key: &Key, b: Place, b_key: Key, depth: usize) -> Place {
        let mut last = depth;
        while bit(a_key, last) == bit(&b_key, last) {
            last += 1;
        }
        let mut children = if bit(a_key, last) == 0 { [a, b] } else { [b, a] };
        for at in (depth..=last).rev() {
            let node = Place::Inner(self.inner.len() as u32);
            self.inner.push(Inner { children, hash: None });
            if at == depth {
                return node;
            }
            children = if bit(a_key, at - 1) == 0 { [node, Place::Empty] } else { [Place::Empty, node] };
        }
        a
    }

    /// Whether anything stands under `key`.
    pub(crate) fn holds(&self, key: &Key) -> bool {
        let (mut place, mut depth) = (self.root, 0);
        while let Place::Inner(at) = place {
            (place, depth) = (self.inner[at as usize].children[bit(key, depth)], depth + 1);
        }
        matches!(place, Place::Leaf(at) if self.leaves[at as usize].key == *key)
    }

    /// The root.
    pub(crate) fn root(&mut self) -> Digest {
        self.hash(self.root)
    }

    /// At most 256 calls deep.
    fn hash(&mut self, place: Place) -> Digest {
        match place {
            Place::Empty => EMPTY,
            Place::Leaf(at) => {
                let leaf = &mut self.leaves[at as usize];
                *leaf.hash.get_or_insert_with(|| Digest::of_parts(&[&[2], &leaf.key, leaf.entries.root().as_bytes()]))
            }
            Place::Inner(at) => {
                let Inner { children: [left, right], hash } = self.inner[at as usize];
                if let Some(hash) = hash {
                    return hash;
                }
                let (left, right) = (self.hash(left), self.hash(right));
                let hash = Digest::of_parts(&[&[3], left.as_bytes(), right.as_bytes()]);
                self.inner[at as usize].hash = Some(hash);
                hash
            }
        }
    }
}

/// Bit `depth` of a key, the most significant first.
fn bit(key: &Key, depth: usize) -> usize {
    usize::from(key[depth / 8] >> (7 - depth % 8) & 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// The definition, word for word.
    fn by_definition(map: &BTreeMap<Key, Vec<(u64, Digest)>>, depth: usize) -> Digest {
        match map.iter().collect::<Vec<_>>().as_slice() {
            [] => EMPTY,
            [(key, entries)] => {
                let leaves: Vec<Digest> = (entries.iter())
                    .map(|(i, h)| merkle::leaf_hash(&[&i.to_be_bytes()[..], h.as_bytes()].concat()))
                    .collect();
                Digest::of_parts(&[&[2], key.as_slice(), merkle::root(&leaves).as_bytes()])
            }
            _ => {
                let (left, right): (BTreeMap<_, _>, BTreeMap<_, _>) =
                    map.clone().into_iter().partition(|(key, _)| bit(key, depth) == 0);
                let (left, right) = (by_definition(&left, depth + 1), by_definition(&right, depth + 1));
                Digest::of_parts(&[&[3], left.as_bytes(), right.as_bytes()])
            }
        }
    }

    #[test]
    fn roots_follow_the_definition_after_every_entry() {
        let mut map = Map::default();
        let mut reference = BTreeMap::<Key, Vec<(u64, Digest)>>::new();
        assert_eq!(map.root(), EMPTY);
        for i in 0..120_u64 {
            // Every third key comes again; two differ in the last bit alone.
            let mut key = *Digest::of((i / 3).to_be_bytes()).as_bytes();
            if i % 40 == 7 {
                key = *Digest::of([0; 8]).as_bytes();
                key[31] ^= 1;
            }
            let leaf = Digest::of(i.to_le_bytes());
            assert_eq!(map.holds(&key), reference.contains_key(&key));
            map.add(&key, i, &leaf);
            reference.entry(key).or_default().push((i, leaf));
            assert_eq!(map.root(), by_definition(&reference, 0), "after {i}");
            assert!(map.holds(&key));
        }
        assert_eq!(map.len(), reference.len());
    }

    #[test]
    fn a_frontier_has_the_root_of_the_whole_tree() {
        let leaves: Vec<Digest> = (0..70_u8).map(|i| merkle::leaf_hash(&[i])).collect();
        let mut frontier = Frontier::default();
        for (i, leaf) in leaves.iter().enumerate() {
            assert_eq!(frontier.root(), merkle::root(&leaves[..i]));
            frontier.push(*leaf);
        }
        assert_eq!((frontier.root(), frontier.size()), (merkle::root(&leaves), 70));
    }
}
