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

fn main() -> ExitCode {
    match cli::Cli::parse().run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            // 1 is the answer `invalid` of a verification; 2 is everything that went wrong.
            ExitCode::from(2)
        }
    }
}
