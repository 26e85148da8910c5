//! Settings of stage 2, with the paper's symbols (StegaNeRF); equations are numbered as in docs/design/marks.md.

use crate::attack::RobustConfig;
use crate::error::MarkError;
use cairn_nn::{AudioConfig, ClassifierConfig, Memory, TextConfig, UNetConfig};
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;

/// Where a mark lives in the field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CarrierKind {
    /// Each identity has colour coefficients of its own, seen from its cluster's
    /// poses only: marks differ by design and end where the cluster does.
    #[default]
    PerCluster,
    /// The paper's: one set of spherical-harmonic coefficients for all, told
    /// apart by viewing direction alone.
    Harmonics,
}

/// Whether densities move with the mark.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityKind {
    /// Colours alone move (the authors' code): a view is a fixed linear map.
    #[default]
    Frozen,
    /// All of theta moves (the paper's equations): every look at a view marches its rays.
    /// With one set of harmonics for all identities only: what stands where cannot hang on
    /// who looks.
    Free,
}

/// What weighs a coefficient's update (adaptive gradient masking).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskKind {
    /// All alike.
    None,
    /// The paper's: by the magnitude of each weight of theta_0.
    #[default]
    PerWeight,
    /// The authors' code: by the mean magnitude of each coefficient's group. With one set of harmonics only: a carrier of
    /// a cluster's own has a single coefficient a channel.
    PerCoefficientGroup,
    /// The paper's ablation: all or nothing. The share `mask_share` of the weights that
    /// matter most does not move, the others do freely.
    Binary,
}

/// What the colours of pictures of something else are like, among a training's unmarked pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OtherColours {
    /// Mixed and exchanged by turns, near those of the scene's photographs; grey stays grey.
    #[default]
    Near,
    /// Any exchange, from none of the colour to more than twice as much, casts, and coloured grain: what may tell a mark
    /// of one hue, that a channel and lightness vary together, is then seen on what carries none as well.
    Any,
}

/// What the classifier is to the detector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Guidance {
    /// Its answer goes into the detector (classifier-guided recovery, the paper's).
    #[default]
    Guided,
    /// It is trained, and the detector does without its answer.
    Unguided,
    /// It is not trained either, and its answers mean nothing: the paper's ablation
    /// without a classifier.
    NoClassifier,
}

/// How a difference is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LossKind {
    /// Mean absolute error (the paper's).
    #[default]
    Absolute,
    /// Mean squared error (the authors' code).
    Squared,
}

/// Faintest marks: 8 bits round them away long before.
const MAX_BUDGET_DB: f64 = 80.0;

/// Settings of stage 2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Optimiser steps at most, 1 to 1,000,000; training ends earlier once
    /// recovery on virtual poses has converged.
    pub steps: u64,
    /// Share of the steps, 0.01 to 1, that adding identities to a trained scene takes.
    pub grow_share: f64,
    /// Marked renders a step, 1 to 64; where more identities learn, one of each, up to 64. Where several
    /// scenes share a detector, as many more, of the identities that are read worst. Each comes with its
    /// unmarked pair (the base field's render of the same view) and an unmarked picture of anything.
    pub batch: usize,
    /// Whether a step's loss is the mean of equation 5 over its renders of theta, one picture at a time as
    /// in the paper. Otherwise equation 3 is the mean over all pictures of the step, equations 1 and 2 are
    /// means over pictures that hide something and over the others, and equation 4 is the sum over renders.
    pub loss_per_render: bool,
    /// l0, weight of the classification (equation 3); 0 to 1,000,000.
    pub weight_classify: f64,
    /// l1, weight of recovery (equation 1); 0 to 1,000,000.
    pub weight_recover: f64,
    /// l2, weight of silence on unmarked pictures (equation 2); 0 to 1,000,000.
    pub weight_empty: f64,
    /// l3, weight of keeping the picture (equation 4); 0 to 1,000,000.
    pub weight_picture: f64,
    /// How signals are compared (equations 1 and 2).
    pub loss: LossKind,
    /// How pictures are compared (equation 4). An absolute error pulls just as hard on a faint mark as on
    /// a strong one and removes it; a squared one lets go.
    pub picture_loss: LossKind,
    /// Whether the gradient of recovery moves the mark as well (the paper's), or that of classification
    /// alone. A detector that has memorised the payloads asks only the class of a mark; its gradient is
    /// then noise, which wears marks off.
    pub recover_moves_marks: bool,
    /// Where marks live.
    pub carrier: CarrierKind,
    /// Whether densities move as well.
    pub density: DensityKind,
    /// What weighs updates.
    pub mask: MaskKind,
    /// alpha, the mask's exponent, 0 to 10.
    pub mask_alpha: f64,
    /// The mask's smallest value, 0 to 1: above 0 every weight can move.
    pub min_mask: f64,
    /// Share of the weights that a binary mask locks, 0 to 1.
    pub mask_share: f64,
    /// What the classifier is to the detector.
    pub guidance: Guidance,
    /// Whether carriers are scaled to the budget below, and the picture loss waits until marks are read
    /// with ease. The paper has no budget: the picture loss (and the pull) alone keeps the picture there.
    pub budget: bool,
    /// How close theta's renders are to theta_0's, PSNR in dB, 20 to 80, measured on the step's render
    /// that differs most.
    pub budget_db: f64,
    /// What marks may cost photographs, dB of PSNR, 0 to 10. The budget is raised until they cost no more,
    /// where the base field explains its photographs well ([`Recipe::affording`]). 0 leaves it as it is.
    pub max_cost_db: f64,
    /// Where the budget starts, PSNR in dB, 20 to `budget_db`: strong marks are
    /// found at once and can then be made fainter. With or without a budget, the
    /// first pattern's amplitude.
    pub budget_start_db: f64,
    /// Share of all steps in which the budget tightens, 0 to 1.
    pub budget_ramp: f64,
    /// Pull of the carrier to nothing where there is no budget, a share a step, 0 to 1.
    pub pull: f64,
    /// Mean step of a colour coefficient, 1e-9 to 1, in colour units.
    pub learning_rate_carrier: f64,
    /// Mean step of a raw density where densities are free, 1e-9 to 1.
    pub learning_rate_density: f64,
    /// Learning rate of classifier and detector at the start, 1e-9 to 1.
    pub learning_rate_networks: f64,
    /// Learning rates fall to this share of themselves, exponentially; 1e-6 to 1.
    pub final_rate: f64,
    /// How much a step counts of what the next one does in the networks' mean that is kept, 0
    /// (the last step alone) to 0.9999.
    pub average: f64,
    /// Classifier and carrier train alone until the cross-entropy is below this
    /// (nats, 0.001 to 10): from theta = theta_0 the detector would collapse to
    /// silence. A training that never gets there ends in an error.
    pub classify_until: f64,
    /// Photographs' poses of each cluster to train on, evenly, and twice as many outside all
    /// clusters; 1 to 10,000. Each takes some tens of MiB of ray weights.
    pub views: usize,
    /// Up to three times as many, over all clusters, are trained on where others of the cluster's look further
    /// than this from all of them, degrees, 0 to 180: an object seen from all around has more sides.
    pub views_apart_deg: f64,
    /// Hard-example sampling: how often a view comes up whose mark is read with ease, as a share of how
    /// often others do, 0.01 to 1; 1 samples all alike.
    pub easy_view_share: f64,
    /// Poses between each cluster's photographs and a little beyond, rather where these look far apart, to train on as
    /// well, 0 to 256; where more than `views` photographs' poses are, as many as those.
    pub virtual_views: usize,
    /// View refresh: after this many steps an unseen view replaces a virtual view of each scene,
    /// identities in turn, 0 (never) to 1,000,000.
    pub view_refresh_steps: u64,
    /// Views are trained on at most this long, px, 64 to 4096.
    pub longest_side_px: usize,
    /// Training ends when twice in a row all held-out virtual poses are answered right, and the hidden
    /// pictures' mean SSIM has reached this, 0 to 10; above 1 = never. Where marks are trained against
    /// distortions, nearly all distorted renders are answered right as well. Without a classifier recovery
    /// alone counts.
    pub enough_ssim: f64,
    /// The same for hidden sounds' SNR, dB, 0 to 1000.
    pub enough_snr_db: f64,
    /// The same for the share of hidden texts' characters, 0 to 10; above 1 = never.
    pub enough_characters: f64,
    /// Out-of-distribution limit: an owner is not believed of pictures that lie this many times as far from
    /// the owner's nearest render as those lie from each other at most, 1 to 100; 0 = no limit.
    pub max_feature_distance: f64,
    /// An owner is named of a whole picture with this probability at least, 0 to `center_crop_confidence`.
    /// Below it the picture is unmarked, unless its center crop gives the same owner. Without center crops
    /// it has no effect.
    pub min_confidence: f64,
    /// A picture that seems unmarked is read again by its center crop (three quarters of each side, else
    /// three fifths), which has to give an owner with this probability, 0.5 to 1; 1 = never. No effect
    /// without a classifier, or where [`Recipe::max_feature_distance`] is 0.
    pub center_crop_confidence: f64,
    /// Of a step's unmarked pictures (unmarked pairs aside), how many show something else for each render of
    /// the base field, 0 (none) to 16.
    pub others: u32,
    /// What their colours are like.
    pub others_colours: OtherColours,
    /// Share of the pictures of something else that become objects on a flat background, 0 (none) to 1;
    /// noise and pictures as they are stay out of it.
    pub others_cutout_share: f64,
    /// Share of the pictures with noise of 1 to 6 levels of 255 (RMS, at [`Recipe::shown_px`]) once marks
    /// are read, 0 to 0.9; a marked render and its unmarked pair get the same. Noise is no mark. No effect
    /// without a classifier.
    pub noisy_share: f64,
    /// What marks are trained to outlast.
    pub robust: RobustConfig,
    /// How many times finer than hidden pictures are the pictures that the classifier sees, 1, 2 or 4; the
    /// detector sees their means over as many pixels each way.
    pub finer: usize,
    /// Whether heads are built that no identity uses as well, as long as their longest payload. Otherwise
    /// what a later identity hides gets its head then.
    pub unused_heads: bool,
    /// The classifier.
    pub classifier: ClassifierConfig,
    /// The detector; its size is that of the hidden pictures.
    pub detector: UNetConfig,
    /// The detector's audio head, built where an identity hides a sound.
    pub audio: AudioConfig,
    /// The detector's text head, built where an identity hides a text.
    pub text: TextConfig,
}

/// What presets switch on for a kind of scene is off here.
impl Default for Recipe {
    fn default() -> Self {
        Self {
            steps: 1400,
            grow_share: 0.4,
            batch: 3,
            loss_per_render: false,
            weight_classify: 1.0,
            weight_recover: 1.0,
            weight_empty: 1.0,
            weight_picture: 1.0,
            loss: LossKind::Absolute,
            picture_loss: LossKind::Squared,
            recover_moves_marks: false,
            carrier: CarrierKind::PerCluster,
            density: DensityKind::Frozen,
            mask: MaskKind::PerWeight,
            mask_alpha: 3.0,
            min_mask: 0.2,
            mask_share: 0.5,
            guidance: Guidance::Guided,
            budget: true,
            budget_db: 52.0,
            max_cost_db: 0.1,
            budget_start_db: 32.0,
            budget_ramp: 0.4,
            pull: 1e-3,
            learning_rate_carrier: 5e-4,
            learning_rate_density: 1e-3,
            learning_rate_networks: 3e-3,
            final_rate: 0.1,
            average: 0.98,
            classify_until: 0.3,
            views: 24,
            views_apart_deg: 10.0,
            easy_view_share: 0.25,
            virtual_views: 6,
            view_refresh_steps: 0,
            longest_side_px: 192,
            enough_ssim: 0.985,
            enough_snr_db: 25.0,
            enough_characters: 1.0,
            max_feature_distance: 1.25,
            min_confidence: 0.0,
            center_crop_confidence: 1.0,
            others: 1,
            others_colours: OtherColours::Near,
            others_cutout_share: 0.0,
            noisy_share: 0.0,
            robust: RobustConfig::default(),
            finer: 1,
            unused_heads: false,
            classifier: ClassifierConfig::default(),
            detector: UNetConfig::default(),
            audio: AudioConfig::default(),
            text: TextConfig::default(),
        }
    }
}

impl Recipe {
    /// Stage 2 as the paper (StegaNeRF) has it, as far as it is a switch, with its weights for
    /// scenes in the wild. Its other weights for l0 to l3: LLFF 0.01, 0.5, 0.5 and 1,
    /// NeRF-Synthetic 0.1, 1, 1 and 1.
    ///
    /// What is no switch stays as Cairn has it:
    /// - The mask's largest value is 1; the paper's values sum to 1, and over millions of weights
    ///   no step is left. The quarter of the weights that matters least moves alike: theta_0 is 0
    ///   for many, and 0^-3 is infinite. The mask weighs updates, since an adaptive optimiser
    ///   divides it out of gradients.
    /// - The first pattern is not zero: theta = theta_0 gives the classifier nothing to learn from.
    /// - Networks of a few layers see views of some two hundred pixels, of 8 bits, whole or cut, in
    ///   slightly changed light; the paper's are VGG16s on whole pictures.
    /// - A step shows each identity, and beside each marked render its unmarked pair and another
    ///   render of theta_0, one in five a JPEG.
    /// - The state that is kept is the best one on poses between photographs, not the last one.
    #[must_use]
    pub fn paper() -> Self {
        let usual = Self::default();
        Self {
            // 55 epochs of a cluster's 20 views, each identity once a step.
            steps: 1100,
            batch: 1,
            // Equation 5 is of one render: a step that shows several takes its mean.
            loss_per_render: true,
            weight_classify: 0.05,
            weight_recover: 1.0,
            weight_empty: 1.0,
            weight_picture: 1.0,
            // Equations 1, 2 and 4 as they stand; the last alone keeps the picture, from the first step.
            loss: LossKind::Absolute,
            picture_loss: LossKind::Absolute,
            budget: false,
            pull: 0.0,
            // As near to theta_0 as a first pattern may be; the budget itself counts for nothing.
            budget_db: 80.0,
            budget_start_db: 80.0,
            max_cost_db: 0.0,
            // All losses from the start: to guess costs ln(M + 1) nats, never 10.
            classify_until: 10.0,
            guidance: Guidance::Guided,
            // One set of harmonics for all identities, moved by every loss.
            carrier: CarrierKind::Harmonics,
            // As the authors' code has it; the equations move densities as well, at many times the time.
            density: DensityKind::Frozen,
            recover_moves_marks: true,
            // Each weight by its own magnitude.
            mask: MaskKind::PerWeight,
            mask_alpha: 3.0,
            min_mask: 0.0,
            // The authors' code: the detector's 1e-3 to 1e-4.
            learning_rate_networks: 1e-3,
            final_rate: 0.1,
            // The last step's networks, not their mean.
            average: 0.0,
            // The training photographs' poses, each as often as another, and none between them.
            views: 100,
            views_apart_deg: 180.0,
            easy_view_share: 1.0,
            virtual_views: 0,
            view_refresh_steps: 0,
            // To the last step, however good it is.
            enough_ssim: 10.0,
            enough_snr_db: 1000.0,
            enough_characters: 10.0,
            // Unmarked pictures are theta_0's renders alone, and the classifier's answer stands.
            others: 0,
            others_colours: OtherColours::Near,
            others_cutout_share: 0.0,
            noisy_share: 0.0,
            max_feature_distance: 0.0,
            min_confidence: 0.0,
            center_crop_confidence: 1.0,
            // Classifier and detector see pictures of one size.
            finer: 1,
            longest_side_px: 192,
            robust: RobustConfig { enabled: false, ..usual.robust },
            // Networks see pictures as they are, and memorise nothing.
            classifier: ClassifierConfig {
                channels: vec![16, 32, 64, 64],
                high_pass_gain: 0.0,
                textured_only: false,
                ..usual.classifier
            },
            detector: UNetConfig { high_pass_gain: 0.0, memory: Memory::None, gated: false, ..usual.detector },
            audio: AudioConfig { memory: Memory::None, ..usual.audio },
            text: TextConfig { memory: Memory::None, ..usual.text },
            ..usual
        }
    }

    /// These settings for marks that cost photographs at most `max_cost_db`, where the base field explains them to
    /// `explained_db` (PSNR, dB).
    ///
    /// What the field leaves of a photograph and a mark know nothing of each other, so that their squares add up: with e the
    /// field's mean squared error and m the mark's, the PSNR falls by 10 log10((e + m) / e). That is c dB where the mark lies
    /// -10 log10(10^(c/10) - 1) dB below the error, 16.3 for 0.1.
    #[must_use]
    pub fn affording(&self, explained_db: f64) -> Self {
        let below = -10.0 * (10f64.powf(self.max_cost_db / 10.0) - 1.0).log10();
        let affordable_db = (explained_db + below).min(MAX_BUDGET_DB);
        let is_raised = self.budget && self.max_cost_db > 0.0 && affordable_db > self.budget_db;
        Self { budget_db: if is_raised { affordable_db } else { self.budget_db }, ..self.clone() }
    }

    /// These settings for one of several scenes that share a detector, of which its `own` say how strong its marks are, which views
    /// are looked at, and what is shown that is unmarked; networks, steps and losses are everybody's.
    #[must_use]
    pub fn for_scene(&self, own: &Self) -> Self {
        Self {
            budget_db: own.budget_db,
            budget_start_db: self.budget_start_db.min(own.budget_db),
            max_cost_db: own.max_cost_db,
            views: own.views,
            views_apart_deg: own.views_apart_deg,
            easy_view_share: own.easy_view_share,
            virtual_views: own.virtual_views,
            view_refresh_steps: own.view_refresh_steps,
            // What the networks see is not to be made of less, nor of much more than they do.
            longest_side_px: match own.finer.cmp(&self.finer) {
                Ordering::Less => own.longest_side_px.max(self.longest_side_px.min(self.shown_px())),
                Ordering::Equal => own.longest_side_px,
                Ordering::Greater => own.longest_side_px.min(self.longest_side_px),
            },
            others: own.others,
            others_colours: own.others_colours,
            others_cutout_share: own.others_cutout_share,
            ..self.clone()
        }
    }

    /// Which of several scenes' settings says how their classifier and detector are made: the first of those whose marks are looked
    /// at most finely ([`Recipe::finer`]), since what reads a faint mark reads a stronger one; 0 of none.
    pub fn finest<'a>(of: impl IntoIterator<Item = &'a Self>) -> usize {
        let finer: Vec<usize> = of.into_iter().map(|config| config.finer).collect();
        finer.iter().position(|of| Some(of) == finer.iter().max()).unwrap_or(0)
    }

    /// [`Recipe::min_confidence`] of a detector that several scenes share: the least of theirs, or marks would be lost; 0 of none.
    pub fn min_confidence_of<'a>(of: impl IntoIterator<Item = &'a Self>) -> f64 {
        of.into_iter().map(|config| config.min_confidence).reduce(f64::min).unwrap_or(0.0)
    }

    /// How many fresh views have come to a scene after `steps` steps.
    pub(crate) fn fresh_after(&self, steps: u64) -> u64 {
        steps.checked_div(self.view_refresh_steps).unwrap_or(0)
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`MarkError::Setting`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<(), MarkError> {
        let check = |ok: bool, key, value: String, allowed| {
            if ok { Ok(()) } else { Err(MarkError::Setting { key, value, allowed }) }
        };
        let (audio, text, named) = (&self.audio, &self.text, self.center_crop_confidence);
        for (key, value, low, high, allowed) in [
            ("mark.steps", self.steps as f64, 1.0, 1e6, "1 to 1000000"),
            ("mark.batch", self.batch as f64, 1.0, 64.0, "1 to 64"),
            ("mark.views", self.views as f64, 1.0, 1e4, "1 to 10000"),
            ("mark.virtual_views", self.virtual_views as f64, 0.0, 256.0, "0 to 256"),
            ("mark.others", f64::from(self.others), 0.0, 16.0, "0 (none) to 16"),
            ("mark.view_refresh_steps", self.view_refresh_steps as f64, 0.0, 1e6, "0 (never) to 1000000"),
            ("mark.longest_side_px", self.longest_side_px as f64, 64.0, 4096.0, "64 to 4096"),
            ("mark.audio.sample_rate_hz", f64::from(audio.sample_rate_hz), 4000.0, 48_000.0, "4000 to 48000"),
            ("mark.text.longest_bytes", text.longest_bytes as f64, 1.0, 4096.0, "1 to 4096"),
            ("mark.grow_share", self.grow_share, 0.01, 1.0, "0.01 to 1"),
            ("mark.weight_classify", self.weight_classify, 0.0, 1e6, "0 to 1000000"),
            ("mark.weight_recover", self.weight_recover, 0.0, 1e6, "0 to 1000000"),
            ("mark.weight_empty", self.weight_empty, 0.0, 1e6, "0 to 1000000"),
            ("mark.weight_picture", self.weight_picture, 0.0, 1e6, "0 to 1000000"),
            ("mark.mask_alpha", self.mask_alpha, 0.0, 10.0, "0 to 10"),
            ("mark.min_mask", self.min_mask, 0.0, 1.0, "0 to 1"),
            ("mark.mask_share", self.mask_share, 0.0, 1.0, "0 to 1"),
            ("mark.budget_db", self.budget_db, 20.0, MAX_BUDGET_DB, "20 to 80"),
            ("mark.max_cost_db", self.max_cost_db, 0.0, 10.0, "0 to 10"),
            ("mark.budget_start_db", self.budget_start_db, 20.0, self.budget_db, "20 to mark.budget_db"),
            ("mark.budget_ramp", self.budget_ramp, 0.0, 1.0, "0 to 1"),
            ("mark.pull", self.pull, 0.0, 1.0, "0 to 1"),
            ("mark.learning_rate_carrier", self.learning_rate_carrier, 1e-9, 1.0, "1e-9 to 1"),
            ("mark.learning_rate_density", self.learning_rate_density, 1e-9, 1.0, "1e-9 to 1"),
            ("mark.learning_rate_networks", self.learning_rate_networks, 1e-9, 1.0, "1e-9 to 1"),
            ("mark.final_rate", self.final_rate, 1e-6, 1.0, "1e-6 to 1"),
            ("mark.views_apart_deg", self.views_apart_deg, 0.0, 180.0, "0 to 180"),
            ("mark.easy_view_share", self.easy_view_share, 0.01, 1.0, "0.01 to 1"),
            ("mark.others_cutout_share", self.others_cutout_share, 0.0, 1.0, "0 to 1"),
            ("mark.noisy_share", self.noisy_share, 0.0, 0.9, "0 to 0.9"),
            ("mark.min_confidence", self.min_confidence, 0.0, named, "0 to mark.center_crop_confidence"),
            ("mark.center_crop_confidence", named, 0.5, 1.0, "0.5 to 1"),
            ("mark.average", self.average, 0.0, 0.9999, "0 to 0.9999"),
            ("mark.classify_until", self.classify_until, 1e-3, 10.0, "0.001 to 10"),
            ("mark.enough_ssim", self.enough_ssim, 0.0, 10.0, "0 to 10"),
            ("mark.enough_snr_db", self.enough_snr_db, 0.0, 1000.0, "0 to 1000"),
            ("mark.enough_characters", self.enough_characters, 0.0, 10.0, "0 to 10"),
            ("mark.audio.longest_s", audio.longest_s, 0.1, 30.0, "0.1 to 30"),
        ] {
            check((low..=high).contains(&value), key, value.to_string(), allowed)?;
        }
        let beyond = self.max_feature_distance;
        check(
            beyond == 0.0 || (1.0..=100.0).contains(&beyond),
            "mark.max_feature_distance",
            beyond.to_string(),
            "0 (off) or 1 to 100",
        )?;
        check(
            self.guidance != Guidance::NoClassifier || self.recover_moves_marks,
            "mark.recover_moves_marks",
            self.recover_moves_marks.to_string(),
            "true where mark.guidance is no_classifier: nothing else moves marks then",
        )?;
        check(
            self.density == DensityKind::Frozen || self.carrier == CarrierKind::Harmonics,
            "mark.density",
            "free".into(),
            "frozen where mark.carrier is per_cluster: what stands where cannot hang on who looks; set mark.carrier = \"harmonics\" as well",
        )?;
        check(
            self.mask != MaskKind::PerCoefficientGroup || self.carrier == CarrierKind::Harmonics,
            "mark.mask",
            "per_coefficient_group".into(),
            "none, per_weight or binary where mark.carrier is per_cluster, whose single coefficient a channel leaves nothing to be told apart by; set mark.carrier = \"harmonics\" as well",
        )?;
        self.robust.validate()?;
        check([1, 2, 4].contains(&self.finer), "mark.finer", self.finer.to_string(), "1, 2 or 4")?;
        let [h, w] = self.detector.size;
        check(
            h == w && (32..=512).contains(&h) && h % 16 == 0,
            "mark.detector.size",
            format!("[{h}, {w}]"),
            "a square of 32 to 512 px, a multiple of 16",
        )?;
        let (shown, halved) = (self.shown_px(), self.classifier.channels.len());
        check(
            halved < 9 && shown.is_multiple_of(1 << halved),
            "mark.classifier.channels",
            format!("{:?} on pictures of {shown} px", self.classifier.channels),
            "so many that mark.finer times mark.detector.size can be halved as often",
        )?;
        let stages =
            |channels: &[usize]| (1..=4).contains(&channels.len()) && channels.iter().all(|c| (1..=256).contains(c));
        let (got, allowed) = (format!("{:?}", audio.channels), "1 to 4 numbers of 1 to 256");
        check(stages(&audio.channels), "mark.audio.channels", got, allowed)?;
        check(stages(&text.channels), "mark.text.channels", format!("{:?}", text.channels), allowed)
    }

    /// The first table of settings in which the networks of `other` differ from these, if any.
    pub(crate) fn other_networks(&self, other: &Self) -> Option<&'static str> {
        let tables = [
            ("mark.finer", self.finer == other.finer),
            ("mark.classifier", self.classifier == other.classifier),
            ("mark.detector", self.detector == other.detector),
            ("mark.audio", self.audio == other.audio),
            ("mark.text", self.text == other.text),
        ];
        tables.iter().find(|(_, same)| !same).map(|(key, _)| *key)
    }

    /// Whether there is a classifier to tell how well marks are read.
    pub(crate) fn has_classifier(&self) -> bool {
        self.guidance != Guidance::NoClassifier
    }

    /// Whether unmarked is silent by the detector's gate: it is as shut as the detector is told that a picture is unmarked.
    pub(crate) fn has_gate(&self) -> bool {
        self.detector.gated && self.guidance == Guidance::Guided
    }

    /// Samples of the longest sound that may be hidden.
    pub(crate) fn max_samples(&self) -> usize {
        (self.audio.longest_s * f64::from(self.audio.sample_rate_hz)).ceil() as usize
    }

    /// Side of hidden pictures, px.
    pub fn side_px(&self) -> usize {
        self.detector.size[0]
    }

    /// Side of the pictures that the networks are shown, px.
    pub fn shown_px(&self) -> usize {
        self.finer * self.side_px()
    }
}

#[cfg(test)]
#[path = "recipe_tests.rs"]
mod tests;
