//! `cairn demo`: the whole way once, on a made-up landmark and without anybody's
//! photographs. Everything goes through the same services as any other client's
//! calls; what it prints is measured then and there.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use cairn_api::v1;
use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_verify::Outcome;
use serde::Serialize;

use super::connect::{Connection, Where};
use super::files::write;
use super::json::{self, Json};
use super::{audit, evaluate, scene, sign, train};
use cairn_service::config::Config;
use cairn_service::engine::Opening;
use cairn_service::query::report::{Report, Right};
use cairn_service::store::folder::must_be_free;

/// The demo's scene.
const SCENE: &str = "demo";
/// One of its views.
const VIEW: &str = "ada_001.png";
/// The file that says whose a folder is.
const MARKER: &str = "made-by-cairn-demo.txt";
/// What a demo leaves in its folder.
const LEFT: [&str; 5] = ["capture", "data", "owners", "contact-sheet.png", "who.png"];

/// `cairn demo`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub json: Json,
    /// Where everything goes: capture, data, bundles, contact sheet, map of contributors. What an earlier demo left there is replaced
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    pub out: PathBuf,
    /// Every random number of landmark and training comes from it
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Photographers, each with a light and an emblem of their own
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub contributors: usize,
    /// Photographs each of them takes
    #[arg(long, value_name = "N", default_value_t = 14)]
    pub photographs: usize,
    /// How long to train: `smoke` only tries the installation
    #[arg(long, value_enum, default_value = "draft")]
    pub quality: train::Quality,
    /// Stop after the base field: no marks
    #[arg(long)]
    pub base_only: bool,
}

/// What the demo found.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// 1.
    pub format_version: u32,
    /// The seed.
    pub seed: u64,
    /// Scores on the views that no training saw.
    pub evaluation: Report,
    /// Whose photographs show one view, and the share of each, 0 to 1; largest first.
    pub shares: Vec<(String, f64)>,
    /// Owner records that came out trusted, of those that were signed.
    pub records_trusted: Right,
    /// Who-contributed answers by pose that named the identity's record.
    pub records_found: Right,
    /// Seconds, step by step, and at the end [`WHOLE`].
    pub seconds: Vec<(String, f64)>,
}

/// What the seconds from start to end are called.
pub const WHOLE: &str = "whole demo";

/// Answers `cairn demo`.
pub async fn run(place: &Where, config: &Config, args: Args) -> anyhow::Result<()> {
    let results = measure(place, config, &args).await?;
    if args.json.json {
        return json::print_value(&serde_json::to_value(&results)?);
    }
    print!("{}", results.evaluation);
    println!("  whose photographs show {VIEW}: {}", in_words(&results.shares));
    println!("  owner records trusted      {}", results.records_trusted);
    println!("  records found by pose      {}", results.records_found);
    for (step, seconds) in &results.seconds {
        println!("  {step:26} {seconds:6.1} s");
    }
    println!("{}", what_next(&args));
    Ok(())
}

fn in_words(shares: &[(String, f64)]) -> String {
    shares.iter().map(|(name, share)| format!("{name} {:.1} %", 100.0 * share)).collect::<Vec<_>>().join(", ")
}

/// What was shown, and what a person may try with it.
fn what_next(args: &Args) -> String {
    let (out, data) = (args.out.display(), args.out.join("data"));
    let data = data.display();
    let mut text = format!(
        "\nWhat this was: {} people photographed a made-up lighthouse, each in a light of their own. A radiance field learnt \
         it from {} photographs.\n",
        args.contributors,
        args.contributors * args.photographs
    );
    if args.base_only {
        text.push_str("It has no marks, since --base-only stopped before them.\n");
    } else {
        text.push_str(
            "Every render now carries a faint mark of the person whose part of the scene it shows, and an owner record of each \
             stands in a log. The owners' keys are plain files here, for trying things out.\n",
        );
    }
    text.push_str(&format!(
        "Look at {out}/who.png: whose photographs show {VIEW}, pixel by pixel.\n\
         Look at {out}/contact-sheet.png: photograph, render, difference times 20, and whose mark is read.\n\nTry next:\n  \
         cairn scene show {SCENE} --poses {out}/cameras.png --data {data}\n  \
         cairn render {SCENE} --path orbit --frames 60 --out {out}/orbit.gif --data {data}\n"
    ));
    if !args.base_only {
        text.push_str(&format!(
            "  cairn render {SCENE} --view {VIEW} --out {out}/render.png --data {data}\n  \
             cairn identify {SCENE} {out}/render.png --data {data}\n  \
             cairn who {SCENE} --view {VIEW} --data {data}\n  \
             cairn audit store {data}\n"
        ));
    }
    text.push_str("Then your own photographs: the README, or `cairn scene import --help`.");
    text
}

/// Runs the demo in its folder.
async fn measure(place: &Where, config: &Config, args: &Args) -> anyhow::Result<Results> {
    let begun = Instant::now();
    let mut clock = Clock { laps: Vec::new(), since: begun };
    let landmark =
        LandmarkConfig { contributors: args.contributors, photographs: args.photographs, ..LandmarkConfig::default() };
    // What it refuses leaves an earlier demo as it is.
    let photographs = Landmark::generate(&landmark, args.seed)?;
    begin(&args.out)?;
    let capture = args.out.join("capture");
    photographs.write(&capture)?;
    clock.lap("photographing");

    let data = args.out.join("data");
    let line =
        Connection::open(&Where { connect: None, data: data.clone(), ..place.clone() }, config, Opening::Begin).await?;
    let results = through(&line, args, &capture, &data, &mut clock).await;
    line.close().await;
    let mut results = results?;
    // Not the sum of the steps: what lies between them counts, too.
    results.seconds.push((WHOLE.to_owned(), begun.elapsed().as_secs_f64()));
    Ok(results)
}

/// Makes the folder `out`, or empties it of what an earlier demo left there. Nothing else is ever deleted.
fn begin(out: &Path) -> anyhow::Result<()> {
    let failed = |what: &str| format!("cannot {what} the folder {}", out.display());
    let marker = out.join(MARKER);
    if out.exists() && !marker.exists() {
        let mut entries = std::fs::read_dir(out).with_context(|| failed("read"))?;
        let name = out.display();
        anyhow::ensure!(
            entries.next().is_none(),
            "{name} holds something else than a demo's files, which stay; name another folder with --out"
        );
    }
    must_be_free(&out.join("data"))?;
    for (folder, made) in [("data/scenes", SCENE), ("owners", "")] {
        let Ok(entries) = std::fs::read_dir(out.join(folder)) else { continue };
        for entry in entries {
            let name = entry?.file_name().to_string_lossy().into_owned();
            // A demo's owners are numbered.
            let is_ours = name == made || (made.is_empty() && name.starts_with(|c: char| c.is_ascii_digit()));
            let (out, folder) = (out.display(), out.join(folder));
            let folder = folder.display();
            anyhow::ensure!(
                is_ours,
                "{folder} holds {name}, which no demo made; name another folder than {out} with --out"
            );
        }
    }
    std::fs::create_dir_all(out).with_context(|| failed("make"))?;
    for entry in std::fs::read_dir(out).with_context(|| failed("read"))? {
        let path = entry?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        // The log's anchor lies beside its data folder, and belongs to that log.
        if LEFT.contains(&name.as_str()) || (name.starts_with("data.") && name.ends_with(".anchor")) {
            cairn_durable::remove(&path)?;
        }
    }
    write(&marker, b"Made by `cairn demo`, which replaces its files here when it runs again.\n")
}

struct Clock {
    laps: Vec<(String, f64)>,
    since: Instant,
}

impl Clock {
    /// Ends a lap; the next one begins.
    fn lap(&mut self, name: &str) {
        self.laps.push((name.to_owned(), self.since.elapsed().as_secs_f64()));
        self.since = Instant::now();
    }
}

async fn through(
    line: &Connection,
    args: &Args,
    capture: &Path,
    data: &Path,
    clock: &mut Clock,
) -> anyhow::Result<Results> {
    clock.since = Instant::now();
    import(line, capture).await?;
    clock.lap("importing");
    let job = training(line, args).await?;
    clock.laps.extend(job.stages.iter().map(|s| (s.stage.clone(), s.seconds)));
    clock.since = Instant::now();
    let signed = sign::sign_all(line, SCENE, &args.out.join("owners")).await?;
    let records_trusted = trusted(&signed, data)?;
    clock.lap("signing and verifying");
    let records_found = found(line, &signed).await?;
    let evaluation = evaluate::report(line, SCENE, Some(&args.out.join("contact-sheet.png"))).await?;
    clock.lap("scoring");
    let shares = shares(line, &args.out.join("who.png")).await?;
    clock.lap("asking who");
    let seconds = std::mem::take(&mut clock.laps);
    Ok(Results { format_version: 1, seed: args.seed, evaluation, shares, records_trusted, records_found, seconds })
}

async fn import(line: &Connection, capture: &Path) -> anyhow::Result<()> {
    let table = capture.join("contributors.csv");
    let mut words = [SCENE, "--hold-out", "8", "--from"].map(OsStr::new).to_vec();
    words.extend([capture.as_os_str(), OsStr::new("--contributors"), table.as_os_str()]);
    scene::import(line, &typed(&words)?).await.map(drop)
}

async fn training(line: &Connection, args: &Args) -> anyhow::Result<v1::Job> {
    let seed = args.seed.to_string();
    let mut words: Vec<&OsStr> = [SCENE, "--by-contributor", "--seed", &seed].map(OsStr::new).to_vec();
    words.extend(args.base_only.then_some(OsStr::new("--base-only")));
    let mut train: train::Args = typed(&words)?;
    train.options.quality = Some(args.quality);
    train::run_to_end(line, &train).await
}

/// The arguments of another command, as a person would type them.
fn typed<T: clap::Args>(words: &[&OsStr]) -> anyhow::Result<T> {
    let command = T::augment_args(clap::Command::new("demo").no_binary_name(true));
    Ok(T::from_arg_matches(&command.try_get_matches_from(words)?)?)
}

/// Verifies each record from its bundle's files.
fn trusted(signed: &[sign::Signed], data: &Path) -> anyhow::Result<Right> {
    let mut trusted = Right::default();
    for sign::Signed { bundle, .. } in signed {
        let trust = audit::trust::Trust { vkey: Some(bundle.join("log.vkey")), policy: None };
        let verify = audit::bundle::Args {
            bundle: bundle.clone(),
            trust,
            against: Some(data.into()),
            ..audit::bundle::Args::default()
        };
        trusted.count(audit::bundle::report(&verify)?.outcome == Outcome::Trusted);
    }
    Ok(trusted)
}

/// Whose photographs show [`VIEW`]; the map of it goes to `map`.
async fn shares(line: &Connection, map: &Path) -> anyhow::Result<Vec<(String, f64)>> {
    let from = Some(v1::viewpoint::From::ViewName(VIEW.into()));
    let viewpoint = Some(v1::Viewpoint { from });
    let request = v1::ContributorsRequest { scene: SCENE.into(), viewpoint, region: None, map: true };
    let answer = line.about(SCENE).query().contributors(request).await?.into_inner();
    write(map, &answer.map_png)?;
    Ok(answer.contributors.into_iter().map(|of| (of.name, of.share)).collect())
}

/// Asks for every training view of a cluster whether the answer leads to the identity's record and no other.
async fn found(line: &Connection, signed: &[sign::Signed]) -> anyhow::Result<Right> {
    let model = scene::get(line, SCENE).await?.model.context("the training left no model")?;
    let mut found = Right::default();
    for identity in &model.identities {
        let records: Vec<u64> = signed.iter().filter(|s| s.identity == identity.number).map(|s| s.index).collect();
        for name in &identity.view_names {
            let from = Some(v1::viewpoint::From::ViewName(name.clone()));
            let viewpoint = Some(v1::Viewpoint { from });
            let request = v1::ContributorsRequest { scene: SCENE.into(), viewpoint, ..Default::default() };
            let answer = line.query().contributors(request).await?.into_inner().answer;
            let right = matches!(answer, Some(v1::contributors_response::Answer::Identity(who))
                if who.number == identity.number && !records.is_empty() && who.record_indices == records);
            found.count(right);
        }
    }
    Ok(found)
}
