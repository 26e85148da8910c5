//! The one binary: parse, build, run.

// First: its macros stand in for the standard ones in the modules after it.
#[macro_use]
mod out;

mod cli;
mod config;
mod daemon;
mod engine;
mod secrets;

use std::process::ExitCode;

use clap::Parser;

/// How many threads candle's element-wise operations take: those that work begun ahead of a training's steps leave
/// (`cairn_stega`), half of them. They wait for one another in a loop that does nothing else, and with more of them than idle cores
/// stage 2 on two cores spent a quarter of its processor time in that loop.
const CANDLE_THREADS: &str = "CANDLE_NUM_THREADS";

fn main() -> ExitCode {
    if std::env::var_os(CANDLE_THREADS).is_none() {
        let threads = std::thread::available_parallelism().map_or(1, |n| (n.get() / 2).max(1));
        // SAFETY: no other thread is there yet that could read the environment.
        unsafe { std::env::set_var(CANDLE_THREADS, threads.to_string()) };
    }
    match cli::Cli::parse().run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            // 1 is the answer `invalid` of a verification; 2 is everything that went wrong.
            ExitCode::from(2)
        }
    }
}
