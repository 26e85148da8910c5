//! `cairn jobs`: the trainings of a data folder, and what becomes of them.

use anyhow::Context as _;
use cairn_api::v1::{self, JobState};

use super::connect::Connection;
use super::json::{self, Json};
use super::progress::clock;
use super::train;
use super::words::{job_id, word};

/// `cairn jobs`.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    json: Json,
}

/// What to do with trainings.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// List all trainings, newest first (also without a word after `jobs`)
    #[command(after_help = "Example:\n  cairn jobs list --json")]
    List {
        #[command(flatten)]
        json: Json,
    },
    /// Show one training: how far it is, how long it still takes, what it found out
    #[command(after_help = "Example:\n  cairn jobs show job-000001")]
    Show {
        /// The training, as job-000001 or 1
        #[arg(value_parser = job_id)]
        job: String,
        #[command(flatten)]
        json: Json,
    },
    /// Watch one training to its end; Ctrl-C stops the watching and leaves the training alone
    #[command(after_help = "Example:\n  cairn jobs watch job-000001")]
    Watch {
        /// The training, as job-000001 or 1
        #[arg(value_parser = job_id)]
        job: String,
        /// Print each state of it as JSON, for programs, one a line
        #[arg(long)]
        json: bool,
    },
    /// Cancel one training; its checkpoint is kept for `cairn train SCENE --resume JOB`
    #[command(after_help = "Example:\n  cairn jobs cancel job-000001")]
    Cancel {
        /// The training, as job-000001 or 1
        #[arg(value_parser = job_id)]
        job: String,
    },
}

impl Args {
    /// The training that it is about.
    pub fn job(&self) -> Option<&str> {
        match self.command.as_ref()? {
            Command::List { .. } => None,
            Command::Show { job, .. } | Command::Watch { job, .. } | Command::Cancel { job } => Some(job),
        }
    }

    /// Whether it only reads.
    pub const fn reads(&self) -> bool {
        !matches!(self.command, Some(Command::Cancel { .. }))
    }
}

/// Answers `cairn jobs`.
pub async fn run(line: &Connection, args: Args) -> anyhow::Result<()> {
    match args.command {
        None => list(line, args.json).await,
        Some(Command::List { json }) => list(line, json).await,
        Some(Command::Show { job, json }) => show(line, &job, json).await,
        Some(Command::Watch { job, json }) => {
            let mut shown = if json { train::Shown::Json } else { train::Shown::bar() };
            let watched = train::watch(line, &job, train::OnInterrupt::Leave, &mut shown).await?;
            train::ended(&watched)?;
            if !json {
                train::report(&watched.job, &[]);
            }
            Ok(())
        }
        Some(Command::Cancel { job }) => {
            let known = train::newest(line, &job).await?;
            let request = v1::CancelTrainingRequest { job_id: job };
            let answer = line.about(&known.scene).training().cancel(request).await?.into_inner();
            let job = answer.job.context("the daemon's answer names no job")?;
            let resume = format!("cairn train {} --resume {}", job.scene, job.id);
            match job.state() {
                JobState::Cancelled => println!("{} is cancelled; `{resume}` goes on with it", job.id),
                state => println!("{} had ended before: {}", job.id, train::state_name(state)),
            }
            Ok(())
        }
    }
}

async fn list(line: &Connection, json: Json) -> anyhow::Result<()> {
    let request = v1::ListTrainingRequest { scene: String::new() };
    let answer = line.training().list(request).await?.into_inner();
    if json.json {
        return json::print(&answer);
    }
    if answer.jobs.is_empty() {
        eprintln!("no trainings yet; start one with `cairn train SCENE`");
    }
    for job in answer.jobs {
        let p = job.progress.clone().unwrap_or_default();
        let place = if p.total > 0 { format!(", {} {}/{}", p.stage, p.step, p.total) } else { String::new() };
        let error = if job.error.is_empty() { String::new() } else { format!(": {}", job.error) };
        println!("{}  {}  {}{place}{error}", job.id, train::scenes(&job), train::state_name(job.state()));
    }
    Ok(())
}

async fn show(line: &Connection, id: &str, json: Json) -> anyhow::Result<()> {
    let job = train::newest(line, id).await?;
    if json.json {
        return json::print(&job);
    }
    println!("{}  {}  {}", job.id, train::scenes(&job), word(job.state().as_str_name(), "JOB_STATE_"));
    if let Some(p) = job.progress.as_ref().filter(|p| p.total > 0) {
        let quality = if p.psnr_db > 0.0 { format!(", {:.1} dB", p.psnr_db) } else { String::new() };
        println!("  {} {}/{}{quality}", p.stage, p.step, p.total);
        if job.state() == JobState::Running && p.seconds_left >= 0.0 {
            println!("  about {} left", clock(p.seconds_left));
        }
    }
    println!("  seed {}", job.seed);
    for stage in &job.stages {
        println!("  {} took {:.0} s", stage.stage, stage.seconds);
    }
    for note in &job.notes {
        println!("  {note}");
    }
    if !job.error.is_empty() {
        println!("  {}", job.error);
    }
    if matches!(job.state(), JobState::Cancelled | JobState::Failed | JobState::Interrupted) {
        println!("  `cairn train {} --resume {}` goes on with it", job.scene, job.id);
    }
    Ok(())
}
