//! `cairn path`: a flight through a trained scene, as an animated file, as single
//! frames, or both. Frames are kept as they come, so that a flight that was cut
//! off goes on where it was.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use cairn_api::v1::{self, render_path_request as to};
use cairn_log::Digest;
use cairn_scene::{Limits, Picture, decode_picture};
use serde_json::json;

use super::animation::{self, Animation, write_whole};
use super::connect::{Connection, refused};
use super::light::InLight;
use super::progress::Progress;
use super::{read, scene};

/// What a folder of frames is of.
const LABEL: &str = "path.json";

/// `cairn path`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The scene
    name: String,
    #[command(flatten)]
    way: Way,
    /// How many frames
    #[arg(long, value_name = "N", default_value_t = 90)]
    frames: u32,
    /// Frames a second of the animation
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=50))]
    fps: u16,
    /// Width of the frames (follows --height or the views where not given)
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(1..))]
    width: Option<u32>,
    /// Height of the frames (follows --width or the views where not given)
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(1..))]
    height: Option<u32>,
    /// Where the animation goes: .gif (256 colours a frame) or .png (animated PNG, every pixel as rendered)
    #[arg(long, value_name = "FILE", required_unless_present = "sequence")]
    out: Option<PathBuf>,
    /// Also keep each frame as a PNG in this folder
    #[arg(long, value_name = "DIR")]
    sequence: Option<PathBuf>,
    /// Go on with a sequence that was cut off
    #[arg(long, requires = "sequence")]
    resume: bool,
    /// The field before it was marked
    #[arg(long)]
    base: bool,
    #[command(flatten)]
    light: InLight,
    /// With the light changing on the way, from the one of --light to the one of this training view
    #[arg(long, value_name = "VIEW", requires = "light")]
    light_to: Option<String>,
}

/// Which way to fly.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct Way {
    /// Around the scene's centre, at the views' median distance
    #[arg(long, value_name = "DEG", num_args = 0..=1, default_missing_value = "360")]
    orbit: Option<f64>,
    /// In front of the scene, within the spread of the views; for scenes seen from one side
    #[arg(long)]
    spiral: bool,
    /// From one view to another
    #[arg(long, num_args = 2, value_names = ["VIEW", "VIEW"])]
    between: Option<Vec<String>>,
}

impl Way {
    fn path(&self) -> anyhow::Result<to::Path> {
        match (self.orbit, self.between.as_deref()) {
            (Some(arc_deg), _) => {
                // To the services 0 means all around; who writes 0 means something else.
                anyhow::ensure!(arc_deg > 0.0 && arc_deg <= 360.0, "--orbit {arc_deg}: allowed is above 0, to 360");
                Ok(to::Path::Orbit(v1::OrbitPath { arc_deg }))
            }
            (None, Some([from, to])) => {
                let (from_view, to_view) = (from.clone(), to.clone());
                Ok(to::Path::Between(v1::BetweenPath { from_view, to_view }))
            }
            _ if self.spiral => Ok(to::Path::Spiral(v1::SpiralPath {})),
            _ => anyhow::bail!("say which way: --orbit, --spiral or --between VIEW VIEW"),
        }
    }
}

/// Answers `cairn path`. The first Ctrl-C ends it after the frame under way.
pub async fn run(line: &Connection, args: Args) -> anyhow::Result<()> {
    if let Some(path) = &args.out {
        animation::Kind::of(path)?;
    }
    let mut request = v1::RenderPathRequest {
        scene: args.name.clone(),
        path: Some(args.way.path()?),
        frames: args.frames,
        first_frame: 0,
        width: args.width.unwrap_or(0),
        height: args.height.unwrap_or(0),
        field: if args.base { v1::FieldKind::Base } else { v1::FieldKind::Marked }.into(),
        appearance: args.light.asked()?,
        appearance_to: args
            .light_to
            .clone()
            .map(|view| v1::Appearance { choice: Some(v1::appearance::Choice::ViewName(view)) }),
    };
    let mut flight = Flight::new(&args);
    if let Some(folder) = &args.sequence {
        let label = label(line, &request).await?;
        flight.pictures = sequence(folder, &label, args.resume, args.frames)?;
        flight.label = (!args.resume).then_some(label);
        request.first_frame = flight.pictures;
        for i in 0..flight.pictures {
            let picture = decode(&read(&frame_path(folder, i))?)?;
            flight.animate(&picture)?;
        }
    }
    if request.first_frame < args.frames {
        flight.fly(line, request).await?;
    }
    flight.land()
}

/// What is written of a flight.
struct Flight<'a> {
    args: &'a Args,
    /// What a new folder of frames is of; made when the request is accepted.
    label: Option<serde_json::Value>,
    animation: Option<Animation>,
    /// Frames that are there.
    pictures: u32,
    /// Their width and height, px.
    size: (usize, usize),
}

impl<'a> Flight<'a> {
    fn new(args: &'a Args) -> Self {
        Self { args, label: None, animation: None, pictures: 0, size: (0, 0) }
    }

    /// Takes frame after frame until all are there.
    async fn fly(&mut self, line: &Connection, request: v1::RenderPathRequest) -> anyhow::Result<()> {
        let (first, total) = (request.first_frame, self.args.frames);
        // Listens from now on, whatever is being done when it comes.
        let mut interrupt = tokio::spawn(tokio::signal::ctrl_c());
        let scene = request.scene.clone();
        let mut stream = line.about(&scene).render().render_path(request).await.map_err(refused)?.into_inner();
        // Not before: what is refused leaves no folder that looks like a flight cut off.
        if let (Some(folder), Some(label)) = (&self.args.sequence, self.label.take()) {
            begin(folder, &label)?;
        }
        let (mut shown, begun) = (Progress::new(true), Instant::now());
        shown.draw("frames", (first.into(), total.into()), "", -1.0);
        loop {
            let message = tokio::select! {
                message = stream.message() => message.map_err(refused)?,
                interrupt = &mut interrupt => {
                    interrupt??;
                    shown.end();
                    // Dropping the stream tells the services to stop.
                    return Err(self.cut_off());
                }
            };
            let Some(frame) = message else { break };
            anyhow::ensure!(
                frame.frame == self.pictures,
                "frame {} came in the place of {}",
                frame.frame,
                self.pictures
            );
            self.keep(&frame.png)?;
            let new = f64::from(self.pictures - first);
            let left = begun.elapsed().as_secs_f64() / new * f64::from(total - self.pictures);
            shown.draw("frames", (self.pictures.into(), total.into()), "", left);
        }
        shown.end();
        anyhow::ensure!(self.pictures == total, "the line ended after {} of {total} frames", self.pictures);
        Ok(())
    }

    /// Keeps one frame, in the folder and in the animation.
    fn keep(&mut self, png: &[u8]) -> anyhow::Result<()> {
        let picture = decode(png)?;
        if let Some(folder) = &self.args.sequence {
            write_whole(&frame_path(folder, self.pictures), png)?;
        }
        self.pictures += 1;
        self.animate(&picture)
    }

    fn animate(&mut self, picture: &Picture) -> anyhow::Result<()> {
        self.size = (picture.width(), picture.height());
        let Some(path) = &self.args.out else { return Ok(()) };
        let animation = match &mut self.animation {
            Some(animation) => animation,
            none => none.insert(Animation::begin(path, self.size, self.args.frames as usize, self.args.fps)?),
        };
        animation.add(picture)
    }

    /// Gives the animation its name, and says what is there.
    fn land(self) -> anyhow::Result<()> {
        let (frames, (width, height)) = (self.pictures, self.size);
        if let Some(animation) = self.animation {
            animation.finish()?;
        }
        let places = [&self.args.out, &self.args.sequence];
        let places: Vec<String> = places.into_iter().flatten().map(|p| p.display().to_string()).collect();
        println!("{frames} frames of {width} x {height} px in {}", places.join(" and in "));
        Ok(())
    }

    fn cut_off(&self) -> anyhow::Error {
        let (done, total) = (self.pictures, self.args.frames);
        match &self.args.sequence {
            Some(folder) => anyhow::anyhow!(
                "cut off after {done} of {total} frames; they are kept in {}: repeat the command with --resume to go on",
                folder.display()
            ),
            None => anyhow::anyhow!(
                "cut off after {done} of {total} frames; nothing is kept (--sequence DIR keeps frames to go on from)"
            ),
        }
    }
}

fn decode(png: &[u8]) -> anyhow::Result<Picture> {
    decode_picture(png, &Limits::default(), None).context("a frame does not decode")
}

fn frame_path(folder: &Path, i: u32) -> PathBuf {
    folder.join(format!("frame-{i:05}.png"))
}

/// Everything that frames depend on: those of another path must not be gone on with.
async fn label(line: &Connection, request: &v1::RenderPathRequest) -> anyhow::Result<serde_json::Value> {
    let model = scene::get(line, &request.scene).await?.model;
    let path = match &request.path {
        Some(to::Path::Orbit(o)) => json!({ "orbit_deg": o.arc_deg }),
        Some(to::Path::Between(b)) => json!({ "from_view": b.from_view, "to_view": b.to_view }),
        Some(to::Path::Spiral(_)) | None => json!("spiral"),
    };
    let mut label = json!({
        "format_version": 1,
        "scene": request.scene,
        "job": model.map(|m| m.job_id),
        "path": path,
        "frames": request.frames,
        "width": request.width,
        "height": request.height,
        "base": request.field() == v1::FieldKind::Base,
        "light": light(request.appearance.as_ref()),
    });
    // Folders of before know nothing of it.
    if request.appearance_to.is_some() {
        label["light_to"] = light(request.appearance_to.as_ref());
    }
    Ok(label)
}

/// A light in a label: a view's name, or a photograph's digest and the camera that took it.
fn light(appearance: Option<&v1::Appearance>) -> serde_json::Value {
    use v1::appearance::Choice;
    match appearance.and_then(|a| a.choice.as_ref()) {
        Some(Choice::ViewName(view)) => json!(view),
        Some(Choice::Photograph(p)) => {
            let digest = Digest::of(&p.photograph).to_string();
            json!({ "photograph_sha256": digest, "taken": taken(p.viewpoint.as_ref()) })
        }
        Some(Choice::Neutral(_) | Choice::Blend(_)) | None => serde_json::Value::Null,
    }
}

/// The camera that took a photograph, in a label.
fn taken(viewpoint: Option<&v1::Viewpoint>) -> serde_json::Value {
    use v1::viewpoint::From;
    match viewpoint.and_then(|v| v.from.as_ref()) {
        Some(From::ViewName(view)) => json!(view),
        Some(From::Camera(camera)) => {
            let i = camera.intrinsics.unwrap_or_default();
            let pose = camera.pose.clone().unwrap_or_default();
            json!({
                "px": [i.width, i.height],
                "lens": [i.fx, i.fy, i.cx, i.cy, i.k1, i.k2, i.k3, i.p1, i.p2],
                "rotation": pose.rotation,
                "position": pose.position,
            })
        }
        None => serde_json::Value::Null,
    }
}

/// How many frames the folder holds to go on from. Without `resume` there must be none.
fn sequence(folder: &Path, label: &serde_json::Value, resume: bool, frames: u32) -> anyhow::Result<u32> {
    let file = folder.join(LABEL);
    if resume {
        let there: serde_json::Value =
            serde_json::from_slice(&read(&file)?).with_context(|| format!("{} is damaged", file.display()))?;
        anyhow::ensure!(
            there == *label,
            "{} holds frames of another path, size, light or model; leave --resume away, with a new folder",
            folder.display()
        );
        return Ok((0..frames).take_while(|i| frame_path(folder, *i).exists()).count() as u32);
    }
    // What was cut off before its first frame is begun anew.
    let is_frame = |name: &str| name.starts_with("frame-") && name.ends_with(".png");
    let mut there = std::fs::read_dir(folder).into_iter().flatten().flatten();
    anyhow::ensure!(
        !there.any(|entry| is_frame(&entry.file_name().to_string_lossy())),
        "{} holds frames already; go on with --resume, or give another folder",
        folder.display()
    );
    Ok(0)
}

/// Makes the folder of frames, and says in it what they are of.
fn begin(folder: &Path, label: &serde_json::Value) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    write_whole(&folder.join(LABEL), &serde_json::to_vec_pretty(label)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_says_whose_light_it_is_and_not_how_the_program_is_built() {
        use v1::{appearance::Choice, viewpoint::From};
        assert_eq!(light(None), serde_json::Value::Null);
        let view = v1::Appearance { choice: Some(Choice::ViewName("a.png".into())) };
        assert_eq!(light(Some(&view)), json!("a.png"));
        let of = |from| {
            let viewpoint = Some(v1::Viewpoint { from: Some(from) });
            let photograph = v1::PhotographAppearance { photograph: vec![1, 2].into(), viewpoint };
            light(Some(&v1::Appearance { choice: Some(Choice::Photograph(photograph)) }))
        };
        let digest = Digest::of([1, 2]).to_string();
        assert_eq!(of(From::ViewName("b.png".into())), json!({ "photograph_sha256": digest, "taken": "b.png" }));
        let camera = |intrinsics| of(From::Camera(v1::Camera { intrinsics, ..v1::Camera::default() }));
        assert_eq!(camera(None), camera(Some(v1::Intrinsics::default())));
        assert_ne!(camera(None), camera(Some(v1::Intrinsics { k3: 0.1, ..v1::Intrinsics::default() })));
    }

    #[test]
    fn a_sequence_goes_on_with_its_own_frames_alone() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("frames");
        let (label, other) = (json!({ "frames": 5 }), json!({ "frames": 6 }));
        assert_eq!(sequence(&folder, &label, false, 5).unwrap(), 0);
        assert!(!folder.exists(), "made before the request is accepted");
        begin(&folder, &other).unwrap();
        assert_eq!(sequence(&folder, &label, false, 5).unwrap(), 0, "no frame of the other one came");
        begin(&folder, &label).unwrap();
        for i in [0, 1, 3] {
            std::fs::write(frame_path(&folder, i), "png").unwrap();
        }
        assert_eq!(sequence(&folder, &label, true, 5).unwrap(), 2, "up to the first that is missing");
        assert!(sequence(&folder, &other, true, 6).unwrap_err().to_string().contains("another path"));
        assert!(sequence(&folder, &label, false, 5).unwrap_err().to_string().contains("--resume"));
    }
}
