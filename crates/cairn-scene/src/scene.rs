//! A scene on disk: the table `scene.json`, the sparse points `points.bin`, the
//! contributors' photographs as they brought them, byte for byte, and `manifest.json` over them all.
//!
//! A scene appears whole or not at all: everything is checked and written into a
//! staging folder beside it, synced, and renamed. What is left of an import that
//! was cut off is a folder whose name starts with `.staging-`, which nothing reads.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use glam::DVec3;
use image::ImageFormat;
use sha2::{Digest, Sha256};

use crate::capture::{Capture, SceneKind};
use crate::error::CaptureError;
use crate::facing::check_near;
use crate::manifest::write_manifest;
use crate::photograph::{read_limited, write_synced};
use crate::picture::{Picture, Picture8};
use crate::scene_file::{FORMAT, PHOTOGRAPHS, PointsRow, SceneFile, VERSION, ViewRow, digest_from_hex, hex};
use crate::train_view::TrainView;

pub(crate) const TABLE: &str = "scene.json";
const POINTS: &str = "points.bin";
/// Largest table that is read: 100 000 views take about 70 MB.
pub(crate) const MAX_TABLE_BYTES: u64 = 256 << 20;
/// Largest file of points that is read: 80 million of them.
const MAX_POINTS_BYTES: u64 = 2 << 30;

/// A scene that is stored and was checked when it was opened.
#[derive(Clone, Debug)]
pub struct SceneFolder {
    folder: PathBuf,
    capture: Capture,
    digests: Vec<[u8; 32]>,
    /// Views that are not to be trained on.
    left_out: BTreeSet<usize>,
}

/// A photograph that is no longer what was imported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mismatch {
    /// Index of the view.
    pub view: usize,
    /// The photograph's file.
    pub photograph: PathBuf,
    /// Its SHA-256 at import.
    pub expected: [u8; 32],
    /// Its SHA-256 now, or why it cannot be read.
    pub got: Result<[u8; 32], String>,
}

impl SceneFolder {
    /// Stores `capture` as the scene `dir/name`, photographs included, and opens it.
    ///
    /// Every photograph is decoded before anything is visible. When this returns
    /// `Ok` the scene is on the disk (files, folders and the rename are synced);
    /// when it returns an error there is no new scene, and one that was there
    /// before is as it was.
    ///
    /// # Errors
    /// [`CaptureError`] for a name that is not allowed, a scene that exists, a
    /// forward-facing one without anything that says where it begins, a
    /// photograph that is missing or broken, and the file system's.
    pub fn create(dir: &Path, name: &str, capture: &Capture) -> Result<Self, CaptureError> {
        let target = scene_path(dir, name)?;
        let taken = || CaptureError::SceneExists { path: target.clone() };
        if fs::symlink_metadata(&target).is_ok() {
            return Err(taken());
        }
        if capture.kind == SceneKind::ForwardFacing {
            let views = capture.views.iter().map(|v| (&v.camera.pose, v.bounds.is_some()));
            check_near(&target, views, &capture.points)?;
        }
        fs::create_dir_all(dir).map_err(CaptureError::io("create", dir))?;
        let staging = Staging::new(dir, name)?;
        fill(&staging.0, capture)?;
        // Read back before it counts: what cannot be opened must not be published.
        Self::open_at(&staging.0)?;
        // A rename replaces nothing but an empty folder, so a scene that appeared meanwhile is safe too.
        fs::rename(&staging.0, &target).map_err(|e| match fs::symlink_metadata(&target) {
            Ok(_) => taken(),
            Err(_) => CaptureError::io("create", &target)(e),
        })?;
        sync_folder(dir)?;
        Self::open_at(&target)
    }

    /// Opens the scene `dir/name`: its table and points are read and checked,
    /// its photographs are not ([`SceneFolder::verify_photographs`] does that).
    ///
    /// # Errors
    /// [`CaptureError`] for a scene that is missing, of another format version,
    /// or altered.
    pub fn open(dir: &Path, name: &str) -> Result<Self, CaptureError> {
        Self::open_at(&scene_path(dir, name)?)
    }

    pub(crate) fn open_at(folder: &Path) -> Result<Self, CaptureError> {
        let file = folder.join(TABLE);
        let table = SceneFile::parse(&file, &read_limited(&file, MAX_TABLE_BYTES)?)?;
        let points = read_points(&folder.join(POINTS), &file, &table.points)?;
        let digests = table
            .views
            .iter()
            .map(|v| digest_from_hex(&file, &format!("view {}", v.name), &v.sha256))
            .collect::<Result<_, _>>()?;
        let capture = Capture {
            missing: Vec::new(),
            root: folder.to_path_buf(),
            kind: table.kind,
            background: table.background,
            views: table.views.into_iter().map(ViewRow::into_view).collect(),
            points,
        };
        Ok(Self { folder: folder.to_path_buf(), capture, digests, left_out: BTreeSet::new() })
    }

    /// The scene's own folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The stored capture; its photographs are the scene's copies.
    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    /// The same scene, of whose training views these (indices) are left out; what lies on the disk does not change.
    #[must_use]
    pub fn leaving_out(mut self, views: BTreeSet<usize>) -> Self {
        self.left_out = views;
        self
    }

    /// Indices of the views to train on, ascending: all that are neither held out nor left out.
    pub fn training(&self) -> impl Iterator<Item = usize> + '_ {
        self.capture.training().filter(|view| !self.left_out.contains(view))
    }

    /// Indices of all views that are not left out, ascending.
    pub fn kept(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.capture.views.len()).filter(|view| !self.left_out.contains(view))
    }

    /// SHA-256 of view `view`'s photograph, as it was imported.
    ///
    /// # Panics
    /// When there is no such view.
    pub fn photograph_digest(&self, view: usize) -> [u8; 32] {
        self.digests[view]
    }

    /// View `view`'s photograph, decoded from the very bytes that were imported.
    ///
    /// # Errors
    /// [`CaptureError::Altered`] when the file has changed since, and as
    /// [`Capture::photograph`].
    pub fn photograph(&self, view: usize) -> Result<Picture, CaptureError> {
        let (path, limits) = self.capture.photograph_path(view)?;
        let bytes = read_limited(&path, limits.max_file_bytes)?;
        let got: [u8; 32] = Sha256::digest(&bytes).into();
        if got != self.digests[view] {
            return Err(CaptureError::Altered { file: path, expected: hex(&self.digests[view]), got: hex(&got) });
        }
        self.capture.decode(view, &path, &bytes)
    }

    /// View `view` as trainings use it: its photograph in 8 bits, its camera and its mask, of one size.
    ///
    /// # Errors
    /// As [`SceneFolder::photograph`].
    pub fn train_view(&self, view: usize) -> Result<TrainView, CaptureError> {
        let rgb8 = Picture8::from(&self.photograph(view)?);
        Ok(TrainView { camera: self.capture.views[view].camera, rgb8, mask: None })
    }

    /// Every photograph whose bytes are not those that were imported; empty for
    /// a sound scene.
    pub fn verify_photographs(&self) -> Vec<Mismatch> {
        let check = |view: usize| {
            let (photograph, limits) = self.capture.photograph_path(view).ok()?;
            let got = read_limited(&photograph, limits.max_file_bytes)
                .map(|bytes| Sha256::digest(&bytes).into())
                .map_err(|e| e.to_string());
            let expected = self.digests[view];
            (got.as_ref() != Ok(&expected)).then_some(Mismatch { view, photograph, expected, got })
        };
        (0..self.digests.len()).filter_map(check).collect()
    }
}

/// The folder of scene `name`, if that is a name.
fn scene_path(dir: &Path, name: &str) -> Result<PathBuf, CaptureError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if name.is_empty() || name.len() > 64 || name.starts_with(['.', '-']) || !name.chars().all(allowed) {
        return Err(CaptureError::SceneName { name: name.to_owned() });
    }
    Ok(dir.join(name))
}

/// A folder of our own that goes when it is not renamed away.
struct Staging(PathBuf);

impl Staging {
    fn new(dir: &Path, name: &str) -> Result<Self, CaptureError> {
        for attempt in 0u32.. {
            let path = dir.join(format!(".staging-{name}-{}-{attempt}", std::process::id()));
            match fs::create_dir(&path) {
                Ok(()) => return Ok(Self(path)),
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists && attempt < 1000 => {}
                Err(e) => return Err(CaptureError::io("create", &path)(e)),
            }
        }
        unreachable!("the loop returns on its 1001st attempt at the latest")
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // After the rename there is nothing left to remove, and a leftover is only litter.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Writes everything of a scene into `folder` and syncs it.
fn fill(folder: &Path, capture: &Capture) -> Result<(), CaptureError> {
    let photographs = folder.join(PHOTOGRAPHS);
    fs::create_dir(&photographs).map_err(CaptureError::io("create", &photographs))?;
    let views = (0..capture.views.len())
        .map(|view| copy_photograph(&photographs, capture, view))
        .collect::<Result<Vec<_>, _>>()?;
    sync_folder(&photographs)?;

    let points: Vec<u8> = capture.points.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect();
    write_synced(&folder.join(POINTS), &points)?;
    let table = SceneFile {
        format: FORMAT.to_owned(),
        version: VERSION,
        kind: capture.kind,
        background: capture.background,
        points: PointsRow { count: capture.points.len() as u64, sha256: hex(&Sha256::digest(&points)) },
        views,
    };
    let path = folder.join(TABLE);
    let json = serde_json::to_vec_pretty(&table).map_err(|e| CaptureError::io("write", &path)(e.into()))?;
    write_synced(&path, &json)?;
    // Last, over all that was written: it tells a changed byte also in the table itself.
    write_manifest(folder)?;
    sync_folder(folder)
}

/// Copies one photograph, which must decode; the bytes checked are the bytes kept.
fn copy_photograph(folder: &Path, capture: &Capture, index: usize) -> Result<ViewRow, CaptureError> {
    let (path, limits) = capture.photograph_path(index)?;
    let bytes = read_limited(&path, limits.max_file_bytes)?;
    capture.decode(index, &path, &bytes)?;
    let ending = if image::guess_format(&bytes).ok() == Some(ImageFormat::Png) { "png" } else { "jpg" };
    let photograph = format!("{index:06}.{ending}");
    write_synced(&folder.join(&photograph), &bytes)?;
    let view = &capture.views[index];
    Ok(ViewRow {
        name: view.name.clone(),
        contributor: view.contributor.clone(),
        held_out: view.held_out,
        bounds: view.bounds,
        camera: view.camera,
        photograph,
        as_stored: view.photograph.as_stored,
        sha256: hex(&Sha256::digest(&bytes)),
    })
}

fn read_points(path: &Path, table: &Path, row: &PointsRow) -> Result<Vec<DVec3>, CaptureError> {
    let expected = digest_from_hex(table, "points", &row.sha256)?;
    let bytes = read_limited(path, MAX_POINTS_BYTES)?;
    let got: [u8; 32] = Sha256::digest(&bytes).into();
    if got != expected {
        return Err(CaptureError::Altered { file: path.to_path_buf(), expected: hex(&expected), got: hex(&got) });
    }
    let wrong = |expected: String, got: String| {
        CaptureError::malformed(path, "the points", expected, got, "import the capture again")
    };
    if row.count.checked_mul(24) != Some(bytes.len() as u64) {
        return Err(wrong(format!("{} points of 24 bytes", row.count), format!("{} bytes", bytes.len())));
    }
    let numbers: Vec<f64> = bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let points: Vec<DVec3> = numbers.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect();
    match points.iter().position(|p| !p.is_finite()) {
        Some(at) => Err(wrong("finite coordinates".to_owned(), format!("{} at {at}", points[at]))),
        None => Ok(points),
    }
}

/// Waits until a folder's entries are on the disk.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), CaptureError> {
    File::open(folder).and_then(|f| f.sync_all()).map_err(CaptureError::io("sync", folder))
}
