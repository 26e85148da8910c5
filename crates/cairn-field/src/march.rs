//! Where along a ray the field is sampled: points half a voxel apart in grid
//! coordinates (a whole one beyond the inner box, and in training), empty blocks
//! and cells passed over. Skipping never moves a sample: the points are a lattice
//! fixed by the ray alone.

use crate::frame::RayPath;
use crate::grid::Grid;
use crate::real::Real;

/// Distance between samples in a picture, in voxels.
pub const STEP_VOXELS: f64 = 0.5;
/// The least distance between samples in contracted space, in voxels: those are
/// drawn out in depth, where nobody can tell.
pub const FAR_STEP_VOXELS: f64 = 1.0;

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

/// Visits the samples of `path` in occupied cells, near to far, until `visit`
/// returns false. They lie `step` voxels apart; `offset` in [0, 1) shifts the
/// lattice by that share of a step (0.5 for a render; random in training).
#[inline(always)]
pub fn march<T: Real>(grid: &Grid<T>, path: &RayPath, offset: f64, step: f64, visit: impl FnMut(&Sample<T>) -> bool) {
    match path {
        RayPath::Miss => {}
        RayPath::Straight { origin, direction, start, end } => {
            straight(grid, (*origin, *direction), (*start, *end), offset, step, visit);
        }
        RayPath::Contracted { origin, direction } => contracted(grid, *origin, *direction, offset, step, visit),
    }
}

/// Unit-cube length of a step of `step` voxels.
fn step_length<T: Real>(grid: &Grid<T>, step: f64) -> f64 {
    let largest = *grid.dims.iter().max().expect("three sides");
    step / (largest - 1) as f64
}

#[inline(always)]
fn cell_of<T: Real>(grid: &Grid<T>, p: [T; 3]) -> ([usize; 3], [T; 3]) {
    let mut cell = [0usize; 3];
    let mut frac = [T::zero(); 3];
    for k in 0..3 {
        // Rounding may leave the cube by an ulp; the clamp keeps it inside.
        let v = p[k].max(T::zero());
        cell[k] = v.whole().min(grid.dims[k] - 2);
        frac[k] = (v - T::of(cell[k] as f64)).min(T::one());
    }
    (cell, frac)
}

#[inline(always)]
fn linear<T>(grid: &Grid<T>, cell: [usize; 3]) -> usize {
    (cell[2] * grid.dims[1] + cell[1]) * grid.dims[0] + cell[0]
}

/// Steps that fit before a point moving at `velocity` (voxels a step) leaves its block.
#[inline(always)]
fn steps_in_block<T: Real>(p: [T; 3], velocity: [T; 3], cell: [usize; 3]) -> usize {
    let side = Grid::<T>::block_side();
    let mut least = T::of(1e6);
    for k in 0..3 {
        let low = T::of((cell[k] / side * side) as f64);
        let high = low + T::of(side as f64);
        let v = velocity[k];
        if v > T::of(1e-6) {
            least = least.min((high - p[k]) / v);
        } else if v < T::of(-1e-6) {
            least = least.min((low - p[k]) / v);
        }
    }
    least.ceil().whole().max(1)
}

#[inline(always)]
fn straight<T: Real>(
    grid: &Grid<T>,
    (origin, direction): ([f64; 3], [f64; 3]),
    (start, end): (f64, f64),
    offset: f64,
    step: f64,
    mut visit: impl FnMut(&Sample<T>) -> bool,
) {
    let scale: [f64; 3] = std::array::from_fn(|k| (grid.dims[k] - 1) as f64);
    let speed = (0..3).map(|k| (direction[k] * scale[k]).powi(2)).sum::<f64>().sqrt();
    let dt = step / speed;
    let count = ((end - start) / dt).floor() as usize;
    let first: [T; 3] = std::array::from_fn(|k| T::of((origin[k] + direction[k] * (start + offset * dt)) * scale[k]));
    let velocity: [T; 3] = std::array::from_fn(|k| T::of(direction[k] * dt * scale[k]));
    lattice(grid, (first, velocity), count, (T::zero(), T::of(step_length(grid, step))), &mut visit);
}

/// Visits the occupied ones of `count` points `first + i velocity` (voxels), each
/// standing for `length`, the first `along` from the start. False once `visit`
/// wants no more.
#[inline(always)]
fn lattice<T: Real>(
    grid: &Grid<T>,
    (first, velocity): ([T; 3], [T; 3]),
    count: usize,
    (along, length): (T, T),
    visit: &mut impl FnMut(&Sample<T>) -> bool,
) -> bool {
    let mut i = 0;
    while i < count {
        let n = T::of(i as f64);
        let p: [T; 3] = std::array::from_fn(|k| first[k] + velocity[k] * n);
        let (cell, frac) = cell_of(grid, p);
        if !grid.block_occupied(cell[0], cell[1], cell[2]) {
            i += steps_in_block(p, velocity, cell);
            continue;
        }
        i += 1;
        let at = linear(grid, cell);
        if !grid.cell_occupied(at) {
            continue;
        }
        if !visit(&Sample { cell: at as u32, frac, length, along: along + n * length, far: false }) {
            return false;
        }
    }
    true
}

#[inline(always)]
fn contracted<T: Real>(
    grid: &Grid<T>,
    origin: [f64; 3],
    direction: [f64; 3],
    offset: f64,
    step: f64,
    mut visit: impl FnMut(&Sample<T>) -> bool,
) {
    let quarter: [T; 3] = std::array::from_fn(|k| T::of((grid.dims[k] - 1) as f64 * 0.25));
    let (o, d) = (origin.map(T::of), direction.map(T::of));
    let (one, two) = (T::one(), T::of(2.0));
    let far_step = T::of(step.max(FAR_STEP_VOXELS));
    let (near_length, far_length) = (T::of(step_length(grid, step)), T::of(step_length(grid, far_step.wide())));
    let offset = T::of(offset);
    let limit = T::of(2.0 * *grid.dims.iter().max().expect("three sides") as f64);
    let norm = |v: [T; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    let inner_velocity: [T; 3] = std::array::from_fn(|k| d[k] * quarter[k]);
    let inner_dt = T::of(step) / norm(inner_velocity);
    let inner_velocity = inner_velocity.map(|v| v * inner_dt);
    let (mut t, mut along) = (T::zero(), T::zero());
    loop {
        let x: [T; 3] = std::array::from_fn(|k| o[k] + d[k] * t);
        let (mut n, mut axis) = (x[0].abs(), 0);
        for k in 1..3 {
            if x[k].abs() > n {
                (n, axis) = (x[k].abs(), k);
            }
        }
        let outward = x[axis] * d[axis] > T::zero();
        if n > limit && outward {
            return;
        }
        let inside = n <= one;
        if inside {
            // Space is straight here, and steps are cheap up to the inner box's end.
            let mut room = T::of(1e6);
            for k in 0..3 {
                if d[k] != T::zero() {
                    let end = if d[k] > T::zero() { one } else { -one };
                    room = room.min((end - x[k]) / (d[k] * inner_dt) - offset);
                }
            }
            if room >= T::zero() {
                let count = room.whole() + 1;
                let first = std::array::from_fn(|k| (x[k] + d[k] * inner_dt * offset + two) * quarter[k]);
                if !lattice(grid, (first, inner_velocity), count, (along, near_length), &mut visit) {
                    return;
                }
                let count = T::of(count as f64);
                t += inner_dt * count;
                along += near_length * count;
                continue;
            }
        }
        let (dt, length) = if inside {
            (inner_dt, near_length)
        } else {
            // d/dt of x (2/n - 1/n^2): the speed in voxels.
            let inverse = n.recip();
            let (s, dn) = ((two - inverse) * inverse, if outward { d[axis].abs() } else { -d[axis].abs() });
            let ds = dn * (two * inverse - two) * inverse * inverse;
            (far_step / norm(std::array::from_fn(|k| (d[k] * s + x[k] * ds) * quarter[k])), far_length)
        };
        let x: [T; 3] = std::array::from_fn(|k| x[k] + d[k] * dt * offset);
        let n = x[0].abs().max(x[1].abs()).max(x[2].abs());
        let s = if n > one { (two - n.recip()) * n.recip() } else { one };
        let p: [T; 3] = std::array::from_fn(|k| (x[k] * s + two) * quarter[k]);
        let (cell, frac) = cell_of(grid, p);
        let at = linear(grid, cell);
        if grid.cell_occupied(at) && !visit(&Sample { cell: at as u32, frac, length, along, far: n > one }) {
            return;
        }
        t += dt;
        along += length;
    }
}
