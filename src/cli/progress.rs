//! Progress for people: a bar on a terminal; now and then a line where the output
//! goes to a file or a pipe.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Seconds between lines of progress where nobody sees a bar.
const LINE_EVERY: Duration = Duration::from_secs(15);

/// How far something is, shown on standard error.
pub struct Progress {
    bar: ProgressBar,
    /// When the last line was written; `None` where none are.
    lines: Option<Instant>,
}

impl Progress {
    /// Nothing is seen of it unless `shown`.
    pub fn new(shown: bool) -> Self {
        if !shown {
            return Self { bar: ProgressBar::hidden(), lines: None };
        }
        let bar = ProgressBar::new(0);
        // The template is a constant that parses; the plain style is there for the day it does not.
        if let Ok(style) = ProgressStyle::with_template("{prefix:12} [{bar:32}] {pos}/{len} {msg}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.enable_steady_tick(Duration::from_millis(250));
        let lines = (!std::io::stderr().is_terminal()).then(Instant::now);
        Self { bar, lines }
    }

    /// Shows that of `what` so many of so many are done, `detail` before the time
    /// left; `seconds_left` below 0 is not known yet.
    pub fn draw(&mut self, what: &str, done: u64, of: u64, detail: &str, seconds_left: f64) {
        self.bar.set_prefix(what.to_owned());
        self.bar.set_length(of);
        self.bar.set_position(done);
        let left = if seconds_left >= 0.0 {
            format!("about {} left", clock(seconds_left))
        } else {
            "time left unknown".into()
        };
        let message = format!("{detail}{left}");
        if self.lines.is_some_and(|last| last.elapsed() >= LINE_EVERY) {
            eprintln!("{what} {done}/{of} {message}");
            self.lines = Some(Instant::now());
        }
        self.bar.set_message(message);
    }

    /// Says something in the place of the time left.
    pub fn say(&self, message: &'static str) {
        self.bar.set_message(message);
    }

    /// Takes the bar away.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }
}

/// Seconds as m:ss, or as h:mm:ss from an hour on.
pub fn clock(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    if hours == 0 { format!("{minutes}:{seconds:02}") } else { format!("{hours}:{minutes:02}:{seconds:02}") }
}
