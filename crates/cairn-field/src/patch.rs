//! What the rays of one tile share. Neighbouring rays meet the same vertices again
//! and again: each vertex's colour is worked out once a tile (seen along the tile's
//! middle), and what its rays owe a vertex is summed before it goes to the grid.
//! Rows of coefficients lie far apart in memory; a tile goes to each once.

use crate::grid::Grid;
use crate::real::Real;
use crate::sh::SH;

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
    most: T,
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
    pub most: T,
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
            cells: Table::new(),
            slots: Table::new(),
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
            sum.most = sum.most.max(shares[k]);
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
            if numbers == [T::zero(); 4] && sum.most == T::zero() {
                continue;
            }
            if let Some(boost) = roulette.survives(weight.wide() as f32) {
                let boost = T::of(f64::from(boost));
                let [r, g, b, raw] = numbers.map(|v| boost * v);
                debts.owed.push(Debt { row: *row, tile, light: [r, g, b], raw, most: sum.most });
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
    /// Least probability: what survives by luck does not outweigh all else.
    const LEAST: f32 = 0.1;
    /// Takes everything.
    pub const NONE: Self = Self { below: 0.0, state: 0 };

    /// The factor of a vertex that weighs `weight`, or `None` when it is passed over.
    #[inline(always)]
    fn survives(&mut self, weight: f32) -> Option<f32> {
        if weight >= self.below {
            return Some(1.0);
        }
        let p = (weight / self.below).max(Self::LEAST);
        // A linear congruential step (Knuth's MMIX): the upper bits are even enough here.
        self.state = self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let chance = (self.state >> 40) as f32 / (1u32 << 24) as f32;
        (chance < p).then(|| 1.0 / p)
    }
}

/// A small hash table from numbers to numbers that is emptied at no cost.
#[derive(Clone, Debug)]
struct Table {
    /// A power of two of places, at most half of them taken.
    entries: Vec<Entry>,
    /// Entries with another stamp are from before the last clearing.
    stamp: u32,
    used: usize,
}

#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    stamp: u32,
    key: u32,
    value: u32,
}

impl Table {
    fn new() -> Self {
        Self { entries: vec![Entry::default(); 1024], stamp: 1, used: 0 }
    }

    fn clear(&mut self) {
        self.used = 0;
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.entries.fill(Entry::default());
            self.stamp = 1;
        }
    }

    /// The value of `key`, which becomes `fresh` if it had none.
    #[inline(always)]
    fn find_or_insert(&mut self, key: u32, fresh: u32) -> u32 {
        let mask = self.entries.len() - 1;
        // Fibonacci hashing (Knuth, TAOCP 3, 6.4): neighbours land far apart.
        let mut at = (u64::from(key).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as usize & mask;
        loop {
            let entry = self.entries[at];
            if entry.stamp != self.stamp {
                break;
            }
            if entry.key == key {
                return entry.value;
            }
            at = (at + 1) & mask;
        }
        self.entries[at] = Entry { stamp: self.stamp, key, value: fresh };
        self.used += 1;
        if 2 * self.used > self.entries.len() {
            self.grow();
        }
        fresh
    }

    #[cold]
    fn grow(&mut self) {
        let old = std::mem::take(&mut self.entries);
        self.entries = vec![Entry::default(); 2 * old.len()];
        self.used = 0;
        let stamp = self.stamp;
        for entry in old.into_iter().filter(|e| e.stamp == stamp) {
            self.find_or_insert(entry.key, entry.value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_keeps_what_it_is_given_until_cleared() {
        let mut table = Table::new();
        // Near the last stamp, so that it runs over once.
        table.stamp = u32::MAX - 1;
        for round in 0..4u32 {
            for key in (0..5000).map(|i| i * 37) {
                assert_eq!(table.find_or_insert(key, key + round), key + round, "new in round {round}");
            }
            for key in (0..5000).map(|i| i * 37) {
                assert_eq!(table.find_or_insert(key, 0), key + round, "found in round {round}");
            }
            table.clear();
        }
    }
}
