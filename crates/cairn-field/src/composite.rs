//! Alpha compositing along one ray, forward and backward. Forward records what
//! it saw on a tape; backward walks the tape, so both share one traversal.
//!
//! method.md's equation: `alpha_i = 1 - exp(-s_i d_i)`,
//! `T_i = exp(-sum_{j<i} s_j d_j)`, `C = sum_i T_i alpha_i c_i + T_end * background`
//! (Max 1995; NeRF eq. 3). Colour is summed in two parts, near (the inner box)
//! and far (contracted space), because appearance treats them differently.

use crate::frame::RayPath;
use crate::grid::{DENSITY_SCALE, Grid, trilinear};
use crate::march::{STEP_VOXELS, march};
use crate::real::{Real, softplus_and_slope};
use crate::sh::SH;

/// When to leave out what cannot be seen.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    /// A sample with less alpha is passed over.
    pub alpha: f64,
    /// A ray ends when less than this of the light from behind would arrive.
    pub transmittance: f64,
    /// A sample that weighs less in the pixel is passed over.
    pub weight: f64,
    /// Distance between samples in the inner box, voxels.
    pub step: f64,
}

impl Thresholds {
    /// For pictures: what is left out is below half an 8-bit step (0.5 / 255 =
    /// 2e-3) at every pixel.
    pub const SHOWN: Self = Self { alpha: 1e-5, transmittance: 1e-3, weight: 0.0, step: STEP_VOXELS };
    /// Leaves nothing out; for reference renders.
    pub const EXACT: Self = Self { alpha: 0.0, transmittance: 0.0, weight: 0.0, step: STEP_VOXELS };
}

/// One sample's share of a ray.
#[derive(Clone, Copy, Debug)]
pub struct Kept<T> {
    /// Cell (first vertex).
    pub cell: u32,
    /// Place in the cell.
    pub frac: [T; 3],
    /// `T_i alpha_i`.
    pub weight: T,
    /// Transmittance behind the sample, `T_{i+1}`.
    pub behind: T,
    /// d(optical depth)/d(raw density).
    pub slope: T,
    /// Distance travelled, unit-cube lengths.
    pub along: T,
    /// Length it stands for.
    pub length: T,
    /// In contracted space.
    pub far: bool,
    /// Colour (before appearance).
    pub colour: [T; 3],
}

/// What a ray gathered, before appearance and background.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gathered<T> {
    /// `sum w c` over the inner box.
    pub near: [T; 3],
    /// `sum w` over the inner box.
    pub near_weight: T,
    /// `sum w c` over contracted space.
    pub far: [T; 3],
    /// `sum w` over contracted space.
    pub far_weight: T,
    /// Transmittance left at the end.
    pub end: T,
    /// `sum w * along`: expected distance in unit-cube lengths, for depth maps.
    pub along: T,
}

/// Marches one ray and composites it; `tape` is cleared and filled, near to far.
#[inline]
pub fn gather<T: Real>(
    grid: &Grid<T>,
    path: &RayPath,
    basis: &[T; SH],
    offset: f64,
    limits: Thresholds,
    tape: &mut Vec<Kept<T>>,
) -> Gathered<T> {
    let corners = grid.corners();
    let end = record(grid, path, offset, limits, tape);
    let mut sum = Gathered { end, ..Gathered::default() };
    for kept in tape.iter_mut() {
        kept.colour = grid.colour_at(kept.cell as usize, &trilinear(kept.frac), &corners, basis);
        sum.add(kept, kept.weight, kept.colour.map(|c| kept.weight * c));
    }
    sum
}

/// As [`gather`], for pictures: the samples of a run in one cell look its corners
/// up together, and the tape's colours stay zero.
#[inline]
pub fn see<T: Real>(
    grid: &Grid<T>,
    path: &RayPath,
    basis: &[T; SH],
    limits: Thresholds,
    tape: &mut Vec<Kept<T>>,
) -> Gathered<T> {
    let corners = grid.corners();
    let end = record(grid, path, 0.5, limits, tape);
    let mut sum = Gathered { end, ..Gathered::default() };
    for run in runs(tape) {
        let shares = corner_shares(run);
        let light = grid.colour_at(run[0].cell as usize, &shares, &corners, basis);
        sum.add(&run[0], T::zero(), light);
        for kept in run {
            sum.add(kept, kept.weight, [T::zero(); 3]);
        }
    }
    sum
}

/// The tape's runs of samples in one cell and one part of space.
pub fn runs<T: Real>(tape: &[Kept<T>]) -> impl Iterator<Item = &[Kept<T>]> {
    tape.chunk_by(|a, b| a.cell == b.cell && a.far == b.far)
}

/// What each corner of a run's cell weighs in the pixel.
pub fn corner_shares<T: Real>(run: &[Kept<T>]) -> [T; 8] {
    let mut shares = [T::zero(); 8];
    for kept in run {
        for (share, corner) in shares.iter_mut().zip(trilinear(kept.frac)) {
            *share += corner * kept.weight;
        }
    }
    shares
}

impl<T: Real> Gathered<T> {
    /// Adds a sample's weight and light to its part of space.
    #[inline(always)]
    fn add(&mut self, kept: &Kept<T>, weight: T, light: [T; 3]) {
        let (part, sum) =
            if kept.far { (&mut self.far, &mut self.far_weight) } else { (&mut self.near, &mut self.near_weight) };
        *sum += weight;
        for c in 0..3 {
            part[c] += light[c];
        }
        self.along += weight * kept.along;
    }
}

/// Marches one ray onto `tape`, colours left zero; returns the transmittance at its end.
#[inline(always)]
fn record<T: Real>(grid: &Grid<T>, path: &RayPath, offset: f64, limits: Thresholds, tape: &mut Vec<Kept<T>>) -> T {
    tape.clear();
    let corners = grid.corners();
    let scale = T::of(DENSITY_SCALE);
    let (least, stop, light) = (T::of(limits.alpha), T::of(limits.transmittance), T::of(limits.weight));
    let mut t = T::one();
    march(grid, path, offset, limits.step, |sample| {
        let weights = trilinear(sample.frac);
        let raw = grid.raw_at(sample.cell as usize, &weights, &corners);
        let (density, slope) = softplus_and_slope(raw);
        let depth = scale * density * sample.length;
        // Alpha is never above the depth: spare the exponential.
        if depth <= least {
            return true;
        }
        let alpha = -(-depth).exp_m1();
        let weight = t * alpha;
        if weight <= light {
            return true;
        }
        t *= T::one() - alpha;
        grid.prefetch_colour(sample.cell as usize, &corners);
        tape.push(Kept {
            cell: sample.cell,
            frac: sample.frac,
            weight,
            behind: t,
            slope: scale * slope * sample.length,
            along: sample.along,
            length: sample.length,
            far: sample.far,
            colour: [T::zero(); 3],
        });
        t > stop
    });
    t
}

/// What one sample owes the grid: gradients at a point, to be spread over its
/// cell's corners.
#[derive(Clone, Copy, Debug)]
pub struct Owed<T> {
    /// Cell (first vertex).
    pub cell: u32,
    /// Which ray of the batch it belongs to (for its basis).
    pub ray: u32,
    /// Place in the cell.
    pub frac: [T; 3],
    /// d(loss)/d(raw density at the point).
    pub raw: T,
    /// d(loss)/d(colour at the point).
    pub colour: [T; 3],
    /// Its weight in the picture, for pruning.
    pub weight: T,
}

/// Losses on a ray's weights themselves.
#[derive(Clone, Copy, Debug, Default)]
pub struct Regularise<T> {
    /// Weight of mip-NeRF 360's distortion loss (eq. 15): draws a ray's weight together.
    pub distortion: T,
    /// Weight of the ray's optical depth: clears the haze that explains nothing.
    pub sparsity: T,
}

/// Walks the tape back. `slope` holds d(loss)/d(each field of [`Gathered`])
/// (its `along` is ignored). Appends to `owed`.
pub fn push_back<T: Real>(
    tape: &[Kept<T>],
    end: T,
    slope: &Gathered<T>,
    regularise: &Regularise<T>,
    ray: u32,
    owed: &mut Vec<Owed<T>>,
) {
    // Sums over everything for the distortion's |u_i - u_j| in one pass.
    let (mut weight_all, mut moment_all) = (T::zero(), T::zero());
    for kept in tape {
        weight_all += kept.weight;
        moment_all += kept.weight * kept.along;
    }
    let (mut weight_behind, mut moment_behind) = (T::zero(), T::zero());
    // sum_{j > i} w_j e_j + T_end e_end, from the back.
    let mut later = end * slope.end;
    let two = T::of(2.0);
    for kept in tape.iter().rev() {
        let (g, g_weight) = if kept.far { (slope.far, slope.far_weight) } else { (slope.near, slope.near_weight) };
        let mut e = g[0] * kept.colour[0] + g[1] * kept.colour[1] + g[2] * kept.colour[2] + g_weight;
        if regularise.distortion != T::zero() {
            let weight_before = weight_all - weight_behind - kept.weight;
            let moment_before = moment_all - moment_behind - kept.weight * kept.along;
            let spread = kept.along * weight_before - moment_before + moment_behind - kept.along * weight_behind;
            e += regularise.distortion * (two * spread + two / T::of(3.0) * kept.weight * kept.length);
            weight_behind += kept.weight;
            moment_behind += kept.weight * kept.along;
        }
        owed.push(Owed {
            cell: kept.cell,
            ray,
            frac: kept.frac,
            raw: kept.slope * (kept.behind * e - later + regularise.sparsity),
            colour: [kept.weight * g[0], kept.weight * g[1], kept.weight * g[2]],
            weight: kept.weight,
        });
        later += kept.weight * e;
    }
}

/// Spreads one sample's gradient over its cell's corners into `gradient`
/// (`rows x ROW`, density in the last column). `touch` hears each row and the
/// corner's share of the sample's weight.
#[inline(always)]
pub fn spread<T: Real>(
    grid: &Grid<T>,
    corners: &[usize; 8],
    owed: &Owed<T>,
    basis: &[T; SH],
    mut add: impl FnMut(usize, T, &[T; crate::grid::ROW]),
) {
    let mut row = [T::zero(); crate::grid::ROW];
    for c in 0..3 {
        for k in 0..SH {
            row[c * SH + k] = owed.colour[c] * basis[k];
        }
    }
    row[crate::grid::ROW - 1] = owed.raw;
    let weights = trilinear(owed.frac);
    for k in 0..8 {
        let at = grid.index[owed.cell as usize + corners[k]] as usize;
        if at != 0 {
            add(at, weights[k], &row);
        }
    }
}
