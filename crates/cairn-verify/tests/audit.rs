//! Audits of evidence made with the formats alone: no registry runs here.

use cairn_log::format::{
    Checkpoint, Digest, Envelope, Leaf, Note, NoteVerifier, OwnerKey, OwnerRecord, Policy, RecordKind, TlogProof,
    WitnessVerifier, cosign,
    merkle::{empty_root, leaf_hash},
    record::{self, Digests, Identity, PAYLOAD_TYPE, Seen, SignalFiles, hidden_signal_commitment, photographs_root},
    testing::Tree,
};
use cairn_verify::{
    Bundle, Code, Evidence, FileInHand, Freshness, LogView, Outcome, RecordInHand, Report, Severity, audit,
};

const ORIGIN: &str = "cairn.example/log";
const FIELD: &[u8] = b"the marked field's bytes";
const DETECTOR: &[u8] = b"the detector's bytes";
const BASE_FIELD: &[u8] = b"base field";
const SHARE_TABLE: &[u8] = b"share table";
const SIGNAL: &[u8] = b"credit";
const CONFIGURATION: &[u8] = b"[train]\nsteps = 55\n";

fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

fn registry() -> OwnerKey {
    key(200)
}

fn pinned() -> NoteVerifier {
    NoteVerifier::new(ORIGIN, registry().public()).unwrap()
}

fn photographs() -> Vec<Digest> {
    ["one", "two", "three"].map(Digest::of).to_vec()
}

fn salt() -> Digest {
    Digest::of("salt")
}

fn owner_record() -> OwnerRecord {
    OwnerRecord {
        version: record::VERSION,
        kind: RecordKind::Training,
        origin: ORIGIN.into(),
        scene: "liberty".into(),
        scene_salt: Digest::of("scene salt"),
        identity: Identity::numbered(2, "Ada"),
        owner_key: key(1).public(),
        digests: Digests {
            marked_field: Some(Digest::of(FIELD)),
            detector: Some(Digest::of(DETECTOR)),
            hidden_signal: Some(hidden_signal_commitment(&salt(), &SignalFiles::picture(SIGNAL))),
            photographs: Some(photographs_root(&photographs())),
            base_field: Some(Digest::of(BASE_FIELD)),
            share_table: Some(Digest::of(SHARE_TABLE)),
            training_configuration: Some(Digest::of(CONFIGURATION)),
        },
        seed: Some(42),
        purpose: "credit".into(),
        nonce: Digest::of("nonce"),
        seen: Seen { size: 0, root: empty_root() },
        replaces: None,
        views: None,
    }
}

fn countersigned() -> Envelope {
    let mut envelope = owner_record().seal(&key(1)).unwrap();
    envelope.sign(&registry());
    envelope
}

/// A log of nine leaves with the envelope's at index 4.
fn proof_of(envelope: &Envelope, signer: &OwnerKey, origin: &str) -> String {
    let mut tree = Tree::new();
    for i in 0..9_u8 {
        tree.push(if i == 4 { Leaf::of(envelope).unwrap().hash() } else { leaf_hash(&[i]) });
    }
    let checkpoint = Checkpoint::new(origin, 9, tree.root()).sign(signer).unwrap().to_string();
    let hashes = tree.prove_inclusion(4, 9).unwrap();
    TlogProof { extra: None, index: 4, hashes, checkpoint }.to_text()
}

/// Everything that belongs together.
struct Whole {
    envelope: Vec<u8>,
    proof: String,
    pinned: NoteVerifier,
    field: Vec<u8>,
    base_field: Vec<u8>,
    share_table: Vec<u8>,
    detector: Vec<u8>,
    signal: Vec<u8>,
    salt: Digest,
    photographs: Vec<Digest>,
    configuration: Vec<u8>,
    log: LogView,
}

fn whole() -> Whole {
    let envelope = countersigned();
    Whole {
        proof: proof_of(&envelope, &registry(), ORIGIN),
        envelope: envelope.to_json().into_bytes(),
        pinned: pinned(),
        field: FIELD.to_vec(),
        base_field: BASE_FIELD.to_vec(),
        share_table: SHARE_TABLE.to_vec(),
        detector: DETECTOR.to_vec(),
        signal: SIGNAL.to_vec(),
        salt: salt(),
        photographs: photographs(),
        configuration: CONFIGURATION.to_vec(),
        log: LogView { size: 9, records: vec![] },
    }
}

impl Whole {
    fn evidence(&self) -> Evidence<'_> {
        Evidence {
            envelope: &self.envelope,
            pinned: Some(&self.pinned),
            policy: None,
            proof: Some(&self.proof),
            marked_field: Some(FileInHand::of("field.safetensors", &self.field)),
            base_field: Some(FileInHand::of("base.field", &self.base_field)),
            share_table: Some(FileInHand::of("base.shares", &self.share_table)),
            detector: Some(FileInHand::of("detector.safetensors", &self.detector)),
            hidden_signal: Some(FileInHand::hidden_signal(
                "credit.txt",
                &self.salt,
                &SignalFiles::picture(&self.signal),
            )),
            photographs: Some(FileInHand::photographs("photographs", &self.photographs)),
            training_configuration: Some(FileInHand::of("train.toml", &self.configuration)),
            log: Some(&self.log),
        }
    }

    fn audit(&self) -> Report {
        audit(&self.evidence())
    }
}

fn errors(report: &Report) -> Vec<&'static str> {
    report.findings.iter().filter(|f| f.severity == Severity::Error).map(|f| f.code.as_str()).collect()
}

#[test]
fn whole_evidence_is_trusted() {
    let report = whole().audit();
    assert_eq!(report.outcome, Outcome::Trusted, "{report}");
    assert_eq!(report.freshness, Freshness::AsOf(9));
    assert!(report.findings.iter().all(|f| f.severity == Severity::Passed), "{report}");
    assert_eq!(report.findings.len(), 12, "{report}");
    assert_eq!(report.record, Some(countersigned().digest().to_string()));
}

#[test]
fn less_evidence_says_what_is_missing_and_trusts_less() {
    let whole = whole();
    let less = |take: fn(&mut Evidence<'_>), code: Code, outcome: Outcome| {
        let mut evidence = whole.evidence();
        take(&mut evidence);
        let report = audit(&evidence);
        assert!(report.has(code), "{code:?}: {report}");
        assert_eq!(report.outcome, outcome, "{code:?}: {report}");
        report
    };
    less(|e| e.pinned = None, Code::RegistryUnpinned, Outcome::Valid);
    less(|e| e.proof = None, Code::InclusionMissing, Outcome::Valid);
    let report = less(|e| e.log = None, Code::FreshnessUnknown, Outcome::Trusted);
    assert_eq!(report.freshness, Freshness::CannotTell);
    less(|e| e.marked_field = None, Code::MarkedFieldUnchecked, Outcome::Trusted);
    less(|e| e.detector = None, Code::DetectorUnchecked, Outcome::Trusted);
    less(|e| e.hidden_signal = None, Code::HiddenSignalUnchecked, Outcome::Trusted);
    less(|e| e.photographs = None, Code::PhotographsUnchecked, Outcome::Trusted);
    less(|e| e.training_configuration = None, Code::ConfigurationUnchecked, Outcome::Trusted);
    let only = Evidence { envelope: &whole.envelope, ..Evidence::default() };
    assert_eq!(audit(&only).outcome, Outcome::Valid);
}

#[test]
fn an_owners_word_alone_is_valid_and_not_trusted() {
    let mut whole = whole();
    whole.envelope = owner_record().seal(&key(1)).unwrap().to_json().into_bytes();
    let report = whole.audit();
    assert_eq!(report.outcome, Outcome::Valid, "{report}");
    assert!(report.has(Code::RegistrySignatureMissing) && report.has(Code::InclusionProven));
}

#[test]
fn another_registrys_word_is_not_the_pinned_ones() {
    let mut whole = whole();
    whole.pinned = NoteVerifier::new(ORIGIN, key(201).public()).unwrap();
    assert_eq!(errors(&whole.audit()), ["checkpoint.signature.invalid", "signature.registry.invalid"]);
    whole.pinned = NoteVerifier::new("other.example/log", registry().public()).unwrap();
    assert_eq!(errors(&whole.audit()), ["checkpoint.origin.unknown", "record.origin.mismatch"]);
    // A tree that anybody drew up, signed by somebody else under the same name.
    let mut whole = self::whole();
    whole.proof = proof_of(&countersigned(), &key(9), ORIGIN);
    let report = whole.audit();
    assert_eq!(errors(&report), ["checkpoint.signature.invalid"]);
    assert!(!report.has(Code::InclusionProven));
}

/// Positions of the bytes of `part` in `text`.
fn places(text: &[u8], part: &str) -> Vec<usize> {
    let part = part.as_bytes();
    (0..text.len().saturating_sub(part.len()))
        .filter(|at| text[*at..].starts_with(part))
        .flat_map(|at| at..at + part.len())
        .collect()
}

#[test]
fn a_flipped_byte_anywhere_in_the_envelope_is_noticed_and_named() {
    let good = whole();
    // Labels are hints that nothing rests on (DSSE): changed ones are named, and change nothing.
    let mut labels = places(&good.envelope, "keyid");
    labels.extend(places(&good.envelope, &key(1).public().id().to_string()));
    labels.extend(places(&good.envelope, &registry().public().id().to_string()));
    assert_eq!(labels.len(), 2 * (5 + 64));
    for at in 0..good.envelope.len() {
        for mask in [0x01, 0x20, 0x80] {
            let mut whole = whole();
            whole.envelope[at] ^= mask;
            let report = whole.audit();
            let shown = || format!("byte {at} mask {mask}: {report}");
            let named = errors(&report);
            if !labels.contains(&at) {
                assert_eq!(report.outcome, Outcome::Invalid, "{}", shown());
                // Where the change makes the body unreadable, that is what is named.
                let right = |c: &&str| ["envelope.", "signature.", "record."].iter().any(|part| c.starts_with(part));
                assert!(named.iter().all(right), "{}", shown());
            } else if report.outcome != Outcome::Invalid {
                assert!(report.has(Code::SignatureKeyidMismatch), "{}", shown());
            }
        }
    }
}

#[test]
fn a_flipped_byte_anywhere_in_the_proof_is_noticed_and_named() {
    let good = whole();
    for at in 0..good.proof.len() {
        for mask in [0x01, 0x04, 0x20] {
            let mut bytes = good.proof.clone().into_bytes();
            bytes[at] ^= mask;
            let Ok(proof) = String::from_utf8(bytes) else { continue };
            let report = Whole { proof, ..whole() }.audit();
            assert_eq!(report.outcome, Outcome::Invalid, "byte {at} mask {mask}: {report}");
            let named = errors(&report);
            let right =
                |c: &&str| c.starts_with("proof.") || c.starts_with("checkpoint.") || c.starts_with("inclusion.");
            assert!(named.iter().all(right), "byte {at} mask {mask}: {report}");
        }
    }
}

/// One thing in hand, what to do to one of its bytes, and the finding that must follow.
type Spoil = (fn(&Whole) -> usize, fn(&mut Whole, usize), &'static str);

#[test]
fn a_flipped_byte_anywhere_in_the_files_is_noticed_and_named() {
    fn flipped(digest: Digest, at: usize) -> Digest {
        let mut bytes = *digest.as_bytes();
        bytes[at] ^= 1;
        Digest::from_bytes(bytes)
    }
    let spoils: [Spoil; 6] = [
        (|w| w.field.len(), |w, at| w.field[at] ^= 1, "digest.marked_field.mismatch"),
        (|w| w.detector.len(), |w, at| w.detector[at] ^= 1, "digest.detector.mismatch"),
        (|w| w.signal.len(), |w, at| w.signal[at] ^= 1, "digest.hidden_signal.mismatch"),
        (|_| 32, |w, at| w.salt = flipped(w.salt, at), "digest.hidden_signal.mismatch"),
        (
            |_| 96,
            |w, at| w.photographs[at / 32] = flipped(w.photographs[at / 32], at % 32),
            "digest.photographs.mismatch",
        ),
        (|w| w.configuration.len(), |w, at| w.configuration[at] ^= 1, "digest.training_configuration.mismatch"),
    ];
    for (length, spoil, code) in spoils {
        for at in 0..length(&whole()) {
            let mut whole = whole();
            spoil(&mut whole, at);
            let report = whole.audit();
            assert_eq!((report.outcome, errors(&report)), (Outcome::Invalid, vec![code]), "byte {at}: {report}");
        }
    }
    let mut fewer = whole();
    fewer.photographs.pop();
    assert_eq!(errors(&fewer.audit()), ["digest.photographs.mismatch"]);
    let mut shuffled = whole();
    shuffled.photographs.reverse();
    assert_eq!(shuffled.audit().outcome, Outcome::Trusted);
}

#[test]
fn a_file_that_the_record_does_not_speak_of_is_not_vouched_for() {
    let mut record = owner_record();
    record.digests.photographs = None;
    let mut envelope = record.seal(&key(1)).unwrap();
    envelope.sign(&registry());
    let mut whole = whole();
    whole.proof = proof_of(&envelope, &registry(), ORIGIN);
    whole.envelope = envelope.to_json().into_bytes();
    assert_eq!(errors(&whole.audit()), ["digest.photographs.mismatch"]);
}

fn signed_body(body: &str) -> Vec<u8> {
    let mut envelope = Envelope::new(PAYLOAD_TYPE, body);
    envelope.sign(&key(1));
    envelope.to_json().into_bytes()
}

#[test]
fn each_wrong_record_has_its_code() {
    let body = serde_json::to_string(&owner_record()).unwrap();
    let mut other_type = Envelope::new("application/vnd.in-toto+json", body.as_str());
    other_type.sign(&key(1));
    let weak = body.replace(&key(1).public().to_string(), &"0".repeat(64));
    let cases = [
        (signed_body(&weak), "key.small_order"),
        (signed_body(&body.replacen("\"version\":1", "\"version\":2", 1)), "record.version.unknown"),
        (signed_body(&body.replace("liberty", "")), "record.malformed"),
        (signed_body(&body.replacen('{', r#"{"more":1,"#, 1)), "record.malformed"),
        (
            signed_body(&body.replace(&key(1).public().to_string(), &key(2).public().to_string())),
            "signature.owner.invalid",
        ),
        (other_type.to_json().into_bytes(), "envelope.type.unknown"),
        (b"{}".to_vec(), "envelope.malformed"),
        (vec![], "envelope.malformed"),
    ];
    for (envelope, code) in cases {
        let report = audit(&Evidence { envelope: &envelope, ..Evidence::default() });
        assert_eq!(errors(&report), [code], "{report}");
    }
}

#[test]
fn a_proof_of_another_record_is_no_proof_of_this_one() {
    let mut other = owner_record();
    other.purpose = "something else".into();
    let other = other.seal(&key(1)).unwrap();
    let report = Whole { proof: proof_of(&other, &registry(), ORIGIN), ..whole() }.audit();
    assert_eq!(errors(&report), ["inclusion.failed"]);
    let mut early = owner_record();
    early.seen.size = 5;
    let mut envelope = early.seal(&key(1)).unwrap();
    envelope.sign(&registry());
    let mut whole = whole();
    whole.proof = proof_of(&envelope, &registry(), ORIGIN);
    whole.envelope = envelope.to_json().into_bytes();
    assert_eq!(errors(&whole.audit()), ["record.seen.contradiction"]);
}

#[test]
fn extra_signatures_and_fields_are_named_and_do_no_harm() {
    let mut envelope = countersigned();
    envelope.sign(&key(50));
    let mut whole = whole();
    whole.envelope = envelope.to_json().replacen('{', r#"{"note":"x","#, 1).into_bytes();
    let report = whole.audit();
    assert!(report.has(Code::SignatureUnknown) && report.has(Code::EnvelopeFieldIgnored), "{report}");
    assert_eq!(report.outcome, Outcome::Trusted);
}

#[test]
fn a_policy_bounds_the_time_from_above_and_the_record_from_below() {
    let witness = WitnessVerifier::new("w.example", key(90).public()).unwrap();
    let policy = Policy::parse(format!("log {}\nwitness w {witness}\nquorum w\n", pinned())).unwrap();
    let mut record = owner_record();
    record.seen.size = 3;
    let mut envelope = record.seal(&key(1)).unwrap();
    envelope.sign(&registry());
    let mut whole = whole();
    whole.envelope = envelope.to_json().into_bytes();
    whole.proof = proof_of(&envelope, &registry(), ORIGIN);
    let report = |whole: &Whole| audit(&Evidence { policy: Some(&policy), ..whole.evidence() });
    let missing = report(&whole);
    assert_eq!(errors(&missing), ["policy.quorum.missing"]);
    assert!(missing.has(Code::TimeNotEarlierThan) && !missing.has(Code::TimeNotLaterThan), "{missing}");

    let mut proof = TlogProof::parse(&whole.proof).unwrap();
    let mut note = Note::parse(&proof.checkpoint).unwrap();
    note.signatures.push(cosign(&note.text, 1_700_000_000, "w.example", &key(90)).unwrap());
    proof.checkpoint = note.to_string();
    whole.proof = proof.to_text();
    let met = report(&whole);
    assert_eq!(met.outcome, Outcome::Trusted, "{met}");
    assert!(met.has(Code::PolicyQuorumMet) && met.to_string().contains("2023-11-14T22:13:20Z"), "{met}");
    note.signatures[1].signature[30] ^= 1;
    proof.checkpoint = note.to_string();
    whole.proof = proof.to_text();
    assert_eq!(errors(&report(&whole)), ["policy.signature.invalid"]);
}

fn later(kind: RecordKind, by: u8, also: Option<u8>, names: bool) -> Vec<u8> {
    let mut record = owner_record();
    record.kind = kind;
    record.owner_key = key(by).public();
    record.replaces =
        (names || matches!(kind, RecordKind::Rotation | RecordKind::Dispute)).then(|| countersigned().digest());
    record.purpose = "later".into();
    let mut envelope = record.seal(&key(by)).unwrap();
    also.into_iter().for_each(|other| envelope.sign(&key(other)));
    envelope.to_json().into_bytes()
}

#[test]
fn the_end_of_a_key_counts_by_log_index() {
    let with = |index, envelope: Vec<u8>| {
        let mut whole = whole();
        whole.log.records.push(RecordInHand { index, envelope });
        whole.audit()
    };
    let revocation = || later(RecordKind::Revocation, 1, None, false);
    assert_eq!(errors(&with(2, revocation())), ["record.after_revocation"]);
    let report = with(6, revocation());
    assert!(report.outcome == Outcome::Trusted && report.has(Code::KeyEndedLater), "{report}");
    assert_eq!(errors(&with(6, later(RecordKind::Revocation, 1, None, true))), ["record.revoked"]);
    // A rotation ends the old key only with the old key's signature.
    assert_eq!(errors(&with(2, later(RecordKind::Rotation, 3, Some(1), true))), ["record.after_revocation"]);
    assert!(with(6, later(RecordKind::Rotation, 3, Some(1), true)).has(Code::KeyEndedLater));
    assert!(errors(&with(2, later(RecordKind::Rotation, 3, None, true))).is_empty());
    // A stranger can end nobody's key, and can dispute.
    assert!(errors(&with(2, later(RecordKind::Revocation, 5, None, true))).is_empty());
    let report = with(7, later(RecordKind::Dispute, 5, None, true));
    assert!(report.has(Code::RecordDisputed) && report.outcome == Outcome::Trusted, "{report}");
    // Broken records and such beyond the view do not count, and are named.
    let mut broken = revocation();
    broken[40] ^= 1;
    for report in [with(2, broken), with(9, revocation())] {
        assert!(report.has(Code::LaterRecordInvalid) && errors(&report).is_empty(), "{report}");
    }
}

#[test]
fn without_a_place_in_the_log_an_ended_key_is_no_good() {
    let mut whole = whole();
    whole.log.records.push(RecordInHand { index: 6, envelope: later(RecordKind::Revocation, 1, None, false) });
    let mut evidence = whole.evidence();
    evidence.proof = None;
    assert_eq!(errors(&audit(&evidence)), ["record.after_revocation"]);
    let mut evidence = whole.evidence();
    evidence.pinned = None;
    assert_eq!(errors(&audit(&evidence)), ["record.after_revocation"]);
    // A view that does not reach the record cannot tell.
    let mut short = self::whole();
    short.log.size = 4;
    let report = short.audit();
    assert_eq!(report.freshness, Freshness::CannotTell);
    assert!(report.has(Code::FreshnessUnknown));
}

#[test]
fn reports_are_readable_by_people_and_by_programs() {
    let mut whole = whole();
    whole.field[0] ^= 1;
    let report = whole.audit();
    let text = report.to_string();
    for part in ["invalid\n", "error    digest.marked_field.mismatch  field.safetensors", "expected", "got", "remedy"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
    assert_eq!((json["version"].as_u64(), json["outcome"].as_str()), (Some(1), Some("invalid")));
    assert_eq!(json["freshness"]["as_of"], 9);
    let finding = json["findings"].as_array().unwrap().iter().find(|f| f["severity"] == "error").unwrap();
    assert_eq!(finding["code"], "digest.marked_field.mismatch");
    assert_eq!(finding["expected"], Digest::of(FIELD).to_string());
    assert!(finding["remedy"].as_str().unwrap().len() > 10);
}

#[test]
fn codes_are_unique_and_every_failure_has_a_remedy() {
    let mut names: Vec<_> = Code::ALL.iter().map(|c| c.as_str()).collect();
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), count);
    for code in Code::ALL {
        let name = code.as_str();
        assert!(name.contains('.') && name.chars().all(|c| c.is_ascii_lowercase() || "._".contains(c)), "{name}");
        if code.severity() >= Severity::Warning {
            assert!(!code.remedy().is_empty(), "{name}");
        }
    }
}

#[test]
fn a_bundle_is_two_small_files_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let whole = whole();
    let at = |ending: &str| folder.path().join(format!("record{ending}"));
    std::fs::write(at(".dsse.json"), &whole.envelope).unwrap();
    assert!(Bundle::read(&at("")).unwrap_err().to_string().contains("record.tlog-proof"));
    std::fs::write(at(".tlog-proof"), &whole.proof).unwrap();
    for name in ["", ".dsse.json", ".tlog-proof"] {
        let bundle = Bundle::read(&at(name)).unwrap();
        let report = audit(&Evidence { pinned: Some(&whole.pinned), ..bundle.evidence() });
        assert_eq!(report.outcome, Outcome::Trusted, "{report}");
    }
    assert!(whole.proof.len() < 2048, "a proof is small: {} bytes", whole.proof.len());
    std::fs::write(at(".tlog-proof"), [0xff; 8]).unwrap();
    assert_eq!(errors(&audit(&Bundle::read(&at("")).unwrap().evidence())), ["proof.malformed"]);
    std::fs::write(at(".tlog-proof"), vec![b'a'; 2 << 20]).unwrap();
    assert!(Bundle::read(&at("")).unwrap_err().to_string().contains("more than"));
}
