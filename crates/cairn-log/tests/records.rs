//! Owner records and leaves: one spelling, strict reading, fixed layout.

use crate::common::owner;
use cairn_log::{
    Digest, Envelope, Leaf, OwnerRecord, RecordError, RecordKind,
    format::{
        merkle,
        record::{
            self, Digests, Identity, PAYLOAD_TYPE, Seen, SignalFiles, hidden_signal_commitment, photographs_root,
            scene_commitment,
        },
    },
};

fn record() -> OwnerRecord {
    OwnerRecord {
        version: record::VERSION,
        kind: RecordKind::Contribution,
        origin: "cairn.example/log".into(),
        scene: "liberty".into(),
        scene_salt: Digest::of("salt"),
        identity: Identity::numbered(3, "Ada \u{201c}the Lens\u{201d} Meyer"),
        owner_key: owner(1).public(),
        digests: Digests { photographs: Some(Digest::of("photographs")), ..Digests::default() },
        seed: Some(u64::MAX - 1),
        purpose: "credit".into(),
        nonce: Digest::of("nonce"),
        seen: Seen { size: 0, root: merkle::empty_root() },
        replaces: None,
        views: None,
    }
}

fn json() -> String {
    serde_json::to_string(&record()).unwrap()
}

#[test]
fn a_sealed_record_opens_to_itself() {
    let envelope = record().seal(&owner(1)).unwrap();
    let read = Envelope::parse(envelope.to_json().as_bytes()).unwrap();
    let (opened, signature) = OwnerRecord::open(&read).unwrap();
    assert_eq!(opened, record());
    assert_eq!(signature, &read.signatures[0]);
    assert!(record().seal(&owner(2)).is_err(), "only the owner named seals");
}

#[test]
fn a_seed_keeps_all_its_bits_and_has_one_spelling() {
    assert!(json().contains(r#""seed":"18446744073709551614""#));
    assert_eq!(OwnerRecord::parse(json().as_bytes()).unwrap().seed, Some(u64::MAX - 1));
    for seed in ["\"\"", "\"-1\"", "\"+1\"", "\"01\"", "\"1.0\"", "\"18446744073709551616\"", "7", "null"] {
        let text = json().replace("\"18446744073709551614\"", seed);
        assert!(OwnerRecord::parse(text.as_bytes()).is_err(), "{seed}");
    }
}

#[test]
fn reading_is_strict() {
    let good = json();
    OwnerRecord::parse(good.as_bytes()).unwrap();
    let refused = |text: String| OwnerRecord::parse(text.as_bytes()).unwrap_err();
    let cases = [
        (good.replacen('{', r#"{"extra":1,"#, 1), "unknown field `extra`"),
        (good.replacen('{', r#"{"scene":"fern","#, 1), "duplicate field `scene`"),
        (good.replace(r#""number":3"#, r#""number":3,"number":4"#), "duplicate field `number`"),
        (good.replace(r#""number":3"#, r#""number":3,"rank":4"#), "unknown field `rank`"),
        (good.replace(r#""number":3"#, r#""number":4294967296"#), "expected u32"),
        (good.replace(r#""number":3"#, r#""number":0"#), "identity.number"),
        (good.replace("contribution", "donation"), "unknown variant `donation`"),
        (good.replace(r#""purpose":"credit","#, ""), "missing field `purpose`"),
        (good.replace("liberty", "lib\\u0007erty"), "field scene"),
        (good.replace("liberty", &"x".repeat(257)), "field scene"),
        (good.replace(r#""size":0"#, r#""size":9007199254740992"#), "seen.size"),
        (format!("{good} {{}}"), "trailing"),
        ("null".into(), "owner record"),
    ];
    for (text, part) in cases {
        let error = refused(text).to_string();
        assert!(error.contains(part), "{part}: {error}");
    }
    // A later version is refused as such, whatever its fields.
    let later = refused(r#"{"version":3,"anything":true}"#.into());
    assert_eq!(later, RecordError::Version { what: "owner record", got: 3, expected: record::VERSION });
    // A key of small order in the body.
    let weak = good.replace(&owner(1).public().to_string(), &"0".repeat(64));
    assert!(refused(weak).to_string().contains("small order"));
}

#[test]
fn each_kind_asks_for_what_it_is_about() {
    for (kind, missing) in [
        (RecordKind::Claim, "digests.marked_field"),
        (RecordKind::Training, "digests.share_table"),
        (RecordKind::Binding, "identity.key"),
        (RecordKind::Rotation, "replaces"),
        (RecordKind::Dispute, "replaces"),
    ] {
        let identity = if kind == RecordKind::Binding { Identity::named("Ada") } else { record().identity };
        let wrong = OwnerRecord { kind, identity, ..record() };
        assert!(matches!(wrong.check(), Err(RecordError::Field { field, .. }) if field == missing), "{kind:?}");
        assert_eq!(RecordKind::from_code(kind.code()), Some(kind));
    }
    assert_eq!((RecordKind::from_code(0), RecordKind::from_code(7), RecordKind::from_code(9)), (None, None, None));
}

#[test]
fn a_claim_binds_the_mark_and_the_photographs() {
    let whole = Digests {
        marked_field: Some(Digest::of("field")),
        detector: Some(Digest::of("detector")),
        hidden_signal: Some(Digest::of("signal")),
        photographs: Some(Digest::of("photographs")),
        ..Digests::default()
    };
    let claim = |digests| OwnerRecord { kind: RecordKind::Claim, digests, ..record() }.check();
    claim(whole.clone()).unwrap();
    for (missing, digests) in [
        ("digests.marked_field", Digests { marked_field: None, ..whole.clone() }),
        ("digests.detector", Digests { detector: None, ..whole.clone() }),
        ("digests.hidden_signal", Digests { hidden_signal: None, ..whole.clone() }),
        ("digests.photographs", Digests { photographs: None, ..whole.clone() }),
    ] {
        let refused = claim(digests).unwrap_err();
        assert!(matches!(refused, RecordError::Field { field, .. } if field == missing), "{missing}: {refused}");
    }
    // Without an identity's number a claim is about photographs, and about nothing else.
    let photographs = Digests { photographs: whole.photographs, ..Digests::default() };
    let identity = Identity::named("Ada");
    OwnerRecord { kind: RecordKind::Claim, digests: photographs, identity: identity.clone(), ..record() }
        .check()
        .unwrap();
    let none = OwnerRecord { kind: RecordKind::Claim, digests: Digests::default(), identity, ..record() }.check();
    assert!(matches!(none, Err(RecordError::Field { field: "digests.photographs", .. })), "{none:?}");
}

#[test]
fn a_training_names_its_share_table_and_a_whole_mark_or_none() {
    let some = Some(Digest::of("a file"));
    let training = |change: fn(&mut Digests)| {
        let mut digests = Digests { share_table: some, training_configuration: some, ..Digests::default() };
        change(&mut digests);
        match (OwnerRecord { kind: RecordKind::Training, digests, ..record() }).check() {
            Err(RecordError::Field { field, .. }) => field,
            Err(e) => panic!("{e}"),
            Ok(()) => "",
        }
    };
    assert_eq!(training(|_| {}), "", "a base field alone has no mark");
    assert_eq!(training(|d| (d.marked_field, d.detector) = (d.share_table, d.share_table)), "");
    assert_eq!(training(|d| d.marked_field = d.share_table), "digests.detector");
    assert_eq!(training(|d| d.detector = d.share_table), "digests.marked_field");
    assert_eq!(training(|d| d.share_table = None), "digests.share_table");
    assert_eq!(training(|d| d.training_configuration = None), "digests.training_configuration");
}

#[test]
fn a_binding_is_about_a_name_and_a_key_alone() {
    let of = |identity| OwnerRecord { kind: RecordKind::Binding, digests: Digests::default(), identity, ..record() };
    let binding = of(Identity { key: Some(owner(7).public()), ..Identity::named("Ada") });
    let sealed = binding.seal(&owner(1)).unwrap();
    assert_eq!(OwnerRecord::open(&sealed).unwrap().0, binding);
    assert_eq!(Leaf::of(&sealed).unwrap().encode()[..2], [1, 8]);
    assert!(!RecordKind::Binding.credits());
    let photograph = Digest::of("photograph");
    let root = photographs_root(&[photograph]);
    let views = OwnerRecord {
        views: Some(vec![photograph]),
        digests: Digests { photographs: Some(root), ..Digests::default() },
        ..binding.clone()
    };
    let numbered = Identity { key: binding.identity.key, ..Identity::numbered(1, "Ada") };
    for (wrong, name) in [
        (of(Identity::named("Ada")), "identity.key"),
        (
            OwnerRecord { kind: RecordKind::Contribution, identity: binding.identity.clone(), ..record() },
            "identity.key",
        ),
        (of(numbered), "identity.number"),
        (OwnerRecord { replaces: Some(photograph), ..binding.clone() }, "replaces"),
        (views, "views"),
    ] {
        let refused = wrong.check();
        assert!(matches!(refused, Err(RecordError::Field { field, .. }) if field == name), "{name}: {refused:?}");
    }
    // A key of small order would sign for anybody.
    let weak = serde_json::to_string(&binding).unwrap().replace(&owner(7).public().to_string(), &"0".repeat(64));
    assert!(OwnerRecord::parse(weak.as_bytes()).unwrap_err().to_string().contains("small order"));
}

#[test]
fn a_leaf_is_162_bytes_in_the_documented_order() {
    let envelope = record().seal(&owner(1)).unwrap();
    let leaf = Leaf::of(&envelope).unwrap();
    let bytes = leaf.encode();
    assert_eq!(bytes.len(), 162);
    assert_eq!(bytes[..2], [1, 2]);
    assert_eq!(bytes[2..34], *Digest::of(envelope.pae()).as_bytes());
    assert_eq!(bytes[34..66], *Digest::of(owner(1).public().to_bytes()).as_bytes());
    assert_eq!(bytes[66..98], *scene_commitment(&Digest::of("salt"), "liberty").as_bytes());
    assert_eq!(bytes[98..], envelope.signatures[0].sig);
    assert_eq!(Leaf::decode(&bytes).unwrap(), leaf);
    assert_eq!(leaf.hash(), Digest::of([&[0][..], &bytes].concat()));
    assert!(Leaf::decode(&bytes[..161]).is_err());
    for (at, value) in [(0, 0), (0, 2), (1, 0), (1, 7), (1, 9)] {
        let mut wrong = bytes;
        wrong[at] = value;
        assert!(Leaf::decode(&wrong).is_err());
    }
}

#[test]
fn photographs_root_does_not_depend_on_order_but_on_each() {
    let [a, b, c] = ["a", "b", "c"].map(Digest::of);
    let root = photographs_root(&[a, b, c]);
    assert_eq!(root, photographs_root(&[c, a, b]));
    assert_ne!(root, photographs_root(&[a, b]));
    assert_ne!(root, photographs_root(&[a, b, b]));
    assert_ne!(root, photographs_root(&[a, b, c, c]));
    let mut sorted = [a, b];
    sorted.sort();
    let leaves = sorted.map(|d| Digest::of([&[0][..], d.as_bytes()].concat()));
    let by_hand = Digest::of([&[1][..], leaves[0].as_bytes(), leaves[1].as_bytes()].concat());
    assert_eq!(photographs_root(&[a, b]), by_hand);
    assert_eq!(photographs_root(&[]), Digest::of(""));
}

#[test]
fn a_commitment_covers_sound_and_text_and_which_is_which() {
    let salt = Digest::of("1");
    let commit = |picture: &[u8], audio: &[u8], text: &[u8]| {
        hidden_signal_commitment(&salt, &SignalFiles { picture, audio, text })
    };
    let all = [commit(b"ab", b"", b""), commit(b"", b"ab", b""), commit(b"", b"", b"ab"), commit(b"a", b"b", b"")];
    for (i, one) in all.iter().enumerate() {
        assert!(all[..i].iter().all(|other| other != one), "signal {i} has another's commitment");
    }
    let framed = [&[0, 0, 0, 0, 0, 0, 0, 1][..], b"a", &[0; 7], &[1], b"b", &[0; 8]].concat();
    let by_hand = [b"cairn hidden signal v2\0", &salt.as_bytes()[..], &framed].concat();
    assert_eq!(all[3], Digest::of(by_hand));
}

#[test]
fn a_commitment_tells_nothing_without_its_salt() {
    let signal = b"credit";
    let one = hidden_signal_commitment(&Digest::of("1"), &SignalFiles::picture(signal));
    assert_ne!(one, hidden_signal_commitment(&Digest::of("2"), &SignalFiles::picture(signal)));
    assert_ne!(one, Digest::of(signal));
    let by_hand = [b"cairn hidden signal v1\0", &Digest::of("1").as_bytes()[..], signal].concat();
    assert_eq!(one, Digest::of(by_hand), "records of pictures are checked as ever");
    let envelope = Envelope::new(PAYLOAD_TYPE, "{}");
    assert!(OwnerRecord::open(&envelope).is_err());
}
