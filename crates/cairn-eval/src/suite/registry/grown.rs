//! A log of some size: what it costs to grow it, to start on it, to prove, to answer, to submit to it, and to verify what
//! comes out.

use std::path::PathBuf;
use std::time::Instant;

use cairn_log::{Registry, SignedRecord, TlogProof};
use cairn_verify::{Evidence, Outcome};
use serde::{Deserialize, Serialize};

use super::load::Waits;
use super::made::{self, ORIGIN};
use crate::children::Work;
use crate::memory;

/// Entries in one batch while a log is grown.
const BATCH: u64 = 1 << 15;
/// Proofs that are timed.
const PROOFS: u64 = 2000;
/// Records that are submitted one after the other.
const SUBMISSIONS: u64 = 100;
/// Verifications that are timed.
const VERIFICATIONS: usize = 200;

/// A log of made-up entries.
#[derive(Clone, Serialize, Deserialize)]
pub struct Log {
    pub label: String,
    pub folder: PathBuf,
    pub seed: u64,
    pub records: u64,
    pub views: u64,
}

/// Grows the log; its answer is the seconds that it took.
#[derive(Clone, Serialize, Deserialize)]
pub struct Grow(pub Log);

/// Starts on the log and works with it. The process's memory is that of serving it.
#[derive(Clone, Serialize, Deserialize)]
pub struct ServeLog(pub Log);

/// Audits all of the log: every byte hashed again, tree, tiles and map made again from the entries.
#[derive(Clone, Serialize, Deserialize)]
pub struct AuditLog(pub Log);

macro_rules! work {
    ($($work:ident, $name:literal, $run:ident -> $result:ty;)*) => {
        $(impl Work for $work {
            const NAME: &'static str = $name;
            type Result = $result;

            fn label(&self) -> &str {
                &self.0.label
            }

            fn run(&self) -> anyhow::Result<$result> {
                $run(&self.0)
            }
        })*
    };
}

work! {
    Grow, "grow", grow -> f64;
    ServeLog, "serve-log", serve -> Served;
    AuditLog, "audit-log", audit -> Audited;
}

/// What it cost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Served {
    pub start_s: f64,
    pub prove_us: Waits,
    pub answer_ms: f64,
    pub answer_bytes: f64,
    pub submit_ms: Waits,
    pub bundle_bytes: f64,
    pub verify_us: f64,
    pub peak_mib: Option<f64>,
}

/// What an audit cost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Audited {
    pub seconds: f64,
    pub peak_mib: Option<f64>,
}

fn grow(task: &Log) -> anyhow::Result<f64> {
    let begun = Instant::now();
    let registry = Registry::open(&task.folder.join("registry"), made::registry_key(), ORIGIN)?;
    let mut number = 0;
    while number < task.records {
        let end = (number + BATCH).min(task.records);
        registry.fill((number..end).map(|number| made::entry(task.seed, number, task.views)))?;
        registry.publish()?;
        registry.tidy(&|| false)?;
        number = end;
        let rate = number as f64 / begun.elapsed().as_secs_f64();
        let left = (task.records - number) as f64 / rate;
        eprintln!("{}: {number} of {} entries, {rate:.0} a second, {left:.0} s left", task.label, task.records);
    }
    drop(registry);
    Ok(begun.elapsed().as_secs_f64())
}

fn serve(task: &Log) -> anyhow::Result<Served> {
    let begun = Instant::now();
    let registry = Registry::open(&task.folder.join("registry"), made::registry_key(), ORIGIN)?;
    let start_s = begun.elapsed().as_secs_f64();
    let size = registry.size();
    let ms = |begun: Instant| begun.elapsed().as_secs_f64() * 1e3;

    let mut proofs = Vec::new();
    for i in 0..PROOFS {
        // Spread over the whole log, so that tiles come from the disk and not from the cache.
        let index = (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ task.seed) % size;
        let begun = Instant::now();
        let proof = registry.tlog_proof(index)?;
        proofs.push(ms(begun) * 1e3);
        std::hint::black_box(proof);
    }
    let begun = Instant::now();
    let answer = registry.answer("landmark-0", None, None, usize::MAX)?;
    let answer_ms = ms(begun);

    let mut waits = Vec::new();
    let mut last = None;
    for i in 0..SUBMISSIONS {
        let (envelope, _) = made::record(&registry, task.seed + 1, task.records + i, task.views)?;
        let begun = Instant::now();
        last = Some(registry.submit(SignedRecord::open(envelope)?)?);
        waits.push(ms(begun));
    }
    registry.publish()?;
    let receipt = last.ok_or_else(|| anyhow::anyhow!("nothing was submitted"))?;
    let (verify_us, bundle_bytes) = verify(&registry, &receipt)?;
    Ok(Served {
        start_s,
        prove_us: Waits::of(proofs),
        answer_ms,
        answer_bytes: answer.to_json().len() as f64,
        submit_ms: Waits::of(waits),
        bundle_bytes,
        verify_us,
        peak_mib: memory::peak_mib(),
    })
}

fn audit(task: &Log) -> anyhow::Result<Audited> {
    let pinned = cairn_log::NoteVerifier::new(ORIGIN, made::registry_key().public())?;
    let options = cairn_verify::StoreOptions { pinned: Some(&pinned), ..Default::default() };
    let begun = Instant::now();
    let report = cairn_verify::audit_store(&task.folder, &options)?;
    anyhow::ensure!(report.outcome == Outcome::Trusted, "the log's audit says {}: {report}", report.outcome);
    Ok(Audited { seconds: begun.elapsed().as_secs_f64(), peak_mib: memory::peak_mib() })
}

/// Microseconds of verifying a bundle, and the bytes of it beside the envelope.
fn verify(registry: &Registry, receipt: &cairn_log::Receipt) -> anyhow::Result<(f64, f64)> {
    let proof: TlogProof = registry.tlog_proof(receipt.index)?;
    let (envelope, proof, pinned) = (receipt.envelope.to_json(), proof.to_text(), registry.verifier()?);
    let mut times = Vec::new();
    for _ in 0..VERIFICATIONS {
        let begun = Instant::now();
        let evidence = Evidence {
            envelope: envelope.as_bytes(),
            proof: Some(&proof),
            pinned: Some(&pinned),
            ..Evidence::default()
        };
        let report = cairn_verify::audit(&evidence);
        times.push(begun.elapsed().as_secs_f64() * 1e6);
        anyhow::ensure!(report.outcome == Outcome::Trusted, "the log's own bundle is {}: {report}", report.outcome);
    }
    Ok((Waits::of(times).median, proof.len() as f64))
}
