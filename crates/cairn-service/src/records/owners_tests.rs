//! Which records bear on an identity: of its marked field, its photographs, and still upheld.

use cairn_log::format::record::{self, Digests, Identity, Seen, random_salt};

use super::*;
use crate::records::testing::{ORIGIN, key, registry};

/// Identity 1 of the newest model.
fn identity() -> IdentityInfo {
    let photographs = ["one", "two"].map(Digest::of).to_vec();
    IdentityInfo { number: 1, label: "ada".into(), views: vec![], photographs, contributors: vec![] }
}

fn field() -> Option<Digest> {
    Some(Digest::of("the newest marked field"))
}

/// A record of this kind about identity 1, every digest that of the newest model.
fn about(registry: &Registry, kind: RecordKind, by: u8) -> OwnerRecord {
    let head = registry.head().unwrap();
    let any = Some(Digest::of("anything"));
    OwnerRecord {
        version: record::VERSION,
        kind,
        origin: ORIGIN.into(),
        scene: "town".into(),
        scene_salt: random_salt().unwrap(),
        identity: Identity::numbered(1, "ada"),
        owner_key: key(by).public(),
        digests: Digests {
            marked_field: field(),
            detector: any,
            hidden_signal: any,
            photographs: Some(identity().photographs_root()),
            base_field: any,
            share_table: any,
            training_configuration: any,
        },
        seed: Some(1),
        purpose: "credit".into(),
        nonce: registry.nonce("town", &key(by).public()).unwrap(),
        seen: Seen { size: head.size, root: head.root },
        replaces: None,
        views: None,
    }
}

/// Enters it, signed by its owner and by `also`.
fn enter(registry: &Registry, record: &OwnerRecord, by: u8, also: Option<u8>) -> (u64, Digest) {
    let mut envelope = record.seal(&key(by)).unwrap();
    if let Some(also) = also {
        envelope.sign(&key(also));
    }
    let receipt = registry.submit(cairn_log::SignedRecord::open(envelope).unwrap()).unwrap();
    (receipt.index, receipt.envelope.digest())
}

fn found(registry: &Registry) -> Vec<u64> {
    bearing_on(registry, "town", field(), &identity()).unwrap()
}

#[test]
fn only_records_of_this_field_and_these_photographs_are_found() {
    let registry = registry();
    let mut wanted = Vec::new();
    // Who ran the training is not credited for it.
    enter(&registry, &about(&registry, RecordKind::Training, 1), 1, None);
    for kind in [RecordKind::Claim, RecordKind::Contribution] {
        wanted.push(enter(&registry, &about(&registry, kind, 1), 1, None).0);
        let mut strange = about(&registry, kind, 2);
        strange.digests.photographs = Some(Digest::of("other photographs"));
        enter(&registry, &strange, 2, None);
    }
    let mut older = about(&registry, RecordKind::Claim, 2);
    older.digests.marked_field = Some(Digest::of("the field before"));
    enter(&registry, &older, 2, None);
    let mut other = about(&registry, RecordKind::Claim, 2);
    other.identity.number = Some(2);
    enter(&registry, &other, 2, None);
    // The same photographs under the number that they had before: the contribution is as good as it was.
    let mut renumbered = about(&registry, RecordKind::Contribution, 3);
    (renumbered.identity.number, renumbered.digests.marked_field) = (Some(2), Some(Digest::of("the field before")));
    wanted.push(enter(&registry, &renumbered, 3, None).0);
    assert_eq!(found(&registry), wanted);
    // Where only the base field was trained, no claim can be about it.
    let base = bearing_on(&registry, "town", None, &identity()).unwrap();
    assert_eq!(base, wanted[1..]);
}

#[test]
fn what_was_taken_back_or_replaced_is_not_found() {
    let registry = registry();
    let enter_kind = |kind, by, replaces, also| {
        let record = OwnerRecord { replaces, ..about(&registry, kind, by) };
        enter(&registry, &record, by, also)
    };
    let (kept, first) = enter_kind(RecordKind::Claim, 1, None, None);
    let (_, second) = enter_kind(RecordKind::Claim, 1, None, None);
    // A dispute takes nothing away and adds nothing.
    enter_kind(RecordKind::Dispute, 9, Some(first), None);
    let (third, replaced) = enter_kind(RecordKind::Claim, 1, Some(second), None);
    assert_eq!(found(&registry), [kept, third]);
    // A rotation leaves all that the old key signed, and claims nothing itself; the new key takes a claim back.
    enter_kind(RecordKind::Rotation, 2, Some(replaced), Some(1));
    assert_eq!(found(&registry), [kept, third]);
    enter_kind(RecordKind::Revocation, 2, Some(replaced), None);
    assert_eq!(found(&registry), [kept]);
}

#[test]
fn a_record_is_taken_back_from_another_scene_too() {
    let registry = registry();
    let (kept, _) = enter(&registry, &about(&registry, RecordKind::Claim, 1), 1, None);
    let (_, taken_back) = enter(&registry, &about(&registry, RecordKind::Claim, 1), 1, None);
    let mut revocation = about(&registry, RecordKind::Revocation, 1);
    (revocation.scene, revocation.replaces) = ("harbour".into(), Some(taken_back));
    revocation.nonce = registry.nonce("harbour", &key(1).public()).unwrap();
    enter(&registry, &revocation, 1, None);
    assert_eq!(found(&registry), [kept]);
}
