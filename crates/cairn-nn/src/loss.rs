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
