//! Noise as sensors, coding and brushes leave it, about as strong as marks are, and no mark.

use crate::attack::Blur;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Standard deviation of the softest grain's blur, px.
const SOFTEST_PX: f32 = 1.5;

/// Noise over a picture, drawn once, so that a marked render and its unmarked pair meet the same.
pub(crate) struct Grain {
    /// Root mean square, of the range [0, 1].
    strength: f32,
    /// The one direction in which it moves colours; none: each channel for itself.
    hue: Option<[f32; 3]>,
    /// Standard deviation of its blur, px; 0: as fine as a pixel.
    soft_px: f32,
    seed: u64,
}

impl Grain {
    /// Between the weakest and the strongest root mean square, faint ones as often as strong ones by the factor; half of it soft.
    /// `one_hue`: how often it is of one hue, 0 to 1.
    pub(crate) fn draw([least, most]: [f32; 2], one_hue: f64, rng: &mut ChaCha8Rng) -> Self {
        let strength = least * (most / least).powf(rng.random_range(0.0f32..1.0));
        let hue = rng.random_bool(one_hue).then(|| std::array::from_fn(|_| rng.random_range(-1.0f32..1.0)));
        let soft_px = if rng.random_bool(0.5) { rng.random_range(0.3..SOFTEST_PX) } else { 0.0 };
        Self { strength, hue, soft_px, seed: rng.random() }
    }

    /// Adds it to a picture of `side x side x 3` numbers, which may leave [0, 1].
    pub(crate) fn apply(&self, picture: &mut [f32], side: usize) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let mut draw = || rng.random_range(-1.0f32..1.0);
        let mut noise: Vec<f32> = match self.hue {
            Some(hue) => (0..side * side).map(|_| draw()).flat_map(|v| hue.map(|c| c * v)).collect(),
            None => (0..picture.len()).map(|_| draw()).collect(),
        };
        if self.soft_px > 0.0 {
            noise = Blur::new(self.soft_px).apply(&noise, [side; 2]);
        }
        let size = (noise.iter().map(|v| v * v).sum::<f32>() / noise.len() as f32).sqrt().max(1e-9);
        picture.iter_mut().zip(noise).for_each(|(p, v)| *p += self.strength / size * v);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What one grain adds to 32 x 32 pixels.
    fn added(grain: &Grain) -> Vec<f32> {
        let mut picture = vec![0.5; 32 * 32 * 3];
        grain.apply(&mut picture, 32);
        picture.iter().map(|v| v - 0.5).collect()
    }

    #[test]
    fn grain_is_as_strong_as_it_was_drawn_and_the_same_on_every_picture() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let (mut soft, mut hues, mut faint) = (0, 0, 0);
        for _ in 0..200 {
            let grain = Grain::draw([0.004, 0.036], 0.5, &mut rng);
            let noise = added(&grain);
            let size = (noise.iter().map(|v| v * v).sum::<f32>() / noise.len() as f32).sqrt();
            assert!((0.0039..0.0361).contains(&size) && (size - grain.strength).abs() < 1e-5, "{size}");
            assert_eq!(added(&grain), noise);
            soft += usize::from(grain.soft_px > 0.0);
            hues += usize::from(grain.hue.is_some());
            faint += usize::from(size < 0.012);
        }
        for (what, count) in [("soft", soft), ("of one hue", hues), ("below the middle", faint)] {
            assert!((70..130).contains(&count), "{count} of 200 {what}");
        }
    }

    #[test]
    fn grain_of_one_hue_moves_colours_one_way_and_soft_grain_moves_neighbours_together() {
        let grain = |hue, soft_px| Grain { strength: 0.02, hue, soft_px, seed: 3 };
        let noise = added(&grain(Some([1.0, -0.5, 0.25]), 0.0));
        assert!(noise.chunks_exact(3).all(|p| (p[1] + 0.5 * p[0]).abs() < 1e-5 && (p[2] - 0.25 * p[0]).abs() < 1e-5));
        let alike = |noise: &[f32]| {
            let red: Vec<f32> = noise.iter().step_by(3).copied().collect();
            red.windows(2).map(|two| two[0] * two[1]).sum::<f32>() / red.iter().map(|v| v * v).sum::<f32>()
        };
        let [fine, soft] = [0.0, 1.5].map(|soft_px| alike(&added(&grain(None, soft_px))));
        assert!(fine.abs() < 0.1 && soft > 0.7, "{fine} and {soft}");
    }
}
