//! What a person may have meant whose command line does not parse: the right command for a guessed word, and the option for
//! a word that stands alone.

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, Error};

use cairn_scene::quoted;

use super::words::job_id;

/// Words that people try as a command, and the command that does it.
const GUESSED: [(&[&str], &str); 14] = [
    (&["import", "add", "new", "create"], "cairn scene import NAME --from DIR"),
    (&["list", "ls", "scenes"], "cairn scene list"),
    (&["show", "info", "views"], "cairn scene show SCENE"),
    (&["check"], "cairn scene check SCENE"),
    (&["delete", "remove", "rm"], "cairn scene delete SCENE"),
    (&["watch", "status", "progress", "trainings"], "cairn jobs"),
    (&["cancel", "stop"], "cairn jobs cancel JOB"),
    (&["resume", "continue"], "cairn train SCENE --resume JOB"),
    (&["detect", "recover", "extract", "decode"], "cairn identify SCENE PICTURE"),
    (&["sign"], "cairn owners sign SCENE --identity N --key FILE --out DIR"),
    (&["records", "log"], "cairn owners list"),
    (&["verify"], "cairn audit"),
    (&["daemon", "server", "start"], "cairn serve"),
    (&["version"], "cairn --version"),
];

/// Commands after whose words one more is an option's, and which option.
const LEFT_AWAY: [(&[&str], &str); 5] = [
    (&["who"], "--view"),
    (&["render"], "--view"),
    (&["owners", "answer"], "--view"),
    (&["scene", "import"], "--from"),
    (&["evaluate"], "--sheet"),
];

/// `error`, which `typed` (the words after the program's name) was refused with, and a tip where one is known; `program`
/// has all commands.
pub fn with_tip(mut error: Error, program: &Command, typed: &[String]) -> Error {
    let word = |kind| match error.get(kind) {
        Some(ContextValue::String(word)) => Some(word.clone()),
        _ => None,
    };
    let tip = match error.kind() {
        ErrorKind::InvalidSubcommand => {
            word(ContextKind::InvalidSubcommand).and_then(|word| meant(program, typed, &word))
        }
        ErrorKind::UnknownArgument => word(ContextKind::InvalidArg).and_then(|word| completed(program, typed, &word)),
        _ => None,
    };
    if let Some(tip) = tip {
        // Its own guesses are by letters alone.
        error.remove(ContextKind::SuggestedSubcommand);
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![StyledStr::from(tip)]));
    }
    error
}

/// The command that was meant with `word` in the place of one.
fn meant(program: &Command, typed: &[String], word: &str) -> Option<String> {
    let above = commands_before(program, typed, word);
    match above[..] {
        [] => {
            let (_, command) = GUESSED.iter().find(|(words, _)| words.contains(&word))?;
            Some(format!("`{command}`"))
        }
        ["jobs"] => job_id(word).ok().map(|job| format!("`cairn jobs show {job}` or `cairn jobs watch {job}`")),
        _ => None,
    }
}

/// The command line with the option before `word` that was left out.
fn completed(program: &Command, typed: &[String], word: &str) -> Option<String> {
    let above = commands_before(program, typed, word);
    let (_, option) = LEFT_AWAY.iter().find(|(command, _)| *command == above)?;
    let at = typed.iter().position(|typed| typed == word).filter(|_| !word.starts_with('-'))?;
    // Two words of one spelling: which of them is meant is not known.
    let is_single = typed.iter().filter(|typed| *typed == word).count() == 1;
    let (before, after) = typed.split_at(at);
    let before = before.iter().map(|word| quoted(word));
    let whole: Vec<String> =
        before.chain([(*option).to_owned()]).chain(after.iter().map(|word| quoted(word))).collect();
    is_single.then(|| format!("`cairn {}`", whole.join(" ")))
}

/// The commands that stand in `typed` before `word`. What follows an option as its value is none.
fn commands_before<'a>(program: &'a Command, typed: &[String], word: &str) -> Vec<&'a str> {
    let (mut at, mut found) = (program, Vec::new());
    let mut words = typed.iter().take_while(|typed| *typed != word);
    while let Some(typed) = words.next() {
        if let Some(command) = at.find_subcommand(typed) {
            found.push(command.get_name());
            at = command;
        } else if [program, at].iter().any(|command| wants_value(command, typed)) {
            words.next();
        }
    }
    found
}

/// Whether `typed` is an option of `command` whose value is the next word.
fn wants_value(command: &Command, typed: &str) -> bool {
    let is_it = |arg: &clap::Arg| match typed.strip_prefix("--") {
        Some(long) => arg.get_long() == Some(long),
        None => arg.get_short().is_some_and(|short| typed.strip_prefix('-') == Some(short.to_string().as_str())),
    };
    command.get_arguments().any(|arg| is_it(arg) && arg.get_action().takes_values())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory as _;

    /// What is said to a command line that is refused.
    fn said(line: &str) -> String {
        let typed: Vec<String> = line.split(' ').map(str::to_owned).collect();
        let program = Cli::command();
        let words = std::iter::once("cairn".to_owned()).chain(typed.clone());
        let error = program.clone().try_get_matches_from(words).unwrap_err();
        with_tip(error, &program, &typed).to_string()
    }

    #[test]
    fn a_guessed_word_is_answered_with_the_command() {
        for (line, command) in [
            ("import town --from capture", "tip: `cairn scene import NAME --from DIR`"),
            ("list", "tip: `cairn scene list`"),
            ("version", "tip: `cairn --version`"),
            ("--data folder ls", "tip: `cairn scene list`"),
            ("--data jobs import town", "tip: `cairn scene import NAME --from DIR`"),
            ("jobs job-000001", "tip: `cairn jobs show job-000001`"),
            ("jobs 1", "tip: `cairn jobs show job-000001`"),
            ("who tower view.png", "tip: `cairn who tower --view view.png`"),
            ("scene import tower capture", "tip: `cairn scene import tower --from capture`"),
            // What is misspelt is clap's to answer.
            ("scene delte town", "'delete'"),
            ("trian town", "'train'"),
        ] {
            let said = said(line);
            assert!(said.contains(command), "{line}: {said}");
        }
        for line in ["nonsense", "jobs nonsense", "who tower --nonsense", "who tower tower", "scene nonsense"] {
            assert!(!said(line).contains("tip: `"), "{line}");
        }
    }

    #[test]
    fn guessed_words_are_no_commands_and_lead_to_some() {
        let program = Cli::command();
        for (words, command) in GUESSED {
            assert!(words.iter().all(|word| program.find_subcommand(word).is_none()), "{words:?}");
            let mut at = &program;
            let leads =
                command.split(' ').skip(1).take_while(|word| word.starts_with(|c: char| c.is_ascii_lowercase()));
            for word in leads {
                at = at.find_subcommand(word).unwrap_or_else(|| panic!("{command}"));
            }
        }
        for (command, option) in LEFT_AWAY {
            let at = command.iter().fold(&program, |at, word| at.find_subcommand(word).unwrap());
            let is_there = |a: &clap::Arg| a.get_long().is_some_and(|long| option == format!("--{long}"));
            assert!(at.get_arguments().any(is_there), "{command:?} {option}");
        }
    }
}
