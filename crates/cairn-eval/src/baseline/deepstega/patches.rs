//! What DeepStega's networks are trained on: patches of photographs, patches to hide
//! in them, and the noise that files and renders put over both.

use super::planes::to_tensor;
use cairn_scene::Picture;
use candle_core::Tensor;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Noise on what is revealed from, uniform to either side: without it the networks hide
/// in the lowest bits, which no file keeps (section 3 of the paper adds some as well).
const NOISE: f32 = 1.5 / 255.0;
/// What is hidden has fewer pixels than photographs: parts of photographs that are
/// hidden are enlarged by up to two to this power.
const ZOOMS: u32 = 3;

/// Photographs, and pictures to hide at the photographs' size.
pub(super) struct Patches {
    photographs: Vec<Picture>,
    hidden: Vec<Picture>,
    side: usize,
}

impl Patches {
    pub(super) fn new(photographs: Vec<Picture>, hidden: &[Picture], side: usize) -> anyhow::Result<Self> {
        let Some(first) = photographs.first().filter(|_| !hidden.is_empty()) else {
            anyhow::bail!("DeepStega needs a photograph and a picture to hide; bring both");
        };
        if let Some(small) = photographs.iter().find(|p| p.width().min(p.height()) < side) {
            let (w, h) = (small.width(), small.height());
            let why = format!("a photograph of {w} x {h} px has no patch of {side} px; lower deepstega.patch_px");
            anyhow::bail!(why);
        }
        let (w, h) = (first.width(), first.height());
        let clean = |p: Picture| p.clamped();
        let hidden = hidden.iter().map(|p| clean(p.resized(w, h))).collect();
        Ok(Self { photographs: photographs.into_iter().map(clean).collect(), hidden, side })
    }

    /// `batch` patches of photographs, as many to hide in them, and noise, N x 3 x side x side each.
    pub(super) fn draw(&self, batch: usize, rng: &mut ChaCha8Rng) -> anyhow::Result<[Tensor; 3]> {
        let (mut covers, mut secrets, mut noise) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..batch {
            covers.push(self.cover(rng));
            secrets.push(self.secret(rng));
            noise.push((0..self.side * self.side * 3).map(|_| rng.random_range(-NOISE..NOISE)).collect());
        }
        Ok([to_tensor(&covers, self.side)?, to_tensor(&secrets, self.side)?, to_tensor(&noise, self.side)?])
    }

    /// A patch of a photograph, every fourth mixed with another.
    fn cover(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let mut patch = self.part(&self.photographs, self.side, rng);
        if rng.random_range(0..4) == 0 {
            let share = rng.random_range(0.2f32..0.8);
            let other = self.part(&self.photographs, self.side, rng);
            patch.iter_mut().zip(other).for_each(|(v, o)| *v += share * (o - *v));
        }
        patch
    }

    /// As often a patch of what is to be hidden as an enlarged part of a photograph, in
    /// exchanged colours: what is revealed must come out of the picture.
    fn secret(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        if rng.random_range(0..2) == 0 {
            return self.part(&self.hidden, self.side, rng);
        }
        let small = (self.side >> rng.random_range(0..=ZOOMS)).max(1);
        let part = self.part(&self.photographs, small, rng);
        let part = Picture::new(small, small, part).expect("three numbers a pixel");
        let mut patch = part.resized(self.side, self.side).into_rgb();
        let shift = rng.random_range(0..3);
        patch.chunks_exact_mut(3).for_each(|pixel| pixel.rotate_left(shift));
        patch
    }

    /// A square of one of `pictures`, as often mirrored as not.
    fn part(&self, pictures: &[Picture], side: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let picture = &pictures[rng.random_range(0..pictures.len())];
        let (x, y) = (rng.random_range(0..=picture.width() - side), rng.random_range(0..=picture.height() - side));
        let mirrored = rng.random_range(0..2) == 0;
        let column = |i: usize| x + if mirrored { side - 1 - i } else { i };
        (0..side * side).flat_map(|i| picture.pixel(column(i % side), y + i / side)).collect()
    }
}
