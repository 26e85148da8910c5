//! From the world to the paper: which way a scene's cameras are looked at from above
//! and from the side, to which scale, and what outline a camera has there.

use cairn_scene::{Capture, Pose};
use glam::{DVec2, DVec3};

use crate::query::crowd;

/// A panel's width and height, px.
pub const PANEL: DVec2 = DVec2::new(600.0, 540.0);
/// How much of the panel cameras and scene fill.
const FILLED: f64 = 0.86;

/// How the world lies on the paper: two directions and up, a middle, a scale.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Right, up the page in the plan, up.
    pub axes: [DVec3; 3],
    middle: DVec3,
    /// Pixels a capture unit.
    pub px_per_unit: f64,
    /// Length of a camera, px.
    pub camera_px: f64,
}

impl Layout {
    /// Fits the cameras, and the scene where it is no larger than they spread, into a panel.
    pub fn new(capture: &Capture) -> Self {
        let poses: Vec<Pose> = capture.views.iter().map(|v| v.camera.pose).collect();
        let axes = axes(&poses);
        let bounds = bounds(capture, &axes);
        let sizes = bounds.map(|(low, high)| high - low);
        let middle = (0..3).map(|k| axes[k] * ((bounds[k].0 + bounds[k].1) / 2.0)).sum();
        let fit = [(sizes[0], PANEL.x), (sizes[1], PANEL.y), (sizes[2], PANEL.y)];
        let scale = fit.iter().filter(|(size, _)| *size > 0.0).map(|(size, room)| FILLED * room / size);
        let px_per_unit = scale.fold(f64::INFINITY, f64::min);
        // Cameras all in one place have no scale; any will do.
        let px_per_unit = if px_per_unit.is_finite() { px_per_unit } else { 1.0 };
        let camera_px = (0.9 * spacing(&poses) * px_per_unit).clamp(11.0, 26.0);
        Self { axes, middle, px_per_unit, camera_px }
    }

    /// A direction on the paper, px a unit; `side` is 1 in the plan and 2 in the side view.
    pub fn along(&self, v: DVec3, side: usize) -> DVec2 {
        DVec2::new(v.dot(self.axes[0]), -v.dot(self.axes[side])) * self.px_per_unit
    }

    /// A point's place in the panel with this top left corner.
    pub fn place(&self, point: DVec3, side: usize, corner: DVec2) -> DVec2 {
        corner + PANEL / 2.0 + self.along(point - self.middle, side)
    }

    /// The outline of a camera's pyramid: its tip `at` where it stands, open to where it looks.
    pub fn camera(&self, pose: &Pose, side: usize, at: DVec2) -> Vec<DVec2> {
        let on_paper = |v: DVec3| self.along(v, side) / self.px_per_unit * self.camera_px;
        let (right, down, ahead) = (pose.rotation.x_axis * 0.45, pose.rotation.y_axis * 0.32, pose.forward());
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        hull(corners.map(|(x, y)| at + on_paper(ahead + right * x + down * y)).into_iter().chain([at]).collect())
    }
}

/// Right, up the page, and up: the cameras' spread lies along the first, and they
/// look up the page.
fn axes(poses: &[Pose]) -> [DVec3; 3] {
    let positions: Vec<DVec3> = poses.iter().map(|p| p.position).collect();
    let spread = crowd::principal_axes(&positions).map_or([DVec3::X, DVec3::Y, DVec3::Z], |(_, axes)| axes);
    let up = crowd::up(poses).unwrap_or(spread[2]);
    let level: Vec<DVec3> = positions.iter().map(|p| *p - up * p.dot(up)).collect();
    let first = crowd::principal_axes(&level).map_or(spread[0], |(_, axes)| axes[0]);
    let right = (first - up * first.dot(up)).try_normalize().unwrap_or_else(|| crowd::across(up));
    let ahead = up.cross(right);
    let looking = crowd::mean(poses.iter().map(Pose::forward)).unwrap_or(DVec3::ZERO);
    // Both turned: seen from above, right stays right of ahead.
    if looking.dot(ahead) < 0.0 { [-right, -ahead, up] } else { [right, ahead, up] }
}

/// Lowest and highest along each axis: the cameras', and the middle of the sparse
/// points where that does not make the cameras small.
fn bounds(capture: &Capture, axes: &[DVec3; 3]) -> [(f64, f64); 3] {
    let cameras = axes.map(|axis| {
        let along = capture.views.iter().map(|v| v.camera.pose.position.dot(axis));
        along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    });
    let both: [(f64, f64); 3] = std::array::from_fn(|k| {
        let along = || capture.points.iter().map(|p| p.dot(axes[k]));
        match (crowd::quantile(along(), 0.1), crowd::quantile(along(), 0.9)) {
            (Some(low), Some(high)) => (cameras[k].0.min(low), cameras[k].1.max(high)),
            _ => cameras[k],
        }
    });
    let size = |bounds: &[(f64, f64); 3]| bounds.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
    if size(&both) <= 2.0 * size(&cameras) { both } else { cameras }
}

/// Median distance from a camera to the next one, capture units; of at most 500 cameras.
fn spacing(poses: &[Pose]) -> f64 {
    let every = poses.len().div_ceil(500).max(1);
    let some: Vec<DVec3> = poses.iter().step_by(every).map(|p| p.position).collect();
    let nearest = |i: usize| {
        let others = some.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, p)| (*p - some[i]).length());
        others.fold(f64::INFINITY, f64::min)
    };
    crowd::quantile((0..some.len()).map(nearest), 0.5).unwrap_or(0.0)
}

/// The corners around a handful of points, in turn: from each to the one that has
/// all others on one side.
fn hull(points: Vec<DVec2>) -> Vec<DVec2> {
    let Some(start) = points.iter().copied().reduce(|a, b| if (b.x, b.y) < (a.x, a.y) { b } else { a }) else {
        return points;
    };
    let mut around = vec![start];
    while around.len() <= points.len() {
        let here = around[around.len() - 1];
        let farther = |best: DVec2, p: &DVec2| {
            let turn = (best - here).perp_dot(*p - here);
            let longer = (*p - here).length_squared() > (best - here).length_squared();
            // Points that coincide but for rounding turn by next to nothing.
            if best == here || turn < -1e-9 || (turn < 1e-9 && longer) { *p } else { best }
        };
        let next = points.iter().fold(here, farther);
        if (next - start).length_squared() < 1e-12 || next == here {
            break;
        }
        around.push(next);
    }
    around
}
