//! What came after the record: its owner's key ended, the record taken back, disputes.
//!
//! Time is counted in log indices only. A key's end does not touch what it signed before.

use cairn_registry::{Digest, Envelope, OwnerRecord, PublicKey, RecordKind};

use crate::{
    code::Code,
    evidence::LogView,
    report::{Findings, Freshness},
};

pub(crate) fn check(
    record: &OwnerRecord,
    digest: Digest,
    index: Option<u64>,
    log: Option<&LogView>,
    findings: &mut Findings,
) -> Freshness {
    let Some(log) = log else {
        findings.add(Code::FreshnessUnknown, "log", "the log's later records", "none");
        return Freshness::CannotTell;
    };
    if let Some(index) = index.filter(|index| *index >= log.size) {
        let expected = format!("a view of the log beyond index {index}");
        findings.add(Code::FreshnessUnknown, "log", expected, format!("one of size {}", log.size));
        return Freshness::CannotTell;
    }
    findings.add(Code::FreshnessKnown, "log", "", format!("known up to size {}", log.size));
    for later in &log.records {
        let place = format!("log, record {}", later.index);
        let opened = Envelope::parse(&later.envelope).map_err(|e| e.to_string()).and_then(|envelope| {
            let (record, _) = OwnerRecord::open(&envelope).map_err(|e| e.to_string())?;
            Ok((envelope, record))
        });
        match opened {
            Ok(_) if later.index >= log.size => {
                let expected = format!("an index below the view's size {}", log.size);
                findings.add(Code::LaterRecordInvalid, place, expected, later.index);
            }
            Ok((envelope, other)) if envelope.digest() != digest => {
                weigh(record, digest, index, later.index, &place, &envelope, &other, findings);
            }
            Ok(_) => {}
            Err(e) => findings.add(Code::LaterRecordInvalid, place, "a record signed by its owner", e),
        }
    }
    Freshness::AsOf(log.size)
}

/// What one other record means for the record under audit.
#[expect(clippy::too_many_arguments, reason = "two records, each with its index, and where to write")]
fn weigh(
    record: &OwnerRecord,
    digest: Digest,
    index: Option<u64>,
    other_index: u64,
    place: &str,
    envelope: &Envelope,
    other: &OwnerRecord,
    findings: &mut Findings,
) {
    let owner: PublicKey = record.owner_key;
    let about_this = other.replaces == Some(digest);
    let ended = match other.kind {
        RecordKind::Revocation => other.owner_key == owner,
        // The old key's signature, not the new owner's word, ends the old key.
        RecordKind::Rotation => other.owner_key != owner && envelope.signature_by(&owner).is_some(),
        RecordKind::Dispute => {
            if about_this {
                findings.add(Code::RecordDisputed, place, "", format!("by {}: {}", other.owner_key, other.purpose));
            }
            return;
        }
        RecordKind::Claim | RecordKind::Contribution | RecordKind::Training => return,
    };
    if !ended {
        return;
    }
    if about_this && other.kind == RecordKind::Revocation {
        return findings.add(Code::RecordRevoked, place, "a record that its owner upholds", &other.purpose);
    }
    match index {
        Some(index) if index < other_index => {
            findings.add(
                Code::KeyEndedLater,
                place,
                "",
                format!("at index {other_index}, behind the record's {index}"),
            );
        }
        Some(index) => {
            let expected = format!("a record before index {other_index}");
            findings.add(Code::RecordAfterRevocation, place, expected, format!("one at index {index}"));
        }
        // Without a proof the record has no place in the log, so it cannot be shown to come before.
        None => {
            let expected = format!("a proof that the record lies before index {other_index}");
            findings.add(Code::RecordAfterRevocation, place, expected, "no proof of its place");
        }
    }
}
