//! `cairn owners`: signing records at the owner's side, correcting and listing
//! them. Verifying them is `cairn audit`'s.
//!
//! An auditor pins the key that `vkey` prints, not the bundle's copy: a forger
//! of a bundle forges that, too.

use std::path::PathBuf;

use anyhow::Context as _;
use cairn_api::v1;
use cairn_log::{Checkpoint, Digest, Note};
use serde::{Deserialize, Serialize};

use super::answers::{self, AnswerArgs};
use super::bind::{self, BindArgs};
use super::connect::Connection;
use super::corrections::{self, DisputeArgs, EraseArgs};
use super::files::write;
use super::json::{self, Json};
use super::records;
use super::records::vkey;
use super::sign::{SignArgs, sign};

/// What to do with owner records.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Sign a record about a contributor's photographs, or about an identity of a scene, and enter it into the log
    #[command(
        after_help = "Examples:\n  cairn owners sign liberty --contributor ada --key ada.key --out bundle\n  cairn owners sign \
                      liberty --identity 1 --key ada.key --out bundle"
    )]
    Sign(SignArgs),
    /// Say as a curator which key a contributor's name stands for; without that, records in the name are unconfirmed
    #[command(after_help = "Example:\n  cairn owners bind liberty --contributor ada --owner-key \
                      3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c --key curator.key --out binding")]
    Bind(BindArgs),
    /// Who contributed to a scene or a view, as a file that proves that no record is left out; for a view also whose
    /// photographs show it, signed by the registry
    #[command(after_help = "Example:\n  cairn owners answer liberty --view view_056.jpg --out answer.json")]
    Answer(AnswerArgs),
    /// Send again what was signed into DIR and got no answer, or fetch a newer proof of the record in it: with the
    /// cosignatures of witnesses that answered late; nothing is entered twice
    #[command(after_help = "Example:\n  cairn owners submit bundle")]
    Submit {
        /// The folder that `--out` named
        dir: PathBuf,
    },
    /// Contest another owner's record: a record that says so
    #[command(
        after_help = "Example:\n  cairn owners dispute liberty --record 0 --key eve.key --purpose mine --out dispute"
    )]
    Dispute(DisputeArgs),
    /// Have a record's envelope erased, and with it all that is personal; its place in the log stays
    #[command(after_help = "Example:\n  cairn owners erase liberty --record 4 --key eve.key")]
    Erase(EraseArgs),
    /// Show one record, and whether it stands
    #[command(after_help = "Example:\n  cairn owners show 0")]
    Show {
        /// Its place in the log (see `cairn owners list`)
        index: u64,
        #[command(flatten)]
        json: Json,
    },
    /// The records of a scene, or all, and whether each stands
    #[command(after_help = "Example:\n  cairn owners list liberty")]
    List {
        /// The scene
        name: Option<String>,
        /// Also keep them in a file, for `cairn audit bundle --log`
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        #[command(flatten)]
        json: Json,
    },
    /// Print the log's public key (vkey), for auditors and witnesses to pin; where there is no log yet it is begun
    #[command(after_help = "Example:\n  cairn owners vkey --out log.vkey")]
    Vkey {
        /// Write it into a file instead
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
}

impl Command {
    /// Whether it only reads. A witness needs the log's key before the daemon starts: so asking for it begins a log.
    pub const fn reads(&self) -> bool {
        matches!(self, Self::Answer(_) | Self::Show { .. } | Self::List { .. })
    }
}

/// Answers `cairn owners`.
pub async fn run(line: &Connection, command: Command) -> anyhow::Result<()> {
    match command {
        Command::Sign(args) => {
            let place = sign(line, &args).await?;
            println!("{place}; its bundle is in {}", args.out.display());
            place.say_more(&args.out);
            Ok(())
        }
        Command::Bind(args) => bind::run(line, &args).await,
        Command::Submit { dir } => {
            let place = records::Bundle::send_again(line, &dir).await?;
            println!("{place}; its bundle is in {}", dir.display());
            place.say_more(&dir);
            Ok(())
        }
        Command::Dispute(args) => {
            let index = corrections::dispute(line, &args).await?;
            println!("record {index} contests record {}; its bundle is in {}", args.record, args.out.display());
            Ok(())
        }
        Command::Erase(args) => corrections::erase(line, &args).await,
        Command::Show { index, json } => corrections::show(line, index, json).await,
        Command::Answer(args) => answers::run(line, &args).await,
        Command::List { name, out, json } => list(line, name, out.as_ref(), json).await,
        Command::Vkey { out } => {
            let vkey = vkey(line).await?;
            match out {
                Some(path) => write(&path, format!("{vkey}\n").as_bytes()),
                None => {
                    println!("{vkey}");
                    Ok(())
                }
            }
        }
    }
}

/// The records of a log as `list --out` keeps them.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LogFile {
    pub(super) format_version: u32,
    /// Records below this were there.
    pub(super) size: u64,
    pub(super) records: Vec<LogEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LogEntry {
    pub(super) index: u64,
    pub(super) envelope: String,
}

async fn list(line: &Connection, name: Option<String>, out: Option<&PathBuf>, json: Json) -> anyhow::Result<()> {
    let checkpoint = line.owners().checkpoint(v1::CheckpointRequest {}).await;
    let note = Note::parse(&checkpoint?.into_inner().checkpoint)?;
    let size = Checkpoint::parse_text(&note.text)?.size;
    let records = records::list(line, name.as_deref().unwrap_or_default()).await?;
    if let Some(scene) = name.as_ref().filter(|_| records.is_empty()) {
        // The log outlives scenes: one that is gone may have records, but one of neither is a slip.
        super::scene::get(line, scene).await?;
    }
    if json.json {
        let records = records.iter().map(records::as_json).collect::<anyhow::Result<Vec<_>>>()?;
        json::print_value(&serde_json::json!({ "size": size.to_string(), "records": records }))?;
    } else if records.is_empty() {
        eprintln!("no owner records yet; sign one with `cairn owners sign`");
    }
    for r in records.iter().filter(|_| !json.json) {
        let owner: [u8; 32] = r.owner_key_sha256.as_ref().try_into().context("the daemon's key id is not 32 bytes")?;
        let about = match (r.envelope.is_empty(), r.identity) {
            (true, _) => "erased".to_owned(),
            // Names come from strangers: quoted, so that they cannot pass for a column.
            (false, 0) => format!("{}  contributor {:?}  {}", r.scene, r.contributor, corrections::state_of(r)),
            (false, number) => format!("{}  identity {number}  {}", r.scene, corrections::state_of(r)),
        };
        println!("{}  {}  {about}  by key id {}", r.index, r.kind, Digest::from_bytes(owner));
    }
    if let Some(path) = out {
        let entry = |r: &v1::Record| -> anyhow::Result<LogEntry> {
            Ok(LogEntry { index: r.index, envelope: String::from_utf8(r.envelope.to_vec())? })
        };
        let kept = records.iter().filter(|r| !r.envelope.is_empty());
        let records = kept.map(entry).collect::<Result<_, _>>()?;
        write(path, &serde_json::to_vec_pretty(&LogFile { format_version: 1, size, records })?)?;
    }
    Ok(())
}
