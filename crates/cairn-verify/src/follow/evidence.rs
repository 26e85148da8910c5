//! Both sides of a contradiction, and what they prove to somebody who was not there.

use std::fmt;

use cairn_log::format::NoteVerifier;
use serde::Serialize;

use super::{
    fetch::{Fetch, Signed},
    reader::Reader,
};
use crate::{
    code::Code,
    report::{Finding, Findings, Outcome, lines, report},
};

/// What a follower keeps when a log contradicts itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Contradiction {
    /// The checkpoint seen first, a signed note.
    pub first: String,
    /// The checkpoint seen later.
    pub second: String,
    /// Tiles of the larger of the two, by path: they lead to its root, and to the root that it had at the smaller size.
    pub tiles: Vec<(String, Vec<u8>)>,
}

/// What a contradiction's evidence proves.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EvidenceReport {
    /// Format version of the report's JSON.
    pub version: u32,
    /// [`Outcome::Trusted`]: two histories are proven, under the pinned key. [`Outcome::Valid`]: both notes are signed,
    /// but that they exclude each other cannot be told. [`Outcome::Invalid`]: the evidence does not hold.
    pub outcome: Outcome,
    /// All findings, in the order of the checks.
    pub findings: Vec<Finding>,
}

/// Checks the evidence of a contradiction anew, believing nobody but the key. `tiles`: those that were kept.
pub fn audit_evidence(first: &str, second: &str, tiles: &dyn Fetch, pinned: &NoteVerifier) -> EvidenceReport {
    let mut findings = Findings::default();
    let pair = [("first", first), ("second", second)];
    let pair = pair.map(|(name, note)| Signed::check(note, pinned, name, &mut findings));
    if let [Some(a), Some(b)] = pair {
        let (small, large) = if a.checkpoint.size <= b.checkpoint.size {
            (a.checkpoint, b.checkpoint)
        } else {
            (b.checkpoint, a.checkpoint)
        };
        let place = "first, second";
        if small.size == large.size && small.root != large.root {
            let got = format!("roots {} and {} at size {}", small.root, large.root, small.size);
            findings.add(Code::EvidenceProven, place, "", got);
        } else if small.size == large.size {
            findings.add(Code::EvidenceNone, place, "two checkpoints that differ", "the same twice");
        } else if small.size == 0 {
            findings.add(
                Code::EvidenceNone,
                place,
                "a history that excludes the other",
                "an empty one, which none does",
            );
        } else {
            match Reader::new(tiles, large.size).roots(small.size, large.size) {
                Err(e) => findings.add(Code::EvidenceUntold, "tiles", "tiles of the larger tree", e),
                Ok((_, root)) if root != large.root => {
                    let got = format!("tiles that make root {root}");
                    findings.add(Code::EvidenceUntold, "tiles", format!("root {}", large.root), got);
                }
                Ok((root, _)) if root != small.root => {
                    let got = format!(
                        "the tree of size {} had root {root} at size {}, and {} was signed",
                        large.size, small.size, small.root
                    );
                    findings.add(Code::EvidenceProven, place, "", got);
                }
                Ok(_) => {
                    let got = format!("one history, seen at size {} and at size {}", small.size, large.size);
                    findings.add(Code::EvidenceUntold, place, "histories that exclude each other", got);
                }
            }
        }
    }
    let outcome = findings.outcome(findings.has(Code::EvidenceProven));
    EvidenceReport { version: EvidenceReport::VERSION, outcome, findings: findings.0 }
}

report!(EvidenceReport);

impl fmt::Display for EvidenceReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let answer = match self.outcome {
            Outcome::Trusted => "proven: the log signed two histories",
            Outcome::Valid => "cannot tell: both are signed, and may be one history",
            Outcome::Invalid => "invalid: this proves nothing",
        };
        writeln!(f, "{answer}")?;
        lines(&self.findings, f)
    }
}
