//! `cairn witness`: cosigning other people's logs, with a key and a memory of its own.

use std::io::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context as _;
use cairn_log::witness::Witness;
use cairn_log::witness::plain_http::Limits;
use cairn_log::{NoteVerifier, WitnessVerifier};

use super::unlock::UnlockArgs;
use cairn_service::grpc::serve::signal;

/// What a witness does.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Cosign logs over HTTP (C2SP tlog-witness), until SIGINT or SIGTERM
    #[command(
        after_help = "Example:\n  cairn witness serve --key witness.key --name witness.example/w1 --folder witness --log log.vkey"
    )]
    Serve(ServeArgs),
    /// Show the verifier key that others pin
    #[command(after_help = "Example:\n  cairn witness vkey --key witness.key --name witness.example/w1")]
    Vkey(Who),
}

/// Who the witness is.
#[derive(Debug, clap::Args)]
pub struct Who {
    /// The witness's key, made with `cairn keys new`; nothing else may sign with it
    #[arg(long)]
    key: PathBuf,
    /// The witness's name, as witness.example/w1: no blanks, no plus signs
    #[arg(long)]
    name: String,
    #[command(flatten)]
    unlock: UnlockArgs,
}

/// Settings of `cairn witness serve`.
#[derive(Debug, clap::Args)]
pub struct ServeArgs {
    #[command(flatten)]
    who: Who,
    /// Where it remembers what it cosigned; a folder of its own, never a copy of another's
    #[arg(long)]
    folder: PathBuf,
    /// Where to listen: IP address and port, 0 for a free one
    #[arg(long, default_value = "127.0.0.1:7343")]
    listen: SocketAddr,
    /// A file with the vkeys of the logs to watch, one a line, # comments
    #[arg(long = "log", value_name = "VKEYFILE", required = true, num_args = 1..)]
    logs: Vec<PathBuf>,
}

/// Answers `cairn witness`.
pub async fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Serve(args) => serve(args).await,
        Command::Vkey(who) => {
            println!("{}", WitnessVerifier::new(&who.name, who.unlock.load(&who.key)?.public())?);
            Ok(())
        }
    }
}

async fn serve(args: &ServeArgs) -> anyhow::Result<()> {
    let mut logs = Vec::new();
    for file in &args.logs {
        logs.extend(vkeys(file)?);
    }
    let key = args.who.unlock.load(&args.who.key)?;
    let witness = Arc::new(Witness::open(&args.folder, &args.who.name, key, logs)?);
    let listener = tokio::net::TcpListener::bind(args.listen)
        .await
        .with_context(|| format!("cannot listen at {} (--listen)", args.listen))?;
    let address = listener.local_addr()?;
    let signal = signal().context("cannot hear signals")?;
    // For people and for programs that started us on port 0. A closed output is no reason to stop.
    let _ = writeln!(std::io::stdout(), "cairn witness listens at http://{address}\n{}", witness.verifier());
    let stop = async {
        match signal.await {
            Ok(signal) => tracing::info!(signal, "shutting down"),
            Err(e) => tracing::error!(error = %e, "cannot hear signals; shutting down"),
        }
    };
    cairn_log::witness::server::serve(listener, witness, Limits::default(), stop).await?;
    tracing::info!("stopped");
    Ok(())
}

/// The vkeys in a file, at least one.
fn vkeys(file: &std::path::Path) -> anyhow::Result<Vec<NoteVerifier>> {
    let text = String::from_utf8(super::files::read(file)?).with_context(|| format!("{}: not text", file.display()))?;
    let mut found = Vec::new();
    for (number, line) in (1..).zip(text.lines().map(str::trim)) {
        if !line.is_empty() && !line.starts_with('#') {
            found.push(line.parse().with_context(|| format!("{}, line {number}", file.display()))?);
        }
    }
    anyhow::ensure!(!found.is_empty(), "{}: no vkey in it; expected a log's, one a line", file.display());
    Ok(found)
}
