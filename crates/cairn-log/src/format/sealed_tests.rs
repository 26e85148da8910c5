//! Sealed keys: files made by another implementation, every byte flipped, wrong secrets, and what may be asked of Argon2id.

use super::*;

/// Both were made by a Python script from the format's description, with `cryptography`'s Argon2id and
/// ChaCha20-Poly1305 and an HChaCha20 of its own (draft-irtf-cfrg-xchacha-03, section 2.2): seed 32 x 07.
const BY_PHRASE: &str = "-----BEGIN CAIRN SEALED KEY-----
Public-Key: ea4a6c63e29c520abef5507b132ec5f9954776aebebe7b92421eea691446d22c

AQEAAABAAAAAAQAAAAQAAQIDBAUGBwgJCgsMDQ4PZGVmZ2hpamtsbW5vcHFyc3R1
dnd4eXp7NbQlnLQEvJIRWirnEsqQsnfl+PPS2+ALRgtj6hm64g3qCMVTBEc1zfpS
s/qCRbxg
-----END CAIRN SEALED KEY-----
";
const BY_FILE: &str = "-----BEGIN CAIRN SEALED KEY-----
Public-Key: ea4a6c63e29c520abef5507b132ec5f9954776aebebe7b92421eea691446d22c

AQJkZWZnaGlqa2xtbm9wcXJzdHV2d3h5ent7dP63+CmOhYA3mjihaLrOXLxVduMr
zbeLUmOgLFl/FzdtSPwshMx2iREV05Ax358=
-----END CAIRN SEALED KEY-----
";

/// As little as RFC 9106 allows: tests try many times.
const CHEAP: Cost = Cost { memory_kib: 8, passes: 1, lanes: 1 };

fn phrase(text: &str) -> Passphrase {
    Passphrase::new(Zeroizing::new(text.into())).unwrap()
}

fn key_file(bytes: [u8; 32]) -> SealingKey {
    SealingKey::parse(&format!("cairn-key-file-v1 {}\n", hex::encode(bytes))).unwrap()
}

#[test]
fn what_another_implementation_sealed_opens() {
    let (phrase, file) = (phrase("correct horse"), key_file(std::array::from_fn(|i| i as u8)));
    for (text, secret) in [(BY_PHRASE, Secret::Passphrase(&phrase)), (BY_FILE, Secret::KeyFile(&file))] {
        let sealed = SealedKey::parse(text).unwrap();
        assert_eq!(sealed.public(), OwnerKey::from_seed(&[7; 32]).public());
        let key = sealed.open(secret).unwrap();
        assert_eq!(*key.seed(), [7; 32]);
    }
}

#[test]
fn every_changed_bit_of_a_file_is_noticed() {
    let file = key_file(std::array::from_fn(|i| i as u8));
    for at in 0..BY_FILE.len() {
        for bit in 0..8 {
            let mut bytes = BY_FILE.as_bytes().to_vec();
            bytes[at] ^= 1 << bit;
            let Ok(text) = String::from_utf8(bytes) else { continue };
            let opened = SealedKey::parse(&text).and_then(|sealed| sealed.open(Secret::KeyFile(&file)));
            assert!(opened.is_err(), "byte {at}, bit {bit}");
        }
    }
}

#[test]
fn every_changed_byte_under_a_passphrase_is_noticed() {
    let phrase = phrase("correct horse");
    let secret = Secret::Passphrase(&phrase);
    let text = SealedKey::seal_at(&OwnerKey::from_seed(&[7; 32]), secret, CHEAP).unwrap().to_text();
    for at in 0..text.len() {
        let mut bytes = text.clone().into_bytes();
        bytes[at] ^= 1;
        let text = String::from_utf8(bytes).unwrap();
        let opened = SealedKey::parse(&text).and_then(|sealed| sealed.open(secret));
        assert!(opened.is_err(), "byte {at}");
    }
    assert!(SealedKey::parse(&text).unwrap().open(secret).is_ok());
}

#[test]
fn a_file_has_one_spelling() {
    let spellings = [
        BY_FILE.trim_end().to_owned(),
        format!("{BY_FILE}\n"),
        format!(" {BY_FILE}"),
        BY_FILE.replace('\n', "\r\n"),
        BY_FILE.replace("dHP", "dH\nP").replacen("Mr\n", "Mr", 1),
        BY_FILE.replace("58=", "58"),
        // The unused bits of the last character.
        BY_FILE.replace("58=", "59="),
        BY_FILE.replace("ea4a6c63", "EA4A6C63"),
        BY_FILE.replace("Public-Key: ", "Public-Key:  "),
        BY_FILE.replace("\n\n", "\nComment: x\n\n"),
        BY_FILE.replacen("AQJk", "AQJkAQJk", 1),
        "x".repeat(5000),
        String::new(),
    ];
    for text in spellings {
        assert!(matches!(SealedKey::parse(&text), Err(SealError::Malformed(_))), "{text}");
    }
}

#[test]
fn another_secret_or_another_kind_of_it_does_not_open() {
    let (good, other) = (phrase("correct horse"), phrase("correct horsf"));
    let (file, another) = (key_file([1; 32]), key_file([2; 32]));
    let key = OwnerKey::from_seed(&[7; 32]);
    let sealed = SealedKey::seal_at(&key, Secret::Passphrase(&good), CHEAP).unwrap();
    assert_eq!(sealed.open(Secret::Passphrase(&other)).unwrap_err(), SealError::Wrong("the passphrase"));
    assert!(matches!(sealed.open(Secret::KeyFile(&file)), Err(SealError::OtherSecret { .. })));
    let sealed = SealedKey::seal(&key, Secret::KeyFile(&file)).unwrap();
    assert_eq!(sealed.open(Secret::KeyFile(&another)).unwrap_err(), SealError::Wrong("the key file"));
    assert!(matches!(sealed.open(Secret::Passphrase(&good)), Err(SealError::OtherSecret { .. })));
    assert_eq!(sealed.open(Secret::KeyFile(&file)).unwrap().public(), key.public());
    // Sealed twice is two files: salt and nonce are fresh.
    assert_ne!(sealed, SealedKey::seal(&key, Secret::KeyFile(&file)).unwrap());
}

#[test]
fn a_seed_that_is_not_the_public_keys_does_not_open() {
    let file = key_file([1; 32]);
    let mut sealed = SealedKey::seal(&OwnerKey::from_seed(&[7; 32]), Secret::KeyFile(&file)).unwrap();
    // Whoever has the secret can bind any public key; the seed gives it away.
    sealed.public = OwnerKey::from_seed(&[8; 32]).public();
    let cipher = sealed.cipher(Secret::KeyFile(&file)).unwrap();
    let payload = Payload { msg: &[7; 32], aad: &sealed.additional_data() };
    let forged = cipher.encrypt(&XNonce::from(sealed.nonce), payload).unwrap();
    sealed.ciphertext.copy_from_slice(&forged);
    let read = SealedKey::parse(&sealed.to_text()).unwrap();
    assert_eq!(read.open(Secret::KeyFile(&file)).unwrap_err(), SealError::Wrong("the key file"));
}

#[test]
fn what_a_file_asks_of_argon2_is_bounded_before_anything_is_allocated() {
    let with = |cost: Cost| {
        let kdf = Kdf::Passphrase { cost, salt: [0; SALT] };
        let public = OwnerKey::from_seed(&[7; 32]).public();
        SealedKey { public, kdf, nonce: [0; NONCE], ciphertext: [0; CIPHERTEXT] }.to_text()
    };
    let ok = Cost::RECOMMENDED;
    for (cost, what) in [
        (Cost { memory_kib: MAX_MEMORY_KIB + 1, ..ok }, "memory (KiB)"),
        (Cost { memory_kib: u32::MAX, ..ok }, "memory (KiB)"),
        (Cost { memory_kib: 31, ..ok }, "memory (KiB)"),
        (Cost { passes: 0, ..ok }, "passes"),
        (Cost { passes: u32::MAX, ..ok }, "passes"),
        (Cost { lanes: 0, ..ok }, "lanes"),
        (Cost { lanes: u32::MAX, ..ok }, "lanes"),
    ] {
        let refused = SealedKey::parse(&with(cost)).unwrap_err();
        assert!(matches!(refused, SealError::Cost { what: named, .. } if named == what), "{cost:?}: {refused}");
    }
    assert!(SealedKey::parse(&with(Cost { memory_kib: MAX_MEMORY_KIB, ..ok })).is_ok());
}

#[test]
fn versions_and_kinds_unknown_are_refused_by_name() {
    // The first base64 characters hold version and kind.
    let newer = BY_FILE.replacen("AQJk", "AgJk", 1);
    assert_eq!(SealedKey::parse(&newer), Err(SealError::Version { got: 2 }));
    let other = BY_FILE.replacen("AQJk", "AQNk", 1);
    assert_eq!(SealedKey::parse(&other), Err(SealError::Kind { got: 3 }));
}

#[test]
fn nothing_printed_holds_a_secret() {
    let (phrase, file) = (phrase("correct horse"), key_file([0xcd; 32]));
    let key = OwnerKey::from_seed(&[0xab; 32]);
    let sealed = SealedKey::seal_at(&key, Secret::Passphrase(&phrase), CHEAP).unwrap();
    let by_file = SealedKey::seal(&key, Secret::KeyFile(&file)).unwrap();
    let wrong = sealed.open(Secret::KeyFile(&file)).unwrap_err();
    let closed = by_file.open(Secret::KeyFile(&key_file([0xce; 32]))).unwrap_err();
    let shown = format!("{phrase:?} {file:?} {key:?} {sealed:?} {by_file:?} {wrong} {wrong:?} {closed} {closed:?}");
    for secret in ["horse", "cdcdcd", "205, 205, 205", "ababab", "171, 171, 171"] {
        assert!(!shown.contains(secret), "{secret}: {shown}");
    }
}
