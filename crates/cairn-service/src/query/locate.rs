//! Where a picture was taken: the camera from which a scene's field looks like it.

use cairn_register::{Located, NotLocated, Registrar};
use cairn_scene::{Camera, Picture, Pose};
use glam::{DVec2, DVec3};

use crate::error::EngineError;
use crate::query::crowd;
use crate::store::model::Model;
use crate::store::snapshot::SceneSnapshot;

/// Upright is not told where the camera looks up or down along it: less of it shows in the picture, as a share.
const MIN_UPRIGHT: f64 = 0.05;

/// The camera of a picture.
#[derive(Clone, Debug)]
pub struct FoundCamera {
    /// The camera, of the picture's own size.
    pub camera: Camera,
    /// How far the picture is turned clockwise, degrees in (-180, 180], against how the scene's photographs stand upright;
    /// `None` where these agree on no upright, or the camera looks along it.
    pub turned_deg: Option<f64>,
    /// Standard deviation of where the camera has what the picture shows, the median over places, px of the picture;
    /// infinite where nothing tells.
    pub uncertainty_px: f64,
    /// Share of the picture's variance that the field explains from there, above 0, 1 at most.
    pub explained: f64,
    /// Keypoints that agree on the camera.
    pub agreeing: usize,
    /// What was compared in the end, where that was asked for.
    pub compared: Option<Compared>,
}

/// A picture beside what the base field shows from its camera, in its light; of one size, [`cairn_register::LONGEST_PX`]
/// long at most.
#[derive(Clone, Debug)]
pub struct Compared {
    /// The picture.
    pub picture: Picture,
    /// The render, clamped to [0, 1].
    pub render: Picture,
}

/// The camera of `picture`, or why none was found; the search is given up once it is no longer `wanted`. With what was
/// `compared` where that is asked for.
///
/// # Errors
/// As [`Model::places`].
pub fn locate(
    model: &Model,
    snapshot: &SceneSnapshot,
    picture: &Picture,
    compared: bool,
    wanted: &dyn Fn() -> bool,
) -> Result<Result<FoundCamera, NotLocated>, EngineError> {
    let registrar = Registrar::new(model.base.clone(), Some(model.places()?));
    Ok(registrar.locate(picture, wanted).map(|found| {
        let Located { registered, uncertainty_px, places, .. } = found;
        let (small, explained) = (registered.camera, registered.explained);
        let larger = picture.width() as f64 / small.intrinsics.width as f64;
        let render = || model.base.render(&small, &registered.appearance).clamped();
        FoundCamera {
            camera: small.resized(picture.width(), picture.height()),
            turned_deg: crowd::up(&snapshot.poses()).and_then(|up| turned_deg(&small.pose, up)),
            uncertainty_px: uncertainty_px * larger,
            explained,
            agreeing: places.len(),
            compared: compared.then(|| Compared { render: render(), picture: registered.picture }),
        }
    }))
}

/// How far a picture from `pose` is turned clockwise where `up` (unit length) is up, degrees.
fn turned_deg(pose: &Pose, up: DVec3) -> Option<f64> {
    let shown = DVec2::new(up.dot(pose.rotation.x_axis), -up.dot(pose.rotation.y_axis));
    (shown.length() > MIN_UPRIGHT).then(|| shown.x.atan2(shown.y).to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn a_picture_is_turned_clockwise_where_its_top_shows_to_the_right() {
        let up = DVec3::Z;
        let level = Pose::look_at(DVec3::X, DVec3::ZERO, up).unwrap();
        assert!(turned_deg(&level, up).unwrap().abs() < 1e-9);
        for degrees in [30.0f64, -90.0, 170.0] {
            // A camera that is turned counterclockwise about its axis has a picture that is turned clockwise.
            let about_axis = DMat3::from_rotation_z(-degrees.to_radians());
            let pose = Pose::new(level.rotation * about_axis, level.position).unwrap();
            assert!((turned_deg(&pose, up).unwrap() - degrees).abs() < 1e-9, "{degrees}");
        }
        let down = Pose::look_at(DVec3::Z, DVec3::ZERO, DVec3::X).unwrap();
        assert_eq!(turned_deg(&down, up), None);
    }
}
