//! `cairn registry`: what an operator does to the log itself, while no daemon has its folder.

use std::time::Instant;

use super::connect::Where;
use super::progress::Progress;
use cairn_service::config::Config;
use cairn_service::records::anchor;
use cairn_service::records::rebuild::rebuild_registry;

/// What to do with the log.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Make the log's working state again from its public files and envelopes, after it was lost or found damaged
    ///
    /// Move DIR/registry/working away first, with the seal beside it. Nothing acknowledged is lost: what was not
    /// published yet follows from the envelopes.
    #[command(after_help = "Example:\n  cairn registry rebuild --data cairn-data")]
    Rebuild,
    /// Hold the log to its anchor (`registry.anchor_file` of --config) and say where it is
    ///
    /// A log that is not empty does not start without its anchor, since nobody could tell a new setting from a file that was
    /// taken away.
    #[command(after_help = "Example:\n  cairn registry anchor --accept")]
    Anchor {
        /// Write the anchor from the log as it is where the file is missing; compare the log's size with what a witness, a
        /// follower or a receipt says first
        #[arg(long)]
        accept: bool,
    },
}

/// Answers `cairn registry`.
///
/// # Errors
/// For a folder that is in use, or without the log's key; what stands against the log's own word.
pub fn run(place: &Where, config: &Config, command: &Command) -> anyhow::Result<()> {
    anyhow::ensure!(
        place.connect.is_none(),
        "`cairn registry` works on a data folder on this machine; leave --connect out"
    );
    match command {
        Command::Rebuild => rebuild(place, config),
        Command::Anchor { accept } => {
            let head = anchor::hold(&place.data, config, *accept)?;
            println!("the log {} goes on from its anchor: size {}, root {}", head.origin, head.size, head.root);
            Ok(())
        }
    }
}

fn rebuild(place: &Where, config: &Config) -> anyhow::Result<()> {
    let (begun, mut progress) = (Instant::now(), Progress::new(true));
    let rebuilt = rebuild_registry(&place.data, config, &mut |done, of| {
        let left = begun.elapsed().as_secs_f64() * of.saturating_sub(done) as f64 / done.max(1) as f64;
        progress.draw("entries", done, of.max(done), "", left);
    })?;
    progress.end();
    println!(
        "made again: {} records in {} log entries, {} of them not published yet; {} public files were put right",
        rebuilt.records, rebuilt.size, rebuilt.unpublished, rebuilt.tiles
    );
    if rebuilt.left_out > 0 {
        println!(
            "{} entries behind the last whole round were left out: of a round that was cut short and never acknowledged, or \
             lost by the disk after it was; compare with a witness or a receipt that is as new",
            rebuilt.left_out
        );
    }
    println!("the root at the published size is the one that was signed; `cairn audit store` checks all the rest");
    Ok(())
}
