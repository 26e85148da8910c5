//! A camera path through a trained scene: planned at once, rendered frame by
//! frame, so that whoever asked can stop between two of them.

use std::collections::BTreeMap;
use std::sync::Arc;

use cairn_field::{Appearance, SceneFrame};
use cairn_scene::{Camera, Capture, Intrinsics, Picture, Pose, SceneKind, View};
use glam::DVec3;

use crate::config::Limits;
use crate::error::EngineError;
use crate::export::paths::{self, PathError};
use crate::query::crowd;
use crate::query::light::{Light, appearance};
use crate::query::viewpoint::FieldKind;
use crate::store::model::Model;
use crate::store::scenes::{check_size, view_index};
use crate::store::snapshot::SceneSnapshot;

/// Which way to fly.
#[derive(Clone, Debug, PartialEq)]
pub enum PathKind {
    /// Around the scene's centre.
    Orbit {
        /// How far around, degrees, above 0, to 360.
        arc_deg: f64,
    },
    /// In front of the scene, around the mean pose.
    Spiral,
    /// From one view to another, by name.
    Between(String, String),
}

/// What to fly and how to see it.
#[derive(Clone, Debug)]
pub struct PathRequest {
    /// The scene's name.
    pub scene: String,
    /// Which way.
    pub kind: PathKind,
    /// How many frames, 2 to `limits.max_path_frames`.
    pub frames: usize,
    /// Frames' width and height, px; 0 follows the other and the views' proportions.
    pub size: (usize, usize),
    /// Which field.
    pub field: FieldKind,
    /// In whose light; `None` is neutral, and between two views from the one's to the other's.
    pub light: Option<Light>,
    /// In whose light it ends; `None` is as it begins, where that is said.
    pub light_to: Option<Light>,
}

/// A path that was planned. It holds no model: whoever takes its frames slowly must not
/// keep a large field in memory.
pub struct Tour {
    /// The scene's name.
    pub scene: String,
    /// The job whose model it was planned for.
    pub job: String,
    field: FieldKind,
    /// The frames' cameras.
    pub cameras: Vec<Camera>,
    /// At the path's beginning and end.
    light: (Appearance, Appearance),
}

/// Plans a camera path; renders nothing yet. `model` loads the scene's model once nothing speaks
/// against the path without it.
///
/// # Errors
/// [`EngineError::Path`] for a path that the scene's cameras do not carry,
/// [`EngineError::OverLimit`], [`EngineError::NotFound`]; `model`'s; [`Light::Photograph`]'s.
pub fn plan(
    snapshot: &SceneSnapshot,
    request: &PathRequest,
    limits: &Limits,
    model: impl FnOnce() -> Result<Arc<Model>, EngineError>,
) -> Result<Tour, EngineError> {
    let most = limits.max_path_frames;
    if request.frames < 2 {
        return Err(EngineError::invalid("the number of frames", request.frames, format!("2 to {most}")));
    }
    EngineError::within("the number of frames", "limits.max_path_frames", most as u64, request.frames as u64)?;
    let capture = snapshot.scene.capture();
    let route = Route::new(snapshot, &request.kind)?;
    let (width, height) = size(request.size.into(), route.usual_size().into());
    check_size("a frame", width, height, limits)?;
    let model = &*model()?;
    if request.field == FieldKind::Marked {
        model.marked_field()?;
    }
    let light = match (&request.light, &route) {
        (Some(light), _) => ends(appearance(model, snapshot, light, limits)?),
        (None, Route::Between(from, to)) => (own_light(model, capture, from), own_light(model, capture, to)),
        (None, _) => ends(model.base.canonical_appearance().clone()),
    };
    let light = match &request.light_to {
        Some(end) => (light.0, appearance(model, snapshot, end, limits)?),
        None => light,
    };
    let cameras = route.cameras(capture, model.base.frame(), request.frames, width, height)?;
    Ok(Tour { scene: request.scene.clone(), job: model.info.job.clone(), field: request.field, cameras, light })
}

/// Renders frame `i` of a path, clamped to [0, 1].
///
/// # Errors
/// [`EngineError::WrongState`] when the scene was trained again since the path was
/// planned.
pub fn frame(model: &Model, tour: &Tour, i: usize) -> Result<Picture, EngineError> {
    if model.info.job != tour.job {
        let why = format!("it began in the model of {}, and the newest is {}'s; begin again", tour.job, model.info.job);
        return Err(EngineError::wrong_state(format!("the path through scene {:?}", tour.scene), "gone on with", why));
    }
    let share = paths::through(i, tour.cameras.len()) as f32;
    model.look(tour.field, &tour.cameras[i], &tour.light.0.mixed(&tour.light.1, share))
}

fn ends(light: Appearance) -> (Appearance, Appearance) {
    (light.clone(), light)
}

/// A kind of path with the views that it needs.
enum Route<'a> {
    Orbit(f64, Vec<&'a View>),
    Spiral(Vec<&'a View>),
    Between(&'a View, &'a View),
}

impl<'a> Route<'a> {
    fn new(snapshot: &'a SceneSnapshot, kind: &PathKind) -> Result<Self, EngineError> {
        let capture = snapshot.scene.capture();
        let training = || capture.training().map(|i| &capture.views[i]).filter(|v| !snapshot.is_out(&v.name)).collect();
        Ok(match kind {
            PathKind::Orbit { .. } if capture.kind == SceneKind::ForwardFacing => {
                return Err(PathError::OneSided.into());
            }
            PathKind::Orbit { arc_deg } => Self::Orbit(*arc_deg, training()),
            PathKind::Spiral => Self::Spiral(training()),
            PathKind::Between(from, to) => {
                let of = |name| Ok::<_, EngineError>(&capture.views[view_index(capture, name)?]);
                Self::Between(of(from)?, of(to)?)
            }
        })
    }

    /// The size that most of its views have, px; the larger of equally frequent ones.
    fn usual_size(&self) -> (usize, usize) {
        let mut counts = BTreeMap::new();
        match self {
            Self::Orbit(_, views) | Self::Spiral(views) => {
                for i in views.iter().map(|v| &v.camera.intrinsics) {
                    *counts.entry((i.width, i.height)).or_insert(0usize) += 1;
                }
            }
            Self::Between(from, _) => {
                counts.insert((from.camera.intrinsics.width, from.camera.intrinsics.height), 1);
            }
        }
        // Without any view the path itself is refused a moment later.
        counts.into_iter().max_by_key(|(_, count)| *count).map_or((1, 1), |(size, _)| size)
    }

    fn cameras(
        &self,
        capture: &Capture,
        frame: &SceneFrame,
        frames: usize,
        width: usize,
        height: usize,
    ) -> Result<Vec<Camera>, EngineError> {
        let views = match self {
            Self::Orbit(_, views) | Self::Spiral(views) => views,
            Self::Between(from, to) => {
                let fitted = |view: &View| Camera {
                    intrinsics: paths::fitted(&view.camera.intrinsics, width, height),
                    pose: view.camera.pose,
                };
                let ends = [*from, *to];
                let centre = centre(frame).map_or_else(|| focus(capture, frame, &ends), Ok)?;
                let (from, to) = (fitted(from), fitted(to));
                return (0..frames)
                    .map(|i| Ok(paths::between(&from, &to, centre, paths::through(i, frames))?))
                    .collect();
            }
        };
        let poses: Vec<Pose> = views.iter().map(|v| v.camera.pose).collect();
        let lenses: Vec<Intrinsics> = views.iter().map(|v| v.camera.intrinsics).collect();
        let intrinsics = paths::middling_lens(&lenses, width, height).ok_or(PathError::NoViews)?;
        let poses = match (self, centre(frame)) {
            (Self::Orbit(arc_deg, _), Some(centre)) => paths::orbit(&poses, centre, *arc_deg, frames)?,
            (Self::Orbit(..), None) => return Err(PathError::OneSided.into()),
            _ => paths::spiral(&poses, depth(capture, frame, views)?, frames)?,
        };
        Ok(poses.into_iter().map(|pose| Camera { intrinsics, pose }).collect())
    }
}

/// The middle of the scene's box; `None` of a scene that was seen from one side.
fn centre(frame: &SceneFrame) -> Option<DVec3> {
    match frame {
        SceneFrame::ForwardFacing { .. } => None,
        SceneFrame::Bounded { centre, .. } | SceneFrame::Unbounded { centre, .. } => Some(*centre),
    }
}

/// The mean pose of views: where they stand, and which way they look (unit length, or zero where
/// that cancels out).
fn gaze(views: &[&View]) -> Result<(DVec3, DVec3), PathError> {
    let middle = crowd::mean(views.iter().map(|v| v.camera.pose.position)).ok_or(PathError::NoViews)?;
    let forward = crowd::mean(views.iter().map(|v| v.camera.pose.forward())).ok_or(PathError::NoViews)?;
    Ok((middle, forward.normalize_or_zero()))
}

/// The point that the views look at where there is no box: `depth` ahead of their mean pose.
fn focus(capture: &Capture, frame: &SceneFrame, views: &[&View]) -> Result<DVec3, PathError> {
    let (middle, forward) = gaze(views)?;
    Ok(middle + forward * depth(capture, frame, views)?)
}

/// How far ahead of the mean pose the views look, capture units: the harmonic mean
/// of nearest and farthest where the import brought them, as nearer things move more;
/// else the median sparse point, the box's centre, or twice the near plane.
fn depth(capture: &Capture, frame: &SceneFrame, views: &[&View]) -> Result<f64, PathError> {
    let median = |of: fn((f64, f64)) -> f64| crowd::quantile(views.iter().filter_map(|v| v.bounds.map(of)), 0.5);
    if let (Some(near), Some(far)) = (median(|b| b.0), median(|b| b.1)) {
        return Ok(2.0 * near * far / (near + far));
    }
    let (middle, forward) = gaze(views)?;
    if let Some(centre) = centre(frame) {
        return Ok((centre - middle).dot(forward));
    }
    let ahead = capture.points.iter().map(|p| (*p - middle).dot(forward)).filter(|d| *d > 0.0);
    Ok(crowd::quantile(ahead, 0.5).unwrap_or(match frame {
        SceneFrame::ForwardFacing { near, .. } => 2.0 * near,
        SceneFrame::Bounded { .. } | SceneFrame::Unbounded { .. } => 0.0,
    }))
}

/// The light of a view: its own; of a view that was held out, the mean of those its
/// contributor's training views have; else neutral.
fn own_light(model: &Model, capture: &Capture, view: &View) -> Appearance {
    let of = |view: &View| model.base.appearances().iter().find(|(n, _)| *n == view.name).map(|(_, a)| a);
    if let Some(own) = of(view) {
        return own.clone();
    }
    let others = capture.views.iter().filter(|v| v.contributor == view.contributor).filter_map(of);
    let mut mean: Option<Appearance> = None;
    for (i, other) in others.enumerate() {
        mean = Some(match mean {
            None => other.clone(),
            Some(so_far) => so_far.mixed(other, 1.0 / (i + 1) as f32),
        });
    }
    mean.unwrap_or_else(|| model.base.canonical_appearance().clone())
}

/// The frames' size: as asked, and where a side is 0, as the other side and the usual proportions have it.
fn size(asked: [usize; 2], usual: [usize; 2]) -> (usize, usize) {
    let scaled = |side: usize, of: usize, other: usize| {
        ((side as f64 * other as f64 / of as f64).round().min(f64::from(u32::MAX)) as usize).max(1)
    };
    match asked {
        [0, 0] => (usual[0], usual[1]),
        [0, height] => (scaled(height, usual[1], usual[0]), height),
        [width, 0] => (width, scaled(width, usual[0], usual[1])),
        [width, height] => (width, height),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_side_that_is_not_given_follows_the_other() {
        assert_eq!(size([0, 0], [300, 200]), (300, 200));
        assert_eq!(size([150, 0], [300, 200]), (150, 100));
        assert_eq!(size([0, 1], [300, 200]), (2, 1));
        assert_eq!(size([7, 9], [300, 200]), (7, 9));
        assert_eq!(size([1, 0], [300, 2]), (1, 1));
    }
}
