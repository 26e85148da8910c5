//! Tables of measurements as CSV: one kind of row a file, to be read by anything.
//!
//! Fields are numbers and our own words; one with a comma, a quote or a line's
//! end is refused rather than quoted, so that a line is always a row.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Rows below a header; see the module's text.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// Why a table was not read, changed or written.
#[derive(Debug, Error)]
pub enum TableError {
    /// The file could not be read or written.
    #[error("cannot {operation} the table {path}: {source}; check the folder and its permissions")]
    Io {
        /// What was tried.
        operation: &'static str,
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file holds another table.
    #[error("{path} begins with `{got}`, and this table with `{expected}`; move it away or choose another folder")]
    Header {
        /// The file.
        path: PathBuf,
        /// Its first line.
        got: String,
        /// This table's.
        expected: String,
    },
    /// A row has a field too many or too few, or one that cannot stand in a line.
    #[error("row {row:?} does not fit the columns `{header}`; they take one field each, without commas and quotes")]
    Row {
        /// The row.
        row: Vec<String>,
        /// The columns.
        header: String,
    },
}

impl Table {
    /// An empty table with these columns; units belong into their names.
    pub fn new(columns: &[&str]) -> Self {
        Self { header: columns.iter().map(|c| (*c).to_owned()).collect(), rows: Vec::new() }
    }

    /// The table of these columns in `path`, empty where there is no such file.
    ///
    /// # Errors
    /// [`TableError`] for a file that cannot be read or holds another table.
    pub fn load(path: &Path, columns: &[&str]) -> Result<Self, TableError> {
        let mut table = Self::new(columns);
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(table),
            Err(source) => return Err(TableError::Io { operation: "read", path: path.to_path_buf(), source }),
        };
        let mut lines = text.lines();
        let (got, expected) = (lines.next().unwrap_or_default().to_owned(), table.header.join(","));
        if got != expected {
            return Err(TableError::Header { path: path.to_path_buf(), got, expected });
        }
        for line in lines {
            table.push(line.split(',').map(str::to_owned).collect())?;
        }
        Ok(table)
    }

    /// Adds a row, one field a column.
    ///
    /// # Errors
    /// [`TableError::Row`].
    pub fn push(&mut self, row: Vec<String>) -> Result<(), TableError> {
        let broken = |field: &String| field.contains([',', '"', '\n', '\r']);
        if row.len() != self.header.len() || row.iter().any(broken) {
            return Err(TableError::Row { row, header: self.header.join(",") });
        }
        self.rows.push(row);
        Ok(())
    }

    /// Keeps the rows that `keep` holds for.
    pub fn retain(&mut self, keep: impl Fn(&[String]) -> bool) {
        self.rows.retain(|row| keep(row));
    }

    /// The rows, in order.
    pub fn rows(&self) -> &[Vec<String>] {
        &self.rows
    }

    /// The table as CSV.
    pub fn to_csv(&self) -> String {
        let mut text = self.header.join(",") + "\n";
        for row in &self.rows {
            text.push_str(&row.join(","));
            text.push('\n');
        }
        text
    }

    /// Writes it to `path`.
    ///
    /// # Errors
    /// [`TableError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), TableError> {
        let io = |source| TableError::Io { operation: "write", path: path.to_path_buf(), source };
        std::fs::write(path, self.to_csv()).map_err(io)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_survives_its_file_and_refuses_another() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let mut table = Table::load(&path, &["case", "time_s"]).unwrap();
        table.push(vec!["a".into(), "1.5".into()]).unwrap();
        table.push(vec!["b".into(), String::new()]).unwrap();
        table.save(&path).unwrap();
        let mut loaded = Table::load(&path, &["case", "time_s"]).unwrap();
        assert_eq!(loaded, table);
        loaded.retain(|row| row[0] != "a");
        assert_eq!(loaded.to_csv(), "case,time_s\nb,\n");
        let error = Table::load(&path, &["case", "other"]).unwrap_err().to_string();
        assert!(error.contains("case,time_s") && error.contains("case,other"), "{error}");
        assert!(table.push(vec!["a,b".into(), "1".into()]).is_err());
        assert!(table.push(vec!["a".into()]).is_err());
    }
}
