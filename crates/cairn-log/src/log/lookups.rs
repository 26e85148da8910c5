//! What a registry is asked about its log. Nothing here writes.

use super::{
    error::{RegistryError, inconsistent},
    read::{self, LogEntry},
    registry::Registry,
    shared::Shared,
};
use crate::format::{
    digest::Digest,
    heir::{self, Ending, Heir},
    key::PublicKey,
    leaf::Leaf,
    map::{MapEntry, MapKey},
    merkle,
    proof::TlogProof,
    record::RecordKind,
};

impl Registry {
    /// The evidence that entry `index` is in the log, under the newest checkpoint, or the newest cosigned one where that
    /// holds it.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for an index that is not there.
    pub fn tlog_proof(&self, index: u64) -> Result<TlogProof, RegistryError> {
        let state = self.shared.read();
        let cosigned = state.cosigned.as_ref().filter(|(size, _)| index < *size);
        let (size, checkpoint) = match cosigned {
            Some((size, note)) => (*size, note.clone()),
            None => (state.size, state.checkpoint.clone()),
        };
        let hashes = state.proven(index, size)?;
        Ok(TlogProof { extra: None, index, hashes, checkpoint })
    }

    /// Proof that the tree of `to` entries begins with the tree of `from` entries.
    ///
    /// # Errors
    /// [`RegistryError::Proof`] for `from` 0 or beyond `to`, or a size that is not there.
    pub fn prove_consistency(&self, from: u64, to: u64) -> Result<Vec<Digest>, RegistryError> {
        let state = self.shared.read();
        read::reached(to, &state)?;
        let proof = merkle::prove_consistency(&state.tree, from, to)?;
        let (first, second) = (merkle::root_at(&state.tree, from)?, merkle::root_at(&state.tree, to)?);
        state.hold_to_signed(to, &second)?;
        merkle::verify_consistency(from, to, &proof, &first, &second).map_err(|e| read::rotten(&e))?;
        Ok(proof)
    }

    /// At most `limit` of the entries with index `from` or more: those about one scene (records, erased or not), or all.
    ///
    /// # Errors
    /// As [`Registry::entry`].
    pub fn page(&self, scene: Option<&str>, from: u64, limit: usize) -> Result<Vec<LogEntry>, RegistryError> {
        let Some(scene) = scene else {
            return (from..self.shared.size())
                .take(limit)
                .map(|index| read::stored_entry(&self.shared, index))
                .collect();
        };
        let listed = self.listed(&MapKey::scene(scene), from, limit)?;
        listed.iter().map(|entry| read::stored_entry(&self.shared, entry.index)).collect()
    }

    /// At most `limit` of a map key's entries with index `from` or more.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn listed(&self, key: &MapKey, from: u64, limit: usize) -> Result<Vec<MapEntry>, RegistryError> {
        read::entries_below(&self.shared, key, self.shared.size(), from, limit)
    }

    /// How the key `owner` ended, if the log holds a revocation or rotation of it.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn ended(&self, owner: &PublicKey) -> Result<Option<Ending>, RegistryError> {
        read::ending(&self.shared, &owner.id())
    }

    /// As [`Registry::ended`], of the key with this id.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn ending_of(&self, key: &Digest) -> Result<Option<Ending>, RegistryError> {
        read::ending(&self.shared, key)
    }

    /// Who speaks for the key with this id today: itself, or what rotations put in its place.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn heir(&self, owner: &Digest) -> Result<Heir, RegistryError> {
        heir::heir(owner, self.shared.size(), |key| read::ending(&self.shared, key))
    }

    /// The leaf of the record at `index`, erased or not: its kind, its digest and its owner's key id.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`], [`RegistryError::NotARecord`], [`RegistryError::Inconsistent`].
    pub fn leaf(&self, index: u64) -> Result<Leaf, RegistryError> {
        let size = self.shared.size();
        if index >= size {
            return Err(RegistryError::NoSuchRecord { index, size });
        }
        read::record_leaf(&self.shared, index)
    }

    /// What names a record in `replaces`, in the log's order, erased or not: where it stands, and its kind.
    ///
    /// # Errors
    /// [`RegistryError::Store`], [`RegistryError::Inconsistent`].
    pub fn about(&self, record: &Digest) -> Result<Vec<(u64, RecordKind)>, RegistryError> {
        let listed = self.listed(&MapKey::about(record), 0, usize::MAX)?;
        listed.iter().map(|entry| Ok((entry.index, read::record_leaf(&self.shared, entry.index)?.kind))).collect()
    }

    /// Re-reads everything: each leaf, its hash in the tree, its envelope, both signatures, its indices. Gives what is wrong,
    /// nothing where all is well.
    ///
    /// # Errors
    /// [`RegistryError::Store`] where the store cannot be read.
    pub fn check(&self) -> Result<Vec<RegistryError>, RegistryError> {
        let size = self.shared.size();
        let mut faults = Vec::new();
        for index in 0..size {
            match check_entry(&self.shared, index) {
                Ok(()) => {}
                Err(RegistryError::Store(e)) => return Err(e.into()),
                Err(fault) => faults.push(fault),
            }
        }
        Ok(faults)
    }
}

fn check_entry(shared: &Shared, index: u64) -> Result<(), RegistryError> {
    let fault = |what: String| Err(inconsistent(&format!("record {index}"), what));
    let (entry, expected) = (read::stored_entry(shared, index)?, shared.read().tree.leaf(index)?);
    let (got, digest) = match &entry {
        LogEntry::Record(stored) => (stored.leaf.hash(), Some(stored.leaf.record)),
        LogEntry::Erased { leaf, .. } => (leaf.hash(), Some(leaf.record)),
        LogEntry::Map { leaf, .. } => (leaf.hash(), None),
    };
    if expected != got {
        return fault(format!("leaf hash {got}, the tree holds {expected}"));
    }
    if let LogEntry::Record(stored) = &entry
        && stored.envelope.signature_by(&shared.key.public()).is_none()
    {
        return fault("the registry's signature is missing or does not verify".into());
    }
    let Some(digest) = digest else { return Ok(()) };
    match read::index_of(shared, &digest)? {
        Some(found) if found == index => Ok(()),
        found => fault(format!("the index by digest says {found:?}")),
    }
}
