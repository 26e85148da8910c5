//! `cairn evaluate`: scores of a trained scene on the views that it never saw.

use std::path::PathBuf;

use anyhow::Context as _;
use cairn_api::v1;

use super::connect::Connection;
use super::files::write;
use super::json::{self, Json};

/// `cairn evaluate`.
#[derive(Debug, clap::Args)]
pub struct EvaluateArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    #[command(flatten)]
    json: Json,
    /// Also draw the contact sheet
    #[arg(long, value_name = "PNG")]
    sheet: Option<PathBuf>,
}

/// Answers `cairn evaluate`.
pub async fn evaluate(line: &Connection, args: EvaluateArgs) -> anyhow::Result<()> {
    let report = report(line, &args.name, args.sheet.as_ref()).await?;
    match args.json.json {
        true => json::print_value(&serde_json::to_value(report)?)?,
        false => print!("{report}"),
    }
    Ok(())
}

/// Scores a scene; writes the contact sheet where asked.
pub async fn report(
    line: &Connection,
    scene: &str,
    sheet: Option<&PathBuf>,
) -> anyhow::Result<cairn_service::query::report::Report> {
    let contact_sheet = sheet.is_some();
    let request = v1::EvaluateRequest { scene: scene.to_owned(), contact_sheet };
    let answer = line.about(scene).query().evaluate(request).await?.into_inner();
    if let Some(path) = sheet {
        write(path, &answer.contact_sheet_png)?;
    }
    serde_json::from_str(&answer.report_json).context("the daemon's report is of another version")
}
