//! The README's commands, held against the program: documentation that cannot rot.
//!
//! Every line of a `console` block that starts with `$ cairn ` must parse, which a command or an option
//! that is not there does not. Those of a block that needs nobody's capture (`PATH/TO`) and no daemon are run as well, in
//! one fresh folder, in order, and must succeed.

use std::path::Path;
use std::process::Command;

#[test]
fn every_cairn_command_of_the_readme_parses_and_runs_where_it_can() {
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let Ok(text) = std::fs::read_to_string(&readme) else {
        eprintln!("SKIPPED every_cairn_command_of_the_readme_parses_and_runs_where_it_can: no {}", readme.display());
        return;
    };
    let commands = commands(&text);
    assert!(!commands.is_empty(), "the README shows no `$ cairn ...` in a `console` block");
    let folder = tempfile::tempdir().unwrap();
    for (command, elsewhere) in commands {
        let mut arguments: Vec<&str> = command.split_whitespace().skip(1).collect();
        if arguments.first() == Some(&"serve") || command.contains("--connect") || elsewhere {
            arguments.push("--help");
        }
        let output =
            Command::new(env!("CARGO_BIN_EXE_cairn")).args(&arguments).current_dir(folder.path()).output().unwrap();
        assert!(output.status.success(), "$ {command}\n{}", String::from_utf8_lossy(&output.stderr));
    }
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
fn commands_are_found_where_they_are_shown() {
    let text = "```console\n$ cairn jobs # all\noutput\n```\n```text\n$ cairn no\n```\n\
        ```console\n$ cairn a PATH/TO/b\n$ cairn c\n```\n";
    let wanted = [("cairn jobs", false), ("cairn a PATH/TO/b", true), ("cairn c", true)];
    assert_eq!(commands(text), wanted.map(|(c, e)| (c.to_owned(), e)));
}
