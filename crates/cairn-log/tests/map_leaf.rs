//! Map leaves, the `views` of a record, and the keys under which records are listed.

use cairn_log::{
    Digest, Entry, Leaf, MapKey, MapLeaf, OwnerKey, OwnerRecord, RecordError, RecordKind,
    format::{
        leaf::LeafError,
        map::keys_of,
        map_leaf::{MapLeafError, statement},
        merkle,
        record::{self, Digests, Identity, MAX_VIEWS, Seen, photographs_root},
    },
};

const ORIGIN: &str = "cairn.example/log";

fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

fn views() -> Vec<Digest> {
    let mut views = ["one", "two", "three"].map(Digest::of).to_vec();
    views.sort_unstable();
    views
}

fn record(kind: RecordKind) -> OwnerRecord {
    OwnerRecord {
        version: record::VERSION,
        kind,
        origin: ORIGIN.into(),
        scene: "liberty".into(),
        scene_salt: Digest::of("salt"),
        identity: Identity::numbered(3, "Ada"),
        owner_key: key(1).public(),
        digests: Digests { photographs: Some(photographs_root(&views())), ..Digests::default() },
        seed: None,
        purpose: "credit".into(),
        nonce: Digest::of("nonce"),
        seen: Seen { size: 0, root: merkle::empty_root() },
        replaces: matches!(kind, RecordKind::Rotation | RecordKind::Dispute).then(|| Digest::of("earlier")),
        views: None,
    }
}

#[test]
fn a_map_leaf_is_a_signed_sentence_about_one_place_of_one_log() {
    let root = Digest::of("map");
    let leaf = MapLeaf::sign(ORIGIN, 41, root, &key(200));
    let body = format!(r#"{{"version":1,"kind":"map","origin":"{ORIGIN}","size":41,"root":"{root}"}}"#);
    let pae = format!("DSSEv1 38 application/vnd.cairn.map-root.v1+json {} {body}", body.len());
    assert_eq!(statement(ORIGIN, 41, &root), pae.as_bytes());
    assert_eq!(leaf.statement, Digest::of(&pae));
    let bytes = leaf.encode();
    assert_eq!((bytes.len(), bytes[..2].to_vec()), (162, vec![1, 7]));
    assert_eq!(bytes[34..66], *key(200).public().id().as_bytes());
    assert_eq!(bytes[66..98], *root.as_bytes());
    key(200).public().verify(pae.as_bytes(), &bytes[98..]).unwrap();
    assert_eq!(leaf.hash(), merkle::leaf_hash(&bytes));
    let registry = key(200).public();
    leaf.verify(ORIGIN, 41, &registry).unwrap();
    assert!(matches!(leaf.verify(ORIGIN, 42, &registry), Err(MapLeafError::Statement { index: 42, .. })));
    assert!(matches!(leaf.verify("other/log", 41, &registry), Err(MapLeafError::Statement { .. })));
    assert!(matches!(leaf.verify(ORIGIN, 41, &key(9).public()), Err(MapLeafError::Registry { .. })));
    let other = MapLeaf { root: Digest::of("other"), ..leaf.clone() };
    assert!(matches!(other.verify(ORIGIN, 41, &registry), Err(MapLeafError::Statement { .. })));
    let mut unsigned = leaf;
    unsigned.signature[5] ^= 1;
    assert!(matches!(unsigned.verify(ORIGIN, 41, &registry), Err(MapLeafError::Signature { index: 41, .. })));
    // An origin that JSON has to escape is still rebuilt.
    MapLeaf::sign("a \"b\" \\ é", 0, root, &key(2)).verify("a \"b\" \\ é", 0, &key(2).public()).unwrap();
}

#[test]
fn leaves_are_told_apart_by_their_kind_byte() {
    let map = MapLeaf::sign(ORIGIN, 1, Digest::of("map"), &key(200));
    let leaf = Leaf::of(&record(RecordKind::Contribution).seal(&key(1)).unwrap()).unwrap();
    assert_eq!(Entry::decode(&map.encode()), Ok(Entry::Map(map.clone())));
    assert_eq!(Entry::decode(&leaf.encode()), Ok(Entry::Record(leaf.clone())));
    for entry in [Entry::Map(map.clone()), Entry::Record(leaf.clone())] {
        assert_eq!(Entry::decode(&entry.encode()).unwrap().hash(), entry.hash());
    }
    assert_eq!(MapLeaf::decode(&map.encode()), Ok(map.clone()));
    assert_eq!(Leaf::decode(&map.encode()), Err(LeafError::IsMap));
    assert!(LeafError::IsMap.to_string().contains("kind 7"));
    assert_eq!(MapLeaf::decode(&leaf.encode()), Err(LeafError::IsRecord { got: 2 }));
    for (at, value, error) in
        [(0, 2, LeafError::Version { got: 2 }), (1, 9, LeafError::Kind { got: 9 }), (1, 0, LeafError::Kind { got: 0 })]
    {
        let mut bytes = map.encode();
        bytes[at] = value;
        assert_eq!(Entry::decode(&bytes), Err(error.clone()));
        assert_eq!(MapLeaf::decode(&bytes), Err(error));
    }
    assert_eq!(Entry::decode(&map.encode()[1..]), Err(LeafError::Length { got: 161 }));
}

#[test]
fn views_are_the_photographs_of_the_record_and_nothing_else() {
    let with = |views| OwnerRecord { views, ..record(RecordKind::Contribution) };
    with(None).check().unwrap();
    with(Some(views())).check().unwrap();
    let envelope = with(Some(views())).seal(&key(1)).unwrap();
    assert_eq!(OwnerRecord::open(&envelope).unwrap().0.views, Some(views()));
    assert!(!serde_json::to_string(&with(None)).unwrap().contains("views"));
    let mut reversed = views();
    reversed.reverse();
    let twice = vec![views()[0], views()[0], views()[1]];
    let mut more = views();
    more.push(Digest::from_bytes([0xff; 32]));
    for wrong in [vec![], reversed, twice, more, views()[..2].to_vec()] {
        let refused = with(Some(wrong)).check().unwrap_err();
        assert!(matches!(refused, RecordError::Field { field: "views", .. }), "{refused}");
    }
    let mut unnamed = record(RecordKind::Revocation);
    unnamed.digests.photographs = None;
    unnamed.views = Some(views());
    assert!(matches!(unnamed.check(), Err(RecordError::Field { field: "views", .. })));
    let mut many: Vec<_> = (0..=MAX_VIEWS as u64).map(|i| Digest::of(i.to_be_bytes())).collect();
    many.sort_unstable();
    for (count, good) in [(MAX_VIEWS, true), (MAX_VIEWS + 1, false)] {
        let mut record = with(Some(many[..count].to_vec()));
        record.digests.photographs = Some(photographs_root(&many[..count]));
        assert_eq!(record.check().is_ok(), good, "{count} views");
        if good {
            // The longest list still travels in an envelope.
            let json = record.seal(&key(1)).unwrap().to_json();
            cairn_log::Envelope::parse(json.as_bytes()).unwrap();
        }
    }
}

#[test]
fn a_record_is_listed_under_everything_that_it_concerns() {
    let sorted = |mut keys: Vec<MapKey>| {
        keys.sort_unstable();
        keys
    };
    let scene = MapKey::scene("liberty");
    let plain = record(RecordKind::Contribution);
    let named = MapKey::contributor("liberty", "Ada");
    assert_eq!(keys_of(&plain, None), sorted(vec![scene, named]));
    assert_ne!(named, MapKey::contributor("liberty", "Bea"));
    // Bindings of the name are found by themselves, however many claim it.
    let identity = Identity { key: Some(key(7).public()), ..Identity::named("Ada") };
    let binding = OwnerRecord { identity, ..record(RecordKind::Binding) };
    assert_eq!(keys_of(&binding, None), sorted(vec![scene, MapKey::binding("liberty", "Ada")]));
    let seen = OwnerRecord { views: Some(views()), ..plain };
    let mut expected: Vec<_> = views().iter().map(|view| MapKey::view("liberty", view)).collect();
    expected.extend([scene, named]);
    assert_eq!(keys_of(&seen, None), sorted(expected));
    let own = MapKey::ended(&key(1).public().id());
    let revocation = record(RecordKind::Revocation);
    assert_eq!(keys_of(&revocation, None), sorted(vec![scene, own]));
    let about = MapKey::about(&Digest::of("earlier"));
    let back = OwnerRecord { replaces: Some(Digest::of("earlier")), ..revocation };
    assert_eq!(keys_of(&back, None), sorted(vec![scene, own, about]));
    let old = key(7).public().id();
    assert_eq!(keys_of(&record(RecordKind::Rotation), Some(old)), sorted(vec![scene, MapKey::ended(&old), about]));
    assert_eq!(keys_of(&record(RecordKind::Rotation), None), sorted(vec![scene, about]));
    // Only a revocation or rotation ends a key, whoever's record it names.
    assert_eq!(keys_of(&record(RecordKind::Dispute), Some(old)), sorted(vec![scene, about]));
}
