//! Stage 2: the marked field and what recovers its signals, trained together.
//!
//! A step takes marked renders of some identities and as many unmarked
//! pictures, runs classifier and detector, and pushes the loss's gradient with
//! respect to the pictures back through the views' fixed linear maps into the
//! carriers (deferred back-propagation). Density never moves. Like stage 1, a
//! step reads no clock and no file and draws only from its seed.

use crate::bank::Bank;
use crate::carrier::{Carrier, Move};
use crate::config::{CarrierKind, LossKind, MarkConfig};
use crate::detector::Detector;
use crate::error::MarkError;
use crate::judge::{Judgement, State};
use crate::marked::MarkedField;
use crate::mask::gradient_mask;
use crate::networks::{Networks, interleaved, planar};
use crate::poses::PlannedView;
use crate::window::Window;
use cairn_capture::Picture;
use cairn_cluster::Clusters;
use cairn_field::operator::CarrierBasis;
use cairn_field::{Appearance, Field};
use cairn_nn::{Adam, AdamConfig, Rate, cross_entropy, mean_absolute, mean_squared, softmax};
use candle_core::{Device, Tensor, Var};
use rand::{RngExt, SeedableRng};
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
    /// One hidden picture an identity, identity 1 first; brought to the detector's size.
    pub signals: Vec<Picture>,
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
    /// Hidden pictures, `side x side x 3`, identity 1 first.
    pub(crate) signals: Vec<Vec<f32>>,
    pub(crate) bank: Bank,
    mask: Vec<f32>,
    pub(crate) carriers: Vec<Carrier>,
    pub(crate) networks: Networks,
    pub(crate) adam: Adam,
    pub(crate) best: Option<State>,
    /// Set once recovery has converged.
    pub(crate) converged: bool,
}

/// A marked render of this step.
struct Marked {
    identity: usize,
    view: usize,
    appearance: Appearance,
    /// Marked minus base, `height x width x 3`.
    change: Vec<f32>,
    /// Whether each number is inside [0, 1], where a gradient passes.
    inside: Vec<bool>,
    window: Window,
    gain: f32,
}

impl MarkTrainer {
    /// Prepares stage 2: works out every view's ray weights (the slow part).
    ///
    /// # Errors
    /// [`MarkError::Setting`], or [`MarkError::Plan`] for a cluster without
    /// training views or another number of signals than clusters.
    pub fn new(field: Arc<Field>, plan: MarkPlan, config: MarkConfig, seed: u64) -> Result<Self, MarkError> {
        config.validate()?;
        let identities = plan.clusters.clusters.len();
        if plan.signals.len() != identities {
            let got = plan.signals.len();
            return Err(MarkError::Plan(format!("{got} signals for {identities} identities; bring one for each")));
        }
        let side = config.side_px();
        let signals = plan.signals.iter().map(|p| crate::negatives::shrunk(p, side)).collect();
        let bank = Bank::new(&field, &plan, &config, seed)?;
        let (basis, count) = match config.carrier {
            CarrierKind::PerCluster => (CarrierBasis::Constant, identities),
            CarrierKind::Harmonics => (CarrierBasis::Harmonics, 1),
        };
        let amplitude = 10f32.powf(-config.budget_start_db as f32 / 20.0);
        let carriers =
            (0..count).map(|i| Carrier::pattern(field.as_ref(), basis, seed, (i, count), amplitude)).collect();
        let mask = gradient_mask(config.mask, config.mask_alpha, config.mask_least, field.as_ref(), basis);
        let networks = Networks::new(&config, identities + 1, seed)?;
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
            joined: false,
            field,
            plan,
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
        let (mut pictures, twins, marked) = self.marked_renders(&mut rng);
        pictures.extend(twins);
        for _ in 0..marked.len() {
            let mut other = self.bank.unmarked(self.config.side_px(), &mut rng);
            Tone::draw(&mut rng).apply(&mut other);
            pictures.push(other);
        }
        let side = self.config.side_px();
        let images = Var::from_vec(planar(&pictures), (pictures.len(), 3, side, side), &Device::Cpu)?;
        let (loss, classify, recover) = self.loss(&images, &marked)?;
        let value = f64::from(loss.to_scalar::<f32>()?);
        if !value.is_finite() {
            return Err(MarkError::NotFinite { step: self.step, place: "the loss".into() });
        }
        let grads = loss.backward()?;
        let slopes = grads
            .get(&images)
            .ok_or_else(|| MarkError::Plan("the loss does not depend on the pictures; raise its weights".into()))?
            .clone();
        self.adam.step(&self.networks.params, &grads)?;
        let kept_db = self.move_carriers(&marked, &slopes)?;
        self.classify = if self.classify.is_finite() { 0.9 * self.classify + 0.1 * classify } else { classify };
        self.joined |= self.classify < self.config.classify_until;
        self.step += 1;
        Ok(self.stats(value, classify, recover, kept_db))
    }

    /// The marked field and the detector at the best state judged so far (the
    /// present one where none was).
    ///
    /// # Errors
    /// [`MarkError`] when the parts cannot be put together.
    pub fn finish(mut self) -> Result<(MarkedField, Detector), MarkError> {
        if let Some(best) = self.best.take() {
            self.networks.params.load(&best.params)?;
            for (carrier, values) in self.carriers.iter_mut().zip(best.carriers) {
                carrier.values = values;
            }
        }
        let carriers = self.carriers.into_iter().map(|c| c.values).collect();
        let marked = MarkedField::new(self.field, self.plan.clusters, self.config.carrier, carriers)?;
        Ok((marked, Detector::new(self.config, self.networks)))
    }

    /// The best judgement so far.
    pub fn best(&self) -> Option<&Judgement> {
        self.best.as_ref().map(|b| &b.judgement)
    }

    fn stats(&self, loss: f64, classify: f64, recover: f64, kept_db: f64) -> MarkStats {
        MarkStats { step: self.step, total: self.steps_total(), loss, classify, recover, kept_db }
    }

    /// Steps after which the budget stands at its final value.
    pub(crate) fn ramp_steps(&self) -> u64 {
        (self.config.steps as f64 * self.config.budget_ramp) as u64
    }

    /// How close to the base field's renders must be kept in this step, dB.
    fn budget_now_db(&self) -> f64 {
        let share = (self.step as f64 / self.ramp_steps().max(1) as f64).min(1.0);
        self.config.budget_start_db + (self.config.budget_db - self.config.budget_start_db) * share
    }

    /// How surely marks are read, 0 to 1: the cross-entropy's distance below
    /// `classify_until`. 0 until the detector has joined.
    pub(crate) fn ease(&self) -> f32 {
        let below = 1.0 - self.classify / self.config.classify_until.max(1e-9);
        if self.joined { below.clamp(0.0, 1.0) as f32 } else { 0.0 }
    }

    /// Which carrier identity `i` (from 0) is in.
    pub(crate) fn carrier_of(&self, i: usize) -> usize {
        i % self.carriers.len()
    }

    /// Renders one view of each of `batch` identities, as the networks see them:
    /// marked, and the same without the mark.
    fn marked_renders(&self, rng: &mut ChaCha8Rng) -> (Vec<Vec<f32>>, Vec<Vec<f32>>, Vec<Marked>) {
        let side = self.config.side_px();
        let identities = self.signals.len();
        let first = (self.step as usize * self.config.batch) % identities;
        let (mut pictures, mut twins, mut all) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..self.config.batch {
            let identity = (first + k) % identities;
            // Now and then on a view of somebody else's: the class must come
            // from the mark and not from what the view shows.
            let stranger = self.carriers.len() > 1 && rng.random_range(0..3) == 0;
            let whose = if stranger { rng.random_range(0..identities) } else { identity };
            let view = self.bank.draw(whose, rng);
            let appearance = self.bank.appearance(view, rng);
            let entry = &self.bank.views[view];
            let mut base = entry.linear.base(&appearance);
            let mut picture = base.clone();
            let carrier = &self.carriers[self.carrier_of(identity)];
            entry.linear.apply(&carrier.values, carrier.basis, &appearance, &mut picture);
            let change = picture.iter().zip(&base).map(|(a, b)| a - b).collect();
            let inside = picture.iter().map(|v| (0.0..=1.0).contains(v)).collect();
            picture.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
            let window = Window::draw(entry.linear.width(), entry.linear.height(), side, rng);
            base.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
            let tone = Tone::draw(rng);
            for (list, full) in [(&mut pictures, &picture), (&mut twins, &base)] {
                let mut seen = window.apply(full);
                tone.apply(&mut seen);
                list.push(seen);
            }
            all.push(Marked { identity, view, appearance, change, inside, window, gain: tone.gain });
        }
        (pictures, twins, all)
    }

    /// Equation 5 without its picture term, which needs no network.
    fn loss(&self, images: &Var, marked: &[Marked]) -> Result<(Tensor, f64, f64), MarkError> {
        let (n, side) = (marked.len(), self.config.side_px());
        let mut classes: Vec<u32> = marked.iter().map(|m| m.identity as u32 + 1).collect();
        let unmarked = images.dims()[0] - n;
        classes.resize(n + unmarked, 0);
        let logits = self.networks.classifier.forward(images)?;
        let cross = cross_entropy(&logits, &classes)?;
        let classify = f64::from(cross.to_scalar::<f32>()?);
        let weighted = (cross * self.config.weight_classify)?;
        if !self.joined {
            return Ok((weighted, classify, 0.0));
        }
        // Detached: recovery must not teach the classifier what to say. The gate
        // silences most unmarked pictures by itself: one twin and one other
        // picture a step suffice, and the detector is the costly network.
        let told = softmax(&logits)?.detach();
        let shown = if self.config.recover_moves_marks { images.as_tensor().clone() } else { images.detach() };
        let (first, last) = (shown.narrow(0, 0, n + 1)?, shown.narrow(0, n + unmarked - 1, 1)?);
        let seen = Tensor::cat(&[&first, &last], 0)?;
        let told = Tensor::cat(&[&told.narrow(0, 0, n + 1)?, &told.narrow(0, n + unmarked - 1, 1)?], 0)?;
        let hidden = self.networks.detector.forward(&seen, &told)?;
        let truth: Vec<Vec<f32>> = marked.iter().map(|m| self.signals[m.identity].clone()).collect();
        let truth = Tensor::from_vec(planar(&truth), (n, 3, side, side), &Device::Cpu)?;
        let distance = match self.config.loss {
            LossKind::Absolute => mean_absolute,
            LossKind::Squared => mean_squared,
        };
        let plus = distance(&hidden.narrow(0, 0, n)?, &truth)?;
        let rest = hidden.narrow(0, n, 2)?;
        let minus = distance(&rest, &rest.zeros_like()?)?;
        let recover = f64::from(plus.to_scalar::<f32>()?);
        let total = ((weighted + (plus * self.config.weight_recover)?)? + (minus * self.config.weight_empty)?)?;
        Ok((total, classify, recover))
    }

    /// Pushes the pictures' gradients into the carriers, moves them, and brings
    /// back any whose renders stray further than the budget. Returns the PSNR of
    /// this step's renders against the base field's, dB.
    fn move_carriers(&mut self, marked: &[Marked], slopes: &Tensor) -> Result<f64, MarkError> {
        let mut worst = vec![0.0f64; self.carriers.len()];
        let mut used = vec![false; self.carriers.len()];
        let mut mean = 0.0;
        // A mark may fade only as far as it is read with ease.
        let ease = self.ease();
        for (i, m) in marked.iter().enumerate() {
            let small = interleaved(&slopes.get(i)?.flatten_all()?.to_vec1::<f32>()?);
            let mut slope = m.window.transpose(&small);
            let keep = ease * self.config.weight_picture as f32 / m.change.len() as f32;
            for ((s, change), inside) in slope.iter_mut().zip(&m.change).zip(&m.inside) {
                let own = match self.config.picture_loss {
                    LossKind::Absolute => change.signum() * f32::from(*change != 0.0),
                    LossKind::Squared => 2.0 * change,
                };
                *s = if *inside { *s * m.gain } else { 0.0 } + keep * own;
            }
            let at = self.carrier_of(m.identity);
            let entry = &self.bank.views[m.view];
            self.carriers[at].owe(&entry.linear, &slope, &m.appearance);
            let square = m.change.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / m.change.len() as f64;
            worst[at] = worst[at].max(square);
            used[at] = true;
            mean += square / marked.len() as f64;
        }
        let decay = self.config.final_rate.powf(self.step as f64 / self.config.steps as f64) as f32;
        let how = Move {
            mask: &self.mask,
            rate: self.config.learning_rate_carrier as f32 * decay,
            pull: ease * self.config.pull as f32,
        };
        let allowed = 10f64.powf(-self.budget_now_db() / 10.0);
        for (i, carrier) in self.carriers.iter_mut().enumerate().filter(|(i, _)| used[*i]) {
            carrier.step(&how)?;
            // Until they are read with ease, marks are held at the budget.
            if worst[i] > allowed || (ease < 0.5 && worst[i] > 0.0) {
                carrier.scale((allowed / worst[i]).sqrt() as f32);
            }
        }
        Ok(-10.0 * mean.max(1e-20).log10())
    }
}

/// What cameras, screens and files do to a picture without harm: a little
/// brightness and contrast, the noise of eight bits.
struct Tone {
    gain: f32,
    shift: f32,
    noise: f32,
    seed: u64,
}

impl Tone {
    fn draw(rng: &mut ChaCha8Rng) -> Self {
        Self {
            gain: rng.random_range(0.9..1.1),
            shift: rng.random_range(-0.05..0.05),
            noise: rng.random_range(0.0..1.5 / 255.0),
            seed: rng.random(),
        }
    }

    /// The same on every picture it is applied to, noise included: a marked
    /// render and its twin shall differ by the mark alone.
    fn apply(&self, picture: &mut [f32]) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        for v in picture.iter_mut() {
            *v = 0.5 + (*v - 0.5) * self.gain + self.shift + self.noise * rng.random_range(-1.0f32..1.0);
        }
    }
}
