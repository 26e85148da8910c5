//! Measures that benchmarks alone take. What the program itself reports is in `cairn_scene::metrics`.

use anyhow::ensure;
use cairn_scene::Picture;
use cairn_scene::metrics::{MetricError, psnr_db_from_mse};

/// PSNR over the pixels where `mask` (row-major, `height * width`) is true, dB.
///
/// # Errors
/// For pictures of different sizes, and a mask of another length or without a pixel.
pub fn psnr_db_masked(a: &Picture, b: &Picture, mask: &[bool]) -> anyhow::Result<f64> {
    let pixels = a.width() * a.height();
    ensure!((a.width(), a.height()) == (b.width(), b.height()), "cannot compare pictures of different sizes");
    ensure!(mask.len() == pixels, "the mask needs one entry for each of {pixels} pixels, got {}", mask.len());
    let selected = mask.iter().filter(|m| **m).count();
    ensure!(selected > 0, "the mask selects no pixel; mark at least one");
    let squares = a.rgb().chunks_exact(3).zip(b.rgb().chunks_exact(3)).zip(mask).filter(|(_, m)| **m);
    let sum: f64 = squares
        .map(|((p, q), _)| p.iter().zip(q).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum::<f64>())
        .sum();
    ensure!(sum.is_finite(), MetricError::NotFinite { what: "one of the pictures", index: 0, value: sum });
    Ok(psnr_db_from_mse(sum / (selected * 3) as f64))
}

/// Expected calibration error (Naeini, Cooper and Hauskrecht 2015; Guo et al.
/// 2017): the mean distance between confidence and accuracy over `bins` equal
/// confidence bins `(lower, upper]`, weighted by how many answers fall in each.
/// `answers` pairs the confidence of the answer given, in [0, 1], with whether
/// it was right. 0 is perfectly calibrated.
///
/// # Errors
/// For no answers, no bins, or a confidence outside [0, 1].
pub fn expected_calibration_error(answers: &[(f64, bool)], bins: usize) -> anyhow::Result<f64> {
    ensure!(!answers.is_empty(), "the list of answers is empty, so there is nothing to measure");
    ensure!(bins > 0, "at least one bin is needed, got none");
    let mut table = vec![(0.0, 0u32); bins];
    for (index, &(confidence, right)) in answers.iter().enumerate() {
        let known = (0.0..=1.0).contains(&confidence);
        ensure!(known, "the confidence at entry {index} is {confidence}; a probability in 0 to 1 is needed");
        let bin = ((confidence * bins as f64).ceil() as usize).clamp(1, bins) - 1;
        table[bin].0 += confidence;
        table[bin].1 += u32::from(right);
    }
    // |sum of confidences - right answers| is the bin's gap times its count.
    let gaps: f64 = table.iter().map(|(confidence, right)| (confidence - f64::from(*right)).abs()).sum();
    Ok(gaps / answers.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    /// What scikit-image and NumPy say; make.py beside it wrote it.
    const REFERENCE: &str = include_str!("../../cairn-scene/tests/metrics_reference/metrics.json");

    fn rows(name: &str) -> Vec<Value> {
        serde_json::from_str::<Value>(REFERENCE).unwrap()[name].as_array().unwrap().clone()
    }

    fn number(row: &Value, name: &str) -> f64 {
        row[name].as_f64().unwrap_or_else(|| panic!("no {name} in {row}"))
    }

    fn close(got: f64, row: &Value, name: &str) {
        assert!((got - number(row, name)).abs() < 1e-5, "{name} is {got}, the reference says {row}");
    }

    /// `count` numbers in [0, 1): make.py's `draw`.
    fn draw(seed: u32, count: usize) -> Vec<f32> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        (0..count).map(|_| next()).collect()
    }

    /// make.py's `smooth`.
    fn smooth(values: &[f32], width: usize, height: usize) -> Vec<f32> {
        let at = |x: usize, y: usize, c: usize| values[((y % height) * width + x % width) * 3 + c];
        let mut out = Vec::with_capacity(values.len());
        for (y, x, c) in (0..height).flat_map(|y| (0..width).flat_map(move |x| (0..3).map(move |c| (y, x, c)))) {
            let mut total = 0.0;
            for (dy, dx) in (0..3).flat_map(|dy| (0..3).map(move |dx| (dy, dx))) {
                total += at(x + width + 1 - dx, y + height + 1 - dy, c);
            }
            out.push(total / 9.0);
        }
        out
    }

    #[test]
    fn masked_pictures_agree_with_scikit_image() {
        for row in rows("pictures") {
            let [width, height, seed] = ["width", "height", "seed"].map(|name| number(&row, name) as usize);
            let (seed, noise) = (seed as u32, number(&row, "noise") as f32);
            let clean = smooth(&draw(seed, width * height * 3), width, height);
            let other = clean.iter().zip(draw(seed + 100, clean.len())).map(|(v, n)| v + noise * (n - 0.5)).collect();
            let mask: Vec<bool> = draw(seed + 200, width * height).iter().map(|v| *v < 0.4).collect();
            let (a, b) = (Picture::new(width, height, clean).unwrap(), Picture::new(width, height, other).unwrap());
            close(psnr_db_masked(&a, &b, &mask).unwrap(), &row, "psnr_db_masked");
        }
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
        assert!((psnr_db_masked(&a, &b, &first).unwrap() + 10.0 * (0.25f64 / 3.0).log10()).abs() < 1e-5);
        let refused = |b: &Picture, mask: &[bool]| psnr_db_masked(&a, b, mask).unwrap_err().to_string();
        assert!(refused(&b, &[true; 5]).contains("12 pixels, got 5"));
        assert!(refused(&b, &[false; 12]).contains("no pixel"));
        assert!(refused(&Picture::constant(3, 4, [0.0; 3]), &[true; 12]).contains("different sizes"));
        b.rgb_mut()[7] = f32::NAN;
        assert!(refused(&b, &[true; 12]).contains("NaN"));
    }

    #[test]
    fn calibration_agrees_with_numpy() {
        for row in rows("calibration") {
            let (count, seed) = (number(&row, "answers") as usize, number(&row, "seed") as u32);
            let confidences = draw(seed, count);
            let answers: Vec<(f64, bool)> =
                confidences.iter().zip(draw(seed + 100, count)).map(|(c, r)| (f64::from(*c), r < *c)).collect();
            let got = expected_calibration_error(&answers, number(&row, "bins") as usize).unwrap();
            close(got, &row, "expected_calibration_error");
        }
    }

    #[test]
    fn calibration_of_a_boaster() {
        let boaster: Vec<_> = (0..10).map(|i| (1.0, i < 6)).collect();
        assert!((expected_calibration_error(&boaster, 15).unwrap() - 0.4).abs() < 1e-12);
        let honest: Vec<_> = (0..10).map(|i| (0.6, i < 6)).collect();
        assert!(expected_calibration_error(&honest, 15).unwrap() < 1e-12);
        let error = expected_calibration_error(&[(0.5, true), (f64::NAN, true)], 5).unwrap_err().to_string();
        assert!(error.contains("entry 1 is NaN"), "{error}");
        assert!(expected_calibration_error(&[], 5).is_err() && expected_calibration_error(&[(0.5, true)], 0).is_err());
    }
}
