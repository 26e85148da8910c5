//! A camera that many matches agree on.
//!
//! A match says more than a point and a place: how much larger the picture shows it than a known view does, and how far
//! it is turned. So one match alone is a rough camera: the view's, turned and with a longer lens. Lowe (2004, section 7.3)
//! has each match vote for such a pose. Among the matches that agree roughly, fours are drawn (RANSAC, Fischler and Bolles
//! 1981). Each is solved for pose and focal length by Newton's steps from the rough camera; a solver in closed form would
//! need the focal length. The best camera is refined on all that agree.
//!
//! What agrees by chance is counted *a contrario* (Moisan and Stival 2004; for cameras Moulon, Monasse and Marlet 2012).
//! Of n matches k lie within a share `a` of the picture from where the camera has them. Were they anywhere, one expects
//! `(n - 4) C(n, k) C(k, 4) a^(k - 4)` fours with agreements so good. The logarithm of that says how sure a camera is, and
//! the radius is the one at which it is least. It assumes that wrong matches are independent of one another.

use crate::alignment::{Covariance, NUMBERS, Normal, changed, units};
use crate::index::Index;
use crate::matching::Match;
use cairn_scene::{Camera, Intrinsics};
use glam::{DMat3, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Matches that are looked at, at most: the surest.
const MATCHES: usize = 1000;
/// Matches whose cameras are tried, at most.
const ROUGH: usize = 400;
/// Rough cameras that are followed.
const FOLLOWED: usize = 16;
/// Fours that are drawn for each.
const DRAWN: usize = 300;
/// Matches that a camera is solved from.
const FOUR: usize = 4;
/// How far off a match may be from a rough camera, shares of the picture's diagonal,
const ROUGHLY: f64 = 0.12;
/// in the logarithm of its size,
const SIZE: f64 = 0.5;
/// and in turn, radians.
const TURN: f64 = 0.5;
/// Largest distance at which a match can agree, shares of the picture's diagonal.
const AGREES: f64 = 0.02;
/// Matches that are off by less agree alike, px: keypoints are found as well as that.
const MIN_OFF_PX: f64 = 0.5;
/// How far a focal length is expected from what a rough camera has, standard deviation of its logarithm.
const FOCAL: f64 = 0.3;
/// How far a number goes for a slope, units.
const PROBE: f64 = 1e-2;
/// How far a principal point is expected from the middle, shares of the longer side: pictures are cut.
const PRINCIPAL: f64 = 0.15;
/// How far a first radial coefficient is expected from what a rough camera has; assumed.
const BENT: f64 = 0.1;
/// How much a picture is expected to be stretched downwards, standard deviation of its logarithm: both sides of a picture
/// of 80 px are rounded to pixels (0.29 px each).
const STRETCHED: f64 = 0.005;

/// A camera with the matches that agree on it.
#[derive(Clone, Debug)]
pub(crate) struct Agreed {
    pub(crate) camera: Camera,
    /// What was expected of its lens.
    pub(crate) lens: Intrinsics,
    /// Numbers of the matches that agree.
    pub(crate) matches: Vec<usize>,
    /// Negative decimal logarithm of how many agreements as good one expects by chance.
    pub(crate) surprise: f64,
    /// How far off the farthest that agrees is, px.
    pub(crate) within_px: f64,
}

/// The camera that most surprisingly many of `matches` agree on, of a picture of `size` px; `None` where there are too
/// few.
pub(crate) fn agreed(index: &Index, matches: &[Match], size: [usize; 2]) -> Option<Agreed> {
    let matches = &matches[..matches.len().min(MATCHES)];
    if matches.len() <= FOUR {
        return None;
    }
    let diagonal = (size[0] as f64).hypot(size[1] as f64);
    let rough = |m: &Match| {
        let camera = rough(index, m, size);
        let with: Vec<usize> = (0..matches.len()).filter(|k| roughly(&camera, m, &matches[*k], diagonal)).collect();
        (camera, with)
    };
    let mut cameras: Vec<(Camera, Vec<usize>)> = matches[..matches.len().min(ROUGH)].par_iter().map(rough).collect();
    cameras.retain(|(_, with)| with.len() > FOUR);
    cameras.sort_by_key(|(_, with)| std::cmp::Reverse(with.len()));
    cameras.truncate(FOLLOWED);
    let chance = Chance::of_picture(size);
    let of = |k: usize| {
        let (camera, with) = &cameras[k];
        let mut rng = ChaCha8Rng::seed_from_u64(k as u64);
        let mut best: Option<Agreed> = None;
        for _ in 0..DRAWN {
            let four = drawn(with.len(), &mut rng).map(|k| matches[with[k]]);
            let lens = &camera.intrinsics;
            let Some(camera) = solved(camera, &four, index.reach, &Solve::four(lens)) else { continue };
            let found = chance.of(&camera, lens, matches);
            if best.as_ref().is_none_or(|b| found.surprise > b.surprise) {
                best = Some(refined(found, matches, index.reach, &chance));
            }
        }
        best
    };
    let best = (0..cameras.len()).into_par_iter().filter_map(of);
    best.reduce_with(|a, b| if b.surprise > a.surprise { b } else { a })
}

/// Four different numbers below `n`, which is above that.
fn drawn(n: usize, rng: &mut ChaCha8Rng) -> [usize; FOUR] {
    let mut four = [usize::MAX; FOUR];
    for k in 0..FOUR {
        four[k] = loop {
            let next = rng.random_range(0..n);
            if !four[..k].contains(&next) {
                break next;
            }
        };
    }
    four
}

/// `found`, refined on the matches that agree for as long as that surprises more.
pub(crate) fn refined(mut found: Agreed, matches: &[Match], reach: f64, chance: &Chance) -> Agreed {
    for _ in 0..4 {
        let with: Vec<Match> = found.matches.iter().map(|k| matches[*k]).collect();
        let numbers = if with.len() >= 8 { NUMBERS } else { 7 };
        let spread_px = (found.within_px / 3.0).max(MIN_OFF_PX);
        let how = Solve { lens: &found.lens, numbers, steps: 10, spread_px, expected: 1.0 };
        let Some(camera) = solved(&found.camera, &with, reach, &how) else { break };
        let next = chance.of(&camera, &found.lens, matches);
        if next.surprise <= found.surprise {
            break;
        }
        found = next;
    }
    found
}

/// The view's camera, turned, with the focal length and in the direction by which it shows the place where the picture does.
fn rough(index: &Index, m: &Match, [width, height]: [usize; 2]) -> Camera {
    let view = &index.cameras[m.view as usize];
    let mut camera = *view;
    let i = &mut camera.intrinsics;
    (i.width, i.height) = (width, height);
    (i.fx, i.fy) = (i.fx * m.larger, i.fy * m.larger);
    (i.cx, i.cy) = (width as f64 / 2.0, height as f64 / 2.0);
    // What the view saw along d the picture shows along the turned d.
    camera.pose.rotation = view.pose.rotation * DMat3::from_rotation_z(-m.turned);
    let towards = (camera.pose.rotation.transpose() * (m.place - camera.pose.position)).normalize_or_zero();
    let wanted = camera.direction(m.at.x, m.at.y).normalize_or_zero();
    if towards != DVec3::ZERO && wanted != DVec3::ZERO {
        let turn = DMat3::from_quat(glam::DQuat::from_rotation_arc(wanted, towards));
        camera.pose.rotation *= turn;
    }
    camera
}

/// Whether `other` agrees with the rough camera of `m`.
fn roughly(camera: &Camera, m: &Match, other: &Match, diagonal: f64) -> bool {
    let turn = (other.turned - m.turned).rem_euclid(std::f64::consts::TAU);
    (other.larger / m.larger).ln().abs() < SIZE
        && turn.min(std::f64::consts::TAU - turn) < TURN
        && camera.project(other.place).is_some_and(|at| (at - other.at).length() < ROUGHLY * diagonal)
}

/// How a camera is solved for.
pub(crate) struct Solve<'a> {
    /// What is expected of the lens: what the view has of which a keypoint is known. The principal point is expected in the
    /// middle.
    pub(crate) lens: &'a Intrinsics,
    /// So many of its numbers, the first ones, are moved.
    pub(crate) numbers: usize,
    /// Steps, at most.
    pub(crate) steps: usize,
    /// Spread of the matches' distances, px.
    pub(crate) spread_px: f64,
    /// How much an expectation of a whole standard deviation counts, px squared.
    pub(crate) expected: f64,
}

impl<'a> Solve<'a> {
    /// From four matches, exactly: no match is an outlier.
    fn four(lens: &'a Intrinsics) -> Self {
        Self { lens, numbers: 7, steps: 8, spread_px: 1e3, expected: 1.0 }
    }
}

/// What matches say of a camera near `now`, with what is expected of focal lengths, principal points and distortion.
struct Equations<'a> {
    matches: &'a [Match],
    reach: f64,
    how: &'a Solve<'a>,
    /// Longer side, px.
    longest: f64,
    /// Where principal points are expected, px.
    middle: DVec2,
    /// What focal lengths are expected, px.
    focal: f64,
    /// What first radial coefficients are expected.
    bent: f64,
    /// What ratios of focal lengths, down to across, are expected.
    stretched: f64,
}

impl Equations<'_> {
    /// The robust cost (Cauchy's), px squared.
    fn cost(&self, camera: &Camera) -> f64 {
        let spread = self.how.spread_px.powi(2);
        let off = |m: &Match| camera.project(m.place).map_or(1e6, |at| (at - m.at).length_squared());
        let i = &camera.intrinsics;
        let aside = (DVec2::new(i.cx, i.cy) - self.middle) / (PRINCIPAL * self.longest);
        let focal = (i.fx / self.focal).ln() / FOCAL;
        let bent = (i.distortion.first_radial() - self.bent) / BENT;
        let stretched = (i.fy / i.fx / self.stretched).ln() / STRETCHED;
        let expected = focal.powi(2) + aside.length_squared() + bent.powi(2) + stretched.powi(2);
        let each = |m: &Match| (1.0 + off(m) / spread).ln() * spread;
        self.matches.iter().map(each).sum::<f64>() + self.how.expected * expected
    }

    fn normal(&self, now: &Camera, units: &[f64; NUMBERS]) -> Normal {
        let mut normal = Normal::default();
        for m in self.matches {
            let Some(at) = now.project(m.place) else { continue };
            let mut slopes = [[0.0; NUMBERS]; 2];
            for k in 0..self.how.numbers {
                let step: [f64; NUMBERS] = std::array::from_fn(|n| if n == k { PROBE } else { 0.0 });
                let Some(there) = changed(now, &step, units).project(m.place) else { continue };
                (slopes[0][k], slopes[1][k]) = ((there.x - at.x) / PROBE, (there.y - at.y) / PROBE);
            }
            let off = m.at - at;
            let weight = 1.0 / (1.0 + off.length_squared() / self.how.spread_px.powi(2));
            normal.add(&slopes[0], off.x, weight);
            normal.add(&slopes[1], off.y, weight);
        }
        let i = &now.intrinsics;
        let aside = PRINCIPAL * self.longest;
        let expected = [
            (6, units[6] / FOCAL, -(i.fx / self.focal).ln() / FOCAL),
            (7, units[7] / aside, (self.middle.x - i.cx) / aside),
            (8, units[8] / aside, (self.middle.y - i.cy) / aside),
            (9, units[9] / BENT, (self.bent - i.distortion.first_radial()) / BENT),
            (10, units[10] / STRETCHED, -(i.fy / i.fx / self.stretched).ln() / STRETCHED),
        ];
        for (k, unit, off) in expected.into_iter().filter(|(k, ..)| *k < self.how.numbers) {
            let slopes = std::array::from_fn(|n| if n == k { unit } else { 0.0 });
            normal.add(&slopes, off, self.how.expected);
        }
        normal
    }
}

fn equations<'a>(matches: &'a [Match], reach: f64, how: &'a Solve<'a>) -> Equations<'a> {
    let i = how.lens;
    let middle = DVec2::new(i.width as f64, i.height as f64) / 2.0;
    let (longest, bent) = (i.width.max(i.height) as f64, i.distortion.first_radial());
    Equations { matches, reach, how, longest, middle, focal: i.fx, bent, stretched: i.fy / i.fx }
}

/// The camera at which `matches` lie best: Levenberg and Marquardt's steps from `camera`, with Cauchy's weights, and what
/// is expected of the lens. `None` where a number of it is not finite.
pub(crate) fn solved(camera: &Camera, matches: &[Match], reach: f64, how: &Solve<'_>) -> Option<Camera> {
    let equations = equations(matches, reach, how);
    let (mut now, mut damping) = (*camera, 1e-4);
    let mut before = equations.cost(&now);
    for _ in 0..how.steps {
        let units = units(&now, equations.reach, equations.longest);
        let normal = equations.normal(&now, &units);
        let mut moved = None;
        for _ in 0..4 {
            let step = normal.step(damping)?;
            let next = changed(&now, &step, &units);
            let after = equations.cost(&next);
            if after < before {
                damping = (damping * 0.1).max(1e-9);
                moved = Some((next, after));
                break;
            }
            damping *= 30.0;
        }
        let Some((next, after)) = moved else { break };
        now = next;
        if before - after < 1e-6 * before {
            break;
        }
        before = after;
    }
    let i = &now.intrinsics;
    let finite =
        now.pose.position.is_finite() && now.pose.rotation.is_finite() && (i.fx * i.fy * i.cx * i.cy).is_finite();
    (finite && i.fx > 0.0).then_some(now)
}

/// How far off the camera may be on which `matches` agree.
pub(crate) fn certainty(camera: &Camera, lens: &Intrinsics, matches: &[Match], reach: f64) -> Option<Covariance> {
    let off = |m: &Match| camera.project(m.place).map(|at| (at - m.at).length());
    let off: Vec<f64> = matches.iter().filter_map(off).collect();
    // Two numbers a match, and what is left of them once eleven are fitted.
    let free = (2 * off.len()).checked_sub(NUMBERS).filter(|free| *free > 0)?;
    let variance = off.iter().map(|d| d * d).sum::<f64>() / free as f64;
    let how = Solve { lens, numbers: NUMBERS, steps: 0, spread_px: 1e3, expected: variance };
    let equations = equations(matches, reach, &how);
    let units = units(camera, reach, equations.longest);
    Covariance::by(units, &equations.normal(camera, &units), variance)
}

/// How likely an agreement is by chance.
pub(crate) struct Chance {
    /// Logarithm of the share of places that a match could have that lie within a pixel.
    pixel: f64,
    /// Largest distance at which a match can agree, px.
    max_px: f64,
}

impl Chance {
    /// Matches that could be anywhere in a picture of that size, px.
    pub(crate) fn of_picture([width, height]: [usize; 2]) -> Self {
        let (w, h) = (width as f64, height as f64);
        Self { pixel: (std::f64::consts::PI / (w * h)).ln(), max_px: (AGREES * w.hypot(h)).max(4.0 * MIN_OFF_PX) }
    }

    /// Matches that were looked for within `radius_px`.
    pub(crate) fn within(radius_px: f64) -> Self {
        Self { pixel: -2.0 * radius_px.ln(), max_px: radius_px / 2.0 }
    }

    /// The matches that agree on `camera`: as many as are least expected.
    pub(crate) fn of(&self, camera: &Camera, lens: &Intrinsics, matches: &[Match]) -> Agreed {
        let off = |k: usize| camera.project(matches[k].place).map(|at| ((at - matches[k].at).length(), k));
        let mut off: Vec<(f64, usize)> =
            (0..matches.len()).filter_map(off).filter(|(d, _)| *d <= self.max_px).collect();
        off.sort_by(|a, b| a.0.total_cmp(&b.0));
        let n = matches.len();
        let (mut log_n_k, mut log_k_4) = (0.0, 0.0);
        let (mut best, mut kept) = (f64::INFINITY, 0);
        for k in 1..=off.len() {
            log_n_k += ((n + 1 - k) as f64 / k as f64).ln();
            if k <= FOUR {
                continue;
            }
            log_k_4 += (k as f64 / (k - FOUR) as f64).ln();
            let within = off[k - 1].0.max(MIN_OFF_PX);
            let expected = ((n - FOUR) as f64).ln()
                + log_n_k
                + log_k_4
                + (k - FOUR) as f64 * (self.pixel + 2.0 * within.ln()).min(0.0);
            if expected < best {
                (best, kept) = (expected, k);
            }
        }
        Agreed {
            camera: *camera,
            lens: *lens,
            within_px: if kept == 0 { 0.0 } else { off[kept - 1].0.max(MIN_OFF_PX) },
            matches: off[..kept].iter().map(|(_, k)| *k).collect(),
            surprise: if kept == 0 { f64::NEG_INFINITY } else { -best / std::f64::consts::LN_10 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::index::Point;
    use cairn_scene::{Distortion, Pose};

    const SIZE_PX: [usize; 2] = [300, 200];

    fn view(position: DVec3) -> Camera {
        let [width, height] = SIZE_PX;
        let intrinsics =
            Intrinsics { width, height, fx: 280.0, fy: 280.0, cx: 150.0, cy: 100.0, distortion: Distortion::default() };
        Camera { intrinsics, pose: Pose::look_at(position, DVec3::ZERO, DVec3::Z).unwrap() }
    }

    /// An index of one view, and so many places.
    fn index(places: &[DVec3]) -> Index {
        let camera = view(DVec3::new(4.0, 0.0, 1.0));
        let point = |place: &DVec3| Point {
            place: (*place - camera.pose.position).as_vec3(),
            span: 0.01,
            scale: 2.0,
            angle: 0.0,
            view: 0,
        };
        Index {
            cameras: vec![camera],
            names: vec!["view".into()],
            reach: 4.0,
            points: places.iter().map(point).collect(),
            descriptors: vec![[0; crate::keypoints::DESCRIPTOR]; places.len()],
        }
    }

    fn places(count: usize, rng: &mut ChaCha8Rng) -> Vec<DVec3> {
        let mut number = || rng.random_range(-1.0..1.0);
        (0..count).map(|_| DVec3::new(number(), number(), number())).collect()
    }

    /// The camera of a picture: elsewhere, turned, with another lens, cut.
    fn truth() -> Camera {
        let mut camera = view(DVec3::new(3.6, 1.1, 0.7));
        camera.pose.rotation *= DMat3::from_rotation_z(0.5);
        let i = &mut camera.intrinsics;
        (i.fx, i.fy, i.cx, i.cy) = (230.0, 230.0, 140.0, 115.0);
        camera
    }

    /// A match of each place with where `camera` has it to `noise_px`, or with anywhere.
    fn matched(camera: &Camera, places: &[DVec3], right: usize, noise_px: f64, rng: &mut ChaCha8Rng) -> Vec<Match> {
        let mut all = Vec::new();
        for (k, place) in places.iter().enumerate() {
            let mut off = || rng.random_range(-1.0..1.0);
            let at = if k < right {
                camera.project(*place).unwrap() + noise_px * DVec2::new(off(), off())
            } else {
                DVec2::new(150.0 * (1.0 + off()), 100.0 * (1.0 + off()))
            };
            let turned = if k < right { 0.5 + 0.1 * off() } else { 3.0 * off() };
            let larger = if k < right { 0.82 + 0.1 * off() } else { 1.0 + 0.5 * off() };
            all.push(Match { at, place: *place, view: 0, larger, turned: -turned, ratio: 0.5 });
        }
        all
    }

    fn off_px(a: &Camera, b: &Camera, places: &[DVec3]) -> f64 {
        places.iter().map(|p| (a.project(*p).unwrap() - b.project(*p).unwrap()).length()).fold(0.0, f64::max)
    }

    #[test]
    fn a_camera_is_found_among_four_wrong_matches_for_a_right_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let places = places(200, &mut rng);
        let matches = matched(&truth(), &places, 40, 0.5, &mut rng);
        let found = agreed(&index(&places), &matches, SIZE_PX).expect("a camera");
        let off = off_px(&found.camera, &truth(), &places[..40]);
        assert!(off < 1.0, "{off} px, {} agree", found.matches.len());
        assert!(found.surprise > 40.0 && found.matches.iter().filter(|k| **k < 40).count() > 35, "{}", found.surprise);
        // Of what is known so well it is said how well.
        let with: Vec<Match> = found.matches.iter().map(|k| matches[*k]).collect();
        let certain =
            certainty(&found.camera, &found.lens, &with, 4.0).unwrap().median_px(&found.camera, &places[..40]);
        assert!((0.03..0.5).contains(&certain), "{certain} px");
    }

    #[test]
    fn matches_with_anywhere_surprise_less_often_than_is_said() {
        let mut largest = f64::NEG_INFINITY;
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
            let places = places(150, &mut rng);
            let matches = matched(&truth(), &places, 0, 0.0, &mut rng);
            if let Some(found) = agreed(&index(&places), &matches, SIZE_PX) {
                largest = largest.max(found.surprise);
            }
        }
        // One in ten is as good as one in ten; nothing near one in a million.
        assert!(largest < 3.0, "{largest}");
    }

    #[test]
    fn four_matches_agree_with_any_camera_and_say_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let places = places(5, &mut rng);
        assert!(agreed(&index(&places), &matched(&truth(), &places[..4], 4, 0.0, &mut rng), SIZE_PX).is_none());
        let five = agreed(&index(&places), &matched(&truth(), &places, 5, 0.0, &mut rng), SIZE_PX);
        assert!(five.is_none_or(|found| found.surprise < 6.0));
        assert!(
            certainty(&truth(), &truth().intrinsics, &matched(&truth(), &places[..4], 4, 0.0, &mut rng), 4.0).is_none()
        );
    }
}
