//! What the records of a proven answer say about each other.
//!
//! Time is counted in log indices only. What lies behind the size that the question
//! is about changes nothing in the answer, and is told besides.

use std::{collections::BTreeMap, convert::Infallible};

use cairn_log::format::{
    Answer, Digest, MapKey, PublicKey, RecordKind, answer::key_said, heir::Ending, heir::same_owner, record::Effect,
};

use super::{
    lists::{Opened, Proven},
    report::{RecordWorth, Standing},
};
use crate::{code::Code, heirs::may_speak, report::Findings};

/// Weighs every record of the asked list, as of a log size.
pub(super) fn weigh(answer: &Answer, proven: &Proven<'_>, as_of: u64, findings: &mut Findings) -> Vec<RecordWorth> {
    let asked = answer.asked();
    let mut records: Vec<RecordWorth> =
        (proven.listed(&asked)).map(|(index, opened)| One { index, opened, as_of, proven }.weigh(findings)).collect();
    let weighed = records.iter().map(|record| (record.index, record.standing)).collect();
    let mut names = Names { proven, as_of, weighed, newest: BTreeMap::new() };
    for record in records.iter_mut().filter(|record| record.standing == Standing::Counts) {
        names.confirm(record, findings);
    }
    records
}

/// Which keys curators bound contributors' names to.
struct Names<'a> {
    proven: &'a Proven<'a>,
    as_of: u64,
    /// Records that were weighed already, by index.
    weighed: BTreeMap<u64, Standing>,
    /// Of each name, by the key of its bindings' list, the binding that counts.
    newest: BTreeMap<MapKey, Option<Bound>>,
}

/// A binding that counts.
#[derive(Clone, Copy)]
struct Bound {
    index: u64,
    /// The key that it names; none where it was erased.
    key: Option<PublicKey>,
}

impl Names<'_> {
    /// Says of a record that counts whether a curator bound its contributor's name to its owner's key.
    fn confirm(&mut self, record: &mut RecordWorth, findings: &mut Findings) {
        let said = self.proven.records.get(&record.index).and_then(|opened| opened.body.as_ref());
        let Some(list) = said.and_then(|said| key_said(said.record())) else { return };
        let (place, name) =
            (format!("record at index {}", record.index), record.contributor.clone().unwrap_or_default());
        let expected = format!("a binding of {name:?} to its owner's key");
        let got = match self.newest(list, findings) {
            None => "none".to_owned(),
            Some(Bound { index, key: None }) => format!("the binding at index {index}, which was erased"),
            Some(Bound { index, key: Some(key) }) if self.one_owner(&record.owner, &key.id()) => {
                record.confirmed_by = Some(index);
                let got = format!("{name:?} by the binding at index {index}");
                return findings.add(Code::AnswerRecordConfirmed, place, "", got);
            }
            Some(Bound { index, .. }) => format!("the binding at index {index}, to another key"),
        };
        findings.add(Code::AnswerRecordUnconfirmed, place, expected, got);
    }

    /// The newest binding of a list that stands.
    fn newest(&mut self, list: MapKey, findings: &mut Findings) -> Option<Bound> {
        if let Some(known) = self.newest.get(&list) {
            return *known;
        }
        let (proven, as_of) = (self.proven, self.as_of);
        let mut newest = None;
        for (index, opened) in proven.listed(&list).filter(|(_, opened)| opened.leaf.kind == RecordKind::Binding) {
            let weigh = || One { index, opened, as_of, proven }.weigh(findings).standing;
            // A binding credits nobody, so that is the best that becomes of it.
            if *self.weighed.entry(index).or_insert_with(weigh) == Standing::NoCredit {
                newest = Some(Bound { index, key: opened.bound() });
            }
        }
        self.newest.insert(list, newest);
        newest
    }

    fn one_owner(&self, one: &Digest, other: &Digest) -> bool {
        let ending = |key: &Digest| Ok::<_, Infallible>(ending(self.proven, key));
        let Ok(same) = same_owner(one, other, self.as_of, ending);
        same
    }
}

/// What ended a key first; that a rotation has the old key's signature was checked with the lists.
fn ending(proven: &Proven<'_>, key: &Digest) -> Option<Ending> {
    let (index, end) = proven.listed(&MapKey::ended(key)).next()?;
    Some(Ending { index, to: (end.leaf.kind == RecordKind::Rotation).then_some(end.leaf.owner) })
}

/// One record of the asked list.
struct One<'a> {
    index: u64,
    opened: &'a Opened,
    as_of: u64,
    proven: &'a Proven<'a>,
}

impl One<'_> {
    fn weigh(&self, findings: &mut Findings) -> RecordWorth {
        let Opened { leaf, body } = self.opened;
        let mut disputed_by = Vec::new();
        let own = match (leaf.kind.credits(), body) {
            (false, _) => Standing::NoCredit,
            (true, None) => Standing::Erased,
            (true, Some(_)) => Standing::Counts,
        };
        let standing = if self.index >= self.as_of {
            let got = format!("behind size {}", self.as_of);
            findings.add(Code::AnswerRecordLater, self.place(), "", got);
            Standing::Later
        } else {
            // The worst that befell it; each is told as a finding.
            own.max(self.about(&mut disputed_by, findings)).max(self.key_ended(findings))
        };
        RecordWorth {
            index: self.index,
            record: leaf.record,
            kind: leaf.kind,
            owner: leaf.owner,
            contributor: body.as_ref().map(|body| body.record().identity.contributor.clone()),
            number: body.as_ref().and_then(|body| body.record().identity.number),
            standing,
            confirmed_by: None,
            disputed_by,
        }
    }

    fn place(&self) -> String {
        format!("record at index {}", self.index)
    }

    /// What other records say about this one.
    fn about(&self, disputed_by: &mut Vec<u64>, findings: &mut Findings) -> Standing {
        let mut standing = Standing::Counts;
        for (index, other) in self.proven.listed(&MapKey::about(&self.opened.leaf.record)) {
            let kind = other.leaf.kind;
            let got = format!("{kind:?} at index {index}");
            let (code, then) = match kind.effect() {
                Effect::LeavesIt => continue,
                Effect::Contests => (Code::RecordDisputed, Standing::Counts),
                Effect::TakesBack => (Code::AnswerRecordRevoked, Standing::Revoked),
                Effect::Replaces => (Code::AnswerRecordReplaced, Standing::Replaced),
            };
            if kind.effect() != Effect::Contests
                && let Err(expected) = self.may_speak(index, other)
            {
                findings.add(Code::LaterRecordInvalid, self.place(), expected, got);
                continue;
            }
            if index >= self.as_of {
                findings.add(Code::AnswerChangedLater, self.place(), "", got);
                continue;
            }
            findings.add(code, self.place(), "", got);
            standing = standing.max(then);
            if kind.effect() == Effect::Contests {
                disputed_by.push(index);
            }
        }
        standing
    }

    /// Whether the record at `index` is by who spoke for this one's owner then, or carries that key's signature; else what
    /// it would have to be. Whoever found a key that its owner had ended speaks for nobody, whatever a registry lets in.
    fn may_speak(&self, index: u64, other: &Opened) -> Result<(), String> {
        let signed = |key: &PublicKey| other.body.as_ref().is_some_and(|b| b.envelope().signature_by(key).is_some());
        let spoke = |id: &Digest| other.leaf.owner == *id || self.proven.keys.get(id).is_some_and(signed);
        may_speak(&self.opened.leaf.owner, index, |key| ending(self.proven, key), spoke)
    }

    /// Whether the owner's key had ended before this record.
    fn key_ended(&self, findings: &mut Findings) -> Standing {
        let mut standing = Standing::Counts;
        for (index, other) in self.proven.listed(&MapKey::ended(&self.opened.leaf.owner)) {
            let got = format!("{:?} at index {index}", other.leaf.kind);
            if index < self.index {
                findings.add(Code::AnswerRecordKeyEnded, self.place(), format!("a record before index {index}"), got);
                standing = Standing::KeyEnded;
            } else if index >= self.as_of {
                findings.add(Code::AnswerChangedLater, self.place(), "", format!("its key ended: {got}"));
            } else if index > self.index {
                findings.add(Code::KeyEndedLater, self.place(), "", got);
            }
        }
        standing
    }
}
