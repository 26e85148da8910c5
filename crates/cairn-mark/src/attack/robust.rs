//! What training does to the pictures of a step, and its settings.
//!
//! Views are trained on at a fraction of the size that people keep pictures at.
//! Blur, noise and JPEG's blocks are fixed in pixels of the large picture, so each
//! training picture stands for one `native_px` long: blur and noise shrink with
//! it, and JPEG works on an enlarged copy.

use super::distortion::{Distortion, Trace, made};
use super::stretch::Stretch;
use crate::error::MarkError;
use cairn_scene::{AreaFilter, Picture};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// What marks are trained to outlast (`[mark.robust]`). A limit at its harmless end
/// leaves its distortion out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobustConfig {
    /// Whether any of it is done.
    pub enabled: bool,
    /// Share of the pictures that something is done to, 0 to 1.
    pub share: f64,
    /// Longest side of the pictures that training stands for, px, 64 to 16384.
    pub native_px: usize,
    /// Lowest JPEG quality, 1 to 100; 100 for none.
    pub jpeg_quality: u8,
    /// Strongest blur, standard deviation, px, 0 to 16.
    pub blur_px: f64,
    /// Strongest noise, standard deviation of the range [0, 1], 0 to 0.5.
    pub noise: f64,
    /// Furthest brightness and contrast from 1, each for itself, 0 to 0.9.
    pub light: f64,
    /// Furthest rotation either way, degrees, 0 to 180.
    pub rotate_deg: f64,
    /// Smallest copy, share of a side, 0.1 to 1.
    pub scale: f64,
    /// Whether pictures are rounded to eight bits a channel at the end.
    pub eight_bits: bool,
    /// Whether the mark's coefficients are rounded to half precision, as files hold them.
    pub half_weights: bool,
}

impl Default for RobustConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            share: 0.7,
            native_px: 512,
            jpeg_quality: LOWEST_QUALITY,
            blur_px: 2.5,
            // Pictures that were cut and made smaller are shrunk less for the networks, and keep more of their noise.
            noise: 0.25,
            light: 0.25,
            rotate_deg: 30.0,
            scale: 0.6,
            eight_bits: true,
            half_weights: true,
        }
    }
}

/// How often each distortion is part of an attack.
const ODDS: f64 = 0.35;
/// One attack in so many has all of them.
const ONE_IN_ALL: u32 = 4;

/// JPEGs of unmarked pictures go down to this quality where none of marked ones is trained on.
const LOWEST_QUALITY: u8 = 25;

/// Any quality from 100 down to `lowest`.
fn drawn_quality(lowest: u8, rng: &mut ChaCha8Rng) -> u8 {
    100 - (rng.random_range(0.0f32..=1.0) * f32::from(100 - lowest)) as u8
}

impl RobustConfig {
    /// Checks every range.
    ///
    /// # Errors
    /// [`MarkError::Setting`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<(), MarkError> {
        for (key, value, low, high, allowed) in [
            ("mark.robust.native_px", self.native_px as f64, 64.0, 16384.0, "64 to 16384"),
            ("mark.robust.jpeg_quality", f64::from(self.jpeg_quality), 1.0, 100.0, "1 to 100"),
            ("mark.robust.share", self.share, 0.0, 1.0, "0 to 1"),
            ("mark.robust.blur_px", self.blur_px, 0.0, 16.0, "0 to 16"),
            ("mark.robust.noise", self.noise, 0.0, 0.5, "0 to 0.5"),
            ("mark.robust.light", self.light, 0.0, 0.9, "0 to 0.9"),
            ("mark.robust.rotate_deg", self.rotate_deg, 0.0, 180.0, "0 to 180"),
            ("mark.robust.scale", self.scale, 0.1, 1.0, "0.1 to 1"),
        ] {
            if !(low..=high).contains(&value) {
                return Err(MarkError::Setting { key, value: value.to_string(), allowed });
            }
        }
        Ok(())
    }

    /// Whether marks are trained to outlast a JPEG.
    pub(crate) fn has_jpegs(&self) -> bool {
        self.enabled && self.jpeg_quality < 100
    }

    fn quality(&self, rng: &mut ChaCha8Rng) -> u8 {
        drawn_quality(self.jpeg_quality, rng)
    }

    /// Distortions in the order that pictures meet them, each with a drawn strength, in
    /// pixels of the large picture; those whose limit is harmless are left out.
    fn all(&self, rng: &mut ChaCha8Rng) -> Vec<Distortion> {
        let mut either = |most: f64| rng.random_range(-most..=most) as f32;
        let (brightness, contrast, degrees) =
            (1.0 + either(self.light), 1.0 + either(self.light), either(self.rotate_deg));
        let mut share = || rng.random_range(0.0f32..=1.0);
        let factor = 1.0 - share() * (1.0 - self.scale as f32);
        let (sigma_px, sigma) = (share() * self.blur_px as f32, share() * self.noise as f32);
        let quality = self.quality(rng);
        let list = [
            (self.rotate_deg > 0.0, Distortion::Rotate { degrees }),
            (self.light > 0.0, Distortion::Light { brightness, contrast }),
            (self.scale < 1.0, Distortion::Scale { factor }),
            (self.blur_px > 0.0, Distortion::Blur { sigma_px }),
            (self.noise > 0.0, Distortion::Noise { sigma }),
            (self.jpeg_quality < 100, Distortion::Jpeg { quality }),
            // Not where marks are not trained to last: these are drawn for them as well (`Attack::one`).
            (self.enabled && self.eight_bits, Distortion::EightBits),
        ];
        list.into_iter().filter(|(wanted, _)| *wanted).map(|(_, d)| d).collect()
    }
}

/// What is done to a picture and to what it is rendered from, drawn once, so that a marked render and its unmarked pair meet the same.
pub(crate) struct Attack {
    steps: Vec<(Distortion, u64)>,
    native_px: f32,
    /// Whether the mark is shown as half precision leaves it.
    half_weights: bool,
}

/// An attacked picture, `height x width x 3`, and its way back.
pub(crate) struct Attacked {
    pub(crate) rgb: Vec<f32>,
    /// Width and height.
    pub(crate) size: [usize; 2],
    back: Vec<Back>,
}

enum Back {
    Trace(Trace),
    Stretch(Stretch),
    Shrink(AreaFilter),
}

impl Attack {
    /// Nothing.
    pub(crate) fn none() -> Self {
        Self { steps: Vec::new(), native_px: 1.0, half_weights: false }
    }

    /// Whether the mark's coefficients are rounded to half precision before they are shown.
    pub(crate) fn rounds_weights(&self) -> bool {
        self.half_weights
    }

    /// Nothing but that.
    #[cfg(test)]
    pub(crate) fn of_weights() -> Self {
        Self { half_weights: true, ..Self::none() }
    }

    /// As often as the settings want it, a few distortions or all; else none.
    pub(crate) fn draw(config: &RobustConfig, rng: &mut ChaCha8Rng) -> Self {
        match config.enabled && rng.random_bool(config.share) {
            true => Self::always(config, rng),
            false => Self::none(),
        }
    }

    /// A few distortions or all.
    pub(crate) fn always(config: &RobustConfig, rng: &mut ChaCha8Rng) -> Self {
        let odds = if rng.random_range(0..ONE_IN_ALL) == 0 { 1.0 } else { ODDS };
        Self::with_odds(config, odds, rng)
    }

    /// All distortions, one after another.
    pub(crate) fn everything(config: &RobustConfig, rng: &mut ChaCha8Rng) -> Self {
        Self::with_odds(config, 1.0, rng)
    }

    fn with_odds(config: &RobustConfig, odds: f64, rng: &mut ChaCha8Rng) -> Self {
        // Some pictures are larger than others.
        let native_px = config.native_px as f32 * rng.random_range(0.7f32..1.4);
        let all = config.all(rng);
        let steps = all.into_iter().filter(|_| rng.random_bool(odds)).collect::<Vec<_>>();
        let steps = steps.into_iter().map(|step| (step, rng.random())).collect();
        // Drawn in any case, so that the setting changes nothing else.
        let is_rounded = rng.random_bool(odds);
        Self { steps, native_px, half_weights: is_rounded && config.half_weights }
    }

    /// One distortion alone, of any strength up to the settings' limits; none where all of them are harmless.
    pub(crate) fn one(config: &RobustConfig, rng: &mut ChaCha8Rng) -> Self {
        let mut all = config.all(rng);
        if all.is_empty() {
            return Self::none();
        }
        let step = all.swap_remove(rng.random_range(0..all.len()));
        Self { steps: vec![(step, rng.random())], native_px: config.native_px as f32, half_weights: false }
    }

    /// A JPEG of any quality down to the settings' limit, or where that leaves JPEGs out down to
    /// [`LOWEST_QUALITY`].
    pub(crate) fn jpeg(config: &RobustConfig, rng: &mut ChaCha8Rng) -> Self {
        let native_px = config.native_px as f32 * rng.random_range(0.7f32..1.4);
        let lowest = if config.jpeg_quality < 100 { config.jpeg_quality } else { LOWEST_QUALITY };
        let steps = vec![(Distortion::Jpeg { quality: drawn_quality(lowest, rng) }, 0)];
        Self { steps, native_px, half_weights: false }
    }

    /// Does it to a file, whose pixels are those of the large picture.
    pub(crate) fn on_file(&self, picture: &Picture) -> Picture {
        self.steps.iter().fold(picture.clone(), |picture, (step, seed)| step.apply(&picture, *seed).clamped())
    }

    /// Does it to a picture of `size` = [width, height] with numbers in [0, 1].
    pub(crate) fn apply(&self, rgb: Vec<f32>, size: [usize; 2]) -> Attacked {
        let ratio = (self.native_px / size[0].max(size[1]) as f32).max(1.0);
        let mut now = Attacked { rgb, size, back: Vec::new() };
        for (step, seed) in &self.steps {
            match *step {
                Distortion::Blur { sigma_px } => now.take(Distortion::Blur { sigma_px: sigma_px / ratio }, *seed),
                // The mean of ratio^2 pixels has a ratio-th of their noise.
                Distortion::Noise { sigma } => now.take(Distortion::Noise { sigma: sigma / ratio }, *seed),
                Distortion::Jpeg { .. } => now.enlarged(ratio, *step),
                other => now.take(other, *seed),
            }
        }
        now
    }
}

impl Attacked {
    fn take(&mut self, step: Distortion, seed: u64) {
        let picture = made(self.size[0], self.size[1], std::mem::take(&mut self.rgb));
        let (picture, trace) = step.traced(&picture, seed);
        self.size = [picture.width(), picture.height()];
        self.rgb = picture.into_rgb();
        self.back.push(Back::Trace(trace));
    }

    /// `step` on a copy `ratio` times larger.
    fn enlarged(&mut self, ratio: f32, step: Distortion) {
        let (small, large) = (self.size, self.size.map(|s| (s as f32 * ratio).round() as usize));
        let stretch = Stretch::new(small, large);
        (self.rgb, self.size) = (stretch.apply(&self.rgb), large);
        self.back.push(Back::Stretch(stretch));
        self.take(step, 0);
        let shrink = AreaFilter::new(large, small);
        (self.rgb, self.size) = (shrink.apply(&self.rgb), small);
        self.back.push(Back::Shrink(shrink));
    }

    /// d(loss)/d(picture) from d(loss)/d(attacked picture).
    pub(crate) fn back(&self, slope: Vec<f32>) -> Vec<f32> {
        self.back.iter().rev().fold(slope, |slope, back| match back {
            Back::Trace(trace) => trace.back(slope),
            Back::Stretch(stretch) => stretch.transpose(&slope),
            Back::Shrink(filter) => filter.transpose(&slope),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// Lowest and highest quality of many JPEGs that unmarked pictures come as.
    fn qualities(config: &RobustConfig) -> (u8, u8) {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let quality = |attack: Attack| match attack.steps[..] {
            [(Distortion::Jpeg { quality }, _)] => quality,
            _ => panic!("another attack"),
        };
        let drawn: Vec<u8> = (0..200).map(|_| quality(Attack::jpeg(config, &mut rng))).collect();
        (*drawn.iter().min().unwrap(), *drawn.iter().max().unwrap())
    }

    #[test]
    fn jpegs_are_shown_unmarked_where_marks_are_trained_for_everything_but_jpegs() {
        let off = RobustConfig::default();
        let turned = RobustConfig { enabled: true, jpeg_quality: 100, ..RobustConfig::default() };
        let all = RobustConfig { enabled: true, jpeg_quality: 60, ..RobustConfig::default() };
        assert_eq!([&off, &turned, &all].map(RobustConfig::has_jpegs), [false, false, true]);
        for (config, low) in [(&off, 25..30), (&turned, 25..30), (&all, 60..63)] {
            let (least, most) = qualities(config);
            assert!(low.contains(&least) && most > 95, "{least} to {most} of {config:?}");
        }
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let met = |config: &RobustConfig, rng: &mut ChaCha8Rng| {
            (0..200).flat_map(|_| Attack::always(config, rng).steps).any(|(d, _)| matches!(d, Distortion::Jpeg { .. }))
        };
        assert!(met(&all, &mut rng) && !met(&turned, &mut rng), "marked pictures meet only what is asked for");
    }

    #[test]
    fn rounding_is_drawn_where_marks_are_to_last_and_only_there() {
        let on = RobustConfig { enabled: true, ..RobustConfig::default() };
        let drawn = |config: &RobustConfig, draw: fn(&RobustConfig, &mut ChaCha8Rng) -> Attack| {
            let mut rng = ChaCha8Rng::seed_from_u64(9);
            let attacks: Vec<Attack> = (0..400).map(|_| draw(config, &mut rng)).collect();
            let rounds = |attack: &&Attack| attack.steps.iter().any(|(step, _)| *step == Distortion::EightBits);
            [attacks.iter().filter(rounds).count(), attacks.iter().filter(|a| a.half_weights).count()]
        };
        // A quarter has all, the others 35 in a hundred: 205 of 400, by the luck of the draw up to 30 more or less.
        let [pictures, weights] = drawn(&on, Attack::always);
        assert!((175..235).contains(&pictures) && (175..235).contains(&weights), "{pictures} and {weights}");
        assert_eq!(drawn(&on, Attack::everything), [400, 400]);
        let [pictures, weights] = drawn(&on, Attack::one);
        assert!((30..90).contains(&pictures) && weights == 0, "one of seven, {pictures}");
        assert_eq!(drawn(&RobustConfig { eight_bits: false, ..on.clone() }, Attack::everything), [0, 400]);
        assert_eq!(drawn(&RobustConfig { half_weights: false, ..on.clone() }, Attack::everything), [400, 0]);
        // What is drawn where marks are not trained to last is what it was.
        let off = RobustConfig { enabled: false, ..on };
        assert_eq!([Attack::draw, Attack::one].map(|draw| drawn(&off, draw)), [[0; 2]; 2]);
        // The last thing that happens to a picture is that it is kept.
        let all = Attack::everything(&RobustConfig { enabled: true, ..off }, &mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(all.steps.last().map(|(step, _)| *step), Some(Distortion::EightBits));
        let kept = all.apply((0..48 * 48 * 3).map(|i| (i % 251) as f32 / 250.0).collect(), [48, 48]);
        assert!(kept.rgb.iter().all(|v| (v * 255.0 - (v * 255.0).round()).abs() < 1e-3));
    }
}
