//! Measures between a recovered sound and the true one.
//!
//! SNR says how exact the samples are; log-spectral distance says how alike it
//! sounds, and does not punish a small delay or a flipped phase. Both stand in
//! reports, since either alone can be flattered.

use std::f64::consts::TAU;

use crate::metrics::error::{MetricError, finite};

/// Samples in one analysis frame (32 ms at 8 kHz).
pub const LSD_FRAME: usize = 256;
/// Samples from one frame's start to the next.
pub const LSD_HOP: usize = 128;
/// Power spectra are floored here, in dB for full-scale samples of 1, so that
/// digital silence against faint noise stays a finite distance.
pub const LSD_FLOOR_DB: f64 = -80.0;

/// Signal-to-noise ratio in dB: `10 log10(sum t^2 / sum (t - r)^2)` of recovered
/// samples `r` against true ones `t` (mono, any scale). Exact recovery gives
/// `f64::INFINITY`; noise against true silence gives `f64::NEG_INFINITY`.
///
/// # Errors
/// [`MetricError`] for different lengths, no samples, or a number that is not finite.
pub fn snr_db(recovered: &[f32], truth: &[f32]) -> Result<f64, MetricError> {
    comparable(recovered, truth)?;
    let signal: f64 = truth.iter().map(|t| f64::from(*t).powi(2)).sum();
    let noise: f64 = truth.iter().zip(recovered).map(|(t, r)| (f64::from(*t) - f64::from(*r)).powi(2)).sum();
    Ok(if noise == 0.0 { f64::INFINITY } else { 10.0 * (signal / noise).log10() })
}

/// Log-spectral distance in dB (Gray and Markel 1976): the mean over frames of
/// the root mean square, over frequency bins, of the difference of the two log
/// power spectra. Frames of [`LSD_FRAME`] samples (periodic Hann window) start
/// every [`LSD_HOP`]; the last one is padded with silence. The spectrum is
/// divided by the window's sum, so that [`LSD_FLOOR_DB`] refers to full scale.
///
/// # Errors
/// As [`snr_db`].
pub fn log_spectral_distance_db(recovered: &[f32], truth: &[f32]) -> Result<f64, MetricError> {
    comparable(recovered, truth)?;
    let frames = truth.len().saturating_sub(LSD_FRAME).div_ceil(LSD_HOP) + 1;
    let mut sum = 0.0;
    for start in (0..frames).map(|f| f * LSD_HOP) {
        let (t, r) = (log_spectrum_db(truth, start), log_spectrum_db(recovered, start));
        sum += (t.iter().zip(&r).map(|(x, y)| (x - y).powi(2)).sum::<f64>() / t.len() as f64).sqrt();
    }
    Ok(sum / frames as f64)
}

/// Power spectrum, dB below full scale, in each of `LSD_FRAME / 2 + 1` bins from 0 to
/// half the sample rate, of the frame that begins at `start`; silence behind the end.
pub fn log_spectrum_db(samples: &[f32], start: usize) -> Vec<f64> {
    let window = |i: usize| 0.5 - 0.5 * (TAU * i as f64 / LSD_FRAME as f64).cos();
    // A periodic Hann window sums to half its length.
    let scale = 2.0 / LSD_FRAME as f64;
    let frame: Vec<f64> =
        (0..LSD_FRAME).map(|i| f64::from(samples.get(start + i).copied().unwrap_or(0.0)) * window(i) * scale).collect();
    let floor = 10f64.powf(LSD_FLOOR_DB / 10.0);
    let spectrum = fourier(&frame);
    spectrum[..=LSD_FRAME / 2].iter().map(|(re, im)| 10.0 * (re * re + im * im).max(floor).log10()).collect()
}

/// Discrete Fourier transform of real `samples`, as (real, imaginary) pairs, by
/// splitting into even and odd (Cooley and Tukey 1965); odd lengths are summed
/// directly. One short frame at a time does not earn an FFT library, which is
/// slower to compile than all of this crate.
fn fourier(samples: &[f64]) -> Vec<(f64, f64)> {
    let n = samples.len();
    let turn = |k: usize| (-TAU * k as f64 / n as f64).sin_cos();
    if n % 2 == 1 {
        let bin = |k: usize| {
            samples.iter().enumerate().fold((0.0, 0.0), |(re, im), (i, v)| {
                let (sin, cos) = turn(i * k % n);
                (re + v * cos, im + v * sin)
            })
        };
        return (0..n).map(bin).collect();
    }
    let half = |from: usize| fourier(&samples.iter().skip(from).step_by(2).copied().collect::<Vec<_>>());
    let (even, odd) = (half(0), half(1));
    let bin = |k: usize| {
        let ((sin, cos), (re, im)) = (turn(k), odd[k % (n / 2)]);
        let (base_re, base_im) = even[k % (n / 2)];
        (base_re + cos * re - sin * im, base_im + cos * im + sin * re)
    };
    (0..n).map(bin).collect()
}

fn comparable(recovered: &[f32], truth: &[f32]) -> Result<(), MetricError> {
    if truth.is_empty() {
        return Err(MetricError::Empty { what: "the true sound" });
    }
    if recovered.len() != truth.len() {
        return Err(MetricError::SoundLength { expected: truth.len(), got: recovered.len() });
    }
    finite("the recovered sound", recovered)?;
    finite("the true sound", truth)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_is_infinite_and_a_tenth_of_the_amplitude_is_twenty() {
        let truth: Vec<f32> = (0..1000).map(|i| (i as f32 * 0.1).sin()).collect();
        assert_eq!(snr_db(&truth, &truth).unwrap(), f64::INFINITY);
        assert_eq!(log_spectral_distance_db(&truth, &truth).unwrap(), 0.0);
        let louder: Vec<f32> = truth.iter().map(|v| v * 1.1).collect();
        assert!((snr_db(&louder, &truth).unwrap() - 20.0).abs() < 1e-4);
    }

    #[test]
    fn silence_has_no_signal() {
        assert_eq!(snr_db(&[0.1; 8], &[0.0; 8]).unwrap(), f64::NEG_INFINITY);
        assert_eq!(snr_db(&[0.0; 8], &[0.0; 8]).unwrap(), f64::INFINITY);
        assert!(log_spectral_distance_db(&[0.1; 8], &[0.0; 8]).unwrap().is_finite());
    }

    #[test]
    fn a_quieter_copy_is_its_gain_away() {
        // Broadband, so that no bin meets the floor.
        let mut state = 1u32;
        let truth: Vec<f32> = (0..2048)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / (1 << 24) as f32 - 0.5
            })
            .collect();
        let half: Vec<f32> = truth.iter().map(|v| v * 0.5).collect();
        assert!((log_spectral_distance_db(&half, &truth).unwrap() - 6.0206).abs() < 1e-2);
    }

    #[test]
    fn bad_input_is_named() {
        assert_eq!(snr_db(&[0.0; 3], &[0.0; 4]), Err(MetricError::SoundLength { expected: 4, got: 3 }));
        assert_eq!(snr_db(&[], &[]), Err(MetricError::Empty { what: "the true sound" }));
        assert!(matches!(snr_db(&[f32::NAN], &[0.0]), Err(MetricError::NotFinite { index: 0, .. })));
    }
}
