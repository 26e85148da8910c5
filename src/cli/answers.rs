//! `cairn owners answer`: who contributed to a scene or to one view of it, as a file that proves it leaves nobody out.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_log::{Answer, Checkpoint};

use super::connect::Connection;
use super::files::{read, write};

/// `cairn owners answer`.
#[derive(Clone, Debug, clap::Args)]
pub struct AnswerArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    pub name: String,
    /// Ask about one of its views; without it, about the whole scene
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,
    /// A checkpoint of this log that you kept: the answer proves that the log went on from it
    #[arg(long, value_name = "FILE")]
    pub as_of: Option<PathBuf>,
    /// Where the answer goes, JSON, for `cairn audit answer`
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// The signed checkpoint in a file. What is none is not sent: it may be a secret.
fn checkpoint(path: &Path) -> anyhow::Result<String> {
    let none = || format!("{} is no checkpoint", path.display());
    let note = String::from_utf8(read(path)?).with_context(none)?;
    Checkpoint::read(&note).with_context(none)?;
    Ok(note)
}

/// Fetches an answer and keeps it. What it is worth is for `cairn audit answer` to say.
pub async fn run(line: &Connection, args: &AnswerArgs) -> anyhow::Result<()> {
    let as_of = match &args.as_of {
        None => String::new(),
        Some(path) => checkpoint(path)?,
    };
    let request = v1::AnswerRequest {
        scene: args.name.clone(),
        of: args.view.clone().map(v1::answer_request::Of::ViewName),
        as_of,
    };
    let v1::AnswerResponse { answer: json, without_shares } = line.owners().answer(request).await?.into_inner();
    let answer = Answer::parse(&json).context("the daemon's answer")?;
    let asked = answer.lists.iter().find(|list| list.key == answer.asked());
    let named = asked.map_or(0, |list| list.entries.len());
    write(&args.out, &json)?;
    let shares = if answer.shares.is_some() { ", and the shares of what the view shows" } else { "" };
    println!(
        "{named} records named, with their proofs{shares}, in {}; check it with `cairn audit answer`",
        args.out.display()
    );
    if !without_shares.is_empty() {
        println!("it holds no shares: {without_shares}");
    }
    Ok(())
}
