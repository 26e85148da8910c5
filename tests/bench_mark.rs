//! `cairn bench mark --quick` on tiny made-up captures: what a detector is asked about,
//! that other captures' renders are among it, and that what cannot be asked is said.

mod common;

use cairn_capture::{Limits, Picture, decode_picture};
use common::Place;
use common::captures::captures;
use serde_json::Value;

/// Captures, settings for smaller networks than `--quick` has, and three pictures to hide.
fn prepare(place: &Place) {
    captures(place);
    let small = "[mark]\nsteps = 10\nclassifier.channels = [4, 8]\ndetector = { size = [32, 32], channels = [4, 8] }\n";
    std::fs::write(place.path("small.toml"), small).unwrap();
    std::fs::create_dir(place.path("captures/signals")).unwrap();
    for (at, rgb) in [[0.9, 0.2, 0.1], [0.1, 0.8, 0.2], [0.2, 0.3, 0.9]].into_iter().enumerate() {
        let mut picture = Picture::constant(32, 32, rgb);
        picture.rgb_mut()[..16 * 32 * 3].fill(0.1 * at as f32);
        cairn_capture::save_png(&place.path(&format!("captures/signals/{at}.png")), &picture).unwrap();
    }
}

#[test]
fn a_detector_is_asked_about_everything_that_has_no_mark() {
    let place = Place::new();
    prepare(&place);
    // There to be asked about, and not measured, so that there is no field of it.
    common::copy(&place.path("captures/lego"), &place.path("captures/trex"));
    // What other suites leave there is not taken for a base field.
    std::fs::create_dir(place.path("out")).unwrap();
    std::fs::write(place.path("out/lego-0.field"), "no field").unwrap();
    let common = ["bench", "mark", "--quick", "--settings", "small.toml", "--captures", "captures"];
    let what = ["--ledger", "l.json", "--out", "out", "--case", "lego", "--case", "liberty"];
    let said = place.cairn_ok(&[&common[..], &what].concat());
    assert!(said.contains("SKIPPED renders of trex") && said.contains("--case trex"), "{said}");
    assert!(!said.contains("SKIPPED renders of l"), "{said}");
    let ledger: Value = serde_json::from_slice(&std::fs::read(place.path("l.json")).unwrap()).unwrap();
    let rows = ledger.as_array().unwrap();
    assert!(rows.iter().all(|row| row["value"].as_f64().is_some_and(f64::is_finite)));
    let value = |case: &str, metric: &str| {
        let row = rows.iter().find(|row| row["case"] == case && row["metric"] == metric);
        row.unwrap_or_else(|| panic!("no row {case}, {metric}"))["value"].as_f64().unwrap()
    };
    for (case, other) in [("lego, quick, small", "liberty"), ("liberty, quick, small", "lego")] {
        let kinds = ["its own photographs, held out", "its own photographs, trained on", "renders of its base field"];
        let others =
            [format!("photographs of {other}"), format!("renders of {other}"), "photographs of trex".to_owned()];
        let kinds: Vec<String> = kinds.map(str::to_owned).into_iter().chain(others).collect();
        let (mut asked, mut owners) = (0.0, 0.0);
        for kind in &kinds {
            let pictures = value(case, &format!("pictures: {kind}"));
            assert!(pictures >= 3.0, "{case}: {pictures} {kind}");
            asked += pictures;
            owners += pictures * (1.0 - value(case, &format!("unmarked: {kind}")));
        }
        assert_eq!(value(case, "pictures without a mark, each training"), asked);
        let share = value(case, "false owners among pictures without a mark");
        assert!((share * asked - owners).abs() < 1e-6, "{case}: {share} of {asked} for {owners}");
        let nothing = value(case, "nothing recovered from pictures without a mark");
        assert!((0.0..=1.0).contains(&nothing));
        let bands = [("0", "0.5"), ("0.5", "0.9"), ("0.9", "0.99"), ("0.99", "1")];
        let of = |(from, to): (&str, &str)| value(case, &format!("answers with a confidence of {from} to {to}"));
        assert!(bands.map(of).iter().sum::<f64>() > asked, "harmed renders are asked about as well");
        for metric in ["weights: float16: accuracy", "reading a picture", "rendering with marks"] {
            assert!(value(case, metric) >= 0.0);
        }
        if cfg!(target_os = "linux") {
            assert!(value(case, "peak memory, serving with marks") > 1.0);
        }
    }
    for sheet in ["lego--quick--small-1", "liberty--quick--small-1"] {
        let png = std::fs::read(place.path(&format!("out/{sheet}.png"))).unwrap();
        let sheet = decode_picture(&png, &Limits::default(), None).unwrap();
        assert!(sheet.width() > 7 * 170 && sheet.rgb().iter().any(|v| *v != sheet.rgb()[0]));
    }
}

#[test]
fn what_training_skips_is_compared_with_the_same_not_skipped() {
    let place = Place::new();
    prepare(&place);
    let common =
        ["bench", "ablation", "--quick", "--settings", "small.toml", "--captures", "captures", "--case", "lego"];
    let ledger = |rows: &[&str]| -> Vec<Value> {
        let what = ["--ledger", "l.json", "--out", "out"];
        place.cairn_ok(&[&common[..], &what, rows].concat());
        let all: Vec<Value> = serde_json::from_slice(&std::fs::read(place.path("l.json")).unwrap()).unwrap();
        all.into_iter().filter(|row| row["case"] == "lego, quick, small, skips").collect()
    };
    assert_eq!(ledger(&["--row", "full"]).len(), 0, "nothing to compare with");
    let rows = ledger(&["--row", "full", "--row", "to the last step"]);
    let skipped: Vec<&str> =
        rows.iter().map(|row| row["metric"].as_str().unwrap().split(':').next().unwrap()).collect();
    assert!(
        skipped.len() >= 4 && skipped.iter().all(|s| *s == "training ends when recovery has converged"),
        "{skipped:?}"
    );
    // Both take all of the ten steps, and the same ones.
    let adds =
        |what: &str| rows.iter().find(|row| row["metric"].as_str().unwrap().ends_with(what)).unwrap()["value"].as_f64();
    assert_eq!(adds(": adds to PSNR change"), Some(0.0));
    assert_eq!(adds(": adds to accuracy"), Some(0.0));
    let share = adds(": share of the time saved").unwrap();
    assert!(share < 1.0 && share.is_finite());
}

#[test]
fn heads_that_nobody_uses_and_an_owner_of_later_are_compared_as_well() {
    let place = Place::new();
    prepare(&place);
    let common = ["bench", "ablation", "--quick", "--settings", "small.toml", "--captures", "captures"];
    let which = ["--ledger", "l.json", "--out", "out", "--case", "lego", "--row", "full", "--row", "two owners"];
    let others = ["--row", "two owners, one of them later", "--row", "heads that nobody uses"];
    place.cairn_ok(&[&common[..], &which, &others].concat());
    let rows: Vec<Value> = serde_json::from_slice(&std::fs::read(place.path("l.json")).unwrap()).unwrap();
    let value = |case: &str, metric: &str| {
        let row =
            rows.iter().find(|row| row["case"] == format!("lego, quick, small, {case}") && row["metric"] == metric);
        row.unwrap_or_else(|| panic!("no row {case}, {metric}"))["value"].as_f64().unwrap()
    };
    // `mark.grow_share` of the ten steps for the second owner, after all of them for the first.
    let steps = |case: &str| value(case, "stage 2, steps");
    assert_eq!(
        [steps("two owners"), steps("two owners, one of them later"), steps("heads that nobody uses")],
        [10.0, 4.0, 10.0]
    );
    for what in ["only heads that somebody uses are built", "an owner who comes later is added to what is trained"] {
        assert!(value("skips", &format!("{what}: saves")).is_finite());
        assert!(value("skips", &format!("{what}: adds to accuracy")).abs() <= 1.0);
    }
    // The first owner's mark is the one of before.
    let mark = |name: &str| {
        let bytes =
            std::fs::read(place.path(&format!("out/lego--quick--small--two-owners--one-of-them-later-1.{name}")));
        cairn_stega::MarkedField::from_bytes(&bytes.unwrap()).unwrap()
    };
    let (first, both) = (mark("first.marked"), mark("marked"));
    assert_eq!((first.carrier(2), both.carrier(1)), (None, first.carrier(1)));
    assert!(both.carrier(2).is_some());
}
