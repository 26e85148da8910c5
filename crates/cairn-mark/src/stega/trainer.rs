//! Stage 2: the marked field and what recovers its signals, trained together.
//!
//! A step takes marked renders of some identities and as many unmarked
//! pictures (`renders`), runs classifier and detector, and pushes the loss's
//! gradient with respect to the pictures back through the views' fixed linear
//! maps into the carriers (`moves`; deferred back-propagation), or along rays marched
//! anew where `mark.density` is free. Like stage 1, a step reads no clock and no file and draws only from its
//! seed.

use crate::detect::blind::detector::Detector;
use crate::detect::blind::networks::{Networks, planar};
use crate::error::MarkError;
use crate::marked::MarkedField;
use crate::payload::{HeadSizes, Numbers, Signal};
use crate::stega::ahead::Ahead;
use crate::stega::bank::BankView;
use crate::stega::carrier::{Carrier, hues};
use crate::stega::checkpoint::fingerprint;
use crate::stega::growth::Restarted;
use crate::stega::judge::{Judgement, State};
use crate::stega::losses::Losses;
use crate::stega::poses::PlannedView;
use crate::stega::recipe::Recipe;
use crate::stega::renders::Render;
use crate::stega::site::{MarkScene, Site};
use cairn_field::Field;
use cairn_nn::{Adam, AdamConfig, Average, NnError, Rate};
use cairn_scene::Picture8;
use cairn_scene::cluster::Clusters;
use candle_core::{Device, Var};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::sync::Arc;

/// What stage 2 is to do in a scene.
#[derive(Clone, Debug)]
pub struct MarkPlan {
    /// Which poses are whose; of its views only the rule for poses is used.
    pub clusters: Clusters,
    /// The training views: cameras and appearances. Held-out views have no place here.
    pub views: Vec<PlannedView>,
    /// What each identity hides, identity 1 first.
    pub signals: Vec<Signal>,
    /// Photographs (and any other unmarked pictures) to be silent on; as long as the plan lives, so in 8 bits.
    pub negatives: Vec<Picture8>,
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkStats {
    /// Steps done, this one included.
    pub step: u64,
    /// Steps in all.
    pub total: u64,
    /// Weighted sum of the losses below (equation 5), each times its weight; where `mark.guidance` is
    /// `no_classifier`, without the classification. With `mark.loss_per_render` all of them are means over the step's renders.
    pub loss: f64,
    /// Cross-entropy, nats (equation 3): the mean over the step's pictures, or with `mark.loss_per_render` the mean over
    /// theta's and that over theta_0's together.
    pub classify: f64,
    /// Recovery error (equation 1); 0 while the classifier trains alone.
    pub recover: f64,
    /// What is said where nothing is hidden (equation 2); 0 while the classifier trains alone.
    pub empty: f64,
    /// Picture loss (equation 4), summed over the step's renders (their mean with `mark.loss_per_render`), as much of it as
    /// counts: under a budget as much as marks are read with ease, else all of it. Its gradient is written out (`moves`), not walked back to.
    pub picture: f64,
    /// PSNR of theta's renders against theta_0's, dB, over this step's renders.
    pub kept_db: f64,
}

/// How far the budget tightens at most while the detector waits for marks to be read.
const UNREAD: f64 = 0.5;
/// Share of the steps that have to be left where the detector joins.
const MIN_LEFT: f64 = 0.02;
/// Marked renders a step that there are at most for the sake of many identities, as many as `mark.batch` may be: more
/// of them take turns.
const MAX_FOR_ALL: usize = 64;

/// Trains a marked field, a detector and a classifier; see the module's text.
pub struct MarkTrainer {
    pub(crate) config: Recipe,
    pub(crate) seed: u64,
    pub(crate) step: u64,
    /// Running mean of how far from read marks are (`Losses::unread`), and after which step the detector joined, if it has.
    pub(crate) unread: f64,
    pub(crate) joined: Option<u64>,
    /// The scenes, most often one. Identities and carriers are counted through all of them.
    pub(crate) sites: Vec<Site>,
    /// The next fresh view of each scene, by its number and the view's.
    pub(crate) ahead: Ahead<(usize, u64), BankView>,
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
    pub(crate) best: Option<State>,
    /// Whether the last judged state was good enough to end.
    pub(crate) enough: bool,
    /// Set once recovery has converged.
    pub(crate) converged: bool,
}

impl MarkTrainer {
    /// Prepares stage 2 of one scene: works out every view's ray weights (the slow part).
    /// Before each view `progress` hears how many are done and how many there are;
    /// where it answers false, preparing stops.
    ///
    /// # Errors
    /// [`MarkError::Setting`]; [`MarkError::Plan`] for a cluster without training
    /// views, another number of signals than clusters, or a signal that cannot be
    /// hidden; [`MarkError::Stopped`].
    pub fn new(
        field: Arc<Field>,
        plan: MarkPlan,
        config: Recipe,
        seed: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        Self::joint(vec![MarkScene::new(field, plan)], config, seed, progress)
    }

    /// As [`MarkTrainer::new`], for several scenes with one detector and one classifier
    /// (the paper's case II). Classes count the first scene's identities, then the
    /// second's, and so on; scenes that hide the same are "one for all".
    ///
    /// # Errors
    /// As [`MarkTrainer::new`]; [`MarkError::Plan`] for no scene at all.
    pub fn joint(
        scenes: Vec<MarkScene>,
        config: Recipe,
        seed: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        let fingerprint = fingerprint(&scenes)?;
        Self::prepared((scenes, fingerprint), config, (seed, 0), progress)
    }

    /// As [`MarkTrainer::joint`], with the plans' fingerprint known, and the views that are there after `step` steps.
    pub(crate) fn prepared(
        (scenes, fingerprint): (Vec<MarkScene>, String),
        config: Recipe,
        (seed, step): (u64, u64),
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        config.validate()?;
        let hidden: Vec<Signal> = scenes.iter().flat_map(|s| s.plan.signals.clone()).collect();
        let sites = Site::all(scenes, &config, (seed, step), progress)?;
        let heads = HeadSizes::of(&hidden, &config);
        let hues = hues(sites.last().map_or(0, |s| s.carriers.end), &[]);
        let pattern = |site: &Site, i: usize| site.pattern(&config, seed, (i, hues[i]));
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
            ahead: Ahead::new(),
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

    /// Steps done.
    pub fn steps_done(&self) -> u64 {
        self.step
    }

    /// The settings it trains by: after a resume those that it was begun with.
    pub fn config(&self) -> &Recipe {
        &self.config
    }

    /// The settings of scene number `at` (from 0), which there is: the training's, with those that it has to itself.
    pub fn config_of(&self, at: usize) -> &Recipe {
        &self.sites[at].config
    }

    /// Steps in all; those done once training has converged.
    pub fn steps_total(&self) -> u64 {
        if self.converged { self.step } else { self.config.steps }
    }

    /// Takes one step. After the last one, does nothing but report.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when a number went wrong; the state is then the last good one.
    pub fn step(&mut self) -> Result<MarkStats, MarkError> {
        if self.step >= self.steps_total() {
            return Ok(self.stats(0.0, &Losses::default(), (0.0, f64::INFINITY)));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream((1 << 32) + self.step);
        let shown = self.marked_renders(&mut rng);
        let (mut pictures, renders) = (shown.marked, shown.renders);
        let mut noisy: Vec<bool> = renders.iter().map(|render| render.noisy).collect();
        // A twin has its render's noise.
        noisy.extend_from_within(..shown.twins.len());
        pictures.extend(shown.twins);
        let side = self.config.shown_px();
        let mut others = Vec::with_capacity(self.batch());
        for _ in 0..self.batch() {
            let attack = self.attack_on_unmarked(&mut rng);
            let other = self.any_site(&mut rng).bank.unmarked(side, &attack, self.joined.is_some(), &mut rng);
            others.push((other, self.tone(&mut rng)));
        }
        others.par_iter_mut().for_each(|(other, tone)| tone.apply(other, side));
        for (other, tone) in others {
            noisy.push(tone.is_noisy());
            pictures.push(other);
        }
        let images = Var::from_vec(planar(&pictures), (pictures.len(), 3, side, side), &Device::Cpu)?;
        let (loss, parts) = self.loss(&images, (&renders, &noisy))?;
        let value = f64::from(loss.to_scalar::<f32>()?);
        if !value.is_finite() {
            return Err(MarkError::NotFinite { step: Some(self.step), place: "the loss".into() });
        }
        let grads = loss.backward()?;
        let slopes = grads
            .get(&images)
            .ok_or_else(|| MarkError::Plan("the loss does not depend on the pictures; raise its weights".into()))?
            .clone();
        // Everything that can refuse the step comes before anything moves.
        let owed = self.owe(&renders, &slopes).and_then(|owed| {
            self.adam.step(&self.networks.params, &grads).map_err(|e| self.refused(e))?;
            Ok(owed)
        });
        let owed = owed.inspect_err(|_| self.carriers.iter_mut().for_each(Carrier::forget))?;
        self.move_carriers(&owed);
        self.average.take_in(&self.networks.params)?;
        self.hear(&renders, &parts.each);
        if let Some(now) = parts.unread {
            self.unread = if self.unread.is_finite() { 0.9 * self.unread + 0.1 * now } else { now };
        }
        self.step += 1;
        // Later, neither the budget nor the detector would have steps enough.
        let left = self.config.steps - self.step;
        let in_time = left as f64 >= MIN_LEFT * self.config.steps as f64 || self.step == 1;
        if self.joined.is_none() && in_time && self.unread < self.config.classify_until {
            self.joined = Some(self.step);
        }
        self.renew();
        let value = value + self.config.weight_picture * owed.picture;
        Ok(self.stats(value, &parts, (owed.picture, owed.kept_db)))
    }

    /// A virtual view of each scene gives its place to a fresh one where the step just taken makes it time to.
    fn renew(&mut self) {
        for (at, Site { scene, config, bank, .. }) in self.sites.iter_mut().enumerate() {
            let last = config.fresh_after(config.steps);
            for k in config.fresh_after(self.step - 1)..config.fresh_after(self.step) {
                bank.renew(scene, config, (k, self.ahead.take(&(at, k))));
                let next = (k + 1 < last).then(|| bank.fresh(scene, config, k + 1)).flatten();
                next.into_iter().for_each(|work| self.ahead.begin((at, k + 1), work));
            }
        }
    }

    /// The first scene's marked field and the detector at the best state judged so far (where
    /// none was, the present marks and the networks' mean over the last steps).
    ///
    /// # Errors
    /// [`MarkError::NotLearnt`] when the marks were never read well enough for the
    /// detector to train; [`MarkError`] when the parts cannot be put together.
    pub fn finish(self) -> Result<(MarkedField, Detector), MarkError> {
        let (mut fields, detector) = self.finish_joint(&mut |_, _| true)?;
        Ok((fields.swap_remove(0), detector))
    }

    /// As [`MarkTrainer::finish`], each scene's marked field in their order. What marked renders look like is learnt
    /// first, from some hundred of each owner: again and again `progress` hears how many are done and about how many
    /// there are; where it answers false, nothing comes of it, and a checkpoint of before has to be resumed.
    ///
    /// # Errors
    /// As [`MarkTrainer::finish`]; [`MarkError::Stopped`].
    pub fn finish_joint(
        mut self,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(Vec<MarkedField>, Detector), MarkError> {
        if self.joined.is_none() {
            let (steps, classify, until) = (self.step, self.unread, self.config.classify_until);
            return Err(MarkError::NotLearnt { steps, classify, until });
        }
        self.average.swap(&self.networks.params)?;
        if let Some(best) = self.best.take() {
            self.networks.params.load(&best.params)?;
            for (carrier, values) in self.carriers.iter_mut().zip(best.carriers) {
                *carrier = Carrier::from_values(carrier.shape, values);
            }
        }
        self.networks.familiar = self.familiar(progress)?;
        let mut carriers = self.carriers.into_iter().map(|c| c.values);
        let (mut fields, kind) = (Vec::new(), (self.config.carrier, self.config.density));
        for Site { scene: MarkScene { field, plan, .. }, carriers: own, .. } in self.sites {
            let own = carriers.by_ref().take(own.len()).collect();
            fields.push(MarkedField::new(field, plan.clusters, kind, own)?);
        }
        Ok((fields, Detector::new(self.config, self.networks)))
    }

    /// Takes in how the step's `renders` and their twins were told; `each` has first those, then these.
    fn hear(&mut self, renders: &[Render], each: &[f32]) {
        let (marked, twins) = each.split_at(renders.len());
        let heard = renders.iter().zip(marked).zip(twins).take(self.batch());
        for ((render, marked), twin) in heard.filter(|((render, _), _)| !render.noisy) {
            self.sites[render.site].bank.draws.hear(render.view, 0.5 * (marked + twin));
        }
    }

    /// After how many steps marks were read well enough for the detector to join, if they have been.
    pub fn joined_at(&self) -> Option<u64> {
        self.joined
    }

    /// Heads that had to start afresh where identities came later, since they are longer or shorter than they were.
    pub fn restarted(&self) -> &[Restarted] {
        &self.restarted
    }

    /// The best judgement so far.
    pub fn best(&self) -> Option<&Judgement> {
        self.best.as_ref().map(|b| &b.judgement)
    }

    fn stats(&self, loss: f64, parts: &Losses, (picture, kept_db): (f64, f64)) -> MarkStats {
        let (step, total) = (self.step, self.steps_total());
        let Losses { classify, recover, empty, .. } = *parts;
        MarkStats { step, total, loss, classify, recover, empty, picture, kept_db }
    }

    /// The step's error for an optimiser that refused a gradient.
    fn refused(&self, error: NnError) -> MarkError {
        match error {
            NnError::Gradient { name, .. } => {
                MarkError::NotFinite { step: Some(self.step), place: format!("the gradient of `{name}`") }
            }
            error => error.into(),
        }
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
