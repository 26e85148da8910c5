//! Owner records as the engine serves them: what a record must state, taking it
//! in, finding and proving it. Signing happens at the owner's, never here.

use cairn_registry::{
    Digest, Envelope, Note, OwnerRecord, PublicKey, RecordKind, Registry, RegistryError, StoredRecord,
};

use super::Engine;
use super::error::EngineError;
use super::model::{IdentityInfo, ModelInfo};

/// What the daemon knows of an identity's mark.
pub struct Material {
    /// The newest model.
    pub info: ModelInfo,
    /// The identity.
    pub identity: IdentityInfo,
    /// The hidden signal's file; empty where nothing is hidden.
    pub signal: Vec<u8>,
}

impl Engine {
    /// What a record about an identity of the newest model has to state.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`], [`EngineError::NotFound`].
    pub fn material(&self, scene: &str, identity: u32) -> Result<Material, EngineError> {
        let Some(info) = self.newest_model(scene)? else {
            self.scene(scene)?;
            return Err(EngineError::NotTrained { scene: scene.to_owned() });
        };
        let known = info.identity(identity)?.clone();
        let signal = if info.mark.is_some() { self.signal(&info, identity)? } else { Vec::new() };
        Ok(Material { info, identity: known, signal })
    }

    /// Takes a record in; durable and published on return.
    ///
    /// # Errors
    /// The registry's.
    pub fn submit_record(&self, envelope: &[u8]) -> Result<cairn_registry::Receipt, EngineError> {
        let envelope =
            Envelope::parse(envelope).map_err(|e| RegistryError::from(cairn_registry::RecordError::from(e)))?;
        Ok(self.registry().submit(&envelope)?)
    }

    /// A nonce for a record of `owner` about `scene`, in hexadecimal.
    ///
    /// # Errors
    /// For 32 bytes that are no public key.
    pub fn nonce(&self, scene: &str, owner: &[u8; 32]) -> Result<String, EngineError> {
        let owner = PublicKey::from_bytes(owner).map_err(RegistryError::from)?;
        Ok(self.registry().nonce(scene, &owner)?.to_string())
    }

    /// Log indices of the records that bear on an identity of `info`, rising: claims and training records of
    /// this very marked field, contributions of the identity's photographs, and rotations of any of these;
    /// none that was taken back or replaced.
    ///
    /// # Errors
    /// The registry's.
    pub fn records_of(&self, info: &ModelInfo, identity: &IdentityInfo) -> Result<Vec<u64>, EngineError> {
        let marked_field = info.mark.as_ref().map(|mark| mark.marked_field);
        bearing_on(self.registry(), &info.scene, marked_field, identity)
    }

    /// The offline proof of a record (C2SP tlog-proof): index, inclusion hashes,
    /// the newest checkpoint.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`].
    pub fn tlog_proof(&self, index: u64) -> Result<String, EngineError> {
        let registry = self.registry();
        let checkpoint = registry.checkpoint();
        // The size is read from the very checkpoint that goes into the proof: the log may grow in between.
        let size = signed_size(&checkpoint)?;
        if index >= size {
            return Err(RegistryError::NoSuchRecord { index, size }.into());
        }
        let mut text = format!("c2sp.org/tlog-proof@v1\nindex {index}\n");
        for hash in registry.prove_inclusion(index, size)? {
            text.push_str(&hash.to_base64());
            text.push('\n');
        }
        text.push('\n');
        text.push_str(&checkpoint);
        Ok(text)
    }
}

/// See [`Engine::records_of`].
fn bearing_on(
    registry: &Registry,
    scene: &str,
    marked_field: Option<Digest>,
    identity: &IdentityInfo,
) -> Result<Vec<u64>, EngineError> {
    let records = registry.records(Some(scene))?;
    let mut kept: Vec<&StoredRecord> = Vec::new();
    for stored in &records {
        let before = kept.len();
        // Whoever may say `replaces` is the registry's to decide; a dispute alone is anybody's.
        if stored.record.kind != RecordKind::Dispute {
            kept.retain(|k| stored.record.replaces != Some(k.leaf.record));
        }
        let replaced_one = kept.len() < before;
        if is_about(&stored.record, marked_field, identity)
            || (stored.record.kind == RecordKind::Rotation && replaced_one)
        {
            kept.push(stored);
        }
    }
    let mut indices = Vec::with_capacity(kept.len());
    for stored in kept {
        // The record that ends a key may be about another scene, and still name the one that it takes back.
        let end = registry.ended(&stored.record.owner_key)?.map(|index| registry.record(index)).transpose()?;
        if end.is_none_or(|end| end.record.replaces != Some(stored.leaf.record)) {
            indices.push(stored.index);
        }
    }
    Ok(indices)
}

/// Whether a record's digests are those of the marked field and the identity's photographs. The number alone
/// says nothing: the next training gives the same number to somebody else.
fn is_about(record: &OwnerRecord, marked_field: Option<Digest>, identity: &IdentityInfo) -> bool {
    let bound = &record.digests;
    let photographs = identity.photographs_root();
    match record.kind {
        RecordKind::Claim | RecordKind::Training => {
            record.identity.number == identity.number
                && marked_field.is_some()
                && bound.marked_field == marked_field
                && bound.photographs.is_none_or(|root| root == photographs)
        }
        RecordKind::Contribution => bound.photographs == Some(photographs),
        RecordKind::Revocation | RecordKind::Rotation | RecordKind::Dispute => false,
    }
}

fn signed_size(checkpoint: &str) -> Result<u64, EngineError> {
    let bad = |e: String| EngineError::Internal(format!("the registry's own checkpoint: {e}"));
    let note = Note::parse(checkpoint).map_err(|e| bad(e.to_string()))?;
    let checkpoint = cairn_registry::Checkpoint::parse_text(&note.text).map_err(|e| bad(e.to_string()))?;
    Ok(checkpoint.size)
}

#[cfg(test)]
#[path = "owners_tests.rs"]
mod tests;
