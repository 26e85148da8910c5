//! Where the field is looked up, against the geometry alone: samples lie on their
//! ray, in order, and stand for all of its length; and passing empty space over
//! never adds, moves or loses one.

use crate::common::{Numbers, Ray, ahead, ball_box, random_grid};
use cairn_field::grid::lattice::Grid;
use cairn_field::rays::march::{STEP_VOXELS, Sample, march};
use cairn_field::{RayPath, Real, SceneFrame};
use glam::DVec3;

const CENTRE: DVec3 = DVec3::new(0.3, -0.2, 0.5);
const HALF: DVec3 = DVec3::new(1.25, 1.0, 1.5);

fn open() -> SceneFrame {
    SceneFrame::Unbounded { centre: CENTRE, half: HALF }
}

/// Rays of every kind, `far` of them from very far away as well.
fn rays(frame: &SceneFrame, n: usize) -> Vec<Ray> {
    let mut numbers = Numbers(17);
    let mut cube = |size: f64| DVec3::from([0.0; 3].map(|_| numbers.within(-size, size)));
    let mut rays = Vec::new();
    for i in 0..n {
        let d = cube(1.0);
        match i % 4 {
            0 => rays.push((CENTRE + cube(0.9) * HALF, d)),
            1 => rays.push((CENTRE + cube(8.0), d)),
            2 => rays.push((CENTRE + cube(5.0) + 3.0 * d.normalize(), -d)),
            _ => {
                let o = cube(1.0) * [30.0, 1e3, 1e5][i / 4 % 3];
                rays.push((o, CENTRE + cube(3.0) - o));
            }
        }
    }
    // Exactly along axes, sides, edges and diagonals, from exact places.
    let signs = [-1.0, 0.0, 1.0];
    let all = || signs.into_iter().flat_map(move |x| signs.map(|y| (x, y)));
    for (x, y) in all() {
        for z in signs {
            let d = DVec3::new(x, y, z);
            if d == DVec3::ZERO {
                continue;
            }
            for o in
                [DVec3::ZERO, DVec3::ONE, DVec3::new(1.0, -1.0, 0.0), DVec3::new(0.25, 1.0, -3.0), 2.0 * d, -2.0 * d]
            {
                rays.push((CENTRE + o * HALF, d * HALF));
                rays.push((CENTRE + o * HALF, d));
            }
        }
    }
    let ray = |(origin, direction): (DVec3, DVec3)| Ray { origin, direction: direction.normalize() };
    rays.into_iter().map(ray).filter(|ray| ray.path(frame) != RayPath::Miss).collect()
}

/// A point of a curve: its parameter and its place.
#[derive(Clone, Copy)]
struct Point {
    at: f64,
    place: DVec3,
}

impl Point {
    fn of(curve: &impl Fn(f64) -> DVec3, at: f64) -> Self {
        Self { at, place: curve(at) }
    }
}

/// Length of `curve` from `a` to `b`: chords, halved until they are straight.
fn length(curve: &impl Fn(f64) -> DVec3, a: Point, b: Point, depth: u32) -> f64 {
    let m = Point::of(curve, 0.5 * (a.at + b.at));
    let [p, q, r] = [a, b, m].map(|point| point.place);
    let (whole, halves) = ((q - p).length(), (r - p).length() + (q - r).length());
    if depth == 0 || depth < 40 && halves < 0.02 && halves - whole < 1e-6 * halves {
        return halves;
    }
    length(curve, a, m, depth - 1) + length(curve, m, b, depth - 1)
}

/// Length of a ray in the grid, in unit-cube lengths of its longest side.
fn arc(frame: &SceneFrame, dims: [usize; 3], o: DVec3, d: DVec3) -> f64 {
    let scale = DVec3::from(dims.map(|n| (n - 1) as f64)) / (dims.into_iter().max().unwrap() - 1) as f64;
    let unit = |t: f64| frame.unit(o + d * t).expect("a place") * scale;
    match frame.path(o, d) {
        RayPath::Straight { origin, direction, start, end } => {
            let at = |t: f64| (DVec3::from(origin) + DVec3::from(direction) * t) * scale;
            (at(end) - at(start)).length()
        }
        _ => {
            // To the nearest place, and on to infinity.
            let nearest = (CENTRE - o).dot(d).max(0.0);
            let beyond = |s: f64| unit(nearest + s / (1.0 - s).max(1e-12));
            let piece = |at: &dyn Fn(f64) -> DVec3, b: f64| length(&at, Point::of(&at, 0.0), Point::of(&at, b), 46);
            let to = if nearest > 0.0 { piece(&unit, nearest) } else { 0.0 };
            to + piece(&beyond, 1.0)
        }
    }
}

fn samples<T: Real>(grid: &Grid<T>, path: &RayPath, offset: f64, step: f64) -> Vec<Sample<T>> {
    let mut out = Vec::new();
    march(grid, path, offset, step, |s| {
        out.extend(s.each());
        true
    });
    out
}

/// A sample's place, voxels.
fn place<T: Real>(grid: &Grid<T>, s: &Sample<T>) -> DVec3 {
    let cell = s.cell as usize;
    let [nx, ny, _] = grid.dims;
    let at = [cell % nx, cell / nx % ny, cell / (nx * ny)];
    DVec3::from(std::array::from_fn(|k| at[k] as f64 + s.frac[k].wide()))
}

/// The world point at a place of the unit cube.
fn world(frame: &SceneFrame, u: DVec3) -> DVec3 {
    match frame {
        SceneFrame::Bounded { centre, half } => (u * 2.0 - 1.0) * *half + *centre,
        SceneFrame::Unbounded { centre, half } => {
            let bent = u * 4.0 - 2.0;
            let n = bent.abs().max_element();
            (if n > 1.0 { bent / (n * (2.0 - n)) } else { bent }) * *half + *centre
        }
        SceneFrame::ForwardFacing { rotation, position, near, low, high } => {
            let z = near / (1.0 - u.z);
            let x = (u.x * (high[0] - low[0]) + low[0]) * z;
            let y = (u.y * (high[1] - low[1]) + low[1]) * z;
            rotation.transpose() * DVec3::new(x, y, z) + *position
        }
    }
}

/// How far off a ray's samples may lie, voxels: where a ray runs along a side of the
/// contracted cube its path is a parabola only nearly.
const OFF: f64 = 0.01;

fn check<T: Real>(frame: &SceneFrame, grid: &Grid<T>, ray: Ray, rounding: f64) {
    let (path, Ray { origin: o, direction: d }) = (ray.path(frame), ray);
    let found = samples(grid, &path, 0.5, STEP_VOXELS);
    let voxels = DVec3::from(grid.dims.map(|n| (n - 1) as f64));
    let largest = voxels.max_element();
    let told = format!("from {o} along {d}");
    let (mut last, mut sum) = (f64::NEG_INFINITY, 0.0);
    for s in &found {
        let numbers = [s.length.wide(), s.along.wide()];
        assert!(numbers.iter().all(|v| v.is_finite() && *v >= 0.0), "{told}: {s:?}");
        assert!(s.frac.iter().all(|f| (0.0..=1.0).contains(&f.wide())), "{told}: {s:?}");
        let at = place(grid, s);
        assert!(s.along.wide() >= last, "{told}: {} along after {last}", s.along.wide());
        last = s.along.wide();
        sum += s.length.wide();
        if !world(frame, at / voxels).is_finite() {
            // At infinity itself: a stretch too short for numbers between.
            assert!(s.length.wide() < 1e-6, "{told}: {s:?}");
            continue;
        }
        // The ray's point nearest to it, by way of the world.
        let t = (world(frame, at / voxels) - o).dot(d);
        let on_ray = frame.unit(o + d * t.max(0.0)).expect("a place") * voxels;
        let off = (on_ray - at).length();
        assert!(off < OFF + rounding, "{told}: {at} is {off} voxels off the ray");
    }
    for pair in found.windows(2) {
        let (a, b) = (place(grid, &pair[0]), place(grid, &pair[1]));
        let [s, t] = [a, b].map(|p| (world(frame, p / voxels) - o).dot(d));
        assert!(!t.is_finite() || t > s - 1e-4 * s.abs(), "{told}: at {t} after {s}");
        assert!((b - a).length() < 2.0, "{told}: {a}, then {b}");
    }
    let expected = arc(frame, grid.dims, o, d);
    assert!((sum - expected).abs() < 0.01 * expected + 1e-6, "{told}: {sum} of {expected}");
    let reached = last + found.last().map_or(0.0, |s| s.length.wide() / 2.0);
    assert!((reached - expected).abs() < 0.02 * expected + 1.0 / largest, "{told}: {reached} along of {expected}");
}

#[test]
fn samples_lie_on_their_ray_in_order_and_cover_it() {
    for (frame, dims) in [(ball_box(), [22, 18, 26]), (open(), [41, 34, 49]), (ahead(), [26, 28, 18])] {
        let grid: Grid<f64> = Grid::full(dims, 0.0, 0.5);
        let rays = rays(&frame, 400);
        assert!(rays.len() > 100, "only {} rays", rays.len());
        for ray in &rays {
            check(&frame, &grid, *ray, 1e-6);
        }
        let grid: Grid<f32> = grid.cast();
        for ray in rays {
            check(&frame, &grid, ray, 1e-3);
        }
    }
}

#[test]
fn skipping_is_only_skipping() {
    for (frame, dims) in [(ball_box(), [43, 39, 46]), (open(), [61, 54, 69]), (ahead(), [46, 48, 38])] {
        // Lumps, far apart: long strides between them. No density at all elsewhere.
        let mut sparse: Grid<f32> = random_grid(dims, 1.0, -3.0..0.0, 3);
        for (v, raw) in sparse.raw.iter_mut().enumerate() {
            let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
            if at.iter().any(|k| k % 17 > 2) {
                *raw = -1e4;
            }
        }
        let mut whole = sparse.clone();
        whole.refresh_occupancy(0.0);
        assert_eq!(whole.occupancy.cells(), dims.map(|n| n - 1).iter().product::<usize>());
        sparse.refresh_occupancy(1e-30);
        assert!(sparse.occupancy.cells() * 20 < whole.occupancy.cells(), "most cells are empty");
        let mut met = 0;
        for Ray { origin: o, direction: d } in rays(&frame, 800) {
            let path = frame.path(o, d);
            for (offset, step) in [(0.5, STEP_VOXELS), (0.0, STEP_VOXELS), (0.37, 1.0), (0.0, 1.0), (0.9, 0.03)] {
                let mut expected = samples(&whole, &path, offset, step);
                let [nx, ny, _] = dims;
                expected.retain(|s| {
                    let cell = s.cell as usize;
                    sparse.occupancy.holds([cell % nx, cell / nx % ny, cell / (nx * ny)])
                });
                let found = samples(&sparse, &path, offset, step);
                assert_eq!(found.len(), expected.len(), "from {o} along {d}, steps of {step} from {offset}");
                for (a, b) in found.iter().zip(&expected) {
                    assert_eq!((a.cell, a.frac, a.length, a.along, a.far), (b.cell, b.frac, b.length, b.along, b.far));
                }
                met += found.len();
            }
        }
        assert!(met > 1000, "only {met} samples");
    }
}
