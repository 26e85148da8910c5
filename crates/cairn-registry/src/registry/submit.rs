//! What a submission must satisfy, before the store is asked and after.

use std::collections::HashMap;

use super::{Registry, RegistryError, layout, nonce::BadNonce, reload};
use crate::{
    digest::Digest,
    dsse::{Envelope, EnvelopeSignature},
    keys::PublicKey,
    leaf::Leaf,
    merkle::Tree,
    record::{OwnerRecord, RecordError, RecordKind},
};

/// A submission whose envelope, owner's signature and own rules hold.
pub(super) struct Candidate {
    pub(super) envelope: Envelope,
    pub(super) record: OwnerRecord,
    pub(super) leaf: Leaf,
}

impl Candidate {
    /// Everything that can be said without the log.
    pub(super) fn check(envelope: &Envelope, origin: &str) -> Result<Self, RegistryError> {
        let (record, signature) = OwnerRecord::open(envelope)?;
        if record.origin != origin {
            return Err(RegistryError::WrongOrigin { expected: origin.to_owned(), got: record.origin });
        }
        let leaf = Leaf::of_opened(envelope, &record, &signature.sig)?;
        Ok(Self { envelope: envelope.clone(), record, leaf })
    }
}

/// Records planned in the batch that is being put together.
#[derive(Default)]
pub(super) struct Planned {
    /// Digest -> index, and the owner.
    pub(super) records: HashMap<Digest, (u64, PublicKey)>,
    /// Nonce -> index.
    pub(super) nonces: HashMap<Digest, u64>,
    /// Key id of an ended key -> index of the record that ended it.
    pub(super) retired: HashMap<Digest, u64>,
}

/// A record that may go into the log.
pub(super) struct Admitted {
    /// With the signatures that mean something here, and the registry's.
    pub(super) envelope: Envelope,
    /// The key that the record ends, if it is a revocation or rotation.
    pub(super) retires: Option<PublicKey>,
}

impl Registry {
    /// Everything that depends on the log, for a record that is not in it.
    pub(super) fn admit(
        &self,
        candidate: &Candidate,
        tree: &Tree,
        size: u64,
        planned: &Planned,
    ) -> Result<Admitted, RegistryError> {
        let record = &candidate.record;
        self.check_not_retired(&record.owner_key, planned)?;
        self.check_nonce(record, size, planned)?;
        if record.seen.size > size || tree.root_at(record.seen.size)? != record.seen.root {
            return Err(RegistryError::SeenForeign { size: record.seen.size, root: record.seen.root });
        }
        let mut signers = vec![record.owner_key];
        if let Some(replaces) = &record.replaces {
            let owner = self.owner_of(replaces, planned)?;
            if record.kind == RecordKind::Rotation && owner == record.owner_key {
                let expected = "for a rotation, another key than that of the record named in `replaces`";
                return Err(RecordError::Field { field: "owner_key", expected, got: owner.to_string() }.into());
            }
            if record.kind != RecordKind::Dispute && owner != record.owner_key {
                if candidate.envelope.signature_by(&owner).is_none() {
                    return Err(RegistryError::ReplacesForeign { replaces: *replaces, owner });
                }
                self.check_not_retired(&owner, planned)?;
                signers.push(owner);
            }
        }
        let retires = match record.kind {
            RecordKind::Revocation => Some(record.owner_key),
            RecordKind::Rotation => signers.get(1).copied(),
            RecordKind::Claim | RecordKind::Contribution | RecordKind::Training | RecordKind::Dispute => None,
        };
        let mut kept = Envelope::new(&candidate.envelope.payload_type, candidate.envelope.payload.as_slice());
        for signer in signers {
            let keyid = signer.id().to_string();
            // Each was found above or, the owner's, on the way in.
            let signature = candidate.envelope.signature_by(&signer);
            kept.signatures.extend(signature.map(|s| EnvelopeSignature { keyid, sig: s.sig.clone() }));
        }
        kept.sign(&self.key);
        Ok(Admitted { envelope: kept, retires })
    }

    fn check_not_retired(&self, owner: &PublicKey, planned: &Planned) -> Result<(), RegistryError> {
        let id = owner.id();
        let ended = match planned.retired.get(&id) {
            Some(index) => Some(*index),
            None => reload::number_at(self.store.as_ref(), &layout::retired(&id), || format!("end of key {owner}"))?,
        };
        match ended {
            Some(index) => Err(RegistryError::OwnerRetired { owner: *owner, index }),
            None => Ok(()),
        }
    }

    fn check_nonce(&self, record: &OwnerRecord, size: u64, planned: &Planned) -> Result<(), RegistryError> {
        let nonce = record.nonce;
        match self.nonces.check(&nonce, size, &record.scene, &record.owner_key) {
            Ok(()) => {}
            Err(BadNonce::Foreign) => return Err(RegistryError::NonceForeign { nonce, scene: record.scene.clone() }),
            Err(BadNonce::Expired { issued }) => return Err(RegistryError::NonceExpired { issued, size }),
        }
        let key = layout::nonce(&nonce);
        let used = match planned.nonces.get(&nonce) {
            Some(index) => Some(*index),
            None => reload::number_at(self.store.as_ref(), &key, || format!("nonce {nonce}"))?,
        };
        match used {
            Some(index) => Err(RegistryError::NonceUsed { nonce, index }),
            None => Ok(()),
        }
    }

    fn owner_of(&self, record: &Digest, planned: &Planned) -> Result<PublicKey, RegistryError> {
        if let Some((_, owner)) = planned.records.get(record) {
            return Ok(*owner);
        }
        let index = reload::index_of(self.store.as_ref(), record)?;
        let index = index.ok_or(RegistryError::ReplacesUnknown { replaces: *record })?;
        Ok(reload::stored(self.store.as_ref(), index)?.record.owner_key)
    }
}
