//! What people and programs do to pictures, as it is done, and with its gradient.
//!
//! A mark is only worth its place if it outlasts the ways that pictures travel:
//! JPEG, blur, noise, other light, a part cut out, a few degrees of rotation, a
//! smaller copy, eight bits. Evaluation applies them ([`Distortion::apply`]); in
//! training [`traced`](Distortion::traced) remembers how to bring a gradient back
//! through, so that marks learn to live where such things leave something
//! (HiDDeN, Zhu et al. 2018, trains through them; for rounding see `jpeg`).

use super::blur::Blur;
use super::{jpeg, turn};
use cairn_scene::{AreaFilter, Picture};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// One thing that is done to a picture. Pictures go in and come out in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// Written as a baseline JPEG (ITU-T T.81) of `quality` 1 to 100 with libjpeg's
    /// tables and colours at half resolution (4:2:0, nearly everybody's default),
    /// and read back.
    Jpeg {
        /// 1 to 100; others count as the nearest of these.
        quality: u8,
    },
    /// Gaussian blur.
    Blur {
        /// Standard deviation, px; 0 changes nothing.
        sigma_px: f32,
    },
    /// Gaussian noise, every channel for itself.
    Noise {
        /// Standard deviation, of the range [0, 1].
        sigma: f32,
    },
    /// Brightness times a factor, then contrast about mid-grey times another.
    Light {
        /// 1 changes nothing.
        brightness: f32,
        /// 1 changes nothing.
        contrast: f32,
    },
    /// A part of the picture: what is around it is cut off.
    Crop {
        /// Share of each side that is kept, above 0, to 1.
        kept: f32,
        /// Where: 0 at the left, 1 at the right.
        across: f32,
        /// Where: 0 at the top, 1 at the bottom.
        down: f32,
    },
    /// Turned about its middle, its size kept; black comes in at the corners.
    Rotate {
        /// Counter-clockwise.
        degrees: f32,
    },
    /// A smaller or larger copy.
    Scale {
        /// Of each side, above 0.
        factor: f32,
    },
    /// Rounded to eight bits a channel, as in a PNG.
    EightBits,
}

/// How a gradient comes back through a distortion.
pub(crate) struct Trace {
    way: Way,
    /// Where a number was cut to [0, 1] no gradient passes; empty where none was.
    inside: Vec<bool>,
}

enum Way {
    /// Rounding and noise: as if nothing had happened (the straight-through estimate, Bengio et al. 2013).
    Straight,
    Gain(f32),
    Blur(Blur, [usize; 2]),
    Cut(Cut),
    Turn(turn::Turn, [usize; 2]),
    Resize(AreaFilter),
    Jpeg(jpeg::Passed),
}

impl Distortion {
    /// The distorted picture. What is drawn (noise) follows from `seed`.
    pub fn apply(&self, picture: &Picture, seed: u64) -> Picture {
        self.traced(picture, seed).0
    }

    /// As [`Distortion::apply`], and how a gradient comes back.
    pub(crate) fn traced(&self, picture: &Picture, seed: u64) -> (Picture, Trace) {
        let (w, h) = (picture.width(), picture.height());
        let same = |rgb: Vec<f32>, way| (made(w, h, rgb), way);
        let (mut out, way) = match *self {
            Self::Jpeg { quality } => {
                let (rgb, passed) = jpeg::round_trip(picture, quality);
                same(rgb, Way::Jpeg(passed))
            }
            Self::Blur { sigma_px } => {
                let blur = Blur::new(sigma_px);
                same(blur.apply(picture.rgb(), [w, h]), Way::Blur(blur, [w, h]))
            }
            Self::Noise { sigma } => {
                let mut noise = Gaussian::new(seed);
                same(picture.rgb().iter().map(|v| v + sigma * noise.draw()).collect(), Way::Straight)
            }
            Self::Light { brightness, contrast } => {
                let light = |v: &f32| 0.5 + contrast * (brightness * v - 0.5);
                same(picture.rgb().iter().map(light).collect(), Way::Gain(contrast * brightness))
            }
            Self::Crop { kept, across, down } => {
                let cut = Cut::new([w, h], kept, [across, down]);
                (made(cut.size[0], cut.size[1], cut.apply(picture.rgb())), Way::Cut(cut))
            }
            Self::Rotate { degrees } => {
                let turn = turn::Turn::new(degrees);
                same(turn.apply(picture.rgb(), [w, h]), Way::Turn(turn, [w, h]))
            }
            Self::Scale { factor } => {
                let side = |s: usize| ((s as f32 * factor).round() as usize).max(1);
                let filter = AreaFilter::new([w, h], [side(w), side(h)]);
                (made(side(w), side(h), filter.apply(picture.rgb())), Way::Resize(filter))
            }
            Self::EightBits => same(picture.rgb().iter().map(|v| (v * 255.0).round() / 255.0).collect(), Way::Straight),
        };
        let outside = out.rgb().iter().any(|v| !(0.0..=1.0).contains(v));
        let inside = if outside { out.rgb().iter().map(|v| (0.0..=1.0).contains(v)).collect() } else { Vec::new() };
        if outside {
            out = out.clamped();
        }
        (out, Trace { way, inside })
    }
}

impl Trace {
    /// d(loss)/d(picture) from d(loss)/d(distorted picture).
    pub(crate) fn back(&self, mut slope: Vec<f32>) -> Vec<f32> {
        for (s, inside) in slope.iter_mut().zip(&self.inside) {
            *s = if *inside { *s } else { 0.0 };
        }
        match &self.way {
            Way::Straight => slope,
            Way::Gain(gain) => {
                slope.iter_mut().for_each(|s| *s *= gain);
                slope
            }
            Way::Blur(blur, size) => blur.transpose(&slope, *size),
            Way::Cut(cut) => cut.transpose(&slope),
            Way::Turn(turn, size) => turn.transpose(&slope, *size),
            Way::Resize(filter) => filter.transpose(&slope),
            Way::Jpeg(passed) => passed.back(&slope),
        }
    }
}

/// A picture of numbers that are there by construction.
pub(super) fn made(width: usize, height: usize, rgb: Vec<f32>) -> Picture {
    Picture::new(width, height, rgb).expect("three numbers a pixel")
}

/// A rectangle of a picture, `[across, down]`.
pub(crate) struct Cut {
    pub(crate) whole: [usize; 2],
    pub(crate) from: [usize; 2],
    pub(crate) size: [usize; 2],
}

impl Cut {
    fn new(whole: [usize; 2], kept: f32, at: [f32; 2]) -> Self {
        let size = whole.map(|s| ((s as f32 * kept).round() as usize).clamp(1, s));
        let from = [0, 1].map(|k| ((whole[k] - size[k]) as f32 * at[k].clamp(0.0, 1.0)).round() as usize);
        Self { whole, from, size }
    }

    pub(crate) fn apply(&self, rgb: &[f32]) -> Vec<f32> {
        let rows = rgb.chunks_exact(self.whole[0] * 3).skip(self.from[1]).take(self.size[1]);
        rows.flat_map(|row| &row[self.from[0] * 3..][..self.size[0] * 3]).copied().collect()
    }

    pub(crate) fn transpose(&self, slope: &[f32]) -> Vec<f32> {
        let mut all = vec![0.0; self.whole[0] * self.whole[1] * 3];
        let rows = all.chunks_exact_mut(self.whole[0] * 3).skip(self.from[1]);
        for (row, from) in rows.zip(slope.chunks_exact(self.size[0] * 3)) {
            row[self.from[0] * 3..][..self.size[0] * 3].copy_from_slice(from);
        }
        all
    }
}

/// Normal numbers by Box and Muller's method, from a seed.
pub(crate) struct Gaussian {
    rng: ChaCha8Rng,
    spare: Option<f32>,
}

impl Gaussian {
    pub(crate) fn new(seed: u64) -> Self {
        Self { rng: ChaCha8Rng::seed_from_u64(seed), spare: None }
    }

    pub(crate) fn draw(&mut self) -> f32 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        // 1 - u is in (0, 1], whose logarithm is finite.
        let radius = (-2.0 * (1.0 - self.rng.random_range(0.0f32..1.0)).ln()).sqrt();
        let (sin, cos) = self.rng.random_range(0.0..std::f32::consts::TAU).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
#[path = "distortion_tests.rs"]
mod tests;
