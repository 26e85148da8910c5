//! When a curator's word confirms a record.

use cairn_log::format::record::{self, Digests, Identity, Seen, random_salt};
use cairn_log::{OwnerRecord, RecordKind, SignedRecord};

use super::*;
use crate::records::testing::{ORIGIN, key, registry};

/// Enters a record in ada's name, signed by its owner and by `also`; its index and digest.
fn enter(
    registry: &Registry,
    kind: RecordKind,
    by: u8,
    change: impl Fn(&mut OwnerRecord),
    also: Option<u8>,
) -> (u64, Digest) {
    let head = registry.head().unwrap();
    let mut record = OwnerRecord {
        version: record::VERSION,
        kind,
        origin: ORIGIN.into(),
        scene: "town".into(),
        scene_salt: random_salt().unwrap(),
        identity: Identity::named("ada"),
        owner_key: key(by).public(),
        digests: Digests { photographs: Some(Digest::of("photographs")), ..Digests::default() },
        seed: None,
        purpose: "credit".into(),
        nonce: registry.nonce("town", &key(by).public()).unwrap(),
        seen: Seen { size: head.size, root: head.root },
        replaces: None,
        views: None,
    };
    change(&mut record);
    let mut envelope = record.seal(&key(by)).unwrap();
    also.iter().for_each(|also| envelope.sign(&key(*also)));
    let receipt = registry.submit(SignedRecord::open(envelope).unwrap()).unwrap();
    (receipt.index, receipt.envelope.digest())
}

fn bind(registry: &Registry, curator: u8, to: u8) -> (u64, Digest) {
    enter(registry, RecordKind::Binding, curator, |record| record.identity.key = Some(key(to).public()), None)
}

fn confirmed(registry: &Registry, index: u64) -> Option<u64> {
    confirmed_by(registry, &registry.record(index).unwrap()).unwrap()
}

#[test]
fn a_record_is_confirmed_by_the_newest_binding_of_its_name_to_its_owners_key() {
    let registry = registry();
    let claim = |by| enter(&registry, RecordKind::Claim, by, |_| (), None);
    let ((squatter, _), (ada, digest)) = (claim(9), claim(1));
    assert_eq!([squatter, ada].map(|index| confirmed(&registry, index)), [None, None]);
    let (first, _) = bind(&registry, 50, 1);
    assert_eq!([squatter, ada].map(|index| confirmed(&registry, index)), [None, Some(first)]);
    // A dispute of hers takes nothing away, and gives no credit itself.
    let (dispute, _) = enter(&registry, RecordKind::Dispute, 9, |record| record.replaces = Some(digest), None);
    assert_eq!([ada, dispute].map(|index| confirmed(&registry, index)), [Some(first), None]);
    // Another key takes the place of hers; what both sign is hers.
    enter(&registry, RecordKind::Rotation, 2, |record| record.replaces = Some(digest), Some(1));
    let (again, _) = claim(2);
    assert_eq!([ada, again].map(|index| confirmed(&registry, index)), [Some(first), Some(first)]);
    // Another curator knows better, and takes it back.
    let (second, second_digest) = bind(&registry, 51, 9);
    assert_eq!([squatter, ada].map(|index| confirmed(&registry, index)), [Some(second), None]);
    enter(&registry, RecordKind::Revocation, 51, |record| record.replaces = Some(second_digest), None);
    assert_eq!([squatter, ada].map(|index| confirmed(&registry, index)), [None, Some(first)]);
    // Another scene's name, and another name, are others.
    let elsewhere = |record: &mut OwnerRecord| {
        record.scene = "fern".into();
        record.nonce = registry.nonce("fern", &key(2).public()).unwrap();
    };
    let (fern, _) = enter(&registry, RecordKind::Claim, 2, elsewhere, None);
    let (bea, _) = enter(&registry, RecordKind::Claim, 2, |record| record.identity = Identity::named("bea"), None);
    assert_eq!([fern, bea].map(|index| confirmed(&registry, index)), [None, None]);
    // What was erased says nothing any more.
    registry.erase_index(first).unwrap();
    assert_eq!(newest(&registry, "town", "ada").unwrap(), Some(Bound { index: first, key: None }));
    assert_eq!(confirmed(&registry, ada), None);
}
