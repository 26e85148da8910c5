//! Whole pictures, tile by tile. The rays of a tile meet the same vertices again and
//! again, and see each along nearly the same direction: a vertex's colour is worked out once a
//! tile, as it is seen from the tile's middle and how that changes across and down. Rays go
//! in small groups, so that they pass empty space together.

use super::composite::{Gathered, Thresholds, composite};
use super::tints::{Share, Tints};
use crate::grid::lattice::{Grid, trilinear};
use crate::grid::sh::SH;
use crate::rays::frame::{RayPath, SceneFrame};
use crate::rays::lens::Eye;
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Largest tile: pixels across,
const MAX_ACROSS: usize = 16;
/// and down.
const MAX_DOWN: usize = 8;
/// About as wide as a tile should be, radians: most rays' directions are then straight
/// across it ([`super::tints`]).
const WIDEST: f64 = 0.03;
/// Rays that go together, across and down: at most a lane each.
const GROUP: (usize, usize) = (4, 2);
const RAYS: usize = GROUP.0 * GROUP.1;

/// A thread's room, used again for every tile.
#[derive(Default)]
struct Room {
    tints: Tints,
    /// The group that is followed, and the one before, which waits for what it asked for.
    groups: [Group; 2],
}

/// A pixel's column and row.
#[derive(Clone, Copy, Default)]
struct Place {
    x: usize,
    y: usize,
}

/// Some rays side by side.
#[derive(Default)]
struct Group {
    /// Where the first one is.
    at: Place,
    harmonics: [[f32; SH]; RAYS],
    shares: [Vec<Share>; RAYS],
    /// Transmittances at the rays' ends.
    ends: [f32; RAYS],
    /// Sums of weight times distance.
    along: [f32; RAYS],
}

/// A pixel's ray as it is handed over.
pub(crate) struct Seen<'a> {
    /// The ray's number in the eye's picture, row-major.
    pub(crate) at: usize,
    /// What it gathered,
    pub(crate) gathered: Gathered<f32>,
    /// and the spherical harmonics along it.
    pub(crate) harmonics: [f32; SH],
    shares: &'a [Share],
    grid: &'a Grid<f32>,
}

impl Seen<'_> {
    /// The cells that were met, near to far; one may come more than once.
    #[inline(always)]
    pub(crate) fn shares(&self) -> &[Share] {
        self.shares
    }

    /// Calls `each` with what was met: a row, what it weighs in the pixel, and whether it is
    /// in contracted space.
    #[inline(always)]
    pub(crate) fn each_vertex(&self, mut each: impl FnMut(usize, f32, bool)) {
        let corners = self.grid.corners();
        for share in self.shares {
            for (corner, weight) in corners.iter().zip(share.corners) {
                each(self.grid.index[share.cell as usize + corner] as usize, weight, share.far);
            }
        }
    }
}

/// A picture cut into tiles.
pub(crate) struct Tiling<'a> {
    grid: &'a Grid<f32>,
    frame: &'a SceneFrame,
    eye: Eye<'a>,
    limits: Thresholds,
    /// Rays across a pixel, and down.
    rays: usize,
    /// Size of a tile, rays.
    across: usize,
    down: usize,
    /// Whether colours are worked out.
    coloured: bool,
}

impl<'a> Tiling<'a> {
    /// Of the rays of `eye` through `grid`; a pixel is `rays x rays` of them (1 or more), and
    /// lies in one tile.
    pub(crate) fn of(
        grid: &'a Grid<f32>,
        frame: &'a SceneFrame,
        eye: Eye<'a>,
        limits: Thresholds,
        rays: usize,
    ) -> Self {
        let within = |max: usize, focal_px: f64| ((WIDEST * focal_px) as usize).clamp(1, max) / rays * rays;
        let intrinsics = &eye.camera.intrinsics;
        let (across, down) = (within(MAX_ACROSS, intrinsics.fx), within(MAX_DOWN, intrinsics.fy));
        Self { grid, frame, eye, limits, rays, across: across.max(rays), down: down.max(rays), coloured: true }
    }

    /// The same without colours: what a ray gathers of them stays 0.
    pub(crate) fn without_colours(self) -> Self {
        Self { coloured: false, ..self }
    }

    /// What `add` makes of each pixel's rays, and `finish` of that; row-major.
    pub(crate) fn gather<P: Clone + Default + Send>(
        &self,
        add: impl Fn(&mut P, &Seen<'_>) + Sync,
        finish: impl Fn(&mut P) + Sync,
    ) -> Vec<P> {
        let none = |pixels: usize| vec![P::default(); pixels];
        let finish = |pixel: &mut P, (): &mut (), pixels: &mut Vec<P>, at: usize| {
            finish(pixel);
            pixels[at] = std::mem::take(pixel);
        };
        self.bands(none, add, finish).into_iter().flatten().collect()
    }

    /// What a thread makes of each band of pixels, from the top: `begin` is told how many they are, `add` of a pixel
    /// and each of its rays, and `finish` of the pixel when it has them all, with a thread's `R` to use again, the
    /// band, and the pixel's place in that, row-major. `finish` leaves the pixel as a new one is: it will be another.
    pub(crate) fn bands<P: Default + Send, R: Default + Send, B: Send>(
        &self,
        begin: impl Fn(usize) -> B + Sync,
        add: impl Fn(&mut P, &Seen<'_>) + Sync,
        finish: impl Fn(&mut P, &mut R, &mut B, usize) + Sync,
    ) -> Vec<B> {
        let (rays, width) = (self.rays, self.eye.lens.size().0 / self.rays);
        // A room is large: as many are made as threads want one at a time, not one for each task.
        let rooms: Mutex<Vec<(Room, Vec<P>, R)>> = Mutex::default();
        let at_rest = || rooms.lock().unwrap_or_else(PoisonError::into_inner);
        let band = |n: usize| {
            let taken = at_rest().pop();
            let (mut room, mut pixels, mut work) = taken.unwrap_or_default();
            let (from, to) = (n * self.down, ((n + 1) * self.down).min(self.eye.lens.size().1));
            pixels.resize_with(self.across / rays * (self.down / rays), P::default);
            let mut band = begin((to - from) / rays * width);
            for tile in self.band(n) {
                let across = (tile.x.1 - tile.x.0) / rays;
                let place = |x: usize, y: usize| (y - from) / rays * across + (x - tile.x.0) / rays;
                tile.render(&mut room, |x, y, seen| add(&mut pixels[place(x, y)], seen));
                for y in (tile.y.0..tile.y.1).step_by(rays) {
                    for x in (tile.x.0..tile.x.1).step_by(rays) {
                        let at = (y - from) / rays * width + x / rays;
                        finish(&mut pixels[place(x, y)], &mut work, &mut band, at);
                    }
                }
            }
            at_rest().push((room, pixels, work));
            band
        };
        (0..self.eye.lens.size().1.div_ceil(self.down)).into_par_iter().map(band).collect()
    }

    /// The tiles of band `n`, from the left.
    fn band(&self, n: usize) -> impl Iterator<Item = Tile<'_>> {
        let (width, height) = self.eye.lens.size();
        let y = (n * self.down, ((n + 1) * self.down).min(height));
        (0..width).step_by(self.across).map(move |x| Tile {
            grid: self.grid,
            frame: self.frame,
            eye: self.eye,
            limits: self.limits,
            x: (x, (x + self.across).min(width)),
            y,
            coloured: self.coloured,
        })
    }
}

/// A part of a picture.
struct Tile<'a> {
    grid: &'a Grid<f32>,
    frame: &'a SceneFrame,
    eye: Eye<'a>,
    limits: Thresholds,
    /// First column, and the one behind the last.
    x: (usize, usize),
    /// The same of rows.
    y: (usize, usize),
    coloured: bool,
}

impl Tile<'_> {
    /// Hands every pixel to `pixel`, with its column and row.
    fn render(&self, room: &mut Room, mut pixel: impl FnMut(usize, usize, &Seen<'_>)) {
        let (middle, bases) = self.bases();
        room.tints.begin(bases);
        let rows = (self.y.0..self.y.1).step_by(GROUP.1);
        let places = rows.flat_map(|y| (self.x.0..self.x.1).step_by(GROUP.0).map(move |x| Place { x, y }));
        for (n, at) in places.enumerate() {
            let [now, before] = &mut room.groups;
            now.follow(self, at);
            if self.coloured {
                now.shares.iter().for_each(|shares| room.tints.ask_for(self.grid, shares));
            }
            if n > 0 {
                self.hand_over(before, &mut room.tints, middle, &mut pixel);
            }
            room.groups.swap(0, 1);
        }
        self.hand_over(&room.groups[1], &mut room.tints, middle, &mut pixel);
    }

    /// Path and harmonics of the pixel at `x`, `y`.
    #[inline(always)]
    fn ray(&self, x: usize, y: usize) -> (RayPath, [f32; SH]) {
        self.eye.ray(self.frame, y * self.eye.lens.size().0 + x)
    }

    /// The middle pixel, what coefficients are multiplied by there, and its change a pixel across, and down.
    fn bases(&self) -> (Place, [[f32; SH]; 3]) {
        let ((left, right), (top, bottom)) = ((self.x.0, self.x.1 - 1), (self.y.0, self.y.1 - 1));
        let (x, y) = ((left + right) / 2, (top + bottom) / 2);
        let of = |x, y| self.ray(x, y).1;
        let change = |from: [f32; SH], to: [f32; SH], pixels: usize| -> [f32; SH] {
            std::array::from_fn(|k| (to[k] - from[k]) / pixels.max(1) as f32)
        };
        let across = change(of(left, y), of(right, y), right - left);
        (Place { x, y }, [of(x, y), across, change(of(x, top), of(x, bottom), bottom - top)])
    }

    /// Hands the pixels of `group` over.
    #[inline(always)]
    fn hand_over(
        &self,
        group: &Group,
        tints: &mut Tints,
        middle: Place,
        pixel: &mut impl FnMut(usize, usize, &Seen<'_>),
    ) {
        let grid = self.grid;
        for (ray, Place { x, y }) in self.rays_of(group.at) {
            let (across, down) = (x as f32 - middle.x as f32, y as f32 - middle.y as f32);
            let shares = &group.shares[ray];
            let mut gathered = match self.coloured {
                true => tints.sum(grid, shares, across, down, &group.harmonics[ray]),
                false => Gathered::default(),
            };
            (gathered.end, gathered.along) = (group.ends[ray], group.along[ray]);
            let at = y * self.eye.lens.size().0 + x;
            pixel(x, y, &Seen { at, gathered, harmonics: group.harmonics[ray], shares, grid });
        }
    }

    /// Numbers, columns and rows of the group's rays whose first is `at`, as many as are in the tile.
    #[inline(always)]
    fn rays_of(&self, at: Place) -> impl Iterator<Item = (usize, Place)> + use<'_> {
        let place = move |ray: usize| (ray, Place { x: at.x + ray % GROUP.0, y: at.y + ray / GROUP.0 });
        (0..RAYS).map(place).filter(|(_, at)| at.x < self.x.1 && at.y < self.y.1)
    }
}

impl Group {
    /// Marches the rays of `tile` from the pixel `at` on and notes what each gathers where.
    #[inline(always)]
    fn follow(&mut self, tile: &Tile<'_>, at: Place) {
        let grid = tile.grid;
        self.at = at;
        self.along = [0.0; RAYS];
        self.shares.iter_mut().for_each(Vec::clear);
        let mut paths = [RayPath::Miss; RAYS];
        for (ray, Place { x, y }) in tile.rays_of(at) {
            (paths[ray], self.harmonics[ray]) = tile.ray(x, y);
        }
        self.ends = composite(grid, &paths, 0.5, tile.limits, |ray, met| {
            let (s, k) = (met.samples, met.lane);
            let shares = &mut self.shares[ray];
            // The one before is most often in the same cell.
            if shares.last().is_none_or(|last| last.cell != s.cell[k] || last.far != s.far) {
                grid.prefetch_index(s.cell[k]);
                let place = s.cells.map(|axis| axis[k] as u8);
                shares.push(Share { cell: s.cell[k], place, far: s.far, corners: [0.0; 8], weight: 0.0 });
            }
            let share = shares.last_mut().expect("there is one now");
            for (sum, corner) in share.corners.iter_mut().zip(trilinear(s.frac_of(k))) {
                *sum += corner * met.weight;
            }
            share.weight += met.weight;
            self.along[ray] += met.weight * s.along[k];
        });
    }
}
