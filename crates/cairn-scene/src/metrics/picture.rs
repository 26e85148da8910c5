//! Pixelwise measures between two pictures. Sums run in f64: a 400 x 600
//! picture has 720 000 terms, and at 50 dB an f32 sum is already off in the
//! second decimal.

use crate::images::picture::Picture;

use crate::metrics::error::{MetricError, finite};

/// Mean squared error over all pixels and channels, in squared picture units
/// (pictures span 0 to 1; values outside are compared as they are).
///
/// # Errors
/// [`MetricError`] for pictures of different sizes or a number that is not finite.
pub fn mse(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    comparable(a, b)?;
    let differences = a.rgb().iter().zip(b.rgb()).map(|(x, y)| f64::from(*x) - f64::from(*y));
    Ok(differences.map(|d| d * d).sum::<f64>() / a.rgb().len() as f64)
}

/// Peak signal-to-noise ratio for pictures that span 0 to 1, in dB:
/// `-10 log10(mse)`. Identical pictures give `f64::INFINITY`.
///
/// # Errors
/// As [`mse`].
pub fn psnr_db(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    mse(a, b).map(psnr_db_from_mse)
}

/// dB from a mean squared error on the 0 to 1 scale; zero gives infinity.
pub fn psnr_db_from_mse(mse: f64) -> f64 {
    if mse == 0.0 { f64::INFINITY } else { -10.0 * mse.log10() }
}

/// Same size, and nothing that is not finite.
pub(crate) fn comparable(a: &Picture, b: &Picture) -> Result<(), MetricError> {
    if (a.width(), a.height()) != (b.width(), b.height()) {
        return Err(MetricError::PictureSize {
            expected_width: a.width(),
            expected_height: a.height(),
            got_width: b.width(),
            got_height: b.height(),
        });
    }
    finite("the first picture", a.rgb())?;
    finite("the second picture", b.rgb())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identical_is_infinite_and_a_tenth_off_is_twenty() {
        let a = Picture::constant(5, 4, [0.5; 3]);
        assert_eq!(psnr_db(&a, &a).unwrap(), f64::INFINITY);
        let b = Picture::constant(5, 4, [0.6; 3]);
        assert!((psnr_db(&a, &b).unwrap() - 20.0).abs() < 1e-5);
    }

    #[test]
    fn bad_input_is_named() {
        let (a, b) = (Picture::constant(4, 3, [0.0; 3]), Picture::constant(3, 4, [0.0; 3]));
        assert!(psnr_db(&a, &b).unwrap_err().to_string().contains("3 x 4"));
        let mut nan = a.clone();
        nan.rgb_mut()[7] = f32::NAN;
        assert!(matches!(mse(&a, &nan), Err(MetricError::NotFinite { index: 7, .. })));
    }
}
