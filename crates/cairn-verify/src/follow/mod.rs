//! Following a log: does what it signs today go on from what it signed when it was
//! looked at last?
//!
//! Fetching is the caller's ([`Fetch`]), and so is keeping: [`follow`] takes the checkpoint last
//! seen and gives the one to keep, or the evidence of a contradiction, which anybody can check
//! again with [`audit_evidence`].

mod entries;
mod evidence;
mod fetch;
mod reader;

use std::fmt;

use cairn_log::format::{Checkpoint, NoteVerifier, Policy, note::MAX_NOTE_BYTES};
use serde::Serialize;

use crate::{
    code::{Code, Severity},
    policy,
    report::{Finding, Findings, lines, report},
    store::Class,
};
pub use evidence::{Contradiction, EvidenceReport, audit_evidence};
use fetch::Signed;
pub use fetch::{Fetch, FollowError, MAX_NEW_ENTRIES};
use reader::Reader;

/// Exit code where two signed checkpoints contradict each other.
pub const CONTRADICTION: u8 = 20;

/// Whom to believe.
#[derive(Debug, Clone, Copy)]
pub struct FollowOptions<'a> {
    /// The log's verifier key, obtained from elsewhere.
    pub pinned: &'a NoteVerifier,
    /// Whose cosignatures every checkpoint must carry.
    pub policy: Option<&'a Policy>,
}

/// What a look at a log found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FollowReport {
    /// Format version of the report's JSON.
    pub version: u32,
    /// The log.
    pub origin: String,
    /// Its size when it was seen last; none at the first look.
    pub from: Option<u64>,
    /// Its size now; none where the checkpoint cannot be believed.
    pub size: Option<u64>,
    /// All findings, in the order of the checks.
    pub findings: Vec<Finding>,
}

/// A look at a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Followed {
    /// For people and programs.
    pub report: FollowReport,
    /// The checkpoint to hold the next look to: the new one where everything held, else none.
    pub keep: Option<String>,
    /// Both sides of a contradiction, to be kept for good.
    pub contradiction: Option<Contradiction>,
}

/// Looks at a log once. `last`: the checkpoint that the last look gave to keep.
///
/// # Errors
/// [`FollowError`] where no answer was reached: files out of reach, or the state of another log. Nothing about the log
/// follows from it.
pub fn follow(log: &dyn Fetch, last: Option<&str>, options: &FollowOptions<'_>) -> Result<Followed, FollowError> {
    let pinned = options.pinned;
    let last = last
        .map(|note| Signed::verify(note, pinned))
        .transpose()
        .map_err(|cause| FollowError::State { log: pinned.name().to_owned(), cause })?;
    let bytes = log.fetch("checkpoint", MAX_NOTE_BYTES)?;
    let bytes = bytes.ok_or_else(|| FollowError::Missing { path: "checkpoint".into() })?;
    let note = String::from_utf8_lossy(&bytes).into_owned();
    let mut look = Look { findings: Findings::default(), contradiction: None };
    let now = Signed::check(&note, pinned, "checkpoint", &mut look.findings);
    if let Some(now) = &now {
        if let Some(policy) = options.policy {
            policy::check(policy, pinned, &note, "checkpoint", &mut look.findings);
        }
        look.compare(log, last.as_ref(), now, pinned)?;
    }
    let sound = !look.findings.failed();
    let report = FollowReport {
        version: FollowReport::VERSION,
        origin: pinned.name().to_owned(),
        from: last.map(|last| last.checkpoint.size),
        size: now.as_ref().map(|now| now.checkpoint.size),
        findings: look.findings.0,
    };
    let keep = now.filter(|_| sound).map(|now| now.note);
    Ok(Followed { report, keep, contradiction: look.contradiction })
}

struct Look {
    findings: Findings,
    contradiction: Option<Contradiction>,
}

impl Look {
    fn compare(
        &mut self,
        log: &dyn Fetch,
        last: Option<&Signed>,
        now: &Signed,
        pinned: &NoteVerifier,
    ) -> Result<(), FollowError> {
        let (size, root) = (now.checkpoint.size, now.checkpoint.root);
        let Some(last) = last else {
            self.findings.add(Code::FollowFirst, "checkpoint", "", "the first look at this log");
            return entries::check(log, &[], 0, now, pinned, &mut self.findings);
        };
        let (old_size, old_root) = (last.checkpoint.size, last.checkpoint.root);
        if size == old_size && root == old_root {
            self.findings.add(Code::FollowConsistent, "checkpoint", "", format!("unchanged at size {size}"));
            return Ok(());
        }
        if size <= old_size {
            // The older tiles are the only ones that could show that it is a mere step back; they may be gone.
            let mut reader = Reader::new(log, old_size);
            if size > 0 && size < old_size {
                let _ = reader.roots(size, old_size);
            }
            let what = if size == old_size { "another root at the same size" } else { "a smaller size" };
            self.contradict(what, last, now, reader);
            return Ok(());
        }
        if old_size == 0 {
            self.findings.add(Code::FollowConsistent, "checkpoint", "", format!("from size 0 to {size}"));
            return entries::check(log, &[], 0, now, pinned, &mut self.findings);
        }
        let mut reader = Reader::new(log, size);
        let (first, second) = reader.roots(old_size, size)?;
        if second != root {
            let got = format!("tiles that make root {second}");
            self.findings.add(Code::FollowTiles, format!("tiles of size {size}"), format!("root {root}"), got);
        } else if first != old_root {
            self.contradict("a history that does not go on from the one seen", last, now, reader);
        } else {
            let peaks = reader.peaks(old_size)?;
            self.findings.add(Code::FollowConsistent, "checkpoint", "", format!("from size {old_size} to {size}"));
            entries::check(log, &peaks, old_size, now, pinned, &mut self.findings)?;
        }
        Ok(())
    }

    fn contradict(&mut self, what: &'static str, last: &Signed, now: &Signed, reader: Reader<'_>) {
        let told = |c: &Checkpoint| format!("size {}, root {}", c.size, c.root);
        let expected = format!("a log that goes on from {}", told(&last.checkpoint));
        let got = format!("{what}: {}", told(&now.checkpoint));
        self.findings.add(Code::FollowContradiction, "checkpoint", expected, got);
        self.contradiction =
            Some(Contradiction { first: last.note.clone(), second: now.note.clone(), tiles: reader.into_files() });
    }
}

report!(FollowReport);

impl FollowReport {
    /// 0 where everything held, [`CONTRADICTION`], or as [`Class::exit_code`]: 10 for a checkpoint that the log or its
    /// witnesses did not sign, 11 for tiles or entries that are not those of the tree, 13 for a map leaf.
    pub fn exit_code(&self) -> u8 {
        let of = |finding: &Finding| match finding.code {
            Code::FollowContradiction => CONTRADICTION,
            Code::FollowTiles => Class::Log.exit_code(),
            Code::FollowMapLeaf => Class::Map.exit_code(),
            _ => Class::Checkpoint.exit_code(),
        };
        let errors: Vec<u8> = self.findings.iter().filter(|f| f.severity == Severity::Error).map(of).collect();
        if errors.contains(&CONTRADICTION) { CONTRADICTION } else { errors.into_iter().min().unwrap_or(0) }
    }
}

impl fmt::Display for FollowReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let answer = match self.exit_code() {
            0 => "consistent",
            CONTRADICTION => "contradiction",
            _ => "invalid",
        };
        writeln!(f, "{answer}  {}", self.origin)?;
        lines(&self.findings, f)
    }
}
