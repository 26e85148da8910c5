//! `cairn audit bundle`: a record, its proof and whatever else is in hand, recomputed
//! from the files alone.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_log::format::record::SignalFiles;
use cairn_log::{Checkpoint, Digest, Envelope, OwnerRecord, TlogProof};
use cairn_verify::{Bundle, Evidence, FileInHand, LogView, Outcome, RecordInHand};

use super::against;
use super::trust::Trust;
use crate::cli::files::read;
use crate::cli::owners::LogFile;
use cairn_durable::read_limited;

/// Largest envelope or proof that is read, bytes; both are a few kilobytes.
const MAX_FILE: u64 = 1 << 20;

/// `cairn audit bundle`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Args {
    /// The bundle: its folder, or the common start of its two files, `F.dsse.json` and `F.tlog-proof`
    #[arg(value_name = "F")]
    pub bundle: PathBuf,
    #[command(flatten)]
    pub trust: Trust,
    /// A data folder whose photographs, settings, base field, share table, marked field and detector, of the record's own
    /// training, are held to it
    #[arg(long, value_name = "DIR")]
    pub against: Option<PathBuf>,
    #[command(flatten)]
    pub files: against::Files,
    /// The log's records, from `cairn owners list --out`: tells of revocations and disputes
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Answers `cairn audit bundle`.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let report = report(args)?;
    super::trust::show(&report, args.json.then(|| report.to_json()));
    Ok(super::trust::exit(report.outcome))
}

/// Recomputes everything from the files that are there.
///
/// # Errors
/// For a file that cannot be read, and for a data folder that has not what the record binds; an invalid
/// record's report comes all the same.
pub fn report(args: &Args) -> anyhow::Result<cairn_verify::Report> {
    let (envelope, proof) = files(&args.bundle)?;
    let policy = args.trust.policy()?;
    let pinned = args.trust.pinned(policy.as_ref(), proof.as_deref().and_then(origin).as_deref())?;
    let log = args.log.as_deref().map(log_view).transpose()?;
    let mut evidence = Evidence {
        envelope: &envelope,
        pinned: pinned.as_ref(),
        policy: policy.as_ref(),
        proof: proof.as_deref(),
        hidden_signal: hidden_signal(&args.bundle)?,
        log: log.as_ref(),
        ..Evidence::default()
    };
    // The record says which files to look at; whether it may be believed is the audit's to say.
    let record = Envelope::parse(&envelope).ok().and_then(|e| OwnerRecord::parse(&e.payload).ok());
    args.files.gather(&mut evidence, record.as_ref())?;
    let mut gathered = Ok(());
    if let (Some(data), Some(record)) = (&args.against, &record) {
        gathered = against::gather(&mut evidence, data, record);
    }
    let report = cairn_verify::audit(&evidence);
    if let Some(data) = args.against.as_ref().filter(|_| report.outcome != Outcome::Invalid) {
        gathered?;
        against::all_compared(&report, data)?;
    }
    Ok(report)
}

/// The log that a proof speaks of, to find its key in a policy.
fn origin(proof: &str) -> Option<String> {
    Some(Checkpoint::read(&TlogProof::parse(proof).ok()?.checkpoint).ok()?.1.origin)
}

/// Envelope and proof. A folder may lack the proof, which the report then says; two files side by side are both there.
fn files(bundle: &Path) -> anyhow::Result<(Vec<u8>, Option<String>)> {
    if bundle.is_dir() {
        let (envelope, proof) = (bundle.join("record.json"), bundle.join("record.tlog-proof"));
        let envelope = read_limited(&envelope, MAX_FILE)?;
        let proof = if proof.exists() { Some(read_limited(&proof, MAX_FILE)?) } else { None };
        // What is no text stays no proof: no check lets U+FFFD pass.
        return Ok((envelope, proof.map(|bytes| String::from_utf8_lossy(&bytes).into_owned())));
    }
    let start = bundle.display();
    let is_absent = [Bundle::ENVELOPE, Bundle::PROOF].iter().all(|ending| {
        let file = format!("{start}.{ending}");
        !bundle.exists() && !Path::new(&file).exists()
    });
    anyhow::ensure!(
        !is_absent,
        "there is no folder {start}, and no {start}.{} with {start}.{}; is the path right?",
        Bundle::ENVELOPE,
        Bundle::PROOF
    );
    let Bundle { envelope, proof } = Bundle::read(bundle)?;
    Ok((envelope, Some(proof)))
}

fn text(path: &Path) -> anyhow::Result<Option<String>> {
    if !path.exists() {
        return Ok(None);
    }
    Ok(Some(String::from_utf8(read(path)?).with_context(|| format!("{} is no text", path.display()))?))
}

fn hidden_signal(bundle: &Path) -> anyhow::Result<Option<FileInHand>> {
    let salt = text(&bundle.join("signal.salt"))?;
    let mut places = Vec::new();
    let mut part = |name: &str| {
        let path = bundle.join(name);
        if !path.exists() {
            return Ok(Vec::new());
        }
        places.push(path.display().to_string());
        read(&path)
    };
    let (picture, audio, words) = (part("signal.png")?, part("signal.wav")?, part("signal.txt")?);
    let files = SignalFiles { picture: &picture, audio: &audio, text: &words };
    let Some(salt) = salt.filter(|_| !files.is_empty()) else { return Ok(None) };
    // What was read is the owner's secret, and not quoted.
    let salt: Digest = salt.trim().parse().ok().context("signal.salt is not 32 bytes in hexadecimal")?;
    Ok(Some(FileInHand::hidden_signal(places.join(", "), &salt, &files)))
}

fn log_view(path: &Path) -> anyhow::Result<LogView> {
    let file: LogFile =
        serde_json::from_slice(&read(path)?).with_context(|| format!("{} is no list of records", path.display()))?;
    anyhow::ensure!(file.format_version == 1, "{}: format version {}, 1 is read", path.display(), file.format_version);
    let records = file.records.into_iter();
    let records = records.map(|r| RecordInHand { index: r.index, envelope: r.envelope.into_bytes() }).collect();
    Ok(LogView { size: file.size, records })
}
