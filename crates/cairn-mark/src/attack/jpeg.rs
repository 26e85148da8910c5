//! A baseline JPEG written and read back (ITU-T T.81; JFIF's colours), without
//! the file: entropy coding loses nothing.
//!
//! Tables, their scaling with quality and the resampling of colours are those of
//! libjpeg (Independent JPEG Group), with which nearly everybody's pictures are
//! made. Rounding has no gradient: a coefficient passes as much of it as there is
//! chance that a nudge tips its rounding, all where half a step or more is in it.

use cairn_scene::Picture;

/// Side of a block.
const N: usize = 8;

/// Quantisation of lightness, row-major, at quality 50 (T.81, table K.1).
#[rustfmt::skip]
const LIGHTNESS: [u16; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61,
    12, 12, 14, 19, 26, 58, 60, 55,
    14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62,
    18, 22, 37, 56, 68, 109, 103, 77,
    24, 35, 55, 64, 81, 104, 113, 92,
    49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];

/// Quantisation of colour at quality 50 (T.81, table K.2).
#[rustfmt::skip]
const COLOUR: [u16; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99,
    18, 21, 26, 66, 99, 99, 99, 99,
    24, 26, 56, 99, 99, 99, 99, 99,
    47, 66, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
];

/// Red, green and blue to lightness, blue and red difference (JFIF 1.02), without the offset of 128.
const TO_YCC: [[f32; 3]; 3] =
    [[0.299, 0.587, 0.114], [-0.168_735_9, -0.331_264_1, 0.5], [0.5, -0.418_687_6, -0.081_312_4]];
/// And back.
const TO_RGB: [[f32; 3]; 3] = [[1.0, 0.0, 1.402], [1.0, -0.344_136_3, -0.714_136_3], [1.0, 1.772, 0.0]];

/// What of a gradient comes through one compression.
pub(super) struct Passed {
    size: [usize; 2],
    /// Of each coefficient, block by block, the share that passes; lightness, then the two colours.
    shares: [Vec<f32>; 3],
}

/// One channel in whole blocks.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

/// The picture after a compression at `quality`, and what of a gradient passes.
pub(super) fn round_trip(picture: &Picture, quality: u8) -> (Vec<f32>, Passed) {
    let size = [picture.width(), picture.height()];
    let cosines = cosines();
    let eight: Vec<f32> = picture.rgb().iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round()).collect();
    let [y, b, r] = split(&eight, size, &TO_YCC).map(|mut plane| {
        plane.values.iter_mut().for_each(|v| *v = v.round());
        plane
    });
    let code = |mut plane: Plane, table: &[u16; 64], middle: f32| {
        let steps = steps(table, quality);
        let mut shares = vec![0.0; plane.values.len()];
        plane.values.iter_mut().for_each(|v| *v -= middle);
        let mut of = shares.chunks_exact_mut(N * N);
        plane.each_block(|block| {
            transform(block, &cosines, false);
            for ((v, step), share) in block.iter_mut().zip(steps).zip(of.next().into_iter().flatten()) {
                let whole = *v / step;
                *share = (2.0 * whole).powi(2).min(1.0);
                *v = whole.round() * step;
            }
            transform(block, &cosines, true);
        });
        // The decoder rounds to eight bits.
        plane.values.iter_mut().for_each(|v| *v = (*v + middle).round().clamp(middle - 128.0, middle + 127.0));
        (plane, shares)
    };
    let (y, of_y) = code(y, &LIGHTNESS, 128.0);
    let (b, of_b) = code(halved(&b, size), &COLOUR, 0.0);
    let (r, of_r) = code(halved(&r, size), &COLOUR, 0.0);
    let round = |mut plane: Plane| {
        plane.values.iter_mut().for_each(|v| *v = v.round());
        plane
    };
    let planes = [y, round(doubled(&b, size)), round(doubled(&r, size))];
    let rgb = joined(&planes, size, &TO_RGB);
    let rgb = rgb.iter().map(|v| v.round().clamp(0.0, 255.0) / 255.0).collect();
    (rgb, Passed { size, shares: [of_y, of_b, of_r] })
}

impl Passed {
    /// d(loss)/d(picture) from d(loss)/d(read back): the transposes of every linear part, and the shares.
    pub(super) fn back(&self, slope: &[f32]) -> Vec<f32> {
        let cosines = cosines();
        // Transposed matrices take the roles of one another.
        let [y, b, r] = split(slope, self.size, &transposed(&TO_RGB));
        let through = |mut plane: Plane, shares: &[f32]| {
            let mut of = shares.chunks_exact(N * N);
            plane.each_block(|block| {
                transform(block, &cosines, false);
                for (v, share) in block.iter_mut().zip(of.next().into_iter().flatten()) {
                    *v *= share;
                }
                transform(block, &cosines, true);
            });
            plane
        };
        let colour = |plane: &Plane, shares: &[f32]| spread(&through(gathered(plane, self.size), shares));
        let planes = [through(y, &self.shares[0]), colour(&b, &self.shares[1]), colour(&r, &self.shares[2])];
        joined(&planes, self.size, &transposed(&TO_YCC))
    }
}

/// libjpeg's steps at `quality`: table entries scaled and held in 1..=255.
fn steps(table: &[u16; 64], quality: u8) -> [f32; 64] {
    let quality = u32::from(quality.clamp(1, 100));
    let scale = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    table.map(|v| ((u32::from(v) * scale + 50) / 100).clamp(1, 255) as f32)
}

/// The orthonormal DCT-II's rows.
fn cosines() -> [[f32; N]; N] {
    let mut rows = [[0.0; N]; N];
    for (k, row) in rows.iter_mut().enumerate() {
        let scale = if k == 0 { (1.0 / N as f64).sqrt() } else { (2.0 / N as f64).sqrt() };
        for (x, v) in row.iter_mut().enumerate() {
            *v = (scale * (std::f64::consts::PI * (2 * x + 1) as f64 * k as f64 / (2 * N) as f64).cos()) as f32;
        }
    }
    rows
}

/// A block's coefficients, row-major, or the block again (`back`).
fn transform(block: &mut [f32; N * N], cosines: &[[f32; N]; N], back: bool) {
    let at = |k: usize, x: usize| if back { cosines[x][k] } else { cosines[k][x] };
    let mut half = [0.0f32; N * N];
    for k in 0..N {
        for x in 0..N {
            let c = at(k, x);
            for i in 0..N {
                half[k * N + i] += c * block[x * N + i];
            }
        }
    }
    *block = [0.0; N * N];
    for (out, row) in block.chunks_exact_mut(N).zip(half.chunks_exact(N)) {
        for (k, out) in out.iter_mut().enumerate() {
            *out = (0..N).map(|x| at(k, x) * row[x]).sum();
        }
    }
}

impl Plane {
    fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![0.0; width * height] }
    }

    /// Every block in turn, row by row.
    fn each_block(&mut self, mut f: impl FnMut(&mut [f32; N * N])) {
        let width = self.width;
        for band in self.values.chunks_exact_mut(width * N) {
            for left in (0..width).step_by(N) {
                let mut block = [0.0; N * N];
                for (line, row) in block.chunks_exact_mut(N).zip(band.chunks_exact(width)) {
                    line.copy_from_slice(&row[left..left + N]);
                }
                f(&mut block);
                for (line, row) in block.chunks_exact(N).zip(band.chunks_exact_mut(width)) {
                    row[left..left + N].copy_from_slice(line);
                }
            }
        }
    }
}

/// Interleaved pixels through a matrix to three planes of whole blocks of 16, the border repeated.
fn split(rgb: &[f32], [w, h]: [usize; 2], matrix: &[[f32; 3]; 3]) -> [Plane; 3] {
    let (width, height) = (w.next_multiple_of(2 * N), h.next_multiple_of(2 * N));
    let mut planes = [0; 3].map(|_| Plane::zeros(width, height));
    for y in 0..height {
        for x in 0..width {
            let pixel = &rgb[(y.min(h - 1) * w + x.min(w - 1)) * 3..][..3];
            for (plane, row) in planes.iter_mut().zip(matrix) {
                plane.values[y * width + x] = row[0] * pixel[0] + row[1] * pixel[1] + row[2] * pixel[2];
            }
        }
    }
    planes
}

/// Three planes through a matrix to interleaved pixels; what was added at the border is cut off.
fn joined(planes: &[Plane; 3], [w, h]: [usize; 2], matrix: &[[f32; 3]; 3]) -> Vec<f32> {
    let mut rgb = Vec::with_capacity(w * h * 3);
    for y in 0..h {
        for x in 0..w {
            let v = [0, 1, 2].map(|k: usize| planes[k].values[y * planes[k].width + x]);
            rgb.extend(matrix.iter().map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2]));
        }
    }
    rgb
}

fn transposed(m: &[[f32; 3]; 3]) -> [[f32; 3]; 3] {
    [0, 1, 2].map(|i: usize| [m[0][i], m[1][i], m[2][i]])
}

/// Means of squares of four, rounded as libjpeg does (a half up and down by turns
/// along a row); below the picture's last row that one is repeated.
fn halved(plane: &Plane, [_, h]: [usize; 2]) -> Plane {
    let mut small = Plane::zeros(plane.width / 2, plane.height / 2);
    for (at, v) in small.values.iter_mut().enumerate() {
        let (x, y) = (at % small.width, (at / small.width).min(h.div_ceil(2) - 1));
        let from = 2 * y * plane.width + 2 * x;
        let of = [from, from + 1, from + plane.width, from + plane.width + 1];
        let up = if x.is_multiple_of(2) { 1.0 } else { 2.0 };
        *v = ((of.iter().map(|i| plane.values[*i]).sum::<f32>() + up) / 4.0).floor();
    }
    small
}

/// The transpose of [`halved`], without its rounding and what it repeats.
fn spread(small: &Plane) -> Plane {
    let mut plane = Plane::zeros(small.width * 2, small.height * 2);
    let width = plane.width;
    for (at, v) in plane.values.iter_mut().enumerate() {
        *v = small.values[at / width / 2 * small.width + at % width / 2] / 4.0;
    }
    plane
}

/// Colour of a picture of `size` at its full resolution again: three quarters of the
/// nearest and one of the next, each way (libjpeg's "fancy" upsampling).
fn doubled(small: &Plane, size: [usize; 2]) -> Plane {
    let mut plane = Plane::zeros(small.width * 2, small.height * 2);
    each_doubled(small.width, size, |to, from, weight| plane.values[to] += weight * small.values[from]);
    plane
}

/// The transpose of [`doubled`].
fn gathered(plane: &Plane, size: [usize; 2]) -> Plane {
    let mut small = Plane::zeros(plane.width / 2, plane.height / 2);
    each_doubled(small.width, size, |to, from, weight| small.values[from] += weight * plane.values[to]);
    small
}

/// Every pixel of a picture, the colours it is made of, in rows of `width`, and their shares.
fn each_doubled(width: usize, [w, h]: [usize; 2], mut f: impl FnMut(usize, usize, f32)) {
    let near = |at: usize, len: usize| {
        let next =
            if at.is_multiple_of(2) { (at / 2).saturating_sub(1) } else { (at / 2 + 1).min(len.div_ceil(2) - 1) };
        [(at / 2, 0.75), (next, 0.25)]
    };
    for y in 0..h {
        for x in 0..w {
            for (v, down) in near(y, h) {
                for (u, across) in near(x, w) {
                    f(y * 2 * width + x, v * width + u, down * across);
                }
            }
        }
    }
}
