//! `cairn render --path`: a camera path through a trained scene, as a GIF or as PNG frames in a folder.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use cairn_api::v1::{self, render_path_request as to};
use cairn_scene::{Limits, decode_picture};

use super::animation::Gif;
use super::connect::Connection;
use super::exit::Cancelled;
use super::files::write;
use super::progress::Progress;

/// The shapes of paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Shape {
    /// Around the scene's centre, at the views' median distance
    Orbit,
    /// In front of the scene, within the spread of the views; for scenes seen from one side
    Spiral,
    /// From the view of --from to the view of --to
    Between,
}

/// What `--path` takes besides its shape.
#[derive(Clone, Debug, clap::Args)]
pub struct PathArgs {
    /// The first frame's view, with --path between
    #[arg(long, value_name = "VIEW", requires = "path", requires = "to")]
    from: Option<String>,
    /// The last frame's view, with --path between
    #[arg(long, value_name = "VIEW", requires = "path", requires = "from")]
    to: Option<String>,
    /// How far around, with --path orbit: above 0, to 360 degrees (360 where not given)
    #[arg(long, value_name = "DEG", requires = "path")]
    arc: Option<f64>,
    /// How many frames
    #[arg(long, value_name = "N", default_value_t = 90)]
    frames: u32,
    /// Frames a second of the GIF
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=50))]
    fps: u16,
    /// Width of the frames (follows --height or the views where not given)
    #[arg(long, value_name = "PX", requires = "path", value_parser = clap::value_parser!(u32).range(1..))]
    width: Option<u32>,
    /// Height of the frames (follows --width or the views where not given)
    #[arg(long, value_name = "PX", requires = "path", value_parser = clap::value_parser!(u32).range(1..))]
    height: Option<u32>,
}

impl PathArgs {
    /// Refuses what only a camera path takes. clap leaves it, since `--path` and `--view` exclude each other.
    ///
    /// # Errors
    /// An option that was given, by name.
    pub fn must_be_absent(&self) -> anyhow::Result<()> {
        let given = [
            ("--from", self.from.is_some()),
            ("--to", self.to.is_some()),
            ("--arc", self.arc.is_some()),
            ("--width", self.width.is_some()),
            ("--height", self.height.is_some()),
        ];
        match given.iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) => anyhow::bail!("{name} is for a camera path: add --path <SHAPE>, or leave it away"),
            None => Ok(()),
        }
    }

    fn path(&self, shape: Shape) -> anyhow::Result<to::Path> {
        let ends = self.from.clone().zip(self.to.clone());
        anyhow::ensure!(shape == Shape::Between || ends.is_none(), "--from and --to are for --path between");
        anyhow::ensure!(shape == Shape::Orbit || self.arc.is_none(), "--arc is for --path orbit");
        match (shape, ends) {
            (Shape::Orbit, _) => {
                let arc_deg = self.arc.unwrap_or(360.0);
                // To the services 0 means all around; on a command line 0 is a mistake.
                anyhow::ensure!(arc_deg > 0.0 && arc_deg <= 360.0, "--arc {arc_deg}: allowed is above 0, to 360");
                Ok(to::Path::Orbit(v1::OrbitPath { arc_deg }))
            }
            (Shape::Spiral, _) => Ok(to::Path::Spiral(v1::SpiralPath {})),
            (Shape::Between, Some((from_view, to_view))) => {
                Ok(to::Path::Between(v1::BetweenPath { from_view, to_view }))
            }
            (Shape::Between, None) => anyhow::bail!("--path between needs --from VIEW and --to VIEW"),
        }
    }
}

/// Which field of a scene a path is through, and in whose light.
pub struct Seen {
    /// The scene.
    pub scene: String,
    /// Which field.
    pub field: v1::FieldKind,
    /// The light of the first frame.
    pub light: Option<v1::Appearance>,
    /// The light of the last frame, where it changes on the way.
    pub light_to: Option<v1::Appearance>,
}

/// Renders the path frame by frame into `out`. The first Ctrl-C ends it after the frame under way.
///
/// # Errors
/// For an `out` that is neither a `.gif` nor a folder, the services' refusals, and the file system's.
pub async fn run(line: &Connection, shape: Shape, args: &PathArgs, seen: Seen, out: &Path) -> anyhow::Result<()> {
    let mut frames = Frames::new(out, args)?;
    let request = v1::RenderPathRequest {
        scene: seen.scene.clone(),
        path: Some(args.path(shape)?),
        frames: args.frames,
        width: args.width.unwrap_or(0),
        height: args.height.unwrap_or(0),
        field: seen.field.into(),
        appearance: seen.light,
        appearance_to: seen.light_to,
    };
    // Listens from now on, whatever is being done when it comes.
    let mut interrupt = tokio::spawn(tokio::signal::ctrl_c());
    let mut stream = line.about(&seen.scene).render().render_path(request).await?.into_inner();
    let (mut shown, begun, total) = (Progress::new(true), Instant::now(), args.frames);
    shown.draw("frames", 0, total.into(), "", -1.0);
    let mut done = 0;
    loop {
        let message = tokio::select! {
            message = stream.message() => message?,
            interrupt = &mut interrupt => {
                interrupt??;
                shown.end();
                // Dropping the stream stops the services.
                return Err(Cancelled(format!("cancelled after {done} of {total} frames")).into());
            }
        };
        let Some(frame) = message else { break };
        anyhow::ensure!(frame.frame == done, "frame {} came in the place of {done}", frame.frame);
        frames.add(done, &frame.png)?;
        done += 1;
        let left = begun.elapsed().as_secs_f64() / f64::from(done) * f64::from(total - done);
        shown.draw("frames", done.into(), total.into(), "", left);
    }
    shown.end();
    anyhow::ensure!(done == total, "the line ended after {done} of {total} frames");
    let (width, height) = frames.finish()?;
    println!("{done} frames of {width} x {height} px in {}", out.display());
    Ok(())
}

/// Where frames go.
enum Frames {
    /// A GIF, begun with its first frame.
    Gif { path: PathBuf, fps: u16, gif: Option<Gif> },
    /// A folder of PNG files; the size of the last frame, px.
    Folder { path: PathBuf, width: usize, height: usize },
}

impl Frames {
    fn new(out: &Path, args: &PathArgs) -> anyhow::Result<Self> {
        let path = out.to_path_buf();
        match out.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("gif") => Ok(Self::Gif { path, fps: args.fps, gif: None }),
            None => {
                let is_frame = |name: &str| name.starts_with("frame-") && name.ends_with(".png");
                let mut there = std::fs::read_dir(out).into_iter().flatten().flatten();
                anyhow::ensure!(
                    !there.any(|entry| is_frame(&entry.file_name().to_string_lossy())),
                    "{} holds frames already; give another folder",
                    out.display()
                );
                Ok(Self::Folder { path, width: 0, height: 0 })
            }
            Some(_) => anyhow::bail!("{}: a path goes into a .gif file, or into a folder of PNG frames", out.display()),
        }
    }

    fn add(&mut self, index: u32, png: &[u8]) -> anyhow::Result<()> {
        let picture = decode_picture(png, &Limits::default(), None).context("a frame does not decode")?;
        match self {
            Self::Gif { path, fps, gif } => {
                let gif = match gif {
                    Some(gif) => gif,
                    none => none.insert(Gif::begin(path, picture.width(), picture.height(), *fps)?),
                };
                gif.add(&picture)
            }
            Self::Folder { path, width, height } => {
                (*width, *height) = (picture.width(), picture.height());
                write(&path.join(format!("frame-{index:05}.png")), png)
            }
        }
    }

    /// Ends the file, and gives the frames' width and height, px.
    fn finish(self) -> anyhow::Result<(usize, usize)> {
        match self {
            Self::Gif { gif, .. } => gif.context("the path has no frame")?.finish(),
            Self::Folder { width, height, .. } => Ok((width, height)),
        }
    }
}
