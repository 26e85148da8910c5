//! Progress of a part: a bar on a terminal, now and then a line elsewhere, with
//! the time that is left.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Seconds between lines where nobody sees a bar.
const LINE_EVERY: Duration = Duration::from_secs(15);

/// How far a part is; see the module's text.
pub struct Progress {
    bar: ProgressBar,
    label: String,
    total: u64,
    begun: Instant,
    last_line: Option<Instant>,
}

impl Progress {
    /// Of `total` steps of what `label` says, none done.
    pub fn new(label: &str, total: u64) -> Self {
        let bar = ProgressBar::new(total);
        // The template is a constant that parses; the plain style is there for the day it does not.
        if let Ok(style) = ProgressStyle::with_template("{prefix} [{bar:32}] {pos}/{len} {msg}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(label.to_owned());
        let last_line = (!std::io::stderr().is_terminal()).then(Instant::now);
        if last_line.is_some() {
            eprintln!("{label}");
        }
        Self { bar, label: label.to_owned(), total, begun: Instant::now(), last_line }
    }

    /// `done` steps are done; `more` is what else there is to say.
    pub fn at(&mut self, done: u64, more: &str) {
        let left = match done {
            0 => "?".to_owned(),
            done => clock(self.begun.elapsed().as_secs_f64() / done as f64 * self.total.saturating_sub(done) as f64),
        };
        let message = format!("{more}{left} left");
        if self.last_line.is_some_and(|last_line| last_line.elapsed() >= LINE_EVERY) {
            eprintln!("{} {done}/{} {message}", self.label, self.total);
            self.last_line = Some(Instant::now());
        }
        self.bar.set_position(done);
        self.bar.set_message(message);
    }
}

impl Progress {
    /// `done` of `total` are done, where the total was not known at the start.
    pub fn of(&mut self, done: u64, total: u64) {
        self.total = total;
        self.bar.set_length(total);
        self.at(done, "");
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Seconds as m:ss.
fn clock(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    format!("{}:{:02}", seconds / 60, seconds % 60)
}
