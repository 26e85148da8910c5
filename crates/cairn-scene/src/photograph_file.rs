//! Where a view's photograph lies, and which of its pixels the camera means.

use std::ops::Deref;
use std::path::{Path, PathBuf};

/// A photograph's file. It derefs to its path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhotographFile {
    /// Relative to [`Capture::root`](crate::Capture::root), or absolute.
    pub path: PathBuf,
    /// Whether the pixels are meant as they are stored, without EXIF orientation, where both ways have the camera's
    /// size. Structure from motion that does not look at EXIF (COLMAP) computes its cameras on those.
    pub as_stored: bool,
}

impl Deref for PhotographFile {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.path
    }
}

impl AsRef<Path> for PhotographFile {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}

impl From<PathBuf> for PhotographFile {
    /// The photograph as it is looked at: EXIF orientation applied.
    fn from(path: PathBuf) -> Self {
        Self { path, as_stored: false }
    }
}

impl From<&str> for PhotographFile {
    fn from(path: &str) -> Self {
        PathBuf::from(path).into()
    }
}
