//! What the audit of an answer says: who is to be credited, and why that is known.

use std::fmt;

use cairn_log::format::{Digest, RecordKind, shares::Shares};
use serde::Serialize;

use crate::report::{Finding, Freshness, Outcome, lines, report};

/// What a record of an answer is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// A claim or contribution that holds: its owner is to be credited.
    Counts,
    /// It would count, but its envelope was erased: somebody contributed, and is not named any more.
    Erased,
    /// A record that credits nobody: a training, revocation, rotation, dispute or binding.
    NoCredit,
    /// Its owner put another record in its place.
    Replaced,
    /// Its owner took it back.
    Revoked,
    /// Its owner's key had ended before it was made.
    KeyEnded,
    /// It came behind the checkpoint asked for.
    Later,
}

/// A record listed under what was asked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RecordWorth {
    /// Its index in the log.
    pub index: u64,
    /// SHA-256 of its PAE.
    pub record: Digest,
    /// What it says.
    pub kind: RecordKind,
    /// Key id of its owner.
    pub owner: Digest,
    /// The contributor's name (in a dispute or binding: whom it names), unless it was erased.
    pub contributor: Option<String>,
    /// The identity's number, where it has one and was not erased.
    pub number: Option<u32>,
    /// What it is worth.
    pub standing: Standing,
    /// Of a record that counts the index of the binding by which its contributor's name stands for its owner's key; none
    /// where it is unconfirmed: then anybody may have entered it.
    pub confirmed_by: Option<u64>,
    /// Indices of the disputes about it, up to the checkpoint asked for.
    pub disputed_by: Vec<u64>,
}

/// The result of the audit of an answer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AnswerReport {
    /// Format version of the report's JSON.
    pub version: u32,
    /// The answer in one word: trusted only where the pinned log signed checkpoint and map, and everything is proven.
    pub outcome: Outcome,
    /// Up to which log size revocations, disputes and the like are known.
    pub freshness: Freshness,
    /// The scene asked about, where the answer could be read.
    pub scene: Option<String>,
    /// The photograph asked about; none for the whole scene.
    pub view: Option<Digest>,
    /// The log size that the question is about: the older checkpoint's where one was asked for. None where the answer
    /// is invalid.
    pub as_of: Option<u64>,
    /// The records listed under what was asked, by index. None where the answer is invalid: then it credits nobody.
    pub records: Vec<RecordWorth>,
    /// Whose photographs show the view, by the registry's signed word; none where it gave none, and where the answer is
    /// invalid.
    pub shares: Option<Shares>,
    /// All findings, in the order of the checks.
    pub findings: Vec<Finding>,
}

report!(AnswerReport);

impl AnswerReport {
    /// The records whose owners are to be credited.
    pub fn credited(&self) -> impl Iterator<Item = &RecordWorth> {
        self.records.iter().filter(|r| r.standing == Standing::Counts)
    }
}

impl fmt::Display for Standing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Counts => "counts",
            Self::Erased => "erased",
            Self::NoCredit => "no credit",
            Self::Replaced => "replaced",
            Self::Revoked => "revoked",
            Self::KeyEnded => "key ended",
            Self::Later => "later",
        })
    }
}

impl fmt::Display for RecordWorth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Names come from strangers: quoted, so that they cannot pass for a line of the report.
        let who = self.contributor.as_ref().map_or_else(|| "(erased)".to_owned(), |name| format!("{name:?}"));
        let kind = format!("{:?}", self.kind).to_lowercase();
        // Whom a dispute or binding names is mostly not its signer: that is its key.
        let names = matches!(self.kind, RecordKind::Dispute | RecordKind::Binding);
        let whose = if names { "naming" } else { "by" };
        write!(f, "{:9} index {}: {kind} {whose} {who}", self.standing, self.index)?;
        if let Some(number) = self.number {
            write!(f, ", identity {number}")?;
        }
        match self.confirmed_by {
            Some(index) => write!(f, ", name confirmed at index {index}")?,
            None if self.standing == Standing::Counts => write!(f, ", name unconfirmed")?,
            None => {}
        }
        if !self.disputed_by.is_empty() {
            let indices: Vec<_> = self.disputed_by.iter().map(u64::to_string).collect();
            write!(f, ", disputed at index {}", indices.join(", "))?;
        }
        write!(f, "\n          record {}, key {}", self.record, self.owner)
    }
}

/// A statement's shares, a line each.
pub(super) fn shares_lines(shares: &Shares, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    writeln!(
        f,
        "shares of what view {:?} shows, by the registry's word (`cairn audit shares` works them out again)",
        shares.view.name
    )?;
    for of in &shares.contributors {
        writeln!(f, "{:6.1} %  {:?}, photographs: {}", 100.0 * of.share, of.name, of.photographs.len())?;
    }
    for (share, what) in [
        (shares.excluded, "excluded photographs"),
        (shares.unseen, "no photograph"),
        (shares.behind, "behind the scene"),
    ] {
        writeln!(f, "{:6.1} %  {what}", 100.0 * share)?;
    }
    Ok(())
}

impl fmt::Display for AnswerReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.outcome)?;
        if let Some(scene) = &self.scene {
            match &self.view {
                Some(view) => write!(f, "who contributed to view {view} of scene {scene:?}")?,
                None => write!(f, "who contributed to scene {scene:?}")?,
            }
            match self.as_of {
                Some(size) => writeln!(f, ", as of log size {size}")?,
                None => writeln!(f)?,
            }
        }
        writeln!(f, "{}", self.freshness)?;
        if self.outcome != Outcome::Invalid {
            writeln!(f, "{} of {} records count", self.credited().count(), self.records.len())?;
        }
        for record in &self.records {
            writeln!(f, "{record}")?;
        }
        if let Some(shares) = &self.shares {
            shares_lines(shares, f)?;
        }
        lines(&self.findings, f)
    }
}
