//! `cairn render`: a picture of a trained scene, or with `--path` a camera path through it.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_scene::{ImageFormat, Limits, decode_picture};

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
    /// Where the picture goes: .png, .jpg, .jpeg or .webp; of a path a .gif, or a folder of PNG frames
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
    let found = args.light.found(line, &args.name).await?;
    let field = if args.base { v1::FieldKind::Base } else { v1::FieldKind::Marked };
    if let Some(shape) = args.from.path {
        let (light, light_to) = (args.light.asked(found)?, args.light_to.of_path()?);
        let seen = Seen { scene: args.name, field, light, light_to };
        return path::run(line, shape, &args.along, seen, &args.out).await;
    }
    args.along.must_be_absent()?;
    let format = format_of(&args.out)?;
    for path in [&args.depth, &args.depth_colours, &args.accumulation].into_iter().flatten() {
        let is_png = ImageFormat::of_path(path) == Some(ImageFormat::Png);
        anyhow::ensure!(is_png, "{}: depth and accumulation have 16 bits; the name ends in .png", path.display());
    }
    let request = v1::RenderRequest {
        scene: args.name.clone(),
        viewpoint: Some(viewpoint(args.from.view, args.from.pose.as_deref())?),
        field: field.into(),
        appearance: args.light.asked_with(args.light_to, found)?,
        accumulation: args.accumulation.is_some(),
        depth: args.depth.is_some(),
        depth_colours: args.depth_colours.is_some(),
    };
    let answer = line.about(&args.name).render().render(request).await?.into_inner();
    write(&args.out, &encoded(format, &answer, &args.out)?)?;
    println!("{} x {} px in {}", answer.width, answer.height, args.out.display());
    if !(args.base || format.is_lossless()) {
        eprintln!("a {} may take a faint mark; .png keeps it", format.name());
    }
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

/// The format that the ending of `out` says.
fn format_of(out: &Path) -> anyhow::Result<ImageFormat> {
    ImageFormat::of_path(out)
        .with_context(|| format!("{}: a picture's name ends in {}", out.display(), ImageFormat::all_endings()))
}

/// The picture of `answer` in `format`: of PNG the bytes that came, of the others its pixels written again.
fn encoded(format: ImageFormat, answer: &v1::RenderResponse, out: &Path) -> anyhow::Result<Vec<u8>> {
    if format == ImageFormat::Png {
        return Ok(answer.png.to_vec());
    }
    let side = answer.width.max(answer.height) as usize;
    anyhow::ensure!(
        side <= format.max_side_px(),
        "{}: {} x {} px; a {} has {} px a side at most, so let the name end in .png",
        out.display(),
        answer.width,
        answer.height,
        format.name(),
        format.max_side_px()
    );
    let picture = decode_picture(&answer.png, &Limits::default(), None)
        .with_context(|| format!("cannot write a {}; let the name end in .png", format.name()))?;
    Ok(format.encode(&picture))
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Picture, encode_png};
    use clap::Args as _;

    fn answer(width: u32, height: u32) -> v1::RenderResponse {
        let rgb = (0..width * height * 3).map(|v| (v * 89 % 256) as f32 / 255.0).collect();
        let picture = Picture::new(width as usize, height as usize, rgb).unwrap();
        v1::RenderResponse { png: encode_png(&picture).into(), width, height, ..v1::RenderResponse::default() }
    }

    #[test]
    fn the_ending_decides_what_is_written() {
        let (answer, limits) = (answer(9, 7), Limits::default());
        let shown = decode_picture(&answer.png, &limits, None).unwrap();
        for (name, format) in [
            ("a.png", ImageFormat::Png),
            ("a.b.JPG", ImageFormat::Jpeg),
            ("a.jpeg", ImageFormat::Jpeg),
            ("a.webp", ImageFormat::WebP),
        ] {
            let out = Path::new(name);
            assert_eq!(format_of(out).unwrap(), format);
            let bytes = encoded(format, &answer, out).unwrap();
            assert_eq!(ImageFormat::of(&bytes), Some(format));
            let back = decode_picture(&bytes, &limits, None).unwrap();
            assert_eq!((back.width(), back.height()), (9, 7));
            assert_eq!(back == shown, format.is_lossless(), "{name}");
        }
        assert_eq!(encoded(ImageFormat::Png, &answer, Path::new("a.png")).unwrap(), answer.png);
        for name in ["a", "a.gif", "a.tiff", ".png"] {
            let error = format_of(Path::new(name)).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(".png, .jpg, .jpeg or .webp"), "{error}");
        }
    }

    #[test]
    fn a_side_that_a_format_cannot_have_is_refused_by_name() {
        let wide = answer(16_384, 1);
        let error = encoded(ImageFormat::WebP, &wide, Path::new("a.webp")).unwrap_err().to_string();
        assert!(["a.webp", "16384 x 1", "16383", ".png"].iter().all(|part| error.contains(part)), "{error}");
        assert!(encoded(ImageFormat::Jpeg, &wide, Path::new("a.jpg")).is_ok());
    }

    #[test]
    fn the_help_names_every_ending() {
        let command = RenderArgs::augment_args(clap::Command::new("render"));
        let out = command.get_arguments().find(|argument| argument.get_id() == "out").unwrap();
        assert!(out.get_help().unwrap().to_string().contains(&ImageFormat::all_endings()));
    }
}
