//! Stage 2: the marked field and what recovers its signals, trained together.
//!
//! A step takes marked renders of some identities and as many unmarked
//! pictures (`renders`), runs classifier and detector, and pushes the loss's
//! gradient with respect to the pictures back through the views' fixed linear
//! maps into the carriers (`moves`; deferred back-propagation), or along rays marched
//! anew where `mark.density` is free. Like stage 1, a step reads no clock and no file and draws only from its
//! seed.

use crate::bank::Bank;
use crate::carrier::Carrier;
use crate::checkpoint::fingerprint;
use crate::config::{CarrierKind, Guidance, MarkConfig};
use crate::detector::Detector;
use crate::error::MarkError;
use crate::judge::{Judgement, State};
use crate::marked::MarkedField;
use crate::networks::{Networks, planar};
use crate::poses::PlannedView;
use crate::renders::Tone;
use crate::shape::{CarrierShape, carrier_mask};
use crate::signal::{HeadSizes, Numbers, Signal};
use cairn_capture::Picture;
use cairn_cluster::Clusters;
use cairn_field::Field;
use cairn_nn::{Adam, AdamConfig, NnError, Rate};
use candle_core::{Device, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// What stage 2 is to do.
#[derive(Clone, Debug)]
pub struct MarkPlan {
    /// Which poses are whose. Built over the training views or over all: only
    /// its rule for poses is used.
    pub clusters: Clusters,
    /// The training views: cameras and appearances. Held-out views have no place here.
    pub views: Vec<PlannedView>,
    /// What each identity hides, identity 1 first.
    pub signals: Vec<Signal>,
    /// Photographs (and any other unmarked pictures) to be silent on.
    pub negatives: Vec<Picture>,
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkStats {
    /// Steps done, this one included.
    pub step: u64,
    /// Steps in all.
    pub total: u64,
    /// Weighted sum of all losses (equation 5).
    pub loss: f64,
    /// Cross-entropy, nats (equation 3).
    pub classify: f64,
    /// Recovery error (equation 1); 0 while the classifier trains alone.
    pub recover: f64,
    /// PSNR of theta's renders against theta_0's, dB, over this step's renders.
    pub kept_db: f64,
}

/// Trains a marked field, a detector and a classifier; see the module's text.
pub struct MarkTrainer {
    pub(crate) config: MarkConfig,
    pub(crate) seed: u64,
    pub(crate) step: u64,
    /// Running mean of the cross-entropy, and whether the detector has joined.
    pub(crate) classify: f64,
    pub(crate) joined: bool,
    pub(crate) field: Arc<Field>,
    pub(crate) plan: MarkPlan,
    /// The plan's and the field's digest, which a checkpoint must meet again.
    pub(crate) fingerprint: String,
    /// What the heads are to say of each identity, identity 1 first.
    pub(crate) signals: Vec<Numbers>,
    pub(crate) bank: Bank,
    pub(crate) mask: Vec<f32>,
    pub(crate) carriers: Vec<Carrier>,
    pub(crate) networks: Networks,
    pub(crate) adam: Adam,
    pub(crate) best: Option<State>,
    /// Set once recovery has converged.
    pub(crate) converged: bool,
}

impl MarkTrainer {
    /// Prepares stage 2: works out every view's ray weights (the slow part).
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
        config: MarkConfig,
        seed: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        let fingerprint = fingerprint(&plan, &field)?;
        Self::prepared(field, (plan, fingerprint), config, seed, progress)
    }

    /// As [`MarkTrainer::new`], with the plan's fingerprint known.
    pub(crate) fn prepared(
        field: Arc<Field>,
        (plan, fingerprint): (MarkPlan, String),
        config: MarkConfig,
        seed: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        config.validate()?;
        let identities = plan.clusters.clusters.len();
        if plan.signals.len() != identities {
            let got = plan.signals.len();
            return Err(MarkError::Plan(format!("{got} signals for {identities} identities; bring one for each")));
        }
        (1..).zip(&plan.signals).try_for_each(|(number, signal)| signal.check(number, &config))?;
        let heads = HeadSizes::of(&plan.signals, &config);
        let signals = plan.signals.iter().map(|s| Numbers::of(s, &heads, config.side_px())).collect();
        let bank = Bank::new(&field, &plan, &config, seed, progress)?;
        let shape = CarrierShape::of(config.carrier, config.density);
        let count = if config.carrier == CarrierKind::PerCluster { identities } else { 1 };
        let amplitude = 10f32.powf(-config.budget_start_db as f32 / 20.0);
        let carriers =
            (0..count).map(|i| Carrier::pattern(field.as_ref(), shape, seed, (i, count), amplitude)).collect();
        let mask = carrier_mask(&config, field.as_ref(), shape);
        let networks = Networks::new(&config, identities + 1, heads, seed)?;
        let rate = Rate::falling(
            config.learning_rate_networks,
            config.learning_rate_networks * config.final_rate,
            config.steps,
        );
        Ok(Self {
            adam: Adam::new(AdamConfig::default(), rate)?,
            seed,
            step: 0,
            classify: f64::INFINITY,
            // Without a classifier there is nothing to wait for.
            joined: config.guidance == Guidance::NoClassifier,
            field,
            plan,
            fingerprint,
            signals,
            bank,
            mask,
            carriers,
            networks,
            best: None,
            converged: false,
            config,
        })
    }

    /// Steps done.
    pub fn steps_done(&self) -> u64 {
        self.step
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
            return Ok(self.stats(0.0, 0.0, 0.0, f64::INFINITY));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream((1 << 32) + self.step);
        let shown = self.marked_renders(&mut rng);
        let (mut pictures, renders) = (shown.marked, shown.renders);
        pictures.extend(shown.twins);
        for _ in 0..self.config.batch {
            let attack = self.attack(&mut rng);
            let mut other = self.bank.unmarked(self.config.side_px(), &attack, &mut rng);
            Tone::draw(&mut rng).apply(&mut other);
            pictures.push(other);
        }
        let side = self.config.side_px();
        let images = Var::from_vec(planar(&pictures), (pictures.len(), 3, side, side), &Device::Cpu)?;
        let (loss, classify, recover) = self.loss(&images, &renders)?;
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
        self.classify = if self.classify.is_finite() { 0.9 * self.classify + 0.1 * classify } else { classify };
        self.joined |= self.classify < self.config.classify_until;
        self.step += 1;
        Ok(self.stats(value, classify, recover, owed.kept_db))
    }

    /// The marked field and the detector at the best state judged so far (the
    /// present one where none was).
    ///
    /// # Errors
    /// [`MarkError::NotLearnt`] when the marks were never read well enough for the
    /// detector to train; [`MarkError`] when the parts cannot be put together.
    pub fn finish(mut self) -> Result<(MarkedField, Detector), MarkError> {
        if !self.joined {
            let (steps, classify, until) = (self.step, self.classify, self.config.classify_until);
            return Err(MarkError::NotLearnt { steps, classify, until });
        }
        if let Some(best) = self.best.take() {
            self.networks.params.load(&best.params)?;
            for (carrier, values) in self.carriers.iter_mut().zip(best.carriers) {
                carrier.values = values;
            }
        }
        let carriers = self.carriers.into_iter().map(|c| c.values).collect();
        let marked =
            MarkedField::new(self.field, self.plan.clusters, (self.config.carrier, self.config.density), carriers)?;
        Ok((marked, Detector::new(self.config, self.networks)))
    }

    /// The best judgement so far.
    pub fn best(&self) -> Option<&Judgement> {
        self.best.as_ref().map(|b| &b.judgement)
    }

    fn stats(&self, loss: f64, classify: f64, recover: f64, kept_db: f64) -> MarkStats {
        MarkStats { step: self.step, total: self.steps_total(), loss, classify, recover, kept_db }
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

    /// Steps after which the budget stands at its final value; 0 where there is none.
    pub(crate) fn ramp_steps(&self) -> u64 {
        if self.config.budget { (self.config.steps as f64 * self.config.budget_ramp) as u64 } else { 0 }
    }

    /// How close to the base field's renders must be kept in this step, dB.
    pub(crate) fn budget_now_db(&self) -> f64 {
        let share = (self.step as f64 / self.ramp_steps().max(1) as f64).min(1.0);
        self.config.budget_start_db + (self.config.budget_db - self.config.budget_start_db) * share
    }

    /// How surely marks are read, 0 to 1: the cross-entropy's distance below
    /// `classify_until`. 0 until the detector has joined.
    pub(crate) fn ease(&self) -> f32 {
        let below = 1.0 - self.classify / self.config.classify_until;
        if self.joined { below.clamp(0.0, 1.0) as f32 } else { 0.0 }
    }

    /// Which carrier identity `i` (from 0) is in.
    pub(crate) fn carrier_of(&self, i: usize) -> usize {
        i % self.carriers.len()
    }
}
