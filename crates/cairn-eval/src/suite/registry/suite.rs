//! Suite `registry`: what records cost to take in, to find, to prove and to verify, and whether any is lost.
//!
//! Two kinds of run: `--long` measures the log of ten million records, without it all else is measured.
//! Throughput and waits are of whole records, signed beforehand and verified on the way in. Logs beyond a few
//! ten thousand are filled with entries whose signatures nobody made (`Registry::fill`): what is measured on those is
//! starting, proving, answering and submitting, which does not depend on what stands in old entries, and an audit of the
//! entries, which count as erased: an audit of envelopes as well verifies two signatures for each.

use std::path::{Path, PathBuf};

use super::grown::{AuditLog, Grow, Log, ServeLog, Served};
use super::load::{Load, Loaded};
use super::victim;
use crate::args::Args;
use crate::chart::{self, Axis, Line};
use crate::children::Children;
use crate::results::Target;
use crate::rows::Rows;

/// Sizes of the cost curves, records.
const SIZES: [u64; 5] = [1_000, 10_000, 100_000, 1_000_000, 10_000_000];
/// The size that the goals are about.
const GOAL: u64 = 10_000_000;
/// Submitters at the same time.
const CLIENTS: usize = 64;
/// Records a second that have to become durable.
const RATE: f64 = 2000.0;
/// Rounds of killing the process that takes records in.
const ROUNDS: u64 = 200;

/// What a log of some size costs.
struct Cost {
    records: u64,
    served: Served,
    audit_s: f64,
}

/// Measures everything, into `rows` and, as curves, into `args.out`.
///
/// # Errors
/// For folders that cannot be made, and whatever goes wrong in a log.
pub fn measure(args: &Args, rows: &mut Rows) -> anyhow::Result<()> {
    let children = Children::default();
    std::fs::create_dir_all(&args.out)?;
    let folder = |name: &str| -> anyhow::Result<PathBuf> {
        let folder = args.out.join(name);
        std::fs::create_dir(&folder)?;
        Ok(folder)
    };
    if args.long {
        return curves(args, &children, rows, &folder);
    }
    let records = if args.quick { 4_000 } else { 40_000 };
    for (case, rate, views, records) in [
        ("as many as are taken, one view a record", None, 1, records),
        ("as many as are taken, twenty views a record", None, 20, records / 4),
        ("2000 records/s, one view a record", Some(RATE), 1, records / 2),
    ] {
        let task = Load {
            label: case.to_owned(),
            folder: folder(&format!("load-{views}-{}", rate.is_some()))?,
            seed: args.seed,
            records,
            clients: CLIENTS,
            rate,
            views,
        };
        of_load(&args.case_name(case), &children.run(&task)?, &task, rows);
        std::fs::remove_dir_all(&task.folder)?;
        rows.save(args)?;
    }
    curves(args, &children, rows, &folder)?;
    let rounds = if args.quick { 20 } else { ROUNDS };
    let survived = victim::kill(&folder("killed")?, args.seed, rounds)?;
    let case = args.case_name("killed at drawn moments");
    rows.add(&case, "rounds", survived.rounds as f64, "", None);
    rows.add(&case, "records acknowledged", survived.acknowledged as f64, "", None);
    for (metric, value) in [
        ("acknowledged records lost", survived.lost),
        ("sizes with two roots", survived.forked),
        ("faults found by reading all again", survived.faults),
    ] {
        rows.add(&case, metric, value as f64, "", Some(Target::at_most(0.0)));
    }
    Ok(())
}

fn of_load(case: &str, loaded: &Loaded, task: &Load, rows: &mut Rows) {
    let goal = (task.views == 1).then_some(());
    let throughput = goal.filter(|()| task.rate.is_none()).map(|()| Target::at_least(RATE));
    rows.add(case, "durable records", loaded.records_per_s, "/s", throughput);
    let paced = goal.filter(|()| task.rate.is_some());
    let acknowledged = &loaded.acknowledged_ms;
    rows.add(case, "acknowledgement, median", acknowledged.median, "ms", None);
    rows.add(case, "acknowledgement, p99", acknowledged.p99, "ms", paced.map(|()| Target::at_most(50.0)));
    rows.add(case, "published, p95", loaded.published_ms.p95, "ms", paced.map(|()| Target::at_most(1000.0)));
    if let Some(peak) = loaded.peak_mib {
        rows.add(case, "peak memory, submitters included", peak, "MiB", None);
    }
}

/// The cost of everything by the log's size.
fn curves(
    args: &Args,
    children: &Children,
    rows: &mut Rows,
    folder: &dyn Fn(&str) -> anyhow::Result<PathBuf>,
) -> anyhow::Result<()> {
    let mut costs = Vec::new();
    let wanted = |records: &u64| if args.long { *records == GOAL } else { *records < GOAL };
    for records in SIZES.into_iter().filter(wanted).filter(|records| !args.quick || *records <= 10_000) {
        let (label, folder) = (format!("{} records", with_units(records)), folder(&format!("log-{records}"))?);
        let log = Log { label: label.clone(), folder: folder.clone(), seed: args.seed, records, views: 1 };
        let grown_s = children.run(&Grow(log.clone()))?;
        let served = children.run(&ServeLog(log.clone()))?;
        let bytes = bytes_in(&folder)?;
        let audited = children.run(&AuditLog(log))?;
        std::fs::remove_dir_all(&folder)?;
        of_size(&args.case_name(&label), &served, records, rows);
        rows.add(&args.case_name(&label), "grown", grown_s, "s", None);
        rows.add(&args.case_name(&label), "audit of all of it", audited.seconds, "s", None);
        if let Some(peak) = audited.peak_mib {
            rows.add(&args.case_name(&label), "audit of all of it, peak memory", peak, "MiB", None);
        }
        rows.add(&args.case_name(&label), "on disk", bytes as f64 / records as f64, "bytes/record", None);
        rows.save(args)?;
        costs.push(Cost { records, served, audit_s: audited.seconds });
    }
    draw(&args.out, &costs)
}

fn of_size(case: &str, served: &Served, records: u64, rows: &mut Rows) {
    let at_most = |value: f64| (records == GOAL).then(|| Target::at_most(value));
    rows.add(case, "start", served.start_s, "s", at_most(2.0));
    rows.add(case, "proof of a record, median", served.prove_us.median / 1e3, "ms", at_most(1.0));
    rows.add(case, "proof of a record, p99", served.prove_us.p99 / 1e3, "ms", at_most(1.0));
    rows.add(case, "bundle beside the envelope", served.bundle_bytes, "bytes", at_most(2000.0));
    rows.add(case, "verification of a bundle", served.verify_us, "us", at_most(200.0));
    rows.add(case, "submission, one after the other, median", served.submit_ms.median, "ms", None);
    rows.add(case, "submission, one after the other, p99", served.submit_ms.p99, "ms", None);
    rows.add(case, "complete answer about a scene", served.answer_ms, "ms", None);
    rows.add(case, "complete answer about a scene, size", served.answer_bytes / 1e6, "MB", None);
    if let Some(peak) = served.peak_mib {
        rows.add(case, "peak memory", peak, "MiB", at_most(300.0));
    }
}

/// Draws what a log's size costs, in milliseconds.
fn draw(out: &Path, costs: &[Cost]) -> anyhow::Result<()> {
    type Of = fn(&Cost) -> f64;
    let of: [(&str, Of); 6] = [
        ("Audit of all of it", |cost| cost.audit_s * 1e3),
        ("Start", |cost| cost.served.start_s * 1e3),
        ("Answer about a scene", |cost| cost.served.answer_ms),
        ("Submission", |cost| cost.served.submit_ms.median),
        ("Verification", |cost| cost.served.verify_us * 1e-3),
        ("Proof", |cost| cost.served.prove_us.median * 1e-3),
    ];
    let line = |(name, of): (&str, Of)| {
        let points = costs.iter().map(|cost| [cost.records as f64, of(cost)]).collect();
        Line { name: name.to_owned(), points }
    };
    let (records, time) = (Axis { name: "Records", is_log: true }, Axis { name: "Time, ms", is_log: true });
    chart::draw(&out.join("sizes.svg"), "What a log's size costs", records, time, &of.map(line))
}

fn bytes_in(folder: &Path) -> anyhow::Result<u64> {
    let mut bytes = 0;
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        bytes += if entry.file_type()?.is_dir() { bytes_in(&entry.path())? } else { entry.metadata()?.len() };
    }
    Ok(bytes)
}

/// A count with thousands apart.
fn with_units(count: u64) -> String {
    let digits = count.to_string();
    let mut grouped = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            grouped.push(' ');
        }
        grouped.push(digit);
    }
    grouped
}
