//! `cairn render`, `who`, `detect`, `evaluate`: looking at a trained scene.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use serde::Deserialize;

use super::connect::{Connection, refused};
use super::light::{InLight, OnTheWay};
use super::{read, write};

/// Contributors named in one line.
const MAX_NAMES: usize = 5;
/// What is said of an unmarked picture whose confidence is less than a half; the answer does not hold the others'.
const MAYBE_LIKELIER: &str = ": somebody may be likelier, and not sure enough to be named; `cairn detect` says who";

/// From where to look.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub struct FromWhere {
    /// The name of one of the scene's views
    #[arg(long, value_name = "VIEW")]
    pub view: Option<String>,
    /// A camera: JSON with width, height, fx, fy, cx, cy (px), camera_to_world (3 or 4 rows of 4 numbers, OpenCV axes),
    /// and k1, k2, k3, p1, p2 where the lens distorts
    #[arg(long, value_name = "FILE")]
    pub pose: Option<PathBuf>,
}

/// `cairn render`.
#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    /// The scene
    name: String,
    #[command(flatten)]
    from: FromWhere,
    /// Where the PNG goes
    #[arg(long, value_name = "PNG")]
    out: PathBuf,
    /// The field before it was marked
    #[arg(long)]
    base: bool,
    #[command(flatten)]
    light: InLight,
    #[command(flatten)]
    on_the_way: OnTheWay,
    /// Also write depth along the optical axis: 16-bit grey, 0 for none, its unit is printed and said in the file
    #[arg(long, value_name = "PNG")]
    depth: Option<PathBuf>,
    /// Also write depth in colours: near yellow, far violet, fading into a grey chequer for none
    #[arg(long, value_name = "PNG")]
    depth_colours: Option<PathBuf>,
    /// Also write accumulation, the share of light that the field stops: 16-bit grey
    #[arg(long, value_name = "PNG")]
    accumulation: Option<PathBuf>,
}

/// `cairn who`.
#[derive(Debug, clap::Args)]
pub struct WhoArgs {
    /// The scene
    name: String,
    #[command(flatten)]
    about: AboutWhat,
    #[command(flatten)]
    over: OverField,
}

/// What to ask about.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct AboutWhat {
    /// The name of one of the scene's views
    #[arg(long, value_name = "VIEW")]
    view: Option<String>,
    /// A camera, as for `cairn render`
    #[arg(long, value_name = "FILE")]
    pose: Option<PathBuf>,
    /// A picture, which the classifier reads
    #[arg(long, value_name = "PNG")]
    picture: Option<PathBuf>,
}

/// Reading a picture by laying it over the field.
#[derive(Debug, clap::Args)]
struct OverField {
    /// Also lay the picture over the field and look for each mark in what the field does not explain: surer, and takes
    /// many seconds where it is not said from where the picture was rendered
    #[arg(long, requires = "picture")]
    over_field: bool,
    /// Lay the picture over the field at this view of the scene, which it was rendered from and neither cut nor turned since
    #[arg(long, value_name = "VIEW", conflicts_with = "rendered_pose", requires = "picture")]
    rendered_view: Option<String>,
    /// Lay it over the field at this camera, written as for `cairn render --pose`
    #[arg(long, value_name = "FILE", requires = "picture")]
    rendered_pose: Option<PathBuf>,
}

impl OverField {
    fn asked(self) -> anyhow::Result<Option<v1::LayOver>> {
        let Self { over_field, rendered_view, rendered_pose } = self;
        if rendered_view.is_some() || rendered_pose.is_some() {
            let viewpoint = Some(viewpoint(rendered_view, rendered_pose.as_deref())?);
            return Ok(Some(v1::LayOver { viewpoint }));
        }
        Ok(over_field.then_some(v1::LayOver { viewpoint: None }))
    }
}

/// `cairn detect`.
#[derive(Debug, clap::Args)]
pub struct DetectArgs {
    /// The scene whose detector reads
    name: String,
    /// The picture, PNG or JPEG
    picture: PathBuf,
    /// Where the recovered picture goes
    #[arg(long, value_name = "PNG")]
    out: Option<PathBuf>,
    /// Where the recovered sound goes
    #[arg(long, value_name = "WAV")]
    audio: Option<PathBuf>,
    /// Where the recovered text goes; it is printed as well
    #[arg(long, value_name = "TXT")]
    text: Option<PathBuf>,
    #[command(flatten)]
    over: OverField,
}

/// `cairn evaluate`.
#[derive(Debug, clap::Args)]
pub struct EvaluateArgs {
    /// The scene
    name: String,
    /// Also write the report as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Also draw the contact sheet
    #[arg(long, value_name = "PNG")]
    sheet: Option<PathBuf>,
}

/// A camera as people write it down.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFile {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
    camera_to_world: Vec<[f64; 4]>,
}

fn camera(path: &Path) -> anyhow::Result<v1::Camera> {
    let f: PoseFile =
        serde_json::from_slice(&read(path)?).with_context(|| format!("{} is no camera", path.display()))?;
    let rows = &f.camera_to_world;
    let last_is_right = rows.get(3).is_none_or(|row| *row == [0.0, 0.0, 0.0, 1.0]);
    anyhow::ensure!(
        (rows.len() == 3 || rows.len() == 4) && last_is_right,
        "{}: camera_to_world needs 3 rows of 4 numbers, or 4 with the last one 0, 0, 0, 1",
        path.display()
    );
    let rotation = rows[..3].iter().flat_map(|row| row[..3].iter().copied()).collect();
    let position = rows[..3].iter().map(|row| row[3]).collect();
    let (fx, fy, cx, cy) = (f.fx, f.fy, f.cx, f.cy);
    let (k1, k2, k3, p1, p2) = (f.k1, f.k2, f.k3, f.p1, f.p2);
    let intrinsics = v1::Intrinsics { width: f.width, height: f.height, fx, fy, cx, cy, k1, k2, k3, p1, p2 };
    Ok(v1::Camera { intrinsics: Some(intrinsics), pose: Some(v1::Pose { rotation, position }) })
}

/// The viewpoint of a view or of a camera's file.
///
/// # Errors
/// For a file that is no camera, and where neither is given.
pub fn viewpoint(view: Option<String>, pose: Option<&Path>) -> anyhow::Result<v1::Viewpoint> {
    use v1::viewpoint::From;
    let from = match (view, pose) {
        (Some(name), _) => From::ViewName(name),
        (None, Some(path)) => From::Camera(camera(path)?),
        (None, None) => anyhow::bail!("say from where: --view or --pose"),
    };
    Ok(v1::Viewpoint { from: Some(from) })
}

/// Answers `cairn render`.
pub async fn render(line: &Connection, args: RenderArgs) -> anyhow::Result<()> {
    let field = if args.base { v1::FieldKind::Base } else { v1::FieldKind::Marked };
    let request = v1::RenderRequest {
        scene: args.name.clone(),
        viewpoint: Some(viewpoint(args.from.view, args.from.pose.as_deref())?),
        field: field.into(),
        appearance: args.light.asked_with(args.on_the_way)?,
        accumulation: args.accumulation.is_some(),
        depth: args.depth.is_some(),
        depth_colours: args.depth_colours.is_some(),
    };
    let answer = line.about(&args.name).render().render(request).await.map_err(refused)?.into_inner();
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

/// Answers `cairn who`.
pub async fn who(line: &Connection, args: WhoArgs) -> anyhow::Result<()> {
    let lay_over = args.over.asked()?;
    let over_field = lay_over.is_some();
    let by_picture = args.about.picture.is_some();
    let answer = match args.about.picture {
        Some(path) => {
            let picture = read(&path)?.into();
            let scene = args.name.clone();
            let request = v1::WhoByPictureRequest { scene, picture, lay_over };
            line.about(&args.name).query().who_by_picture(request).await
        }
        None => {
            let viewpoint = Some(viewpoint(args.about.view, args.about.pose.as_deref())?);
            let request = v1::WhoByPoseRequest { scene: args.name, viewpoint };
            line.query().who_by_pose(request).await
        }
    };
    let answer = answer.map_err(refused)?.into_inner();
    match answer.answer {
        Some(v1::who_response::Answer::Identity(who)) => {
            println!("identity {}: {} (confidence {:.2})", who.number, who.label, answer.confidence);
            if !who.contributors.is_empty() {
                println!("{}: photographs by {}", who.label, named(&who.contributors));
            }
            let indices: Vec<String> = who.record_indices.iter().map(u64::to_string).collect();
            let records = if indices.is_empty() { "none".to_owned() } else { indices.join(", ") };
            println!("owner records at index: {records}");
        }
        Some(v1::who_response::Answer::Elsewhere(there)) => {
            println!("{} (confidence {:.2})", elsewhere(&there), answer.confidence);
        }
        _ => {
            let likelier = if by_picture && answer.confidence < 0.5 { MAYBE_LIKELIER } else { "" };
            println!("unmarked (confidence {:.2}){likelier}", answer.confidence);
        }
    }
    closer(answer.closer_look);
    if over_field {
        laid(answer.laid_over.as_ref());
    }
    Ok(())
}

/// Of an unmarked picture: that an owner is likelier all the same, if one is.
fn unsure(probabilities: &[f32]) -> String {
    let all = || probabilities.iter().enumerate();
    match all().max_by(|(_, a), (_, b)| a.total_cmp(b)) {
        Some((class, _)) if class > 0 => format!(": class {class} is likelier, and not sure enough to be named"),
        _ => String::new(),
    }
}

/// Whether the answer is that of the picture's middle.
fn closer(looked: bool) {
    if looked {
        println!("read in the middle of the picture: the whole says nothing surely");
    }
}

/// What laying the picture over the field said.
fn laid(found: Option<&v1::LaidOver>) {
    let Some(found) = found else {
        println!("it is like the field from nowhere that was tried: the classifier answers");
        return;
    };
    println!("laid over the field, which explains {:.0} % of it", 100.0 * found.explained);
    for (at, score) in found.scores.iter().enumerate() {
        println!("  mark {}: {score:.1} deviations (believed from {:.0} on)", at + 1, found.believed_from);
    }
    match found.believed {
        0 => println!("no mark stands out: the classifier answers"),
        number => println!("mark {number} stands out and is believed"),
    }
}

/// Whose mark of another scene it is.
fn elsewhere(there: &v1::WhoElsewhere) -> String {
    format!("of scene {}, identity {}: {}", there.scene, there.number, there.label)
}

/// The first contributors by name, each with a count; how many more there are.
fn named(contributors: &[v1::WhoContributor]) -> String {
    let first = contributors.iter().take(MAX_NAMES).map(|c| format!("{} ({})", c.name, c.photographs));
    let mut names = first.collect::<Vec<_>>().join(", ");
    if contributors.len() > MAX_NAMES {
        names.push_str(&format!(" and {} more", contributors.len() - MAX_NAMES));
    }
    names
}

/// Answers `cairn detect`.
pub async fn detect(line: &Connection, args: DetectArgs) -> anyhow::Result<()> {
    let picture = read(&args.picture)?.into();
    let lay_over = args.over.asked()?;
    let over_field = lay_over.is_some();
    let request = v1::DetectRequest { scene: args.name.clone(), picture, lay_over };
    let answer = line.about(&args.name).detection().detect(request).await.map_err(refused)?.into_inner();
    match (answer.identity, &answer.elsewhere) {
        (0, Some(there)) => println!("{}", elsewhere(there)),
        (0, None) => println!("unmarked{}", unsure(&answer.probabilities)),
        (number, _) => println!("identity {number}: {}", answer.label),
    }
    closer(answer.closer_look);
    if over_field {
        laid(answer.laid_over.as_ref());
    }
    for (class, probability) in answer.probabilities.iter().enumerate() {
        println!("  class {class}: {probability:.4}");
    }
    if let Some(text) = &answer.recovered_text {
        // Quoted and escaped: it comes out of a picture, and may say anything to a terminal.
        println!("recovered text: {text:?}");
    }
    let text = answer.recovered_text.as_deref().unwrap_or_default().as_bytes();
    for (what, option, path, bytes) in [
        ("picture", "--out", &args.out, &answer.recovered_png[..]),
        ("sound", "--audio", &args.audio, &answer.recovered_wav[..]),
        ("text", "--text", &args.text, text),
    ] {
        match path {
            Some(path) if bytes.is_empty() && what != "text" => {
                println!("no {what} for {}: nobody hides one in the scene", path.display());
            }
            Some(path) => {
                write(path, bytes)?;
                println!("recovered {what} in {}", path.display());
            }
            None if bytes.is_empty() || what == "text" => {}
            None => println!("recovered {what} not kept; give {option} to have it"),
        }
    }
    Ok(())
}

/// Answers `cairn evaluate`.
pub async fn evaluate(line: &Connection, args: EvaluateArgs) -> anyhow::Result<()> {
    let report = report(line, &args.name, args.json.as_ref(), args.sheet.as_ref()).await?;
    print!("{report}");
    Ok(())
}

/// Scores a scene; writes the report and the contact sheet where asked.
pub async fn report(
    line: &Connection,
    scene: &str,
    json: Option<&PathBuf>,
    sheet: Option<&PathBuf>,
) -> anyhow::Result<cairn_service::query::report::Report> {
    let contact_sheet = sheet.is_some();
    let request = v1::EvaluateRequest { scene: scene.to_owned(), contact_sheet };
    let answer = line.about(scene).query().evaluate(request).await.map_err(refused)?.into_inner();
    if let Some(path) = json {
        write(path, answer.report_json.as_bytes())?;
    }
    if let Some(path) = sheet {
        write(path, &answer.contact_sheet_png)?;
    }
    serde_json::from_str(&answer.report_json).context("the daemon's report is of another version")
}

/// Looking from a camera of one's own: the pose file of a [`cairn_scene::Camera`].
#[cfg(test)]
fn pose_file(camera: &cairn_scene::Camera) -> serde_json::Value {
    let (i, p) = (&camera.intrinsics, &camera.pose);
    let row = |r: usize| {
        let rotation = p.rotation.row(r);
        [rotation.x, rotation.y, rotation.z, p.position[r]]
    };
    serde_json::json!({
        "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy,
        "camera_to_world": [row(0), row(1), row(2)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Camera, Distortion, Intrinsics, Pose};
    use glam::{DMat3, DVec3};

    #[test]
    fn a_pose_file_is_the_camera_it_describes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pose.json");
        let pose = Pose::look_at(DVec3::new(1.0, -2.0, 3.0), DVec3::ZERO, DVec3::Z).unwrap();
        let distortion = Distortion::default();
        let intrinsics = Intrinsics { width: 8, height: 6, fx: 7.0, fy: 7.0, cx: 4.0, cy: 3.0, distortion };
        let wanted = Camera { intrinsics, pose };
        std::fs::write(&path, pose_file(&wanted).to_string()).unwrap();
        let read = cairn_service::grpc::from_proto::camera("c", Some(&camera(&path).unwrap())).unwrap();
        assert!((read.pose.position - wanted.pose.position).length() < 1e-12);
        let difference: DMat3 = read.pose.rotation - wanted.pose.rotation;
        assert!(difference.to_cols_array().iter().all(|v| v.abs() < 1e-9), "{difference}");
        assert!((wanted.ray(1.0, 2.0).1 - read.ray(1.0, 2.0).1).length() < 1e-9);
    }

    #[test]
    fn a_line_names_five_contributors_and_counts_the_rest() {
        let of = |count: u32| {
            let of = |n| v1::WhoContributor { name: format!("drone-{n}"), photographs: 9 - n };
            named(&(0..count).map(of).collect::<Vec<_>>())
        };
        assert_eq!(of(2), "drone-0 (9), drone-1 (8)");
        assert_eq!(of(5), "drone-0 (9), drone-1 (8), drone-2 (7), drone-3 (6), drone-4 (5)");
        assert_eq!(of(7), "drone-0 (9), drone-1 (8), drone-2 (7), drone-3 (6), drone-4 (5) and 2 more");
    }

    #[test]
    fn an_unmarked_picture_that_tells_an_owner_says_so() {
        assert_eq!(unsure(&[0.6, 0.1, 0.3]), "");
        assert!(unsure(&[0.3, 0.0, 0.7]).contains("class 2 is likelier"));
        assert_eq!(unsure(&[]), "");
    }

    #[test]
    fn a_wrong_last_row_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pose.json");
        let text = r#"{"width":1,"height":1,"fx":1,"fy":1,"cx":0,"cy":0,
            "camera_to_world":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]}"#;
        std::fs::write(&path, text).unwrap();
        assert!(camera(&path).unwrap_err().to_string().contains("0, 0, 0, 1"));
    }
}
