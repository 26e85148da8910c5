//! How a state of a training does on poses that it was not trained on.

use crate::stega::recipe::Recipe;

/// How a state did on virtual poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// After this many steps.
    pub step: u64,
    /// Right answers of the classifier, the mean of the shares of marked and of unmarked pictures (of one kind where
    /// there is none of the other), [0, 1].
    pub accuracy: f64,
    /// The share of right answers after attacks (`[mark.robust]`), two in three of them all at once; as `accuracy` where there
    /// are none.
    pub attacked: f64,
    /// How near the recovered signals come to the true ones.
    pub recovered: Recovered,
    /// Who does worst, which a mean over many identities does not show; `None` where marks of fewer than two were judged.
    pub weakest: Option<Weakest>,
}

/// The identity of which something comes back worst, over the poses that it is judged by: its least figure is the least of all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weakest {
    /// Its class, from 1.
    pub identity: usize,
    /// The share of its marked pictures that are told as its own, [0, 1].
    pub told: f64,
    /// What comes back of its signals.
    pub recovered: Recovered,
}

/// How near recovered signals come to the true ones, each the mean over the poses
/// of identities that hide such a thing; `None` where nobody does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Recovered {
    /// SSIM of the pictures.
    pub picture_ssim: Option<f64>,
    /// SNR of the sounds, dB: of the mean ratio of noise to signal, so that one lost
    /// sound is not outweighed by another that is perfect.
    pub audio_snr_db: Option<f64>,
    /// Share of the texts' characters (bytes), 0 to 1.
    pub text_characters: Option<f64>,
}

impl Recovered {
    /// All three, for a file.
    pub(crate) fn parts(&self) -> [Option<f64>; 3] {
        [self.picture_ssim, self.audio_snr_db, self.text_characters]
    }

    pub(crate) fn from_parts([picture_ssim, audio_snr_db, text_characters]: [Option<f64>; 3]) -> Self {
        Self { picture_ssim, audio_snr_db, text_characters }
    }

    /// The mean over the heads, each 0 (nothing, or silence) to 1: SSIM, one less the
    /// ratio of noise to signal in amplitude, and characters.
    pub(crate) fn score(&self) -> f64 {
        let all = self.shares();
        all.iter().flatten().sum::<f64>() / all.iter().flatten().count().max(1) as f64
    }

    /// Each head, 0 (nothing, or silence) to 1.
    pub(crate) fn shares(&self) -> [Option<f64>; 3] {
        let sound = self.audio_snr_db.map(|db| (1.0 - 10f64.powf(-db / 20.0)).max(0.0));
        [self.picture_ssim, sound, self.text_characters]
    }

    /// Whether each is good enough to end training.
    pub(crate) fn is_enough(&self, config: &Recipe) -> bool {
        self.picture_ssim.is_none_or(|ssim| ssim >= config.enough_ssim)
            && self.audio_snr_db.is_none_or(|db| db >= config.enough_snr_db)
            && self.text_characters.is_none_or(|share| share >= config.enough_characters)
    }
}

impl Judgement {
    /// What states are ranked by; without a classifier its answers are those of an untrained one, and recovery is all there is.
    pub(crate) fn score(&self, has_classifier: bool) -> f64 {
        // An owner missed or made up is worse than a blurred signal.
        let answers = if has_classifier { self.accuracy + self.attacked } else { 0.0 };
        answers + self.recovered.score()
    }
}

/// What is kept of the best state.
#[derive(Clone)]
pub(crate) struct Best {
    pub(crate) judgement: Judgement,
    pub(crate) params: Vec<u8>,
    pub(crate) carriers: Vec<Vec<f32>>,
}
