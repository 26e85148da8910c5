//! `cairn scene show --poses`: a picture of where the scene's cameras stand.

use std::path::{Path, PathBuf};

use cairn_api::v1::{self, draw_poses_request::Clusters};
use cairn_scene::quoted;

use super::connect::Connection;
use super::files::write;
use super::json::Json;

/// What to draw of a scene.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Also draw where the cameras stand, coloured by contributor and by cluster: .png or .svg
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
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
    min_views: u32,
    /// The training's seed
    #[arg(long, default_value_t = 1, requires = "poses")]
    seed: u64,
}

impl Args {
    /// Refuses clusters to be shown that are not to be drawn.
    ///
    /// # Errors
    /// As said, with the command line that draws them.
    pub fn check(&self, scene: &str) -> anyhow::Result<()> {
        let asked = match self.anchors {
            Some(anchors) => format!("--anchors {anchors}"),
            None if self.by_contributor => "--by-contributor".to_owned(),
            None => return Ok(()),
        };
        anyhow::ensure!(
            self.poses.is_some(),
            "{asked} is about the drawing; have it drawn: cairn scene show {scene} {asked} --poses cameras.png",
            scene = quoted(scene)
        );
        Ok(())
    }
}

/// Draws the cameras of scene `name` where `args` ask for it.
///
/// # Errors
/// For a file that ends neither in `.png` nor in `.svg`, the services' refusals, and the file system's.
pub async fn draw(line: &Connection, name: String, args: Args, json: Json) -> anyhow::Result<()> {
    let Some(out) = &args.poses else { return Ok(()) };
    let format = format(out)?;
    let clusters = match args.anchors {
        Some(anchors) => Some(Clusters::ByAnchors(v1::ByAnchors { anchors, neighbours: args.neighbours.unwrap_or(0) })),
        None if args.by_contributor => Some(Clusters::ByContributor(v1::ByContributor { min_views: args.min_views })),
        None => None,
    };
    let request = v1::DrawPosesRequest { scene: name, clusters, seed: args.seed, format: format.into() };
    let answer = line.scenes().draw_poses(request).await?.into_inner();
    write(out, &answer.picture)?;
    if json.json {
        return Ok(());
    }
    let (views, path) = (answer.views, out.display());
    match answer.clusters {
        0 => println!("{views} cameras by contributor in {path}"),
        clusters => println!("{views} cameras by contributor and in {clusters} clusters in {path}"),
    }
    Ok(())
}

fn format(out: &Path) -> anyhow::Result<v1::DrawingFormat> {
    match out.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("png") => Ok(v1::DrawingFormat::Png),
        Some("svg") => Ok(v1::DrawingFormat::Svg),
        _ => anyhow::bail!("{}: the drawing ends in .png or .svg", out.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn clusters_without_a_drawing_are_answered_with_what_to_type() {
        let check = |line: &[&str]| Line::try_parse_from([&["show"], line].concat()).unwrap().args.check("town");
        for asked in ["--by-contributor", "--anchors=3"] {
            let refused = check(&[asked]).unwrap_err().to_string();
            let line = format!("cairn scene show town {} --poses cameras.png", asked.replace('=', " "));
            assert!(refused.contains(&line), "{refused}");
            assert!(check(&[asked, "--poses", "a.png"]).is_ok());
        }
        assert!(check(&[]).is_ok());
    }
}
