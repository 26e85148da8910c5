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
use crate::stega::plan::MarkScene;
use crate::stega::recipe::{CarrierKind, Recipe};
use cairn_field::MarkableField;
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
    pub(crate) fn among(fresh: &[String], before: &HeadSizes, now: &HeadSizes) -> Vec<Self> {
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

impl Earlier<'_> {
    /// Refuses what does not fit the `scenes` and settings of the new training.
    pub(crate) fn check(&self, scenes: &[MarkScene], config: &Recipe) -> Result<(), MarkError> {
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
