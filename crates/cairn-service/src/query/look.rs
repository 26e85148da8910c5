//! Rendering, asking who contributed, and identifying pictures.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use cairn_scene::{Camera, Picture};

use crate::config::Limits;
use crate::engine::Engine;
use crate::error::EngineError;
use crate::query::light::{Light, same_proportions};
use crate::query::maps::Maps;
use crate::store::classes::Found;
use crate::store::model::{Model, ModelInfo};
use crate::store::scenes::check_size;
use crate::store::scenes::view_index;
use crate::train::stages::Appearance;

/// From where to look.
#[derive(Clone, Debug)]
pub enum Viewpoint {
    /// A view of the scene, by name.
    View(String),
    /// Any camera.
    Camera(Camera),
}

/// Which field to render.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldKind {
    /// After stage 1.
    Base,
    /// After stage 2.
    Marked,
}

/// Who it is, and how sure that is, 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Who {
    /// Number and label; `None` for nobody.
    pub identity: Option<(u32, String)>,
    /// Who took the photographs of the identity's cluster and how many each, most first, then by name.
    pub contributors: Vec<(String, usize)>,
    /// Of a picture the answer's probability; of a place 1 in a cluster's middle, 0 on its border.
    pub confidence: f64,
    /// Log indices of the owner records that bear on the identity, rising: see [`Engine::records_of`].
    pub records: Vec<u64>,
}

/// Whose mark a picture carries, and all that was read from it.
#[derive(Clone, Debug)]
pub struct Identified {
    /// Whose it is.
    pub who: Who,
    /// What was read.
    pub found: Found,
}

/// Laying a picture over the field.
#[derive(Clone, Debug)]
pub struct Over {
    /// From where the picture was rendered, where that is known.
    pub from: Option<Viewpoint>,
    /// Says so once nobody waits for the answer any more.
    pub given_up: Arc<AtomicBool>,
}

/// Refuses a picture that `camera` cannot have taken whole, at whatever size.
fn check_whole(picture: &Picture, camera: &Camera) -> Result<(), EngineError> {
    if same_proportions(picture, camera) {
        return Ok(());
    }
    let (across, down) = (camera.intrinsics.width, camera.intrinsics.height);
    let allowed = format!("the proportions of what it was rendered at, {across} x {down} px, or no viewpoint at all");
    Err(EngineError::invalid("the picture", format!("{} x {} px", picture.width(), picture.height()), allowed))
}

/// Decodes a PNG or JPEG under the limits.
///
/// # Errors
/// [`EngineError::OverLimit`] before decoding, and cairn-scene's.
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Picture, EngineError> {
    decode_on(bytes, limits, None)
}

/// As [`decode`], what is transparent in the picture being of `background` (RGB, 0 to 1; `None` is white).
///
/// # Errors
/// As [`decode`].
pub fn decode_on(bytes: &[u8], limits: &Limits, background: Option<[f32; 3]>) -> Result<Picture, EngineError> {
    let got = bytes.len() as u64;
    if got > limits.max_photograph_bytes {
        let (what, key) = ("the picture in bytes".to_owned(), "limits.max_photograph_bytes");
        return Err(EngineError::OverLimit { what, key, limit: limits.max_photograph_bytes, got });
    }
    Ok(cairn_scene::decode_picture(bytes, &limits.of_pictures(), background)?)
}

impl Engine {
    /// The camera of a viewpoint.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] for a view that is not there, [`EngineError::OverLimit`].
    pub fn camera(&self, scene: &str, viewpoint: &Viewpoint) -> Result<Camera, EngineError> {
        self.camera_of("the render", scene, viewpoint)
    }

    /// As [`Engine::camera`]; `what` names what it takes in errors.
    pub(crate) fn camera_of(&self, what: &str, scene: &str, viewpoint: &Viewpoint) -> Result<Camera, EngineError> {
        let camera = match viewpoint {
            Viewpoint::Camera(camera) => *camera,
            Viewpoint::View(name) => {
                let scene = self.scene(scene)?;
                let capture = scene.capture();
                capture.views[view_index(capture, name)?].camera
            }
        };
        check_size(what, camera.intrinsics.width, camera.intrinsics.height, &self.limits)?;
        Ok(camera)
    }

    /// Renders a view, clamped to [0, 1]; with accumulation and depth where `maps` asks for them.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`], [`EngineError::NotFound`], [`EngineError::Invalid`]; in a photograph's light what is
    /// said of [`Light::Photograph`].
    pub fn render(
        &self,
        scene: &str,
        viewpoint: &Viewpoint,
        field: FieldKind,
        light: &Light,
        maps: bool,
    ) -> Result<(Picture, Option<Maps>), EngineError> {
        let model = self.model(scene)?;
        let camera = self.camera(scene, viewpoint)?;
        let appearance = self.appearance(&model, light)?;
        if !maps {
            return Ok((model.look(field, &camera, &appearance)?, None));
        }
        // Where densities are frozen a mark is colour alone, and what lies behind it the base field's.
        let shapes = match field {
            FieldKind::Base => &model.base,
            FieldKind::Marked => model.marked_field()?.theta(),
        };
        let seen = shapes.render_maps(&camera, &appearance);
        let maps = Maps::new(model.base.frame(), &camera, &seen);
        let picture = match field {
            FieldKind::Base => seen.picture.clamped(),
            FieldKind::Marked => model.look(field, &camera, &appearance)?,
        };
        Ok((picture, Some(maps)))
    }

    /// Whose cluster a viewpoint belongs to.
    ///
    /// # Errors
    /// As [`Engine::camera`]; [`EngineError::NotTrained`].
    pub fn contributors(&self, scene: &str, viewpoint: &Viewpoint) -> Result<Who, EngineError> {
        let camera = self.camera(scene, viewpoint)?;
        let Some(info) = self.newest_model(scene)? else {
            self.scene(scene)?;
            return Err(EngineError::NotTrained { scene: scene.to_owned() });
        };
        let out = self.quarantine.out_of(&info)?;
        let found = info.clusters.identity_of_without(&camera.pose, &out);
        // Nobody is credited with a view that is in quarantine, wherever it says that it was taken.
        if let Viewpoint::View(name) = viewpoint
            && self.quarantine.names(scene, &self.scene(scene)?)?.0.contains(name)
        {
            return self.who(&info, None, 1.0);
        }
        // How far from the border, in units of the way from the middle to the border.
        let reach = found.distance + found.margin.abs();
        let confidence = if reach > 0.0 && reach.is_finite() { (found.margin.abs() / reach).min(1.0) } else { 1.0 };
        self.who(&info, found.identity, confidence)
    }

    /// Whose mark a picture carries, as the classifier reads it; or, with `over`, as the field tells it.
    ///
    /// # Errors
    /// For a picture that does not decode, and [`Model::mark`]'s.
    pub fn identify(&self, scene: &str, bytes: &[u8], over: Option<Over>) -> Result<Identified, EngineError> {
        let (model, found) = self.read_picture(scene, bytes, over)?;
        let who = self.who(&model.info, found.identity, found.confidence.into())?;
        Ok(Identified { who, found })
    }

    fn read_picture(&self, scene: &str, bytes: &[u8], over: Option<Over>) -> Result<(Arc<Model>, Found), EngineError> {
        let picture = decode(bytes, &self.limits)?;
        let model = self.model(scene)?;
        let mark = model.mark()?;
        let Some(Over { from, given_up }) = over else {
            let found = mark.detect(&picture)?;
            return Ok((model, found));
        };
        let from = from.map(|viewpoint| self.camera(scene, &viewpoint)).transpose()?;
        if let Some(camera) = &from {
            check_whole(&picture, camera)?;
        }
        let folder = self.scene(scene)?;
        // Where a view in quarantine says that it was taken is what is doubted.
        let out = self.quarantine.names(scene, &folder)?.0;
        let capture = folder.capture();
        let views = || {
            let of = |i: usize| (capture.views[i].camera, capture.views[i].name.clone());
            capture.training().map(of).filter(|(_, name)| !out.contains(name)).collect()
        };
        let found = mark.detect_laid_over(&picture, views, (from.as_ref(), &|| !given_up.load(Ordering::Relaxed)))?;
        Ok((model, found))
    }

    fn who(&self, info: &ModelInfo, identity: Option<u32>, confidence: f64) -> Result<Who, EngineError> {
        let nobody = Who { identity: None, contributors: Vec::new(), confidence, records: Vec::new() };
        let Some(number) = identity else { return Ok(nobody) };
        let known = info.identity(number)?;
        let Some(contributors) = self.quarantine.credited(&info.scene, known)? else { return Ok(nobody) };
        let records = self.records_of(info, known)?;
        Ok(Who { identity: Some((number, known.label.clone())), contributors, confidence, records })
    }
}

impl Model {
    /// What `camera` sees, clamped to [0, 1].
    ///
    /// # Errors
    /// As [`Model::marked_field`].
    pub fn look(&self, field: FieldKind, camera: &Camera, appearance: &Appearance) -> Result<Picture, EngineError> {
        let picture = match field {
            FieldKind::Base => self.base.render(camera, appearance),
            FieldKind::Marked => self.marked_field()?.render(camera, appearance),
        };
        Ok(picture.clamped())
    }
}
