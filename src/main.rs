//! The one binary: parse, build, run.

// First: its macros stand in for the standard ones in the modules after it.
#[macro_use]
mod out;

mod cli;

use std::process::ExitCode;

use cli::exit::{self, Cancelled};

/// How many threads candle's element-wise operations take.
const CANDLE_THREADS: &str = "CANDLE_NUM_THREADS";

fn main() -> ExitCode {
    leave_cores();
    match cli::Cli::given().and_then(cli::Cli::run) {
        Ok(code) => code,
        Err(error) => match error.downcast_ref::<Cancelled>() {
            Some(cancelled) => {
                eprintln!("{cancelled}");
                ExitCode::from(exit::CANCELLED)
            }
            None => {
                eprintln!("error: {}", exit::in_words(&error));
                ExitCode::from(exit::FAILED)
            }
        },
    }
}

/// Gives candle's element-wise operations half of the threads, if nobody has said how many: the others are for what is begun ahead of a
/// training's steps (`cairn_mark`). candle's threads wait for one another in a loop that does nothing else, and with more of them
/// than idle cores stage 2 on two cores spent a quarter of its processor time there.
fn leave_cores() {
    if std::env::var_os(CANDLE_THREADS).is_some() {
        return;
    }
    let wanted = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.parse::<usize>().ok()).filter(|n| *n > 0);
    let threads = wanted.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    // SAFETY: no other thread is there yet that could read the environment.
    unsafe { std::env::set_var(CANDLE_THREADS, (threads / 2).max(1).to_string()) };
}
