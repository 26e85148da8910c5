//! Rays of whole views. Undistorting a pixel costs more than marching through
//! empty space, so directions are worked out once per lens and kept.

use super::frame::{RayPath, SceneFrame};
use crate::grid::sh::{SH, basis};
use cairn_scene::{Camera, Distortion, Intrinsics};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::Arc;

/// Directions of every pixel of one lens, in the camera's axes.
#[derive(Debug)]
pub struct Lens {
    intrinsics: Intrinsics,
    directions: Directions,
}

/// A direction for each pixel, row-major.
#[derive(Debug)]
enum Directions {
    /// A pinhole's: x and y where depth is 1.
    Ahead(Vec<[f32; 2]>),
    /// A fisheye's, of unit length: some have no depth.
    Around(Vec<[f32; 3]>),
}

/// A camera and the directions of its pixels.
#[derive(Clone, Copy)]
pub struct Eye<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The camera's lens.
    pub lens: &'a Lens,
}

impl Eye<'_> {
    /// Path and colour basis of pixel `at` (row-major).
    #[inline(always)]
    pub(crate) fn ray(&self, frame: &SceneFrame, at: usize) -> (RayPath, [f32; SH]) {
        self.lens.ray(self.camera, frame, at)
    }
}

impl Lens {
    /// Works out all directions of `camera`.
    pub fn new(camera: &Camera) -> Self {
        Self { intrinsics: camera.intrinsics, directions: Directions::of(std::slice::from_ref(camera)) }
    }

    /// The pixels of several cameras of one size, place and kind of lens as one picture, one camera's below the other's:
    /// to follow them together costs less than one by one.
    ///
    /// # Panics
    /// Without cameras.
    pub fn stacked(cameras: &[Camera]) -> Self {
        let first = cameras.first().expect("a camera");
        let intrinsics = Intrinsics { height: first.intrinsics.height * cameras.len(), ..first.intrinsics };
        Self { intrinsics, directions: Directions::of(cameras) }
    }

    /// One lens a camera, those with equal intrinsics shared.
    pub fn shared(cameras: impl Iterator<Item = Camera>) -> Vec<Arc<Self>> {
        let mut lenses: Vec<Arc<Self>> = Vec::new();
        cameras
            .map(|camera| {
                // The last first: captures come sorted, so that neighbours agree.
                if let Some(lens) = lenses.iter().rev().find(|l| l.intrinsics == camera.intrinsics) {
                    return lens.clone();
                }
                let lens = Arc::new(Self::new(&camera));
                lenses.push(lens.clone());
                lens
            })
            .collect()
    }

    /// Path and colour basis of pixel `at` (row-major) of `camera`, which must
    /// have this lens.
    #[inline]
    pub fn ray(&self, camera: &Camera, frame: &SceneFrame, at: usize) -> (RayPath, [f32; SH]) {
        let d = (camera.pose.rotation * self.directions.at(at)).normalize();
        (frame.path(camera.pose.position, d), basis([d.x as f32, d.y as f32, d.z as f32]))
    }

    /// Pixels across and down.
    pub fn size(&self) -> (usize, usize) {
        (self.intrinsics.width, self.intrinsics.height)
    }

    /// Pixels of a view.
    pub fn pixels(&self) -> usize {
        self.intrinsics.width * self.intrinsics.height
    }
}

impl Directions {
    /// Of the pixels of `cameras` (one or more, of one kind of lens), one camera's after the other's.
    fn of(cameras: &[Camera]) -> Self {
        match cameras[0].intrinsics.distortion {
            Distortion::Pinhole(_) => Self::Ahead(each(cameras, |d| [d.x as f32, d.y as f32])),
            Distortion::Fisheye(_) => Self::Around(each(cameras, |d| d.as_vec3().to_array())),
        }
    }

    /// The direction of pixel `at`, of any length.
    #[inline(always)]
    fn at(&self, at: usize) -> DVec3 {
        match self {
            Self::Ahead(slopes) => DVec3::new(f64::from(slopes[at][0]), f64::from(slopes[at][1]), 1.0),
            Self::Around(directions) => DVec3::from_array(directions[at].map(f64::from)),
        }
    }
}

/// What `keep` makes of the direction of each pixel of `cameras`.
fn each<T: Send>(cameras: &[Camera], keep: impl Fn(DVec3) -> T + Sync) -> Vec<T> {
    let of = |camera: &Camera| -> Vec<T> {
        let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
        let direction = |i: usize| camera.direction((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
        (0..w * h).into_par_iter().map(|i| keep(direction(i))).collect()
    };
    cameras.iter().flat_map(of).collect()
}
