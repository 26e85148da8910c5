//! From where a scene is looked at, through which field, and pictures that come in.

use cairn_field::Appearance;
use cairn_scene::{Camera, Picture};

use crate::config::Limits;
use crate::error::EngineError;
use crate::store::model::Model;
use crate::store::scenes::check_size;
use crate::store::snapshot::SceneSnapshot;

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

/// Decodes a picture of any [`cairn_scene::ImageFormat`] under the limits.
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
    let (key, most) = ("limits.max_photograph_bytes", limits.max_photograph_bytes);
    EngineError::within("the picture in bytes", key, most, bytes.len() as u64)?;
    Ok(cairn_scene::decode_picture(bytes, &limits.of_pictures(), background)?)
}

/// Whether `camera` can have taken the picture whole, at whatever size.
pub(crate) fn same_proportions(picture: &Picture, camera: &Camera) -> bool {
    let (w, h) = (picture.width() as f64, picture.height() as f64);
    let (across, down) = (camera.intrinsics.width as f64, camera.intrinsics.height as f64);
    // A side may have been rounded.
    (w * down / across - h).abs() <= 1.0 || (h * across / down - w).abs() <= 1.0
}

/// Refuses `what`, a picture that `camera`, which is called `of`, cannot have taken whole, at
/// whatever size; `remedy` ends what is allowed.
pub(crate) fn must_be_whole(
    what: &str,
    picture: &Picture,
    camera: &Camera,
    of: &str,
    remedy: &str,
) -> Result<(), EngineError> {
    if same_proportions(picture, camera) {
        return Ok(());
    }
    let (across, down) = (camera.intrinsics.width, camera.intrinsics.height);
    let got = format!("{} x {} px", picture.width(), picture.height());
    Err(EngineError::invalid(what, got, format!("the proportions of {of}, {across} x {down} px, {remedy}")))
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

/// The camera of a viewpoint; `what` names in errors what it takes.
///
/// # Errors
/// [`EngineError::NotFound`] for a view that is not there, [`EngineError::OverLimit`].
pub fn camera_of(
    what: &str,
    snapshot: &SceneSnapshot,
    viewpoint: &Viewpoint,
    limits: &Limits,
) -> Result<Camera, EngineError> {
    let camera = match viewpoint {
        Viewpoint::Camera(camera) => *camera,
        Viewpoint::View(name) => snapshot.camera_of(name)?,
    };
    check_size(what, camera.intrinsics.width, camera.intrinsics.height, limits)?;
    Ok(camera)
}
