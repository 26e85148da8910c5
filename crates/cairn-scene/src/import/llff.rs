//! LLFF's `poses_bounds.npy`: 17 numbers a view, a 3 x 5 matrix in row-major
//! order whose columns are down, right and backwards (world directions of the
//! camera's axes), position, and (height, width, focal), then near and far.
//! Format: <https://github.com/Fyusion/LLFF>, "Using your own poses".
//!
//! The rows carry no names: they belong to the photographs in order of name.

use std::path::{Path, PathBuf};

use cairn_durable::read_limited;
use glam::{DMat3, DVec3};

use crate::cameras::facing::face_one_way;
use crate::cameras::intrinsics::{Intrinsics, MAX_CAMERA_SIDE_PX};
use crate::cameras::lens::Distortion;
use crate::cameras::pose::Pose;
use crate::error::CaptureError;
use crate::images::format::ImageFormat;
use crate::import::model::{Entry, Guess, Model, check_count, image_folder};
use crate::import::npy;
use crate::import::options::ReadOptions;

/// Where photographs usually lie, in order of preference: the small ones are
/// what figures on these scenes are published for.
const FOLDERS: [&str; 4] = ["images_8", "images_4", "images_2", "images"];

/// Reads `folder/poses_bounds.npy`; `None` where there is none.
///
/// # Errors
/// For a file that is no N x 17 array, a row that is no camera, or another
/// number of photographs than rows.
pub(crate) fn read(folder: &Path, options: &ReadOptions) -> Result<Option<Model>, CaptureError> {
    let file = folder.join("poses_bounds.npy");
    if !file.is_file() {
        return Ok(None);
    }
    let matrix = npy::parse(&file, &read_limited(&file, options.limits.max_file_bytes)?)?;
    if matrix.columns != 17 {
        let (expected, remedy) = ("17 columns", "write it with LLFF's imgs2poses.py");
        return Err(CaptureError::malformed(&file, "shape", expected, format!("{}", matrix.columns), remedy));
    }
    check_count(&file, matrix.rows as u64, options.limits.max_views)?;
    let images = image_folder(folder, options, &FOLDERS).ok_or_else(|| {
        let (expected, remedy) = (
            format!("a folder beside it: {}", FOLDERS.join(", ")),
            "put the photographs there, or name another (--images DIR)",
        );
        CaptureError::malformed(&file, "the photographs", expected, "none".to_owned(), remedy)
    })?;
    let names = photographs(&folder.join(&images))?;
    if names.len() != matrix.rows {
        let (expected, got) = (format!("{} photographs", matrix.rows), names.len().to_string());
        let entry = format!("the folder {}", images.display());
        let remedy = "the rows belong to the photographs in order of name: bring exactly one for each row";
        return Err(CaptureError::malformed(&file, entry, expected, got, remedy));
    }
    let rows = matrix.values.chunks_exact(17).enumerate().zip(names);
    let entries = rows.map(|((i, row), name)| entry(&file, &images, i, row, name)).collect::<Result<Vec<_>, _>>()?;
    let kind = if face_one_way(entries.iter().map(|e| &e.pose)) { Guess::ForwardFacing } else { Guess::Unbounded };
    Ok(Some(Model::new(file, kind, entries)))
}

fn entry(file: &Path, images: &Path, index: usize, row: &[f64], name: String) -> Result<Entry, CaptureError> {
    let label = format!("row {index} ({name})");
    let wrong = |expected: &str, got: String| {
        Err(CaptureError::malformed(file, label.clone(), expected, got, "write it again with LLFF's imgs2poses.py"))
    };
    let column = |c: usize| DVec3::new(row[c], row[5 + c], row[10 + c]);
    let (down, right, back, position, hwf) = (column(0), column(1), column(2), column(3), column(4));
    let pose = Pose::from_file(DMat3::from_cols(right, down, -back), position)
        .map_err(|problem| CaptureError::Pose { file: file.to_path_buf(), entry: label.clone(), problem })?;
    let whole = |v: f64| (v.fract() == 0.0 && v >= 1.0 && v <= MAX_CAMERA_SIDE_PX as f64).then_some(v as usize);
    let (Some(height), Some(width)) = (whole(hwf.x), whole(hwf.y)) else {
        return wrong("a height and a width in whole pixels", format!("{} and {}", hwf.x, hwf.y));
    };
    let (near, far) = (row[15], row[16]);
    if !(near > 0.0 && far > near && far.is_finite()) {
        return wrong("bounds with 0 < near < far", format!("{near} and {far}"));
    }
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let intrinsics = Intrinsics { width, height, fx: hwf.z, fy: hwf.z, cx, cy, distortion: Distortion::default() };
    let photograph = images.join(&name);
    Ok(Entry {
        name,
        label,
        intrinsics,
        pose,
        photograph,
        bounds: Some((near, far)),
        mask: None,
        support: None,
        held_out: None,
    })
}

/// File names of the photographs in `folder` that are not hidden, sorted.
fn photographs(folder: &PathBuf) -> Result<Vec<String>, CaptureError> {
    let mut names = Vec::new();
    for item in std::fs::read_dir(folder).map_err(CaptureError::io("open", folder))? {
        let path = item.map_err(CaptureError::io("read", folder))?.path();
        if let (Some(_), Some(name)) = (ImageFormat::of_path(&path), path.file_name().and_then(|n| n.to_str()))
            // What macOS leaves beside files on other systems' disks (`._a.png`) is none.
            && !name.starts_with('.')
        {
            names.push(name.to_owned());
        }
    }
    names.sort();
    Ok(names)
}
