//! What people wrote about a suite's figures, such as what keeps it from a target
//! it misses. The page brings it word for word; figures stay the ledger's.

use std::collections::BTreeMap;
use std::path::Path;

use crate::ledger::LedgerError;

/// Notes by suite; see the module's text.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes(BTreeMap<String, String>);

impl Notes {
    /// The notes in `folder`: `SUITE.md` is suite `SUITE`'s. A folder that does not
    /// exist holds none.
    ///
    /// # Errors
    /// [`LedgerError::Io`] naming the folder or file that cannot be read.
    pub fn read(folder: &Path) -> Result<Self, LedgerError> {
        let mut notes = BTreeMap::new();
        let io = |path: &Path, source| LedgerError::Io { operation: "read the notes of", path: path.into(), source };
        let list = match std::fs::read_dir(folder) {
            Ok(list) => list,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(e) => return Err(io(folder, e)),
        };
        for entry in list {
            let path = entry.map_err(|e| io(folder, e))?.path();
            let suite = path.file_stem().and_then(|s| s.to_str()).unwrap_or_default().to_owned();
            if path.extension().is_some_and(|e| e == "md") && !suite.is_empty() {
                let text = std::fs::read_to_string(&path).map_err(|e| io(&path, e))?;
                notes.insert(suite, text.trim_end().to_owned());
            }
        }
        Ok(Self(notes))
    }

    /// A suite's note; `None` where there is none or it is empty.
    pub fn of(&self, suite: &str) -> Option<&str> {
        self.0.get(suite).map(String::as_str).filter(|note| !note.is_empty())
    }
}
