//! `cairn locate`: which camera took a picture, and the picture beside what the field shows from there.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1::{self, locate_response::Answer};
use cairn_scene::{Limits, Picture, decode_picture, encode_png};
use cairn_service::export::sheet::{Tile, contact_sheet};
use cairn_service::query::evaluate::difference;

use super::animation::Gif;
use super::connect::Connection;
use super::files::{read, read_picture, write};
use super::json::{self, Json};
use super::viewpoint::{FromWhere, viewpoint};

/// Frames a second in which picture and render follow each other.
const BLINKS: u16 = 2;
/// What the picture has more than the render is drawn so many times as strong.
const TIMES: f32 = 5.0;

/// `cairn locate`.
#[derive(Debug, clap::Args)]
pub struct LocateArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    /// The picture, PNG, JPEG or WebP; it may be turned, cut and made smaller
    picture: PathBuf,
    /// Also draw the picture and what the field shows from its camera: a .gif in which they take turns, or a .png of both and
    /// their difference times 5; refused where no camera is found
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    json: Json,
}

/// Answers `cairn locate`.
pub async fn locate(line: &Connection, args: LocateArgs) -> anyhow::Result<()> {
    let drawing = args.out.as_deref().map(Drawing::of).transpose()?;
    let picture = read_picture("locate", &args.name, &args.picture)?;
    let mut answer = ask(line, &args.name, picture, drawing.is_some()).await?;
    if let (Some(drawing), Some(Answer::Found(found))) = (&drawing, &mut answer.answer) {
        drawing.draw(found)?;
        // Files are for these.
        (found.compared_png, found.render_png) = Default::default();
    }
    match (&answer.answer, args.json.json) {
        (_, true) => json::print(&answer)?,
        (Some(Answer::Found(found)), _) => in_words(found)?.iter().for_each(|said| println!("{said}")),
        (Some(Answer::NotFound(why)), _) => println!("not found: {why}"),
        (None, _) => anyhow::bail!("the daemon sent an answer that says nothing"),
    }
    match (drawing, &answer.answer) {
        (Some(drawing), Some(Answer::Found(_))) if !args.json.json => println!("{drawing}"),
        (Some(Drawing::Blink(out) | Drawing::Sheet(out)), Some(Answer::NotFound(_))) => {
            anyhow::bail!("nothing is written into {}: the picture's camera was not found", out.display())
        }
        _ => {}
    }
    Ok(())
}

/// A place that is asked about.
pub struct Asked {
    /// From where.
    pub viewpoint: v1::Viewpoint,
    /// The camera that took the picture that was given in the place of one.
    pub located: Option<v1::FoundCamera>,
}

/// The place that `from` says; of a picture its camera is looked for.
///
/// # Errors
/// For files that cannot be read and a picture whose camera is not found, with the reason; the services' refusals.
pub async fn asked(line: &Connection, scene: &str, from: FromWhere) -> anyhow::Result<Asked> {
    let Some(picture) = &from.picture else {
        return Ok(Asked { viewpoint: viewpoint(from.view, from.pose.as_deref())?, located: None });
    };
    let found = camera_of(line, scene, picture).await?;
    let from = found.camera.clone().map(v1::viewpoint::From::Camera);
    Ok(Asked { viewpoint: v1::Viewpoint { from }, located: Some(found) })
}

/// The camera that took the picture in a file.
///
/// # Errors
/// As [`asked`].
pub async fn camera_of(line: &Connection, scene: &str, picture: &Path) -> anyhow::Result<v1::FoundCamera> {
    match ask(line, scene, read(picture)?, false).await?.answer {
        Some(Answer::Found(found)) => Ok(*found),
        Some(Answer::NotFound(why)) => anyhow::bail!("{}: {why}", picture.display()),
        None => anyhow::bail!("the daemon sent an answer that says nothing"),
    }
}

async fn ask(line: &Connection, scene: &str, picture: Vec<u8>, compared: bool) -> anyhow::Result<v1::LocateResponse> {
    let request = v1::LocateRequest { scene: scene.to_owned(), picture: picture.into(), compared };
    Ok(line.about(scene).query().locate(request).await?.into_inner())
}

/// A camera that was found, for people.
///
/// # Errors
/// For an answer without one.
pub fn in_words(found: &v1::FoundCamera) -> anyhow::Result<[String; 3]> {
    let camera = found.camera.as_ref().context("the daemon found a camera and sent none")?;
    let (lens, pose) = (camera.intrinsics.unwrap_or_default(), camera.pose.clone().unwrap_or_default());
    let in_three = |numbers: Vec<f64>| numbers.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    // The third column, row by row.
    let ahead = pose.rotation.iter().skip(2).step_by(3).copied().collect();
    let focal = match (lens.fx - lens.fy).abs() <= 0.001 * lens.fx {
        true => format!("{:.1}", lens.fx),
        false => format!("{:.1} across and {:.1} down", lens.fx, lens.fy),
    };
    let turned = match found.turned_deg {
        None => String::new(),
        Some(by) if by.abs() < 0.05 => "; the picture is upright".to_owned(),
        Some(by) if by > 0.0 => format!("; the picture is turned clockwise by {by:.1} degrees"),
        Some(by) => format!("; the picture is turned counterclockwise by {:.1} degrees", -by),
    };
    let uncertain = match found.uncertainty_px.is_finite() {
        true => format!("uncertain by {:.2} px", found.uncertainty_px),
        false => "its uncertainty is not known".to_owned(),
    };
    let (agreeing, explained) = (found.agreeing, 100.0 * found.explained);
    Ok([
        format!("camera at ({}), looking along ({})", in_three(pose.position), in_three(ahead)),
        format!("focal length {focal} px of {} x {} px{turned}", lens.width, lens.height),
        format!("{uncertain}: {agreeing} keypoints agree, and the field explains {explained:.0} % of the picture"),
    ])
}

/// The picture and what the field shows from its camera, by the file's ending.
enum Drawing {
    /// They take turns.
    Blink(PathBuf),
    /// They stand side by side, with their difference.
    Sheet(PathBuf),
}

impl Drawing {
    fn of(out: &Path) -> anyhow::Result<Self> {
        match out.extension().and_then(|ending| ending.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("gif") => Ok(Self::Blink(out.to_path_buf())),
            Some("png") => Ok(Self::Sheet(out.to_path_buf())),
            _ => anyhow::bail!("{}: the comparison's name ends in .gif or .png", out.display()),
        }
    }

    fn draw(&self, found: &v1::FoundCamera) -> anyhow::Result<()> {
        let decoded = |png: &[u8]| decode_picture(png, &Limits::default(), None).context("a picture does not decode");
        let (picture, render) = (decoded(&found.compared_png)?, decoded(&found.render_png)?);
        match self {
            Self::Blink(out) => {
                let mut gif = Gif::begin(out, picture.width(), picture.height(), BLINKS)?;
                gif.add(&picture)?;
                gif.add(&render)?;
                gif.finish().map(drop)
            }
            Self::Sheet(out) => write(out, &encode_png(&sheet(picture, render))),
        }
    }
}

impl std::fmt::Display for Drawing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Blink(out) => write!(f, "picture and render take turns in {}", out.display()),
            Self::Sheet(out) => write!(f, "picture, render and their difference times {TIMES} in {}", out.display()),
        }
    }
}

fn sheet(picture: Picture, render: Picture) -> Picture {
    let (width, height) = (picture.width(), picture.height());
    let differs = difference(&picture, &render, TIMES);
    let named = [("Picture", picture), ("Render", render), ("Difference x 5", differs)];
    contact_sheet(&[named.map(|(label, picture)| Tile { picture, label: label.into() }).to_vec()], width, height)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found() -> v1::FoundCamera {
        let intrinsics = v1::Intrinsics { width: 200, height: 300, fx: 240.0, fy: 240.1, ..Default::default() };
        let pose = v1::Pose { rotation: (1..=9).map(f64::from).collect(), position: vec![0.5, -1.25, 3.0] };
        let camera = Some(v1::Camera { intrinsics: Some(intrinsics), pose: Some(pose) });
        v1::FoundCamera { camera, uncertainty_px: 0.123, explained: 0.987, agreeing: 57, ..Default::default() }
    }

    #[test]
    fn people_read_where_the_camera_stands_and_how_sure_that_is() {
        let said = in_words(&found()).unwrap();
        assert_eq!(said[0], "camera at (0.500, -1.250, 3.000), looking along (3.000, 6.000, 9.000)");
        assert_eq!(said[1], "focal length 240.0 px of 200 x 300 px");
        assert_eq!(said[2], "uncertain by 0.12 px: 57 keypoints agree, and the field explains 99 % of the picture");
        let turned = |by| in_words(&v1::FoundCamera { turned_deg: Some(by), ..found() }).unwrap()[1].clone();
        assert!(turned(12.34).ends_with("; the picture is turned clockwise by 12.3 degrees"));
        assert!(turned(-90.0).ends_with("; the picture is turned counterclockwise by 90.0 degrees"));
        assert!(turned(-0.01).ends_with("; the picture is upright"));
        let unknown = v1::FoundCamera { uncertainty_px: f64::INFINITY, ..found() };
        assert!(in_words(&unknown).unwrap()[2].starts_with("its uncertainty is not known: "));
        let mut wide = found();
        wide.camera.as_mut().unwrap().intrinsics.as_mut().unwrap().fy = 250.0;
        assert_eq!(in_words(&wide).unwrap()[1], "focal length 240.0 across and 250.0 down px of 200 x 300 px");
    }

    #[test]
    fn the_ending_says_what_is_drawn() {
        assert!(matches!(Drawing::of(Path::new("a.GIF")), Ok(Drawing::Blink(_))));
        assert!(matches!(Drawing::of(Path::new("a.png")), Ok(Drawing::Sheet(_))));
        let refused = Drawing::of(Path::new("a.jpg")).err().unwrap().to_string();
        assert_eq!(refused, "a.jpg: the comparison's name ends in .gif or .png");
    }

    #[test]
    fn a_sheet_has_three_pictures_side_by_side() {
        let sheet = sheet(Picture::constant(20, 10, [0.6; 3]), Picture::constant(20, 10, [0.5; 3]));
        let at = |tile: usize| sheet.pixel(4 + tile * 24 + 10, 4 + 5)[0];
        assert_eq!((at(0), at(1)), (0.6, 0.5));
        assert!((at(2) - 1.0).abs() < 1e-5, "half, and five times a tenth: {}", at(2));
    }
}
