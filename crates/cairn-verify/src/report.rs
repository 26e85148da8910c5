//! What an audit answers: findings, and the outcome that follows from them.

use std::fmt;

use serde::Serialize;

use crate::code::{Code, Severity};

/// The answer in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Something does not hold.
    Invalid,
    /// Everything that was checked holds, but nothing ties it to a registry that you chose to trust.
    Valid,
    /// Moreover the pinned registry signed the record and proved that it is in its log.
    Trusted,
}

/// What is known about later records (revocations, disputes). "Cannot tell" is an answer of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Freshness {
    /// No view of the log was handed in.
    CannotTell,
    /// Known up to this log size.
    AsOf(u64),
}

/// One thing that was checked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What it is about.
    pub code: Code,
    /// How much it weighs.
    pub severity: Severity,
    /// Where: the file, the field, the record.
    pub place: String,
    /// What was expected; empty where that says nothing.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub expected: String,
    /// What was found.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub got: String,
    /// What to do.
    #[serde(skip_serializing_if = "str::is_empty")]
    pub remedy: &'static str,
}

/// The result of an audit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Format version of the report's JSON.
    pub version: u32,
    /// The answer in one word.
    pub outcome: Outcome,
    /// What is known about later records.
    pub freshness: Freshness,
    /// SHA-256 of the record's PAE, where the envelope could be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub record: Option<String>,
    /// All findings, in the order of the checks.
    pub findings: Vec<Finding>,
}

impl Finding {
    /// A finding of one's own: of what this crate does not look at.
    pub fn of(code: Code, place: &str, expected: &str, got: &str) -> Self {
        let (expected, got) = (expected.to_owned(), got.to_owned());
        Self { code, severity: code.severity(), place: place.to_owned(), expected, got, remedy: code.remedy() }
    }
}

/// What every report has besides its fields.
macro_rules! report {
    ($report:ident) => {
        impl $report {
            /// The version of the JSON form.
            pub const VERSION: u32 = 1;

            /// Whether a finding with this code is there.
            pub fn has(&self, code: $crate::Code) -> bool {
                self.findings.iter().any(|f| f.code == code)
            }

            /// The report as indented JSON.
            pub fn to_json(&self) -> String {
                // Strings and numbers only: there is nothing that could fail to serialise.
                serde_json::to_string_pretty(self).unwrap_or_default()
            }
        }
    };
}
pub(crate) use report;

report!(Report);

/// Findings, a line each: what failed and what limits the report first, the rest in the order of the checks.
pub(crate) fn lines(findings: &[Finding], f: &mut fmt::Formatter<'_>) -> fmt::Result {
    let weighty = |severity: Severity| findings.iter().filter(move |finding| finding.severity == severity);
    let rest = findings.iter().filter(|finding| finding.severity < Severity::Warning);
    let mut all = weighty(Severity::Error).chain(weighty(Severity::Warning)).chain(rest);
    all.try_for_each(|finding| writeln!(f, "{finding}"))
}

/// So many files, in words.
pub(crate) fn files(count: usize) -> String {
    format!("{count} {}", if count == 1 { "file" } else { "files" })
}

/// Collects findings.
#[derive(Debug, Default)]
pub(crate) struct Findings(pub(crate) Vec<Finding>);

impl Findings {
    pub(crate) fn add(&mut self, code: Code, place: impl Into<String>, expected: impl ToString, got: impl ToString) {
        self.0.push(Finding::of(code, &place.into(), &expected.to_string(), &got.to_string()));
    }

    pub(crate) fn has(&self, code: Code) -> bool {
        self.0.iter().any(|f| f.code == code)
    }

    pub(crate) fn append(&mut self, other: Self) {
        self.0.extend(other.0);
    }

    /// Whether a failed check of this class is there.
    pub(crate) fn has_class(&self, class: crate::Class) -> bool {
        self.0.iter().any(|f| f.severity == Severity::Error && crate::Class::of(f.code) == Some(class))
    }

    pub(crate) fn failed(&self) -> bool {
        self.0.iter().any(|f| f.severity == Severity::Error)
    }

    /// The outcome, where `trusted` says whether somebody known vouches for all of it.
    pub(crate) fn outcome(&self, trusted: bool) -> Outcome {
        match (self.failed(), trusted) {
            (true, _) => Outcome::Invalid,
            (false, true) => Outcome::Trusted,
            (false, false) => Outcome::Valid,
        }
    }
}

impl fmt::Display for Freshness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CannotTell => write!(f, "later revocations or disputes: cannot tell"),
            Self::AsOf(size) => write!(f, "later revocations or disputes: known up to log size {size}"),
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Invalid => "invalid",
            Self::Valid => "valid",
            Self::Trusted => "trusted",
        })
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:8} {}  {}", self.severity, self.code.as_str(), self.place)?;
        if !self.expected.is_empty() {
            write!(f, "\n           expected {}", self.expected)?;
        }
        if !self.got.is_empty() {
            write!(f, "\n           got      {}", self.got)?;
        }
        if !self.remedy.is_empty() {
            write!(f, "\n           remedy   {}", self.remedy)?;
        }
        Ok(())
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.outcome)?;
        writeln!(f, "{}", self.freshness)?;
        lines(&self.findings, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_failed_comes_first_and_what_limits_the_report_next() {
        let mut findings = Findings::default();
        for code in [
            Code::CheckpointVerified,
            Code::DetectorUnchecked,
            Code::FreshnessUnknown,
            Code::InclusionFailed,
            Code::RegistryUnpinned,
        ] {
            findings.add(code, "", "", "");
        }
        let report = Report {
            version: Report::VERSION,
            outcome: Outcome::Invalid,
            freshness: Freshness::CannotTell,
            record: None,
            findings: findings.0,
        };
        let said = report.to_string();
        let order: Vec<&str> = said.lines().filter_map(|line| line.split_whitespace().nth(1)).skip(1).collect();
        let order: Vec<&&str> = order.iter().filter(|word| word.contains('.')).collect();
        let wanted = [
            "inclusion.failed",
            "freshness.unknown",
            "registry.unpinned",
            "checkpoint.verified",
            "digest.detector.unchecked",
        ];
        assert_eq!(order, wanted.iter().collect::<Vec<_>>(), "{said}");
    }
}
