//! Suite `registration` on tiny made-up captures: every figure is there and finite, and so are the tries and the sheet.

use crate::common::{Place, value};

#[test]
fn the_suite_leaves_rows_tries_and_a_sheet() {
    let place = Place::new();
    place.eval_ok(&["registration", "--case", "lego"]);
    let rows = place.rows();
    assert!(rows.iter().all(|row| row.value.is_finite() && row.suite == "registration"));
    let (small, large) = ("lego, 300 px, quick", "lego, 400 px, quick");
    for case in [small, large] {
        for metric in ["clean: placed", "all together: at 35 dB, low", "photographs: placed", "search, median"] {
            value(&rows, case, metric);
        }
        assert_eq!(value(&rows, case, "turn 45 deg: n"), 2.0, "places of a quick run");
        assert_eq!(value(&rows, case, "wrong placements"), 0.0);
    }
    assert_eq!(value(&rows, small, "pictures of other scenes: n"), 4.0);
    assert!(!rows.iter().any(|row| row.case == large && row.metric.starts_with("pictures of other scenes")));
    for case in ["lego-300", "lego-400"] {
        let tries = std::fs::read(place.path(&format!("out/registration-{case}.json"))).unwrap();
        let tries: serde_json::Value = serde_json::from_slice(&tries).unwrap();
        assert_eq!(tries["trials"].as_array().unwrap().len(), 2 * 18);
        assert!(place.path(&format!("out/registration-{case}.png")).is_file());
    }
    // The field is kept: another run trains none.
    let fields = || std::fs::read_dir(place.path("out/lego")).unwrap().count();
    let before = fields();
    let again = place.eval(&["registration", "--case", "lego"]);
    let said = String::from_utf8_lossy(&again.stderr);
    assert!(again.status.success() && !said.contains("training") && fields() == before, "{said}");
}
