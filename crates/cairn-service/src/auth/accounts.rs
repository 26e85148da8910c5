//! Accounts: a public key, a name, a role. Kept in one JSON file that is written
//! anew, durably, at every change.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use cairn_log::{Digest, PublicKey};
use serde::{Deserialize, Serialize};

use crate::auth::error::{AccessError, AccountError, FileError, MAX_NAME};
use crate::auth::file;
use crate::auth::quota::Limits;
use crate::auth::registration::Registration;
use crate::auth::roles::Role;

/// Most accounts of one daemon. Anybody may ask for one, and the file is read whole.
pub const MAX_ACCOUNTS: usize = 50_000;
/// Most accounts that wait for approval at the same time.
pub const MAX_WAITING: usize = 1_000;

/// Where an account stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// Registered, and not yet approved by an operator.
    Waiting,
    /// In use.
    Active,
    /// Shut out by an operator.
    Disabled,
}

impl fmt::Display for Standing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// An account.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Account {
    /// Signs the account's tokens. Never of small order.
    pub key: PublicKey,
    /// What people call it; two accounts may have the same.
    pub name: String,
    /// What it may do.
    pub role: Role,
    /// The role that its owner asked for.
    pub asked: Role,
    /// Whether it may do anything at all.
    pub standing: Standing,
    /// When it was registered, seconds since 1970 by the daemon's clock.
    pub since: u64,
    /// Quotas of its own instead of the daemon's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quota: Option<Limits>,
    /// The key in place of `key`, as the log of owner records has it after rotations: it signs now, and `key` no more.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heir: Option<PublicKey>,
    /// Index of the record that ended the account's key with none in its place. Then nobody signs for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ended_by: Option<u64>,
}

impl Account {
    /// An active one.
    fn new(key: PublicKey, name: &str, role: Role, since: u64) -> Self {
        let (name, standing) = (name.to_owned(), Standing::Active);
        Self { key, name, role, asked: role, standing, since, quota: None, heir: None, ended_by: None }
    }

    /// What quotas and scenes know it by: the key that it was registered under, whatever signs for it today.
    pub fn id(&self) -> Digest {
        self.key.id()
    }

    /// The key that signs for it.
    pub fn signer(&self) -> &PublicKey {
        self.heir.as_ref().unwrap_or(&self.key)
    }

    /// Whether it is in use, and somebody can sign for it.
    fn is_usable(&self) -> bool {
        self.standing == Standing::Active && self.ended_by.is_none()
    }
}

/// Who gets an account.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// Everybody, as contributor, at once.
    Open,
    /// Whom an operator approves.
    Approval,
    /// Nobody who is not there already.
    Closed,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    format_version: u64,
    accounts: Vec<Account>,
}

/// What an operator changes of an account.
#[derive(Clone, Copy, Debug)]
pub enum Change {
    /// Approves it, with this role or the one that it asked for.
    Approve(Option<Role>),
    /// Gives it another role.
    Role(Role),
    /// Shuts it out, or lets it in again.
    Disabled(bool),
    /// Gives it quotas of its own, or (`None`) the daemon's again.
    Quota(Option<Limits>),
}

/// All accounts of a daemon.
#[derive(Debug)]
pub struct Accounts {
    path: PathBuf,
    by_id: Mutex<BTreeMap<Digest, Account>>,
}

type Map = BTreeMap<Digest, Account>;

impl Accounts {
    /// Reads the file at `path`; none there is no accounts.
    ///
    /// # Errors
    /// [`FileError`], also where a key stands there twice.
    pub fn open(path: PathBuf) -> Result<Self, FileError> {
        let mut by_id = Map::new();
        let stored: Option<Stored> = file::read(&path)?;
        for account in stored.into_iter().flat_map(|s| s.accounts) {
            if let Some(twice) = by_id.insert(account.id(), account) {
                return Err(FileError::Stored { path, problem: format!("the key {} stands there twice", twice.key) });
            }
        }
        Ok(Self { path, by_id: Mutex::new(by_id) })
    }

    /// The account whose key has this id.
    pub fn get(&self, id: &Digest) -> Option<Account> {
        self.lock().get(id).cloned()
    }

    /// The account for which the key with this id signs, or did before it ended: its own first, then the oldest of those
    /// that continue under it.
    pub fn of_signer(&self, id: &Digest) -> Option<Account> {
        let all = self.lock();
        place_of(&all, id).and_then(|place| all.get(&place)).cloned()
    }

    /// All accounts, oldest first, then by name.
    pub fn list(&self) -> Vec<Account> {
        let mut all: Vec<Account> = self.lock().values().cloned().collect();
        all.sort_by(|a, b| (a.since, &a.name).cmp(&(b.since, &b.name)));
        all
    }

    /// Takes in a registration whose proof was verified ([`crate::auth::Nonces::verify`]). A key that has an account, or
    /// under which one continues, keeps it as it is.
    ///
    /// # Errors
    /// [`AccountError`], [`FileError`].
    pub fn register(&self, asked: &Registration, policy: Policy, now: u64) -> Result<Account, AccessError> {
        self.edit(|all| {
            if let Some(known) = place_of(all, &asked.key.id()).and_then(|place| all.get(&place)) {
                return Ok(known.clone());
            }
            let standing = match policy {
                Policy::Open => Standing::Active,
                Policy::Approval => Standing::Waiting,
                Policy::Closed => return Err(AccountError::Closed),
            };
            let waiting = all.values().filter(|a| a.standing == Standing::Waiting).count();
            if standing == Standing::Waiting && waiting >= MAX_WAITING {
                return Err(AccountError::TooMany { what: "wait for approval", got: waiting });
            }
            // Whatever was asked for: more than a contributor is an operator's to give.
            let account = Account::new(asked.key, &asked.name, Role::Contributor, now);
            insert(all, Account { asked: asked.role, standing, ..account })
        })
    }

    /// Adds an active account without a proof: for the daemon's own machine.
    ///
    /// # Errors
    /// [`AccountError`], [`FileError`].
    pub fn add(&self, key: PublicKey, name: &str, role: Role, now: u64) -> Result<Account, AccessError> {
        self.edit(|all| {
            if let Some(known) = all.get(&key.id()) {
                return Err(AccountError::Exists { key, name: known.name.clone(), role: known.role });
            }
            insert(all, Account::new(key, name, role, now))
        })
    }

    /// Changes the account of `key`.
    ///
    /// # Errors
    /// [`AccountError`], [`FileError`].
    pub fn change(&self, key: &PublicKey, change: Change) -> Result<Account, AccessError> {
        self.edit(|all| {
            let operators = all.values().filter(|a| a.role == Role::Operator && a.is_usable()).count();
            let place = place_of(all, &key.id()).ok_or(AccountError::NoSuch { key: *key })?;
            let account = all.get_mut(&place).ok_or(AccountError::NoSuch { key: *key })?;
            let loses_operator = matches!(change, Change::Disabled(true))
                || matches!(change, Change::Role(role) if role != Role::Operator);
            if loses_operator && account.role == Role::Operator && account.is_usable() && operators == 1 {
                return Err(AccountError::LastOperator { name: account.name.clone() });
            }
            match (change, account.standing) {
                (Change::Approve(role), Standing::Waiting) => {
                    account.standing = Standing::Active;
                    account.role = role.unwrap_or(account.asked);
                }
                (Change::Approve(_), standing) => {
                    let standing = standing.to_string();
                    return Err(AccountError::NotWaiting { name: account.name.clone(), standing });
                }
                (Change::Disabled(false), Standing::Waiting) => {
                    return Err(AccountError::Waiting { name: account.name.clone() });
                }
                (Change::Disabled(true), _) => account.standing = Standing::Disabled,
                (Change::Disabled(false), _) => account.standing = Standing::Active,
                (Change::Role(role), _) => account.role = role,
                (Change::Quota(quota), _) => account.quota = quota,
            }
            Ok(account.clone())
        })
    }

    /// Takes down what the log says of an account's key (the account's id): the key in its place, or the record that ended it
    /// with none. Also the last operator's: a key in other hands is worse than none.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn follow(&self, id: &Digest, heir: Option<PublicKey>, ended_by: Option<u64>) -> Result<(), AccessError> {
        let mut by_id = self.lock();
        let mut next = by_id.clone();
        let Some(account) = next.get_mut(id) else { return Ok(()) };
        (account.heir, account.ended_by) = (heir, ended_by);
        self.replace(&mut by_id, next)
    }

    /// Changes a copy, writes that down, and only then lets it count.
    fn edit(&self, edit: impl FnOnce(&mut Map) -> Result<Account, AccountError>) -> Result<Account, AccessError> {
        let mut by_id = self.lock();
        let mut next = by_id.clone();
        let changed = edit(&mut next)?;
        self.replace(&mut by_id, next)?;
        Ok(changed)
    }

    fn replace(&self, by_id: &mut Map, next: Map) -> Result<(), AccessError> {
        if next != *by_id {
            let accounts = next.values().cloned().collect();
            file::write(&self.path, &Stored { format_version: file::FORMAT_VERSION, accounts })?;
            *by_id = next;
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Map> {
        self.by_id.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Where the account of a key stands, by the key's id: its own, or the oldest that continues under it.
fn place_of(all: &Map, id: &Digest) -> Option<Digest> {
    if all.contains_key(id) {
        return Some(*id);
    }
    let heirs = all.iter().filter(|(_, account)| account.heir.is_some_and(|heir| heir.id() == *id));
    heirs.min_by_key(|(_, account)| account.since).map(|(place, _)| *place)
}

fn insert(all: &mut Map, account: Account) -> Result<Account, AccountError> {
    let bytes = account.name.len();
    let control = account.name.chars().any(char::is_control);
    if !(1..=MAX_NAME).contains(&bytes) || control {
        return Err(AccountError::Name { bytes, more: if control { " and control characters" } else { "" } });
    }
    if all.len() >= MAX_ACCOUNTS {
        return Err(AccountError::TooMany { what: "are there", got: all.len() });
    }
    all.insert(account.id(), account.clone());
    Ok(account)
}

#[cfg(test)]
#[path = "accounts_tests.rs"]
mod tests;
