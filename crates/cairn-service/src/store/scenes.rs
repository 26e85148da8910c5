//! Scenes as they lie in the data folder: listing and opening them.

use std::path::Path;

use cairn_scene::{Capture, SceneFolder};

use crate::config::Limits;
use crate::error::EngineError;

/// Refuses what cannot be a scene's name (and could leave the folder).
///
/// # Errors
/// [`EngineError::Invalid`] with the name and what a name may be.
pub fn check_scene_name(name: &str) -> Result<(), EngineError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if name.is_empty() || name.len() > 64 || name.starts_with(['.', '-']) || !name.chars().all(allowed) {
        let shown: String = name.chars().take(80).collect();
        let expected = "1 to 64 of a-z, A-Z, 0-9, '-', '_', '.', not starting with '-' or '.'";
        return Err(EngineError::invalid("the scene's name", format!("{shown:?}"), expected));
    }
    Ok(())
}

/// Refuses a picture or a camera that is larger than the settings allow.
///
/// # Errors
/// [`EngineError::OverLimit`] with the size and the limit.
pub fn check_size(what: &str, width: usize, height: usize, limits: &Limits) -> Result<(), EngineError> {
    let side = width.max(height) as u64;
    let what_side = format!("the longest side of {what} in px");
    EngineError::within(what_side, "limits.max_side_px", limits.max_side_px as u64, side)?;
    let pixels = (width as u64).saturating_mul(height as u64);
    EngineError::within(format!("the number of pixels of {what}"), "limits.max_pixels", limits.max_pixels, pixels)
}

/// Names of the scenes in `folder`, sorted.
///
/// # Errors
/// The file system's.
pub fn list(folder: &Path) -> Result<Vec<String>, EngineError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(EngineError::io("list", folder))? {
        let entry = entry.map_err(EngineError::io("list", folder))?;
        if let Ok(name) = entry.file_name().into_string()
            && check_scene_name(&name).is_ok()
            && entry.path().is_dir()
        {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}

/// Opens scene `name`.
///
/// # Errors
/// [`EngineError::NotFound`] listing some that there are, and cairn-scene's.
pub fn open(folder: &Path, name: &str) -> Result<SceneFolder, EngineError> {
    check_scene_name(name)?;
    if !folder.join(name).is_dir() {
        let there = list(folder)?;
        return Err(EngineError::misnamed("scene", name, there.iter().map(String::as_str)));
    }
    Ok(SceneFolder::open(folder, name)?)
}

/// Index of view `name`, which may stand without its folders where one view alone ends in it.
///
/// # Errors
/// [`EngineError::NotFound`] listing some that there are, or those that it may mean.
pub fn view_index(capture: &Capture, name: &str) -> Result<usize, EngineError> {
    let names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    place_of(&names, name)
}

/// Where `name` stands among `names`, as [`view_index`] looks for it.
fn place_of(names: &[&str], name: &str) -> Result<usize, EngineError> {
    if let Some(index) = names.iter().position(|known| *known == name) {
        return Ok(index);
    }
    let ends_in_it = |known: &str| known.strip_suffix(name).is_some_and(|folders| folders.ends_with('/'));
    let meant: Vec<usize> = (0..names.len()).filter(|index| !name.is_empty() && ends_in_it(names[*index])).collect();
    match meant[..] {
        [index] => Ok(index),
        [] => Err(EngineError::misnamed("view", name, names.iter().copied())),
        _ => Err(EngineError::misnamed("single view", name, meant.iter().map(|index| names[*index]))),
    }
}

#[cfg(test)]
mod tests {
    use super::place_of;

    #[test]
    fn a_view_is_found_without_its_folders_where_it_is_the_only_one() {
        let names = ["a/1.jpg", "a/b/1.jpg", "b/2.jpg", "12.jpg", "2.jpg"];
        let at = |name| place_of(&names, name).map_err(|e| e.to_string());
        assert_eq!((at("a/1.jpg"), at("b/1.jpg"), at("12.jpg")), (Ok(0), Ok(1), Ok(3)));
        // A whole name goes first.
        assert_eq!(at("2.jpg"), Ok(4));
        let refused = at("1.jpg").unwrap_err();
        assert!(refused.contains("no single view \"1.jpg\"; there is: a/1.jpg, a/b/1.jpg"), "{refused}");
        for absent in ["", ".jpg", "3.jpg", "/2.jpg"] {
            assert!(at(absent).unwrap_err().contains("no view"), "{absent}");
        }
    }
}
