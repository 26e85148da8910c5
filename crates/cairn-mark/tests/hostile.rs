//! What must not go wrong on bad input: one clear error, never a panic, and the
//! last good state.

use crate::common::{bytes, cameras, config, field, photograph, plan, ran, run, start, trained};
use cairn_field::Field;
use cairn_mark::{Detector, MarkError, MarkTrainer, MarkedField, Recipe};
use safetensors::tensor::{SafeTensors, TensorView};
use std::collections::HashMap;
use std::sync::Arc;

/// Numbers as they lie in a file.
fn floats(value: f32, n: usize) -> Vec<u8> {
    value.to_le_bytes().repeat(n)
}

/// A file with its header or a part's bytes changed.
fn altered(
    bytes: &[u8],
    change: impl Fn(&mut serde_json::Value),
    part: &str,
    with: impl Fn(&[u8]) -> Vec<u8>,
) -> Vec<u8> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).unwrap();
    let mut header: serde_json::Value = serde_json::from_str(&metadata.metadata().as_ref().unwrap()["cairn"]).unwrap();
    change(&mut header);
    let file = SafeTensors::deserialize(bytes).unwrap();
    assert!(part.is_empty() || file.tensor(part).is_ok(), "no part `{part}`");
    let data: Vec<_> = file
        .tensors()
        .into_iter()
        .map(|(name, t)| {
            let data = if name == part { with(t.data()) } else { t.data().to_vec() };
            let shape =
                if name == part && data.len() != t.data().len() { vec![data.len()] } else { t.shape().to_vec() };
            (name, t.dtype(), shape, data)
        })
        .collect();
    let views = data.iter().map(|(n, t, s, d)| (n.as_str(), TensorView::new(*t, s.clone(), d).unwrap()));
    safetensors::serialize(views, Some(HashMap::from([("cairn".to_owned(), header.to_string())]))).unwrap()
}

/// A file with all numbers of one part set to `value`.
fn filled(bytes: &[u8], part: &str, value: f32) -> Vec<u8> {
    altered(bytes, |_| (), part, |data| floats(value, data.len() / 4))
}

/// A file with one tensor of the file within its part `part` set to `value`.
fn filled_within(bytes: &[u8], part: &str, name: &str, value: f32) -> Vec<u8> {
    altered(bytes, |_| (), part, |data| filled(data, name, value))
}

fn resume(bytes: &[u8]) -> Result<MarkTrainer, MarkError> {
    MarkTrainer::resume(bytes, field(), plan(), &mut |_, _| true)
}

/// A checkpoint after three steps and a judgement, the detector having joined.
fn checkpoint(config: Recipe) -> Vec<u8> {
    let mut trainer = start(config);
    for _ in 0..3 {
        trainer.step().unwrap();
    }
    trainer.judge().unwrap();
    trainer.checkpoint().unwrap()
}

#[test]
fn a_poisoned_step_is_not_taken() {
    // The picture loss at its heaviest, so that a carrier's gradient overflows before its renders do.
    let bytes = checkpoint(Recipe { weight_picture: 1e6, budget_ramp: 0.0, view_refresh_steps: 3, ..config(20) });
    for (name, poisoned, place) in [
        ("a gradient", filled(&bytes, "carrier1.values", 1e37), "a carrier's gradient"),
        ("a gradient's square", filled(&bytes, "carrier1.values", 1e20), "a carrier's gradient"),
        ("the loss", filled_within(&bytes, "networks", "classifier.head.weight", 1e38), "the loss"),
    ] {
        let mut trainer = resume(&poisoned).unwrap();
        let before = trainer.checkpoint().unwrap();
        for _ in 0..2 {
            match trainer.step() {
                Err(MarkError::NotFinite { step: Some(3), place: found }) => assert_eq!(found, place, "{name}"),
                other => panic!("{name}: {other:?}"),
            }
            assert!(trainer.checkpoint().unwrap() == before, "{name}: the state is not as before");
        }
    }
    let mut sound = resume(&bytes).unwrap();
    sound.step().unwrap();
    assert!(sound.checkpoint().unwrap() != bytes, "a step that changes nothing says nothing above");
}

#[test]
fn answers_that_are_not_finite_are_no_answers() {
    let bytes = checkpoint(Recipe { budget_ramp: 0.0, ..config(20) });
    for (name, place) in [("classifier.head.weight", "probability"), ("detector.out.weight", "recovered picture")] {
        let mut trainer = resume(&filled_within(&bytes, "average", name, 3e38)).unwrap();
        let before = *trainer.best().unwrap();
        match trainer.judge() {
            Err(MarkError::NotFinite { step: Some(3), place: found }) => assert!(found.contains(place), "{found}"),
            other => panic!("{name}: {other:?}"),
        }
        assert_eq!(*trainer.best().unwrap(), before);
    }
    let (_, detector) = trained(config(1));
    let bad = filled_within(&detector.to_bytes().unwrap(), "parameters", "classifier.head.weight", 3e38);
    let error = Detector::from_bytes(&bad).unwrap().detect(&photograph(&cameras()[0])).unwrap_err();
    assert!(matches!(error, MarkError::NotFinite { step: None, .. }), "{error}");
    assert!(error.to_string().contains("restore the detector"), "{error}");
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let new = |plan, config| MarkTrainer::new(field(), plan, config, 7, &mut |_, _| true).err().unwrap();
    let mut short = plan();
    short.signals.pop();
    let error = new(short, config(3)).to_string();
    assert!(error.contains("1 signals for 2 identities"), "{error}");
    let with = |change: fn(&mut Recipe)| {
        let mut config = config(3);
        change(&mut config);
        config
    };
    for (wrong, key) in [
        (Recipe { budget_db: 5.0, ..config(3) }, "mark.budget_db"),
        (Recipe { classify_until: 0.0, ..config(3) }, "mark.classify_until"),
        (Recipe { weight_picture: -1.0, ..config(3) }, "mark.weight_picture"),
        (Recipe { enough_snr_db: f64::NAN, ..config(3) }, "mark.enough_snr_db"),
        (Recipe { enough_characters: -0.1, ..config(3) }, "mark.enough_characters"),
        (Recipe { finer: 3, ..config(3) }, "mark.finer"),
        (Recipe { view_refresh_steps: 1_000_001, ..config(3) }, "mark.view_refresh_steps"),
        (Recipe { others: 1_000_001, ..config(3) }, "mark.others"),
        (Recipe { others_cutout_share: 1.5, ..config(3) }, "mark.others_cutout_share"),
        (Recipe { min_confidence: 1.1, ..config(3) }, "mark.min_confidence"),
        (Recipe { center_crop_confidence: 0.4, ..config(3) }, "mark.center_crop_confidence"),
        // 32 px cannot be halved six times; the 64 of `finer` = 2 could.
        (with(|c| c.classifier.channels = vec![8; 6]), "mark.classifier.channels"),
        (with(|c| c.audio.sample_rate_hz = 100), "mark.audio.sample_rate_hz"),
        (with(|c| c.audio.longest_s = 31.0), "mark.audio.longest_s"),
        (with(|c| c.audio.channels = vec![]), "mark.audio.channels"),
        (with(|c| c.audio.channels = vec![8, 0]), "mark.audio.channels"),
        (with(|c| c.text.longest_bytes = 0), "mark.text.longest_bytes"),
        (with(|c| c.text.channels = vec![8; 5]), "mark.text.channels"),
    ] {
        let error = new(plan(), wrong);
        assert!(matches!(error, MarkError::Setting { key: found, .. } if found == key), "{error}");
    }

    let [marked, detector] = bytes(ran(config(1)));
    assert!(MarkedField::from_bytes(&detector).is_err(), "a detector is no marked field");
    assert!(Detector::from_bytes(&marked).is_err(), "a marked field is no detector");
    for cut in [0, 7, 100, marked.len() / 2, marked.len() - 1] {
        assert!(MarkedField::from_bytes(&marked[..cut]).is_err(), "cut at {cut}");
    }
    let old = altered(&detector, |h| h["format"] = "cairn.detector/1".into(), "", <[u8]>::to_vec);
    let error = Detector::from_bytes(&old).err().unwrap().to_string();
    assert!(error.contains("cairn.detector/1") && error.contains("cairn.detector/8"), "{error}");
    // A later program's, whose settings this one does not know.
    let later = |h: &mut serde_json::Value| {
        h["format"] = "cairn.detector/999".into();
        h["config"]["of_later"] = 1.into();
    };
    let error = Detector::from_bytes(&altered(&detector, later, "", <[u8]>::to_vec)).err().unwrap().to_string();
    assert!(error.contains("cairn.detector/999") && error.contains("cairn.detector/8"), "{error}");
    for heads in [
        serde_json::json!({ "picture": true, "audio": u32::MAX, "text": null }),
        serde_json::json!({ "picture": true, "audio": null, "text": 1u64 << 40 }),
        serde_json::json!({ "picture": false, "audio": null, "text": null }),
    ] {
        let huge = altered(&detector, |h| h["heads"] = heads.clone(), "", <[u8]>::to_vec);
        let error = Detector::from_bytes(&huge).err().unwrap().to_string();
        assert!(error.contains("heads") && error.contains("do not fit"), "{error}");
    }
    let nan = filled_within(&detector, "parameters", "detector.memory", f32::NAN);
    let error = Detector::from_bytes(&nan).err().unwrap().to_string();
    assert!(error.contains("NaN") && error.contains("detector.memory"), "{error}");
}

#[test]
fn a_marked_field_of_another_version_is_refused_by_name() {
    let marked = trained(config(2)).0.to_bytes().unwrap();
    let refused = |change: &dyn Fn(&mut serde_json::Value), parts: &[&str]| {
        let error = MarkedField::from_bytes(&altered(&marked, change, "", <[u8]>::to_vec)).err().unwrap().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    for other in ["cairn.marked/1", "cairn.marked/3", "cairn.marked/999"] {
        refused(&|h| h["format"] = other.into(), &[other, "cairn.marked/4", "train the scene again"]);
    }
    refused(&|h| h["density"] = "free".into(), &["densities moved for one identity alone"]);
}

#[test]
fn a_checkpoint_meets_its_own_plan_only() {
    let bytes = start(config(3)).checkpoint().unwrap();
    let refused = |field: Arc<Field>, plan| {
        let error = MarkTrainer::resume(&bytes, field, plan, &mut |_, _| true).err().expect("an error").to_string();
        assert!(error.contains("another base field, or other views"), "{error}");
    };
    let mut other = plan();
    other.signals.swap(0, 1);
    refused(field(), other);
    let mut other = plan();
    other.negatives.pop();
    refused(field(), other);
    let mut other = plan();
    other.views[3].camera.intrinsics.fx += 1e-9;
    refused(field(), other);
    let mut other = plan();
    other.views[3].camera.pose.position.x += 1e-9;
    refused(field(), other);
    let mut other = plan();
    let bright = cairn_field::Appearance::neutral([0.5; 3]);
    other.views[3].appearance = other.views[3].appearance.mixed(&bright, 0.5);
    refused(field(), other);
    let mut other = plan();
    other.clusters.clusters[0].members.pop();
    refused(field(), other);
    refused(crate::common::train_field(59), plan());
    assert!(resume(&bytes).is_ok());
}

#[test]
fn damaged_checkpoints_are_refused_by_part() {
    let bytes = checkpoint(Recipe { budget_ramp: 0.0, ..config(20) });
    assert!(resume(&altered(&bytes, |_| (), "", <[u8]>::to_vec)).is_ok());
    let refused = |bytes: &[u8], parts: &[&str]| {
        let error = resume(bytes).err().unwrap_or_else(|| panic!("{parts:?} taken")).to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{parts:?}: {error}");
    };
    let header = |change: &dyn Fn(&mut serde_json::Value)| altered(&bytes, change, "", <[u8]>::to_vec);
    let old = "cairn.marked.checkpoint/1";
    refused(&header(&|h| h["format"] = old.into()), &[old, "cairn.marked.checkpoint/8"]);
    let later = |h: &mut serde_json::Value| {
        h["format"] = "cairn.marked.checkpoint/1000".into();
        h["config"]["a setting of later"] = 1.into();
    };
    refused(&header(&later), &["cairn.marked.checkpoint/1000", "train the scene again"]);
    for steps in [vec![], vec![3u64], vec![3, 3, 3]] {
        refused(&header(&|h| h["carrier_steps"] = steps.clone().into()), &["carrier_steps", "2 carriers"]);
    }
    refused(&header(&|h| h["step"] = 21.into()), &["step 21 of 20"]);
    // Refused before as many views are drawn as such a training would have seen.
    let endless = |h: &mut serde_json::Value| {
        h["step"] = u64::MAX.into();
        h["config"]["view_refresh_steps"] = 1.into();
    };
    refused(&header(&endless), &["of 20"]);
    refused(&header(&|h| h["joined_at"] = 1_000.into()), &["joined_at", "1000"]);
    refused(&header(&|h| assert!(h.as_object_mut().unwrap().remove("joined_at").is_some())), &["joined_at"]);
    refused(&header(&|h| h["settled"] = serde_json::json!([true])), &["settled", "2 carriers"]);
    let own = serde_json::to_value(vec![config(20); 2]).unwrap();
    refused(&header(&|h| h["of_scenes"] = own.clone()), &["of_scenes", "2 entries for 1 scenes"]);
    let wrong = serde_json::to_value([Recipe { others: 99, ..config(20) }]).unwrap();
    refused(&header(&|h| h["of_scenes"] = wrong.clone()), &["mark.others"]);
    refused(&header(&|h| h["weakest"][0] = 0.into()), &["weakest", "2 identities"]);
    refused(&header(&|h| h["weakest"][0] = 3.into()), &["weakest", "2 identities"]);
    refused(&header(&|h| h["weakest"][1] = f64::NAN.to_bits().into()), &["weakest"]);
    for bad in [f64::NAN, f64::INFINITY] {
        refused(&header(&|h| h["classify_bits"] = bad.to_bits().into()), &["classify_bits"]);
    }
    refused(&header(&|h| h["best"][1][1] = f64::NAN.to_bits().into()), &["best"]);
    refused(&header(&|h| h["best"][2][0] = f64::NAN.to_bits().into()), &["best"]);
    for (part, bad) in [
        ("carrier0.values", f32::NAN),
        ("carrier1.first", f32::INFINITY),
        ("carrier0.second", f32::NEG_INFINITY),
        ("best.carrier1", f32::NAN),
        ("draws0", f32::NAN),
    ] {
        refused(&filled(&bytes, part, bad), &[part, "not finite"]);
    }
    refused(&altered(&bytes, |_| (), "carrier1.first", |data| data[4..].to_vec()), &["carrier1.first", "bytes"]);
    refused(&filled_within(&bytes, "networks", "classifier.head.bias", f32::NAN), &["NaN", "classifier.head.bias"]);
    refused(&filled_within(&bytes, "average", "classifier.head.bias", f32::NAN), &["NaN", "classifier.head.bias"]);
    refused(&altered(&bytes, |_| (), "draws0", |data| data[4..].to_vec()), &["draws0", "bytes"]);
    refused(&filled_within(&bytes, "adam", "square/classifier.head.bias", f32::INFINITY), &["optimiser", "inf"]);
    refused(&filled_within(&bytes, "best.networks", "classifier.head.bias", f32::NAN), &["NaN"]);
    for cut in (0..bytes.len()).step_by(bytes.len() / 40) {
        assert!(resume(&bytes[..cut]).is_err(), "cut at {cut}");
    }
}

#[test]
fn a_pixel_that_is_not_finite_is_named() {
    let (_, detector) = trained(config(1));
    let mut picture = photograph(&cameras()[0]);
    picture.rgb_mut()[(5 * 40 + 3) * 3] = f32::NAN;
    let error = detector.detect(&picture).unwrap_err().to_string();
    assert!(error.contains("(3, 5)"), "{error}");
}

#[test]
fn after_the_last_step_there_is_nothing_more_to_do() {
    let mut trainer = start(config(2));
    run(&mut trainer);
    let before = trainer.checkpoint().unwrap();
    assert_eq!(trainer.step().unwrap().step, 2);
    assert!(trainer.checkpoint().unwrap() == before);
}
