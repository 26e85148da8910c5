//! The two inner loops that all of a convolution's time goes into.
//!
//! Images are laid out as zero-padded planes read as one long row, so that a
//! kernel's tap is a constant offset and the loops know neither rows nor
//! borders: output `p` of channel `o` is `sum_c sum_t w[o][c][t] *
//! plane[c][offset[t] + p]`. The few positions between rows that are no pixel
//! are computed and thrown away. This needs no im2col copy, nine times the
//! input's size for a 3 x 3 kernel.

use super::lanes::{LANES, Lanes};

/// Output channels taken together: their weights share each loaded pixel.
pub(crate) const TILE_CHANNELS: usize = 4;
/// Vectors of neighbouring outputs taken together; 4 x 3 sums, three pixels and
/// one weight fill AVX2's sixteen registers.
const TILE_VECTORS: usize = 3;
/// Outputs of one step of [`correlate`]; results come in multiples of it.
pub(crate) const TILE: usize = TILE_VECTORS * LANES;
/// Zeros that must follow each channel's planes: reads run over by less than this.
pub(crate) const SLACK: usize = 32;
/// Taps taken together by [`correlate_weights`].
const TILE_TAPS: usize = 3;
/// Positions summed before moving to the next taps, so that both operands stay
/// in the first-level cache.
const CHUNK: usize = 1024;

/// Zero-padded planes of one image, `channels x plane_len`, each channel
/// followed by at least [`SLACK`] zeros that belong to its `plane_len`.
#[derive(Clone, Copy)]
pub(crate) struct Planes<'a> {
    /// The numbers.
    pub(crate) data: &'a [f32],
    /// Channels.
    pub(crate) channels: usize,
    /// Numbers a channel, slack included.
    pub(crate) plane_len: usize,
}

impl Planes<'_> {
    /// Panics unless `len` positions from every tap lie inside a channel.
    fn check(&self, taps: &[usize], len: usize) {
        let last = taps.iter().max().copied().unwrap_or(0);
        assert!(last + len <= self.plane_len, "tap {last} and {len} positions leave a plane of {}", self.plane_len);
        assert!(self.channels * self.plane_len <= self.data.len(), "planes are shorter than they say");
    }
}

/// Correlates `planes` with the weights of up to [`TILE_CHANNELS`] output channels.
///
/// `weights` is `channels x taps x tile`, `bias` has `tile` numbers, `out` is
/// `tile x out_len` with `out_len` a multiple of [`TILE`].
pub(crate) fn correlate(planes: Planes<'_>, taps: &[usize], weights: &[f32], bias: &[f32], out: &mut [f32]) {
    match bias.len() {
        1 => correlate_tile::<1>(planes, taps, weights, bias, out),
        2 => correlate_tile::<2>(planes, taps, weights, bias, out),
        3 => correlate_tile::<3>(planes, taps, weights, bias, out),
        4 => correlate_tile::<4>(planes, taps, weights, bias, out),
        n => unreachable!("a tile has 1 to {TILE_CHANNELS} channels, got {n}"),
    }
}

fn correlate_tile<const C: usize>(planes: Planes<'_>, taps: &[usize], weights: &[f32], bias: &[f32], out: &mut [f32]) {
    let out_len = out.len() / C;
    assert!(out_len.is_multiple_of(TILE), "{out_len} outputs are no multiple of {TILE}");
    assert_eq!(weights.len(), planes.channels * taps.len() * C, "weights of a tile");
    planes.check(taps, out_len);
    for p in (0..out_len).step_by(TILE) {
        let mut sums: [[Lanes; TILE_VECTORS]; C] = std::array::from_fn(|c| [Lanes::splat(bias[c]); TILE_VECTORS]);
        let mut weight = weights.as_ptr();
        for channel in 0..planes.channels {
            // SAFETY: `check` proved `channel * plane_len + tap + out_len` to lie inside `data`,
            // and `p + TILE <= out_len`; `weight` advances `C` for each of channels x taps.
            unsafe {
                let base = planes.data.as_ptr().add(channel * planes.plane_len + p);
                for &tap in taps {
                    let pixels: [Lanes; TILE_VECTORS] =
                        std::array::from_fn(|v| Lanes::load(base.wrapping_add(tap + v * LANES)));
                    for (c, sum) in sums.iter_mut().enumerate() {
                        let w = Lanes::splat(*weight.wrapping_add(c));
                        for (s, x) in sum.iter_mut().zip(pixels) {
                            *s = x.mul_add(w, *s);
                        }
                    }
                    weight = weight.wrapping_add(C);
                }
            }
        }
        for (c, sum) in sums.iter().enumerate() {
            for (v, s) in sum.iter().enumerate() {
                // SAFETY: `c < C`, `p + TILE <= out_len` and `out` holds `C * out_len` numbers.
                unsafe { s.store(out.as_mut_ptr().add(c * out_len + p + v * LANES)) };
            }
        }
    }
}

/// Adds to `out` (`tile x channels x taps`) the products of `planes` with the
/// output gradients `grads` (`tile x len`, zero where no pixel is, `len` a
/// multiple of [`LANES`]), summed over positions: the weights' gradient.
pub(crate) fn correlate_weights(planes: Planes<'_>, taps: &[usize], grads: &[f32], len: usize, out: &mut [f32]) {
    let tile = grads.len() / len;
    assert!(len.is_multiple_of(LANES) && tile * len == grads.len(), "{len} positions, {} gradients", grads.len());
    assert_eq!(out.len(), tile * planes.channels * taps.len(), "weights of a tile");
    planes.check(taps, len);
    for start in (0..len).step_by(CHUNK) {
        let span = (start, CHUNK.min(len - start));
        for channel in 0..planes.channels {
            for (group, few) in taps.chunks(TILE_TAPS).enumerate() {
                let mut sums = [[0.0_f32; TILE_TAPS]; TILE_CHANNELS];
                match few.len() {
                    1 => weights_rows::<1>(planes, channel, few, grads, (len, tile), span, &mut sums),
                    2 => weights_rows::<2>(planes, channel, few, grads, (len, tile), span, &mut sums),
                    _ => weights_rows::<3>(planes, channel, few, grads, (len, tile), span, &mut sums),
                }
                for (c, row) in sums.iter().enumerate().take(tile) {
                    for (t, s) in row.iter().enumerate().take(few.len()) {
                        out[(c * planes.channels + channel) * taps.len() + group * TILE_TAPS + t] += s;
                    }
                }
            }
        }
    }
}

/// One chunk, one input channel, `T` taps, all channels of the tile.
fn weights_rows<const T: usize>(
    planes: Planes<'_>,
    channel: usize,
    taps: &[usize],
    grads: &[f32],
    (len, tile): (usize, usize),
    span: (usize, usize),
    sums: &mut [[f32; TILE_TAPS]; TILE_CHANNELS],
) {
    match tile {
        1 => weights_block::<T, 1>(planes, channel, taps, grads, len, span, sums),
        2 => weights_block::<T, 2>(planes, channel, taps, grads, len, span, sums),
        3 => weights_block::<T, 3>(planes, channel, taps, grads, len, span, sums),
        4 => weights_block::<T, 4>(planes, channel, taps, grads, len, span, sums),
        n => unreachable!("a tile has 1 to {TILE_CHANNELS} channels, got {n}"),
    }
}

fn weights_block<const T: usize, const C: usize>(
    planes: Planes<'_>,
    channel: usize,
    taps: &[usize],
    grads: &[f32],
    len: usize,
    (start, count): (usize, usize),
    out: &mut [[f32; TILE_TAPS]; TILE_CHANNELS],
) {
    let mut sums = [[Lanes::splat(0.0); T]; C];
    let data = planes.data.as_ptr().wrapping_add(channel * planes.plane_len);
    let pixel_rows: [*const f32; T] = std::array::from_fn(|t| data.wrapping_add(taps[t]));
    let grad_rows: [*const f32; C] = std::array::from_fn(|c| grads.as_ptr().wrapping_add(c * len));
    let mut p = start;
    while p < start + count {
        // SAFETY: the caller checked that every tap has `len` positions inside its channel and
        // that `grads` holds `C * len` numbers; `p + LANES <= len` as both are multiples of it.
        unsafe {
            let pixels: [Lanes; T] = std::array::from_fn(|t| Lanes::load(pixel_rows[t].wrapping_add(p)));
            for (c, sum) in sums.iter_mut().enumerate() {
                let grad = Lanes::load(grad_rows[c].wrapping_add(p));
                for (s, x) in sum.iter_mut().zip(pixels) {
                    *s = grad.mul_add(x, *s);
                }
            }
        }
        p += LANES;
    }
    for (row, sum) in out.iter_mut().zip(&sums) {
        for (o, s) in row.iter_mut().zip(sum) {
            *o = s.sum();
        }
    }
}
