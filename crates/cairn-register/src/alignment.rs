//! From about where a picture was taken to exactly where: Levenberg and Marquardt's steps on the difference of
//! colours. Slopes are differences of renders: nothing is assumed of depths, and every pixel is what the
//! renderer makes of it. What fits nowhere (a black corner, something stuck over the picture) loses its say by
//! Tukey's weights.
//!
//! The light is a linear regression by the same weights at every place. So a step is judged in the light that it was worked
//! out in. Where it was not, steps led nowhere, and pictures settled beside their places.

pub(super) use super::matrix::{NUMBERS, Normal};
use super::windows::Level;
use cairn_field::Field;
use cairn_field::appearance::cholesky::{factor, solve};
use cairn_field::appearance::prior::Prior;
use cairn_field::rays::lens::{Eye, Lens};
use cairn_field::stats::median;
use cairn_field::{Appearance, appearance::code::FEATURES};
use cairn_scene::Camera;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Where Tukey's weights end, in robust standard deviations.
const TUKEY: f64 = 4.685;
/// A number goes so far for a slope that pixels move by about that, pixels of the level.
const UNIT_PX: f64 = 0.4;
/// A step whose square is smaller teaches rounding alone, units squared.
const MIN_LEARNT: f64 = 1e-8;
/// Steps that are tried from a place, each shorter than the one before.
const TRIES: usize = 5;
/// Damping that is felt: a step that leads nowhere is damped by that at least.
const DAMPED: f64 = 1e-4;
/// Steps that slopes are learnt from before they are worked out anew.
const LEARNT: usize = 4;

/// What a picture is compared with.
pub(super) struct Against<'a> {
    pub(super) field: &'a Field,
    /// What light to expect.
    pub(super) prior: &'a Prior,
    /// How far off what is seen is, capture units.
    pub(super) reach: f64,
}

/// How a level is gone through.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pass {
    /// Steps, at most.
    pub(super) steps: usize,
    /// A step that moves pixels by less ends it, pixels of the level.
    pub(super) settled_px: f64,
    /// The smallest spread of differences: what is off by more times it is an outlier, colours in [0, 1].
    pub(super) min_spread: f64,
    /// Whether it is asked how far off the camera may be: nine renders more.
    pub(super) is_last: bool,
}

/// A place, refined on one level.
#[derive(Clone, Debug)]
pub(super) struct Refined {
    pub(super) camera: Camera,
    pub(super) appearance: Appearance,
    /// Share of the pixels' variance that is explained, by the weights that they ended with.
    pub(super) explained: f64,
    /// How far off the camera may be, after a last pass; `None` where the windows do not determine one.
    pub(super) covariance: Option<Covariance>,
}

/// What the field shows at a camera, and how far off the picture is.
struct Looked {
    camera: Camera,
    appearance: Appearance,
    /// What each pixel gathers, before any light.
    features: Vec<[f32; FEATURES]>,
    residuals: Vec<[f32; 3]>,
}

/// A step that was taken.
struct Moved {
    next: Looked,
    /// The numbers' units that it went.
    step: [f64; NUMBERS],
}

/// Takes steps from `camera`, as `pass` says. `None` where there is nothing to
/// compare, no light explains it, or it is no longer `wanted`.
pub(super) fn refine(
    against: &Against<'_>,
    level: &Level,
    camera: Camera,
    pass: Pass,
    wanted: &dyn Fn() -> bool,
) -> Option<Refined> {
    let Pass { steps, settled_px, min_spread, is_last } = pass;
    if level.windows.is_empty() {
        return None;
    }
    let mut now = look(against, level, &camera, None)?;
    // Little: with much, steps along the valley of longer lenses further off were too short to go on.
    let mut damping = 1e-5;
    let (mut known, mut learnt) = (None::<Slopes>, 0);
    // Weights change as it goes, so that a cost that falls proves no end.
    for _ in 0..steps {
        if !wanted() {
            return None;
        }
        let weights = Weights::of(&now.residuals, &level.tells, min_spread);
        // In the light that a step will be judged in.
        now = lit(against, level, &now.camera, now.features, Some(&weights))?;
        let mut slopes = known.take().filter(|_| learnt < LEARNT).unwrap_or_else(|| {
            learnt = 0;
            Slopes::at(against, level, &now, &weights)
        });
        // Slopes that were learnt and do not lead on are worked out anew, and say nothing of the next step's damping.
        let (mut damped, tries) = (damping, if learnt == 0 { TRIES } else { 1 });
        match slopes.follow(against, level, &now, &weights, &mut damped, tries) {
            Some(Moved { next, step }) => {
                slopes.learn(&step, &now.residuals, &next.residuals);
                (now, known, learnt, damping) = (next, Some(slopes), learnt + 1, damped);
                if step.iter().map(|s| s * s).sum::<f64>().sqrt() * UNIT_PX < settled_px {
                    break;
                }
            }
            None if learnt == 0 => break,
            None => learnt = LEARNT,
        }
    }
    let weights = Weights::of(&now.residuals, &level.tells, min_spread);
    let explained = weights.explained(&now.residuals, level);
    let certain = || Covariance::of(level, &now.residuals, &weights, &Slopes::at(against, level, &now, &weights));
    let covariance = if is_last { certain() } else { None };
    Some(Refined { camera: now.camera, appearance: now.appearance, explained, covariance })
}

/// How far each number goes so that pixels move by about [`UNIT_PX`] of a copy `longest` px long.
pub(super) fn units(camera: &Camera, reach: f64, longest: f64) -> [f64; NUMBERS] {
    let i = &camera.intrinsics;
    // Of the copy's pixels one is so many of the picture's.
    let pixel = i.width.max(i.height) as f64 / longest * UNIT_PX;
    let (angle, half) = (pixel / i.fx, i.width.max(i.height) as f64 / 2.0);
    let aside = angle * reach;
    let larger = pixel / half;
    [angle, angle, larger, aside, aside, larger * reach, larger, pixel, pixel]
}

/// `camera` with its nine numbers changed by `step`, each in its unit: turned about its own axes, moved along them, its
/// focal length multiplied, its principal point moved.
pub(super) fn changed(camera: &Camera, step: &[f64; NUMBERS], units: &[f64; NUMBERS]) -> Camera {
    let by: [f64; NUMBERS] = std::array::from_fn(|k| step[k] * units[k]);
    let mut changed = *camera;
    let turn = DMat3::from_quat(glam::DQuat::from_scaled_axis(DVec3::new(by[0], by[1], by[2])));
    changed.pose.position += camera.pose.rotation * DVec3::new(by[3], by[4], by[5]);
    changed.pose.rotation = camera.pose.rotation * turn;
    let i = &mut changed.intrinsics;
    let larger = by[6].clamp(-1.0, 1.0).exp();
    (i.fx, i.fy) = (i.fx * larger, i.fy * larger);
    (i.cx, i.cy) = (i.cx + by[7], i.cy + by[8]);
    changed
}

/// What the level's pixels gather from `camera`.
fn gathered(field: &Field, level: &Level, camera: &Camera) -> Vec<[f32; FEATURES]> {
    let parts: Vec<Camera> = level.windows.iter().map(|w| level.camera(camera, w)).collect();
    field.features_of(Eye { camera: &parts[0], lens: &Lens::stacked(&parts) }, level.rays)
}

fn look(against: &Against<'_>, level: &Level, camera: &Camera, weights: Option<&Weights>) -> Option<Looked> {
    lit(against, level, camera, gathered(against.field, level, camera), weights)
}

/// What pixels with those `features` show in the light that fits best, each counting as its weight says.
fn lit(
    against: &Against<'_>,
    level: &Level,
    camera: &Camera,
    features: Vec<[f32; FEATURES]>,
    weights: Option<&Weights>,
) -> Option<Looked> {
    let weight = |at: usize| weights.map_or(1.0, |w| w.each[at].sqrt() as f32);
    let some: Vec<usize> = (0..features.len()).filter(|at| weight(*at) > 0.0).collect();
    let weighed = |at: &usize| {
        let w = weight(*at);
        (features[*at].map(|v| v * w), level.pixels[*at].map(|v| v * w))
    };
    let (f, p): (Vec<_>, Vec<_>) = some.iter().map(weighed).unzip();
    let appearance = against.prior.fit(&f, &p)?;
    let residuals = differences(&features, &appearance, &level.pixels);
    Some(Looked { camera: *camera, appearance, features, residuals })
}

/// Each pixel less what the field shows there.
fn differences(features: &[[f32; FEATURES]], light: &Appearance, pixels: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let off = |(f, pixel): (&[f32; FEATURES], &[f32; 3])| {
        // Files hold no colours beyond these.
        let shown = light.shade(f).map(|v| v.clamp(0.0, 1.0));
        std::array::from_fn(|c| pixel[c] - shown[c])
    };
    features.iter().zip(pixels).map(off).collect()
}

/// How what the field shows changes with each of a camera's numbers: as a render with that one a little
/// different differs. All of them so: a turn and a move to the side show nearly the same, and slopes of the picture (times
/// how far a pixel's place moves, by its depth) are too rough to tell the difference between them: steps along it were a
/// tenth of what they should be.
struct Slopes {
    /// How far each number went.
    units: [f64; NUMBERS],
    /// What that added to each colour of each pixel.
    each: Vec<[[f32; NUMBERS]; 3]>,
}

impl Slopes {
    /// Of the present camera: nine renders. Of what they show counts what no change of light would (Golub and Pereyra
    /// 1973, as Kaufman 1975 simplifies it): the light is fitted again at every place.
    fn at(against: &Against<'_>, level: &Level, now: &Looked, weights: &Weights) -> Self {
        let units = units(&now.camera, against.reach, level.size.0.max(level.size.1) as f64);
        let of = |k: usize| {
            let step = std::array::from_fn(|n| if n == k { 1.0 } else { 0.0 });
            let there = changed(&now.camera, &step, &units);
            differences(&gathered(against.field, level, &there), &now.appearance, &level.pixels)
        };
        let probes: Vec<Vec<[f32; 3]>> = (0..NUMBERS).into_par_iter().map(of).collect();
        // A residual falls by what the render rises.
        let slope = |at: usize, c: usize, k: usize| now.residuals[at][c] - probes[k][at][c];
        let each = |at: usize| std::array::from_fn(|c| std::array::from_fn(|k| slope(at, c, k)));
        let mut slopes = Self { units, each: (0..now.residuals.len()).map(each).collect() };
        for channel in 0..3 {
            slopes.clear_of_light(against.prior, now, weights, channel);
        }
        slopes
    }

    /// Takes off what another light makes as well of one colour channel, as far as lights are so.
    fn clear_of_light(&mut self, prior: &Prior, now: &Looked, weights: &Weights, channel: usize) {
        let counts = weights.each.iter().filter(|w| **w > 0.0).count() as f64;
        let mut gram = prior.of_channel(channel).map(|row| row.map(|v| v * counts));
        let mut right = [[0.0; FEATURES]; NUMBERS];
        for ((features, slopes), w) in now.features.iter().zip(&self.each).zip(&weights.each) {
            let f = features.map(f64::from);
            for (a, row) in gram.iter_mut().enumerate() {
                row.iter_mut().zip(&f).for_each(|(g, b)| *g += w * f[a] * b);
            }
            for (right, slope) in right.iter_mut().zip(&slopes[channel]) {
                right.iter_mut().zip(&f).for_each(|(r, f)| *r += w * f * f64::from(*slope));
            }
        }
        let gram = gram.as_flattened_mut();
        if factor(gram, FEATURES).is_none() {
            return;
        }
        right.iter_mut().for_each(|x| solve(gram, x));
        for (features, slopes) in now.features.iter().zip(&mut self.each) {
            for (slope, x) in slopes[channel].iter_mut().zip(&right) {
                let lit: f64 = features.iter().zip(x).map(|(f, x)| f64::from(*f) * x).sum();
                *slope -= lit as f32;
            }
        }
    }

    /// Takes what a `step` did to the residuals for the slopes along it (Broyden 1965): a step is one render, slopes are
    /// nine.
    fn learn(&mut self, step: &[f64; NUMBERS], before: &[[f32; 3]], after: &[[f32; 3]]) {
        let square: f64 = step.iter().map(|s| s * s).sum();
        if square < MIN_LEARNT {
            return;
        }
        let share: [f32; NUMBERS] = std::array::from_fn(|k| (step[k] / square) as f32);
        let step = step.map(|s| s as f32);
        let each = self.each.par_iter_mut().zip(before).zip(after);
        each.for_each(|((slopes, before), after)| {
            for ((slopes, b), a) in slopes.iter_mut().zip(before).zip(after) {
                let foreseen: f32 = slopes.iter().zip(&step).map(|(j, s)| j * s).sum();
                let off = b - a - foreseen;
                slopes.iter_mut().zip(&share).for_each(|(j, s)| *j += off * s);
            }
        });
    }

    /// The first step that comes to a lower cost, each tried damped more than the one before.
    fn follow(
        &self,
        against: &Against<'_>,
        level: &Level,
        now: &Looked,
        weights: &Weights,
        damping: &mut f64,
        tries: usize,
    ) -> Option<Moved> {
        let normal = self.normal(&now.residuals, weights);
        let before = weights.cost(&now.residuals);
        for _ in 0..tries {
            let step = normal.step(*damping)?;
            let there = changed(&now.camera, &step, &self.units);
            // Light is fitted to what counted: an outlier has no say in it either.
            let next = look(against, level, &there, Some(weights));
            let cost = next.as_ref().map_or(f64::INFINITY, |next| weights.cost(&next.residuals));
            if let Some(next) = next.filter(|_| cost < before) {
                *damping = (*damping * 0.1).max(1e-8);
                return Some(Moved { next, step });
            }
            *damping = (*damping * 30.0).max(DAMPED);
        }
        None
    }

    fn normal(&self, residuals: &[[f32; 3]], weights: &Weights) -> Normal {
        let mut normal = Normal::default();
        for ((slopes, r), w) in self.each.iter().zip(residuals).zip(&weights.each).filter(|(_, w)| **w != 0.0) {
            for (slopes, r) in slopes.iter().zip(r) {
                normal.add(&slopes.map(f64::from), f64::from(*r), *w);
            }
        }
        normal
    }
}

/// How far a camera that pictures were aligned to may be off.
#[derive(Clone, Debug)]
pub(super) struct Covariance {
    units: [f64; NUMBERS],
    /// Of the numbers, in those units.
    matrix: [[f64; NUMBERS]; NUMBERS],
}

impl Covariance {
    /// By what the level's windows say one by one: neighbouring pixels err together, windows do not. The normal
    /// equations' inverse on either side of the windows' own sums (White 1980; clustered, Liang and Zeger 1986). `None`
    /// where the windows do not determine a camera.
    fn of(level: &Level, residuals: &[[f32; 3]], weights: &Weights, slopes: &Slopes) -> Option<Self> {
        let whole = slopes.normal(residuals, weights);
        let inverse = whole.inverse()?;
        let mut middle = [[0.0; NUMBERS]; NUMBERS];
        let (mut first, mut told) = (0, 0);
        for window in &level.windows {
            let own = first..first + window.width * window.height;
            first = own.end;
            let mut part = Normal::default();
            for at in own.filter(|at| weights.each[*at] != 0.0) {
                for (slopes, r) in slopes.each[at].iter().zip(&residuals[at]) {
                    part.add(&slopes.map(f64::from), f64::from(*r), weights.each[at]);
                }
            }
            told += usize::from(part.right.iter().any(|v| *v != 0.0));
            for (row, a) in middle.iter_mut().zip(part.right) {
                row.iter_mut().zip(part.right).for_each(|(m, b)| *m += a * b);
            }
        }
        // As many windows as numbers leave nothing to tell errors by.
        let free = told.checked_sub(NUMBERS).filter(|free| *free > 0)?;
        let share = told as f64 / free as f64;
        let times = |a: &[[f64; NUMBERS]; NUMBERS], b: &[[f64; NUMBERS]; NUMBERS]| -> [[f64; NUMBERS]; NUMBERS] {
            std::array::from_fn(|i| std::array::from_fn(|j| (0..NUMBERS).map(|k| a[i][k] * b[k][j]).sum()))
        };
        let matrix = times(&times(&inverse, &middle), &inverse).map(|row| row.map(|v| v * share));
        matrix.iter().flatten().all(|v| v.is_finite()).then_some(Self { units: slopes.units, matrix })
    }

    /// By the normal equations of numbers in those `units`, and the variance of what they are equations of.
    pub(super) fn by(units: [f64; NUMBERS], normal: &Normal, variance: f64) -> Option<Self> {
        Some(Self { units, matrix: normal.inverse()?.map(|row| row.map(|v| v * variance)) })
    }

    /// Standard deviation of where `camera` has `places`, the median over those that it sees, px; infinite where it sees
    /// none.
    pub(super) fn median_px(&self, camera: &Camera, places: &[DVec3]) -> f64 {
        let off: Vec<f64> = places.iter().filter_map(|place| self.off_px(camera, *place)).collect();
        if off.is_empty() { f64::INFINITY } else { median(off) }
    }

    /// Standard deviation of where `camera` has `place`, px; `None` where it does not see it.
    fn off_px(&self, camera: &Camera, place: DVec3) -> Option<f64> {
        let here = camera.project(place)?;
        let mut slopes = [[0.0; NUMBERS]; 2];
        for k in 0..NUMBERS {
            let step: [f64; NUMBERS] = std::array::from_fn(|n| if n == k { 1e-2 } else { 0.0 });
            let there = changed(camera, &step, &self.units).project(place)?;
            (slopes[0][k], slopes[1][k]) = ((there.x - here.x) * 1e2, (there.y - here.y) * 1e2);
        }
        let variance = |s: &[f64; NUMBERS]| -> f64 {
            (0..NUMBERS)
                .flat_map(|i| (0..NUMBERS).map(move |j| (i, j)))
                .map(|(i, j)| s[i] * self.matrix[i][j] * s[j])
                .sum()
        };
        Some(slopes.iter().map(variance).sum::<f64>().max(0.0).sqrt())
    }
}

/// Tukey's biweights of residuals.
struct Weights {
    each: Vec<f64>,
    /// Robust standard deviation of a pixel's difference.
    spread: f64,
}

impl Weights {
    /// By the spread of those residuals that tell something.
    fn of(residuals: &[[f32; 3]], tells: &[bool], min_spread: f64) -> Self {
        let sizes: Vec<f64> = residuals.iter().map(size).collect();
        let telling: Vec<f64> = sizes.iter().zip(tells).filter(|(_, tells)| **tells).map(|(s, _)| *s).collect();
        // Of a length of three normal numbers the median is 1.54 of their deviation. Nothing tells: no spread.
        let median = if telling.is_empty() { 0.0 } else { median(telling) };
        let spread = (median / 1.54).max(min_spread);
        let weight = |s: &f64| (1.0 - (s / (TUKEY * spread * 3f64.sqrt())).powi(2)).max(0.0).powi(2);
        Self { each: sizes.iter().map(weight).collect(), spread }
    }

    /// Tukey's loss, with the spread that these weights were made with.
    fn cost(&self, residuals: &[[f32; 3]]) -> f64 {
        let end = TUKEY * self.spread * 3f64.sqrt();
        let loss = |r: &[f32; 3]| 1.0 - (1.0 - (size(r) / end).powi(2)).max(0.0).powi(3);
        residuals.iter().map(loss).sum()
    }

    /// Share of the pixels that tell something of which the field explains anything, times the share of their
    /// variance that it explains, 1 at most.
    fn explained(&self, residuals: &[[f32; 3]], level: &Level) -> f64 {
        let telling = level.tells.iter().filter(|tells| **tells).count();
        let some: Vec<usize> = (0..residuals.len()).filter(|at| level.tells[*at] && self.each[*at] > 0.1).collect();
        let n = some.len() as f64;
        let mean: [f64; 3] =
            std::array::from_fn(|c| some.iter().map(|at| f64::from(level.pixels[*at][c])).sum::<f64>() / n);
        let (mut left, mut variance) = (0.0, 0.0);
        for at in &some {
            left += size(&residuals[*at]).powi(2);
            variance += (0..3).map(|c| (f64::from(level.pixels[*at][c]) - mean[c]).powi(2)).sum::<f64>();
        }
        if variance > 0.0 { n / telling as f64 * (1.0 - left / variance) } else { 0.0 }
    }
}

fn size(r: &[f32; 3]) -> f64 {
    r.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}
