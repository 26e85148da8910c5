//! The same verdicts from another language: `verify_bundle.py`, written from the public formats alone, and Cairn judge
//! each other's bundles, the same spoilt ones, and the same published cases.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use cairn_log::{Note, NoteVerifier, PublicKey};
use cairn_testkit::daemon::Place;
use cairn_verify::{Evidence, Outcome, audit};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/verify_bundle.py");

/// Files of a bundle that are spoilt.
const FILES: [&str; 2] = ["record.json", "record.tlog-proof"];

/// Bits that are flipped in a bundle, each judged by both.
const FLIPS: usize = 12;

/// Python with what the script needs, or a visible line that the test was skipped.
fn python(test: &str) -> Option<&'static str> {
    let there = Command::new("python3").args(["-c", "import cryptography"]).output();
    if there.is_ok_and(|output| output.status.success()) {
        return Some("python3");
    }
    println!("SKIPPED {test}: no python3 with the package `cryptography`");
    None
}

/// Runs the script; its exit code is 0 or 1, anything else is a fault of its own.
fn script(python: &str, arguments: &[&str]) -> Output {
    let output = Command::new(python).arg("-B").arg(SCRIPT).args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 1)) && !said.contains("Traceback"), "{arguments:?}: {said}");
    output
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Cairn's own verdict on the files of a bundle.
fn ours(bundle: &Path, pinned: &NoteVerifier) -> Outcome {
    let envelope = fs::read(bundle.join(FILES[0])).unwrap();
    // The command refuses a file that is no text before anything is audited.
    let Ok(proof) = String::from_utf8(fs::read(bundle.join(FILES[1])).unwrap()) else { return Outcome::Invalid };
    let evidence = Evidence { envelope: &envelope, proof: Some(&proof), pinned: Some(pinned), ..Evidence::default() };
    audit(&evidence).outcome
}

fn pinned(file: &Path) -> NoteVerifier {
    fs::read_to_string(file).unwrap().trim().parse().unwrap()
}

/// Flips bits all over the bundle: both must say the same of each, and neither takes a changed body or proof.
fn agree_on_flipped_bits(python: &str, bundle: &Path, vkey: &Path) {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut refused = 0;
    for _ in 0..FLIPS {
        let path = bundle.join(FILES[random.next_u32() as usize % FILES.len()]);
        let good = fs::read(&path).unwrap();
        let (at, bit) = (random.random_range(0..good.len()), random.random_range(0..7));
        let mut bytes = good.clone();
        bytes[at] ^= 1 << bit;
        fs::write(&path, &bytes).unwrap();
        let theirs = script(python, &[bundle.to_str().unwrap(), "--vkey", vkey.to_str().unwrap()]);
        let ours = ours(bundle, &pinned(vkey));
        let taken = theirs.status.success();
        assert_eq!(taken, ours != Outcome::Invalid, "{} byte {at} bit {bit}: {}", path.display(), said(&theirs));
        refused += usize::from(!taken);
        fs::write(&path, good).unwrap();
    }
    assert!(refused > FLIPS / 2, "only {refused} of {FLIPS} flipped bits were noticed");
}

#[test]
fn a_bundle_made_here_verifies_in_python_and_a_changed_one_does_not() {
    let Some(python) = python("a_bundle_made_here_verifies_in_python_and_a_changed_one_does_not") else { return };
    let place = Place::new();
    let (data, key, bundle) = (place.text("data"), place.text("ada.key"), place.path("bundle"));
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
    place.cairn_ok(&["keys", "new", &key, "--plain"]);
    let (folder, vkey) = (place.text("bundle"), place.text("pinned.vkey"));
    let sign = ["owners", "sign", "town", "--identity", "1", "--key", &key, "--kind", "contribution", "--data", &data];
    // A second record, so that the first one's proof has hashes.
    place.cairn_ok(&[&sign[..], &["--out", &place.text("before")]].concat());
    place.cairn_ok(&[&sign[..], &["--out", &folder]].concat());
    place.cairn_ok(&["owners", "vkey", "--data", &data, "--out", &vkey]);

    let good = script(python, &[&folder, "--vkey", &vkey]);
    assert!(good.status.success(), "{}", said(&good));
    for code in ["checkpoint", "owner", "registry", "inclusion"] {
        assert!(said(&good).contains(&format!("ok   {code}: ")), "{}", said(&good));
    }
    assert_ne!(ours(&bundle, &pinned(Path::new(&vkey))), Outcome::Invalid);
    agree_on_flipped_bits(python, &bundle, Path::new(&vkey));

    let refuses = |arguments: &[&str], code: &str| {
        let output = script(python, arguments);
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        assert!(said(&output).contains(&format!("BAD  {code}: ")), "{code}: {}", said(&output));
    };
    // Nobody cosigned it; another log's key; the proof of the other record.
    refuses(&[&folder, "--vkey", &vkey, "--quorum", "1"], "quorum");
    let other = NoteVerifier::new("another/log", cairn_log::OwnerKey::from_seed(&[9; 32]).public()).unwrap();
    fs::write(place.path("other.vkey"), other.to_string()).unwrap();
    refuses(&[&folder, "--vkey", &place.text("other.vkey")], "checkpoint-signature");
    fs::copy(bundle.join(FILES[1]), place.path("before").join(FILES[1])).unwrap();
    refuses(&[&place.text("before"), "--vkey", &vkey], "proof");
}

#[test]
fn a_bundle_made_in_python_verifies_here_and_a_changed_one_does_not() {
    let Some(python) = python("a_bundle_made_in_python_verifies_here_and_a_changed_one_does_not") else { return };
    let place = tempfile::tempdir().unwrap();
    let bundle = place.path().join("bundle");
    let folder = bundle.to_str().unwrap();
    assert!(script(python, &["--make", folder]).status.success());
    let vkey = bundle.join("log.vkey");
    assert_eq!(ours(&bundle, &pinned(&vkey)), Outcome::Trusted);
    let witnesses: Vec<String> = [1, 2].map(|n| format!("{folder}/witness-{n}.vkey")).into();
    let ask = [folder, "--vkey", vkey.to_str().unwrap(), "--quorum", "2", "--witness", &witnesses[0]];
    assert!(!script(python, &ask).status.success(), "one known witness is no quorum of two");
    assert!(script(python, &[&ask[..], &["--witness", &witnesses[1]]].concat()).status.success());
    agree_on_flipped_bits(python, &bundle, &vkey);
    for witness in &witnesses {
        cosignature_holds(&bundle.join(FILES[1]), Path::new(witness));
    }
    // Another seed is another log.
    let other = place.path().join("other");
    assert!(script(python, &["--make", other.to_str().unwrap(), "--seed", "another"]).status.success());
    assert_eq!(ours(&other, &pinned(&vkey)), Outcome::Invalid);
}

/// C2SP tlog-cosignature: key type 4, the signature behind the time, over the time and the text.
fn cosignature_holds(proof: &Path, vkey: &Path) {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let vkey = fs::read_to_string(vkey).unwrap();
    let (name, key) = (vkey.split('+').next().unwrap(), vkey.trim().splitn(3, '+').nth(2).unwrap());
    let typed = STANDARD.decode(key).unwrap();
    assert_eq!(typed[0], 4);
    let key = PublicKey::from_bytes(typed[1..].try_into().unwrap()).unwrap();
    let proof = fs::read_to_string(proof).unwrap();
    let note = Note::parse(proof.split_once("\n\n").unwrap().1).unwrap();
    let line = note.signatures.iter().find(|s| s.name == name).unwrap();
    assert_eq!(line.key_id, cairn_log::format::note::key_id(name, &typed));
    let (time, signature) = line.signature.split_first_chunk::<8>().unwrap();
    let message = |time| format!("cosignature/v1\ntime {time}\n{}", note.text);
    let time = u64::from_be_bytes(*time);
    key.verify(message(time).as_bytes(), signature).unwrap();
    key.verify(message(time + 1).as_bytes(), signature).unwrap_err();
}

#[test]
fn python_agrees_on_the_published_merkle_cases() {
    let test = "python_agrees_on_the_published_merkle_cases";
    let Some(python) = python(test) else { return };
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/vectors");
    let folder = std::env::var_os("CAIRN_VECTORS").map_or_else(|| beside.into(), PathBuf::from).join("merkle");
    if !folder.is_dir() {
        println!("SKIPPED {test}: no vectors at {}", folder.display());
        return;
    }
    let output = script(python, &["--vectors", folder.to_str().unwrap()]);
    assert_eq!(said(&output), "98 inclusion and 98 consistency cases, 1 with stand-ins\n");
    assert!(output.status.success());
}

#[test]
fn python_agrees_on_signatures_that_verifiers_disagree_on() {
    let Some(python) = python("python_agrees_on_signatures_that_verifiers_disagree_on") else { return };
    let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("{b:02x}")).collect::<String>();
    let case = |e: &crate::edges::Edge| serde_json::json!({"message": hex(&e.message), "pub_key": hex(&e.key), "signature": hex(&e.signature)});
    let cases: Vec<_> = crate::edges::edges().iter().map(case).collect();
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), serde_json::to_vec(&cases).unwrap()).unwrap();
    let output = script(python, &["--signatures", file.path().to_str().unwrap()]);
    assert_eq!(said(&output).trim(), crate::edges::STRICT);
}
