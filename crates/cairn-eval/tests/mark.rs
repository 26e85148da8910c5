//! `cairn bench mark --quick` on tiny made-up captures: what a detector is asked about,
//! that other captures' renders are among it, and that what cannot be asked is said.

use crate::common::Place;
use crate::common::captures::captures;
use cairn_scene::{Limits, Picture, decode_picture};
use serde_json::Value;

/// Captures, settings for smaller networks than `--quick` has, and three pictures to hide.
fn prepare(place: &Place) {
    captures(place);
    let small = "[mark]\nsteps = 10\nmost_cost_db = 0.0001\nclassifier.channels = [4, 8]\ndetector = { size = [32, 32], channels = [4, 8] }\n";
    std::fs::write(place.path("small.toml"), small).unwrap();
    std::fs::create_dir(place.path("captures/signals")).unwrap();
    for (at, rgb) in [[0.9, 0.2, 0.1], [0.1, 0.8, 0.2], [0.2, 0.3, 0.9]].into_iter().enumerate() {
        let mut picture = Picture::constant(32, 32, rgb);
        picture.rgb_mut()[..16 * 32 * 3].fill(0.1 * at as f32);
        cairn_scene::save_png(&place.path(&format!("captures/signals/{at}.png")), &picture).unwrap();
    }
}

/// How many harmed renders without a mark were asked about, of `views` held-out views, and how many were given an owner: what
/// each distortion's rows say has to be what the two rows of all of them say.
fn harmed_twins(rows: &[Value], case: &str, views: f64) -> f64 {
    let of_case = || rows.iter().filter(|row| row["case"] == case);
    let value = |metric: &str| {
        let row = of_case().find(|row| row["metric"] == metric);
        row.unwrap_or_else(|| panic!("no row {case}, {metric}"))["value"].as_f64().unwrap()
    };
    let (mut asked, mut owners, mut harms) = (0.0, 0.0, 0);
    for row in of_case() {
        let metric = row["metric"].as_str().unwrap();
        let twins = metric.strip_suffix(": the same views without a mark are unmarked");
        let Some(harm) = twins.filter(|how| *how != "a stranger's mark") else { continue };
        let tries = match harm {
            harm if harm.starts_with("noise") || harm.starts_with("crop") || harm == "all combined" => 3.0,
            harm if harm.starts_with("rotation") => 2.0,
            _ => 1.0,
        };
        let (answers, unmarked) = (tries * views, row["value"].as_f64().unwrap());
        assert_eq!(row["target"]["value"], 1.0, "{case}, {harm}");
        // The accuracy is of these and as many marked renders; both have whole numbers of right answers.
        let marked = 2.0 * value(&format!("{harm}: accuracy")) - unmarked;
        for right in [answers * unmarked, answers * marked] {
            let is_whole = (right - right.round()).abs() < 1e-6 && (-1e-6..answers + 1e-6).contains(&right);
            assert!(is_whole, "{case}, {harm}: {right} of {answers}");
        }
        asked += answers;
        owners += answers * (1.0 - unmarked);
        harms += 1;
    }
    assert!(harms >= 28, "{harms} of 24 distortions of pictures and four of weights");
    assert_eq!(value("answers on harmed views without a mark"), asked);
    let told = value("false owners, harmed views without a mark");
    assert!((told - owners).abs() < 1e-6, "{case}: {told} for {owners}");
    asked
}

#[test]
fn a_detector_is_asked_about_everything_that_has_no_mark() {
    let place = Place::new();
    prepare(&place);
    // There to be asked about, and not measured, so that there is no field of it.
    crate::common::copy(&place.path("captures/lego"), &place.path("captures/trex"));
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
        let (mut pictures, mut asked, mut owners) = (0.0, 0.0, 0.0);
        for kind in &kinds {
            let answers = value(case, &format!("answers: {kind}"));
            let of_kind = value(case, &format!("distinct pictures: {kind}"));
            // Fields of so few steps may look the same from two places.
            let all_differ = answers == 3.0 * of_kind || (kind.starts_with("renders") && answers > 3.0 * of_kind);
            assert!(of_kind >= 2.0 && all_differ, "{case}: {of_kind} {kind}, {answers} answers");
            pictures += of_kind;
            asked += answers;
            owners += answers * (1.0 - value(case, &format!("unmarked: {kind}")));
        }
        let views = value(case, "held-out views");
        let training = value(case, "distinct pictures: its own photographs, trained on");
        // As many again from between the photographs as a split may have.
        assert_eq!(value(case, "answers: renders of its base field"), 3.0 * (views + training + 12.0));
        // The one capture is there under two names, and the third has photographs of the same.
        let twice = value(case, "distinct pictures: photographs of trex");
        let distinct = value(case, "distinct pictures without a mark, each training");
        let renders = pictures - 3.0 * twice;
        assert!(distinct > twice && distinct <= renders + twice, "{case}: {distinct} of {pictures}");
        assert_eq!(value(case, "answers on pictures without a mark, all trainings"), asked);
        let share = value(case, "false owners among pictures without a mark");
        assert!((share * asked - owners).abs() < 1e-6, "{case}: {share} of {asked} for {owners}");
        // What names nobody says nothing.
        let nothing = value(case, "nothing recovered from pictures without a mark");
        assert!((nothing - (1.0 - share)).abs() < 1e-9, "{case}: nothing in {nothing}, owners of {share}");
        let harmed = harmed_twins(rows, case, views);
        let of = |what: &str| -> f64 {
            let bands = [("0", "0.5"), ("0.5", "0.9"), ("0.9", "0.99"), ("0.99", "1")];
            bands.map(|(from, to)| value(case, &format!("{what} with a confidence of {from} to {to}"))).iter().sum()
        };
        assert_eq!(of("renders not harmed, answers"), asked + 2.0 * views);
        assert_eq!(of("answers"), asked + 2.0 * views + 2.0 * harmed);
        for metric in ["reading a picture", "reading a picture without a mark", "rendering with marks"] {
            assert!(value(case, metric) > 0.0);
        }
        // The settings let marks cost next to nothing, so that the budget is raised as a job's would be.
        let budget_db = value(case, "stage 2, marks kept below renders of the base field");
        assert!((55.0..=80.0).contains(&budget_db), "{case}: {budget_db} dB");
        if cfg!(target_os = "linux") {
            assert!(value(case, "peak memory, serving with marks") > 1.0);
        }
    }
    // Each field is rendered once: the second case is asked about what the first one's judgement left.
    let within = |folder: &std::path::Path| -> Vec<std::path::PathBuf> {
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
    };
    let programs = within(&place.path("out/unmarked"));
    assert_eq!(programs.len(), 1);
    let mut kept: Vec<f64> = within(&programs[0]).iter().map(|field| within(field).len() as f64 * 3.0).collect();
    let mut rendered =
        ["lego", "liberty"].map(|of| value(&format!("{of}, quick, small"), "answers: renders of its base field"));
    kept.sort_by(f64::total_cmp);
    rendered.sort_by(f64::total_cmp);
    assert_eq!(kept, rendered, "three forms of each");
    for (case, other) in [("lego", "liberty"), ("liberty", "lego")] {
        let [own, theirs] = [(case, "its base field"), (other, case)]
            .map(|(of, what)| value(&format!("{of}, quick, small"), &format!("distinct pictures: renders of {what}")));
        assert_eq!(own, theirs, "{case}");
    }
    // Held-out poses have no say in whose a pose is: a cluster has training views alone.
    let marked = std::fs::read(place.path("out/lego--quick--small-1.marked")).unwrap();
    let clusters = cairn_mark::MarkedField::from_bytes(&marked).unwrap().clusters().clusters.clone();
    let training = value("lego, quick, small", "distinct pictures: its own photographs, trained on");
    assert_eq!(clusters.iter().map(|cluster| cluster.members.len()).collect::<Vec<_>>(), [training as usize]);
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
        cairn_mark::MarkedField::from_bytes(&bytes.unwrap()).unwrap()
    };
    let (first, both) = (mark("first.marked"), mark("marked"));
    assert_eq!((first.carrier(2), both.carrier(1)), (None, first.carrier(1)));
    assert!(both.carrier(2).is_some());
}
