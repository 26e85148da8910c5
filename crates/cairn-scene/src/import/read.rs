//! Which format a capture is in, and reading it.

use std::path::{Path, PathBuf};

use crate::capture::Capture;
use crate::error::CaptureError;
use crate::images::format::ImageFormat;
use crate::import::options::ReadOptions;
use crate::import::{assemble, colmap, llff, model::Guess, transforms};

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
    /// all of them to at least twice as far, is `SceneKind::ForwardFacing`; NeRF-Synthetic, and a `transforms.json`
    /// whose photographs are all transparent (each has an alpha channel, and in
    /// five of them, chosen evenly, it is somewhere less than full) and whose
    /// `aabb_scale` is not over 1, is `SceneKind::Bounded`; everything else is
    /// `SceneKind::Unbounded`, which is right, if wasteful, for any scene.
    /// A forward-facing scene needs something that says where it begins: depth
    /// bounds, or points before the cameras.
    ///
    /// # Errors
    /// [`CaptureError`], naming the file and the entry, for anything missing,
    /// malformed or over the limits; [`CaptureError::HoldOut`].
    pub fn read(folder: &Path, options: &ReadOptions) -> Result<Self, CaptureError> {
        if let Some(every @ (0 | 1)) = options.hold_out {
            return Err(CaptureError::HoldOut { every });
        }
        let (folder, named) = (Self::folder_of(folder), camera_file(folder));
        std::fs::read_dir(folder).map_err(CaptureError::io("open", folder))?;
        let transforms = || transforms::read(folder, named, options)?.ok_or_else(|| no_cameras(folder, options));
        if named.is_some_and(|name| name != LLFF) {
            return assemble::assemble(folder, transforms()?, options);
        }
        let llff = llff::read(folder, options)?;
        let ahead = llff.as_ref().is_some_and(|m| m.kind == Guess::ForwardFacing);
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
}

/// Why `folder` is no capture: it lies in one, it has photographs alone, or nothing that is known.
fn no_cameras(folder: &Path, options: &ReadOptions) -> CaptureError {
    let above = match folder.parent() {
        Some(parent) if parent.as_os_str().is_empty() => PathBuf::from("."),
        Some(parent) if folder.file_name().is_some() => parent.to_path_buf(),
        _ => folder.join(".."),
    };
    if has_cameras(&above) {
        return CaptureError::InCapture { folder: folder.to_path_buf(), capture: above };
    }
    let named = options.images.iter().map(|images| folder.join(images));
    for images in named.chain([folder.join("images"), folder.to_path_buf()]) {
        let Ok(entries) = std::fs::read_dir(&images) else { continue };
        let photographs = entries.flatten().filter(|entry| ImageFormat::of_path(&entry.path()).is_some()).count();
        if photographs > 0 {
            return CaptureError::NoCameras { folder: folder.to_path_buf(), images, photographs };
        }
    }
    CaptureError::NotACapture { folder: folder.to_path_buf() }
}

const LLFF: &str = "poses_bounds.npy";
/// Camera files that a capture may be named by.
const CAMERA_FILES: [&str; 3] = ["transforms.json", "transforms_train.json", LLFF];

/// Whether cameras of any format lie where [`Capture::read`] looks for them in `folder`. A stray `cameras.txt` is none.
fn has_cameras(folder: &Path) -> bool {
    colmap::is_in(folder) || CAMERA_FILES.iter().any(|name| folder.join(name).is_file())
}

/// The name of the camera file that `from` is, if it is one.
fn camera_file(from: &Path) -> Option<&'static str> {
    let name = from.file_name()?.to_str()?;
    CAMERA_FILES.into_iter().find(|&known| known == name).filter(|_| from.is_file())
}
