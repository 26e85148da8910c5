//! A scene as questions about it see it, read once: its folder, its newest model's `model.json`, and which of its views
//! are left out. It is good until a new model is published or other views are left out.

use std::collections::BTreeSet;
use std::path::Path;

use cairn_log::Digest;
use cairn_scene::{Camera, Pose, SceneFolder, Unused};

use crate::error::EngineError;
use crate::store::exclusions::{Credited, Entries, Exclusions};
use crate::store::model::{IdentityInfo, ModelInfo};
use crate::store::scenes;

/// A scene, its newest model, and the views that are left out.
pub struct SceneSnapshot {
    /// The scene's name.
    pub name: String,
    /// The scene, with all its views.
    pub scene: SceneFolder,
    /// What the newest model says of itself; `None` before the first.
    pub newest: Option<ModelInfo>,
    /// What was decided about the views, and what was measured of them.
    pub entries: Entries,
    /// Names of views that are excluded.
    out: BTreeSet<String>,
    /// Those of the model's identities, by their index in its clusters.
    pub out_of_clusters: BTreeSet<usize>,
    /// Whose photographs are left of each identity, in the model's order; `None` where all are left out.
    credited: Vec<Option<Credited>>,
    /// [`Exclusions::changes`] before it was read.
    changes: u64,
}

impl SceneSnapshot {
    /// Reads the scene `name` as it is now, whose newest model says `info` of itself.
    ///
    /// # Errors
    /// As [`scenes::open`]; [`EngineError::Stored`] for a damaged file.
    pub fn read(
        scenes: &Path,
        exclusions: &Exclusions,
        name: &str,
        info: Option<ModelInfo>,
    ) -> Result<Self, EngineError> {
        let changes = exclusions.changes();
        let scene = scenes::open(scenes, name)?;
        let entries = exclusions.of(name)?;
        let out = entries.excluded();
        let out_of_clusters = info.as_ref().map(|info| entries.out_of(info)).unwrap_or_default();
        let identities = info.iter().flat_map(|info| &info.identities);
        let credited = identities.map(|identity| entries.credited(identity)).collect();
        Ok(Self { name: name.to_owned(), scene, newest: info, entries, out, out_of_clusters, credited, changes })
    }

    /// Whether it still says what reading the scene `name` again would say.
    pub fn is_current(&self, exclusions: &Exclusions, name: &str, newest: Option<&ModelInfo>) -> bool {
        self.name == name && self.newest.as_ref() == newest && self.changes == exclusions.changes()
    }

    /// What the newest model says of itself.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`].
    pub fn info(&self) -> Result<&ModelInfo, EngineError> {
        self.newest.as_ref().ok_or_else(|| EngineError::NotTrained { scene: self.name.clone() })
    }

    /// Whether the view of the full name `name` is left out.
    pub fn is_out(&self, name: &str) -> bool {
        self.out.contains(name)
    }

    /// Why the view of the full name `name` earns no share: it is excluded, or else held out.
    pub fn unused(&self, name: &str) -> Option<Unused> {
        let held_out = || self.scene.capture().views.iter().any(|view| view.held_out && view.name == name);
        if self.is_out(name) { Some(Unused::Excluded) } else { held_out().then_some(Unused::HeldOut) }
    }

    /// The full name of view `name`, which may lack its folders.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] lists some that there are.
    pub fn full_name(&self, name: &str) -> Result<&str, EngineError> {
        let capture = self.scene.capture();
        Ok(&capture.views[scenes::view_index(capture, name)?].name)
    }

    /// The camera of view `name`.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] lists some that there are.
    pub fn camera_of(&self, name: &str) -> Result<Camera, EngineError> {
        let capture = self.scene.capture();
        Ok(capture.views[scenes::view_index(capture, name)?].camera)
    }

    /// The full name of the first view with this photograph that is not left out.
    pub fn view_of(&self, photograph: &Digest) -> Option<&str> {
        let views = self.scene.capture().views.iter().enumerate();
        let is_of = |i: usize| self.scene.photograph_digest(i) == *photograph.as_bytes();
        views.filter(|(i, view)| is_of(*i) && !self.is_out(&view.name)).map(|(_, view)| view.name.as_str()).next()
    }

    /// SHA-256 of view `name`'s photograph.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] lists some that there are.
    pub fn photograph_of(&self, name: &str) -> Result<Digest, EngineError> {
        let view = scenes::view_index(self.scene.capture(), name)?;
        Ok(Digest::from_bytes(self.scene.photograph_digest(view)))
    }

    /// Poses of the views to train on that are not left out.
    pub fn poses(&self) -> Vec<Pose> {
        let capture = self.scene.capture();
        let training = capture.training().map(|i| &capture.views[i]).filter(|view| !self.is_out(&view.name));
        training.map(|view| view.camera.pose).collect()
    }

    /// Identity `number`, and whose photographs are left of it; `None` where all of them are left out.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`], [`EngineError::NotFound`].
    pub fn identity(&self, number: u32) -> Result<(&IdentityInfo, Option<&Credited>), EngineError> {
        let info = self.info()?;
        let identity = info.identity(number)?;
        let at = info.identities.iter().position(|i| i.number == number);
        Ok((identity, at.and_then(|at| self.credited[at].as_ref())))
    }
}
