//! `cairn bench field --quick` on tiny made-up captures: every table, chart and
//! row is there and finite, a missed target is called so, nothing is skipped in
//! silence, and Ctrl-C leaves the ledger as it was. And `cairn bench few` and
//! `cairn bench own` on one of them.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::Place;
use crate::common::captures::captures;
use serde_json::Value;

/// The rows of a CSV below its header, and the header.
fn table(path: &Path) -> (Vec<String>, Vec<Vec<String>>) {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    (lines.next().unwrap(), lines.collect())
}

/// The numbers of a column; those that are empty are left out.
fn numbers(path: &Path, column: &str) -> Vec<f64> {
    let (header, rows) = table(path);
    let at = header.iter().position(|name| name == column).unwrap_or_else(|| panic!("no column {column}: {header:?}"));
    rows.iter().filter(|row| !row[at].is_empty()).map(|row| row[at].parse().unwrap()).collect()
}

#[test]
fn the_suite_leaves_tables_charts_and_rows() {
    let place = Place::new();
    captures(&place);
    std::fs::create_dir(place.path("limits")).unwrap();
    std::fs::write(place.path("limits/field.md"), "What limits it: *nothing but time*.\n").unwrap();
    let common = ["bench", "field", "--quick", "--captures", "captures", "--ledger", "l.json", "--page", "l.md"];
    // One after the other into the same folder: its tables then hold both.
    let mut said = String::new();
    for case in ["lego", "liberty"] {
        said += &place.cairn_ok(&[&common[..], &["--out", "out", "--case", case]].concat());
    }
    check_rows(&place, &said);
    check_tables(&place.path("out"));
    let page = std::fs::read_to_string(place.path("l.md")).unwrap();
    assert!(page.contains("\n## field\n\nWhat limits it: *nothing but time*.\n\n| case |"), "{page}");
    std::fs::write(place.path("limits/field.md"), "What limits it: memory.\n").unwrap();
    place.cairn_ok(&["bench", "page", "--ledger", "l.json"]);
    let again = std::fs::read_to_string(place.path("l.md")).unwrap();
    assert_eq!(again, page.replace("*nothing but time*", "memory"));
    let refused = place.cairn(&["bench", "page", "--ledger", "typo.json", "--page", "l.md"]);
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("typo.json"));
    assert_eq!(std::fs::read_to_string(place.path("l.md")).unwrap(), again, "the page is as it was");
}

#[test]
fn without_curves_only_the_configured_steps_are_measured() {
    let place = Place::new();
    captures(&place);
    let common =
        ["--quick", "--no-curves", "--captures", "captures", "--ledger", "l.json", "--out", "out", "--case", "lego"];
    place.cairn_ok(&[&["bench", "field", "--seed", "2"], &common[..]].concat());
    let ledger: Value = serde_json::from_slice(&std::fs::read(place.path("l.json")).unwrap()).unwrap();
    let rows: Vec<&str> = ledger.as_array().unwrap().iter().map(|row| row["metric"].as_str().unwrap()).collect();
    for metric in ["PSNR", "SSIM", "training", "rendering rays/s"] {
        assert!(rows.contains(&metric), "no {metric}: {rows:?}");
    }
    let curves = |metric: &&&str| {
        metric.contains("of the steps") || metric.contains("as shipped") || metric.contains("left out")
    };
    assert_eq!(rows.iter().find(curves), None);
    assert_eq!(table(&place.path("out/budgets.csv")).1.len(), 1);
    assert!(!place.path("out/tradeoffs.csv").exists());
    let refused = place.cairn(&[&["bench", "few"], &common[..]].concat());
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("--no-curves"));
}

fn check_rows(place: &Place, said: &str) {
    let ledger: Value = serde_json::from_slice(&std::fs::read(place.path("l.json")).unwrap()).unwrap();
    let rows = ledger.as_array().unwrap();
    let find = |case: &str, metric: &str| {
        let row = rows.iter().find(|r| r["case"] == case && r["metric"] == metric);
        row.unwrap_or_else(|| panic!("no row {case}, {metric}"))
    };
    for row in rows {
        assert!(row["value"].as_f64().is_some_and(f64::is_finite), "{row}");
        assert_eq!(row["suite"], "field");
        assert!(!row["command"].as_str().unwrap().contains("captures"), "{row}");
    }
    let (lego, liberty) = ("lego, quick", "liberty, quick");
    for metric in ["SSIM", "PSNR, 1/8 of the steps", "training, 1/2 of the steps", "training rays/s", "stored field"] {
        find(lego, metric);
    }
    for metric in ["limits as shipped: max error", "nothing left out: rendering", "stop at 0.01: RMS error"] {
        find(liberty, metric);
    }
    // Against exact pictures the shipped step shows; what is left out at it hardly does, nor does half precision.
    let error = |metric: &str| find(liberty, metric)["value"].as_f64().unwrap();
    let finer = error("limits as shipped: RMS error against 0.0625 voxels");
    assert!(finer > error("limits as shipped: RMS error"), "{finer}");
    assert!(error("stored in half precision: max error against f32") < 0.5);
    find(liberty, "SSIM, right half");
    // Nobody trains to 33 dB in a moment: a missed target is in the ledger and on the screen.
    let missed = find(lego, "PSNR");
    assert_eq!((&missed["met"], &missed["target"]["value"]), (&Value::Bool(false), &33.0.into()));
    assert!(said.lines().any(|l| l.contains(" PSNR ") && l.contains("MISSED: at least 33.0000 dB")), "{said}");
    assert_eq!(find(liberty, "PSNR on the mask, right half")["target"]["value"], 23.0);
    assert_eq!(find(lego, "training")["met"], true);
    assert_eq!(find(liberty, "rendering rays/s")["target"]["value"], 3e6);
    for (metric, most) in [("peak memory, training", 2048.0), ("peak memory, serving", 500.0)] {
        if cfg!(target_os = "linux") {
            let row = find(lego, metric);
            assert_eq!(row["target"]["value"], most);
            assert!(row["value"].as_f64().unwrap() > 1.0, "{row}");
        } else {
            assert!(said.contains(&format!("SKIPPED {metric}")), "{said}");
        }
    }
}

fn check_tables(out: &Path) {
    let budgets = out.join("budgets.csv");
    let (_, rows) = table(&budgets);
    let of: Vec<[&str; 3]> = rows.iter().map(|r| [r[0].as_str(), r[2].as_str(), r[3].as_str()]).collect();
    let steps = [("1/8", "8"), ("1/4", "16"), ("1/2", "32"), ("1", "64")];
    let wanted = ["lego quick", "liberty quick"].map(|case| steps.map(|(share, steps)| [case, share, steps]));
    assert_eq!(of, wanted.concat());
    for column in ["training_s", "psnr_db", "ssim"] {
        let values = numbers(&budgets, column);
        assert!(values.len() == 8 && values.iter().all(|v| v.is_finite()), "{column}: {values:?}");
    }
    assert_eq!(numbers(&budgets, "mask_psnr_db").len(), 4, "liberty has masks, lego has none");
    let tradeoffs = out.join("tradeoffs.csv");
    for column in ["rays_per_s", "max_error_levels_same_step", "rms_error_levels_fine_step"] {
        let values = numbers(&tradeoffs, column);
        assert!(values.len() >= 2 * 20 && values.iter().all(|v| v.is_finite()), "{column}: {values:?}");
    }
    // Leaving nothing out differs from f64 by rounding alone.
    let (header, rows) = table(&tradeoffs);
    let error = header.iter().position(|name| name == "max_error_levels_same_step").unwrap();
    for row in rows.iter().filter(|row| row[2] == "nothing left out") {
        assert!(row[error].parse::<f64>().unwrap() < 0.1, "{row:?}");
    }
    for sheet in ["lego-field-1-1.png", "lego-field-1-1-8.png", "liberty-field-1-1.png"] {
        let png = std::fs::read(out.join(sheet)).unwrap();
        let sheet = cairn_scene::decode_picture(&png, &cairn_scene::Limits::default(), None).unwrap();
        assert!(sheet.width() > 3 * 256 && sheet.rgb().iter().any(|v| *v != sheet.rgb()[0]));
    }
    for chart in ["budgets", "tradeoffs-lego-quick-max", "tradeoffs-lego-quick-rms", "tradeoffs-liberty-quick-max"] {
        let svg = std::fs::read_to_string(out.join(format!("{chart}.svg"))).unwrap();
        assert!(svg.contains("<polyline") && !svg.contains("NaN") && !svg.contains("inf"), "{chart}: {svg}");
    }
}

#[test]
fn ten_views_are_trained_with_and_without_what_their_distance_asks_for() {
    let place = Place::new();
    captures(&place);
    let common = ["bench", "few", "--quick", "--captures", "captures", "--ledger", "l.json", "--out", "out"];
    place.cairn_ok(&[&common[..], &["--case", "lego"]].concat());
    let ledger: Value = serde_json::from_slice(&std::fs::read(place.path("l.json")).unwrap()).unwrap();
    let rows = ledger.as_array().unwrap();
    let find = |metric: &str| {
        let row = rows.iter().find(|r| r["metric"] == metric).unwrap_or_else(|| panic!("no row {metric} in {rows:?}"));
        assert_eq!((&row["suite"], &row["case"]), (&"few".into(), &"lego, quick, ten views".into()));
        row["value"].as_f64().unwrap()
    };
    // The square of how many times as far as 14 degrees.
    let (apart, smoother) = (find("views look apart"), find("smoother by"));
    assert!((smoother - (apart / 14.0).powi(2).clamp(1.0, 16.0)).abs() < 1e-9, "{apart} degrees, {smoother} times");
    assert!(smoother > 1.0, "a few views from all around: {apart} degrees");
    for metric in ["PSNR", "PSNR, never smoother", "SSIM", "SSIM, never smoother", "training, never smoother"] {
        assert!(find(metric).is_finite());
    }
    assert_ne!(find("PSNR"), find("PSNR, never smoother"), "the same training twice");
}

#[test]
fn a_capture_of_ones_own_is_trained_with_and_without_the_grid_it_asks_for() {
    let place = Place::new();
    captures(&place);
    let gone = std::fs::read_dir(place.path("captures/liberty/images")).unwrap().next().unwrap().unwrap().path();
    std::fs::remove_file(&gone).unwrap();
    // Small enough that its photographs ask for more; without a light of their own, which would forbid that.
    std::fs::write(place.path("small.toml"), "[field]\nvoxels = 4096\nvoxel_px = 2.0\nappearance = \"off\"\n").unwrap();
    let folder = ["--folder", "captures/liberty", "--settings", "small.toml"];
    let common = ["bench", "own", "--quick", "--ledger", "l.json", "--out", "out"];
    let all = [&common[..], &folder].concat();
    let refused = place.cairn(&all);
    let error = String::from_utf8_lossy(&refused.stderr);
    let name = gone.file_name().unwrap().to_str().unwrap();
    assert!(!refused.status.success() && error.contains(name) && error.contains("--skip-missing"), "{error}");
    assert!(!place.path("l.json").exists());
    place.cairn_ok(&[&all[..], &["--skip-missing"]].concat());
    let ledger: Value = serde_json::from_slice(&std::fs::read(place.path("l.json")).unwrap()).unwrap();
    let find = |metric: &str| {
        let rows = ledger.as_array().unwrap();
        let row = rows.iter().find(|r| r["metric"] == metric).unwrap_or_else(|| panic!("no row {metric} in {rows:?}"));
        assert_eq!((&row["suite"], &row["case"]), (&"own".into(), &"liberty, quick, small".into()));
        row["value"].as_f64().unwrap()
    };
    for metric in ["PSNR", "SSIM", "training"] {
        assert!(find(metric).is_finite() && find(&format!("{metric}, never finer")).is_finite());
    }
    assert!(find("vertices") > 2.0 * find("vertices, never finer"));
}

#[test]
fn a_capture_that_is_not_there_is_named_before_any_work() {
    let place = Place::new();
    captures(&place);
    let output = place.cairn(&["bench", "field", "--quick", "--captures", "captures", "--ledger", "l.json"]);
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && error.contains("fern") && error.contains("--case NAME"), "{error}");
    assert!(!place.path("l.json").exists() && !place.path("bench-out").exists());
}

#[test]
#[cfg(unix)]
fn ctrl_c_ends_the_work_and_leaves_the_ledger() {
    let place = Place::new();
    captures(&place);
    std::fs::write(place.path("l.json"), "[]\n").unwrap();
    std::fs::write(place.path("long.toml"), "[field]\nsteps = 1000000\n").unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_cairn"))
        .args(["bench", "field", "--quick", "--case", "lego", "--captures", "captures", "--ledger", "l.json"])
        .args(["--settings", "long.toml", "--out", "out"])
        .current_dir(place.dir.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("lego, training") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "it ended before it trained");
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    // The part writes to the same pipe: this ends when that has ended, too.
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    assert!(!child.wait().unwrap().success());
    assert!(rest.contains("stopped by Ctrl-C"), "{rest}");
    assert_eq!(std::fs::read_to_string(place.path("l.json")).unwrap(), "[]\n");
}
