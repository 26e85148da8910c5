//! A scene on disk: the table `scene.json`, the sparse points `points.bin`, the
//! contributors' photographs as they brought them, byte for byte, their masks as PNGs of 1 bit, and `manifest.json`
//! over them all.
//!
//! A scene appears whole or not at all: everything is checked and written into a
//! staging folder beside it, synced, and renamed. What is left of an import that
//! was cut off is a folder whose name starts with `.staging-`, which nothing reads.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use cairn_durable::{read_limited, sync_folder, write_synced};
use glam::DVec3;
use sha2::{Digest, Sha256};

use crate::cameras::facing::check_near;
use crate::capture::{Capture, LeftOut, SceneKind};
use crate::error::CaptureError;
use crate::images::format::ImageFormat;
use crate::images::mask::Mask;
use crate::images::picture::{Picture, Picture8};
use crate::scene::manifest::write_manifest;
use crate::scene::table::{
    FORMAT, MASKS, MAX_TABLE_BYTES, MaskRow, PHOTOGRAPHS, PointsRow, SceneFile, TABLE, VERSION, ViewRow,
    digest_from_hex,
};
use crate::train_view::TrainView;

const POINTS: &str = "points.bin";
/// Largest file of points that is read: 80 million of them.
const MAX_POINTS_BYTES: u64 = 2 << 30;

/// A scene that is stored and was checked when it was opened.
#[derive(Clone, Debug)]
pub struct SceneFolder {
    folder: PathBuf,
    capture: Capture,
    digests: Vec<[u8; 32]>,
    /// SHA-256 of each view's mask, where it has one.
    mask_digests: Vec<Option<[u8; 32]>>,
    /// Views that are not to be trained on.
    left_out: BTreeSet<usize>,
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
    /// its photographs as each is decoded.
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
        let of_mask = |v: &ViewRow| match &v.mask {
            Some(mask) => digest_from_hex(&file, &format!("the mask of view {}", v.name), &mask.sha256).map(Some),
            None => Ok(None),
        };
        let mask_digests = table.views.iter().map(of_mask).collect::<Result<_, _>>()?;
        let capture = Capture {
            left_out: LeftOut::default(),
            root: folder.to_path_buf(),
            kind: table.kind,
            background: table.background,
            views: table.views.into_iter().map(ViewRow::into_view).collect(),
            points,
        };
        Ok(Self { folder: folder.to_path_buf(), capture, digests, mask_digests, left_out: BTreeSet::new() })
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
        let bytes = read_held_to(&path, limits.max_file_bytes, &self.digests[view])?;
        self.capture.decode(view, &path, &bytes)
    }

    /// View `view`'s mask, of its photograph's size; `None` where all pixels are used.
    ///
    /// # Errors
    /// [`CaptureError::Altered`] when the file has changed since the import, and as [`Capture::mask`].
    pub fn mask(&self, view: usize) -> Result<Option<Mask>, CaptureError> {
        let Some((path, limits)) = self.capture.mask_path(view)? else { return Ok(None) };
        // The table gives each mask a digest.
        let digest = self.mask_digests[view].unwrap_or_default();
        let bytes = read_held_to(&path, limits.max_file_bytes, &digest)?;
        self.capture.decode_mask(view, &path, &bytes).map(Some)
    }

    /// View `view` as trainings use it: its photograph in 8 bits, its camera and its mask, of one size.
    ///
    /// # Errors
    /// As [`SceneFolder::photograph`] and [`SceneFolder::mask`].
    pub fn train_view(&self, view: usize) -> Result<TrainView, CaptureError> {
        let rgb8 = Picture8::from(&self.photograph(view)?);
        Ok(TrainView { camera: self.capture.views[view].camera, rgb8, mask: self.mask(view)? })
    }
}

/// The bytes of the file at `path`, whose SHA-256 must be `expected`.
fn read_held_to(path: &Path, limit: u64, expected: &[u8; 32]) -> Result<Vec<u8>, CaptureError> {
    let bytes = read_limited(path, limit)?;
    let got: [u8; 32] = Sha256::digest(&bytes).into();
    if got != *expected {
        return Err(CaptureError::Altered {
            file: path.to_path_buf(),
            expected: hex::encode(expected),
            got: hex::encode(got),
        });
    }
    Ok(bytes)
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
    if capture.views.iter().any(|view| view.mask.is_some()) {
        let masks = folder.join(MASKS);
        fs::create_dir(&masks).map_err(CaptureError::io("create", &masks))?;
    }
    let views = (0..capture.views.len()).map(|view| copy_view(folder, capture, view)).collect::<Result<Vec<_>, _>>()?;
    sync_folder(&photographs)?;
    if views.iter().any(|view| view.mask.is_some()) {
        sync_folder(&folder.join(MASKS))?;
    }

    let points: Vec<u8> = capture.points.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect();
    write_synced(&folder.join(POINTS), &points)?;
    let table = SceneFile {
        format: FORMAT.to_owned(),
        version: VERSION,
        kind: capture.kind,
        background: capture.background,
        points: PointsRow { count: capture.points.len() as u64, sha256: hex::encode(Sha256::digest(&points)) },
        views,
    };
    let path = folder.join(TABLE);
    let json = serde_json::to_vec_pretty(&table).map_err(|e| CaptureError::io("write", &path)(e.into()))?;
    write_synced(&path, &json)?;
    // Last, over all that was written: it tells a changed byte also in the table itself.
    write_manifest(folder)?;
    Ok(sync_folder(folder)?)
}

/// Copies one view's photograph and mask, which must decode. A photograph's bytes that are checked are those that are
/// kept; a mask is kept as its pixels say.
fn copy_view(folder: &Path, capture: &Capture, index: usize) -> Result<ViewRow, CaptureError> {
    let (path, limits) = capture.photograph_path(index)?;
    let bytes = read_limited(&path, limits.max_file_bytes)?;
    capture.decode(index, &path, &bytes)?;
    let ending = ImageFormat::of(&bytes).map_or("", |format| format.endings()[0]);
    let photograph = format!("{index:06}.{ending}");
    write_synced(&folder.join(PHOTOGRAPHS).join(&photograph), &bytes)?;
    let mask = match capture.mask(index)? {
        None => None,
        Some(mask) => {
            let (file, png) = (format!("{index:06}.png"), mask.to_png());
            write_synced(&folder.join(MASKS).join(&file), &png)?;
            Some(MaskRow { file, sha256: hex::encode(Sha256::digest(&png)) })
        }
    };
    let view = &capture.views[index];
    Ok(ViewRow {
        name: view.name.clone(),
        contributor: view.contributor.clone(),
        contributor_key: view.contributor_key.map(hex::encode),
        held_out: view.held_out,
        bounds: view.bounds,
        camera: view.camera,
        photograph,
        as_stored: view.as_stored,
        sha256: hex::encode(Sha256::digest(&bytes)),
        mask,
        support: view.support,
    })
}

fn read_points(path: &Path, table: &Path, row: &PointsRow) -> Result<Vec<DVec3>, CaptureError> {
    let expected = digest_from_hex(table, "points", &row.sha256)?;
    let bytes = read_held_to(path, MAX_POINTS_BYTES, &expected)?;
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
