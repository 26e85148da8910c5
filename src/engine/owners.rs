//! Owner records as the engine serves them: what a record must state, taking it
//! in, finding and proving it. Signing happens at the owner's, never here.

use cairn_registry::{Envelope, Note, PublicKey, RegistryError};

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

    /// Log indices of the records about an identity of a scene, rising.
    ///
    /// # Errors
    /// The registry's.
    pub fn records_of(&self, scene: &str, identity: u32) -> Result<Vec<u64>, EngineError> {
        let records = self.registry().records(Some(scene))?;
        Ok(records.iter().filter(|r| r.record.identity.number == identity).map(|r| r.index).collect())
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

fn signed_size(checkpoint: &str) -> Result<u64, EngineError> {
    let bad = |e: String| EngineError::Internal(format!("the registry's own checkpoint: {e}"));
    let note = Note::parse(checkpoint).map_err(|e| bad(e.to_string()))?;
    let checkpoint = cairn_registry::Checkpoint::parse_text(&note.text).map_err(|e| bad(e.to_string()))?;
    Ok(checkpoint.size)
}
