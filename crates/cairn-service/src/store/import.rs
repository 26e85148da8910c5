//! Bringing captures in: an import is gathered in the staging folder, checked whole, and becomes a scene at once.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use cairn_log::{Digest, PublicKey};
use cairn_scene::{Capture, LeftOut, SceneFolder, SceneKind, UnusedPhotographs, View};
use glam::DVec3;
use sha2::{Digest as _, Sha256};

use crate::auth::Charge;
use crate::config::Limits;
use crate::error::EngineError;
use crate::store::access::Owned;
use crate::store::scenes::{check_scene_name, check_size};

/// Most points of a scene's surface; they take 24 bytes each.
const MAX_POINTS: usize = 50_000_000;

/// What an import announces before the photographs' bytes.
#[derive(Clone, Debug)]
pub struct ImportPlan {
    /// The new scene's name.
    pub scene: String,
    /// How the scene lies around its cameras.
    pub kind: SceneKind,
    /// What transparent photographs are composited on.
    pub background: Option<[f32; 3]>,
    /// The views, in the order of their photographs' bytes.
    pub views: Vec<PlannedView>,
    /// Photographs that the contributor table names and no view shows.
    pub listed: Vec<UnusedPhotographs>,
}

/// A scene that was imported.
#[derive(Debug)]
pub struct Imported {
    /// It, opened.
    pub scene: SceneFolder,
    /// The contributors who get no share whatever is trained; see [`Capture::without_share`].
    pub without_share: Vec<UnusedPhotographs>,
}

/// A view that is going to be brought.
#[derive(Clone, Debug)]
pub struct PlannedView {
    /// The view; the paths of its files are the import's to choose.
    pub view: View,
    /// The photograph's file.
    pub photograph: PlannedFile,
    /// The mask's file, if it has one.
    pub mask: Option<PlannedFile>,
}

impl PlannedView {
    /// Its files, in the order in which they come.
    fn files(&self) -> impl Iterator<Item = &PlannedFile> {
        std::iter::once(&self.photograph).chain(&self.mask)
    }

    fn bytes(&self) -> u64 {
        self.files().fold(0, |sum, file| sum.saturating_add(file.bytes))
    }
}

/// A file that is going to be brought.
#[derive(Clone, Copy, Debug)]
pub struct PlannedFile {
    /// Its size, bytes.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: [u8; 32],
}

/// An import under way. Dropped before [`Import::finish`], it leaves nothing.
#[derive(Debug)]
pub struct Import {
    plan: ImportPlan,
    points: Vec<DVec3>,
    /// Who is charged with it; charged no longer when dropped.
    pub(crate) owned: Option<Owned>,
    folder: tempfile::TempDir,
    /// The file being written, bytes so far, and their hash.
    current: Option<(File, u64, Sha256)>,
    /// The view whose files come next.
    next: usize,
    /// Whether that view's photograph is whole, so that its mask comes.
    mask_is_next: bool,
}

impl Import {
    /// Checks the plan and makes room for it.
    ///
    /// # Errors
    /// For a plan over the limits, a name that is taken or not allowed, views with
    /// the same name, and the file system's.
    pub fn begin(plan: ImportPlan, limits: &Limits, scenes: &Path, staging: &Path) -> Result<Self, EngineError> {
        check_scene_name(&plan.scene)?;
        let path = scenes.join(&plan.scene);
        if path.exists() {
            return Err(cairn_scene::CaptureError::SceneExists { path }.into());
        }
        check_plan(&plan, limits)?;
        let folder = tempfile::Builder::new()
            .prefix("import-")
            .tempdir_in(staging)
            .map_err(EngineError::io("create a folder in", staging))?;
        Ok(Self { plan, points: Vec::new(), owned: None, folder, current: None, next: 0, mask_is_next: false })
    }

    /// The new scene's name.
    pub fn scene(&self) -> &str {
        &self.plan.scene
    }

    /// What the plan says that photographs and masks take.
    pub fn takes(&self) -> Charge {
        let bytes = self.plan.views.iter().fold(0_u64, |sum, v| sum.saturating_add(v.bytes()));
        Charge { bytes, views: self.plan.views.len() as u64 }
    }

    /// A name like no other import's.
    pub fn id(&self) -> String {
        self.folder.path().file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Takes points of the surface, capture's unit.
    ///
    /// # Errors
    /// For more than `MAX_POINTS`.
    pub fn add_points(&mut self, points: Vec<DVec3>) -> Result<(), EngineError> {
        let count = self.points.len() + points.len();
        if count > MAX_POINTS {
            return Err(EngineError::invalid("the number of points", count, format!("at most {MAX_POINTS}")));
        }
        self.points.extend(points);
        Ok(())
    }

    /// Takes the next bytes of view `index`'s photograph or, where `is_mask`, of its mask, which comes after it.
    ///
    /// # Errors
    /// For bytes out of order, more than announced, or of another SHA-256.
    pub fn write(&mut self, index: usize, is_mask: bool, data: &[u8]) -> Result<(), EngineError> {
        let Some(view) = self.plan.views.get(self.next).filter(|_| index == self.next) else {
            let expected = format!("view {} of {}, in the header's order", self.next, self.plan.views.len());
            return Err(EngineError::invalid("the chunk's view_index", index, expected));
        };
        let planned = match (&view.mask, self.mask_is_next) {
            _ if is_mask != self.mask_is_next => {
                let expected = if self.mask_is_next { "its mask's" } else { "its photograph's" };
                let got = if is_mask { "its mask's" } else { "its photograph's" };
                return Err(EngineError::invalid(format!("the chunk's bytes for {}", view.view.name), got, expected));
            }
            (Some(mask), true) => *mask,
            _ => view.photograph,
        };
        let what = format!("the {} of {}", if is_mask { "mask" } else { "photograph" }, view.view.name);
        let path = file_path(self.folder.path(), index, is_mask);
        if self.current.is_none() {
            let file = File::create_new(&path).map_err(EngineError::io("create", &path))?;
            self.current = Some((file, 0, Sha256::new()));
        }
        let Some((file, written, hash)) = self.current.as_mut() else { return Ok(()) };
        *written += data.len() as u64;
        if *written > planned.bytes {
            let expected = format!("{} bytes, as the header says", planned.bytes);
            return Err(EngineError::invalid(what, "longer", expected));
        }
        file.write_all(data).map_err(EngineError::io("write", &path))?;
        hash.update(data);
        if *written == planned.bytes {
            let got: [u8; 32] = std::mem::take(hash).finalize().into();
            if got != planned.sha256 {
                let expected = format!("SHA-256 {}, as the header says", Digest::from_bytes(planned.sha256));
                let got = format!("of SHA-256 {}", Digest::from_bytes(got));
                return Err(EngineError::invalid(what, got, expected));
            }
            self.current = None;
            self.mask_is_next = !is_mask && view.mask.is_some();
            self.next += usize::from(!self.mask_is_next);
        }
        Ok(())
    }

    /// Decodes every photograph, stores the scene durably and opens it. Blocks.
    ///
    /// # Errors
    /// For missing bytes, a photograph that does not decode or has another size
    /// than its camera, and the file system's.
    pub fn finish(self, scenes: &Path) -> Result<Imported, EngineError> {
        if self.next < self.plan.views.len() {
            let expected = format!("{} views, whole", self.plan.views.len());
            return Err(EngineError::invalid("the import", format!("{} whole views", self.next), expected));
        }
        let placed = |(index, planned): (usize, PlannedView)| {
            let mut view = planned.view;
            view.photograph = file_path(Path::new(""), index, false);
            view.mask = planned.mask.map(|_| file_path(Path::new(""), index, true));
            view
        };
        let mut views: Vec<View> = self.plan.views.into_iter().enumerate().map(placed).collect();
        // A capture's views are sorted by name: who sent them in another order gets the same scene.
        views.sort_by(|a, b| a.name.cmp(&b.name));
        let capture = Capture {
            left_out: LeftOut { listed: self.plan.listed, ..LeftOut::default() },
            root: self.folder.path().to_path_buf(),
            kind: self.plan.kind,
            background: self.plan.background,
            views,
            points: self.points,
        };
        Imported::store(scenes, &self.plan.scene, &capture)
    }
}

impl Imported {
    /// Stores `capture` as the scene `name`.
    ///
    /// # Errors
    /// As [`SceneFolder::create`].
    pub(crate) fn store(scenes: &Path, name: &str, capture: &Capture) -> Result<Self, EngineError> {
        let scene = SceneFolder::create(scenes, name, capture)?;
        Ok(Self { scene, without_share: capture.without_share() })
    }
}

/// Refuses what is no public key in a view's table of contributors, and two keys for one contributor.
///
/// # Errors
/// [`EngineError::Invalid`] naming the contributor.
pub(crate) fn check_keys<'a>(views: impl Iterator<Item = &'a View>) -> Result<(), EngineError> {
    let mut keys: BTreeMap<&str, Option<[u8; 32]>> = BTreeMap::new();
    for view in views {
        let (name, key) = (view.contributor.as_str(), view.contributor_key);
        let what = || format!("the key of contributor {name:?}");
        match keys.insert(name, key) {
            Some(known) if known != key => {
                let said =
                    |key: Option<[u8; 32]>| key.map_or("none".to_owned(), |key| Digest::from_bytes(key).to_string());
                let got = format!("{} and {}", said(known), said(key));
                return Err(EngineError::invalid(what(), got, "one key, the same in all their views"));
            }
            Some(_) => {}
            None => {
                let checked = key.as_ref().map(PublicKey::from_bytes).transpose();
                checked.map_err(|e| EngineError::invalid(what(), e, "an Ed25519 public key"))?;
            }
        }
    }
    Ok(())
}

fn file_path(folder: &Path, index: usize, is_mask: bool) -> PathBuf {
    folder.join(format!("{index:06}.{}", if is_mask { "mask" } else { "photograph" }))
}

fn check_plan(plan: &ImportPlan, limits: &Limits) -> Result<(), EngineError> {
    let count = plan.views.len();
    if count < 1 {
        return Err(EngineError::invalid("the number of views", count, "1 or more"));
    }
    EngineError::within("the number of views", "limits.max_views", limits.max_views as u64, count as u64)?;
    if plan.views.iter().all(|v| v.view.held_out) {
        return Err(EngineError::invalid("the split", "all views held out", "at least one view to train on"));
    }
    let (what, rows) = ("the number of photographs that no view shows", plan.listed.len() as u64);
    EngineError::within(what, "limits.max_views", limits.max_views as u64, rows)?;
    let mut names: Vec<&str> = plan.views.iter().map(|v| v.view.name.as_str()).collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(EngineError::invalid("the views' names", format!("{:?} twice", twice[0]), "distinct names"));
    }
    check_keys(plan.views.iter().map(|planned| &planned.view))?;
    let mut total = 0u64;
    for view in &plan.views {
        let (name, i) = (&view.view.name, &view.view.camera.intrinsics);
        check_size(&format!("view {name}"), i.width, i.height, limits)?;
        if view.photograph.bytes == 0 {
            return Err(EngineError::invalid(format!("the photograph of {name}"), "0 bytes", "1 byte or more"));
        }
        for (what, file) in ["photograph", "mask"].into_iter().zip(view.files()) {
            let what = format!("the {what} of {name} in bytes");
            EngineError::within(what, "limits.max_photograph_bytes", limits.max_photograph_bytes, file.bytes)?;
        }
        total = total.saturating_add(view.bytes());
    }
    EngineError::within("the bytes of photographs and masks", "limits.max_scene_bytes", limits.max_scene_bytes, total)
}
