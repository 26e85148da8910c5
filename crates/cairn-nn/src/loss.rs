//! Losses, each one number averaged over everything, but for the bitwise one.

use candle_core::{CpuStorage, CustomOp2, D, Layout, Shape, Tensor};

use crate::error::{NnError, Result};
use crate::raw::{floats, tensor, with_floats};

/// Mean cross-entropy, in nats, of `logits`, N x (M + 1), with the true
/// `classes`, one below M + 1 for each row; by log-softmax, so that large
/// logits stay finite.
///
/// # Errors
/// [`NnError::Input`] when there is not one known class a row.
pub fn cross_entropy(logits: &Tensor, classes: &[u32]) -> Result<Tensor> {
    let (n, k) = logits.dims2()?;
    if n != classes.len() || classes.iter().any(|&c| c as usize >= k) {
        let expected = format!("one class below {k} for each of {n} rows");
        let got = classes.iter().map(|&c| c as usize).collect();
        return Err(NnError::Input { network: "the cross-entropy", expected, got });
    }
    let target = Tensor::new(classes, logits.device())?;
    Ok(candle_nn::loss::cross_entropy(logits, &target)?)
}

/// Softmax over the last dimension.
///
/// # Errors
/// When `logits` is a scalar.
pub fn softmax(logits: &Tensor) -> Result<Tensor> {
    Ok(candle_nn::ops::softmax(logits, D::Minus1)?)
}

/// Mean of |a - b|.
///
/// # Errors
/// When shapes differ.
pub fn mean_absolute(a: &Tensor, b: &Tensor) -> Result<Tensor> {
    Ok((a - b)?.abs()?.mean_all()?)
}

/// Mean of (a - b)^2.
///
/// # Errors
/// When shapes differ.
pub fn mean_squared(a: &Tensor, b: &Tensor) -> Result<Tensor> {
    Ok((a - b)?.sqr()?.mean_all()?)
}

/// Cross-entropy, in nats, of each bit of `targets` (0 or 1; any shape) under
/// `logits` of the same shape: `max(x, 0) - x t + ln(1 + exp(-|x|))`, which stays
/// finite and exact for large logits where the logarithm of a sigmoid does not.
/// No gradient flows to the targets.
///
/// # Errors
/// When shapes differ or a tensor is not f32 on the CPU.
pub fn binary_cross_entropy(logits: &Tensor, targets: &Tensor) -> Result<Tensor> {
    Ok(logits.contiguous()?.apply_op2(&targets.contiguous()?, BitwiseCrossEntropy)?)
}

/// One operation both ways: put together from candle's, its gradient would be
/// wrong at a logit of exactly 0, where a memory starts.
struct BitwiseCrossEntropy;

const BITWISE: &str = "cairn-bitwise-cross-entropy";

impl CustomOp2 for BitwiseCrossEntropy {
    fn name(&self) -> &'static str {
        BITWISE
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> candle_core::Result<(CpuStorage, Shape)> {
        let (x, t) = (floats(BITWISE, s1, l1)?, floats(BITWISE, s2, l2)?);
        if l1.shape() != l2.shape() {
            candle_core::bail!("{BITWISE}: logits {:?} for targets {:?}", l1.shape(), l2.shape());
        }
        let each = |(x, t): (&f32, &f32)| x.max(0.0) - x * t + (-x.abs()).exp().ln_1p();
        Ok((CpuStorage::F32(x.iter().zip(t).map(each).collect()), l1.shape().clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        t: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> candle_core::Result<(Option<Tensor>, Option<Tensor>)> {
        let each = |x: f32, t: f32| {
            let e = (-x.abs()).exp();
            (if x >= 0.0 { 1.0 } else { e }) / (1.0 + e) - t
        };
        let slope = with_floats(BITWISE, x, |xs| {
            with_floats(BITWISE, t, |ts| {
                with_floats(BITWISE, &grad.contiguous()?, |gs| {
                    xs.iter().zip(ts).zip(gs).map(|((x, t), g)| each(*x, *t) * g).collect::<Vec<f32>>()
                })
            })
        })???;
        Ok((Some(tensor(slope, x.shape())?), None))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    fn rows(values: &[f32], n: usize) -> Var {
        Var::from_vec(values.to_vec(), (n, values.len() / n), &Device::Cpu).unwrap()
    }

    fn value(t: &Tensor) -> f32 {
        t.to_scalar::<f32>().unwrap()
    }

    fn near(got: &[f32], expected: &[f32]) {
        assert_eq!(got.len(), expected.len());
        for (got, expected) in got.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-6, "{got} for {expected}");
        }
    }

    #[test]
    fn cross_entropy_is_the_mean_logarithm_of_the_true_class() {
        // exp: 1, 2, 1 of 4 and 5, 1, 2 of 8. Classes 1 and 2 have 1/2 and 1/4: (ln 2 + ln 4) / 2 = 1.5 ln 2 = 1.0397208.
        let logits = rows(&[0.0, 2.0f32.ln(), 0.0, 5.0f32.ln(), 0.0, 2.0f32.ln()], 2);
        let loss = cross_entropy(&logits, &[1, 2]).unwrap();
        near(&[value(&loss)], &[1.039_720_8]);
        // The slope is the probability, less 1 for the true class, over two rows.
        let slope = loss.backward().unwrap().get(&logits).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        near(&slope, &[0.125, -0.25, 0.125, 0.3125, 0.0625, -0.375]);
        // Nothing said of three classes is ln 3 = 1.0986123; far out it is the difference of logits.
        near(&[value(&cross_entropy(&rows(&[0.0; 3], 1), &[2]).unwrap())], &[1.098_612_3]);
        assert_eq!(value(&cross_entropy(&rows(&[1000.0, -500.0], 1), &[1]).unwrap()), 1500.0);
    }

    #[test]
    fn cross_entropy_wants_one_known_class_a_row() {
        let logits = rows(&[0.0; 6], 2);
        for classes in [&[0, 3][..], &[0], &[0, 1, 2]] {
            let error = cross_entropy(&logits, classes).unwrap_err().to_string();
            assert!(error.contains("one class below 3 for each of 2 rows"), "{classes:?}: {error}");
        }
    }

    #[test]
    fn softmax_is_each_rows_share() {
        let shares = softmax(&rows(&[0.0, 3.0f32.ln(), 2.0f32.ln(), 2.0f32.ln()], 2)).unwrap();
        near(&shares.flatten_all().unwrap().to_vec1::<f32>().unwrap(), &[0.25, 0.75, 0.5, 0.5]);
    }

    #[test]
    fn errors_are_means_of_sizes_and_of_squares() {
        let (a, b) = (rows(&[1.0, -2.0, 0.5, 0.0], 2), rows(&[0.5, 1.0, 0.5, -4.0], 2));
        // Differences 0.5, -3, 0, 4: sizes 7.5 / 4, squares 25.25 / 4.
        let (absolute, squared) = (mean_absolute(&a, &b).unwrap(), mean_squared(&a, &b).unwrap());
        assert_eq!((value(&absolute), value(&squared)), (1.875, 6.3125));
        let slope =
            |of: &Tensor| of.backward().unwrap().get(&a).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        // Signs over four, and twice the differences over four. Where there is no difference the sign counts as 1, which is as
        // good a slope of a size as any from -1.
        near(&slope(&absolute), &[0.25, -0.25, 0.25, 0.25]);
        near(&slope(&squared), &[0.25, -1.5, 0.0, 2.0]);
        assert!(mean_absolute(&a, &rows(&[0.0; 4], 1)).is_err() && mean_squared(&a, &rows(&[0.0; 4], 1)).is_err());
    }
}
