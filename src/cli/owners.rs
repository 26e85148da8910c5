//! `cairn owners`: signing records at the owner's side, listing them, and
//! verifying them from files alone.
//!
//! A signed record becomes a bundle, a folder of files that whoever has them can
//! verify without a daemon: `record.json` (DSSE envelope), `record.tlog-proof`,
//! `log.vkey`, and for a claim `signal.png` with `signal.salt`, which are the
//! owner's secret until they choose to show them. An auditor pins the key that
//! `vkey` prints, not the bundle's copy: whoever forges a bundle forges that too.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_audit::{Evidence, HiddenSignalInHand, LogView, Outcome, RecordInHand};
use cairn_proto::v1;
use cairn_registry::record::{Digests, Identity, Seen, hidden_signal_commitment, photographs_root, random_salt};
use cairn_registry::{Checkpoint, Digest, Envelope, Note, NoteVerifier, OwnerKey, OwnerRecord, RecordKind};
use serde::{Deserialize, Serialize};

use super::connect::{Connection, refused};
use super::{VERSION, against, read, write};

/// What to do with owner records.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Sign a record about an identity of a scene, and enter it into the log
    Sign(SignArgs),
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

/// `cairn owners sign`.
#[derive(Clone, Debug, clap::Args)]
pub struct SignArgs {
    /// The scene
    pub name: String,
    /// The identity, 1 and up (see `cairn scene show`)
    #[arg(long, value_name = "N")]
    pub identity: u32,
    /// The owner's key file (see `cairn keys new`)
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// What the record says
    #[arg(long, value_enum, default_value_t = Kind::Claim)]
    pub kind: Kind,
    /// What the record is for, in words
    #[arg(long, default_value = "credit for the photographs")]
    pub purpose: String,
    /// Where the bundle goes: a new folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// The records that can be signed here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// The identity's mark in the marked field is the owner's
    Claim,
    /// The cluster's photographs are the owner's
    Contribution,
    /// This training made the marked field
    Training,
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

/// Answers `cairn owners sign`, `list` and `vkey`.
pub async fn run(line: &Connection, command: Command) -> anyhow::Result<()> {
    match command {
        Command::Sign(args) => {
            let index = sign(line, &args).await?;
            println!("record {index} is durable and published; its bundle is in {}", args.out.display());
            Ok(())
        }
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

/// Signs a record and enters it; its index in the log.
pub async fn sign(line: &Connection, args: &SignArgs) -> anyhow::Result<u64> {
    let key = OwnerKey::load(&args.key)?;
    std::fs::create_dir(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let mut client = line.owners();
    let request = v1::MaterialRequest { format_version: VERSION, scene: args.name.clone(), identity: args.identity };
    let material = client.material(request).await.map_err(refused)?.into_inner();
    let owner_key = key.public().to_bytes().to_vec().into();
    let request = v1::NonceRequest { format_version: VERSION, scene: args.name.clone(), owner_key };
    let nonce = client.nonce(request).await.map_err(refused)?.into_inner();
    let salt = random_salt()?;
    let record = record(args, &key, &material, &nonce, &salt)?;
    let envelope = record.seal(&key)?.to_json().into_bytes();
    let request = v1::SubmitRecordRequest { format_version: VERSION, envelope: envelope.into() };
    let entered = client.submit(request).await.map_err(refused)?.into_inner();
    let entered = entered.record.context("the daemon's answer names no record")?;
    // What came back must be what was signed, or the bundle would speak for somebody else.
    let returned = Envelope::parse(&entered.envelope)?;
    anyhow::ensure!(OwnerRecord::open(&returned)?.0 == record, "the daemon returned another record than was signed");

    let request = v1::ProofRequest { format_version: VERSION, index: entered.index };
    let proof = client.proof(request).await.map_err(refused)?.into_inner().tlog_proof;
    let vkey = vkey(line).await?;
    write(&args.out.join("record.json"), &entered.envelope)?;
    write(&args.out.join("record.tlog-proof"), proof.as_bytes())?;
    write(&args.out.join("log.vkey"), format!("{vkey}\n").as_bytes())?;
    if record.digests.hidden_signal.is_some() {
        write(&args.out.join("signal.png"), &material.signal)?;
        write(&args.out.join("signal.salt"), format!("{salt}\n").as_bytes())?;
    }
    Ok(entered.index)
}

/// The log's verifier key, one line without its end.
async fn vkey(line: &Connection) -> anyhow::Result<String> {
    let request = v1::CheckpointRequest { format_version: VERSION };
    Ok(line.owners().checkpoint(request).await.map_err(refused)?.into_inner().vkey)
}

/// A record that [`sign_all`] signed.
pub struct Signed {
    /// The identity's number.
    pub identity: u32,
    /// The record's place in the log.
    pub index: u64,
    /// The bundle's folder.
    pub bundle: PathBuf,
}

/// Makes a key for every identity of the scene's model and signs a record with it:
/// `FOLDER/<number>.key` and the bundle `FOLDER/<number>`. For trying things out: in
/// earnest every owner makes their own key where they are.
pub async fn sign_all(line: &Connection, scene: &str, folder: &Path) -> anyhow::Result<Vec<Signed>> {
    let model = super::scene::get(line, scene).await?.model.context("the scene has no model yet; train it first")?;
    std::fs::create_dir(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let kind = if model.marked_field_sha256.is_empty() { Kind::Contribution } else { Kind::Claim };
    let mut signed = Vec::with_capacity(model.identities.len());
    for identity in &model.identities {
        let key = folder.join(format!("{}.key", identity.number));
        OwnerKey::generate()?.save(&key)?;
        let out = folder.join(identity.number.to_string());
        let purpose = "credit for the photographs".to_owned();
        let args = SignArgs { name: scene.to_owned(), identity: identity.number, key, kind, purpose, out };
        let index = sign(line, &args).await?;
        signed.push(Signed { identity: identity.number, index, bundle: args.out });
    }
    Ok(signed)
}

fn record(
    args: &SignArgs,
    key: &OwnerKey,
    material: &v1::MaterialResponse,
    nonce: &v1::NonceResponse,
    salt: &Digest,
) -> anyhow::Result<OwnerRecord> {
    let digest = |what: &str, bytes: &[u8]| -> anyhow::Result<Option<Digest>> {
        if bytes.is_empty() {
            return Ok(None);
        }
        let bytes = bytes.try_into().with_context(|| format!("the daemon's digest of {what} is not 32 bytes"))?;
        Ok(Some(Digest::from_bytes(bytes)))
    };
    let mut photographs = Vec::with_capacity(material.photograph_sha256.len());
    for bytes in &material.photograph_sha256 {
        photographs.push(digest("a photograph", bytes)?.context("the daemon's digest of a photograph is empty")?);
    }
    let kind = match args.kind {
        Kind::Claim => RecordKind::Claim,
        Kind::Contribution => RecordKind::Contribution,
        Kind::Training => RecordKind::Training,
    };
    let hidden = (!material.signal.is_empty()).then(|| hidden_signal_commitment(salt, &material.signal));
    let checkpoint = Checkpoint::parse_text(&Note::parse(&nonce.checkpoint)?.text)?;
    Ok(OwnerRecord {
        version: cairn_registry::record::VERSION,
        kind,
        origin: nonce.origin.clone(),
        scene: args.name.clone(),
        scene_salt: random_salt()?,
        identity: Identity { number: args.identity, contributor: material.label.clone() },
        owner_key: key.public(),
        digests: Digests {
            marked_field: digest("the marked field", &material.marked_field_sha256)?,
            detector: digest("the detector", &material.detector_sha256)?,
            hidden_signal: hidden,
            photographs: Some(photographs_root(&photographs)),
            training_configuration: digest("the settings", &material.settings_sha256)?,
        },
        seed: Some(material.seed),
        purpose: args.purpose.clone(),
        nonce: nonce.nonce.parse().context("the daemon's nonce is not 32 bytes in hexadecimal")?,
        seen: Seen { size: checkpoint.size, root: checkpoint.root },
        replaces: None,
        views: None,
    })
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
    let request = v1::ListRecordsRequest { format_version: VERSION, scene: name.unwrap_or_default() };
    let records = line.owners().list(request).await.map_err(refused)?.into_inner().records;
    for r in &records {
        let owner: [u8; 32] = r.owner_key_sha256.as_ref().try_into().context("the daemon's key id is not 32 bytes")?;
        println!("{}  {}  {}  identity {}  by key {}", r.index, r.kind, r.scene, r.identity, Digest::from_bytes(owner));
    }
    if let Some(path) = out {
        let entry = |r: &v1::Record| -> anyhow::Result<LogEntry> {
            Ok(LogEntry { index: r.index, envelope: String::from_utf8(r.envelope.to_vec())? })
        };
        let records = records.iter().map(entry).collect::<Result<_, _>>()?;
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
