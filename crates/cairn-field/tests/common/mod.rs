//! A tiny world with a known answer, shared by the tests: a banded ball above
//! nothing, photographed from a ring, and fields of random numbers.
// Each test program uses its own part of this.
#![allow(dead_code)]

pub mod landmark;

use cairn_field::grid::lattice::{DENSITY_SCALE, Grid, ROW};
use cairn_field::grid::sh::SH;
use cairn_field::{Appearance, Field, FieldConfig, NamedView, RayPath, Real, SceneFrame};
use cairn_scene::{
    Camera, Capture, Distortion, Intrinsics, LeftOut, Mask, Picture, Picture8, Pose, SceneKind, TrainView, View,
};
use glam::{DMat3, DVec3};
use half::f16;
use safetensors::tensor::{Dtype, TensorView};
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// Numbers that only look random (SplitMix64).
pub struct Numbers(pub u64);

impl Numbers {
    /// The next, in [0, 1).
    pub fn share(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// The next, in [low, high).
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }
}

/// A photograph that a test may change before it is learnt from.
#[derive(Clone, Debug)]
pub struct Photo {
    pub name: String,
    pub camera: Camera,
    pub picture: Picture,
    pub mask: Option<Mask>,
}

/// The photographs as stage 1 takes them.
pub fn named(photos: Vec<Photo>) -> Vec<NamedView> {
    let view = |Photo { name, camera, picture, mask }: Photo| {
        let rgb8 = Picture8::from(&picture);
        NamedView { name, view: Arc::new(TrainView { camera, rgb8, mask }) }
    };
    photos.into_iter().map(view).collect()
}

/// A camera of `size` x `size` pixels at `position` that looks at `target`.
pub fn camera(position: DVec3, target: DVec3, size: usize) -> Camera {
    let s = size as f64;
    let intrinsics = Intrinsics {
        width: size,
        height: size,
        fx: 1.2 * s,
        fy: 1.25 * s,
        cx: s / 2.0,
        cy: s / 2.0,
        distortion: Distortion::default(),
    };
    Camera { intrinsics, pose: Pose::look_at(position, target, DVec3::Y).expect("a proper direction") }
}

/// `n` cameras around `at`, four units off.
pub fn ring(n: usize, size: usize, unit: f64, at: DVec3) -> Vec<Camera> {
    (0..n)
        .map(|i| {
            let a = i as f64 * std::f64::consts::TAU / n as f64 + 0.1;
            let place = DVec3::new(a.cos(), 0.35 * (2.0 * a).sin() + 0.2, a.sin()) * 4.0 * unit;
            camera(at + place, at, size)
        })
        .collect()
}

/// The photograph `camera` takes of the ball of radius `unit` around `at`:
/// bands of colour on grey.
pub fn photograph(camera: &Camera, unit: f64, at: DVec3) -> Picture {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut rgb = Vec::with_capacity(w * h * 3);
    for i in 0..w * h {
        let (o, d) = camera.ray((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
        let to = at - o;
        let nearest = to.dot(d);
        let off = unit * unit - (to - d * nearest).length_squared();
        if off < 0.0 {
            rgb.extend([0.5f32; 3]);
            continue;
        }
        let n = (o + d * (nearest - off.sqrt()) - at) / unit;
        rgb.extend([n.x, n.y, (3.0 * n.z).sin()].map(|v| (0.5 + 0.4 * v) as f32));
    }
    Picture::new(w, h, rgb).expect("three numbers a pixel")
}

/// The ring's photographs, ready to train on.
pub fn views(n: usize, size: usize, unit: f64, at: DVec3) -> Vec<Photo> {
    photographs(&ring(n, size, unit, at), unit, at)
}

/// The ring as a capture, for choosing a frame; sparse points lie on the ball.
pub fn capture(kind: SceneKind, cameras: Vec<Camera>, unit: f64, at: DVec3) -> Capture {
    let mut numbers = Numbers(5);
    let points =
        (0..300).map(|_| at + unit * DVec3::from([0.0; 3].map(|_| numbers.within(-1.0, 1.0))).normalize()).collect();
    let views = cameras
        .into_iter()
        .enumerate()
        .map(|(i, camera)| View {
            name: format!("{i:03}.png"),
            camera,
            contributor: "unknown".into(),
            contributor_key: None,
            photograph: "none".into(),
            as_stored: false,
            held_out: false,
            mask: None,
            support: None,
            bounds: None,
        })
        .collect();
    Capture { root: ".".into(), kind, background: None, views, points, left_out: LeftOut::default() }
}

/// The box around the unit ball.
pub fn ball_box() -> SceneFrame {
    SceneFrame::Bounded { centre: DVec3::ZERO, half: DVec3::splat(1.25) }
}

/// The same with all of space around it.
pub fn ball_in_the_open() -> SceneFrame {
    SceneFrame::Unbounded { centre: DVec3::ZERO, half: DVec3::new(1.25, 1.0, 1.5) }
}

/// Forward-facing along +z from around the origin.
pub fn ahead() -> SceneFrame {
    SceneFrame::ForwardFacing {
        rotation: DMat3::IDENTITY,
        position: DVec3::new(0.1, -0.05, 0.0),
        near: 1.0,
        low: [-0.7, -0.6],
        high: [0.65, 0.7],
    }
}

/// A forward-facing row of cameras, four units in front of `at`.
pub fn facing(n: usize, size: usize, unit: f64, at: DVec3) -> Vec<Camera> {
    (0..n)
        .map(|i| {
            let a = i as f64 * 2.4;
            let place = DVec3::new(0.9 * a.cos(), 0.6 * a.sin(), -4.0) * unit;
            camera(at + place, at + DVec3::new(0.3 * place.x, 0.3 * place.y, 0.0), size)
        })
        .collect()
}

/// What `cameras` photograph of the ball, ready to train on.
pub fn photographs(cameras: &[Camera], unit: f64, at: DVec3) -> Vec<Photo> {
    let view = |(i, camera): (usize, &Camera)| Photo {
        name: format!("{i:03}.png"),
        picture: photograph(camera, unit, at),
        camera: *camera,
        mask: None,
    };
    cameras.iter().enumerate().map(view).collect()
}

/// Settings small enough to train in a second.
pub fn tiny(steps: u64) -> FieldConfig {
    FieldConfig { steps, rays_per_step: 256, voxels: 12_000, levels: 2, ..FieldConfig::default() }
}

/// Where a ray begins and where it goes, in world units.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: DVec3,
    pub direction: DVec3,
}

impl Ray {
    /// From `origin` through `target`.
    pub fn towards(origin: DVec3, target: DVec3) -> Self {
        Self { origin, direction: (target - origin).normalize() }
    }

    /// Where it goes in `frame`.
    pub fn path(&self, frame: &SceneFrame) -> RayPath {
        frame.path(self.origin, self.direction)
    }
}

/// A grid of random numbers in which about `filled` of the vertices have a row;
/// raw densities lie in `raw`.
pub fn random_grid<T: Real>(dims: [usize; 3], filled: f64, raw: Range<f64>, seed: u64) -> Grid<T> {
    let mut numbers = Numbers(seed);
    let vertex: Vec<u32> = (0..dims.iter().product::<usize>() as u32).filter(|_| numbers.share() < filled).collect();
    let mut grid = Grid::with_vertices(dims, vertex);
    for row in 1..grid.rows() {
        let vertex = grid.vertex[row] as usize;
        grid.raw[vertex] = T::of(numbers.within(raw.start, raw.end));
        for k in 0..3 * SH {
            let level = if k < 3 { 1.7 } else { 0.0 };
            grid.colour[row * ROW + k] = T::of(level + numbers.within(-0.6, 0.6));
        }
    }
    grid.refresh_occupancy(0.0);
    grid
}

/// The raw density whose density is `density` per unit-cube length, > 0.
pub fn raw_for(density: f64) -> f64 {
    let softplus = density / DENSITY_SCALE;
    if softplus > 30.0 { softplus } else { softplus.exp_m1().ln() }
}

/// An appearance of random numbers near the neutral one.
pub fn random_appearance(seed: u64) -> Appearance {
    let mut numbers = Numbers(seed);
    let neutral = Appearance::neutral([0.3, 0.5, 0.7]);
    let code = neutral.code().iter().map(|v| v + numbers.within(-0.2, 0.2) as f32).collect();
    Appearance::from_code(code).expect("finite numbers")
}

/// The stored form of a field, put together without the crate's writer.
pub fn stored_field(frame: &SceneFrame, grid: &Grid<f32>, canonical: &Appearance) -> Vec<u8> {
    let header = serde_json::json!({
        "format": cairn_field::FIELD_FORMAT, "frame": frame, "dims": grid.dims, "canonical": canonical, "appearances": [],
    });
    stored_with(&header, grid)
}

/// As [`stored_field`], with any header.
pub fn stored_with(header: &serde_json::Value, grid: &Grid<f32>) -> Vec<u8> {
    let rows = grid.rows() - 1;
    let vertex: Vec<u8> = grid.vertex[1..].iter().flat_map(|v| v.to_le_bytes()).collect();
    let raw: Vec<u8> = grid.raw_rows().flat_map(f32::to_le_bytes).collect();
    let colour: Vec<u8> = grid.colour[ROW..]
        .chunks_exact(ROW)
        .flat_map(|row| row[..3 * SH].iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()))
        .collect();
    let blocks: usize = grid.dims.iter().map(|d| (d - 1).div_ceil(4)).product();
    let cells: Vec<u8> = vec![u8::MAX; 8 * blocks];
    let tensors = [
        ("cells", TensorView::new(Dtype::U64, vec![blocks], &cells).expect("fits")),
        ("colour", TensorView::new(Dtype::F16, vec![rows, SH, 3], &colour).expect("fits")),
        ("density", TensorView::new(Dtype::F32, vec![rows], &raw).expect("fits")),
        ("vertex", TensorView::new(Dtype::U32, vec![rows], &vertex).expect("fits")),
    ];
    let metadata = HashMap::from([("cairn".to_owned(), header.to_string())]);
    safetensors::serialize(tensors, Some(metadata)).expect("plain tensors")
}

/// A field with this grid.
pub fn field_of(frame: &SceneFrame, grid: &Grid<f32>, canonical: &Appearance) -> Field {
    Field::from_bytes(&stored_field(frame, grid, canonical)).expect("a sound field")
}

/// Largest absolute difference of two equally long lists of finite numbers.
pub fn apart(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    assert!(a.iter().chain(b).all(|v| v.is_finite()), "all numbers are finite");
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Root mean square difference of two equally long lists.
pub fn rms(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    (a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}
