//! Pictures that carry no mark: base renders, photographs, and pictures of
//! anything else. Without them a classifier says yes to everything, and a
//! detector recognises the scene and not the mark.

use crate::distort::Blur;
use cairn_capture::{AreaFilter, Picture};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Share of the pictures from the bank that are shown as they are.
const AS_IT_IS: f64 = 0.4;

/// A bank of unmarked pictures at the networks' size.
pub(crate) struct Negatives {
    side: usize,
    /// Each as it is, and as it is read from a JPEG; `side x side x 3`.
    pictures: Vec<[Vec<f32>; 2]>,
}

impl Negatives {
    pub(crate) fn new(side: usize, pictures: impl Iterator<Item = [Vec<f32>; 2]>) -> Self {
        Self { side, pictures: pictures.collect() }
    }

    /// One of the bank as it is, or made into a picture of something else: cropped,
    /// mirrored, in other colours, sharpened, with coloured edges, two laid over one another,
    /// or plain noise.
    /// A project has photographs of its landmark only, and the world has others: what
    /// their colours are like must not be what tells a mark.
    /// With `jpegs`, half come as JPEGs.
    pub(crate) fn draw(&self, jpegs: bool, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let n = self.side * self.side * 3;
        if self.pictures.is_empty() || rng.random_range(0..12) == 0 {
            let (level, depth) = (rng.random_range(0.0f32..1.0), rng.random_range(0.0f32..0.5));
            return (0..n).map(|_| (level + depth * rng.random_range(-1.0f32..1.0)).clamp(0.0, 1.0)).collect();
        }
        let [plain, jpeg] = &self.pictures[rng.random_range(0..self.pictures.len())];
        let mut picture = if jpegs && rng.random_bool(0.5) { jpeg.clone() } else { plain.clone() };
        if rng.random_bool(AS_IT_IS) {
            return picture;
        }
        if rng.random_range(0..2) == 0 {
            picture = self.cropped(&picture, rng);
        }
        if rng.random_range(0..2) == 0 {
            for row in picture.chunks_exact_mut(self.side * 3) {
                for x in 0..self.side / 2 {
                    for c in 0..3 {
                        row.swap(x * 3 + c, (self.side - 1 - x) * 3 + c);
                    }
                }
            }
        }
        if rng.random_range(0..3) == 0 {
            let [other, _] = &self.pictures[rng.random_range(0..self.pictures.len())];
            let share = rng.random_range(0.2f32..0.8);
            picture.iter_mut().zip(other).for_each(|(v, o)| *v += share * (o - *v));
        }
        if rng.random_range(0..3) == 0 {
            picture = self.sharpened(picture, rng.random_range(0.3f32..2.0));
        }
        if rng.random_range(0..3) == 0 {
            self.fringe(&mut picture, rng);
        }
        recoloured(&mut picture, rng);
        picture
    }

    /// One channel moved by up to a pixel and a half each way: coloured edges, as lenses,
    /// resampling and painters make them. They are what looks most like a mark.
    fn fringe(&self, picture: &mut [f32], rng: &mut ChaCha8Rng) {
        let channel = rng.random_range(0..3);
        let [dx, dy] = [0; 2].map(|_| rng.random_range(-1.5f32..1.5));
        let plane: Vec<f32> = picture.iter().skip(channel).step_by(3).copied().collect();
        let most = self.side as f32 - 1.0;
        let at = |x: usize, y: usize| plane[y.min(self.side - 1) * self.side + x.min(self.side - 1)];
        for (i, pixel) in picture.chunks_exact_mut(3).enumerate() {
            let x = ((i % self.side) as f32 + dx).clamp(0.0, most);
            let y = ((i / self.side) as f32 + dy).clamp(0.0, most);
            let (u, v) = (x as usize, y as usize);
            let row = |v: usize| at(u, v) + x.fract() * (at(u + 1, v) - at(u, v));
            pixel[channel] = row(v) + y.fract() * (row(v + 1) - row(v));
        }
    }

    /// Fine detail made larger by `more`, as cameras and programs do.
    fn sharpened(&self, mut picture: Vec<f32>, more: f32) -> Vec<f32> {
        let soft = Blur::new(1.0).apply(&picture, [self.side; 2]);
        picture.iter_mut().zip(soft).for_each(|(v, s)| *v = (*v + more * (*v - s)).clamp(0.0, 1.0));
        picture
    }

    fn cropped(&self, picture: &[f32], rng: &mut ChaCha8Rng) -> Vec<f32> {
        let size = rng.random_range(self.side / 2..=self.side);
        let (x, y) = (rng.random_range(0..=self.side - size), rng.random_range(0..=self.side - size));
        let mut part = Vec::with_capacity(size * size * 3);
        for row in y..y + size {
            part.extend_from_slice(&picture[(row * self.side + x) * 3..(row * self.side + x + size) * 3]);
        }
        AreaFilter::new([size, size], [self.side, self.side]).apply(&part)
    }
}

/// Channels exchanged, then mixed by a matrix near the identity that keeps grey, then a
/// curve: other materials, lights and cameras.
fn recoloured(picture: &mut [f32], rng: &mut ChaCha8Rng) {
    let shift = rng.random_range(0..3);
    let strength = rng.random_range(0.0f32..0.6);
    let gamma = rng.random_range(0.6f32..1.6);
    let matrix: [[f32; 3]; 3] = std::array::from_fn(|row| {
        let mut mix: [f32; 3] =
            std::array::from_fn(|c| f32::from(u8::from(c == row)) + strength * rng.random_range(-1.0f32..1.0));
        let off = (mix.iter().sum::<f32>() - 1.0) / 3.0;
        mix.iter_mut().for_each(|m| *m -= off);
        mix
    });
    for pixel in picture.chunks_exact_mut(3) {
        pixel.rotate_left(shift);
        let of = [pixel[0], pixel[1], pixel[2]];
        for (v, mix) in pixel.iter_mut().zip(&matrix) {
            let mixed = mix[0] * of[0] + mix[1] * of[1] + mix[2] * of[2];
            *v = mixed.clamp(0.0, 1.0).powf(gamma);
        }
    }
}

/// A picture at the networks' size, clamped to what a file can hold.
pub(crate) fn shrunk(picture: &Picture, side: usize) -> Vec<f32> {
    picture.clone().clamped().resized(side, side).into_rgb()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn other_colours_keep_grey_grey_and_stay_in_range() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            let mut picture = vec![0.4, 0.4, 0.4, 1.0, 0.0, 0.3, 0.0, 0.0, 0.0];
            recoloured(&mut picture, &mut rng);
            assert!(picture.iter().all(|v| (0.0..=1.0).contains(v)), "{picture:?}");
            let grey = &picture[..3];
            assert!(grey.iter().all(|v| (v - grey[0]).abs() < 1e-5), "{grey:?}");
        }
    }

    #[test]
    fn a_fringe_moves_one_channel_and_leaves_the_others() {
        let ramp: Vec<f32> = (0..16 * 16).flat_map(|i| [(i % 16) as f32 / 16.0; 3]).collect();
        let bank = Negatives::new(16, std::iter::empty());
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        for _ in 0..20 {
            let mut moved = ramp.clone();
            bank.fringe(&mut moved, &mut rng);
            let off = |c: usize| (0..256).map(|i| (moved[i * 3 + c] - ramp[i * 3 + c]).abs()).fold(0.0f32, f32::max);
            let changed: Vec<f32> = (0..3).map(off).filter(|o| *o > 1e-6).collect();
            assert_eq!(changed.len(), 1, "{changed:?}");
            assert!(changed[0] < 1.51 / 16.0, "{changed:?}");
        }
    }

    #[test]
    fn what_is_drawn_differs_and_is_a_picture() {
        let half: Vec<f32> = (0..16 * 16 * 3).map(|i| if i % 48 < 24 { 0.2 } else { 0.9 }).collect();
        let bank = Negatives::new(16, std::iter::once([half.clone(), half]));
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let drawn: Vec<Vec<f32>> = (0..40).map(|_| bank.draw(true, &mut rng)).collect();
        assert!(drawn.iter().all(|p| p.len() == 16 * 16 * 3 && p.iter().all(|v| (0.0..=1.0).contains(v))));
        let different = drawn.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!(different > 30, "{different} of 39");
    }

    #[test]
    fn jpegs_are_drawn_when_asked_for_and_never_else() {
        let [plain, jpeg] = [0.2, 0.9].map(|v| vec![v; 16 * 16 * 3]);
        let bank = Negatives::new(16, std::iter::once([plain.clone(), jpeg.clone()]));
        let drawn = |jpegs: bool| {
            let mut rng = ChaCha8Rng::seed_from_u64(4);
            let all: Vec<Vec<f32>> = (0..400).map(|_| bank.draw(jpegs, &mut rng)).collect();
            [&plain, &jpeg].map(|of| all.iter().filter(|picture| *picture == of).count())
        };
        // Four in ten come as they are.
        assert!(matches!(drawn(false), [120..=200, 0]), "{:?}", drawn(false));
        assert!(matches!(drawn(true), [50..=110, 50..=110]), "{:?}", drawn(true));
    }
}
