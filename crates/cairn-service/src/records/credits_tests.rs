//! Which records stand beside a contributor's share.

use cairn_log::format::record::{self, Digests, Identity, Seen, photographs_root, random_salt};
use cairn_log::{OwnerRecord, RecordKind, SignedRecord};

use super::*;
use crate::records::testing::{ORIGIN, key, registry};

fn photograph(name: &str) -> Digest {
    Digest::of(name)
}

/// A record of this kind by `by`, in a contributor's name, which lists these photographs.
fn entered(registry: &Registry, kind: RecordKind, by: u8, identity: Identity, views: &[&str]) -> (u64, Digest) {
    let mut listed: Vec<Digest> = views.iter().map(|name| photograph(name)).collect();
    listed.sort_unstable();
    let head = registry.head().unwrap();
    let record = OwnerRecord {
        version: record::VERSION,
        kind,
        origin: ORIGIN.into(),
        scene: "town".into(),
        scene_salt: random_salt().unwrap(),
        identity,
        owner_key: key(by).public(),
        digests: Digests { photographs: Some(photographs_root(&listed)), ..Digests::default() },
        seed: None,
        purpose: "credit".into(),
        nonce: registry.nonce("town", &key(by).public()).unwrap(),
        seen: Seen { size: head.size, root: head.root },
        replaces: None,
        views: (!listed.is_empty()).then_some(listed),
    };
    enter(registry, record, by)
}

fn enter(registry: &Registry, record: OwnerRecord, by: u8) -> (u64, Digest) {
    let receipt = registry.submit(SignedRecord::open(record.seal(&key(by)).unwrap()).unwrap()).unwrap();
    (receipt.index, receipt.envelope.digest())
}

fn found(registry: &Registry, contributor: &str, photographs: &[&str]) -> Vec<(u64, bool)> {
    let photographs: Vec<Digest> = photographs.iter().map(|name| photograph(name)).collect();
    let credits = LookUp::new(registry, "town").of(contributor, &photographs).unwrap();
    assert!(!credits.may_be_more);
    credits.records.iter().map(|record| (record.index, record.confirmed)).collect()
}

#[test]
fn records_of_the_name_and_of_the_photographs_are_found_and_confirmed_by_the_name() {
    use RecordKind::{Binding, Claim, Contribution};
    let registry = registry();
    let named = Identity::named;
    let (by_name, _) = entered(&registry, Claim, 1, named("ada"), &[]);
    // Of a cluster that another name stands for, with a photograph of hers in it: what a curator says of her name is not
    // said of that one, though the key is hers.
    let (cluster, _) = entered(&registry, Contribution, 1, Identity::numbered(3, "anchor-7"), &["a", "z"]);
    // A stranger's, in a name of their own, which a curator confirmed: it is theirs and not hers.
    let (strange, _) = entered(&registry, Claim, 9, named("eve"), &["a", "b"]);
    entered(&registry, Claim, 9, named("eve"), &["z"]);
    let wanted = [(by_name, false), (cluster, false), (strange, false)];
    assert_eq!(found(&registry, "ada", &["a", "b"]), wanted);
    let bind = |name: &str, to: u8| {
        let identity = Identity { key: Some(key(to).public()), ..named(name) };
        entered(&registry, Binding, 50, identity, &[]);
    };
    bind("ada", 1);
    bind("eve", 9);
    assert_eq!(found(&registry, "ada", &["a", "b"]), [(by_name, true), (cluster, false), (strange, false)]);
    assert_eq!(found(&registry, "ada", &["b"]), [(by_name, true), (strange, false)]);
    assert_eq!(found(&registry, "bea", &["c"]), []);
    assert_eq!(found(&registry, "eve", &[]).len(), 2);
}

#[test]
fn what_was_taken_back_credits_nobody() {
    let registry = registry();
    let (_, digest) = entered(&registry, RecordKind::Claim, 1, Identity::named("ada"), &["a"]);
    let (second, _) = entered(&registry, RecordKind::Claim, 1, Identity::named("ada"), &["a"]);
    let mut revocation = registry.record(second).unwrap().record;
    (revocation.kind, revocation.replaces) = (RecordKind::Revocation, Some(digest));
    (revocation.nonce, revocation.views) = (registry.nonce("town", &key(1).public()).unwrap(), None);
    enter(&registry, revocation, 1);
    assert_eq!(found(&registry, "ada", &["a"]), [(second, false)]);
    registry.erase_index(second).unwrap();
    assert_eq!(found(&registry, "ada", &["a"]), []);
}

#[test]
fn a_flood_of_claims_is_looked_at_in_part_and_that_is_said() {
    let registry = registry();
    for _ in 0..=MAX_LISTED {
        entered(&registry, RecordKind::Claim, 9, Identity::named("ada"), &[]);
    }
    let credits = LookUp::new(&registry, "town").of("ada", &[]).unwrap();
    assert!(credits.may_be_more && credits.records.len() == MAX_LISTED);
    // Once a curator bound the name, her own claim is found behind all the others, and also after other answers' floods.
    let (own, _) = entered(&registry, RecordKind::Claim, 1, Identity::named("ada"), &[]);
    assert!(credits.records.iter().all(|record| record.index != own));
    let bound = Identity { key: Some(key(1).public()), ..Identity::named("ada") };
    entered(&registry, RecordKind::Binding, 50, bound, &[]);
    let mut look_up = LookUp::new(&registry, "town");
    look_up.other_records_left = 0;
    let credits = look_up.of("ada", &[]).unwrap();
    assert_eq!(credits.records, [Crediting { index: own, confirmed: true }]);
    assert!(credits.may_be_more);
    assert_eq!(LookUp::new(&registry, "town").of("ada", &[]).unwrap().records.len(), MAX_LISTED);
    let many: Vec<Digest> = (0..=MAX_PHOTOGRAPHS as u64).map(|i| Digest::of(i.to_be_bytes())).collect();
    let mut look_up = LookUp::new(&registry, "town");
    assert!(!look_up.of("bea", &many[1..]).unwrap().may_be_more);
    assert!(look_up.of("cleo", &many[..1]).unwrap().may_be_more, "what an answer may look at is used up");
}
