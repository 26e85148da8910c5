//! The renderer against a slow and obvious one, written anew in f64: the integral
//! along the ray, world point by world point in pieces far smaller than a voxel,
//! nothing skipped, no ray ended early. They share the field and no rule of where
//! to look at it; what steps of half a voxel leave of the integral is bounded.

use crate::common::{
    Numbers, Ray, ahead, ball_box, ball_in_the_open, camera, field_of, random_appearance, random_grid,
};
use cairn_field::appearance::code::features;
use cairn_field::grid::lattice::{DENSITY_SCALE, EMPTY_RAW, Grid, ROW};
use cairn_field::grid::sh::basis;
use cairn_field::rays::march::STEP_VOXELS;
use cairn_field::render::composite::gather;
use cairn_field::render::patch::Patch;
use cairn_field::{Appearance, SceneFrame, Thresholds};
use cairn_scene::Camera;
use glam::DVec3;
use std::f64::consts::PI;

/// A world point in the unit cube, and whether it lies beyond the inner box.
fn place(frame: &SceneFrame, p: DVec3) -> (DVec3, bool) {
    match frame {
        SceneFrame::Bounded { centre, half } => ((p - (*centre - *half)) / (2.0 * *half), false),
        SceneFrame::Unbounded { centre, half } => {
            let y = (p - *centre) / *half;
            let n = y.x.abs().max(y.y.abs()).max(y.z.abs());
            let bent = if n > 1.0 { y / n * (2.0 - 1.0 / n) } else { y };
            ((bent + 2.0) / 4.0, n > 1.0)
        }
        SceneFrame::ForwardFacing { rotation, position, near, low, high } => {
            let q = *rotation * (p - *position);
            let x = (q.x / q.z - low[0]) / (high[0] - low[0]);
            let y = (q.y / q.z - low[1]) / (high[1] - low[1]);
            (DVec3::new(x, y, 1.0 - near / q.z), false)
        }
    }
}

/// Places `t` that cut a ray into pieces of at most 1 / `fine` voxel, the inner
/// box's sides among them.
fn cuts(frame: &SceneFrame, dims: [usize; 3], o: DVec3, d: DVec3, fine: f64) -> Vec<f64> {
    let voxels = DVec3::from(dims.map(|n| (n - 1) as f64));
    let inside = |u: DVec3| u.min_element() >= 0.0 && u.max_element() <= 1.0;
    let even = |(start, end): (f64, f64), length: f64| {
        let n = (length * fine).ceil().max(1.0) as usize;
        (0..=n).map(move |i| start + (end - start) * i as f64 / n as f64)
    };
    match frame {
        SceneFrame::Unbounded { centre, half } => {
            let y = |t: f64| ((o + d * t - *centre) / *half).abs().max_element();
            let border = crossing(|t| y(t) <= 1.0, 0.0, 20.0);
            let mut cuts = vec![0.0];
            let mut t = 0.0;
            while y(t) < 1e5 {
                // Speed by a difference in space, well on this side of the border.
                let h = 1e-7 * (1.0 + t);
                let speed = ((place(frame, o + d * (t + h)).0 - place(frame, o + d * t).0) * voxels).length() / h;
                let next = t + 1.0 / (fine * speed);
                t = [border.0, border.1].into_iter().find(|b| t < *b && *b < next).unwrap_or(next);
                cuts.push(t);
            }
            cuts
        }
        SceneFrame::Bounded { half, .. } => {
            let ends = crossing(|t| inside(place(frame, o + d * t).0), 0.0, 20.0);
            even(ends, (d / (2.0 * *half) * voxels).length() * (ends.1 - ends.0)).collect()
        }
        SceneFrame::ForwardFacing { rotation, position, near, .. } => {
            // Even in device coordinates, where z' = 1 - near/z.
            let (q, w) = (*rotation * (o - *position), *rotation * d);
            let at = |s: f64| (near / (1.0 - s.min(1.0 - 1e-12)) - q.z) / w.z;
            let ends = crossing(|s| inside(place(frame, o + d * at(s)).0), 0.0, 1.0);
            let whole = (place(frame, o + d * at(ends.1)).0 - place(frame, o + d * at(ends.0)).0) * voxels;
            even(ends, whole.length()).map(at).collect()
        }
    }
}

/// The stretch of [low, high] where `inside` holds, by scan and bisection.
fn crossing(inside: impl Fn(f64) -> bool, low: f64, high: f64) -> (f64, f64) {
    let n = 4000;
    let at = |i: usize| low + (high - low) * i as f64 / n as f64;
    let edge = |mut yes: f64, mut no: f64| {
        for _ in 0..60 {
            let m = (yes + no) / 2.0;
            if inside(m) { yes = m } else { no = m }
        }
        yes
    };
    let Some(first) = (0..=n).find(|i| inside(at(*i))) else { return (0.0, 0.0) };
    let last = (first..=n).take_while(|i| inside(at(*i))).last().unwrap();
    let start = if first == 0 { low } else { edge(at(first), at(first - 1)) };
    let end = if last == n { high } else { edge(at(last), at(last + 1)) };
    (start, end)
}

/// Spherical harmonics from their Cartesian forms (Condon-Shortley phase).
fn harmonics(d: DVec3) -> [f64; 9] {
    let (x, y, z) = (d.x, d.y, d.z);
    let one = (3.0 / (4.0 * PI)).sqrt();
    let two = (15.0 / (4.0 * PI)).sqrt();
    [
        (1.0 / (4.0 * PI)).sqrt(),
        -one * y,
        one * z,
        -one * x,
        two * x * y,
        -two * y * z,
        (5.0 / (16.0 * PI)).sqrt() * (2.0 * z * z - x * x - y * y),
        -two * x * z,
        two / 2.0 * (x * x - y * y),
    ]
}

/// Raw density and the 27 coefficients at a unit-cube point.
fn look_up(grid: &Grid<f32>, u: DVec3) -> (f64, [f64; 27]) {
    let (mut raw, mut colour) = (0.0, [0.0; 27]);
    let g: [f64; 3] = std::array::from_fn(|k| u[k].clamp(0.0, 1.0) * (grid.dims[k] - 1) as f64);
    let low: [usize; 3] = std::array::from_fn(|k| (g[k].floor() as usize).min(grid.dims[k] - 2));
    for corner in 0..8usize {
        let at: [usize; 3] = std::array::from_fn(|k| low[k] + (corner >> k & 1));
        let w: f64 = (0..3).map(|k| 1.0 - (g[k] - at[k] as f64).abs()).product();
        let row = grid.index[at[0] + grid.dims[0] * (at[1] + grid.dims[1] * at[2])] as usize;
        let raw_there = grid.raw[at[0] + grid.dims[0] * (at[1] + grid.dims[1] * at[2])];
        raw += w * if row == 0 { EMPTY_RAW } else { f64::from(raw_there) };
        if row != 0 {
            for k in 0..27 {
                colour[k] += w * f64::from(grid.colour[row * ROW + k]);
            }
        }
    }
    (raw, colour)
}

/// One pixel: `code . (near, near weight, far, far weight, sky)`.
fn pixel(frame: &SceneFrame, grid: &Grid<f32>, look: &Appearance, ray: Ray, fine: f64) -> [f64; 3] {
    let Ray { origin: o, direction: d } = ray;
    let y = harmonics(d);
    let voxels = DVec3::from(grid.dims.map(|n| (n - 1) as f64));
    let mut light = 1.0;
    let mut f = [0.0f64; 17];
    for piece in cuts(frame, grid.dims, o, d, fine).windows(2) {
        let [a, b, m] = [piece[0], piece[1], 0.5 * (piece[0] + piece[1])].map(|t| place(frame, o + d * t));
        let length = ((b.0 - a.0) * voxels).length() / voxels.max_element();
        let (raw, colour) = look_up(grid, m.0);
        let alpha = 1.0 - (-DENSITY_SCALE * (1.0 + raw.exp()).ln() * length).exp();
        let first = if m.1 { 4 } else { 0 };
        for c in 0..3 {
            f[first + c] += light * alpha * (0..9).map(|k| y[k] * colour[3 * k + c]).sum::<f64>();
        }
        f[first + 3] += light * alpha;
        light *= 1.0 - alpha;
    }
    for k in 0..9 {
        f[8 + k] = light * y[k];
    }
    std::array::from_fn(|c| (0..17).map(|k| f64::from(look.code()[c * 17 + k]) * f[k]).sum::<f64>())
}

fn rays(camera: &Camera) -> Vec<Ray> {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let of = |(origin, direction)| Ray { origin, direction };
    (0..w * h).map(|i| of(camera.ray((i % w) as f64 + 0.5, (i / w) as f64 + 0.5))).collect()
}

/// The same field on a lattice `k` times as fine: piecewise trilinear as before.
fn refined(grid: &Grid<f32>, k: usize) -> Grid<f64> {
    let dims = grid.dims.map(|n| (n - 1) * k + 1);
    let mut fine: Grid<f64> = Grid::full(dims, 0.0, 0.0);
    for row in 1..fine.rows() {
        let v = fine.vertex[row] as usize;
        let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
        let u = DVec3::from(std::array::from_fn(|i| at[i] as f64 / (dims[i] - 1) as f64));
        let (raw, colour) = look_up(grid, u);
        fine.raw[v] = raw;
        fine.colour[row * ROW..row * ROW + 27].copy_from_slice(&colour);
    }
    fine
}

/// A grid with empty regions wider than a block, and haze and walls elsewhere.
fn patchy(dims: [usize; 3]) -> Grid<f32> {
    let mut grid = random_grid(dims, 0.9, -6.0..0.5, 21);
    for row in 1..grid.rows() {
        let v = grid.vertex[row] as usize;
        let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
        if at.iter().map(|k| k / 9).sum::<usize>() % 2 == 1 {
            grid.raw[v] = -40.0;
        }
    }
    grid
}

/// Soft bodies several voxels wide in front of one another, colours that change as slowly.
fn shapes(dims: [usize; 3]) -> Grid<f32> {
    let mut grid: Grid<f32> = Grid::full(dims, 0.0, 0.0);
    let mut numbers = Numbers(3);
    let mut waves = || -> [f64; 4] { std::array::from_fn(|_| numbers.within(-0.6, 0.6)) };
    let (body, colours): ([f64; 4], [[f64; 4]; 27]) = (waves(), std::array::from_fn(|_| waves()));
    let wave = |w: [f64; 4], at: [usize; 3]| (0..3).map(|k| w[k] * at[k] as f64).sum::<f64>() + 7.0 * w[3];
    for row in 1..grid.rows() {
        let v = grid.vertex[row] as usize;
        let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
        grid.raw[v] = (5.0 * wave(body, at).sin() - 4.5) as f32;
        for k in 0..27 {
            let level = if k < 3 { 1.7 } else { 0.0 };
            grid.colour[row * ROW + k] = (level + 0.5 * wave(colours[k], at).sin()) as f32;
        }
    }
    grid.refresh_occupancy(0.0);
    grid
}

/// Largest absolute and root mean square difference of two pictures.
fn differences(a: &[[f64; 3]], b: &[[f64; 3]]) -> (f64, f64) {
    assert_eq!(a.len(), b.len());
    let d: Vec<f64> = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).collect();
    (d.iter().fold(0.0, |m, v| m.max(*v)), (d.iter().map(|v| v * v).sum::<f64>() / d.len() as f64).sqrt())
}

fn wide(rgb: &[f32]) -> Vec<[f64; 3]> {
    rgb.chunks_exact(3).map(|p| std::array::from_fn(|c| f64::from(p[c]))).collect()
}

/// What the f64 renderer makes of a camera's rays, leaving nothing out.
fn rendered(frame: &SceneFrame, grid: &Grid<f64>, look: &Appearance, camera: &Camera, step: f64) -> Vec<[f64; 3]> {
    let limits = Thresholds { step, ..Thresholds::EXACT };
    let shade = |ray: Ray| {
        let basis = basis(ray.direction.to_array());
        let mut patch = Patch::default();
        patch.begin(basis);
        let gathered = gather(grid, &mut patch, &ray.path(frame), 0.5, limits, &mut Vec::new());
        look.shade(&features(&gathered, &basis))
    };
    rays(camera).into_iter().map(shade).collect()
}

/// Ever finer steps come ever closer to the integral, with the square of the step.
fn converges(frame: &SceneFrame, cameras: &[Camera]) {
    let look = random_appearance(8);
    let grid: Grid<f32> = random_grid([9, 8, 10], 0.9, -6.0..-1.0, 21);
    let expected: Vec<_> = cameras
        .iter()
        .map(|camera| rays(camera).into_iter().map(|ray| pixel(frame, &grid, &look, ray, 128.0)).collect::<Vec<_>>())
        .collect();
    let mut last = f64::INFINITY;
    // Steps of 1/4 to 1/32 voxel of `grid` in the inner box, 1/2 to 1/8 beyond it.
    for (k, step, most) in [(2, 0.5, 1e-2), (4, 0.5, 3e-3), (8, 0.25, 1e-3)] {
        let fine = refined(&grid, k);
        let off = cameras
            .iter()
            .zip(&expected)
            .map(|(camera, expected)| differences(&rendered(frame, &fine, &look, camera, step), expected).1);
        let off = off.fold(0.0, f64::max);
        assert!(off < most && off < 0.5 * last, "{k} times finer: {off} off, {last} before");
        last = off;
    }
}

/// Shipped pictures: `off` is how far (most, and root mean square) steps of half a
/// voxel, a whole one beyond the inner box, may leave them from the integral.
fn agree(frame: &SceneFrame, grid: &Grid<f32>, cameras: &[Camera], off: [f64; 2]) {
    let look = random_appearance(8);
    let field = field_of(frame, grid, &look);
    let mut whole = field.grid().cast::<f64>();
    whole.refresh_occupancy(0.0);
    for (n, camera) in cameras.iter().enumerate() {
        let expected: Vec<_> =
            rays(camera).into_iter().map(|ray| pixel(frame, field.grid(), &look, ray, 32.0)).collect();
        let spread = expected.iter().flatten().fold(0.0f64, |m, v| m.max(v - expected[0][0]));
        assert!(spread > 0.1, "view {n} shows nothing");
        let shown = wide(field.render(camera, &look).rgb());
        let (most, mean) = differences(&shown, &expected);
        assert!(most < off[0] && mean < off[1], "view {n}: {most} off, rms {mean}");
        // The same samples in f64. Left out in a shown picture: light behind 1e-3, samples below 1e-5.
        let same = rendered(frame, &whole, &look, camera, STEP_VOXELS);
        let (most, mean) = differences(&shown, &same);
        assert!(most < 3e-3 && mean < 1e-3, "view {n}, left out: {most}, rms {mean}");
        let exact: Vec<f32> = field
            .gather_view(camera, Thresholds::EXACT)
            .iter()
            .flat_map(|(g, basis)| look.shade(&features(g, basis)))
            .collect();
        let (most, mean) = differences(&wide(&exact), &same);
        assert!(most < 2e-5 && mean < 2e-6, "view {n}, rounding: {most}, rms {mean}");
    }
}

/// All of it, for a field whose neighbouring vertices have nothing in common (the
/// worst there is for any step) and for one with shapes of several voxels.
fn check(frame: &SceneFrame, dims: [usize; 3], cameras: &[Camera]) {
    agree(frame, &patchy(dims), cameras, [0.2, 0.04]);
    // Beyond an inner box steps are twice as long, and errors four times as large.
    let times = if frame.is_unbounded() { 4.0 } else { 1.0 };
    agree(frame, &shapes(dims), cameras, [0.02 * times, 4e-3 * times]);
    converges(frame, cameras);
}

#[test]
fn a_bounded_box() {
    let cameras = [
        camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 12),
        // Inside the grid, and along an axis.
        camera(DVec3::new(0.2, 0.1, -0.3), DVec3::new(1.0, 0.3, 0.0), 9),
        camera(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, 9),
    ];
    check(&ball_box(), [22, 18, 26], &cameras);
}

#[test]
fn contracted_space() {
    let cameras = [
        camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 10),
        camera(DVec3::new(0.2, 0.1, -0.3), DVec3::new(1.0, 0.3, 0.0), 9),
        // Away from the box: surroundings only.
        camera(DVec3::new(2.0, 0.3, 3.0), DVec3::new(5.0, 1.0, 9.0), 9),
    ];
    check(&ball_in_the_open(), [30, 26, 34], &cameras);
}

#[test]
fn device_coordinates() {
    let cameras = [
        camera(DVec3::new(0.05, 0.1, 0.02), DVec3::new(0.0, 0.0, 4.0), 12),
        camera(DVec3::new(-0.3, 0.1, -0.2), DVec3::new(0.4, 0.0, 4.0), 12),
    ];
    check(&ahead(), [26, 28, 18], &cameras);
}
