//! How to read a capture.

use std::path::PathBuf;

use crate::capture::SceneKind;
use crate::images::format::Limits;

/// How to read a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadOptions {
    /// A CSV table with the columns `image` and `contributor`, one row a view.
    pub contributors: Option<PathBuf>,
    /// What kind of scene it is, instead of the guess.
    pub kind: Option<SceneKind>,
    /// Hold out views 0, n, 2n, ... in order of name, to measure on; n is 2 or more. A capture that names test views of
    /// its own holds out those instead. `None` holds out no view, the capture's own test views included.
    pub hold_out: Option<usize>,
    /// The folder of photographs, relative to the capture (or absolute),
    /// instead of the format's usual one.
    pub images: Option<PathBuf>,
    /// A folder of masks, relative to the capture (or absolute), instead of what the format says. A mask is named as
    /// its photograph with `.png` behind, or with `.png` for the ending; white (from 128 of 255) means use.
    pub masks: Option<PathBuf>,
    /// Leave out the views whose photographs are not there, where any is; else the first is an error.
    pub skip_missing: bool,
    /// The most that is accepted.
    pub limits: Limits,
}

impl Default for ReadOptions {
    /// No table, kind guessed, no view held out, default limits.
    fn default() -> Self {
        Self {
            contributors: None,
            kind: None,
            hold_out: None,
            images: None,
            masks: None,
            skip_missing: false,
            limits: Limits::default(),
        }
    }
}
