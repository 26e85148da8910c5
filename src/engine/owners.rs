//! Owner records as the engine serves them: what a record must state, taking it
//! in, finding and proving it. Signing happens at the owner's, never here.

use std::collections::HashSet;

use cairn_registry::{Digest, Envelope, OwnerRecord, PublicKey, RecordKind, Registry, RegistryError};

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

    /// Takes a record in; durable on return, and published soon after.
    ///
    /// # Errors
    /// The registry's.
    pub fn submit_record(&self, envelope: &[u8]) -> Result<cairn_registry::Receipt, EngineError> {
        let envelope =
            Envelope::parse(envelope).map_err(|e| RegistryError::from(cairn_registry::RecordError::from(e)))?;
        let receipt = self.registry().submit(&envelope)?;
        self.publisher.wake();
        Ok(receipt)
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
        let size = self.registry().size();
        if index >= size {
            return Err(RegistryError::NoSuchRecord { index, size }.into());
        }
        Ok(self.registry().tlog_proof(index)?.to_text())
    }
}

/// See [`Engine::records_of`].
fn bearing_on(
    registry: &Registry,
    scene: &str,
    marked_field: Option<Digest>,
    identity: &IdentityInfo,
) -> Result<Vec<u64>, EngineError> {
    let mut related = HashSet::new();
    let mut indices = Vec::new();
    for stored in registry.records(Some(scene))? {
        let record = &stored.record;
        let of_one = record.replaces.is_some_and(|replaced| related.contains(&replaced));
        if !(is_about(record, marked_field, identity) || (record.kind == RecordKind::Rotation && of_one)) {
            continue;
        }
        related.insert(stored.leaf.record);
        // Whoever may say `replaces` is the registry's to decide; a dispute alone is anybody's.
        if registry.about(&stored.leaf.record)?.iter().all(|(_, kind)| *kind == RecordKind::Dispute) {
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

#[cfg(test)]
#[path = "owners_tests.rs"]
mod tests;
