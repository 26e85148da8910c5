//! Owners of scenes, and what a crash leaves of them.

use super::*;

const LIMITS: Limits =
    Limits { bytes: 100, views: 10, training_seconds: 10, queued_jobs: 1, records: 0, records_per_day: 0 };

fn open(dir: &Path) -> (DataFolder, Access) {
    let folder = DataFolder::open(dir).unwrap();
    let access = Access::open(&folder, LIMITS).unwrap();
    (folder, access)
}

fn charge(bytes: u64) -> Charge {
    Charge { bytes, views: 2 }
}

#[test]
fn a_scene_has_its_owner_from_before_it_is_there_until_after_it_is_gone() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, access) = open(dir.path());
    let ada = Digest::of("ada");
    let town = folder.scenes().join("town");
    let owned = access.reserve(ada, "a", charge(60)).unwrap();
    assert!(access.reserve(ada, "b", charge(60)).is_err(), "two imports cannot both have the last of it");
    let place = access.place("town", town.clone()).unwrap();
    assert!(access.place("town", town.clone()).is_err(), "nobody else finishes an import under this name");
    access.announce(&place, Some(&owned)).unwrap();
    assert_eq!(access.owner_of("town").unwrap(), Some(ada));
    std::fs::create_dir(&town).unwrap();
    access.became(&place, Some(owned));
    drop(place);
    assert!(access.place("town", town.clone()).is_err(), "it is there");
    drop((folder, access));

    let (folder, access) = open(dir.path());
    assert_eq!((access.owner_of("town").unwrap(), access.usage(&ada).bytes), (Some(ada), 60));
    assert_eq!(access.owner_of("../town").unwrap(), None);
    std::fs::remove_dir(&town).unwrap();
    access.forget("town").unwrap();
    access.forget("town").unwrap();
    assert_eq!((access.owner_of("town").unwrap(), access.usage(&ada).bytes), (None, 0));
    drop((folder, access));
}

#[test]
fn whatever_a_crash_leaves_is_set_right_at_the_start() {
    let dir = tempfile::tempdir().unwrap();
    let ada = Digest::of("ada");
    {
        let (folder, access) = open(dir.path());
        // Dies with one import announced, and another one finished but not yet charged under its name.
        let owned = access.reserve(ada, "a", charge(40)).unwrap();
        let place = access.place("announced", folder.scenes().join("announced")).unwrap();
        access.announce(&place, Some(&owned)).unwrap();
        let other = access.reserve(ada, "b", charge(50)).unwrap();
        let town = access.place("town", folder.scenes().join("town")).unwrap();
        access.announce(&town, Some(&other)).unwrap();
        std::fs::create_dir(folder.scenes().join("town")).unwrap();
        std::mem::forget((owned, other));
    }
    let (_folder, access) = open(dir.path());
    assert_eq!(access.owner_of("announced").unwrap(), None);
    assert_eq!(access.owner_of("town").unwrap(), Some(ada));
    assert_eq!(access.usage(&ada).bytes, 50);
}

#[test]
fn accounts_may_have_quotas_of_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let key = cairn_log::OwnerKey::from_seed(&[1; 32]).public();
    add_account(dir.path(), key, "ada", Role::Curator).unwrap();
    let (_folder, access) = open(dir.path());
    assert_eq!(access.limits(&key.id()), LIMITS);
    assert!(add_account(dir.path(), key, "ada", Role::Curator).unwrap_err().to_string().contains("in use"));
    let own = Limits { bytes: 7, ..LIMITS };
    access.accounts().change(&key, crate::auth::Change::Quota(Some(own))).unwrap();
    assert_eq!(access.limits(&key.id()), own);
    access.check_training(&key.id(), 0).unwrap();
    assert!(access.check_training(&key.id(), 1).is_err());
    access.spend(&key.id(), 10.0).unwrap();
    assert_eq!(access.seconds_left(&key.id()), Some(0.0));
    let refused = access.check_training(&key.id(), 0).unwrap_err().to_string();
    assert!(refused.contains("`training_seconds` is 10: 10 used"), "{refused}");
}

/// A log in memory, with a record of key 1 about a scene.
mod log {
    use cairn_log::format::record::{self, Digests, Identity, Seen};
    use cairn_log::log::store::FaultyStore;
    use cairn_log::{OwnerKey, OwnerRecord};

    use super::*;

    pub fn key(number: u8) -> OwnerKey {
        OwnerKey::from_seed(&[number; 32])
    }

    pub fn open() -> Registry {
        let store = FaultyStore::new();
        Registry::open_store(Box::new(store.clone()), Box::new(store), key(200), "log.test").unwrap()
    }

    /// Enters a record, signed by its owner and by `also`; what was entered, its digest and its place.
    pub fn enter(
        registry: &Registry,
        kind: RecordKind,
        by: u8,
        replaces: Option<Digest>,
        also: Option<u8>,
    ) -> (OwnerRecord, Digest, u64) {
        let head = registry.head().unwrap();
        let record = OwnerRecord {
            version: record::VERSION,
            kind,
            origin: "log.test".into(),
            scene: "town".into(),
            scene_salt: Digest::of("salt"),
            identity: Identity::numbered(1, "ada"),
            owner_key: key(by).public(),
            digests: Digests { photographs: Some(Digest::of("photographs")), ..Digests::default() },
            seed: None,
            purpose: "credit".into(),
            nonce: registry.nonce("town", &key(by).public()).unwrap(),
            seen: Seen { size: head.size, root: head.root },
            replaces,
            views: None,
        };
        let mut envelope = record.seal(&key(by)).unwrap();
        also.into_iter().for_each(|other| envelope.sign(&key(other)));
        let receipt = registry.submit(cairn_log::SignedRecord::open(envelope).unwrap()).unwrap();
        (record, receipt.envelope.digest(), receipt.index)
    }
}

#[test]
fn accounts_follow_the_log_also_where_a_crash_came_between() {
    use log::{enter, key, open as open_log};
    let dir = tempfile::tempdir().unwrap();
    for number in [1, 5] {
        add_account(dir.path(), key(number).public(), "ada", Role::Contributor).unwrap();
    }
    let (_folder, access) = open(dir.path());
    let registry = open_log();
    let state = |number: u8| {
        let account = access.accounts().get(&key(number).public().id()).unwrap();
        (account.heir, account.ended_by)
    };
    let (_, first, _) = enter(&registry, RecordKind::Contribution, 1, None, None);
    access.follow_all(&registry).unwrap();
    assert_eq!(state(1), (None, None));
    // Followed as it came in, and along the chain.
    let (rotation, second, _) = enter(&registry, RecordKind::Rotation, 2, Some(first), Some(1));
    access.follow(&registry, &rotation).unwrap();
    assert_eq!((state(1), state(5)), ((Some(key(2).public()), None), (None, None)));
    assert_eq!(access.payer(&key(2).public().id()), key(1).public().id(), "its account pays");
    let (rotation, _, index) = enter(&registry, RecordKind::Rotation, 3, Some(second), Some(2));
    access.follow(&registry, &rotation).unwrap();
    assert_eq!(state(1), (Some(key(3).public()), None));
    // Its contents may go once it was followed.
    registry.erase_index(index).unwrap();
    access.follow_all(&registry).unwrap();
    assert_eq!(state(1), (Some(key(3).public()), None));
    // Died before it was followed: the start does it.
    let (_, third, _) = enter(&registry, RecordKind::Contribution, 3, None, None);
    let (_, _, index) = enter(&registry, RecordKind::Rotation, 4, Some(third), Some(3));
    access.follow_all(&registry).unwrap();
    assert_eq!(state(1), (Some(key(4).public()), None));
    // And where nobody can know the key any more, the old one is good no longer all the same.
    access.accounts().follow(&key(1).public().id(), Some(key(3).public()), None).unwrap();
    registry.erase_index(index).unwrap();
    access.follow_all(&registry).unwrap();
    assert_eq!(state(1), (Some(key(3).public()), Some(index)));
    let (end, _, index) = enter(&registry, RecordKind::Revocation, 5, None, None);
    access.follow(&registry, &end).unwrap();
    assert_eq!(state(5), (None, Some(index)));
}
