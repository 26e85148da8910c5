//! The weights' gradient where there are many output channels.
//!
//! `kernel::correlate_weights` keeps positions in lanes and adds lanes up at the
//! end, which costs as much as a hundred positions or more. With sixteen or more output channels
//! these can be the lanes instead: the gradients of a position's channels lie
//! side by side, and each source's pixel is spread over them. Nothing has to be
//! added up, and no sum is spent on positions between rows.

#[cfg(target_arch = "x86_64")]
use super::lanes::x86::{Avx2, Avx512};
use super::lanes::{Isa, LANES, Lanes, Plain};

/// Numbers of gradients that are gone through before the next sources: a part of the first-level cache.
const GROUP: usize = 8192;
/// Positions summed at most before a sum goes to memory.
const POSITIONS: usize = 512;

/// Rows of positions: `images x rows` rows of `columns`, of which the sources'
/// are `pitch` apart and images `block` apart, and the gradients' follow each other.
#[derive(Clone, Copy)]
pub(crate) struct Rows {
    pub(crate) images: usize,
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) pitch: usize,
    pub(crate) block: usize,
}

impl Rows {
    /// Offset of a row in a source's plane.
    fn offset(&self, row: usize) -> usize {
        row / self.rows * self.block + row % self.rows * self.pitch
    }

    pub(crate) fn positions(&self) -> usize {
        self.images * self.rows * self.columns
    }
}

/// Adds to `out` (`sources x lanes`) the products of `data` at `offsets` with
/// `grads` (`positions x lanes`), summed over positions; `lanes` a multiple of [`LANES`].
pub(crate) fn products(
    isa: Isa,
    data: &[f32],
    offsets: &[usize],
    rows: Rows,
    grads: &[f32],
    lanes: usize,
    out: &mut [f32],
) {
    let all = rows.images * rows.rows;
    let last = offsets.iter().max().copied().unwrap_or(0) + rows.offset(all - 1) + rows.columns;
    assert!(last <= data.len(), "sources end at {last} of {} numbers", data.len());
    assert!(lanes.is_multiple_of(LANES) && grads.len() == rows.positions() * lanes, "{} gradients", grads.len());
    assert_eq!(out.len(), offsets.len() * lanes, "weights");
    let [most_sources, most_vectors] = most(isa);
    let (tiles, vectors) = (offsets.len().div_ceil(most_sources), lanes / LANES);
    let stacks = vectors.div_ceil(most_vectors);
    let group = ((GROUP / lanes).clamp(64, POSITIONS) / rows.columns).max(1);
    for from in (0..all).step_by(group) {
        let to = all.min(from + group);
        for stack in 0..stacks {
            let [v, end] = [stack, stack + 1].map(|i| i * vectors / stacks);
            for tile in 0..tiles {
                let [s, s_end] = [tile, tile + 1].map(|i| i * offsets.len() / tiles);
                let span =
                    Span { data, offsets: &offsets[s..s_end], rows, from, to, grads: &grads[v * LANES..], lanes };
                // SAFETY: the assertions prove all reads: rows below `all` of every source, and lanes
                // `v * LANES` to `end * LANES` of as many positions; and the writes of sources s to s_end.
                unsafe { block(isa, [s_end - s, end - v], span, out[s * lanes + v * LANES..].as_mut_ptr()) };
            }
        }
    }
}

/// Sources and vectors of a tile at most.
fn most(isa: Isa) -> [usize; 2] {
    match isa {
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => [8, 3],
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => [6, 1],
        Isa::Plain => [4, 1],
    }
}

#[derive(Clone, Copy)]
struct Span<'a> {
    data: &'a [f32],
    offsets: &'a [usize],
    rows: Rows,
    from: usize,
    to: usize,
    grads: &'a [f32],
    lanes: usize,
}

/// # Safety
/// As [`products`] proves.
unsafe fn block(isa: Isa, [sources, vectors]: [usize; 2], span: Span<'_>, out: *mut f32) {
    macro_rules! choose {
        ($step:ident: $($sources:literal)+, $vectors:tt) => {
            match sources {
                $($sources => choose!(@ $step, $sources, $vectors),)+
                n => unreachable!("{isa:?} has no tile of {n} sources"),
            }
        };
        (@ $step:ident, $sources:literal, [$($vectors:literal)+]) => {
            match vectors {
                // SAFETY: as the caller proves.
                $($vectors => unsafe { $step::<$sources, $vectors>(span, out) },)+
                n => unreachable!("{isa:?} has no tile of {n} vectors"),
            }
        };
    }
    match isa {
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => choose!(outer_avx512: 1 2 3 4 5 6 7 8, [1 2 3]),
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => choose!(outer_avx2: 1 2 3 4 5 6, [1]),
        Isa::Plain => choose!(outer_plain: 1 2 3 4, [1]),
    }
}

/// `S` sources by `V` vectors of output channels over some rows.
///
/// # Safety
/// As [`products`] proves; `L`'s instructions must be enabled.
#[inline(always)]
unsafe fn outer<L: Lanes, const S: usize, const V: usize>(span: Span<'_>, out: *mut f32) {
    // SAFETY: as the caller proves.
    unsafe {
        let mut sums = [[L::splat(0.0); V]; S];
        let mut grads = span.grads.as_ptr().add(span.from * span.rows.columns * span.lanes);
        for row in span.from..span.to {
            let data = span.data.as_ptr().add(span.rows.offset(row));
            let mut from = [data; S];
            for k in 0..S {
                from[k] = data.add(*span.offsets.get_unchecked(k));
            }
            for j in 0..span.rows.columns {
                let mut g = [L::splat(0.0); V];
                for v in 0..V {
                    g[v] = L::load(grads.add(v * LANES));
                }
                for k in 0..S {
                    let x = L::splat(*from[k].add(j));
                    for v in 0..V {
                        sums[k][v] = g[v].mul_add(x, sums[k][v]);
                    }
                }
                grads = grads.add(span.lanes);
            }
        }
        for k in 0..S {
            for v in 0..V {
                let to = out.add(k * span.lanes + v * LANES);
                L::load(to).mul_add(L::splat(1.0), sums[k][v]).store(to);
            }
        }
    }
}

/// The loop, once for each set of instructions.
macro_rules! compiled {
    ($outer:ident, $lanes:ty $(, $arch:meta, $features:literal)?) => {
        /// # Safety
        /// As [`outer`]; the instructions must be there.
        $(#[cfg($arch)] #[target_feature(enable = $features)])?
        unsafe fn $outer<const S: usize, const V: usize>(span: Span<'_>, out: *mut f32) {
            // SAFETY: as the caller proves; the instructions are enabled here.
            unsafe { outer::<$lanes, S, V>(span, out) }
        }
    };
}

compiled!(outer_avx512, Avx512, target_arch = "x86_64", "avx512f");
compiled!(outer_avx2, Avx2, target_arch = "x86_64", "avx2,fma");
compiled!(outer_plain, Plain);

/// Writes `rows` (channels, equally long) side by side into `to`, one position
/// every `lanes` numbers, and zeros into the lanes after them.
pub(crate) fn side_by_side(rows: &[&[f32]], lanes: usize, to: &mut [f32]) {
    let len = rows.first().map_or(0, |row| row.len());
    let mut fours = rows.chunks_exact(4);
    let mut lane = 0;
    for four in &mut fours {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| &four[i][..len]);
        for j in 0..len {
            to[j * lanes + lane..][..4].copy_from_slice(&[a[j], b[j], c[j], d[j]]);
        }
        lane += 4;
    }
    for row in fours.remainder() {
        for (j, v) in row.iter().enumerate() {
            to[j * lanes + lane] = *v;
        }
        lane += 1;
    }
    if lane < lanes {
        to.chunks_exact_mut(lanes).take(len).for_each(|position| position[lane..].fill(0.0));
    }
}
