//! What came after the record: its owner's key ended, the record replaced or taken back, disputes.
//!
//! Time is counted in log indices only. A key's end does not touch what it signed before. Who may speak for the
//! owner follows rotations from key to key ([`cairn_log::format::heir::heir()`]), as in the registry and in complete answers.

use std::collections::BTreeMap;

use cairn_log::format::{
    Digest, OwnerRecord, PublicKey, SignedRecord,
    heir::{self, Ending},
    record::Effect,
};

use crate::{
    code::Code,
    evidence::LogView,
    heirs::may_speak,
    report::{Findings, Freshness},
};

/// The record under audit.
pub(crate) struct Audited<'a> {
    pub(crate) record: &'a OwnerRecord,
    pub(crate) digest: Digest,
    /// Its proven place in the log.
    pub(crate) index: Option<u64>,
}

/// A later record whose owner's signature holds.
struct Later {
    index: u64,
    signed: SignedRecord,
}

pub(crate) fn check(audited: &Audited<'_>, log: Option<&LogView>, findings: &mut Findings) -> Freshness {
    let Some(log) = log else {
        findings.add(Code::FreshnessUnknown, "log", "the log's later records", "none");
        return Freshness::CannotTell;
    };
    if let Some(index) = audited.index.filter(|index| *index >= log.size) {
        let expected = format!("a view of the log beyond index {index}");
        findings.add(Code::FreshnessUnknown, "log", expected, format!("one of size {}", log.size));
        return Freshness::CannotTell;
    }
    findings.add(
        Code::FreshnessKnown,
        "log",
        "",
        format!("known up to size {}, if the list in hand leaves nothing out", log.size),
    );
    let mut known = opened(log, findings);
    known.sort_by_key(|later| later.index);
    let keys = known.iter().map(|later| later.signed.record().owner_key).chain([audited.record.owner_key]);
    let view = View { audited, keys: keys.map(|key| (key.id(), key)).collect(), known: &known };
    for later in known.iter().filter(|later| later.signed.digest() != audited.digest) {
        view.weigh(later, findings);
    }
    Freshness::AsOf(log.size)
}

/// The records of the view that hold; the others are named.
fn opened(log: &LogView, findings: &mut Findings) -> Vec<Later> {
    let mut known = Vec::new();
    for later in &log.records {
        match SignedRecord::parse(&later.envelope) {
            Ok(_) if later.index >= log.size => {
                let expected = format!("an index below the view's size {}", log.size);
                findings.add(Code::LaterRecordInvalid, place(later.index), expected, later.index);
            }
            Ok(signed) => known.push(Later { index: later.index, signed }),
            Err(e) => {
                findings.add(Code::LaterRecordInvalid, place(later.index), "a record signed by its owner", e);
            }
        }
    }
    known
}

fn place(index: u64) -> String {
    format!("log, record {index}")
}

/// What is known of the log, for the record under audit.
struct View<'a> {
    audited: &'a Audited<'a>,
    /// Owners' keys by their ids.
    keys: BTreeMap<Digest, PublicKey>,
    /// By index.
    known: &'a [Later],
}

impl View<'_> {
    /// What one other record means for the record under audit.
    fn weigh(&self, other: &Later, findings: &mut Findings) {
        let record = other.signed.record();
        let kind = record.kind;
        if record.replaces == Some(self.audited.digest) {
            match kind.effect() {
                Effect::Contests => {
                    let got = format!("by {}: {}", record.owner_key, record.purpose);
                    return findings.add(Code::RecordDisputed, place(other.index), "", got);
                }
                Effect::TakesBack => {
                    if self.spoken_for(other, findings) {
                        let expected = "a record that its owner upholds";
                        return findings.add(Code::RecordRevoked, place(other.index), expected, &record.purpose);
                    }
                }
                Effect::Replaces => {
                    if self.spoken_for(other, findings) {
                        let got = format!("{kind:?} by {}", record.owner_key);
                        findings.add(Code::RecordReplaced, place(other.index), "", got);
                    }
                }
                Effect::LeavesIt => {}
            }
        }
        if heir::ends(&self.audited.record.owner_key, record, other.signed.envelope()).is_some() {
            self.key_ended(other.index, findings);
        }
    }

    /// Whether a record about the one under audit is by who spoke for its owner then, or carries that key's signature;
    /// else it is named.
    fn spoken_for(&self, other: &Later, findings: &mut Findings) -> bool {
        let owner = self.audited.record.owner_key.id();
        let spoke =
            |id: &Digest| self.keys.get(id).is_some_and(|key| other.signed.envelope().signature_by(key).is_some());
        let Err(expected) = may_speak(&owner, other.index, |key| self.ending(key), spoke) else { return true };
        let record = other.signed.record();
        let got = format!("{:?} by {}", record.kind, record.owner_key);
        findings.add(Code::LaterRecordInvalid, place(other.index), expected, got);
        false
    }

    /// What ended a key first.
    fn ending(&self, key: &Digest) -> Option<Ending> {
        let key = self.keys.get(key)?;
        let end = |later: &Later| {
            let to = heir::ends(key, later.signed.record(), later.signed.envelope())?;
            Some(Ending { index: later.index, to })
        };
        self.known.iter().find_map(end)
    }

    /// The owner's key was ended at `ended`: what it signed before stays good.
    fn key_ended(&self, ended: u64, findings: &mut Findings) {
        match self.audited.index {
            Some(index) if index < ended => {
                let got = format!("at index {ended}, behind the record's {index}");
                findings.add(Code::KeyEndedLater, place(ended), "", got);
            }
            Some(index) => {
                let expected = format!("a record before index {ended}");
                findings.add(Code::RecordAfterRevocation, place(ended), expected, format!("one at index {index}"));
            }
            // Without a proof the record has no place in the log, so it cannot be shown to come before.
            None => {
                let expected = format!("a proof that the record lies before index {ended}");
                findings.add(Code::RecordAfterRevocation, place(ended), expected, "no proof of its place");
            }
        }
    }
}
