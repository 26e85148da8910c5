//! Every write, sync and rename fails in turn, with and without a power cut behind it: afterwards no size was
//! cosigned with two roots, and no cosignature went back.

use std::{
    collections::BTreeMap,
    io,
    path::Path,
    sync::{Arc, Mutex},
};

use crate::witness_common::{Hands, Log, ORIGIN, ask, log_verifier, over};
use cairn_durable::{DurableError, OpenFile};
use cairn_log::witness::{AddCheckpoint, Response, Witness};
use cairn_log::{Checkpoint, Digest, Note};

/// What a failing step did all the same.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    /// Nothing.
    Nothing,
    /// Half of it, where it can be halved.
    Half,
    /// All of it: only the report is wrong.
    All,
}

/// What is left behind a power cut.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cut {
    None,
    /// Only what was synced.
    Synced,
    /// Names that were not synced as well, but of files only what was.
    Names,
}

#[derive(Clone, Default)]
struct File {
    bytes: Vec<u8>,
    synced: Option<Vec<u8>>,
}

/// A disk that keeps names and bytes apart, and what is in memory from what would survive.
#[derive(Clone, Default)]
struct Disk {
    files: Vec<File>,
    names: BTreeMap<String, usize>,
    synced_names: BTreeMap<String, usize>,
    steps: usize,
    fails: Option<(usize, Fault)>,
    failed: bool,
}

impl Disk {
    /// Counts a step; says how much of it is to be done where it fails.
    fn step(&mut self) -> Option<Fault> {
        let fault = self.fails.filter(|(at, _)| *at == self.steps).map(|(_, fault)| fault);
        self.steps += 1;
        self.failed |= fault.is_some();
        fault
    }

    fn survived(&self, cut: Cut) -> Self {
        let names = match cut {
            Cut::None => return Self { fails: None, ..self.clone() },
            Cut::Synced => &self.synced_names,
            Cut::Names => &self.names,
        };
        let left = |file: &File| {
            // Never synced: some of it may be there.
            let bytes = file.synced.clone().unwrap_or_else(|| file.bytes[..file.bytes.len() / 3].to_vec());
            File { synced: Some(bytes.clone()), bytes }
        };
        let files = self.files.iter().map(left).collect();
        Self { files, names: names.clone(), synced_names: names.clone(), ..Self::default() }
    }
}

#[derive(Clone, Default)]
struct Double(Arc<Mutex<Disk>>);

fn done(fault: Option<Fault>) -> Result<(), DurableError> {
    let injected = |fault| io::Error::other(format!("injected: {fault:?} done"));
    fault.map_or(Ok(()), |fault| Err(DurableError::io("write", Path::new("memory"))(injected(fault))))
}

impl cairn_durable::Disk for Double {
    fn read(&self, name: &str, _: u64) -> Result<Option<Vec<u8>>, DurableError> {
        let disk = self.0.lock().unwrap();
        Ok(disk.names.get(name).map(|at| disk.files[*at].bytes.clone()))
    }

    fn open(&self, _: &str) -> Result<Option<Box<dyn OpenFile>>, DurableError> {
        unreachable!("a witness reads whole files")
    }

    fn remove(&self, _: &str) -> Result<(), DurableError> {
        unreachable!("a witness removes nothing")
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, DurableError> {
        let disk = self.0.lock().unwrap();
        Ok(disk.names.keys().filter_map(|n| n.strip_prefix(&format!("{folder}/")).map(str::to_owned)).collect())
    }

    fn write(&self, name: &str, offset: u64, bytes: &[u8]) -> Result<(), DurableError> {
        assert_eq!(offset, 0);
        let mut disk = self.0.lock().unwrap();
        let fault = disk.step();
        let bytes = match fault {
            Some(Fault::Nothing) => return done(fault),
            Some(Fault::Half) => &bytes[..bytes.len() / 2],
            _ => bytes,
        };
        let next = disk.files.len();
        let at = *disk.names.entry(name.to_owned()).or_insert(next);
        if at == next {
            disk.files.push(File::default());
        }
        disk.files[at].bytes = bytes.to_vec();
        done(fault)
    }

    fn sync(&self, name: &str) -> Result<(), DurableError> {
        let mut disk = self.0.lock().unwrap();
        let fault = disk.step();
        let at = disk.names[name];
        let bytes = disk.files[at].bytes.clone();
        match fault {
            Some(Fault::Nothing) => {}
            Some(Fault::Half) => disk.files[at].synced = Some(bytes[..bytes.len() / 2].to_vec()),
            _ => disk.files[at].synced = Some(bytes),
        }
        done(fault)
    }

    fn rename(&self, from: &str, to: &str) -> Result<(), DurableError> {
        let mut disk = self.0.lock().unwrap();
        let fault = disk.step();
        if matches!(fault, None | Some(Fault::All)) {
            let at = disk.names.remove(from).unwrap();
            disk.names.insert(to.to_owned(), at);
        }
        done(fault)
    }

    fn sync_folder(&self, _: &str) -> Result<(), DurableError> {
        let mut disk = self.0.lock().unwrap();
        let fault = disk.step();
        if matches!(fault, None | Some(Fault::All)) {
            disk.synced_names = disk.names.clone();
        }
        done(fault)
    }
}

/// Everything that was cosigned, in order; two histories that part after three leaves.
struct Record {
    histories: [Log; 2],
    cosigned: Vec<(u64, Digest)>,
}

impl Record {
    fn ask(&mut self, witness: &Witness, history: usize, old: u64, size: u64) -> Response {
        let request: AddCheckpoint = self.histories[history].request(old, size);
        let answer = ask(witness, &request);
        if answer.status == 200 {
            crate::witness_common::cosignature(witness, &request, &answer);
            let root = Checkpoint::parse_text(&Note::parse(&request.note).unwrap().text).unwrap().root;
            self.cosigned.push((size, root));
        }
        answer
    }

    /// As a client does: once more from the size that the witness names.
    fn ask_again(&mut self, witness: &Witness, history: usize, size: u64) -> u16 {
        let told = self.ask(witness, history, 0, size);
        if told.status != 409 {
            return told.status;
        }
        let old: u64 = told.body.trim().parse().unwrap();
        self.ask(witness, history, old.min(size), size).status
    }

    fn one_history(&self, case: &str) {
        for pair in self.cosigned.windows(2) {
            assert!(pair[0].0 <= pair[1].0, "{case}: went back from {} to {}", pair[0].0, pair[1].0);
        }
        let whole = |log: &Log| self.cosigned.iter().all(|(size, root)| log.root(*size) == *root);
        assert!(self.histories.iter().any(whole), "{case}: cosigned two histories: {:?}", self.cosigned);
    }
}

/// One life: growth, a fault somewhere, a fork at once and after a restart.
fn live(fails: Option<(usize, Fault)>, cut: Cut) -> (usize, bool, Vec<u16>) {
    let case = format!("{fails:?}, cut {cut:?}");
    let hands = Hands::new();
    let storage = Double::default();
    storage.0.lock().unwrap().fails = fails;
    let mut record = Record { histories: [Log::new(3, 1), Log::new(3, 2)], cosigned: Vec::new() };
    let mut witness = over(Box::new(storage.clone()), &hands).unwrap();
    let mut statuses = Vec::new();
    let mut cut_yet = cut == Cut::None;
    let mut storage = storage;
    let mut steps = 0;
    for (history, old, size) in [(0, 0, 2), (0, 2, 3), (0, 3, 5), (1, 3, 5), (1, 5, 5), (0, 5, 6), (1, 3, 6), (0, 6, 9)]
    {
        statuses.push(record.ask(&witness, history, old, size).status);
        if storage.0.lock().unwrap().failed && !cut_yet {
            cut_yet = true;
            let left = storage.0.lock().unwrap().survived(cut);
            steps += storage.0.lock().unwrap().steps;
            drop(witness);
            storage = Double(Arc::new(Mutex::new(left)));
            witness = over(Box::new(storage.clone()), &hands).unwrap_or_else(|e| panic!("{case}: {e}"));
            // The fork tries its luck first.
            statuses.push(record.ask_again(&witness, 1, size));
            statuses.push(record.ask_again(&witness, 0, size));
        }
    }
    // It is not stuck: one of the histories goes on.
    let ends = [(0, 20), (1, 21), (0, 22)].map(|(history, size)| record.ask_again(&witness, history, size));
    assert!(ends.contains(&200), "{case}: {statuses:?} {ends:?}");
    record.one_history(&case);
    let failed = statuses.contains(&500);
    let kept = over(Box::new(Double(Arc::new(Mutex::new(storage.0.lock().unwrap().survived(Cut::Synced))))), &hands);
    let kept = kept.unwrap_or_else(|e| panic!("{case}: {e}")).latest(&Digest::of(ORIGIN)).unwrap();
    let kept = Checkpoint::verify(&kept, &log_verifier()).unwrap();
    // What left was durable; a checkpoint that was about to be cosigned may be there in its place.
    record.cosigned.push((kept.size, kept.root));
    record.one_history(&case);
    let steps = steps + storage.0.lock().unwrap().steps;
    (steps, failed, statuses)
}

#[test]
fn whatever_fails_nothing_is_cosigned_twice() {
    let (steps, failed, statuses) = live(None, Cut::None);
    assert!(!failed);
    assert_eq!(statuses, [200, 200, 200, 409, 409, 200, 409, 200]);
    assert!(steps >= 4 * 6, "only {steps} steps");
    let mut refused = 0;
    for at in 0..steps {
        for fault in [Fault::Nothing, Fault::Half, Fault::All] {
            for cut in [Cut::None, Cut::Synced, Cut::Names] {
                refused += usize::from(live(Some((at, fault)), cut).1);
            }
        }
    }
    // A fault while evidence is kept refuses nothing; all the others do.
    assert!(refused >= 9 * 4 * 5, "only {refused} lives saw a fault");
}

#[test]
fn after_a_failure_the_file_decides() {
    let (log, hands, storage) = (Log::new(40, 0), Hands::new(), Double::default());
    let witness = over(Box::new(storage.clone()), &hands).unwrap();
    let fail_next = |at: usize| {
        let mut disk = storage.0.lock().unwrap();
        disk.fails = Some((disk.steps + at, Fault::All));
    };
    assert_eq!(ask(&witness, &log.request(0, 4)).status, 200);
    // The folder's sync reports a failure: the new file is there, though nothing left.
    fail_next(3);
    assert_eq!(ask(&witness, &log.request(4, 6)).status, 500);
    let answer = ask(&witness, &log.request(4, 7));
    assert_eq!((answer.status, answer.body.as_str()), (409, "6\n"));
    assert_eq!(ask(&witness, &log.request(6, 7)).status, 200);
    // A file that has gone back meanwhile is not believed.
    let old = storage.0.lock().unwrap().clone();
    assert_eq!(ask(&witness, &log.request(7, 9)).status, 200);
    fail_next(0);
    assert_eq!(ask(&witness, &log.request(9, 10)).status, 500);
    *storage.0.lock().unwrap() = old;
    for _ in 0..2 {
        assert_eq!(ask(&witness, &log.request(7, 8)).status, 500);
    }
}
