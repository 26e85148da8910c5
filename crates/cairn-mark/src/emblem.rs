//! Emblems to hide when a contributor brings nothing of their own: a crest with
//! a rosette and a letter, different in shape, colour and pattern for each.
//!
//! Their detail is of middle size on purpose. Flat colour would make any
//! recovery look good, and single-pixel detail would be lost at 8 bits.

use std::f32::consts::TAU;

use cairn_scene::Picture;
use glam::{Vec2, Vec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Samples a side in each pixel: edges are smooth, as in a photograph.
const SUPERSAMPLING: usize = 3;

/// The letters A to Z of five by seven dots: rows from the top; in each the highest of five bits is the left dot.
const LETTERS: [[u8; 7]; 26] = [
    [14, 17, 17, 31, 17, 17, 17],
    [30, 17, 17, 30, 17, 17, 30],
    [14, 17, 16, 16, 16, 17, 14],
    [30, 17, 17, 17, 17, 17, 30],
    [31, 16, 16, 30, 16, 16, 31],
    [31, 16, 16, 30, 16, 16, 16],
    [14, 17, 16, 23, 17, 17, 15],
    [17, 17, 17, 31, 17, 17, 17],
    [14, 4, 4, 4, 4, 4, 14],
    [7, 2, 2, 2, 2, 18, 12],
    [17, 18, 20, 24, 20, 18, 17],
    [16, 16, 16, 16, 16, 16, 31],
    [17, 27, 21, 21, 17, 17, 17],
    [17, 25, 21, 19, 17, 17, 17],
    [14, 17, 17, 17, 17, 17, 14],
    [30, 17, 17, 30, 16, 16, 16],
    [14, 17, 17, 17, 21, 18, 13],
    [30, 17, 17, 30, 20, 18, 17],
    [15, 16, 16, 14, 1, 1, 30],
    [31, 4, 4, 4, 4, 4, 4],
    [17, 17, 17, 17, 17, 17, 14],
    [17, 17, 17, 17, 17, 10, 4],
    [17, 17, 17, 21, 21, 27, 17],
    [17, 17, 10, 4, 10, 17, 17],
    [17, 17, 10, 4, 4, 4, 4],
    [31, 1, 2, 4, 8, 16, 31],
];

/// What is drawn at random of an emblem.
struct Design {
    kind: usize,
    petals: f32,
    turn: f32,
    field: Vec3,
    second: Vec3,
    light: Vec3,
    /// 0 is A.
    letter: usize,
}

/// The emblem of contributor `index` (from 0), `size` x `size` pixels, values in
/// [0, 1]. Hue, shape and letter follow `index`, so that neighbours never look
/// alike; `seed` varies the details. Six shapes and 26 letters: 78 emblems
/// differ in shape or letter before they repeat.
///
/// # Panics
/// When `size` is zero.
pub fn emblem(index: usize, size: usize, seed: u64) -> Picture {
    let design = Design::new(index, seed);
    let mut picture = Picture::constant(size, size, [0.0; 3]);
    let step = 2.0 / (size * SUPERSAMPLING) as f32;
    for (at, pixel) in picture.rgb_mut().chunks_exact_mut(3).enumerate() {
        let (x, y) = (at % size * SUPERSAMPLING, at / size * SUPERSAMPLING);
        let mut sum = Vec3::ZERO;
        for sub in 0..SUPERSAMPLING * SUPERSAMPLING {
            let (dx, dy) = (x + sub % SUPERSAMPLING, y + sub / SUPERSAMPLING);
            sum += design.colour(Vec2::new(dx as f32 + 0.5, dy as f32 + 0.5) * step - Vec2::ONE);
        }
        let mean = sum / (SUPERSAMPLING * SUPERSAMPLING) as f32;
        pixel.copy_from_slice(&mean.clamp(Vec3::ZERO, Vec3::ONE).to_array());
    }
    picture
}

impl Design {
    fn new(index: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(index as u64);
        // The golden angle keeps any number of hues apart.
        let hue = (0.02 + index as f32 * 0.381_966 + rng.random_range(-0.02..0.02f32)).rem_euclid(1.0);
        Self {
            kind: index % 6,
            petals: (5 + (index * 3 + rng.random_range(0..2usize)) % 8) as f32,
            turn: rng.random_range(0.0..TAU),
            field: hsv(hue, 0.78, 0.62),
            second: hsv(hue + 0.42 + rng.random_range(-0.06..0.06f32), 0.6, 0.92),
            light: hsv(hue + 0.12, 0.12, 0.97),
            letter: index % 26,
        }
    }

    /// Colour at `p` in -1 to 1 (y down).
    fn colour(&self, p: Vec2) -> Vec3 {
        let ground = self.ground(p);
        let outline = self.outline(p);
        let charge = self.charge(p, outline);
        // From outside in: ground, rim, charge, disc, letter.
        let rim = smoothstep(0.06, 0.05, outline.abs());
        let inside = smoothstep(0.006, -0.006, outline);
        let disc = smoothstep(0.40, 0.39, p.length());
        let ring = smoothstep(0.03, 0.02, (p.length() - 0.40).abs());
        let mut colour = ground.lerp(charge, inside).lerp(self.light, rim);
        colour = colour.lerp(self.field * (0.62 - 0.3 * p.y), disc).lerp(self.light, ring);
        if self.inked(p) { self.light } else { colour }
    }

    /// What lies around the crest: a gradient with a weave.
    fn ground(&self, p: Vec2) -> Vec3 {
        let (sin, cos) = self.turn.sin_cos();
        let along = p.x * cos + p.y * sin;
        let weave = ((p.x + p.y) * 13.0).sin() * ((p.x - p.y) * 13.0).sin();
        (self.second * 0.42).lerp(self.field * 0.5, 0.5 + 0.35 * along) * (0.85 + 0.25 * weave)
    }

    /// Distance (about) to the crest's outline, negative inside.
    fn outline(&self, p: Vec2) -> f32 {
        let (q, angle) = (p.abs(), p.y.atan2(p.x));
        match self.kind {
            0 => p.length() - 0.86,
            1 => {
                // A shield: straight above, two arcs to a point below.
                let side = if p.y < -0.1 { q.x - 0.74 } else { Vec2::new(q.x + 0.45, p.y + 0.1).length() - 1.19 };
                side.max(-0.84 - p.y)
            }
            2 => (q.x + q.y) * 0.75 - 0.68,
            3 => (q.x * 0.866 + q.y * 0.5).max(q.y) - 0.78,
            4 => p.length() - 0.76 - 0.1 * (angle * 8.0).cos(),
            _ => {
                let r = (q - Vec2::splat(0.42)).max(Vec2::ZERO);
                r.length() - 0.38
            }
        }
    }

    /// The pattern inside the crest.
    fn charge(&self, p: Vec2, outline: f32) -> Vec3 {
        let (r, angle) = (p.length(), p.y.atan2(p.x) + self.turn);
        let pattern = match self.kind {
            0 => (angle * self.petals).cos() + 0.35 * (r * 26.0).cos(),
            1 => (p.x * 9.5).sin() * if p.y < 0.0 { 1.0 } else { -1.0 },
            2 => (p.x * 11.0).sin() * (p.y * 11.0).sin() * 1.6,
            3 => (angle * 3.0 + r * 9.0).sin(),
            4 => (outline * 24.0).cos() + 0.5 * (angle * self.petals).cos(),
            _ => ((p.x + p.y) * 8.5 + 0.6 * (angle * 4.0).sin()).sin(),
        };
        self.field.lerp(self.second, smoothstep(-0.12, 0.12, pattern)) * (1.0 - 0.22 * p.y)
    }

    /// Whether the letter in the middle covers `p`.
    fn inked(&self, p: Vec2) -> bool {
        let dot = 0.072;
        let at = (p + Vec2::new(2.5, 3.5) * dot) / dot;
        let (x, y) = (at.x as usize, at.y as usize);
        at.x >= 0.0 && at.y >= 0.0 && x < 5 && y < 7 && LETTERS[self.letter][y] >> (4 - x) & 1 == 1
    }
}

/// 0 below `low`, 1 above `high` (the other way round where they are), smooth between.
fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Hue (in turns, wrapping), saturation and value to RGB.
fn hsv(hue: f32, saturation: f32, value: f32) -> Vec3 {
    let channel = |offset: f32| {
        let k = (offset + hue * 6.0).rem_euclid(6.0);
        value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    Vec3::new(channel(5.0), channel(3.0), channel(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distance(a: &Picture, b: &Picture) -> f32 {
        a.rgb().iter().zip(b.rgb()).map(|(x, y)| (x - y).abs()).sum::<f32>() / a.rgb().len() as f32
    }

    #[test]
    fn emblems_differ_and_repeat_by_seed() {
        let all: Vec<Picture> = (0..12).map(|i| emblem(i, 64, 5)).collect();
        for (i, a) in all.iter().enumerate() {
            assert!(a.rgb().iter().all(|v| (0.0..=1.0).contains(v)));
            for (j, b) in all.iter().enumerate().skip(i + 1) {
                assert!(distance(a, b) > 0.1, "{i} and {j} differ by {}", distance(a, b));
            }
        }
        assert_eq!(all[3], emblem(3, 64, 5));
        assert_ne!(all[3], emblem(3, 64, 6));
    }

    #[test]
    fn detail_is_of_middle_size() {
        for index in 0..8 {
            let full = emblem(index, 128, 1);
            let coarse = full.resized(8, 8).resized(128, 128);
            let half = full.resized(64, 64).resized(128, 128);
            let (lost, kept) = (distance(&full, &coarse), distance(&full, &half));
            assert!(lost > 0.05, "emblem {index} is nearly flat: {lost}");
            assert!(kept < 0.35 * lost, "emblem {index} has too much fine detail: {kept} of {lost}");
        }
    }
}
