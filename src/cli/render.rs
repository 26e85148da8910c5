//! `cairn render`: a picture of a trained scene, or with `--path` a camera path through it.

use std::path::PathBuf;

use cairn_api::v1;

use super::connect::Connection;
use super::files::write;
use super::light::{InLight, LightTo};
use super::path::{self, PathArgs, Seen, Shape};
use super::viewpoint::viewpoint;

/// `cairn render`.
#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    #[command(flatten)]
    from: From,
    /// Where the picture goes: a PNG; of a path a .gif, or a folder of PNG frames
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// The field before it was marked
    #[arg(long)]
    base: bool,
    #[command(flatten)]
    light: InLight,
    #[command(flatten)]
    light_to: LightTo,
    /// Also write depth along the optical axis: 16-bit grey, 0 for none, its unit is printed and said in the file
    #[arg(long, value_name = "PNG", conflicts_with = "path")]
    depth: Option<PathBuf>,
    /// Also write depth in colours: near yellow, far violet, fading into a grey chequer for none
    #[arg(long, value_name = "PNG", conflicts_with = "path")]
    depth_colours: Option<PathBuf>,
    /// Also write accumulation, the share of light that the field stops: 16-bit grey
    #[arg(long, value_name = "PNG", conflicts_with = "path")]
    accumulation: Option<PathBuf>,
    #[command(flatten)]
    along: PathArgs,
}

/// From where to look.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct From {
    /// The name of one of the scene's views
    #[arg(long, value_name = "VIEW")]
    view: Option<String>,
    /// A camera: JSON with width, height, fx, fy, cx, cy (px), camera_to_world (3 or 4 rows of 4 numbers, OpenCV axes),
    /// and k1, k2, k3, p1, p2 where the lens distorts
    #[arg(long, value_name = "FILE")]
    pose: Option<PathBuf>,
    /// A camera path through the scene
    #[arg(long, value_enum, value_name = "SHAPE")]
    path: Option<Shape>,
}

/// Answers `cairn render`.
pub async fn render(line: &Connection, args: RenderArgs) -> anyhow::Result<()> {
    let field = if args.base { v1::FieldKind::Base } else { v1::FieldKind::Marked };
    if let Some(shape) = args.from.path {
        let (light, light_to) = (args.light.asked()?, args.light_to.of_path()?);
        let seen = Seen { scene: args.name, field, light, light_to };
        return path::run(line, shape, &args.along, seen, &args.out).await;
    }
    args.along.must_be_absent()?;
    let request = v1::RenderRequest {
        scene: args.name.clone(),
        viewpoint: Some(viewpoint(args.from.view, args.from.pose.as_deref())?),
        field: field.into(),
        appearance: args.light.asked_with(args.light_to)?,
        accumulation: args.accumulation.is_some(),
        depth: args.depth.is_some(),
        depth_colours: args.depth_colours.is_some(),
    };
    let answer = line.about(&args.name).render().render(request).await?.into_inner();
    write(&args.out, &answer.png)?;
    println!("{} x {} px in {}", answer.width, answer.height, args.out.display());
    if let Some(path) = &args.depth {
        write(path, &answer.depth_png)?;
        let unit = answer.depth_unit;
        println!("depth in {}: grey value x {unit:.4e} capture units, 0 is no depth", path.display());
    }
    if let Some(path) = &args.depth_colours {
        write(path, &answer.depth_colours_png)?;
        println!("depth in colours in {}", path.display());
    }
    if let Some(path) = &args.accumulation {
        write(path, &answer.accumulation_png)?;
        println!("accumulation in {}: 65535 is all light stopped", path.display());
    }
    Ok(())
}
