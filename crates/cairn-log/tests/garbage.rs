//! Hostile input: every reader is fed mutations of good input and noise. It may refuse; it may not panic, nor allocate
//! more than a stated multiple of what it was given, and what it takes it must write back to something that it reads the same.

mod targets;

use cairn_log::{
    Answer, Checkpoint, CheckpointError, Digest, Envelope, Note, OwnerRecord, TlogProof,
    format::{
        answer::{AnswerError, MAX_ANSWER_BYTES},
        dsse::MAX_ENVELOPE_BYTES,
        note::MAX_NOTE_BYTES,
    },
};
use cairn_testkit::{Counting, Limit, attack, attack_with, cases, peak_of, samples};
use targets::{TARGETS, Target, envelope, target};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn try_one(name: &str) {
    let Target { name, good, limit: (times, plus), read } = *target(name);
    let good = good();
    let good: Vec<&[u8]> = good.iter().map(Vec::as_slice).collect();
    attack(name, &good, Limit { times, plus }, read);
}

/// One test a target, so that they run side by side and are named when they fail.
macro_rules! attacked {
    ($($test:ident: $name:literal),* $(,)?) => {
        $(#[test]
        fn $test() {
            try_one($name);
        })*

        #[test]
        fn no_target_is_left_out() {
            let tried = [$($name),*];
            assert_eq!(TARGETS.map(|target| target.name), tried);
        }
    };
}

attacked! {
    notes: "note",
    checkpoints: "checkpoint",
    tlog_proofs: "tlog-proof",
    tile_paths: "tile path",
    entry_bundles: "entry bundle",
    envelopes: "DSSE envelope",
    owner_records: "owner record",
    leaves: "leaf",
    vkeys: "vkey",
    public_keys: "public key",
    key_files: "key file",
    packs: "pack",
    map_proofs: "map proof",
    complete_answers: "complete answer",
    map_lists: "map list",
}

/// Not a multiple any more but a bound: beyond the largest input that is read, nothing is allocated for it.
#[test]
fn what_is_too_large_is_refused_by_its_length_alone() {
    let large = vec![b' '; MAX_ANSWER_BYTES + 1];
    let (refused, peak) = peak_of(|| Answer::parse(&large));
    assert_eq!(refused, Err(AnswerError::TooLarge { got: MAX_ANSWER_BYTES + 1 }));
    assert!(peak < 4096, "{peak} bytes for an answer that is too large");
    for length in [MAX_ENVELOPE_BYTES + 1, 32 << 20] {
        let json = [br#"{"payload":""#.as_slice(), &vec![b'A'; length]].concat();
        attack_with(
            "large envelope",
            &[&json],
            1,
            |_| 4096,
            |b| assert!(b.len() < length || Envelope::parse(b).is_err()),
        );
        let note = format!("log\n1\n{}\n\n\u{2014} log AAAAAAAA\n", "x".repeat(length.max(MAX_NOTE_BYTES)));
        let note_bound = |length| if length > MAX_NOTE_BYTES { 4096 } else { 12 * length + 8192 };
        attack_with("large note", &[note.as_bytes()], 1, note_bound, |b| {
            let _ = std::str::from_utf8(b).map(Note::parse);
        });
    }
}

/// Lists whose elements are refused, or that are too long, are not built first.
#[test]
fn lists_are_refused_before_they_are_built() {
    let newlines = format!("log\n1\n{}\n{}", Digest::of("root").to_base64(), "\n".repeat(500_000));
    let (refused, peak) = peak_of(|| Checkpoint::parse_text(&newlines));
    assert!(matches!(refused, Err(CheckpointError::Line { line: 4, .. })), "{refused:?}");
    assert!(peak < 4096, "{peak} bytes for lines that are refused");
    let signatures = format!("text\n\n{}", "\u{2014} a AAAAAAA=\n".repeat(40_000));
    let (refused, peak) = peak_of(|| Note::parse(&signatures));
    assert!(refused.unwrap_err().to_string().contains("40000 signatures"));
    assert!(peak < 4096, "{peak} bytes for signatures that are refused");
}

#[test]
fn a_mutated_record_is_never_taken_for_the_owners() {
    let good = envelope();
    let json = good.to_json();
    let mut opened = 0;
    for input in samples("mutated record", &[json.as_bytes()]).take(2 * cases() as usize) {
        let Ok(envelope) = Envelope::parse(&input) else { continue };
        if let Ok((record, _)) = OwnerRecord::open(&envelope) {
            opened += 1;
            assert_eq!((&envelope.payload, &envelope.payload_type), (&good.payload, &good.payload_type));
            assert_eq!(Ok(record), OwnerRecord::parse(&good.payload));
        }
    }
    assert!(opened > 0, "mutations of labels leave the record as it is");
}

#[test]
fn mutations_are_taken_and_refused() {
    // Were all refused, or all taken, the attacks above would try one half of the readers only.
    let count = |name: &str, read: fn(&[u8]) -> bool| {
        let good = (target(name).good)();
        let good: Vec<&[u8]> = good.iter().map(Vec::as_slice).collect();
        let taken = samples(name, &good).take(1000).filter(|input| read(input)).count();
        assert!((10..990).contains(&taken), "{name}: {taken} of 1000 taken");
    };
    count("note", |b| std::str::from_utf8(b).is_ok_and(|t| Note::parse(t).is_ok()));
    count("tlog-proof", |b| std::str::from_utf8(b).is_ok_and(|t| TlogProof::parse(t).is_ok()));
    count("DSSE envelope", |b| Envelope::parse(b).is_ok());
    count("owner record", |b| OwnerRecord::parse(b).is_ok());
}
