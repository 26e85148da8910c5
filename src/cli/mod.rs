//! The command line: what can be asked for, and which file answers it.

mod access;
mod animation;
mod answers;
mod audit;
mod bind;
mod check;
mod connect;
mod corrections;
mod credential;
mod demo;
mod evaluate;
pub mod exit;
mod files;
mod guesses;
mod identify;
mod jobs;
mod json;
mod keys;
mod light;
mod locate;
mod owners;
mod path;
mod poses;
mod progress;
mod records;
#[cfg(test)]
mod reference;
mod registry;
mod render;
mod scene;
mod shell;
mod sign;
mod signals;
mod train;
mod unlock;
mod viewpoint;
mod who;
mod witness;
mod words;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use anyhow::Context as _;
use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use cairn_service::config::{Config, LogFormat};
use cairn_service::engine::Opening;
use connect::{Connection, Where};

/// What every `--help` ends in.
const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    an audit says invalid; audits have more, from 10 on (see `cairn audit --help`)
  2    refused or failed; the message says why and what helps
  130  cancelled with Ctrl-C

Examples:
  cairn demo
  cairn scene import liberty --from liberty --contributors contributors.csv
  cairn train liberty --anchors 3 --neighbours 20
  cairn who liberty --view view_056.jpg --json";

/// Credits the photographers of a landmark: radiance fields with hidden, recoverable owner marks.
#[derive(Debug, Parser)]
#[command(name = "cairn", version, max_term_width = 100, after_long_help = EXIT_CODES)]
pub struct Cli {
    #[command(flatten)]
    place: Where,
    #[command(subcommand)]
    command: Command,
}

/// In the order in which a person needs them.
#[derive(Debug, Subcommand)]
enum Command {
    /// Everything once, on a made-up landmark: import, train, mark, sign, ask, verify
    #[command(after_help = "Example:\n  cairn demo --out demo-out")]
    Demo(demo::Args),
    /// Import, list, show, check and delete scenes
    #[command(subcommand)]
    Scene(scene::Command),
    /// Train a scene: base field, then marked field and detector
    #[command(after_help = "Examples:
  cairn train liberty --anchors 3 --neighbours 20
  cairn train liberty --by-contributor --quality draft --signals signals
  cairn train liberty --resume job-000001")]
    Train(Box<train::Args>),
    /// List, show, watch and cancel trainings
    #[command(after_help = "Examples:
  cairn jobs
  cairn jobs watch job-000001
  cairn jobs cancel job-000001")]
    Jobs(jobs::Args),
    /// Render a trained scene to a picture, or a camera path through it to a GIF or PNG frames
    #[command(after_help = "Examples:
  cairn render liberty --view view_056.jpg --out view_056.png
  cairn render liberty --path orbit --frames 60 --width 150 --out orbit.gif")]
    Render(Box<render::RenderArgs>),
    /// Ask who contributed what a view or a camera sees
    #[command(after_help = "Examples:
  cairn who liberty --view view_056.jpg
  cairn who liberty --view view_056.jpg --map who.png
  cairn who liberty --pose camera.json --json
  cairn who liberty --picture picture.jpg")]
    Who(who::WhoArgs),
    /// Find whose mark a picture carries, and recover what it hides
    #[command(after_help = "Examples:
  cairn identify liberty picture.png
  cairn identify liberty picture.png --register --payload-out recovered")]
    Identify(identify::IdentifyArgs),
    /// Find the camera that took a picture of the scene
    #[command(after_help = "Examples:
  cairn locate liberty picture.jpg
  cairn locate liberty picture.jpg --out blink.gif")]
    Locate(locate::LocateArgs),
    /// Score a trained scene on the views it never saw (imported with --hold-out)
    #[command(after_help = "Example:\n  cairn evaluate liberty-test --sheet contact-sheet.png")]
    Evaluate(evaluate::EvaluateArgs),
    /// Make, seal, show, rotate and revoke owners' keys (they stay on this machine)
    #[command(subcommand)]
    Keys(keys::Command),
    /// Sign, correct and list owner records
    #[command(subcommand)]
    Owners(owners::Command),
    /// Verify bundles, stores and logs, trusting nobody
    #[command(subcommand)]
    Audit(audit::Command),
    /// Run the daemon on --data with --config, until SIGINT or SIGTERM
    #[command(after_help = "Example:\n  cairn serve --config daemon.toml --data cairn-data")]
    Serve,
    /// Who may do what on a daemon: register, approve, roles, quotas
    #[command(subcommand)]
    Access(access::Command),
    /// Repair the log of a daemon that is not running
    #[command(subcommand)]
    Registry(registry::Command),
    /// Cosign the checkpoints of logs, as a witness
    #[command(subcommand)]
    Witness(witness::Command),
    /// Print completions for a shell
    #[command(after_help = "Example:\n  cairn completions bash")]
    Completions(shell::CompletionsArgs),
    /// Write manual pages, one for each command
    #[command(after_help = "Example:\n  cairn man --out man1")]
    Man(shell::ManArgs),
}

impl Command {
    /// What it opens the data folder for.
    fn opening(&self) -> Opening {
        match self {
            command if command.reads() => Opening::Read,
            Self::Scene(scene::Command::Import(_)) | Self::Owners(owners::Command::Vkey { .. }) => Opening::Begin,
            _ => Opening::Change,
        }
    }

    /// Whether it only reads.
    fn reads(&self) -> bool {
        match self {
            Self::Scene(command) => command.reads(),
            Self::Jobs(args) => args.reads(),
            Self::Owners(command) => command.reads(),
            Self::Access(command) => command.reads(),
            Self::Render(_) | Self::Who(_) | Self::Identify(_) | Self::Locate(_) | Self::Evaluate(_) => true,
            _ => false,
        }
    }

    /// The training that it is about.
    fn job(&self) -> Option<&str> {
        match self {
            Self::Train(args) => args.resume.as_deref(),
            Self::Jobs(args) => args.job(),
            _ => None,
        }
    }
}

impl Cli {
    /// The command line of this process. What does not parse ends it, with a message.
    ///
    /// # Errors
    /// For options that exclude each other.
    pub fn given() -> anyhow::Result<Self> {
        let program = Self::command();
        let given = program.clone().try_get_matches().unwrap_or_else(|error| {
            let typed: Vec<String> =
                std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
            guesses::with_tip(error, &program, &typed).exit()
        });
        let mut cli = Self::from_arg_matches(&given).unwrap_or_else(|error| error.exit());
        cli.place.settle(&given)?;
        Ok(cli)
    }

    /// Runs the command. The exit code is 1 where a verification says `invalid`, and `cairn audit` has more.
    ///
    /// # Errors
    /// What went wrong, for people to read; [`exit::Cancelled`].
    pub fn run(self) -> anyhow::Result<ExitCode> {
        // Whatever opens a data folder reads the registry's key.
        cairn_service::secrets::keep_out_of_dumps()
            .context("cannot forbid core dumps, which would hold secret keys")?;
        let config = Config::load(self.place.config.as_deref())?;
        start_log(&config, matches!(self.command, Command::Serve | Command::Witness(_)));
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
        runtime.block_on(self.answer(config))
    }

    async fn answer(self, config: Config) -> anyhow::Result<ExitCode> {
        let place = self.place;
        match self.command {
            Command::Serve => cairn_service::grpc::serve::serve(config, &place.data).await?,
            Command::Keys(command) if command.is_local() => keys::local(&command)?,
            Command::Witness(command) => witness::run(&command).await?,
            Command::Access(access::Command::Add(args)) => access::add(&place, &args)?,
            Command::Registry(command) => registry::run(&place, &config, &command)?,
            Command::Demo(args) => demo::run(&place, &config, args).await?,
            Command::Completions(args) => shell::completions(&args, Self::command()),
            Command::Man(args) => shell::man(&args, Self::command())?,
            Command::Audit(command) => return audit::run(&command),
            command => {
                let opening = command.opening();
                let line = Connection::open(&place, &config, opening).await?;
                line.say_what_was_interrupted(command.job());
                let answer = over(&line, command).await;
                line.close().await;
                answer?;
            }
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// The commands that talk to the services.
async fn over(line: &Connection, command: Command) -> anyhow::Result<()> {
    match command {
        Command::Scene(command) => scene::run(line, command).await,
        Command::Train(args) => train::run(line, *args).await,
        Command::Jobs(args) => jobs::run(line, args).await,
        Command::Render(args) => render::render(line, *args).await,
        Command::Identify(args) => identify::identify(line, args).await,
        Command::Locate(args) => locate::locate(line, args).await,
        Command::Who(args) => who::who(line, args).await,
        Command::Evaluate(args) => evaluate::evaluate(line, args).await,
        Command::Access(command) => access::run(line, command).await,
        Command::Owners(command) => owners::run(line, command).await,
        Command::Keys(command) => keys::run(line, &command).await,
        // They were answered before there was a line.
        Command::Serve
        | Command::Audit(_)
        | Command::Witness(_)
        | Command::Demo(_)
        | Command::Registry(_)
        | Command::Completions(_)
        | Command::Man(_) => Ok(()),
    }
}

/// Logs go to standard error: standard output belongs to answers. Commands other
/// than the daemon speak for themselves, and log only what is wrong.
fn start_log(config: &Config, daemon: bool) {
    let filter = if daemon { config.log_filter.as_str() } else { "warn" };
    let log = tracing_subscriber::fmt()
        .with_env_filter(tracing_subscriber::EnvFilter::new(filter))
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    match config.log_format {
        LogFormat::Text => log.init(),
        LogFormat::Json => log.json().init(),
    }
}
