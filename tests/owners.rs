//! Owner records from key to verdict, through the real binary: signed at the
//! owner's side, entered, listed, and verified from files alone.

mod common;

use common::{Daemon, Place};

#[test]
fn a_record_is_signed_entered_verified_and_seen_through_when_forged() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let tiny = place.text("tiny.toml");
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--settings", &tiny, "--data", &data]);
    let (key, bundle) = (place.text("ada.key"), place.text("bundle"));
    place.cairn_ok(&["keys", "new", &key]);
    // A key is never replaced, and its file is its owner's alone.
    assert!(!place.cairn(&["keys", "new", &key]).status.success());

    let daemon = Daemon::start(&place.path("data"), "");
    let connect = ["--connect", daemon.url.as_str()];
    let sign = ["owners", "sign", "town", "--identity", "1", "--key", &key, "--kind", "contribution", "--out", &bundle];
    let said = place.cairn_ok(&[&sign[..], &connect].concat());
    assert!(said.contains("record 0 is durable and published"), "{said}");
    let list = place.text("log.json");
    let listed = place.cairn_ok(&["owners", "list", "town", "--out", &list, connect[0], connect[1]]);
    assert!(listed.starts_with("0  contribution  town  identity 1"), "{listed}");
    let who = place.cairn_ok(&["who", "town", "--view", &first_view(&place, &connect), connect[0], connect[1]]);
    assert!(who.contains("owner records: 0"), "{who}");
    assert!(daemon.terminate().success());

    // The daemon is gone; the files speak.
    let vkey = place.text("bundle/log.vkey");
    let verify = ["owners", "verify", &bundle, "--vkey", &vkey, "--against", &data, "--log", &list];
    let report = place.cairn_ok(&verify);
    assert!(report.starts_with("trusted"), "{report}");
    assert!(place.cairn_ok(&["owners", "verify", &bundle]).starts_with("valid"));

    // Another photograph than the one that was signed for.
    let photographs = place.path("data/scenes/town/photographs");
    for entry in std::fs::read_dir(&photographs).unwrap() {
        let path = entry.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.push(0);
        std::fs::write(&path, bytes).unwrap();
    }
    let forged = place.cairn(&verify);
    assert_eq!(forged.status.code(), Some(1), "{}", String::from_utf8_lossy(&forged.stdout));
    assert!(String::from_utf8_lossy(&forged.stdout).starts_with("invalid"));

    // A changed word in the record itself.
    let record = place.path("bundle/record.json");
    let mut json: serde_json::Value = serde_json::from_slice(&std::fs::read(&record).unwrap()).unwrap();
    let payload = json["payload"].as_str().unwrap().to_owned();
    let swapped =
        if payload.starts_with('e') { payload.replacen('e', "f", 1) } else { payload.replacen(&payload[..1], "e", 1) };
    json["payload"] = swapped.into();
    std::fs::write(&record, json.to_string()).unwrap();
    assert_eq!(place.cairn(&["owners", "verify", &bundle]).status.code(), Some(1));
}

/// A view of identity 1's cluster.
fn first_view(place: &Place, connect: &[&str; 2]) -> String {
    let shown = place.cairn_ok(&["scene", "show", "town", connect[0], connect[1]]);
    let label = shown.lines().find_map(|l| l.trim().strip_prefix("identity 1: ")?.split(',').next()).unwrap();
    let of_label = |l: &&str| l.contains(&format!("by {label}")) && !l.contains("held out");
    shown.lines().find(of_label).unwrap().trim().split("  ").next().unwrap().to_owned()
}
