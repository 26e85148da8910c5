//! `cairn owners`: signing records at the owner's side, correcting and listing
//! them, and verifying them from files alone.
//!
//! An auditor pins the key that `vkey` prints, not the bundle's copy: whoever
//! forges a bundle forges that too.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_audit::{Evidence, HiddenSignalInHand, LogView, Outcome, RecordInHand};
use cairn_proto::v1;
use cairn_registry::{Checkpoint, Digest, Envelope, Note, NoteVerifier, OwnerRecord};
use serde::{Deserialize, Serialize};

use super::connect::{Connection, refused};
use super::corrections::{self, DisputeArgs, EraseArgs};
use super::records::vkey;
use super::sign::{SignArgs, sign};
use super::{VERSION, against, read, records, write};

/// What to do with owner records.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Sign a record about an identity of a scene, and enter it into the log
    Sign(SignArgs),
    /// Contest somebody's record: a record that says so
    Dispute(DisputeArgs),
    /// Have a record's envelope erased, and with it all that is personal; its place in the log stays
    Erase(EraseArgs),
    /// Show one record, and whether it stands
    Show {
        /// Its place in the log (see `cairn owners list`)
        index: u64,
    },
    /// The records of a scene, or all
    List {
        /// The scene
        name: Option<String>,
        /// Also keep them in a file, for `verify --log`
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Print the log's public key (vkey), for auditors to pin: a key that comes with a bundle proves nothing
    Vkey {
        /// Write it into a file instead
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Verify a bundle from its files; exit code 0 for valid and trusted, 1 for invalid
    Verify(VerifyArgs),
}

/// `cairn owners verify`.
#[derive(Clone, Debug, clap::Args)]
pub struct VerifyArgs {
    /// The bundle's folder
    pub bundle: PathBuf,
    /// The log's public key (see `cairn owners vkey`), obtained elsewhere than the bundle; without it nothing is trusted
    #[arg(long, value_name = "FILE")]
    pub vkey: Option<PathBuf>,
    /// A data folder whose photographs, settings, marked field and detector, of the record's own training, are held to it
    #[arg(long, value_name = "DIR")]
    pub against: Option<PathBuf>,
    /// The log's records, from `cairn owners list --out`: tells of revocations and disputes
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Answers every `cairn owners` but `verify`.
pub async fn run(line: &Connection, command: Command) -> anyhow::Result<()> {
    match command {
        Command::Sign(args) => {
            let index = sign(line, &args).await?;
            println!("record {index} is durable and published; its bundle is in {}", args.out.display());
            Ok(())
        }
        Command::Dispute(args) => {
            let index = corrections::dispute(line, &args).await?;
            println!("record {index} contests record {}; its bundle is in {}", args.record, args.out.display());
            Ok(())
        }
        Command::Erase(args) => corrections::erase(line, &args).await,
        Command::Show { index } => corrections::show(line, index).await,
        Command::List { name, out } => list(line, name, out.as_ref()).await,
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
        Command::Verify(args) => verify(&args).map(drop),
    }
}

/// The records of a log as `list --out` keeps them.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LogFile {
    format_version: u32,
    /// Records below this were there.
    size: u64,
    records: Vec<LogEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LogEntry {
    index: u64,
    envelope: String,
}

async fn list(line: &Connection, name: Option<String>, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let checkpoint = line.owners().checkpoint(v1::CheckpointRequest { format_version: VERSION }).await;
    let note = Note::parse(&checkpoint.map_err(refused)?.into_inner().checkpoint)?;
    let size = Checkpoint::parse_text(&note.text)?.size;
    let records = records::list(line, &name.unwrap_or_default()).await?;
    for r in &records {
        let owner: [u8; 32] = r.owner_key_sha256.as_ref().try_into().context("the daemon's key id is not 32 bytes")?;
        let identity = if r.envelope.is_empty() { "erased".to_owned() } else { format!("identity {}", r.identity) };
        println!("{}  {}  {}  {identity}  by key {}", r.index, r.kind, r.scene, Digest::from_bytes(owner));
    }
    if let Some(path) = out {
        let entry = |r: &v1::Record| -> anyhow::Result<LogEntry> {
            Ok(LogEntry { index: r.index, envelope: String::from_utf8(r.envelope.to_vec())? })
        };
        let records = records.iter().filter(|r| !r.envelope.is_empty()).map(entry).collect::<Result<_, _>>()?;
        write(path, &serde_json::to_vec_pretty(&LogFile { format_version: 1, size, records })?)?;
    }
    Ok(())
}

/// Answers `cairn owners verify`.
pub fn verify(args: &VerifyArgs) -> anyhow::Result<ExitCode> {
    let report = audit(args)?;
    if args.json {
        println!("{}", report.to_json());
    } else {
        print!("{report}");
    }
    Ok(if report.outcome == Outcome::Invalid { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Recomputes everything from the files that are there.
///
/// # Errors
/// For a file that cannot be read, and for a data folder that has not what the record binds; an invalid
/// record's report comes all the same.
pub fn audit(args: &VerifyArgs) -> anyhow::Result<cairn_audit::Report> {
    let envelope = read(&args.bundle.join("record.json"))?;
    let proof = text(&args.bundle.join("record.tlog-proof"))?;
    let pinned: Option<NoteVerifier> = match &args.vkey {
        None => None,
        Some(path) => {
            let vkey = String::from_utf8(read(path)?)?;
            Some(vkey.trim().parse().with_context(|| format!("{} is no vkey", path.display()))?)
        }
    };
    let log = args.log.as_deref().map(log_view).transpose()?;
    let mut evidence = Evidence {
        envelope: &envelope,
        pinned: pinned.as_ref(),
        proof: proof.as_deref(),
        hidden_signal: hidden_signal(&args.bundle)?,
        log: log.as_ref(),
        ..Evidence::default()
    };
    let mut gathered = Ok(());
    if let Some(data) = &args.against {
        // The record says which files to look at; whether it may be believed is the audit's to say.
        let parsed = Envelope::parse(&envelope).ok().and_then(|e| OwnerRecord::parse(&e.payload).ok());
        if let Some(record) = parsed {
            gathered = against::gather(&mut evidence, data, &record);
        }
    }
    let report = cairn_audit::audit(&evidence);
    if let Some(data) = args.against.as_ref().filter(|_| report.outcome != Outcome::Invalid) {
        gathered?;
        against::all_compared(&report, data)?;
    }
    Ok(report)
}

fn text(path: &Path) -> anyhow::Result<Option<String>> {
    if !path.exists() {
        return Ok(None);
    }
    Ok(Some(String::from_utf8(read(path)?).with_context(|| format!("{} is no text", path.display()))?))
}

fn hidden_signal(bundle: &Path) -> anyhow::Result<Option<HiddenSignalInHand>> {
    let (signal, salt) = (bundle.join("signal.png"), text(&bundle.join("signal.salt"))?);
    let Some(salt) = salt.filter(|_| signal.exists()) else { return Ok(None) };
    let salt: Digest = salt.trim().parse().context("signal.salt is not 32 bytes in hexadecimal")?;
    Ok(Some(HiddenSignalInHand::of(signal.display().to_string(), &salt, &read(&signal)?)))
}

fn log_view(path: &Path) -> anyhow::Result<LogView> {
    let file: LogFile =
        serde_json::from_slice(&read(path)?).with_context(|| format!("{} is no list of records", path.display()))?;
    anyhow::ensure!(file.format_version == 1, "{}: format version {}, 1 is read", path.display(), file.format_version);
    let records = file.records.into_iter();
    let records = records.map(|r| RecordInHand { index: r.index, envelope: r.envelope.into_bytes() }).collect();
    Ok(LogView { size: file.size, records })
}
