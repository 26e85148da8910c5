//! Rays of whole views. Undistorting a pixel costs more than marching through
//! empty space, so directions are worked out once per lens and kept.

use super::frame::{RayPath, SceneFrame};
use crate::grid::sh::{SH, basis};
use cairn_scene::{Camera, Intrinsics};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::Arc;

/// Directions of every pixel of one lens, in the camera's axes with depth 1.
#[derive(Debug)]
pub struct Lens {
    intrinsics: Intrinsics,
    /// x and y of each pixel's direction, row-major.
    slopes: Vec<[f32; 2]>,
}

/// A camera and the directions of its pixels.
#[derive(Clone, Copy)]
pub(crate) struct Eye<'a> {
    pub(crate) camera: &'a Camera,
    /// The camera's lens.
    pub(crate) lens: &'a Lens,
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
        let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
        let slopes = (0..w * h)
            .into_par_iter()
            .map(|i| {
                let d = camera.direction((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
                [d.x as f32, d.y as f32]
            })
            .collect();
        Self { intrinsics: camera.intrinsics, slopes }
    }

    /// The pixels of several cameras of one size and place as one picture, one camera's below the other's:
    /// to follow them together costs less than one by one.
    ///
    /// # Panics
    /// Without cameras.
    pub(crate) fn stacked(cameras: &[Camera]) -> Self {
        let first = cameras.first().expect("a camera");
        let slopes = cameras.iter().flat_map(|camera| Self::new(camera).slopes).collect();
        let intrinsics = Intrinsics { height: first.intrinsics.height * cameras.len(), ..first.intrinsics };
        Self { intrinsics, slopes }
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
        let [x, y] = self.slopes[at];
        let d = (camera.pose.rotation * DVec3::new(f64::from(x), f64::from(y), 1.0)).normalize();
        (frame.path(camera.pose.position, d), basis([d.x as f32, d.y as f32, d.z as f32]))
    }

    /// Pixels across and down.
    pub fn size(&self) -> (usize, usize) {
        (self.intrinsics.width, self.intrinsics.height)
    }

    /// Pixels of a view.
    pub fn pixels(&self) -> usize {
        self.slopes.len()
    }
}
