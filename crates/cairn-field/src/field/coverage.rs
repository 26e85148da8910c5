//! Which rows of a field a picture sees, and how much of each: what shares are made of.
//!
//! With density given a pixel is `sum_v W[p,v] c_v`. Two things of `W` are asked for, and neither needs it whole:
//! its transpose applied to a picture of weights ([`VisibleField::row_weights`]), and itself applied to some numbers a
//! row ([`VisibleField::mixed`]).

use super::model::Field;
use crate::appearance::code::{Appearance, FEATURES, features};
use crate::grid::lattice::Grid;
use crate::grid::table::Table;
use crate::rays::lens::{Eye, Lens};
use crate::render::composite::Thresholds;
use crate::render::picture::{Seen, Tiling};
use crate::render::tints::Share;
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
    fn row_weights(&self, camera: &Camera, of_pixel: OfPixel<'_>) -> RowWeights;
    /// What `camera` sees of numbers that rows have, row-major: `W` times them. `slot_of` has for each row where in
    /// `numbers` its own are.
    ///
    /// # Panics
    /// When `slot_of` is of another length than there are rows, or names what `numbers` has not.
    fn mixed(&self, camera: &Camera, slot_of: &[u32], numbers: &[[f32; CHANNELS]]) -> Vec<Mixed>;
}

/// What each pixel weighs, >= 0.
#[derive(Clone, Copy)]
pub enum OfPixel<'a> {
    /// One.
    All,
    /// What is said of its number, row-major.
    ByPlace(&'a (dyn Fn(usize) -> f32 + Sync)),
    /// What is said of what it shows; takes longer, since colours are worked out.
    ByColour(&'a (dyn Fn(&Pixel) -> f32 + Sync)),
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

    fn row_weights(&self, camera: &Camera, of_pixel: OfPixel<'_>) -> RowWeights {
        let lens = Lens::new(camera);
        let tiling = Tiling::of(&self.grid, &self.frame, Eye { camera, lens: &lens }, Thresholds::SHOWN, 1);
        let add = |ray: &mut Ray, seen: &Seen<'_>| {
            ray.weight = match of_pixel {
                OfPixel::All => 1.0,
                OfPixel::ByPlace(weight) => weight(seen.at),
                OfPixel::ByColour(weight) => {
                    weight(&Pixel { at: seen.at, features: features(&seen.gathered, &seen.harmonics) })
                }
            };
            ray.end = seen.gathered.end;
            if ray.weight != 0.0 {
                ray.met.extend_from_slice(seen.shares());
            }
        };
        let finish = |ray: &mut Ray, table: &mut Table, band: &mut Band, _: usize| band.add(ray, table);
        let tiling = if matches!(of_pixel, OfPixel::ByColour(_)) { tiling } else { tiling.without_colours() };
        RowWeights::of(&self.grid, &tiling.bands(|_| Band::default(), add, finish))
    }

    fn mixed(&self, camera: &Camera, slot_of: &[u32], numbers: &[[f32; CHANNELS]]) -> Vec<Mixed> {
        assert_eq!(slot_of.len(), self.rows(), "a slot for each row");
        let lens = Lens::new(camera);
        let tiling = Tiling::of(&self.grid, &self.frame, Eye { camera, lens: &lens }, Thresholds::SHOWN, 1);
        let pixel = |seen: &Seen<'_>| {
            let mut mixed = Mixed { channels: [0.0; CHANNELS], behind: seen.gathered.end };
            seen.each_vertex(|row, weight, _| {
                let own = &numbers[slot_of[row] as usize];
                mixed.channels.iter_mut().zip(own).for_each(|(sum, v)| *sum += weight * v);
            });
            mixed
        };
        tiling.without_colours().gather(|out, seen| *out = pixel(seen), |_| {})
    }
}

/// A ray as it is followed.
#[derive(Default)]
struct Ray {
    weight: f32,
    end: f32,
    met: Vec<Share>,
}

/// What the rays of a band met.
#[derive(Default)]
struct Band {
    /// Cells, by their first vertices, and what their corners weigh.
    cells: Vec<(u32, [f32; 8])>,
    behind: f64,
    pixels: f64,
}

impl Band {
    /// Adds a ray, and leaves a new one; `table` says where in `cells` one is.
    fn add(&mut self, ray: &mut Ray, table: &mut Table) {
        // Its first ray: what is in the table is another band's.
        if self.cells.is_empty() {
            table.clear();
        }
        let own = ray.weight;
        self.pixels += f64::from(own);
        self.behind += f64::from(own * ray.end);
        for share in ray.met.drain(..) {
            let fresh = self.cells.len() as u32;
            let found = table.find_or_insert(share.cell, fresh);
            if found == fresh {
                self.cells.push((share.cell, [0.0; 8]));
            }
            let sums = &mut self.cells[found as usize].1;
            sums.iter_mut().zip(share.corners).for_each(|(sum, weight)| *sum += own * weight);
        }
    }
}

impl RowWeights {
    /// What all bands met of `grid`. Each row's sum is taken in their order.
    fn of(grid: &Grid<f32>, bands: &[Band]) -> Self {
        let mut all = Self::default();
        let (corners, mut sums) = (grid.corners(), vec![0f32; grid.rows()]);
        for band in bands {
            all.behind += band.behind;
            all.pixels += band.pixels;
            for (cell, weights) in &band.cells {
                for (corner, weight) in corners.iter().zip(weights) {
                    sums[grid.index[*cell as usize + corner] as usize] += weight;
                }
            }
        }
        let seen = |(row, weight): (usize, f32)| (row != 0 && weight > 0.0).then_some((row as u32, weight));
        all.rows = sums.into_iter().enumerate().filter_map(seen).collect();
        all
    }
}
