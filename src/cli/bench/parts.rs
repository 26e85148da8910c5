//! The other side of [`super::children`]: `cairn bench-part` reads one task, does
//! it and answers with one line of JSON. It ends when its standard input does.

use std::io::{BufRead as _, Read as _};

use anyhow::Context as _;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::field::{score, serve, tradeoff, train};
use super::{baseline, mark, registry};

/// A piece of the suite's work.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// A training from its first step to the stored field.
    Train(train::Task),
    /// Pictures against photographs.
    Score(score::Task),
    /// A stored field, loaded and rendered.
    Serve(serve::Task),
    /// What each limit of a render costs.
    Tradeoff(tradeoff::Task),
    /// DeepStega's networks, trained and stored.
    Networks(baseline::TrainNetworks),
    /// Stage 2 from a stored base field to the stored detector.
    Mark(mark::Mark),
    /// A marked field and its detector, judged.
    Judge(mark::Judge),
    /// A marked field and its detector, loaded, rendered and read.
    ServeMarks(mark::Serve),
    /// Stage 2 of several captures with one detector, judged.
    Scenes(mark::scenes::Task),
    /// Submissions to a log under load.
    Load(registry::Load),
    /// A log grown to some size.
    Grow(registry::Growth),
    /// A log of some size, started and asked.
    Log(registry::Serve),
    /// A log of some size, audited.
    AuditLog(registry::Audit),
    /// Submissions to a log until the process is killed.
    Victim(registry::Victim),
}

/// What [`super::children::Children::run`] takes.
pub trait Work: Clone + Serialize {
    /// What it answers.
    type Result: DeserializeOwned;
    /// What people are told is under way.
    fn label(&self) -> &str;
    /// Itself as a task.
    fn to_part(&self) -> Part;
}

macro_rules! work {
    ($($task:ty: $part:ident -> $result:ty,)*) => {
        $(impl Work for $task {
            type Result = $result;
            fn label(&self) -> &str {
                &self.label
            }
            fn to_part(&self) -> Part {
                Part::$part(self.clone())
            }
        })*
    };
}

work! {
    train::Task: Train -> train::Trained,
    score::Task: Score -> score::Scored,
    serve::Task: Serve -> serve::Served,
    tradeoff::Task: Tradeoff -> Vec<tradeoff::Tradeoff>,
    baseline::TrainNetworks: Networks -> baseline::Networks,
    mark::Mark: Mark -> mark::Marked,
    mark::Judge: Judge -> mark::Judged,
    mark::Serve: ServeMarks -> mark::Served,
    mark::scenes::Task: Scenes -> mark::scenes::Joined,
    registry::Load: Load -> registry::Loaded,
    registry::Growth: Grow -> f64,
    registry::Serve: Log -> registry::Served,
    registry::Audit: AuditLog -> registry::Audited,
}

/// Answers `cairn bench-part`.
///
/// # Errors
/// For a line that is no task, and the work's own.
pub fn part() -> anyhow::Result<()> {
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line).context("cannot read the task")?;
    let part: Part = serde_json::from_str(&line)
        .context("standard input holds no task: `cairn bench` starts this command, people do not")?;
    std::thread::spawn(end_with_the_line);
    let answer = match part {
        Part::Train(task) => serde_json::to_string(&train::run(&task)?)?,
        Part::Score(task) => serde_json::to_string(&score::run(&task)?)?,
        Part::Serve(task) => serde_json::to_string(&serve::run(&task)?)?,
        Part::Tradeoff(task) => serde_json::to_string(&tradeoff::run(&task)?)?,
        Part::Networks(task) => serde_json::to_string(&baseline::train_networks(&task)?)?,
        Part::Mark(task) => serde_json::to_string(&mark::mark(&task)?)?,
        Part::Judge(task) => serde_json::to_string(&mark::judge(&task)?)?,
        Part::ServeMarks(task) => serde_json::to_string(&mark::serve(&task)?)?,
        Part::Scenes(task) => serde_json::to_string(&mark::scenes::run(&task)?)?,
        Part::Load(task) => serde_json::to_string(&registry::load(&task)?)?,
        Part::Grow(task) => serde_json::to_string(&registry::grow(&task)?)?,
        Part::Log(task) => serde_json::to_string(&registry::serve(&task)?)?,
        Part::AuditLog(task) => serde_json::to_string(&registry::audit(&task)?)?,
        Part::Victim(task) => serde_json::to_string(&registry::victim(&task)?)?,
    };
    println!("{answer}");
    Ok(())
}

/// Ends this process when standard input does: nobody waits for it any more.
fn end_with_the_line() {
    let mut rest = [0u8; 64];
    while matches!(std::io::stdin().lock().read(&mut rest), Ok(1..)) {}
    std::process::exit(130);
}
