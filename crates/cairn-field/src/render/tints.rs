//! The colours of the vertices that the rays of one tile of a picture meet, each worked out
//! once, and what a ray gathers of them.

use super::composite::Gathered;
use crate::grid::lattice::Grid;
use crate::grid::sh::SH;

/// A vertex's colour seen from a tile's middle, its change a pixel across, and down;
/// padding behind each.
type Tint = [f32; 12];

/// What a ray gathers in one cell and one part of space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Share {
    /// Its first vertex.
    pub(crate) cell: u32,
    /// The cell's place, by axis, as far as [`Tints`] tells places apart.
    pub(crate) place: [u8; 3],
    /// In contracted space.
    pub(crate) far: bool,
    /// What each corner weighs in the pixel.
    pub(crate) corners: [f32; 8],
    /// What they weigh together.
    pub(crate) weight: f32,
}

/// Vertices as a tile sees them. Each has one place, where another may take it later: those
/// of any cube of [`SIDE`] vertices a side have places of their own, and a tile seldom
/// sees more at once.
pub(crate) struct Tints {
    /// The tile's: the colour basis in its middle, and its change a pixel across, and down.
    bases: [[f32; SH]; 3],
    /// By place, the vertex whose it is, or [`NOBODY`].
    vertex: Vec<u32>,
    /// By place, its tint.
    tint: Vec<Tint>,
    /// Places that are somebody's.
    used: Vec<u16>,
}

/// The largest amount that a ray's colour basis may differ from what its tile makes of it: a colour whose
/// coefficients come to one is then off by a tenth of an 8-bit step at most.
const MAX_BENT: f32 = 4e-4;
/// Vertices a side that are told apart; a power of two.
const SIDE: usize = 16;
const NOBODY: u32 = u32::MAX;

impl Default for Tints {
    fn default() -> Self {
        let places = SIDE * SIDE * SIDE;
        Self { bases: [[0.0; SH]; 3], vertex: vec![NOBODY; places], tint: vec![[0.0; 12]; places], used: Vec::new() }
    }
}

impl Tints {
    /// Forgets everything; what comes is seen so.
    pub(crate) fn begin(&mut self, bases: [[f32; SH]; 3]) {
        self.bases = bases;
        for place in self.used.drain(..) {
            self.vertex[usize::from(place)] = NOBODY;
        }
    }

    /// Places of a cell's corners, x fastest.
    #[inline(always)]
    fn places(cell: [u8; 3]) -> [usize; 8] {
        let at = |axis: usize, on: usize| (usize::from(cell[axis]) + on) % SIDE * SIDE.pow(axis as u32);
        std::array::from_fn(|k| at(0, k & 1) + at(1, k >> 1 & 1) + at(2, k >> 2))
    }

    /// Asks for the rows that [`Tints::sum`] will have to look up: they lie far apart.
    #[inline(always)]
    pub(crate) fn ask_for(&self, grid: &Grid<f32>, shares: &[Share]) {
        let corners = grid.corners();
        for share in shares {
            for (place, corner) in Self::places(share.place).into_iter().zip(corners) {
                let vertex = share.cell + corner as u32;
                if self.vertex[place] != vertex {
                    grid.prefetch_row(grid.index[vertex as usize]);
                }
            }
        }
    }

    /// What a ray along `basis` gathers whose pixel is so far `across` and `down` off the tile's middle. A ray whose
    /// direction the tile does not know well enough goes by itself: in wide tiles, and where a lens
    /// folds its picture's rim over.
    #[inline(always)]
    pub(crate) fn sum(
        &mut self,
        grid: &Grid<f32>,
        shares: &[Share],
        across: f32,
        down: f32,
        basis: &[f32; SH],
    ) -> Gathered<f32> {
        let [middle, by_column, by_row] = &self.bases;
        let bent = |k: usize| (basis[k] - (middle[k] + across * by_column[k] + down * by_row[k])).abs();
        // Not `any`, by which what is not a number would be straight.
        if !(0..SH).all(|k| bent(k) < MAX_BENT) {
            return alone(grid, shares, basis);
        }
        let corners = grid.corners();
        let (mut parts, mut weights) = ([[0.0f32; 12]; 2], [0.0; 2]);
        for share in shares {
            let places = Self::places(share.place);
            for (place, corner) in places.into_iter().zip(corners) {
                let vertex = share.cell + corner as u32;
                if self.vertex[place] != vertex {
                    self.look_up(grid, place, vertex);
                }
            }
            let part = usize::from(share.far);
            let mut sums = parts[part];
            for (place, weight) in places.into_iter().zip(share.corners) {
                for (sum, v) in sums.iter_mut().zip(&self.tint[place]) {
                    *sum += weight * v;
                }
            }
            parts[part] = sums;
            weights[part] += share.weight;
        }
        let colour = |part: &Tint| std::array::from_fn(|c| part[c] + across * part[4 + c] + down * part[8 + c]);
        Gathered {
            near: colour(&parts[0]),
            near_weight: weights[0],
            far: colour(&parts[1]),
            far_weight: weights[1],
            ..Gathered::default()
        }
    }

    /// Gives `place` to `vertex`.
    #[inline(never)]
    fn look_up(&mut self, grid: &Grid<f32>, place: usize, vertex: u32) {
        let row = grid.index[vertex as usize];
        self.vertex[place] = vertex;
        self.used.push(place as u16);
        for (out, basis) in self.tint[place].chunks_exact_mut(4).zip(&self.bases) {
            out[..3].copy_from_slice(&grid.colour_along(row, basis));
        }
    }
}

/// What a ray gathers along `basis`, vertex by vertex.
#[cold]
fn alone(grid: &Grid<f32>, shares: &[Share], basis: &[f32; SH]) -> Gathered<f32> {
    let corners = grid.corners();
    let mut sum = Gathered::default();
    for share in shares {
        let light = grid.light(share.cell as usize, &share.corners, &corners, basis);
        let (part, weight) =
            if share.far { (&mut sum.far, &mut sum.far_weight) } else { (&mut sum.near, &mut sum.near_weight) };
        *weight += share.weight;
        part.iter_mut().zip(light).for_each(|(part, light)| *part += light);
    }
    sum
}
