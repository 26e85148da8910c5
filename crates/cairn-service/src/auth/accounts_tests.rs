//! Accounts: who becomes what, whose key signs for them, and what their file may say.

use cairn_log::OwnerKey;

use super::*;

fn key(seed: u8) -> PublicKey {
    OwnerKey::from_seed(&[seed; 32]).public()
}

fn asking(seed: u8, name: &str, role: Role) -> Registration {
    Registration { nonce: Digest::of("n"), origin: "log".into(), key: key(seed), name: name.into(), role }
}

fn open(dir: &tempfile::TempDir) -> Accounts {
    Accounts::open(dir.path().join("access/accounts.json")).unwrap()
}

fn refused(result: Result<Account, AccessError>) -> AccountError {
    match result {
        Err(AccessError::Account(error)) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn policies_decide_and_nobody_makes_themselves_more_than_a_contributor() {
    let dir = tempfile::tempdir().unwrap();
    let accounts = open(&dir);
    let ada = accounts.register(&asking(1, "ada", Role::Operator), Policy::Open, 5).unwrap();
    assert_eq!((ada.role, ada.asked, ada.standing), (Role::Contributor, Role::Operator, Standing::Active));
    let bob = accounts.register(&asking(2, "bob", Role::Curator), Policy::Approval, 6).unwrap();
    assert_eq!((bob.role, bob.standing), (Role::Contributor, Standing::Waiting));
    assert_eq!(refused(accounts.register(&asking(3, "eve", Role::Curator), Policy::Closed, 7)), AccountError::Closed);
    // Again, under any name and policy: it stays what it was.
    assert_eq!(accounts.register(&asking(2, "robert", Role::Operator), Policy::Open, 9).unwrap(), bob);

    let bob = accounts.change(&bob.key, Change::Approve(None)).unwrap();
    assert_eq!((bob.role, bob.standing), (Role::Curator, Standing::Active));
    assert!(matches!(refused(accounts.change(&bob.key, Change::Approve(None))), AccountError::NotWaiting { .. }));
    assert!(matches!(refused(accounts.change(&key(3), Change::Approve(None))), AccountError::NoSuch { .. }));
    assert_eq!(open(&dir).list(), accounts.list(), "it is all in the file");
    assert_eq!(accounts.list(), [ada, bob]);
}

#[test]
fn the_last_operator_stays() {
    let dir = tempfile::tempdir().unwrap();
    let accounts = open(&dir);
    accounts.add(key(1), "root", Role::Operator, 1).unwrap();
    let last = AccountError::LastOperator { name: "root".into() };
    assert_eq!(refused(accounts.change(&key(1), Change::Disabled(true))), last);
    assert_eq!(refused(accounts.change(&key(1), Change::Role(Role::Auditor))), last);
    assert!(matches!(refused(accounts.add(key(1), "again", Role::Curator, 2)), AccountError::Exists { .. }));
    accounts.add(key(2), "second", Role::Operator, 2).unwrap();
    assert_eq!(accounts.change(&key(1), Change::Disabled(true)).unwrap().standing, Standing::Disabled);
    assert_eq!(
        refused(accounts.change(&key(2), Change::Role(Role::Curator))),
        AccountError::LastOperator { name: "second".into() }
    );
    assert_eq!(accounts.change(&key(1), Change::Disabled(false)).unwrap().standing, Standing::Active);
}

#[test]
fn an_account_continues_under_the_key_in_its_keys_place() {
    let dir = tempfile::tempdir().unwrap();
    let accounts = open(&dir);
    let ada = accounts.add(key(1), "ada", Role::Operator, 1).unwrap();
    accounts.add(key(9), "other", Role::Operator, 1).unwrap();
    accounts.follow(&ada.id(), Some(key(2)), None).unwrap();
    let now = accounts.of_signer(&key(2).id()).unwrap();
    assert_eq!((now.id(), now.signer(), now.role), (ada.id(), &key(2), Role::Operator));
    // Whoever names the new key means this account; registering it makes no second one.
    assert_eq!(accounts.change(&key(2), Change::Role(Role::Curator)).unwrap().id(), ada.id());
    assert_eq!(accounts.register(&asking(2, "again", Role::Auditor), Policy::Open, 3).unwrap().id(), ada.id());
    assert_eq!(open(&dir).of_signer(&key(2).id()), accounts.of_signer(&key(2).id()), "it is all in the file");
    // Ended for good: an operator who is left does not count it among those who can act.
    accounts.change(&key(2), Change::Role(Role::Operator)).unwrap();
    accounts.follow(&ada.id(), Some(key(2)), Some(7)).unwrap();
    assert!(matches!(refused(accounts.change(&key(9), Change::Disabled(true))), AccountError::LastOperator { .. }));
    accounts.follow(&Digest::of("nobody"), None, Some(1)).unwrap();
    // A key with an account of its own keeps it, whatever else continues under it.
    accounts.follow(&ada.id(), Some(key(9)), None).unwrap();
    assert_eq!(accounts.of_signer(&key(9).id()).unwrap().name, "other");
}

#[test]
fn names_are_bounded_and_so_is_the_waiting_room() {
    let dir = tempfile::tempdir().unwrap();
    let accounts = open(&dir);
    for name in ["", "a\nb", &"x".repeat(MAX_NAME + 1)] {
        assert!(matches!(refused(accounts.add(key(1), name, Role::Auditor, 1)), AccountError::Name { .. }));
    }
    // As many as fit, put there at once: a thousand registrations are a thousand flushed files.
    let many: Map = (0..MAX_WAITING)
        .map(|n| {
            let key = OwnerKey::from_seed(Digest::of(n.to_be_bytes()).as_bytes()).public();
            let (role, standing) = (Role::Contributor, Standing::Waiting);
            let (quota, heir, ended_by) = (None, None, None);
            (key.id(), Account { key, name: "n".into(), role, asked: role, standing, since: 0, quota, heir, ended_by })
        })
        .collect();
    *accounts.lock() = many;
    let full = accounts.register(&asking(1, "late", Role::Contributor), Policy::Approval, 1);
    assert_eq!(refused(full), AccountError::TooMany { what: "wait for approval", got: MAX_WAITING });
    assert!(accounts.register(&asking(1, "late", Role::Contributor), Policy::Open, 1).is_ok());
}

#[test]
fn another_version_and_damage_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("accounts.json");
    let small_order = format!("{}{}", "01", "00".repeat(31));
    let weak = format!(
        r#"{{"format_version": 1, "accounts": [{{"key": "{small_order}", "name": "x", "role": "curator",
        "asked": "curator", "standing": "active", "since": 1}}]}}"#
    );
    for (text, says) in [
        (r#"{"format_version": 2, "accounts": []}"#, "format version 2"),
        (r#"{"accounts": []}"#, "no format version"),
        ("{", "no JSON"),
        (weak.as_str(), "small order"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = Accounts::open(path.clone()).unwrap_err().to_string();
        assert!(error.contains(says) && error.contains("accounts.json"), "{error}");
    }
}
