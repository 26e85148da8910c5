//! Policies: what is read, what is refused and on which line, and what quorums say of times.

use super::*;
use crate::format::note::Note;
use crate::format::{cosignature::cosign, digest::Digest, key::OwnerKey};

const ORIGIN: &str = "log.example/owners";

fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

fn log_vkey(number: u8) -> String {
    NoteVerifier::new(ORIGIN, key(number).public()).unwrap().to_string()
}

fn witness_vkey(number: u8) -> String {
    WitnessVerifier::new(&format!("w{number}"), key(number).public()).unwrap().to_string()
}

/// The example of the specification: two of three X, any of three Y, both groups.
fn example() -> String {
    let mut text = format!("# of tlog-policy\n\nlog {}\n", log_vkey(100));
    for (name, number) in [("X1", 1), ("X2", 2), ("X3", 3), ("Y1", 4), ("Y2", 5), ("Y3", 6)] {
        text += &format!("\twitness {name}  {} https://{name}.example/ \n", witness_vkey(number));
    }
    text + "group X-witnesses 2 X1 X2 X3\ngroup Y-witnesses any Y1 Y2 Y3\n\
            group X-and-Y all X-witnesses Y-witnesses\nquorum X-and-Y\n"
}

/// A checkpoint of the log with cosignatures: (witness, time).
fn note(cosigned: &[(u8, u64)]) -> Note {
    let mut note = Checkpoint::new(ORIGIN, 5, Digest::of("root")).sign(&key(100)).unwrap();
    for (number, time) in cosigned {
        note.signatures.push(cosign(&note.text, *time, &format!("w{number}"), &key(*number)).unwrap());
    }
    note
}

fn judge(policy: &str, cosigned: &[(u8, u64)]) -> Quorum {
    Policy::parse(policy).unwrap().check(&note(cosigned).to_string()).unwrap().quorum
}

#[test]
fn the_example_is_read() {
    let policy = Policy::parse(example()).unwrap();
    assert_eq!(policy.logs()[0].verifier.to_string(), log_vkey(100));
    assert_eq!(policy.logs()[0].url, None);
    let names: Vec<_> = policy.witnesses().iter().map(|w| w.name.as_str()).collect();
    assert_eq!(names, ["X1", "X2", "X3", "Y1", "Y2", "Y3"]);
    assert_eq!(policy.witnesses()[0].url.as_deref(), Some("https://X1.example/"));
    let verdict = policy.check(&note(&[(1, 30), (3, 10), (5, 20)]).to_string()).unwrap();
    assert_eq!(verdict.checkpoint, Checkpoint::new(ORIGIN, 5, Digest::of("root")));
    assert_eq!(verdict.cosigned, [("X1".into(), 30), ("X3".into(), 10), ("Y2".into(), 20)]);
    assert_eq!(verdict.missing, ["X2", "Y1", "Y3"]);
    assert_eq!(verdict.quorum, Quorum::Complete { not_later_than: 30 });
}

#[test]
fn a_quorum_is_complete_at_the_kth_smallest_time() {
    let complete = |not_later_than| Quorum::Complete { not_later_than };
    for (cosigned, expected) in [
        (&[][..], Quorum::Incomplete),
        (&[(1, 10)], Quorum::Incomplete),
        (&[(1, 10), (2, 20)], Quorum::Incomplete),
        (&[(4, 5), (5, 6), (6, 7)], Quorum::Incomplete),
        (&[(1, 10), (2, 20), (4, 5)], complete(20)),
        (&[(1, 10), (2, 20), (4, 50)], complete(50)),
        // The third witness makes a late second one unnecessary, the second Y a late first one.
        (&[(1, 10), (2, 90), (3, 12), (4, 50), (5, 11)], complete(12)),
        // Of one witness's lines the earliest counts.
        (&[(1, 99), (1, 10), (2, 20), (4, 5)], complete(20)),
        // Strangers count for nothing.
        (&[(1, 10), (7, 20), (4, 5)], Quorum::Incomplete),
    ] {
        assert_eq!(judge(&example(), cosigned), expected, "{cosigned:?}");
    }
    let none = format!("log {}\nquorum none", log_vkey(100));
    assert_eq!(judge(&none, &[(1, 10)]), Quorum::NotRequired);
    assert!(judge(&none, &[]).holds() && judge(&none, &[]).not_later_than().is_none());
    let one = format!("log {}\nwitness none-such {}\nquorum none-such\n", log_vkey(100), witness_vkey(1));
    assert_eq!((judge(&one, &[(1, 7)]), judge(&one, &[(2, 7)])), (complete(7), Quorum::Incomplete));
}

#[test]
fn what_no_policy_judges() {
    let policy = Policy::parse(example()).unwrap();
    let good = note(&[(1, 10), (2, 20), (4, 5)]);
    // A known witness's bad line condemns the note, even where the others would do.
    let mut forged = good.clone();
    forged.signatures.push(cosign(&good.text.replace('5', "6"), 9, "w6", &key(6)).unwrap());
    assert!(matches!(policy.check(&forged.to_string()), Err(PolicyCheckError::Cosignature(_))));
    // So does the log's.
    let mut forged = good.clone();
    forged.signatures[0].signature[0] ^= 1;
    assert!(matches!(policy.check(&forged.to_string()), Err(PolicyCheckError::Checkpoint(_))));
    let mut unsigned = good.clone();
    unsigned.signatures.remove(0);
    assert!(matches!(policy.check(&unsigned.to_string()), Err(PolicyCheckError::Checkpoint(_))));
    let other = Checkpoint::new("other.example", 5, Digest::of("root")).sign(&key(100)).unwrap();
    let error = policy.check(&other.to_string()).unwrap_err();
    assert!(error.to_string().contains("other.example") && error.to_string().contains(ORIGIN), "{error}");
    assert!(policy.check("no note").is_err());
    // Without logs of its own a policy judges for a caller that knows its log.
    let bare = Policy::parse(format!("witness a {}\nquorum a", witness_vkey(1))).unwrap();
    assert!(matches!(bare.check(&good.to_string()), Err(PolicyCheckError::UnknownLog { .. })));
    let log = NoteVerifier::new(ORIGIN, key(100).public()).unwrap();
    assert_eq!(bare.check_under(&good.to_string(), &[log]).unwrap().quorum.not_later_than(), Some(10));
}

#[test]
fn refusals_name_the_line() {
    let (w1, w2) = (witness_vkey(1), witness_vkey(2));
    let renamed = WitnessVerifier::new("else", key(1).public()).unwrap();
    let two = format!("witness a {w1}\nwitness b {w2}\n");
    for (text, line, part) in [
        ("colour red\n".into(), 1, "no keyword"),
        ("\n\nquorum\n".into(), 3, "quorum <name>"),
        ("quorum none\nquorum none\n".into(), 2, "second quorum"),
        ("quorum x\n".into(), 1, "\"x\""),
        ("quorum none more\n".into(), 1, "quorum"),
        ("log x\nquorum none\n".into(), 1, "three parts"),
        (format!("log {w1}\n"), 1, "key type"),
        (format!("witness a {}\n", log_vkey(1)), 1, "key type"),
        (format!("witness a {w1} url more\n"), 1, "witness <name>"),
        (format!("witness none {w1}\n"), 1, "reserved"),
        (format!("witness a {w1}\nwitness a {w2}\n"), 2, "defined already"),
        (format!("witness a {w1}\nwitness b {renamed}\n"), 2, "public key already"),
        (format!("log {0}\nlog {0}\n", log_vkey(9)), 2, "public key already"),
        (format!("{two}group g any\n"), 3, "at least one member"),
        (format!("{two}group g 0 a b\n"), 3, "1 to 2"),
        (format!("{two}group g 3 a b\n"), 3, "1 to 2"),
        (format!("{two}group g +1 a b\n"), 3, "threshold"),
        (format!("{two}group g 99999999999999999999 a b\n"), 3, "threshold"),
        (format!("{two}group g any a c\n"), 3, "\"c\""),
        (format!("{two}group g any g\n"), 3, "\"g\""),
        (format!("{two}group g any none\n"), 3, "\"none\""),
        (format!("{two}group g any a a\n"), 3, "listed once"),
        (format!("{two}group g any a\ngroup h any a b\n"), 4, "listed once"),
        (format!("{two}group a any b\n"), 3, "defined already"),
        (format!("group g any a\n{two}"), 1, "\"a\""),
        ("quorum none\r\n".into(), 1, "0x0d"),
        ("# bell \u{7}\n".into(), 1, "0x07"),
        ("# delete \u{7f}\n".into(), 1, "0x7f"),
    ] {
        match Policy::parse(&text) {
            Err(PolicyError::Line { line: got, what }) => {
                assert_eq!(got, line, "{text}");
                assert!(what.contains(part), "{text} gave {what}");
            }
            other => panic!("{text} gave {other:?}"),
        }
    }
    let long = Policy::parse("x".repeat(100_000)).unwrap_err().to_string();
    assert!(long.len() < 1000, "an error of {} bytes", long.len());
    assert_eq!(Policy::parse(&two), Err(PolicyError::NoQuorum));
    let large = vec![b'\n'; MAX_POLICY_BYTES + 1];
    assert_eq!(Policy::parse(&large), Err(PolicyError::TooLarge { got: large.len() }));
}

#[test]
fn names_are_octets() {
    let lines = |name: &[u8]| {
        let (first, second) = (format!(" {}\nwitness ", witness_vkey(1)), format!(" {}\n", witness_vkey(2)));
        [b"witness K", first.as_bytes(), name, second.as_bytes(), b"quorum ", name, b"\n"].concat()
    };
    // The Kelvin sign is not the letter, and what is no UTF-8 is a name all the same.
    for name in [&b"\xe2\x84\xaa"[..], b"\xff\xfe"] {
        let policy = Policy::parse(lines(name)).unwrap();
        assert_eq!(policy.quorum, Some(Member::Witness(1)));
    }
    assert!(Policy::parse(lines(b"K")).is_err());
}

#[test]
fn deep_nesting_is_no_deep_recursion() {
    let mut text = format!("log {}\nwitness g0 {}\n", log_vkey(100), witness_vkey(1));
    for i in 0..5_000 {
        text += &format!("group g{} any g{i}\n", i + 1);
    }
    assert_eq!(judge(&(text + "quorum g5000"), &[(1, 3)]), Quorum::Complete { not_later_than: 3 });
}
