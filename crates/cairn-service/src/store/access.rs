//! Whose is what, and how much of it: accounts, quotas, and which scene was
//! imported by whom. An owner is known by the id of their account's key; what
//! comes in without an account belongs to nobody and is charged to nobody.
//!
//! Contract. A scene's owner is on the disk before the scene is there, and gone only
//! after it. What an import takes is charged before its first byte is stored. Whatever a
//! crash leaves of either is set right at the next start.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::auth::quota::check_jobs;
use crate::auth::{AccessError, Account, Accounts, Charge, Limits, Quotas, Reserved, Role, Usage};
use cairn_log::{Digest, Heir, OwnerRecord, PublicKey, RecordKind, Registry, RegistryError};
use serde::{Deserialize, Serialize};

use crate::error::EngineError;
use crate::store::folder::{DataFolder, read_json, write_json};
use crate::store::scenes;
use cairn_durable::{remove, sync_folder};

/// Format version of a scene's owner file.
const OWNER_VERSION: u32 = 1;

/// Accounts, quotas and owners of one data folder.
#[derive(Debug)]
pub struct Access {
    accounts: Accounts,
    quotas: Arc<Quotas>,
    /// Quotas of accounts without their own.
    limits: Limits,
    owners: PathBuf,
    /// Scenes whose imports are being finished: two of the same name must not write each other's owner.
    finishing: Mutex<HashSet<String>>,
}

/// Who imported a scene: `DIR/owners/NAME.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneOwner {
    format_version: u32,
    /// Id of the account's key.
    owner: Digest,
    bytes: u64,
    views: u64,
}

/// What an import takes, and of whom.
#[derive(Debug)]
pub struct Owned {
    owner: Digest,
    charge: Charge,
    reserved: Reserved,
}

/// A name that nobody else finishes an import under.
pub struct Place<'a> {
    access: &'a Access,
    name: String,
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.access.finishing.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.name);
    }
}

/// Now, seconds since 1970.
pub fn unix_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

impl Access {
    /// Reads accounts and quotas, and sets right what a crash left of scenes' owners.
    ///
    /// # Errors
    /// For a file that is damaged, and the file system's.
    pub fn open(folder: &DataFolder, limits: Limits) -> Result<Self, EngineError> {
        let accounts = Accounts::open(folder.accounts()).map_err(AccessError::from)?;
        let quotas = Quotas::open(folder.usage()).map_err(AccessError::from)?;
        let owners = folder.owners();
        std::fs::create_dir_all(&owners).map_err(EngineError::io("create", &owners))?;
        let mut owned = Vec::new();
        let io = |e| EngineError::io("list", &owners)(e);
        for entry in std::fs::read_dir(&owners).map_err(io)? {
            let path = entry.map_err(io)?.path();
            let name = path.file_name().and_then(|n| n.to_str()?.strip_suffix(".json"));
            match name.filter(|name| folder.scenes().join(name).is_dir()) {
                Some(name) => {
                    let found: SceneOwner = read_json(&path, OWNER_VERSION)?;
                    let charge = Charge { bytes: found.bytes, views: found.views };
                    owned.push((found.owner, name.to_owned(), charge));
                }
                None => remove(&path)?,
            }
        }
        quotas.reconcile(owned).map_err(AccessError::from)?;
        Ok(Self { accounts, quotas: Arc::new(quotas), limits, owners, finishing: Mutex::default() })
    }

    /// The accounts.
    pub fn accounts(&self) -> &Accounts {
        &self.accounts
    }

    /// What an owner may use: their own quotas, or else the daemon's.
    pub fn limits(&self, owner: &Digest) -> Limits {
        self.accounts.get(owner).and_then(|account| account.quota).unwrap_or(self.limits)
    }

    /// Who pays for what the account signed for by `key` (an id) uses: the account's id, or the key itself where it has none.
    pub fn payer(&self, key: &Digest) -> Digest {
        self.accounts.of_signer(key).map_or(*key, |account| account.id())
    }

    /// Takes down what the log says of the accounts' keys: which other key signs for them after rotations, and which have
    /// ended. For the start, since the daemon may have died between a rotation and [`Access::follow`].
    ///
    /// # Errors
    /// The registry's and the file system's.
    pub fn follow_all(&self, registry: &Registry) -> Result<(), EngineError> {
        self.accounts.list().iter().try_for_each(|account| self.follow_one(registry, account))
    }

    /// As [`Access::follow_all`], for the accounts that a record of the log, a revocation or rotation, may concern.
    ///
    /// # Errors
    /// The registry's and the file system's.
    pub fn follow(&self, registry: &Registry, record: &OwnerRecord) -> Result<(), EngineError> {
        let mut ended = record.owner_key.id();
        if record.kind == RecordKind::Rotation
            && let Some(replaces) = record.replaces
            && let Some(of) = registry.find(&replaces)?
        {
            ended = registry.leaf(of)?.owner;
        }
        let signed_by = |account: &&Account| account.id() == ended || account.signer().id() == ended;
        self.accounts.list().iter().filter(signed_by).try_for_each(|account| self.follow_one(registry, account))
    }

    fn follow_one(&self, registry: &Registry, account: &Account) -> Result<(), EngineError> {
        let (heir, ended_by) = match registry.heir(&account.id())? {
            Heir::Key { since: None, .. } => (None, None),
            Heir::Key { id, .. } if account.signer().id() == id => (account.heir, None),
            // The key stands in the rotation; where that was erased nobody can know it, and the old one is good no more.
            Heir::Key { since: Some(index), .. } => match registry.record(index) {
                Ok(rotation) => (Some(rotation.record.owner_key), None),
                Err(RegistryError::Erased { .. }) => (account.heir, Some(index)),
                Err(error) => return Err(error.into()),
            },
            Heir::Nobody { ended_by, .. } => (account.heir, Some(ended_by)),
        };
        if (heir, ended_by) != (account.heir, account.ended_by) {
            self.accounts.follow(&account.id(), heir, ended_by).map_err(EngineError::from)?;
            tracing::info!(account = account.name, heir = ?heir.map(|key| key.to_string()), ended_by, "key followed");
        }
        Ok(())
    }

    /// Charges an owner with one record, before it is submitted.
    ///
    /// # Errors
    /// The quota's.
    pub fn charge_record(&self, owner: &Digest) -> Result<(), EngineError> {
        Ok(self.quotas.charge_record(owner, &self.limits(owner), unix_s())?)
    }

    /// Gives back what a record was charged with that did not get into the log, or was in it before.
    pub fn forgive_record(&self, owner: &Digest) {
        if let Err(error) = self.quotas.forgive_record(owner, &self.limits(owner), unix_s()) {
            tracing::warn!(%owner, %error, "a record that is not in the log stays charged");
        }
    }

    /// What an owner uses; their jobs are counted elsewhere.
    pub fn usage(&self, owner: &Digest) -> Usage {
        self.quotas.usage(owner, unix_s())
    }

    fn file(&self, scene: &str) -> PathBuf {
        self.owners.join(format!("{scene}.json"))
    }

    /// Who imported a scene; `None` for nobody's, and for a name that no scene can have.
    ///
    /// # Errors
    /// [`EngineError::Stored`].
    pub fn owner_of(&self, scene: &str) -> Result<Option<Digest>, EngineError> {
        if scenes::check_scene_name(scene).is_err() {
            return Ok(None);
        }
        let path = self.file(scene);
        if !path.exists() {
            return Ok(None);
        }
        let found: SceneOwner = read_json(&path, OWNER_VERSION)?;
        Ok(Some(found.owner))
    }

    /// Charges an owner with an import that begins. `import` is like no other's.
    ///
    /// # Errors
    /// The quota's.
    pub fn reserve(&self, owner: Digest, import: &str, charge: Charge) -> Result<Owned, EngineError> {
        // The blank keeps it apart from every scene's name.
        let item = format!("import {import}");
        Ok(Owned { owner, charge, reserved: Reserved::new(&self.quotas, owner, &self.limits(&owner), item, charge)? })
    }

    /// Takes the name of a scene whose import is about to be finished.
    ///
    /// # Errors
    /// As for a scene that is there, while another import is finished under it.
    pub fn place(&self, scene: &str, path: PathBuf) -> Result<Place<'_>, EngineError> {
        let taken = || Err(cairn_scene::CaptureError::SceneExists { path: path.clone() }.into());
        if !self.finishing.lock().unwrap_or_else(PoisonError::into_inner).insert(scene.to_owned()) {
            return taken();
        }
        let place = Place { access: self, name: scene.to_owned() };
        if path.exists() { taken() } else { Ok(place) }
    }

    /// Writes down whose a scene is going to be.
    ///
    /// # Errors
    /// The file system's.
    pub fn announce(&self, place: &Place<'_>, owned: Option<&Owned>) -> Result<(), EngineError> {
        let path = self.file(&place.name);
        match owned {
            Some(Owned { owner, charge: Charge { bytes, views }, .. }) => write_json(
                &path,
                &SceneOwner { format_version: OWNER_VERSION, owner: *owner, bytes: *bytes, views: *views },
            ),
            None => Ok(remove(&path)?),
        }
    }

    /// The scene is there: its charge stands under its name.
    pub fn became(&self, place: &Place<'_>, owned: Option<Owned>) {
        if let Some(owned) = owned
            && let Err(error) = owned.reserved.became(&place.name)
        {
            // It stands charged all the same, under the import's name, until the next start.
            tracing::warn!(scene = place.name, %error, "a scene's charge keeps its import's name");
        }
    }

    /// The scene is gone, or came to nothing: so is its owner, and what it was charged with.
    ///
    /// # Errors
    /// The file system's; the next start sets it right.
    pub fn forget(&self, scene: &str) -> Result<(), EngineError> {
        let path = self.file(scene);
        if !path.exists() {
            return Ok(());
        }
        let found: SceneOwner = read_json(&path, OWNER_VERSION)?;
        self.quotas.release(&found.owner, scene).map_err(AccessError::from)?;
        remove(&path)?;
        Ok(sync_folder(&self.owners)?)
    }

    /// Whether an owner, of whose trainings `open` have not ended, may have one more.
    ///
    /// # Errors
    /// The quota's.
    pub fn check_training(&self, owner: &Digest, open: u64) -> Result<(), EngineError> {
        let limits = self.limits(owner);
        check_jobs(&limits, open).map_err(AccessError::from)?;
        self.quotas.check_training(owner, &limits, unix_s()).map_err(AccessError::from)?;
        Ok(())
    }

    /// Seconds of training that an owner has left; `None` without a limit.
    pub fn seconds_left(&self, owner: &Digest) -> Option<f64> {
        self.quotas.seconds_left(owner, &self.limits(owner), unix_s())
    }

    /// Charges an owner with seconds of training.
    ///
    /// # Errors
    /// The file system's.
    pub fn spend(&self, owner: &Digest, seconds: f64) -> Result<(), EngineError> {
        Ok(self.quotas.spend(owner, seconds, unix_s()).map_err(AccessError::from)?)
    }
}

/// Adds an account to a data folder that no daemon has open: how the first operator is made.
///
/// # Errors
/// [`EngineError::Locked`] while a daemon runs on it; the accounts'.
pub fn add_account(data: &Path, key: PublicKey, name: &str, role: Role) -> Result<Account, EngineError> {
    let folder = DataFolder::open(data)?;
    let accounts = Accounts::open(folder.accounts()).map_err(AccessError::from)?;
    Ok(accounts.add(key, name, role, unix_s())?)
}

#[cfg(test)]
#[path = "access_tests.rs"]
mod tests;
