//! Losses, each one number averaged over everything.

use candle_core::{D, Tensor};

use crate::error::{NnError, Result};

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
