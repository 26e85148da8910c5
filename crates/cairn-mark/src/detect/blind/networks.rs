//! Detector and classifier together: built alike for training and for use.

use crate::detect::blind::heads::Heads;
use crate::detect::blind::out_of_distribution::Familiar;
use crate::error::MarkError;
use crate::payload::{HeadSizes, Numbers};
use crate::stega::judge::winner;
use crate::stega::recipe::{Guidance, Recipe};
use cairn_nn::{Classifier, Params, softmax};
use candle_core::{Device, Tensor};

/// Class probabilities (M + 1), and what the heads say.
pub(crate) type Reading = (Vec<f32>, Numbers);

/// F_psi and Fc_psi with their parameters.
pub(crate) struct Networks {
    pub(crate) params: Params,
    pub(crate) classifier: Classifier,
    pub(crate) detector: Heads,
    /// Where owners' renders lie; none while training.
    pub(crate) familiar: Option<Familiar>,
    guidance: Guidance,
}

impl Networks {
    /// Fresh networks for `classes` = M + 1 classes, with heads of `sizes`.
    pub(crate) fn new(config: &Recipe, classes: usize, sizes: HeadSizes, seed: u64) -> Result<Self, MarkError> {
        Self::with(config, classes, sizes, Params::new(seed))
    }

    /// Networks over `params`, which may hold stored values already.
    pub(crate) fn with(
        config: &Recipe,
        classes: usize,
        sizes: HeadSizes,
        mut params: Params,
    ) -> Result<Self, MarkError> {
        let classifier = Classifier::new(&config.classifier, classes, params.scope("classifier"))?;
        let detector = Heads::new(config, classes, sizes, &mut params)?;
        Ok(Self { params, classifier, detector, familiar: None, guidance: config.guidance })
    }

    /// What the detector is told of class probabilities, N x (M + 1): nothing, as zeros,
    /// where it is to do without.
    pub(crate) fn told(&self, probabilities: Tensor) -> Result<Tensor, MarkError> {
        match self.guidance {
            Guidance::Guided => Ok(probabilities),
            Guidance::Unguided | Guidance::NoClassifier => Ok(probabilities.zeros_like()?),
        }
    }

    /// The likeliest class of each of `pictures` (`side x side x 3`), by the classifier alone.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when a probability is not finite.
    pub(crate) fn classes(&self, pictures: &[Vec<f32>], side: usize) -> Result<Vec<usize>, MarkError> {
        let probabilities = softmax(&self.classifier.forward(&to_tensor(pictures, side)?)?)?.to_vec2::<f32>()?;
        probabilities.iter().try_for_each(|p| finite(p, "a class's probability"))?;
        Ok(probabilities.iter().map(|p| winner(p)).collect())
    }

    /// The class probabilities of each of `images` (N x 3 x side x side); owners count for less on pictures unlike their renders.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when one is not finite.
    pub(crate) fn odds(&self, images: &Tensor) -> Result<Vec<Vec<f32>>, MarkError> {
        let features = self.classifier.features(images)?;
        let mut probabilities = softmax(&self.classifier.classify(&features)?)?.to_vec2::<f32>()?;
        probabilities.iter().try_for_each(|p| finite(p, "a class's probability"))?;
        if let Some(familiar) = &self.familiar {
            for (probabilities, features) in probabilities.iter_mut().zip(features.to_vec2::<f32>()?) {
                familiar.doubt(probabilities, &features);
            }
        }
        Ok(probabilities)
    }

    /// Class probabilities and hidden signals for `pictures` (each `side x side x 3`).
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when a probability or a hidden value is not finite.
    pub(crate) fn read(&self, pictures: &[Vec<f32>], side: usize) -> Result<Vec<Reading>, MarkError> {
        let images = to_tensor(pictures, side)?;
        let probabilities = self.odds(&images)?;
        let classes: Vec<usize> = probabilities.iter().map(|p| winner(p)).collect();
        Ok(probabilities.into_iter().zip(self.hidden(&images, &classes)?).collect())
    }

    /// What `images` (N x 3 x side x side) of `classes` hide.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when a hidden value is not finite.
    pub(crate) fn hidden(&self, images: &Tensor, classes: &[usize]) -> Result<Vec<Numbers>, MarkError> {
        let count = self.classifier.classes();
        // The detector is told the decision, not its odds: half an owner's signal is nobody's.
        let told = classes.iter().flat_map(|class| (0..count).map(move |k| if k == *class { 1.0f32 } else { 0.0 }));
        let told = Tensor::from_vec(told.collect(), (classes.len(), count), &Device::Cpu)?;
        let said = self.detector.forward(images, &self.told(told)?)?;
        (0..classes.len()).map(|i| said.numbers(i)).collect()
    }
}

/// Refuses numbers that would otherwise be ranked or clamped into an answer.
pub(crate) fn finite(values: &[f32], place: &str) -> Result<(), MarkError> {
    match values.iter().all(|v| v.is_finite()) {
        true => Ok(()),
        false => Err(MarkError::NotFinite { step: None, place: place.into() }),
    }
}

/// N x 3 x side x side from interleaved pictures.
pub(crate) fn to_tensor(pictures: &[Vec<f32>], side: usize) -> Result<Tensor, MarkError> {
    Ok(Tensor::from_vec(planar(pictures), (pictures.len(), 3, side, side), &Device::Cpu)?)
}

/// Interleaved pictures as planes, one after another.
pub(crate) fn planar(pictures: &[Vec<f32>]) -> Vec<f32> {
    let mut out = Vec::with_capacity(pictures.iter().map(Vec::len).sum());
    for picture in pictures {
        for c in 0..3 {
            out.extend(picture.iter().skip(c).step_by(3));
        }
    }
    out
}

/// Three planes as an interleaved picture.
pub(crate) fn interleaved(planes: &[f32]) -> Vec<f32> {
    let n = planes.len() / 3;
    (0..n * 3).map(|i| planes[(i % 3) * n + i / 3]).collect()
}
