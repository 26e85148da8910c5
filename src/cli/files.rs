//! Files that commands read and write, named where that fails.

use std::path::Path;

use anyhow::Context as _;

/// Reads a file.
///
/// # Errors
/// The file system's, with the file's name.
pub fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Reads the picture that `command` is given after a scene.
///
/// # Errors
/// For the two in the wrong order, and as [`read`].
pub fn read_picture(command: &str, scene: &str, picture: &Path) -> anyhow::Result<Vec<u8>> {
    let swapped = !picture.is_file() && Path::new(scene).is_file();
    anyhow::ensure!(!swapped, "the scene comes first: cairn {command} {} {scene}", picture.display());
    read(picture)
}

/// Writes a file, and makes the folders above it that are not there.
///
/// # Errors
/// The file system's, with the file's or the folder's name.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    make_folder_of(path)?;
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Makes the folders above a file that are not there.
///
/// # Errors
/// The file system's, with the folder's name.
pub fn make_folder_of(path: &Path) -> anyhow::Result<()> {
    let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) else { return Ok(()) };
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_files_folders_are_made_or_the_one_that_cannot_be_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("new/folder/x.png");
        write(&file, b"there").unwrap();
        assert_eq!(read(&file).unwrap(), b"there");
        let refused = write(&file.join("y.png"), b"").unwrap_err().to_string();
        assert_eq!(refused, format!("cannot make the folder {}", file.display()));
        assert!(make_folder_of(Path::new("x.png")).is_ok());
    }
}
