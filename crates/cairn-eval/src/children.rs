//! Work in processes of its own, so that peak memory is that work's alone. A process reads what to do as one line of
//! JSON on its standard input, answers with one line, and ends when its standard input does: none outlasts this one.

use std::io::{BufRead as _, Read as _, Write as _};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context as _;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// The hidden command that a process is started with.
pub const COMMAND: &str = "part";

/// A piece of a suite's work.
pub trait Work: Clone + Serialize + DeserializeOwned + Send + 'static {
    /// Its name among all pieces.
    const NAME: &'static str;
    /// What it answers.
    type Result: Serialize + DeserializeOwned + Send + 'static;

    /// What is shown of it while it runs.
    fn label(&self) -> &str;

    /// Does it.
    ///
    /// # Errors
    /// Those of the work.
    fn run(&self) -> anyhow::Result<Self::Result>;
}

/// A piece of work as its process reads it.
#[derive(Serialize, Deserialize)]
pub struct Part {
    /// [`Work::NAME`].
    pub name: String,
    /// The work itself.
    pub task: serde_json::Value,
}

impl Part {
    /// That of `work`.
    ///
    /// # Errors
    /// For work that cannot be written as JSON.
    pub fn of<W: Work>(work: &W) -> anyhow::Result<Self> {
        Ok(Self { name: W::NAME.to_owned(), task: serde_json::to_value(work)? })
    }

    /// Reads one from standard input. From then on this process ends when its standard input does.
    ///
    /// # Errors
    /// For a line that is no part.
    pub fn from_stdin() -> anyhow::Result<Self> {
        let mut line = String::new();
        std::io::stdin().lock().read_line(&mut line).context("cannot read the task")?;
        let part = serde_json::from_str(&line)
            .context("standard input holds no task: the suites start this command, people do not")?;
        std::thread::spawn(end_with_the_line);
        Ok(part)
    }

    /// Does the work as a `W`; its answer as JSON.
    ///
    /// # Errors
    /// For a task that is no `W`, and the work's own.
    pub fn answer<W: Work>(self) -> anyhow::Result<String> {
        Ok(serde_json::to_string(&serde_json::from_value::<W>(self.task)?.run()?)?)
    }

    /// Starts a process that does it; what to do is written to its standard input, which is given back.
    ///
    /// # Errors
    /// For a process that cannot be started.
    pub fn start(&self) -> anyhow::Result<(Child, ChildStdin)> {
        let program = std::env::current_exe().context("cannot find this program's own file to start it again")?;
        let mut command = Command::new(&program);
        command.arg(COMMAND).stdin(Stdio::piped()).stdout(Stdio::piped());
        // Out of reach of the terminal's Ctrl-C: this process handles it.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        let mut line = child.stdin.take().context("the process has no standard input")?;
        // A process that ends at once says itself why; that error is the one to report.
        let _ = writeln!(line, "{}", serde_json::to_string(self)?);
        Ok((child, line))
    }
}

/// Ends this process when standard input does: nothing waits for its answer any more.
fn end_with_the_line() {
    let mut rest = [0u8; 64];
    while matches!(std::io::stdin().lock().read(&mut rest), Ok(1..)) {}
    std::process::exit(130);
}

/// The process under way, if there is one.
#[derive(Clone, Default)]
pub struct Children {
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    line: Option<ChildStdin>,
    stopped: bool,
}

impl Children {
    /// Does `work` in a process of its own and waits for it. Its progress goes to standard error.
    ///
    /// # Errors
    /// For a process that cannot be started, fails or is stopped.
    pub fn run<W: Work>(&self, work: &W) -> anyhow::Result<W::Result> {
        let label = work.label();
        anyhow::ensure!(!self.lock().stopped, "{label}: stopped");
        let (mut child, line) = Part::of(work)?.start()?;
        let mut output = child.stdout.take().context("the process has no standard output")?;
        {
            let mut state = self.lock();
            state.line = (!state.stopped).then_some(line);
        }
        let mut answer = String::new();
        let heard = output.read_to_string(&mut answer).context("cannot read what the process answers");
        self.lock().line = None;
        let status = child.wait().context("cannot wait for the process")?;
        anyhow::ensure!(!self.lock().stopped, "{label}: stopped");
        heard?;
        anyhow::ensure!(status.success(), "{label}: its process ended with {status}; its error is above");
        serde_json::from_str(&answer).with_context(|| format!("{label}: its process answered {answer:?}"))
    }

    /// Runs `work` on a thread of its own. Ctrl-C ends its process.
    ///
    /// # Errors
    /// The work's own, and that it was stopped.
    pub async fn unless_stopped<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Self) -> anyhow::Result<T> + Send + 'static,
    ) -> anyhow::Result<T> {
        let children = self.clone();
        let mut work = tokio::task::spawn_blocking(move || work(&children));
        tokio::select! {
            done = &mut work => done.context("the measurement broke off")?,
            interrupt = tokio::signal::ctrl_c() => {
                interrupt?;
                self.stop();
                // Its error would only say that it was stopped.
                let _ = work.await;
                anyhow::bail!("stopped by Ctrl-C; the rows of finished captures are kept, this capture has none")
            }
        }
    }

    /// Ends the process under way, and any that would follow.
    fn stop(&self) {
        let mut state = self.lock();
        state.stopped = true;
        state.line = None;
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
