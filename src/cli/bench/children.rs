//! Work in processes of its own. A process hears what to do as one line on its
//! standard input and lives no longer than that stays open, so none outlasts
//! this one, however it ends.

use std::io::{Read as _, Write as _};
use std::process::{ChildStdin, Command, Stdio};
use std::sync::{Mutex, PoisonError};

use anyhow::Context as _;

use super::parts::Work;

/// The process under way, if there is one.
#[derive(Default)]
pub struct Children {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    line: Option<ChildStdin>,
    stopped: bool,
}

impl Children {
    /// Does `work` in a process of its own and waits for it. What it has to say of
    /// its progress goes to standard error.
    ///
    /// # Errors
    /// For a process that cannot be started, fails or is stopped.
    pub fn run<W: Work>(&self, work: &W) -> anyhow::Result<W::Result> {
        let label = work.label().to_owned();
        let mut task = serde_json::to_vec(&work.to_part())?;
        task.push(b'\n');
        let program = std::env::current_exe().context("cannot find this program's own file to start it again")?;
        let mut command = Command::new(&program);
        command.arg("bench-part").stdin(Stdio::piped()).stdout(Stdio::piped());
        // Out of reach of the terminal's Ctrl-C: this process hears it and says what it meant.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        let answered = self.converse(&mut child, &task);
        self.lock().line = None;
        let status = child.wait().context("cannot wait for the process")?;
        anyhow::ensure!(!self.lock().stopped, "{label}: stopped");
        let answer = answered?;
        anyhow::ensure!(status.success(), "{label}: its process ended with {status}; what it said of it is above");
        serde_json::from_str(&answer).with_context(|| format!("{label}: its process answered {answer:?}"))
    }

    /// Ends the process under way, and any that would follow.
    pub fn stop(&self) {
        let mut state = self.lock();
        state.stopped = true;
        state.line = None;
    }

    /// Says what to do, and hears the answer to its end.
    fn converse(&self, child: &mut std::process::Child, task: &[u8]) -> anyhow::Result<String> {
        let mut line = child.stdin.take().context("the process has no standard input")?;
        let mut output = child.stdout.take().context("the process has no standard output")?;
        let sent = line.write_all(task);
        {
            let mut state = self.lock();
            state.line = (!state.stopped).then_some(line);
        }
        let mut answer = String::new();
        output.read_to_string(&mut answer).context("cannot read what the process answers")?;
        // A process that ended at once says itself why, which is the error to report.
        if answer.is_empty() { Ok(answer) } else { sent.map(|()| answer).context("cannot tell the process what to do") }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
