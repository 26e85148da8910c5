//! Identities that come later: stage 2 goes on from an earlier training instead of
//! starting over.
//!
//! Marks that are there stay as they are, to the bit: pictures that carry them are
//! out in the world. What is new gets a carrier with a hue of its own between theirs,
//! and the networks go on from what they know, a class wider.

use crate::detect::blind::detector::Detector;
use crate::detect::blind::heads::{AUDIO, TEXT};
use crate::error::MarkError;
use crate::payload::HeadSizes;
use crate::stega::carrier::{Carrier, hue_of, hues};
use crate::stega::recipe::{CarrierKind, Recipe};
use crate::stega::site::MarkScene;
use crate::stega::trainer::MarkTrainer;
use cairn_field::MarkableField;
use cairn_nn::Average;
use serde::{Deserialize, Serialize};
use std::fmt;

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

/// A head that an earlier training had and that could not go on from it: it is as long as the longest signal, and what was
/// learnt in another length does not fit. As text, what people are told.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Restarted {
    /// The head for sounds.
    Audio {
        /// Samples that it held.
        before: usize,
        /// Samples that it holds.
        now: usize,
    },
    /// The head for texts.
    Text {
        /// Bytes of UTF-8 that it held.
        before: usize,
        /// Bytes of UTF-8 that it holds.
        now: usize,
    },
}

impl Restarted {
    /// Those of the heads that were there `before` of which a tensor is among the `fresh` ones (names of
    /// [`cairn_nn::Params::graft`]).
    fn among(fresh: &[String], before: &HeadSizes, now: &HeadSizes) -> Vec<Self> {
        let is_fresh = |scope: &str| fresh.iter().any(|name| name.starts_with(scope));
        let audio = before.audio.zip(now.audio).filter(|_| is_fresh(AUDIO));
        let text = before.text.zip(now.text).filter(|_| is_fresh(TEXT));
        let audio = audio.map(|(before, now)| Self::Audio { before, now });
        audio.into_iter().chain(text.map(|(before, now)| Self::Text { before, now })).collect()
    }
}

impl fmt::Display for Restarted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kind, before, now, unit) = match self {
            Self::Audio { before, now } => ("sounds", before, now, "samples"),
            Self::Text { before, now } => ("texts", before, now, "bytes"),
        };
        write!(
            f,
            "the head for hidden {kind} starts afresh: it is as long as the longest of them, {now} {unit} where it was {before}, and \
             what it had learnt does not fit. The {kind} of earlier identities are learnt again in this training's steps: see that \
             they still come back, and if not, train with a larger mark.grow_share, or add {kind} of at most {before} {unit} only"
        )
    }
}

impl MarkTrainer {
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
        let mut trainer = Self::joint(scenes, config, seed, progress)?;
        let mut class_of = vec![Some(0)];
        class_of.extend(earlier.identities.iter().map(|known| known.map(|k| k.class)));
        let fresh = trainer.networks.params.graft(earlier.detector.params(), &class_of)?;
        trainer.restarted = Restarted::among(&fresh, earlier.detector.heads(), trainer.networks.detector.sizes());
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
    fn check(&self, scenes: &[MarkScene], config: &Recipe) -> Result<(), MarkError> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_starts_afresh_where_it_was_and_has_another_length() {
        let sizes = |audio, text| HeadSizes { picture: true, audio, text };
        let fresh = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        let both = fresh(&["detector.audio.place", "detector.text.memory", "detector.text.place"]);
        let (before, now) = (sizes(Some(256), Some(3)), sizes(Some(512), Some(12)));
        let restarted = Restarted::among(&both, &before, &now);
        assert_eq!(restarted, [Restarted::Audio { before: 256, now: 512 }, Restarted::Text { before: 3, now: 12 }]);
        let said = restarted[1].to_string();
        for part in ["hidden texts", "12 bytes where it was 3", "learnt again", "mark.grow_share", "at most 3 bytes"] {
            assert!(said.contains(part), "{part}: {said}");
        }
        // Nobody hid such a thing before: nothing is forgotten. And what fits goes on.
        assert_eq!(Restarted::among(&both, &sizes(None, None), &now), []);
        assert_eq!(Restarted::among(&fresh(&["detector.out.weight"]), &before, &before), []);
    }
}
