//! `cairn ... | head -1`: a reader that leaves ends no command, and makes none panic.

use std::process::Stdio;

use cairn_testkit::daemon::Place;

/// What a command says on standard error, and its exit code, where the reader of its standard output is gone before it
/// writes.
fn unread(place: &Place, arguments: &[&str]) -> (Option<i32>, String) {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut command = cairn_testkit::daemon::command();
    let output = command.args(arguments).current_dir(place.dir.path()).stdout(writer).stderr(Stdio::piped()).output();
    let output = output.unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn commands_whose_reader_left_come_to_their_ordinary_end() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let (key, out) = (place.text("ada.key"), place.text("bundle"));
    let settings = ["--quality", "smoke", "--data", &data];
    let train = [&["train", "town", "--by-contributor", "--base-only"][..], &settings].concat();
    let sign = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", &key, "--out", &out];
    let vkey = place.path("bundle").join("log.vkey").display().to_string();
    let with_data = |arguments: &[&'static str]| [arguments, &["--data"]].concat();
    for arguments in [
        vec!["keys", "new", &key, "--plain"],
        vec!["keys", "show", &key],
        train,
        [&sign[..], &["--data", &data]].concat(),
        [&with_data(&["jobs"])[..], &[&data]].concat(),
        [&with_data(&["scene", "list"])[..], &[&data]].concat(),
        [&with_data(&["scene", "show", "town"])[..], &[&data]].concat(),
        [&with_data(&["owners", "list", "town"])[..], &[&data]].concat(),
        [&with_data(&["owners", "show", "0"])[..], &[&data]].concat(),
        vec!["audit", "bundle", &out, "--vkey", &vkey],
        vec!["audit", "bundle", &out, "--vkey", &vkey, "--json"],
        vec!["audit", "store", &data],
        vec!["--help"],
    ] {
        let (code, said) = unread(&place, &arguments);
        assert!(code == Some(0) && !said.contains("panicked"), "cairn {arguments:?}: {code:?}, {said}");
    }
    // What was not read was done all the same.
    assert!(place.cairn_ok(&["scene", "show", "town", "--data", &data]).contains("model"));
    assert!(place.cairn_ok(&["audit", "bundle", &out, "--vkey", &vkey]).starts_with("trusted"));
    // A verdict is in the exit code, read or not.
    std::fs::write(place.path("bundle").join("record.json"), "{}").unwrap();
    assert_eq!(unread(&place, &["audit", "bundle", &out, "--vkey", &vkey]).0, Some(1));
}
