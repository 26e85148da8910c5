//! Values of the wire's enums as people read them.

/// A value in a word: `JOB_STATE_DONE` without its `prefix` is `done`.
pub fn word(name: &str, prefix: &str) -> String {
    name.trim_start_matches(prefix).to_ascii_lowercase().replace('_', "-")
}
