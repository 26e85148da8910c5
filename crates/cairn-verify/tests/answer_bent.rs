//! Complete answers that somebody bent: every way to leave out, put in or exchange something has its code.

use crate::common::{Log, ORIGIN, SCENE, audited, binding, errors, key, log, pinned, registry, sealed, view};
use cairn_log::format::{
    Answer, Checkpoint, Digest, Entry, Leaf, MapKey, MapLeaf, MapTree, RecordKind,
    answer::{AsOf, List, ListedRecord, Source as _, keys_about},
    map::ProofEnd,
    merkle::empty_root,
};
use cairn_verify::{Code, Outcome, audit_answer};

/// Bends the honest answer about view `two`, as of C.
fn bent(bend: impl Fn(&mut Answer, &Log)) -> Vec<&'static str> {
    let (log, older) = log();
    let mut answer = log.answer(Some("two"));
    let consistency = log.tree.prove_consistency(3, 12).unwrap();
    answer.as_of = Some(AsOf { checkpoint: older, consistency });
    assert_eq!(audited(&answer).outcome, Outcome::Trusted);
    bend(&mut answer, &log);
    errors(&audited(&answer))
}

fn asked_two() -> MapKey {
    MapKey::view(SCENE, &view("two"))
}

fn list_at(answer: &mut Answer, key: MapKey) -> &mut List {
    answer.lists.iter_mut().find(|list| list.key == key).unwrap()
}

#[test]
fn what_is_left_out_is_missed() {
    assert_eq!(bent(|a, _| a.records.retain(|r| r.index != 1)), ["answer.list.foreign", "answer.record.missing"]);
    assert_eq!(bent(|a, _| a.records.retain(|r| r.index != 7)), ["answer.record.missing"]);
    let codes = bent(|a, _| {
        list_at(a, asked_two()).entries.retain(|e| e.index != 1);
    });
    assert!(codes.contains(&"map.proof.failed"), "{codes:?}");
    // Thoroughly: the entry, the record and its lists.
    let codes = bent(|a, log| {
        list_at(a, asked_two()).entries.retain(|e| e.index != 1);
        let leaf = Leaf::decode(&log.entries[1].0.encode()).unwrap();
        let [about, ended] = keys_about(&leaf);
        let keys = [about, ended, MapKey::binding(SCENE, "contributor 2")];
        a.lists.retain(|list| !keys.contains(&list.key));
        a.records.retain(|r| ![1, 4].contains(&r.index));
    });
    assert_eq!(codes, ["map.proof.failed"]);
    assert_eq!(bent(|a, _| a.lists.retain(|list| list.key != asked_two())), ["answer.incomplete"]);
    // Without the list of disputes nobody knows whether there is one.
    let second = log().0.entries[1].0.clone();
    let about = |entry: &Entry| match entry {
        Entry::Record(leaf) => MapKey::about(&leaf.record),
        Entry::Map(_) => unreachable!("index 1 holds a record"),
    };
    let codes = bent(|a, _| {
        a.lists.retain(|list| list.key != about(&second));
        a.records.retain(|r| r.index != 4);
    });
    assert_eq!(codes, ["answer.incomplete"]);
}

#[test]
fn a_binding_that_is_left_out_is_missed() {
    let (mut log, _) = log();
    log.add(binding(50, "contributor 1", 1));
    log.close();
    let answer = log.answer(Some("one"));
    assert_eq!(audited(&answer).records[0].confirmed_by, Some(12));
    let without = |bend: &dyn Fn(&mut Answer)| {
        let mut bent = answer.clone();
        bend(&mut bent);
        errors(&audited(&bent))
    };
    let key = MapKey::binding(SCENE, "contributor 1");
    assert_eq!(without(&|a| a.records.retain(|r| r.index != 12)), ["answer.list.foreign", "answer.record.missing"]);
    assert!(without(&|a| a.lists.retain(|list| list.key != key)).contains(&"answer.incomplete"));
    assert_eq!(without(&|a| a.lists.retain(|list| list.key != MapKey::ended(&key_id(50)))), ["answer.incomplete"]);
    // Thoroughly: as if the name had never been bound.
    let codes = without(&|a| {
        list_at(a, key).entries.clear();
        let about = MapKey::about(&a.records.iter().find(|r| r.index == 12).map(digest_of).unwrap());
        a.lists.retain(|list| ![about, MapKey::ended(&key_id(50))].contains(&list.key));
        a.records.retain(|r| r.index != 12);
    });
    assert_eq!(codes, ["map.proof.failed"]);
}

fn key_id(number: u8) -> Digest {
    key(number).public().id()
}

fn digest_of(record: &ListedRecord) -> Digest {
    Leaf::decode(&record.leaf).unwrap().record
}

#[test]
fn absence_cannot_be_forged() {
    let nothing = |end: fn(&Log) -> ProofEnd| {
        move |a: &mut Answer, log: &Log| {
            let list = list_at(a, asked_two());
            list.entries.clear();
            list.proof.end = end(log);
            a.lists.retain(|list| list.key == asked_two());
            a.records.clear();
        }
    };
    assert_eq!(bent(nothing(|_| ProofEnd::Empty)), ["map.proof.failed"]);
    assert_eq!(bent(nothing(|_| ProofEnd::Own)), ["map.proof.failed"]);
    assert_eq!(
        bent(nothing(|log| {
            let key = asked_two();
            ProofEnd::Other { key, value: log.map.borrow().get(&key).unwrap().root() }
        })),
        ["map.proof.failed"]
    );
    // A true proof of absence, of something else.
    let codes = bent(|a, log| {
        nothing(|_| ProofEnd::Empty)(a, log);
        list_at(a, asked_two()).proof = log.map.borrow_mut().prove(&MapKey::view(SCENE, &view("four")));
    });
    assert_eq!(codes, ["map.proof.failed"]);
}

#[test]
fn what_does_not_belong_is_refused() {
    // A true record of the log, about another scene.
    let codes = bent(|a, log| {
        a.records.push(log.record(9).unwrap());
        a.records.sort_by_key(|r| r.index);
    });
    assert_eq!(codes, ["answer.record.foreign"]);
    let fern = || MapKey::scene("fern");
    let codes = bent(|a, log| {
        a.lists.push(log.list(&fern()).unwrap());
        a.lists.sort_by_key(|l| l.key);
        a.records.push(log.record(9).unwrap());
        a.records.sort_by_key(|r| r.index);
    });
    assert_eq!(codes, ["answer.list.foreign"]);
    // Envelopes exchanged; a whole record in another's place; a leaf of the log that is no record.
    let codes = bent(|a, _| {
        let other = a.records[0].envelope.clone();
        a.records[1].envelope = other;
    });
    assert!(codes.contains(&"answer.record.mismatch"), "{codes:?}");
    let codes = bent(|a, log| {
        let other = log.record(9).unwrap();
        a.records[1] = ListedRecord { index: 1, ..other };
    });
    assert!(codes.contains(&"answer.record.mismatch") && codes.contains(&"inclusion.failed"), "{codes:?}");
    let codes = bent(|a, log| {
        let other = log.record(2).unwrap();
        a.records[1] = ListedRecord { index: 1, ..other };
    });
    assert!(codes.contains(&"answer.record.mismatch"), "{codes:?}");
    let codes = bent(|a, _| a.records[1].envelope.as_mut().unwrap().payload[20] ^= 1);
    assert!(codes.contains(&"answer.record.mismatch"), "{codes:?}");
    let codes = bent(|a, _| a.records[0].inclusion[0] = Digest::of("x"));
    assert!(codes.contains(&"inclusion.failed"), "{codes:?}");
}

#[test]
fn a_registry_that_lists_what_does_not_concern_is_caught() {
    let mut log = Log::default();
    let envelope = sealed(RecordKind::Contribution, 1, &["one"], None);
    let leaf = Leaf::of(&envelope).unwrap();
    log.add_under(envelope, leaf, &[MapKey::scene(SCENE), MapKey::view(SCENE, &view("two"))]);
    let stranger = sealed(RecordKind::Revocation, 2, &[], None);
    let leaf = Leaf::of(&stranger).unwrap();
    log.add_under(stranger, leaf, &[MapKey::ended(&key(1).public().id())]);
    log.close();
    let report = audited(&log.answer(Some("two")));
    assert_eq!(errors(&report), ["answer.record.foreign"]);
    assert_eq!(report.findings.iter().filter(|f| f.code == Code::AnswerRecordForeign).count(), 2, "{report}");
    // Erasing the envelope does not help: a stranger's revocation ends nobody's key.
    log.entries[1].1 = None;
    let report = audited(&log.answer(None));
    assert_eq!(errors(&report), ["answer.record.foreign"]);
}

#[test]
fn only_the_last_map_leaf_of_the_pinned_registry_will_do() {
    assert_eq!(bent(|a, log| a.map = Some(log.map_part(6))), ["map.leaf.not_last"]);
    assert_eq!(bent(|a, _| a.map = None), ["map.leaf.not_last"]);
    assert_eq!(bent(|a, log| a.map.as_mut().unwrap().leaf = log.entries[6].0.encode()), ["map.leaf.not_included"]);
    let own = |a: &mut Answer, _: &Log| {
        let root = MapTree::new().root();
        a.map.as_mut().unwrap().leaf = MapLeaf::sign(ORIGIN, 11, root, &registry()).encode();
    };
    assert_eq!(bent(own), ["map.leaf.not_included"]);
    assert_eq!(bent(|a, log| a.map.as_mut().unwrap().leaf = log.entries[10].0.encode()), ["map.leaf.invalid"]);
    // The log as a thief of its checkpoint key alone could write it: the last leaf is somebody else's, or an old one.
    for (leaf, code) in [
        (MapLeaf::sign(ORIGIN, 12, Digest::of("map"), &key(9)), "map.leaf.invalid"),
        (MapLeaf::sign(ORIGIN, 11, Digest::of("map"), &registry()), "map.leaf.invalid"),
        (MapLeaf::sign("other/log", 12, Digest::of("map"), &registry()), "map.leaf.invalid"),
    ] {
        let (mut log, _) = log();
        log.tree.push(leaf.hash());
        log.entries.push((Entry::Map(leaf), None));
        assert_eq!(errors(&audited(&log.answer(None))), [code]);
    }
    // A log that ends in a record has no map over all of it.
    let (mut log, _) = log();
    log.add(sealed(RecordKind::Contribution, 8, &["two"], None));
    assert_eq!(errors(&audited(&log.answer(None))), ["map.leaf.invalid"]);
}

#[test]
fn checkpoints_are_those_of_the_pinned_log_and_of_one_history() {
    assert_eq!(bent(|a, log| a.checkpoint = log.checkpoint(&key(9))), ["checkpoint.signature.invalid"]);
    assert_eq!(bent(|a, _| a.checkpoint = a.checkpoint.replace(ORIGIN, "other/log")), ["checkpoint.origin.unknown"]);
    assert_eq!(bent(|a, _| a.checkpoint.clear()), ["checkpoint.malformed"]);
    assert_eq!(bent(|a, _| a.origin = "other/log".into()), ["answer.origin.mismatch"]);
    assert_eq!(bent(|a, _| a.as_of.as_mut().unwrap().checkpoint.clear()), ["checkpoint.malformed"]);
    let codes = bent(|a, _| a.as_of.as_mut().unwrap().consistency[0] = Digest::of("x"));
    assert_eq!(codes, ["answer.as_of.inconsistent"]);
    assert_eq!(bent(|a, _| a.as_of.as_mut().unwrap().consistency.clear()), ["answer.as_of.inconsistent"]);
    // Another history of size 3, signed by the registry itself; and the empty log, which every log begins with.
    for (size, root) in [(3, Digest::of("fork")), (0, empty_root()), (13, Digest::of("ahead"))] {
        let fork = Checkpoint::new(ORIGIN, size, root).sign(&registry()).unwrap().to_string();
        assert_eq!(bent(|a, _| a.as_of.as_mut().unwrap().checkpoint = fork.clone()), ["answer.as_of.inconsistent"]);
    }
    let unsigned = Checkpoint::new(ORIGIN, 3, Digest::of("x")).sign(&key(9)).unwrap().to_string();
    let codes = bent(|a, _| a.as_of.as_mut().unwrap().checkpoint = unsigned.clone());
    assert_eq!(codes, ["checkpoint.signature.invalid"]);
}

#[test]
fn answers_are_read_strictly() {
    let (log, _) = log();
    let json = log.answer(Some("two")).to_json();
    assert_eq!(Answer::parse(json.as_bytes()).unwrap().to_json(), json);
    let with = |from: &str, to: &str| {
        let changed = json.replacen(from, to, 1);
        assert_ne!(changed, json, "{from}");
        errors(&audit_answer(changed.as_bytes(), Some(&pinned())))
    };
    assert_eq!(with("cairn-answer/3", "cairn-answer/4"), ["answer.format.unknown"]);
    assert_eq!(with("{", r#"{"more":1,"#), ["answer.malformed"]);
    assert_eq!(with(r#""scene":"liberty""#, r#""scene":"liberty ""#), ["answer.malformed"]);
    assert_eq!(with(r#""leaf":""#, r#""leaf":"AA"#), ["answer.malformed"]);
    assert_eq!(with(r#""siblings":["#, r#""siblings":["","#), ["answer.malformed"]);
    assert_eq!(with(r#""signatures":[{"#, r#""signatures":[],"other":[{"#), ["answer.malformed"]);
    for broken in [&b"{}"[..], b"", b"[]", b"\xff", &json.as_bytes()[..json.len() - 1]] {
        assert_eq!(errors(&audit_answer(broken, Some(&pinned()))), ["answer.malformed"]);
    }
    let order = |bend: fn(&mut Answer)| bent(|a, _| bend(a));
    assert_eq!(order(|a| a.lists.reverse()), ["answer.malformed"]);
    assert_eq!(order(|a| a.records.reverse()), ["answer.malformed"]);
    assert_eq!(order(|a| a.records.insert(0, a.records[0].clone())), ["answer.malformed"]);
    let twice = |a: &mut Answer| {
        let list = list_at(a, asked_two());
        list.entries.insert(0, list.entries[0]);
    };
    assert_eq!(order(twice), ["answer.malformed"]);
}

#[test]
fn a_changed_byte_is_noticed_or_changes_nothing() {
    let (log, _) = log();
    let answer = log.answer(Some("two"));
    let (json, honest) = (answer.to_json(), audited(&answer));
    let (mut refused, step) = (0, json.len() / 300);
    for at in (0..json.len()).step_by(step) {
        for flip in [1, 4, 0x80] {
            let mut bytes = json.clone().into_bytes();
            bytes[at] ^= flip;
            let report = audit_answer(&bytes, Some(&pinned()));
            if report.outcome == Outcome::Invalid {
                refused += 1;
            } else {
                // Labels of keys are hints, which nobody signs and nobody obeys.
                assert_eq!(report.records, honest.records, "byte {at}");
                assert_eq!((&report.view, &report.scene), (&honest.view, &honest.scene), "byte {at}");
            }
        }
    }
    assert!(refused > 700, "{refused} of 900");
}
