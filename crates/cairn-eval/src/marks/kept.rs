//! Renders of base fields that are kept in a folder, so that they are rendered once and not for each training's
//! judgement: theta_0 never changes. A render belongs to the program, the field and the camera and light it was made with.

use std::fs::{File, create_dir_all, read_dir, remove_dir_all};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_log::Digest;
use cairn_mark::PlannedView;
use cairn_scene::{Limits, Picture, decode_picture, save_png};

/// The folder within `all` for renders that this program makes. Those of others are deleted, so that `all` does not grow with
/// every build.
///
/// # Errors
/// For a program that does not read, and folders that cannot be listed or deleted.
pub fn of_this_program(all: &Path) -> anyhow::Result<PathBuf> {
    let program = std::env::current_exe().context("where is this program?")?;
    let own = all.join(digest_of(&program)?);
    if all.is_dir() {
        let listed = read_dir(all).with_context(|| format!("cannot list {}", all.display()))?;
        let folders = listed.filter_map(Result::ok).map(|entry| entry.path());
        for other in folders.filter(|path| path.is_dir() && *path != own) {
            eprintln!("deleting {}: another build's renders", other.display());
            remove_dir_all(&other).with_context(|| format!("cannot delete {}", other.display()))?;
        }
    }
    Ok(own)
}

/// A field's renders.
pub struct Kept {
    folder: PathBuf,
}

impl Kept {
    /// Those of the field in the file `field`, in a folder of their own within `all`.
    ///
    /// # Errors
    /// For a file that does not read, and a folder that cannot be made.
    pub fn new(field: &Path, all: &Path) -> anyhow::Result<Self> {
        let folder = all.join(digest_of(field)?);
        create_dir_all(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        Ok(Self { folder })
    }

    /// The render from `view`, as files hold it; what is not there, or does not decode, is made by `render`.
    ///
    /// # Errors
    /// As `render`, and for a folder that cannot be written.
    pub fn picture(
        &self,
        view: &PlannedView,
        render: impl FnOnce() -> anyhow::Result<Picture>,
    ) -> anyhow::Result<Picture> {
        let file = self.folder.join(format!("{}.png", short(&Digest::of(format!("{view:?}")))));
        let there = std::fs::read(&file).ok().and_then(|png| decode_picture(&png, &Limits::default(), None).ok());
        if let Some(kept) = there {
            return Ok(kept);
        }
        let made = render()?;
        save_png(&file, &made)?;
        Ok(made)
    }
}

/// SHA-256 of a file, read piece by piece: a large capture's field takes gigabytes.
fn digest_of(path: &Path) -> anyhow::Result<String> {
    let digest = File::open(path).and_then(|mut file| Digest::of_all(&mut file));
    Ok(short(&digest.with_context(|| format!("cannot read {}", path.display()))?.0))
}

/// Half of a digest, as a name.
fn short(digest: &Digest) -> String {
    digest.as_bytes().iter().take(16).map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_field::Appearance;
    use cairn_scene::{Camera, Distortion, Intrinsics, Pose};
    use cairn_service::query::evaluate::eight_bits;
    use glam::DVec3;

    #[test]
    fn a_render_is_made_once_for_each_field_camera_and_light() {
        let place = tempfile::tempdir().unwrap();
        let [one, other] = ["one.field", "other.field"].map(|name| place.path().join(name));
        std::fs::write(&one, "a field").unwrap();
        std::fs::write(&other, "another").unwrap();
        let all = place.path().join("unmarked");
        let view = |x: f64, light: f32| {
            let distortion = Distortion::default();
            let intrinsics = Intrinsics { width: 5, height: 3, fx: 8.0, fy: 8.0, cx: 2.5, cy: 1.5, distortion };
            let pose = Pose::look_at(DVec3::new(x, 0.0, 0.5), DVec3::ZERO, DVec3::Z).unwrap();
            PlannedView { camera: Camera { intrinsics, pose }, appearance: Appearance::neutral([light; 3]) }
        };
        let picture = |seed: usize| {
            let rgb = (0..45).map(|i| ((i * 37 + seed * 11) % 256) as f32 / 255.0 + 1e-3).collect();
            eight_bits(&Picture::new(5, 3, rgb).unwrap()).unwrap()
        };
        let kept = Kept::new(&one, &all).unwrap();
        let made = |kept: &Kept, view: &PlannedView, seed| kept.picture(view, || Ok(picture(seed))).unwrap();
        let again = |view: &PlannedView| Kept::new(&one, &all).unwrap().picture(view, || panic!("made again")).unwrap();
        assert_eq!(made(&kept, &view(3.0, 0.0), 1), picture(1));
        assert_eq!(again(&view(3.0, 0.0)), picture(1), "the same numbers, bit by bit");
        assert_eq!(made(&kept, &view(3.5, 0.0), 2), picture(2), "another camera");
        assert_eq!(made(&kept, &view(3.0, 0.5), 3), picture(3), "another light");
        assert_eq!(made(&Kept::new(&other, &all).unwrap(), &view(3.0, 0.0), 4), picture(4), "another field");
        assert_eq!(again(&view(3.0, 0.0)), picture(1));
        for file in read_dir(&kept.folder).unwrap() {
            std::fs::write(file.unwrap().path(), "no picture").unwrap();
        }
        assert_eq!(made(&kept, &view(3.0, 0.0), 5), picture(5), "what does not decode is made again");
    }

    #[test]
    fn other_builds_renders_are_deleted() {
        let place = tempfile::tempdir().unwrap();
        let first = of_this_program(place.path()).unwrap();
        create_dir_all(&first).unwrap();
        create_dir_all(place.path().join("0123/4567")).unwrap();
        assert_eq!(of_this_program(place.path()).unwrap(), first);
        let left: Vec<PathBuf> = read_dir(place.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(left, [first]);
    }
}
