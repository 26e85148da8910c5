//! Distortions against an outside reference, by hand and by their transposes.

use super::*;
use crate::attack::stretch::Stretch;
use crate::attack::{Attack, RobustConfig};
use serde_json::Value;

fn numbers(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| rng.random_range(0.1f32..0.9)).collect()
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// A picture with edges, slopes and saturated colours, by a formula that Python has as well.
fn figure(width: usize, height: usize) -> Picture {
    let mut rgb = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let (fx, fy) = (x as f64, y as f64);
            let r = 128.0 + 90.0 * (0.35 * fx + 0.2 * fy).sin();
            let g = 110.0 + 80.0 * (0.22 * fx - 0.31 * fy).cos();
            let b = if (x / 6 + y / 6) % 2 == 1 { ((37 * x + 53 * y) % 256) as f64 } else { 60.0 };
            rgb.extend([r, g, b].map(|v| (v.round() / 255.0) as f32));
        }
    }
    made(width, height, rgb)
}

#[test]
fn jpeg_gives_what_libjpeg_gives() {
    let reference: Value = serde_json::from_str(include_str!("../../tests/reference/jpeg.json")).unwrap();
    for quality in [30u8, 75, 95] {
        let expected: Vec<i64> =
            reference[quality.to_string()].as_array().unwrap().iter().map(|v| v.as_i64().unwrap()).collect();
        let got = Distortion::Jpeg { quality }.apply(&figure(20, 18), 0).to_rgb8();
        assert_eq!(got.len(), expected.len());
        let gaps: Vec<i64> = got.iter().zip(&expected).map(|(g, e)| (i64::from(*g) - e).abs()).collect();
        let (worst, mean) = (*gaps.iter().max().unwrap(), gaps.iter().sum::<i64>() as f64 / gaps.len() as f64);
        assert!(worst <= 6 && mean < 0.75, "quality {quality}: {worst} at worst, {mean} in the mean");
    }
}

#[test]
fn linear_distortions_come_back_by_their_transposes() {
    let (w, h) = (21, 14);
    let crop = Distortion::Crop { kept: 0.6, across: 0.3, down: 1.0 };
    for distortion in [
        Distortion::Blur { sigma_px: 1.3 },
        Distortion::Blur { sigma_px: 9.0 },
        Distortion::Blur { sigma_px: 0.0 },
        Distortion::Rotate { degrees: 17.0 },
        Distortion::Rotate { degrees: -90.0 },
        Distortion::Scale { factor: 0.7 },
        Distortion::Scale { factor: 1.6 },
        crop,
    ] {
        let picture = made(w, h, numbers(w * h * 3, 1));
        let (out, trace) = distortion.traced(&picture, 0);
        let slope = numbers(out.rgb().len(), 2);
        let (there, back) = (dot(out.rgb(), &slope), dot(picture.rgb(), &trace.back(slope.clone())));
        assert!((there - back).abs() < 1e-3 * there.abs(), "{distortion:?}: {there} and {back}");
    }
    let stretch = Stretch::new([w, h], [50, 33]);
    let (x, y) = (numbers(w * h * 3, 3), numbers(50 * 33 * 3, 4));
    let (there, back) = (dot(&stretch.apply(&x), &y), dot(&x, &stretch.transpose(&y)));
    assert!((there - back).abs() < 1e-3 * there, "{there} and {back}");
}

#[test]
fn light_passes_its_gain_and_nothing_where_it_was_cut_off() {
    let picture = made(3, 1, vec![0.5, 0.2, 0.9, 0.4, 0.6, 0.0, 1.0, 0.7, 0.55]);
    let (out, trace) = Distortion::Light { brightness: 1.1, contrast: 2.0 }.traced(&picture, 0);
    let by_hand = |v: f32| (0.5 + 2.0 * (1.1 * v - 0.5)).clamp(0.0, 1.0);
    for (out, v) in out.rgb().iter().zip(picture.rgb()) {
        assert!((out - by_hand(*v)).abs() < 1e-6);
    }
    let back = trace.back(vec![1.0; 9]);
    let expected = [2.2, 0.0, 0.0, 2.2, 2.2, 0.0, 0.0, 0.0, 2.2];
    assert!(back.iter().zip(expected).all(|(b, e): (&f32, f32)| (b - e).abs() < 1e-6), "{back:?}");
}

/// A slow change of a picture that JPEG keeps comes back as large as it went in.
#[test]
fn jpeg_passes_the_gradient_of_what_it_keeps() {
    let (w, h) = (32, 32);
    let base = figure(w, h);
    let slow = |x: usize, y: usize, c: usize| 0.04 * (x as f32 / 9.0 + y as f32 / 13.0 + c as f32 * 0.6).sin();
    let change: Vec<f32> = (0..w * h * 3).map(|i| slow(i / 3 % w, i / 3 / w, i % 3)).collect();
    let squeezed = |v: &f32| 0.2 + 0.6 * v;
    let base = made(w, h, base.rgb().iter().map(squeezed).collect());
    let moved = made(w, h, base.rgb().iter().zip(&change).map(|(b, c)| b + c).collect());
    let slope: Vec<f32> = change.iter().map(|c| c * 10.0).collect();
    let jpeg = Distortion::Jpeg { quality: 95 };
    let (from, trace) = jpeg.traced(&base, 0);
    let difference: Vec<f32> = jpeg.apply(&moved, 0).rgb().iter().zip(from.rgb()).map(|(a, b)| a - b).collect();
    let (measured, promised) = (dot(&difference, &slope), dot(&change, &trace.back(slope.clone())));
    assert!((measured / promised - 1.0).abs() < 0.1, "{measured} measured, {promised} by the gradient");
    // And next to nothing comes back of what it throws away: a checkerboard of colour on grey.
    let grey = made(w, h, vec![0.5; w * h * 3]);
    let checker: Vec<f32> =
        (0..w * h).flat_map(|i| if (i % w + i / w) % 2 == 0 { [1.0, -1.0, 0.0] } else { [-1.0, 1.0, 0.0] }).collect();
    let back = Distortion::Jpeg { quality: 50 }.traced(&grey, 0).1.back(checker.clone());
    assert!(dot(&back, &back) < 1e-6 * dot(&checker, &checker), "a gradient where nothing can be changed");
}

#[test]
fn a_gradient_passes_rounding_as_if_nothing_had_happened() {
    let picture = made(2, 1, vec![0.1, 0.25, 0.999, 0.5, 0.0, 1.0]);
    let (out, trace) = Distortion::EightBits.traced(&picture, 0);
    let levels = [26.0, 64.0, 255.0, 128.0, 0.0, 255.0];
    assert_eq!(out.rgb(), levels.map(|level: f32| level / 255.0));
    let slope = vec![0.5, -1.0, 2.0, 0.25, 3.0, -4.0];
    assert_eq!(trace.back(slope.clone()), slope);
}

#[test]
fn noise_has_its_deviation_and_follows_from_its_seed() {
    let grey = made(64, 64, vec![0.5; 64 * 64 * 3]);
    let noise = Distortion::Noise { sigma: 0.1 };
    let noisy = noise.apply(&grey, 7);
    assert_eq!(noisy, noise.apply(&grey, 7));
    assert_ne!(noisy, noise.apply(&grey, 8));
    let n = noisy.rgb().len() as f64;
    let mean = noisy.rgb().iter().map(|v| f64::from(*v)).sum::<f64>() / n;
    let deviation = (noisy.rgb().iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / n).sqrt();
    assert!((mean - 0.5).abs() < 0.003 && (deviation - 0.1).abs() < 0.003, "{mean} {deviation}");
}

#[test]
fn a_quarter_turn_is_counter_clockwise() {
    // A dot at the right of the middle goes to the top.
    let mut picture = Picture::constant(9, 9, [0.0; 3]);
    picture.rgb_mut()[(4 * 9 + 7) * 3..][..3].fill(1.0);
    let turned = Distortion::Rotate { degrees: 90.0 }.apply(&picture, 0);
    assert!(turned.pixel(4, 1)[0] > 0.99 && turned.pixel(7, 4)[0] < 0.01);
}

#[test]
fn every_distortion_of_a_constant_or_single_pixel_stays_in_range() {
    let all = [
        Distortion::Jpeg { quality: 0 },
        Distortion::Blur { sigma_px: 40.0 },
        Distortion::Noise { sigma: 0.5 },
        Distortion::Light { brightness: 9.0, contrast: 9.0 },
        Distortion::Crop { kept: 0.01, across: 2.0, down: -1.0 },
        Distortion::Rotate { degrees: 45.0 },
        Distortion::Scale { factor: 0.01 },
        Distortion::EightBits,
    ];
    for picture in [Picture::constant(1, 1, [1.0; 3]), Picture::constant(17, 3, [0.0, 1.0, 0.3])] {
        for distortion in all {
            let (out, trace) = distortion.traced(&picture, 3);
            assert!(out.rgb().iter().all(|v| (0.0..=1.0).contains(v)), "{distortion:?}");
            let back = trace.back(vec![1.0; out.rgb().len()]);
            assert_eq!(back.len(), picture.rgb().len(), "{distortion:?}");
            assert!(back.iter().all(|v| v.is_finite()), "{distortion:?}");
        }
    }
}

/// Only linear distortions, so that the whole way back can be checked.
#[test]
fn an_attack_comes_back_through_all_that_it_did() {
    let config = RobustConfig {
        enabled: true,
        share: 1.0,
        noise: 0.0,
        light: 0.0,
        jpeg_quality: 100,
        eight_bits: false,
        ..RobustConfig::default()
    };
    let (size, mut longest) = ([40, 30], 0);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for seed in 0..20 {
        let attack = Attack::draw(&config, &mut rng);
        let x = numbers(40 * 30 * 3, seed);
        let attacked = attack.apply(x.clone(), size);
        let y = numbers(attacked.rgb.len(), seed + 100);
        let (there, back) = (dot(&attacked.rgb, &y), dot(&x, &attacked.back(y.clone())));
        assert!((there - back).abs() < 1e-3 * there, "{there} and {back}");
        longest = longest.max(attacked.size[0]);
    }
    assert!(longest <= 40);
}

#[test]
fn a_mark_and_its_twin_meet_the_same_attack() {
    let config = RobustConfig { enabled: true, share: 1.0, ..RobustConfig::default() };
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for _ in 0..10 {
        let attack = Attack::draw(&config, &mut rng);
        let x = numbers(24 * 24 * 3, 1);
        assert_eq!(attack.apply(x.clone(), [24, 24]).rgb, attack.apply(x, [24, 24]).rgb);
    }
    let off = RobustConfig::default();
    let x = numbers(24 * 24 * 3, 1);
    assert_eq!(Attack::draw(&off, &mut rng).apply(x.clone(), [24, 24]).rgb, x);
}

#[test]
fn a_limit_out_of_range_is_named() {
    let bad = RobustConfig { noise: f64::NAN, ..RobustConfig::default() };
    assert!(bad.validate().unwrap_err().to_string().contains("mark.robust.noise"));
    let bad = RobustConfig { jpeg_quality: 0, ..RobustConfig::default() };
    assert!(bad.validate().unwrap_err().to_string().contains("mark.robust.jpeg_quality"));
    assert!(RobustConfig::default().validate().is_ok());
}
