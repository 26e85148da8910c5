//! The process is killed (SIGKILL) at seeded moments while it takes records in; what it acknowledged must be
//! there afterwards, and no size may ever have two roots.
#![cfg(all(feature = "store", unix))]

use std::{
    collections::HashMap,
    env,
    io::{BufRead as _, BufReader, Write as _},
    path::Path,
    process::{Command, Stdio},
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

use crate::common::*;
use cairn_durable::RealDisk;
use cairn_log::{Anchor, Checkpoint, Digest, Registry, format::merkle, log::store::DiskStore};
use rand::{RngExt as _, SeedableRng as _};

const CHILD: &str = "CAIRN_CRASH_CHILD";
const ROUNDS: u64 = 10;
/// Rows that become a sorted run: those of some ten records.
const ENOUGH: usize = 40;

/// One acknowledged record, as the child printed it.
struct Acknowledged {
    index: u64,
    record: Digest,
    size: u64,
    root: Digest,
}

/// The log's anchor, beside its folder.
fn anchor(folder: &Path) -> Anchor {
    Anchor::at(&folder.with_extension("anchor")).unwrap()
}

/// Submits until it is killed; one line an acknowledgement. Its store moves rows all the time.
fn child(folder: &Path) {
    let store = DiskStore::open(&folder.join("working")).unwrap();
    let disk = RealDisk::new(folder);
    let anchor = anchor(folder);
    let registry =
        Registry::open_tiered(Box::new(store), Box::new(disk), registry_key(), ORIGIN, ENOUGH, Some(anchor)).unwrap();
    let log = registry.verifier().unwrap();
    let count = AtomicU64::new(0);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            loop {
                registry.publish().unwrap();
                registry.tidy(&|| false).unwrap();
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        for number in 1..=3_u8 {
            let (registry, log, count) = (&registry, &log, &count);
            scope.spawn(move || {
                loop {
                    let what = format!("{}/{}", std::process::id(), count.fetch_add(1, Ordering::Relaxed));
                    let receipt = submit(registry, &owner(number), "liberty", &what).unwrap();
                    let checkpoint = Checkpoint::verify(&receipt.checkpoint, log).unwrap();
                    let record = receipt.envelope.digest();
                    let line = format!("ack {} {record} {} {}\n", receipt.index, checkpoint.size, checkpoint.root);
                    // The reader gone means that the parent died: stop with it.
                    if std::io::stdout().lock().write_all(line.as_bytes()).is_err() {
                        std::process::exit(1);
                    }
                }
            });
        }
    });
}

fn parse(line: &str) -> Option<Acknowledged> {
    // The test harness may have begun the line with words of its own.
    let line = &line[line.find("ack ")?..];
    let mut words = line.strip_suffix('\n')?.split(' ').skip(1);
    let index = words.next()?.parse().ok()?;
    let record = words.next()?.parse().ok()?;
    let size = words.next()?.parse().ok()?;
    Some(Acknowledged { index, record, size, root: words.next()?.parse().ok()? })
}

/// Lets a child run until `wanted` acknowledgements and `further` time; kills it; gives all that it acknowledged.
fn run_and_kill(folder: &Path, wanted: usize, further: Duration) -> Vec<Acknowledged> {
    let test = "crash::what_was_acknowledged_survives_a_kill_at_any_moment";
    let mut child = Command::new(env::current_exe().unwrap())
        .args(["--exact", test, "--nocapture"])
        .env(CHILD, folder)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap());
    let mut acknowledged = Vec::new();
    let mut line = String::new();
    while acknowledged.len() < wanted {
        line.clear();
        assert_ne!(lines.read_line(&mut line).unwrap(), 0, "the child ended by itself");
        acknowledged.extend(parse(&line));
    }
    let moment = Instant::now() + further;
    while Instant::now() < moment {
        std::hint::spin_loop();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    loop {
        line.clear();
        if lines.read_line(&mut line).unwrap() == 0 {
            return acknowledged;
        }
        acknowledged.extend(parse(&line));
    }
}

#[test]
fn what_was_acknowledged_survives_a_kill_at_any_moment() {
    if let Some(folder) = env::var_os(CHILD) {
        return child(Path::new(&folder));
    }
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("log");
    std::fs::create_dir(&folder).unwrap();
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(20_261_121);
    let mut records: HashMap<u64, Digest> = HashMap::new();
    let mut roots: HashMap<u64, Digest> = HashMap::new();
    for round in 0..ROUNDS {
        let (wanted, micros) = (random.random_range(1..25), random.random_range(0..8000));
        for acknowledged in run_and_kill(&folder, wanted, Duration::from_micros(micros)) {
            let old = records.insert(acknowledged.index, acknowledged.record);
            assert_eq!(old, None, "round {round}: index {} was given twice", acknowledged.index);
            let root = roots.entry(acknowledged.size).or_insert(acknowledged.root);
            assert_eq!(*root, acknowledged.root, "round {round}: two roots of size {}", acknowledged.size);
        }
        let registry = Registry::open_anchored(&folder, registry_key(), ORIGIN, Some(anchor(&folder))).unwrap();
        let head = Checkpoint::verify(&registry.checkpoint(), &registry.verifier().unwrap()).unwrap();
        let faults = registry.check().unwrap();
        assert!(faults.is_empty(), "round {round}: {faults:?}");
        for (index, record) in &records {
            assert_eq!(registry.find(record).unwrap(), Some(*index), "round {round}");
            let proof = registry.prove_inclusion(*index, head.size).unwrap();
            let leaf_hash = registry.record(*index).unwrap().leaf.hash();
            merkle::verify_inclusion(&leaf_hash, *index, head.size, &proof, &head.root).unwrap();
        }
        for (size, root) in &roots {
            let proof = registry.prove_consistency(*size, head.size).unwrap();
            merkle::verify_consistency(*size, head.size, &proof, root, &head.root).unwrap();
        }
    }
    assert!(records.len() as u64 >= ROUNDS);
    let working = folder.join("working");
    assert_ne!(std::fs::read_dir(working.join("runs")).unwrap().count(), 0, "no row ever moved");
    // And all of it is there still where the working state is lost as well.
    std::fs::remove_dir_all(working).unwrap();
    let rebuilt = Registry::rebuild(&folder, &registry_key(), ORIGIN, &mut |_, _| {}).unwrap();
    let anchored = Some(anchor(&folder));
    let registry = Registry::open_anchored(&folder, registry_key(), ORIGIN, anchored).unwrap();
    assert_eq!(registry.size(), rebuilt.size);
    assert!(records.iter().all(|(index, record)| registry.find(record).unwrap() == Some(*index)));
}
