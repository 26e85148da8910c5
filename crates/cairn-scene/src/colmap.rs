//! COLMAP sparse models, binary and text: cameras, images, points3D.
//! Format: <https://colmap.github.io/format.html>.
//!
//! An image's pose is world-to-camera: a quaternion (w, x, y, z) and a
//! translation, `x_camera = R x_world + t`, in OpenCV axes. COLMAP puts the top
//! left pixel's centre at (0.5, 0.5), as Cairn does, so nothing is shifted. It does
//! not look at EXIF orientation: its poses are those of the pixels as they are stored.

mod binary;
mod text;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use crate::assemble::{self, Entry, Guess, MAX_CAMERA_SIDE_PX, Model};
use crate::camera::{Distortion, Intrinsics, Pose};
use crate::capture::ReadOptions;
use crate::error::CaptureError;

/// What to do about a file that is cut short or garbled.
const REMEDY: &str = "export the model again with COLMAP (`colmap model_converter`)";

/// COLMAP's camera models by number, with how many parameters each has
/// (src/colmap/sensor/models.h).
const MODELS: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

/// One image as either kind of file states it.
struct Image {
    id: u32,
    /// Quaternion w, x, y, z, world to camera.
    rotation: [f64; 4],
    translation: DVec3,
    camera: u32,
    name: String,
}

/// Cameras by their number.
type Cameras = HashMap<u32, Intrinsics>;

/// Reads the COLMAP model of `folder`; `None` where there is none.
///
/// # Errors
/// For a model that is incomplete, garbled, or of an unsupported camera model.
pub(crate) fn read(folder: &Path, options: &ReadOptions) -> Result<Option<Model>, CaptureError> {
    let places = [folder.join("sparse/0"), folder.join("sparse"), folder.to_path_buf()];
    let Some((place, ending)) = places.iter().find_map(|place| Some((place, ending_in(place)?))) else {
        return Ok(None);
    };
    let [cameras_file, images_file, points_file] =
        ["cameras", "images", "points3D"].map(|name| place.join(format!("{name}.{ending}")));
    let max_views = options.limits.max_views;
    let (cameras, images) = match ending {
        "bin" => (binary::cameras(&cameras_file)?, binary::images(&images_file, max_views)?),
        _ => (text::cameras(&cameras_file)?, text::images(&images_file, max_views)?),
    };
    let points = match ending {
        _ if !points_file.is_file() => Vec::new(),
        "bin" => binary::points(&points_file)?,
        _ => text::points(&points_file)?,
    };
    let usual = ["images", "images_2", "images_4", "images_8"];
    let photographs = assemble::image_folder(folder, options, &usual).unwrap_or_default();
    let entries = images
        .into_iter()
        .map(|image| entry(&images_file, &cameras, &photographs, image))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Some(Model {
        file: images_file,
        kind: Guess::ForwardFacingIfDeep,
        as_stored: true,
        entries,
        points,
        missing: Vec::new(),
    }))
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
    let relative = assemble::inside(&image.name)
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
    Ok(Entry { name: image.name, label, intrinsics, pose, photograph, bounds: None, held_out: None })
}

/// A camera's model number from its name.
fn model_number(file: &Path, id: u32, name: &str) -> Result<usize, CaptureError> {
    MODELS.iter().position(|(known, _)| *known == name).ok_or_else(|| unsupported(file, id, name.to_owned()))
}

fn unsupported(file: &Path, id: u32, model: String) -> CaptureError {
    CaptureError::UnsupportedCamera { file: file.to_path_buf(), entry: format!("camera {id}"), model }
}

/// The camera that `model` (an index of [`MODELS`]) and its parameters describe.
fn intrinsics(
    file: &Path,
    id: u32,
    model: usize,
    (width, height): (u64, u64),
    p: &[f64],
) -> Result<Intrinsics, CaptureError> {
    let none = Distortion::default();
    let (fx, fy, cx, cy, distortion) = match (MODELS[model].0, p) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => (f, f, cx, cy, none),
        ("PINHOLE", &[fx, fy, cx, cy]) => (fx, fy, cx, cy, none),
        ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => (f, f, cx, cy, Distortion { k1, ..none }),
        ("RADIAL", &[f, cx, cy, k1, k2]) => (f, f, cx, cy, Distortion { k1, k2, ..none }),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => (fx, fy, cx, cy, Distortion { k1, k2, k3: 0.0, p1, p2 }),
        (name, p) if p.len() == MODELS[model].1 => return Err(unsupported(file, id, name.to_owned())),
        (name, p) => {
            let (expected, got) = (format!("{} parameters of {name}", MODELS[model].1), p.len().to_string());
            return Err(CaptureError::malformed(file, format!("camera {id}"), expected, got, REMEDY));
        }
    };
    // A side over the bound saturates and is refused with the rest of the checks.
    let side = |v: u64| usize::try_from(v).unwrap_or(usize::MAX).min(MAX_CAMERA_SIDE_PX + 1);
    let intrinsics = Intrinsics { width: side(width), height: side(height), fx, fy, cx, cy, distortion };
    assemble::check_intrinsics(file, &format!("camera {id}"), &intrinsics)?;
    Ok(intrinsics)
}

/// Keeps `camera` under its number, once.
fn insert(file: &Path, cameras: &mut Cameras, id: u32, camera: Intrinsics) -> Result<(), CaptureError> {
    if cameras.insert(id, camera).is_some() {
        let expected = "a camera number used only once";
        return Err(CaptureError::malformed(file, format!("camera {id}"), expected, "it twice", REMEDY));
    }
    Ok(())
}

/// `point` if it is one.
fn check_point(file: &Path, id: u64, point: DVec3) -> Result<DVec3, CaptureError> {
    if !point.is_finite() {
        let got = point.to_string();
        return Err(CaptureError::malformed(file, format!("point {id}"), "finite coordinates", got, REMEDY));
    }
    Ok(point)
}
