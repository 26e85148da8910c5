//! `docs/reference/cli.md`, made from the declarations of the commands. A test writes and compares it; the program does
//! not carry this.

use std::fmt::Write as _;

use clap::builder::StyledStr;
use clap::{Arg, ArgAction, Command, CommandFactory as _};

/// What stands above the commands.
const HEAD: &str = "# Commands\n\nEvery command of `cairn`, from the declarations in `src/cli`. `cairn COMMAND --help` says the same. \
    `--json` prints the\nmessage that the daemon answers with; its fields are those of [the contract](api.md), bytes in \
    hexadecimal.\n";

/// The page.
fn page() -> String {
    let mut root = super::Cli::command();
    root.build();
    let mut text = HEAD.to_owned();
    text.push_str("\n## Options of every command\n\n");
    options(&mut text, root.get_arguments().filter(|arg| arg.is_global_set()));
    let help = root.get_after_long_help().map(ToString::to_string).unwrap_or_default();
    write!(text, "\n```text\n{help}\n```\n").expect("a string takes all");
    for command in root.get_subcommands().filter(|command| command.get_name() != "help") {
        section(&mut text, command, &format!("cairn {}", command.get_name()));
    }
    text
}

/// A command, and after it the commands below it.
fn section(text: &mut String, command: &Command, path: &str) {
    let below: Vec<&Command> = command.get_subcommands().filter(|below| below.get_name() != "help").collect();
    let about = command.get_long_about().or(command.get_about()).map(plain).unwrap_or_default();
    write!(text, "\n## {path}\n\n{about}\n").expect("a string takes all");
    let own: Vec<&Arg> = command.get_arguments().filter(|arg| !arg.is_global_set() && arg.get_id() != "help").collect();
    if below.is_empty() || !own.is_empty() {
        let usage = plain(&command.clone().render_usage());
        write!(text, "\n```text\n{}\n```\n", usage.trim_start_matches("Usage: ")).expect("as above");
    }
    if !own.is_empty() {
        text.push('\n');
        options(text, own.into_iter());
    }
    if let Some(help) = command.get_after_help() {
        write!(text, "\n```text\n{}\n```\n", plain(help)).expect("as above");
    }
    for command in below {
        section(text, command, &format!("{path} {}", command.get_name()));
    }
}

/// A list of options and arguments.
fn options<'a>(text: &mut String, options: impl Iterator<Item = &'a Arg>) {
    for arg in options.filter(|arg| !arg.is_hide_set()) {
        let takes = matches!(arg.get_action(), ArgAction::Set | ArgAction::Append);
        let names = arg.get_value_names().unwrap_or_default();
        let values: Vec<String> = names.iter().map(|name| format!("<{name}>")).collect();
        let name = match arg.get_long() {
            Some(long) if takes => format!("--{long} {}", values.join(" ")),
            Some(long) => format!("--{long}"),
            None => values.join(" "),
        };
        let mut about = arg.get_help().map(plain).unwrap_or_default().replace('\n', " ");
        let choices: Vec<String> = arg.get_possible_values().iter().map(|v| format!("`{}`", v.get_name())).collect();
        if takes && !choices.is_empty() && choices != ["`true`", "`false`"] {
            write!(about, ": {}", choices.join(", ")).expect("as above");
        }
        let defaults: Vec<String> =
            arg.get_default_values().iter().map(|value| value.to_string_lossy().into_owned()).collect();
        if takes && !defaults.is_empty() && !arg.is_hide_default_value_set() && !defaults[0].is_empty() {
            write!(about, " [default: {}]", defaults.join(", ")).expect("as above");
        }
        if let Some(variable) = arg.get_env() {
            write!(about, " [variable: {}]", variable.to_string_lossy()).expect("as above");
        }
        writeln!(text, "- `{}`: {about}", name.trim_end()).expect("as above");
    }
}

fn plain(styled: &StyledStr) -> String {
    styled.to_string().trim_end().to_owned()
}

#[test]
fn the_reference_of_commands_is_what_the_declarations_say() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/cli.md");
    let wanted = page();
    if std::env::var_os("CAIRN_WRITE_DOCS").is_some() {
        std::fs::write(&path, &wanted).unwrap();
    }
    let there = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(there == wanted, "{} is old: CAIRN_WRITE_DOCS=1 cargo test -p cairn reference", path.display());
}

/// Lines of help that show a command.
fn examples(command: &Command, found: &mut Vec<String>) {
    let texts = [command.get_after_help(), command.get_after_long_help()];
    for text in texts.into_iter().flatten().map(ToString::to_string) {
        found.extend(text.lines().filter_map(|line| line.strip_prefix("  cairn ")).map(str::to_owned));
    }
    command.get_subcommands().for_each(|below| examples(below, found));
}

#[test]
fn every_example_of_a_help_is_a_command_that_parses() {
    let mut root = super::Cli::command();
    root.build();
    let mut found = Vec::new();
    examples(&root, &mut found);
    assert!(found.len() > 20, "{found:?}");
    for example in found {
        let words = std::iter::once("cairn").chain(example.split_whitespace());
        let parsed = <super::Cli as clap::Parser>::try_parse_from(words);
        assert!(parsed.is_ok(), "cairn {example}: {}", parsed.unwrap_err());
    }
}

#[test]
fn every_command_that_people_type_shows_an_example() {
    fn without(command: &Command, path: &str, missing: &mut Vec<String>) {
        let below: Vec<&Command> = command.get_subcommands().filter(|below| below.get_name() != "help").collect();
        if below.is_empty() && command.get_after_help().is_none() {
            missing.push(path.to_owned());
        }
        below.iter().for_each(|below| without(below, &format!("{path} {}", below.get_name()), missing));
    }
    let mut root = super::Cli::command();
    root.build();
    let mut missing = Vec::new();
    without(&root, "cairn", &mut missing);
    assert!(missing.is_empty(), "no example in the help of {missing:?}");
}
