//! Killed at any moment: a process submits until it is shot, and what it acknowledged must be there afterwards.

use std::collections::HashMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use cairn_log::{Checkpoint, Digest, Registry, SignedRecord, format::merkle};
use serde::{Deserialize, Serialize};

use super::made::{self, ORIGIN};
use crate::children::{Part, Work};
use cairn_service::records::publisher::Publisher;

/// Submitters in the process that is killed.
const CLIENTS: u64 = 4;

/// Submits until it is killed.
#[derive(Clone, Serialize, Deserialize)]
pub struct Victim {
    pub folder: PathBuf,
    pub seed: u64,
    pub round: u64,
}

/// An acknowledgement, as it is said on standard output.
#[derive(Serialize, Deserialize)]
struct Acknowledged {
    index: u64,
    record: Digest,
    size: u64,
    root: Digest,
}

/// What became of the log over all rounds.
#[derive(Clone, Debug, Default)]
pub struct Survived {
    pub rounds: u64,
    pub acknowledged: u64,
    pub lost: u64,
    pub forked: u64,
    pub faults: u64,
}

impl Work for Victim {
    const NAME: &'static str = "victim";
    type Result = ();

    fn label(&self) -> &str {
        "submitting until it is killed"
    }

    /// Prints one line for each acknowledgement.
    fn run(&self) -> anyhow::Result<()> {
        let task = self;
        let registry = Arc::new(Registry::open(&task.folder.join("registry"), made::registry_key(), ORIGIN)?);
        let publisher = Publisher::start(registry.clone(), vec![])?;
        let (log, count) = (registry.verifier()?, AtomicU64::new(0));
        std::thread::scope(|scope| {
            let clients: Vec<_> = (0..CLIENTS)
                .map(|_| {
                    scope.spawn(|| -> anyhow::Result<()> {
                        loop {
                            let number = task.round * 1_000_000 + count.fetch_add(1, Ordering::Relaxed);
                            let receipt = registry
                                .submit(SignedRecord::open(made::record(&registry, task.seed, number, 1)?.0)?)?;
                            publisher.wake();
                            let checkpoint = Checkpoint::verify(&receipt.checkpoint, &log)?;
                            let (size, root) = (checkpoint.size, checkpoint.root);
                            let said =
                                Acknowledged { index: receipt.index, record: receipt.envelope.digest(), size, root };
                            writeln!(std::io::stdout().lock(), "{}", serde_json::to_string(&said)?)?;
                        }
                    })
                })
                .collect();
            for client in clients {
                client.join().map_err(|_| anyhow::anyhow!("a submitter's thread panicked"))??;
            }
            Ok(())
        })
    }
}

/// Kills such a process `rounds` times at drawn moments, and holds the log to all that was ever acknowledged.
///
/// # Errors
/// Where a process cannot be started, or the log does not open again.
pub fn kill(folder: &Path, seed: u64, rounds: u64) -> anyhow::Result<Survived> {
    let mut survived = Survived { rounds, ..Survived::default() };
    let (mut records, mut roots) = (HashMap::new(), HashMap::new());
    for round in 0..rounds {
        let drawn = u64::from_be_bytes(Digest::of(format!("{seed} {round}")).as_bytes()[..8].try_into()?);
        let task = Victim { folder: folder.to_path_buf(), seed, round };
        for said in shot(&task, Duration::from_micros(drawn % 250_000))? {
            survived.acknowledged += 1;
            if records.insert(said.record, said.index).is_some_and(|index| index != said.index) {
                survived.lost += 1;
            }
            if roots.insert(said.size, said.root).is_some_and(|root| root != said.root) {
                survived.forked += 1;
            }
        }
        let registry = Registry::open(&folder.join("registry"), made::registry_key(), ORIGIN)
            .with_context(|| format!("round {round}"))?;
        hold(&registry, &records, &roots, &mut survived)?;
        if (round + 1) % 20 == 0 {
            eprintln!("killed {} of {rounds} times, {} records acknowledged", round + 1, survived.acknowledged);
        }
    }
    let registry = Registry::open(&folder.join("registry"), made::registry_key(), ORIGIN)?;
    survived.faults = registry.check()?.len() as u64;
    Ok(survived)
}

fn hold(
    registry: &Registry,
    records: &HashMap<Digest, u64>,
    roots: &HashMap<u64, Digest>,
    survived: &mut Survived,
) -> anyhow::Result<()> {
    let head = registry.head()?;
    for (record, index) in records {
        survived.lost += u64::from(registry.find(record)? != Some(*index));
    }
    for (size, root) in roots {
        let proof = registry.prove_consistency(*size, head.size)?;
        let consistent = merkle::verify_consistency(*size, head.size, &proof, root, &head.root);
        survived.forked += u64::from(consistent.is_err());
    }
    Ok(())
}

/// Starts the process, lets it acknowledge one record and then go on for `further`, and kills it.
fn shot(task: &Victim, further: Duration) -> anyhow::Result<Vec<Acknowledged>> {
    let (mut child, line) = Part::of(task)?.start()?;
    let mut said = BufReader::new(child.stdout.take().context("the process has no standard output")?).lines();
    let first = said.next().context("the process to be killed ended by itself; its error is above")??;
    std::thread::sleep(further);
    child.kill()?;
    let rest: Vec<String> = said.map_while(Result::ok).collect();
    child.wait()?;
    drop(line);
    // The last line may be cut off: then it acknowledges nothing.
    Ok([first].iter().chain(&rest).filter_map(|line| serde_json::from_str(line).ok()).collect())
}
