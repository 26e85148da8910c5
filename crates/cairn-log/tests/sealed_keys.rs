//! Key files under a seal: what loads with what, who may read them, and that sealing replaces a file at one stroke.
#![cfg(feature = "sealed-keys")]

use std::{cell::Cell, fs, path::Path};

use cairn_log::{
    KeyError, OwnerKey,
    format::sealed::{Passphrase, SealError, SealedBy, SealingKey},
    keys::{
        KeyFileError, Seal, StoredKey, Unlock, load_key, load_new_passphrase, load_passphrase, load_sealing_key,
        reseal_key, save_key, save_sealing_key,
    },
};
use zeroize::Zeroizing;

fn phrase(text: &str) -> Result<Passphrase, KeyError> {
    Passphrase::new(Zeroizing::new(text.into()))
}

/// Writes a file as its owner alone may read it.
fn private(path: &Path, text: &str) {
    let mut file = fs::OpenOptions::new();
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut file, 0o600);
    let mut file = file.write(true).create(true).truncate(true).open(path).unwrap();
    std::io::Write::write_all(&mut file, text.as_bytes()).unwrap();
}

#[test]
fn a_key_loads_with_what_it_was_sealed_with_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let key = OwnerKey::from_seed(&[5; 32]);
    let (unlock, other) = (SealingKey::generate().unwrap(), SealingKey::generate().unwrap());
    save_key(&at("plain"), &key, &Seal::Plain).unwrap();
    save_key(&at("file"), &key, &Seal::KeyFile(unlock.clone())).unwrap();
    // The one place where the recommended, slow parameters are run.
    save_key(&at("phrase"), &key, &Seal::Passphrase(phrase("correct horse").unwrap())).unwrap();

    let asked = Cell::new(0);
    let ask = |_: &Path| {
        asked.set(asked.get() + 1);
        Ok(phrase("correct horse")?)
    };
    let public = |name: &str, unlock: &Unlock<'_>| load_key(&at(name), unlock).map(|key| key.public());
    assert_eq!(public("plain", &Unlock::Nothing).unwrap(), key.public());
    assert_eq!(public("plain", &Unlock::Ask(&ask)).unwrap(), key.public());
    assert!(matches!(public("file", &Unlock::Ask(&ask)), Err(KeyFileError::Sealed { by: SealedBy::KeyFile, .. })));
    assert_eq!(asked.get(), 0, "asked for what nobody needs");
    assert_eq!(public("phrase", &Unlock::Ask(&ask)).unwrap(), key.public());
    assert_eq!(asked.get(), 1);
    assert_eq!(public("file", &Unlock::KeyFile(unlock.clone())).unwrap(), key.public());

    assert!(matches!(public("plain", &Unlock::KeyFile(unlock.clone())), Err(KeyFileError::NotSealed { .. })));
    assert!(matches!(
        public("phrase", &Unlock::Nothing),
        Err(KeyFileError::Sealed { by: SealedBy::Passphrase(_), .. })
    ));
    let wrong = public("file", &Unlock::KeyFile(other)).unwrap_err();
    assert!(matches!(wrong, KeyFileError::Seal { error: SealError::Wrong(_), .. }), "{wrong}");
    assert!(wrong.to_string().contains(&at("file").display().to_string()), "{wrong}");
    assert!(matches!(public("phrase", &Unlock::KeyFile(unlock)), Err(KeyFileError::Seal { .. })));
    assert!(matches!(public("file", &Unlock::Nothing), Err(KeyFileError::Sealed { by: SealedBy::KeyFile, .. })));
}

#[test]
fn the_public_half_is_there_without_the_secret() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("key");
    let key = OwnerKey::from_seed(&[5; 32]);
    save_key(&path, &key, &Seal::KeyFile(SealingKey::generate().unwrap())).unwrap();
    let stored = StoredKey::read(&path).unwrap();
    assert_eq!((stored.public(), stored.sealed_by()), (key.public(), Some(SealedBy::KeyFile)));
    assert!(!fs::read_to_string(&path).unwrap().contains(&hex::encode([5; 32])));
}

#[test]
fn sealing_replaces_the_file_and_saving_never_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("key");
    let (key, unlock) = (OwnerKey::from_seed(&[5; 32]), SealingKey::generate().unwrap());
    save_key(&path, &key, &Seal::Plain).unwrap();
    let refused = save_key(&path, &key, &Seal::KeyFile(unlock.clone()));
    assert!(matches!(refused, Err(KeyFileError::Exists { .. })));
    reseal_key(&path, &key, &Seal::KeyFile(unlock.clone())).unwrap();
    assert!(!fs::read_to_string(&path).unwrap().contains("PRIVATE KEY"));
    assert_eq!(load_key(&path, &Unlock::KeyFile(unlock)).unwrap().public(), key.public());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays behind");
}

#[cfg(unix)]
#[test]
fn secrets_that_others_may_read_are_refused() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let unlock = SealingKey::generate().unwrap();
    save_sealing_key(&at("unlock"), &unlock).unwrap();
    save_key(&at("key"), &OwnerKey::from_seed(&[5; 32]), &Seal::KeyFile(unlock)).unwrap();
    private(&at("phrase"), "correct horse\n");
    load_passphrase(&at("phrase")).unwrap();
    for name in ["unlock", "key", "phrase"] {
        assert_eq!(fs::metadata(at(name)).unwrap().permissions().mode() & 0o777, 0o600, "{name}");
        for mode in [0o640, 0o604, 0o620, 0o601] {
            fs::set_permissions(at(name), fs::Permissions::from_mode(mode)).unwrap();
            let refused = match name {
                "unlock" => load_sealing_key(&at(name)).map(drop),
                "key" => StoredKey::read(&at(name)).map(drop),
                _ => load_passphrase(&at(name)).map(drop),
            };
            assert!(matches!(refused, Err(KeyFileError::TooOpen { mode: got, .. }) if got == mode), "{name} {mode:o}");
        }
    }
}

#[test]
fn passphrases_and_key_files_that_are_none_are_refused_without_repeating_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("secret");
    for text in ["", "short", "two lines\nof a song", "tab\tulators", &"x".repeat(1025)] {
        private(&path, text);
        let refused = load_new_passphrase(&path).unwrap_err().to_string();
        assert!(text.is_empty() || !refused.contains(text), "{refused}");
        // What opens nothing is wrong, not unfit.
        assert_eq!(load_passphrase(&path).is_ok(), !text.contains(char::is_control), "{text:?}");
    }
    for text in ["x".repeat(5000), "\u{0}".into()] {
        private(&path, &text);
        assert!(load_passphrase(&path).is_err());
    }
    private(&path, "correct horse\r\n");
    assert!(load_passphrase(&path).unwrap() == phrase("correct horse").unwrap());
    // As many characters as bytes are not needed.
    assert!(phrase("Übergröß").is_ok() && phrase("Übergrö").is_err());

    let good = format!("cairn-key-file-v1 {}\n", "ab".repeat(32));
    private(&path, &good);
    load_sealing_key(&path).unwrap();
    for text in [good.replace("v1", "v2"), good.replace("ab\n", "\n"), good.replace("ab\n", "abab\n"), "ab".repeat(32)]
    {
        private(&path, &text);
        let refused = load_sealing_key(&path).unwrap_err();
        assert!(matches!(refused, KeyFileError::NotAKey { .. }), "{refused}");
        assert!(!format!("{refused} {refused:?}").contains("abab"), "{refused}");
    }
}
