//! What the rays of one tile share. Neighbouring rays meet the same vertices again
//! and again: each vertex's colour is worked out once a tile (seen along the tile's
//! middle), and what its rays owe a vertex is summed before it goes to the grid.
//! Rows of coefficients lie far apart in memory; a tile goes to each once.

use crate::grid::lattice::Grid;
use crate::grid::real::Real;
use crate::grid::sh::SH;
use crate::grid::table::Table;

/// The vertices met by the rays of a tile; see the module's text.
#[derive(Clone, Debug)]
pub struct Patch<T> {
    basis: [T; SH],
    /// Where in `corners` a cell is.
    cells: Table,
    /// Slot of a row.
    slots: Table,
    /// Slots of the corners of each cell met.
    corners: Vec<[u32; 8]>,
    /// By slot, its row in the grid; slot 0 stands for the empty row.
    rows: Vec<u32>,
    /// By slot, its colour as seen along `basis` (and padding); shorter than `rows`
    /// until [`Patch::look_up`].
    colour: Vec<[T; 4]>,
    sums: Vec<Sum<T>>,
}

/// What a vertex's gradient comes to so far.
#[derive(Clone, Copy, Debug, Default)]
struct Sum<T> {
    /// d(loss)/d(colour seen), and the vertex's weight in all pixels.
    light: [T; 4],
    /// d(loss)/d(raw density).
    raw: T,
    /// Largest weight in a pixel.
    max_weight: T,
}

/// What a tile owes a row of the grid.
#[derive(Clone, Copy, Debug)]
pub struct Debt<T> {
    /// The row.
    pub row: u32,
    /// Which tile of its task it comes from (for the basis).
    pub tile: u32,
    /// d(loss)/d(colour seen); its coefficients' gradient is this times the basis.
    pub light: [T; 3],
    /// d(loss)/d(raw density).
    pub raw: T,
    /// The row's largest weight in a pixel.
    pub max_weight: T,
}

/// What some tiles owe the grid.
#[derive(Clone, Debug, Default)]
pub struct Debts<T> {
    /// Tile by tile.
    pub owed: Vec<Debt<T>>,
    /// Colour basis of each tile.
    pub bases: Vec<[T; SH]>,
}

impl<T: Real> Default for Patch<T> {
    fn default() -> Self {
        let mut patch = Self {
            basis: [T::zero(); SH],
            cells: Table::default(),
            slots: Table::default(),
            corners: Vec::new(),
            rows: Vec::new(),
            colour: Vec::new(),
            sums: Vec::new(),
        };
        patch.begin([T::zero(); SH]);
        patch
    }
}

impl<T: Real> Patch<T> {
    /// Largest gradient at a vertex that passes for a number: sums of their squares
    /// are then far from f32's end.
    const LARGEST: f64 = 1e12;

    /// Forgets everything; what comes is seen along `basis`.
    pub fn begin(&mut self, basis: [T; SH]) {
        self.basis = basis;
        self.cells.clear();
        self.slots.clear();
        self.corners.clear();
        self.rows.clear();
        self.colour.clear();
        self.sums.clear();
        self.rows.push(0);
        self.colour.push([T::zero(); 4]);
        self.sums.push(Sum::default());
    }

    /// The place of `cell` among those met; its colours count from [`Patch::look_up`] on.
    #[inline(always)]
    pub(crate) fn meet(&mut self, grid: &Grid<T>, cell: u32) -> u32 {
        let fresh = self.corners.len() as u32;
        let place = self.cells.find_or_insert(cell, fresh);
        if place == fresh {
            self.enter(grid, cell);
        }
        place
    }

    fn enter(&mut self, grid: &Grid<T>, cell: u32) {
        let rows = grid.corner_rows(cell as usize, &grid.corners());
        let slots = rows.map(|row| {
            if row == 0 {
                return 0;
            }
            let fresh = self.rows.len() as u32;
            let slot = self.slots.find_or_insert(row, fresh);
            if slot == fresh {
                grid.prefetch_row(row);
                self.rows.push(row);
            }
            slot
        });
        self.corners.push(slots);
    }

    /// Looks up the colours of all vertices met since the last time.
    #[inline]
    pub(crate) fn look_up(&mut self, grid: &Grid<T>) {
        for row in &self.rows[self.colour.len()..] {
            let [r, g, b] = grid.colour_along(*row, &self.basis);
            self.colour.push([r, g, b, T::zero()]);
            self.sums.push(Sum::default());
        }
    }

    /// Colours of the corners of the cell at `place`.
    #[inline(always)]
    pub(crate) fn colours(&self, place: u32) -> [[T; 4]; 8] {
        self.corners[place as usize].map(|slot| self.colour[slot as usize])
    }

    /// Adds what a run of samples in the cell at `place` owes its corners: `raw` is
    /// d(loss)/d(raw density) of each, `shares` what each weighs in the pixel, and
    /// `light` d(loss)/d(light gathered).
    #[inline(always)]
    pub(crate) fn owe(&mut self, place: u32, raw: &[T; 8], shares: &[T; 8], light: [T; 3]) {
        let light = [light[0], light[1], light[2], T::one()];
        for (k, slot) in self.corners[place as usize].into_iter().enumerate() {
            let sum = &mut self.sums[slot as usize];
            for (l, add) in sum.light.iter_mut().zip(light) {
                *l += shares[k] * add;
            }
            sum.raw += raw[k];
            sum.max_weight = sum.max_weight.max(shares[k]);
        }
    }

    /// Appends to `debts` what the tile owes, of faint vertices as `roulette` decides;
    /// false when a gradient is not finite, or absurd.
    pub fn settle(&self, roulette: &mut Roulette, debts: &mut Debts<T>) -> bool {
        let tile = debts.bases.len() as u32;
        debts.bases.push(self.basis);
        let largest = T::of(Self::LARGEST);
        let mut fine = true;
        for (sum, row) in self.sums.iter().zip(&self.rows).skip(1) {
            let [r, g, b, weight] = sum.light;
            let numbers = [r, g, b, sum.raw];
            fine &= numbers.iter().all(|v| v.abs() <= largest);
            if numbers == [T::zero(); 4] && sum.max_weight == T::zero() {
                continue;
            }
            if let Some(boost) = roulette.survives(weight.wide() as f32) {
                let boost = T::of(f64::from(boost));
                let [r, g, b, raw] = numbers.map(|v| boost * v);
                debts.owed.push(Debt { row: *row, tile, light: [r, g, b], raw, max_weight: sum.max_weight });
            }
        }
        fine
    }
}

/// Which faint vertices' gradients count: each with a probability, and then as much
/// the more. The mean stays what it is, and most of the work goes where the light is.
#[derive(Clone, Copy, Debug)]
pub struct Roulette {
    /// Weight in a tile's pixels below which a vertex takes its chance; 0 takes all.
    pub below: f32,
    /// State of the chance: a seed, then whatever was drawn from it.
    pub state: u64,
}

impl Default for Roulette {
    fn default() -> Self {
        Self::NONE
    }
}

impl Roulette {
    /// Smallest probability: what survives by luck does not outweigh all else.
    const MIN_PROBABILITY: f32 = 0.1;
    /// Takes everything.
    pub const NONE: Self = Self { below: 0.0, state: 0 };

    /// The factor of a vertex that weighs `weight`, or `None` when it is passed over.
    #[inline(always)]
    fn survives(&mut self, weight: f32) -> Option<f32> {
        if weight >= self.below {
            return Some(1.0);
        }
        let p = (weight / self.below).max(Self::MIN_PROBABILITY);
        // A linear congruential step (Knuth's MMIX): the upper bits are even enough here.
        self.state = self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let chance = (self.state >> 40) as f32 / (1u32 << 24) as f32;
        (chance < p).then(|| 1.0 / p)
    }
}
