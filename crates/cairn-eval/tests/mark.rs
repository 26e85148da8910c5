//! Suites `mark` and `ablation` on tiny made-up captures: what a detector is asked about, that other captures' renders are
//! among it, and that what cannot be asked is reported.

use cairn_eval::results::Row;

use crate::common::{Place, value};

/// How many attacked renders without a mark were asked about, of `views` held-out views: what each attack's rows say has to
/// be what the two rows of all of them say.
fn attacked_pairs(rows: &[Row], case: &str, views: f64) -> f64 {
    let (mut asked, mut owners, mut attacks) = (0.0, 0.0, 0);
    for row in rows.iter().filter(|row| row.case == case) {
        let pairs = row.metric.strip_suffix(": unmarked pairs are unmarked");
        let Some(attack) = pairs.filter(|how| *how != "a stranger's mark") else { continue };
        let tries = match attack {
            attack if attack.starts_with("noise") || attack.starts_with("crop") || attack == "all combined" => 3.0,
            attack if attack.starts_with("rotation") => 2.0,
            _ => 1.0,
        };
        let answers = tries * views;
        // The accuracy is of these and as many marked renders; both have whole numbers of right answers.
        let marked = 2.0 * value(rows, case, &format!("{attack}: accuracy")) - row.value;
        for right in [answers * row.value, answers * marked] {
            let is_whole = (right - right.round()).abs() < 1e-6 && (-1e-6..answers + 1e-6).contains(&right);
            assert!(is_whole, "{case}, {attack}: {right} of {answers}");
        }
        asked += answers;
        owners += answers * (1.0 - row.value);
        attacks += 1;
    }
    assert!(attacks >= 28, "{attacks} of 24 attacks on pictures and four on weights");
    assert_eq!(value(rows, case, "answers on attacked views without a mark"), asked);
    let counted = value(rows, case, "false owners, attacked views without a mark");
    assert!((counted - owners).abs() < 1e-6, "{case}: {counted} for {owners}");
    asked
}

#[test]
fn a_detector_is_asked_about_everything_that_has_no_mark() {
    let place = Place::new();
    // There to be asked about, and not measured, so that there is no field of it.
    cairn_testkit::copy(&place.path("captures/lego"), &place.path("captures/trex"));
    let said = place.eval_ok(&["mark", "--case", "lego", "--case", "liberty"]);
    assert!(said.contains("SKIPPED renders of trex") && said.contains("--case trex"), "{said}");
    assert!(!said.contains("SKIPPED renders of l"), "{said}");
    let rows = place.rows();
    assert!(rows.iter().all(|row| row.value.is_finite()));
    for (case, other) in [("lego, quick", "liberty"), ("liberty, quick", "lego")] {
        let kinds = ["its own photographs, held out", "its own photographs, trained on", "renders of its base field"];
        let others =
            [format!("photographs of {other}"), format!("renders of {other}"), "photographs of trex".to_owned()];
        let (mut asked, mut owners) = (0.0, 0.0);
        for kind in kinds.map(str::to_owned).iter().chain(&others) {
            let answers = value(&rows, case, &format!("answers: {kind}"));
            let pictures = value(&rows, case, &format!("distinct pictures: {kind}"));
            // Fields of so few steps may look the same from two places.
            assert!(pictures >= 2.0 && answers >= 3.0 * pictures, "{case}: {pictures} {kind}, {answers} answers");
            asked += answers;
            owners += answers * (1.0 - value(&rows, case, &format!("unmarked: {kind}")));
        }
        assert_eq!(value(&rows, case, "answers on pictures without a mark, all trainings"), asked);
        let share = value(&rows, case, "false owners among pictures without a mark");
        assert!((share * asked - owners).abs() < 1e-6, "{case}: {share} of {asked} for {owners}");
        assert!(attacked_pairs(&rows, case, value(&rows, case, "held-out views")) > 0.0);
    }
    let png = std::fs::read(place.path("out/lego--quick-1.png")).unwrap();
    let sheet = cairn_scene::decode_picture(&png, &cairn_scene::Limits::default(), None).unwrap();
    assert!(sheet.width() > 7 * 170 && sheet.rgb().iter().any(|v| *v != sheet.rgb()[0]));
}

#[test]
fn what_training_skips_is_compared_with_the_same_not_skipped() {
    let place = Place::new();
    let skips = |rows: &[&str]| -> Vec<Row> {
        place.eval_ok(&[&["ablation", "--case", "lego"], rows].concat());
        place.rows().into_iter().filter(|row| row.case == "lego, quick, skips").collect()
    };
    assert_eq!(skips(&["--row", "full"]).len(), 0, "nothing to compare with");
    let rows = skips(&["--row", "full", "--row", "to the last step"]);
    let what = "training ends when recovery has converged";
    assert!(rows.len() >= 4 && rows.iter().all(|row| row.metric.starts_with(what)), "{rows:?}");
    let share = value(&rows, "lego, quick, skips", &format!("{what}: share of the time saved"));
    assert!(share < 1.0 && share.is_finite());
    assert!(!place.path("results/ablation.jsonl").exists(), "no row of it has a target");
}
