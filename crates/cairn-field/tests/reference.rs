//! The shipped renderer against a slow and obvious one, written anew in f64:
//! world point by world point, nothing skipped, no ray ended early. What they
//! share is the stated rule of where samples lie (half a voxel apart).

mod common;

use cairn_capture::Camera;
use cairn_field::appearance::features;
use cairn_field::grid::{DENSITY_SCALE, EMPTY_RAW, Grid, ROW};
use cairn_field::march::{FAR_STEP_VOXELS, STEP_VOXELS};
use cairn_field::{Appearance, Field, SceneFrame, Thresholds};
use common::{ahead, apart, ball_box, ball_in_the_open, camera, field_of, random_appearance, random_grid, rms};
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

/// World points a ray is sampled at, in the middle of steps of half a voxel (a
/// whole one beyond the inner box), and how many voxels they stand for.
fn points(frame: &SceneFrame, dims: [usize; 3], o: DVec3, d: DVec3) -> Vec<(DVec3, f64)> {
    let voxels = DVec3::from(dims.map(|n| (n - 1) as f64));
    let inside = |u: DVec3| u.min_element() >= 0.0 && u.max_element() <= 1.0;
    match frame {
        SceneFrame::Unbounded { centre, half } => {
            let mut out = Vec::new();
            let (mut t, limit) = (0.0, 2.0 * dims.into_iter().max().unwrap() as f64);
            loop {
                let y = (o + d * t - *centre) / *half;
                let growing = ((o + d * (t + 1e-6) - *centre) / *half).abs().max_element() > y.abs().max_element();
                if y.abs().max_element() > limit && growing {
                    return out;
                }
                // Speed in voxels by a difference in space, on the inner side of the border.
                let h = 1e-7 * (1.0 + t);
                let ahead = (place(frame, o + d * (t + h)).0 - place(frame, o + d * t).0) * voxels;
                let step = if y.abs().max_element() > 1.0 { FAR_STEP_VOXELS } else { STEP_VOXELS };
                let dt = step / (ahead.length() / h);
                out.push((o + d * (t + dt / 2.0), step));
                t += dt;
            }
        }
        SceneFrame::Bounded { half, .. } => {
            let dt = STEP_VOXELS / (d / (2.0 * *half) * voxels).length();
            let (start, end) = crossing(|t| inside(place(frame, o + d * t).0), 0.0, 20.0);
            let n = ((end - start) / dt).floor() as usize;
            (0..n).map(|i| (o + d * (start + (i as f64 + 0.5) * dt), STEP_VOXELS)).collect()
        }
        SceneFrame::ForwardFacing { rotation, position, near, .. } => {
            // Even steps in device coordinates: z' = 1 - near/z is even along the ray.
            let (q, w) = (*rotation * (o - *position), *rotation * d);
            let at = |s: f64| {
                let z = near / (1.0 - s);
                o + d * ((z - q.z) / w.z)
            };
            let (start, end) = crossing(|s| inside(place(frame, at(s.min(1.0 - 1e-12))).0), 0.0, 1.0);
            let whole = place(frame, at(0.9)).0 - place(frame, at(0.1)).0;
            let dt = STEP_VOXELS / (whole / 0.8 * voxels).length();
            let n = ((end - start) / dt).floor() as usize;
            (0..n).map(|i| (at(start + (i as f64 + 0.5) * dt), STEP_VOXELS)).collect()
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
        raw += w * if row == 0 { EMPTY_RAW } else { f64::from(grid.raw[row]) };
        if row != 0 {
            for k in 0..27 {
                colour[k] += w * f64::from(grid.colour[row * ROW + k]);
            }
        }
    }
    (raw, colour)
}

/// One pixel: `code . (near, near weight, far, far weight, sky)`.
fn pixel(field: &Field, look: &Appearance, o: DVec3, d: DVec3) -> [f32; 3] {
    let grid = field.grid();
    let y = harmonics(d);
    let voxels = (grid.dims.into_iter().max().unwrap() - 1) as f64;
    let mut light = 1.0;
    let mut f = [0.0f64; 17];
    for (p, step) in points(field.frame(), grid.dims, o, d) {
        let (u, far) = place(field.frame(), p);
        let (raw, colour) = look_up(grid, u);
        let alpha = 1.0 - (-DENSITY_SCALE * (1.0 + raw.exp()).ln() * step / voxels).exp();
        let first = if far { 4 } else { 0 };
        for c in 0..3 {
            f[first + c] += light * alpha * (0..9).map(|k| y[k] * colour[c * 9 + k]).sum::<f64>();
        }
        f[first + 3] += light * alpha;
        light *= 1.0 - alpha;
    }
    for k in 0..9 {
        f[8 + k] = light * y[k];
    }
    std::array::from_fn(|c| (0..17).map(|k| f64::from(look.code()[c * 17 + k]) * f[k]).sum::<f64>() as f32)
}

fn reference(field: &Field, look: &Appearance, camera: &Camera) -> Vec<f32> {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let ray = |i: usize| camera.ray((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
    (0..w * h).flat_map(|i| pixel(field, look, ray(i).0, ray(i).1)).collect()
}

/// A grid with empty regions wider than a block, and haze and walls elsewhere.
fn patchy(dims: [usize; 3]) -> Grid<f32> {
    let mut grid = random_grid(dims, 0.9, (-6.0, 0.5), 21);
    for row in 1..grid.rows() {
        let v = grid.vertex[row] as usize;
        let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
        if at.iter().map(|k| k / 9).sum::<usize>() % 2 == 1 {
            grid.raw[row] = -40.0;
        }
    }
    grid
}

fn agree(frame: &SceneFrame, dims: [usize; 3], cameras: &[Camera]) {
    let look = random_appearance(8);
    let field = field_of(frame, &patchy(dims), &look);
    for (n, camera) in cameras.iter().enumerate() {
        let expected = reference(&field, &look, camera);
        let spread = expected.iter().fold(0.0f32, |m, v| m.max(v - expected[0]));
        assert!(spread > 0.1, "view {n} shows nothing");
        // Left out in a shown picture: light behind 1e-3, samples below 1e-5.
        let shown = field.render(camera, &look);
        assert!(apart(shown.rgb(), &expected) < 3e-3, "view {n}: {}", apart(shown.rgb(), &expected));
        assert!(rms(shown.rgb(), &expected) < 1e-3, "view {n}: rms {}", rms(shown.rgb(), &expected));
        let exact: Vec<f32> = field
            .gather_view(camera, Thresholds::EXACT)
            .iter()
            .flat_map(|(g, basis)| look.shade(&features(g, basis)))
            .collect();
        assert!(apart(&exact, &expected) < 1e-3, "view {n}, exact: {}", apart(&exact, &expected));
        assert!(rms(&exact, &expected) < 1e-4, "view {n}, exact: rms {}", rms(&exact, &expected));
    }
}

#[test]
fn a_bounded_box() {
    let cameras = [
        camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 12),
        // Inside the grid, and along an axis.
        camera(DVec3::new(0.2, 0.1, -0.3), DVec3::new(1.0, 0.3, 0.0), 9),
        camera(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, 9),
    ];
    agree(&ball_box(), [22, 18, 26], &cameras);
}

#[test]
fn contracted_space() {
    let cameras = [
        camera(DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO, 10),
        camera(DVec3::new(0.2, 0.1, -0.3), DVec3::new(1.0, 0.3, 0.0), 9),
        // Away from the box: surroundings only.
        camera(DVec3::new(2.0, 0.3, 3.0), DVec3::new(5.0, 1.0, 9.0), 9),
    ];
    agree(&ball_in_the_open(), [30, 26, 34], &cameras);
}

#[test]
fn device_coordinates() {
    let cameras = [
        camera(DVec3::new(0.05, 0.1, 0.02), DVec3::new(0.0, 0.0, 4.0), 12),
        camera(DVec3::new(-0.3, 0.1, -0.2), DVec3::new(0.4, 0.0, 4.0), 12),
    ];
    agree(&ahead(), [26, 28, 18], &cameras);
}
