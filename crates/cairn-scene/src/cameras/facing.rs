//! Whether all cameras look one way, from about one place, into a scene that is
//! deep in front of them: then space is divided as forward-facing scenes want it.
//!
//! Where a camera file brings no depth bounds, the sparse points have to tell. A
//! landmark that was photographed from one side looks one way, too, and is
//! better off as a scene in the open: its photographers stand nearer and farther,
//! and its points lie at about one depth. Whatever is in doubt stays unbounded.

use std::path::Path;

use glam::DVec3;

use crate::cameras::camera::Camera;
use crate::cameras::pose::Pose;
use crate::error::CaptureError;

/// Cosine of the widest angle between a camera and the mean direction: 30 degrees.
/// LLFF's own scenes have 10.
const COS_APART: f64 = 0.866;
/// Cosine of the widest angle between a ray at a picture's corner and the mean
/// direction, 80 degrees: at 90 a ray never reaches the near plane.
const COS_CORNER: f64 = 0.174;
/// How far the cameras may stand before or behind their mean, as a share of the
/// distance to the nearest points. LLFF's fern has 0.04, trex 0.15; photographs of
/// the Statue of Liberty from one side 0.3 and more.
const DEPTH_OF_CAMERAS: f64 = 0.25;
/// How many times farther than the nearest points the farthest must lie. A
/// landmark's are less than 2, a room's or a garden's more.
const DEPTH_OF_SCENE: f64 = 2.0;
/// Fewer points say nothing certain.
const ENOUGH_POINTS: usize = 100;

/// Whether all `poses` look less than 60 degrees away from their mean direction,
/// as normalised device coordinates need.
pub(crate) fn face_one_way<'a>(poses: impl Iterator<Item = &'a Pose> + Clone) -> bool {
    face_within(poses, 0.5).is_some()
}

/// The mean direction of `poses`, where none has a smaller cosine to it than `cosine`.
fn face_within<'a>(poses: impl Iterator<Item = &'a Pose> + Clone, cosine: f64) -> Option<DVec3> {
    let mean = poses.clone().map(Pose::forward).sum::<DVec3>().try_normalize()?;
    poses.clone().all(|p| p.forward().dot(mean) > cosine).then_some(mean)
}

/// Whether `cameras` look into one deep scene from about one place, as far as `points` tell.
pub(crate) fn looks_ahead(cameras: &[Camera], points: &[DVec3]) -> bool {
    let Some(forward) = face_within(cameras.iter().map(|c| &c.pose), COS_APART) else { return false };
    let centre = cameras.iter().map(|c| c.pose.position).sum::<DVec3>() / cameras.len() as f64;
    let mut depths: Vec<f64> = points.iter().map(|&p| forward.dot(p - centre)).collect();
    if depths.len() < ENOUGH_POINTS {
        return false;
    }
    depths.sort_by(f64::total_cmp);
    // A hundredth on either side, because some points are always matched wrongly.
    let outliers = depths.len() / 100;
    let (near, far) = (depths[outliers], depths[depths.len() - 1 - outliers]);
    let near_enough = |c: &Camera| forward.dot(c.pose.position - centre).abs() <= DEPTH_OF_CAMERAS * near;
    near > 0.0
        && far >= DEPTH_OF_SCENE * near
        && cameras.iter().all(near_enough)
        && cameras.iter().all(|c| corners_ahead(c, forward))
}

/// Whether what is in the picture's corners lies ahead.
fn corners_ahead(camera: &Camera, forward: DVec3) -> bool {
    let (w, h) = (camera.intrinsics.width as f64, camera.intrinsics.height as f64);
    [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].into_iter().all(|(x, y)| camera.ray(x, y).1.dot(forward) > COS_CORNER)
}

/// Refuses a forward-facing capture where nothing says where the scene begins: neither depth bounds nor a point ahead
/// of the cameras. A training could not place its near plane. `views` are poses, and whether each has bounds.
///
/// # Errors
/// [`CaptureError::Malformed`], about `file`.
pub(crate) fn check_near<'a>(
    file: &Path,
    views: impl Iterator<Item = (&'a Pose, bool)> + Clone,
    points: &[DVec3],
) -> Result<(), CaptureError> {
    let forward: DVec3 = views.clone().map(|(pose, _)| pose.forward()).sum();
    let centre = views.clone().map(|(pose, _)| pose.position).sum::<DVec3>() / views.clone().count() as f64;
    if views.clone().any(|(_, bounds)| bounds) || points.iter().any(|&p| forward.dot(p - centre) > 0.0) {
        return Ok(());
    }
    let expected = "depth bounds (LLFF) or sparse points before the cameras, to say where the scene begins";
    let remedy = "bring poses_bounds.npy or COLMAP's points3D with it, or import it as unbounded (--kind unbounded)";
    Err(CaptureError::malformed(file, "forward-facing", expected, "neither", remedy))
}
