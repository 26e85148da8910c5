//! The two inner loops that all of a convolution's time goes into.
//!
//! Images are laid out as zero-padded planes read as one long row, so that a
//! kernel's tap is a constant offset and the loops know neither rows nor
//! borders: result `p` of channel `o` is `sum_s w[o][s] * data[offset[s] + p]`,
//! where a source `s` is a tap of an input channel. The few positions between
//! rows that are no pixel are computed and thrown away. This needs no im2col
//! copy, nine times the input's size for a 3 x 3 kernel.
//!
//! Each loop keeps a tile of sums in registers: several channels, whose weights
//! share each loaded pixel, by several vectors of positions (or by several
//! sources). Every sum's order is the same whatever the tile and the vectors.

#[cfg(target_arch = "x86_64")]
use super::lanes::x86::{Avx2, Avx512};
use super::lanes::{Isa, LANES, Lanes, Plain, sum};

/// Positions summed in lanes before lanes are added up; both operands of that
/// many stay in the first-level cache.
const CHUNK: usize = 1024;
/// Most channels, and sources, of a tile of [`correlate_weights`].
const WEIGHT_TILE: [usize; 2] = [8, 3];

/// Channels that one call of [`correlate`] takes at most.
pub(crate) fn tile_channels(isa: Isa) -> usize {
    match isa {
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => 8,
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => 6,
        Isa::Plain => 4,
    }
}

/// Planes, the offsets of all sources in them, and how many positions to go through.
#[derive(Clone, Copy)]
pub(crate) struct Sources<'a> {
    data: &'a [f32],
    offsets: &'a [usize],
    len: usize,
}

impl<'a> Sources<'a> {
    /// Panics unless `len`, a multiple of [`LANES`], positions from every offset lie inside `data`.
    pub(crate) fn new(data: &'a [f32], offsets: &'a [usize], len: usize) -> Self {
        let last = offsets.iter().max().copied().unwrap_or(0);
        assert!(len.is_multiple_of(LANES), "{len} positions are no multiple of {LANES}");
        assert!(last + len <= data.len(), "offset {last} and {len} positions leave {} numbers", data.len());
        Self { data, offsets, len }
    }
}

/// Correlates with the weights (`sources x channels`) of a tile of channels,
/// one a `bias`, into `out`, `channels x len`.
pub(crate) fn correlate(isa: Isa, s: Sources<'_>, weights: &[f32], bias: &[f32], out: &mut [f32]) {
    assert_eq!(weights.len(), s.offsets.len() * bias.len(), "weights of a tile");
    assert_eq!(out.len(), s.len * bias.len(), "results of a tile");
    let mut p = 0;
    while p < s.len {
        let vectors = (s.len - p) / LANES;
        // SAFETY: `Sources::new` proved all reads of `len` positions, the lengths of weights, bias and
        // results are as the tile needs them, `p` and the vectors done stay within `len`, and
        // `Isa` is only made for instructions that were found.
        p += LANES * unsafe { tile(isa, s, p, vectors, weights, bias, out.as_mut_ptr()) };
    }
}

/// One tile at position `p` with at most `vectors` vectors; returns how many it did.
///
/// # Safety
/// As [`correlate`] proves.
unsafe fn tile(isa: Isa, s: Sources<'_>, p: usize, vectors: usize, w: &[f32], bias: &[f32], out: *mut f32) -> usize {
    macro_rules! choose {
        ($step:ident: $(($rows:literal: $($v:literal)+))+) => {
            match bias.len() {
                // SAFETY: as the caller proves; the largest tile that fits is taken.
                $($rows => unsafe { $(if vectors >= $v { $step::<$rows, $v>(s, p, w, bias, out); return $v; })+ })+
                n => unreachable!("{isa:?} has no tile of {n} channels"),
            }
        };
    }
    match isa {
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => {
            choose!(step_avx512: (8: 3 2 1) (7: 3 2 1) (6: 4 2 1) (5: 4 2 1) (4: 6 4 2 1) (3: 8 4 2 1) (2: 8 4 2 1) (1: 8 4 2 1))
        }
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => choose!(step_avx2: (6: 1) (5: 1) (4: 1) (3: 1) (2: 2 1) (1: 3 2 1)),
        Isa::Plain => choose!(step_plain: (4: 1) (3: 1) (2: 1) (1: 1)),
    }
    0
}

/// `V` vectors of positions from `p` for `R` channels.
///
/// # Safety
/// As [`correlate`] proves; `L`'s instructions must be enabled.
#[inline(always)]
unsafe fn step<L: Lanes, const R: usize, const V: usize>(
    s: Sources<'_>,
    p: usize,
    weights: &[f32],
    bias: &[f32],
    out: *mut f32,
) {
    // SAFETY: offset + p + V * LANES <= data.len(), `weights` advances R for each source, `bias`
    // holds R and `out` R x len numbers, as the caller proves.
    unsafe {
        let mut sums = [[L::splat(0.0); V]; R];
        for r in 0..R {
            sums[r] = [L::splat(*bias.get_unchecked(r)); V];
        }
        let base = s.data.as_ptr().add(p);
        let mut weight = weights.as_ptr();
        for &offset in s.offsets {
            let from = base.add(offset);
            let mut x = [L::splat(0.0); V];
            for v in 0..V {
                x[v] = L::load(from.add(v * LANES));
            }
            for r in 0..R {
                let w = L::splat(*weight.add(r));
                for v in 0..V {
                    sums[r][v] = x[v].mul_add(w, sums[r][v]);
                }
            }
            weight = weight.add(R);
        }
        for r in 0..R {
            for v in 0..V {
                sums[r][v].store(out.add(r * s.len + p + v * LANES));
            }
        }
    }
}

/// Adds to `out` (`channels x sources`) the products of sources with the output
/// gradients `grads` (`channels x pitch`, of which `len` count), summed over positions.
pub(crate) fn correlate_weights(isa: Isa, s: Sources<'_>, grads: &[f32], pitch: usize, out: &mut [f32]) {
    let (channels, sources) = (grads.len() / pitch, s.offsets.len());
    assert!(channels * pitch == grads.len() && s.len <= pitch, "{} gradients in rows of {pitch}", grads.len());
    assert_eq!(out.len(), channels * sources, "weights");
    let [most_rows, most_columns] = weight_tile(isa);
    let tiles = channels.div_ceil(most_rows);
    for start in (0..s.len).step_by(CHUNK) {
        let len = CHUNK.min(s.len - start);
        for tile in 0..tiles {
            let (first, end) = (tile * channels / tiles, (tile + 1) * channels / tiles);
            let rows = end - first;
            for at in (0..sources).step_by(most_columns) {
                let columns = most_columns.min(sources - at);
                let mut sums = [[[0.0; LANES]; WEIGHT_TILE[1]]; WEIGHT_TILE[0]];
                let span = Span { s, grads: &grads[first * pitch..end * pitch], pitch, at, start, len };
                // SAFETY: `Sources::new` proved the reads of sources, the slice holds `rows` rows of `pitch`,
                // `start + len <= s.len <= pitch`, and `at + columns <= sources`.
                unsafe { weight_block(isa, [rows, columns], span, &mut sums) };
                for (r, row) in sums.iter().enumerate().take(rows) {
                    let to = &mut out[(first + r) * sources + at..][..columns];
                    to.iter_mut().zip(row).for_each(|(o, v)| *o += sum(v));
                }
            }
        }
    }
}

fn weight_tile(isa: Isa) -> [usize; 2] {
    match isa {
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => WEIGHT_TILE,
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => [3, 2],
        Isa::Plain => [2, 2],
    }
}

/// What one tile of [`correlate_weights`] goes through.
#[derive(Clone, Copy)]
struct Span<'a> {
    s: Sources<'a>,
    grads: &'a [f32],
    pitch: usize,
    /// First source.
    at: usize,
    start: usize,
    len: usize,
}

type Sums = [[[f32; LANES]; WEIGHT_TILE[1]]; WEIGHT_TILE[0]];

/// # Safety
/// As [`correlate_weights`] proves.
unsafe fn weight_block(isa: Isa, [rows, columns]: [usize; 2], span: Span<'_>, sums: &mut Sums) {
    macro_rules! choose {
        ($step:ident: $($rows:literal)+, $columns:tt) => {
            match rows {
                $($rows => choose!(@ $step, $rows, $columns),)+
                n => unreachable!("{isa:?} has no tile of {n} channels"),
            }
        };
        (@ $step:ident, $rows:literal, [$($columns:literal)+]) => {
            match columns {
                // SAFETY: as the caller proves.
                $($columns => unsafe { $step::<$rows, $columns>(span, sums) },)+
                n => unreachable!("{isa:?} has no tile of {n} sources"),
            }
        };
    }
    match isa {
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => choose!(weights_avx512: 1 2 3 4 5 6 7 8, [1 2 3]),
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => choose!(weights_avx2: 1 2 3, [1 2]),
        Isa::Plain => choose!(weights_plain: 1 2, [1 2]),
    }
}

/// `R` channels and `S` sources over a span of positions.
///
/// # Safety
/// As [`correlate_weights`] proves; `L`'s instructions must be enabled.
#[inline(always)]
unsafe fn weights<L: Lanes, const R: usize, const S: usize>(span: Span<'_>, out: &mut Sums) {
    // SAFETY: every source has `start + len` positions, `grads` R rows of `pitch`, and `out` is larger than R x S.
    unsafe {
        let mut sums = [[L::splat(0.0); S]; R];
        let data = span.s.data.as_ptr().add(span.start);
        let mut from = [data; S];
        for k in 0..S {
            from[k] = data.add(*span.s.offsets.get_unchecked(span.at + k));
        }
        let grads = span.grads.as_ptr().add(span.start);
        let mut p = 0;
        while p < span.len {
            let mut x = [L::splat(0.0); S];
            for k in 0..S {
                x[k] = L::load(from[k].add(p));
            }
            for r in 0..R {
                let g = L::load(grads.add(r * span.pitch + p));
                for k in 0..S {
                    sums[r][k] = g.mul_add(x[k], sums[r][k]);
                }
            }
            p += LANES;
        }
        for r in 0..R {
            for k in 0..S {
                sums[r][k].store(out[r][k].as_mut_ptr());
            }
        }
    }
}

/// The loops, once for each set of instructions.
macro_rules! compiled {
    ($step:ident, $weights:ident, $lanes:ty $(, $arch:meta, $features:literal)?) => {
        /// # Safety
        /// As [`step`]; the instructions must be there.
        $(#[cfg($arch)] #[target_feature(enable = $features)])?
        unsafe fn $step<const R: usize, const V: usize>(s: Sources<'_>, p: usize, w: &[f32], bias: &[f32], out: *mut f32) {
            // SAFETY: as the caller proves; the instructions are enabled here.
            unsafe { step::<$lanes, R, V>(s, p, w, bias, out) }
        }

        /// # Safety
        /// As [`weights`]; the instructions must be there.
        $(#[cfg($arch)] #[target_feature(enable = $features)])?
        unsafe fn $weights<const R: usize, const S: usize>(span: Span<'_>, sums: &mut Sums) {
            // SAFETY: as the caller proves; the instructions are enabled here.
            unsafe { weights::<$lanes, R, S>(span, sums) }
        }
    };
}

compiled!(step_avx512, weights_avx512, Avx512, target_arch = "x86_64", "avx512f");
compiled!(step_avx2, weights_avx2, Avx2, target_arch = "x86_64", "avx2,fma");
compiled!(step_plain, weights_plain, Plain);
