//! A data folder for tests, with room beside it for the log's anchor.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// A data folder that is removed after its test, with what lies beside it.
pub struct TestFolder {
    data: PathBuf,
    _around: TempDir,
}

impl Default for TestFolder {
    fn default() -> Self {
        Self::new()
    }
}

impl TestFolder {
    /// An empty one.
    pub fn new() -> Self {
        let around = tempfile::tempdir().unwrap();
        let data = around.path().join("data");
        fs::create_dir(&data).unwrap();
        Self { data, _around: around }
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.data
    }
}
