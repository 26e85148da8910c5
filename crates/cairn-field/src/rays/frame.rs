//! From the world to the grid: where a scene's box lies and how a ray runs
//! through it. Three kinds, after what photographs are like: forward-facing
//! (normalised device coordinates, NeRF appendix C), bounded (a box), unbounded
//! (a box, and around it all of space contracted, after mip-NeRF 360 eq. 10 with
//! the maximum norm so that the contracted space is a box again).
//!
//! Geometry is worked out in f64 relative to the scene's own centre and size, so
//! a scene in millimetres and one in kilometres, or one a million units off the
//! origin, give the same picture. What lies so far off for its size that f64 cannot
//! tell its places apart is refused.

use crate::error::FieldError;
use crate::stats::median;
use cairn_scene::{Camera, Capture, SceneKind, View};
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

/// The largest share of a scene's size that numbers may be apart where it lies: half of it, which is what a
/// camera may be off, is less than a fifth of a pixel where a thousand span what is seen three sizes away.
const COARSEST: f64 = 1e-3;

impl SceneFrame {
    /// Chooses the box from a capture: see the module's text for the kinds.
    ///
    /// # Errors
    /// [`FieldError::Frame`] when there are no views, the box has no size, or it lies so far from the origin that
    /// coordinates there are coarser than a thousandth of its size.
    pub fn from_capture(capture: &Capture) -> Result<Self, FieldError> {
        Self::from_views(capture, 0..capture.views.len())
    }

    /// As [`SceneFrame::from_capture`], from some of its views (indices): a wrong pose would move the box.
    ///
    /// # Errors
    /// As there.
    pub fn from_views(capture: &Capture, views: impl IntoIterator<Item = usize>) -> Result<Self, FieldError> {
        let views: Vec<&View> = views.into_iter().map(|v| &capture.views[v]).collect();
        let cameras: Vec<&Camera> = views.iter().map(|v| &v.camera).collect();
        if cameras.is_empty() {
            return Err(FieldError::Frame("the capture has no views".into()));
        }
        let frame = match capture.kind {
            SceneKind::ForwardFacing => {
                let near = views.iter().filter_map(|v| v.bounds.map(|b| b.0)).fold(f64::INFINITY, f64::min);
                Self::forward_facing(&cameras, near, &capture.points)
            }
            SceneKind::Bounded => Self::boxed(&cameras, &[], false),
            SceneKind::Unbounded => Self::boxed(&cameras, &capture.points, true),
        };
        frame.and_then(Self::unless_too_far)
    }

    /// The frame, unless it lies where numbers are too far apart for its size ([`COARSEST`]).
    fn unless_too_far(self) -> Result<Self, FieldError> {
        let (place, size) = match &self {
            Self::ForwardFacing { position, near, .. } => (position, *near),
            Self::Bounded { centre, half } | Self::Unbounded { centre, half } => (centre, half.min_element()),
        };
        let far = place.abs().max_element();
        let apart = far * f64::EPSILON / size;
        if apart > COARSEST {
            return Err(FieldError::Frame(format!(
                "the scene is {size:.1e} units in size and {far:.1e} from the origin, where coordinates are {apart:.1e} of \
                 its size apart (allowed is {COARSEST}): its cameras are no more where they were. Subtract their mean position \
                 from all positions and points in the program that made the capture, and import what it then writes"
            )));
        }
        Ok(self)
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
        // Not `max`, which would hide that there is none.
        let near = if near < foremost * 1.05 { foremost * 1.05 } else { near };
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
                DVec3::new(high[0] - low[0], high[1] - low[1], (high[0] - low[0]).min(high[1] - low[1]) * 0.35)
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

    /// The place in space of a point of the unit cube, homogeneous `[x, y, z, w]` with w >= 0, which is 0 at infinity:
    /// in the frame's own axes, about its own middle, and in lengths of its own. Angles are the world's.
    pub(crate) fn place(&self, unit: DVec3) -> [f64; 4] {
        match self {
            Self::ForwardFacing { low, high, .. } => {
                let slope = |k: usize| low[k] + unit[k] * (high[k] - low[k]);
                [slope(0), slope(1), 1.0, 1.0 - unit.z]
            }
            Self::Bounded { half, .. } => {
                let at = (unit * 2.0 - 1.0) * half / half.max_element();
                [at.x, at.y, at.z, 1.0]
            }
            Self::Unbounded { half, .. } => {
                // The inverse of `contract`: beyond the inner box x = y / (n (2 - n)).
                let at = (unit * 4.0 - 2.0) * half / half.max_element();
                let n = (unit * 4.0 - 2.0).abs().max_element();
                let [at, w] = if n <= 1.0 { [at, DVec3::ONE] } else { [at / n, DVec3::splat(2.0 - n)] };
                [at.x, at.y, at.z, w.x.max(0.0)]
            }
        }
    }

    /// The place of a point of the world, as [`SceneFrame::place`] has it.
    pub(crate) fn place_of(&self, point: DVec3) -> [f64; 4] {
        let at = match self {
            Self::ForwardFacing { rotation, position, near, .. } => *rotation * (point - *position) / *near,
            Self::Bounded { centre, half } | Self::Unbounded { centre, half } => (point - *centre) / half.max_element(),
        };
        [at.x, at.y, at.z, 1.0]
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
    let distance = median(cameras.iter().map(|c| (c.pose.position - focus).length()).collect());
    let slope = median(cameras.iter().map(|c| c.intrinsics.half_width()).collect());
    let spread = (cameras.iter().map(|c| (c.pose.position - middle).length_squared()).sum::<f64>()
        / cameras.len() as f64)
        .sqrt();
    // Cameras that stand together and look outwards: the scene is around them.
    let half = (distance * slope).max(spread * 0.5);
    (focus, if half > 0.0 { half } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Distortion, Intrinsics, LeftOut, Pose, View};

    fn camera(position: DVec3, target: DVec3) -> Camera {
        let distortion = Distortion::default();
        let intrinsics = Intrinsics { width: 200, height: 100, fx: 200.0, fy: 200.0, cx: 100.0, cy: 50.0, distortion };
        Camera { intrinsics, pose: Pose::look_at(position, target, -DVec3::Y).expect("a direction") }
    }

    fn capture(kind: SceneKind, cameras: &[Camera], near: Option<f64>, points: Vec<DVec3>) -> Capture {
        let views = cameras
            .iter()
            .enumerate()
            .map(|(i, camera)| View {
                name: format!("{i}"),
                camera: *camera,
                contributor: String::new(),
                contributor_key: None,
                photograph: "none".into(),
                as_stored: false,
                mask: None,
                support: None,
                held_out: false,
                bounds: near.map(|n| (n, 100.0)),
            })
            .collect();
        Capture { root: ".".into(), kind, background: None, views, points, left_out: LeftOut::default() }
    }

    #[test]
    fn contraction_keeps_the_inside_and_brings_infinity_to_two() {
        let inside = DVec3::new(0.3, -1.0, 0.999);
        assert_eq!(contract(inside), inside);
        // mip-NeRF 360 eq. 10 by hand: (2 - 1/4) (4, 2, -1) / 4.
        assert!((contract(DVec3::new(4.0, 2.0, -1.0)) - DVec3::new(1.75, 0.875, -0.4375)).length() < 1e-15);
        assert!((contract(DVec3::new(0.0, -1e12, 0.0)) - DVec3::new(0.0, -2.0, 0.0)).length() < 1e-11);
        let (a, b) = (contract(DVec3::new(1.0 - 1e-9, 0.5, 0.2)), contract(DVec3::new(1.0 + 1e-9, 0.5, 0.2)));
        assert!((a - b).length() < 1e-8, "no jump at the border");
    }

    #[test]
    fn a_known_point_in_device_coordinates() {
        let frame = SceneFrame::ForwardFacing {
            rotation: DMat3::IDENTITY,
            position: DVec3::new(1.0, 0.0, 0.0),
            near: 2.0,
            low: [-1.0, -0.5],
            high: [1.0, 0.5],
        };
        // At depth 4: x/z = 1/4 of [-1, 1], y/z = -1/4 of [-1/2, 1/2], 1 - 2/4.
        let at = frame.unit(DVec3::new(2.0, -1.0, 4.0)).expect("in front");
        assert!((at - DVec3::new(0.625, 0.25, 0.5)).length() < 1e-15, "{at}");
        assert_eq!(frame.unit(DVec3::new(2.0, -1.0, -4.0)), None);
        // World rays are straight there, and run from the near plane to infinity.
        let (o, d) = (DVec3::new(1.2, 0.1, 0.3), DVec3::new(0.1, -0.05, 1.0));
        let RayPath::Straight { origin, direction, start, end } = frame.path(o, d) else {
            panic!("it crosses the box")
        };
        assert!((start, end) == (0.0, 1.0));
        for t in [2.0, 3.7, 50.0] {
            let point = frame.unit(o + d * (t - 0.3)).expect("in front");
            let s = (point.z - origin[2]) / direction[2];
            let on = DVec3::from(origin) + DVec3::from(direction) * s;
            assert!((on - point).length() < 1e-12, "at depth {t}: {on} for {point}");
        }
        assert_eq!(frame.path(o, DVec3::NEG_Z), RayPath::Miss);
    }

    #[test]
    fn every_pixel_of_a_forward_scene_stays_in_the_cube() {
        let cameras: Vec<Camera> =
            (0..5).map(|i| camera(DVec3::new(f64::from(i) * 0.1, 0.05, 0.0), DVec3::new(0.1, 0.0, 9.0))).collect();
        let frame = SceneFrame::from_capture(&capture(SceneKind::ForwardFacing, &cameras, Some(2.0), Vec::new()))
            .expect("a frame");
        for camera in &cameras {
            for (x, y) in [(0.0, 0.0), (200.0, 0.0), (0.0, 100.0), (200.0, 100.0), (77.0, 31.0)] {
                let (o, d) = camera.ray(x, y);
                let RayPath::Straight { start, end, .. } = frame.path(o, d) else { panic!("it crosses the box") };
                assert!(start < 1e-9 && end > 1.0 - 1e-9, "from {start} to {end}");
            }
        }
        let error = SceneFrame::from_capture(&capture(SceneKind::ForwardFacing, &cameras, None, Vec::new()));
        assert!(error.expect_err("no near plane").to_string().contains("near bounds or sparse points"));
    }

    #[test]
    fn boxes_lie_where_the_cameras_look() {
        let at = DVec3::new(5.0, -2.0, 1.0);
        let cameras: Vec<Camera> = (0..8)
            .map(|i| f64::from(i) * std::f64::consts::FRAC_PI_4)
            .map(|a| camera(at + DVec3::new(4.0 * a.cos(), -1.0, 4.0 * a.sin()), at))
            .collect();
        let SceneFrame::Bounded { centre, half } =
            SceneFrame::from_capture(&capture(SceneKind::Bounded, &cameras, None, Vec::new())).expect("a box")
        else {
            panic!("bounded")
        };
        // Half of what is seen from 17^0.5 away with a field of half a unit a unit, and 5 %.
        let expected = 17f64.sqrt() * 0.5 * 1.05;
        assert!((centre - at).length() < 0.02, "{centre}");
        assert!((half - DVec3::splat(expected)).length() < 0.02, "{half} for {expected}");
        // Points say it better: the middle 90 % of [-1, 1] x [0, 4] x [0, 0.1], widened by a fifth.
        let points = (0..=1000).map(|i| f64::from(i) / 1000.0);
        let points = points.map(|s| at + DVec3::new(2.0 * s - 1.0, 4.0 * s, 0.1 * s)).collect();
        let SceneFrame::Unbounded { centre, half } =
            SceneFrame::from_capture(&capture(SceneKind::Unbounded, &cameras, None, points)).expect("a box")
        else {
            panic!("unbounded")
        };
        assert!((centre - at - DVec3::new(0.0, 2.0, 0.05)).length() < 1e-6, "{centre}");
        // The thin side is kept at a quarter of the longest.
        assert!((half - DVec3::new(1.08, 2.16, 0.54)).length() < 1e-6, "{half}");
        let none = capture(SceneKind::Bounded, &[], None, Vec::new());
        assert!(SceneFrame::from_capture(&none).expect_err("no views").to_string().contains("no views"));
    }

    #[test]
    fn rays_beside_a_box_miss_it() {
        let frame = SceneFrame::Bounded { centre: DVec3::ZERO, half: DVec3::ONE };
        assert_eq!(frame.path(DVec3::new(3.0, 0.0, 0.0), DVec3::X), RayPath::Miss);
        assert_eq!(frame.path(DVec3::new(3.0, 1.5, 0.0), DVec3::NEG_X), RayPath::Miss);
        let RayPath::Straight { start, end, .. } = frame.path(DVec3::new(3.0, 0.5, 0.0), DVec3::NEG_X) else {
            panic!("it crosses the box")
        };
        assert!((start - 2.0).abs() < 1e-12 && (end - 4.0).abs() < 1e-12);
        let RayPath::Straight { start, .. } = frame.path(DVec3::ZERO, DVec3::X) else { panic!("it starts inside") };
        assert_eq!(start, 0.0);
    }
}
