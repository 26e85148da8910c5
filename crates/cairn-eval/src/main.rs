//! The program of the benchmarks: `cargo run --release -p cairn-eval -- field --case lego`.

use std::process::ExitCode;

use cairn_eval::args::Args;
use cairn_eval::{children, parts, run};
use clap::Parser;

/// How many threads candle's element-wise operations take.
const CANDLE_THREADS: &str = "CANDLE_NUM_THREADS";

/// Measures run time and quality of Cairn.
#[derive(Parser)]
#[command(name = "cairn-eval")]
struct Cli {
    #[command(flatten)]
    args: Args,
}

fn main() -> ExitCode {
    leave_cores();
    match answer() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn answer() -> anyhow::Result<()> {
    if std::env::args().nth(1).is_some_and(|first| first == children::COMMAND) {
        return parts::run();
    }
    let args = Cli::parse().args;
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(run::run(&args))
}

/// Gives candle's element-wise operations half of the threads, as the program `cairn` does.
fn leave_cores() {
    if std::env::var_os(CANDLE_THREADS).is_some() {
        return;
    }
    let wanted = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.parse::<usize>().ok()).filter(|n| *n > 0);
    let threads = wanted.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    // SAFETY: no other thread is there yet that could read the environment.
    unsafe { std::env::set_var(CANDLE_THREADS, (threads / 2).max(1).to_string()) };
}
