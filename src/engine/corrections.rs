//! What becomes of a record after it was entered: disputes, replacements and ends of keys as the log has them, and
//! erasure at its owner's request.

use cairn_registry::{Digest, Envelope, Erasure, ErasureError, RecordKind, RegistryError, StoredRecord};

use super::Engine;
use super::error::EngineError;

/// What later records say of one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Standing {
    /// The first record that its owner put in its place, a rotation among them.
    pub replaced_by: Option<u64>,
    /// The revocation that takes it back.
    pub taken_back_by: Option<u64>,
    /// Disputes about it, by log index.
    pub disputed_by: Vec<u64>,
    /// The revocation or rotation that ended its owner's key; the record came before, and stays good.
    pub key_ended_by: Option<u64>,
}

impl Engine {
    /// What later records say of record `index`.
    ///
    /// # Errors
    /// The registry's.
    pub fn standing(&self, stored: &StoredRecord) -> Result<Standing, EngineError> {
        let registry = self.registry();
        let mut standing = Standing { key_ended_by: registry.ended(&stored.record.owner_key)?, ..Standing::default() };
        for (index, kind) in registry.about(&stored.leaf.record)? {
            match kind {
                RecordKind::Dispute => standing.disputed_by.push(index),
                RecordKind::Revocation => standing.taken_back_by = Some(index),
                RecordKind::Claim | RecordKind::Contribution | RecordKind::Training | RecordKind::Rotation => {
                    standing.replaced_by.get_or_insert(index);
                }
            }
        }
        Ok(standing)
    }

    /// Erases a record's envelope at its owner's signed request; its place in the log, whose leaf stays.
    ///
    /// # Errors
    /// [`EngineError::Erasure`], [`EngineError::ErasesOther`], [`EngineError::NotYours`], the registry's.
    pub fn erase_record(&self, request: &[u8]) -> Result<u64, EngineError> {
        let envelope = Envelope::parse(request).map_err(ErasureError::from)?;
        let erasure = Erasure::open(&envelope)?;
        let request = erasure.request();
        let registry = self.registry();
        if request.origin != registry.origin() {
            let (expected, got) = (registry.origin().to_owned(), request.origin.clone());
            return Err(RegistryError::WrongOrigin { expected, got }.into());
        }
        let (index, key) = (request.index, request.owner_key);
        let stored = registry.record(index)?;
        if stored.leaf.record != request.record {
            let (expected, got) = (stored.leaf.record, request.record);
            return Err(EngineError::ErasesOther { index, expected, got });
        }
        match self.heir(stored.leaf.owner)? {
            Heir::Key(heir) if heir == key.id() => Ok(registry.erase(&erasure)?),
            Heir::Key(heir) => {
                Err(EngineError::NotYours { index, key, why: format!("it belongs to the key with id {heir}") })
            }
            Heir::Nobody { revoked_by } => {
                let why = format!("its owner's key was revoked by record {revoked_by}; ask who runs this registry");
                Err(EngineError::NotYours { index, key, why })
            }
        }
    }

    /// Id of the key that speaks for `owner` (a key id) today: itself, or what rotations put in its place.
    fn heir(&self, owner: Digest) -> Result<Heir, EngineError> {
        let mut key = owner;
        // Each rotation stands behind the last and leads to a key that was good then, so this comes to an end.
        while let Some(end) = self.registry().ended_id(&key)? {
            let ended = self.registry().leaf(end)?;
            if ended.kind != RecordKind::Rotation {
                return Ok(Heir::Nobody { revoked_by: end });
            }
            key = ended.owner;
        }
        Ok(Heir::Key(key))
    }
}

/// Who speaks for a key.
enum Heir {
    /// The key with this id.
    Key(Digest),
    /// Nobody: a revoked key may be in other hands.
    Nobody { revoked_by: u64 },
}
