//! From COLMAP's cameras, images and points to a model.
//!
//! An image's pose is world-to-camera: a quaternion (w, x, y, z) and a
//! translation, `x_camera = R x_world + t`, in OpenCV axes. COLMAP puts the top
//! left pixel's centre at (0.5, 0.5), as Cairn does, so nothing is shifted. It does
//! not look at EXIF orientation: its poses are those of the pixels as they are stored.

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat};

use crate::cameras::pose::Pose;
use crate::capture::LeftOut;
use crate::error::CaptureError;
use crate::import::colmap::parts::{Cameras, Image, Points, REMEDY};
use crate::import::colmap::{binary, text};
use crate::import::model::{self, Entry, Guess, ImageFolder, Model};
use crate::import::options::ReadOptions;

/// Where COLMAP's tools look for masks, beside the photographs.
const MASKS: &str = "masks";

/// Reads the COLMAP model of `folder`; `None` where there is none.
///
/// # Errors
/// For a model that is incomplete, garbled, or of an unsupported camera model.
pub(crate) fn read(folder: &Path, options: &ReadOptions) -> Result<Option<Model>, CaptureError> {
    let Some((place, ending)) = place_in(folder) else { return Ok(None) };
    let [cameras_file, images_file, points_file] =
        ["cameras", "images", "points3D"].map(|name| place.join(format!("{name}.{ending}")));
    let max_views = options.limits.max_views;
    let points = match ending {
        _ if !points_file.is_file() => None,
        "bin" => Some(binary::points(&points_file)?),
        _ => Some(text::points(&points_file)?),
    };
    let (cameras, images) = match ending {
        "bin" => (binary::cameras(&cameras_file)?, binary::images(&images_file, max_views, points.as_ref())?),
        _ => (text::cameras(&cameras_file)?, text::images(&images_file, max_views, points.as_ref())?),
    };
    let usual = ["images", "images_2", "images_4", "images_8"];
    let photographs = model::image_folder(folder, options, &usual).unwrap_or_default();
    let entries = images
        .into_iter()
        .map(|image| entry(&images_file, &cameras, &photographs, image))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Some(Model {
        file: images_file,
        kind: Guess::ForwardFacingIfDeep,
        as_stored: true,
        entries,
        points: points.map(|points: Points| points.positions).unwrap_or_default(),
        masks: folder.join(MASKS).is_dir().then(|| MASKS.into()),
        images: Some(ImageFolder { path: photographs, is_in_names: false }),
        left_out: LeftOut { models: models_beside(folder, &place), ..LeftOut::default() },
    }))
}

/// Whether a whole model lies where [`read`] looks for it in `folder`: cameras, and images beside them.
pub(crate) fn is_in(folder: &Path) -> bool {
    place_in(folder).is_some_and(|(place, ending)| place.join(format!("images.{ending}")).is_file())
}

/// Where the model of `folder` lies, and the ending of its files.
fn place_in(folder: &Path) -> Option<(PathBuf, &'static str)> {
    let places = [folder.join("sparse/0"), folder.join("sparse"), folder.to_path_buf()];
    places.into_iter().find_map(|place| ending_in(&place).map(|ending| (place, ending)))
}

/// Folders of models beside the one at `place`, relative to `folder`.
fn models_beside(folder: &Path, place: &Path) -> Vec<PathBuf> {
    if place != folder.join("sparse/0") {
        return Vec::new();
    }
    let there = std::fs::read_dir(folder.join("sparse")).into_iter().flatten().flatten().map(|entry| entry.path());
    let others = there.filter(|path| path != place && ending_in(path).is_some());
    let mut models: Vec<PathBuf> = others.filter_map(|path| Some(path.strip_prefix(folder).ok()?.to_owned())).collect();
    models.sort();
    models
}

/// `bin` or `txt`, whichever has cameras at `place`; binary first, as it is exact.
fn ending_in(place: &Path) -> Option<&'static str> {
    ["bin", "txt"].into_iter().find(|ending| place.join(format!("cameras.{ending}")).is_file())
}

fn entry(file: &Path, cameras: &Cameras, photographs: &Path, image: Image) -> Result<Entry, CaptureError> {
    let label = format!("image {} ({})", image.id, image.name);
    let wrong = |expected: &str, got: String| CaptureError::malformed(file, label.clone(), expected, got, REMEDY);
    let intrinsics = *cameras
        .get(&image.camera)
        .ok_or_else(|| wrong("a camera that the cameras file lists", format!("camera {}", image.camera)))?;
    let relative = model::inside(&image.name)
        .ok_or_else(|| wrong("a name inside the folder of photographs", format!("{:?}", image.name)))?;
    let [w, x, y, z] = image.rotation;
    let quaternion = DQuat::from_xyzw(x, y, z, w);
    let norm = quaternion.length();
    if norm.is_nan() || (norm - 1.0).abs() > 1e-3 {
        return Err(wrong("a quaternion of length 1 to within 1e-3", format!("length {norm}")));
    }
    let camera_to_world = DMat3::from_quat(quaternion.normalize()).transpose();
    let pose = Pose::new(camera_to_world, -(camera_to_world * image.translation))
        .map_err(|problem| CaptureError::Pose { file: file.to_path_buf(), entry: label.clone(), problem })?;
    let photograph: PathBuf = photographs.join(relative);
    let Image { name, support, .. } = image;
    Ok(Entry { name, label, intrinsics, pose, photograph, bounds: None, mask: None, support, held_out: None })
}
