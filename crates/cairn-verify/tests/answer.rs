//! Complete answers from logs made by hand: honest ones are trusted, and say what each record is worth.

use crate::common::{Log, ORIGIN, SCENE, audited, binding, errors, key, log, pinned, record, registry, sealed, view};
use cairn_log::format::{Checkpoint, RecordKind, answer::AsOf, merkle::leaf_hash, testing::Tree};
use cairn_verify::{AnswerReport, Code, Freshness, Outcome, Question, Standing, audit_answer, audit_answer_to};

fn standings(report: &AnswerReport) -> Vec<(u64, Standing)> {
    report.records.iter().map(|r| (r.index, r.standing)).collect()
}

#[test]
fn an_honest_answer_about_a_scene_is_trusted_and_weighs_every_record() {
    use Standing::{Counts, NoCredit, Replaced, Revoked};
    let (log, _) = log();
    let report = audited(&log.answer(None));
    assert_eq!((report.outcome, report.freshness), (Outcome::Trusted, Freshness::AsOf(12)), "{report}");
    let expected = [
        (0, Counts),
        (1, Counts),
        (3, Replaced),
        (4, NoCredit),
        (5, Revoked),
        (7, NoCredit),
        (8, NoCredit),
        (10, Counts),
    ];
    assert_eq!(standings(&report), expected, "{report}");
    assert_eq!(report.records[1].disputed_by, [4]);
    assert_eq!(report.records[0].contributor.as_deref(), Some("contributor 1"));
    for code in [
        Code::CheckpointVerified,
        Code::MapLeafValid,
        Code::MapMembershipProven,
        Code::MapAbsenceProven,
        Code::AnswerRecordsProven,
        Code::KeyEndedLater,
        Code::RecordDisputed,
        Code::AnswerRecordRevoked,
        Code::AnswerRecordReplaced,
    ] {
        assert!(report.has(code), "{code:?}: {report}");
    }
}

#[test]
fn a_view_is_answered_by_those_who_list_it() {
    let (log, _) = log();
    let report = audited(&log.answer(Some("two")));
    assert_eq!(report.outcome, Outcome::Trusted, "{report}");
    assert_eq!(standings(&report), [(0, Standing::Counts), (1, Standing::Counts), (5, Standing::Revoked)]);
    let three = audited(&log.answer(Some("three")));
    assert_eq!(three.credited().map(|r| r.index).collect::<Vec<_>>(), [1]);
    // Nobody, and that is proven.
    let none = audited(&log.answer(Some("four")));
    assert_eq!((none.outcome, none.records.len()), (Outcome::Trusted, 0), "{none}");
    assert!(none.has(Code::MapAbsenceProven) && !none.has(Code::MapMembershipProven));
    let empty = Log::default();
    let report = audited(&empty.answer(None));
    assert_eq!((report.outcome, report.freshness), (Outcome::Trusted, Freshness::AsOf(0)), "{report}");
}

#[test]
fn an_answer_as_of_an_older_checkpoint_tells_what_came_later_besides() {
    let (log, older) = log();
    let mut answer = log.answer(None);
    let consistency = log.tree.prove_consistency(3, 12).unwrap();
    answer.as_of = Some(AsOf { checkpoint: older, consistency });
    let report = audited(&answer);
    assert_eq!((report.outcome, report.as_of), (Outcome::Trusted, Some(3)), "{report}");
    assert_eq!(report.freshness, Freshness::AsOf(12));
    let counting: Vec<_> = report.credited().map(|r| (r.index, r.disputed_by.len())).collect();
    assert_eq!(counting, [(0, 0), (1, 0)], "the dispute came later: {report}");
    assert!(report.records[2..].iter().all(|r| r.standing == Standing::Later), "{report}");
    assert!(report.has(Code::AnswerAsOfProven) && report.has(Code::AnswerRecordLater));
    let changed = report.findings.iter().filter(|f| f.code == Code::AnswerChangedLater);
    assert_eq!(changed.map(|f| f.place.as_str()).collect::<Vec<_>>(), ["record at index 0", "record at index 1"]);
}

#[test]
fn a_key_that_had_ended_and_a_strangers_replacement_do_not_count() {
    use RecordKind::{Contribution, Revocation, Rotation};
    let mut log = Log::default();
    log.add(sealed(Revocation, 1, &[], None));
    log.add(sealed(Contribution, 1, &["one"], None));
    let good = log.add(sealed(Contribution, 2, &["one"], None));
    log.add(sealed(Contribution, 3, &[], Some(good)));
    let mut agreed = sealed(Contribution, 4, &[], Some(good));
    log.close();
    let report = audited(&log.answer(Some("one")));
    assert_eq!(standings(&report), [(1, Standing::KeyEnded), (2, Standing::Counts)], "{report}");
    assert!(report.has(Code::AnswerRecordKeyEnded) && report.has(Code::LaterRecordInvalid));
    // With the owner's signature the other may take its place.
    agreed.sign(&key(2));
    log.add(agreed);
    log.close();
    let report = audited(&log.answer(Some("one")));
    assert_eq!(standings(&report), [(1, Standing::KeyEnded), (2, Standing::Replaced)], "{report}");
    // A rotation that the old key did not sign ends nothing, whatever the map says.
    let rotation = sealed(Rotation, 9, &[], Some(good));
    log.add(rotation);
    log.close();
    assert_eq!(errors(&audited(&log.answer(Some("one")))), ["answer.record.foreign"]);
}

#[test]
fn a_stolen_key_takes_nothing_back_once_it_was_ended() {
    use RecordKind::{Contribution, Revocation};
    let mut log = Log::default();
    let good = log.add(sealed(Contribution, 2, &["one"], None));
    log.add(sealed(Revocation, 2, &[], None));
    // The thief, and a registry that lets it in all the same: under the key itself, and with it as a second signature.
    log.add(sealed(Contribution, 2, &[], Some(good)));
    let mut agreed = sealed(Contribution, 4, &[], Some(good));
    agreed.sign(&key(2));
    log.add(agreed);
    log.close();
    let report = audited(&log.answer(Some("one")));
    assert_eq!(standings(&report), [(0, Standing::Counts)], "{report}");
    assert_eq!(report.findings.iter().filter(|f| f.code == Code::LaterRecordInvalid).count(), 2, "{report}");
}

/// Of each record that counts for view `one`, the binding that confirms it.
fn confirmed(log: &Log) -> Vec<(u64, Option<u64>)> {
    let report = audited(&log.answer(Some("one")));
    assert_eq!(report.outcome, Outcome::Trusted, "{report}");
    assert_eq!(errors(&report), [""; 0]);
    // A scene's answer says the same of the records that it has in common.
    let scene = audited(&log.answer(None));
    let of_scene = |index| scene.records.iter().find(|r| r.index == index).and_then(|r| r.confirmed_by);
    report.credited().map(|r| (r.index, r.confirmed_by)).inspect(|(i, by)| assert_eq!(of_scene(*i), *by)).collect()
}

/// A claim of photographs alone, in a contributor's name.
fn claim(by: u8, contributor: &str) -> cairn_log::format::Envelope {
    let identity = cairn_log::format::record::Identity::named(contributor);
    let of = record(RecordKind::Claim, by, &["one"], None);
    cairn_log::format::OwnerRecord { identity, ..of }.seal(&key(by)).unwrap()
}

#[test]
fn a_claim_is_unconfirmed_until_a_curator_binds_its_name_whoever_came_first() {
    let mut log = Log::default();
    // The stranger comes first.
    log.add(claim(9, "ada"));
    log.add(claim(1, "ada"));
    log.close();
    assert_eq!(confirmed(&log), [(0, None), (1, None)]);
    let report = audited(&log.answer(Some("one")));
    assert_eq!(report.findings.iter().filter(|f| f.code == Code::AnswerRecordUnconfirmed).count(), 2, "{report}");
    assert!(report.to_string().contains("counts    index 0: claim by \"ada\", name unconfirmed\n"), "{report}");
    log.add(binding(50, "ada", 1));
    // Another name's binding, and another scene's, say nothing of hers.
    log.add(binding(50, "bea", 9));
    log.close();
    assert_eq!(confirmed(&log), [(0, None), (1, Some(3))]);
    let report = audited(&log.answer(Some("one")));
    assert!(report.has(Code::AnswerRecordConfirmed), "{report}");
    assert!(
        report.to_string().contains("counts    index 1: claim by \"ada\", name confirmed at index 3\n"),
        "{report}"
    );
}

#[test]
fn of_a_names_bindings_the_newest_that_stands_counts() {
    let mut log = Log::default();
    log.add(claim(1, "ada"));
    log.add(claim(2, "ada"));
    log.add(binding(50, "ada", 1));
    log.close();
    assert_eq!(confirmed(&log), [(0, Some(2)), (1, None)]);
    // By another curator.
    let second = log.add(binding(51, "ada", 2));
    log.close();
    assert_eq!(confirmed(&log), [(0, None), (1, Some(4))]);
    // As of the checkpoint before, the first still counts.
    let mut older = Log::default();
    for envelope in log.entries[..3].iter().filter_map(|(_, envelope)| envelope.clone()) {
        older.add(envelope);
    }
    let as_of = AsOf { checkpoint: older.close(), consistency: log.tree.prove_consistency(4, 6).unwrap() };
    let report = audited(&cairn_log::format::Answer { as_of: Some(as_of), ..log.answer(Some("one")) });
    assert_eq!(report.records.iter().map(|r| r.confirmed_by).collect::<Vec<_>>(), [Some(2), None], "{report}");
    // Its curator takes the second back: then the first counts again. A stranger's word changes nothing.
    log.add(sealed(RecordKind::Revocation, 9, &[], Some(second)));
    log.close();
    assert_eq!(confirmed(&log), [(0, None), (1, Some(4))]);
    log.add(sealed(RecordKind::Revocation, 51, &[], Some(second)));
    log.close();
    assert_eq!(confirmed(&log), [(0, Some(2)), (1, None)]);
    // One that was erased says nothing any more, and hides none that came after it.
    log.entries[2].1 = None;
    assert_eq!(confirmed(&log), [(0, None), (1, None)]);
    log.add(binding(50, "ada", 1));
    log.close();
    assert_eq!(confirmed(&log), [(0, Some(10)), (1, None)]);
}

#[test]
fn a_binding_holds_for_the_keys_that_rotations_join() {
    let mut log = Log::default();
    let first = log.add(claim(1, "ada"));
    log.add(binding(50, "ada", 1));
    let mut rotation = sealed(RecordKind::Rotation, 2, &[], Some(first));
    rotation.sign(&key(1));
    log.add(rotation);
    let second = log.add(claim(2, "ada"));
    log.close();
    assert_eq!(confirmed(&log), [(0, Some(1)), (3, Some(1))]);
    // Bound anew to the key in its place; and once that ended, what it signed stays confirmed.
    log.add(binding(50, "ada", 2));
    log.add(sealed(RecordKind::Revocation, 2, &[], None));
    log.close();
    assert_eq!(confirmed(&log), [(0, Some(5)), (3, Some(5))]);
    // A rotation that the old key did not sign joins nothing, whatever the map says.
    log.add(sealed(RecordKind::Rotation, 9, &[], Some(second)));
    log.close();
    assert_eq!(errors(&audited(&log.answer(Some("one")))), ["answer.record.foreign"]);
}

#[test]
fn an_erased_record_keeps_its_place_and_loses_its_name() {
    let (mut log, _) = log();
    log.entries[0].1 = None;
    log.entries[7].1 = None;
    let report = audited(&log.answer(Some("two")));
    assert_eq!(report.outcome, Outcome::Trusted, "{report}");
    assert_eq!(standings(&report), [(0, Standing::Erased), (1, Standing::Counts), (5, Standing::Revoked)]);
    assert_eq!((report.records[0].contributor.clone(), report.records[0].number), (None, None));
    assert!(report.has(Code::AnswerRecordErased));
    assert!(report.to_string().contains("(erased)"));
}

#[test]
fn an_answer_to_another_question_is_none() {
    let (log, _) = log();
    let asked = |answered: Option<&str>, scene: &str, about: Option<&str>| {
        let question = Question { scene: scene.into(), view: about.map(view) };
        audit_answer_to(log.answer(answered).to_json().as_bytes(), Some(&pinned()), Some(&question))
    };
    for view in [None, Some("two")] {
        let report = asked(view, SCENE, view);
        assert!(report.outcome == Outcome::Trusted && report.has(Code::AnswerQuestionMatch), "{report}");
    }
    for (answered, scene, about) in [
        (None, "fern", None),
        (None, SCENE, Some("two")),
        (Some("two"), SCENE, None),
        (Some("two"), SCENE, Some("one")),
    ] {
        // True in itself, and credits nobody all the same.
        assert_eq!(errors(&asked(answered, scene, about)), ["answer.question.mismatch"]);
    }
    let garbage = audit_answer_to(b"{", None, Some(&Question { scene: SCENE.into(), view: None }));
    assert_eq!(errors(&garbage), ["answer.malformed"]);
}

#[test]
fn without_a_pinned_key_nothing_is_trusted() {
    let (log, _) = log();
    let json = log.answer(None).to_json();
    let report = audit_answer(json.as_bytes(), None);
    assert_eq!((report.outcome, report.freshness), (Outcome::Valid, Freshness::CannotTell), "{report}");
    assert!(report.has(Code::RegistryUnpinned) && !report.has(Code::MapLeafValid));
    let mut moved = log.answer(None);
    let last = moved.map.as_mut().unwrap();
    last.leaf[3] ^= 1;
    let mut tree = Tree::new();
    log.entries[..11].iter().for_each(|(entry, _)| _ = tree.push(entry.hash()));
    tree.push(leaf_hash(&last.leaf));
    last.inclusion = tree.prove_inclusion(11, 12).unwrap();
    moved.checkpoint = Checkpoint::new(ORIGIN, 12, tree.root()).sign(&registry()).unwrap().to_string();
    assert!(audit_answer(moved.to_json().as_bytes(), None).has(Code::MapLeafInvalid));
}

#[test]
fn answer_reports_are_readable_by_people_and_by_programs() {
    let (log, _) = log();
    let report = audited(&log.answer(None));
    let text = report.to_string();
    for part in [
        "trusted\n",
        "who contributed to scene \"liberty\", as of log size 12\n",
        "3 of 8 records count\n",
        "counts    index 1: contribution by \"contributor 2\", identity 2, name unconfirmed, disputed at index 4\n",
        "no credit index 4: dispute naming \"contributor 5\", identity 5\n",
        "revoked   index 5:",
        "map.membership.proven",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
    assert_eq!((json["version"].as_u64(), json["outcome"].as_str()), (Some(1), Some("trusted")));
    assert_eq!(json["freshness"]["as_of"], 12);
    assert_eq!(json["records"][3]["standing"], "no_credit");
    assert_eq!(json["records"][0]["kind"], "contribution");
    assert_eq!(json["scene"], SCENE);
}
