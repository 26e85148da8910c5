//! Fisheye lenses: how far a direction lies off the axis becomes how far it lands from the principal point.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// An equidistant fisheye with a polynomial of ninth order. A direction at the angle `t` off the optical axis lands
/// `r(t) = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)` focal lengths from the principal point, on the axis's side where
/// it lies.
///
/// Source: COLMAP, src/colmap/sensor/models.h, `OpenCVFisheyeCameraModel::ImgFromCam` (`FisheyeFromNormal`, then
/// `Distortion`), which is OpenCV's `cv::fisheye`. SIMPLE_RADIAL_FISHEYE has k1 alone. COLMAP takes `t` as
/// `atan(hypot(x, y) / z)` and projects what lies ahead only. Here `t` is `atan2(hypot(x, y), z)`: the same angle
/// ahead, and the one that goes on to the side and behind, up to 180 degrees.
///
/// `r` grows from 0 where its slope, a polynomial in `t^2` that is 1 on the axis, is above 0. The widest angle that the
/// lens has is therefore the first root of the slope, or 180 degrees where there is none before. Up to there each
/// distance belongs to one angle; what lies farther off is not seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Coefficients", into = "Coefficients")]
pub struct Fisheye {
    k: [f64; 4],
    /// The widest angle off the axis, radians.
    widest: f64,
}

/// A fisheye as it is stored.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Coefficients {
    k1: f64,
    k2: f64,
    k3: f64,
    k4: f64,
}

/// A fisheye that ends within its picture, so that the rays beyond have no direction.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error(
    "the fisheye ends {:.1} degrees off its axis, {radius:.4} focal lengths from the principal point, {}; the picture's farthest corner lies {corner:.4} out, and no ray leads there; calibrate it with fewer coefficients, crop the photographs, or undistort them (`colmap image_undistorter`)",
    widest.to_degrees(), if *widest < PI { "where its polynomial turns back" } else { "straight behind the camera" }
)]
pub struct LensError {
    /// The widest angle off the axis that the lens has, radians.
    pub widest: f64,
    /// Where that lands, focal lengths from the principal point.
    pub radius: f64,
    /// How far the picture's farthest corner lies, focal lengths from the principal point.
    pub corner: f64,
}

impl Fisheye {
    /// The lens with the coefficients k1 to k4, dimensionless.
    pub fn new(k: [f64; 4]) -> Self {
        // d r / d t, as a polynomial in t^2.
        let slope = [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]];
        let widest = roots(&slope, PI * PI).first().map_or(PI, |root| root.sqrt());
        Self { k, widest }
    }

    /// k1 to k4.
    pub fn k(&self) -> [f64; 4] {
        self.k
    }

    /// The widest angle off the axis that the lens has, radians, above 0, at most pi.
    pub fn widest(&self) -> f64 {
        self.widest
    }

    /// How far from the principal point what is `angle` (radians, 0 to [`Fisheye::widest`]) off the axis lands, focal
    /// lengths.
    pub fn radius(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        let t2 = angle * angle;
        angle * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    }

    fn slope(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        let t2 = angle * angle;
        1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
    }

    /// The angle off the axis of what lands `radius` focal lengths from the principal point: 0 to
    /// [`Fisheye::widest`], radians, and that one for whatever lies farther out.
    ///
    /// Newton's method on [`Fisheye::radius`]. As that grows all the way, the angle always lies between the nearest one
    /// tried that lands too near and the nearest that lands too far. A step that leaves these two, or that is not half
    /// as long as the one before, is replaced by their middle. So the steps or the bounds halve each time, and it ends.
    pub fn angle(&self, radius: f64) -> f64 {
        // What is no number lies nowhere nearer.
        if radius.is_nan() || radius >= self.radius(self.widest) {
            return self.widest;
        }
        let exact = 2.0 * f64::EPSILON;
        let (mut near, mut far) = (0.0, self.widest);
        let (mut angle, mut step) = (radius.clamp(near, far), f64::INFINITY);
        for _ in 0..200 {
            let off = self.radius(angle) - radius;
            if off > 0.0 {
                far = angle;
            } else {
                near = angle;
            }
            let newton = angle - off / self.slope(angle);
            if (newton - angle).abs() <= exact * angle || far - near <= exact * angle {
                break;
            }
            let sound = near < newton && newton < far && (newton - angle).abs() <= 0.5 * step;
            let next = if sound { newton } else { near + 0.5 * (far - near) };
            step = (next - angle).abs();
            angle = next;
        }
        angle
    }

    /// Where a direction in the camera's axes (any length) lands, focal lengths from the principal point. `None` for
    /// one farther off the axis than [`Fisheye::widest`], and for straight behind, which is no one place.
    pub(crate) fn project(&self, direction: DVec3) -> Option<DVec2> {
        let across = direction.x.hypot(direction.y);
        let angle = across.atan2(direction.z);
        if across == 0.0 {
            return (direction.z > 0.0).then_some(DVec2::ZERO);
        }
        (angle <= self.widest).then(|| direction.truncate() * (self.radius(angle) / across))
    }

    /// The direction, of unit length and in the camera's axes, of what lands `at` (focal lengths from the principal
    /// point). Beyond the lens it is the last direction that the lens has on that side.
    pub(crate) fn direction(&self, at: DVec2) -> DVec3 {
        let radius = at.x.hypot(at.y);
        // On the axis every side is the same, and what is not finite is on none.
        let side = if radius > 0.0 && radius.is_finite() { at / radius } else { DVec2::X };
        let (sin, cos) = self.angle(radius).sin_cos();
        (side * sin).extend(cos)
    }
}

impl From<Coefficients> for Fisheye {
    fn from(Coefficients { k1, k2, k3, k4 }: Coefficients) -> Self {
        Self::new([k1, k2, k3, k4])
    }
}

impl From<Fisheye> for Coefficients {
    fn from(Fisheye { k: [k1, k2, k3, k4], .. }: Fisheye) -> Self {
        Self { k1, k2, k3, k4 }
    }
}

/// Where the polynomial (its constant first) changes its sign between 0 and `end`, ascending. Between neighbouring
/// roots of its derivative a polynomial is monotone, and so has one such place at most: halving finds it.
fn roots(polynomial: &[f64], end: f64) -> Vec<f64> {
    if polynomial.len() < 2 {
        return Vec::new();
    }
    let value = |x: f64| polynomial.iter().rev().fold(0.0, |sum, c| sum * x + c);
    let derivative: Vec<f64> = (1u32..).zip(&polynomial[1..]).map(|(n, c)| f64::from(n) * c).collect();
    let (mut found, mut from) = (Vec::new(), 0.0);
    for to in roots(&derivative, end).into_iter().chain([end]) {
        let rises = value(from) < 0.0;
        if rises != (value(to) < 0.0) {
            let (mut low, mut high) = (from, to);
            // As often as a number has digits, and some.
            for _ in 0..64 {
                let middle = 0.5 * (low + high);
                if (value(middle) < 0.0) == rises {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            // Before it, where the sign is still the one it had.
            found.push(low);
        }
        from = to;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ideal; as action cameras have it; bulging; with a bend that comes close to turning back (slope 0.02) and does not.
    const LENSES: [[f64; 4]; 4] =
        [[0.0; 4], [-0.03, 0.004, -0.003, 0.0004], [0.09, 0.02, 0.01, 0.003], [-0.3, 0.04133, 0.0, 0.0]];

    #[test]
    fn directions_come_back_over_the_whole_picture() {
        for (k, wide_deg) in LENSES.into_iter().flat_map(|k| [20.0, 90.0, 170.0, 178.0, 220.0, 359.0].map(|w| (k, w))) {
            let lens = Fisheye::new(k);
            let corner = lens.radius((wide_deg / 2.0f64).to_radians().min(lens.widest()));
            for i in 0..=40 {
                for j in 0..24 {
                    let (out, around) = (corner * f64::from(i) / 40.0, f64::from(j) * PI / 12.0);
                    let at = DVec2::from_angle(around) * out;
                    let direction = lens.direction(at);
                    assert!((direction.length() - 1.0).abs() < 1e-14, "{k:?}");
                    // A length does not matter.
                    let back = lens.project(direction * 7.5).unwrap();
                    assert!((back - at).length() < 1e-12 * (1.0 + out), "{k:?}, {wide_deg} degrees: {back} for {at}");
                }
            }
        }
    }

    #[test]
    fn angles_come_back_also_where_the_slope_is_small() {
        for k in LENSES {
            let lens = Fisheye::new(k);
            for i in 0..=2000 {
                let angle = lens.widest() * f64::from(i) / 2000.0;
                let off = (lens.angle(lens.radius(angle)) - angle).abs();
                // What rounding of the radius makes of the angle.
                let allowed = 16.0 * f64::EPSILON * (1.0 + lens.radius(angle) / lens.slope(angle).max(1e-9));
                assert!(off <= allowed, "{k:?} at {angle}: {off} off, allowed is {allowed}");
            }
        }
    }

    #[test]
    fn the_widest_angle_is_where_the_polynomial_turns_back() {
        // 1 + 3 k1 t^2 = 0.
        assert!((Fisheye::new([-0.25, 0.0, 0.0, 0.0]).widest() - (4.0f64 / 3.0).sqrt()).abs() < 1e-15);
        // (1 - t^2) (1 - t^2 / 4): the first of two roots.
        let two = Fisheye::new([-1.25 / 3.0, 0.25 / 5.0, 0.0, 0.0]);
        assert!((two.widest() - 1.0).abs() < 1e-14, "{}", two.widest());
        // (1 - t^2 / 2) (1 + t^2 / 3) (1 + t^4): one root, and a polynomial of full order.
        let full = Fisheye::new([-1.0 / 18.0, (1.0 - 1.0 / 6.0) / 5.0, -1.0 / 42.0, -1.0 / 54.0]);
        assert!((full.widest() - 2f64.sqrt()).abs() < 1e-14, "{}", full.widest());
        assert_eq!(Fisheye::new([0.1, 0.0, 0.0, 0.0]).widest(), PI);
        // Against many small steps.
        let mut turned = 0;
        for n in 0..625 {
            let k = [0, 1, 2, 3].map(|i| [-0.4, -0.07, 0.0, 0.03, 0.2][n / 5usize.pow(i) % 5]);
            let lens = Fisheye::new(k);
            let first = (0..20_000).map(|i| PI * f64::from(i) / 20_000.0).find(|t| lens.slope(*t) <= 0.0);
            let apart = first.unwrap_or(PI) - lens.widest();
            assert!((0.0..PI / 10_000.0).contains(&apart), "{k:?}: {} for {first:?}", lens.widest());
            turned += usize::from(first.is_some());
        }
        assert!((200..600).contains(&turned), "{turned} of 625 turn back");
    }

    #[test]
    fn what_the_lens_does_not_see_has_no_place_and_the_last_direction() {
        let lens = Fisheye::new([-0.25, 0.0, 0.0, 0.0]);
        let at = |angle: f64| lens.project(DVec3::new(0.0, angle.sin(), angle.cos()));
        assert!(at(lens.widest() - 1e-9).is_some() && at(lens.widest() + 1e-9).is_none());
        let last = lens.direction(DVec2::Y * lens.radius(lens.widest()));
        for far in [0.8, 1e3, 1e300] {
            assert_eq!(lens.direction(DVec2::Y * far), last, "{far}");
        }
        let ideal = Fisheye::new([0.0; 4]);
        // Beside the camera, behind it, and straight behind.
        assert!((ideal.project(DVec3::X).unwrap() - DVec2::X * PI / 2.0).length() < 1e-15);
        assert!((ideal.project(DVec3::new(0.0, 1.0, -1.0)).unwrap() - DVec2::Y * 0.75 * PI).length() < 1e-15);
        assert_eq!(ideal.project(-DVec3::Z), None);
        assert_eq!(ideal.project(DVec3::Z), Some(DVec2::ZERO));
        assert_eq!(ideal.project(DVec3::ZERO), None);
        assert_eq!(ideal.direction(DVec2::ZERO), DVec3::Z);
    }

    #[test]
    fn numbers_that_are_none_give_finite_directions() {
        let odd = [f64::NAN, f64::INFINITY, -1e300, 1e300, f64::MIN_POSITIVE];
        for n in 0..odd.len().pow(2) {
            let (a, b) = (odd[n % odd.len()], odd[n / odd.len()]);
            for k in [[0.0; 4], [a, 0.0, b, 0.0], [0.0, a, 0.0, b]] {
                let lens = Fisheye::new(k);
                assert!(lens.widest() >= 0.0 && lens.widest() <= PI, "{k:?}: {}", lens.widest());
                let direction = lens.direction(DVec2::new(a, b));
                assert!((direction.length() - 1.0).abs() < 1e-12, "{k:?} at {a}, {b}: {direction}");
            }
        }
    }

    #[test]
    fn it_is_stored_as_its_coefficients() {
        let lens = Fisheye::new([-0.03, 1.0 / 3.0, -0.003, 1e-17]);
        let json = serde_json::to_string(&lens).unwrap();
        assert_eq!(json, r#"{"k1":-0.03,"k2":0.3333333333333333,"k3":-0.003,"k4":1e-17}"#);
        assert_eq!(serde_json::from_str::<Fisheye>(&json).unwrap(), lens);
        assert!(serde_json::from_str::<Fisheye>(r#"{"k1":1,"k2":1,"k3":1}"#).is_err());
    }
}
