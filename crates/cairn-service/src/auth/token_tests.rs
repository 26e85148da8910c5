//! Tokens: good for one call, once, and for nothing else.

use super::*;
use crate::auth::roles::Role;

const NOW: u64 = 1_700_000_000;
const METHOD: &str = "/cairn.v1.SceneService/Delete";

struct Fixture {
    _dir: tempfile::TempDir,
    accounts: Accounts,
    key: OwnerKey,
    verifier: Verifier,
}

impl Fixture {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let accounts = Accounts::open(dir.path().join("accounts.json")).unwrap();
        let key = OwnerKey::from_seed(&[1; 32]);
        accounts.add(key.public(), "ada", Role::Contributor, 1).unwrap();
        let registry = OwnerKey::from_seed(&[9; 32]).public();
        let verifier = Verifier::new(Daemon::starting("log", &registry).unwrap(), 300);
        Self { _dir: dir, accounts, key, verifier }
    }

    fn sign(&self) -> String {
        sign(&self.key, &self.verifier.daemon, METHOD, "town", NOW, 60).unwrap()
    }

    fn verify_at(&self, token: &str, now: u64) -> Result<(Account, Claims), AccessError> {
        self.verifier.verify(token, Call { method: METHOD, need: Need::Change, now, ended_too: false }, &self.accounts)
    }

    fn refused(&self, token: &str, now: u64) -> TokenError {
        match self.verify_at(token, now) {
            Err(AccessError::Token(error)) => error,
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_token_is_good_once() {
    let f = Fixture::new();
    let token = f.sign();
    let (account, claims) = f.verify_at(&token, NOW).unwrap();
    assert_eq!((account.name.as_str(), claims.scene.as_str()), ("ada", "town"));
    claims.about("town").unwrap();
    assert!(matches!(claims.about("well"), Err(TokenError::WrongScene { .. })));
    assert!(matches!(claims.about(""), Err(TokenError::WrongScene { .. })));
    // Until it is too old to be accepted anyway it is known for used.
    for now in [NOW, NOW + 60, NOW + 60 + SKEW_S] {
        assert_eq!(f.refused(&token, now), TokenError::Replayed, "{now}");
    }
    assert!(matches!(f.refused(&token, NOW + 61 + SKEW_S), TokenError::Expired { .. }));
    assert!(f.verify_at(&f.sign(), NOW).is_ok(), "the next one is another");
}

#[test]
fn every_flipped_bit_is_found() {
    let f = Fixture::new();
    let token = f.sign();
    let bytes = URL_SAFE_NO_PAD.decode(&token).unwrap();
    for bit in 0..bytes.len() * 8 {
        let mut changed = bytes.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let refused = f.verify_at(&URL_SAFE_NO_PAD.encode(&changed), NOW);
        assert!(refused.is_err(), "bit {bit} of {} may be flipped", bytes.len() * 8);
    }
    // Its text has no second spelling, either.
    for at in 0..token.len() {
        for other in ["A", "B", "=", "+", " ", "\u{e9}"] {
            let mut changed = token.clone();
            changed.replace_range(at..=at, other);
            assert!(changed == token || f.verify_at(&changed, NOW).is_err(), "character {at} may be {other:?}");
        }
    }
    // None of these was the first use.
    assert!(f.verify_at(&token, NOW).is_ok());
}

#[test]
fn every_shorter_and_longer_token_is_refused() {
    let f = Fixture::new();
    let bytes = URL_SAFE_NO_PAD.decode(f.sign()).unwrap();
    for length in 0..bytes.len() {
        assert!(f.verify_at(&URL_SAFE_NO_PAD.encode(&bytes[..length]), NOW).is_err(), "{length} bytes");
    }
    let mut longer = bytes[..bytes.len() - SIGNATURE].to_vec();
    longer.push(0);
    let signature = f.key.sign(&[DOMAIN, &longer].concat());
    longer.extend_from_slice(&signature);
    let refused = f.refused(&URL_SAFE_NO_PAD.encode(&longer), NOW);
    assert_eq!(refused, TokenError::Malformed { field: "bytes too many" });
    assert_eq!(f.refused(&"A".repeat(MAX_TEXT + 1), NOW), TokenError::Malformed { field: "it is too long" });
    assert_eq!(f.refused("", NOW), TokenError::Malformed { field: "the signature" });
}

#[test]
fn another_method_daemon_or_run_is_refused() {
    let f = Fixture::new();
    let here = f.verifier.daemon.clone();
    let signed = |daemon: &Daemon, method: &str| sign(&f.key, daemon, method, "town", NOW, 60).unwrap();
    let import = signed(&here, "/cairn.v1.SceneService/Import");
    assert!(matches!(f.refused(&import, NOW), TokenError::WrongMethod { .. }));
    let other_run = Daemon { run: [0; 16], ..here.clone() };
    let refused = f.refused(&signed(&other_run, METHOD), NOW).to_string();
    assert!(refused.contains("an earlier run of this daemon"), "{refused}");
    for daemon in
        [Daemon { origin: "log2".into(), ..here.clone() }, Daemon { registry: Digest::of("another"), ..here.clone() }]
    {
        assert!(matches!(f.refused(&signed(&daemon, METHOD), NOW), TokenError::WrongDaemon { .. }));
    }
}

#[test]
fn the_window_is_exact_and_clocks_may_be_thirty_seconds_apart() {
    let f = Fixture::new();
    assert!(f.verify_at(&f.sign(), NOW - SKEW_S).is_ok());
    assert_eq!(f.refused(&f.sign(), NOW - SKEW_S - 1), TokenError::NotYet { issued: NOW, now: NOW - SKEW_S - 1 });
    assert!(f.verify_at(&f.sign(), NOW + 60 + SKEW_S).is_ok());
    let late = NOW + 61 + SKEW_S;
    assert_eq!(f.refused(&f.sign(), late), TokenError::Expired { expires: NOW + 60, now: late });
    let living = |s| sign(&f.key, &f.verifier.daemon, METHOD, "town", NOW, s).unwrap();
    assert!(f.verify_at(&living(300), NOW).is_ok());
    assert!(matches!(f.refused(&living(301), NOW), TokenError::Lifetime { longest_s: 300, .. }));
    assert!(matches!(f.refused(&living(u64::MAX), NOW), TokenError::Lifetime { .. }));
    let shorter = Verifier::new(f.verifier.daemon.clone(), 59);
    let call = Call { method: METHOD, need: Need::Change, now: NOW, ended_too: false };
    let refused = shorter.verify(&f.sign(), call, &f.accounts);
    assert!(matches!(refused, Err(AccessError::Token(TokenError::Lifetime { longest_s: 59, .. }))));
    assert_eq!(Verifier::new(f.verifier.daemon.clone(), 9_999).longest_s, MAX_LIFETIME_S);
}

#[test]
fn strangers_and_those_who_may_not_are_told_apart() {
    let f = Fixture::new();
    let stranger = OwnerKey::from_seed(&[2; 32]);
    let token = sign(&stranger, &f.verifier.daemon, METHOD, "town", NOW, 60).unwrap();
    assert!(matches!(f.verify_at(&token, NOW), Err(AccessError::Account(AccountError::Unknown { .. }))));
    // Ada's id over a stranger's signature.
    let mut bytes = URL_SAFE_NO_PAD.decode(&token).unwrap();
    bytes[1..33].copy_from_slice(f.key.public().id().as_bytes());
    assert!(matches!(f.refused(&URL_SAFE_NO_PAD.encode(&bytes), NOW), TokenError::BadSignature { .. }));
    // The same bytes signed for another purpose are no token.
    let body = bytes.len() - SIGNATURE;
    let elsewhere = f.key.sign(&bytes[..body]);
    bytes[body..].copy_from_slice(&elsewhere);
    assert!(matches!(f.refused(&URL_SAFE_NO_PAD.encode(&bytes), NOW), TokenError::BadSignature { .. }));

    let operate = Call { method: METHOD, need: Need::Operate, now: NOW, ended_too: false };
    let token = f.sign();
    let denied = f.verifier.verify(&token, operate, &f.accounts).unwrap_err();
    assert!(denied.to_string().contains("needs the role operator; \"ada\" is contributor"), "{denied}");
    assert!(f.verify_at(&token, NOW).is_ok(), "what was refused was not used up");

    f.accounts.change(&f.key.public(), crate::auth::Change::Disabled(true)).unwrap();
    assert!(matches!(f.verify_at(&f.sign(), NOW), Err(AccessError::Account(AccountError::Disabled { .. }))));
}

#[test]
fn a_full_memory_refuses_and_forgets_nothing_early() {
    let mut f = Fixture::new();
    f.verifier = Verifier::with_memory(f.verifier.daemon.clone(), 300, 2, 2);
    let first = f.sign();
    f.verify_at(&first, NOW).unwrap();
    f.verify_at(&f.sign(), NOW).unwrap();
    let full = f.refused(&f.sign(), NOW);
    assert_eq!(full, TokenError::MemoryFull { whose: "this account", limit: 2, frees: NOW + 60 + SKEW_S + 1 });
    assert_eq!(f.refused(&first, NOW), TokenError::Replayed);
    assert!(matches!(f.verify_at(&first, NOW + 100), Err(AccessError::Token(TokenError::Expired { .. }))));
    let later = sign(&f.key, &f.verifier.daemon, METHOD, "town", NOW + 91, 60).unwrap();
    assert!(f.verify_at(&later, NOW + 91).is_ok());
}

#[test]
fn what_is_too_long_is_not_signed() {
    let f = Fixture::new();
    let long = sign(&f.key, &f.verifier.daemon, METHOD, &"x".repeat(65), NOW, 60);
    assert_eq!(long, Err(TokenError::TooLong { field: "the scene's name" }));
    let daemon = Daemon { origin: "o".repeat(256), ..f.verifier.daemon.clone() };
    let longest = sign(&f.key, &daemon, &"m".repeat(128), &"x".repeat(64), NOW, 60).unwrap();
    assert!(longest.len() <= MAX_TEXT, "{} characters", longest.len());
}

#[test]
fn an_unknown_version_is_refused_by_number() {
    let f = Fixture::new();
    let mut bytes = URL_SAFE_NO_PAD.decode(f.sign()).unwrap();
    bytes[0] = 2;
    assert_eq!(f.refused(&URL_SAFE_NO_PAD.encode(&bytes), NOW), TokenError::Version { got: 2 });
}

#[test]
fn only_the_key_that_the_log_has_in_its_place_signs_for_an_account() {
    let f = Fixture::new();
    let (next, last) = (OwnerKey::from_seed(&[2; 32]), OwnerKey::from_seed(&[3; 32]));
    let by = |key: &OwnerKey| sign(key, &f.verifier.daemon, METHOD, "town", NOW, 60).unwrap();
    let account = |refused: Result<(Account, Claims), AccessError>| match refused {
        Err(AccessError::Account(error)) => error,
        other => panic!("{other:?}"),
    };
    let id = f.key.public().id();
    assert!(matches!(account(f.verify_at(&by(&next), NOW)), AccountError::Unknown { .. }));
    for heir in [&next, &last] {
        f.accounts.follow(&id, Some(heir.public()), None).unwrap();
        let (found, _) = f.verify_at(&by(heir), NOW).unwrap();
        assert_eq!((found.id(), found.name.as_str()), (id, "ada"));
        let said = account(f.verify_at(&by(&f.key), NOW));
        assert_eq!(said, AccountError::Rotated { name: "ada".into(), heir: heir.public() });
    }
    assert!(matches!(account(f.verify_at(&by(&next), NOW)), AccountError::Unknown { .. }), "it was rotated again");
    // Whoever has not the old key learns nothing of what became of it.
    let mut forged = by(&f.key);
    let at = forged.len() - 3;
    let other = if forged[at..].starts_with('A') { "B" } else { "A" };
    forged.replace_range(at..=at, other);
    assert!(matches!(f.verify_at(&forged, NOW), Err(AccessError::Token(_))));
    f.accounts.follow(&id, Some(last.public()), Some(7)).unwrap();
    for key in [&f.key, &last] {
        assert!(matches!(account(f.verify_at(&by(key), NOW)), AccountError::Ended { index: 7, .. }));
    }
    // A call that such an account may make, too: by the last key that signed for it, and no earlier one.
    let call = Call { method: METHOD, need: Need::Change, now: NOW, ended_too: true };
    let (found, _) = f.verifier.verify(&by(&last), call, &f.accounts).unwrap();
    assert_eq!((found.id(), found.ended_by), (id, Some(7)));
    assert!(matches!(account(f.verifier.verify(&by(&f.key), call, &f.accounts)), AccountError::Rotated { .. }));
}
