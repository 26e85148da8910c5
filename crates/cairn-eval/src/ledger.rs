//! Rows of measurements and their file.
//!
//! The file is JSON in a stable order, one field a line, so that a change of one
//! figure is a change of one line in review. It is a bare list of rows, for
//! tools that know nothing of Cairn; unknown fields are refused.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Which side of a target is good.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TargetOp {
    /// The value is to be at least the target's.
    #[serde(rename = ">=")]
    AtLeast,
    /// The value is to be at most the target's.
    #[serde(rename = "<=")]
    AtMost,
}

/// What a measurement is to reach, in the row's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Which side is good.
    pub op: TargetOp,
    /// The bound, itself allowed.
    pub value: f64,
}

impl Target {
    /// A target of at least `value`.
    pub fn at_least(value: f64) -> Self {
        Self { op: TargetOp::AtLeast, value }
    }

    /// A target of at most `value`.
    pub fn at_most(value: f64) -> Self {
        Self { op: TargetOp::AtMost, value }
    }

    /// Whether `value` reaches it.
    pub fn is_met_by(&self, value: f64) -> bool {
        match self.op {
            TargetOp::AtLeast => value >= self.value,
            TargetOp::AtMost => value <= self.value,
        }
    }
}

/// One measurement. (`suite`, `case`, `metric`, `seed`) is its key.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Which table it stands in, such as `stage 2`.
    pub suite: String,
    /// What was measured on, such as `fern, one image`.
    pub case: String,
    /// What was measured, such as `hidden SSIM`.
    pub metric: String,
    /// The figure; finite.
    pub value: f64,
    /// Its unit, such as `dB`; empty for a plain number.
    pub unit: String,
    /// What it was to reach, if anything.
    pub target: Option<Target>,
    /// The command line that measures it again.
    pub command: String,
    /// The seed of every random number in it.
    pub seed: u64,
    /// The commit it was measured at; see [`crate::commit`].
    pub commit: String,
    /// The machine, without a name; see [`crate::machine`].
    pub machine: String,
    /// The day in UTC, `YYYY-MM-DD`; see [`crate::today`].
    pub date: String,
}

impl Row {
    /// Whether the target is reached; `None` without one.
    pub fn met(&self) -> Option<bool> {
        self.target.map(|t| t.is_met_by(self.value))
    }

    /// What identifies a measurement: a newer one of the same key replaces it.
    pub(crate) fn key(&self) -> (&str, &str, &str, u64) {
        (&self.suite, &self.case, &self.metric, self.seed)
    }

    fn name(&self) -> String {
        format!("{} / {} / {} (seed {})", self.suite, self.case, self.metric, self.seed)
    }
}

/// A row as the file has it: with `met`, for readers without this crate.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredRow {
    suite: String,
    case: String,
    metric: String,
    value: f64,
    unit: String,
    target: Option<Target>,
    met: Option<bool>,
    command: String,
    seed: u64,
    commit: String,
    machine: String,
    date: String,
}

/// Why the ledger was not read, changed or written.
#[derive(Debug, Error)]
pub enum LedgerError {
    /// The file could not be read or written.
    #[error("cannot {operation} the ledger {path}: {source}")]
    Io {
        /// What was tried.
        operation: &'static str,
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file is no ledger.
    #[error("{path} is no ledger of measurements: {source}; restore it from version control")]
    Json {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: serde_json::Error,
    },
    /// A row contradicts itself.
    #[error("{path}: {row} says met = {got:?}, but its value and target give {expected:?}; measure it again")]
    Met {
        /// The file.
        path: PathBuf,
        /// The row.
        row: String,
        /// What it says.
        got: Option<bool>,
        /// What follows from its figures.
        expected: Option<bool>,
    },
    /// A row cannot be recorded.
    #[error("cannot record {row}: {problem}")]
    Row {
        /// The row.
        row: String,
        /// What is wrong with it, and the remedy.
        problem: String,
    },
}

/// All measurements, ordered by suite, case, metric and seed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ledger {
    rows: Vec<Row>,
}

impl Ledger {
    /// Reads the ledger at `path`; a file that does not exist is an empty one.
    ///
    /// # Errors
    /// [`LedgerError`] for a file that cannot be read or whose rows contradict
    /// or repeat themselves.
    pub fn load(path: &Path) -> Result<Self, LedgerError> {
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(source) => return Err(LedgerError::Io { operation: "read", path: path.to_path_buf(), source }),
        };
        let stored: Vec<StoredRow> =
            serde_json::from_slice(&bytes).map_err(|source| LedgerError::Json { path: path.to_path_buf(), source })?;
        let mut ledger = Self::default();
        for stored in stored {
            let (got, row) = stored.into_row();
            let expected = row.met();
            if got != expected {
                return Err(LedgerError::Met { path: path.to_path_buf(), row: row.name(), got, expected });
            }
            if ledger.rows.iter().any(|r| r.key() == row.key()) {
                let problem = format!("{} has it twice; remove one", path.display());
                return Err(LedgerError::Row { row: row.name(), problem });
            }
            ledger.record(row)?;
        }
        Ok(ledger)
    }

    /// Adds a measurement, in place of an older one of the same suite, case,
    /// metric and seed.
    ///
    /// # Errors
    /// [`LedgerError::Row`] for a number that is not finite, or an empty suite,
    /// case, metric or command.
    pub fn record(&mut self, row: Row) -> Result<(), LedgerError> {
        let refuse = |problem: String| Err(LedgerError::Row { row: row.name(), problem });
        if !row.value.is_finite() {
            return refuse(format!("its value is {}; record a finite number or leave the row out", row.value));
        }
        if let Some(target) = row.target.filter(|t| !t.value.is_finite()) {
            return refuse(format!("its target is {}; give a finite one or none", target.value));
        }
        let texts = [("suite", &row.suite), ("case", &row.case), ("metric", &row.metric), ("command", &row.command)];
        if let Some((name, _)) = texts.iter().find(|(_, text)| text.trim().is_empty()) {
            return refuse(format!("its {name} is empty; a figure without it cannot be found or repeated"));
        }
        match self.rows.binary_search_by(|r| r.key().cmp(&row.key())) {
            Ok(at) => self.rows[at] = row,
            Err(at) => self.rows.insert(at, row),
        }
        Ok(())
    }

    /// The measurements, ordered by suite, case, metric and seed.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Measurements that miss their target.
    pub fn missed(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|r| r.met() == Some(false))
    }

    /// Writes the ledger to `path`: synced beside it, then renamed, so that
    /// nobody ever reads half of it. The same rows give the same bytes.
    ///
    /// # Errors
    /// [`LedgerError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), LedgerError> {
        let rows: Vec<StoredRow> = self.rows.iter().cloned().map(StoredRow::from).collect();
        let mut text = serde_json::to_string_pretty(&rows)
            .map_err(|source| LedgerError::Json { path: path.to_path_buf(), source })?;
        text.push('\n');
        let part = path.with_extension(format!("part-{}", std::process::id()));
        let io = |operation| move |source| LedgerError::Io { operation, path: path.to_path_buf(), source };
        let write = || {
            let mut file = std::fs::File::create(&part)?;
            file.write_all(text.as_bytes())?;
            file.sync_all()?;
            std::fs::rename(&part, path)
        };
        write().map_err(|e| {
            // The write's own error is the one to report; the leftover is only litter.
            let _ = std::fs::remove_file(&part);
            io("write")(e)
        })
    }
}

impl StoredRow {
    fn into_row(self) -> (Option<bool>, Row) {
        let Self { suite, case, metric, value, unit, target, met, command, seed, commit, machine, date } = self;
        (met, Row { suite, case, metric, value, unit, target, command, seed, commit, machine, date })
    }
}

impl From<Row> for StoredRow {
    fn from(row: Row) -> Self {
        let met = row.met();
        let Row { suite, case, metric, value, unit, target, command, seed, commit, machine, date } = row;
        Self { suite, case, metric, value, unit, target, met, command, seed, commit, machine, date }
    }
}
