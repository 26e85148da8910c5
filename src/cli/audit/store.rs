//! `cairn audit store`: a daemon's data folder, every byte of it, from the files alone.
//! The daemon may be running; what it is writing just then may then look cut off.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use cairn_log::keys::StoredKey;
use cairn_log::{Checkpoint, NoteVerifier};
use cairn_verify::{Finding, StoreOptions, audit_folders, audit_store};

use super::renders;
use super::trust::Trust;
use cairn_durable::read_limited;

/// `cairn audit store`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The daemon's data folder
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    #[command(flatten)]
    pub trust: Trust,
    /// Views of each scene with marks that are rendered again, and their mark looked for; 0 for none
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub sample: usize,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Answers `cairn audit store`.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let policy = args.trust.policy()?;
    let origin = origin(&args.dir);
    let pinned = args.trust.pinned(policy.as_ref(), origin.as_deref())?;
    let found = own_key(&args.dir, origin.as_deref());
    let (mut beside, stock) = audit_folders(&args.dir)?;
    if let (Some(pinned), Some(found)) = (&pinned, &found) {
        beside.extend(compare_keys(pinned, found));
    }
    let options =
        StoreOptions { pinned: pinned.as_ref(), found: found.as_ref(), policy: policy.as_ref(), stock: Some(&stock) };
    let mut report = audit_store(&args.dir, &options)?;
    report.extend(beside);
    report.extend(renders::check(&args.dir, args.sample));
    super::trust::show(&report, args.json.then(|| report.to_json()));
    Ok(ExitCode::from(report.exit_code()))
}

/// The log's name, as its checkpoint has it; whether to believe that is the audit's to say.
fn origin(dir: &Path) -> Option<String> {
    let note = read_limited(&dir.join("registry/public/checkpoint"), 1 << 20).ok()?;
    Some(Checkpoint::read(std::str::from_utf8(&note).ok()?).ok()?.1.origin)
}

/// The public half of the folder's own key, where it may be read.
fn own_key(dir: &Path, origin: Option<&str>) -> Option<NoteVerifier> {
    let key = StoredKey::read(&dir.join("registry.key")).ok()?;
    NoteVerifier::new(origin?, key.public()).ok()
}

fn compare_keys(pinned: &NoteVerifier, found: &NoteVerifier) -> Option<Finding> {
    use cairn_verify::Code;
    let same = pinned.key() == found.key();
    (!same).then(|| Finding::of(Code::FileMismatch, "registry.key", &pinned.to_string(), &found.to_string()))
}
