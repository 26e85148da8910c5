//! The documents that are made from the declarations: `configs/daemon.toml`, the reference page,
//! and a file a preset. A test writes and compares them; the program does not carry this.

use std::fmt::Write as _;

use toml::{Table, Value};

use super::declare::{Allowed, Setting};
use super::preset::{self, GROUPS, Group};
use super::settings::{Settings, TABLES};
use super::training::{Chosen, Preset, Quality};

/// Longest line of a written file.
const WIDTH: usize = 100;

/// Every document: its path in the repository, and its text.
///
/// # Panics
/// Where a declared default is no TOML, which a test rules out.
pub fn all() -> Vec<(String, String)> {
    let mut all = vec![
        ("configs/daemon.toml".to_owned(), daemon_toml()),
        ("docs/reference/config.md".to_owned(), reference()),
        ("configs/balanced.toml".to_owned(), balanced()),
    ];
    all.extend(GROUPS.iter().map(|group| (format!("configs/{}.toml", group.name), preset_file(group))));
    all
}

/// The commented settings file: every setting at its default.
fn daemon_toml() -> String {
    let mut text = comment(
        "The daemon's settings, all of them, at their defaults. A file given with --config needs only the keys that it \
         changes. A key that is not here, and a value that is not allowed, stop the start. Written from the declarations \
         in the code; docs/reference/config.md gives each setting's reason.",
    );
    for (table, values) in TABLES.iter().zip(defaults()) {
        writeln!(text, "\n{}[{}]", comment(table.about), table.path).expect("a string takes all");
        for setting in table.settings {
            let about = format!("{} Allowed: {}.", setting.about.trim(), setting.allowed.words());
            writeln!(text, "{}{} = {}", comment(&about), setting.key, literal(&values, setting)).expect("as above");
        }
    }
    text
}

/// The reference page of the settings.
fn reference() -> String {
    let count: usize = TABLES.iter().map(|table| table.settings.len()).sum();
    let mut text = format!(
        "# Settings\n\nThe daemon has {count} settings. `configs/daemon.toml` holds them all at their defaults; a file given \
         with `--config` needs only\nthe keys that it changes. A key that does not exist, and a value that is not allowed, \
         stop the start with the key, the value and\nwhat is allowed. This page is written from the declarations in \
         `crates/cairn-service/src/config/settings.rs`.\n"
    );
    for (table, values) in TABLES.iter().zip(defaults()) {
        write!(text, "\n## [{}]\n\n{}\n", table.path, flowing(table.about)).expect("a string takes all");
        for setting in table.settings {
            let (kind, allowed) = (type_name(setting.allowed), setting.allowed.words());
            let Setting { key, about, reason, .. } = setting;
            let (default, about) = (literal(&values, setting), flowing(about));
            write!(
                text,
                "\n### `{}.{key}`\n\n{about}\n\n- {kind}; allowed: {allowed}\n- default: `{default}`\n- change it when: {reason}\n",
                table.path
            )
            .expect("as above");
        }
    }
    text
}

/// A setting's type in words.
fn type_name(allowed: Allowed) -> &'static str {
    match allowed {
        Allowed::Whole(..) | Allowed::WholeOrPreset(..) | Allowed::MultipleOrPreset(..) => "whole number",
        Allowed::NumberOrPreset(..) => "number",
        Allowed::Switch => "switch",
        Allowed::OneOf(_) => "word",
        Allowed::Text(_) => "text",
        Allowed::Texts(_) => "list of texts",
    }
}

/// A group's file: its values with their reasons. What differs between presets stands in a table a preset.
fn preset_file(group: &Group) -> String {
    let mut text = comment(&format!(
        "{} This file shows what `{}` sets; it is built into the program and is not read.",
        group.about.trim(),
        group.name
    ));
    let on = [Preset::Forward, Preset::Object, Preset::Outdoor].map(|preset| {
        let chosen = Chosen { preset, quality: Quality::Balanced, robust: false };
        let mut settings = preset::settings(chosen);
        (group.apply)(&mut settings);
        (format!("{preset:?}").to_lowercase(), Table::try_from(&settings).expect("settings are TOML"))
    });
    let [first, ..] = &on;
    let differs =
        group.sets.iter().any(|set| on.iter().any(|(_, of)| value(of, set.path) != value(&first.1, set.path)));
    let shown = if differs { &on[..] } else { &on[..1] };
    for (name, settings) in shown {
        let mut table = None;
        for set in group.sets {
            let (key, path) = set.path.split_last().expect("a set value has a key");
            let within = if differs { [&[name.as_str()], path].concat().join(".") } else { path.join(".") };
            if table.as_ref() != Some(&within) {
                let header = if within.is_empty() { String::new() } else { format!("[{within}]\n") };
                write!(text, "\n{header}").expect("a string takes all");
                table = Some(within);
            }
            let why = if set.why.is_empty() { String::new() } else { comment(set.why) };
            writeln!(text, "{why}{key} = {}", value(settings, set.path)).expect("as above");
        }
    }
    text
}

/// The file of the quality that has no values of its own.
fn balanced() -> String {
    comment(
        "What the measurements are of: the preset of the scene's kind as it stands. `balanced` sets nothing over it.",
    )
}

/// The default values of every table.
fn defaults() -> Vec<Table> {
    let values = Settings::default().values().expect("defaults are TOML");
    values.into_iter().map(|(_, values)| values).collect()
}

/// A setting's default as the file writes it.
fn literal(values: &Table, setting: &Setting) -> String {
    values[setting.key].to_string()
}

/// The value at `path` of settings.
fn value(settings: &Table, path: &[&str]) -> String {
    let mut at = &Value::Table(settings.clone());
    for part in path {
        at = &at[*part];
    }
    at.to_string()
}

/// Prose as lines of comment.
fn comment(prose: &str) -> String {
    let mut lines = vec![String::new()];
    for word in prose.split_whitespace() {
        let line = lines.last_mut().expect("there is one");
        if line.len() + 1 + word.len() + 2 > WIDTH {
            lines.push(word.to_owned());
        } else {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    lines.iter().fold(String::new(), |text, line| text + "# " + line + "\n")
}

/// Prose on one line.
fn flowing(prose: &str) -> String {
    prose.split_whitespace().collect::<Vec<_>>().join(" ")
}
