//! Which pixels a step looks at: small square tiles, so that neighbouring rays meet
//! the same rows of the grid while these are still at hand, drawn from all tiles of
//! all views without repetition until every one was seen.

use crate::chance::mixed;
use crate::rays::lens::Lens;
use std::sync::Arc;

/// The tiles of all views.
#[derive(Debug)]
pub(crate) struct Tiles {
    /// Side of a tile, pixels.
    side: usize,
    /// First tile of each view, and how many there are in all.
    starts: Vec<u64>,
    /// Width and height of each view, pixels.
    sizes: Vec<(usize, usize)>,
}

/// A tile: a view's pixels from `x` to `right` and from `y` to `bottom`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tile {
    pub(crate) view: usize,
    pub(crate) x: usize,
    pub(crate) y: usize,
    pub(crate) right: usize,
    pub(crate) bottom: usize,
}

impl Tiles {
    /// Tiles of `side` x `side` pixels; smaller ones at the edges.
    pub(crate) fn of<'a>(lenses: impl Iterator<Item = &'a Arc<Lens>>, side: usize) -> Self {
        let (mut starts, mut sizes) = (vec![0], Vec::new());
        for lens in lenses {
            let (w, h) = lens.size();
            sizes.push((w, h));
            starts.push(starts[starts.len() - 1] + (w.div_ceil(side) * h.div_ceil(side)) as u64);
        }
        Self { side, starts, sizes }
    }

    /// Tiles in all.
    pub(crate) fn count(&self) -> u64 {
        self.starts[self.starts.len() - 1]
    }

    /// The `n`th tile drawn: every round over all tiles is another permutation.
    pub(crate) fn draw(&self, seed: u64, n: u64) -> Tile {
        let (round, place) = (n / self.count(), n % self.count());
        self.tile(permuted(place, self.count(), mixed(seed ^ mixed(round))))
    }

    fn tile(&self, n: u64) -> Tile {
        let view = self.starts.partition_point(|s| *s <= n) - 1;
        let (w, h) = self.sizes[view];
        let side = self.side;
        let (across, at) = (w.div_ceil(side), (n - self.starts[view]) as usize);
        let (x, y) = (at % across * side, at / across * side);
        Tile { view, x, y, right: (x + side).min(w), bottom: (y + side).min(h) }
    }
}

impl Tile {
    /// Pixels.
    pub(crate) fn len(&self) -> usize {
        (self.right - self.x) * (self.bottom - self.y)
    }
}

/// Where a permutation of `0..n` chosen by `key` puts `place`: a Feistel network on
/// the next even power of two, walked until it is back in range (Black and Rogaway 2002).
fn permuted(place: u64, n: u64, key: u64) -> u64 {
    let half = (64 - (n - 1).max(3).leading_zeros()).div_ceil(2);
    let low = (1u64 << half) - 1;
    let mut x = place;
    loop {
        for round in 0..4 {
            let (left, right) = (x >> half, x & low);
            x = right << half | (left ^ mixed(key ^ right ^ round << 60)) & low;
        }
        if x < n {
            return x;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_sees_every_tile_once() {
        for n in [1u64, 2, 3, 17, 64, 1000] {
            for key in [0, 1, 77] {
                let mut seen: Vec<u64> = (0..n).map(|i| permuted(i, n, key)).collect();
                if n == 1000 {
                    assert_ne!(seen[..20], (0..20).collect::<Vec<_>>()[..], "shuffled");
                }
                seen.sort_unstable();
                assert_eq!(seen, (0..n).collect::<Vec<_>>(), "{n} tiles, key {key}");
            }
        }
    }

    #[test]
    fn tiles_cover_every_pixel_of_every_view_once() {
        let tiles = Tiles { side: 8, starts: vec![0, 6, 7], sizes: vec![(20, 9), (3, 8)] };
        let mut seen = [vec![0; 180], vec![0; 24]];
        for n in 0..tiles.count() {
            let t = tiles.draw(5, n);
            assert_eq!(t.len(), (t.right - t.x) * (t.bottom - t.y));
            for (y, x) in (t.y..t.bottom).flat_map(|y| (t.x..t.right).map(move |x| (y, x))) {
                seen[t.view][y * tiles.sizes[t.view].0 + x] += 1;
            }
        }
        assert!(seen.iter().flatten().all(|n| *n == 1), "{seen:?}");
    }
}
