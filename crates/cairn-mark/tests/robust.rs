//! Marks that are trained to last: the same bytes from the same seed, and really
//! read after what happens to pictures; and fields with changed weights.

use crate::common::{bytes, cameras, config, field, plan, ran, run, start, trained};
use cairn_mark::{Detector, Distortion, MarkTrainer, MarkedField, Recipe, RobustConfig};

fn robust(steps: u64) -> Recipe {
    let robust = RobustConfig { enabled: true, native_px: 64, ..RobustConfig::default() };
    Recipe { robust, ..config(steps) }
}

#[test]
fn interrupted_and_on_any_number_of_threads_the_same_bytes() {
    let whole = bytes(ran(robust(12)));
    let on_one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert!(on_one.install(|| bytes(ran(robust(12)))) == whole, "one thread and several differ");
    let mut first = start(robust(12));
    for _ in 0..7 {
        first.step().unwrap();
        if first.steps_done() == 5 {
            first.judge().unwrap();
        }
    }
    let stopped = first.checkpoint().unwrap();
    let mut second = MarkTrainer::resume(&stopped, field(), plan(), &mut |_, _| true).unwrap();
    run(&mut second);
    assert!(bytes(second) == whole, "the resumed run ended elsewhere");
    assert!(bytes(ran(config(12))) != whole, "attacks changed nothing");
}

/// Which attacks are drawn hangs on neither setting, so that what differs is what the mark was rounded to.
#[test]
fn marks_in_half_precision_are_trained_on_where_they_are_to_last() {
    let harmless = RobustConfig {
        share: 1.0,
        jpeg_quality: 100,
        blur_px: 0.0,
        noise: 0.0,
        light: 0.0,
        rotate_deg: 0.0,
        scale: 1.0,
        eight_bits: false,
        ..robust(1).robust
    };
    let networks = |half_weights: bool, enabled: bool| {
        let robust = RobustConfig { half_weights, enabled, ..harmless.clone() };
        let [_, detector] = bytes(ran(Recipe { robust, ..config(6) }));
        safetensors::SafeTensors::deserialize(&detector).unwrap().tensor("parameters").unwrap().data().to_vec()
    };
    assert!(networks(true, true) != networks(false, true), "no mark was rounded");
    assert!(networks(true, false) == networks(false, false), "a mark was rounded that is not to last");
}

/// Right answers over marked and unmarked renders after each of `distortions`.
fn accuracy(marked: &MarkedField, detector: &Detector, distortions: &[Distortion]) -> f64 {
    let (mut right, mut asked) = (0, 0);
    let appearance = field().canonical_appearance().clone();
    for camera in cameras() {
        let truth = marked.clusters().identity_of(&camera.pose).identity;
        for (picture, truth) in
            [(marked.render(&camera, &appearance), truth), (field().render(&camera, &appearance), None)]
        {
            for (seed, distortion) in distortions.iter().enumerate() {
                let harmed = distortion.apply(&picture.clone().clamped(), seed as u64);
                right += usize::from(detector.detect(&harmed).unwrap().identity == truth);
                asked += 1;
            }
        }
    }
    right as f64 / asked as f64
}

#[test]
fn what_is_trained_to_last_lasts_longer() {
    let harm = [
        Distortion::Noise { sigma: 0.06 },
        Distortion::Rotate { degrees: 20.0 },
        Distortion::Blur { sigma_px: 0.7 },
        Distortion::Light { brightness: 1.15, contrast: 0.85 },
    ];
    let plain = Recipe { budget_db: 32.0, budget_start_db: 26.0, classify_until: 0.3, ..config(600) };
    let lasting = Recipe { robust: RobustConfig { jpeg_quality: 100, ..robust(1).robust }, ..plain.clone() };
    let score = |config| {
        let (marked, detector) = trained(config);
        accuracy(&marked, &detector, &harm)
    };
    let (without, with) = (score(plain), score(lasting));
    assert!(with > without + 0.05 && with > 0.8, "{with} with, {without} without");
}

#[test]
fn pruned_and_noisy_fields_are_what_they_say() {
    let (marked, _) = trained(config(3));
    let weights = |field: &MarkedField| {
        let mut all = Vec::new();
        let _ = field.base().with_colours(|colours| all.extend_from_slice(colours));
        all
    };
    let zeros = |values: &[f32]| values.iter().filter(|v| **v == 0.0).count() as f64 / values.len() as f64;
    let (before, half) = (weights(&marked), weights(&marked.pruned(0.5)));
    assert!(zeros(&half) > zeros(&before).max(0.3), "{} of {}", zeros(&half), zeros(&before));
    let kept = half.iter().filter(|v| **v != 0.0).fold(f32::INFINITY, |least, v| least.min(v.abs()));
    let lost = before.iter().zip(&half).filter(|(_, h)| **h == 0.0).fold(0.0f32, |most, (b, _)| most.max(b.abs()));
    assert!(lost <= kept, "lost {lost}, kept {kept}");
    assert!(weights(&marked.pruned(0.0)) == before);

    let noisy = weights(&marked.noisy(0.1, 4));
    let rms = |values: &mut dyn Iterator<Item = f32>| {
        let (sum, n) = values.fold((0.0, 0.0), |(s, n), v| (s + f64::from(v).powi(2), n + 1.0));
        (sum / n).sqrt()
    };
    let share = rms(&mut noisy.iter().zip(&before).map(|(a, b)| a - b)) / rms(&mut before.iter().copied());
    assert!((share - 0.1).abs() < 0.005, "noise of {share} RMS");
    assert!(weights(&marked.noisy(0.1, 4)) == noisy && weights(&marked.noisy(0.1, 5)) != noisy);
}

#[test]
fn a_field_in_half_precision_shows_nearly_the_same() {
    let (marked, _) = trained(config(3));
    let half = marked.in_half_precision();
    let raw = |field: &MarkedField| field.base().grid().raw.clone();
    let off = raw(&marked).iter().zip(raw(&half)).map(|(a, b)| (a - b).abs() / a.abs().max(1e-3)).fold(0.0, f32::max);
    // Half a unit in the eleventh bit.
    assert!(off > 0.0 && off <= 0.5f32.powi(11), "densities are off by {off}");
    let (camera, appearance) = (cameras()[0], field().canonical_appearance().clone());
    let (whole, rounded) = (marked.render(&camera, &appearance), half.render(&camera, &appearance));
    let most = whole.rgb().iter().zip(rounded.rgb()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(most > 0.0 && most < 0.5 / 255.0, "half precision changes a pixel by {most}");
}
