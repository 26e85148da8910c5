//! What becomes of a record after it was entered: disputes, replacements and ends of keys as the log has them, and
//! erasure at its owner's request.

use cairn_log::format::record::Effect;
use cairn_log::{Digest, Envelope, Erasure, Heir, RecordError, Registry, RegistryError, StoredRecord};

use crate::error::EngineError;

/// What later records say of one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Standing {
    /// The first record that its owner put in its place.
    pub replaced_by: Option<u64>,
    /// The revocation that takes it back.
    pub taken_back_by: Option<u64>,
    /// Disputes about it, by log index.
    pub disputed_by: Vec<u64>,
    /// The revocation or rotation that ended its owner's key; the record came before, and stays good.
    pub key_ended_by: Option<u64>,
    /// Whether that was a rotation.
    pub key_rotated: bool,
}

impl Standing {
    /// Whether its owner upholds it. A record that [`cairn_log::RecordKind::credits`] counts for as long as that holds, as in an answer's
    /// audit.
    pub const fn is_upheld(&self) -> bool {
        self.replaced_by.is_none() && self.taken_back_by.is_none()
    }
}

/// What later records say of record `index`.
///
/// # Errors
/// The registry's.
pub fn standing(registry: &Registry, stored: &StoredRecord) -> Result<Standing, EngineError> {
    let ended = registry.ended(&stored.record.owner_key)?;
    let mut standing = Standing {
        key_ended_by: ended.map(|end| end.index),
        key_rotated: ended.is_some_and(|end| end.to.is_some()),
        ..Standing::default()
    };
    // Whoever may say `replaces` is the registry's to decide.
    for (index, kind) in registry.about(&stored.leaf.record)? {
        match kind.effect() {
            Effect::Contests => standing.disputed_by.push(index),
            Effect::TakesBack => standing.taken_back_by = Some(index),
            Effect::Replaces => {
                standing.replaced_by.get_or_insert(index);
            }
            Effect::LeavesIt => {}
        }
    }
    Ok(standing)
}

/// Whether no later record replaces this one (by its digest) or takes it back.
///
/// # Errors
/// The registry's.
pub fn is_upheld(registry: &Registry, record: &Digest) -> Result<bool, EngineError> {
    let about = registry.about(record)?;
    Ok(about.iter().all(|(_, kind)| matches!(kind.effect(), Effect::Contests | Effect::LeavesIt)))
}

/// A request to erase, its own signature verified, and the record that it names.
pub struct AskedErasure {
    /// The request as it was signed.
    pub envelope: Envelope,
    /// What it asks for.
    pub erasure: Erasure,
    /// The record, as it is in the log.
    pub stored: StoredRecord,
}

/// Reads a request to erase, once, with the record that it names.
///
/// # Errors
/// [`EngineError::Erasure`], the registry's.
pub fn erasure_asked(registry: &Registry, request: &[u8]) -> Result<AskedErasure, EngineError> {
    let envelope = Envelope::parse(request).map_err(RecordError::from)?;
    let erasure = Erasure::open(&envelope)?;
    let stored = registry.record(erasure.request().index)?;
    Ok(AskedErasure { envelope, erasure, stored })
}

/// Erases a record's envelope at its owner's signed request; its place in the log, whose leaf stays.
///
/// # Errors
/// [`EngineError::WrongState`] where another record lies there, [`EngineError::NotYours`], the
/// registry's.
pub fn erase_record(registry: &Registry, asked: &AskedErasure) -> Result<u64, EngineError> {
    let AskedErasure { erasure, stored, .. } = asked;
    let request = erasure.request();
    if request.origin != registry.origin() {
        let (expected, got) = (registry.origin().to_owned(), request.origin.clone());
        return Err(RegistryError::WrongOrigin { expected, got }.into());
    }
    let (index, key) = (request.index, request.owner_key);
    if stored.leaf.record != request.record {
        let (expected, got) = (stored.leaf.record, request.record);
        let why = format!("it is {expected}, the request is to erase {got}; fetch the record and sign again");
        return Err(EngineError::wrong_state(format!("record {index}"), "erased", why));
    }
    match registry.heir(&stored.leaf.owner)? {
        Heir::Key { id, .. } if id == key.id() => Ok(registry.erase(erasure)?),
        Heir::Key { id, .. } => {
            Err(EngineError::NotYours { index, key, why: format!("it belongs to the key with id {id}") })
        }
        Heir::Nobody { ended_by, .. } => {
            let why = format!("its owner's key was revoked by record {ended_by}; ask who runs this registry");
            Err(EngineError::NotYours { index, key, why })
        }
    }
}
