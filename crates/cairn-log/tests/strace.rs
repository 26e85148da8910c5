//! The kernel refuses: `strace` makes system calls of a submitting process fail, one a run, each kind in turn. Whatever the
//! process made of it, the log must open afterwards, hold what was acknowledged, honour what was signed, and take the
//! record that failed.
//!
//! The store trait's failing double (faults.rs) tries every operation; this tries what lies below the trait.
#![cfg(all(feature = "store", target_os = "linux"))]

use std::{
    collections::HashMap,
    env, fs,
    os::unix::process::CommandExt,
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use crate::common::*;
use cairn_log::{Checkpoint, Digest, Envelope, Registry, RegistryError, format::merkle};

const TEST: &str = "strace::a_system_call_that_fails_loses_nothing_that_was_acknowledged";
const CHILD: &str = "CAIRN_STRACE_CHILD";

/// Records that the child submits, one after the other.
const RECORDS: usize = 4;

/// Calls that write or make durable, and how many runs each gets at most, spread over all its calls; where
/// `CAIRN_FUZZ_CASES` asks for more than usual, every call has its turn.
const CALLS: [(&str, usize); 9] = [
    ("fsync", 8),
    ("fdatasync", 4),
    ("sync_file_range", 4),
    ("pwrite64", 8),
    ("write", 6),
    ("ftruncate", 3),
    ("rename", 4),
    ("renameat2", 4),
    ("openat", 8),
];

/// Submits; one line an acknowledgement, and the envelope of the first record that failed.
fn child(folder: &Path) {
    let registry = Registry::open(&folder.join("log"), registry_key(), ORIGIN).unwrap();
    for count in 0..RECORDS {
        let envelope = sealed(&registry, &owner(1), "liberty", &count.to_string());
        fs::write(folder.join("tried.json"), envelope.to_json()).unwrap();
        let receipt = take(&registry, &envelope).unwrap();
        let note = receipt.checkpoint.replace('\n', "|");
        // In one call, so that no acknowledgement is half a line.
        println!("ack {} {} {note}", receipt.index, receipt.envelope.digest());
    }
}

/// What the child acknowledged: index, digest, signed checkpoint.
fn acknowledged(said: &str) -> Vec<(u64, Digest, String)> {
    let parse = |line: &str| {
        let mut words = line[line.find("ack ")?..].splitn(4, ' ').skip(1);
        let (index, digest) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
        Some((index, digest, words.next()?.replace('|', "\n")))
    };
    said.lines().filter_map(parse).collect()
}

/// Long past what a child takes. Where two of sled's threads fail to write at once, sled 0.34 may wait for them for
/// ever; what such a process leaves behind when it is killed must be as good.
const HUNG: Duration = Duration::from_secs(60);

/// Runs the child under strace with these options, and kills it where it hangs; what it printed.
fn run(folder: &Path, options: &[&str]) -> String {
    let printed = folder.join("printed");
    let mut tracer = Command::new("strace")
        .args(["-f", "-qq", "-o"])
        .arg(folder.join("trace"))
        .args(options)
        .arg(env::current_exe().unwrap())
        .args(["--exact", TEST, "--nocapture", "--test-threads=1"])
        .env(CHILD, folder)
        .env("RUST_BACKTRACE", "0")
        .stdout(fs::File::create(&printed).unwrap())
        .stderr(Stdio::null())
        // A group of their own: the child would outlive a tracer that is killed alone.
        .process_group(0)
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while tracer.try_wait().unwrap().is_none() {
        if begun.elapsed() > HUNG {
            println!("hung and killed: {options:?}");
            Command::new("kill").args(["-9", "--", &format!("-{}", tracer.id())]).status().unwrap();
            tracer.wait().unwrap();
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    String::from_utf8_lossy(&fs::read(printed).unwrap()).into_owned()
}

/// Whether strace is there and may trace.
fn can_trace() -> bool {
    let tried = Command::new("strace").args(["-f", "-qq", "-o", "/dev/null", "-e", "trace=fsync", "true"]).output();
    tried.is_ok_and(|output| output.status.success())
}

/// How often each call is made where nothing fails, by the thread that makes it most: strace counts by thread as well.
fn count_calls() -> Vec<usize> {
    let folder = tempfile::tempdir().unwrap();
    let names: Vec<_> = CALLS.iter().map(|(call, _)| format!("?{call}")).collect();
    let said = run(folder.path(), &["-e", &format!("trace={}", names.join(","))]);
    assert_eq!(acknowledged(&said).len(), RECORDS, "{said}");
    let trace = fs::read_to_string(folder.path().join("trace")).unwrap();
    let most = |call: &str| {
        let mut threads = HashMap::new();
        for line in trace.lines() {
            let Some((thread, made)) = line.split_once(' ') else { continue };
            if made.trim_start().starts_with(&format!("{call}(")) {
                *threads.entry(thread).or_insert(0) += 1;
            }
        }
        threads.into_values().max().unwrap_or(0)
    };
    CALLS.iter().map(|(call, _)| most(call)).collect()
}

/// Opens the log again. A child that was killed with its tracer is not ours to wait for, and holds the log until the
/// kernel is done with it.
fn reopened(folder: &Path) -> Result<Registry, RegistryError> {
    let begun = Instant::now();
    loop {
        match Registry::open(&folder.join("log"), registry_key(), ORIGIN) {
            Err(RegistryError::Locked { .. }) if begun.elapsed() < HUNG => std::thread::sleep(Duration::from_millis(5)),
            opened => return opened,
        }
    }
}

/// Everything that must hold after the run, whatever failed in it.
fn must_honour(folder: &Path, said: &str, what: &str) {
    let registry = reopened(folder).unwrap_or_else(|e| panic!("{what}: the log does not open again: {e}"));
    let log = registry.verifier().unwrap();
    let head = Checkpoint::verify(&registry.checkpoint(), &log).unwrap();
    for (index, digest, note) in acknowledged(said) {
        assert_eq!(registry.find(&digest).unwrap(), Some(index), "{what}: record {index} was acknowledged");
        let seen = Checkpoint::verify(&note, &log).unwrap();
        let proof = registry.prove_consistency(seen.size, head.size).unwrap();
        merkle::verify_consistency(seen.size, head.size, &proof, &seen.root, &head.root)
            .unwrap_or_else(|e| panic!("{what}: a signed checkpoint is not honoured: {e}"));
    }
    let faults = registry.check().unwrap();
    assert!(faults.is_empty(), "{what}: {faults:?}");
    // The submitter asks again, and there is one record of it.
    let tried = fs::read(folder.join("tried.json")).ok().and_then(|json| Envelope::parse(&json).ok());
    if let Some(envelope) = tried {
        let receipt = take(&registry, &envelope).unwrap_or_else(|e| panic!("{what}: the retry: {e}"));
        verify_receipt(&registry, &receipt);
    }
    let records = records(&registry, None);
    let digests: std::collections::HashSet<_> = records.iter().map(|r| r.leaf.record).collect();
    assert_eq!(digests.len(), records.len(), "{what}: a record twice");
}

#[test]
fn a_system_call_that_fails_loses_nothing_that_was_acknowledged() {
    if let Some(folder) = env::var_os(CHILD) {
        return child(Path::new(&folder));
    }
    if !can_trace() {
        println!("SKIPPED {TEST}: no strace here that may trace");
        return;
    }
    let counts = count_calls();
    println!("{:?}", CALLS.iter().map(|(call, _)| *call).zip(&counts).collect::<Vec<_>>());
    let (mut runs, mut hurt) = (0, 0);
    let all = cairn_testkit::cases() > cairn_testkit::CASES;
    for ((call, most), count) in CALLS.iter().zip(counts) {
        let turns = if all { count } else { count.min(*most) };
        for turn in 0..turns {
            // From the last call backwards: a process's first calls are its loader's.
            let nth = count - turn * count / turns;
            let error = if runs % 4 == 0 { "ENOSPC" } else { "EIO" };
            let folder = tempfile::tempdir().unwrap();
            let inject = format!("inject={call}:error={error}:when={nth}");
            let said = run(folder.path(), &["-e", &format!("trace={call}"), "-e", &inject]);
            must_honour(folder.path(), &said, &format!("{error} from {call} number {nth}"));
            runs += 1;
            hurt += usize::from(acknowledged(&said).len() < RECORDS);
        }
    }
    println!("{runs} runs, {hurt} of them lost their submitter to the fault");
    assert!(runs >= 10 && hurt >= 5, "{runs} runs, {hurt} noticed: the faults hit nothing");
}
