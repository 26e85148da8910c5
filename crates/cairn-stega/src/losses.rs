//! What a step is to make smaller: equations 1, 2, 3 and 5; equation 4 needs no network (`moves`).
//!
//! With several heads equations 1 and 2 are the heads' mean. A render whose identity
//! hides nothing of a head's kind counts for that head as an unmarked picture does:
//! it is to be silent there. Silence is black, no sound, no text.

use crate::config::{Guidance, LossKind};
use crate::error::MarkError;
use crate::heads::Said;
use crate::networks::planar;
use crate::renders::Render;
use crate::signal::Numbers;
use crate::trainer::MarkTrainer;
use cairn_nn::{binary_cross_entropy, cross_entropy, softmax};
use candle_core::{Device, Tensor, Var};

/// How a head's numbers are compared with what they should be.
#[derive(Clone, Copy)]
enum Distance {
    /// As `mark.loss` says.
    Levels(LossKind),
    /// Cross-entropy of bits, from logits.
    Bits,
}

/// What a signal has for a head.
type Part = fn(&Numbers) -> Option<Vec<f32>>;

impl MarkTrainer {
    /// Equation 5 without its picture term, which needs no network: the loss, and what
    /// it is made of. `images` are the renders (those of
    /// identities first), then the twins, then the other unmarked pictures.
    pub(crate) fn loss(&self, images: &Var, renders: &[Render]) -> Result<(Tensor, Losses), MarkError> {
        let all = images.dims()[0];
        let mut classes: Vec<u32> = renders.iter().map(|r| r.class).collect();
        classes.resize(all, 0);
        let logits = self.networks.classifier.forward(images)?;
        let cross = cross_entropy(&logits, &classes)?;
        let classify = f64::from(cross.to_scalar::<f32>()?);
        // Detached: recovery must not teach the classifier what to say.
        let probabilities = softmax(&logits)?.detach();
        let each = surprises(&probabilities.to_vec2::<f32>()?, &classes);
        let taught = self.config.guidance != Guidance::NoClassifier;
        let weighted = (cross * if taught { self.config.weight_classify } else { 0.0 })?;
        if self.joined.is_none() {
            return Ok((weighted, Losses { classify, each, ..Losses::default() }));
        }
        // The gate silences most unmarked pictures by itself: one twin and one other
        // picture a step suffice, and the detector is the costly network.
        let told = self.networks.told(probabilities)?;
        let shown = if self.config.recover_moves_marks { images.as_tensor().clone() } else { images.detach() };
        let some = |t: &Tensor| Tensor::cat(&[&t.narrow(0, 0, renders.len() + 1)?, &t.narrow(0, all - 1, 1)?], 0);
        let said = self.networks.detector.forward(&some(&shown)?, &some(&told)?)?;
        let hidden = |class: &u32| (*class as usize).checked_sub(1).map(|identity| &self.signals[identity]);
        let truths: Vec<Option<&Numbers>> = classes[..renders.len()].iter().chain(&[0, 0]).map(hidden).collect();
        let weights = [self.config.weight_recover, self.config.weight_empty];
        let (heads, [recover, empty]) = recovery(&said, &truths, weights, self.config.loss)?;
        Ok(((weighted + heads)?, Losses { classify, each, recover, empty }))
    }
}

/// What a step's loss is made of, but for the picture's.
#[derive(Default)]
pub(crate) struct Losses {
    /// Cross-entropy, nats, the mean over the step's pictures (equation 3).
    pub(crate) classify: f64,
    /// The same of each picture.
    pub(crate) each: Vec<f32>,
    /// Recovery error (equation 1); 0 while the classifier trains alone.
    pub(crate) recover: f64,
    /// What is said where nothing is hidden (equation 2); 0 while the classifier trains alone.
    pub(crate) empty: f64,
}

/// Cross-entropy of each picture from its probabilities and class, nats, at most 87.
fn surprises(probabilities: &[Vec<f32>], classes: &[u32]) -> Vec<f32> {
    let of = |(p, class): (&Vec<f32>, &u32)| -p[*class as usize].max(f32::MIN_POSITIVE).ln();
    probabilities.iter().zip(classes).map(of).collect()
}

/// `l1` times equation 1 plus `l2` times equation 2, the mean over the heads, and
/// the two alone; `weights` are l1 and l2. Of each picture `truths` has what it
/// hides, if anything.
fn recovery(
    said: &Said,
    truths: &[Option<&Numbers>],
    weights: [f64; 2],
    loss: LossKind,
) -> Result<(Tensor, [f64; 2]), MarkError> {
    let levels = Distance::Levels(loss);
    let heads: [(&Option<Tensor>, Distance, Part); 3] = [
        // The networks' pictures are planes.
        (&said.picture, levels, |n| n.picture.as_ref().map(|p| planar(std::slice::from_ref(p)))),
        (&said.audio, levels, |n| n.audio.clone()),
        (&said.text, Distance::Bits, |n| n.text.clone()),
    ];
    let (mut total, mut means, mut count) = (Tensor::zeros((), candle_core::DType::F32, &Device::Cpu)?, [0.0; 2], 0.0);
    for (said, distance, of) in heads {
        let Some(said) = said else { continue };
        let truths: Vec<Option<Vec<f32>>> = truths.iter().map(|t| t.and_then(of)).collect();
        let (both, of_head) = head(said, &truths, weights, distance)?;
        total = (total + both)?;
        means = [0, 1].map(|i| means[i] + of_head[i]);
        count += 1.0;
    }
    Ok(((total * (1.0 / count))?, means.map(|mean| mean / count)))
}

/// Equations 1 and 2 of one head, as [`recovery`] puts them together. Each is the
/// mean over its pictures; one without any is 0.
fn head(
    said: &Tensor,
    truths: &[Option<Vec<f32>>],
    [plus, minus]: [f64; 2],
    distance: Distance,
) -> Result<(Tensor, [f64; 2]), MarkError> {
    let each = said.elem_count() / truths.len();
    let owned = truths.iter().flatten().count();
    let silence = vec![0.0f32; each];
    let target: Vec<f32> = truths.iter().flat_map(|t| t.as_ref().unwrap_or(&silence)).copied().collect();
    let target = Tensor::from_vec(target, (truths.len(), each), &Device::Cpu)?;
    let said = said.flatten_from(1)?;
    let apart = match distance {
        Distance::Levels(LossKind::Absolute) => (said - target)?.abs()?,
        Distance::Levels(LossKind::Squared) => (said - target)?.sqr()?,
        Distance::Bits => binary_cross_entropy(&said, &target)?,
    };
    let apart = apart.mean(1)?;
    let weights: Vec<f32> = (truths.iter())
        .map(|t| if t.is_some() { plus / owned as f64 } else { minus / (truths.len() - owned) as f64 } as f32)
        .collect();
    let means = apart.to_vec1::<f32>()?;
    let mean_of = |hides: bool, count: usize| {
        let those = means.iter().zip(truths).filter(|(_, t)| t.is_some() == hides);
        those.map(|(v, _)| f64::from(*v)).sum::<f64>() / count.max(1) as f64
    };
    let weights = Tensor::from_vec(weights, truths.len(), &Device::Cpu)?;
    Ok(((apart * weights)?.sum_all()?, [mean_of(true, owned), mean_of(false, truths.len() - owned)]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tensor(values: &[f32], n: usize) -> Tensor {
        Tensor::from_vec(values.to_vec(), (n, values.len() / n), &Device::Cpu).unwrap()
    }

    fn value(t: &Tensor) -> f64 {
        f64::from(t.to_scalar::<f32>().unwrap())
    }

    #[test]
    fn a_head_is_compared_with_what_is_hidden_and_with_silence() {
        // Two owners and one silent picture, two samples each.
        let said = tensor(&[0.5, -0.5, 0.0, 1.0, 0.25, -0.75], 3);
        let truths = [Some(vec![0.25, 0.5]), Some(vec![0.0, -1.0]), None];
        // |.|: (0.25 + 1) / 2 and (0 + 2) / 2, mean 0.8125; silence (0.25 + 0.75) / 2.
        let (both, [plus, minus]) = head(&said, &truths, [2.0, 3.0], Distance::Levels(LossKind::Absolute)).unwrap();
        assert!((plus - 0.8125).abs() < 1e-6 && (minus - 0.5).abs() < 1e-6);
        assert!((value(&both) - (2.0 * 0.8125 + 3.0 * 0.5)).abs() < 1e-6);
        // Squares: (0.0625 + 1) / 2 and (0 + 4) / 2, mean 1.265625; silence (0.0625 + 0.5625) / 2.
        let (both, [plus, minus]) = head(&said, &truths, [2.0, 3.0], Distance::Levels(LossKind::Squared)).unwrap();
        assert!((plus - 1.265_625).abs() < 1e-6 && (minus - 0.3125).abs() < 1e-6);
        assert!((value(&both) - (2.0 * 1.265_625 + 3.0 * 0.3125)).abs() < 1e-6);
    }

    #[test]
    fn a_picture_surprises_by_the_logarithm_of_its_class() {
        let told = [vec![0.5, 0.25, 0.25], vec![1.0, 0.0, 0.0], vec![0.0, 0.0, 1.0]];
        // -ln(1/4) = 1.386294; -ln 1 = 0; for nothing at all the smallest normal number, 2^-126: 126 ln 2 = 87.336545.
        for (got, expected) in surprises(&told, &[1, 0, 1]).iter().zip([1.386_294, 0.0, 87.336_55]) {
            assert!((got - expected).abs() < 1e-5, "{got} for {expected}");
        }
    }

    #[test]
    fn bits_are_compared_by_cross_entropy_from_logits() {
        // A 1 under logit ln 3 has probability 3/4, a 0 under it 1/4; a logit of 0 says nothing.
        let three = 3.0f32.ln();
        let said = tensor(&[three, three, 0.0, -three], 2);
        let (both, [plus, _]) = head(&said, &[Some(vec![1.0, 0.0]), None], [1.0, 1.0], Distance::Bits).unwrap();
        let expected = (-(0.75f64.ln()) - 0.25f64.ln()) / 2.0;
        assert!((plus - expected).abs() < 1e-6, "{plus} for {expected}");
        let silent = (2.0f64.ln() - 0.75f64.ln()) / 2.0;
        assert!((value(&both) - expected - silent).abs() < 1e-6);
        // Far out it is the logit itself, and finite.
        let (far, _) = head(&tensor(&[90.0, -1e4], 1), &[Some(vec![0.0, 1.0])], [1.0, 1.0], Distance::Bits).unwrap();
        assert!((value(&far) - (90.0 + 1e4) / 2.0).abs() < 1e-2);
    }

    #[test]
    fn heads_weigh_alike_and_one_without_owners_is_only_silent() {
        let said = Said {
            picture: None,
            audio: Some(tensor(&[0.5, 0.5, -0.25, -0.25], 2)),
            text: Some(tensor(&[0.0; 16], 2)),
        };
        let spoken = Numbers { audio: Some(vec![0.0, 1.0]), ..Numbers::default() };
        let (both, [plus, minus]) = recovery(&said, &[Some(&spoken), None], [1.0, 1.0], LossKind::Absolute).unwrap();
        // Audio: 0.5 and 0.25. Text: nobody's, so that both pictures are to be silent, ln 2 nats a bit.
        assert!((plus - 0.25).abs() < 1e-6, "{plus}");
        assert!((minus - (0.25 + 2.0f64.ln()) / 2.0).abs() < 1e-6, "{minus}");
        assert!((value(&both) - (0.75 + 2.0f64.ln()) / 2.0).abs() < 1e-6);
    }

    #[test]
    fn the_gradient_of_bits_is_the_sigmoid_less_the_bit_even_at_zero() {
        let x = Var::from_vec(vec![0.0f32, 0.0, 2.0, -3.0], (1, 4), &Device::Cpu).unwrap();
        let target = tensor(&[0.0, 1.0, 1.0, 0.0], 1);
        let loss = binary_cross_entropy(&x, &target).unwrap().sum_all().unwrap();
        let slope = loss.backward().unwrap().get(&x).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
        for (got, expected) in slope.iter().zip([0.5, -0.5, sigmoid(2.0) - 1.0, sigmoid(-3.0)]) {
            assert!((got - expected).abs() < 1e-6, "{got} for {expected}");
        }
    }
}
