//! In whose light a scene is rendered: a view's, one on the way from one view's to another's, or that of a
//! photograph that somebody brings.

use cairn_field::Appearance;
use cairn_scene::{Camera, Picture};

use crate::config::Limits;
use crate::error::EngineError;
use crate::query::viewpoint::{Viewpoint, camera_of, decode_on, must_be_whole};
use crate::store::model::Model;
use crate::store::scenes::view_index;
use crate::store::snapshot::SceneSnapshot;

/// A photograph is compared with the field at this length at most, px: a light is some sixty numbers, which more pixels
/// would not tell better.
const LONGEST_PX: usize = 800;

/// In whose light.
#[derive(Clone, Debug)]
pub enum Light {
    /// The mean of the training views'.
    Neutral,
    /// A view's: of a training view as it was trained, of another as it is fitted to its photograph.
    View(String),
    /// Between two views': share 0 is the first, 1 the second, nothing beyond.
    Blend(String, String, f64),
    /// That of a photograph, a file of any [`cairn_scene::ImageFormat`], which a camera took whole.
    /// [`EngineError::WrongState`] for a scene of one light, [`EngineError::OverLimit`] and cairn-scene's errors for what
    /// is no picture or too large, [`EngineError::Invalid`] for one of other proportions than the camera's,
    /// [`EngineError::NotFound`] for a view that is not there.
    Photograph(Vec<u8>, Viewpoint),
}

/// The appearance that `light` asks for.
///
/// # Errors
/// [`EngineError::NotFound`] for a view that is not there; [`Light::Photograph`]'s.
pub fn appearance(
    model: &Model,
    snapshot: &SceneSnapshot,
    light: &Light,
    limits: &Limits,
) -> Result<Appearance, EngineError> {
    match light {
        Light::Neutral => Ok(model.base.canonical_appearance().clone()),
        Light::View(name) => of_view(model, snapshot, name),
        Light::Blend(from, to, share) => {
            let (from, to) = (of_view(model, snapshot, from)?, of_view(model, snapshot, to)?);
            Ok(from.mixed(&to, *share as f32))
        }
        Light::Photograph(bytes, taken) => of_photograph(model, snapshot, bytes, taken, limits),
    }
}

/// The appearance of a view: a training view has one, and that of another is fitted to its photograph. In scenes of one
/// light every view has the same.
fn of_view(model: &Model, snapshot: &SceneSnapshot, name: &str) -> Result<Appearance, EngineError> {
    let index = view_index(snapshot.scene.capture(), name)?;
    let known = model.base.appearances();
    if known.is_empty() {
        return Ok(model.base.canonical_appearance().clone());
    }
    let view = &snapshot.scene.capture().views[index];
    match known.iter().find(|(known, _)| *known == view.name) {
        Some((_, appearance)) => Ok(appearance.clone()),
        None => fitted(model, &snapshot.scene.photograph(index)?, &view.camera),
    }
}

/// Fits an appearance to a whole photograph.
fn of_photograph(
    model: &Model,
    snapshot: &SceneSnapshot,
    bytes: &[u8],
    taken: &Viewpoint,
    limits: &Limits,
) -> Result<Appearance, EngineError> {
    let scene = &model.info.scene;
    if model.base.appearances().is_empty() {
        let why = "its field was trained as of one light, and knows no other; render it without, or train it on \
                   photographs in several lights (with --appearance on where `auto` did not find that out)";
        return Err(EngineError::wrong_state(format!("scene {scene:?}"), "rendered in a photograph's light", why));
    }
    let background = snapshot.scene.capture().background;
    let photograph = decode_on(bytes, limits, background)?;
    let camera = camera_of("the photograph's camera", snapshot, taken, limits)?;
    let (of, remedy) = ("the camera that took it", "neither cut nor turned");
    must_be_whole("the photograph", &photograph, &camera, of, remedy)?;
    fitted(model, &photograph, &camera)
}

/// The appearance in which the field looks most like `photograph`, which `camera` took.
fn fitted(model: &Model, photograph: &Picture, camera: &Camera) -> Result<Appearance, EngineError> {
    let (width, height) = compared_at(photograph, camera);
    Ok(model.base.fit_appearance(&camera.resized(width, height), &photograph.resized(width, height))?)
}

/// Width and height, px: the photograph's or the camera's, whichever is smaller, and [`LONGEST_PX`] at most.
fn compared_at(photograph: &Picture, camera: &Camera) -> (usize, usize) {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let longest = width.max(height);
    let to = longest.min(photograph.width().max(photograph.height())).min(LONGEST_PX);
    let side = |px: usize| ((px * to) as f64 / longest as f64).round().max(1.0) as usize;
    (side(width), side(height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::viewpoint::same_proportions;
    use cairn_scene::{Distortion, Intrinsics, Pose};
    use glam::DVec3;

    fn camera(width: usize, height: usize) -> Camera {
        let distortion = Distortion::default();
        let intrinsics = Intrinsics { width, height, fx: 90.0, fy: 90.0, cx: 4.0, cy: 3.0, distortion };
        Camera { intrinsics, pose: Pose::look_at(DVec3::X, DVec3::ZERO, DVec3::Z).unwrap() }
    }

    #[test]
    fn a_photograph_is_compared_at_the_smaller_size_and_not_at_any() {
        let at = |photograph: (usize, usize), taken: (usize, usize)| {
            compared_at(&Picture::constant(photograph.0, photograph.1, [0.5; 3]), &camera(taken.0, taken.1))
        };
        assert_eq!(at((200, 300), (200, 300)), (200, 300));
        assert_eq!(at((400, 600), (200, 300)), (200, 300));
        assert_eq!(at((100, 150), (200, 300)), (100, 150));
        assert_eq!(at((1600, 1000), (3200, 2000)), (800, 500));
        assert_eq!(at((2000, 1), (4000, 2)), (800, 1));
    }

    #[test]
    fn a_side_that_was_rounded_is_no_other_proportion() {
        let fits = |w, h| same_proportions(&Picture::constant(w, h, [0.5; 3]), &camera(300, 200));
        assert!(fits(300, 200) && fits(150, 100) && fits(151, 101) && fits(601, 400));
        assert!(!fits(200, 300) && !fits(150, 110) && !fits(300, 204));
    }
}
