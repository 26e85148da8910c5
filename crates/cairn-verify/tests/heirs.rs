//! Who may speak for a record after its owner's key ended: complete answers and bundles with later records agree, link by
//! link of a chain of rotations.

use crate::common::{Log, audited, errors, key, pinned, registry, sealed};
use cairn_log::format::{
    Digest, Entry, Envelope,
    RecordKind::{self, *},
    TlogProof,
};
use cairn_verify::{AnswerReport, Code, Evidence, LogView, Outcome, RecordInHand, Report, Standing, audit};

/// A record of `by` about an earlier one, with signatures of `also`.
fn about(kind: RecordKind, by: u8, earlier: Digest, also: &[u8]) -> Envelope {
    let mut envelope = sealed(kind, by, &[], Some(earlier));
    also.iter().for_each(|other| envelope.sign(&key(*other)));
    envelope
}

/// A log that begins with record 0, which is asked about, and record 1, both by key 1.
fn begun() -> (Log, Digest, Digest) {
    let mut log = Log::default();
    let asked = log.add(sealed(Contribution, 1, &["one"], None));
    let other = log.add(sealed(Contribution, 1, &["two"], None));
    (log, asked, other)
}

/// Record 0 as a complete answer, and as a bundle with the log's later records, have it.
fn judged(mut log: Log) -> (AnswerReport, Report) {
    log.close();
    let answer = audited(&log.answer(Some("one")));
    assert!(errors(&answer).is_empty(), "{answer}");
    let later = log.entries.iter().zip(0..).skip(1).filter_map(|((_, envelope), index)| {
        Some(RecordInHand { index, envelope: envelope.as_ref()?.to_json().into_bytes() })
    });
    let view = LogView { size: log.tree.size(), records: later.collect() };
    let mut envelope = log.entries[0].1.clone().unwrap();
    envelope.sign(&registry());
    let proof = TlogProof { extra: None, index: 0, hashes: log.inclusion(0), checkpoint: log.checkpoint(&registry()) };
    let (json, proof, pinned) = (envelope.to_json(), proof.to_text(), pinned());
    let evidence = Evidence {
        envelope: json.as_bytes(),
        pinned: Some(&pinned),
        proof: Some(&proof),
        log: Some(&view),
        ..Evidence::default()
    };
    (answer, audit(&evidence))
}

/// What both say of record 0.
fn standing(log: Log) -> Standing {
    let (answer, bundle) = judged(log);
    let standing = answer.records[0].standing;
    let codes = (bundle.has(Code::RecordReplaced), bundle.has(Code::RecordRevoked));
    let expected = match standing {
        Standing::Replaced => (true, false),
        Standing::Revoked => (false, true),
        _ => (false, false),
    };
    assert_eq!(codes, expected, "the answer says {standing}:\n{answer}\nand the bundle\n{bundle}");
    assert_eq!(answer.has(Code::LaterRecordInvalid), bundle.has(Code::LaterRecordInvalid), "{answer}\n{bundle}");
    standing
}

#[test]
fn heirs_along_a_chain_replace_and_take_back() {
    // 2 follows 1 by a rotation of the other record; alone, it replaces record 0.
    let (mut log, asked, other) = begun();
    let second = log.add(about(Rotation, 2, other, &[1]));
    log.add(about(Contribution, 2, asked, &[]));
    assert_eq!(standing(log), Standing::Replaced);
    // And 3 follows 2.
    for (kind, then) in [(Contribution, Standing::Replaced), (Revocation, Standing::Revoked)] {
        let (mut log, asked, other) = begun();
        let second = log.add(about(Rotation, 2, other, &[1]));
        log.add(about(Rotation, 3, second, &[2]));
        log.add(about(kind, 3, asked, &[]));
        assert_eq!(standing(log), then);
    }
    // The keys before it speak no more, and strangers need the word of the one that does.
    for (by, also, then) in [
        (1, &[][..], Standing::Counts),
        (2, &[], Standing::Counts),
        (9, &[1, 2], Standing::Counts),
        (9, &[3], Standing::Replaced),
    ] {
        let (mut log, asked, other) = begun();
        assert_eq!(log.add(about(Rotation, 2, other, &[1])), second);
        log.add(about(Rotation, 3, second, &[2]));
        log.add(about(Contribution, by, asked, also));
        assert_eq!(standing(log), then, "by {by} with {also:?}");
    }
}

#[test]
fn what_came_before_the_rotation_was_the_old_keys_to_say() {
    let (mut log, asked, other) = begun();
    log.add(about(Contribution, 2, asked, &[]));
    log.add(about(Rotation, 2, other, &[1]));
    assert_eq!(standing(log), Standing::Counts, "2 was nobody then");
    let (mut log, asked, other) = begun();
    log.add(about(Contribution, 1, asked, &[]));
    log.add(about(Rotation, 2, other, &[1]));
    assert_eq!(standing(log), Standing::Replaced);
}

#[test]
fn revoked_keys_have_no_heirs() {
    // Revoked after it took over.
    let (mut log, asked, other) = begun();
    log.add(about(Rotation, 2, other, &[1]));
    log.add(sealed(Revocation, 2, &[], None));
    log.add(about(Contribution, 2, asked, &[]));
    assert_eq!(standing(log), Standing::Counts);
    // A thief who rotates after the revocation, which a registry that lets it in cannot help.
    let (mut log, asked, other) = begun();
    log.add(sealed(Revocation, 1, &[], None));
    log.add(about(Rotation, 7, other, &[1]));
    log.add(about(Contribution, 7, asked, &[]));
    assert_eq!(standing(log), Standing::Counts);
    // Rotated to a key that had ended.
    let (mut log, asked, other) = begun();
    log.add(sealed(Revocation, 2, &[], None));
    log.add(about(Rotation, 2, other, &[1]));
    log.add(about(Contribution, 2, asked, &[]));
    assert_eq!(standing(log), Standing::Counts);
}

#[test]
fn a_rotation_that_the_old_key_did_not_sign_makes_no_heir() {
    let (mut log, asked, other) = begun();
    // The map of an honest registry would not list it as the key's end.
    let rotation = about(Rotation, 7, other, &[]);
    let (leaf, record) = cairn_log::format::Leaf::open(&rotation).unwrap();
    log.add_under(rotation, leaf, &cairn_log::format::map::keys_of(&record, None));
    log.add(about(Contribution, 7, asked, &[]));
    assert_eq!(standing(log), Standing::Counts);
}

#[test]
fn an_answer_that_leaves_out_a_link_of_the_chain_is_not_whole() {
    let (mut log, asked, other) = begun();
    log.add(about(Rotation, 2, other, &[1]));
    log.add(sealed(Revocation, 2, &[], None));
    log.add(about(Contribution, 2, asked, &[]));
    log.close();
    let mut answer = log.answer(Some("one"));
    let ended = cairn_log::format::MapKey::ended(&key(2).public().id());
    answer.lists.retain(|list| list.key != ended);
    answer.records.retain(|record| record.index != 3);
    assert_eq!(
        errors(&audited(&answer)),
        ["answer.incomplete"],
        "the revocation of 2 is what makes its word worthless"
    );
}

#[test]
fn an_erased_rotation_still_leads_to_the_heir() {
    let (mut log, asked, other) = begun();
    log.add(about(Rotation, 2, other, &[1]));
    log.add(about(Contribution, 2, asked, &[]));
    log.entries[2].1 = None;
    assert!(matches!(&log.entries[2].0, Entry::Record(leaf) if leaf.kind == Rotation));
    log.close();
    let report = audited(&log.answer(Some("one")));
    assert_eq!((report.outcome, report.records[0].standing), (Outcome::Trusted, Standing::Replaced), "{report}");
}
