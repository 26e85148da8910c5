//! What every command that enters a record shares: what the registry gives to sign, sealing and submitting, the check of
//! what came back, and the bundle.
//!
//! A bundle is a folder of files that their holder can verify without a daemon: `record.json` (DSSE
//! envelope), `record.tlog-proof`, `log.vkey`, and for a claim `signal.png`, `signal.wav` and
//! `signal.txt` (what there is of them) with `signal.salt`, which are the owner's secret until they
//! choose to show them. `record.signed.json` is there for as long as there is no answer.

use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_log::format::merkle;
use cairn_log::format::record::{Digests, Identity, Seen, random_salt};
use cairn_log::{
    Checkpoint, Digest, Note, NoteVerifier, OwnerKey, OwnerRecord, PublicKey, RecordKind, SignedRecord, TlogProof,
};
use tonic::{Code, Status};

use super::connect::Connection;
use super::json;
use cairn_durable::{write_atomic, write_secret};

/// What the registry gives a signer to sign.
pub struct Ground {
    /// The log's name.
    pub origin: String,
    /// Its nonce for the scene and the key.
    pub nonce: Digest,
    /// Its newest checkpoint.
    pub seen: Seen,
}

/// All records of a scene, or of the log where that is empty, by index.
pub async fn list(line: &Connection, scene: &str) -> anyhow::Result<Vec<v1::Record>> {
    let (mut records, mut from) = (Vec::new(), 0);
    loop {
        let request = v1::ListRecordsRequest { scene: scene.to_owned(), from, limit: 0 };
        let page = line.owners().list(request).await?.into_inner();
        records.extend(page.records);
        match page.next {
            Some(next) if next > from => from = next,
            Some(next) => anyhow::bail!("the daemon says to go on at record {next}, behind {from}"),
            None => return Ok(records),
        }
    }
}

impl Ground {
    /// Asks for it.
    pub async fn ask(line: &Connection, scene: &str, key: &PublicKey) -> anyhow::Result<Self> {
        let owner_key = key.to_bytes().to_vec().into();
        let request = v1::NonceRequest { scene: scene.to_owned(), owner_key };
        let nonce = line.about(scene).owners().nonce(request).await?.into_inner();
        let checkpoint = Checkpoint::parse_text(&Note::parse(&nonce.checkpoint)?.text)?;
        Ok(Self {
            origin: nonce.origin,
            nonce: nonce.nonce.parse().context("the daemon's nonce is not 32 bytes in hexadecimal")?,
            seen: Seen { size: checkpoint.size, root: checkpoint.root },
        })
    }

    /// A record of `key` about `earlier`: its scene and identity, and nothing else of it.
    pub fn about(
        self,
        earlier: &Stored,
        kind: RecordKind,
        key: &OwnerKey,
        purpose: &str,
    ) -> anyhow::Result<OwnerRecord> {
        Ok(OwnerRecord {
            kind,
            digests: Digests::default(),
            seed: None,
            replaces: Some(earlier.digest),
            views: None,
            ..self.anew(earlier, key, purpose)?
        })
    }

    /// The record `earlier` as `key` would sign it today: all that it says, on new ground.
    pub fn anew(self, earlier: &Stored, key: &OwnerKey, purpose: &str) -> anyhow::Result<OwnerRecord> {
        Ok(OwnerRecord {
            origin: self.origin,
            nonce: self.nonce,
            seen: self.seen,
            scene_salt: random_salt()?,
            owner_key: key.public(),
            purpose: purpose.to_owned(),
            // No record but a binding names a key, and none is signed anew.
            identity: Identity { key: None, ..earlier.record.identity.clone() },
            ..earlier.record.clone()
        })
    }
}

/// A record that is in the log, its owner's signature verified here.
pub struct Stored {
    /// Its place.
    pub index: u64,
    /// SHA-256 of its PAE, as `replaces` names it.
    pub digest: Digest,
    /// What it says.
    pub record: OwnerRecord,
    /// What the daemon says became of it.
    pub standing: v1::Standing,
}

impl Stored {
    /// Fetches one; `None` where it was erased.
    pub async fn find(line: &Connection, index: u64) -> anyhow::Result<Option<Self>> {
        let request = v1::GetRecordRequest { index };
        let answer = line.owners().get(request).await?.into_inner();
        let found = answer.record.context("the daemon's answer names no record")?;
        if found.envelope.is_empty() {
            return Ok(None);
        }
        let (_, record, leaf) = SignedRecord::parse(&found.envelope)?.into_parts();
        Ok(Some(Self { index, digest: leaf.record, record, standing: found.standing.unwrap_or_default() }))
    }

    /// Fetches one about `scene`.
    pub async fn of_scene(line: &Connection, scene: &str, index: u64) -> anyhow::Result<Self> {
        let stored = Self::find(line, index).await?.with_context(|| format!("record {index} was erased"))?;
        let of = &stored.record.scene;
        anyhow::ensure!(of == scene, "record {index} is about scene {of:?}, not {scene:?}");
        Ok(stored)
    }

    /// Refuses a key that cannot speak for the record: another than its owner's, unless that one was rotated; then it is the
    /// registry's to say whether this one took its place. For a revoked key nobody speaks. Refuses a rotation, too: what is
    /// said of one changes nothing.
    pub fn spoken_for_by(&self, key: &OwnerKey) -> anyhow::Result<()> {
        let index = self.index;
        anyhow::ensure!(
            self.record.kind != RecordKind::Rotation,
            "record {index} is a rotation and credits nobody; name the record that it is about (see `cairn owners show {index}`)"
        );
        match self.standing.key_ended_by {
            None => self.belongs_to(key),
            Some(_) if self.standing.key_rotated => Ok(()),
            Some(by) => anyhow::bail!(
                "record {index} belongs to key {}, which record {by} revoked. It can no longer be replaced or taken back",
                self.record.owner_key
            ),
        }
    }

    /// Refuses a key that the record does not belong to.
    pub fn belongs_to(&self, key: &OwnerKey) -> anyhow::Result<()> {
        let (index, owner) = (self.index, self.record.owner_key);
        anyhow::ensure!(owner == key.public(), "record {index} belongs to key {owner}, not to {}", key.public());
        Ok(())
    }
}

/// What became of a record that was entered, in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Its index in the log.
    pub index: u64,
    /// Whether its proof is the newest; otherwise it is as of the acknowledgement, and under the log's signature alone.
    pub published: bool,
    /// How many witnesses cosigned that proof.
    pub cosigned: usize,
    /// How many the daemon asks.
    pub witnesses: usize,
}

impl Place {
    /// Says what its owner keeps to themselves of the bundle in `folder`, and what that still lacks.
    pub fn say_more(&self, folder: &Path) {
        if folder.join(SALT).exists() {
            println!("keep signal.* in it to yourself, until you choose to show what is hidden; send the other files");
        }
        if self.cosigned < self.witnesses {
            println!(
                "where a policy asks for the others, `cairn owners submit {}` fetches a newer proof once they have cosigned",
                cairn_scene::quoted(&folder.display().to_string())
            );
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "record {} is durable{}", self.index, if self.published { " and published" } else { "" })?;
        match self.witnesses {
            0 => Ok(()),
            asked => write!(f, ", cosigned by {} of {asked} witnesses", self.cosigned),
        }
    }
}

/// What was signed, until there is an answer: the record's envelope with its owner's signatures alone.
const SIGNED: &str = "record.signed.json";

/// The record's envelope, as the registry signed it.
const RECORD: &str = "record.json";

/// The record's proof.
const PROOF: &str = "record.tlog-proof";

/// What makes a hidden signal the owner's secret.
pub const SALT: &str = "signal.salt";

/// The log's verifier key.
const VKEY: &str = "log.vkey";

/// A proof of the daemon's that does not go with the bundle's: what shows that one log has two histories.
const OTHER: &str = "record.other.tlog-proof";

/// Who has signed a proof's checkpoint beside the log, by the names that the signatures give. An audit with a policy finds
/// out whether they hold.
fn cosigners(proof: &TlogProof) -> anyhow::Result<BTreeSet<String>> {
    let (note, checkpoint) = Checkpoint::read(&proof.checkpoint).context("the proof's checkpoint")?;
    let names = note.signatures.into_iter().map(|signature| signature.name);
    Ok(names.filter(|name| *name != checkpoint.origin).collect())
}

/// Puts the daemon's newest proof of a bundle's record in the place of the one that it has, where it holds under the bundle's
/// key of the log and says all that the other says.
async fn prove_again(line: &Connection, folder: &Path) -> anyhow::Result<Place> {
    let text = |name: &str| {
        let path = folder.join(name);
        let bytes = super::files::read(&path)?;
        String::from_utf8(bytes).with_context(|| format!("{} is no text", path.display()))
    };
    let old = TlogProof::parse(&text(PROOF)?).with_context(|| format!("{}", folder.join(PROOF).display()))?;
    let signed = SignedRecord::parse(text(RECORD)?.as_bytes());
    let signed = signed.with_context(|| format!("{} is no signed record", folder.join(RECORD).display()))?;
    let pinned: NoteVerifier =
        text(VKEY)?.trim().parse().with_context(|| format!("{} is no vkey", folder.join(VKEY).display()))?;
    let known = Checkpoint::verify(&old.checkpoint, &pinned)
        .with_context(|| format!("{}, under the bundle's log.vkey", folder.join(PROOF).display()))?;
    let index = old.index;
    let answer = line.owners().proof(v1::ProofRequest { index }).await?.into_inner();
    let new = TlogProof::parse(&answer.tlog_proof).context("the daemon's proof")?;
    let checkpoint =
        Checkpoint::verify(&new.checkpoint, &pinned).context("the daemon's proof, under the bundle's log.vkey")?;
    if checkpoint.size < known.size || (checkpoint.size == known.size && checkpoint.root != known.root) {
        let other = folder.join(OTHER);
        write_atomic(&other, answer.tlog_proof.as_bytes())?;
        anyhow::bail!(
            "the daemon's log has {} entries and root {}, and the bundle's proof is of {} entries and root {}. A log does not \
             shrink or change: keep both proofs ({} is the daemon's), and show them to its witnesses",
            checkpoint.size,
            checkpoint.root,
            known.size,
            known.root,
            other.display()
        );
    }
    merkle::verify_inclusion(&signed.leaf().hash(), index, checkpoint.size, &new.hashes, &checkpoint.root)
        .with_context(|| format!("the daemon's proof is not of the record in {}", folder.display()))?;
    let cosigned = cosigners(&new)?;
    let missing: Vec<String> = cosigners(&old)?.difference(&cosigned).cloned().collect();
    anyhow::ensure!(
        missing.is_empty(),
        "the daemon's proof lacks the cosignature of {}, so the bundle's stays; ask again later",
        missing.join(", ")
    );
    let cosigned = cosigned.len();
    write_atomic(&folder.join(PROOF), answer.tlog_proof.as_bytes())?;
    Ok(Place { index, published: true, cosigned, witnesses: answer.witnesses as usize })
}

/// The folder of a bundle, made before anything is signed; gone again where nothing was written.
pub struct Bundle {
    folder: PathBuf,
    /// The folders above it that were made for it, the innermost first.
    above: Vec<PathBuf>,
}

impl Bundle {
    /// Refuses a folder that is there, before a passphrase is typed for nothing.
    pub fn must_be_new(folder: &Path) -> anyhow::Result<()> {
        let is_new = folder.symlink_metadata().is_err();
        anyhow::ensure!(is_new, "{} exists already; give a new folder (--out)", folder.display());
        Ok(())
    }

    /// Makes the folder, which must be new, and those above it that are not there.
    pub fn begin(folder: &Path) -> anyhow::Result<Self> {
        Self::must_be_new(folder)?;
        let ancestors = folder.ancestors().skip(1).filter(|above| !above.as_os_str().is_empty());
        let above = ancestors.take_while(|above| !above.exists()).map(Path::to_path_buf).collect();
        // First, so that it takes away what was made where not all of it can be.
        let bundle = Self { folder: folder.to_path_buf(), above };
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        Ok(bundle)
    }

    /// Signs a record with its owner's key and any other that must sign, enters it, and writes what
    /// an auditor needs and `secrets`, the owner's, which no other user may read. What is written
    /// before it is sent, an answer that is lost loses not; what cannot be written is not sent.
    pub async fn enter(
        &self,
        line: &Connection,
        record: &OwnerRecord,
        keys: &[&OwnerKey],
        secrets: &[(&str, &[u8])],
    ) -> anyhow::Result<Place> {
        let (owner, others) = keys.split_first().context("no key signs")?;
        let mut envelope = record.seal(owner)?;
        others.iter().for_each(|key| envelope.sign(key));
        let signed = envelope.to_json().into_bytes();
        let files = || secrets.iter().copied().chain([(SIGNED, &signed[..])]);
        let take_away = || files().for_each(|(name, _)| drop(std::fs::remove_file(self.folder.join(name))));
        let written = files().try_for_each(|(name, bytes)| write_secret(&self.folder.join(name), bytes));
        written.inspect_err(|_| take_away())?;
        let sent = send(line, record, signed.clone()).await;
        if matches!(&sent, Err(status) if !is_open(status)) {
            // It will never be in the log: the folder goes, too.
            take_away();
        }
        self.finish(line, record, sent).await
    }

    /// Sends what [`Bundle::enter`] left in `folder` without an answer, and goes on from there. A bundle that had its answer
    /// gets a newer proof.
    pub async fn send_again(line: &Connection, folder: &Path) -> anyhow::Result<Place> {
        let path = folder.join(SIGNED);
        if !path.exists() && folder.join(PROOF).exists() {
            return prove_again(line, folder).await;
        }
        let signed = std::fs::read(&path)
            .with_context(|| format!("{} waits for no answer: cannot read {}", folder.display(), path.display()))?;
        let read = SignedRecord::parse(&signed).with_context(|| format!("{} is no signed record", path.display()))?;
        let record = read.record();
        let sent = send(line, record, signed).await;
        let is_refused = matches!(&sent, Err(status) if !is_open(status));
        let done = Self { folder: folder.to_path_buf(), above: Vec::new() }.finish(line, record, sent).await;
        // Another account, or another daemon, may answer.
        let kept =
            || format!("refused; what was signed stays in {}: delete it where it is not wanted", folder.display());
        if is_refused { done.with_context(kept) } else { done }
    }

    async fn finish(
        &self,
        line: &Connection,
        record: &OwnerRecord,
        sent: Result<v1::SubmitRecordResponse, Status>,
    ) -> anyhow::Result<Place> {
        let lost = || {
            // Then the key that follows is the account's.
            let who = if record.kind == RecordKind::Rotation { " (--account: the new key)" } else { "" };
            format!(
                "no answer that settles it; what was signed is kept, `cairn owners submit {}`{who} asks again",
                self.name()
            )
        };
        let answer = match sent {
            Err(status) if is_open(&status) => return Err(status).with_context(lost),
            Err(status) => return Err(status.into()),
            Ok(answer) => answer,
        };
        let entered = answer.record.context("the daemon's answer names no record")?;
        // What came back must be what was signed, or the bundle would speak for another owner.
        let returned = SignedRecord::parse(&entered.envelope)?;
        anyhow::ensure!(returned.record() == record, "the daemon returned another record than was signed");
        self.write(line, &entered, &answer.tlog_proof, &answer.vkey).await
    }

    /// Fetches the record's newest proof, and writes what an auditor needs; `acknowledged` is the
    /// proof that came with the acknowledgement.
    async fn write(
        &self,
        line: &Connection,
        entered: &v1::Record,
        acknowledged: &str,
        vkey: &str,
    ) -> anyhow::Result<Place> {
        // First: with the record in hand its proof can be fetched by every caller, also where its
        // key was just ended.
        self.add(RECORD, &entered.envelope)?;
        let request = v1::ProofRequest { index: entered.index };
        let (proof, witnesses, published) = match line.owners().proof(request).await {
            Ok(newest) => {
                let v1::ProofResponse { tlog_proof, witnesses, .. } = newest.into_inner();
                (tlog_proof, witnesses as usize, true)
            }
            // Where reading is closed, a key that this very record ended reads no more: what came with the
            // acknowledgement proves it as well, if without witnesses.
            Err(status) if is_refused_caller(&status) && !acknowledged.is_empty() => {
                eprintln!(
                    "note: reading is closed to this key, so the proof of record {} is the acknowledgement's, without witnesses; \
                     for a cosigned one ask a caller who may read, or the operator",
                    entered.index
                );
                (acknowledged.to_owned(), 0, false)
            }
            Err(status) => {
                let problem = "is in the log; its proof was not given";
                let again = format!("`cairn owners submit {}` asks again", self.name());
                return Err(status).with_context(|| format!("record {} {problem}, {again}", entered.index));
            }
        };
        let cosigned = cosigners(&TlogProof::parse(&proof).context("the daemon's proof")?)?.len();
        self.add(PROOF, proof.as_bytes())?;
        self.add(VKEY, format!("{vkey}\n").as_bytes())?;
        let signed = self.folder.join(SIGNED);
        std::fs::remove_file(&signed).with_context(|| format!("cannot remove {}", signed.display()))?;
        Ok(Place { index: entered.index, published, cosigned, witnesses })
    }

    /// Writes one file more.
    fn add(&self, name: &str, bytes: &[u8]) -> anyhow::Result<()> {
        Ok(write_atomic(&self.folder.join(name), bytes)?)
    }

    fn name(&self) -> std::path::Display<'_> {
        self.folder.display()
    }
}

impl Drop for Bundle {
    fn drop(&mut self) {
        // Fails, as it should, where there is something in it.
        for folder in std::iter::once(&self.folder).chain(&self.above) {
            let _ = std::fs::remove_dir(folder);
        }
    }
}

async fn send(line: &Connection, record: &OwnerRecord, signed: Vec<u8>) -> Result<v1::SubmitRecordResponse, Status> {
    let request = v1::SubmitRecordRequest { envelope: signed.into() };
    Ok(line.about(&record.scene).owners().submit(request).await?.into_inner())
}

/// Whether what was asked for may have been done all the same: the line broke, or the daemon did, or something on the
/// way asked twice. What is kept for nothing costs nothing.
fn is_open(status: &Status) -> bool {
    use Code::{FailedPrecondition, InvalidArgument, NotFound, PermissionDenied, ResourceExhausted};
    !matches!(status.code(), FailedPrecondition | InvalidArgument | NotFound | PermissionDenied | ResourceExhausted)
}

/// Whether a call was refused because of who calls.
fn is_refused_caller(status: &Status) -> bool {
    matches!(status.code(), Code::Unauthenticated | Code::PermissionDenied)
}

/// A record as JSON, its envelope not as bytes but as the JSON that it is.
pub fn as_json(record: &v1::Record) -> anyhow::Result<serde_json::Value> {
    let mut value = json::of(record)?;
    if !record.envelope.is_empty() {
        value["envelope"] = serde_json::from_slice(&record.envelope).context("the record's envelope is no JSON")?;
    }
    Ok(value)
}

/// The log's verifier key, one line without its end.
pub async fn vkey(line: &Connection) -> anyhow::Result<String> {
    let request = v1::CheckpointRequest {};
    Ok(line.owners().checkpoint(request).await?.into_inner().vkey)
}
