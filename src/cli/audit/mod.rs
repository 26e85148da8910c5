//! `cairn audit`: what an auditor runs who trusts nobody. No daemon is needed,
//! and none is asked: the files, or a log's public tiles, speak for themselves.
//!
//! Every verb answers with coded findings and an exit code; 2 is always "could not
//! be done" (a wrong argument, a file or a server out of reach), never a verdict.

mod against;
mod answer;
pub mod bundle;
mod evidence;
mod follow;
mod http;
mod renders;
mod shares;
mod store;
pub mod trust;

use std::process::ExitCode;

/// What to audit.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Verify a bundle from its files; exit code 0 for valid and trusted, 1 for invalid
    #[command(after_help = "Example:\n  cairn audit bundle bundle --vkey log.vkey")]
    Bundle(bundle::Args),
    /// Verify a complete answer (who contributed, and nobody left out); exit codes as for a bundle
    #[command(after_help = "Example:\n  cairn audit answer answer.json --vkey log.vkey")]
    Answer(answer::Args),
    /// Work out again the shares in an answer about a view, from base field, share table and camera; exit codes as for a
    /// bundle
    #[command(
        after_help = "Example:\n  cairn audit shares answer.json --base-field base.field --share-table base.shares \
                      --scene liberty --view IMG_3.jpg --vkey log.vkey"
    )]
    Shares(shares::Args),
    /// Hash a whole data folder again; exit code 0 clean, 10 checkpoint, 11 log or tile, 12 record, 13 map, 14 working
    /// state, 15 scene, model or render (the smallest, where several are at fault)
    #[command(after_help = "Example:\n  cairn audit store cairn-data --vkey log.vkey")]
    Store(store::Args),
    /// Hold a log, over HTTP, to what it signed before; exit code 20 where it contradicts itself, else as for a store
    #[command(after_help = "Example:\n  cairn audit follow http://log.example --vkey log.vkey --state seen --once")]
    Follow(follow::Args),
    /// Check what `follow` kept of a contradiction; exit code 0 where it proves two histories, 1 where it does not
    #[command(after_help = "Example:\n  cairn audit evidence seen/evidence.json --vkey log.vkey")]
    Evidence(evidence::Args),
}

/// Answers `cairn audit`.
pub fn run(command: &Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Bundle(args) => bundle::run(args),
        Command::Answer(args) => answer::run(args),
        Command::Shares(args) => shares::run(args),
        Command::Store(args) => store::run(args),
        Command::Follow(args) => follow::run(args),
        Command::Evidence(args) => evidence::run(args),
    }
}
