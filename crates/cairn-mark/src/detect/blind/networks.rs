//! Detector and classifier together: built alike for training and for use.

use crate::detect::blind::heads::Heads;
use crate::detect::blind::out_of_distribution::OutOfDistribution;
use crate::error::MarkError;
use crate::payload::{HeadSizes, Numbers};
use crate::stega::recipe::{Guidance, Recipe};
use crate::tensors::{finite, to_tensor, winner};
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
    pub(crate) out_of_distribution: Option<OutOfDistribution>,
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
        Ok(Self { params, classifier, detector, out_of_distribution: None, guidance: config.guidance })
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
        if let Some(known) = &self.out_of_distribution {
            for (probabilities, features) in probabilities.iter_mut().zip(features.to_vec2::<f32>()?) {
                known.doubt(probabilities, &features);
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
