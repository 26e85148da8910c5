//! `cairn scene`: import, list, show, check, exclude, include, delete.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{IsTerminal as _, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context as _;
use cairn_api::v1::{self, import_scene_request::Part};
use cairn_log::{Digest, PublicKey};
use cairn_scene::{Capture, ReadOptions, SceneKind, encode_png, no_share};

use super::connect::Connection;
use super::json::{self, Json};
use cairn_service::grpc::{from_proto, to_proto};

/// Bytes of photograph a message.
const CHUNK_BYTES: usize = 256 << 10;
/// Points a message.
const POINTS_A_CHUNK: usize = 10_000;

/// What to do with scenes.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Bring a capture in: COLMAP, LLFF, NeRF-Synthetic or transforms.json
    #[command(
        after_help = "Example:\n  cairn scene import liberty --from liberty --contributors contributors.csv --scale 0.5"
    )]
    Import(ImportArgs),
    /// All scenes
    #[command(after_help = "Example:\n  cairn scene list")]
    List {
        #[command(flatten)]
        json: Json,
    },
    /// One scene, its views and its model
    #[command(after_help = "Example:\n  cairn scene show liberty --poses cameras.png")]
    Show {
        /// The scene
        #[arg(value_name = "SCENE")]
        name: String,
        #[command(flatten)]
        json: Json,
        #[command(flatten)]
        poses: super::poses::Args,
    },
    /// How far each view is to be trusted: how the other views explain it, how structure from motion supports it
    #[command(after_help = "Example:\n  cairn scene check liberty --picture check.png")]
    Check(super::check::CheckArgs),
    /// Exclude views: the next training learns nothing from them, and nobody is credited with them
    #[command(after_help = "Example:\n  cairn scene exclude liberty view_098.jpg --why mirrored")]
    Exclude(super::check::ExcludeArgs),
    /// Include views: the next training learns from them, and none excludes them by itself
    #[command(after_help = "Example:\n  cairn scene include liberty view_098.jpg")]
    Include(super::check::IncludeArgs),
    /// Delete a scene and its models (owner records stay in the log)
    #[command(after_help = "Example:\n  cairn scene delete liberty")]
    Delete {
        /// The scene
        #[arg(value_name = "SCENE")]
        name: String,
        /// Do not ask
        #[arg(long)]
        yes: bool,
    },
}

impl Command {
    /// Whether it only reads.
    pub const fn reads(&self) -> bool {
        matches!(self, Self::List { .. } | Self::Show { .. } | Self::Check(_))
    }
}

/// `cairn scene import`.
#[derive(Clone, Debug, clap::Args)]
pub struct ImportArgs {
    /// The new scene's name: letters, digits, '-', '_', '.'
    pub name: String,
    /// The capture's folder, or its transforms.json
    #[arg(long, value_name = "DIR")]
    pub from: PathBuf,
    /// The folder of photographs, in the capture's folder or absolute (its format's usual one where not given)
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,
    /// A folder of masks, in the capture's folder or absolute: named as the photographs, with .png (or .webp) behind or
    /// for the ending; white means use (where not given, COLMAP's masks folder, or nerfstudio's mask_path)
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// Who took what: a CSV table with the columns image,contributor and maybe key, the contributor's public key; looked
    /// for here, then in the capture's folder
    #[arg(long, value_name = "CSV")]
    pub contributors: Option<PathBuf>,
    /// How the scene lies around its cameras (guessed where not given)
    #[arg(long, value_enum)]
    pub kind: Option<Kind>,
    /// Hold out every n-th view in order of name, 2 and up, for `cairn evaluate`; a capture with test views of its own
    /// holds out those (where not given, every photograph is trained on)
    #[arg(long, value_name = "N")]
    pub hold_out: Option<usize>,
    /// Leave out the views whose photographs are not there, and say which
    #[arg(long)]
    pub skip_missing: bool,
    /// Resample the photographs to this width (with --height); the scene then keeps and signs the copies
    #[arg(long, value_name = "PX", requires = "height")]
    pub width: Option<usize>,
    /// Resample the photographs to this height
    #[arg(long, value_name = "PX", requires = "width")]
    pub height: Option<usize>,
    /// Resample the photographs by this factor, above 0, to 1; the scene then keeps and signs the copies, and an auditor needs
    /// these
    #[arg(long, value_name = "FACTOR", conflicts_with = "width")]
    pub scale: Option<f64>,
    #[command(flatten)]
    pub json: Json,
}

/// The kinds of scenes.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Kind {
    /// All cameras look the same way from about the same place (LLFF)
    ForwardFacing,
    /// An object within a box, nothing behind it (NeRF-Synthetic)
    Bounded,
    /// Something in the open
    Unbounded,
}

/// Answers `cairn scene`.
pub async fn run(line: &Connection, command: Command) -> anyhow::Result<()> {
    match command {
        Command::Import(args) => {
            let answer = import(line, &args).await?;
            if args.json.json {
                return json::print(&answer);
            }
            let summary = answer.scene.unwrap_or_default();
            println!("imported {}", one_line(&summary, args.kind.is_none()));
            say_no_share(answer.without_share)
        }
        Command::List { json } => {
            let request = v1::ListScenesRequest {};
            let answer = line.scenes().list(request).await?.into_inner();
            if json.json {
                return json::print(&answer);
            }
            if answer.scenes.is_empty() {
                eprintln!("no scenes yet; bring one in with `cairn scene import NAME --from DIR`");
            }
            answer.scenes.iter().for_each(|s| println!("{}", one_line(s, false)));
            Ok(())
        }
        Command::Show { name, json, poses } => {
            poses.check(&name)?;
            show(line, &name, json).await?;
            super::poses::draw(line, name, poses, json).await
        }
        Command::Check(args) => super::check::check(line, args).await,
        Command::Exclude(args) => super::check::exclude(line, args).await,
        Command::Include(args) => super::check::include(line, args).await,
        Command::Delete { name, yes } => {
            if !yes {
                let summary = get(line, &name).await?.summary.unwrap_or_default();
                sure(&format!("delete scene {name} with its {} photographs and its models?", summary.views))?;
            }
            let request = v1::DeleteSceneRequest { scene: name.clone() };
            line.about(&name).scenes().delete(request).await?;
            println!("deleted {name}");
            Ok(())
        }
    }
}

/// A scene in one line; `guessed`: nobody said how it lies.
fn one_line(s: &v1::SceneSummary, guessed: bool) -> String {
    let trained = if s.trained { "trained" } else { "not trained" };
    let megabytes = s.photograph_bytes as f64 / 1e6;
    format!(
        "{}: {} views ({} held out) by {} contributors, {megabytes:.1} MB, {}, {trained}",
        s.name,
        s.views,
        s.held_out_views,
        s.contributors,
        lies(s, guessed)
    )
}

/// Names the contributors who get no share, and why, where there are any.
fn say_no_share(rows: Vec<v1::UnusedPhotographs>) -> anyhow::Result<()> {
    if let Some(sentence) = no_share(&from_proto::unused_photographs("without_share", rows)?) {
        println!("  {sentence}");
    }
    Ok(())
}

/// How a scene lies, and what is behind it where that is known.
pub fn lies(s: &v1::SceneSummary, guessed: bool) -> String {
    let kind = super::words::word(s.kind().as_str_name(), "SCENE_KIND_");
    let guessed = if guessed { " (guessed; --kind says otherwise)" } else { "" };
    let background = match s.background[..] {
        [] => String::new(),
        [0.0, 0.0, 0.0] => ", on black".to_owned(),
        [1.0, 1.0, 1.0] => ", on white".to_owned(),
        ref rgb => format!(", on RGB {}", rgb.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(" ")),
    };
    format!("{kind}{guessed}{background}")
}

/// Asks the person at the terminal, who has to say yes.
fn sure(question: &str) -> anyhow::Result<()> {
    anyhow::ensure!(std::io::stdin().is_terminal(), "{question} Nobody is there to ask; give --yes");
    eprintln!("{question} [y/N]");
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    anyhow::ensure!(matches!(answer.trim(), "y" | "Y" | "yes"), "nothing was deleted");
    Ok(())
}

async fn show(line: &Connection, name: &str, json: Json) -> anyhow::Result<()> {
    let scene = get(line, name).await?;
    if json.json {
        return json::print(&scene);
    }
    if let Some(summary) = &scene.summary {
        println!("{}", one_line(summary, false));
    }
    for view in &scene.views {
        let held_out = if view.held_out { "  held out" } else { "" };
        let decided = view.decision.as_ref().map_or(String::new(), |d| format!("  {}", super::check::decision(d)));
        println!("  {}  by {}{held_out}{decided}", view.name, view.contributor);
    }
    for (contributor, key) in keys(&scene)? {
        println!("  key of {contributor}: {key}");
    }
    if let Some(model) = scene.model {
        println!("model of {}, seed {}", model.job_id, model.seed);
        for identity in &model.identities {
            println!("  identity {}: {}, {} views", identity.number, identity.label, identity.view_names.len());
        }
        say_no_share(model.without_share)?;
    }
    Ok(())
}

/// The keys that the table of contributors gives, by their names.
pub fn keys(scene: &v1::GetSceneResponse) -> anyhow::Result<BTreeMap<String, PublicKey>> {
    let with_key = scene.views.iter().filter(|view| !view.contributor_key.is_empty());
    let key = |view: &v1::SceneView| {
        let bytes =
            view.contributor_key.as_ref().try_into().context("the daemon's key of a contributor is not 32 bytes")?;
        anyhow::Ok((view.contributor.clone(), PublicKey::from_bytes(bytes)?))
    };
    with_key.map(key).collect()
}

/// One scene.
pub async fn get(line: &Connection, name: &str) -> anyhow::Result<v1::GetSceneResponse> {
    let request = v1::GetSceneRequest { scene: name.to_owned() };
    Ok(line.scenes().get(request).await?.into_inner())
}

/// What is sent of a view: its photograph and, where it has one, its mask.
struct Files {
    photograph: Photograph,
    mask: Option<Vec<u8>>,
}

/// A photograph's file, or its resampled copy.
enum Photograph {
    File(PathBuf),
    Copy(Vec<u8>),
}

/// Reads a capture and streams it to the services.
pub async fn import(line: &Connection, args: &ImportArgs) -> anyhow::Result<v1::ImportSceneResponse> {
    let kind = args.kind.map(|k| match k {
        Kind::ForwardFacing => SceneKind::ForwardFacing,
        Kind::Bounded => SceneKind::Bounded,
        Kind::Unbounded => SceneKind::Unbounded,
    });
    let contributors = args.contributors.as_deref().map(|table| found(table, Capture::folder_of(&args.from)));
    let contributors = contributors.transpose()?;
    let (hold_out, skip_missing) = (args.hold_out, args.skip_missing);
    let (images, masks) = (args.images.clone(), args.masks.clone());
    let options = ReadOptions { contributors, kind, hold_out, images, masks, skip_missing, ..ReadOptions::default() };
    let capture = Capture::read(&args.from, &options)?;
    capture.notes().iter().for_each(|note| eprintln!("{note}"));
    let (views, photographs) = prepare(&capture, args)?;
    let header = v1::ImportHeader {
        scene: args.name.clone(),
        views,
        kind: to_proto::scene_kind(capture.kind).into(),
        background: capture.background.map(Vec::from).unwrap_or_default(),
        listed: to_proto::unused_photographs(&capture.left_out.listed),
    };
    let first = v1::ImportSceneRequest { part: Some(Part::Header(header)) };
    let point_chunk = |points: &[glam::DVec3]| {
        let chunk = v1::PointChunk { xyz: points.iter().flat_map(|p| p.to_array()).collect() };
        v1::ImportSceneRequest { part: Some(Part::Points(chunk)) }
    };
    let points: Vec<_> = capture.points.chunks(POINTS_A_CHUNK).map(point_chunk).collect();
    let trouble = Arc::new(Mutex::new(None));
    let chunks = chunks(photographs, trouble.clone());
    let messages = tokio_stream::iter(std::iter::once(first).chain(points).chain(chunks));
    let answer = line.about(&args.name).scenes().import(messages).await;
    // A file that could not be read ended the stream early; that is the error to tell.
    if let Some(error) = trouble.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(error);
    }
    Ok(answer?.into_inner())
}

/// The table of contributors: `table` as it is named, or in the folder of the capture.
///
/// # Errors
/// Where it is in neither, with the tables that there are, or what a table is.
fn found(table: &Path, capture: &Path) -> anyhow::Result<PathBuf> {
    let beside = capture.join(table);
    if let Some(path) = [table, &beside].into_iter().find(|path| path.exists()) {
        return Ok(path.to_path_buf());
    }
    let is_table = |path: &PathBuf| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"));
    let entries = std::fs::read_dir(capture).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut tables: Vec<String> = entries.filter(is_table).map(|path| path.display().to_string()).collect();
    tables.sort();
    let (table, capture) = (table.display(), capture.display());
    let remedy = match tables[..] {
        [] => "write one line `image,contributor` and then one a photograph, or leave --contributors away".to_owned(),
        _ => format!("there is {}", tables.join(", ")),
    };
    anyhow::bail!("there is no table {table}, neither here nor in {capture}; {remedy}")
}

fn prepare(capture: &Capture, args: &ImportArgs) -> anyhow::Result<(Vec<v1::ImportView>, Vec<Files>)> {
    let (mut views, mut files) = (Vec::new(), Vec::new());
    for (index, view) in capture.views.iter().enumerate() {
        let mut camera = view.camera;
        let path = capture.root.join(&view.photograph);
        let (photograph, bytes, sha256) = match new_size(args, &camera)? {
            None => {
                let hashed = File::open(&path).and_then(|mut file| Digest::of_all(&mut file));
                let (sha256, bytes) = hashed.with_context(|| format!("cannot read {}", path.display()))?;
                (Photograph::File(path), bytes, sha256)
            }
            Some((width, height)) => {
                camera = camera.resized(width, height);
                let copy = encode_png(&capture.photograph(index)?.resized(width, height));
                let (bytes, sha256) = (copy.len() as u64, Digest::of(&copy));
                (Photograph::Copy(copy), bytes, sha256)
            }
        };
        let size = (camera.intrinsics.width, camera.intrinsics.height);
        let mask = capture.mask(index)?.map(|mask| mask.resized(size.0, size.1).to_png());
        let (near, far) = view.bounds.unwrap_or((0.0, 0.0));
        views.push(v1::ImportView {
            name: view.name.clone(),
            camera: Some(to_proto::camera(&camera)),
            contributor: view.contributor.clone(),
            contributor_key: view.contributor_key.map(|key| key.to_vec()).unwrap_or_default().into(),
            photograph_bytes: bytes,
            photograph_sha256: sha256.as_bytes().to_vec().into(),
            near,
            far,
            held_out: view.held_out,
            // A resampled copy is upright already, and has no EXIF.
            as_stored: view.as_stored && matches!(photograph, Photograph::File(_)),
            mask_bytes: mask.as_ref().map_or(0, |png| png.len() as u64),
            mask_sha256: mask.as_ref().map(|png| Digest::of(png).as_bytes().to_vec().into()).unwrap_or_default(),
            support: view
                .support
                .map(|s| v1::Support { points: s.points, reprojection_error_px: s.reprojection_error_px }),
        });
        files.push(Files { photograph, mask });
    }
    Ok((views, files))
}

fn new_size(args: &ImportArgs, camera: &cairn_scene::Camera) -> anyhow::Result<Option<(usize, usize)>> {
    if let (Some(width), Some(height)) = (args.width, args.height) {
        anyhow::ensure!(width > 0 && height > 0, "--width {width} --height {height}: both must be 1 or more");
        return Ok(Some((width, height)));
    }
    let Some(scale) = args.scale else { return Ok(None) };
    anyhow::ensure!(scale > 0.0 && scale <= 1.0, "--scale {scale}: allowed is above 0, to 1");
    let side = |px: usize| ((px as f64 * scale).round() as usize).max(1);
    Ok(Some((side(camera.intrinsics.width), side(camera.intrinsics.height))))
}

/// The photographs' and masks' bytes, read as they are sent. Ends early where a file cannot
/// be read, and says so in `trouble`.
fn chunks(
    files: Vec<Files>,
    trouble: Arc<Mutex<Option<anyhow::Error>>>,
) -> impl Iterator<Item = v1::ImportSceneRequest> + Send + 'static {
    let mut open: Option<(u32, bool, Box<dyn Read + Send>)> = None;
    let each = files.into_iter().enumerate().flat_map(|(index, Files { photograph, mask })| {
        let mask = mask.map(|png| (index, true, Photograph::Copy(png)));
        std::iter::once((index, false, photograph)).chain(mask)
    });
    let mut rest = each.collect::<Vec<_>>().into_iter();
    std::iter::from_fn(move || {
        loop {
            if open.is_none() {
                let (index, is_mask, photograph) = rest.next()?;
                let reader: Box<dyn Read + Send> = match photograph {
                    Photograph::Copy(bytes) => Box::new(std::io::Cursor::new(bytes)),
                    Photograph::File(path) => match File::open(&path) {
                        Ok(file) => Box::new(file),
                        Err(e) => {
                            let error = anyhow::Error::from(e).context(format!("cannot read {}", path.display()));
                            *trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                            return None;
                        }
                    },
                };
                open = Some((index as u32, is_mask, reader));
            }
            let (view_index, is_mask, reader) = open.as_mut()?;
            let mut data = Vec::with_capacity(CHUNK_BYTES);
            match reader.take(CHUNK_BYTES as u64).read_to_end(&mut data) {
                Ok(0) => open = None,
                Ok(_) => {
                    let chunk = v1::PhotographChunk { view_index: *view_index, data: data.into(), is_mask: *is_mask };
                    return Some(v1::ImportSceneRequest { part: Some(Part::Chunk(chunk)) });
                }
                Err(e) => {
                    *trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(e.into());
                    return None;
                }
            }
        }
    })
}
