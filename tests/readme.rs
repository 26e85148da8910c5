//! The commands of README and guide, held against the program: documentation that cannot rot.
//!
//! Every line of a `console` block that starts with `$ cairn ` must parse, which a command or an option
//! that is not there does not. Those that need no scene and no daemon ([`ALONE`]) are run as well, in one fresh folder, in
//! order, and must succeed, unless their block needs what only its reader has (`PATH/TO`).

use std::path::{Path, PathBuf};

/// Commands that need nothing but the program.
const ALONE: [&str; 3] = ["keys", "completions", "man"];

/// A witness's verifier key.
const VKEY: &str = "witness.example/w1+aa4a09d1+BOpKbGPinFIKvvVQexMuxfmVR3auvr57kkIe6mkURtIs";

/// The README and every page of the guide.
fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let guide = std::fs::read_dir(root.join("docs/guide")).unwrap().map(|entry| entry.unwrap().path());
    let mut pages: Vec<PathBuf> = guide.chain([root.join("README.md")]).collect();
    pages.sort();
    pages
}

#[test]
fn every_cairn_command_of_readme_and_guide_parses_and_runs_where_it_can() {
    let (mut shown, mut run) = (0, 0);
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for (command, elsewhere) in commands(&text) {
            shown += 1;
            let mut arguments: Vec<&str> = command.split_whitespace().skip(1).collect();
            if elsewhere || !arguments.first().is_some_and(|first| ALONE.contains(first)) {
                arguments.push("--help");
            } else {
                run += 1;
            }
            let output = cairn_testkit::daemon::command().args(&arguments).current_dir(folder.path()).output().unwrap();
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{}: $ {command}\n{said}", page.display());
        }
    }
    assert!(shown > 50 && run > 3, "README and guide show {shown} commands in `console` blocks; {run} were run");
}

/// Lines `$ cairn ...` of the text's `console` blocks, without comments, and
/// whether their block needs what only its reader has.
fn commands(text: &str) -> Vec<(String, bool)> {
    let mut found = Vec::new();
    for block in text.split("```console\n").skip(1) {
        let block = block.split("\n```").next().unwrap_or(block);
        let elsewhere = block.contains("PATH/TO");
        for command in block.lines().filter_map(|line| line.strip_prefix("$ ")).filter(|c| c.starts_with("cairn ")) {
            found.push((command.split(" #").next().unwrap_or(command).to_owned(), elsewhere));
        }
    }
    found
}

#[test]
fn every_settings_file_of_the_guide_is_taken() {
    let mut shown = 0;
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for settings in text.split("```toml\n").skip(1).map(|block| block.split("```").next().unwrap()) {
            shown += 1;
            let place = cairn_testkit::daemon::Place::new();
            place.token();
            // The page leaves a witness's verifier key to its reader.
            let settings = settings.replace("VKEY", VKEY);
            std::fs::write(place.path("daemon.toml"), &settings).unwrap();
            // Settings are read before the folder is looked for.
            let said = place.cairn_refused(&["jobs", "--config", "daemon.toml", "--data", "absent"]);
            assert!(said.contains("there is no data folder"), "{}: {settings}\n{said}", page.display());
        }
    }
    assert!(shown >= 2, "the guide shows {shown} files of settings");
}

#[test]
fn commands_are_found_where_they_are_shown() {
    let text = "```console\n$ cairn jobs # all\noutput\n```\n```text\n$ cairn no\n```\n\
        ```console\n$ cairn a PATH/TO/b\n$ cairn c\n```\n";
    let wanted = [("cairn jobs", false), ("cairn a PATH/TO/b", true), ("cairn c", true)];
    assert_eq!(commands(text), wanted.map(|(c, e)| (c.to_owned(), e)));
}
