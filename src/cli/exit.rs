//! How a command ends that did not do what was asked: its exit code, and what it says.

use std::error::Error;

use tonic::Status;

/// The exit code of what went wrong. 1 is a verdict: an audit's `invalid`.
pub const FAILED: u8 = 2;
/// The exit code of what a person cancelled: 128 and the number of the signal, as shells have it.
pub const CANCELLED: u8 = 130;

/// A person cancelled it; what was kept, in words.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Cancelled(pub String);

/// An error with its causes, each of which adds something; a daemon's refusal in its own words.
pub fn in_words(error: &anyhow::Error) -> String {
    let mut words = String::new();
    for cause in error.chain() {
        let refused = cause.downcast_ref::<Status>();
        let said = match refused {
            Some(refused) if refused.source().is_some() => format!("the line to the daemon broke ({})", last(refused)),
            Some(refused) => refused.message().to_owned(),
            None => cause.to_string(),
        };
        // Most errors say already what the system said to them.
        if !words.contains(&said) {
            let between = if words.is_empty() { "" } else { ": " };
            words.push_str(&format!("{between}{said}"));
        }
        // What lies behind it is the line's own business.
        if refused.is_some() {
            break;
        }
    }
    words
}

/// The cause of all.
pub fn last(error: &dyn Error) -> String {
    let mut last = error;
    while let Some(cause) = last.source() {
        last = cause;
    }
    last.to_string()
}
