//! The detector's heads: a picture's, a sound's and a text's, over one encoder.
//! Only those are built that some identity uses.

use crate::error::MarkError;
use crate::payload::{HeadSizes, Numbers};
use crate::stega::recipe::Recipe;
use crate::tensors::{finite, interleaved};
use cairn_nn::{AudioHead, Params, TextHead, UNet, avg_pool};
use candle_core::Tensor;

/// What the names of the audio head's and the text head's parameters start with.
pub(crate) const AUDIO: &str = "detector.audio";
pub(crate) const TEXT: &str = "detector.text";

/// F_psi.
pub(crate) struct Heads {
    sizes: HeadSizes,
    /// How many times finer the pictures are than what the encoder sees.
    finer: usize,
    unet: UNet,
    audio: Option<AudioHead>,
    text: Option<TextHead>,
}

/// What the heads say of N pictures.
pub(crate) struct Said {
    /// N x 3 x side x side.
    pub(crate) picture: Option<Tensor>,
    /// N x samples.
    pub(crate) audio: Option<Tensor>,
    /// Logits, N x bits.
    pub(crate) text: Option<Tensor>,
}

impl Heads {
    /// Heads of `sizes` over `params`, told of `classes` = M + 1 classes.
    pub(crate) fn new(
        config: &Recipe,
        classes: usize,
        sizes: HeadSizes,
        params: &mut Params,
    ) -> Result<Self, MarkError> {
        let encoder = &config.detector;
        let unet = match sizes.picture {
            true => UNet::new(&config.detector, classes, params.scope("detector"))?,
            false => UNet::encoder(&config.detector, classes, params.scope("detector"))?,
        };
        let audio = match sizes.audio {
            Some(samples) => Some(AudioHead::new(&config.audio, samples, encoder, classes, params.scope(AUDIO))?),
            None => None,
        };
        let text = match sizes.text {
            Some(bytes) => Some(TextHead::new(&config.text, bytes, encoder, classes, params.scope(TEXT))?),
            None => None,
        };
        Ok(Self { sizes, finer: config.finer, unet, audio, text })
    }

    /// Which there are.
    pub(crate) fn sizes(&self) -> &HeadSizes {
        &self.sizes
    }

    /// What `images`, N x 3 x side x side (as shown, see `Recipe::finer`), hide, told their classes, N x (M + 1).
    pub(crate) fn forward(&self, images: &Tensor, told: &Tensor) -> Result<Said, MarkError> {
        let features = match self.finer {
            1 => self.unet.features(images, told)?,
            finer => self.unet.features(&avg_pool(images, [finer; 2])?, told)?,
        };
        let picture = if self.sizes.picture { Some(self.unet.draw(&features, told)?) } else { None };
        let audio = self.audio.as_ref().map(|head| head.forward(features.coarsest(), told)).transpose()?;
        let text = self.text.as_ref().map(|head| head.forward(features.coarsest(), told)).transpose()?;
        Ok(Said { picture, audio, text })
    }
}

impl Said {
    /// As much, and nothing: black, silence, and every bit a guess.
    pub(crate) fn silent(&self) -> Result<Self, MarkError> {
        let none = |said: &Option<Tensor>| said.as_ref().map(Tensor::zeros_like).transpose();
        Ok(Self { picture: none(&self.picture)?, audio: none(&self.audio)?, text: none(&self.text)? })
    }

    /// What was said of picture `i`.
    ///
    /// # Errors
    /// [`MarkError::NotFinite`] when a number of it is not.
    pub(crate) fn numbers(&self, i: usize) -> Result<Numbers, MarkError> {
        let of = |said: &Option<Tensor>, place| -> Result<Option<Vec<f32>>, MarkError> {
            let Some(said) = said else { return Ok(None) };
            let flat = said.get(i)?.flatten_all()?.to_vec1::<f32>()?;
            finite(&flat, place)?;
            Ok(Some(flat))
        };
        Ok(Numbers {
            picture: of(&self.picture, "the recovered picture")?.map(|planes| interleaved(&planes)),
            audio: of(&self.audio, "the recovered sound")?,
            text: of(&self.text, "the recovered text")?,
        })
    }
}
