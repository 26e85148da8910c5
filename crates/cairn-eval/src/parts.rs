//! Every piece of work that runs in a process of its own, by name.

use crate::children::{Part, Work};
use crate::suite::{baseline, registry, scenes, tradeoff};
use crate::{marked, marks, registration, trained, woven};

/// Reads one part from standard input, does it, and prints its answer.
///
/// # Errors
/// For a line that is no part, and the work's own.
pub fn run() -> anyhow::Result<()> {
    let part = Part::from_stdin()?;
    macro_rules! dispatch {
        ($($work:ty,)*) => {
            match part.name.as_str() {
                $(<$work>::NAME => part.answer::<$work>()?,)*
                other => anyhow::bail!("there is no work called {other:?}"),
            }
        };
    }
    let answer = dispatch! {
        trained::Train,
        trained::Score,
        trained::Serve,
        tradeoff::Tradeoffs,
        baseline::TrainNetworks,
        marked::Mark,
        marked::ServeMarks,
        marks::judge::Judge,
        scenes::Join,
        registration::work::Register,
        woven::work::ReadBack,
        registry::load::Load,
        registry::grown::Grow,
        registry::grown::ServeLog,
        registry::grown::AuditLog,
        registry::victim::Victim,
    };
    println!("{answer}");
    Ok(())
}
