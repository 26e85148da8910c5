//! The audit of a complete answer: that every record in it is in the log, that
//! none is left out, and what each is worth.
//!
//! In the order in which the checks can mean something: the checkpoint under the pinned key, the older one asked
//! for, the map's root as the log's last leaf, the lists under that root, the records
//! that they name, and only then what the records say about each other. That
//! the map itself follows from the log is for whoever reads the whole log to check; two maps at one size
//! would be two leaves at one index.

mod lists;
mod question;
mod report;
mod shares;
mod worth;

pub use question::Question;
pub use report::{AnswerReport, RecordWorth, Standing};
pub use shares::{SharesReport, audit_shares, audit_shares_to};

use cairn_log::format::{
    Answer, AnswerError, Checkpoint, Digest, MapLeaf, NoteVerifier,
    answer::Format,
    map,
    merkle::{verify_consistency, verify_inclusion},
    shares::Shares,
};

use crate::{
    check::check_checkpoint,
    code::Code,
    report::{Findings, Freshness, Outcome},
};

/// Verifies a complete answer of a registry: JSON of [`Answer`].
///
/// Never fails: whatever is wrong with the answer is a finding. Without the log's pinned key nothing is trusted.
pub fn audit_answer(answer: &[u8], pinned: Option<&NoteVerifier>) -> AnswerReport {
    audit_answer_to(answer, pinned, None)
}

/// As [`audit_answer`]; where the question is given, an answer to another one is invalid.
pub fn audit_answer_to(answer: &[u8], pinned: Option<&NoteVerifier>, asked: Option<&Question>) -> AnswerReport {
    let mut findings = Findings::default();
    let answer = match Answer::parse(answer) {
        Ok(answer) => answer,
        Err(e) => {
            let code = match &e {
                AnswerError::Format { .. } => Code::AnswerFormatUnknown,
                AnswerError::TooLarge { .. }
                | AnswerError::Json { .. }
                | AnswerError::Scene(_)
                | AnswerError::Order { .. } => Code::AnswerMalformed,
            };
            findings.add(code, "answer", format!("a complete answer of format {}", Format::NAME), e);
            return report(None, None, Said::default(), findings);
        }
    };
    if pinned.is_none() {
        findings.add(Code::RegistryUnpinned, "registry", "a pinned verifier key", "none");
    }
    if let Some(asked) = asked {
        question::check(&answer, asked, &mut findings);
    }
    let mut said = Said::default();
    let sizes = check_log(&answer, pinned, &mut findings);
    if let Some((sizes, root)) = &sizes
        && let Some(proven) = lists::check(&answer, &sizes.checkpoint, root, &mut findings)
        && !findings.failed()
    {
        said.records = worth::weigh(&answer, &proven, sizes.as_of, &mut findings);
        said.shares = shares::check(&answer, &sizes.checkpoint, pinned, &mut findings);
    }
    report(Some(answer), sizes.map(|(sizes, _)| sizes), said, findings)
}

/// The log that the answer is about.
struct Sizes {
    checkpoint: Checkpoint,
    /// The size that the question is about.
    as_of: u64,
}

/// What an answer that holds says.
#[derive(Default)]
struct Said {
    records: Vec<RecordWorth>,
    shares: Option<Shares>,
}

fn report(answer: Option<Answer>, sizes: Option<Sizes>, said: Said, findings: Findings) -> AnswerReport {
    let anchored = findings.has(Code::CheckpointVerified);
    let outcome = findings.outcome(anchored);
    // A checkpoint that nobody known signed tells nothing about what is known.
    let freshness = match &sizes {
        Some(sizes) if anchored && outcome != Outcome::Invalid => Freshness::AsOf(sizes.checkpoint.size),
        _ => Freshness::CannotTell,
    };
    AnswerReport {
        version: AnswerReport::VERSION,
        outcome,
        freshness,
        view: answer.as_ref().and_then(|a| a.view),
        scene: answer.map(|a| a.scene),
        as_of: sizes.filter(|_| outcome != Outcome::Invalid).map(|sizes| sizes.as_of),
        records: if outcome == Outcome::Invalid { Vec::new() } else { said.records },
        shares: said.shares.filter(|_| outcome != Outcome::Invalid),
        findings: findings.0,
    }
}

/// The checkpoints and the map's root; `None` where nothing further can mean anything.
fn check_log(answer: &Answer, pinned: Option<&NoteVerifier>, findings: &mut Findings) -> Option<(Sizes, Digest)> {
    let checkpoint = check_checkpoint(&answer.checkpoint, pinned, "checkpoint", findings)?;
    if answer.origin != checkpoint.origin {
        findings.add(Code::AnswerOriginMismatch, "answer, field origin", &checkpoint.origin, &answer.origin);
    }
    let as_of = check_as_of(answer, &checkpoint, pinned, findings);
    let root = check_map_leaf(answer, &checkpoint, pinned, findings)?;
    Some((Sizes { as_of: as_of.unwrap_or(checkpoint.size), checkpoint }, root))
}

/// Size of the older checkpoint, where one is there and the answer's log begins with its log.
fn check_as_of(
    answer: &Answer,
    checkpoint: &Checkpoint,
    pinned: Option<&NoteVerifier>,
    findings: &mut Findings,
) -> Option<u64> {
    let part = answer.as_of.as_ref()?;
    let older = check_checkpoint(&part.checkpoint, pinned, "as_of, checkpoint", findings)?;
    let place = format!("as_of, size {}", older.size);
    if older.origin != checkpoint.origin {
        findings.add(Code::AnswerOriginMismatch, place, &checkpoint.origin, &older.origin);
        return None;
    }
    let consistent = verify_consistency(older.size, checkpoint.size, &part.consistency, &older.root, &checkpoint.root);
    match consistent {
        Ok(()) => {
            findings.add(Code::AnswerAsOfProven, place, "", format!("the log of {} begins with it", checkpoint.size));
            Some(older.size)
        }
        Err(e) => {
            let expected = format!("the beginning of the log of size {}", checkpoint.size);
            findings.add(Code::AnswerAsOfInconsistent, place, expected, e);
            None
        }
    }
}

/// The root of the map over everything below the checkpoint's last leaf.
fn check_map_leaf(
    answer: &Answer,
    checkpoint: &Checkpoint,
    pinned: Option<&NoteVerifier>,
    findings: &mut Findings,
) -> Option<Digest> {
    let size = checkpoint.size;
    let Some(part) = &answer.map else {
        if size == 0 {
            return Some(map::EMPTY);
        }
        findings.add(Code::MapLeafNotLast, "map", format!("the leaf at index {}", size - 1), "none");
        return None;
    };
    let index = part.index;
    let place = format!("map leaf at index {index} of {size}");
    if index.checked_add(1) != Some(size) {
        findings.add(Code::MapLeafNotLast, place, "the checkpoint's last leaf", format!("index {index}"));
        return None;
    }
    let leaf = match MapLeaf::decode(&part.leaf) {
        Ok(leaf) => leaf,
        Err(e) => {
            findings.add(Code::MapLeafInvalid, place, "a map leaf", e);
            return None;
        }
    };
    if let Err(e) = verify_inclusion(&leaf.hash(), index, size, &part.inclusion, &checkpoint.root) {
        findings.add(Code::MapLeafNotIncluded, place, format!("root {}", checkpoint.root), e);
        return None;
    }
    let origin = &checkpoint.origin;
    let checked = match pinned {
        Some(pinned) => leaf.verify(origin, index, pinned.key()),
        // Nobody's signature can be checked; that the sentence is the one for this place still can.
        None => leaf.verify_statement(origin, index),
    };
    if let Err(wrong) = checked {
        findings.add(Code::MapLeafInvalid, place, format!("the registry's word on the map of size {index}"), wrong);
        return None;
    }
    if let Some(pinned) = pinned {
        findings.add(Code::MapLeafValid, place, "", format!("root {} by {pinned}", leaf.root));
    }
    Some(leaf.root)
}
