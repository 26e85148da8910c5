//! Which rows of a field a picture sees, and how much of each: what shares are made of.
//!
//! With density given a pixel is `sum_v W[p,v] c_v`. Two things of `W` are asked for, and neither needs it whole:
//! its transpose applied to a picture of weights ([`VisibleField::row_weights`]), and itself applied to some numbers a
//! row ([`VisibleField::mixed`]).

use super::model::Field;
use crate::appearance::code::{Appearance, FEATURES, features};
use crate::grid::table::Table;
use crate::rays::lens::{Eye, Lens};
use crate::render::composite::Thresholds;
use crate::render::picture::{Seen, Tiling};
use cairn_scene::Camera;
use glam::DVec3;

/// Numbers a row that [`VisibleField::mixed`] brings to a picture at once.
pub const CHANNELS: usize = 8;

/// A field whose rows can be asked after.
pub trait VisibleField: Sync {
    /// Rows, the unused row 0 included.
    fn rows(&self) -> usize;
    /// Where the vertex of `row` lies: `[x, y, z, w]`, homogeneous, w >= 0 and 0 at infinity, in coordinates whose
    /// angles are the world's.
    ///
    /// # Panics
    /// When there is no such row, or it is 0.
    fn place(&self, row: usize) -> [f32; 4];
    /// Where `point` of the world lies in the same coordinates; its w is 1.
    fn place_of(&self, point: DVec3) -> [f32; 4];
    /// What the pixels of `camera` see of each row, summed with the weight that `of_pixel` gives each: `W^T` times a
    /// picture of weights. It comes out the same with any number of threads.
    fn row_weights(&self, camera: &Camera, of_pixel: &(dyn Fn(&Pixel) -> f32 + Sync)) -> RowWeights;
    /// What `camera` sees of numbers that rows have, row-major: `W` times them. `slot_of` has for each row where in
    /// `numbers` its own are.
    ///
    /// # Panics
    /// When `slot_of` is of another length than there are rows, or names what `numbers` has not.
    fn mixed(&self, camera: &Camera, slot_of: &[u32], numbers: &[[f32; CHANNELS]]) -> Vec<Mixed>;
}

/// A pixel that is to be given a weight.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Its number, row-major.
    pub at: usize,
    features: [f32; FEATURES],
}

impl Pixel {
    /// Its colour in the light of `appearance`, RGB, not clamped.
    pub fn colour(&self, appearance: &Appearance) -> [f32; 3] {
        appearance.shade(&self.features)
    }
}

/// What some pixels see of a field, summed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowWeights {
    /// Each row that is seen, ascending and never 0, and what it weighs in the pixels: > 0, in pixels.
    pub rows: Vec<(u32, f32)>,
    /// Light that comes through the field from behind it, in pixels.
    pub behind: f64,
    /// The pixels' weights in all.
    pub pixels: f64,
}

/// What a pixel sees of rows' numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mixed {
    /// The numbers, each row's by what it weighs in the pixel.
    pub channels: [f32; CHANNELS],
    /// The light that comes through the field from behind it, 0 to 1.
    pub behind: f32,
}

impl VisibleField for Field {
    fn rows(&self) -> usize {
        self.grid.rows()
    }

    fn place(&self, row: usize) -> [f32; 4] {
        let [nx, ny, nz] = self.grid.dims;
        let v = self.grid.vertex[row] as usize;
        let at = DVec3::new((v % nx) as f64, (v / nx % ny) as f64, (v / (nx * ny)) as f64);
        let cells = DVec3::new((nx - 1) as f64, (ny - 1) as f64, (nz - 1) as f64);
        self.frame.place(at / cells).map(|v| v as f32)
    }

    fn place_of(&self, point: DVec3) -> [f32; 4] {
        self.frame.place_of(point).map(|v| v as f32)
    }

    fn row_weights(&self, camera: &Camera, of_pixel: &(dyn Fn(&Pixel) -> f32 + Sync)) -> RowWeights {
        let lens = Lens::new(camera);
        let tiling = Tiling::of(&self.grid, &self.frame, Eye { camera, lens: &lens }, Thresholds::SHOWN, 1);
        let add = |ray: &mut Ray, seen: &Seen<'_>| {
            let pixel = Pixel { at: seen.at, features: features(&seen.gathered, &seen.harmonics) };
            (ray.weight, ray.end) = (of_pixel(&pixel), seen.gathered.end);
            if ray.weight != 0.0 {
                seen.each_vertex(|row, weight, _| ray.met.push((row as u32, weight)));
            }
        };
        let finish = |ray: &mut Ray, (): &mut (), band: &mut Band, _: usize| band.add(ray);
        RowWeights::of(tiling.bands(|_| Band::default(), add, finish))
    }

    fn mixed(&self, camera: &Camera, slot_of: &[u32], numbers: &[[f32; CHANNELS]]) -> Vec<Mixed> {
        assert_eq!(slot_of.len(), self.rows(), "a slot for each row");
        self.each_pixel(camera, Thresholds::SHOWN, |seen| {
            let mut mixed = Mixed { channels: [0.0; CHANNELS], behind: seen.gathered.end };
            seen.each_vertex(|row, weight, _| {
                let own = &numbers[slot_of[row] as usize];
                mixed.channels.iter_mut().zip(own).for_each(|(sum, v)| *sum += weight * v);
            });
            mixed
        })
    }
}

/// A ray as it is followed.
#[derive(Default)]
struct Ray {
    weight: f32,
    end: f32,
    met: Vec<(u32, f32)>,
}

/// What the rays of a band met.
#[derive(Default)]
struct Band {
    /// Where in `rows` a row is.
    table: Table,
    rows: Vec<(u32, f32)>,
    behind: f64,
    pixels: f64,
}

impl Band {
    /// Adds a ray, and leaves a new one.
    fn add(&mut self, ray: &mut Ray) {
        let own = ray.weight;
        self.pixels += f64::from(own);
        self.behind += f64::from(own * ray.end);
        for (row, weight) in ray.met.drain(..) {
            let fresh = self.rows.len() as u32;
            let found = self.table.find_or_insert(row, fresh);
            if found == fresh {
                self.rows.push((row, 0.0));
            }
            self.rows[found as usize].1 += own * weight;
        }
    }
}

impl RowWeights {
    /// What all bands met. Each row's sum is taken in their order.
    fn of(bands: Vec<Band>) -> Self {
        let mut all = Self::default();
        let mut met = Vec::with_capacity(bands.iter().map(|band| band.rows.len()).sum());
        for band in bands {
            all.behind += band.behind;
            all.pixels += band.pixels;
            met.extend(band.rows);
        }
        met.sort_by_key(|(row, _)| *row);
        for (row, weight) in met {
            match all.rows.last_mut() {
                Some((last, sum)) if *last == row => *sum += weight,
                _ if row != 0 && weight > 0.0 => all.rows.push((row, weight)),
                _ => {}
            }
        }
        all
    }
}
