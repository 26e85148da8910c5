//! What a submission must satisfy, before the store is asked and after.

use std::collections::HashMap;

use super::{
    error::RegistryError,
    layout,
    nonce::BadNonce,
    read, reload,
    shared::{Shared, Writer},
    tiles::TileTree,
};
use crate::format::{
    digest::Digest,
    dsse::{Envelope, EnvelopeSignature, MAX_ENVELOPE_BYTES},
    heir::{Ending, Heir, heir},
    key::PublicKey,
    merkle,
    record::{self, OwnerRecord, RecordKind},
    signed::SignedRecord,
};

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
    /// Id of the key that the record ends, if it is a revocation or rotation.
    pub(super) retires: Option<Digest>,
    /// Key id of the owner of the record named in `replaces`.
    pub(super) replaced_owner: Option<Digest>,
}

/// A record is taken into the log that it names.
pub(super) fn check_origin(shared: &Shared, candidate: &SignedRecord) -> Result<(), RegistryError> {
    let got = &candidate.record().origin;
    if *got != shared.origin {
        return Err(RegistryError::WrongOrigin { expected: shared.origin.clone(), got: got.clone() });
    }
    Ok(())
}

/// Everything that depends on the log, for a record that is not in it.
pub(super) fn admit(
    shared: &Shared,
    candidate: &SignedRecord,
    tree: &TileTree,
    size: u64,
    writer: &Writer,
    planned: &Planned,
) -> Result<Admitted, RegistryError> {
    let record = candidate.record();
    check_not_retired(shared, &candidate.leaf().owner, &record.owner_key.to_string(), planned)?;
    check_nonce(shared, record, size, writer, planned)?;
    if record.seen.size > size || merkle::root_at(tree, record.seen.size)? != record.seen.root {
        return Err(RegistryError::SeenForeign { size: record.seen.size, root: record.seen.root });
    }
    let mut signers = vec![record.owner_key];
    let mut replaced_owner = None;
    if let Some(replaces) = &record.replaces {
        let owner = owner_of(shared, replaces, planned)?;
        replaced_owner = Some(owner);
        signers.extend(consent_of(shared, candidate, replaces, &owner, planned)?);
    }
    let retires = match record.kind {
        RecordKind::Revocation => Some(candidate.leaf().owner),
        RecordKind::Rotation => replaced_owner,
        RecordKind::Claim
        | RecordKind::Contribution
        | RecordKind::Training
        | RecordKind::Dispute
        | RecordKind::Binding => None,
    };
    let envelope = countersigned(shared, candidate, &signers)?;
    Ok(Admitted { envelope, retires, replaced_owner })
}

/// The other owner's key, where the record needs that owner's signature: what is replaced may be somebody else's
/// only for disputes, and a rotation goes from one key to another. A key that rotations led to owns what the keys
/// before it owned, and needs nobody's word.
fn consent_of(
    shared: &Shared,
    candidate: &SignedRecord,
    replaces: &Digest,
    owner: &Digest,
    planned: &Planned,
) -> Result<Option<PublicKey>, RegistryError> {
    let record = candidate.record();
    if record.kind == RecordKind::Dispute {
        return Ok(None);
    }
    if record.kind == RecordKind::Rotation {
        // It ends the key that owns the record it names, so that must still be good: no heir stands in for it.
        if *owner == candidate.leaf().owner {
            let expected = "for a rotation, another key than that of the record named in `replaces`";
            let got = record.owner_key.to_string();
            return Err(record::field("owner_key", expected, got).into());
        }
        let old = agreed(candidate, replaces, key_of(shared, replaces, planned)?)?;
        check_not_retired(shared, owner, &old.to_string(), planned)?;
        return Ok(Some(old));
    }
    match heir_with(shared, owner, planned)? {
        Heir::Key { id, .. } if id == candidate.leaf().owner => Ok(None),
        // The key itself is known from a record that it signed, or, where that is erased, not at all.
        Heir::Key { since: None, .. } => agreed(candidate, replaces, key_of(shared, replaces, planned)?).map(Some),
        Heir::Key { since: Some(index), .. } => {
            let planned = planned.records.values().find(|(at, _)| *at == index).map(|(_, key)| *key);
            let key =
                planned.map_or_else(|| Ok(read::stored(shared, index)?.record.owner_key), Ok::<_, RegistryError>)?;
            agreed(candidate, replaces, key).map(Some)
        }
        Heir::Nobody { id, ended_by } => {
            Err(RegistryError::ReplacesRevoked { replaces: *replaces, owner: id, index: ended_by })
        }
    }
}

/// `owner`, where the candidate carries its signature.
fn agreed(candidate: &SignedRecord, replaces: &Digest, owner: PublicKey) -> Result<PublicKey, RegistryError> {
    match candidate.envelope().signature_by(&owner) {
        Some(_) => Ok(owner),
        None => Err(RegistryError::ReplacesForeign { replaces: *replaces, owner }),
    }
}

/// Who speaks for a key today, the batch that is being put together included.
fn heir_with(shared: &Shared, owner: &Digest, planned: &Planned) -> Result<Heir, RegistryError> {
    heir(owner, u64::MAX, |key| ending_with(shared, key, planned))
}

/// How a key ended, the batch that is being put together included.
fn ending_with(shared: &Shared, key: &Digest, planned: &Planned) -> Result<Option<Ending>, RegistryError> {
    if let Some(index) = planned.retired.get(key) {
        let by = planned.records.values().find(|(at, _)| at == index).map(|(_, owner)| owner.id());
        // A revocation is by the key that it ends, a rotation never.
        return Ok(Some(Ending { index: *index, to: by.filter(|by| by != key) }));
    }
    let index = reload::number_at(shared.store.as_ref(), &layout::retired(key), || format!("end of key {key}"))?;
    index.map(|index| read::ending_at(shared, index)).transpose()
}

/// The envelope with the signatures that mean something here, and the registry's.
fn countersigned(shared: &Shared, candidate: &SignedRecord, signers: &[PublicKey]) -> Result<Envelope, RegistryError> {
    let mut kept = Envelope::new(&candidate.envelope().payload_type, candidate.envelope().payload.as_slice());
    for signer in signers {
        let keyid = signer.id().to_string();
        if *signer == candidate.record().owner_key {
            // Verified on the way in.
            kept.signatures.push(EnvelopeSignature { keyid, sig: candidate.leaf().signature.to_vec() });
            continue;
        }
        // It was found above.
        let signature = candidate.envelope().signature_by(signer);
        kept.signatures.extend(signature.map(|s| EnvelopeSignature { keyid, sig: s.sig.clone() }));
    }
    kept.sign(&shared.key);
    let length = kept.to_json().len();
    if length > MAX_ENVELOPE_BYTES {
        // It would be kept and could not be read again.
        let expected = "an envelope of at most 65536 bytes with the registry's signature; list fewer views";
        return Err(record::field("views", expected, format!("{length} bytes")).into());
    }
    Ok(kept)
}

fn check_not_retired(shared: &Shared, id: &Digest, owner: &str, planned: &Planned) -> Result<(), RegistryError> {
    match ending_with(shared, id, planned)? {
        Some(Ending { index, to: Some(_) }) => Err(RegistryError::OwnerRotated { owner: owner.to_owned(), index }),
        Some(Ending { index, to: None }) => Err(RegistryError::OwnerRevoked { owner: owner.to_owned(), index }),
        None => Ok(()),
    }
}

fn check_nonce(
    shared: &Shared,
    record: &OwnerRecord,
    size: u64,
    writer: &Writer,
    planned: &Planned,
) -> Result<(), RegistryError> {
    let nonce = record.nonce;
    check_issued(shared, &nonce, size, &record.scene, &record.owner_key)?;
    match planned.nonces.get(&nonce).or_else(|| writer.used.get(&nonce)) {
        Some(index) => Err(RegistryError::NonceUsed { nonce, index: *index }),
        None => Ok(()),
    }
}

/// Whether this registry issued a nonce for a scene and an owner, lately.
pub(super) fn check_issued(
    shared: &Shared,
    nonce: &Digest,
    size: u64,
    scene: &str,
    owner: &PublicKey,
) -> Result<(), RegistryError> {
    match shared.nonces.check(nonce, size, scene, owner) {
        Ok(()) => Ok(()),
        Err(BadNonce::Foreign) => Err(RegistryError::NonceForeign { nonce: *nonce, scene: scene.to_owned() }),
        Err(BadNonce::Expired { issued }) => Err(RegistryError::NonceExpired { issued, size }),
    }
}

/// Key id of a record's owner, from its leaf: known also where the record is erased.
fn owner_of(shared: &Shared, record: &Digest, planned: &Planned) -> Result<Digest, RegistryError> {
    if let Some((_, owner)) = planned.records.get(record) {
        return Ok(owner.id());
    }
    let index = read::index_of(shared, record)?.ok_or(RegistryError::ReplacesUnknown { replaces: *record })?;
    Ok(read::record_leaf(shared, index)?.owner)
}

fn key_of(shared: &Shared, record: &Digest, planned: &Planned) -> Result<PublicKey, RegistryError> {
    if let Some((_, owner)) = planned.records.get(record) {
        return Ok(*owner);
    }
    let index = read::index_of(shared, record)?.ok_or(RegistryError::ReplacesUnknown { replaces: *record })?;
    Ok(read::stored(shared, index)?.record.owner_key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        format::key::OwnerKey,
        log::{Registry, store::FaultyStore},
    };

    #[test]
    fn ends_of_keys_in_the_same_batch_count() {
        let store = FaultyStore::new();
        let disk = Box::new(store.clone());
        let registry = Registry::open_store(Box::new(store), disk, OwnerKey::from_seed(&[9; 32]), "log.test").unwrap();
        let [a, b, c] = [1, 2, 3].map(|seed| OwnerKey::from_seed(&[seed; 32]).public());
        let mut planned = Planned::default();
        let mut plan = |name: &str, index, by: PublicKey, ends: PublicKey| {
            planned.records.insert(Digest::of(name), (index, by));
            planned.retired.insert(ends.id(), index);
        };
        plan("a to b", 0, b, a);
        plan("b to c", 1, c, b);
        let heir = heir_with(&registry.shared, &a.id(), &planned).unwrap();
        assert_eq!(heir, Heir::Key { id: c.id(), since: Some(1) });
        planned.records.insert(Digest::of("c ends"), (2, c));
        planned.retired.insert(c.id(), 2);
        assert_eq!(heir_with(&registry.shared, &a.id(), &planned).unwrap(), Heir::Nobody { id: c.id(), ended_by: 2 });
    }
}
