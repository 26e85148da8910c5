//! `cairn audit answer`: who contributed, with proofs that each record named is in the
//! log and that none is left out.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use cairn_log::Digest;
use cairn_verify::{FileInHand, Question};

use cairn_durable::read_limited;

/// Largest answer that is opened, bytes; cairn-verify has a limit of its own.
pub(super) const MAX_ANSWER_BYTES: u64 = 256 << 20;

/// What was asked, for who holds an answer to it.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Asked {
    /// The scene that was asked about: an answer about another is invalid
    #[arg(long, value_name = "NAME")]
    pub scene: Option<String>,
    /// The photograph that was asked about, its file or its SHA-256; without it, that the whole scene was
    #[arg(long, value_name = "FILE|SHA256", requires = "scene")]
    pub view: Option<String>,
}

impl Asked {
    /// The question, where it is given.
    ///
    /// # Errors
    /// For a photograph that cannot be read.
    pub fn question(&self) -> anyhow::Result<Option<Question>> {
        let Some(scene) = self.scene.clone() else { return Ok(None) };
        Ok(Some(Question { scene, view: self.view.as_deref().map(photograph).transpose()? }))
    }
}

/// `cairn audit answer`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The answer, JSON
    #[arg(value_name = "F")]
    pub answer: PathBuf,
    /// The log's public key (see `cairn owners vkey`), obtained elsewhere; without it nothing is trusted
    #[arg(long, value_name = "FILE")]
    pub vkey: Option<PathBuf>,
    #[command(flatten)]
    pub asked: Asked,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// A photograph's digest: as given, or of the file with this name.
fn photograph(text: &str) -> anyhow::Result<Digest> {
    match text.parse() {
        Ok(digest) => Ok(digest),
        Err(_) => {
            Ok(FileInHand::read(Path::new(text)).context("--view takes a photograph's file or its SHA-256")?.digest)
        }
    }
}

/// Answers `cairn audit answer`.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let answer = read_limited(&args.answer, MAX_ANSWER_BYTES)?;
    let pinned = args.vkey.as_deref().map(super::trust::vkey).transpose()?;
    let question = args.asked.question()?;
    let report = cairn_verify::audit_answer_to(&answer, pinned.as_ref(), question.as_ref());
    super::trust::show(&report, args.json.then(|| report.to_json()));
    Ok(super::trust::exit(report.outcome))
}
