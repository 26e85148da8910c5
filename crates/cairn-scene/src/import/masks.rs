//! Which mask belongs to which photograph.

use std::path::{Path, PathBuf};

use crate::error::CaptureError;
use crate::images::format::ImageFormat;
use crate::import::model::{Entry, Model};
use crate::import::options::ReadOptions;

/// The masks of the model's views, in their order: from the folder that was asked for, or as the camera file says, or
/// from the folder where the format keeps them.
///
/// # Errors
/// For a folder that was asked for and is not there or has no mask of any view, and a mask that the camera file names
/// and is not there.
pub(crate) fn find(root: &Path, model: &Model, options: &ReadOptions) -> Result<Vec<Option<PathBuf>>, CaptureError> {
    if let Some(folder) = &options.masks {
        let place = root.join(folder);
        std::fs::read_dir(&place).map_err(CaptureError::io("open", &place))?;
        let found: Vec<_> = model.entries.iter().map(|entry| in_folder(root, folder, entry)).collect();
        if found.iter().all(Option::is_none) {
            let endings = endings().map(|ending| format!(".{ending}")).collect::<Vec<_>>().join(" or ");
            let expected =
                format!("at least one mask, named as its photograph with {endings} behind or for the ending");
            let remedy = "name the masks so, or name their folder (--masks DIR)";
            return Err(CaptureError::malformed(&place, "the masks", expected, "none", remedy));
        }
        return Ok(found);
    }
    model.entries.iter().map(|entry| of_entry(root, model, entry)).collect()
}

fn of_entry(root: &Path, model: &Model, entry: &Entry) -> Result<Option<PathBuf>, CaptureError> {
    if let Some(mask) = &entry.mask {
        if root.join(mask).is_file() {
            return Ok(Some(mask.clone()));
        }
        let (expected, got) = ("a mask that is there", format!("{} is not", root.join(mask).display()));
        let remedy = "bring the mask, or remove its mask_path";
        return Err(CaptureError::malformed(&model.file, entry.label.clone(), expected, got, remedy));
    }
    Ok(model.masks.as_ref().and_then(|folder| in_folder(root, folder, entry)))
}

/// Endings of masks: those of lossless formats, since others smear a mask's edge.
fn endings() -> impl Iterator<Item = &'static str> {
    ImageFormat::ALL.into_iter().filter(|format| format.is_lossless()).flat_map(|format| format.endings()).copied()
}

/// The mask of `entry` in `folder`: under the photograph's name, folders included, then under its file name alone.
fn in_folder(root: &Path, folder: &Path, entry: &Entry) -> Option<PathBuf> {
    let name = Path::new(&entry.name);
    [Some(name), name.file_name().map(Path::new)]
        .into_iter()
        .flatten()
        .flat_map(|name| endings().map(move |ending| (name, ending)))
        .flat_map(|(name, ending)| {
            let mut behind = name.as_os_str().to_owned();
            behind.push(format!(".{ending}"));
            [PathBuf::from(behind), name.with_extension(ending)]
        })
        .map(|name| folder.join(name))
        .find(|mask| root.join(mask).is_file())
}
