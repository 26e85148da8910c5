//! How a ray runs through the grid: one to a few segments, in each of which its place is
//! quadratic in the sample's number. In a box it is even linear. In contracted space, between
//! two changes of the coordinate that is largest, `x = A + B n` with that
//! coordinate's magnitude `n`, and `contract(x) = (A u + B) (2 - u)` with
//! `u = 1 / n`: no root and no division a sample, and infinity is `u = 0`.

use super::frame::RayPath;
use crate::grid::real::{Real, larger, smaller};

/// Largest number of samples of a segment, whatever the step.
const MAX_SAMPLES: f64 = 16_777_216.0;

/// A stretch of a ray; see the module's text.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment<T> {
    /// Sample i lies at `place[0] + i place[1] + i^2 place[2]`, voxels.
    pub(crate) place: [[T; 3]; 3],
    pub(crate) count: usize,
    /// Steps a voxel at least, going up and going down each axis.
    pub(crate) up: [T; 3],
    pub(crate) down: [T; 3],
    /// The square of sample i's length is `length[0] + i length[1] + i^2 length[2]`.
    pub(crate) length: [T; 3],
    /// Sample i is `along[0] + i along[1]` along the ray.
    pub(crate) along: [T; 2],
    pub(crate) far: bool,
}

/// A stretch of a ray before it is cut into samples: its place, voxels, is
/// `c[0] + c[1] s + c[2] s^2` for `s` in [0, 1].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    c: [[f64; 3]; 3],
    /// Beyond the inner box.
    pub(crate) far: bool,
}

impl<T: Real> Segment<T> {
    /// One without samples.
    pub(crate) fn nowhere() -> Self {
        let zero = [T::zero(); 3];
        Self { place: [zero; 3], count: 0, up: zero, down: zero, length: zero, along: [T::zero(); 2], far: false }
    }
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
    #[inline(always)]
    pub(crate) fn segment<T: Real>(&self, dims: [usize; 3], offset: f64, step: f64, along: &mut f64) -> Segment<T> {
        // Simpson's rule; exact where the stretch is straight.
        let voxels =
            if self.far { (self.speed(0.0) + 4.0 * self.speed(0.5) + self.speed(1.0)) / 6.0 } else { self.speed(0.0) };
        let largest = (*dims.iter().max().expect("three sides") - 1) as f64;
        // Not `clamp`, which would leave what is not a number.
        let count = smaller(larger((voxels / step).ceil(), 1.0), MAX_SAMPLES);
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

/// The stretches of a ray, near to far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretches {
    origin: [f64; 3],
    direction: [f64; 3],
    /// Voxels a unit of the inner box's half sides.
    quarter: [f64; 3],
    /// Where a stretch may end, of which `cut..ends` are still to come.
    cuts: [f64; 12],
    cut: usize,
    ends: usize,
    /// How far along the ray the next one begins, in units of `direction`; infinite at the end.
    from: f64,
    /// The only one there is, where the ray is straight.
    straight: Option<Stretch>,
}

impl Stretches {
    /// Those of `path` through a grid of `dims` vertices.
    #[inline(always)]
    pub(crate) fn of(dims: [usize; 3], path: &RayPath) -> Self {
        let none = Self {
            origin: [0.0; 3],
            direction: [0.0; 3],
            quarter: dims.map(|d| (d - 1) as f64 * 0.25),
            cuts: [0.0; 12],
            cut: 0,
            ends: 0,
            from: f64::INFINITY,
            straight: None,
        };
        match path {
            RayPath::Miss => none,
            RayPath::Straight { origin, direction, start, end } => {
                let at = |t: f64| std::array::from_fn(|k| (origin[k] + direction[k] * t) * (dims[k] - 1) as f64);
                Self { straight: Some(Stretch::linear(at(*start), at(*end), false)), ..none }
            }
            RayPath::Contracted { origin, direction } => {
                let (cuts, ends) = cuts(*origin, *direction);
                Self { origin: *origin, direction: *direction, cuts, ends, from: 0.0, ..none }
            }
        }
    }

    /// The next one.
    #[inline(always)]
    pub(crate) fn next(&mut self) -> Option<Stretch> {
        if let Some(straight) = self.straight.take() {
            return Some(straight);
        }
        let (o, d) = (self.origin, self.direction);
        while self.from.is_finite() {
            let mut to = self.end();
            let Some((axis, far)) = largest(o, d, self.from, to) else {
                // Nothing lies between two equal cuts.
                self.from = if to.is_finite() { self.from } else { to };
                continue;
            };
            // Cuts between the two smaller coordinates change nothing.
            while to.is_finite() {
                let next = if self.cut < self.ends { self.cuts[self.cut] } else { f64::INFINITY };
                if largest(o, d, to, next).is_some_and(|now| now != (axis, far)) {
                    break;
                }
                to = self.end();
            }
            let from = std::mem::replace(&mut self.from, to);
            return Some(if far {
                outside(o, d, axis, from, to, self.quarter)
            } else {
                let at = |t: f64| std::array::from_fn(|k| (o[k] + d[k] * t + 2.0) * self.quarter[k]);
                Stretch::linear(at(from), at(to), false)
            });
        }
        None
    }

    /// Takes the next cut; infinity behind the last.
    #[inline(always)]
    fn end(&mut self) -> f64 {
        self.cut += 1;
        if self.cut <= self.ends { self.cuts[self.cut - 1] } else { f64::INFINITY }
    }
}

/// A stretch beyond the inner box, from `from` to `to` along the ray, in which `axis` is the largest coordinate.
fn outside(o: [f64; 3], d: [f64; 3], axis: usize, from: f64, to: f64, quarter: [f64; 3]) -> Stretch {
    let near = (o[axis] + d[axis] * from).abs().max(1.0);
    let far = if to.is_finite() { (o[axis] + d[axis] * to).abs().max(1.0) } else { f64::INFINITY };
    let voxels = |x: [f64; 3]| std::array::from_fn(|k| (x[k] + 2.0) * quarter[k]);
    if (near / far - 1.0).abs() < 0.02 {
        // The ray runs along a side of the cube: u hardly changes, and t serves.
        let bent = |t: f64| {
            let x: [f64; 3] = std::array::from_fn(|k| o[k] + d[k] * t);
            let u = 1.0 / x[axis].abs().max(1.0);
            voxels(x.map(|v| v * u * (2.0 - u)))
        };
        return Stretch::through(bent(from), bent(0.5 * (from + to)), bent(to), true);
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
