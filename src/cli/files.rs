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

/// Writes a file.
///
/// # Errors
/// As [`must_have_folder`]; the file system's, with the file's name.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    must_have_folder(path)?;
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Refuses a file to be written whose folder is not there: what takes minutes is then not begun.
///
/// # Errors
/// As said, with the command that makes the folder.
pub fn must_have_folder(path: &Path) -> anyhow::Result<()> {
    let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) else { return Ok(()) };
    // One that cannot be looked at is for the writing to find out.
    let is_absent = matches!(folder.try_exists(), Ok(false));
    let (path, folder) = (path.display(), folder.display());
    anyhow::ensure!(!is_absent, "cannot write {path}: there is no folder {folder}; make it with `mkdir -p {folder}`");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_in_no_folder_is_answered_with_the_command_that_makes_it() {
        let dir = tempfile::tempdir().unwrap();
        let absent = dir.path().join("no/folder");
        let refused = write(&absent.join("x.png"), b"").unwrap_err().to_string();
        assert!(refused.ends_with(&format!("`mkdir -p {}`", absent.display())), "{refused}");
        write(&dir.path().join("x.png"), b"there").unwrap();
        assert!(must_have_folder(Path::new("x.png")).is_ok());
    }
}
