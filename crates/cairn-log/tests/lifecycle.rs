//! A record's life in the registry, over the real store: submission, restart, proofs, and what is refused.
#![cfg(feature = "store")]

use crate::common::*;
use cairn_log::{
    Checkpoint, Digest, Envelope, LogEntry, OwnerRecord, RecordError, RecordKind, Registry, RegistryError,
    format::merkle, log::store::FaultyStore,
};

fn in_memory() -> (FaultyStore, Registry) {
    let store = FaultyStore::new();
    let registry =
        Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN).unwrap();
    (store, registry)
}

fn reopened(store: &FaultyStore) -> Registry {
    Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN).unwrap()
}

#[test]
fn records_survive_a_restart_and_every_size_stays_provable() {
    let folder = tempfile::tempdir().unwrap();
    let mut checkpoints = Vec::new();
    let receipts: Vec<_> = {
        let registry = Registry::open(folder.path(), registry_key(), ORIGIN).unwrap();
        assert_eq!(registry.size(), 0);
        let scenes = ["liberty", "fern", "liberty", "trex", "fern"];
        let take = |(i, scene): (usize, &&str)| {
            let receipt = submit(&registry, &owner(i as u8 + 1), scene, &i.to_string()).unwrap();
            assert_eq!(receipt.index, 2 * i as u64, "a map leaf follows each batch");
            verify_receipt(&registry, &receipt);
            checkpoints.push(receipt.checkpoint.clone());
            receipt
        };
        scenes.iter().enumerate().map(take).collect()
    };
    let registry = Registry::open(folder.path(), registry_key(), ORIGIN).unwrap();
    assert_eq!(registry.size(), 10);
    assert_eq!(registry.checkpoint(), receipts[4].checkpoint, "the same tree is signed the same after a restart");
    assert!(registry.check().unwrap().is_empty());
    let log = registry.verifier().unwrap();
    let head = Checkpoint::verify(&registry.checkpoint(), &log).unwrap();
    for (old, receipt) in checkpoints.iter().zip(&receipts) {
        let old = Checkpoint::verify(old, &log).unwrap();
        let proof = registry.prove_consistency(old.size, head.size).unwrap();
        merkle::verify_consistency(old.size, head.size, &proof, &old.root, &head.root).unwrap();
        let proof = registry.prove_inclusion(receipt.index, 10).unwrap();
        merkle::verify_inclusion(&receipt.leaf_hash, receipt.index, 10, &proof, &head.root).unwrap();
    }
    let of = |scene| records(&registry, scene).iter().map(|r| r.index).collect::<Vec<_>>();
    assert_eq!((of(Some("liberty")), of(Some("fern"))), (vec![0, 4], vec![2, 8]));
    assert_eq!((of(None), of(Some("nowhere"))), (vec![0, 2, 4, 6, 8], vec![]));
    let page = |scene, from, limit| registry.page(scene, from, limit).unwrap();
    assert!(matches!(&page(Some("fern"), 3, 9)[..], [LogEntry::Record(stored)] if stored.index == 8));
    assert!(matches!(&page(None, 1, 2)[..], [LogEntry::Map { index: 1, .. }, LogEntry::Record(_)]));
    assert_eq!(registry.record(4).unwrap().envelope, receipts[2].envelope);
    assert_eq!(registry.find(&receipts[3].envelope.digest()).unwrap(), Some(6));
    assert!(matches!(registry.record(5), Err(RegistryError::NotARecord { index: 5 })));
    assert!(matches!(registry.record(10), Err(RegistryError::NoSuchRecord { index: 10, size: 10 })));
    assert!(matches!(registry.prove_inclusion(0, 11), Err(RegistryError::Proof(_))));
    assert!(matches!(registry.prove_consistency(1, 11), Err(RegistryError::Proof(_))));
}

const fn shared_between_threads<T: Send + Sync>() {}
const _: () = shared_between_threads::<Registry>();

#[test]
fn a_second_writer_is_refused_and_told_who_holds_the_store() {
    let folder = tempfile::tempdir().unwrap();
    let first = Registry::open(folder.path(), registry_key(), ORIGIN).unwrap();
    match Registry::open(folder.path(), registry_key(), ORIGIN) {
        Err(RegistryError::Locked { pid, .. }) => assert_eq!(pid, std::process::id().to_string()),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("two writers"),
    }
    drop(first);
    Registry::open(folder.path(), registry_key(), ORIGIN).unwrap();
}

#[test]
fn the_same_record_again_gives_its_old_index() {
    let (store, registry) = in_memory();
    let envelope = sealed(&registry, &owner(1), "fern", "a");
    let first = take(&registry, &envelope).unwrap();
    submit(&registry, &owner(2), "fern", "b").unwrap();
    let again = take(&registry, &envelope).unwrap();
    assert_eq!((first.index, again.index, again.resubmitted, registry.size()), (0, 0, true, 4));
    assert_eq!((again.size, &again.envelope), (4, &first.envelope));
    verify_receipt(&registry, &again);
    // Also the countersigned envelope, also with foreign signatures around, also after a restart.
    let mut noisy = first.envelope.clone();
    noisy.sign(&owner(77));
    let registry = reopened(&store.crash());
    let again = take(&registry, &noisy).unwrap();
    assert_eq!((again.index, &again.envelope, registry.size()), (0, &first.envelope, 4));
}

/// One change to a good record, and whether the refusal is the right one.
type Case = (&'static str, fn(&mut OwnerRecord), fn(&RegistryError) -> bool);

#[test]
fn each_rule_refuses_by_name_and_leaves_no_trace() {
    let (store, registry) = in_memory();
    submit(&registry, &owner(9), "fern", "first").unwrap();
    let before = store.keys();
    let cases: [Case; 12] = [
        ("origin", |r| r.origin = "other.example/log".into(), |e| matches!(e, RegistryError::WrongOrigin { .. })),
        ("nonce", |r| r.nonce = Digest::of("mine"), |e| matches!(e, RegistryError::NonceForeign { .. })),
        ("scene", |r| r.scene = "trex".into(), |e| matches!(e, RegistryError::NonceForeign { .. })),
        ("seen size", |r| r.seen.size = 3, |e| matches!(e, RegistryError::SeenForeign { size: 3, .. })),
        ("seen root", |r| r.seen.root = Digest::of("x"), |e| matches!(e, RegistryError::SeenForeign { .. })),
        ("replaces", |r| r.replaces = Some(Digest::of("x")), |e| matches!(e, RegistryError::ReplacesUnknown { .. })),
        ("kind", |r| r.kind = RecordKind::Dispute, |e| is_field(e, "replaces")),
        ("digest", |r| r.digests.detector = None, |e| is_field(e, "digests.detector")),
        ("seed", |r| r.seed = None, |e| is_field(e, "seed")),
        ("identity", |r| r.identity.number = Some(0), |e| is_field(e, "identity.number")),
        ("blank", |r| r.scene = " fern".into(), |e| is_field(e, "scene")),
        ("version", |r| r.version = 3, |e| matches!(e, RegistryError::Record(RecordError::Version { got: 3, .. }))),
    ];
    for (name, change, right) in cases {
        let mut record = record(&registry, &owner(1), "fern", "a");
        change(&mut record);
        // Sealed by hand: `seal` itself would refuse some of these.
        let mut envelope = Envelope::new(cairn_log::format::record::PAYLOAD_TYPE, serde_json::to_vec(&record).unwrap());
        envelope.sign(&owner(1));
        let error = take(&registry, &envelope).unwrap_err();
        assert!(right(&error), "{name}: {error}");
    }
    assert_eq!((registry.size(), store.keys()), (2, before));
}

fn is_field(error: &RegistryError, name: &str) -> bool {
    matches!(error, RegistryError::Record(RecordError::Field { field, .. }) if *field == name)
}

#[test]
fn a_record_needs_its_owners_signature_and_its_type() {
    let (_, registry) = in_memory();
    let good = sealed(&registry, &owner(1), "fern", "a");
    let mut foreign = Envelope::new(&good.payload_type, good.payload.as_slice());
    foreign.sign(&owner(2));
    let refused = take(&registry, &foreign).unwrap_err();
    assert!(matches!(refused, RegistryError::Record(RecordError::OwnerSignature { .. })), "{refused}");
    let mut other_type = Envelope::new("application/vnd.cairn.owner-record.v2+json", good.payload.as_slice());
    other_type.sign(&owner(1));
    let refused = take(&registry, &other_type).unwrap_err();
    assert!(matches!(refused, RegistryError::Record(RecordError::Envelope(_))), "{refused}");
    assert!(refused.to_string().contains("owner-record.v2"));
    assert_eq!(registry.size(), 0);
}

#[test]
fn a_nonce_serves_one_record() {
    let (_, registry) = in_memory();
    let mut record = record(&registry, &owner(1), "fern", "a");
    take(&registry, &record.seal(&owner(1)).unwrap()).unwrap();
    record.purpose = "something else".into();
    let refused = take(&registry, &record.seal(&owner(1)).unwrap()).unwrap_err();
    assert!(matches!(refused, RegistryError::NonceUsed { index: 0, .. }), "{refused}");
}

#[test]
fn who_may_write_about_an_earlier_record() {
    let (_, registry) = in_memory();
    let first = submit(&registry, &owner(1), "fern", "a").unwrap().envelope.digest();
    let about = |kind, by: u8| {
        let mut r = record(&registry, &owner(by), "fern", "about");
        (r.kind, r.replaces) = (kind, Some(first));
        r.seal(&owner(by)).unwrap()
    };
    for kind in [RecordKind::Revocation, RecordKind::Rotation, RecordKind::Training] {
        let refused = take(&registry, &about(kind, 2)).unwrap_err();
        assert!(matches!(refused, RegistryError::ReplacesForeign { .. }), "{kind:?}: {refused}");
    }
    // Anybody may dispute; a new key takes over where the old one signs too; then the old one is good for nothing.
    take(&registry, &about(RecordKind::Dispute, 2)).unwrap();
    let mut rotation = about(RecordKind::Rotation, 3);
    rotation.sign(&owner(1));
    let before = sealed(&registry, &owner(1), "fern", "before");
    assert!(is_field(&take(&registry, &about(RecordKind::Rotation, 1)).unwrap_err(), "owner_key"));
    let receipt = take(&registry, &rotation).unwrap();
    assert_eq!(receipt.envelope.signatures.len(), 3, "new owner, old owner, registry");
    let mut again = about(RecordKind::Rotation, 4);
    again.sign(&owner(1));
    for envelope in [before, again, about(RecordKind::Revocation, 1)] {
        let refused = take(&registry, &envelope).unwrap_err();
        assert!(matches!(refused, RegistryError::OwnerRotated { index: 4, .. }), "{refused}");
    }
    assert!(take(&registry, &rotation).unwrap().resubmitted);
    assert!(registry.check().unwrap().is_empty());
}

#[test]
fn a_revoked_key_signs_no_more_also_after_a_restart() {
    let (store, registry) = in_memory();
    submit(&registry, &owner(1), "fern", "a").unwrap();
    let mut revocation = record(&registry, &owner(1), "fern", "end");
    revocation.kind = RecordKind::Revocation;
    take(&registry, &revocation.seal(&owner(1)).unwrap()).unwrap();
    let registry = reopened(&store.crash());
    let refused = submit(&registry, &owner(1), "trex", "b").unwrap_err();
    assert!(matches!(refused, RegistryError::OwnerRevoked { index: 2, .. }), "{refused}");
    submit(&registry, &owner(2), "trex", "b").unwrap();
    assert_eq!(registry.size(), 6);
}

#[test]
fn submissions_at_once_share_flushes_and_each_gets_its_own_place() {
    let (store, registry) = in_memory();
    let flushes_before = store.flushes();
    let receipts: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (1..=64_u8)
            .map(|number| {
                let registry = &registry;
                scope.spawn(move || {
                    (0..8)
                        .map(|i| submit(registry, &owner(number), "fern", &format!("{number}/{i}")).unwrap())
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        threads.into_iter().flat_map(|t| t.join().unwrap()).collect()
    });
    let mut indices: Vec<_> = receipts.iter().map(|r| r.index).collect();
    indices.sort_unstable();
    // Each batch's map leaf has a place of its own.
    let of_records = (0..registry.size()).filter(|index| registry.record(*index).is_ok());
    assert_eq!(indices, of_records.collect::<Vec<_>>());
    assert_eq!(indices.len(), 512);
    receipts.iter().for_each(|receipt| verify_receipt(&registry, receipt));
    assert!(store.flushes() - flushes_before <= 512);
    assert!(registry.check().unwrap().is_empty());
}
