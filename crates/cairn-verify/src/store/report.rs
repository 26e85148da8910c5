//! What the audit of a store answers.

use std::fmt;

use cairn_log::format::{Checkpoint, Digest};
use serde::Serialize;

use super::Class;
use crate::{
    code::{Code, Severity},
    report::{Finding, Findings, Outcome, lines, report},
};

/// Most findings that a report carries; a store that is lost as a whole has one for each of its files.
const MAX_FINDINGS: usize = 1000;

/// Counts of what was looked at.
#[derive(Debug, Clone, Default)]
pub(super) struct Tally {
    pub(super) records: u64,
    pub(super) erased: u64,
    pub(super) map_leaves: u64,
    pub(super) map_checked: u64,
    pub(super) map_keys: u64,
    pub(super) in_stock: u64,
}

/// The result of the audit of a data folder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct StoreReport {
    /// Format version of the report's JSON.
    pub version: u32,
    /// The answer in one word. Whether the log was shown to others in another form, no folder can tell.
    pub outcome: Outcome,
    /// Classes of the faults found; empty where there are none.
    pub classes: Vec<Class>,
    /// Size of the published log; 0 where there is no checkpoint.
    pub size: u64,
    /// Root of the published log, as its checkpoint has it.
    pub root: Option<Digest>,
    /// Records, erased ones included.
    pub records: u64,
    /// Records of which only the map keys are left.
    pub erased: u64,
    /// Map leaves.
    pub map_leaves: u64,
    /// Keys of the newest map.
    pub map_keys: u64,
    /// Digests named by records that files of this folder have.
    pub digests_in_folder: u64,
    /// Findings left out.
    pub left_out: usize,
    /// The findings, in the order of the checks.
    pub findings: Vec<Finding>,
    /// Whether the log's key came from elsewhere.
    #[serde(skip)]
    pinned: bool,
}

report!(StoreReport);

impl StoreReport {
    pub(super) fn new(checkpoint: Option<Checkpoint>, tally: Tally, findings: Findings, pinned: bool) -> Self {
        let mut report = Self {
            version: Self::VERSION,
            outcome: Outcome::Invalid,
            classes: Vec::new(),
            size: checkpoint.as_ref().map_or(0, |c| c.size),
            root: checkpoint.map(|c| c.root),
            records: tally.records,
            erased: tally.erased,
            map_leaves: tally.map_leaves,
            map_keys: tally.map_keys,
            digests_in_folder: tally.in_stock,
            left_out: 0,
            findings: Vec::new(),
            pinned,
        };
        report.extend(findings.0);
        report
    }

    /// Adds what was found elsewhere in the folder: by [`crate::audit_folders`], or by rendering.
    pub fn extend(&mut self, findings: Vec<Finding>) {
        for finding in findings {
            let class = Class::of(finding.code).filter(|_| finding.severity == Severity::Error);
            if let Some(class) = class.filter(|class| !self.classes.contains(class)) {
                self.classes.push(class);
            }
            if self.findings.len() < MAX_FINDINGS {
                self.findings.push(finding);
            } else {
                self.left_out += 1;
            }
        }
        self.classes.sort_unstable();
        self.outcome = match (self.classes.is_empty(), self.pinned && self.has(Code::StoreCheckpointVerified)) {
            (false, _) => Outcome::Invalid,
            (true, false) => Outcome::Valid,
            (true, true) => Outcome::Trusted,
        };
    }

    /// 0 where nothing is at fault, else the smallest of the classes' codes.
    pub fn exit_code(&self) -> u8 {
        self.classes.first().map_or(0, |class| class.exit_code())
    }
}

impl fmt::Display for StoreReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.outcome)?;
        let root = self.root.map_or_else(|| "none".to_owned(), |root| root.to_string());
        writeln!(f, "log of size {}, root {root}", self.size)?;
        let erased = if self.erased == 0 { String::new() } else { format!(" ({} erased)", self.erased) };
        writeln!(f, "{} records{erased}, {} map leaves, {} keys", self.records, self.map_leaves, self.map_keys)?;
        lines(&self.findings, f)?;
        if self.left_out > 0 {
            writeln!(f, "and {} findings more", self.left_out)?;
        }
        Ok(())
    }
}
