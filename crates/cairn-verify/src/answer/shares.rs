//! The statement of shares beside an answer: that the registry signed it, about what was asked, and that it adds up.
//! Whether the shares are those of field and table, [`super::SharesReport`]'s maker has to work out again.

use std::fmt;

use cairn_log::format::{
    Answer, AnswerError, Checkpoint, NoteVerifier, RecordError,
    answer::Format,
    shares::{self, Shares},
};
use serde::Serialize;

use super::{
    question::{self, Question},
    report::shares_lines,
};
use crate::{
    check::check_checkpoint,
    code::Code,
    report::{Finding, Findings, Outcome, lines, report},
};

/// The result of the audit of a statement of shares.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SharesReport {
    /// Format version of the report's JSON.
    pub version: u32,
    /// In one word: trusted only where the pinned registry signed the statement, and its checkpoint.
    pub outcome: Outcome,
    /// What it says; none where it is invalid.
    pub shares: Option<Shares>,
    /// All findings, in the order of the checks.
    pub findings: Vec<Finding>,
}

report!(SharesReport);

impl SharesReport {
    /// The report with what was found besides, by who worked the shares out again.
    pub fn with(self, more: impl IntoIterator<Item = Finding>) -> Self {
        let mut findings = Findings(self.findings);
        findings.0.extend(more);
        Self::of(self.shares, findings)
    }

    fn of(shares: Option<Shares>, findings: Findings) -> Self {
        let anchored = findings.has(Code::CheckpointVerified) && findings.has(Code::SharesVerified);
        let outcome = findings.outcome(anchored);
        // An invalid statement says nothing.
        let shares = shares.filter(|_| outcome != Outcome::Invalid);
        Self { version: Self::VERSION, outcome, shares, findings: findings.0 }
    }
}

impl fmt::Display for SharesReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.outcome)?;
        if let Some(shares) = &self.shares {
            shares_lines(shares, f)?;
        }
        lines(&self.findings, f)
    }
}

/// Verifies the statement of shares beside an answer, JSON of [`Answer`], and nothing else of that but its checkpoint.
///
/// Never fails: whatever is wrong is a finding. Without the log's pinned key nothing is trusted.
pub fn audit_shares(answer: &[u8], pinned: Option<&NoteVerifier>) -> SharesReport {
    audit_shares_to(answer, pinned, None)
}

/// As [`audit_shares`]; where the question is given, an answer to another one is invalid.
pub fn audit_shares_to(answer: &[u8], pinned: Option<&NoteVerifier>, asked: Option<&Question>) -> SharesReport {
    let mut findings = Findings::default();
    let answer = match Answer::parse(answer) {
        Ok(answer) => answer,
        Err(e) => {
            let is_unknown = matches!(e, AnswerError::Format { .. });
            let code = if is_unknown { Code::AnswerFormatUnknown } else { Code::AnswerMalformed };
            findings.add(code, "answer", format!("a complete answer of format {}", Format::NAME), e);
            return SharesReport::of(None, findings);
        }
    };
    if pinned.is_none() {
        findings.add(Code::RegistryUnpinned, "registry", "a pinned verifier key", "none");
    }
    if let Some(asked) = asked {
        question::check(&answer, asked, &mut findings);
    }
    let checkpoint = check_checkpoint(&answer.checkpoint, pinned, "checkpoint", &mut findings);
    let shares = checkpoint.and_then(|checkpoint| check(&answer, &checkpoint, pinned, &mut findings));
    if shares.is_none() && !findings.failed() {
        let expected = "an answer about a view, of a scene that was trained";
        findings.add(Code::SharesMalformed, PLACE, expected, "no statement of shares");
    }
    SharesReport::of(shares, findings)
}

/// Where findings are.
const PLACE: &str = "answer, field shares";

/// The statement that stands beside an answer, where it holds; an answer about a view may have none.
pub(super) fn check(
    answer: &Answer,
    checkpoint: &Checkpoint,
    pinned: Option<&NoteVerifier>,
    findings: &mut Findings,
) -> Option<Shares> {
    let Some(envelope) = &answer.shares else {
        if answer.view.is_some() {
            findings.add(Code::SharesMissing, PLACE, "", "none");
        }
        return None;
    };
    let signer = pinned.map_or_else(|| "the registry that it names".to_owned(), ToString::to_string);
    let shares = match Shares::open(envelope) {
        Ok(shares) => shares,
        Err(e) => {
            let is_unsigned = matches!(e, RecordError::OwnerSignature { .. });
            let code = if is_unsigned { Code::SharesSignatureInvalid } else { Code::SharesMalformed };
            let expected = format!("a statement of shares of version {} by {signer}", shares::VERSION);
            findings.add(code, PLACE, expected, e);
            return None;
        }
    };
    if let Some(pinned) = pinned.filter(|pinned| *pinned.key() != shares.registry_key) {
        let got = format!("one by key {}", shares.registry_key);
        findings.add(Code::SharesSignatureInvalid, PLACE, format!("a statement by {pinned}"), got);
        return None;
    }
    let before = findings.0.len();
    let subject = |origin: &str, scene: &str, view: Option<String>| {
        let view = view.unwrap_or_else(|| "no view".to_owned());
        format!("log {origin}, scene {scene:?}, {view}")
    };
    let asked = subject(&checkpoint.origin, &answer.scene, answer.view.map(|view| format!("view {view}")));
    let said = subject(&shares.origin, &shares.scene, Some(format!("view {}", shares.view.photograph)));
    if asked != said {
        findings.add(Code::SharesSubjectMismatch, PLACE, asked, said);
    }
    let (size, root) = (shares.checkpoint.size, shares.checkpoint.root);
    if (size, root) != (checkpoint.size, checkpoint.root) {
        let expected = format!("size {}, root {}", checkpoint.size, checkpoint.root);
        findings.add(Code::SharesCheckpointMismatch, PLACE, expected, format!("size {size}, root {root}"));
    }
    if let Some((what, sum)) = shares.wrong_sum() {
        findings.add(Code::SharesSumMismatch, PLACE, what, format!("a sum of {sum}"));
    }
    if findings.0.len() > before {
        return None;
    }
    if pinned.is_some() {
        let photographs: usize = shares.contributors.iter().map(|of| of.photographs.len()).sum();
        let got = format!("{} contributors, {photographs} photographs, by {signer}", shares.contributors.len());
        findings.add(Code::SharesVerified, PLACE, "", got);
    }
    Some(shares)
}
