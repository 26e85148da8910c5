//! Why a measure could not be taken. One type for the crate: callers show it
//! and stop, they never choose by kind.

use thiserror::Error;

/// Why two things could not be compared.
#[derive(Debug, Clone, Error, PartialEq)]
pub enum MetricError {
    /// The pictures' sizes differ.
    #[error(
        "cannot compare a {got_width} x {got_height} picture with one of {expected_width} x {expected_height}; resize one of them first"
    )]
    PictureSize {
        /// Pixels across of the first picture.
        expected_width: usize,
        /// Pixels down of the first picture.
        expected_height: usize,
        /// Pixels across of the second picture.
        got_width: usize,
        /// Pixels down of the second picture.
        got_height: usize,
    },
    /// SSIM's window does not fit.
    #[error("SSIM needs at least {window} x {window} pixels, got {width} x {height}; enlarge both pictures")]
    TooSmall {
        /// Side of the window, px.
        window: usize,
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
    /// The sounds' lengths differ.
    #[error("cannot compare {got} samples with {expected}; cut or pad one of the sounds first")]
    SoundLength {
        /// Samples of the true sound.
        expected: usize,
        /// Samples of the recovered sound.
        got: usize,
    },
    /// There is nothing to measure.
    #[error("{what} is empty, so there is nothing to measure")]
    Empty {
        /// What holds nothing.
        what: &'static str,
    },
    /// A number is NaN or infinite.
    #[error("{what} holds {value} at entry {index}, which is no finite number; find the step that made it")]
    NotFinite {
        /// Which input.
        what: &'static str,
        /// Where, counted from 0.
        index: usize,
        /// The number.
        value: f64,
    },
}

/// Refuses the first number of `values` that is not finite; `what` names them.
pub(crate) fn finite(what: &'static str, values: &[f32]) -> Result<(), MetricError> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(index) => Err(MetricError::NotFinite { what, index, value: f64::from(values[index]) }),
    }
}
