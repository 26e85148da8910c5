//! `cairn scene poses`: a picture of where the scene's cameras stand.

use std::path::PathBuf;

use cairn_api::v1::{self, draw_poses_request::Clusters};

use super::animation::write_whole;
use super::connect::{Connection, refused};

/// `cairn scene poses`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The scene
    name: String,
    /// Where the picture goes: .png or .svg
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Show the clusters that `cairn train --anchors M` would make (not given: the newest model's, if there is one)
    #[arg(long, value_name = "M", conflicts_with = "by_contributor")]
    anchors: Option<u32>,
    /// K, the views of a cluster; not given: as many as there are, 20 at most
    #[arg(long, value_name = "K", requires = "anchors")]
    neighbours: Option<u32>,
    /// Show the clusters that `cairn train --by-contributor` would make
    #[arg(long)]
    by_contributor: bool,
    /// Views that a contributor needs to be an identity, with --by-contributor
    #[arg(long, value_name = "N", default_value_t = 2, requires = "by_contributor")]
    least_views: u32,
    /// The training's seed
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Answers `cairn scene poses`.
pub async fn run(line: &Connection, args: Args) -> anyhow::Result<()> {
    let format = match args.out.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("png") => v1::DrawingFormat::Png,
        Some("svg") => v1::DrawingFormat::Svg,
        _ => anyhow::bail!("{}: the drawing ends in .png or .svg", args.out.display()),
    };
    let clusters = match args.anchors {
        Some(anchors) => Some(Clusters::ByAnchors(v1::ByAnchors { anchors, neighbours: args.neighbours.unwrap_or(0) })),
        None if args.by_contributor => {
            Some(Clusters::ByContributor(v1::ByContributor { least_views: args.least_views }))
        }
        None => None,
    };
    let request = v1::DrawPosesRequest { scene: args.name, clusters, seed: args.seed, format: format.into() };
    let answer = line.scenes().draw_poses(request).await.map_err(refused)?.into_inner();
    write_whole(&args.out, &answer.picture)?;
    let (views, path) = (answer.views, args.out.display());
    match answer.clusters {
        0 => println!("{views} cameras by contributor in {path}"),
        clusters => println!("{views} cameras by contributor and in {clusters} clusters in {path}"),
    }
    Ok(())
}
