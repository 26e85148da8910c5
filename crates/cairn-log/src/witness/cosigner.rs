//! The witness itself, without any network: checks a checkpoint, remembers it, cosigns it.
//!
//! Contract. The checkpoint MUST be durable before its cosignature leaves, and checking and remembering are one step
//! under the log's lock (C2SP tlog-witness, "add-checkpoint", the race at its end). When writing fails, nobody knows what the
//! disk holds, the old checkpoint or the new one; both are safe, since the new one was not cosigned. The file is
//! then read again before anything else is decided, and must not have gone back behind what was cosigned.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{SystemTime, UNIX_EPOCH},
};

use cairn_durable::{Disk, Files, LockFile, RealDisk, make_folders, sync_folder};

use crate::format::{
    checkpoint::Checkpoint,
    cosignature::{CosignatureError, WitnessVerifier, cosign},
    digest::Digest,
    key::OwnerKey,
    merkle::{empty_root, verify_consistency},
    note::{Note, NoteError, NoteVerifier},
};

use crate::witness::{
    evidence::{Contradiction, EVIDENCE, Evidence, Kind},
    request::{AddCheckpoint, RequestError},
    state::{LOGS, Remembered, path_of},
};

/// Content type of an answer that is a size (409).
pub const SIZE_TYPE: &str = "text/x.tlog.size";
const TEXT_TYPE: &str = "text/plain; charset=utf-8";

/// Longest answer for people, characters.
const MAX_TEXT: usize = 400;

/// How far the clock may step back, seconds: it is then held at the last cosignature's time. Further, and nothing is cosigned.
const MAX_STEP_BACK_S: u64 = 60;

/// Largest file that is read, bytes; the files hold notes of limited size.
const MAX_FILE_BYTES: u64 = 4 << 20;

/// Tells the time, Unix seconds.
pub type Clock = Box<dyn Fn() -> u64 + Send + Sync>;

/// An answer, for whatever carries it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// HTTP status.
    pub status: u16,
    /// Content type.
    pub content_type: &'static str,
    /// Body: signature lines (200), a size (409), or what is wrong, for people.
    pub body: String,
}

/// Why a witness does not start.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Its name.
    #[error(transparent)]
    Name(#[from] NoteError),
    /// Nothing to watch.
    #[error("a witness of no log; name at least one log's vkey")]
    NoLogs,
    /// One key for two roles: a log could pass the witness's cosignatures off as its own signatures.
    #[error("log {origin:?} signs with this witness's own key; a witness needs a key that nobody else uses")]
    OwnKey {
        /// The log.
        origin: String,
    },
    /// What it remembers cannot be read. It does not start without: it would cosign a second history.
    #[error("witness's memory: {file}: {what}")]
    Memory {
        /// Which file or folder.
        file: String,
        /// What is wrong.
        what: String,
    },
}

struct Log {
    keys: Vec<NoteVerifier>,
    memory: Mutex<Memory>,
}

struct Memory {
    /// What was cosigned last.
    newest: Option<Remembered>,
    /// Whether the file may hold something newer, since writing it did not end well.
    doubtful: bool,
}

/// A witness over its folder, `Send` and `Sync`. Its calls block on the disk.
pub struct Witness {
    key: OwnerKey,
    verifier: WitnessVerifier,
    logs: BTreeMap<String, Log>,
    evidence: Evidence,
    storage: Files,
    clock: Clock,
    _lock: Option<LockFile>,
}

impl Witness {
    /// A witness called `name` over the folder `path`, for the logs whose vkeys are given; several of one origin are all good.
    ///
    /// # Errors
    /// [`OpenError`]; a folder that is held, was another witness's or cannot be read is [`OpenError::Memory`].
    pub fn open(path: &Path, name: &str, key: OwnerKey, logs: Vec<NoteVerifier>) -> Result<Self, OpenError> {
        let clock = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        Self::open_timed(path, Box::new(clock), name, key, logs)
    }

    /// As [`Witness::open`], with a clock of the caller's.
    ///
    /// # Errors
    /// As [`Witness::open`].
    pub fn open_timed(
        path: &Path,
        clock: Clock,
        name: &str,
        key: OwnerKey,
        logs: Vec<NoteVerifier>,
    ) -> Result<Self, OpenError> {
        let made = [LOGS, EVIDENCE].iter().try_for_each(|folder| make_folders(&path.join(folder)));
        // Also where the folders were there: a start that died may have made them and flushed nothing.
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let durable = made.and_then(|()| [path, parent].into_iter().try_for_each(sync_folder));
        let lock = durable.and_then(|()| LockFile::take(&path.join("LOCK")));
        let lock = lock.map_err(|e| OpenError::Memory { file: path.display().to_string(), what: e.to_string() })?;
        let witness = Self::open_on(Box::new(RealDisk::new(path)), clock, name, key, logs)?;
        Ok(Self { _lock: Some(lock), ..witness })
    }

    /// A witness over a disk and a clock of the caller's, who sees to it that there is one.
    ///
    /// # Errors
    /// As [`Witness::open`].
    pub fn open_on(
        disk: Box<dyn Disk>,
        clock: Clock,
        name: &str,
        key: OwnerKey,
        logs: Vec<NoteVerifier>,
    ) -> Result<Self, OpenError> {
        let storage = Files::new(disk);
        let verifier = WitnessVerifier::new(name, key.public())?;
        let mut by_origin: BTreeMap<String, Vec<NoteVerifier>> = BTreeMap::new();
        for log in logs {
            if log.key() == verifier.key() {
                return Err(OpenError::OwnKey { origin: log.name().to_owned() });
            }
            by_origin.entry(log.name().to_owned()).or_default().push(log);
        }
        if by_origin.is_empty() {
            return Err(OpenError::NoLogs);
        }
        let mut logs = BTreeMap::new();
        for (origin, keys) in by_origin {
            let newest = recall(&storage, &origin, &verifier)
                .map_err(|what| OpenError::Memory { file: path_of(&origin), what })?;
            logs.insert(origin, Log { keys, memory: Mutex::new(Memory { newest, doubtful: false }) });
        }
        let evidence =
            Evidence::open(&storage).map_err(|e| OpenError::Memory { file: "evidence".into(), what: e.to_string() })?;
        Ok(Self { key, verifier, logs, evidence, storage, clock, _lock: None })
    }

    /// The vkey that verifiers pin.
    pub fn verifier(&self) -> &WitnessVerifier {
        &self.verifier
    }

    /// The newest cosigned checkpoint of the log whose origin has this SHA-256, with the log's signature and the cosignature
    /// ("Monitor Retrieval Mechanism"); none where nothing was cosigned.
    pub fn latest(&self, origin: &Digest) -> Option<String> {
        let (_, log) = self.logs.iter().find(|(name, _)| Digest::of(name) == *origin)?;
        log.memory().newest.as_ref().map(|newest| newest.note.clone())
    }

    /// Answers `POST <prefix>/add-checkpoint`.
    ///
    /// 200 and the cosignature; 400 malformed, or old size beyond the checkpoint's; 403 not signed by a trusted key, or
    /// a trusted key's signature does not hold; 404 unknown origin; 409 and the size that was cosigned last, where the old
    /// size is another, or where old size and checkpoint size are that size and the root is another (as tlog-witness
    /// v1.0.0 has it; its draft since July 2026 has 422 for the latter); 413 a body beyond
    /// [`MAX_BODY_BYTES`](crate::witness::request::MAX_BODY_BYTES); 422 the proof does not hold; 500 the witness could not remember
    /// the checkpoint, so it does not cosign it.
    pub fn add_checkpoint(&self, body: &[u8]) -> Response {
        self.consider(body).unwrap_or_else(|refusal| refusal)
    }

    fn consider(&self, body: &[u8]) -> Result<Response, Response> {
        let request = AddCheckpoint::parse(body).map_err(|e| match e {
            RequestError::TooLarge { .. } => text(413, e),
            RequestError::Line { .. } => text(400, e),
        })?;
        let (mut note, checkpoint) = Checkpoint::read(&request.note).map_err(|e| text(400, e))?;
        let Some(log) = self.logs.get(&checkpoint.origin) else {
            return Err(text(404, format!("no log {:?} is known here", checkpoint.origin)));
        };
        note.verify(&log.keys).map_err(|e| text(403, e))?;
        // From here on only what was verified.
        let trusted = |line: &_| log.keys.iter().any(|key| key.claims(line));
        note.signatures.retain(trusted);
        if request.old > checkpoint.size {
            return Err(text(400, format!("old size {} is beyond size {}", request.old, checkpoint.size)));
        }
        let mut memory = log.memory();
        self.settle(&checkpoint.origin, &mut memory)?;
        self.check(&request, &checkpoint, &note, memory.newest.as_ref())?;
        let last = memory.newest.as_ref().map_or(0, |newest| newest.time);
        let remembered = self.cosigned(checkpoint, note, last)?;
        self.remember(&mut memory, remembered)
    }

    /// Reads the file again where it is not known what it holds.
    fn settle(&self, origin: &str, memory: &mut Memory) -> Result<(), Response> {
        if !memory.doubtful {
            return Ok(());
        }
        let unsettled = |what: String| {
            tracing::error!(origin, what, "the witness's memory is in doubt; nothing is cosigned for this log");
            text(500, "the witness cannot read its memory; try later")
        };
        let found = recall(&self.storage, origin, &self.verifier).map_err(unsettled)?;
        let gone_back = match (&memory.newest, &found) {
            (None, _) => false,
            (Some(_), None) => true,
            (Some(old), Some(new)) if old.checkpoint.size == new.checkpoint.size => {
                old.checkpoint.root != new.checkpoint.root
            }
            (Some(old), Some(new)) => new.checkpoint.size < old.checkpoint.size,
        };
        if gone_back {
            return Err(unsettled("the file is older than what was cosigned".into()));
        }
        *memory = Memory { newest: found, doubtful: false };
        Ok(())
    }

    /// The checks against what was cosigned last, in the order of the specification.
    fn check(
        &self,
        request: &AddCheckpoint,
        checkpoint: &Checkpoint,
        note: &Note,
        newest: Option<&Remembered>,
    ) -> Result<(), Response> {
        let size = newest.map_or(0, |newest| newest.checkpoint.size);
        let conflict = || Response { status: 409, content_type: SIZE_TYPE, body: format!("{size}\n") };
        let forked = newest.filter(|n| n.checkpoint.size == checkpoint.size && n.checkpoint.root != checkpoint.root);
        if let Some(newest) = forked {
            self.keep(Kind::Fork, request, note, newest);
        }
        if request.old != size {
            return Err(conflict());
        }
        if checkpoint.size == 0 && checkpoint.root != empty_root() {
            return Err(text(422, "a tree of size 0 has the root SHA-256(\"\")"));
        }
        if forked.is_some() {
            return Err(conflict());
        }
        let proven = match newest {
            Some(newest) if size > 0 => {
                let root = &newest.checkpoint.root;
                verify_consistency(size, checkpoint.size, &request.proof, root, &checkpoint.root)
                    .map_err(|e| e.to_string())
            }
            // The empty tree is consistent with any.
            _ if request.proof.is_empty() => Ok(()),
            _ => Err("a proof from the empty tree must be empty".into()),
        };
        proven.map_err(|what| {
            if let Some(newest) = newest.filter(|n| n.checkpoint.size < checkpoint.size && size > 0) {
                self.keep(Kind::Unproven, request, note, newest);
            }
            text(422, format!("no proof of consistency from size {size} to {}: {what}", checkpoint.size))
        })
    }

    /// Whether evidence is kept changes no answer: the checkpoint is refused in any case.
    fn keep(&self, kind: Kind, request: &AddCheckpoint, note: &Note, newest: &Remembered) {
        let origin = newest.checkpoint.origin.as_str();
        let contradiction = Contradiction {
            kind,
            origin,
            time: (self.clock)(),
            cosigned: &newest.note,
            submitted: &note.to_string(),
            old: request.old,
            proof: request.proof.iter().map(Digest::to_base64).collect(),
        };
        match self.evidence.keep(&self.storage, &note.text, &contradiction) {
            Ok(Some(file)) => tracing::warn!(origin, ?kind, file, "a signed checkpoint contradicts the cosigned one"),
            Ok(None) => {}
            Err(e) => tracing::error!(origin, ?kind, error = %e, "a contradiction could not be kept"),
        }
    }

    /// The checkpoint with this witness's line, not remembered yet. `last` is the time of the one before.
    fn cosigned(&self, checkpoint: Checkpoint, mut note: Note, last: u64) -> Result<Remembered, Response> {
        let now = (self.clock)();
        // A later checkpoint at an earlier time would contradict the statement made before.
        if now.saturating_add(MAX_STEP_BACK_S) < last {
            tracing::error!(now, last, "the clock stands before the last cosignature; set it right");
            return Err(text(500, "the witness's clock stands before its last cosignature"));
        }
        let time = now.max(last);
        let line = cosign(&note.text, time, self.verifier.name(), &self.key).map_err(|e: CosignatureError| {
            tracing::error!(error = %e, "cannot cosign");
            text(500, "the witness cannot cosign")
        })?;
        note.signatures.push(line);
        Ok(Remembered { checkpoint, time, note: note.to_string() })
    }

    fn remember(&self, memory: &mut Memory, newest: Remembered) -> Result<Response, Response> {
        let origin = &newest.checkpoint.origin;
        memory.doubtful = true;
        self.storage.replace(&[(path_of(origin), newest.to_json())]).map_err(|e| {
            tracing::error!(origin, error = %e, "the witness could not remember a checkpoint, and did not cosign it");
            text(500, "the witness could not remember the checkpoint, and does not cosign it; try again")
        })?;
        let body = newest.note.lines().last().map(|line| format!("{line}\n")).unwrap_or_default();
        *memory = Memory { newest: Some(newest), doubtful: false };
        Ok(Response { status: 200, content_type: TEXT_TYPE, body })
    }
}

impl Log {
    /// A panic under the lock leaves `doubtful` set, and what was cosigned as it was.
    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn recall(storage: &Files, origin: &str, witness: &WitnessVerifier) -> Result<Option<Remembered>, String> {
    let json = storage.read(&path_of(origin), MAX_FILE_BYTES).map_err(|e| e.to_string())?;
    json.map(|json| Remembered::from_json(&json, origin, witness)).transpose()
}

/// An answer for people; what it quotes of the request is cut.
fn text(status: u16, what: impl ToString) -> Response {
    let what: String = what.to_string().chars().take(MAX_TEXT).collect();
    Response { status, content_type: TEXT_TYPE, body: format!("{what}\n") }
}
