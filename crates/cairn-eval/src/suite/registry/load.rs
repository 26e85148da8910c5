//! Submissions under load: how many records a second become durable, and how long a submitter and a monitor wait.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use cairn_log::{Envelope, Registry, SignedRecord};
use serde::{Deserialize, Serialize};

use super::made::{self, ORIGIN};
use crate::children::Work;
use crate::memory;
use cairn_service::records::publisher::Publisher;

/// A log under load, in a process of its own.
#[derive(Clone, Serialize, Deserialize)]
pub struct Load {
    pub label: String,
    pub folder: PathBuf,
    pub seed: u64,
    pub records: u64,
    /// Submitters at the same time.
    pub clients: usize,
    /// Records a second that are brought, evenly; none: as many as are taken.
    pub rate: Option<f64>,
    /// Photographs that each record lists.
    pub views: u64,
}

/// What came of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Loaded {
    pub records_per_s: f64,
    pub acknowledged_ms: Waits,
    pub published_ms: Waits,
    pub peak_mib: Option<f64>,
}

/// How long was waited.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Waits {
    pub median: f64,
    pub p95: f64,
    pub p99: f64,
}

impl Waits {
    /// Of waits in milliseconds.
    pub fn of(mut ms: Vec<f64>) -> Self {
        ms.sort_by(f64::total_cmp);
        let at = |share: f64| ms.get(((ms.len() as f64 * share) as usize).min(ms.len().saturating_sub(1)));
        let at = |share| at(share).copied().unwrap_or(f64::NAN);
        Self { median: at(0.5), p95: at(0.95), p99: at(0.99) }
    }
}

/// One acknowledged record.
struct Acknowledged {
    index: u64,
    /// Since the beginning.
    at: Duration,
    waited: Duration,
}

impl Work for Load {
    const NAME: &'static str = "load";
    type Result = Loaded;

    fn label(&self) -> &str {
        &self.label
    }

    /// Submits records that were signed beforehand: owners sign elsewhere.
    fn run(&self) -> anyhow::Result<Loaded> {
        let task = self;
        let registry = Arc::new(Registry::open(&task.folder.join("registry"), made::registry_key(), ORIGIN)?);
        let made = (0..task.records).map(|number| Ok(made::record(&registry, task.seed, number, task.views)?.0));
        let envelopes = made.collect::<anyhow::Result<Vec<Envelope>>>()?;
        let publisher = Publisher::start(registry.clone(), vec![])?;
        let (begun, ended, next) = (Instant::now(), AtomicBool::new(false), AtomicUsize::new(0));
        let (acknowledged, publications) = std::thread::scope(|scope| {
            let watcher = scope.spawn(|| watch(&registry, begun, &ended));
            let clients: Vec<_> = (0..task.clients)
                .map(|_| scope.spawn(|| submit(task, &registry, &publisher, &envelopes, &next, begun)))
                .collect();
            let done: Vec<_> = clients.into_iter().map(|client| client.join()).collect();
            let size = registry.size();
            // The last records are published a moment later.
            while registry.published().is_none_or(|published| published.size < size) && begun.elapsed().as_secs() < 600
            {
                std::thread::sleep(Duration::from_millis(5));
            }
            ended.store(true, Ordering::SeqCst);
            (done, watcher.join())
        });
        let mut all = Vec::new();
        for client in acknowledged {
            all.extend(client.map_err(|_| anyhow::anyhow!("a submitter's thread panicked"))??);
        }
        let publications = publications.map_err(|_| anyhow::anyhow!("the watcher's thread panicked"))?;
        let last = all.iter().map(|a| a.at).max().unwrap_or_default();
        let shown = |a: &Acknowledged| publications.iter().find(|(size, _)| *size > a.index).map(|(_, at)| *at);
        let published =
            all.iter().filter_map(|a| Some((shown(a)?.saturating_sub(a.at) + a.waited).as_secs_f64() * 1e3));
        Ok(Loaded {
            records_per_s: all.len() as f64 / last.as_secs_f64(),
            published_ms: Waits::of(published.collect()),
            acknowledged_ms: Waits::of(all.iter().map(|a| a.waited.as_secs_f64() * 1e3).collect()),
            peak_mib: memory::peak_mib(),
        })
    }
}

/// One submitter. With a rate, a record's wait begins when it was due, not when its turn came.
fn submit(
    task: &Load,
    registry: &Registry,
    publisher: &Publisher,
    envelopes: &[Envelope],
    next: &AtomicUsize,
    begun: Instant,
) -> anyhow::Result<Vec<Acknowledged>> {
    let mut acknowledged = Vec::new();
    loop {
        let number = next.fetch_add(1, Ordering::Relaxed);
        let Some(envelope) = envelopes.get(number) else { return Ok(acknowledged) };
        let due = task.rate.map_or_else(|| begun.elapsed(), |rate| Duration::from_secs_f64(number as f64 / rate));
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        let receipt = registry.submit(SignedRecord::open(envelope.clone())?)?;
        publisher.wake();
        let at = begun.elapsed();
        acknowledged.push(Acknowledged { index: receipt.index, at, waited: at.saturating_sub(due) });
    }
}

/// When which size was there for monitors.
fn watch(registry: &Registry, begun: Instant, ended: &AtomicBool) -> Vec<(u64, Duration)> {
    let mut seen: Vec<(u64, Duration)> = Vec::new();
    loop {
        let last = ended.load(Ordering::SeqCst);
        if let Some(published) = registry.published()
            && seen.last().is_none_or(|(size, _)| *size < published.size)
        {
            seen.push((published.size, begun.elapsed()));
        }
        if last {
            return seen;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}
