//! The state of a training of stage 2. `sample` makes a step's pictures of it, `forward` the loss, `backward` what
//! that asks of the marks, and `judge` says how good it is.

use crate::detect::blind::networks::Networks;
use crate::error::MarkError;
use crate::payload::{HeadSizes, Numbers, Signal};
use crate::stega::bank::BankView;
use crate::stega::carrier::{Carrier, hues};
use crate::stega::growth::Restarted;
use crate::stega::judgement::Best;
use crate::stega::plan::MarkScene;
use crate::stega::prefetch::Prefetch;
use crate::stega::recipe::Recipe;
use crate::stega::site::Site;
use cairn_nn::{Adam, AdamConfig, Average, Rate};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// How far the budget tightens at most while the detector waits for marks to be read.
const UNREAD: f64 = 0.5;
/// Marked renders a step that there are at most for the sake of many identities, as many as `mark.batch` may be: more
/// of them take turns.
const MAX_FOR_ALL: usize = 64;

/// A training as it stands.
pub(crate) struct State {
    pub(crate) config: Recipe,
    pub(crate) seed: u64,
    pub(crate) step: u64,
    /// Running mean of how far from read marks are (`Losses::unread`), and after which step the detector joined, if it has.
    pub(crate) unread: f64,
    pub(crate) joined: Option<u64>,
    /// The scenes, most often one. Identities and carriers are counted through all of them.
    pub(crate) sites: Vec<Site>,
    /// The next unseen view of each scene, by its number and the view's.
    pub(crate) prefetch: Prefetch<(usize, u64), BankView>,
    /// The plans' and the fields' digest, which a checkpoint must meet again.
    pub(crate) fingerprint: String,
    /// What the heads are to say of each identity, identity 1 first.
    pub(crate) signals: Vec<Numbers>,
    pub(crate) carriers: Vec<Carrier>,
    /// Which of them stay as they are: marks of an earlier training.
    pub(crate) settled: Vec<bool>,
    /// Heads that could not go on from an earlier training's.
    pub(crate) restarted: Vec<Restarted>,
    pub(crate) networks: Networks,
    pub(crate) adam: Adam,
    /// The networks' mean over the last steps: what is judged, and kept.
    pub(crate) average: Average,
    pub(crate) best: Option<Best>,
    /// Whether the last judged state was good enough to end.
    pub(crate) enough: bool,
    /// Set once recovery has converged.
    pub(crate) converged: bool,
}

impl State {
    /// A training of `scenes`, whose [`fingerprint`](crate::stega::plan::fingerprint) is known, before its first
    /// step, with the views that are there after `step` steps.
    ///
    /// # Errors
    /// As [`Site::all`]; [`MarkError::Setting`].
    pub(crate) fn new(
        scenes: Vec<MarkScene>,
        fingerprint: String,
        config: Recipe,
        seed: u64,
        step: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        config.validate()?;
        let hidden: Vec<Signal> = scenes.iter().flat_map(|s| s.plan.signals.clone()).collect();
        let sites = Site::all(scenes, &config, seed, step, progress)?;
        let heads = HeadSizes::of(&hidden, &config);
        let hues = hues(sites.last().map_or(0, |s| s.carriers.end), &[]);
        let pattern = |site: &Site, i: usize| site.pattern(&config, seed, i, hues[i]);
        let carriers: Vec<Carrier> =
            sites.iter().flat_map(|site| site.carriers.clone().map(|i| pattern(site, i))).collect();
        let networks = Networks::new(&config, hidden.len() + 1, heads, seed)?;
        let rate = Rate::falling(
            config.learning_rate_networks,
            config.learning_rate_networks * config.final_rate,
            config.steps,
        );
        Ok(Self {
            average: Average::new(&networks.params, config.average)?,
            adam: Adam::new(AdamConfig::default(), rate)?,
            seed,
            step: 0,
            unread: f64::INFINITY,
            // Without a classifier there is nothing to wait for.
            joined: (!config.has_classifier()).then_some(0),
            sites,
            prefetch: Prefetch::new(),
            fingerprint,
            signals: hidden.iter().map(|s| Numbers::of(s, &heads, config.side_px())).collect(),
            settled: vec![false; carriers.len()],
            restarted: Vec::new(),
            carriers,
            networks,
            best: None,
            enough: false,
            converged: false,
            config,
        })
    }

    /// Steps in all; those done once training has converged.
    pub(crate) fn steps_total(&self) -> u64 {
        if self.converged { self.step } else { self.config.steps }
    }

    /// How far the budget has tightened, 0 to 1.
    pub(crate) fn tightened(&self) -> f64 {
        tightened(&self.config, self.step, self.joined)
    }

    /// The same where the last step scaled the carriers.
    pub(crate) fn tightened_last(&self) -> f64 {
        tightened(&self.config, self.step.saturating_sub(1), self.joined)
    }

    /// How surely marks are read, 0 to 1; 0 until the detector has joined.
    pub(crate) fn ease(&self) -> f32 {
        if self.joined.is_some() { ease(&self.config, self.unread) } else { 0.0 }
    }

    /// Marked renders a step: identities in turn and, where several scenes share the networks, as many more as one scene alone
    /// would have.
    pub(crate) fn batch(&self) -> usize {
        self.in_turn() + if self.sites.len() > 1 { self.config.batch } else { 0 }
    }

    /// Of those, how many go round all identities: one of each that still learns, up to [`MAX_FOR_ALL`].
    pub(crate) fn in_turn(&self) -> usize {
        // One carrier for all settles nobody.
        let settled = self.settled.iter().filter(|is_settled| **is_settled).count();
        let learning = self.signals.len() - settled.min(self.signals.len());
        self.config.batch.max(learning.min(MAX_FOR_ALL))
    }

    /// The scene of identity `i` (from 0).
    pub(crate) fn site_of(&self, i: usize) -> usize {
        self.sites.partition_point(|site| site.identities.end <= i)
    }

    /// One scene as well as another.
    pub(crate) fn any_site(&self, rng: &mut ChaCha8Rng) -> &Site {
        // One alone is not worth a draw, which would change what follows it.
        let at = if self.sites.len() > 1 { rng.random_range(0..self.sites.len()) } else { 0 };
        &self.sites[at]
    }
}

/// How surely marks are read that are `unread` so far, 0 to 1: the cross-entropy's distance below `classify_until`. Without a
/// classifier there is none to go by, and it is recovery's distance from what a detector that says nothing gets wrong.
fn ease(config: &Recipe, unread: f64) -> f32 {
    let hopeless = if config.has_classifier() { config.classify_until } else { 1.0 };
    (1.0 - unread / hopeless).clamp(0.0, 1.0) as f32
}

/// How far the budget has tightened after `step` steps, 0 to 1 (1 where there is none): evenly over `mark.budget_ramp` of all
/// steps, but before marks are read at all no further than [`UNREAD`]; from where the detector has `joined` on as fast, or
/// in half of the steps that are left.
fn tightened(config: &Recipe, step: u64, joined: Option<u64>) -> f64 {
    let (step, steps) = (step as f64, config.steps as f64);
    let ramp = (steps * config.budget_ramp).floor();
    if !config.budget || ramp < 1.0 {
        return 1.0;
    }
    match joined.map(|at| at as f64) {
        None => (step / ramp).min(UNREAD),
        Some(at) if at <= UNREAD * ramp => (step / ramp).min(1.0),
        Some(at) => {
            let rest = ((1.0 - UNREAD) * ramp).min(0.5 * (steps - at)).max(1.0);
            (UNREAD + (1.0 - UNREAD) * (step - at) / rest).min(1.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stega::recipe::Guidance;

    #[test]
    fn ease_goes_by_the_classifier_and_without_one_by_recovery() {
        let told = Recipe { classify_until: 0.3, ..Recipe::default() };
        let unguided = Recipe { guidance: Guidance::Unguided, ..told.clone() };
        let none = Recipe { guidance: Guidance::NoClassifier, ..told.clone() };
        for (config, unread, expected) in [
            (&told, 0.075, 0.75),
            (&told, 0.69, 0.0),
            (&unguided, 0.15, 0.5),
            (&none, 0.25, 0.75),
            // As much wrong as silence is, more, and before the first step.
            (&none, 1.0, 0.0),
            (&none, 1.7, 0.0),
            (&none, f64::INFINITY, 0.0),
        ] {
            assert!((ease(config, unread) - expected).abs() < 1e-6, "{unread} of {:?}", config.guidance);
        }
    }

    #[test]
    fn the_budget_waits_until_marks_are_read_and_is_met_before_the_end() {
        let config = Recipe { steps: 1000, budget_ramp: 0.4, ..Recipe::default() };
        let at = |step, joined| tightened(&config, step, joined);
        // Read early, it tightens evenly.
        for (step, share) in [(0, 0.0), (100, 0.25), (200, 0.5), (400, 1.0), (900, 1.0)] {
            assert!((at(step, Some(50)) - share).abs() < 1e-12, "{step}");
        }
        // Not read, it waits; read late, it goes on from there as fast,
        assert_eq!((at(60, None), at(300, None), at(900, None)), (0.15, UNREAD, UNREAD));
        assert_eq!(at(300, Some(300)), UNREAD);
        assert!((at(340, Some(300)) - (UNREAD + 0.1)).abs() < 1e-12);
        assert_eq!(at(500, Some(300)), 1.0);
        // or faster, so that what is kept meets it.
        assert!(at(940, Some(900)) < 1.0 && at(950, Some(900)) == 1.0);
        let none = Recipe { budget: false, ..config.clone() };
        assert_eq!(tightened(&none, 0, None), 1.0);
        assert_eq!(tightened(&Recipe { budget_ramp: 0.0, ..config }, 0, None), 1.0);
    }
}
