//! Rows of measurements and their files: `bench/results/SUITE.jsonl`, one row a line.
//!
//! A newer row of the same suite, case and metric replaces the older one. Rows stand in a stable order, so that a
//! change of one figure is a change of one line in review. Unknown fields are refused.

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

/// One measurement. (`suite`, `case`, `metric`) is its key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Which table it stands in, such as `mark`.
    pub suite: String,
    /// What was measured on, such as `fern`.
    pub case: String,
    /// What was measured, such as `hidden SSIM`.
    pub metric: String,
    /// The figure; finite.
    pub value: f64,
    /// Its unit, such as `dB`; empty for a plain number.
    pub unit: String,
    /// What it was to reach, if anything.
    pub target: Option<Target>,
    /// Whether the target is reached, for readers without this crate; none without a target.
    pub met: Option<bool>,
    /// The command line that measures it again.
    pub command: String,
    /// The seed of every random number in it.
    pub seed: u64,
    /// The commit it was measured at.
    pub commit: String,
    /// The machine, without a name.
    pub machine: String,
    /// The day in UTC, `YYYY-MM-DD`.
    pub date: String,
}

impl Row {
    fn key(&self) -> [&str; 3] {
        [&self.suite, &self.case, &self.metric]
    }

    fn name(&self) -> String {
        self.key().join(" / ")
    }

    fn problem(&self) -> Option<String> {
        if !self.value.is_finite() {
            return Some(format!("its value is {}; record a finite number or leave the row out", self.value));
        }
        if let Some(target) = self.target.filter(|t| !t.value.is_finite()) {
            return Some(format!("its target is {}; give a finite one or none", target.value));
        }
        let expected = self.target.map(|t| t.is_met_by(self.value));
        if self.met != expected {
            let met = self.met;
            return Some(format!("it says met = {met:?}, but its figures give {expected:?}; measure it again"));
        }
        let texts =
            [("suite", &self.suite), ("case", &self.case), ("metric", &self.metric), ("command", &self.command)];
        let (name, _) = texts.iter().find(|(_, text)| text.trim().is_empty())?;
        Some(format!("its {name} is empty; a figure without it cannot be found or repeated"))
    }
}

/// Why results were not read, changed or written.
#[derive(Debug, Error)]
pub enum ResultsError {
    /// A file or folder could not be read or written.
    #[error("cannot {operation} {path}: {source}")]
    Io {
        /// What was tried.
        operation: &'static str,
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A line is no row.
    #[error("{path}, line {line}: no row of results: {source}; restore the file from version control")]
    Json {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Why not.
        source: serde_json::Error,
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

/// All measurements, ordered by suite, case and metric.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Results {
    rows: Vec<Row>,
}

impl Results {
    /// Reads every `SUITE.jsonl` of `folder`; a folder that does not exist holds nothing.
    ///
    /// # Errors
    /// [`ResultsError`] for a file that cannot be read, and for rows that contradict or repeat themselves.
    pub fn load(folder: &Path) -> Result<Self, ResultsError> {
        let io = |path: &Path| {
            let path = path.to_path_buf();
            move |source| ResultsError::Io { operation: "read", path, source }
        };
        let mut results = Self::default();
        let listed = match std::fs::read_dir(folder) {
            Ok(listed) => listed,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(results),
            Err(e) => return Err(io(folder)(e)),
        };
        for entry in listed {
            let path = entry.map_err(io(folder))?.path();
            if path.extension().is_none_or(|ending| ending != "jsonl") {
                continue;
            }
            let text = std::fs::read_to_string(&path).map_err(io(&path))?;
            for (at, line) in text.lines().enumerate() {
                let row: Row = serde_json::from_str(line).map_err(|source| ResultsError::Json {
                    path: path.clone(),
                    line: at + 1,
                    source,
                })?;
                if results.rows.iter().any(|other| other.key() == row.key()) {
                    let problem = format!("{} has it twice; remove one", path.display());
                    return Err(ResultsError::Row { row: row.name(), problem });
                }
                results.record(row)?;
            }
        }
        Ok(results)
    }

    /// Adds a measurement, in place of an older one of the same suite, case and metric.
    ///
    /// # Errors
    /// [`ResultsError::Row`] for a number that is not finite, an empty suite, case, metric or command, and a `met` that
    /// contradicts the figures.
    pub fn record(&mut self, row: Row) -> Result<(), ResultsError> {
        if let Some(problem) = row.problem() {
            return Err(ResultsError::Row { row: row.name(), problem });
        }
        match self.rows.binary_search_by(|other| other.key().cmp(&row.key())) {
            Ok(at) => self.rows[at] = row,
            Err(at) => self.rows.insert(at, row),
        }
        Ok(())
    }

    /// The measurements, ordered by suite, case and metric.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Measurements that miss their target.
    pub fn missed(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|row| row.met == Some(false))
    }

    /// Writes the rows of `suite` to its file in `folder`: synced beside it, then renamed. The same rows give the same
    /// bytes.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn save(&self, folder: &Path, suite: &str) -> Result<(), ResultsError> {
        let path = folder.join(format!("{suite}.jsonl"));
        let io = |source| ResultsError::Io { operation: "write", path: path.clone(), source };
        let mut text = String::new();
        for row in self.rows.iter().filter(|row| row.suite == suite) {
            text += &serde_json::to_string(row).map_err(|e| io(e.into()))?;
            text.push('\n');
        }
        let written =
            cairn_durable::make_folders(folder).and_then(|()| cairn_durable::write_atomic(&path, text.as_bytes()));
        written.map_err(|error| io(error.into_cause()))
    }
}
