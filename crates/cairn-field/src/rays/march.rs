//! Where along a ray the field is sampled: points half a voxel apart in grid
//! coordinates (a whole one beyond the inner box), empty space passed over.
//! Skipping never moves a sample: the points are a lattice fixed by the ray alone.
//!
//! Rays that run beside one another go through empty space together, a lane each: to find
//! the next place that holds anything is a chain of instructions of which each waits for the one
//! before, and eight chains wait together. What is found is then looked at ray by ray, a lane
//! a sample.

use super::frame::RayPath;
use super::stretch::{Segment, Stretches};
use crate::grid::lattice::Grid;
use crate::grid::occupancy::BLOCK;
use crate::grid::real::{LANES, Real, larger, smaller};

/// Distance between samples in a picture, in voxels.
pub const STEP_VOXELS: f64 = 0.5;
/// The smallest distance between samples in contracted space, in voxels: those are
/// drawn out in depth, where nobody can tell.
pub const FAR_STEP_VOXELS: f64 = 1.0;

/// More than f32 rounds a place in the largest grid (4096 voxels a side), voxels.
const ROUNDING: f64 = 1e-3;

/// Density (per unit-cube length) below which a cell of a grid of `dims` vertices counts as empty: a step
/// through it stops less than a ten-thousandth of the light.
pub(crate) fn empty_density(dims: [usize; 3]) -> f64 {
    let largest = dims.iter().copied().max().unwrap_or(2);
    1e-4 * (largest - 1) as f64 / STEP_VOXELS
}

/// A place where the field is looked up.
#[derive(Clone, Copy, Debug)]
pub struct Sample<T> {
    /// Linear index of the cell's first vertex.
    pub cell: u32,
    /// Place within the cell, each in [0, 1].
    pub frac: [T; 3],
    /// Length of ray it stands for, unit-cube lengths.
    pub length: T,
    /// How far along the ray it is, in unit-cube lengths travelled.
    pub along: T,
    /// Beyond the inner box of an unbounded scene.
    pub far: bool,
}

/// Up to [`LANES`] samples next to one another on a ray, a lane each; what [`Sample`]
/// says of one. Lanes that are not held have numbers, too, and no meaning.
#[derive(Clone, Copy, Debug)]
pub struct Samples<T> {
    /// Lanes that lie in occupied cells, a bit each; at least one of what is visited.
    pub held: u32,
    /// Cells; a held lane's where a lane is not held.
    pub cell: [u32; LANES],
    /// Cells by axis; of a held lane the place of `cell` in the lattice.
    pub cells: [[u32; LANES]; 3],
    /// Places within the cells, by axis.
    pub frac: [[T; LANES]; 3],
    /// Lengths of ray.
    pub length: [T; LANES],
    /// How far along the ray.
    pub along: [T; LANES],
    /// Beyond the inner box of an unbounded scene, all of them.
    pub far: bool,
}

impl<T: Real> Samples<T> {
    /// The held lanes' samples, near to far.
    pub fn each(&self) -> impl Iterator<Item = Sample<T>> + '_ {
        lanes(self.held).map(|k| Sample {
            cell: self.cell[k],
            frac: self.frac_of(k),
            length: self.length[k],
            along: self.along[k],
            far: self.far,
        })
    }

    /// Where in its cell lane `k` lies.
    #[inline(always)]
    pub(crate) fn frac_of(&self, k: usize) -> [T; 3] {
        [self.frac[0][k], self.frac[1][k], self.frac[2][k]]
    }
}

/// The lanes whose bit is set, ascending.
#[inline(always)]
pub(crate) fn lanes(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let k = bits.trailing_zeros() as usize;
        bits &= bits.wrapping_sub(1);
        (k < LANES).then_some(k)
    })
}

/// Visits the samples of `path` in occupied cells, near to far, until `visit`
/// returns false. They lie `step` voxels apart; `offset` in [0, 1) shifts the
/// lattice by that share of a step (0.5 for a render; random in training).
#[inline(always)]
pub fn march<T: Real>(
    grid: &Grid<T>,
    path: &RayPath,
    offset: f64,
    step: f64,
    mut visit: impl FnMut(&Samples<T>) -> bool,
) {
    march_together(grid, &[*path], offset, step, |_, samples| visit(samples));
}

/// [`march`] along some rays, best such as run beside one another; `visit` is told which
/// ray it is. Each one's samples come near to far.
#[inline(always)]
pub(crate) fn march_together<T: Real, const N: usize>(
    grid: &Grid<T>,
    paths: &[RayPath; N],
    offset: f64,
    step: f64,
    mut visit: impl FnMut(usize, &Samples<T>) -> bool,
) {
    const { assert!(N <= LANES, "a lane a ray") };
    let mut rays = Rays::begin(grid, paths, offset, step);
    loop {
        rays.pass_what_is_empty(grid);
        if rays.under_way == 0 {
            return;
        }
        for ray in lanes(rays.under_way) {
            let samples = rays.segment[ray].samples(grid, rays.at[ray] as usize);
            if samples.held != 0 && !visit(ray, &samples) {
                rays.under_way &= !(1 << ray);
            } else {
                rays.go_on(grid, ray, LANES as u32);
            }
        }
    }
}

/// Some rays and how far they are.
struct Rays<T, const N: usize> {
    offset: f64,
    step: f64,
    /// What comes after each one's segment, and how long the ray is until there.
    rest: [Stretches; N],
    along: [f64; N],
    /// Where each one is,
    segment: [Segment<T>; N],
    /// the next sample therein,
    at: [u32; N],
    /// and, by axis, what of it the way through empty space needs.
    way: [Way<T, N>; 3],
    /// Rays that have not ended, a bit each.
    under_way: u32,
}

/// What of [`Segment`] is about one axis, a lane a ray.
#[derive(Clone, Copy)]
struct Way<T, const N: usize> {
    place: [[T; N]; 3],
    up: [T; N],
    down: [T; N],
}

impl<T: Real, const N: usize> Rays<T, N> {
    #[inline(always)]
    fn begin(grid: &Grid<T>, paths: &[RayPath; N], offset: f64, step: f64) -> Self {
        let zero = [T::zero(); N];
        let mut rays = Self {
            offset,
            step,
            rest: std::array::from_fn(|k| Stretches::of(grid.dims, &paths[k])),
            along: [0.0; N],
            segment: [Segment::nowhere(); N],
            at: [0; N],
            way: [Way { place: [zero; 3], up: zero, down: zero }; 3],
            under_way: 0,
        };
        for ray in 0..N {
            rays.under_way |= u32::from(rays.next_segment(grid, ray)) << ray;
        }
        rays
    }

    /// Moves `ray` on to its next segment; false where there is none.
    #[inline(always)]
    fn next_segment(&mut self, grid: &Grid<T>, ray: usize) -> bool {
        let Some(stretch) = self.rest[ray].next() else { return false };
        let step = if stretch.far { self.step.max(FAR_STEP_VOXELS) } else { self.step };
        let segment = stretch.segment(grid.dims, self.offset, step, &mut self.along[ray]);
        for (k, way) in self.way.iter_mut().enumerate() {
            for power in 0..3 {
                way.place[power][ray] = segment.place[power][k];
            }
            (way.up[ray], way.down[ray]) = (segment.up[k], segment.down[k]);
        }
        (self.segment[ray], self.at[ray]) = (segment, 0);
        true
    }

    /// Moves `ray` on by `samples`.
    #[inline(always)]
    fn go_on(&mut self, grid: &Grid<T>, ray: usize, samples: u32) {
        self.at[ray] += samples;
        if self.at[ray] as usize >= self.segment[ray].count && !self.next_segment(grid, ray) {
            self.under_way &= !(1 << ray);
        }
    }

    /// Moves all rays on until each is in a block that holds something, or at its end.
    #[inline(always)]
    fn pass_what_is_empty(&mut self, grid: &Grid<T>) {
        let mut moving = self.under_way;
        while moving != 0 {
            let (reach, samples) = self.strides(grid);
            for ray in lanes(moving) {
                if reach[ray] == 0 {
                    moving &= !(1 << ray);
                } else {
                    self.go_on(grid, ray, samples[ray]);
                }
            }
            moving &= self.under_way;
        }
    }

    /// For each ray, how many blocks off the nearest is that holds something, and how many
    /// samples it is to the next one that may lie outside the empty cube of blocks around it,
    /// whose half side that is. What is passed over lies inside by more than a place is
    /// rounded: a sample on the very side is looked at. No branch: a lane a ray.
    #[inline(always)]
    fn strides(&self, grid: &Grid<T>) -> ([i32; N], [u32; N]) {
        let n = self.at.map(|at| T::whole_of(at as i32));
        let side = BLOCK as i32;
        let (mut p, mut block) = ([[T::zero(); N]; 3], [[0i32; N]; 3]);
        for (k, way) in self.way.iter().enumerate() {
            let last = (grid.dims[k] - 2) as i32;
            for ray in 0..N {
                let place = way.place[0][ray] + n[ray] * (way.place[1][ray] + n[ray] * way.place[2][ray]);
                p[k][ray] = larger(place, T::zero());
                block[k][ray] = p[k][ray].whole().min(last) >> BLOCK.trailing_zeros();
            }
        }
        let reach = grid.occupancy.reaches(&block);
        let mut nearest = [T::of(1e9); N];
        for (k, way) in self.way.iter().enumerate() {
            for ray in 0..N {
                let low = T::whole_of((block[k][ray] - reach[ray] + 1) * side) + T::of(ROUNDING);
                let high = T::whole_of((block[k][ray] + reach[ray]) * side) - T::of(ROUNDING);
                let (above, below) = (high - p[k][ray], p[k][ray] - low);
                let nearer = smaller(above * way.up[ray], below * way.down[ray]);
                nearest[ray] = smaller(nearer, nearest[ray]);
            }
        }
        (reach, nearest.map(|samples| samples.whole() as u32 + 1))
    }
}

impl<T: Real> Segment<T> {
    /// Sample `n`'s place along axis `k`, voxels. Rounding may leave the cube by an ulp;
    /// this clamp, and the one of its cell, keep it inside.
    #[inline(always)]
    fn place(&self, n: T, k: usize) -> T {
        larger(self.place[0][k] + n * (self.place[1][k] + n * self.place[2][k]), T::zero())
    }

    /// The samples from `i` on. Loops over lanes have no branch and become vector instructions.
    #[inline(always)]
    fn samples(&self, grid: &Grid<T>, i: usize) -> Samples<T> {
        let last = grid.dims.map(|d| (d - 2) as i32);
        let n: [T; LANES] = std::array::from_fn(|k| T::of((i + k) as f64));
        let (mut cells, mut frac) = ([[0u32; LANES]; 3], [[T::zero(); LANES]; 3]);
        for axis in 0..3 {
            for k in 0..LANES {
                let p = self.place(n[k], axis);
                let cell = p.whole().min(last[axis]);
                cells[axis][k] = cell as u32;
                frac[axis][k] = smaller(p - T::whole_of(cell), T::one());
            }
        }
        let [x, y, z] = cells;
        let (nx, ny) = (grid.dims[0] as u32, grid.dims[1] as u32);
        let mut cell: [u32; LANES] = std::array::from_fn(|k| (z[k] * ny + y[k]) * nx + x[k]);
        let held = grid.occupancy.held([x, y, z]) & u32::MAX >> (32 - (self.count - i).min(LANES));
        let first = held.trailing_zeros() as usize % LANES;
        for k in 0..LANES {
            // What is looked up for nothing is then at hand at least.
            cell[k] = if held >> k & 1 == 1 { cell[k] } else { cell[first] };
        }
        Samples {
            held,
            cell,
            cells,
            frac,
            length: n.map(|n| larger(self.length[0] + n * (self.length[1] + n * self.length[2]), T::zero()).sqrt()),
            along: n.map(|n| self.along[0] + n * self.along[1]),
            far: self.far,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid in which every fourth block or so holds something.
    fn scattered(dims: [usize; 3]) -> Grid<f32> {
        let all: Vec<u32> = (0..dims.iter().product::<usize>() as u32).collect();
        let mut grid = Grid::with_vertices(dims, all);
        for (v, raw) in grid.raw.iter_mut().enumerate() {
            let block = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])].map(|at| at / 5);
            let chance = crate::chance::mixed((block[0] + 100 * block[1] + 10_000 * block[2]) as u64);
            *raw = if chance.is_multiple_of(4) { 1.0 } else { -30.0 };
        }
        grid.refresh_occupancy(1e-3);
        grid
    }

    #[test]
    fn rays_meet_the_same_together_as_alone() {
        let grid = scattered([61, 47, 80]);
        let path = |k: usize| {
            let (a, b) = (k as f64, (k * k % 11) as f64);
            let direction = [1.0 - 0.02 * a, 0.3 - 0.1 * b, 0.2 * a - 0.7];
            match k {
                3 => RayPath::Miss,
                _ if k.is_multiple_of(2) => {
                    RayPath::Straight { origin: [0.05, 0.5, 0.5], direction, start: 0.0, end: 0.5 + 0.05 * a }
                }
                _ => RayPath::Contracted { origin: [-2.0 + 0.3 * a, 0.4, 0.1 * b], direction },
            }
        };
        let paths: [RayPath; LANES] = std::array::from_fn(path);
        // Ray 6 ends once it was shown three samples.
        let stop = |ray: usize, seen: &[Sample<f32>]| ray == 6 && seen.len() >= 3;
        let numbers = |all: &[Sample<f32>]| -> Vec<(u32, [u32; 5], bool)> {
            let bits = |s: &Sample<f32>| [s.frac[0], s.frac[1], s.frac[2], s.length, s.along].map(f32::to_bits);
            all.iter().map(|s| (s.cell, bits(s), s.far)).collect()
        };
        let mut together: [Vec<Sample<f32>>; LANES] = Default::default();
        march_together(&grid, &paths, 0.3, 0.5, |ray, samples| {
            together[ray].extend(samples.each());
            !stop(ray, &together[ray])
        });
        for (ray, path) in paths.iter().enumerate() {
            let mut alone = Vec::new();
            march(&grid, path, 0.3, 0.5, |samples| {
                alone.extend(samples.each());
                !stop(ray, &alone)
            });
            assert_eq!(numbers(&together[ray]), numbers(&alone), "ray {ray}");
            assert!(ray == 3 || !alone.is_empty(), "ray {ray} meets something");
        }
        assert!(together.iter().any(|seen| seen.len() > 20) && together[3].is_empty());
    }
}
