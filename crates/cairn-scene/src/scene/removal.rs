//! Taking views out of a stored scene for good: photographs that must not lie on the disk any longer.
//!
//! A scene is otherwise never changed. The order of the steps is such that whatever a crash leaves, the same
//! call finishes: the manifest goes first (it would no longer be true), then the table is replaced by one
//! without the views, then their photographs are deleted, and last the manifest is written anew.

use std::collections::HashSet;
use std::fs;
use std::path::Path;

use cairn_durable::{read_limited, remove, sync_folder, write_atomic};

use crate::error::CaptureError;
use crate::scene::folder::SceneFolder;
use crate::scene::manifest::{MANIFEST, write_manifest};
use crate::scene::table::{MASKS, MAX_TABLE_BYTES, PHOTOGRAPHS, SceneFile, TABLE};

impl SceneFolder {
    /// Takes the views with these names out, photographs and all, and opens what is left. Views that are not
    /// there are no error: so it can be called again where it was cut off. Durable on return.
    ///
    /// Nobody else MUST use the scene meanwhile.
    ///
    /// # Errors
    /// [`CaptureError`] where no view to train on would be left (then nothing has changed), and the file system's.
    pub fn without_for_good(&self, names: &[&str]) -> Result<Self, CaptureError> {
        let (folder, file) = (self.folder(), self.folder().join(TABLE));
        let mut table = SceneFile::parse(&file, &read_limited(&file, MAX_TABLE_BYTES)?)?;
        table.views.retain(|row| !names.contains(&row.name.as_str()));
        if table.views.iter().all(|row| row.held_out) {
            let (expected, got) = ("a view left to train on", "none");
            return Err(CaptureError::malformed(&file, "the views", expected, got, "delete the scene instead"));
        }
        remove(&folder.join(MANIFEST))?;
        sync_folder(folder)?;
        let json = serde_json::to_vec_pretty(&table).map_err(|e| CaptureError::io("write", &file)(e.into()))?;
        write_atomic(&file, &json)?;
        let photographs = table.views.iter().map(|row| row.photograph.as_str()).collect();
        keep_only(&folder.join(PHOTOGRAPHS), &photographs)?;
        if folder.join(MASKS).is_dir() {
            let masks = table.views.iter().filter_map(|row| row.mask.as_ref()).map(|mask| mask.file.as_str());
            keep_only(&folder.join(MASKS), &masks.collect())?;
        }
        write_manifest(folder)?;
        sync_folder(folder)?;
        Self::open_at(folder)
    }
}

/// Removes all files from `folder` but those of these names; durable on return.
fn keep_only(folder: &Path, kept: &HashSet<&str>) -> Result<(), CaptureError> {
    for entry in fs::read_dir(folder).map_err(CaptureError::io("list", folder))? {
        let entry = entry.map_err(CaptureError::io("list", folder))?;
        if !entry.file_name().to_str().is_some_and(|name| kept.contains(name)) {
            remove(&entry.path())?;
        }
    }
    Ok(sync_folder(folder)?)
}
