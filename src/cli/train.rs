//! `cairn train`: start or take up a training and watch it.

use std::path::PathBuf;

use anyhow::Context as _;
use cairn_api::v1::{self, JobState, start_training_request::Clusters};
use clap::builder::ArgPredicate;

use super::connect::Connection;
use super::exit::Cancelled;
use super::json;
use super::progress::Progress;
use super::scene;
use super::signals::{fit_one_message, signals};
use super::words::{job_id, word};

/// `cairn train`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The scene
    #[arg(value_name = "SCENE")]
    pub name: String,
    /// M, the number of clusters around anchors
    #[arg(long, value_name = "M", default_value_t = 3, conflicts_with = "by_contributor")]
    pub anchors: u32,
    /// K, the views of a cluster; not given: as many as there are, 20 at most (with --grow as many as before)
    #[arg(long, value_name = "K", conflicts_with = "by_contributor")]
    pub neighbours: Option<u32>,
    /// One cluster for each contributor instead
    #[arg(long)]
    pub by_contributor: bool,
    /// Views that a contributor needs to be an identity, with --by-contributor
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub min_views: u32,
    /// The same seed gives the same bytes [default: 1, with --grow the earlier training's]
    #[arg(
        long,
        default_value = "1",
        default_value_if("grow", ArgPredicate::IsPresent, "0"),
        hide_default_value = true
    )]
    pub seed: u64,
    /// What to hide, one for each identity: PNG, JPEG, WebP, WAV and TXT files; those of one name but for the ending are one
    /// identity's. Where all are named as identities are labelled each is its identity's, else identity 1's is first, 2 before
    /// 10 (pictures are drawn where not given)
    #[arg(long, value_name = "DIR", conflicts_with = "base_only")]
    pub signals: Option<PathBuf>,
    #[command(flatten)]
    pub options: Options,
    /// Stop after the base field: no marks, and no clusters needed
    #[arg(long)]
    pub base_only: bool,
    /// Mark this scene together with it, with one detector for both; again for each other scene
    #[arg(long = "with", value_name = "SCENE", conflicts_with = "base_only")]
    pub with: Vec<String>,
    /// Go on from the newest model: fields and marks stay as they are, and identities that it has not are added
    /// (ask for more anchors, or contributors of fewer views); all that it has must be among them, and --signals are those of the
    /// added ones
    #[arg(long, conflicts_with_all = ["base_only", "Options"])]
    pub grow: bool,
    /// Go on with a training of this scene that was cancelled or cut off, or failed
    #[arg(long, value_name = "JOB", value_parser = job_id)]
    pub resume: Option<String>,
    /// Do not wait for the end; a daemon has to be running, with --connect or on --data
    #[arg(long, conflicts_with = "keys")]
    pub detach: bool,
    /// Then make a key for every identity in this new folder, and sign a record with each (for trying things out)
    #[arg(long, value_name = "DIR")]
    pub keys: Option<PathBuf>,
}

/// How to train. What is not given is as the daemon's file has it (`[training]`).
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Options {
    /// The kind of scene to train for; `auto` takes the scene's own
    #[arg(long, value_enum)]
    pub preset: Option<Preset>,
    /// Seconds (smoke, good for trying an installation only), minutes (draft), balanced, or twice the work (archival)
    #[arg(long, value_enum)]
    pub quality: Option<Quality>,
    /// Make marks outlast JPEG, blur, noise, other light, rotation and smaller copies, at a price in the picture
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub robust: Option<bool>,
    /// The most vertices of the field's grid, where memory is short; 0 for the preset's
    #[arg(long, value_name = "N")]
    pub max_voxels: Option<u64>,
    /// Whether every view gets an appearance of its own; `auto` where the photographs turn out to differ in light
    #[arg(long, value_enum)]
    pub appearance: Option<Appearance>,
    /// Side of hidden pictures, px; 0 for the preset's
    #[arg(long, value_name = "PX")]
    pub payload_picture_px: Option<u32>,
    /// Longest hidden sound, seconds; 0 for the preset's
    #[arg(long, value_name = "S")]
    pub payload_sound_s: Option<f64>,
    /// Samples a second of hidden sounds; 0 for the preset's
    #[arg(long, value_name = "HZ")]
    pub payload_sound_hz: Option<u32>,
    /// Longest hidden text, bytes of UTF-8; 0 for the preset's
    #[arg(long, value_name = "BYTES")]
    pub payload_text_bytes: Option<u32>,
}

/// A kind of scene.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Preset {
    /// The scene's own kind
    Auto = v1::Preset::Auto as isize,
    /// All cameras look the same way from about the same place
    Forward = v1::Preset::Forward as isize,
    /// An object within a box, nothing behind it
    Object = v1::Preset::Object as isize,
    /// A landmark in the open
    Outdoor = v1::Preset::Outdoor as isize,
}

/// How long a training takes, and how good it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Quality {
    /// Seconds: for integration tests and trying an installation, good for nothing else
    Smoke = v1::Quality::Smoke as isize,
    /// Minutes: for trying things out
    Draft = v1::Quality::Draft as isize,
    /// What the measurements are of
    Balanced = v1::Quality::Balanced as isize,
    /// Twice the work; not measured yet
    Archival = v1::Quality::Archival as isize,
}

/// Whether views get appearances of their own.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Appearance {
    /// Where the photographs turn out to differ in light
    Auto = v1::AppearanceMode::Auto as isize,
    /// Always
    On = v1::AppearanceMode::On as isize,
    /// Never
    Off = v1::AppearanceMode::Off as isize,
}

impl Options {
    /// As the request has them.
    fn to_proto(&self) -> v1::TrainingOptions {
        v1::TrainingOptions {
            preset: self.preset.map_or(0, |preset| preset as i32),
            quality: self.quality.map_or(0, |quality| quality as i32),
            robust: self.robust,
            max_voxels: self.max_voxels,
            appearance: self.appearance.map_or(0, |appearance| appearance as i32),
            payload_picture_px: self.payload_picture_px,
            payload_sound_s: self.payload_sound_s,
            payload_sound_hz: self.payload_sound_hz,
            payload_text_bytes: self.payload_text_bytes,
        }
    }
}

/// Answers `cairn train`.
pub async fn run(line: &Connection, args: Args) -> anyhow::Result<()> {
    anyhow::ensure!(
        !args.detach || line.is_a_daemons(),
        "--detach leaves the training to a daemon, and none is running; start one with `cairn serve`, or leave --detach away"
    );
    if let Some(folder) = &args.keys {
        anyhow::ensure!(!folder.exists(), "{} is there already; --keys names a new folder", folder.display());
    }
    let job = match &args.resume {
        Some(id) => {
            let job = newest(line, id).await?;
            let is_of = job.scene == args.name || job.also.contains(&args.name);
            let of = &job.scene;
            anyhow::ensure!(is_of, "{id} is a training of {of}; `cairn train {of} --resume {id}` goes on with it");
            let request = v1::ResumeTrainingRequest { job_id: id.clone() };
            let job = line.about(&args.name).training().resume(request).await?.into_inner().job;
            job.context("the daemon's answer names no job")?
        }
        None => start(line, &args).await?,
    };
    println!("{} accepted for {}", job.id, scenes_as_they_lie(line, &job).await);
    // Who hides what, above all: it is in records for good, and the time to look is now.
    let told = job.notes.clone();
    told.iter().for_each(|note| println!("  {note}"));
    say_what_is_ahead(line, &job).await;
    if args.detach {
        return Ok(());
    }
    let watched = watch(line, &job.id, OnInterrupt::Cancel, &mut Shown::bar()).await?;
    ended(&watched)?;
    report(&watched.job, &told);
    let scene = scene::get(line, &args.name).await.ok().and_then(|answer| answer.summary);
    if !args.base_only && scene.is_some_and(|summary| summary.held_out_views > 0) {
        println!("see how good it is: `cairn evaluate {} --sheet contact-sheet.png`", args.name);
    }
    if let Some(folder) = args.keys {
        let signed = super::sign::sign_all(line, &args.name, &folder).await?;
        println!("{} owner records signed; keys and bundles are in {}", signed.len(), folder.display());
        println!("those keys are plain files for trying things out; an owner's own is sealed (`cairn keys new`)");
    }
    Ok(())
}

/// Starts a training and watches it to its good end.
pub async fn run_to_end(line: &Connection, args: &Args) -> anyhow::Result<v1::Job> {
    let watched = watch(line, &start(line, args).await?.id, OnInterrupt::Cancel, &mut Shown::bar()).await?;
    ended(&watched)?;
    Ok(watched.job)
}

/// Has a training accepted.
async fn start(line: &Connection, args: &Args) -> anyhow::Result<v1::Job> {
    let request = request(args)?;
    fit_one_message(&request.signals, line.max_message_bytes)?;
    let answer = line.about(&args.name).training().start(request).await?.into_inner();
    answer.job.context("the daemon's answer names no job")
}

/// The request that the arguments stand for.
pub fn request(args: &Args) -> anyhow::Result<v1::StartTrainingRequest> {
    let clusters = if args.by_contributor {
        Clusters::ByContributor(v1::ByContributor { min_views: args.min_views })
    } else {
        Clusters::ByAnchors(v1::ByAnchors { anchors: args.anchors, neighbours: args.neighbours.unwrap_or(0) })
    };
    let signals = match &args.signals {
        Some(folder) => signals(folder)?,
        None => Vec::new(),
    };
    Ok(v1::StartTrainingRequest {
        scene: args.name.clone(),
        clusters: Some(clusters),
        seed: args.seed,
        options: Some(args.options.to_proto()),
        signals,
        base_only: args.base_only,
        also: args.with.clone(),
        grow: args.grow,
    })
}

/// Names the jobs that were there before `job` was: one is worked on at a time, and those that an
/// earlier run left unfinished go on first. Where they cannot be asked for there is nothing to say.
async fn say_what_is_ahead(line: &Connection, job: &v1::Job) {
    let request = v1::ListTrainingRequest { scene: String::new() };
    let Ok(answer) = line.training().list(request).await else { return };
    let is_ahead =
        |other: &v1::Job| other.id != job.id && matches!(other.state(), JobState::Accepted | JobState::Running);
    let jobs = answer.into_inner().jobs;
    let ahead: Vec<String> = jobs.iter().filter(|j| is_ahead(j)).map(|j| format!("{} ({})", j.id, scenes(j))).collect();
    if !ahead.is_empty() {
        eprintln!("{} waits for {} to end", job.id, ahead.join(", "));
    }
}

/// The names of a job's scenes.
pub fn scenes(job: &v1::Job) -> String {
    std::iter::once(job.scene.as_str()).chain(job.also.iter().map(String::as_str)).collect::<Vec<_>>().join(", ")
}

/// The same with how each lies, by which its settings were chosen; without where the scene cannot be asked for.
async fn scenes_as_they_lie(line: &Connection, job: &v1::Job) -> String {
    let mut told = Vec::new();
    for name in std::iter::once(&job.scene).chain(&job.also) {
        let summary = scene::get(line, name).await.ok().and_then(|answer| answer.summary);
        told.push(summary.map_or_else(|| name.clone(), |s| format!("{name} ({})", scene::lies(&s, false))));
    }
    told.join(", ")
}

/// A training as it is now.
pub async fn newest(line: &Connection, id: &str) -> anyhow::Result<v1::Job> {
    let request = v1::WatchTrainingRequest { job_id: id.to_owned() };
    let first = line.training().watch(request).await?.into_inner().message().await?;
    first.and_then(|message| message.job).context("the daemon said nothing of the job")
}

/// What Ctrl-C does to a training that is watched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnInterrupt {
    /// It cancels the training.
    Cancel,
    /// It stops the watching.
    Leave,
}

/// A training that was watched to its end.
pub struct Watched {
    /// It, as it ended.
    pub job: v1::Job,
    /// Whether the person at this command had it cancelled.
    pub is_interrupted: bool,
}

/// How the states of a watched training are shown.
pub enum Shown {
    /// With a bar, on standard error.
    Bar(Progress),
    /// As JSON, one a line, on standard output.
    Json,
}

impl Shown {
    /// With a bar.
    pub fn bar() -> Self {
        Self::Bar(Progress::new(true))
    }

    fn job(&mut self, job: &v1::Job) -> anyhow::Result<()> {
        match self {
            Self::Bar(bar) => draw(bar, job),
            Self::Json => json::print_line(job)?,
        }
        Ok(())
    }

    fn end(&self) {
        if let Self::Bar(bar) = self {
            bar.end();
        }
    }
}

/// Watches a job to its end.
pub async fn watch(
    line: &Connection,
    id: &str,
    on_interrupt: OnInterrupt,
    shown: &mut Shown,
) -> anyhow::Result<Watched> {
    let request = v1::WatchTrainingRequest { job_id: id.to_owned() };
    let mut stream = line.training().watch(request).await?.into_inner();
    let mut last: Option<v1::Job> = None;
    let mut is_interrupted = false;
    loop {
        tokio::select! {
            message = stream.message() => match message.with_context(|| cut_off(id, last.as_ref()))? {
                Some(message) => {
                    if let Some(job) = message.job {
                        shown.job(&job)?;
                        last = Some(job);
                    }
                }
                None => break,
            },
            interrupt = tokio::signal::ctrl_c() => {
                interrupt?;
                if on_interrupt == OnInterrupt::Leave {
                    shown.end();
                    return Err(Cancelled(format!("{id} goes on; `cairn jobs watch {id}` watches it again")).into());
                }
                is_interrupted = true;
                if let Shown::Bar(bar) = &*shown {
                    bar.say("cancelling after this step");
                }
                let request = v1::CancelTrainingRequest { job_id: id.to_owned() };
                let scene = last.as_ref().map_or("", |job| job.scene.as_str());
                line.about(scene).training().cancel(request).await?;
            }
        }
    }
    shown.end();
    let job = last.context("the daemon closed the line before it said anything of the job")?;
    Ok(Watched { job, is_interrupted })
}

/// What to do where the process that trains is gone.
fn cut_off(id: &str, last: Option<&v1::Job>) -> String {
    let scene = last.map_or("SCENE", |job| job.scene.as_str());
    format!("{id} is not watched any more; where it was cut off, `cairn train {scene} --resume {id}` goes on with it")
}

fn draw(shown: &mut Progress, job: &v1::Job) {
    let Some(p) = &job.progress else { return };
    // What is prepared before a stage has neither.
    let quality = match (p.psnr_db > 0.0, p.loss != 0.0) {
        (true, _) => format!("{:.1} dB, ", p.psnr_db),
        (false, true) => format!("loss {:.4}, ", p.loss),
        (false, false) => String::new(),
    };
    shown.draw(&p.stage, p.step, p.total, &quality, p.seconds_left);
}

/// Whether a training ended well.
///
/// # Errors
/// How it ended otherwise; [`Cancelled`] where the person at this command cancelled it, and nobody else.
pub fn ended(watched: &Watched) -> anyhow::Result<()> {
    let job = &watched.job;
    let resume = format!("go on with `cairn train {} --resume {}`", job.scene, job.id);
    match job.state() {
        JobState::Done => Ok(()),
        JobState::Cancelled if watched.is_interrupted => {
            Err(Cancelled(format!("{} cancelled; its checkpoint is kept: {resume}", job.id)).into())
        }
        JobState::Cancelled => {
            anyhow::bail!("{} was cancelled by another command; its checkpoint is kept: {resume}", job.id)
        }
        JobState::Interrupted => {
            anyhow::bail!("{} was cut off with its process; its checkpoint is kept: {resume}", job.id)
        }
        JobState::Failed => anyhow::bail!(
            "{} failed: {}; where settings or photographs are at fault, train anew with others; where the machine was, {resume}",
            job.id,
            job.error
        ),
        state => anyhow::bail!("the daemon closed the line while {} was {}", job.id, state_name(state)),
    }
}

/// Says what a job that is done took, with its notes but those that were `told` when it began.
pub fn report(job: &v1::Job, told: &[String]) {
    let stages: Vec<String> = job.stages.iter().map(|s| format!("{} {:.0} s", s.stage, s.seconds)).collect();
    println!("{} done ({})", job.id, stages.join(", "));
    job.notes.iter().filter(|note| !told.contains(note)).for_each(|note| println!("  {note}"));
}

/// A state in a word.
pub fn state_name(state: JobState) -> String {
    word(state.as_str_name(), "JOB_STATE_")
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

    fn asked(line: &[&str]) -> Result<v1::StartTrainingRequest, String> {
        let line = Line::try_parse_from([&["train", "town"][..], line].concat()).map_err(|e| e.to_string())?;
        request(&line.args).map_err(|e| e.to_string())
    }

    #[test]
    fn a_scene_that_grows_has_the_seed_that_it_was_trained_with() {
        let seed = |line: &[&str]| asked(line).unwrap().seed;
        assert_eq!((seed(&[]), seed(&["--seed", "9"])), (1, 9));
        // 0 asks the daemon for it.
        assert_eq!((seed(&["--grow"]), seed(&["--grow", "--seed", "9"])), (0, 9));
    }

    #[test]
    fn a_scene_that_grows_takes_no_options() {
        let refused = asked(&["--grow", "--quality", "draft"]).unwrap_err();
        assert!(refused.contains("--grow") && refused.contains("--quality"), "{refused}");
        let options = asked(&["--quality", "draft", "--robust=false"]).unwrap().options.unwrap();
        assert_eq!((options.quality(), options.robust), (v1::Quality::Draft, Some(false)));
        assert_eq!(asked(&["--robust"]).unwrap().options.unwrap().robust, Some(true));
    }

    #[test]
    fn only_who_cancelled_a_training_is_told_so_by_the_exit_code() {
        let job = v1::Job { id: "job-000001".into(), state: JobState::Cancelled.into(), ..v1::Job::default() };
        let refused = |is_interrupted| ended(&Watched { job: job.clone(), is_interrupted }).unwrap_err();
        assert!(refused(true).is::<Cancelled>());
        let elsewhere = refused(false);
        assert!(!elsewhere.is::<Cancelled>() && elsewhere.to_string().contains("by another command"), "{elsewhere}");
    }

    #[test]
    fn nothing_is_hidden_where_nothing_is_marked() {
        let refused = asked(&["--base-only", "--signals", "folder"]).unwrap_err();
        assert!(refused.contains("--base-only") && refused.contains("--signals"), "{refused}");
    }
}
