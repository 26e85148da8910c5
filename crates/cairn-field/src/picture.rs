//! Whole pictures, tile by tile. The rays of a tile meet the same vertices again and
//! again, and see each along nearly the same direction: a vertex's colour is worked out once a
//! tile, as it is seen from the tile's middle and how that changes across and down. Rays go
//! in small groups, so that they pass empty space together.

use crate::composite::{Gathered, Thresholds, composite};
use crate::field::Field;
use crate::frame::RayPath;
use crate::grid::{Grid, trilinear};
use crate::lights::{FIRST, LIGHTS};
use crate::rays::Lens;
use crate::sh::SH;
use crate::tints::{Share, Tints};
use cairn_scene::Camera;
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Most pixels of a tile across and down.
const TILE: (usize, usize) = (16, 8);
/// About as wide as a tile should be, radians: most rays' directions are then straight
/// across it ([`crate::tints`]).
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

/// Some rays side by side.
#[derive(Default)]
struct Group {
    /// Column and row of the first one.
    at: (usize, usize),
    harmonics: [[f32; SH]; RAYS],
    shares: [Vec<Share>; RAYS],
    /// Transmittances at the rays' ends.
    ends: [f32; RAYS],
    /// Sums of weight times distance.
    along: [f32; RAYS],
}

/// A pixel's ray as it is handed over.
pub(crate) struct Seen<'a> {
    /// What it gathered,
    pub(crate) gathered: Gathered<f32>,
    /// and the spherical harmonics along it.
    pub(crate) harmonics: [f32; SH],
    shares: &'a [Share],
    grid: &'a Grid<f32>,
}

impl Seen<'_> {
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

impl Seen<'_> {
    /// What the pixel gathers more for one unit of each basis light: near and far colour.
    pub(crate) fn per_light(&self) -> PerLight {
        let mut lit = [[0.0; 6]; LIGHTS];
        self.each_vertex(|row, weight, far| {
            let coefficients = self.grid.row(row as u32)[3 * FIRST..].chunks_exact(3);
            for (sum, rgb) in lit.iter_mut().zip(coefficients) {
                let sum = &mut sum[if far { 3 } else { 0 }..][..3];
                sum.iter_mut().zip(rgb).for_each(|(s, v)| *s += weight * v);
            }
        });
        lit
    }
}

/// What a pixel gathers more for one unit of each basis light: near colour, then far.
pub(crate) type PerLight = [[f32; 6]; LIGHTS];

impl Field {
    /// What `pixel` makes of every pixel of `camera`, row-major.
    pub(crate) fn each_pixel<O: Clone + Default + Send>(
        &self,
        camera: &Camera,
        lights: [f32; LIGHTS],
        limits: Thresholds,
        pixel: impl Fn(&Seen<'_>) -> O + Sync,
    ) -> Vec<O> {
        let lens = Lens::new(camera);
        let tiling = Tiling::of(self, (camera, &lens), lights, limits, 1);
        tiling.gather(|out, seen| *out = pixel(seen), |_| {})
    }
}

/// A picture cut into tiles.
pub(crate) struct Tiling<'a> {
    field: &'a Field,
    camera: &'a Camera,
    lens: &'a Lens,
    lights: [f32; LIGHTS],
    limits: Thresholds,
    /// Rays across a pixel, and down.
    rays: usize,
    /// Size of a tile, rays.
    across: usize,
    down: usize,
}

impl<'a> Tiling<'a> {
    /// Of the rays of `camera`, whose lens it is; a pixel is `rays x rays` of them (1 or more), and
    /// lies in one tile.
    pub(crate) fn of(
        field: &'a Field,
        (camera, lens): (&'a Camera, &'a Lens),
        lights: [f32; LIGHTS],
        limits: Thresholds,
        rays: usize,
    ) -> Self {
        let within = |most: usize, focal: f64| ((WIDEST * focal) as usize).clamp(1, most) / rays * rays;
        let (across, down) = (within(TILE.0, camera.intrinsics.fx), within(TILE.1, camera.intrinsics.fy));
        Self { field, camera, lens, lights, limits, rays, across: across.max(rays), down: down.max(rays) }
    }

    /// What `add` makes of each pixel's rays, and `finish` of that; row-major.
    pub(crate) fn gather<P: Clone + Default + Send>(
        &self,
        add: impl Fn(&mut P, &Seen<'_>) + Sync,
        finish: impl Fn(&mut P) + Sync,
    ) -> Vec<P> {
        let none = |pixels: usize| vec![P::default(); pixels];
        let finish = |pixel: &mut P, (): &mut (), (pixels, at): (&mut Vec<P>, usize)| {
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
        finish: impl Fn(&mut P, &mut R, (&mut B, usize)) + Sync,
    ) -> Vec<B> {
        let (rays, width) = (self.rays, self.lens.size().0 / self.rays);
        // A room is large: as many are made as threads want one at a time, not one for each task.
        let rooms: Mutex<Vec<(Room, Vec<P>, R)>> = Mutex::default();
        let at_rest = || rooms.lock().unwrap_or_else(PoisonError::into_inner);
        let band = |n: usize| {
            let taken = at_rest().pop();
            let (mut room, mut pixels, mut work) = taken.unwrap_or_default();
            let (from, to) = (n * self.down, ((n + 1) * self.down).min(self.lens.size().1));
            pixels.resize_with(self.across / rays * (self.down / rays), P::default);
            let mut band = begin((to - from) / rays * width);
            for tile in self.band(n) {
                let across = (tile.x.1 - tile.x.0) / rays;
                let place = |x: usize, y: usize| (y - from) / rays * across + (x - tile.x.0) / rays;
                tile.render(&mut room, |x, y, seen| add(&mut pixels[place(x, y)], seen));
                for y in (tile.y.0..tile.y.1).step_by(rays) {
                    for x in (tile.x.0..tile.x.1).step_by(rays) {
                        let at = (y - from) / rays * width + x / rays;
                        finish(&mut pixels[place(x, y)], &mut work, (&mut band, at));
                    }
                }
            }
            at_rest().push((room, pixels, work));
            band
        };
        (0..self.lens.size().1.div_ceil(self.down)).into_par_iter().map(band).collect()
    }

    /// The tiles of band `n`, from the left.
    fn band(&self, n: usize) -> impl Iterator<Item = Tile<'_>> {
        let (width, height) = self.lens.size();
        let y = (n * self.down, ((n + 1) * self.down).min(height));
        (0..width).step_by(self.across).map(move |x| Tile {
            field: self.field,
            camera: self.camera,
            lens: self.lens,
            lights: self.lights,
            limits: self.limits,
            x: (x, (x + self.across).min(width)),
            y,
        })
    }
}

/// A part of a picture.
struct Tile<'a> {
    field: &'a Field,
    camera: &'a Camera,
    lens: &'a Lens,
    lights: [f32; LIGHTS],
    limits: Thresholds,
    /// First column, and the one behind the last.
    x: (usize, usize),
    /// The same of rows.
    y: (usize, usize),
}

impl Tile<'_> {
    /// Hands every pixel to `pixel`, with its column and row.
    fn render(&self, room: &mut Room, mut pixel: impl FnMut(usize, usize, &Seen<'_>)) {
        let (middle, bases) = self.bases();
        room.tints.begin(bases);
        let rows = (self.y.0..self.y.1).step_by(GROUP.1);
        let places = rows.flat_map(|y| (self.x.0..self.x.1).step_by(GROUP.0).map(move |x| (x, y)));
        for (n, at) in places.enumerate() {
            let [now, before] = &mut room.groups;
            now.follow(self, at);
            now.shares.iter().for_each(|shares| room.tints.ask_for(&self.field.grid, shares));
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
        self.lens.ray(self.camera, &self.field.frame, y * self.lens.size().0 + x)
    }

    /// What coefficients are multiplied by along a ray with these harmonics.
    #[inline(always)]
    fn weights(&self, harmonics: &[f32; SH]) -> [f32; SH] {
        self.field.colours.weights(harmonics, &self.lights)
    }

    /// The middle pixel, what coefficients are multiplied by there, and its change a pixel across, and down.
    fn bases(&self) -> ((usize, usize), [[f32; SH]; 3]) {
        let ((left, right), (top, bottom)) = ((self.x.0, self.x.1 - 1), (self.y.0, self.y.1 - 1));
        let (x, y) = ((left + right) / 2, (top + bottom) / 2);
        let of = |x, y| self.weights(&self.ray(x, y).1);
        let change = |from: [f32; SH], to: [f32; SH], pixels: usize| -> [f32; SH] {
            std::array::from_fn(|k| (to[k] - from[k]) / pixels.max(1) as f32)
        };
        let across = change(of(left, y), of(right, y), right - left);
        ((x, y), [of(x, y), across, change(of(x, top), of(x, bottom), bottom - top)])
    }

    /// Hands the pixels of `group` over.
    #[inline(always)]
    fn hand_over(
        &self,
        group: &Group,
        tints: &mut Tints,
        middle: (usize, usize),
        pixel: &mut impl FnMut(usize, usize, &Seen<'_>),
    ) {
        let grid = &self.field.grid;
        for (ray, (x, y)) in self.rays_of(group.at) {
            let off = (x as f32 - middle.0 as f32, y as f32 - middle.1 as f32);
            let shares = &group.shares[ray];
            let mut gathered = tints.sum(grid, shares, off, &self.weights(&group.harmonics[ray]));
            (gathered.end, gathered.along) = (group.ends[ray], group.along[ray]);
            pixel(x, y, &Seen { gathered, harmonics: group.harmonics[ray], shares, grid });
        }
    }

    /// Numbers, columns and rows of the group's rays whose first is `at`, as many as are in the tile.
    #[inline(always)]
    fn rays_of(&self, at: (usize, usize)) -> impl Iterator<Item = (usize, (usize, usize))> + use<'_> {
        let place = move |ray: usize| (ray, (at.0 + ray % GROUP.0, at.1 + ray / GROUP.0));
        (0..RAYS).map(place).filter(|(_, (x, y))| *x < self.x.1 && *y < self.y.1)
    }
}

impl Group {
    /// Marches the rays of `tile` from the pixel `at` on and notes what each gathers where.
    #[inline(always)]
    fn follow(&mut self, tile: &Tile<'_>, at: (usize, usize)) {
        let grid = &tile.field.grid;
        self.at = at;
        self.along = [0.0; RAYS];
        self.shares.iter_mut().for_each(Vec::clear);
        let mut paths = [RayPath::Miss; RAYS];
        for (ray, (x, y)) in tile.rays_of(at) {
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
