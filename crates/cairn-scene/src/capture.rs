//! A capture: every view of one place with its camera, its photograph and who
//! took it, read from whichever format the cameras came in.

use std::path::{Path, PathBuf};

use cairn_durable::read_limited;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::cameras::camera::Camera;
use crate::error::CaptureError;
use crate::images::format::Limits;
use crate::images::mask::Mask;
use crate::images::photograph;
use crate::images::picture::Picture;
use crate::shell::quoted;
use crate::unused::{Standing, Unused, UnusedPhotographs, without_share};

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

/// How well structure from motion supports a photograph's pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// How many of its image points belong to a reconstructed point.
    pub points: u32,
    /// The mean over those of their points' reprojection errors, px; 0 without points.
    pub reprojection_error_px: f64,
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
    /// The public key (Ed25519) that the table of contributors gives for who took it, the same for all of theirs; whether
    /// it is a key is not looked at here. It is what a curator may bind the name to, and binds nothing by itself.
    pub contributor_key: Option<[u8; 32]>,
    /// Where the photograph lies, relative to [`Capture::root`], or absolute.
    pub photograph: PathBuf,
    /// Whether the photograph's pixels are meant as they are stored, without EXIF orientation, where both ways have the
    /// camera's size. Structure from motion that does not look at EXIF (COLMAP) computes its cameras on those.
    pub as_stored: bool,
    /// Whether it is kept from training, to measure on.
    pub held_out: bool,
    /// Where its mask lies, relative to [`Capture::root`], or absolute; `None` uses all pixels.
    pub mask: Option<PathBuf>,
    /// What structure from motion says for it; `None` where the format brings nothing of that.
    pub support: Option<Support>,
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
    /// What lies there and is not read.
    pub left_out: LeftOut,
}

/// What a capture's folder has and its views do not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Names of the views whose photographs are not there (see `skip_missing` of the options); of a `transforms.json`
    /// as it has them, maybe without an ending.
    pub missing: Vec<String>,
    /// Names of the photographs that no camera was found for, as their views would have them, sorted.
    pub without_camera: Vec<String>,
    /// Folders of further COLMAP models, relative to [`Capture::root`], sorted: COLMAP makes several where the
    /// photographs fall into groups that do not overlap.
    pub models: Vec<PathBuf>,
    /// Photographs that the contributor table names and no view shows: of those above, as far as they have a row.
    pub listed: Vec<UnusedPhotographs>,
}

/// Folders that hold one capture's photographs in several sizes.
const SIZES: [&str; 4] = ["images", "images_2", "images_4", "images_8"];
/// How many views or photographs a note names.
const NAMED: usize = 5;

impl Capture {
    /// Notes for who brought this capture, a sentence or two each: what was left out of it, which folder of
    /// photographs was taken where there are several, and which views' lenses fold
    /// within the frame.
    pub fn notes(&self) -> Vec<String> {
        let LeftOut { missing, without_camera, models, .. } = &self.left_out;
        let views = if missing.len() == 1 { "view" } else { "views" };
        let missing = (!missing.is_empty())
            .then(|| format!("left out {} {views} without photographs: {}", missing.len(), missing.join(", ")));
        let (have, them) = match without_camera.len() {
            1 => ("photograph has", "it"),
            _ => ("photographs have", "them"),
        };
        let without_camera = (!without_camera.is_empty()).then(|| {
            let (count, names) = (without_camera.len(), few(without_camera, NAMED));
            format!("{count} {have} no camera, and the scene leaves {them} out: {names}")
        });
        let models = models.iter().map(|model| self.model_note(model));
        let left_out = missing.into_iter().chain(without_camera).chain(models);
        left_out.chain(self.folder_note()).chain(self.lens_note()).collect()
    }

    /// The contributors who get no share whatever is trained: all of their photographs are held out, missing or
    /// without a camera. Of a stored scene the held-out ones alone are known.
    pub fn without_share(&self) -> Vec<UnusedPhotographs> {
        let views = self.views.iter().map(|view| Standing {
            contributor: &view.contributor,
            why: view.held_out.then_some(Unused::HeldOut),
            photographs: 1,
        });
        let listed = self.left_out.listed.iter().map(|row| Standing {
            contributor: &row.contributor,
            why: Some(row.why),
            photographs: row.photographs,
        });
        without_share(views.chain(listed))
    }

    fn model_note(&self, model: &Path) -> String {
        // A view is named from the folder of photographs on.
        let folder = |view: &View| {
            let depth = Path::new(&view.name).components().count();
            Some(self.root.join(view.photograph.ancestors().nth(depth)?))
        };
        let images = self.views.first().and_then(folder).unwrap_or_else(|| self.root.clone());
        let images = std::path::absolute(&images).unwrap_or(images);
        let [there, images] = [self.root.join(model), images].map(|path| quoted(&path.display().to_string()));
        format!(
            "COLMAP made another model, {}; this import does not read it (`--from {there} --images {images}` does)",
            model.display()
        )
    }

    fn folder_note(&self) -> Option<String> {
        let taken = self.views.first()?.photograph.components().next()?;
        let taken = SIZES.into_iter().find(|&name| Path::new(name).components().next() == Some(taken))?;
        let others: Vec<&str> =
            SIZES.into_iter().filter(|&name| name != taken && self.root.join(name).is_dir()).collect();
        let list = others.join(", ");
        (!others.is_empty()).then(|| format!("photographs are those in {taken}; there is {list}, too (--images DIR)"))
    }

    fn lens_note(&self) -> Option<String> {
        let folding: Vec<&str> =
            self.views.iter().filter(|v| v.camera.intrinsics.folds()).map(|v| v.name.as_str()).collect();
        let views = few(&folding, NAMED);
        (!folding.is_empty()).then(|| {
            format!(
                "the lens distortion of {views} folds within the frame: towards the corners its rays turn back, and what is seen \
                 there is placed wrongly; calibrate with fewer coefficients, or undistort the photographs (`colmap image_undistorter`)"
            )
        })
    }

    /// The photograph of view `view`, decoded: as large as the view's camera,
    /// EXIF orientation applied, alpha composited on the background. Orientation
    /// is left out where only the stored pixels fit the camera, which then was
    /// computed on those, and where both ways fit and the camera's format says
    /// so ([`View::as_stored`]).
    ///
    /// # Errors
    /// [`CaptureError`] for a view that is not there, a photograph that is
    /// missing, broken, over the limits, or of another size than the camera.
    pub fn photograph(&self, view: usize) -> Result<Picture, CaptureError> {
        let (path, limits) = self.photograph_path(view)?;
        let bytes = read_limited(&path, limits.max_file_bytes)?;
        self.decode(view, &path, &bytes)
    }

    /// The mask of view `view`, of its camera's size; `None` where all pixels are used.
    ///
    /// # Errors
    /// [`CaptureError`] for a view that is not there, a mask that is missing, broken, over the limits, or of another
    /// size than the camera.
    pub fn mask(&self, view: usize) -> Result<Option<Mask>, CaptureError> {
        let Some((path, limits)) = self.mask_path(view)? else { return Ok(None) };
        let bytes = read_limited(&path, limits.max_file_bytes)?;
        self.decode_mask(view, &path, &bytes).map(Some)
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

    /// Where view `view`'s mask lies, and the limits it is read under; `None` where it has none.
    pub(crate) fn mask_path(&self, view: usize) -> Result<Option<(PathBuf, Limits)>, CaptureError> {
        let missing = CaptureError::NoSuchView { view, views: self.views.len() };
        let view = self.views.get(view).ok_or(missing)?;
        Ok(view.mask.as_ref().map(|mask| (self.root.join(mask), limits_for(view))))
    }

    /// Decodes `bytes`, which were read from `path`, as view `view`'s mask.
    pub(crate) fn decode_mask(&self, view: usize, path: &Path, bytes: &[u8]) -> Result<Mask, CaptureError> {
        let view = &self.views[view];
        photograph::decode_mask(path, bytes, &limits_for(view), &view.camera.intrinsics)
    }

    /// Decodes `bytes`, which were read from `path`, as view `view`'s photograph.
    pub(crate) fn decode(&self, view: usize, path: &Path, bytes: &[u8]) -> Result<Picture, CaptureError> {
        let view = &self.views[view];
        let camera = &view.camera.intrinsics;
        photograph::decode_sized(path, bytes, &limits_for(view), self.background, camera, view.as_stored)
    }
}

/// The first `most` of `names`, and how many more there are.
pub(crate) fn few<T: AsRef<str>>(names: &[T], most: usize) -> String {
    let first: Vec<&str> = names.iter().take(most).map(AsRef::as_ref).collect();
    let rest = match names.len().saturating_sub(most) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    format!("{}{rest}", first.join(", "))
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
