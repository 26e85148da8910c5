//! Signed notes and checkpoints against Go's documented example and the rules of C2SP.

use cairn_log::{Checkpoint, CheckpointError, Digest, Note, NoteError, NoteVerifier, OwnerKey};

/// The example of golang.org/x/mod/sumdb/note's documentation.
const PETER: &str = "PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW";
const PETERS_NOTE: &str = "If you think cryptography is the answer to your problem,\n\
    then you don't know what your problem is.\n\
    \n\
    \u{2014} PeterNeumann x08go/ZJkuBS9UG/SffcvIAQxVBtiFupLLr8pAcElZInNIuGUgYN1FFYC2pZSNXgKvqfqdngotpRZb6KE6RyyBwJnAM=\n";

fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

fn verifier(name: &str, number: u8) -> NoteVerifier {
    NoteVerifier::new(name, key(number).public()).unwrap()
}

#[test]
fn gos_example_verifies_and_is_written_the_same() {
    let peter: NoteVerifier = PETER.parse().unwrap();
    assert_eq!(peter.to_string(), PETER);
    let note = Note::parse(PETERS_NOTE).unwrap();
    assert_eq!(note.verify(std::slice::from_ref(&peter)).unwrap(), [&peter]);
    assert_eq!(note.to_string(), PETERS_NOTE);
    // The Go checksum database's key.
    let sum = "sum.golang.org+033de0ae+Ac4zctda0e5eza+HJyk9SxEdh+s3Ux18htTTAD8OuAn8";
    assert_eq!(sum.parse::<NoteVerifier>().unwrap().to_string(), sum);
}

#[test]
fn a_flipped_byte_anywhere_in_a_note_is_noticed() {
    let peter: NoteVerifier = PETER.parse().unwrap();
    for at in 0..PETERS_NOTE.len() {
        for bit in 0..8 {
            let mut bytes = PETERS_NOTE.as_bytes().to_vec();
            bytes[at] ^= 1 << bit;
            let Ok(text) = String::from_utf8(bytes) else { continue };
            let verified = Note::parse(&text).and_then(|n| n.verify(std::slice::from_ref(&peter)).map(drop));
            assert!(verified.is_err(), "byte {at} bit {bit}");
        }
    }
}

#[test]
fn the_text_ends_at_the_last_blank_line() {
    let mut note = Note::new("one\n\ntwo\n\n\u{2014} looks like a signature\n".into()).unwrap();
    note.sign("log", &key(1)).unwrap();
    let read = Note::parse(&note.to_string()).unwrap();
    assert_eq!(read, note);
    read.verify(&[verifier("log", 1)]).unwrap();
}

#[test]
fn unknown_signers_are_ignored_known_bad_ones_condemn() {
    let mut note = Note::new("text\n".into()).unwrap();
    note.sign("stranger", &key(9)).unwrap();
    note.sign("log", &key(1)).unwrap();
    note.sign("log", &key(1)).unwrap();
    let known = [verifier("log", 1), verifier("witness", 2)];
    assert_eq!(note.verify(&known).unwrap(), [&known[0]], "twice the same signer counts once");
    assert!(matches!(note.verify(&[verifier("witness", 2)]), Err(NoteError::NoneVerified { .. })));
    assert!(matches!(note.verify(&[]), Err(NoteError::NoneVerified { .. })));
    // Another key under the same name has another key id: unknown, not bad.
    assert!(matches!(note.verify(&[verifier("log", 3)]), Err(NoteError::NoneVerified { .. })));
    note.sign("witness", &key(2)).unwrap();
    note.signatures[3].signature[5] ^= 1;
    assert_eq!(note.verify(&known), Err(NoteError::BadSignature { name: "witness".into() }));
    assert_eq!(note.verify(&known[..1]).unwrap(), [&known[0]]);
}

#[test]
fn malformed_notes_are_refused() {
    let line = "\u{2014} log AAAAAAAA\n";
    for (text, why) in [
        (String::new(), "blank line"),
        ("text\n".into(), "blank line"),
        (format!("text{line}"), "blank line"),
        ("text\n\n".into(), "newline"),
        (format!("text\n\n{}", line.trim_end()), "newline"),
        (format!("te\u{1}xt\n\n{line}"), "control"),
        (format!("te\rxt\n\n{line}"), "control"),
        ("text\n\n- log AAAAAAAA\n".into(), "em dash"),
        ("text\n\n\u{2014} log\n".into(), "no blank"),
        ("text\n\n\u{2014} log AAAA!AAA\n".into(), "base64"),
        ("text\n\n\u{2014} log AAA=\n".into(), "key id"),
        ("text\n\n\u{2014} log AAAAAA==\n".into(), "without a signature"),
        (format!("text\n\n{}", line.repeat(101)), "101 signatures"),
        (format!("{}\n\n{line}", "x".repeat(1_000_001)), "at most"),
    ] {
        let refused = Note::parse(&text).unwrap_err().to_string();
        assert!(refused.contains(why), "{why}: {refused}");
    }
    for name in ["", "a b", "a+b", "a\u{a0}b", "a\tb"] {
        assert!(Note::new("t\n".into()).unwrap().sign(name, &key(1)).is_err(), "{name:?}");
    }
    assert!(Note::new("no newline".into()).is_err());
}

#[test]
fn malformed_vkeys_are_refused() {
    let weak = {
        let typed = [&[1][..], &[0; 32]].concat();
        let id = cairn_log::format::note::key_id("x", &typed);
        format!("x+{}+{}", hex::encode(id), base64::Engine::encode(&base64::engine::general_purpose::STANDARD, typed))
    };
    for (vkey, why) in [
        ("PeterNeumann+c74f20a3".to_owned(), "three parts"),
        (PETER.replace("c74f", "c74e"), "key id"),
        (PETER.replace("c74f20a3", "c74f20a"), "hexadecimal"),
        (PETER.replace("Peter", "Pet er"), "without blanks"),
        (PETER.replace("ARpc", "ARpd"), "key id"),
        (PETER.replace("ARpc", "AR!c"), "base64"),
        (weak, "small order"),
    ] {
        let refused = vkey.parse::<NoteVerifier>().unwrap_err().to_string();
        assert!(refused.contains(why), "{why}: {refused}");
    }
}

#[test]
fn a_checkpoint_goes_through_text_and_signature() {
    let mut checkpoint = Checkpoint::new("cairn.example/log", 20_852_163, Digest::of("root"));
    checkpoint.extensions.push("further line".into());
    let text = checkpoint.to_text();
    let root = Digest::of("root").to_base64();
    assert_eq!(text, format!("cairn.example/log\n20852163\n{root}\nfurther line\n"));
    assert_eq!(Checkpoint::parse_text(&text).unwrap(), checkpoint);
    let note = checkpoint.sign(&key(1)).unwrap().to_string();
    assert_eq!(Checkpoint::verify(&note, &verifier("cairn.example/log", 1)).unwrap(), checkpoint);
    let refused = Checkpoint::verify(&note, &verifier("other.example/log", 1)).unwrap_err();
    assert!(matches!(refused, CheckpointError::Origin { .. }), "{refused}");
    // The log's key over a text that names another origin.
    let mut foreign = Note::new(Checkpoint::new("other.example/log", 1, Digest::of("root")).to_text()).unwrap();
    foreign.sign("cairn.example/log", &key(1)).unwrap();
    let refused = Checkpoint::verify(&foreign.to_string(), &verifier("cairn.example/log", 1)).unwrap_err();
    assert!(matches!(refused, CheckpointError::Origin { .. }), "{refused}");
}

#[test]
fn malformed_checkpoints_name_the_line() {
    let root = Digest::of("root").to_base64();
    for (text, line) in [
        (format!("\n1\n{root}\n"), 1),
        ("log\n".to_owned(), 2),
        (format!("log\n01\n{root}\n"), 2),
        (format!("log\n+1\n{root}\n"), 2),
        (format!("log\n-1\n{root}\n"), 2),
        (format!("log\n18446744073709551616\n{root}\n"), 2),
        (format!("log\n \n{root}\n"), 2),
        ("log\n1\n".to_owned(), 3),
        ("log\n1\nAAAA\n".to_owned(), 3),
        (format!("log\n1\n{}\n", root.trim_end_matches('=')), 3),
        (format!("log\n1\n{root}\nx\n\n"), 5),
        (format!("log\n1\n{root}"), 1),
    ] {
        match Checkpoint::parse_text(&text) {
            Err(CheckpointError::Line { line: got, .. }) => assert_eq!(got, line, "{text:?}"),
            other => panic!("{text:?}: {other:?}"),
        }
    }
    assert!(Checkpoint::parse_text(&format!("log\n18446744073709551615\n{root}\n")).is_ok());
}
