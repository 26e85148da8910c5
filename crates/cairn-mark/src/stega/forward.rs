//! What a step is to make smaller: equations 1, 2, 3 and 5; equation 4 needs no network (`backward`).
//!
//! Equation 5 is of one pose P: of theta(P), and of theta_0(P), which is its unmarked pair. A step has N renders of theta. With
//! `mark.loss_per_render` its loss is the mean of equation 5 over them, that is with every render of theta divided by N and
//! every picture without a mark by how many of them the term is over, since each stands for any theta_0(P):
//!
//! - l0 (1/N sum CE(theta) + mean CE(theta_0)), equation 3, the second over unmarked pairs and other unmarked pictures;
//! - l1/N sum |F - I| over renders of identities, equation 1;
//! - l2 (1/N sum |F| over renders of no cluster + mean |F| over one unmarked pair and one other unmarked picture), equation 2;
//! - l3/N sum |theta - theta_0|, equation 4.
//!
//! Without it (the default) equation 3 is one mean over all pictures, equations 1 and 2 are each the mean over the pictures they
//! are of, and equation 4 is summed: against equation 5 the picture weighs N times as much as recovery, and some 3 N times as
//! much as classification.
//!
//! With several heads equations 1 and 2 are the heads' mean. A render whose identity
//! hides nothing of a head's kind counts for that head as an unmarked picture does:
//! it is to be silent there. Silence is black, no sound, no text.

use crate::detect::blind::heads::Said;
use crate::error::MarkError;
use crate::payload::Numbers;
use crate::stega::recipe::LossKind;
use crate::stega::sample::Render;
use crate::stega::state::State;
use crate::tensors::planar;
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

/// Equation 5 without its picture term, which needs no network: the loss, and what
/// it is made of. `images` are the renders (those of
/// identities first), then the unmarked pairs, then the other unmarked pictures; `noisy` says of each whether it came with much noise.
pub(crate) fn forward(
    state: &State,
    images: &Var,
    renders: &[Render],
    noisy: &[bool],
) -> Result<(Tensor, Losses), MarkError> {
    let all = images.dims()[0];
    let mut classes: Vec<u32> = renders.iter().map(|r| r.class).collect();
    classes.resize(all, 0);
    let logits = state.networks.classifier.forward(images)?;
    let of_renders = state.config.loss_per_render.then_some(renders.len());
    let cross = classification(&logits, &classes, of_renders)?;
    let classify = f64::from(cross.to_scalar::<f32>()?);
    // Detached: recovery must not teach the classifier what to say.
    let probabilities = softmax(&logits)?.detach();
    let each = surprises(&probabilities.to_vec2::<f32>()?, &classes);
    let taught = state.config.has_classifier();
    let weighted = (cross * if taught { state.config.weight_classify } else { 0.0 })?;
    // By pictures, also where the loss is a mean over renders: `classify_until` means the same there.
    let unread = mean_of_quiet(&each, noisy);
    if state.joined.is_none() {
        return Ok((weighted, Losses { classify, each, unread, ..Losses::default() }));
    }
    // The gate silences most unmarked pictures by itself: one unmarked pair and one other
    // picture a step suffice, and the detector is the costly network.
    let told = state.networks.told(probabilities)?;
    let shown = if state.config.recover_moves_marks { images.as_tensor().clone() } else { images.detach() };
    let pieces = pieces([renders.len(), pair_now(state), all]);
    let some = |t: &Tensor| -> Result<Tensor, MarkError> {
        let parts = pieces.iter().map(|(from, length)| t.narrow(0, *from, *length)).collect::<Result<Vec<_>, _>>()?;
        Ok(Tensor::cat(&parts, 0)?)
    };
    let said = state.networks.detector.forward(&some(&shown)?, &some(&told)?)?;
    let hidden = |class: &u32| (*class as usize).checked_sub(1).map(|identity| &state.signals[identity]);
    let truths: Vec<Option<&Numbers>> = classes[..renders.len()].iter().chain(&[0, 0]).map(hidden).collect();
    let weights = [state.config.weight_recover, state.config.weight_empty];
    let (heads, [recover, empty]) = recovery(&said, &truths, weights, of_renders, state.config.loss)?;
    let unread = match taught {
        true => unread,
        false => {
            let silent = recovery(&said.silent()?, &truths, weights, of_renders, state.config.loss)?;
            Some(share_of_silence([recover, empty], silent.1[0]))
        }
    };
    Ok(((weighted + heads)?, Losses { classify, each, recover, empty, unread }))
}

/// Which of the step's unmarked pairs the detector sees: the first, whose silence the gate sees to; where none does, each
/// identity's in turn, since silence on it is learnt from these.
fn pair_now(state: &State) -> usize {
    if state.config.has_gate() { 0 } else { turn(state.step, state.in_turn(), state.signals.len()) }
}

/// The place in step `step` of the render, of `batch`, whose unmarked pair it is the turn of. Renders go round the `identities` as
/// well: all come up because this moves on only once those have come round.
fn turn(step: u64, batch: usize, identities: usize) -> usize {
    let round = if batch.is_multiple_of(identities) { 1 } else { identities };
    (step / round as u64 % batch as u64) as usize
}

/// The pictures of a step that the detector sees, as (first, how many): of `all` the `renders`, the unmarked pair at `unmarked pair`, and the last.
fn pieces([renders, pair, all]: [usize; 3]) -> Vec<(usize, usize)> {
    match pair {
        0 => vec![(0, renders + 1), (all - 1, 1)],
        pair => vec![(0, renders), (renders + pair, 1), (all - 1, 1)],
    }
}

/// Equation 3, nats: the mean over all pictures; with `of_renders` = N the mean over the first N, which are theta's, and
/// that over the others together.
fn classification(logits: &Tensor, classes: &[u32], of_renders: Option<usize>) -> Result<Tensor, MarkError> {
    let Some(n) = of_renders else { return Ok(cross_entropy(logits, classes)?) };
    let half = |from: usize, length: usize| {
        cross_entropy(&logits.narrow(0, from, length)?.contiguous()?, &classes[from..from + length])
    };
    Ok((half(0, n)? + half(n, classes.len() - n)?)?)
}

/// How far from read marks are, told by recovery alone: equations 1 and 2 together as a share of equation 1 of a detector that
/// says nothing. 0 is all and nothing else; what says nothing, or the same of everything, has 1.
fn share_of_silence([recover, empty]: [f64; 2], silent: f64) -> f64 {
    if silent > 0.0 { (recover + empty) / silent } else { 1.0 }
}

/// What a step's loss is made of, but for the picture's.
#[derive(Default)]
pub(crate) struct Losses {
    /// Cross-entropy, nats (equation 3), as [`classification`] puts it together.
    pub(crate) classify: f64,
    /// The same of each picture.
    pub(crate) each: Vec<f32>,
    /// Recovery error (equation 1); 0 while the classifier trains alone.
    pub(crate) recover: f64,
    /// What is said where nothing is hidden (equation 2); 0 while the classifier trains alone.
    pub(crate) empty: f64,
    /// How far from read marks are: the mean cross-entropy, nats, of the pictures that are not noisy, if any; without a classifier
    /// [`share_of_silence`].
    pub(crate) unread: Option<f64>,
}

/// The mean of `each` over the pictures that are not `noisy`: noise may take a mark, which says nothing of how well it is read without.
fn mean_of_quiet(each: &[f32], noisy: &[bool]) -> Option<f64> {
    let quiet: Vec<f64> = each.iter().zip(noisy).filter(|(_, noisy)| !**noisy).map(|(v, _)| f64::from(*v)).collect();
    (!quiet.is_empty()).then(|| quiet.iter().sum::<f64>() / quiet.len() as f64)
}

/// Cross-entropy of each picture from its probabilities and class, nats, at most 87.
fn surprises(probabilities: &[Vec<f32>], classes: &[u32]) -> Vec<f32> {
    let of = |(p, class): (&Vec<f32>, &u32)| -p[*class as usize].max(f32::MIN_POSITIVE).ln();
    probabilities.iter().zip(classes).map(of).collect()
}

/// `l1` times equation 1 plus `l2` times equation 2, the mean over the heads, and
/// the two alone; `weights` are l1 and l2, and N where the first N pictures are the renders whose mean it is to be. Of each
/// picture `truths` has what it hides, if anything.
fn recovery(
    said: &Said,
    truths: &[Option<&Numbers>],
    weights: [f64; 2],
    of_renders: Option<usize>,
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
        let (both, of_head) = head(said, &truths, weights, of_renders, distance)?;
        total = (total + both)?;
        means = [0, 1].map(|i| means[i] + of_head[i]);
        count += 1.0;
    }
    Ok(((total * (1.0 / count))?, means.map(|mean| mean / count)))
}

/// By what each picture's error is divided: by how many pictures hide something or by how many do not, whichever it is of;
/// with `of_renders` = N by N if it is one of the first N, which are theta's, and else by how many the others are.
fn divisors<T>(truths: &[Option<T>], of_renders: Option<usize>) -> Vec<f64> {
    let owned = truths.iter().flatten().count();
    let by = |(i, truth): (usize, &Option<T>)| match of_renders {
        None if truth.is_some() => owned,
        None => truths.len() - owned,
        Some(n) if i < n => n,
        Some(n) => truths.len() - n,
    };
    truths.iter().enumerate().map(|picture| by(picture) as f64).collect()
}

/// Equations 1 and 2 of one head, as [`recovery`] puts them together. Each is the sum over its pictures, divided by
/// [`divisors`]; one without any is 0.
fn head(
    said: &Tensor,
    truths: &[Option<Vec<f32>>],
    [plus, minus]: [f64; 2],
    of_renders: Option<usize>,
    distance: Distance,
) -> Result<(Tensor, [f64; 2]), MarkError> {
    let each = said.elem_count() / truths.len();
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
    let by = divisors(truths, of_renders);
    let weights = truths.iter().zip(&by).map(|(t, by)| (if t.is_some() { plus } else { minus } / by) as f32).collect();
    let means = apart.to_vec1::<f32>()?;
    let mean_of = |hides: bool| -> f64 {
        let those = means.iter().zip(&by).zip(truths).filter(|(_, t)| t.is_some() == hides);
        those.map(|((v, by), _)| f64::from(*v) / by).sum()
    };
    let weights = Tensor::from_vec(weights, truths.len(), &Device::Cpu)?;
    Ok(((apart * weights)?.sum_all()?, [mean_of(true), mean_of(false)]))
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
    fn how_well_marks_are_read_is_told_by_pictures_without_noise() {
        assert_eq!(mean_of_quiet(&[1.0, 9.0, 2.0], &[false, true, false]), Some(1.5));
        assert_eq!(mean_of_quiet(&[9.0], &[true]), None);
    }

    #[test]
    fn a_head_is_compared_with_what_is_hidden_and_with_silence() {
        // Two owners and one silent picture, two samples each.
        let said = tensor(&[0.5, -0.5, 0.0, 1.0, 0.25, -0.75], 3);
        let truths = [Some(vec![0.25, 0.5]), Some(vec![0.0, -1.0]), None];
        // |.|: (0.25 + 1) / 2 and (0 + 2) / 2, mean 0.8125; silence (0.25 + 0.75) / 2.
        let (both, [plus, minus]) =
            head(&said, &truths, [2.0, 3.0], None, Distance::Levels(LossKind::Absolute)).unwrap();
        assert!((plus - 0.8125).abs() < 1e-6 && (minus - 0.5).abs() < 1e-6);
        assert!((value(&both) - (2.0 * 0.8125 + 3.0 * 0.5)).abs() < 1e-6);
        // Squares: (0.0625 + 1) / 2 and (0 + 4) / 2, mean 1.265625; silence (0.0625 + 0.5625) / 2.
        let (both, [plus, minus]) =
            head(&said, &truths, [2.0, 3.0], None, Distance::Levels(LossKind::Squared)).unwrap();
        assert!((plus - 1.265_625).abs() < 1e-6 && (minus - 0.3125).abs() < 1e-6);
        assert!((value(&both) - (2.0 * 1.265_625 + 3.0 * 0.3125)).abs() < 1e-6);
    }

    /// Three identities, a view of no cluster, three unmarked pairs and three other unmarked pictures: N = 4 renders of theta.
    #[test]
    fn a_step_of_three_identities_weighs_as_equation_5_a_render() {
        // Four classes; a logit of ln 2 beside three of 0 has probability 2/5, one of 0 beside it 1/5.
        let sure = |class: usize| (0..4).map(move |k| if k == class { 2.0f32.ln() } else { 0.0 });
        // The three identities are told right, the view of no cluster as identity 1; of the six unmarked pictures, the last is.
        let said: Vec<f32> = [1, 2, 3, 1, 0, 0, 0, 0, 0, 2].into_iter().flat_map(sure).collect();
        let (logits, classes) = (tensor(&said, 10), [1, 2, 3, 0, 0, 0, 0, 0, 0, 0]);
        let [right, wrong] = [-(0.4f64.ln()), -(0.2f64.ln())];
        let apart = |of_renders| value(&classification(&logits, &classes, of_renders).unwrap());
        assert!((apart(None) - (8.0 * right + 2.0 * wrong) / 10.0).abs() < 1e-6);
        let expected = (3.0 * right + wrong) / 4.0 + (5.0 * right + wrong) / 6.0;
        assert!((apart(Some(4)) - expected).abs() < 1e-6);

        // Of these the detector sees the four renders, a unmarked pair and the last; a number each.
        let truths = [Some(vec![1.0]), Some(vec![1.0]), Some(vec![1.0]), None, None, None];
        assert_eq!(divisors(&truths, None), [3.0; 6]);
        assert_eq!(divisors(&truths, Some(4)), [4.0, 4.0, 4.0, 4.0, 2.0, 2.0]);
        // Off by 1/2, 1/4, 1/4; by 1/8, by 1/2 and 1/4.
        let said = tensor(&[0.5, 0.75, 1.25, 0.125, 0.5, -0.25], 6);
        let both = |of_renders| {
            let (both, means) =
                head(&said, &truths, [2.0, 3.0], of_renders, Distance::Levels(LossKind::Absolute)).unwrap();
            (value(&both), means)
        };
        let (sum, means) = both(None);
        assert!((means[0] - 1.0 / 3.0).abs() < 1e-6 && (means[1] - 0.875 / 3.0).abs() < 1e-6, "{means:?}");
        assert!((sum - (2.0 / 3.0 + 0.875)).abs() < 1e-6, "{sum}");
        // 1/4 (1/2 + 1/4 + 1/4); 1/4 of 1/8 and 1/2 (1/2 + 1/4).
        let (sum, means) = both(Some(4));
        assert_eq!(means, [0.25, 0.03125 + 0.375]);
        assert!((sum - (2.0 * 0.25 + 3.0 * 0.40625)).abs() < 1e-6, "{sum}");
    }

    #[test]
    fn silence_is_as_far_from_read_as_can_be_and_so_is_the_same_of_everything() {
        let one = Numbers { audio: Some(vec![0.5, -0.25]), text: Some(vec![1.0, 0.0]), ..Numbers::default() };
        // Said of two owners' pictures, who hide the same, and of an unmarked one.
        let unread = |audio: [f32; 6], text: [f32; 6]| {
            let said = Said { picture: None, audio: Some(tensor(&audio, 3)), text: Some(tensor(&text, 3)) };
            let of = |said: &Said| {
                recovery(said, &[Some(&one), Some(&one), None], [9.0, 7.0], None, LossKind::Absolute).unwrap().1
            };
            share_of_silence(of(&said), of(&said.silent().unwrap())[0])
        };
        let (silent, [yes, no]) = ([0.0; 6], [30.0, -30.0]);
        let all = unread([0.5, -0.25, 0.5, -0.25, 0.0, 0.0], [yes, no, yes, no, no, no]);
        assert!(all.abs() < 1e-6, "{all}");
        // Of the text a guess costs ln 2 a bit, of the sound silence 3/8: together half of each. Unmarked, the guess costs as much.
        let (sound, text) = (0.375, 2.0f64.ln());
        let guessed = unread(silent, silent);
        assert!((guessed - (sound + 2.0 * text) / (sound + text)).abs() < 1e-6, "{guessed}");
        let same = unread([0.5, -0.25, 0.5, -0.25, 0.5, -0.25], [yes, no, yes, no, no, no]);
        assert!((same - sound / (sound + text)).abs() < 1e-6, "{same}");
        assert_eq!(share_of_silence([0.0, 0.0], 0.0), 1.0);
    }

    #[test]
    fn every_identitys_twin_has_its_turn() {
        // Render k of a step is of identity (step x batch + k) modulo the identities (`marked_renders`).
        for (batch, identities) in [(3, 3), (3, 1), (2, 3), (2, 4), (3, 2), (4, 6), (64, 100)] {
            let mut counts = vec![0; identities];
            let steps = batch * identities * 4;
            for step in 0..steps {
                counts[(step * batch + turn(step as u64, batch, identities)) % identities] += 1;
            }
            assert_eq!(counts, vec![steps / identities; identities], "{batch} of {identities}");
        }
        assert_eq!([0, 1, 2, 3].map(|step| turn(step, 3, 3)), [0, 1, 2, 0]);
        // Three identities' renders, one of no cluster, three unmarked pairs, three others.
        assert_eq!(pieces([4, 0, 10]), [(0, 5), (9, 1)]);
        assert_eq!(pieces([4, 2, 10]), [(0, 4), (6, 1), (9, 1)]);
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
        let (both, [plus, _]) = head(&said, &[Some(vec![1.0, 0.0]), None], [1.0, 1.0], None, Distance::Bits).unwrap();
        let expected = (-(0.75f64.ln()) - 0.25f64.ln()) / 2.0;
        assert!((plus - expected).abs() < 1e-6, "{plus} for {expected}");
        let silent = (2.0f64.ln() - 0.75f64.ln()) / 2.0;
        assert!((value(&both) - expected - silent).abs() < 1e-6);
        // Far out it is the logit itself, and finite.
        let (far, _) =
            head(&tensor(&[90.0, -1e4], 1), &[Some(vec![0.0, 1.0])], [1.0, 1.0], None, Distance::Bits).unwrap();
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
        let (both, [plus, minus]) =
            recovery(&said, &[Some(&spoken), None], [1.0, 1.0], None, LossKind::Absolute).unwrap();
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
