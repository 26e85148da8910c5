//! `scene.json`, the table of a stored scene: what it holds and how strictly it
//! is read back. The version is looked at before anything else, so that a file
//! of tomorrow is refused by its version and not by a field.

use std::collections::{HashMap, HashSet};
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::cameras::camera::Camera;
use crate::cameras::intrinsics::check_intrinsics;
use crate::cameras::pose::Pose;
use crate::capture::{SceneKind, Support, View};
use crate::error::CaptureError;

/// The table's name in its folder.
pub(crate) const TABLE: &str = "scene.json";
/// Largest table that is read: 100 000 views take about 70 MB.
pub(crate) const MAX_TABLE_BYTES: u64 = 256 << 20;
/// What `format` says in every scene file.
pub(crate) const FORMAT: &str = "cairn-scene";
/// The version that this program writes and reads.
pub(crate) const VERSION: u32 = 4;
/// Folder of the photographs within a scene.
pub(crate) const PHOTOGRAPHS: &str = "photographs";
/// Folder of the masks within a scene, there where a view has one.
pub(crate) const MASKS: &str = "masks";

const REMEDY: &str = "restore the scene from a copy, or import the capture again";

#[derive(Deserialize)]
struct Head {
    format: String,
    version: u64,
}

/// The whole file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SceneFile {
    pub format: String,
    pub version: u32,
    pub kind: SceneKind,
    pub background: Option<[f32; 3]>,
    /// Sparse points, kept in `points.bin`.
    pub points: PointsRow,
    pub views: Vec<ViewRow>,
}

/// The file of sparse points: little-endian f64, x y z for each.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PointsRow {
    pub count: u64,
    /// Hexadecimal SHA-256 of `points.bin`.
    pub sha256: String,
}

/// One view.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ViewRow {
    pub name: String,
    pub contributor: String,
    /// Hexadecimal; the same for all views of a contributor.
    pub contributor_key: Option<String>,
    pub held_out: bool,
    pub bounds: Option<(f64, f64)>,
    pub camera: Camera,
    /// File name within `photographs/`.
    pub photograph: String,
    /// `View::as_stored`.
    pub as_stored: bool,
    /// Hexadecimal SHA-256 of the photograph's bytes.
    pub sha256: String,
    pub mask: Option<MaskRow>,
    pub support: Option<Support>,
}

/// A view's mask: a grey PNG of 1 bit, white where the photograph is used.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MaskRow {
    /// File name within `masks/`.
    pub file: String,
    /// Hexadecimal SHA-256 of the file.
    pub sha256: String,
}

impl SceneFile {
    /// Parses and checks the bytes of the scene file at `file`.
    ///
    /// # Errors
    /// For another format or version, and for anything a scene cannot hold.
    pub(crate) fn parse(file: &Path, bytes: &[u8]) -> Result<Self, CaptureError> {
        let wrong = |expected: &str, got: String| CaptureError::malformed(file, "the JSON", expected, got, REMEDY);
        let head: Head = serde_json::from_slice(bytes).map_err(|e| wrong("a scene's table", e.to_string()))?;
        if head.format != FORMAT {
            return Err(wrong("format \"cairn-scene\"", format!("{:?}", head.format)));
        }
        if head.version != u64::from(VERSION) {
            return Err(CaptureError::UnknownVersion {
                file: file.to_path_buf(),
                expected: VERSION,
                got: head.version,
            });
        }
        let scene: Self = serde_json::from_slice(bytes).map_err(|e| wrong("a scene's table", e.to_string()))?;
        scene.check(file)?;
        Ok(scene)
    }

    fn check(&self, file: &Path) -> Result<(), CaptureError> {
        let wrong = |entry: String, expected: &str, got: String| {
            Err(CaptureError::malformed(file, entry, expected, got, REMEDY))
        };
        if self.background.is_some_and(|rgb| !rgb.iter().all(|v| (0.0..=1.0).contains(v))) {
            return wrong("background".to_owned(), "three numbers in [0, 1]", format!("{:?}", self.background));
        }
        if self.views.is_empty() {
            return wrong("views".to_owned(), "at least one view", "none".to_owned());
        }
        let (mut files, mut masks) = (HashSet::new(), HashSet::new());
        let mut keys = HashMap::new();
        for (i, view) in self.views.iter().enumerate() {
            let entry = format!("view {i} ({})", view.name);
            if i > 0 && self.views[i - 1].name >= view.name {
                return wrong(entry, "views sorted by name, each once", format!("after {}", self.views[i - 1].name));
            }
            if view.name.is_empty() || view.contributor.is_empty() {
                return wrong(entry, "a name and a contributor", "an empty one".to_owned());
            }
            if let Some(key) = &view.contributor_key
                && key_of(key).is_none()
            {
                return wrong(entry, "a contributor's key of 64 lower-case hexadecimal digits", format!("{key:?}"));
            }
            if *keys.entry(&view.contributor).or_insert(&view.contributor_key) != &view.contributor_key {
                return wrong(entry, "one key for each contributor", format!("another of {:?}", view.contributor));
            }
            if view.bounds.is_some_and(|(near, far)| !(near > 0.0 && far > near && far.is_finite())) {
                return wrong(entry, "bounds with 0 < near < far", format!("{:?}", view.bounds));
            }
            if !is_file_name(&view.photograph) || !files.insert(view.photograph.as_str()) {
                return wrong(entry, "a photograph's file name, each once", format!("{:?}", view.photograph));
            }
            if let Some(mask) = &view.mask
                && (!is_file_name(&mask.file) || !masks.insert(mask.file.as_str()))
            {
                return wrong(entry, "a mask's file name, each once", format!("{:?}", mask.file));
            }
            if view.support.is_some_and(|s| !(s.reprojection_error_px >= 0.0 && s.reprojection_error_px.is_finite())) {
                return wrong(entry, "a finite reprojection error, at least 0", format!("{:?}", view.support));
            }
            check_intrinsics(file, &entry, &view.camera.intrinsics)?;
            Pose::new(view.camera.pose.rotation, view.camera.pose.position).map_err(|problem| CaptureError::Pose {
                file: file.to_path_buf(),
                entry,
                problem,
            })?;
        }
        Ok(())
    }
}

impl ViewRow {
    /// The row as a view of the capture stored around it.
    pub(crate) fn into_view(self) -> View {
        View {
            name: self.name,
            camera: self.camera,
            contributor: self.contributor,
            contributor_key: self.contributor_key.as_deref().and_then(key_of),
            photograph: PathBuf::from(PHOTOGRAPHS).join(self.photograph),
            as_stored: self.as_stored,
            mask: self.mask.map(|mask| PathBuf::from(MASKS).join(mask.file)),
            support: self.support,
            held_out: self.held_out,
            bounds: self.bounds,
        }
    }
}

/// A public key from 64 lower-case hexadecimal digits.
fn key_of(text: &str) -> Option<[u8; 32]> {
    let mut key = [0; 32];
    hex::decode_to_slice(text, &mut key).ok()?;
    (hex::encode(key) == text).then_some(key)
}

fn is_file_name(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    matches!((parts.next(), parts.next()), (Some(Component::Normal(part)), None) if part == name)
}

/// A SHA-256 from 64 hexadecimal digits.
///
/// # Errors
/// For anything else, naming `entry` of `file`.
pub(crate) fn digest_from_hex(file: &Path, entry: &str, text: &str) -> Result<[u8; 32], CaptureError> {
    let mut digest = [0; 32];
    match hex::decode_to_slice(text, &mut digest) {
        Ok(()) if hex::encode(digest) == text => Ok(digest),
        _ => {
            let expected = "a SHA-256 of 64 lower-case hexadecimal digits";
            Err(CaptureError::malformed(file, entry, expected, format!("{text:?}"), REMEDY))
        }
    }
}
