//! From the world to the grid: where a scene's box lies and how a ray runs
//! through it. Three kinds, after what photographs are like: forward-facing
//! (normalised device coordinates, NeRF appendix C), bounded (a box), unbounded
//! (a box, and around it all of space contracted, after mip-NeRF 360 eq. 10 with
//! the maximum norm so that the contracted space is a box again).
//!
//! Geometry is worked out in f64 relative to the scene's own centre and size, so
//! a scene in millimetres and one in kilometres, or one a million units off the
//! origin, give the same picture.

use crate::error::FieldError;
use cairn_capture::{Camera, Capture, SceneKind};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// How world points map to the unit cube that the grid fills.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum SceneFrame {
    /// Normalised device coordinates of a reference camera: x and y are
    /// perspective, z is linear in inverse depth from `near` to infinity.
    ForwardFacing {
        /// World to reference-camera rotation (OpenCV axes).
        rotation: DMat3,
        /// The reference camera's centre, capture units.
        position: DVec3,
        /// Depth of the near plane, capture units, > 0.
        near: f64,
        /// Smallest x/depth and y/depth that any ray reaches.
        low: [f64; 2],
        /// Largest x/depth and y/depth that any ray reaches.
        high: [f64; 2],
    },
    /// An axis-aligned box; nothing outside it.
    Bounded {
        /// Its middle, capture units.
        centre: DVec3,
        /// Half its sides, capture units.
        half: DVec3,
    },
    /// An axis-aligned box at full resolution with all of space around it,
    /// contracted to the box of twice its size.
    Unbounded {
        /// Its middle, capture units.
        centre: DVec3,
        /// Half its sides, capture units.
        half: DVec3,
    },
}

/// A ray in the frame's own coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RayPath {
    /// `origin + t * direction` in the unit cube for `t` in `[start, end]`.
    Straight {
        /// At t = 0, unit-cube coordinates.
        origin: [f64; 3],
        /// Per unit of t.
        direction: [f64; 3],
        /// Where the ray enters the cube.
        start: f64,
        /// Where it leaves.
        end: f64,
    },
    /// `origin + t * direction` for t >= 0, in units of the inner box's half
    /// sides, contracted afterwards.
    Contracted {
        /// At t = 0.
        origin: [f64; 3],
        /// Per unit of t; its maximum norm is 1.
        direction: [f64; 3],
    },
    /// The ray misses the box.
    Miss,
}

/// Bends space beyond the unit maximum-norm ball into the ball of radius 2
/// (mip-NeRF 360, eq. 10, with the maximum norm).
pub fn contract(x: DVec3) -> DVec3 {
    let n = x.abs().max_element();
    if n <= 1.0 { x } else { x * ((2.0 - 1.0 / n) / n) }
}

impl SceneFrame {
    /// Chooses the box from a capture: see the module's text for the kinds.
    ///
    /// # Errors
    /// [`FieldError::Frame`] when there are no views or the box has no size.
    pub fn from_capture(capture: &Capture) -> Result<Self, FieldError> {
        let cameras: Vec<&Camera> = capture.views.iter().map(|v| &v.camera).collect();
        if cameras.is_empty() {
            return Err(FieldError::Frame("the capture has no views".into()));
        }
        match capture.kind {
            SceneKind::ForwardFacing => {
                let near = capture.views.iter().filter_map(|v| v.bounds.map(|b| b.0)).fold(f64::INFINITY, f64::min);
                Self::forward_facing(&cameras, near, &capture.points)
            }
            SceneKind::Bounded => Self::boxed(&cameras, &[], false),
            SceneKind::Unbounded => Self::boxed(&cameras, &capture.points, true),
        }
    }

    fn forward_facing(cameras: &[&Camera], near: f64, points: &[DVec3]) -> Result<Self, FieldError> {
        let mean = |f: fn(&Camera) -> DVec3| cameras.iter().map(|c| f(c)).sum::<DVec3>() / cameras.len() as f64;
        let position = mean(|c| c.pose.position);
        let forward = mean(|c| c.pose.rotation.z_axis)
            .try_normalize()
            .ok_or_else(|| FieldError::Frame("the views look in opposite directions; import as unbounded".into()))?;
        let down = mean(|c| c.pose.rotation.y_axis);
        let right = down
            .cross(forward)
            .try_normalize()
            .ok_or_else(|| FieldError::Frame("the views agree on no upright; import the scene as unbounded".into()))?;
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let depth = |p: DVec3| (rotation * (p - position)).z;
        let mut near = near * 0.9;
        if !near.is_finite() {
            let mut depths: Vec<f64> = points.iter().map(|p| depth(*p)).filter(|d| *d > 0.0).collect();
            depths.sort_by(f64::total_cmp);
            near = depths.get(depths.len() / 100).copied().unwrap_or(f64::NAN) * 0.8;
        }
        // The near plane must lie in front of every camera.
        let foremost = cameras.iter().map(|c| depth(c.pose.position)).fold(f64::NEG_INFINITY, f64::max);
        let near = near.max(foremost * 1.05);
        if !(near > 0.0 && near.is_finite()) {
            return Err(FieldError::Frame(
                "a forward-facing scene needs near bounds or sparse points to place its near plane; import it as unbounded".into(),
            ));
        }
        let mut frame = Self::ForwardFacing { rotation, position, near, low: [0.0; 2], high: [1.0; 2] };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for camera in cameras {
            let (w, h) = (camera.intrinsics.width as f64, camera.intrinsics.height as f64);
            for (x, y) in
                [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h), (w / 2.0, 0.0), (w / 2.0, h), (0.0, h / 2.0), (w, h / 2.0)]
            {
                let (o, d) = camera.ray(x, y);
                let Some((a, b)) = frame.ndc_ends(o, d) else {
                    return Err(FieldError::Frame(
                        "a view looks more than 90 degrees off the others; import the scene as unbounded".into(),
                    ));
                };
                for e in [a, b] {
                    for k in 0..2 {
                        low[k] = low[k].min(e[k]);
                        high[k] = high[k].max(e[k]);
                    }
                }
            }
        }
        if let Self::ForwardFacing { low: l, high: h, .. } = &mut frame {
            (*l, *h) = (low, high);
        }
        Ok(frame)
    }

    fn boxed(cameras: &[&Camera], points: &[DVec3], unbounded: bool) -> Result<Self, FieldError> {
        let (focus, footprint) = focus_and_footprint(cameras);
        let (mut centre, mut half) = (focus, DVec3::splat(footprint * 1.05));
        if unbounded && points.len() >= 100 {
            // Nine tenths of the sparse points, a little widened: what the
            // photographers looked at, without the far shore.
            let axis = |k: usize| {
                let mut v: Vec<f64> = points.iter().map(|p| p[k]).collect();
                v.sort_by(f64::total_cmp);
                (v[v.len() / 20], v[v.len() - 1 - v.len() / 20])
            };
            let (x, y, z) = (axis(0), axis(1), axis(2));
            let (low, high) = (DVec3::new(x.0, y.0, z.0), DVec3::new(x.1, y.1, z.1));
            centre = (low + high) / 2.0;
            half = (high - low) * 0.6;
            half = half.max(DVec3::splat(half.max_element() * 0.25));
        }
        if !(half.min_element() > 0.0 && half.is_finite() && centre.is_finite()) {
            return Err(FieldError::Frame("the scene's box has no size; check the camera positions".into()));
        }
        Ok(if unbounded { Self::Unbounded { centre, half } } else { Self::Bounded { centre, half } })
    }

    /// Sides of the unit cube relative to one another, largest = 1: voxels are
    /// made cubic by choosing resolutions in this proportion.
    pub fn proportions(&self) -> [f64; 3] {
        let p = match self {
            Self::ForwardFacing { low, high, .. } => {
                DVec3::new(high[0] - low[0], high[1] - low[1], (high[0] - low[0]).min(high[1] - low[1]) * 0.6)
            }
            Self::Bounded { half, .. } | Self::Unbounded { half, .. } => *half,
        };
        (p / p.max_element()).to_array()
    }

    /// Whether a sky lies behind everything (rays never end inside the box).
    pub fn is_unbounded(&self) -> bool {
        matches!(self, Self::Unbounded { .. })
    }

    /// A world ray in this frame. `direction` need not have unit length.
    pub fn path(&self, origin: DVec3, direction: DVec3) -> RayPath {
        match self {
            Self::ForwardFacing { low, high, .. } => {
                let Some((a, b)) = self.ndc_ends(origin, direction) else { return RayPath::Miss };
                let unit =
                    |e: [f64; 3]| [(e[0] - low[0]) / (high[0] - low[0]), (e[1] - low[1]) / (high[1] - low[1]), e[2]];
                let (a, b) = (DVec3::from(unit(a)), DVec3::from(unit(b)));
                clip(a, b - a, 0.0, 1.0)
            }
            Self::Bounded { centre, half } => {
                let o = (origin - centre) / half * 0.5 + 0.5;
                clip(o, direction / half * 0.5, 0.0, f64::INFINITY)
            }
            Self::Unbounded { centre, half } => {
                let d = direction / half;
                let n = d.abs().max_element();
                if !(n > 0.0 && n.is_finite()) {
                    return RayPath::Miss;
                }
                RayPath::Contracted { origin: ((origin - centre) / half).to_array(), direction: (d / n).to_array() }
            }
        }
    }

    /// A world point's place in the unit cube; `None` where the frame has none.
    pub fn unit(&self, point: DVec3) -> Option<DVec3> {
        match self {
            Self::ForwardFacing { rotation, position, near, low, high } => {
                let p = *rotation * (point - *position);
                (p.z > 0.0).then(|| {
                    DVec3::new(
                        (p.x / p.z - low[0]) / (high[0] - low[0]),
                        (p.y / p.z - low[1]) / (high[1] - low[1]),
                        1.0 - near / p.z,
                    )
                })
            }
            Self::Bounded { centre, half } => Some((point - centre) / half * 0.5 + 0.5),
            Self::Unbounded { centre, half } => Some(contract((point - centre) / half) * 0.25 + 0.5),
        }
    }

    /// Where a ray crosses the near plane and where it ends at infinity:
    /// (x/depth, y/depth, 1 - near/depth). `None` when it never gets there.
    fn ndc_ends(&self, origin: DVec3, direction: DVec3) -> Option<([f64; 3], [f64; 3])> {
        let Self::ForwardFacing { rotation, position, near, .. } = self else { return None };
        let (o, d) = (*rotation * (origin - *position), *rotation * direction);
        if d.z <= 1e-9 * d.length() {
            return None;
        }
        // A camera beyond the near plane starts where it stands.
        let t = ((near - o.z) / d.z).max(0.0);
        let p = o + d * t;
        Some(([p.x / p.z, p.y / p.z, 1.0 - near / p.z], [d.x / d.z, d.y / d.z, 1.0]))
    }
}

/// The part of a ray inside the unit cube.
fn clip(origin: DVec3, direction: DVec3, start: f64, end: f64) -> RayPath {
    let (mut start, mut end) = (start, end);
    for k in 0..3 {
        if direction[k].abs() < 1e-300 {
            if !(0.0..=1.0).contains(&origin[k]) {
                return RayPath::Miss;
            }
            continue;
        }
        let (a, b) = ((0.0 - origin[k]) / direction[k], (1.0 - origin[k]) / direction[k]);
        start = start.max(a.min(b));
        end = end.min(a.max(b));
    }
    if start < end && (end - start).is_finite() {
        RayPath::Straight { origin: origin.to_array(), direction: direction.to_array(), start, end }
    } else {
        RayPath::Miss
    }
}

/// The point nearest to all optical axes (least squares), and half the width of
/// what a middling view sees there, in capture units.
fn focus_and_footprint(cameras: &[&Camera]) -> (DVec3, f64) {
    let middle = cameras.iter().map(|c| c.pose.position).sum::<DVec3>() / cameras.len() as f64;
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let d = camera.pose.forward();
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += across;
        b += across * (camera.pose.position - middle);
    }
    // Parallel axes meet nowhere: a little pull to the cameras' middle decides.
    a += DMat3::IDENTITY * (1e-3 * cameras.len() as f64);
    let focus = middle + a.inverse() * b;
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() / 2]
    };
    let distance = median(cameras.iter().map(|c| (c.pose.position - focus).length()).collect());
    let slope = median(
        cameras
            .iter()
            .map(|c| {
                let i = &c.intrinsics;
                (i.width as f64 / i.fx).max(i.height as f64 / i.fy) / 2.0
            })
            .collect(),
    );
    let spread = (cameras.iter().map(|c| (c.pose.position - middle).length_squared()).sum::<f64>()
        / cameras.len() as f64)
        .sqrt();
    // Cameras that stand together and look outwards: the scene is around them.
    let half = (distance * slope).max(spread * 0.5);
    (focus, if half > 0.0 { half } else { 1.0 })
}
