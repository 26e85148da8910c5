//! Keys over their whole life, through the real binary: made and sealed, signing, rotated, revoked; and what becomes of
//! the records that they signed.

use std::os::unix::fs::PermissionsExt as _;

use cairn_log::{Digest, Envelope, OwnerRecord, RecordKind, TlogProof};
use cairn_testkit::daemon::{Daemon, Place};

/// A made-up landmark with a model, and a key file that everybody's keys here are sealed with.
struct Town {
    place: Place,
    data: String,
    unlock: String,
}

impl Town {
    fn new() -> Self {
        let place = Place::new();
        let (data, unlock) = (place.text("data"), place.text("unlock"));
        place.import("town", ["--data", &data]);
        place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
        place.cairn_ok(&["keys", "new-key-file", &unlock]);
        Self { place, data, unlock }
    }

    /// Makes a sealed key; its file.
    fn key(&self, name: &str) -> String {
        let file = self.place.text(name);
        self.place.cairn_ok(&["keys", "new", &file, "--key-file", &self.unlock]);
        file
    }

    fn with<'a>(&'a self, arguments: &[&'a str]) -> Vec<&'a str> {
        [arguments, &["--key-file", &self.unlock, "--data", &self.data]].concat()
    }

    /// Runs a command that enters a record with sealed keys; the record's place in the log.
    fn enter(&self, arguments: &[&str]) -> String {
        let said = self.place.cairn_ok(&self.with(arguments));
        let (_, rest) = said.split_once("record ").unwrap_or_else(|| panic!("{said}"));
        rest.chars().take_while(char::is_ascii_digit).collect()
    }

    /// As [`Town::enter`] for what must be refused; what was said.
    fn refused(&self, arguments: &[&str]) -> String {
        let output = self.place.cairn(&self.with(arguments));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        said
    }

    fn sign(&self, key: &str, out: &str) -> String {
        self.enter(&["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", key, "--out", out])
    }

    /// The line `state` of a record.
    fn state(&self, index: &str) -> String {
        let said = self.place.cairn_ok(&["owners", "show", index, "--data", &self.data]);
        let state = said.lines().find_map(|l| l.trim().strip_prefix("state"));
        state.unwrap_or_else(|| panic!("{said}")).trim().to_owned()
    }

    /// The record of a bundle, its owner's signature verified, and its digest; its proof is about `index`.
    fn bundle(&self, folder: &str, index: &str) -> (OwnerRecord, Digest) {
        let read = |name: &str| std::fs::read(self.place.path(folder).join(name)).unwrap();
        let envelope = Envelope::parse(&read("record.json")).unwrap();
        let proof = TlogProof::parse(std::str::from_utf8(&read("record.tlog-proof")).unwrap()).unwrap();
        assert_eq!(proof.index.to_string(), index);
        assert!(read("log.vkey").starts_with(b"cairn.localhost/owners+"));
        (OwnerRecord::open(&envelope).unwrap().0, envelope.digest())
    }
}

#[test]
fn a_key_signs_is_rotated_and_revoked_and_its_records_say_so() {
    let town = Town::new();
    let (ada, next) = (town.key("ada.key"), town.key("next.key"));
    let out = |name: &str| town.place.text(name);

    // Sealed: no command uses it without the key file, and none says more than that.
    let sign = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", &ada, "--out"];
    let closed = town.place.cairn(&[&sign[..], &[&out("none"), "--data", &town.data]].concat());
    assert!(String::from_utf8_lossy(&closed.stderr).contains("sealed by a key file"), "{closed:?}");
    assert!(!town.place.path("none").exists(), "an empty bundle stays behind");

    // A folder that is there is refused before the key is looked at, and those above a new one are made, and gone again.
    std::fs::create_dir(town.place.path("there")).unwrap();
    let said = town.refused(&[&sign[..sign.len() - 2], &[&out("no.key"), "--out", &out("there")]].concat());
    assert!(said.contains("there exists already; give a new folder (--out)"), "{said}");
    town.refused(&["owners", "sign", "town", "--identity", "99", "--key", &ada, "--out", &out("some/where/new")]);
    assert!(!town.place.path("some").exists(), "empty folders stay behind");

    let first = town.sign(&ada, &out("some/first"));
    std::fs::rename(town.place.path("some/first"), town.place.path("first")).unwrap();
    assert_eq!(town.state(&first), "stands, name unconfirmed");
    let (record, digest) = town.bundle("first", &first);
    assert!(record.views.as_ref().is_some_and(|views| !views.is_empty() && views.is_sorted()));

    // The photographs that it lists are named.
    let shown = town.place.cairn_ok(&["owners", "show", &first, "--data", &town.data]);
    let views = record.views.as_ref().unwrap();
    assert!(shown.contains(&format!("views          {} photographs:", views.len())), "{shown}");
    for view in views {
        assert!(shown.contains(&format!("{view}  images/")), "{view}: {shown}");
    }

    // Rotated: all that the record binds goes on under the new key, and the old one signs no more.
    let rotate = ["keys", "rotate", "town", "--record", &first, "--key", &ada, "--new-key", &next, "--out"];
    let second = town.enter(&[&rotate[..], &[&out("second")]].concat());
    let rotation = town.bundle("second", &second).0;
    assert_eq!((rotation.kind, rotation.replaces), (RecordKind::Rotation, Some(digest)));
    assert_eq!((&rotation.digests, &rotation.views), (&record.digests, &record.views));
    assert_ne!(rotation.owner_key, record.owner_key);
    assert_eq!(
        town.state(&first),
        format!("stands, name unconfirmed; its key was rotated by record {second}, after it")
    );
    let said = town.refused(&[&sign[..], &[&out("old")]].concat());
    assert!(said.contains(&format!("rotated by record {second}; sign with the key that follows it")), "{said}");

    // A rotation credits nobody: to replace it or to take it back would change nothing.
    let revoke = ["keys", "revoke", "town", "--key", &next, "--purpose", "the laptop is gone", "--out"];
    let replace = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--replaces"];
    for refused in [
        town.refused(&[&replace[..], &[&second, "--key", &next, "--out", &out("none")]].concat()),
        town.refused(&[&revoke[..], &[&out("none"), "--record", &second]].concat()),
    ] {
        let wanted = format!("record {second} is a rotation and credits nobody; name the record that it is about");
        assert!(refused.contains(&wanted), "{refused}");
    }

    // The record that it is about is replaced by the key that follows, and by nobody else.
    let bob = town.key("bob.key");
    let said = town.refused(&[&replace[..], &[&first, "--key", &bob, "--out", &out("bobs")]].concat());
    assert!(said.contains("who did not sign this one"), "{said}");
    let third = town.enter(&[&replace[..], &[&first, "--key", &next, "--out", &out("third")]].concat());
    assert_eq!(town.bundle("third", &third).0.replaces, Some(digest));
    let replaced = format!("replaced by record {third}; its key was rotated by record {second}, after it");
    assert_eq!(town.state(&first), replaced);

    // Contested by anybody.
    let dispute = ["owners", "dispute", "town", "--record", &third, "--key", &bob, "--purpose", "these are mine"];
    let fourth = town.enter(&[&dispute[..], &["--out", &out("fourth")]].concat());
    assert_eq!(town.state(&third), format!("stands, name unconfirmed; disputed by record {fourth}"));

    // Revoked, one record with it.
    let said = town.refused(&["keys", "revoke", "town", "--key", &ada, "--purpose", "late", "--out", &out("late")]);
    assert!(said.contains(&format!("rotated by record {second}")), "{said}");
    let fifth = town.enter(&[&revoke[..], &[&out("fifth"), "--record", &third]].concat());
    assert_eq!(town.bundle("fifth", &fifth).0.kind, RecordKind::Revocation);
    let wanted = format!(
        "taken back by record {fifth}; disputed by record {fourth}; its key was revoked by record {fifth}, after it"
    );
    assert_eq!(town.state(&third), wanted);
    // What nobody can do any more is not advised.
    let said = town.refused(&[&revoke[..], &[&out("again")]].concat());
    assert!(said.contains(&format!("revoked by record {fifth}, and no key follows it")), "{said}");
    for key in [&next, &bob] {
        let said = town.refused(&[&replace[..], &[&third, "--key", key, "--out", &out("gone")]].concat());
        assert!(said.contains(&format!("record {third} belongs to key")), "{said}");
        assert!(said.contains(&format!("record {fifth} revoked. It can no longer be replaced")), "{said}");
    }

    // The list says of each what became of it.
    let listed = town.place.cairn_ok(&["owners", "list", "town", "--data", &town.data]);
    for (index, state) in [
        (&first, replaced),
        (&second, format!("stands; its key was revoked by record {fifth}, after it")),
        (&third, wanted),
        (&fourth, "stands".to_owned()),
    ] {
        let of = listed.lines().find(|line| line.starts_with(&format!("{index}  "))).unwrap();
        assert!(of.contains(&format!("  identity 1  {state}  by key ")), "{of}");
    }
    let listed = town.place.cairn_json(&["owners", "list", "town", "--json", "--data", &town.data]);
    assert_eq!(listed["records"][0]["standing"]["replaced_by"], third.as_str(), "{listed}");

    // Nobody speaks for a revoked key, and only its owner for one in use.
    let erase = ["owners", "erase", "town", "--record", &third, "--key"];
    for key in [&ada, &next, &bob] {
        let said = town.refused(&[&erase[..], &[key]].concat());
        assert!(said.contains(&format!("revoked by record {fifth}")), "{said}");
    }
    let said = town.refused(&["owners", "erase", "town", "--record", &fourth, "--key", &next]);
    assert!(said.contains("it belongs to the key with id"), "{said}");

    // Where the scene is gone, so are its names, and that is said once.
    town.place.cairn_ok(&["scene", "delete", "town", "--yes", "--data", &town.data]);
    let shown = town.place.cairn_ok(&["owners", "show", &first, "--data", &town.data]);
    assert!(shown.contains("the scene's names cannot be asked for: "), "{shown}");
    assert!(views.iter().all(|view| shown.contains(&format!("{view}\n"))) && !shown.contains("(not in"), "{shown}");
}

#[test]
fn an_owner_has_records_erased_and_so_has_the_key_that_follows() {
    let town = Town::new();
    let (ada, next) = (town.key("ada.key"), town.key("next.key"));
    let (first, other) = (town.sign(&ada, &town.place.text("first")), town.sign(&ada, &town.place.text("other")));
    let erase = |index: &str, key: &str| {
        town.place.cairn_ok(&town.with(&["owners", "erase", "town", "--record", index, "--key", key]));
        assert!(town.state(index).starts_with("erased"), "{index}");
    };
    erase(&first, &ada);
    assert!(town.refused(&["owners", "erase", "town", "--record", &first, "--key", &ada]).contains("was erased"));
    let out = town.place.text("rotation");
    let rotation =
        town.enter(&["keys", "rotate", "town", "--record", &other, "--key", &ada, "--new-key", &next, "--out", &out]);
    let said = town.refused(&["owners", "erase", "town", "--record", &other, "--key", &ada]);
    assert!(said.contains("it belongs to the key with id"), "{said}");
    // That the new key took the old one's place outlives the rotation's contents.
    erase(&rotation, &next);
    erase(&other, &next);
    let listed = town.place.cairn_ok(&["owners", "list", "town", "--data", &town.data]);
    assert_eq!(listed.lines().filter(|l| l.contains("  erased  ")).count(), 3, "{listed}");
}

#[test]
fn the_key_that_follows_replaces_and_takes_back_what_the_one_before_it_signed() {
    let town = Town::new();
    let (ada, next, bob) = (town.key("ada.key"), town.key("next.key"), town.key("bob.key"));
    let out = |name: &str| town.place.text(name);
    let [first, second, third] = ["first", "second", "third"].map(|name| town.sign(&ada, &out(name)));
    let rotate = ["keys", "rotate", "town", "--record", &first, "--key", &ada, "--new-key", &next, "--out"];
    town.enter(&[&rotate[..], &[&out("rotation")]].concat());
    // The rotation names the first record; the others are the new key's all the same.
    let replace = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--replaces", &second];
    let said = town.refused(&[&replace[..], &["--key", &bob, "--out", &out("bobs")]].concat());
    assert!(said.contains("who did not sign this one"), "{said}");
    let replaced = town.enter(&[&replace[..], &["--key", &next, "--out", &out("replaced")]].concat());
    assert!(town.state(&second).starts_with(&format!("replaced by record {replaced}")), "{}", town.state(&second));
    let revoke = ["keys", "revoke", "town", "--key", &next, "--purpose", "not mine", "--record", &third, "--out"];
    let revoked = town.enter(&[&revoke[..], &[&out("revoked")]].concat());
    assert!(town.state(&third).starts_with(&format!("taken back by record {revoked}")), "{}", town.state(&third));
    // Stopped cleanly, the folder's own state is sealed, and a byte that changes in it is named.
    let store = || {
        let done = town.place.cairn(&["audit", "store", &town.data]);
        (done.status.code(), String::from_utf8_lossy(&done.stdout).into_owned())
    };
    let (code, said) = store();
    assert!(code == Some(0) && said.contains("state.verified") && !said.contains("file.uncovered  access"), "{said}");
    let sealed = std::path::Path::new(&town.data).join("registry.key");
    let good = std::fs::read(&sealed).unwrap();
    std::fs::write(&sealed, [&good[..], b"x"].concat()).unwrap();
    let (code, said) = store();
    assert!(code == Some(14) && said.contains("state.mismatch  registry.key"), "{said}");
    std::fs::write(&sealed, good).unwrap();
    // An answer is held to the question.
    let answer = out("answer.json");
    town.place.cairn_ok(&["owners", "answer", "town", "--out", &answer, "--data", &town.data]);
    let photograph = std::fs::read_dir(town.place.path("capture/images")).unwrap().next().unwrap().unwrap().path();
    let photograph = photograph.to_str().unwrap();
    for (question, wanted) in [
        (&["--scene", "town"][..], Some(0)),
        (&["--scene", "fern"], Some(1)),
        (&["--scene", "town", "--view", photograph], Some(1)),
        (&["--scene", "town", "--view", "no-such-file"], Some(2)),
    ] {
        let done = town.place.cairn(&[&["audit", "answer", &answer][..], question].concat());
        let said = String::from_utf8_lossy(&done.stdout);
        let mismatch = said.contains("answer.question.mismatch");
        assert_eq!((done.status.code(), mismatch), (wanted, wanted == Some(1)), "{question:?}: {said}");
    }
    // A bundle from before, with the log's records, says so.
    let list = out("log.json");
    town.place.cairn_ok(&["owners", "list", "town", "--out", &list, "--data", &town.data]);
    let audited = |bundle: &str| {
        let vkey = town.place.path(bundle).join("log.vkey").to_str().unwrap().to_owned();
        let done = town.place.cairn(&["audit", "bundle", &out(bundle), "--vkey", &vkey, "--log", &list]);
        String::from_utf8_lossy(&done.stdout).into_owned()
    };
    let said = audited("second");
    assert!(said.starts_with("trusted\n") && said.contains("record.replaced  log, record"), "{said}");
    let said = audited("third");
    assert!(said.starts_with("invalid\n") && said.contains("record.revoked"), "{said}");
}

#[test]
fn keys_are_sealed_by_what_was_asked_for_and_sealed_anew() {
    let place = Place::new();
    let (phrase, unlock, plain, sealed) =
        (place.text("phrase"), place.text("unlock"), place.text("plain.key"), place.text("sealed.key"));
    place.cairn_ok(&["keys", "new-key-file", &unlock]);
    std::fs::write(&phrase, "correct horse\n").unwrap();
    let new = ["keys", "new", &sealed, "--passphrase-file", &phrase];
    std::fs::set_permissions(&phrase, std::fs::Permissions::from_mode(0o644)).unwrap();
    let open = place.cairn(&new);
    assert!(String::from_utf8_lossy(&open.stderr).contains("mode 644"), "{open:?}");
    assert!(!place.path("sealed.key").exists());
    std::fs::set_permissions(&phrase, std::fs::Permissions::from_mode(0o600)).unwrap();

    let made = place.cairn_ok(&new);
    assert!(made.contains("sealed by  a passphrase (argon2id, 65536 KiB, 3 passes, 4 lanes)"), "{made}");
    let public = |text: &str| text.lines().find(|l| l.starts_with("public key ")).unwrap().to_owned();
    assert_eq!(public(&place.cairn_ok(&["keys", "show", &sealed])), public(&made));
    let file = || std::fs::read_to_string(place.path("sealed.key")).unwrap();
    assert!(file().starts_with("-----BEGIN CAIRN SEALED KEY-----\n"));
    assert_eq!(place.path("sealed.key").metadata().unwrap().permissions().mode() & 0o777, 0o600);

    // A file that is no secret is not called one that others may read.
    let vkey = place.text("witness.vkey");
    let line = place.cairn_ok(&["witness", "vkey", "--name", "w", "--key", &sealed, "--passphrase-file", &phrase]);
    std::fs::write(&vkey, line).unwrap();
    std::fs::set_permissions(&vkey, std::fs::Permissions::from_mode(0o644)).unwrap();
    let said = place.cairn_refused(&["keys", "show", &vkey]);
    assert!(said.contains("a verifier key (vkey), the public half") && !said.contains("mode"), "{said}");

    // Where nobody can be asked, that is said.
    let program = cairn_testkit::daemon::command();
    let alone = std::process::Command::new("setsid")
        .args(["-w".as_ref(), program.get_program()])
        .args(["witness", "vkey", "--name", "w", "--key", &sealed])
        .output();
    match alone {
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(said.contains("(there is no terminal here)") && said.contains("--passphrase-file"), "{said}");
        }
        Err(e) => println!("SKIPPED a command without a terminal: no setsid on this system ({e})"),
    }

    // A wrong passphrase is wrong, however short; a new one may not be short.
    let (short, other) = (place.text("short"), place.text("other.key"));
    std::fs::write(&short, "hors\n").unwrap();
    std::fs::set_permissions(&short, std::fs::Permissions::from_mode(0o600)).unwrap();
    let vkey = ["witness", "vkey", "--name", "w", "--key", &sealed, "--passphrase-file", &short];
    assert!(place.cairn_refused(&vkey).contains("the passphrase is another than it was sealed with"));
    let said = place.cairn_refused(&["keys", "new", &other, "--passphrase-file", &short]);
    assert!(said.contains("fewer than 8"), "{said}");

    // Another seal for the same key, and not for whoever has not opened it.
    let seal = ["keys", "seal", &sealed, "--key-file", &unlock];
    let before = file();
    let closed = place.cairn(&[&seal[..], &["--old-key-file", &unlock]].concat());
    assert!(String::from_utf8_lossy(&closed.stderr).contains("is sealed by a passphrase"), "{closed:?}");
    assert_eq!(file(), before);
    let anew = place.cairn_ok(&[&seal[..], &["--old-passphrase-file", &phrase]].concat());
    assert!(anew.contains("sealed by  a key file") && public(&anew) == public(&made), "{anew}");

    // A plain key says that it is, until it is sealed.
    let made = place.cairn_ok(&["keys", "new", &plain, "--plain"]);
    assert!(made.contains("it is not sealed") && made.contains("sealed by  nothing"), "{made}");
    let anew = place.cairn_ok(&["keys", "seal", &plain, "--key-file", &unlock]);
    assert!(anew.contains("may still hold the plain key") && public(&anew) == public(&made), "{anew}");
    assert!(!std::fs::read_to_string(place.path("plain.key")).unwrap().contains("PRIVATE"));
}

#[test]
fn the_registrys_key_is_sealed_by_the_file_that_the_settings_name() {
    let place = Place::new();
    let (data, unlock, config) = (place.text("data"), place.text("unlock"), place.text("sealed.toml"));
    std::fs::write(place.path("sealed.toml"), format!("[registry]\nkey_file = {unlock:?}\n")).unwrap();
    let vkey = ["owners", "vkey", "--data", &data];
    let sealed = [&vkey[..], &["--config", &config]].concat();
    let refused = |arguments: &[&str], part: &str| {
        let output = place.cairn(arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && said.contains(part), "{said}");
    };
    // Never made in passing: a misspelt path would seal the log's key with what nobody keeps.
    refused(&sealed, &format!("cairn keys new-key-file {unlock}"));
    place.cairn_ok(&["keys", "new-key-file", &unlock]);
    let first = place.cairn_ok(&sealed);
    let key = || std::fs::read_to_string(place.path("data/registry.key")).unwrap();
    assert!(key().starts_with("-----BEGIN CAIRN SEALED KEY-----\n"));
    assert_eq!(place.cairn_ok(&sealed), first);
    refused(&vkey, "registry.key_file");

    // A log that began with a plain key goes on with the same one, sealed.
    let (data, config) = (place.text("plain-data"), ["--config", config.as_str()]);
    let vkey = ["owners", "vkey", "--data", &data];
    let first = place.cairn_ok(&vkey);
    refused(&[&vkey[..], &config].concat(), "cairn keys seal");
    place.cairn_ok(&["keys", "seal", &place.text("plain-data/registry.key"), "--key-file", &unlock]);
    assert_eq!(place.cairn_ok(&[&vkey[..], &config].concat()), first);
}

#[cfg(target_os = "linux")]
#[test]
fn a_daemon_leaves_no_core_dump() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "");
    let limits = std::fs::read_to_string(format!("/proc/{}/limits", daemon.pid())).unwrap();
    let core = limits.lines().find(|l| l.starts_with("Max core file size")).unwrap();
    assert_eq!(core.split_whitespace().skip(4).take(2).collect::<Vec<_>>(), ["0", "0"], "{core}");
    assert!(daemon.terminate().success());
}
