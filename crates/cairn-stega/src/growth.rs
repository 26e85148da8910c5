//! Identities that come later: stage 2 goes on from an earlier training instead of
//! starting over.
//!
//! Marks that are there stay as they are, to the bit: pictures that carry them are
//! out in the world. What is new gets a carrier with a hue of its own between theirs,
//! and the networks go on from what they know, a class wider.

use crate::carrier::{Carrier, hue_of, hues};
use crate::config::{CarrierKind, MarkConfig};
use crate::detector::Detector;
use crate::error::MarkError;
use crate::site::MarkScene;
use crate::trainer::MarkTrainer;
use cairn_field::operator::MarkableField;
use cairn_nn::Average;

/// An earlier training to go on from.
#[derive(Clone)]
pub struct Earlier<'a> {
    /// What reads its marks.
    pub detector: &'a Detector,
    /// What each identity of the new plan, scene after scene, was there; `None` for a new one.
    pub identities: Vec<Option<Known<'a>>>,
}

/// An identity that was trained before.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// Its class in the earlier detector, 1 and up.
    pub class: usize,
    /// Its carrier ([`crate::MarkedField::carrier`]), over the same base field.
    pub carrier: &'a [f32],
}

impl MarkTrainer {
    /// As [`MarkTrainer::joint`], going on from an `earlier` training of some of the
    /// identities: their carriers stay as they are, and `mark.grow_share` of the steps are taken.
    ///
    /// # Errors
    /// As [`MarkTrainer::joint`]; [`MarkError::Plan`] where the earlier training does not fit: other networks or
    /// base fields, carriers that are not one an identity, a class twice or beyond those there are, nothing
    /// new, or nothing known.
    pub fn growing(
        scenes: Vec<MarkScene>,
        earlier: &Earlier<'_>,
        mut config: MarkConfig,
        seed: u64,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        config.validate()?;
        earlier.check(&scenes, &config)?;
        config.steps = ((config.steps as f64 * config.grow_share).ceil() as u64).max(1);
        let mut trainer = Self::joint(scenes, config, seed, progress)?;
        let mut class_of = vec![Some(0)];
        class_of.extend(earlier.identities.iter().map(|known| known.map(|k| k.class)));
        trainer.networks.params.graft(earlier.detector.params(), &class_of)?;
        trainer.average = Average::new(&trainer.networks.params, trainer.config.average)?;
        let taken: Vec<f32> = earlier.identities.iter().flatten().map(|known| hue_of(known.carrier)).collect();
        let mut free = hues(earlier.identities.len() - taken.len(), &taken).into_iter();
        for (i, known) in earlier.identities.iter().enumerate() {
            let site = &trainer.sites[trainer.site_of(i)];
            trainer.carriers[i] = match known {
                Some(known) => Carrier::from_values(trainer.carriers[i].shape, known.carrier.to_vec()),
                None => site.pattern(&trainer.config, seed, (i, free.next().unwrap_or_default())),
            };
            trainer.settled[i] = known.is_some();
        }
        Ok(trainer)
    }
}

impl Earlier<'_> {
    fn check(&self, scenes: &[MarkScene], config: &MarkConfig) -> Result<(), MarkError> {
        let refuse = |why: String| Err(MarkError::Plan(format!("{why}; train from the start instead")));
        if config.carrier != CarrierKind::PerCluster {
            return refuse("`mark.carrier` is not per_cluster, so that marks have no carrier each to keep".into());
        }
        if let Some(key) = config.other_networks(self.detector.config()) {
            return refuse(format!("`{key}` is another than in the earlier training"));
        }
        let rows: Vec<usize> = scenes.iter().flat_map(|s| s.plan.signals.iter().map(|_| s.field.rows())).collect();
        if rows.len() != self.identities.len() {
            let (got, expected) = (self.identities.len(), rows.len());
            return refuse(format!("{got} identities to go on with for {expected} in the plan"));
        }
        let mut seen = vec![false; self.detector.classes()];
        for (known, rows) in self.identities.iter().zip(rows) {
            let Some(known) = known else { continue };
            if known.class == 0 || known.class >= seen.len() || std::mem::replace(&mut seen[known.class], true) {
                return refuse(format!("class {} of an earlier detector of {}, or twice", known.class, seen.len()));
            }
            if known.carrier.len() != rows * 3 {
                return refuse(format!("the carrier of class {} is of another base field", known.class));
            }
        }
        let known = self.identities.iter().flatten().count();
        match known {
            0 => refuse("no identity of the plan was trained before".into()),
            n if n == self.identities.len() => {
                Err(MarkError::Plan(format!("all {n} identities are trained already; there is nothing to add")))
            }
            _ => Ok(()),
        }
    }
}
