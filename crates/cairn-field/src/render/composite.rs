//! Alpha compositing along one ray, forward and backward. Forward records what
//! it saw on a tape; backward walks the tape, so both share one traversal.
//!
//! The quadrature of volume rendering: `alpha_i = 1 - exp(-s_i d_i)`,
//! `T_i = exp(-sum_{j<i} s_j d_j)`, `C = sum_i T_i alpha_i c_i + T_end * background`
//! (Max 1995; NeRF eq. 3). Colour is summed in two parts, near (the inner box)
//! and far (contracted space), because appearance treats them differently.

use super::patch::Patch;
use crate::grid::lattice::{DENSITY_SCALE, Grid, trilinear};
use crate::grid::real::{LANES, Real};
use crate::grid::sh::SH;
use crate::rays::frame::RayPath;
use crate::rays::march::{STEP_VOXELS, Samples, lanes, march_together};

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
    /// Place of the cell in the [`Patch`].
    pub place: u32,
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

/// Marches one ray and composites it, colours as `patch` (begun for this ray's tile)
/// sees them; `tape` is cleared and filled, near to far.
#[inline]
pub fn gather<T: Real>(
    grid: &Grid<T>,
    patch: &mut Patch<T>,
    path: &RayPath,
    offset: f64,
    limits: Thresholds,
    tape: &mut Vec<Kept<T>>,
) -> Gathered<T> {
    let end = record(grid, path, offset, limits, tape, |cell| patch.meet(grid, cell));
    patch.look_up(grid);
    let mut sum = Gathered { end, ..Gathered::default() };
    for run in tape.chunk_by_mut(|a, b| a.cell == b.cell) {
        let colours = patch.colours(run[0].place);
        for kept in run {
            let mut colour = [T::zero(); 4];
            for (c, share) in colours.iter().zip(trilinear(kept.frac)) {
                for k in 0..4 {
                    colour[k] += share * c[k];
                }
            }
            kept.colour = [colour[0], colour[1], colour[2]];
            sum.add(kept, kept.weight, kept.colour.map(|c| kept.weight * c));
        }
    }
    sum
}

/// As [`gather`] for one ray along `basis`, by itself (whole pictures go by tiles, see `picture.rs`): the samples of
/// a run in one cell look its corners up together, and the tape's places and colours stay zero.
#[inline]
pub fn see<T: Real>(
    grid: &Grid<T>,
    path: &RayPath,
    basis: &[T; SH],
    limits: Thresholds,
    tape: &mut Vec<Kept<T>>,
) -> Gathered<T> {
    let corners = grid.corners();
    let end = record(grid, path, 0.5, limits, tape, |cell| {
        grid.prefetch_colour(cell as usize, &corners);
        0
    });
    let mut sum = Gathered { end, ..Gathered::default() };
    for run in runs(tape) {
        let shares = corner_shares(run);
        let light = grid.light(run[0].cell as usize, &shares, &corners, basis);
        sum.add(&run[0], T::zero(), light);
        for kept in run {
            sum.add(kept, kept.weight, [T::zero(); 3]);
        }
    }
    sum
}

/// Fills `tape` with what a ray of a picture meets and what that weighs; places and
/// colours stay zero.
#[inline]
pub(crate) fn weigh<T: Real>(grid: &Grid<T>, path: &RayPath, limits: Thresholds, tape: &mut Vec<Kept<T>>) {
    record(grid, path, 0.5, limits, tape, |_| 0);
}

/// The tape's runs of samples in one cell and one part of space.
pub(crate) fn runs<T: Real>(tape: &[Kept<T>]) -> impl DoubleEndedIterator<Item = &[Kept<T>]> {
    tape.chunk_by(|a, b| a.cell == b.cell && a.far == b.far)
}

/// What each corner of a run's cell weighs in the pixel.
pub(crate) fn corner_shares<T: Real>(run: &[Kept<T>]) -> [T; 8] {
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

/// Marches one ray onto `tape`, colours left zero; `place` says where a cell's colours
/// will be. Returns the transmittance at its end.
#[inline(always)]
fn record<T: Real>(
    grid: &Grid<T>,
    path: &RayPath,
    offset: f64,
    limits: Thresholds,
    tape: &mut Vec<Kept<T>>,
    mut place: impl FnMut(u32) -> u32,
) -> T {
    tape.clear();
    let [end] = composite(grid, &[*path], offset, limits, |_, met| {
        let (s, k) = (met.samples, met.lane);
        // The one before is most often in the same cell.
        let place = match tape.last() {
            Some(last) if last.cell == s.cell[k] => last.place,
            _ => place(s.cell[k]),
        };
        tape.push(Kept {
            cell: s.cell[k],
            place,
            frac: s.frac_of(k),
            weight: met.weight,
            behind: met.behind,
            slope: met.slope,
            along: s.along[k],
            length: s.length[k],
            far: s.far,
            colour: [T::zero(); 3],
        });
    });
    end
}

/// A sample that shows.
pub(crate) struct Met<'a, T> {
    /// It and its neighbours,
    pub(crate) samples: &'a Samples<T>,
    /// among which it is this one.
    pub(crate) lane: usize,
    /// `T_i alpha_i`.
    pub(crate) weight: T,
    /// Transmittance behind it, `T_{i+1}`.
    behind: T,
    /// d(optical depth)/d(raw density).
    slope: T,
}

/// Marches some rays and hands over what shows, each ray's (by its number) near to far.
/// Returns the transmittances at their ends.
#[inline(always)]
pub(crate) fn composite<T: Real, const N: usize>(
    grid: &Grid<T>,
    paths: &[RayPath; N],
    offset: f64,
    limits: Thresholds,
    mut keep: impl FnMut(usize, Met<'_, T>),
) -> [T; N] {
    let scale = T::of(DENSITY_SCALE);
    let (faint, stop, weak) = (T::of(limits.alpha), T::of(limits.transmittance), T::of(limits.weight));
    let mut transmittance = [T::one(); N];
    march_together(grid, paths, offset, limits.step, |ray, samples| {
        let left = &mut transmittance[ray];
        let raw = grid.raw_at_lanes(&samples.cell, &samples.frac);
        // All lanes at once: this loop has no branch and becomes vector instructions.
        let (mut alpha, mut slope) = ([T::zero(); LANES], [T::zero(); LANES]);
        for k in 0..LANES {
            let (density, rise) = raw[k].softplus_and_slope();
            alpha[k] = (scale * density * samples.length[k]).stopped();
            slope[k] = scale * rise * samples.length[k];
        }
        for lane in lanes(samples.held) {
            let (alpha, slope) = (alpha[lane], slope[lane]);
            if alpha <= faint {
                continue;
            }
            let weight = *left * alpha;
            if weight <= weak {
                continue;
            }
            *left *= T::one() - alpha;
            keep(ray, Met { samples, lane, weight, behind: *left, slope });
            if *left <= stop {
                return false;
            }
        }
        true
    });
    transmittance
}

/// Walks the tape back. `slope` holds d(loss)/d(each field of [`Gathered`])
/// (its `along` is ignored), and `distortion` the weight of mip-NeRF 360's distortion loss (eq. 15), which draws a
/// ray's weight together. Adds what the ray owes to `patch`, with which it was gathered.
pub fn push_back<T: Real>(patch: &mut Patch<T>, tape: &[Kept<T>], end: T, slope: &Gathered<T>, distortion: T) {
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
    for run in runs(tape).rev() {
        let (g, g_weight) = if run[0].far { (slope.far, slope.far_weight) } else { (slope.near, slope.near_weight) };
        let (mut raws, mut shares) = ([T::zero(); 8], [T::zero(); 8]);
        for kept in run.iter().rev() {
            let mut e = g[0] * kept.colour[0] + g[1] * kept.colour[1] + g[2] * kept.colour[2] + g_weight;
            if distortion != T::zero() {
                let weight_before = weight_all - weight_behind - kept.weight;
                let moment_before = moment_all - moment_behind - kept.weight * kept.along;
                let spread = kept.along * weight_before - moment_before + moment_behind - kept.along * weight_behind;
                e += distortion * (two * spread + two / T::of(3.0) * kept.weight * kept.length);
                weight_behind += kept.weight;
                moment_behind += kept.weight * kept.along;
            }
            let raw = kept.slope * (kept.behind * e - later);
            for (k, corner) in trilinear(kept.frac).into_iter().enumerate() {
                raws[k] += corner * raw;
                shares[k] += corner * kept.weight;
            }
            later += kept.weight * e;
        }
        patch.owe(run[0].place, &raws, &shares, g);
    }
}
