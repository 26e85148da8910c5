//! Whole pictures, tile by tile. The rays of a tile meet the same vertices again and
//! again, and see each along nearly the same direction: a vertex's colour is worked out once a
//! tile, as it is seen from the tile's middle and how that changes across and down. Rays go
//! in small groups, so that they pass empty space together.

use crate::composite::{Gathered, Thresholds, composite};
use crate::field::Field;
use crate::frame::RayPath;
use crate::grid::{Grid, trilinear};
use crate::rays::Lens;
use crate::sh::SH;
use crate::tints::{Share, Tints};
use cairn_capture::Camera;
use rayon::prelude::*;

/// Most pixels of a tile across and down.
const TILE: (usize, usize) = (16, 8);
/// Widest a tile may be, radians: harmonics of degree 2 are then straight across it to less than a
/// thousandth of what they come to, a tenth of an 8-bit step in what shines.
const WIDEST: f64 = 0.06;
/// Rays that go together, across and down.
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
    bases: [[f32; SH]; RAYS],
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
    /// and the colour basis along it.
    pub(crate) basis: [f32; SH],
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

impl Field {
    /// What `pixel` makes of every pixel of `camera`, row-major.
    pub(crate) fn each_pixel<O: Clone + Default + Send>(
        &self,
        camera: &Camera,
        limits: Thresholds,
        pixel: impl Fn(&Seen<'_>) -> O + Sync,
    ) -> Vec<O> {
        let lens = Lens::new(camera);
        let (w, h) = lens.size();
        let mut all = vec![O::default(); w * h];
        let within = |most: usize, focal: f64| ((WIDEST * focal) as usize).clamp(1, most);
        let (across, down) = (within(TILE.0, camera.intrinsics.fx), within(TILE.1, camera.intrinsics.fy));
        all.par_chunks_mut(down * w).enumerate().for_each_init(Room::default, |room, (n, band)| {
            for left in (0..w).step_by(across) {
                let tile = Tile {
                    field: self,
                    camera,
                    lens: &lens,
                    limits,
                    x: (left, (left + across).min(w)),
                    y: (n * down, n * down + band.len() / w),
                };
                tile.render(room, |x, y, seen| band[(y - n * down) * w + x] = pixel(seen));
            }
        });
        all
    }
}

/// A part of a picture.
struct Tile<'a> {
    field: &'a Field,
    camera: &'a Camera,
    lens: &'a Lens,
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

    /// Path and basis of the pixel at `x`, `y`.
    #[inline(always)]
    fn ray(&self, x: usize, y: usize) -> (RayPath, [f32; SH]) {
        self.lens.ray(self.camera, &self.field.frame, y * self.lens.size().0 + x)
    }

    /// The middle pixel, the colour basis there, and its change a pixel across, and down.
    fn bases(&self) -> ((usize, usize), [[f32; SH]; 3]) {
        let ((left, right), (top, bottom)) = ((self.x.0, self.x.1 - 1), (self.y.0, self.y.1 - 1));
        let (x, y) = ((left + right) / 2, (top + bottom) / 2);
        let of = |x, y| self.ray(x, y).1;
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
            let mut gathered = tints.sum(grid, shares, off);
            (gathered.end, gathered.along) = (group.ends[ray], group.along[ray]);
            pixel(x, y, &Seen { gathered, basis: group.bases[ray], shares, grid });
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
            (paths[ray], self.bases[ray]) = tile.ray(x, y);
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
