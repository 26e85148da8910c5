//! Where along a ray the field is sampled: points half a voxel apart in grid
//! coordinates (a whole one beyond the inner box), empty space passed over.
//! Skipping never moves a sample: the points are a lattice fixed by the ray alone.
//!
//! A ray is one to a few segments in which its place in the grid is quadratic in
//! the sample's number. In a box it is even linear. In contracted space, between
//! two changes of the coordinate that is largest, `x = A + B n` with that
//! coordinate's magnitude `n`, and `contract(x) = (A u + B) (2 - u)` with
//! `u = 1 / n`: no root and no division a sample, and infinity is `u = 0`.

use crate::frame::RayPath;
use crate::grid::Grid;
use crate::occupancy::{BLOCK, bit};
use crate::real::Real;

/// Distance between samples in a picture, in voxels.
pub const STEP_VOXELS: f64 = 0.5;
/// The least distance between samples in contracted space, in voxels: those are
/// drawn out in depth, where nobody can tell.
pub const FAR_STEP_VOXELS: f64 = 1.0;
/// Most samples of a segment, whatever the step.
const MOST_SAMPLES: f64 = 16_777_216.0;

/// More than f32 rounds a place in the largest grid (4096 voxels a side), voxels.
const ROUNDING: f64 = 1e-3;

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

/// A stretch of a ray; see the module's text.
#[derive(Clone, Copy, Debug)]
struct Segment<T> {
    /// Sample i lies at `place[0] + i place[1] + i^2 place[2]`, voxels.
    place: [[T; 3]; 3],
    count: usize,
    /// Steps a voxel at least, going up and going down each axis.
    up: [T; 3],
    down: [T; 3],
    /// The square of sample i's length is `length[0] + i length[1] + i^2 length[2]`.
    length: [T; 3],
    /// Sample i is `along[0] + i along[1]` along the ray.
    along: [T; 2],
    far: bool,
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
    mut visit: impl FnMut(&Sample<T>) -> bool,
) {
    match path {
        RayPath::Miss => {}
        RayPath::Straight { origin, direction, start, end } => {
            let at = |t: f64| std::array::from_fn(|k| (origin[k] + direction[k] * t) * (grid.dims[k] - 1) as f64);
            let stretch = Stretch::linear(at(*start), at(*end), false);
            let mut along = 0.0;
            let segment = stretch.segment(grid.dims, offset, step, &mut along);
            traverse(grid, &segment, &mut visit);
        }
        RayPath::Contracted { origin, direction } => {
            let mut along = 0.0;
            for_stretches(grid.dims, *origin, *direction, |stretch| {
                let step = if stretch.far { step.max(FAR_STEP_VOXELS) } else { step };
                let segment = stretch.segment(grid.dims, offset, step, &mut along);
                traverse(grid, &segment, &mut visit)
            });
        }
    }
}

/// Visits a segment's samples; false once `visit` wants no more.
#[inline(always)]
fn traverse<T: Real>(grid: &Grid<T>, s: &Segment<T>, visit: &mut impl FnMut(&Sample<T>) -> bool) -> bool {
    let last = grid.dims.map(|d| d - 2);
    let mut i = 0;
    while i < s.count {
        let n = T::of(i as f64);
        let mut p = [T::zero(); 3];
        let mut cell = [0usize; 3];
        for k in 0..3 {
            // Rounding may leave the cube by an ulp; the clamps keep it inside.
            p[k] = (s.place[0][k] + n * (s.place[1][k] + n * s.place[2][k])).max(T::zero());
            cell[k] = p[k].whole().min(last[k]);
        }
        let block = grid.occupancy.block_of(cell);
        let mask = grid.occupancy.mask(block);
        if mask == 0 {
            i += stride(s, p, cell, grid.occupancy.reach(block));
            continue;
        }
        if mask >> bit(cell) & 1 == 1 {
            let at = (cell[2] * grid.dims[1] + cell[1]) * grid.dims[0] + cell[0];
            let sample = Sample {
                cell: at as u32,
                frac: std::array::from_fn(|k| (p[k] - T::of(cell[k] as f64)).min(T::one())),
                length: (s.length[0] + n * (s.length[1] + n * s.length[2])).max(T::zero()).sqrt(),
                along: s.along[0] + n * s.along[1],
                far: s.far,
            };
            if !visit(&sample) {
                return false;
            }
        }
        i += 1;
    }
    true
}

/// Samples to the next one that may lie outside the empty cube of blocks around
/// `cell`, whose half side is `reach` blocks. What is passed over lies inside by
/// more than a place is rounded: a sample on the very side is looked at.
#[inline(always)]
fn stride<T: Real>(s: &Segment<T>, p: [T; 3], cell: [usize; 3], reach: usize) -> usize {
    let mut least = T::of(1e9);
    for k in 0..3 {
        let block = (cell[k] / BLOCK) as i32;
        let low = (block - reach as i32 + 1) * BLOCK as i32;
        let high = (block + reach as i32) * BLOCK as i32;
        let (above, below) = (T::of(f64::from(high) - ROUNDING) - p[k], p[k] - T::of(f64::from(low) + ROUNDING));
        least = least.min(above * s.up[k]).min(below * s.down[k]);
    }
    least.whole() + 1
}

/// A stretch of a ray before it is cut into samples: its place, voxels, is
/// `c[0] + c[1] s + c[2] s^2` for `s` in [0, 1].
#[derive(Clone, Copy, Debug)]
struct Stretch {
    c: [[f64; 3]; 3],
    far: bool,
}

impl Stretch {
    fn linear(from: [f64; 3], to: [f64; 3], far: bool) -> Self {
        Self { c: [from, std::array::from_fn(|k| to[k] - from[k]), [0.0; 3]], far }
    }

    /// Through three places, at s = 0, 1/2 and 1.
    fn through(from: [f64; 3], middle: [f64; 3], to: [f64; 3], far: bool) -> Self {
        let second: [f64; 3] = std::array::from_fn(|k| 2.0 * (from[k] + to[k]) - 4.0 * middle[k]);
        Self { c: [from, std::array::from_fn(|k| to[k] - from[k] - second[k]), second], far }
    }

    /// Speed at `s`, voxels.
    fn speed(&self, s: f64) -> f64 {
        (0..3).map(|k| (self.c[1][k] + 2.0 * s * self.c[2][k]).powi(2)).sum::<f64>().sqrt()
    }

    /// Cuts it into even shares of `s`, about `step` voxels long; moves `along` to its end.
    fn segment<T: Real>(&self, dims: [usize; 3], offset: f64, step: f64, along: &mut f64) -> Segment<T> {
        // Simpson's rule; exact where the stretch is straight.
        let voxels =
            if self.far { (self.speed(0.0) + 4.0 * self.speed(0.5) + self.speed(1.0)) / 6.0 } else { self.speed(0.0) };
        let largest = (*dims.iter().max().expect("three sides") - 1) as f64;
        let count = (voxels / step).ceil().clamp(1.0, MOST_SAMPLES);
        let h = 1.0 / count;
        let [a, b, c] = self.c;
        let first = offset * h;
        let velocity = |s: f64| -> [f64; 3] { std::array::from_fn(|k| (b[k] + 2.0 * s * c[k]) * h) };
        // Speeds are linear in s: largest at an end.
        let (start, end) = (velocity(0.0), velocity(1.0));
        let bound = |sign: f64| -> [T; 3] {
            std::array::from_fn(|k| T::of((1.0 / (sign * start[k]).max(sign * end[k]).max(1e-9)).min(1e9)))
        };
        // |velocity|^2 is quadratic in s, and s linear in i.
        let square = |x: [f64; 3], y: [f64; 3]| (0..3).map(|k| x[k] * y[k]).sum::<f64>() / (largest * largest);
        let (now, change) = (velocity(first), c.map(|c| 2.0 * c * h * h));
        let length = [square(now, now), 2.0 * square(now, change), square(change, change)];
        let begun = *along;
        *along += voxels / largest;
        Segment {
            place: [
                std::array::from_fn(|k| T::of(a[k] + first * (b[k] + first * c[k]))),
                now.map(T::of),
                c.map(|c| T::of(c * h * h)),
            ],
            count: count as usize,
            up: bound(1.0),
            down: bound(-1.0),
            length: length.map(T::of),
            along: [T::of(begun + offset * voxels * h / largest), T::of(voxels * h / largest)],
            far: self.far,
        }
    }
}

/// Calls `each` for the stretches of a ray through contracted space, near to far,
/// until it returns false.
#[inline(always)]
fn for_stretches(dims: [usize; 3], o: [f64; 3], d: [f64; 3], mut each: impl FnMut(Stretch) -> bool) {
    let quarter: [f64; 3] = std::array::from_fn(|k| (dims[k] - 1) as f64 * 0.25);
    let (cuts, n) = cuts(o, d);
    let mut from = 0.0;
    let mut cut = 0;
    while cut <= n {
        let mut to = if cut < n { cuts[cut] } else { f64::INFINITY };
        cut += 1;
        let Some((axis, far)) = largest(o, d, from, to) else { continue };
        // Cuts between the two smaller coordinates change nothing.
        while to.is_finite() {
            let next = if cut < n { cuts[cut] } else { f64::INFINITY };
            if largest(o, d, to, next).is_some_and(|now| now != (axis, far)) {
                break;
            }
            (to, cut) = (next, cut + 1);
        }
        let stretch = if far {
            outside(o, d, axis, (from, to), quarter)
        } else {
            let at = |t: f64| std::array::from_fn(|k| (o[k] + d[k] * t + 2.0) * quarter[k]);
            Stretch::linear(at(from), at(to), false)
        };
        if !each(stretch) {
            return;
        }
        from = to;
    }
}

/// A stretch beyond the inner box, between `t`, in which `axis` is the largest coordinate.
fn outside(o: [f64; 3], d: [f64; 3], axis: usize, t: (f64, f64), quarter: [f64; 3]) -> Stretch {
    let near = (o[axis] + d[axis] * t.0).abs().max(1.0);
    let far = if t.1.is_finite() { (o[axis] + d[axis] * t.1).abs().max(1.0) } else { f64::INFINITY };
    let voxels = |x: [f64; 3]| std::array::from_fn(|k| (x[k] + 2.0) * quarter[k]);
    if (near / far - 1.0).abs() < 0.02 {
        // The ray runs along a side of the cube: u hardly changes, and t serves.
        let bent = |t: f64| {
            let x: [f64; 3] = std::array::from_fn(|k| o[k] + d[k] * t);
            let u = 1.0 / x[axis].abs().max(1.0);
            voxels(x.map(|v| v * u * (2.0 - u)))
        };
        return Stretch::through(bent(t.0), bent(0.5 * (t.0 + t.1)), bent(t.1), true);
    }
    let sign = if near < far { d[axis].signum() } else { -d[axis].signum() };
    let place = |u: f64| {
        let x: [f64; 3] = std::array::from_fn(|k| {
            if k == axis {
                return sign * (2.0 - u);
            }
            // x = a + b n, from t = (n sign - o_axis) / d_axis.
            let (a, b) = (o[k] - d[k] * (o[axis] / d[axis]), d[k] / d[axis] * sign);
            (a * u + b) * (2.0 - u)
        });
        voxels(x)
    };
    let (a, b) = (1.0 / near, 1.0 / far);
    Stretch::through(place(a), place(0.5 * (a + b)), place(b), true)
}

/// The largest coordinate between two `t`, and whether that is beyond the inner
/// box; `None` where there is nothing between.
#[inline(always)]
fn largest(o: [f64; 3], d: [f64; 3], from: f64, to: f64) -> Option<(usize, bool)> {
    let t = if to.is_finite() { 0.5 * (from + to) } else { 2.0 * from + 1.0 };
    if !(from < t && t < to) {
        return None;
    }
    let x: [f64; 3] = std::array::from_fn(|k| (o[k] + d[k] * t).abs());
    let axis = if x[0] >= x[1] && x[0] >= x[2] {
        0
    } else if x[1] >= x[2] {
        1
    } else {
        2
    };
    let far = x[axis] > 1.0;
    // Inside the box every axis is the same.
    Some((if far { axis } else { 0 }, far))
}

/// Where, ascending and beyond 0, two coordinates are equally large or one is 1.
/// Not so far out that no grid could show it: rounding would decide which is larger.
#[inline(always)]
fn cuts(o: [f64; 3], d: [f64; 3]) -> ([f64; 12], usize) {
    let (mut cuts, mut n) = ([0.0; 12], 0);
    let farthest = 1e7 * (1.0 + o[0].abs().max(o[1].abs()).max(o[2].abs()));
    let mut add = |t: f64| {
        if !(t > 0.0 && t < farthest) {
            return;
        }
        let mut at = n;
        while at > 0 && cuts[at - 1] > t {
            cuts[at] = cuts[at - 1];
            at -= 1;
        }
        cuts[at] = t;
        n += 1;
    };
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        add((o[j] - o[i]) / (d[i] - d[j]));
        add(-(o[i] + o[j]) / (d[i] + d[j]));
    }
    for k in 0..3 {
        add((1.0 - o[k]) / d[k]);
        add((-1.0 - o[k]) / d[k]);
    }
    (cuts, n)
}
