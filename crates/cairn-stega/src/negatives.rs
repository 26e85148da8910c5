//! Pictures that carry no mark: base renders, photographs, and pictures of
//! anything else. Without them a classifier says yes to everything, and a
//! detector recognises the scene and not the mark.

use cairn_capture::{AreaFilter, Picture};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A bank of unmarked pictures at the networks' size.
pub(crate) struct Negatives {
    side: usize,
    /// `side x side x 3` each.
    pictures: Vec<Vec<f32>>,
}

impl Negatives {
    pub(crate) fn new(side: usize, pictures: impl Iterator<Item = Vec<f32>>) -> Self {
        Self { side, pictures: pictures.collect() }
    }

    /// One of the bank as it is, or made into a picture of something else:
    /// mirrored, cropped, recoloured, two laid over one another, or plain noise.
    pub(crate) fn draw(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let n = self.side * self.side * 3;
        if self.pictures.is_empty() || rng.random_range(0..12) == 0 {
            let (level, depth) = (rng.random_range(0.0f32..1.0), rng.random_range(0.0f32..0.5));
            return (0..n).map(|_| (level + depth * rng.random_range(-1.0f32..1.0)).clamp(0.0, 1.0)).collect();
        }
        let mut picture = self.pictures[rng.random_range(0..self.pictures.len())].clone();
        if rng.random_range(0..3) == 0 {
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
        let shift = rng.random_range(0..3);
        for pixel in picture.chunks_exact_mut(3) {
            pixel.rotate_left(shift);
        }
        if rng.random_range(0..3) == 0 {
            let other = &self.pictures[rng.random_range(0..self.pictures.len())];
            let share = rng.random_range(0.2f32..0.8);
            picture.iter_mut().zip(other).for_each(|(v, o)| *v += share * (o - *v));
        }
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

/// A picture at the networks' size, clamped to what a file can hold.
pub(crate) fn shrunk(picture: &Picture, side: usize) -> Vec<f32> {
    picture.clone().clamped().resized(side, side).into_rgb()
}
