//! A log's side of tlog-witness: asks witnesses for cosignatures on a new checkpoint.
//!
//! A witness's answer is believed only as far as its signature goes: lines of others are ignored, its own are
//! verified, and an answer is read to a limit and no further. Two answers matter beyond the moment: a witness that
//! cosigned more than the log holds ([`WitnessError::Ahead`]) or another tree of the same size ([`WitnessError::Inconsistent`])
//! says that this log was restored from a backup or forked; a log that hears that must not go on signing.
//!
//! The calls block; each takes at most [`TIMEOUT`].

use std::{
    sync::atomic::{AtomicU64, Ordering},
    thread,
    time::Duration,
};

use crate::format::{
    checkpoint::{Checkpoint, CheckpointError},
    cosignature::{Cosignature, CosignatureError, WitnessVerifier},
    digest::{Digest, decimal},
    note::{Note, NoteSignature, NoteVerifier},
};
use ureq::{Agent, Body, http};

use crate::witness::request::AddCheckpoint;

/// Longest that one request takes, connecting included.
pub const TIMEOUT: Duration = Duration::from_secs(10);

/// Largest answer that is read, bytes.
pub const MAX_ANSWER_BYTES: u64 = 256 << 10;

/// Largest head of an answer, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;

/// Most signature lines in an answer.
const MAX_LINES: usize = 100;

/// Why there is no cosignature. Each names the witness.
#[derive(Debug, thiserror::Error)]
pub enum WitnessError {
    /// Not an address that can be asked.
    #[error("witness {witness}: address {got:?}; expected http:// or https:// and a host")]
    Url {
        /// The witness.
        witness: String,
        /// The address.
        got: String,
    },
    /// No answer, or none within limits.
    #[error("witness {witness} at {url}: {cause}")]
    Unreachable {
        /// The witness.
        witness: String,
        /// What was asked.
        url: String,
        /// Why.
        cause: String,
    },
    /// It cosigned another size last than the request said; ask again from that one.
    #[error("witness {witness} cosigned size {size} last; ask again with a proof from there")]
    Conflict {
        /// The witness.
        witness: String,
        /// The size that it cosigned last.
        size: u64,
    },
    /// It cosigned more than this log holds.
    #[error(
        "witness {witness} cosigned size {size}, this log has {ours} leaves: it was restored from an older backup, or another \
         log signs with its key; do not go on with it"
    )]
    Ahead {
        /// The witness.
        witness: String,
        /// The size that it cosigned last.
        size: u64,
        /// The size of the checkpoint that it was to cosign.
        ours: u64,
    },
    /// It cosigned another tree, so that this one does not follow from it.
    #[error("witness {witness} cosigned another history up to size {size}: {answer}")]
    Inconsistent {
        /// The witness.
        witness: String,
        /// The size that it cosigned last.
        size: u64,
        /// What it said.
        answer: String,
    },
    /// It does not know the log, does not trust its key, or has trouble of its own.
    #[error("witness {witness} refuses with status {status}: {answer}")]
    Refused {
        /// The witness.
        witness: String,
        /// HTTP status: 404 the log is unknown to it, 403 the key is.
        status: u16,
        /// What it said.
        answer: String,
    },
    /// An answer that is none of the protocol.
    #[error("witness {witness} answers {what}")]
    Malformed {
        /// The witness.
        witness: String,
        /// What is wrong.
        what: String,
    },
    /// Its cosignature does not hold.
    #[error("witness {witness}: {cause}")]
    Cosignature {
        /// The witness.
        witness: String,
        /// Why.
        cause: CosignatureError,
    },
    /// What was to be cosigned, or what it keeps as the log's newest, is no checkpoint of the log.
    #[error("checkpoint for witness {witness}: {cause}")]
    Checkpoint {
        /// The witness.
        witness: String,
        /// Why.
        cause: CheckpointError,
    },
    /// This log could not prove what the witness asks for.
    #[error("no proof from size {from} to {to} for witness {witness}: {cause}")]
    Proof {
        /// The witness.
        witness: String,
        /// The witness's size.
        from: u64,
        /// The checkpoint's size.
        to: u64,
        /// Why.
        cause: String,
    },
}

/// A log's checkpoint as a witness keeps it, verified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Witnessed {
    /// The checkpoint, the log's signature on it verified.
    pub checkpoint: Checkpoint,
    /// The witness's cosignature on it, verified.
    pub cosignature: Cosignature,
    /// The note.
    pub note: String,
}

/// One witness and where it is reached. For one log: it remembers which size the witness saw last.
#[derive(Debug)]
pub struct WitnessClient {
    url: String,
    verifier: WitnessVerifier,
    agent: Agent,
    /// Size that the witness cosigned last, as far as its answers told; a guess where it starts the exchange.
    known: AtomicU64,
}

/// Proof that the tree of `.1` leaves begins with the tree of `.0` leaves, both at least 1; the text says why there is none.
pub type Prove<'a> = dyn Fn(u64, u64) -> Result<Vec<Digest>, String> + Sync + 'a;

impl WitnessClient {
    /// A client of the witness whose submission prefix is `url`; its vkey is pinned.
    ///
    /// # Errors
    /// [`WitnessError::Url`].
    pub fn new(verifier: WitnessVerifier, url: &str) -> Result<Self, WitnessError> {
        let uri: Option<http::Uri> = url.parse().ok();
        let fits = uri.is_some_and(|uri| {
            matches!(uri.scheme_str(), Some("http" | "https")) && uri.host().is_some_and(|h| !h.is_empty())
        });
        if !fits || url.contains(['?', '#', '@']) {
            return Err(WitnessError::Url { witness: verifier.name().to_owned(), got: url.to_owned() });
        }
        let config = Agent::config_builder()
            .timeout_global(Some(TIMEOUT))
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .max_response_header_size(MAX_HEAD_BYTES)
            .proxy(None)
            .user_agent(concat!("cairn/", env!("CARGO_PKG_VERSION")));
        let url = url.trim_end_matches('/').to_owned();
        Ok(Self { url, verifier, agent: config.build().new_agent(), known: AtomicU64::new(0) })
    }

    /// The witness's pinned key and name.
    pub fn verifier(&self) -> &WitnessVerifier {
        &self.verifier
    }

    /// The submission prefix, without a slash at its end.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Asks once: `old` is the size that the witness cosigned last, `proof` leads from there to `note`, a checkpoint signed
    /// by its log. From old size 0, and to the same size, the proof is empty.
    ///
    /// # Errors
    /// [`WitnessError`]; [`WitnessError::Conflict`] tells the size to ask again from, [`WitnessError::Ahead`] that it is
    /// beyond the checkpoint.
    pub fn add_checkpoint(&self, old: u64, proof: &[Digest], note: &str) -> Result<Cosignature, WitnessError> {
        let (read, Checkpoint { size: ours, .. }) = Checkpoint::read(note).map_err(|e| self.not_ours(e))?;
        let request = AddCheckpoint { old, proof: proof.to_vec(), note: note.to_owned() };
        let url = format!("{}/add-checkpoint", self.url);
        let sent = self.agent.post(&url).content_type("text/plain; charset=utf-8").send(request.to_body());
        let (status, answer) = self.answer(&url, sent)?;
        match status {
            200 => {
                let cosignature = self.cosignature(read, &answer)?;
                self.known.store(ours, Ordering::Relaxed);
                Ok(cosignature)
            }
            409 => Err(self.conflict(old, ours, &answer)),
            422 => Err(WitnessError::Inconsistent { witness: self.name(), size: old, answer: clip(&answer) }),
            status => Err(WitnessError::Refused { witness: self.name(), status, answer: clip(&answer) }),
        }
    }

    /// As [`WitnessClient::add_checkpoint`], from the size that the witness is believed to have seen last, and once more
    /// from the size that it names where that was another.
    ///
    /// # Errors
    /// [`WitnessError`].
    pub fn cosign(&self, note: &str, prove: &Prove<'_>) -> Result<Cosignature, WitnessError> {
        let to = Checkpoint::read(note).map_err(|e| self.not_ours(e))?.1.size;
        let ask = |from: u64| {
            let proof = if from == 0 || from == to { Ok(Vec::new()) } else { prove(from, to) };
            let failed = |cause| WitnessError::Proof { witness: self.name(), from, to, cause };
            self.add_checkpoint(from, &proof.map_err(failed)?, note)
        };
        // More than this checkpoint holds would be malformed; asked from 0, the witness tells for itself.
        let known = Some(self.known.load(Ordering::Relaxed)).filter(|known| *known <= to).unwrap_or(0);
        match ask(known) {
            Err(WitnessError::Conflict { size, .. }) => ask(size),
            other => other,
        }
    }

    /// The log's newest checkpoint that this witness cosigned, if it cosigned one ("Monitor Retrieval Mechanism"; a
    /// witness may answer from a copy up to an hour old).
    ///
    /// # Errors
    /// [`WitnessError`]: also where what it keeps is not signed by `log` or not cosigned by it.
    pub fn latest(&self, log: &NoteVerifier) -> Result<Option<Witnessed>, WitnessError> {
        let url = format!("{}/{}/checkpoint", self.url, Digest::of(log.name()));
        let (status, note) = self.answer(&url, self.agent.get(&url).call())?;
        match status {
            200 => {}
            404 => return Ok(None),
            status => return Err(WitnessError::Refused { witness: self.name(), status, answer: clip(&note) }),
        }
        let checkpoint = Checkpoint::verify(&note, log).map_err(|e| self.not_ours(e))?;
        let read = Note::parse(&note).map_err(|e| self.not_ours(e.into()))?;
        let cosignature = self.found(&read)?;
        Ok(Some(Witnessed { checkpoint, cosignature, note }))
    }

    fn answer(
        &self,
        url: &str,
        sent: Result<http::Response<Body>, ureq::Error>,
    ) -> Result<(u16, String), WitnessError> {
        let failed = |e: ureq::Error| WitnessError::Unreachable {
            witness: self.name(),
            url: url.to_owned(),
            cause: e.to_string(),
        };
        let mut response = sent.map_err(failed)?;
        let body = response.body_mut().with_config().limit(MAX_ANSWER_BYTES).read_to_vec().map_err(failed)?;
        let text = String::from_utf8(body);
        let text = text.map_err(|_| self.malformed("with a body that is not UTF-8".into()))?;
        Ok((response.status().as_u16(), text))
    }

    /// The witness's own line among those that it answered with.
    fn cosignature(&self, note: Note, answer: &str) -> Result<Cosignature, WitnessError> {
        let lines: Vec<&str> = answer.lines().collect();
        if lines.len() > MAX_LINES {
            return Err(self.malformed(format!("with {} lines, at most {MAX_LINES} are read", lines.len())));
        }
        let signatures = lines.into_iter().map(str::parse).collect::<Result<Vec<NoteSignature>, _>>();
        let signatures = signatures.map_err(|e| self.malformed(e.to_string()))?;
        self.found(&Note { signatures, ..note })
    }

    fn found(&self, note: &Note) -> Result<Cosignature, WitnessError> {
        let found = self.verifier.find(note);
        let found = found.map_err(|cause| WitnessError::Cosignature { witness: self.name(), cause })?;
        found.ok_or_else(|| self.malformed(format!("without a cosignature of {}", self.verifier)))
    }

    fn conflict(&self, old: u64, ours: u64, answer: &str) -> WitnessError {
        let Some(size) = answer.strip_suffix('\n').and_then(decimal) else {
            return self.malformed(format!("a conflict with {:?}, expected a size and a newline", clip(answer)));
        };
        self.known.store(size, Ordering::Relaxed);
        match size {
            size if size > ours => WitnessError::Ahead { witness: self.name(), size, ours },
            // It was asked from its own size: what it minds is the root (tlog-witness v1.0.0).
            size if size == old => WitnessError::Inconsistent {
                witness: self.name(),
                size,
                answer: format!("it has another root at size {size}"),
            },
            size => WitnessError::Conflict { witness: self.name(), size },
        }
    }

    fn name(&self) -> String {
        self.verifier.name().to_owned()
    }

    fn malformed(&self, what: String) -> WitnessError {
        WitnessError::Malformed { witness: self.name(), what }
    }

    fn not_ours(&self, cause: CheckpointError) -> WitnessError {
        WitnessError::Checkpoint { witness: self.name(), cause }
    }
}

/// Asks all witnesses at the same time for a cosignature on `note`; the answers come in the clients' order.
///
/// Takes as long as the slowest of them: two requests of [`TIMEOUT`] at most.
pub fn collect(clients: &[WitnessClient], note: &str, prove: &Prove<'_>) -> Vec<Result<Cosignature, WitnessError>> {
    thread::scope(|scope| {
        let asked: Vec<_> = clients.iter().map(|client| scope.spawn(move || client.cosign(note, prove))).collect();
        let answers = clients.iter().zip(asked).map(|(client, thread)| {
            let ended = "a request's thread ended early";
            thread.join().unwrap_or_else(|_| Err(client.malformed(ended.into())))
        });
        answers.collect()
    })
}

fn clip(text: &str) -> String {
    text.trim_end().chars().take(200).collect()
}
