//! The training of DeepStega's networks.

use super::networks::DeepStega;
use super::patches::Patches;
use cairn_nn::{Adam, AdamConfig, Rate, mean_squared};
use cairn_scene::Picture;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// How the networks are built and trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeepConfig {
    /// Optimiser steps, 1 to 1,000,000.
    pub steps: u64,
    /// Pairs of a photograph's patch and one to hide in it, a step, 1 to 64.
    pub batch: usize,
    /// Side of the patches, 16 to 512 px; no photograph's may be shorter.
    pub patch_px: usize,
    /// Channels of every layer, 1 to 256.
    pub channels: usize,
    /// beta, weight of the revealed picture's error against the photograph's, 0 to 1000.
    pub weight_reveal: f64,
    /// Learning rate at the start, 1e-9 to 1; it falls to a tenth, exponentially.
    pub learning_rate: f64,
}

impl Default for DeepConfig {
    fn default() -> Self {
        // beta is the paper's.
        Self { steps: 4000, batch: 4, patch_px: 32, channels: 24, weight_reveal: 0.75, learning_rate: 4e-3 }
    }
}

impl DeepConfig {
    /// Checks every range.
    ///
    /// # Errors
    /// An error naming the first key that is out of range.
    pub fn validate(&self) -> anyhow::Result<()> {
        for (key, value, low, high, allowed) in [
            ("deepstega.steps", self.steps as f64, 1.0, 1e6, "1 to 1000000"),
            ("deepstega.batch", self.batch as f64, 1.0, 64.0, "1 to 64"),
            ("deepstega.patch_px", self.patch_px as f64, 16.0, 512.0, "16 to 512"),
            ("deepstega.channels", self.channels as f64, 1.0, 256.0, "1 to 256"),
            ("deepstega.weight_reveal", self.weight_reveal, 0.0, 1000.0, "0 to 1000"),
            ("deepstega.learning_rate", self.learning_rate, 1e-9, 1.0, "1e-9 to 1"),
        ] {
            if !(low..=high).contains(&value) {
                anyhow::bail!("{key} is {value}; allowed is {allowed}");
            }
        }
        Ok(())
    }
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeepStats {
    /// Steps done, this one included.
    pub step: u64,
    /// PSNR of the patches with something hidden in them against the same without, dB.
    pub cover_db: f64,
    /// PSNR of what was revealed against what was hidden, dB.
    pub revealed_db: f64,
}

/// Trains [`DeepStega`]; see the module's text.
pub struct DeepTrainer {
    config: DeepConfig,
    seed: u64,
    step: u64,
    patches: Patches,
    stega: DeepStega,
    adam: Adam,
}

impl DeepTrainer {
    /// Prepares training on `photographs`, to hide pictures such as `hidden` in them;
    /// both may be of any number and sizes.
    ///
    /// # Errors
    /// An error; An error without photographs or pictures to
    /// hide, and for a photograph smaller than a patch.
    pub fn new(photographs: Vec<Picture>, hidden: &[Picture], config: DeepConfig, seed: u64) -> anyhow::Result<Self> {
        config.validate()?;
        let patches = Patches::new(photographs, hidden, config.patch_px)?;
        let rate = Rate::falling(config.learning_rate, config.learning_rate * 0.1, config.steps);
        let stega = DeepStega::fresh(config.channels, seed)?;
        Ok(Self { adam: Adam::new(AdamConfig::default(), rate)?, config, seed, step: 0, patches, stega })
    }

    /// Steps done.
    pub fn steps_done(&self) -> u64 {
        self.step
    }

    /// Steps in all.
    pub fn steps_total(&self) -> u64 {
        self.config.steps
    }

    /// Takes one step, also after the last one.
    ///
    /// # Errors
    /// An error or An error when a number is not finite; the
    /// state is then the last good one.
    pub fn step(&mut self) -> anyhow::Result<DeepStats> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(self.step);
        let [cover, secret, noise] = self.patches.draw(self.config.batch, &mut rng)?;
        let marked = self.stega.hidden_in(&cover, &secret)?;
        let revealed = self.stega.revealed(&(&marked + noise)?)?;
        let (kept, found) = (mean_squared(&marked, &cover)?, mean_squared(&revealed, &secret)?);
        let errors = [kept.to_scalar::<f32>()?, found.to_scalar::<f32>()?].map(f64::from);
        if errors.iter().any(|e| !e.is_finite()) {
            let why = format!("step {}: DeepStega's loss is not finite; lower its learning rate", self.step);
            anyhow::bail!(why);
        }
        let grads = (kept + (found * self.config.weight_reveal)?)?.backward()?;
        self.adam.step(self.stega.params(), &grads)?;
        self.step += 1;
        let [cover_db, revealed_db] = errors.map(|e| -10.0 * e.max(1e-20).log10());
        Ok(DeepStats { step: self.step, cover_db, revealed_db })
    }

    /// The networks as they are.
    pub fn finish(self) -> DeepStega {
        self.stega
    }
}
