//! Camera paths: an orbit around the scene's centre, a spiral in front of it, a
//! flight between two views. Poses from poses; nothing here renders or reads.
//!
//! A path that would show what no photograph shows is refused with the path that
//! would do instead.

use std::f64::consts::{FRAC_PI_2, TAU};

use cairn_scene::{Camera, Distortion, Intrinsics, Pose};
use glam::{DMat3, DQuat, DVec3};
use thiserror::Error;

use crate::query::crowd;

/// Steepest that an orbit looks up or down, radians: at the pole there is no upright.
const STEEPEST: f64 = FRAC_PI_2 * 0.9;
/// Turns of a spiral; it goes forth and back once in the time of both.
const TURNS: f64 = 2.0;
/// Share of the cameras (by distance from the middle, along each axis) that a spiral stays within.
const SPIRAL_WITHIN: f64 = 0.8;

/// Why there is no such path.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PathError {
    /// No pose to start from.
    #[error("there is no view to make a path from; import the scene with training views")]
    NoViews,
    /// No common upright.
    #[error("the views agree on no upright direction; use a path between two views instead (--path between)")]
    NoUpright,
    /// The cameras stand where the path's centre is, or all in one place.
    #[error("the views stand in one place ({what}); use a path between two views, or bring views from more places")]
    OnePlace {
        /// What has no size.
        what: &'static str,
    },
    /// An orbit of a scene that was seen from one side.
    #[error(
        "an orbit goes around a scene, and this one is forward-facing: it was seen from one side only; use a spiral (--path spiral)"
    )]
    OneSided,
    /// An orbit of a scene whose cameras look outwards.
    #[error(
        "{away} of {views} views look away from the scene's centre: an orbit would show what no photograph shows; use a path between two views (--path between)"
    )]
    LookingAway {
        /// How many do.
        away: usize,
        /// Of how many.
        views: usize,
    },
    /// From a pinhole's view to a fisheye's.
    #[error(
        "one of the two views was taken by a fisheye and the other was not, and no lens lies between them; take two views of one kind of lens"
    )]
    OtherLens,
    /// A spiral of cameras that look everywhere.
    #[error("the views look in many directions, and a spiral needs a common one; use an orbit (--path orbit)")]
    NoCommonView,
}

/// `frames` poses on a circle (or an arc of `arc_deg`, above 0, to 360) around
/// `centre`: at the cameras' median distance and median height above the centre's
/// horizon, upright, looking at the centre. It begins where most cameras stand;
/// an arc lies evenly on both sides of that, a circle closes on itself.
///
/// # Errors
/// [`PathError`] for cameras without an upright, at the centre, or looking away.
pub fn orbit(poses: &[Pose], centre: DVec3, arc_deg: f64, frames: usize) -> Result<Vec<Pose>, PathError> {
    let up = crowd::up(poses).ok_or(if poses.is_empty() { PathError::NoViews } else { PathError::NoUpright })?;
    let away = poses.iter().filter(|p| (centre - p.position).dot(p.forward()) < 0.0).count();
    if 2 * away > poses.len() {
        return Err(PathError::LookingAway { away, views: poses.len() });
    }
    let offsets = || poses.iter().map(|p| p.position - centre);
    let distance = crowd::quantile(offsets().map(DVec3::length), 0.5).ok_or(PathError::NoViews)?;
    if !(distance > 0.0 && distance.is_finite()) {
        return Err(PathError::OnePlace { what: "at the scene's centre" });
    }
    let heights = offsets().filter(|o| o.length() > 0.0).map(|o| (o.normalize().dot(up)).clamp(-1.0, 1.0).asin());
    let height = crowd::quantile(heights, 0.5).unwrap_or(0.0).clamp(-STEEPEST, STEEPEST);
    let level = |v: DVec3| v - up * v.dot(up);
    let crowd_side = crowd::mean(offsets().map(level)).filter(|m| m.length() > 1e-3 * distance);
    let ahead = crowd_side.map_or_else(|| crowd::across(up), DVec3::normalize);
    let aside = up.cross(ahead);
    let whole = arc_deg >= 360.0;
    let pose = |i: usize| {
        let share = if whole { i as f64 / frames as f64 } else { through(i, frames) - 0.5 };
        let (sin, cos) = (share * arc_deg.to_radians()).sin_cos();
        let out = (ahead * cos + aside * sin) * height.cos() + up * height.sin();
        // The height is kept from the pole, so up and the way in are never one.
        Pose::look_at(centre + out * distance, centre, up).map_err(|_| PathError::NoUpright)
    };
    (0..frames).map(pose).collect()
}

/// `frames` poses on an ellipse around the mean pose, within the spread of the
/// cameras and moving a little forth and back, all looking at the point `depth`
/// (capture units, above 0) in front of the mean pose. Closes on itself.
///
/// # Errors
/// [`PathError`] for cameras that look everywhere or stand in one place.
pub fn spiral(poses: &[Pose], depth: f64, frames: usize) -> Result<Vec<Pose>, PathError> {
    let middle = crowd::mean(poses.iter().map(|p| p.position)).ok_or(PathError::NoViews)?;
    let forward = crowd::mean(poses.iter().map(Pose::forward)).ok_or(PathError::NoViews)?;
    if forward.length() < 0.5 {
        return Err(PathError::NoCommonView);
    }
    let forward = forward.normalize();
    let down = crowd::mean(poses.iter().map(|p| p.rotation.y_axis)).ok_or(PathError::NoViews)?;
    let right = down.cross(forward).try_normalize().ok_or(PathError::NoUpright)?;
    let up = right.cross(forward);
    let spread = |axis: DVec3| {
        let along = poses.iter().map(|p| (p.position - middle).dot(axis).abs());
        crowd::quantile(along, SPIRAL_WITHIN).unwrap_or(0.0)
    };
    let (wide, high, deep) = (spread(right), spread(up), spread(forward));
    if !(depth > 0.0 && depth.is_finite()) {
        return Err(PathError::OnePlace { what: "with nothing in front of them" });
    }
    if wide.max(high) <= 1e-6 * depth {
        return Err(PathError::OnePlace { what: "their spread is next to nothing" });
    }
    // Never past what is looked at.
    let (target, deep) = (middle + forward * depth, deep.min(depth * 0.5));
    let pose = |i: usize| {
        let angle = TAU * TURNS * i as f64 / frames as f64;
        let (sin, cos) = angle.sin_cos();
        let to_and_fro = (angle / TURNS).sin();
        let position = middle + right * (wide * cos) + up * (high * sin) + forward * (deep * to_and_fro);
        Pose::look_at(position, target, up).map_err(|_| PathError::NoUpright)
    };
    (0..frames).map(pose).collect()
}

/// The camera at `share` of the way between two: exactly the first at 0 and the
/// second at 1. Rotations are interpolated on the sphere, lenses linearly; positions so
/// that `centre` moves straight as the camera sees it, which keeps it in the picture and the
/// camera from going through it. Cameras that look the same way move along a line.
///
/// # Errors
/// [`PathError::OtherLens`] between a pinhole and a fisheye.
pub fn between(from: &Camera, to: &Camera, centre: DVec3, share: f64) -> Result<Camera, PathError> {
    let intrinsics = mixed(&from.intrinsics, &to.intrinsics, share).ok_or(PathError::OtherLens)?;
    if share <= 0.0 {
        return Ok(*from);
    }
    if share >= 1.0 {
        return Ok(*to);
    }
    let turn = |pose: &Pose| DQuat::from_mat3(&pose.rotation).normalize();
    let rotation = DMat3::from_quat(turn(&from.pose).slerp(turn(&to.pose), share));
    let seen = |pose: &Pose| pose.rotation.transpose() * (centre - pose.position);
    let position = centre - rotation * seen(&from.pose).lerp(seen(&to.pose), share);
    Ok(Camera { intrinsics, pose: Pose { rotation, position } })
}

/// How far frame `i` of `frames` is through the whole, 0 to 1, ends included.
pub fn through(i: usize, frames: usize) -> f64 {
    if frames > 1 { i as f64 / (frames - 1) as f64 } else { 0.0 }
}

/// The lens of a camera that took no photograph: a pinhole with the median focal length of `views`, square
/// pixels, no distortion, `width` x `height` px. What fisheyes took it shows in the middle at their scale, and less
/// of what is beside it. `None` without views.
pub fn middling_lens(views: &[Intrinsics], width: usize, height: usize) -> Option<Intrinsics> {
    let fitted = || views.iter().map(|view| fitted(view, width, height));
    let focal = crowd::quantile(fitted().map(|i| (i.fx + i.fy) / 2.0), 0.5)?;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    Some(Intrinsics { width, height, fx: focal, fy: focal, cx, cy, distortion: Distortion::default() })
}

/// The lens at another size, which may have other proportions: pixels keep their
/// shape, and what is too wide or too high is cut off on both sides.
pub fn fitted(lens: &Intrinsics, width: usize, height: usize) -> Intrinsics {
    let scale = (width as f64 / lens.width as f64).max(height as f64 / lens.height as f64);
    let shift = |centre: f64, old: usize, new: usize| (centre - old as f64 / 2.0) * scale + new as f64 / 2.0;
    let (cx, cy) = (shift(lens.cx, lens.width, width), shift(lens.cy, lens.height, height));
    Intrinsics { width, height, fx: lens.fx * scale, fy: lens.fy * scale, cx, cy, distortion: lens.distortion }
}

/// A lens between two of the same size; `None` between a pinhole and a fisheye.
fn mixed(a: &Intrinsics, b: &Intrinsics, share: f64) -> Option<Intrinsics> {
    let mix = |a: f64, b: f64| a + (b - a) * share;
    let distortion = a.distortion.mixed(&b.distortion, share)?;
    let (fx, fy, cx, cy) = (mix(a.fx, b.fx), mix(a.fy, b.fy), mix(a.cx, b.cx), mix(a.cy, b.cy));
    Some(Intrinsics { width: a.width, height: a.height, fx, fy, cx, cy, distortion })
}

#[cfg(test)]
#[path = "paths_tests.rs"]
mod tests;
