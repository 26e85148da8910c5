//! A key that a rotation put in another's place speaks for all of that one's records; a revoked key has no heir.
#![cfg(feature = "store")]

use crate::common::{ORIGIN, owner, record, registry_key, sealed, submit, take};
use cairn_log::{
    Digest, Envelope, Heir, Receipt, RecordError, RecordKind, Registry, RegistryError, log::store::FaultyStore,
};

fn opened(store: &FaultyStore) -> Registry {
    Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN).unwrap()
}

/// A record of kind `kind` by owner `by` about an earlier one, with signatures of `also`.
fn about(registry: &Registry, kind: RecordKind, by: u8, earlier: Digest, also: &[u8]) -> Envelope {
    let mut record = record(registry, &owner(by), "fern", &format!("{kind:?} by {by} of {earlier}"));
    (record.kind, record.replaces) = (kind, Some(earlier));
    let mut envelope = record.seal(&owner(by)).unwrap();
    also.iter().for_each(|other| envelope.sign(&owner(*other)));
    envelope
}

fn rotate(registry: &Registry, from: u8, to: u8, earlier: Digest) -> Receipt {
    take(registry, &about(registry, RecordKind::Rotation, to, earlier, &[from])).unwrap()
}

fn entered(registry: &Registry, by: u8, what: &str) -> Digest {
    submit(registry, &owner(by), "fern", what).unwrap().envelope.digest()
}

#[test]
fn the_new_key_replaces_and_takes_back_what_the_old_ones_signed() {
    let store = FaultyStore::new();
    let registry = opened(&store);
    let [first, second, third, fourth] = ["1", "2", "3", "4"].map(|what| entered(&registry, 1, what));
    let second_key = rotate(&registry, 1, 2, first);
    // Key 2 goes on for a record that the rotation does not name; nobody but the two signs.
    let replaced = take(&registry, &about(&registry, RecordKind::Training, 2, second, &[])).unwrap();
    assert_eq!(replaced.envelope.signatures.len(), 2, "the new owner and the registry");
    // Along a chain of rotations, also after a restart.
    rotate(&registry, 2, 3, second_key.envelope.digest());
    drop(registry);
    let registry = opened(&store);
    let of_first = registry.heir(&owner(1).public().id()).unwrap();
    assert!(of_first.is(&owner(3).public().id()), "{of_first:?}");
    take(&registry, &about(&registry, RecordKind::Training, 3, third, &[])).unwrap();
    // Whoever else takes a record's place needs the heir's word, and the ended key's is worth nothing.
    for by_ended in [&[][..], &[1]] {
        let refused = take(&registry, &about(&registry, RecordKind::Training, 9, fourth, by_ended)).unwrap_err();
        let heir = owner(3).public();
        assert!(matches!(&refused, RegistryError::ReplacesForeign { owner, .. } if *owner == heir), "{refused}");
    }
    let agreed = take(&registry, &about(&registry, RecordKind::Training, 9, fourth, &[3, 1])).unwrap();
    assert_eq!(agreed.envelope.signatures.len(), 3, "the new owner, the heir and the registry");
    // It takes back, too, which ends it.
    take(&registry, &about(&registry, RecordKind::Revocation, 3, fourth, &[])).unwrap();
    let nobody = registry.heir(&owner(1).public().id()).unwrap();
    assert!(matches!(nobody, Heir::Nobody { id, .. } if id == owner(3).public().id()), "{nobody:?}");
    assert!(registry.check().unwrap().is_empty());
}

#[test]
fn a_revoked_key_has_no_heir_and_a_thief_makes_none() {
    let store = FaultyStore::new();
    let registry = opened(&store);
    let [first, second] = ["1", "2"].map(|what| entered(&registry, 1, what));
    let mut end = record(&registry, &owner(1), "fern", "end");
    end.kind = RecordKind::Revocation;
    let end = take(&registry, &end.seal(&owner(1)).unwrap()).unwrap().index;
    // The thief rotates to a key of their own, behind the revocation.
    let refused = take(&registry, &about(&registry, RecordKind::Rotation, 7, first, &[1])).unwrap_err();
    assert!(matches!(refused, RegistryError::OwnerRevoked { index, .. } if index == end), "{refused}");
    for (by, also) in [(7, &[][..]), (7, &[1]), (2, &[])] {
        let refused = take(&registry, &about(&registry, RecordKind::Training, by, second, also)).unwrap_err();
        assert!(matches!(refused, RegistryError::ReplacesRevoked { index, .. } if index == end), "{refused}");
    }
    assert_eq!(
        registry.heir(&owner(1).public().id()).unwrap(),
        Heir::Nobody { id: owner(1).public().id(), ended_by: end }
    );
}

#[test]
fn a_rotation_that_was_refused_makes_no_heir() {
    let store = FaultyStore::new();
    let registry = opened(&store);
    let [first, second] = ["1", "2"].map(|what| entered(&registry, 1, what));
    // Without the old key's signature; to itself; and to a key that is revoked.
    assert!(take(&registry, &about(&registry, RecordKind::Rotation, 2, first, &[])).is_err());
    let refused = take(&registry, &about(&registry, RecordKind::Rotation, 1, first, &[])).unwrap_err();
    assert!(matches!(refused, RegistryError::Record(RecordError::Field { field: "owner_key", .. })), "{refused}");
    let mut end = record(&registry, &owner(2), "fern", "end");
    end.kind = RecordKind::Revocation;
    take(&registry, &end.seal(&owner(2)).unwrap()).unwrap();
    assert!(take(&registry, &about(&registry, RecordKind::Rotation, 2, first, &[1])).is_err());
    let itself = registry.heir(&owner(1).public().id()).unwrap();
    assert_eq!(itself, Heir::Key { id: owner(1).public().id(), since: None });
    assert!(take(&registry, &about(&registry, RecordKind::Training, 2, second, &[])).is_err());
    // An heir rotates its own records; of those before it the old key, which has ended, would have to agree.
    rotate(&registry, 1, 3, first);
    let refused = take(&registry, &about(&registry, RecordKind::Rotation, 4, second, &[1, 3])).unwrap_err();
    assert!(matches!(refused, RegistryError::OwnerRotated { .. }), "{refused}");
    assert!(take(&registry, &sealed(&registry, &owner(3), "fern", "goes on")).is_ok());
}
