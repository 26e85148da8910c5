//! What a step is to make smaller: equations 1, 2, 3 and 5.

use crate::config::{Guidance, LossKind};
use crate::error::MarkError;
use crate::networks::planar;
use crate::renders::Render;
use crate::trainer::MarkTrainer;
use cairn_nn::{cross_entropy, mean_absolute, mean_squared, softmax};
use candle_core::{Device, Tensor, Var};

impl MarkTrainer {
    /// Equation 5 without its picture term, which needs no network: the loss, its
    /// cross-entropy and its recovery error. `images` are the renders (those of
    /// identities first), then the twins, then the other unmarked pictures.
    pub(crate) fn loss(&self, images: &Var, renders: &[Render]) -> Result<(Tensor, f64, f64), MarkError> {
        let (all, side) = (images.dims()[0], self.config.side_px());
        let mut classes: Vec<u32> = renders.iter().map(|r| r.class).collect();
        classes.resize(all, 0);
        let logits = self.networks.classifier.forward(images)?;
        let cross = cross_entropy(&logits, &classes)?;
        let classify = f64::from(cross.to_scalar::<f32>()?);
        let taught = self.config.guidance != Guidance::NoClassifier;
        let weighted = (cross * if taught { self.config.weight_classify } else { 0.0 })?;
        if !self.joined {
            return Ok((weighted, classify, 0.0));
        }
        // Detached: recovery must not teach the classifier what to say. The gate
        // silences most unmarked pictures by itself: one twin and one other
        // picture a step suffice, and the detector is the costly network.
        let told = self.networks.told(softmax(&logits)?.detach())?;
        let shown = if self.config.recover_moves_marks { images.as_tensor().clone() } else { images.detach() };
        let some = |t: &Tensor| Tensor::cat(&[&t.narrow(0, 0, renders.len() + 1)?, &t.narrow(0, all - 1, 1)?], 0);
        let hidden = self.networks.detector.forward(&some(&shown)?, &some(&told)?)?;
        let owners = classes.iter().filter_map(|class| (*class as usize).checked_sub(1));
        let truth: Vec<Vec<f32>> = owners.map(|identity| self.signals[identity].clone()).collect();
        let marked = truth.len();
        let truth = Tensor::from_vec(planar(&truth), (marked, 3, side, side), &Device::Cpu)?;
        let distance = match self.config.loss {
            LossKind::Absolute => mean_absolute,
            LossKind::Squared => mean_squared,
        };
        let plus = distance(&hidden.narrow(0, 0, marked)?, &truth)?;
        let rest = hidden.narrow(0, marked, renders.len() - marked + 2)?;
        let minus = distance(&rest, &rest.zeros_like()?)?;
        let recover = f64::from(plus.to_scalar::<f32>()?);
        let total = ((weighted + (plus * self.config.weight_recover)?)? + (minus * self.config.weight_empty)?)?;
        Ok((total, classify, recover))
    }
}
