//! Whose class is whose: a detector counts the identities of all scenes that share it,
//! a scene its own only.

use cairn_mark::{Detection, NotRegistered};
use serde::{Deserialize, Serialize};

/// A scene's part of a detector's classes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Share {
    /// The scene.
    pub scene: String,
    /// What its identities are called, in order: a class each.
    pub labels: Vec<String>,
}

/// Which of a detector's classes are a scene's.
#[derive(Clone, Debug, PartialEq)]
pub struct Classes {
    shares: Vec<Share>,
    /// Which of the shares is its own.
    own: usize,
}

/// An identity of another scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Elsewhere {
    /// The scene.
    pub scene: String,
    /// The identity's number there, 1 and up.
    pub number: u32,
    /// What it is called there.
    pub label: String,
}

/// What registering a picture with the scene's field says.
#[derive(Clone, Debug, PartialEq)]
pub struct Registered {
    /// Share of the picture that the field explains, 1 at most.
    pub explained: f64,
    /// How far each identity's mark stands out, identity 1 first, standard deviations.
    pub scores: Vec<f64>,
    /// The identity whose mark is believed.
    pub believed: Option<u32>,
}

/// What a picture says, in the scene's own numbers.
#[derive(Clone, Debug)]
pub struct Found {
    /// The scene's identity, or another scene's; neither where the picture says `unmarked`.
    pub identity: Option<u32>,
    /// Where the picture carries a mark of another scene with the same detector.
    pub elsewhere: Option<Elsewhere>,
    /// Probability of the answer, 0 to 1.
    pub confidence: f32,
    /// What registering the picture with the field said, or why no place was found for it, where that was asked for.
    pub registered: Option<Result<Registered, NotRegistered>>,
    /// What the detector said, with the scene's classes alone: `unmarked`, then its identities; what is
    /// missing to 1 is other scenes'.
    pub detection: Detection,
}

impl Found {
    /// Whether nobody's mark was found, of this scene or another.
    pub fn is_unmarked(&self) -> bool {
        self.identity.is_none() && self.elsewhere.is_none()
    }
}

impl Classes {
    /// Those of `scene`; `None` where it has no share.
    pub fn new(scene: &str, shares: Vec<Share>) -> Option<Self> {
        let own = shares.iter().position(|share| share.scene == scene)?;
        Some(Self { shares, own })
    }

    /// Identities of the scenes before it.
    fn before(&self) -> usize {
        self.shares[..self.own].iter().map(|share| share.labels.len()).sum()
    }

    /// M + 1, of all scenes.
    pub fn count(&self) -> usize {
        1 + self.shares.iter().map(|share| share.labels.len()).sum::<usize>()
    }

    /// The detector's class of the scene's identity `number`, 1 and up.
    pub fn of(&self, number: u32) -> usize {
        self.before() + number as usize
    }

    /// Whose `class` is: the scene's identity, or another's; neither of class 0.
    fn owner(&self, class: usize) -> (Option<u32>, Option<Elsewhere>) {
        let mut first = 1;
        for (at, Share { scene, labels }) in self.shares.iter().enumerate() {
            if let Some(label) = class.checked_sub(first).and_then(|at| labels.get(at)) {
                let number = (class - first + 1) as u32;
                let there = || Elsewhere { scene: scene.clone(), number, label: label.clone() };
                return if at == self.own { (Some(number), None) } else { (None, Some(there())) };
            }
            first += labels.len();
        }
        (None, None)
    }

    /// What `detection` says in the scene's own numbers.
    pub(crate) fn found(&self, mut detection: Detection) -> Found {
        let class = detection.identity.unwrap_or(0) as usize;
        let confidence = detection.probabilities.get(class).copied().unwrap_or(0.0);
        let (identity, elsewhere) = self.owner(class);
        detection.identity = identity;
        let (unmarked, owners) = detection.probabilities.split_at(1);
        let own = owners.iter().skip(self.before()).take(self.shares[self.own].labels.len());
        detection.probabilities = unmarked.iter().chain(own).copied().collect();
        Found { identity, elsewhere, confidence, registered: None, detection }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_mark::Signal;

    fn share(scene: &str, labels: &[&str]) -> Share {
        Share { scene: scene.into(), labels: labels.iter().map(|l| (*l).to_owned()).collect() }
    }

    fn said(class: u32, probabilities: &[f32]) -> Detection {
        let (probabilities, recovered) = (probabilities.to_vec(), Signal::default());
        Detection {
            identity: (class > 0).then_some(class),
            probabilities,
            is_center_crop: false,
            recovered,
            text_bytes: None,
        }
    }

    #[test]
    fn classes_of_scenes_that_share_a_detector_are_told_apart() {
        let shares = vec![share("mill", &["ada", "bo"]), share("town", &["cy"]), share("well", &["di", "ed"])];
        let town = Classes::new("town", shares.clone()).unwrap();
        assert_eq!((town.count(), town.of(1)), (6, 3));
        let found = town.found(said(3, &[0.1, 0.0, 0.1, 0.7, 0.1, 0.0]));
        assert_eq!((found.identity, found.elsewhere, found.confidence), (Some(1), None, 0.7));
        assert_eq!((found.detection.identity, found.detection.probabilities), (Some(1), vec![0.1, 0.7]));
        let found = town.found(said(5, &[0.1, 0.0, 0.1, 0.1, 0.1, 0.6]));
        let ed = Elsewhere { scene: "well".into(), number: 2, label: "ed".into() };
        assert!(!found.is_unmarked() && found.detection.identity.is_none());
        assert_eq!((found.identity, found.elsewhere, found.confidence), (None, Some(ed), 0.6));
        assert!(town.found(said(0, &[0.9, 0.0, 0.0, 0.1, 0.0, 0.0])).is_unmarked());
        assert_eq!(Classes::new("fern", shares.clone()), None);
        let mill = Classes::new("mill", shares).unwrap();
        let found = mill.found(said(2, &[0.0, 0.1, 0.9, 0.0, 0.0, 0.0]));
        assert_eq!((found.identity, found.detection.probabilities), (Some(2), vec![0.0, 0.1, 0.9]));
    }

    #[test]
    fn a_scene_with_a_detector_of_its_own_has_all_classes() {
        let alone = Classes::new("town", vec![share("town", &["ada", "bo"])]).unwrap();
        assert_eq!((alone.count(), alone.of(2)), (3, 2));
        let found = alone.found(said(2, &[0.2, 0.1, 0.7]));
        assert_eq!((found.identity, found.detection.probabilities), (Some(2), vec![0.2, 0.1, 0.7]));
    }
}
