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
    Ok(differences(a, b).map(|d| d * d).sum::<f64>() / a.rgb().len() as f64)
}

/// Mean absolute error over all pixels and channels, in picture units.
///
/// # Errors
/// As [`mse`].
pub fn mae(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    comparable(a, b)?;
    Ok(differences(a, b).map(f64::abs).sum::<f64>() / a.rgb().len() as f64)
}

/// [`mse`] over the pixels where `mask` (row-major, `height * width`) is true.
///
/// # Errors
/// As [`mse`]; also for a mask of the wrong length or one that selects no pixel.
pub fn mse_masked(a: &Picture, b: &Picture, mask: &[bool]) -> Result<f64, MetricError> {
    comparable(a, b)?;
    let selected = checked_mask(a, mask)?;
    let squares = a.rgb().chunks_exact(3).zip(b.rgb().chunks_exact(3)).zip(mask).filter(|(_, m)| **m);
    let sum: f64 = squares
        .map(|((p, q), _)| p.iter().zip(q).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum::<f64>())
        .sum();
    Ok(sum / (selected * 3) as f64)
}

/// Peak signal-to-noise ratio for pictures that span 0 to 1, in dB:
/// `-10 log10(mse)`. Identical pictures give `f64::INFINITY`.
///
/// # Errors
/// As [`mse`].
pub fn psnr_db(a: &Picture, b: &Picture) -> Result<f64, MetricError> {
    mse(a, b).map(psnr_db_from_mse)
}

/// [`psnr_db`] over the pixels where `mask` (row-major, `height * width`) is true.
///
/// # Errors
/// As [`mse_masked`].
pub fn psnr_db_masked(a: &Picture, b: &Picture, mask: &[bool]) -> Result<f64, MetricError> {
    mse_masked(a, b, mask).map(psnr_db_from_mse)
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

/// How many pixels the mask selects; at least one.
pub(crate) fn checked_mask(a: &Picture, mask: &[bool]) -> Result<usize, MetricError> {
    let expected = a.width() * a.height();
    if mask.len() != expected {
        return Err(MetricError::MaskLength { expected, got: mask.len() });
    }
    match mask.iter().filter(|m| **m).count() {
        0 => Err(MetricError::MaskEmpty { what: "pixels" }),
        selected => Ok(selected),
    }
}

fn differences<'a>(a: &'a Picture, b: &'a Picture) -> impl Iterator<Item = f64> + 'a {
    a.rgb().iter().zip(b.rgb()).map(|(x, y)| f64::from(*x) - f64::from(*y))
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
        assert!((mae(&a, &b).unwrap() - 0.1).abs() < 1e-7);
    }

    #[test]
    fn a_mask_sees_only_its_pixels() {
        let a = Picture::constant(4, 3, [0.2; 3]);
        let mut b = a.clone();
        b.rgb_mut()[..3].copy_from_slice(&[0.7, 0.2, 0.2]);
        let mut mask = vec![true; 12];
        mask[0] = false;
        assert_eq!(psnr_db_masked(&a, &b, &mask).unwrap(), f64::INFINITY);
        let first: Vec<bool> = (0..12).map(|i| i == 0).collect();
        assert!((mse_masked(&a, &b, &first).unwrap() - 0.25 / 3.0).abs() < 1e-7);
        let full = vec![true; 12];
        assert_eq!(mse_masked(&a, &b, &full).unwrap(), mse(&a, &b).unwrap());
    }

    #[test]
    fn bad_input_is_named() {
        let (a, b) = (Picture::constant(4, 3, [0.0; 3]), Picture::constant(3, 4, [0.0; 3]));
        assert!(psnr_db(&a, &b).unwrap_err().to_string().contains("3 x 4"));
        assert_eq!(mse_masked(&a, &a, &[true; 5]), Err(MetricError::MaskLength { expected: 12, got: 5 }));
        assert_eq!(mse_masked(&a, &a, &[false; 12]), Err(MetricError::MaskEmpty { what: "pixels" }));
        let mut nan = a.clone();
        nan.rgb_mut()[7] = f32::NAN;
        assert!(matches!(mse(&a, &nan), Err(MetricError::NotFinite { index: 7, .. })));
    }
}
