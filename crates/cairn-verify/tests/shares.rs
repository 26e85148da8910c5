//! Statements of shares beside answers: honest ones are trusted, and every way to bend one has its code.

use crate::common::{Log, ORIGIN, SCENE, audited, errors, key, log, pinned, registry, view};
use cairn_log::format::{
    Answer, Checkpoint, Digest, OwnerKey,
    record::Seen,
    shares::{ContributorShares, PhotographShare, Sampled, SharedFiles, SharedView, Shares, VERSION},
};
use cairn_verify::{Code, Outcome, Question, Severity, SharesReport, audit_answer, audit_shares, audit_shares_to};

/// What an honest registry would sign about view `two`.
fn shares(answer: &Answer) -> Shares {
    let checkpoint = Checkpoint::read(&answer.checkpoint).unwrap().1;
    let photograph = |name: &str, share| PhotographShare { view: name.into(), photograph: view(name), share };
    let of = |name: &str, photographs: Vec<PhotographShare>| ContributorShares {
        name: name.into(),
        share: photographs.iter().map(|photograph| photograph.share).sum(),
        photographs,
    };
    Shares {
        version: VERSION,
        origin: ORIGIN.into(),
        registry_key: registry().public(),
        scene: SCENE.into(),
        view: SharedView { name: "two.png".into(), photograph: view("two") },
        camera: serde_json::json!({}),
        files: SharedFiles {
            base_field: Digest::of("base"),
            share_table: Digest::of("table"),
            settings: Digest::of("settings"),
            marked_field: Some(Digest::of("marked")),
        },
        power: 8,
        sampled: Sampled { width: 4, height: 3 },
        contributors: vec![
            of("contributor 2", vec![photograph("one", 0.25), photograph("three", 0.125)]),
            of("contributor 1", vec![photograph("four", 0.25)]),
        ],
        excluded: 0.125,
        excluded_views: vec![SharedView { name: "five.png".into(), photograph: view("five") }],
        unseen: 0.0625,
        behind: 0.1875,
        checkpoint: Seen { size: checkpoint.size, root: checkpoint.root },
    }
}

/// The answer about view `two`, with these shares as `by` signs them.
fn with(log: &Log, by: &OwnerKey, bend: impl Fn(&mut Shares)) -> Answer {
    let mut answer = log.answer(Some("two"));
    let mut shares = shares(&answer);
    bend(&mut shares);
    shares.registry_key = by.public();
    answer.shares = Some(shares.seal(by).unwrap());
    answer
}

/// The codes of the errors, which both audits find.
fn both(answer: &Answer) -> Vec<&'static str> {
    let report: SharesReport = audit_shares(answer.to_json().as_bytes(), Some(&pinned()));
    let failed = report.findings.iter().filter(|f| f.severity == Severity::Error);
    let codes: Vec<&str> = failed.map(|f| f.code.as_str()).collect();
    assert_eq!((report.outcome == Outcome::Invalid, report.shares.is_none()), (!codes.is_empty(), !codes.is_empty()));
    assert_eq!(codes, errors(&audited(answer)), "{report}");
    codes
}

#[test]
fn honest_shares_are_trusted_and_said() {
    let (log, _) = log();
    let answer = with(&log, &registry(), |_| ());
    assert_eq!(both(&answer), [""; 0]);
    let report = audited(&answer);
    assert!(report.outcome == Outcome::Trusted && report.has(Code::SharesVerified), "{report}");
    let text = report.to_string();
    for part in [
        "shares of what view \"two.png\" shows, by the registry's word",
        "\n  37.5 %  \"contributor 2\", photographs: 2\n",
        "\n  12.5 %  excluded photographs\n",
        "\n  18.8 %  behind the scene\n",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
    assert_eq!(json["shares"]["contributors"][1]["name"], "contributor 1");
    let alone = audit_shares(answer.to_json().as_bytes(), Some(&pinned()));
    assert!(alone.outcome == Outcome::Trusted && alone.to_string().starts_with("trusted\nshares of"), "{alone}");
    // Nobody's key is pinned: nothing is trusted.
    let unpinned = audit_shares(answer.to_json().as_bytes(), None);
    assert!(unpinned.outcome == Outcome::Valid && !unpinned.has(Code::SharesVerified), "{unpinned}");
    assert!(!audit_answer(answer.to_json().as_bytes(), None).has(Code::SharesVerified));
}

#[test]
fn an_answer_without_shares_says_so_and_is_as_good() {
    let (log, _) = log();
    let (of_view, of_scene) = (log.answer(Some("two")), log.answer(None));
    let report = audited(&of_view);
    assert!(report.outcome == Outcome::Trusted && report.has(Code::SharesMissing), "{report}");
    assert!(!audited(&of_scene).has(Code::SharesMissing));
    for answer in [of_view, of_scene] {
        let report = audit_shares(answer.to_json().as_bytes(), Some(&pinned()));
        assert!(report.outcome == Outcome::Invalid && report.has(Code::SharesMalformed), "{report}");
    }
    assert!(audit_shares(b"{", None).has(Code::AnswerMalformed));
}

#[test]
fn a_statement_that_was_changed_moved_or_made_by_another_is_invalid() {
    let (log, _) = log();
    assert_eq!(both(&with(&log, &key(9), |_| ())), ["shares.signature.invalid"]);
    let mut changed = with(&log, &registry(), |_| ());
    let envelope = changed.shares.as_mut().unwrap();
    let body = String::from_utf8(envelope.payload.clone()).unwrap();
    envelope.payload = body.replace("contributor 1", "contributor 9").into_bytes();
    assert_eq!(both(&changed), ["shares.signature.invalid"]);
    envelope_of(&mut changed).payload = b"{}".to_vec();
    assert_eq!(both(&changed), ["shares.malformed"]);
    envelope_of(&mut changed).payload_type = "application/vnd.cairn.owner-record.v1+json".into();
    assert_eq!(both(&changed), ["shares.malformed"]);
    let subject = ["shares.subject.mismatch"];
    assert_eq!(both(&with(&log, &registry(), |s| s.origin = "other.example/log".into())), subject);
    assert_eq!(both(&with(&log, &registry(), |s| s.scene = "fern".into())), subject);
    assert_eq!(both(&with(&log, &registry(), |s| s.view.photograph = view("one"))), subject);
    let elsewhere = with(&log, &registry(), |s| s.checkpoint.size = 3);
    assert_eq!(both(&elsewhere), ["shares.checkpoint.mismatch"]);
    // An answer about the whole scene has none.
    let mut whole = log.answer(None);
    whole.shares = with(&log, &registry(), |_| ()).shares;
    assert_eq!(both(&whole), subject);
}

fn envelope_of(answer: &mut Answer) -> &mut cairn_log::format::Envelope {
    answer.shares.as_mut().unwrap()
}

#[test]
fn shares_of_another_view_than_the_one_asked_about_are_no_answer() {
    let (log, _) = log();
    let answer = with(&log, &registry(), |_| ()).to_json();
    let audit = |scene: &str, name: &str| {
        let asked = Question { scene: scene.into(), view: Some(view(name)) };
        audit_shares_to(answer.as_bytes(), Some(&pinned()), Some(&asked))
    };
    let report = audit(SCENE, "two");
    assert!(report.outcome == Outcome::Trusted && report.has(Code::AnswerQuestionMatch), "{report}");
    for report in [audit(SCENE, "one"), audit("fern", "two")] {
        assert!(report.outcome == Outcome::Invalid && report.has(Code::AnswerQuestionMismatch), "{report}");
    }
}

#[test]
fn shares_that_do_not_add_up_are_refused_though_the_registry_signed_them() {
    let (log, _) = log();
    let wrong = ["shares.sum.mismatch"];
    assert_eq!(both(&with(&log, &registry(), |s| s.contributors[0].share = 0.5)), wrong);
    assert_eq!(both(&with(&log, &registry(), |s| s.unseen = 0.0)), wrong);
    assert_eq!(both(&with(&log, &registry(), |s| s.contributors.truncate(1))), wrong);
    // What rounding does is none of that.
    assert_eq!(both(&with(&log, &registry(), |s| s.unseen += 1e-4)), [""; 0]);
}

#[test]
fn the_auditors_guide_names_every_code_of_shares() {
    let guide = include_str!("../../../docs/security/auditing.md");
    let named = |code: &&Code| code.as_str().starts_with("shares.") && !guide.contains(&format!("`{}`", code.as_str()));
    let missing: Vec<&str> = Code::ALL.iter().filter(named).map(|code| code.as_str()).collect();
    assert!(missing.is_empty(), "docs/security/auditing.md does not name {missing:?}");
    for word in guide.split('`').filter(|word| word.starts_with("shares.")) {
        assert!(
            Code::ALL.iter().any(|code| code.as_str() == word),
            "docs/security/auditing.md names {word}, which is no code"
        );
    }
}
