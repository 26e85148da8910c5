//! The command line: what can be asked for, and which file answers it.

mod access;
mod answers;
mod audit;
mod check;
mod connect;
mod corrections;
mod credential;
mod demo;
mod evaluate;
mod files;
mod identify;
mod keys;
mod light;
mod owners;
mod path;
mod poses;
mod progress;
mod records;
mod registry;
mod render;
mod scene;
mod sign;
mod signals;
mod train;
mod unlock;
mod viewpoint;
mod witness;
mod words;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use anyhow::Context as _;
use clap::{Parser, Subcommand};

use cairn_service::config::{Config, LogFormat};
use connect::{Connection, Where};

/// Credits the photographers of a landmark: radiance fields with hidden, recoverable owner marks.
#[derive(Debug, Parser)]
#[command(name = "cairn", version, max_term_width = 100)]
pub struct Cli {
    #[command(flatten)]
    place: Where,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the daemon on --data with --config, until SIGINT or SIGTERM
    Serve,
    /// Import, list, show, check and delete scenes
    #[command(subcommand)]
    Scene(scene::Command),
    /// Train a scene: base field, then marked field and detector
    Train(train::Args),
    /// List the training jobs, newest first
    Jobs,
    /// Render a trained scene to a picture, or a camera path through it to a GIF or PNG frames
    Render(Box<render::RenderArgs>),
    /// Find whose mark a picture carries, and recover what it hides
    Identify(identify::IdentifyArgs),
    /// Ask who contributed what a view or a camera sees
    Who(identify::WhoArgs),
    /// Score a trained scene on the views it never saw
    Evaluate(evaluate::EvaluateArgs),
    /// Make, seal, show, rotate and revoke owners' keys (they stay on this machine)
    #[command(subcommand)]
    Keys(keys::Command),
    /// Who may do what on a daemon: register, approve, roles, quotas
    #[command(subcommand)]
    Access(access::Command),
    /// Sign, correct and list owner records
    #[command(subcommand)]
    Owners(owners::Command),
    /// Verify bundles, stores and logs, trusting nobody
    #[command(subcommand)]
    Audit(audit::Command),
    /// Repair the log of a daemon that is not running
    #[command(subcommand)]
    Registry(registry::Command),
    /// Cosign the checkpoints of logs, as a witness
    #[command(subcommand)]
    Witness(witness::Command),
    /// Everything once, on a made-up landmark: import, train, mark, sign, ask, verify
    Demo(demo::Args),
}

impl Cli {
    /// Runs the command. The exit code is 1 where a verification says `invalid`, and `cairn audit` has more.
    ///
    /// # Errors
    /// Whatever went wrong, for people to read.
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
            Command::Audit(command) => return audit::run(&command),
            command => {
                let line = Connection::open(&place, &config).await?;
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
        Command::Train(args) => train::run(line, args).await,
        Command::Jobs => train::jobs(line).await,
        Command::Render(args) => render::render(line, *args).await,
        Command::Identify(args) => identify::identify(line, args).await,
        Command::Who(args) => identify::who(line, args).await,
        Command::Evaluate(args) => evaluate::evaluate(line, args).await,
        Command::Access(command) => access::run(line, command).await,
        Command::Owners(command) => owners::run(line, command).await,
        Command::Keys(command) => keys::run(line, &command).await,
        Command::Serve | Command::Audit(_) | Command::Witness(_) | Command::Demo(_) | Command::Registry(_) => Ok(()),
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
