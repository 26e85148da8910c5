//! A capture: every view of one place with its camera, its photograph and who
//! took it, read from whichever format the cameras came in.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::error::CaptureError;
use crate::photograph::{self, Limits};
use crate::photograph_file::PhotographFile;
use crate::picture::Picture;
use crate::{assemble, colmap, llff, transforms};

/// The contributor of a view that no table says anything about.
pub const UNKNOWN_CONTRIBUTOR: &str = "unknown";

/// How a scene lies around its cameras; decides how space is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneKind {
    /// All cameras look the same way from about the same place (LLFF).
    ForwardFacing,
    /// An object within a box, nothing behind it (NeRF-Synthetic).
    Bounded,
    /// Something in the open, with a background without end.
    Unbounded,
}

/// One photograph and its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// What the camera file calls it; unique in the capture, `/` between folders.
    pub name: String,
    /// Its camera, at the photograph's own size.
    pub camera: Camera,
    /// Who took it; [`UNKNOWN_CONTRIBUTOR`] where no table was given.
    pub contributor: String,
    /// Where the photograph lies, relative to [`Capture::root`], and which way its pixels are meant.
    pub photograph: PhotographFile,
    /// Whether it is kept from training, to measure on.
    pub held_out: bool,
    /// Nearest and farthest depth of the scene here, in the capture's unit
    /// (LLFF brings it).
    pub bounds: Option<(f64, f64)>,
}

/// Every view of one place.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The folder that photographs are relative to.
    pub root: PathBuf,
    /// How the scene lies around its cameras.
    pub kind: SceneKind,
    /// What transparent photographs are composited on, RGB in [0, 1]; `None`
    /// where the photographs are not transparent (an alpha channel that is full
    /// everywhere is not), or some in the open are and others are not. White then
    /// stands in for it when a photograph is decoded, but nothing is rendered before it.
    pub background: Option<[f32; 3]>,
    /// The views, sorted by name (bytewise).
    pub views: Vec<View>,
    /// Sparse points on the scene's surfaces, in the capture's unit, finite;
    /// empty where the format brings none.
    pub points: Vec<DVec3>,
    /// Names of the views that were left out because their photographs are not there (see
    /// [`ReadOptions::skip_missing`]); of a `transforms.json` as it has them, maybe without an ending.
    pub missing: Vec<String>,
}

/// How to read a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadOptions {
    /// A CSV table with the columns `image` and `contributor`, one row a view.
    pub contributors: Option<PathBuf>,
    /// What kind of scene it is, instead of the guess.
    pub kind: Option<SceneKind>,
    /// Hold out views 0, n, 2n, ... in order of name; 0 holds out none. A
    /// capture that brings its own split keeps that.
    pub hold_every: usize,
    /// The folder of photographs, relative to the capture (or absolute),
    /// instead of the format's usual one.
    pub images: Option<PathBuf>,
    /// Leave out the views whose photographs are not there, where any is; else the first is an error.
    pub skip_missing: bool,
    /// The most that is accepted.
    pub limits: Limits,
}

impl Default for ReadOptions {
    /// No table, kind guessed, every 8th view held out, default limits.
    fn default() -> Self {
        Self {
            contributors: None,
            kind: None,
            hold_every: 8,
            images: None,
            skip_missing: false,
            limits: Limits::default(),
        }
    }
}

impl Capture {
    /// Reads the capture in `folder`, whichever format its cameras are in. A camera file may be named instead
    /// ([`Capture::folder_of`]); then that one is read.
    ///
    /// The first of these that is there is read:
    /// 1. `poses_bounds.npy` whose cameras all face one way (LLFF);
    /// 2. a COLMAP model in `sparse/0`, `sparse` or the folder itself;
    /// 3. any other `poses_bounds.npy`;
    /// 4. `transforms_train.json` with `transforms_test.json` or, without that,
    ///    `transforms_val.json` (NeRF-Synthetic);
    /// 5. `transforms.json` (instant-ngp, nerfstudio).
    ///
    /// LLFF comes before COLMAP because LLFF's scenes ship with both and only
    /// the former has depth bounds; a 360-degree capture that ships with both
    /// (Mip-NeRF 360) does not face one way.
    ///
    /// Photographs lie, unless `options.images` says otherwise, in the first of
    /// `images_8`, `images_4`, `images_2`, `images` for LLFF (its figures are
    /// published for the smaller ones); in the first of `images`, `images_2`,
    /// `images_4`, `images_8`, or else the folder itself, for COLMAP; where
    /// `file_path` says for transforms. Cameras are brought to the photographs'
    /// size where only the size differs.
    ///
    /// The kind is guessed: LLFF whose cameras face one way, and a COLMAP model
    /// whose cameras do from about one place, with points that reach from before
    /// all of them to at least twice as far, is [`SceneKind::ForwardFacing`]; NeRF-Synthetic, and a `transforms.json`
    /// whose photographs are all transparent (each has an alpha channel, and in
    /// five of them, chosen evenly, it is somewhere less than full) and whose
    /// `aabb_scale` is not over 1, is [`SceneKind::Bounded`]; everything else is
    /// [`SceneKind::Unbounded`], which is right, if wasteful, for any scene.
    /// A forward-facing scene needs something that says where it begins: depth
    /// bounds, or points before the cameras.
    ///
    /// # Errors
    /// [`CaptureError`], naming the file and the entry, for anything missing,
    /// malformed or over the limits.
    pub fn read(folder: &Path, options: &ReadOptions) -> Result<Self, CaptureError> {
        let (folder, named) = (Self::folder_of(folder), camera_file(folder));
        std::fs::read_dir(folder).map_err(CaptureError::io("open", folder))?;
        let transforms = || {
            transforms::read(folder, named, options)?
                .ok_or_else(|| CaptureError::NotACapture { folder: folder.to_path_buf() })
        };
        if named.is_some_and(|name| name != LLFF) {
            return assemble::assemble(folder, transforms()?, options);
        }
        let llff = llff::read(folder, options)?;
        let ahead = llff.as_ref().is_some_and(|m| m.kind == assemble::Guess::ForwardFacing);
        let colmap = if ahead || named.is_some() { None } else { colmap::read(folder, options)? };
        let model = match colmap.or(llff) {
            Some(model) => model,
            None => transforms()?,
        };
        assemble::assemble(folder, model, options)
    }

    /// The folder of the capture at `from`: `from` itself, or where that is a camera file that gives a capture its
    /// format (`transforms.json`, `transforms_train.json`, `poses_bounds.npy`), the folder it lies in.
    pub fn folder_of(from: &Path) -> &Path {
        match from.parent().filter(|_| camera_file(from).is_some()) {
            // The file in the folder that the process is in.
            Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
            Some(parent) => parent,
            None => from,
        }
    }

    /// The photograph of view `view`, decoded: as large as the view's camera,
    /// EXIF orientation applied, alpha composited on the background. Orientation
    /// is left out where only the stored pixels fit the camera, which then was
    /// computed on those, and where both ways fit and the camera's format says
    /// so ([`PhotographFile::as_stored`]).
    ///
    /// # Errors
    /// [`CaptureError`] for a view that is not there, a photograph that is
    /// missing, broken, over the limits, or of another size than the camera.
    pub fn photograph(&self, view: usize) -> Result<Picture, CaptureError> {
        let (path, limits) = self.photograph_path(view)?;
        let bytes = photograph::read_limited(&path, limits.max_file_bytes)?;
        self.decode(view, &path, &bytes)
    }

    /// Indices of the views to train on, ascending.
    pub fn training(&self) -> impl Iterator<Item = usize> + '_ {
        self.views.iter().enumerate().filter(|(_, v)| !v.held_out).map(|(i, _)| i)
    }

    /// Indices of the views to measure on, ascending.
    pub fn held_out(&self) -> impl Iterator<Item = usize> + '_ {
        self.views.iter().enumerate().filter(|(_, v)| v.held_out).map(|(i, _)| i)
    }

    /// Where view `view`'s photograph lies, and the limits it is read under: the
    /// usual ones, or as much more as its camera's size needs.
    pub(crate) fn photograph_path(&self, view: usize) -> Result<(PathBuf, Limits), CaptureError> {
        let missing = CaptureError::NoSuchView { view, views: self.views.len() };
        let view = self.views.get(view).ok_or(missing)?;
        Ok((self.root.join(&view.photograph), limits_for(view)))
    }

    /// Decodes `bytes`, which were read from `path`, as view `view`'s photograph.
    pub(crate) fn decode(&self, view: usize, path: &Path, bytes: &[u8]) -> Result<Picture, CaptureError> {
        let view = &self.views[view];
        let size = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        photograph::decode_sized(path, bytes, &limits_for(view), self.background, size, view.photograph.as_stored)
    }
}

const LLFF: &str = "poses_bounds.npy";

/// The name of the camera file that `from` is, if it is one.
fn camera_file(from: &Path) -> Option<&'static str> {
    let known = ["transforms.json", "transforms_train.json", LLFF];
    let name = from.file_name()?.to_str()?;
    known.into_iter().find(|&known| known == name).filter(|_| from.is_file())
}

fn limits_for(view: &View) -> Limits {
    let (w, h) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    let usual = Limits::default();
    let pixels = w as u64 * h as u64;
    Limits {
        // 16-bit RGBA that does not compress, twice over.
        max_file_bytes: usual.max_file_bytes.max(pixels.saturating_mul(16)),
        max_side_px: usual.max_side_px.max(w).max(h),
        max_pixels: usual.max_pixels.max(pixels),
        max_views: usual.max_views,
    }
}
