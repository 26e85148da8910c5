//! A whole map in memory, the plain way: a binary trie with the lists in its
//! leaves. For verifiers, who make the map again from a log, and for tests.

use super::{EMPTY, ListState, MapEntry, MapKey, MapProof, ProofEnd, leaf_hash, node_hash};
use crate::format::digest::Digest;

/// A verifiable map that grows record by record.
#[derive(Debug, Clone, Default)]
pub struct MapTree {
    top: Node,
    keys: u64,
}

#[derive(Debug, Clone, Default)]
enum Node {
    #[default]
    Empty,
    /// The only key of its subtree, wherever that stands.
    Leaf(Box<(MapKey, ListState)>),
    Inner(Box<Inner>),
}

#[derive(Debug, Clone, Default)]
struct Inner {
    /// `[left, right]`.
    sides: [Node; 2],
    /// `None` since something below changed.
    hash: Option<Digest>,
}

impl MapTree {
    /// The empty map.
    pub fn new() -> Self {
        Self::default()
    }

    /// How many keys.
    pub fn len(&self) -> u64 {
        self.keys
    }

    /// Whether it has no key.
    pub fn is_empty(&self) -> bool {
        self.keys == 0
    }

    /// Appends an entry to a key's list; it MUST lie behind the list's others in the log.
    pub fn append(&mut self, key: MapKey, entry: &MapEntry) {
        let mut node = &mut self.top;
        for depth in 0.. {
            match node {
                Node::Empty => {
                    let mut list = ListState::default();
                    list.append(entry);
                    *node = Node::Leaf(Box::new((key, list)));
                    self.keys += 1;
                    return;
                }
                Node::Leaf(leaf) if leaf.0 == key => return leaf.1.append(entry),
                Node::Leaf(leaf) => {
                    // Two keys from here on: the one that was alone moves a step down.
                    let side = usize::from(leaf.0.bit(depth));
                    let mut inner = Inner::default();
                    inner.sides[side] = std::mem::take(node);
                    *node = Node::Inner(Box::new(inner));
                }
                Node::Inner(_) => {}
            }
            let Node::Inner(inner) = node else { return };
            inner.hash = None;
            node = &mut inner.sides[usize::from(key.bit(depth))];
        }
    }

    /// A key's list, if it has one.
    pub fn get(&self, key: &MapKey) -> Option<&ListState> {
        let mut node = &self.top;
        for depth in 0.. {
            match node {
                Node::Empty => return None,
                Node::Leaf(leaf) => return (leaf.0 == *key).then_some(&leaf.1),
                Node::Inner(inner) => node = &inner.sides[usize::from(key.bit(depth))],
            }
        }
        None
    }

    /// The map's root, after hashing what changed since it was last asked for.
    pub fn root(&mut self) -> Digest {
        self.top.hash()
    }

    /// Proves that a key has its list's root as value, or that it has none.
    pub fn prove(&mut self, key: &MapKey) -> MapProof {
        let mut siblings = Vec::new();
        let mut node = &mut self.top;
        loop {
            match node {
                Node::Empty => return MapProof { siblings, end: ProofEnd::Empty },
                Node::Leaf(leaf) if leaf.0 == *key => return MapProof { siblings, end: ProofEnd::Own },
                Node::Leaf(leaf) => {
                    let end = ProofEnd::Other { key: leaf.0, value: leaf.1.root() };
                    return MapProof { siblings, end };
                }
                Node::Inner(inner) => {
                    let [left, right] = &mut inner.sides;
                    let (next, sibling) = if key.bit(siblings.len()) { (right, left) } else { (left, right) };
                    siblings.push(sibling.hash());
                    node = next;
                }
            }
        }
    }
}

impl Node {
    fn hash(&mut self) -> Digest {
        match self {
            Self::Empty => EMPTY,
            Self::Leaf(leaf) => leaf_hash(&leaf.0, &leaf.1.root()),
            Self::Inner(inner) => {
                let Inner { sides: [left, right], hash } = inner.as_mut();
                *hash.get_or_insert_with(|| node_hash(&left.hash(), &right.hash()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::format::merkle;

    /// The definition, word for word.
    fn by_definition(map: &BTreeMap<MapKey, Vec<MapEntry>>, depth: usize) -> Digest {
        match map.iter().collect::<Vec<_>>().as_slice() {
            [] => EMPTY,
            [(key, entries)] => {
                let leaf = |e: &MapEntry| [&e.index.to_be_bytes()[..], e.leaf_hash.as_bytes()].concat();
                let leaves: Vec<Digest> = entries.iter().map(|entry| merkle::leaf_hash(&leaf(entry))).collect();
                Digest::of_parts(&[&[2], key.as_bytes(), merkle::root(&leaves).as_bytes()])
            }
            _ => {
                let (left, right): (BTreeMap<_, _>, BTreeMap<_, _>) =
                    map.clone().into_iter().partition(|(key, _)| key.as_bytes()[depth / 8] >> (7 - depth % 8) & 1 == 0);
                let (left, right) = (by_definition(&left, depth + 1), by_definition(&right, depth + 1));
                Digest::of_parts(&[&[3], left.as_bytes(), right.as_bytes()])
            }
        }
    }

    #[test]
    fn roots_follow_the_definition_after_every_entry() {
        let mut map = MapTree::new();
        let mut reference = BTreeMap::<MapKey, Vec<MapEntry>>::new();
        assert_eq!(map.root(), EMPTY);
        for index in 0..120_u64 {
            // Every third key comes again; two differ in the last bit alone.
            let mut key = *Digest::of((index / 3).to_be_bytes()).as_bytes();
            if index % 40 == 7 {
                key = *Digest::of([0; 8]).as_bytes();
                key[31] ^= 1;
            }
            let (key, entry) =
                (MapKey::from_bytes(key), MapEntry { index, leaf_hash: Digest::of(index.to_le_bytes()) });
            assert_eq!(map.get(&key).is_some(), reference.contains_key(&key));
            map.append(key, &entry);
            reference.entry(key).or_default().push(entry);
            assert_eq!(map.root(), by_definition(&reference, 0), "after {index}");
            assert!(map.get(&key).is_some());
        }
        assert_eq!(map.len(), reference.len() as u64);
    }
}
