//! The checks, in the order in which they can mean something: the checkpoint under the
//! pinned key, the envelope and its signatures, inclusion, the files in hand, and what came later.

use cairn_log::format::{
    Checkpoint, CheckpointError, Digest, DsseError, Envelope, KeyError, NoteError, NoteVerifier, OwnerRecord,
    PublicKey, RecordError, SignedRecord, TlogProof, merkle,
    record::{PAYLOAD_TYPE, VERSION},
};

use crate::{
    code::Code,
    evidence::Evidence,
    later, policy,
    report::{Findings, Freshness, Report},
};

/// Verifies a record with everything in hand.
///
/// Never fails: whatever is wrong with the evidence is a finding. The outcome is
/// [`Outcome::Trusted`](crate::Outcome::Trusted) only where the pinned registry signed the record and its log, under a checkpoint signed by the
/// pinned key, includes it.
pub fn audit(evidence: &Evidence<'_>) -> Report {
    let mut findings = Findings::default();
    let proof = evidence.proof.and_then(|text| check_proof(text, evidence, &mut findings));
    let mut digest = None;
    let mut freshness = Freshness::CannotTell;
    if let Some(signed) = check_envelope(evidence.envelope, &mut digest, &mut findings) {
        let record = signed.record();
        check_other_signatures(&signed, evidence.pinned, &mut findings);
        match &proof {
            Some(proof) => check_inclusion(&signed, proof, &mut findings),
            None if evidence.proof.is_none() => {
                findings.add(Code::InclusionMissing, "proof", "a .tlog-proof", "none");
            }
            None => {}
        }
        check_files(record, evidence, &mut findings);
        // A place in the log counts only where the pinned log vouches for it: anybody can draw up a tree of their own.
        let anchored = findings.has(Code::CheckpointVerified) && findings.has(Code::InclusionProven);
        let index = proof.as_ref().filter(|_| anchored).map(|p| p.proof.index);
        let audited = later::Audited { record, digest: signed.digest(), index };
        freshness = later::check(&audited, evidence.log, &mut findings);
    }
    let anchored = [Code::RegistrySignatureValid, Code::CheckpointVerified, Code::InclusionProven];
    let outcome = findings.outcome(anchored.iter().all(|code| findings.has(*code)));
    let record = digest.map(|d| d.to_string());
    Report { version: Report::VERSION, outcome, freshness, record, findings: findings.0 }
}

/// A proof whose checkpoint holds as far as that can be told.
struct Checked {
    proof: TlogProof,
    checkpoint: Checkpoint,
}

fn check_proof(text: &str, evidence: &Evidence<'_>, findings: &mut Findings) -> Option<Checked> {
    let proof = match TlogProof::parse(text) {
        Ok(proof) => proof,
        Err(e) => {
            findings.add(Code::ProofMalformed, "proof", "a .tlog-proof", e);
            return None;
        }
    };
    let checkpoint = check_checkpoint(&proof.checkpoint, evidence.pinned, "checkpoint", findings)?;
    if let (Some(policy), Some(pinned)) = (evidence.policy, evidence.pinned) {
        policy::check(policy, pinned, &proof.checkpoint, "checkpoint", findings);
    }
    Some(Checked { proof, checkpoint })
}

/// A checkpoint that the pinned log signed; without a pinned key, one that can be read.
pub(crate) fn check_checkpoint(
    note: &str,
    pinned: Option<&NoteVerifier>,
    place: &str,
    findings: &mut Findings,
) -> Option<Checkpoint> {
    let Some(pinned) = pinned else {
        return match Checkpoint::read(note) {
            Ok((_, checkpoint)) => Some(checkpoint),
            Err(e) => {
                findings.add(Code::CheckpointMalformed, place, "a signed checkpoint", e);
                None
            }
        };
    };
    match Checkpoint::verify(note, pinned) {
        Ok(checkpoint) => {
            let got = format!("size {}, root {}", checkpoint.size, checkpoint.root);
            findings.add(Code::CheckpointVerified, place, "", got);
            Some(checkpoint)
        }
        Err(e) => {
            let code = match &e {
                CheckpointError::Origin { .. } => Code::CheckpointOriginUnknown,
                CheckpointError::Note(NoteError::BadSignature { .. } | NoteError::NoneVerified { .. }) => {
                    Code::CheckpointSignatureInvalid
                }
                CheckpointError::Note(_) | CheckpointError::Line { .. } => Code::CheckpointMalformed,
            };
            findings.add(code, place, format!("a checkpoint signed by {pinned}"), e);
            None
        }
    }
}

/// The envelope, its record, and the owner's signature over exactly those bytes.
fn check_envelope(json: &[u8], digest: &mut Option<Digest>, findings: &mut Findings) -> Option<SignedRecord> {
    let envelope = match Envelope::parse(json) {
        Ok(envelope) => envelope,
        Err(e) => {
            findings.add(Code::EnvelopeMalformed, "envelope", "a DSSE envelope", e);
            return None;
        }
    };
    *digest = Some(envelope.digest());
    for field in &envelope.ignored_fields {
        findings.add(Code::EnvelopeFieldIgnored, format!("envelope, field {field}"), "no such field", field);
    }
    match SignedRecord::open(envelope.clone()) {
        Ok(signed) => {
            findings.add(Code::OwnerSignatureValid, "envelope", "", format!("by key {}", signed.record().owner_key));
            Some(signed)
        }
        Err(e) => {
            let of_version = format!("an owner record of version {VERSION}");
            let (code, expected) = match &e {
                RecordError::Envelope(DsseError::PayloadType { .. }) => (Code::EnvelopeTypeUnknown, PAYLOAD_TYPE),
                RecordError::Envelope(_) => (Code::EnvelopeMalformed, "a DSSE envelope"),
                RecordError::Version { .. } => (Code::RecordVersionUnknown, of_version.as_str()),
                RecordError::OwnerSignature { .. } => (Code::OwnerSignatureInvalid, "a signature by the owner named"),
                RecordError::Json { .. } if owner_key_is_weak(&envelope.payload) => {
                    (Code::KeySmallOrder, "a key of prime order")
                }
                RecordError::Json { .. } | RecordError::Field { .. } => (Code::RecordMalformed, of_version.as_str()),
            };
            findings.add(code, "envelope, payload", expected, e);
            None
        }
    }
}

/// Looks past the strict reader, which refuses such a record as a whole, to tell why it does.
fn owner_key_is_weak(body: &[u8]) -> bool {
    let value: Option<serde_json::Value> = serde_json::from_slice(body).ok();
    let key = value.as_ref().and_then(|v| v.get("owner_key")).and_then(|v| v.as_str());
    matches!(key.map(str::parse::<PublicKey>), Some(Err(KeyError::SmallOrder { .. })))
}

fn check_other_signatures(signed: &SignedRecord, pinned: Option<&NoteVerifier>, findings: &mut Findings) {
    let (envelope, leaf, record) = (signed.envelope(), signed.leaf(), signed.record());
    let pae = envelope.pae();
    let known: Vec<_> = [Some(&record.owner_key), pinned.map(NoteVerifier::key)].into_iter().flatten().collect();
    let mut strangers = Vec::new();
    let mut by_registry = false;
    for (i, signature) in envelope.signatures.iter().enumerate() {
        let place = format!("envelope, signatures[{i}]");
        // The leaf holds the owner's signature, which was verified; elsewhere the label says which key to try first.
        let of_owner = signature.sig == leaf.signature;
        let (labelled, others): (Vec<_>, Vec<_>) =
            known.iter().partition(|key| key.id().to_string() == signature.keyid);
        let holds = |key: &&&PublicKey| key.verify(&pae, &signature.sig).is_ok();
        let found = if of_owner { known.first() } else { labelled.into_iter().chain(others).find(holds) };
        let Some(key) = found.copied() else {
            strangers.push(place);
            continue;
        };
        by_registry |= pinned.is_some_and(|p| p.key() == key);
        let label = key.id().to_string();
        if signature.keyid != label {
            findings.add(Code::SignatureKeyidMismatch, place, label, format!("{:?}", signature.keyid));
        }
    }
    if let Some(pinned) = pinned {
        let expected = format!("a signature by {pinned}");
        if record.origin != pinned.name() {
            findings.add(Code::RecordOriginMismatch, "record, field origin", pinned.name(), &record.origin);
        }
        if by_registry {
            findings.add(Code::RegistrySignatureValid, "envelope", "", format!("by {pinned}"));
        } else if strangers.is_empty() {
            findings.add(Code::RegistrySignatureMissing, "envelope", expected, "the owner's only");
        } else {
            // A signature that holds under no known key may be the registry's, broken.
            findings.add(Code::RegistrySignatureInvalid, strangers.join("; "), expected, "none that verifies");
            return;
        }
    } else {
        findings.add(Code::RegistryUnpinned, "registry", "a pinned verifier key", "none");
    }
    for place in strangers {
        findings.add(Code::SignatureUnknown, place, "a signature by the owner or a pinned key", "one by nobody known");
    }
}

fn check_inclusion(signed: &SignedRecord, checked: &Checked, findings: &mut Findings) {
    let (leaf, record) = (signed.leaf(), signed.record());
    let Checked { proof, checkpoint } = checked;
    let (index, size) = (proof.index, checkpoint.size);
    let place = format!("record at index {index} of {size}");
    let leaf_hash = leaf.hash();
    if record.seen.size > index {
        let expected = format!("at most {index}, the record's own index");
        findings.add(Code::RecordSeenContradiction, "record, field seen.size", expected, record.seen.size);
    }
    if record.origin != checkpoint.origin && !findings.has(Code::RecordOriginMismatch) {
        findings.add(Code::RecordOriginMismatch, "record, field origin", &checkpoint.origin, &record.origin);
    }
    match merkle::verify_inclusion(&leaf_hash, index, size, &proof.hashes, &checkpoint.root) {
        Ok(()) => {
            findings.add(Code::InclusionProven, place, "", format!("leaf hash {leaf_hash}"));
            // The owner could not have named a root that was not there yet.
            if record.seen.size > 0 && record.seen.size <= index && findings.has(Code::CheckpointVerified) {
                let got = format!("the checkpoint of size {}, root {}", record.seen.size, record.seen.root);
                findings.add(Code::TimeNotEarlierThan, "record, field seen", "", got);
            }
        }
        Err(e) => findings.add(Code::InclusionFailed, place, format!("root {}", checkpoint.root), e),
    }
}

fn check_files(record: &OwnerRecord, evidence: &Evidence<'_>, findings: &mut Findings) {
    let digests = &record.digests;
    let comparisons = [
        (
            digests.marked_field,
            &evidence.marked_field,
            "marked_field",
            [Code::MarkedFieldMatch, Code::MarkedFieldMismatch, Code::MarkedFieldUnchecked],
        ),
        (
            digests.base_field,
            &evidence.base_field,
            "base_field",
            [Code::BaseFieldMatch, Code::BaseFieldMismatch, Code::BaseFieldUnchecked],
        ),
        (
            digests.share_table,
            &evidence.share_table,
            "share_table",
            [Code::ShareTableMatch, Code::ShareTableMismatch, Code::ShareTableUnchecked],
        ),
        (
            digests.detector,
            &evidence.detector,
            "detector",
            [Code::DetectorMatch, Code::DetectorMismatch, Code::DetectorUnchecked],
        ),
        (
            digests.hidden_signal,
            &evidence.hidden_signal,
            "hidden_signal",
            [Code::HiddenSignalMatch, Code::HiddenSignalMismatch, Code::HiddenSignalUnchecked],
        ),
        (
            digests.photographs,
            &evidence.photographs,
            "photographs",
            [Code::PhotographsMatch, Code::PhotographsMismatch, Code::PhotographsUnchecked],
        ),
        (
            digests.training_configuration,
            &evidence.training_configuration,
            "training_configuration",
            [Code::ConfigurationMatch, Code::ConfigurationMismatch, Code::ConfigurationUnchecked],
        ),
    ];
    for (named, in_hand, field, [matches, mismatch, unchecked]) in comparisons {
        let record_field = || format!("record, field digests.{field}");
        match (named, in_hand) {
            (Some(named), Some(file)) if named == file.digest => findings.add(matches, &file.place, "", named),
            (Some(named), Some(file)) => findings.add(mismatch, &file.place, named, file.digest),
            // A file that the record does not speak of must not look vouched for.
            (None, Some(file)) => {
                findings.add(mismatch, &file.place, "no such file: the record names none", file.digest)
            }
            (Some(named), None) => findings.add(unchecked, record_field(), named, "nothing in hand"),
            (None, None) => {}
        }
    }
}
