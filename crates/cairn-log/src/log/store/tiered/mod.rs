//! A store that stays small: rows that only accumulate move out of it into sorted runs, plain files that never change
//! (a log-structured merge-tree, O'Neil et al. 1996, whose write-ahead log is the store).
//!
//! A log of ten million records has tens of millions of rows about them: where a record is, what the map lists. In sled
//! each took some five hundred bytes, every start read a table of all pages, and every batch rewrote pages all over
//! the file. Here they wait in memory, and in the store as they came ([`recent`]), until they are enough for a run. Runs
//! are written once, in order, and read by block; merging four of a level into one of the next keeps them few.
//! A small log never has one.
//!
//! Nothing about durability changes: a row is in the store first, in one write with all else of its batch. In one write, too,
//! the store's row about a new run ([`manifest`]) comes and the rows' journal goes. A crash before that leaves a file
//! that nothing names.

mod filter;
mod format;
mod manifest;
mod merge;
mod reader;
mod recent;
mod writer;

use std::{
    cmp::Reverse,
    ops::Bound,
    sync::{Arc, Mutex, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard},
};

use self::{
    format::RESTORE,
    manifest::{Manifest, RunInfo},
    merge::{Merge, Sorted},
    reader::Run,
    recent::Recent,
    writer::RunWriter,
};
use super::{Change, Entry, Store, StoreError, successor};
use cairn_durable::Files;

use crate::format::digest::Digest;

/// The row of the store that holds the [`Manifest`].
const MANIFEST: &[u8] = b"runs";
/// Runs of a level that become one of the next.
const FAN: usize = 4;
/// Rows between two questions whether to stop.
const ASKED_EVERY: usize = 4096;

/// Rows that move into runs: those whose keys begin with a prefix. They may be written again, but not taken away.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cold {
    /// What their keys begin with.
    pub prefix: &'static [u8],
    /// Whether single keys are looked up, most of them in vain: these are in the runs' filters, and MUST end in 16 bytes that
    /// are as good as random.
    pub looked_up: bool,
}

/// A file whose bytes never change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KnownFile {
    /// Where it is, as the store's files name it.
    pub path: String,
    /// Bytes.
    pub size: u64,
    /// Digest of all of them, from when they were written.
    pub sha256: Digest,
}

/// A store and its runs.
pub struct TieredStore {
    hot: Box<dyn Store>,
    files: Arc<Files>,
    folder: &'static str,
    cold: &'static [Cold],
    /// Rows in memory from which on a run is begun.
    enough: usize,
    state: RwLock<State>,
    /// The next journal entry. Held while the store is written to, so that entries are numbered as batches come.
    next_entry: Mutex<u64>,
    /// The next run. Never given twice: whether the manifest of a failed attempt is in the store is unknown.
    next_run: Mutex<u64>,
    tidying: Mutex<()>,
    /// What went wrong in the store while rows were moved: then it is unknown what it holds, as after any failed write.
    broken: OnceLock<StoreError>,
}

/// What readers see at one moment, newest first.
struct State {
    recent: Recent,
    /// On their way into a run.
    leaving: Option<Arc<Recent>>,
    levels: Arc<Levels>,
}

struct Levels {
    manifest: Manifest,
    /// Newest first.
    runs: Vec<Arc<Run>>,
}

impl TieredStore {
    /// The store `hot` with its runs in `folder` of `files`. Rows that `cold` names move once there are `enough` of them.
    ///
    /// # Errors
    /// [`StoreError`] names a run that is missing or damaged.
    pub fn open(
        hot: Box<dyn Store>,
        files: Arc<Files>,
        folder: &'static str,
        cold: &'static [Cold],
        enough: usize,
    ) -> Result<Self, StoreError> {
        let manifest = match hot.get(MANIFEST)? {
            None => Manifest::default(),
            Some(bytes) => Manifest::decode(&bytes).ok_or_else(|| {
                let cause = format!("the list of sorted runs is damaged or of another version; {RESTORE}");
                StoreError::new("open", folder, cause)
            })?,
        };
        let runs = manifest.runs.iter().map(|run| Ok(Arc::new(Run::open(&files, path_of(folder, run.number), *run)?)));
        let runs = runs.collect::<Result<_, StoreError>>()?;
        // The list of runs may be read back and not be durable yet: the one before it names files that go now.
        if !manifest.replaced.is_empty() {
            hot.flush()?;
        }
        // Left over by a crash: merged runs, and one that was finished and never named.
        for number in manifest.replaced.iter().chain([&manifest.next]) {
            files.remove(&path_of(folder, *number))?;
            files.discard(&path_of(folder, *number))?;
        }
        let (recent, next_entry) = Recent::load(hot.as_ref())?;
        let next_run = Mutex::new(manifest.next);
        let levels = Arc::new(Levels { manifest, runs });
        Ok(Self {
            hot,
            files,
            folder,
            cold,
            enough: enough.max(1),
            state: RwLock::new(State { recent, leaving: None, levels }),
            next_entry: Mutex::new(next_entry),
            next_run,
            tidying: Mutex::new(()),
            broken: OnceLock::new(),
        })
    }

    fn cold_of(&self, key: &[u8]) -> Option<&Cold> {
        self.cold.iter().find(|cold| key.starts_with(cold.prefix))
    }

    fn read(&self) -> RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, State> {
        self.state.write().unwrap_or_else(PoisonError::into_inner)
    }

    fn sound(&self) -> Result<(), StoreError> {
        self.broken.get().map_or(Ok(()), |e| Err(e.clone()))
    }

    /// Cold rows of a batch, and the rest of it.
    fn part(&self, batch: Vec<Change>) -> Result<(Vec<Entry>, Vec<Change>), StoreError> {
        let (mut cold, mut hot) = (Vec::new(), Vec::new());
        for (key, value) in batch {
            let refuse = |cause| StoreError::new("put", format!("{key:02x?}"), cause);
            if self.cold_of(&key).is_none() {
                hot.push((key, value));
                continue;
            }
            let Some(value) = value else { return Err(refuse("rows of this kind are not taken away")) };
            if u16::try_from(key.len()).is_err() || u32::try_from(value.len()).is_err() {
                return Err(refuse("a key of more than 64 KiB, or a value of more than 4 GiB"));
            }
            cold.push((key, value));
        }
        Ok((cold, hot))
    }

    /// Moves rows into a new run, if there are enough, or if an earlier attempt did not come to its end.
    fn move_out(&self, stop: &dyn Fn() -> bool) -> Result<(), StoreError> {
        let (leaving, levels) = {
            let state = &mut *self.write();
            if state.leaving.is_none() && state.recent.rows.len() >= self.enough {
                state.leaving = Some(Arc::new(std::mem::take(&mut state.recent)));
            }
            (state.leaving.clone(), state.levels.clone())
        };
        let Some(leaving) = leaving else { return Ok(()) };
        let filtered = leaving.rows.keys().filter(|key| self.is_looked_up(key)).count() as u64;
        let rows = Box::new(leaving.rows.iter().map(|(key, value)| Ok((key.clone(), value.clone()))));
        let Some(run) = self.write_run(Merge::new(vec![rows])?, filtered, 0, stop)? else { return Ok(()) };
        let runs = [&[run], levels.manifest.runs.as_slice()].concat();
        self.adopt(runs, leaving.forgotten().collect(), true)
    }

    fn is_looked_up(&self, key: &[u8]) -> bool {
        self.cold_of(key).is_some_and(|cold| cold.looked_up)
    }

    /// Merges runs until no level has as many as make one of the next.
    fn compact(&self, stop: &dyn Fn() -> bool) -> Result<(), StoreError> {
        loop {
            let levels = self.read().levels.clone();
            let mut runs = levels.manifest.runs.clone();
            let Some((first, level)) = due(&runs) else { return Ok(()) };
            let parts = &levels.runs[first..first + FAN];
            let sources = parts.iter().map(|run| Box::new(run.rows_from(&[])) as Sorted<'_>).collect();
            let filtered = parts.iter().map(|run| run.info.filtered).sum();
            let Some(run) = self.write_run(Merge::new(sources)?, filtered, level + 1, stop)? else { return Ok(()) };
            runs.splice(first..first + FAN, [run]);
            self.adopt(runs, Vec::new(), false)?;
        }
    }

    /// Writes a run; none where that was stopped.
    fn write_run(
        &self,
        rows: Merge<'_>,
        filtered: u64,
        level: u8,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<RunInfo>, StoreError> {
        let number = {
            let mut next = self.next_run.lock().unwrap_or_else(PoisonError::into_inner);
            *next += 1;
            *next - 1
        };
        let mut run = RunWriter::new(&self.files, path_of(self.folder, number), filtered);
        for (at, row) in rows.enumerate() {
            if at.is_multiple_of(ASKED_EVERY) && stop() {
                return Ok(None);
            }
            let (key, value) = row?;
            run.push(&key, &value, self.is_looked_up(&key))?;
        }
        run.finish(number, level).map(Some)
    }

    /// Makes a list of runs durable, in one write with `changes`, and from then on the one that counts. Where rows have
    /// `left` for the newest of them, these are not kept in memory any more.
    fn adopt(&self, runs: Vec<RunInfo>, mut changes: Vec<Change>, left: bool) -> Result<(), StoreError> {
        let before = self.read().levels.clone();
        let next = *self.next_run.lock().unwrap_or_else(PoisonError::into_inner);
        // Merged into others, or written by an attempt that failed before it could name them.
        let merged = before.manifest.runs.iter().map(|run| run.number);
        let replaced = merged.chain(before.manifest.next..next);
        let replaced = replaced.filter(|number| runs.iter().all(|run| run.number != *number)).collect();
        let manifest = Manifest { next, runs, replaced };
        let open = |info: &RunInfo| match before.runs.iter().find(|run| run.info == *info) {
            Some(run) => Ok(run.clone()),
            None => Run::open(&self.files, path_of(self.folder, info.number), *info).map(Arc::new),
        };
        let runs = manifest.runs.iter().map(open).collect::<Result<_, StoreError>>()?;
        // Those of the list before are gone, or go now: the new list names others.
        self.remove(&before.manifest.replaced)?;
        changes.push((MANIFEST.to_vec(), Some(manifest.encode())));
        let written = self.hot.put(changes).and_then(|()| self.hot.flush());
        written.inspect_err(|e| drop(self.broken.set(e.clone())))?;
        let replaced = manifest.replaced.clone();
        {
            let mut state = self.write();
            state.levels = Arc::new(Levels { manifest, runs });
            if left {
                state.leaving = None;
            }
        }
        // Whoever still reads them has them open.
        self.remove(&replaced)
    }

    fn remove(&self, runs: &[u64]) -> Result<(), StoreError> {
        runs.iter().map(|number| path_of(self.folder, *number)).try_for_each(|path| {
            self.files.remove(&path)?;
            Ok(self.files.discard(&path)?)
        })
    }
}

impl Store for TieredStore {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(cold) = self.cold_of(key) else { return self.hot.get(key) };
        let levels = {
            let state = self.read();
            let leaving = || state.leaving.as_ref()?.rows.get(key);
            if let Some(value) = state.recent.rows.get(key).or_else(leaving) {
                return Ok(Some(value.clone()));
            }
            state.levels.clone()
        };
        for run in levels.runs.iter().filter(|run| !cold.looked_up || run.may_hold(key)) {
            if let Some(value) = run.get(key)? {
                return Ok(Some(value));
            }
        }
        Ok(None)
    }

    fn put(&self, batch: Vec<Change>) -> Result<(), StoreError> {
        self.sound()?;
        let (cold, mut hot) = self.part(batch)?;
        let mut next = self.next_entry.lock().unwrap_or_else(PoisonError::into_inner);
        let (entries, numbers) = recent::entries_of(&cold, &mut next);
        hot.extend(entries);
        // A journal entry that may be there and is nobody's would come back over newer rows at the next start.
        self.hot.put(hot).inspect_err(|e| drop((!numbers.is_empty()).then(|| self.broken.set(e.clone()))))?;
        self.write().recent.add(cold, numbers);
        Ok(())
    }

    fn flush(&self) -> Result<(), StoreError> {
        self.sound()?;
        self.hot.flush()
    }

    fn range(&self, from: &[u8], to: Option<&[u8]>, limit: usize) -> Result<Vec<Entry>, StoreError> {
        let reaches = |cold: &Cold| {
            to.is_none_or(|to| cold.prefix < to) && successor(cold.prefix).is_none_or(|end| from < end.as_slice())
        };
        if !self.cold.iter().any(reaches) {
            return self.hot.range(from, to, limit);
        }
        if to.is_some_and(|to| to <= from) {
            return Ok(Vec::new());
        }
        let within = (Bound::Included(from), to.map_or(Bound::Unbounded, Bound::Excluded));
        let of = |recent: &Recent| -> Sorted<'static> {
            let rows = recent.rows.range::<[u8], _>(within).take(limit);
            Box::new(rows.map(|(key, value)| Ok((key.clone(), value.clone()))).collect::<Vec<_>>().into_iter())
        };
        let (mut sources, levels) = {
            let state = self.read();
            let recent: Vec<_> = [&state.recent].into_iter().chain(state.leaving.as_deref()).map(of).collect();
            (recent, state.levels.clone())
        };
        // A range within the cold rows, as all but a few are, has nothing in the store.
        let holds = |cold: &Cold| match (to, successor(cold.prefix)) {
            (Some(to), Some(end)) => from.starts_with(cold.prefix) && to <= end.as_slice(),
            (_, end) => from.starts_with(cold.prefix) && end.is_none(),
        };
        if !self.cold.iter().any(holds) {
            sources.push(Box::new(self.hot.range(from, to, limit)?.into_iter().map(Ok)));
        }
        sources.extend(levels.runs.iter().map(|run| Box::new(run.rows_from(from)) as Sorted<'_>));
        let within = |row: &Result<Entry, StoreError>| match (row, to) {
            (Ok((key, _)), Some(to)) => key.as_slice() < to,
            _ => true,
        };
        Merge::new(sources)?.take_while(within).take(limit).collect()
    }

    fn tidy(&self, stop: &dyn Fn() -> bool) -> Result<(), StoreError> {
        let _one_at_a_time = self.tidying.lock().unwrap_or_else(PoisonError::into_inner);
        self.sound()?;
        self.move_out(stop)?;
        self.compact(stop)
    }

    fn known_files(&self) -> Vec<KnownFile> {
        let known =
            |run: &RunInfo| KnownFile { path: path_of(self.folder, run.number), size: run.size, sha256: run.sha256 };
        self.read().levels.manifest.runs.iter().map(known).collect()
    }
}

/// The first of as many neighbouring runs of a level as make one of the next, and the level: of the lowest level, and there
/// the oldest, so that levels go on ascending with age.
fn due(runs: &[RunInfo]) -> Option<(usize, u8)> {
    let windows = runs.windows(FAN).enumerate();
    let alike = windows.filter(|(_, window)| window.iter().all(|run| run.level == window[0].level));
    let (at, window) = alike.min_by_key(|(at, window)| (window[0].level, Reverse(*at)))?;
    Some((at, window[0].level))
}

fn path_of(folder: &str, number: u64) -> String {
    format!("{folder}/{number:08}")
}
