//! The verifiable map against its definition: known answers, random maps, and proofs that somebody bent.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
};

use cairn_log::{
    Digest, MapEntry, MapKey, MapProof, MapTree,
    format::map::{EMPTY, ListState, ProofEnd, list_root},
    log::{
        map::{BucketMap, BucketTop, Buckets, MapError, Row, Staged},
        store::StoreError,
    },
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Keys' rows and buckets' tops as a store would hold them.
#[derive(Default)]
struct Stored {
    rows: BTreeMap<MapKey, Vec<u8>>,
    tops: BTreeMap<u32, [u8; 34]>,
    loads: RefCell<Vec<u32>>,
}

/// The first 18 bits of a key.
fn bucket_of(key: &MapKey) -> u32 {
    u32::from_be_bytes(*key.as_bytes().first_chunk().unwrap()) >> 14
}

impl Buckets for Stored {
    fn load(&self, bucket: u32) -> Result<Vec<Row>, StoreError> {
        self.loads.borrow_mut().push(bucket);
        let rows = self.rows.iter().filter(|(key, _)| bucket_of(key) == bucket);
        Ok(rows.map(|(key, list)| (*key, list.clone())).collect())
    }
}

impl Stored {
    fn keep(&mut self, staged: &Staged) {
        self.rows.extend(staged.rows.iter().cloned());
        self.tops.extend(staged.tops.iter().map(|(bucket, top)| (*bucket, top.encode())));
    }

    fn restart(&self) -> BucketMap {
        BucketMap::from_tops(self.tops.iter().map(|(b, top)| (*b, BucketTop::decode(*b, top).unwrap())))
    }
}

/// The definition, word for word: the subtree at `depth` over the keys that share the bits above it.
fn by_definition(rows: &[(MapKey, Digest)], depth: usize) -> Digest {
    let is_set = |key: &MapKey| key.as_bytes()[depth / 8] & (0x80 >> (depth % 8)) != 0;
    match rows {
        [] => EMPTY,
        [(key, value)] => Digest::of_parts(&[&[2], key.as_bytes(), value.as_bytes()]),
        _ => {
            let (right, left): (Vec<_>, Vec<_>) = rows.iter().partition(|(key, _)| is_set(key));
            let (left, right) = (by_definition(&left, depth + 1), by_definition(&right, depth + 1));
            Digest::of_parts(&[&[3], left.as_bytes(), right.as_bytes()])
        }
    }
}

fn entry(index: u64) -> MapEntry {
    MapEntry { index, leaf_hash: Digest::of(index.to_be_bytes()) }
}

/// A key that shares its first `shared` bits with `with`, and not the one behind them.
fn neighbour(with: &MapKey, shared: usize, random: &mut ChaCha8Rng) -> MapKey {
    let mut bytes: [u8; 32] = random.random();
    for bit in 0..=shared.min(255) {
        let (at, mask) = (bit / 8, 0x80 >> (bit % 8));
        let own = (with.as_bytes()[at] & mask != 0) ^ (bit == shared);
        bytes[at] = if own { bytes[at] | mask } else { bytes[at] & !mask };
    }
    MapKey::from_bytes(bytes)
}

/// Keys spread evenly, with some that share up to 255 bits with another one.
fn keys(count: usize, random: &mut ChaCha8Rng) -> Vec<MapKey> {
    let mut keys: Vec<MapKey> = Vec::new();
    while keys.len() < count {
        let key = match random.random_range(0..3) {
            0 if !keys.is_empty() => {
                let with = keys[random.random_range(0..keys.len())];
                neighbour(&with, random.random_range(0..256), random)
            }
            _ => MapKey::from_bytes(random.random()),
        };
        if !keys.contains(&key) {
            keys.push(key);
        }
    }
    keys
}

#[test]
fn keys_are_hashed_as_written_down() {
    let expected = |label: &str, fields: &[&[u8]]| {
        let mut bytes = label.as_bytes().to_vec();
        bytes.push(0);
        for field in fields {
            bytes.extend_from_slice(&(field.len() as u64).to_be_bytes());
            bytes.extend_from_slice(field);
        }
        MapKey::from_bytes(*Digest::of(bytes).as_bytes())
    };
    let digest = Digest::of("photograph");
    assert_eq!(MapKey::scene("fern"), expected("cairn map scene v1", &[b"fern"]));
    assert_eq!(MapKey::view("fern", &digest), expected("cairn map view v1", &[b"fern", digest.as_bytes()]));
    assert_eq!(MapKey::ended(&digest), expected("cairn map ended v1", &[digest.as_bytes()]));
    assert_eq!(MapKey::about(&digest), expected("cairn map about v1", &[digest.as_bytes()]));
    // From another implementation (Python's hashlib), so that the four above cannot be wrong together.
    let known = "3e35c134d178a0ee918124d25dbbae896fcc194b8540309a9ce5ca81299923e0";
    assert_eq!(MapKey::scene("fern").to_string(), known);
}

#[test]
fn maps_of_no_one_and_two_keys_have_the_roots_worked_out_by_hand() {
    let mut tree = MapTree::new();
    assert_eq!(tree.root(), Digest::from_bytes([0; 32]));
    assert_eq!(BucketMap::new().root(), tree.root());
    // First bits 00.. and 01..: they part at the second bit.
    let (low, high) = (MapKey::from_bytes([0x00; 32]), MapKey::from_bytes([0x40; 32]));
    let (low_value, high_value) = (entry(1).hash(), entry(2).hash());
    let low_leaf = Digest::of([&[2], low.as_bytes().as_slice(), low_value.as_bytes()].concat());
    let high_leaf = Digest::of([&[2], high.as_bytes().as_slice(), high_value.as_bytes()].concat());
    tree.append(low, &entry(1));
    assert_eq!(tree.root(), low_leaf, "one key: its leaf is the root");
    let half = Digest::of([&[3], low_leaf.as_bytes().as_slice(), high_leaf.as_bytes()].concat());
    let whole = Digest::of([&[3], half.as_bytes().as_slice(), &[0; 32]].concat());
    tree.append(high, &entry(2));
    assert_eq!(tree.root(), whole, "two keys that share a bit");
    let mut map = BucketMap::new();
    let mut stored = Stored::default();
    for (key, index, root) in [(low, 1, low_leaf), (high, 2, whole)] {
        let staged = map.stage(&stored, &BTreeMap::from([(key, vec![entry(index)])])).unwrap();
        stored.keep(&staged);
        map.apply(&staged);
        assert_eq!((staged.root, map.root()), (root, root));
    }
    let proof = tree.prove(&low);
    assert_eq!(proof, MapProof { siblings: vec![EMPTY, high_leaf], end: ProofEnd::Own });
    proof.verify(&low, Some(low_value), &whole).unwrap();
    let absent = tree.prove(&MapKey::from_bytes([0x80; 32]));
    assert_eq!(absent, MapProof { siblings: vec![half], end: ProofEnd::Empty });
    let beside = tree.prove(&MapKey::from_bytes([0x60; 32]));
    let end = ProofEnd::Other { key: high, value: high_value };
    assert_eq!(beside, MapProof { siblings: vec![EMPTY, low_leaf], end });
}

#[test]
fn three_ways_to_grow_a_map_have_one_root_and_one_proof() {
    for seed in 0..12 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let keys = keys(1 + 23 * seed as usize, &mut random);
        let (mut map, mut stored, mut tree) = (BucketMap::new(), Stored::default(), MapTree::new());
        let mut lists: BTreeMap<MapKey, Vec<MapEntry>> = BTreeMap::new();
        let mut index = 0;
        for _batch in 0..6 {
            let mut changes: BTreeMap<MapKey, Vec<MapEntry>> = BTreeMap::new();
            for _ in 0..random.random_range(0..2 * keys.len()) {
                let key = keys[random.random_range(0..keys.len())];
                changes.entry(key).or_default().push(entry(index));
                tree.append(key, &entry(index));
                lists.entry(key).or_default().push(entry(index));
                index += random.random_range(1..5_u64);
            }
            let staged = map.stage(&stored, &changes).unwrap();
            // What is staged changes nothing before it is stored.
            assert_eq!(map.root(), stored.restart().root());
            let touched: BTreeSet<_> = staged.tops.iter().map(|top| top.0).collect();
            assert_eq!(stored.loads.take(), touched.into_iter().collect::<Vec<_>>(), "only changed buckets are read");
            stored.keep(&staged);
            map.apply(&staged);
            let rows: Vec<_> = lists.iter().map(|(key, entries)| (*key, list_root(entries))).collect();
            let root = by_definition(&rows, 0);
            assert_eq!([staged.root, map.root(), tree.root(), stored.restart().root()], [root; 4], "seed {seed}");
        }
        assert_eq!(tree.len(), lists.len() as u64);
        for key in
            keys.iter().copied().chain((0..40).map(|_| neighbour(&keys[0], random.random_range(0..256), &mut random)))
        {
            let (list, proof) = map.prove(&stored, &key).unwrap();
            assert_eq!(proof, tree.prove(&key), "seed {seed}, key {key}");
            assert_eq!(list.as_ref(), tree.get(&key));
            assert_eq!(list.as_ref().map(ListState::root), lists.get(&key).map(|entries| list_root(entries)));
            proof.verify(&key, list.as_ref().map(ListState::root), &map.root()).unwrap();
        }
    }
}

/// A map of 60 keys and its proofs for members and for absentees.
fn proven() -> (MapTree, Vec<(MapKey, Option<Digest>, MapProof)>) {
    let mut random = ChaCha8Rng::seed_from_u64(77);
    let keys = keys(90, &mut random);
    let mut tree = MapTree::new();
    (0..).zip(&keys[..60]).for_each(|(i, key)| tree.append(*key, &entry(i)));
    let proofs = keys.iter().map(|key| (*key, tree.get(key).map(ListState::root), tree.prove(key))).collect();
    (tree, proofs)
}

#[test]
fn bent_proofs_are_refused_by_name() {
    let (mut tree, proofs) = proven();
    let root = tree.root();
    let code = |proof: &MapProof, key: &MapKey, value| proof.verify(key, value, &root).map_err(|e| e.code());
    let mut seen = BTreeSet::new();
    for (key, value, proof) in &proofs {
        assert_eq!(code(proof, key, *value), Ok(()));
        // The other claim, with the same proof and with every end that fits it.
        let forged = if value.is_some() { None } else { Some(Digest::of("forged")) };
        assert_eq!(code(proof, key, forged), Err("map.proof.wrong_sort"));
        let other = proofs.iter().find(|(k, v, _)| k != key && v.is_some()).unwrap();
        let ends = [
            ProofEnd::Own,
            ProofEnd::Empty,
            ProofEnd::Other { key: other.0, value: other.1.unwrap() },
            ProofEnd::Other { key: *key, value: value.unwrap_or(EMPTY) },
        ];
        for end in ends {
            let bent = MapProof { end, ..proof.clone() };
            seen.insert(code(&bent, key, forged).unwrap_err());
        }
        if let Some(value) = value {
            assert!(code(proof, key, Some(Digest::of(value.as_bytes()))).is_err());
        }
        for at in 0..proof.siblings.len() {
            let mut bent = proof.clone();
            bent.siblings[at] = Digest::of("x");
            assert_eq!(code(&bent, key, *value), Err("map.proof.root_mismatch"));
            let mut bent = proof.clone();
            bent.siblings.remove(at);
            assert!(code(&bent, key, *value).is_err());
            let mut bent = proof.clone();
            bent.siblings.swap(0, at);
            assert!(bent == *proof || code(&bent, key, *value).is_err());
        }
        let mut long = proof.clone();
        long.siblings.resize(257, Digest::of("x"));
        assert_eq!(code(&long, key, *value), Err("map.proof.too_long"));
        let mut padded = proof.clone();
        padded.siblings.push(EMPTY);
        assert_eq!(code(&padded, key, *value), Err("map.proof.not_collapsed"));
        assert!(proof.verify(key, *value, &Digest::of("another root")).is_err());
        // A proof of one key is none of another.
        for (elsewhere, _, _) in proofs.iter().filter(|p| p.0 != *key).take(20) {
            assert!(value.is_none() || code(proof, elsewhere, *value).is_err());
        }
    }
    let all =
        ["map.proof.other_path", "map.proof.own_leaf_as_other", "map.proof.root_mismatch", "map.proof.wrong_sort"];
    assert!(seen.iter().copied().eq(all), "{seen:?}");
}

#[test]
fn proofs_go_through_json_and_only_strictly() {
    let (_, proofs) = proven();
    for (_, _, proof) in &proofs {
        let json = serde_json::to_string(proof).unwrap();
        assert_eq!(&serde_json::from_str::<MapProof>(&json).unwrap(), proof);
    }
    let hash = format!("{:?}", EMPTY.to_base64());
    let many = vec![hash.as_str(); 257].join(",");
    for json in [
        format!(r#"{{"siblings":[{many}],"end":"own"}}"#),
        r#"{"siblings":[],"end":"mine"}"#.into(),
        r#"{"siblings":[],"end":"own","more":1}"#.into(),
        r#"{"siblings":["AAAA"],"end":"own"}"#.into(),
        r#"{"siblings":[]}"#.into(),
        format!(r#"{{"siblings":[],"end":{{"other":{{"key":"00","value":{hash}}}}}}}"#),
    ] {
        assert!(serde_json::from_str::<MapProof>(&json).is_err(), "{json}");
    }
    let most = json_of(&vec![hash.as_str(); 256].join(","));
    assert_eq!(serde_json::from_str::<MapProof>(&most).unwrap().siblings.len(), 256);
}

fn json_of(siblings: &str) -> String {
    format!(r#"{{"siblings":[{siblings}],"end":"empty"}}"#)
}

#[test]
fn spoilt_buckets_are_named_and_no_proof_comes_out_of_them() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let first = MapKey::from_bytes(random.random());
    // Three keys in one bucket, one elsewhere.
    let keys = [
        first,
        neighbour(&first, 30, &mut random),
        neighbour(&first, 90, &mut random),
        neighbour(&first, 3, &mut random),
    ];
    let changes: BTreeMap<_, _> = (0..).zip(keys).map(|(i, key)| (key, vec![entry(i), entry(i + 9)])).collect();
    let mut map = BucketMap::new();
    let mut stored = Stored::default();
    let staged = map.stage(&stored, &changes).unwrap();
    stored.keep(&staged);
    map.apply(&staged);
    assert_eq!((stored.rows.len(), stored.tops.len()), (4, 2));
    let refused = |map: &BucketMap, stored: &Stored, key: &MapKey| match map.prove(stored, key) {
        Err(MapError::Bucket { bucket, .. } | MapError::Inconsistent { bucket }) => bucket == bucket_of(key),
        _ => false,
    };
    for key in keys {
        let good = stored.rows[&key].clone();
        for at in 0..good.len() {
            let mut bytes = good.clone();
            bytes[at] ^= 1;
            stored.rows.insert(key, bytes);
            assert!(refused(&map, &stored, &key), "byte {at}");
            assert!(map.stage(&stored, &BTreeMap::from([(key, vec![entry(99)])])).is_err(), "byte {at}");
        }
        for bytes in [&good[..good.len() - 1], &[&good[..], &[0]].concat()] {
            stored.rows.insert(key, bytes.to_vec());
            assert!(matches!(map.prove(&stored, &key), Err(MapError::Bucket { .. })));
        }
        stored.rows.remove(&key);
        assert!(refused(&map, &stored, &key), "a row that is gone");
        assert!(matches!(map.stage(&stored, &changes), Err(MapError::Inconsistent { .. })));
        stored.rows.insert(key, good);
        map.prove(&stored, &key).unwrap();
    }
    for bytes in [&[][..], &[1; 34], &[2; 34], &[1; 33]] {
        assert!(bytes.len() == 34 && bytes[0] == 1 || BucketTop::decode(7, bytes).is_err());
    }
    assert!(
        BucketTop::decode(7, &[[1, 3].as_slice(), &[0; 32]].concat()).unwrap_err().to_string().contains("bucket 7")
    );
}

#[test]
fn a_store_that_fails_fails_the_batch_and_leaves_the_map() {
    struct Failing;
    impl Buckets for Failing {
        fn load(&self, _: u32) -> Result<Vec<Row>, StoreError> {
            Err(StoreError { operation: "get", place: "memory".into(), cause: "injected".into() })
        }
    }
    let map = BucketMap::new();
    let changes = BTreeMap::from([(MapKey::scene("fern"), vec![entry(0)])]);
    assert!(matches!(map.stage(&Failing, &changes), Err(MapError::Store(_))));
    assert_eq!(map.root(), EMPTY);
    // Nothing to do needs no store, and absence in an empty map neither.
    assert_eq!(map.stage(&Failing, &BTreeMap::new()).unwrap().root, EMPTY);
    assert_eq!(map.prove(&Failing, &MapKey::scene("fern")).unwrap().0, None);
}
