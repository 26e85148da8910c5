//! From about where a picture was taken to exactly where: Levenberg and Marquardt's steps on the difference of
//! colours. A step is one render of the parts that are compared: it brings what they show, their slopes and their depth.
//! What fits nowhere (a black corner, something laid over the picture) loses its say by
//! Tukey's weights.

pub(super) use super::matrix::{NUMBERS, Normal};
use super::windows::{Level, Pixel};
use cairn_field::{Appearance, appearance::code::FEATURES};
use cairn_field::appearance::prior::Prior;
use cairn_field::{Field, Sampled, distance};
use cairn_field::rays::lens::{Eye, Lens};
use cairn_field::stats::median;
use cairn_scene::Camera;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Where Tukey's weights end, in robust standard deviations.
const TUKEY: f64 = 4.685;
/// A number's unit moves pixels by about so much, pixels of the level.
const UNIT_PX: f64 = 0.4;
/// How far a number goes for a slope, units.
const PROBE: f64 = 0.1;
/// Steps that are tried from a place, each shorter than the one before.
const TRIES: usize = 4;
/// How far off the sky is, in distances of what is seen.
const FAR: f64 = 1e6;
/// A step that moves pixels by less ends a level, pixels of the level.
const SETTLED_PX: f64 = 0.01;

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
    /// How often slopes are worked out, at most.
    pub(super) steps: usize,
    /// So many of the nine numbers, the first ones, are moved.
    pub(super) free: usize,
    /// The smallest spread of differences by which outliers are told, colours in [0, 1].
    pub(super) min_spread: f64,
}

/// A place, refined on one level.
#[derive(Clone, Debug)]
pub(super) struct Refined {
    pub(super) camera: Camera,
    pub(super) appearance: Appearance,
    /// Share of the pixels' variance that is explained, by the weights that they ended with.
    pub(super) explained: f64,
    /// How far off the camera may be; `None` where the windows do not determine one.
    pub(super) covariance: Option<Covariance>,
}

/// What the field shows at a camera, and how far off the picture is.
struct Looked {
    camera: Camera,
    appearance: Appearance,
    /// Each window's pixels with the margin around them.
    shown: Vec<Sampled>,
    residuals: Vec<[f32; 3]>,
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
    let Pass { steps, free, min_spread } = pass;
    if level.windows.is_empty() {
        return None;
    }
    let mut now = look(against, level, &camera, None)?;
    // Little: with much, steps along the valley of longer lenses further off were too short to go on.
    let mut damping = 1e-5;
    // Weights change as it goes, so that a cost that falls proves no end.
    for _ in 0..steps {
        if !wanted() {
            return None;
        }
        let weights = Weights::of(&now.residuals, &level.tells, min_spread);
        let slopes = Slopes::at(against, level, &now, free);
        let Some((next, by_px)) = slopes.follow(against, level, &now, &weights, &mut damping) else { break };
        now = next;
        if by_px < SETTLED_PX {
            break;
        }
    }
    let weights = Weights::of(&now.residuals, &level.tells, min_spread);
    let explained = weights.explained(&now.residuals, level);
    let covariance = Covariance::of(level, &now.residuals, &weights, &Slopes::at(against, level, &now, NUMBERS));
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

/// What the level's windows show from `camera`, with their margins.
fn sampled(field: &Field, level: &Level, camera: &Camera) -> Vec<Sampled> {
    let parts: Vec<Camera> = level.windows.iter().map(|w| level.camera(camera, w)).collect();
    field.sampled(Eye { camera: &parts[0], lens: &Lens::stacked(&parts) }, level.rays)
}

fn look(against: &Against<'_>, level: &Level, camera: &Camera, weights: Option<&Weights>) -> Option<Looked> {
    let shown = sampled(against.field, level, camera);
    let features: Vec<[f32; FEATURES]> = level.within().map(|at| shown[at].features).collect();
    let counts = |at: &usize| weights.is_none_or(|w| w.each[*at] > 0.1);
    let some: Vec<usize> = (0..features.len()).filter(counts).collect();
    let (f, p): (Vec<_>, Vec<_>) = some.iter().map(|at| (features[*at], level.pixels[*at])).unzip();
    let appearance = against.prior.fit(&f, &p)?;
    let residuals = differences(&features, &appearance, &level.pixels);
    Some(Looked { camera: *camera, appearance, shown, residuals })
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

/// How what the field shows changes with each of a camera's numbers: by the render's own slopes and how far what a
/// pixel shows moves, by its depth. Where a near edge hides something far that is not so; such pixels are few.
struct Slopes {
    /// How far each number went.
    units: [f64; NUMBERS],
    /// What that added to each colour of each pixel.
    each: Vec<[[f32; NUMBERS]; 3]>,
}

impl Slopes {
    /// For the first `free` numbers of the present camera; the others' are 0.
    fn at(against: &Against<'_>, level: &Level, now: &Looked, free: usize) -> Self {
        let units = units(&now.camera, against.reach, level.size.0.max(level.size.1) as f64);
        let small = now.camera.resized(level.size.0, level.size.1);
        let changed: [Camera; NUMBERS] = std::array::from_fn(|k| {
            let step = std::array::from_fn(|n| if n == k { PROBE } else { 0.0 });
            changed(&now.camera, &step, &units).resized(level.size.0, level.size.1)
        });
        let frame = against.field.frame();
        let of = |(place, at): (Pixel, usize)| {
            let slope = |a: usize, b: usize| -> [f32; 3] {
                let (a, b) = (now.shown[a].features, now.shown[b].features);
                let (a, b) = (now.appearance.shade(&a), now.appearance.shade(&b));
                // Files hold no colours beyond these.
                std::array::from_fn(|c| (b[c].clamp(0.0, 1.0) - a[c].clamp(0.0, 1.0)) / 2.0)
            };
            let (across, down) = (slope(at - 1, at + 1), slope(at - place.stride, at + place.stride));
            let (origin, direction) = small.ray(place.x, place.y);
            let seen = now.shown[at];
            // What stops no light is infinitely far.
            let away = if seen.accumulation > 0.5 {
                distance(frame, origin, direction, f64::from(seen.along / seen.accumulation))
            } else {
                None
            };
            let point = origin + direction * away.unwrap_or(FAR * against.reach);
            let moved = |k: usize| {
                let there = (k < free).then(|| changed[k].project(point)).flatten();
                there.map_or([0.0; 2], |at| [(at.x - place.x) / PROBE, (at.y - place.y) / PROBE])
            };
            let moved: [[f64; 2]; NUMBERS] = std::array::from_fn(moved);
            // The render shows at a pixel what was where the pixel came from.
            std::array::from_fn(|c| moved.map(|[x, y]| -(across[c] * x as f32 + down[c] * y as f32)))
        };
        let places: Vec<(Pixel, usize)> = level.places().zip(level.within()).collect();
        Self { units, each: places.into_par_iter().map(of).collect() }
    }

    /// The first step that comes to a lower cost, each tried damped more than the one before; and by how many pixels.
    fn follow(
        &self,
        against: &Against<'_>,
        level: &Level,
        now: &Looked,
        weights: &Weights,
        damping: &mut f64,
    ) -> Option<(Looked, f64)> {
        let normal = self.normal(&now.residuals, weights);
        let before = weights.cost(&now.residuals);
        for _ in 0..TRIES {
            let step = normal.step(*damping)?;
            let there = changed(&now.camera, &step, &self.units);
            // Light is fitted to what counted: an outlier has no say in it either.
            let next = look(against, level, &there, Some(weights));
            let cost = next.as_ref().map_or(f64::INFINITY, |next| weights.cost(&next.residuals));
            if let Some(next) = next.filter(|_| cost < before) {
                *damping = (*damping * 0.1).max(1e-8);
                return Some((next, step.iter().map(|s| s * s).sum::<f64>().sqrt() * UNIT_PX));
            }
            *damping *= 30.0;
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

    /// Standard deviation of where `camera` has `place`, px; `None` where it does not see it.
    pub(super) fn off_px(&self, camera: &Camera, place: DVec3) -> Option<f64> {
        let here = camera.project(place)?;
        let mut slopes = [[0.0; NUMBERS]; 2];
        for k in 0..NUMBERS {
            let step: [f64; NUMBERS] = std::array::from_fn(|n| if n == k { 1e-2 } else { 0.0 });
            let there = changed(camera, &step, &self.units).project(place)?;
            (slopes[0][k], slopes[1][k]) = ((there.x - here.x) * 1e2, (there.y - here.y) * 1e2);
        }
        let variance = |s: &[f64; NUMBERS]| -> f64 {
            (0..NUMBERS).flat_map(|i| (0..NUMBERS).map(move |j| (i, j))).map(|(i, j)| s[i] * self.matrix[i][j] * s[j]).sum()
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
