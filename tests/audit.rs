//! `cairn audit` through the real binary: a data folder made by hand from the formats
//! alone, a log served over plain HTTP that forks, and the evidence of it.

use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::{Arc, Mutex};

use crate::handmade::{Log, key, put};
use cairn_log::keys::{Seal, save_key};
use cairn_log::{RecordKind, WitnessVerifier, cosign};

fn cairn(arguments: &[&str]) -> Output {
    cairn_testkit::daemon::command().args(arguments).output().unwrap()
}

/// Exit code and standard output.
fn audit(arguments: &[&str]) -> (Option<i32>, String) {
    let output = cairn(&[&["audit"], arguments].concat());
    let said = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&said).into_owned())
}

/// A folder with a log's data and its key to pin.
fn place(log: &Log) -> (tempfile::TempDir, String, String) {
    let dir = tempfile::tempdir().unwrap();
    let (data, vkey) = (dir.path().join("data"), dir.path().join("log.vkey"));
    log.write(&data);
    put(&vkey, format!("{}\n", log.verifier()).as_bytes());
    (dir, data.display().to_string(), vkey.display().to_string())
}

#[test]
fn a_store_is_audited_and_each_fault_has_its_exit_code() {
    let log = Log::small();
    let (dir, data, vkey) = place(&log);
    let (code, said) = audit(&["store", &data, "--vkey", &vkey]);
    assert_eq!((code, said.lines().next()), (Some(0), Some("trusted")), "{said}");
    let (code, said) = audit(&["store", &data, "--json"]);
    let json: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!((code, json["outcome"].as_str(), json["records"].as_u64()), (Some(0), Some("valid"), Some(5)), "{said}");
    // The folder's own key is found, and compared with the one that is pinned.
    save_key(&dir.path().join("data/registry.key"), &log.signer, &Seal::Plain).unwrap();
    let (code, said) = audit(&["store", &data]);
    assert!(code == Some(0) && said.contains("store.key.unpinned"), "{said}");
    std::fs::remove_file(dir.path().join("data/registry.key")).unwrap();
    save_key(&dir.path().join("data/registry.key"), &key(7), &Seal::Plain).unwrap();
    let (code, said) = audit(&["store", &data, "--vkey", &vkey]);
    assert!(code == Some(15) && said.contains("registry.key"), "{said}");
    std::fs::remove_file(dir.path().join("data/registry.key")).unwrap();

    let spoil = |name: &str| {
        let path = dir.path().join("data").join(name);
        let mut bytes = std::fs::read(&path).unwrap();
        let at = bytes.len() / 2;
        bytes[at] ^= 1;
        std::fs::write(path, bytes).unwrap();
    };
    for (name, exit) in [
        ("registry/working/db", 14),
        ("registry/envelopes/000", 12),
        ("registry/public/tile/0/000.p/8", 11),
        ("registry/public/checkpoint", 10),
    ] {
        spoil(name);
        let (code, said) = audit(&["store", &data, "--vkey", &vkey]);
        // Each fault comes on top of those before it, and is of a class that goes first.
        assert!(code == Some(exit) && said.contains(name), "{name}: {said}");
    }
    let (code, said) = audit(&["store", &vkey]);
    assert!(code == Some(2) && said.contains("log.vkey"), "{said}");
}

#[test]
fn a_lost_working_state_is_made_again_from_a_folder_written_by_other_code() {
    let log = Log::small();
    let (dir, data, vkey) = place(&log);
    let registry = dir.path().join("data/registry");
    let config = dir.path().join("cairn.toml");
    put(&config, format!("[registry]\norigin = \"{}\"\n", crate::handmade::ORIGIN).as_bytes());
    let config = config.display().to_string();
    save_key(&dir.path().join("data/registry.key"), &log.signer, &Seal::Plain).unwrap();
    let run = |arguments: &[&str]| {
        let output = cairn(&[arguments, &["--data", &data, "--config", &config]].concat());
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        (output.status.success(), said)
    };
    let (done, said) = run(&["registry", "rebuild"]);
    let working = registry.join("working");
    assert!(!done && said.contains(&format!("{}: is there; move it away", working.display())), "{said}");
    assert!(registry.join("working.seal").exists(), "what was refused changes nothing");
    std::fs::remove_dir_all(registry.join("working")).unwrap();
    let (done, said) = run(&["registry", "rebuild"]);
    assert!(done && said.contains("5 records in 8 log entries, 0 of them not published yet"), "{said}");
    // Other code keeps no anchor: a person says that this log is the newest.
    let (done, said) = run(&["registry", "anchor", "--accept"]);
    assert!(done, "{said}");
    let (done, said) = run(&["owners", "list", "town"]);
    assert!(done && said.contains("town"), "{said}");
    // That command closed it cleanly, and so sealed it.
    let (code, said) = audit(&["store", &data, "--vkey", &vkey]);
    assert!(code == Some(0) && said.starts_with("trusted") && said.contains("working.verified"), "{said}");
}

#[test]
fn a_policy_names_the_log_and_asks_for_its_witnesses() {
    let log = Log::small();
    let (dir, data, _) = place(&log);
    let witness = WitnessVerifier::new("w.example", key(90).public()).unwrap();
    let policy = dir.path().join("policy");
    put(&policy, format!("log {}\nwitness w {witness}\nquorum w\n", log.verifier()).as_bytes());
    let policy = policy.display().to_string();
    let (code, said) = audit(&["store", &data, "--policy", &policy]);
    assert!(code == Some(10) && said.contains("policy.quorum.missing"), "{said}");
    let mut note = cairn_log::Note::parse(&log.checkpoint(8)).unwrap();
    note.signatures.push(cosign(&note.text, 1_700_000_000, "w.example", &key(90)).unwrap());
    put(&dir.path().join("data/registry/public/checkpoint"), note.to_string().as_bytes());
    let (code, said) = audit(&["store", &data, "--policy", &policy]);
    assert!(code == Some(0) && said.starts_with("trusted") && said.contains("2023-11-14T22:13:20Z"), "{said}");
}

#[test]
fn a_log_is_followed_until_it_forks_and_the_evidence_is_kept() {
    let mut log = Log::small();
    let (dir, data, vkey) = place(&log);
    let folder = Arc::new(Mutex::new(PathBuf::from(&data).join("registry/public")));
    let url = cairn_testkit::daemon::files::serve(folder.clone());
    let state = dir.path().join("state");
    let state_text = state.display().to_string();
    let follow = ["follow", &url, "--vkey", &vkey, "--state", &state_text, "--once"];
    let (code, said) = audit(&follow);
    assert!(code == Some(0) && said.contains("follow.first"), "{said}");
    let mut fork = log.clone();
    log.add(&log.record(RecordKind::Claim, 5, "town"), &[]);
    log.end_batch();
    log.write(Path::new(&data));
    let (code, said) = audit(&follow);
    assert!(code == Some(0) && said.contains("from size 8 to 10"), "{said}");
    let kept = std::fs::read_to_string(state.join("checkpoint")).unwrap();
    assert_eq!(kept, log.checkpoint(10));

    fork.add(&fork.record(RecordKind::Claim, 6, "elsewhere"), &[]);
    fork.end_batch();
    fork.end_batch();
    let forged = dir.path().join("forged");
    fork.write(&forged);
    *folder.lock().unwrap() = forged.join("registry/public");
    for _ in 0..2 {
        let (code, said) = audit(&follow);
        assert!(code == Some(20) && said.starts_with("contradiction"), "{said}");
    }
    assert_eq!(std::fs::read_to_string(state.join("checkpoint")).unwrap(), kept, "the first stays");
    let evidence = state.join("evidence/1").display().to_string();
    assert!(!state.join("evidence/2").exists());
    let (code, said) = audit(&["evidence", &evidence, "--vkey", &vkey]);
    assert!(code == Some(0) && said.starts_with("proven"), "{said}");
    put(&state.join("evidence/1/first"), b"x");
    assert_eq!(audit(&["evidence", &evidence, "--vkey", &vkey]).0, Some(1));
    // Out of reach is no verdict, and neither is a log without a key.
    let (code, said) = audit(&["follow", "http://127.0.0.1:1", "--vkey", &vkey, "--state", &state_text, "--once"]);
    assert_eq!(code, Some(2), "{said}");
    assert_eq!(audit(&["follow", &url, "--state", &state_text, "--once"]).0, Some(2));
}

/// The files that somebody may name by mistake where a public one belongs, each with what no message may say of it.
fn secrets(dir: &Path) -> Vec<(String, Vec<String>)> {
    let path = |name: &str| dir.join(name).display().to_string();
    // Plus signs part a verifier key: of the keys one that has them.
    let pem = (0..=255).map(|n| key(n).to_pem().unwrap()).find(|pem| pem.matches('+').count() > 1).unwrap();
    put(&dir.join("plain.key"), pem.as_bytes());
    for arguments in
        [["keys", "new-key-file", "unlock"].as_slice(), &["keys", "new", "sealed.key", "--key-file", "unlock"]]
    {
        let done = cairn_testkit::daemon::command().args(arguments).current_dir(dir).output().unwrap();
        assert!(done.status.success(), "{done:?}");
    }
    put(&dir.join("token"), b"PHf4cGxlYXNlZG9ub3RzYXl0aGlzYWxvdWQ\n");
    put(&dir.join("token.toml"), b"colour = \"PHf4cGxlYXNlZG9ub3RzYXl0aGlzYWxvdWQ\"\n");
    put(&dir.join("phrase"), b"donotsaythisaloud eversoquietly\n");
    let names = ["plain.key", "sealed.key", "unlock", "token", "token.toml", "phrase"];
    let words = |text: String| -> Vec<String> {
        let lines = text.lines().filter(|line| !line.starts_with("-----") && !line.starts_with("Public-Key: "));
        let words = lines.flat_map(|line| line.split(['+', ' ', '=', '"']).map(str::to_owned));
        words.filter(|word| word.len() > 11 && word != "cairn-key-file-v1").map(|word| word[..12].to_owned()).collect()
    };
    names.map(|name| (path(name), words(std::fs::read_to_string(dir.join(name)).unwrap()))).to_vec()
}

#[test]
fn no_message_quotes_a_secret_that_was_given_by_mistake() {
    let log = Log::small();
    let (dir, data, vkey) = place(&log);
    let (evidence, bundle) = (dir.path().join("evidence"), dir.path().join("bundle"));
    put(&evidence.join("first"), log.checkpoint(8).as_bytes());
    put(&evidence.join("second"), log.checkpoint(8).as_bytes());
    put(&bundle.join("record.json"), b"{}");
    let (evidence, bundle) = (evidence.display().to_string(), bundle.display().to_string());
    let state = dir.path().join("state").display().to_string();
    let absent = dir.path().join("absent").display().to_string();
    put(&dir.path().join("answer"), b"{}");
    let answer = dir.path().join("answer").display().to_string();
    let plain = dir.path().join("plain.key").display().to_string();
    let begun = dir.path().join("begun").display().to_string();
    assert!(cairn(&["owners", "vkey", "--data", &begun]).status.success());
    for (file, words) in secrets(dir.path()) {
        let f = file.as_str();
        assert!(!words.is_empty(), "{f}");
        for command in [
            &["audit", "bundle", &bundle, "--vkey", f][..],
            &["audit", "bundle", &bundle, "--policy", f],
            &["audit", "bundle", &bundle, "--log", f],
            &["audit", "answer", &answer, "--vkey", f],
            &["audit", "store", &data, "--vkey", f],
            &["audit", "store", &data, "--policy", f],
            &["audit", "evidence", &evidence, "--vkey", f],
            &["audit", "follow", "http://127.0.0.1:1", "--once", "--state", &state, "--vkey", f],
            &["audit", "follow", "http://127.0.0.1:1", "--once", "--state", &state, "--policy", f],
            &["scene", "list", "--data", &begun, "--config", f],
            &["scene", "list", "--connect", "https://127.0.0.1:1", "--tls-ca", f],
            &["owners", "answer", "town", "--data", &begun, "--out", &absent, "--as-of", f],
            &["witness", "serve", "--key", &plain, "--name", "w", "--folder", &absent, "--log", f],
            &["keys", "show", f],
            &["keys", "new", &absent, "--key-file", f],
        ] {
            let output = cairn(command);
            let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
            let told = words.iter().find(|word| said.contains(word.as_str()));
            assert!(told.is_none(), "{command:?} says {told:?}: {said}");
            // A key may be shown, and may seal another.
            if command[0] != "keys" {
                assert_eq!(output.status.code(), Some(2), "{command:?}: {said}");
            }
        }
        let _ = std::fs::remove_file(dir.path().join("absent"));
    }
    let (code, said) = audit(&["bundle", &bundle, "--vkey", &plain]);
    assert!(
        code == Some(2) && said.contains("this is a private key") && said.contains("`cairn owners vkey`"),
        "{said}"
    );
    let (code, said) = audit(&["bundle", &bundle, "--policy", &plain]);
    assert!(code == Some(2) && said.contains("this is a private key, not a policy"), "{said}");
    assert_eq!(audit(&["bundle", &bundle, "--vkey", &vkey]).0, Some(1));
}
