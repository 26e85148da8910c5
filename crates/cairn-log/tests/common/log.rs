//! Records to submit to a log, and the verification of what it answers.

use cairn_log::{
    Checkpoint, Digest, Envelope, LogEntry, OwnerKey, OwnerRecord, Receipt, RecordKind, Registry, RegistryError,
    SignedRecord, StoredRecord,
    format::{
        merkle,
        record::{self, Digests, Identity, Seen},
    },
};

/// A training record of `owner` about `scene`, complete in every field, with a fresh nonce.
pub fn record(registry: &Registry, owner: &OwnerKey, scene: &str, what: &str) -> OwnerRecord {
    let head = registry.head().unwrap();
    let digest = |of: &str| Some(Digest::of(format!("{of} of {what}")));
    OwnerRecord {
        version: record::VERSION,
        kind: RecordKind::Training,
        origin: registry.origin().to_owned(),
        scene: scene.to_owned(),
        scene_salt: Digest::of(format!("salt of {what}")),
        identity: Identity::numbered(1, "Ada"),
        owner_key: owner.public(),
        digests: Digests {
            marked_field: digest("field"),
            detector: digest("detector"),
            hidden_signal: digest("signal"),
            photographs: digest("photographs"),
            base_field: digest("base field"),
            share_table: digest("share table"),
            training_configuration: digest("configuration"),
        },
        seed: Some(u64::MAX),
        purpose: "credit".into(),
        nonce: registry.nonce(scene, &owner.public()).unwrap(),
        seen: Seen { size: head.size, root: head.root },
        replaces: None,
        views: None,
    }
}

pub fn sealed(registry: &Registry, owner: &OwnerKey, scene: &str, what: &str) -> Envelope {
    record(registry, owner, scene, what).seal(owner).unwrap()
}

/// Submits what is sealed.
pub fn take(registry: &Registry, envelope: &Envelope) -> Result<Receipt, RegistryError> {
    registry.submit(SignedRecord::open(envelope.clone())?)
}

/// The records, of one scene or all, in the log's order; erased ones are left out.
pub fn records(registry: &Registry, scene: Option<&str>) -> Vec<StoredRecord> {
    let entries = registry.page(scene, 0, usize::MAX).unwrap().into_iter();
    entries.filter_map(|entry| if let LogEntry::Record(stored) = entry { Some(*stored) } else { None }).collect()
}

pub fn submit(registry: &Registry, owner: &OwnerKey, scene: &str, what: &str) -> Result<Receipt, RegistryError> {
    take(registry, &sealed(registry, owner, scene, what))
}

/// Verifies a receipt the way a stranger would: from the registry's vkey alone.
pub fn verify_receipt(registry: &Registry, receipt: &Receipt) {
    let checkpoint = Checkpoint::verify(&receipt.checkpoint, &registry.verifier().unwrap()).unwrap();
    assert_eq!(checkpoint.size, receipt.size);
    assert!(receipt.durable);
    merkle::verify_inclusion(&receipt.leaf_hash, receipt.index, checkpoint.size, &receipt.inclusion, &checkpoint.root)
        .unwrap();
    assert!(receipt.envelope.signature_by(&registry.public_key()).is_some());
    assert_eq!(cairn_log::Leaf::of(&receipt.envelope).unwrap().hash(), receipt.leaf_hash);
}

/// Everything that must hold in a log found again, given what had been signed and acknowledged before.
pub fn must_honour(registry: &Registry, signed: &[String], acknowledged: &[Envelope]) {
    let log = registry.verifier().unwrap();
    let head = Checkpoint::verify(&registry.checkpoint(), &log).unwrap();
    for note in signed {
        let old = Checkpoint::verify(note, &log).unwrap();
        let proof = registry.prove_consistency(old.size, head.size).unwrap();
        merkle::verify_consistency(old.size, head.size, &proof, &old.root, &head.root).unwrap();
    }
    for envelope in acknowledged {
        assert!(registry.find(&envelope.digest()).unwrap().is_some());
    }
    let faults = registry.check().unwrap();
    assert!(faults.is_empty(), "{faults:?}");
}
