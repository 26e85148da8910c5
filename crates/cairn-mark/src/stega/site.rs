//! A scene's part in stage 2. Several scenes may be marked in one training, with one
//! detector and one classifier for all (the paper's case II): what they share is in
//! [`crate::MarkTrainer`], what each has to itself is here.

use crate::error::MarkError;
use crate::progress::Progress;
use crate::stega::bank::{Bank, Chosen, Prepare};
use crate::stega::carrier::Carrier;
use crate::stega::plan::{MarkPlan, MarkScene};
use crate::stega::recipe::{CarrierKind, Recipe};
use crate::stega::shape::{CarrierShape, carrier_mask};
use std::ops::Range;

/// A scene being marked.
pub(crate) struct Site {
    pub(crate) scene: MarkScene,
    /// The training's settings, with those that the scene has to itself.
    pub(crate) config: Recipe,
    pub(crate) bank: Bank,
    /// How much each coefficient of a carrier may move.
    pub(crate) mask: Vec<f32>,
    /// Its identities among all scenes', from 0.
    pub(crate) identities: Range<usize>,
    /// Its carriers among all scenes'.
    pub(crate) carriers: Range<usize>,
}

impl Site {
    /// One for each scene, with ray weights worked out, as they are after `step` steps (views come and go);
    /// `progress` is asked before each view of any of them.
    ///
    /// # Errors
    /// [`MarkError::Setting`] for a scene's own that are out of range; [`MarkError::Plan`] for no scene, a cluster without training views or another number of signals
    /// than clusters; [`MarkError::Signal`]; [`MarkError::Stopped`].
    pub(crate) fn all(
        scenes: Vec<MarkScene>,
        config: &Recipe,
        seed: u64,
        step: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Vec<Self>, MarkError> {
        if scenes.is_empty() {
            return Err(MarkError::Plan("no scene to mark; bring one or more".into()));
        }
        scenes.iter().try_for_each(|scene| check_signals(&scene.plan, config))?;
        let chosen = |s: &MarkScene| {
            let own = s.settings.as_ref().map_or_else(|| config.clone(), |own| config.for_scene(own));
            own.validate()?;
            Ok((Chosen::draw(&s.plan, &own, seed)?.renewed(&s.plan, own.fresh_after(step)), own))
        };
        let chosen = scenes.iter().map(chosen).collect::<Result<Vec<_>, MarkError>>()?;
        let total = chosen.iter().map(|(chosen, _)| chosen.len()).sum();
        let (mut sites, mut done) = (Vec::<Self>::with_capacity(scenes.len()), 0);
        for (scene, (chosen, own)) in scenes.into_iter().zip(chosen) {
            let views = chosen.len();
            let mut prepare = Prepare::new(&scene, &own, Progress::new(done, total, progress));
            let bank = Bank::new(&scene.plan, chosen, &own, &mut prepare)?;
            done += views;
            let (first, first_carrier) = sites.last().map_or((0, 0), |s| (s.identities.end, s.carriers.end));
            let identities = first..first + scene.plan.signals.len();
            let carriers = if config.carrier == CarrierKind::PerCluster { identities.len() } else { 1 };
            let shape = CarrierShape::of(config.carrier, config.density);
            let mask = carrier_mask(config, scene.field.as_ref(), shape);
            let carriers = first_carrier..first_carrier + carriers;
            sites.push(Self { scene, config: own, bank, mask, identities, carriers });
        }
        Ok(sites)
    }

    /// Its carrier `which` of all scenes' before the first step, with that hue.
    pub(crate) fn pattern(&self, config: &Recipe, seed: u64, which: usize, hue: f32) -> Carrier {
        let shape = CarrierShape::of(config.carrier, config.density);
        let amplitude = 10f32.powf(-config.budget_start_db as f32 / 20.0);
        Carrier::pattern(self.scene.field.as_ref(), shape, seed, which, hue, amplitude)
    }

    /// How close to its base field's renders the scene's must be kept where the budget has tightened so far (0 to 1), dB.
    pub(crate) fn budget_db(&self, tightened: f64) -> f64 {
        let Recipe { budget_start_db, budget_db, .. } = self.config;
        budget_start_db + (budget_db - budget_start_db) * tightened
    }

    /// Which carrier the scene's identity `i` (of all scenes', from 0) is in.
    pub(crate) fn carrier_of(&self, i: usize) -> usize {
        self.carriers.start + (i - self.identities.start) % self.carriers.len()
    }
}

/// Refuses signals that are too few, too many, or cannot be hidden.
fn check_signals(plan: &MarkPlan, config: &Recipe) -> Result<(), MarkError> {
    let (got, identities) = (plan.signals.len(), plan.clusters.clusters.len());
    if got != identities {
        return Err(MarkError::Plan(format!("{got} signals for {identities} identities; bring one for each")));
    }
    (1..).zip(&plan.signals).try_for_each(|(number, signal)| signal.check(number, config))
}
