//! Taking views out of a stored scene for good: photographs that must not lie on the disk any longer.
//!
//! A scene is otherwise never changed. The order of the steps is such that whatever a crash leaves, the same
//! call finishes: the manifest goes first (it would no longer be true), then the table is replaced by one
//! without the views, then their photographs are deleted, and last the manifest is written anew.

use std::collections::HashSet;
use std::fs;

use crate::error::CaptureError;
use crate::manifest::{MANIFEST, write_manifest};
use crate::photograph::{read_limited, write_synced};
use crate::scene::{MAX_TABLE_BYTES, SceneFolder, TABLE, sync_folder};
use crate::scene_file::{PHOTOGRAPHS, SceneFile};

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
        match fs::remove_file(folder.join(MANIFEST)) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(CaptureError::io("remove", &folder.join(MANIFEST))(e));
            }
            _ => sync_folder(folder)?,
        }
        let new = folder.join(format!("{TABLE}.new"));
        let json = serde_json::to_vec_pretty(&table).map_err(|e| CaptureError::io("write", &file)(e.into()))?;
        write_synced(&new, &json)?;
        fs::rename(&new, &file).map_err(CaptureError::io("replace", &file))?;
        sync_folder(folder)?;
        let kept: HashSet<&str> = table.views.iter().map(|row| row.photograph.as_str()).collect();
        let photographs = folder.join(PHOTOGRAPHS);
        for entry in fs::read_dir(&photographs).map_err(CaptureError::io("list", &photographs))? {
            let entry = entry.map_err(CaptureError::io("list", &photographs))?;
            if !entry.file_name().to_str().is_some_and(|name| kept.contains(name)) {
                fs::remove_file(entry.path()).map_err(CaptureError::io("remove", &entry.path()))?;
            }
        }
        sync_folder(&photographs)?;
        write_manifest(folder)?;
        sync_folder(folder)?;
        Self::open_at(folder)
    }
}
