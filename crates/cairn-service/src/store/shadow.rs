//! Reading a data folder that cannot be written: a backup, a read-only disk.
//!
//! Who opens a data folder writes in it: a lock, the store of the log, what is put in order at a start. A *shadow* is a
//! folder for the time of one command. It has links to what is only read and copies of what an owner would write to.
//! The copies are small: state files, job files, and of the log what is in no file of its own yet.
//!
//! A shadow holds a lock in it while its command lives. What a killed command left behind is cleared by the next that
//! the same user makes one with. A command that is killed before it locks leaves its folder, which is empty.

use std::fs::{self, File, OpenOptions};
use std::io::{Error, ErrorKind};
use std::path::Path;
use std::time::Duration;

use cairn_durable::LockFile;
use tempfile::TempDir;

use crate::error::EngineError;
use crate::store::folder::{LOCK, must_be_free};

/// How the names of shadows begin.
const PREFIX: &str = "cairn-reads-";
/// The lock that the command of a shadow holds.
const OWNED: &str = "shadow.lock";
/// A shadow is not taken for left behind before this: its command may be about to lock it.
const IN_THE_MAKING: Duration = Duration::from_secs(60);
/// Folders of the data folder that are linked: they are large, and reading leaves them alone.
const LINKED: [&str; 3] = ["scenes", "models", "registry.key"];
/// What is made anew where it is needed: the owner's lock, its socket, and imports that were cut off.
const LEFT_OUT: [&str; 3] = [LOCK, "socket", "staging"];
/// Folders of the log whose contents are large and only read.
const LINKED_OF_LOG: [&str; 3] = ["public", "envelopes", "runs"];
/// How deep folders are copied: `registry/working/db/*` is the deepest.
const MAX_DEPTH: usize = 5;

/// A shadow. It goes when this is dropped.
#[derive(Debug)]
pub struct Shadow {
    // First, so that nothing of it is there any more when the lock is let go.
    folder: TempDir,
    _owned: LockFile,
}

impl Shadow {
    /// Where it is.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// A shadow of the data folder `data`; `None` where that can be written itself.
///
/// # Errors
/// [`EngineError::Locked`] while another process has the folder, whose state is then not of one moment; the file
/// system's.
pub fn of(data: &Path) -> Result<Option<Shadow>, EngineError> {
    must_be_free(data)?;
    let refused = |e: &Error| matches!(e.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem);
    let lock = data.join(LOCK);
    let probes = [
        // Without a name, so that nothing is seen of it.
        tempfile::tempfile_in(data).map(drop),
        OpenOptions::new().write(true).open(&lock).map(drop),
    ];
    for probe in probes {
        match probe {
            Err(e) if refused(&e) => return make(data, &std::env::temp_dir()).map(Some),
            Err(e) if e.kind() != ErrorKind::NotFound => return Err(EngineError::io("open", &lock)(e)),
            _ => {}
        }
    }
    Ok(None)
}

/// Makes the shadow in the folder `place`, from which those go that were left behind.
fn make(data: &Path, place: &Path) -> Result<Shadow, EngineError> {
    // Links need the whole path.
    let data = data.canonicalize().map_err(EngineError::io("find", data))?;
    let made = tempfile::Builder::new().prefix(PREFIX).tempdir_in(place);
    let folder = made.map_err(EngineError::io("make a folder in", place))?;
    let owned = LockFile::take(&folder.path().join(OWNED))?;
    let shadow = Shadow { folder, _owned: owned };
    clear(place, owner(shadow.path()));
    for entry in fs::read_dir(&data).map_err(EngineError::io("list", &data))? {
        let entry = entry.map_err(EngineError::io("list", &data))?;
        let name = entry.file_name();
        let (from, to) = (entry.path(), shadow.path().join(&name));
        if LEFT_OUT.iter().any(|out| name == *out) {
            continue;
        }
        let done = match LINKED.iter().any(|linked| name == *linked) {
            true => link(&from, &to),
            false => copy(&from, &to, if name == "registry" { &LINKED_OF_LOG } else { &[] }, MAX_DEPTH),
        };
        done.map_err(EngineError::io("copy for reading", &from))?;
    }
    Ok(shadow)
}

/// Removes the shadows of the user `own` in `place` whose commands ended without doing so. What cannot be looked at or
/// removed stays, and another user's is not touched: opening what lies in it may wait for ever.
fn clear(place: &Path, own: Option<u32>) {
    for entry in fs::read_dir(place).into_iter().flatten().flatten() {
        // Links are not followed.
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let is_shadow = is_folder && entry.file_name().as_encoded_bytes().starts_with(PREFIX.as_bytes());
        let path = entry.path();
        if is_shadow && own.is_some() && owner(&path) == own && is_left(&path) {
            let _ = fs::remove_dir_all(path);
        }
    }
}

/// The user whose the folder or file is; `None` where that is not known.
#[cfg(unix)]
fn owner(path: &Path) -> Option<u32> {
    use std::os::unix::fs::MetadataExt as _;
    fs::symlink_metadata(path).ok().map(|there| there.uid())
}

#[cfg(not(unix))]
fn owner(_: &Path) -> Option<u32> {
    None
}

/// Whether nobody holds the lock of the shadow `folder`, and has not for a while. Only a file that can be opened tells.
fn is_left(folder: &Path) -> bool {
    let lock = folder.join(OWNED);
    let Some(there) = fs::symlink_metadata(&lock).ok().filter(fs::Metadata::is_file) else { return false };
    let age = there.modified().ok().and_then(|at| at.elapsed().ok());
    age.is_some_and(|age| age >= IN_THE_MAKING) && File::open(&lock).is_ok() && LockFile::must_be_free(&lock).is_ok()
}

/// Copies a file or a folder, as files that can be written; folders named in `linked` become links, and so do
/// checkpoints and fields of jobs, which are large.
fn copy(from: &Path, to: &Path, linked: &[&str], depth: usize) -> Result<(), Error> {
    if !from.is_dir() {
        // Not `fs::copy`: it would copy that nobody may write.
        return std::io::copy(&mut File::open(from)?, &mut File::create(to)?).map(drop);
    }
    if depth == 0 {
        return Err(Error::other("the folder is deeper than a data folder is"));
    }
    fs::create_dir(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let name = entry.file_name();
        let large = entry.path().extension().is_some_and(|ending| ending == "checkpoint" || ending == "field");
        match large || linked.iter().any(|linked| name == *linked) {
            true => link(&entry.path(), &to.join(name))?,
            false => copy(&entry.path(), &to.join(name), linked, depth - 1)?,
        }
    }
    Ok(())
}

#[cfg(unix)]
fn link(from: &Path, to: &Path) -> Result<(), Error> {
    std::os::unix::fs::symlink(from, to)
}

#[cfg(not(unix))]
fn link(_: &Path, _: &Path) -> Result<(), Error> {
    Err(Error::new(ErrorKind::Unsupported, "a data folder that cannot be written is read on Unix only"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::engine::{Engine, Opening};
    use std::collections::BTreeMap;
    use std::path::PathBuf;

    /// Every file below `folder`, with its bytes.
    fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut found = BTreeMap::new();
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                found.extend(files(&path));
            } else {
                found.insert(path.clone(), fs::read(&path).unwrap());
            }
        }
        found
    }

    #[test]
    fn where_nothing_is_nothing_is_made() {
        let dir = tempfile::tempdir().unwrap();
        let (absent, other) = (dir.path().join("absent"), dir.path().join("other"));
        std::fs::create_dir(&other).unwrap();
        let config = Config::from_toml("", "test").unwrap();
        for path in [&absent, &other] {
            let refused = Engine::open(path, &config, Opening::Read).map(drop).unwrap_err().to_string();
            assert!(refused.contains("there is no data folder") && refused.contains("--data"), "{refused}");
        }
        assert!(!absent.exists() && std::fs::read_dir(&other).unwrap().next().is_none());
    }

    #[test]
    fn a_shadow_reads_as_the_folder_does_and_leaves_every_byte_of_it() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        let config = Config::from_toml("", "test").unwrap();
        let scene = data.join("scenes/town");
        {
            let engine = Engine::open(&data, &config, Opening::Begin).unwrap();
            std::fs::create_dir_all(&scene).unwrap();
            engine.close();
        }
        let before = files(&data);
        let shadow = make(&data, dir.path()).unwrap();
        let copied = shadow.path().to_path_buf();
        let engine = Engine::open_in(&data, &config, Opening::Read, Some(shadow)).unwrap();
        assert_eq!(engine.scene_names().unwrap(), ["town"]);
        assert_eq!(engine.registry().size(), 0);
        engine.close();
        drop(engine);
        assert_eq!(files(&data), before);
        assert!(!copied.exists(), "the shadow is left in {}", copied.display());
    }

    #[test]
    fn what_a_killed_command_left_is_cleared_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        fs::create_dir(&data).unwrap();
        let age = |folder: &Path, seconds| {
            let lock = OpenOptions::new().write(true).open(folder.join(OWNED)).unwrap();
            lock.set_modified(std::time::SystemTime::now() - Duration::from_secs(seconds)).unwrap();
        };
        let left = |name: &str, seconds| {
            let folder = dir.path().join(name);
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join(OWNED), "1").unwrap();
            age(&folder, seconds);
            folder
        };
        let (killed, young, foreign) =
            (left("cairn-reads-killed", 3600), left("cairn-reads-young", 5), left("somebody", 3600));
        let unlocked = dir.path().join("cairn-reads-begun");
        fs::create_dir(&unlocked).unwrap();
        // An old lock that is no file of the folder's own.
        let linked = dir.path().join("cairn-reads-linked");
        fs::create_dir(&linked).unwrap();
        link(&foreign.join(OWNED), &linked.join(OWNED)).unwrap();
        clear(dir.path(), owner(dir.path()).map(|own| own + 1));
        assert!(killed.exists(), "a shadow of another user's is cleared");
        let held = make(&data, dir.path()).unwrap();
        assert!(!killed.exists() && young.exists() && foreign.exists() && unlocked.exists());
        assert!(linked.exists());
        // As old, and its command lives.
        age(held.path(), 3600);
        drop(make(&data, dir.path()).unwrap());
        assert!(held.path().exists());
    }
}
