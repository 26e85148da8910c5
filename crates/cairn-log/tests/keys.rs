//! Ed25519 keys and signatures: known answers, the edge cases where verifiers disagree, and key files.

use std::fs;

use cairn_log::{
    KeyError, OwnerKey, PublicKey,
    keys::{KeyFileError, Seal, Unlock, load_key, save_key},
};

/// The order of the base point, little-endian (RFC 8032, 5.1).
const ORDER: &str = "edd3f55c1a631258d69cf7a2def9de1400000000000000000000000000000010";

/// The encodings of the eight points of small order, canonical or not (as listed by libsodium and in
/// "Taming the many EdDSAs", table 1).
const SMALL_ORDER: [&str; 11] = [
    "0100000000000000000000000000000000000000000000000000000000000000",
    "0100000000000000000000000000000000000000000000000000000000000080",
    "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "0000000000000000000000000000000000000000000000000000000000000000",
    "0000000000000000000000000000000000000000000000000000000000000080",
    "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
    "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc85",
    "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
    "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac03fa",
    "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
];

fn bytes<const N: usize>(text: &str) -> [u8; N] {
    hex::decode(text).unwrap().try_into().unwrap()
}

#[test]
fn rfc_8032_test_2() {
    let key = OwnerKey::from_seed(&bytes("4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb"));
    assert_eq!(key.public().to_string(), "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c");
    let expected = "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da\
                    085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00";
    assert_eq!(hex::encode(key.sign(&[0x72])), expected);
    key.public().verify(&[0x72], &key.sign(&[0x72])).unwrap();
}

#[test]
fn keys_of_small_order_and_second_spellings_do_not_exist() {
    for text in SMALL_ORDER {
        let refused = PublicKey::from_bytes(&bytes(text));
        assert!(matches!(refused, Err(KeyError::SmallOrder { .. } | KeyError::Malformed { .. })), "{text}");
        assert!(text.parse::<PublicKey>().is_err());
    }
    // Every y from p to 2^255 - 1 is a second spelling of a small y.
    for low in 0xed..=0xff_u8 {
        for high in [0x7f, 0xff] {
            let mut key = [0xff; 32];
            (key[0], key[31]) = (low, high);
            assert!(matches!(PublicKey::from_bytes(&key), Err(KeyError::Malformed { .. })), "{low:x} {high:x}");
        }
    }
    // y = 2 is no point of the curve.
    let mut key = [0; 32];
    key[0] = 2;
    assert!(matches!(PublicKey::from_bytes(&key), Err(KeyError::Malformed { .. })));
}

#[test]
fn a_signature_has_one_spelling() {
    let key = OwnerKey::from_seed(&[3; 32]);
    let good = key.sign(b"message");
    key.public().verify(b"message", &good).unwrap();
    // S + L is the same scalar and must not be the same signature.
    let mut high = good;
    let mut carry = 0;
    for (byte, order) in high[32..].iter_mut().zip(bytes::<32>(ORDER)) {
        let sum = u16::from(*byte) + u16::from(order) + carry;
        *byte = sum.to_le_bytes()[0];
        carry = sum >> 8;
    }
    assert_ne!(high, good);
    assert!(key.public().verify(b"message", &high).is_err());
    // R of small order.
    for text in SMALL_ORDER {
        let mut signature = good;
        signature[..32].copy_from_slice(&bytes::<32>(text));
        assert!(key.public().verify(b"message", &signature).is_err());
        signature[32..].fill(0);
        assert!(key.public().verify(b"message", &signature).is_err());
    }
    for at in 0..64 {
        let mut flipped = good;
        flipped[at] ^= 1;
        assert!(key.public().verify(b"message", &flipped).is_err(), "byte {at}");
    }
    assert!(key.public().verify(b"messagf", &good).is_err());
    assert!(key.public().verify(b"message", &good[..63]).is_err());
    assert!(key.public().verify(b"message", &[&good[..], &[0]].concat()).is_err());
}

#[test]
fn a_key_file_is_private_whole_and_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("owner.pem");
    let key = OwnerKey::generate().unwrap();
    save_key(&path, &key, &Seal::Plain).unwrap();
    assert_eq!(load_key(&path, &Unlock::Nothing).unwrap().public(), key.public());
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("-----BEGIN PRIVATE KEY-----\n"), "{}", text.len());
    assert!(matches!(save_key(&path, &OwnerKey::generate().unwrap(), &Seal::Plain), Err(KeyFileError::Exists { .. })));
    assert_eq!(load_key(&path, &Unlock::Nothing).unwrap().public(), key.public());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays behind");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        let refused = load_key(&path, &Unlock::Nothing).unwrap_err();
        assert!(matches!(refused, KeyFileError::TooOpen { mode: 0o640, .. }), "{refused}");
        // Readers of PEM pass over lines before it.
        for before in ["Bag Attributes\n", "ada's key\n\n", "\n"] {
            fs::write(&path, format!("{before}{text}")).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
            let refused = load_key(&path, &Unlock::Nothing).unwrap_err();
            assert!(matches!(refused, KeyFileError::TooOpen { mode: 0o644, .. }), "{before:?}: {refused}");
        }
        fs::write(&path, format!("Bag Attributes\n{text}")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        assert_eq!(load_key(&path, &Unlock::Nothing).unwrap().public(), key.public());
    }
}

#[test]
fn what_is_no_key_file_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.pem");
    assert!(matches!(load_key(&path, &Unlock::Nothing), Err(KeyFileError::Missing { .. })));
    let good = OwnerKey::from_seed(&[5; 32]).to_pem().unwrap();
    let texts =
        [String::new(), "hello".into(), good.replace("PRIVATE", "PUBLIC"), good[..60].to_owned(), "x".repeat(5000)];
    for text in texts {
        let mut file = fs::OpenOptions::new();
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut file, 0o600);
        let mut file = file.write(true).create(true).truncate(true).open(&path).unwrap();
        std::io::Write::write_all(&mut file, text.as_bytes()).unwrap();
        let refused = load_key(&path, &Unlock::Nothing).unwrap_err();
        assert!(matches!(refused, KeyFileError::NotAKey { .. }), "{refused}");
        assert!(refused.to_string().contains("bad.pem"));
    }
}

/// What `openssl genpkey -algorithm ed25519` writes for the seed of RFC 8410, section 10.3.
#[test]
fn the_example_of_rfc_8410_is_read() {
    let pem = "-----BEGIN PRIVATE KEY-----\n\
               MC4CAQAwBQYDK2VwBCIEINTuctv5E1hK1bbY8fdp+K06/nwoy/HU++CXqI9EdVhC\n\
               -----END PRIVATE KEY-----\n";
    let key = OwnerKey::from_pem(pem).unwrap();
    assert_eq!(key.public().to_string(), "19bf44096984cdfe8541bac167dc3b96c85086aa30b6b6cb0c5c38ad703166e1");
    assert_eq!(key.to_pem().unwrap().as_str(), pem);
}

#[test]
fn secrets_are_not_printed() {
    let seed = [0xab; 32];
    let key = OwnerKey::from_seed(&seed);
    let shown = format!("{key:?} {key:#?}");
    assert!(!shown.contains("abab") && !shown.contains("171"), "{shown}");
    assert!(shown.contains(&key.public().to_string()));
}

/// The verdict on one signature, by key and signature as they are read from outside.
fn taken(key: &[u8; 32], message: &[u8], signature: &[u8]) -> char {
    let verified = PublicKey::from_bytes(key).and_then(|key| key.verify(message, signature));
    if verified.is_ok() { 'V' } else { 'X' }
}

#[test]
fn signatures_that_verifiers_disagree_on_are_refused() {
    let edges = crate::edges::edges();
    let verdicts: String = edges.iter().map(|e| taken(&e.key, &e.message, &e.signature)).collect();
    let names: Vec<_> = edges.iter().map(|e| e.name).collect();
    assert_eq!(verdicts, crate::edges::STRICT, "{names:#?}");
    // They are what they say: most hold by an equation of RFC 8032, so that it is strictness that refuses them.
    let spelling = |e: &crate::edges::Edge| {
        crate::edges::is_canonical(e.key) && crate::edges::is_canonical(e.signature[..32].try_into().unwrap())
    };
    let two = |e: &crate::edges::Edge| (e.holds.without_cofactor, e.holds.with_cofactor);
    let holds: Vec<_> = edges.iter().map(|e| (two(e), spelling(e))).collect();
    let (both, with, never) = ((true, true), (false, true), (false, false));
    let expected = [both, both, both, both, with, with, both, both, both, never, both, with];
    let spellings = [true, true, true, true, true, true, true, true, false, false, false, false];
    assert_eq!(holds, expected.into_iter().zip(spellings).collect::<Vec<_>>());
}

/// The same with the paper's own vectors, where `ed25519-speccheck/cases.json` lies among the vectors.
#[test]
fn published_edge_cases_get_the_strict_verdicts() {
    let test = "published_edge_cases_get_the_strict_verdicts";
    let Some(folder) = crate::common::vectors(test).and_then(|merkle| Some(merkle.parent()?.join("ed25519-speccheck")))
    else {
        return;
    };
    let Ok(text) = fs::read(folder.join("cases.json")) else {
        eprintln!("SKIPPED {test}: no {}/cases.json (github.com/novifinancial/ed25519-speccheck)", folder.display());
        return;
    };
    let cases: Vec<serde_json::Value> = serde_json::from_slice(&text).unwrap();
    let part = |case: &serde_json::Value, name: &str| hex::decode(case[name].as_str().unwrap()).unwrap();
    let verdict = |case| {
        let key = part(case, "pub_key").try_into().unwrap();
        taken(&key, &part(case, "message"), &part(case, "signature"))
    };
    let verdicts: String = cases.iter().map(verdict).collect();
    assert!(cases.len() >= 10, "{}", cases.len());
    assert_eq!(verdicts, crate::edges::STRICT[..cases.len()]);
}
