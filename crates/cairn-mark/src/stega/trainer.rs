//! Stage 2: the marked field and what recovers its signals, trained together.
//!
//! A step takes marked renders of some identities and as many unmarked
//! pictures (`sample`), runs classifier and detector (`forward`), and pushes the loss's
//! gradient with respect to the pictures back through the views' fixed linear
//! maps into the carriers (`backward`; deferred back-propagation), or along rays marched
//! anew where `mark.density` is free. Like stage 1, a step reads no clock and no file and draws only from its
//! seed.

use crate::detect::blind::detector::Detector;
use crate::error::MarkError;
use crate::marked::MarkedField;
use crate::stega::backward::{apply, backward};
use crate::stega::carrier::{Carrier, hue_of, hues};
use crate::stega::checkpoint;
use crate::stega::forward::{Losses, forward};
use crate::stega::growth::{Earlier, Restarted};
use crate::stega::judge::judge;
use crate::stega::judgement::Judgement;
use crate::stega::plan::{MarkPlan, MarkScene, fingerprint};
use crate::stega::recipe::Recipe;
use crate::stega::references::references;
use crate::stega::sample::{Render, attack_on_unmarked, marked_renders, tone};
use crate::stega::site::Site;
use crate::stega::state::State;
use crate::tensors::planar;
use cairn_field::Field;
use cairn_nn::{Average, NnError};
use candle_core::{Device, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::sync::Arc;

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
    /// counts: under a budget as much as marks are read with ease, else all of it. Its gradient is written out (`keep`), not walked back to.
    pub picture: f64,
    /// PSNR of theta's renders against theta_0's, dB, over this step's renders.
    pub kept_db: f64,
}

/// Share of the steps that have to be left where the detector joins.
const MIN_LEFT: f64 = 0.02;

/// Trains a marked field, a detector and a classifier; see the module's text.
pub struct MarkTrainer {
    state: State,
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
        Ok(Self { state: State::new(scenes, fingerprint, config, seed, 0, progress)? })
    }

    /// Steps done.
    pub fn steps_done(&self) -> u64 {
        self.state.step
    }

    /// The settings it trains by: after a resume those that it was begun with.
    pub fn config(&self) -> &Recipe {
        &self.state.config
    }

    /// The settings of scene number `at` (from 0), which there is: the training's, with those that it has to itself.
    pub fn config_of(&self, at: usize) -> &Recipe {
        &self.state.sites[at].config
    }

    /// Steps in all; those done once training has converged.
    pub fn steps_total(&self) -> u64 {
        self.state.steps_total()
    }

    /// Takes one step. After the last one, does nothing but report.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when a number went wrong; the state is then the last good one.
    pub fn step(&mut self) -> Result<MarkStats, MarkError> {
        step(&mut self.state)
    }

    /// Judges the present marks with the networks' mean over the last steps, and keeps them if
    /// they are the best so far. The caller decides when; a run that judges at the same steps gives the same
    /// bytes. Training counts as converged once everything is answered right twice in a row, with
    /// ease in training too (the few judged poses alone flatter), and the hidden
    /// signals are all good enough (`enough_ssim`, `enough_snr_db`, `enough_characters`). Without a classifier
    /// (`mark.guidance`) that and ease are all that is asked, and the best state is the one that recovers most.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when an answer is not finite; [`MarkError`] when the
    /// networks fail. The best state so far is then what it was.
    pub fn judge(&mut self) -> Result<Judgement, MarkError> {
        judge(&mut self.state)
    }

    /// As [`MarkTrainer::joint`], going on from an `earlier` training of some of the
    /// identities: their carriers stay as they are, and `mark.grow_share` of the steps are taken. A head whose length
    /// differs starts afresh ([`MarkTrainer::restarted`]).
    ///
    /// # Errors
    /// As [`MarkTrainer::joint`]; [`MarkError::Plan`] where the earlier training does not fit: other networks or
    /// base fields, carriers that are not one an identity, a class twice or beyond those there are, nothing
    /// new, or nothing known.
    pub fn growing(
        scenes: Vec<MarkScene>,
        earlier: &Earlier<'_>,
        mut config: Recipe,
        seed: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        config.validate()?;
        earlier.check(&scenes, &config)?;
        config.steps = ((config.steps as f64 * config.grow_share).ceil() as u64).max(1);
        let Self { mut state } = Self::joint(scenes, config, seed, progress)?;
        let mut class_of = vec![Some(0)];
        class_of.extend(earlier.identities.iter().map(|known| known.map(|k| k.class)));
        let fresh = state.networks.params.graft(earlier.detector.params(), &class_of)?;
        state.restarted = Restarted::among(&fresh, earlier.detector.heads(), state.networks.detector.sizes());
        state.average = Average::new(&state.networks.params, state.config.average)?;
        let taken: Vec<f32> = earlier.identities.iter().flatten().map(|known| hue_of(known.carrier)).collect();
        let mut free = hues(earlier.identities.len() - taken.len(), &taken).into_iter();
        for (i, known) in earlier.identities.iter().enumerate() {
            let site = &state.sites[state.site_of(i)];
            state.carriers[i] = match known {
                Some(known) => Carrier::from_values(state.carriers[i].shape, known.carrier.to_vec()),
                None => site.pattern(&state.config, seed, i, free.next().unwrap_or_default()),
            };
            state.settled[i] = known.is_some();
        }
        Ok(Self { state })
    }

    /// The whole state. Equal states give equal bytes.
    ///
    /// # Errors
    /// [`MarkError::Stored`] when it cannot be written out.
    pub fn checkpoint(&self) -> Result<Vec<u8>, MarkError> {
        checkpoint::write(&self.state)
    }

    /// Takes stage 2 of one scene up where `bytes` left it, on the same field and plan. Ray
    /// weights are worked out anew, with `progress` as in [`MarkTrainer::new`].
    ///
    /// # Errors
    /// [`MarkError::Stored`] for an unknown format, a damaged file, another plan or
    /// field; [`MarkError::Stopped`].
    pub fn resume(
        bytes: &[u8],
        field: Arc<Field>,
        plan: MarkPlan,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        Self::resume_joint(bytes, vec![MarkScene::new(field, plan)], progress)
    }

    /// As [`MarkTrainer::resume`], of several scenes in the order they were begun in.
    ///
    /// # Errors
    /// As [`MarkTrainer::resume`].
    pub fn resume_joint(
        bytes: &[u8],
        scenes: Vec<MarkScene>,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        Ok(Self { state: checkpoint::read(bytes, scenes, progress)? })
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
        self,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<(Vec<MarkedField>, Detector), MarkError> {
        let mut state = self.state;
        if state.joined.is_none() {
            let (steps, classify, until) = (state.step, state.unread, state.config.classify_until);
            return Err(MarkError::NotLearnt { steps, classify, until });
        }
        state.average.swap(&state.networks.params)?;
        if let Some(best) = state.best.take() {
            state.networks.params.load(&best.params)?;
            for (carrier, values) in state.carriers.iter_mut().zip(best.carriers) {
                *carrier = Carrier::from_values(carrier.shape, values);
            }
        }
        state.networks.out_of_distribution = references(&state, progress)?;
        let mut carriers = state.carriers.into_iter().map(|c| c.values);
        let mut fields = Vec::new();
        let Recipe { carrier, density, .. } = state.config;
        for Site { scene: MarkScene { field, plan, .. }, carriers: own, .. } in state.sites {
            let own = carriers.by_ref().take(own.len()).collect();
            fields.push(MarkedField::new(field, plan.clusters, carrier, density, own)?);
        }
        Ok((fields, Detector::new(state.config, state.networks)))
    }

    /// After how many steps marks were read well enough for the detector to join, if they have been.
    pub fn joined_at(&self) -> Option<u64> {
        self.state.joined
    }

    /// Heads that had to start afresh where identities came later, since they are longer or shorter than they were.
    pub fn restarted(&self) -> &[Restarted] {
        &self.state.restarted
    }

    /// The best judgement so far.
    pub fn best(&self) -> Option<&Judgement> {
        self.state.best.as_ref().map(|b| &b.judgement)
    }
}

/// One step of `state`; after the last one a report alone.
fn step(state: &mut State) -> Result<MarkStats, MarkError> {
    if state.step >= state.steps_total() {
        return Ok(stats(state, 0.0, &Losses::default(), 0.0, f64::INFINITY));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(state.seed);
    rng.set_stream((1 << 32) + state.step);
    let shown = marked_renders(state, &mut rng);
    let (mut pictures, renders) = (shown.marked, shown.renders);
    let mut noisy: Vec<bool> = renders.iter().map(|render| render.noisy).collect();
    // An unmarked pair has its render's noise.
    noisy.extend_from_within(..shown.pairs.len());
    pictures.extend(shown.pairs);
    let side = state.config.shown_px();
    let mut others = Vec::with_capacity(state.batch());
    for _ in 0..state.batch() {
        let attack = attack_on_unmarked(state, &mut rng);
        let other = state.any_site(&mut rng).bank.unmarked(side, &attack, state.joined.is_some(), &mut rng);
        others.push((other, tone(state, &mut rng)));
    }
    others.par_iter_mut().for_each(|(other, tone)| tone.apply(other, side));
    for (other, tone) in others {
        noisy.push(tone.is_noisy());
        pictures.push(other);
    }
    let images = Var::from_vec(planar(&pictures), (pictures.len(), 3, side, side), &Device::Cpu)?;
    let (loss, parts) = forward(state, &images, &renders, &noisy)?;
    let value = f64::from(loss.to_scalar::<f32>()?);
    if !value.is_finite() {
        return Err(MarkError::NotFinite { step: Some(state.step), place: "the loss".into() });
    }
    let grads = loss.backward()?;
    let slopes = grads
        .get(&images)
        .ok_or_else(|| MarkError::Plan("the loss does not depend on the pictures; raise its weights".into()))?
        .clone();
    // Everything that can refuse the step comes before anything moves.
    let owed = backward(state, &renders, &slopes).and_then(|owed| {
        state.adam.step(&state.networks.params, &grads).map_err(|e| refused(state.step, e))?;
        Ok(owed)
    });
    let owed = owed.inspect_err(|_| state.carriers.iter_mut().for_each(Carrier::forget))?;
    apply(state, &owed);
    state.average.take_in(&state.networks.params)?;
    hear(state, &renders, &parts.each);
    if let Some(now) = parts.unread {
        state.unread = if state.unread.is_finite() { 0.9 * state.unread + 0.1 * now } else { now };
    }
    state.step += 1;
    // Later, neither the budget nor the detector would have steps enough.
    let left = state.config.steps - state.step;
    let in_time = left as f64 >= MIN_LEFT * state.config.steps as f64 || state.step == 1;
    if state.joined.is_none() && in_time && state.unread < state.config.classify_until {
        state.joined = Some(state.step);
    }
    renew(state);
    let value = value + state.config.weight_picture * owed.picture;
    Ok(stats(state, value, &parts, owed.picture, owed.kept_db))
}

/// A virtual view of each scene gives its place to a fresh one where the step just taken makes it time to.
fn renew(state: &mut State) {
    for (at, Site { scene, config, bank, .. }) in state.sites.iter_mut().enumerate() {
        let last = config.fresh_after(config.steps);
        for k in config.fresh_after(state.step - 1)..config.fresh_after(state.step) {
            bank.renew(scene, config, k, state.prefetch.take(&(at, k)));
            let next = (k + 1 < last).then(|| bank.fresh(scene, config, k + 1)).flatten();
            next.into_iter().for_each(|work| state.prefetch.begin((at, k + 1), work));
        }
    }
}

/// Takes in how the step's `renders` and their pairs were told; `each` has first those, then these.
fn hear(state: &mut State, renders: &[Render], each: &[f32]) {
    let (marked, pairs) = each.split_at(renders.len());
    let heard = renders.iter().zip(marked).zip(pairs).take(state.batch());
    for ((render, marked), pair) in heard.filter(|((render, _), _)| !render.noisy) {
        state.sites[render.site].bank.draws.hear(render.view, 0.5 * (marked + pair));
    }
}

/// The report of a step.
fn stats(state: &State, loss: f64, parts: &Losses, picture: f64, kept_db: f64) -> MarkStats {
    let (step, total) = (state.step, state.steps_total());
    let Losses { classify, recover, empty, .. } = *parts;
    MarkStats { step, total, loss, classify, recover, empty, picture, kept_db }
}

/// The step's error for an optimiser that refused a gradient.
fn refused(step: u64, error: NnError) -> MarkError {
    match error {
        NnError::Gradient { name, .. } => {
            MarkError::NotFinite { step: Some(step), place: format!("the gradient of `{name}`") }
        }
        error => error.into(),
    }
}
