//! The photograph that a camera file names, however it spells the name.
//!
//! Camera files travel between systems: they leave endings away, write `\`
//! between folders, and compose accents (NFC) where the disk has them apart
//! (NFD). A file of just that name always comes first.

use std::path::{Component, Path, PathBuf};

use unicode_normalization::UnicodeNormalization;

use crate::images::format::ImageFormat;

/// Endings that camera files leave away: those of photographs in small letters, then in capital ones.
pub(crate) fn left_away() -> Vec<String> {
    let small: Vec<String> = ImageFormat::ALL.iter().flat_map(|f| f.endings()).map(|e| format!(".{e}")).collect();
    let capital: Vec<String> = small.iter().map(|ending| ending.to_uppercase()).collect();
    [small, capital].concat()
}

/// The file below `root` that `path` means, relative to `root` as `path` is: as it
/// is named, or with one of `endings`; then with `\` for a separator; then of
/// another Unicode normalisation. `None` where there is none.
pub(crate) fn find(root: &Path, path: &Path, endings: &[String]) -> Option<PathBuf> {
    let spelled: Vec<PathBuf> = std::iter::once(path.to_path_buf()).chain(with_slashes(path)).collect();
    let candidates = || {
        spelled.iter().flat_map(|path| {
            std::iter::once("").chain(endings.iter().map(String::as_str)).map(|ending| {
                let mut name = path.clone().into_os_string();
                name.push(ending);
                PathBuf::from(name)
            })
        })
    };
    candidates().find(|c| root.join(c).is_file()).or_else(|| candidates().find_map(|c| of_other_form(root, &c)))
}

/// `path` with `/` for `\`, unless it then climbs out of a folder.
fn with_slashes(path: &Path) -> Option<PathBuf> {
    let text = path.to_str().filter(|text| text.contains('\\'))?;
    let spelled = text.replace('\\', "/");
    // `./` goes, so that one photograph has one name.
    let spelled: PathBuf = Path::new(&spelled).components().filter(|part| *part != Component::CurDir).collect();
    let climbs = |path: &Path| path.components().filter(|part| *part == Component::ParentDir).count();
    (climbs(&spelled) == climbs(path)).then_some(spelled)
}

/// The file below `root` whose folders and name are those of `path` in another Unicode normalisation.
fn of_other_form(root: &Path, path: &Path) -> Option<PathBuf> {
    // Names of ASCII have one form only, and most names are: no folder is listed for them.
    if path.to_str()?.is_ascii() {
        return None;
    }
    let mut found = PathBuf::new();
    for part in path.components() {
        let as_named = found.join(part);
        if root.join(&as_named).exists() {
            found = as_named;
            continue;
        }
        let wanted = composed(part.as_os_str().to_str()?);
        let mut names = std::fs::read_dir(root.join(&found)).ok()?.flatten().map(|entry| entry.file_name());
        found.push(names.find(|name| name.to_str().is_some_and(|name| composed(name) == wanted))?);
    }
    root.join(&found).is_file().then_some(found)
}

/// `text` in normalisation form C.
pub(crate) fn composed(text: &str) -> String {
    text.nfc().collect()
}

/// How a camera file's `path` is compared with another of its own: `/` between folders, no `./` at the start.
pub(crate) fn plain(path: &str) -> String {
    path.replace('\\', "/").trim_start_matches("./").to_owned()
}
