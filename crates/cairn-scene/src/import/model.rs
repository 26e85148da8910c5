//! What every format's reader gives: a camera file's whole content, before it is held to its photographs.

use std::path::{Component, Path, PathBuf};

use glam::DVec3;

use crate::cameras::intrinsics::Intrinsics;
use crate::cameras::pose::Pose;
use crate::capture::{LeftOut, Support};
use crate::error::CaptureError;
use crate::import::options::ReadOptions;

/// What a format alone says about the kind of scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Guess {
    ForwardFacing,
    Bounded,
    BoundedIfTransparent,
    ForwardFacingIfDeep,
    Unbounded,
}

/// One view as its camera file states it, the pose already checked.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub name: String,
    /// How errors name it, for example `image 12 (a.jpg)`.
    pub label: String,
    pub intrinsics: Intrinsics,
    pub pose: Pose,
    /// Relative to the capture's folder.
    pub photograph: PathBuf,
    pub bounds: Option<(f64, f64)>,
    /// Where the camera file names a mask, relative to the capture's folder.
    pub mask: Option<PathBuf>,
    /// What structure from motion says for it.
    pub support: Option<Support>,
    /// Where the format brings a split.
    pub held_out: Option<bool>,
}

/// A camera file's whole content.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    /// The file that errors about entries name.
    pub file: PathBuf,
    pub kind: Guess,
    /// Whether its cameras were computed on pixels as they are stored, without EXIF orientation.
    pub as_stored: bool,
    pub entries: Vec<Entry>,
    pub points: Vec<DVec3>,
    /// The folder where the format keeps masks, if it is there, relative to the capture's folder.
    pub masks: Option<PathBuf>,
    /// Where photographs lie that its cameras may not cover, where the format says so.
    pub images: Option<ImageFolder>,
    /// What was left out already.
    pub left_out: LeftOut,
}

/// A folder of photographs.
#[derive(Clone, Debug)]
pub(crate) struct ImageFolder {
    /// Relative to the capture's folder, or absolute; empty where it is that folder.
    pub path: PathBuf,
    /// Whether the views' names begin with it.
    pub is_in_names: bool,
}

impl Model {
    /// Cameras alone, of pixels that are as they are looked at.
    pub(crate) fn new(file: PathBuf, kind: Guess, entries: Vec<Entry>) -> Self {
        Self {
            file,
            kind,
            as_stored: false,
            entries,
            points: Vec::new(),
            masks: None,
            images: None,
            left_out: LeftOut::default(),
        }
    }
}

/// Refuses a file that states no views, or more than are allowed.
pub(crate) fn check_count(file: &Path, views: u64, max_views: usize) -> Result<(), CaptureError> {
    if views == 0 {
        let remedy = "bring a file that lists the photographs";
        return Err(CaptureError::malformed(file, "the list of views", "at least one view", "none", remedy));
    }
    if views > max_views as u64 {
        let (file, what) = (file.display().to_string(), "number of views");
        return Err(CaptureError::TooLarge { file, what, limit: max_views as u64, got: views });
    }
    Ok(())
}

/// `path` as a relative path that stays where it starts; `None` for one that is
/// absolute, climbs out, or is empty. `./` goes.
pub(crate) fn inside(path: &str) -> Option<PathBuf> {
    let mut clean = PathBuf::new();
    for part in Path::new(path).components() {
        match part {
            Component::CurDir => {}
            Component::Normal(part) => clean.push(part),
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    (!clean.as_os_str().is_empty()).then_some(clean)
}

/// The folder of photographs relative to `root`: the one asked for, or the first
/// of `usual` that exists.
pub(crate) fn image_folder(root: &Path, options: &ReadOptions, usual: &[&str]) -> Option<PathBuf> {
    if let Some(asked) = &options.images {
        return Some(asked.strip_prefix(root).unwrap_or(asked).to_path_buf());
    }
    usual.iter().map(PathBuf::from).find(|folder| root.join(folder).is_dir())
}
