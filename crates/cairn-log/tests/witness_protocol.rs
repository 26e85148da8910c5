//! `add-checkpoint`, status by status (C2SP tlog-witness), what is remembered, and what is kept as evidence.

use crate::witness_common::{Hands, Log, NAME, NOW, ORIGIN, ask, cosignature, key, log_verifier, names, open};
use cairn_log::witness::{AddCheckpoint, OpenError, Witness, request::MAX_BODY_BYTES};
use cairn_log::{Checkpoint, Digest, Note, NoteVerifier};

fn conflict(size: u64) -> cairn_log::witness::Response {
    cairn_log::witness::Response { status: 409, content_type: "text/x.tlog.size", body: format!("{size}\n") }
}

#[test]
fn a_log_that_grows_is_cosigned() {
    let dir = tempfile::tempdir().unwrap();
    let (log, hands) = (Log::new(40, 0), Hands::new());
    let witness = open(dir.path(), &hands).unwrap();
    assert_eq!(witness.latest(&Digest::of(ORIGIN)), None);
    // The empty log too; and the same size again, at a later time.
    for (step, (old, size)) in [(0, 0), (0, 0), (0, 3), (3, 3), (3, 4), (4, 17), (17, 40)].into_iter().enumerate() {
        let time = NOW + step as u64;
        hands.set(time);
        let request = log.request(old, size);
        let answer = ask(&witness, &request);
        assert_eq!(answer.content_type, "text/plain; charset=utf-8");
        assert_eq!(cosignature(&witness, &request, &answer).time, time);
        // What monitors get carries both signatures.
        let latest = witness.latest(&Digest::of(ORIGIN)).unwrap();
        assert_eq!(Checkpoint::verify(&latest, &log_verifier()).unwrap().size, size);
        assert_eq!(witness.verifier().find(&Note::parse(&latest).unwrap()).unwrap().unwrap().time, time);
    }
    assert_eq!(witness.latest(&Digest::of("other")), None);
    assert_eq!(names(&dir.path().join("evidence")), Vec::<String>::new());
}

#[test]
fn each_refusal_has_its_status() {
    let dir = tempfile::tempdir().unwrap();
    let (log, hands) = (Log::new(40, 0), Hands::new());
    let witness = open(dir.path(), &hands).unwrap();
    let good = log.request(0, 10);
    let status = |request: &AddCheckpoint| ask(&witness, request).status;
    let note = |text: &str| AddCheckpoint { note: text.into(), ..good.clone() };
    let signed = |checkpoint: Checkpoint, number| note(&checkpoint.sign(&key(number)).unwrap().to_string());
    let ten = || Checkpoint::new(ORIGIN, 10, log.root(10));

    // Malformed.
    assert_eq!(witness.add_checkpoint(b"").status, 400);
    assert_eq!(witness.add_checkpoint(b"old 1\n").status, 400);
    assert_eq!(status(&note("")), 400);
    assert_eq!(status(&note("no checkpoint\n\n\u{2014} x AAAAAAAA\n")), 400);
    assert_eq!(status(&note(&good.note.replace("\n10\n", "\n010\n"))), 400);
    assert_eq!(status(&note(good.note.trim_end())), 400);
    assert_eq!(status(&AddCheckpoint { old: 11, ..good.clone() }), 400);
    assert_eq!(witness.add_checkpoint(&vec![b'x'; MAX_BODY_BYTES + 1]).status, 413);
    // Unknown log; nobody trusted signed; a trusted key's signature that does not hold, beside one that does.
    assert_eq!(status(&signed(Checkpoint::new("other", 10, log.root(10)), 1)), 404);
    let long = ask(&witness, &signed(Checkpoint::new("x".repeat(100_000), 10, log.root(10)), 1));
    assert!(long.status == 404 && long.body.len() < 1000, "an answer does not echo without end");
    assert_eq!(status(&signed(ten(), 9)), 403);
    let mut twice = Note::parse(&good.note).unwrap();
    twice.signatures.push(twice.signatures[0].clone());
    twice.signatures[1].signature[3] ^= 1;
    assert_eq!(status(&note(&twice.to_string())), 403);
    // An empty tree with a root, a proof from nothing.
    assert_eq!(status(&signed(Checkpoint::new(ORIGIN, 0, log.root(10)), 1)), 422);
    assert_eq!(status(&AddCheckpoint { proof: vec![Digest::of("x")], ..good.clone() }), 422);
    // None of this was remembered, or is evidence of anything.
    assert_eq!(names(&dir.path().join("logs")), Vec::<String>::new());
    assert_eq!(ask(&witness, &log.request(3, 10)), conflict(0));

    assert_eq!(status(&good), 200);
    assert_eq!(ask(&witness, &good), conflict(10), "old 0 tells the size");
    assert_eq!(ask(&witness, &log.request(9, 12)), conflict(10));
    assert_eq!(ask(&witness, &log.request(4, 4)), conflict(10), "never back");
    assert_eq!(status(&log.request(10, 9)), 400);
    assert_eq!(status(&AddCheckpoint { proof: vec![Digest::of("x")], ..log.request(10, 10) }), 422);
    let unknown_too = AddCheckpoint {
        note: good.note.clone() + "\u{2014} stranger AAAAAAAA\n\u{2014} log.example/owners AAAAAAAA\n",
        ..log.request(10, 10)
    };
    assert_eq!(status(&unknown_too), 200, "strangers' lines are ignored");
    assert!(!witness.latest(&Digest::of(ORIGIN)).unwrap().contains("stranger"));
    assert_eq!(names(&dir.path().join("evidence")), Vec::<String>::new());
}

#[test]
fn a_fork_is_refused_and_both_sides_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let (log, fork, hands) = (Log::new(40, 0), Log::new(7, 1), Hands::new());
    let witness = open(dir.path(), &hands).unwrap();
    assert_eq!(ask(&witness, &log.request(0, 10)).status, 200);
    let evidence = || names(&dir.path().join("evidence"));
    // Another root for the size that was cosigned, whatever the old size; the same fork is kept once.
    for old in [10, 3, 10] {
        assert_eq!(ask(&witness, &fork.request(old, 10)), conflict(10));
        assert_eq!(evidence().len(), 1);
    }
    // A larger tree that does not begin with it: the fork's own proof, and one that is made up.
    for proof in [fork.proof(10, 12), Vec::new()] {
        let answer = ask(&witness, &AddCheckpoint { proof, ..fork.request(10, 12) });
        assert_eq!(answer.status, 422, "{answer:?}");
        assert_eq!(evidence().len(), 2);
    }
    let read = |prefix: &str| -> serde_json::Value {
        let name = evidence().into_iter().find(|name| name.starts_with(prefix)).unwrap();
        serde_json::from_slice(&std::fs::read(dir.path().join("evidence").join(name)).unwrap()).unwrap()
    };
    for (kind, size) in [("fork", 10), ("unproven", 12)] {
        let file = read(kind);
        assert_eq!((&file["format_version"], &file["kind"]), (&1.into(), &kind.into()));
        let side = |name: &str| Checkpoint::verify(file[name].as_str().unwrap(), &log_verifier()).unwrap();
        assert_eq!((side("cosigned").size, side("cosigned").root), (10, log.root(10)));
        assert_eq!((side("submitted").size, side("submitted").root), (size, fork.root(size)));
    }
    // The log itself goes on; after a restart the evidence is still kept once.
    assert_eq!(ask(&witness, &log.request(10, 12)).status, 200);
    drop(witness);
    let witness = open(dir.path(), &hands).unwrap();
    assert_eq!(ask(&witness, &fork.request(12, 12)), conflict(12));
    assert_eq!(evidence().len(), 3);
    drop(witness);
    assert_eq!(ask(&open(dir.path(), &hands).unwrap(), &fork.request(12, 12)), conflict(12));
    assert_eq!(evidence().len(), 3);
}

#[test]
fn a_restart_remembers_and_a_spoilt_memory_stops_it() {
    let dir = tempfile::tempdir().unwrap();
    let (log, hands) = (Log::new(40, 0), Hands::new());
    let witness = open(dir.path(), &hands).unwrap();
    assert_eq!(ask(&witness, &log.request(0, 10)).status, 200);
    let kept = witness.latest(&Digest::of(ORIGIN));
    drop(witness);
    let witness = open(dir.path(), &hands).unwrap();
    assert_eq!(witness.latest(&Digest::of(ORIGIN)), kept);
    assert_eq!(ask(&witness, &log.request(0, 12)), conflict(10));
    drop(witness);

    let file = dir.path().join("logs").join(&names(&dir.path().join("logs"))[0]);
    let good = std::fs::read_to_string(&file).unwrap();
    let reopened = |text: &str| {
        std::fs::write(&file, text).unwrap();
        open(dir.path(), &hands).map(drop)
    };
    for (spoilt, says) in [
        (String::new(), "EOF"),
        (good.replace("\"format_version\": 1", "\"format_version\": 2"), "format version 2"),
        (good.replace("\"size\": 10", "\"size\": 9"), "9"),
        (good.replace(NAME, "witness.example/w2"), "not cosigned by"),
        (good.replace("\"size\"", "\"sise\""), "sise"),
        (good[..good.len() / 2].into(), "EOF"),
    ] {
        match reopened(&spoilt) {
            Err(OpenError::Memory { file, what }) => {
                assert!(file.starts_with("logs/") && what.contains(says), "{file}: {what}");
            }
            other => panic!("{spoilt} gave {other:?}"),
        }
    }
    reopened(&good).unwrap();
    // Another witness has no business in this folder.
    let other = Witness::open(dir.path(), "else", key(2), vec![log_verifier()]).map(drop);
    assert!(matches!(other, Err(OpenError::Memory { .. })), "{other:?}");
}

#[test]
fn what_no_witness_starts_with() {
    let dir = tempfile::tempdir().unwrap();
    let open = |name, number, logs| Witness::open(dir.path(), name, key(number), logs).map(drop);
    assert!(matches!(open("a b", 2, vec![log_verifier()]), Err(OpenError::Name(_))));
    assert!(matches!(open(NAME, 2, vec![]), Err(OpenError::NoLogs)));
    assert!(matches!(open(NAME, 1, vec![log_verifier()]), Err(OpenError::OwnKey { .. })));
}

#[test]
fn each_log_is_its_own_and_may_have_two_keys() {
    let dir = tempfile::tempdir().unwrap();
    let log = Log::new(40, 0);
    let renewed = NoteVerifier::new(ORIGIN, key(3).public()).unwrap();
    let second = NoteVerifier::new("second.example", key(4).public()).unwrap();
    let witness = Witness::open(dir.path(), NAME, key(2), vec![log_verifier(), renewed, second]).unwrap();
    assert_eq!(ask(&witness, &log.request(0, 10)).status, 200);
    let signed = |origin: &str, number, old, size| {
        let note = Checkpoint::new(origin, size, log.root(size)).sign(&key(number)).unwrap().to_string();
        AddCheckpoint { old, proof: log.proof(old, size), note }
    };
    assert_eq!(ask(&witness, &signed(ORIGIN, 3, 10, 11)).status, 200, "the renewed key");
    assert_eq!(ask(&witness, &signed("second.example", 3, 0, 5)).status, 403, "another log's key");
    assert_eq!(ask(&witness, &signed("second.example", 4, 0, 5)).status, 200);
    assert_eq!(ask(&witness, &signed(ORIGIN, 3, 5, 11)), conflict(11));
}

#[test]
fn cosignatures_never_go_back_in_time() {
    let dir = tempfile::tempdir().unwrap();
    let (log, hands) = (Log::new(40, 0), Hands::new());
    let witness = open(dir.path(), &hands).unwrap();
    assert_eq!(ask(&witness, &log.request(0, 3)).status, 200);
    hands.set(NOW - 60);
    let request = log.request(3, 4);
    let answer = ask(&witness, &request);
    assert_eq!(cosignature(&witness, &request, &answer).time, NOW, "held, where the step is small");
    hands.set(NOW - 61);
    assert_eq!(ask(&witness, &log.request(4, 5)).status, 500);
    hands.set(NOW + 1);
    assert_eq!(ask(&witness, &log.request(4, 5)).status, 200);
    let dir = tempfile::tempdir().unwrap();
    hands.set(0);
    assert_eq!(ask(&open(dir.path(), &hands).unwrap(), &log.request(0, 3)).status, 500, "a clock that was never set");
}

#[test]
fn racing_requests_never_roll_back() {
    let dir = tempfile::tempdir().unwrap();
    let (log, hands) = (Log::new(40, 0), Hands::new());
    let witness = open(dir.path(), &hands).unwrap();
    std::thread::scope(|scope| {
        for worker in 0..4_u64 {
            let (log, witness) = (&log, &witness);
            scope.spawn(move || {
                let mut old = 0;
                for size in (1..=40).filter(|size| size % 4 == worker || size % 3 == worker) {
                    // As a client does: on a conflict once more, from the size that the witness names.
                    for _ in 0..2 {
                        let answer = ask(witness, &log.request(old, size.max(old)));
                        if answer.status == 200 {
                            old = size.max(old);
                            // Whoever asks now is never told less than what was cosigned.
                            let latest = witness.latest(&Digest::of(ORIGIN)).unwrap();
                            assert!(Checkpoint::verify(&latest, &log_verifier()).unwrap().size >= old);
                            break;
                        }
                        assert_eq!(answer.status, 409, "{answer:?}");
                        let told: u64 = answer.body.trim().parse().unwrap();
                        assert!(told >= old, "cosigned {old}, now told {told}");
                        old = told;
                    }
                }
            });
        }
    });
    let size = |note: String| Checkpoint::verify(&note, &log_verifier()).unwrap().size;
    let newest = size(witness.latest(&Digest::of(ORIGIN)).unwrap());
    drop(witness);
    assert_eq!(size(open(dir.path(), &hands).unwrap().latest(&Digest::of(ORIGIN)).unwrap()), newest);
}

#[test]
fn a_folder_has_one_user_and_a_monstrous_memory_is_not_read() {
    let (log, hands, dir) = (Log::new(40, 0), Hands::new(), tempfile::tempdir().unwrap());
    let witness = open(dir.path(), &hands).unwrap();
    let second = open(dir.path(), &hands).map(drop);
    assert!(matches!(&second, Err(OpenError::Memory { what, .. }) if what.contains("held")), "{second:?}");
    assert_eq!(ask(&witness, &log.request(0, 4)).status, 200);
    drop(witness);
    let logs = dir.path().join("logs");
    assert_eq!(names(&logs).len(), 1, "no temporary file stays");
    std::fs::write(logs.join(&names(&logs)[0]), vec![b' '; (4 << 20) + 1]).unwrap();
    let refused = open(dir.path(), &hands).map(drop);
    assert!(matches!(&refused, Err(OpenError::Memory { what, .. }) if what.contains("at most 4194304")), "{refused:?}");
}
