//! Quotas: what one owner may use, in one durable file.
//!
//! What is stored is charged by item (a scene, or an import under way), so that
//! charging again replaces, and releasing again changes nothing: whatever was cut
//! off in between can be set right by [`Quotas::reconcile`] with the list of items
//! that there really are. Training is charged by the hour that it was spent in, and
//! is forgiven a day later; so are owner records, which are also counted in all. Queued jobs are counted where they are kept, so that
//! there is nothing to leak; only their limit is held here.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use cairn_log::Digest;
use serde::{Deserialize, Serialize};

use crate::auth::error::{AccessError, FileError, Frees, Kind, QuotaError};
use crate::auth::file;

const HOUR_S: u64 = 3600;
/// Hours of the rolling day, the present one included.
const WINDOW_H: u64 = 24;

/// How much of each; 0 means no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Bytes of photographs stored.
    pub bytes: u64,
    /// Views stored.
    pub views: u64,
    /// Seconds of training within a rolling day.
    pub training_seconds: u64,
    /// Trainings that have not ended.
    pub queued_jobs: u64,
    /// Owner records submitted, in all. What the log holds stays, so these are never given back.
    pub records: u64,
    /// Owner records submitted within a rolling day.
    pub records_per_day: u64,
}

/// What an owner uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Bytes of photographs stored, imports under way included.
    pub bytes: u64,
    /// Views stored, likewise.
    pub views: u64,
    /// Seconds of training within the rolling day, rounded up.
    pub training_seconds: u64,
    /// When the oldest of these are forgiven, seconds since 1970; 0 where there are none.
    pub training_frees_at: u64,
    /// Owner records submitted since they were counted: where neither of their quotas was set, they were not.
    pub records: u64,
    /// Of these, within the rolling day.
    pub records_per_day: u64,
}

/// What one item takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Charge {
    /// Bytes of photographs.
    pub bytes: u64,
    /// Views.
    pub views: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Owner {
    /// By item.
    stored: BTreeMap<String, Charge>,
    /// Milliseconds of training, by hour since 1970.
    trained_ms: BTreeMap<u64, u64>,
    /// Owner records submitted, in all.
    records: u64,
    /// Of the last day, by hour since 1970.
    records_by_hour: BTreeMap<u64, u64>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    format_version: u64,
    /// By key id.
    owners: BTreeMap<String, Owner>,
}

/// The quotas of all owners of a daemon.
#[derive(Debug)]
pub struct Quotas {
    path: PathBuf,
    used: Mutex<Stored>,
}

impl Quotas {
    /// Reads the file at `path`; none there is nothing used.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn open(path: PathBuf) -> Result<Self, FileError> {
        let empty = Stored { format_version: file::FORMAT_VERSION, owners: BTreeMap::new() };
        let used = file::read(&path)?.unwrap_or(empty);
        Ok(Self { path, used: Mutex::new(used) })
    }

    /// Charges `owner` with what `item` takes, durably, or not at all. Charging an item again replaces its charge.
    ///
    /// # Errors
    /// [`QuotaError`] of the first quota that does not allow it; [`FileError`].
    pub fn charge(&self, owner: &Digest, limits: &Limits, item: &str, charge: Charge) -> Result<(), AccessError> {
        self.change(|all| {
            let owner = all.entry(owner.to_string()).or_default();
            owner.stored.remove(item);
            let used = owner.sum();
            for (kind, limit, used, needed) in [
                (Kind::Bytes, limits.bytes, used.bytes, charge.bytes),
                (Kind::Views, limits.views, used.views, charge.views),
            ] {
                if limit != 0 && used.saturating_add(needed) > limit {
                    return Err(QuotaError { kind, limit, used, needed, frees: Frees::OnDelete }.into());
                }
            }
            owner.stored.insert(item.to_owned(), charge);
            Ok(())
        })
    }

    /// Gives a charge to another item of the same owner: an import under way became a scene.
    ///
    /// # Errors
    /// [`FileError`]; nothing has changed then.
    pub fn rename(&self, owner: &Digest, from: &str, to: &str) -> Result<(), FileError> {
        self.change(|all| {
            if let Some(owner) = all.get_mut(&owner.to_string())
                && let Some(charge) = owner.stored.remove(from)
            {
                owner.stored.insert(to.to_owned(), charge);
            }
            Ok(())
        })
    }

    /// Takes back what an item was charged with; nothing where it was not.
    ///
    /// # Errors
    /// [`FileError`]; the charge still stands then.
    pub fn release(&self, owner: &Digest, item: &str) -> Result<(), FileError> {
        self.change(|all| {
            if let Some(owner) = all.get_mut(&owner.to_string()) {
                owner.stored.remove(item);
            }
            Ok(())
        })
    }

    /// Sets what is stored to exactly `items`: for the start, after whatever cut the last run off.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn reconcile(&self, items: impl IntoIterator<Item = (Digest, String, Charge)>) -> Result<(), FileError> {
        self.change(|all| {
            all.values_mut().for_each(|owner| owner.stored.clear());
            for (owner, item, charge) in items {
                all.entry(owner.to_string()).or_default().stored.insert(item, charge);
            }
            Ok(())
        })
    }

    /// Charges `owner` with seconds of training that were spent until `now`, durably. They are spent: no quota
    /// refuses them.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn spend(&self, owner: &Digest, seconds: f64, now: u64) -> Result<(), FileError> {
        // NaN becomes 0, as it should.
        let ms = (seconds.max(0.0) * 1000.0).ceil() as u64;
        self.change(|all| {
            let owner = all.entry(owner.to_string()).or_default();
            count(&mut owner.trained_ms, ms, now);
            Ok(())
        })
    }

    /// Seconds of training that `owner` has left; `None` without a limit.
    pub fn seconds_left(&self, owner: &Digest, limits: &Limits, now: u64) -> Option<f64> {
        if limits.training_seconds == 0 {
            return None;
        }
        let used = self.lock().owners.get(&owner.to_string()).map_or(0, |o| of_the_day(&o.trained_ms, now).0);
        Some(limits.training_seconds.saturating_mul(1000).saturating_sub(used) as f64 / 1000.0)
    }

    /// Whether `owner` has any training left.
    ///
    /// # Errors
    /// [`QuotaError`], naming the time at which the next hour is forgiven.
    pub fn check_training(&self, owner: &Digest, limits: &Limits, now: u64) -> Result<(), QuotaError> {
        if self.seconds_left(owner, limits, now).is_none_or(|left| left > 0.0) {
            return Ok(());
        }
        let usage = self.usage(owner, now);
        Err(QuotaError {
            kind: Kind::TrainingSeconds,
            limit: limits.training_seconds,
            used: usage.training_seconds,
            needed: 1,
            frees: Frees::At(usage.training_frees_at),
        })
    }

    /// Charges `owner` with one owner record submitted at `now`, durably, or not at all. Without a limit nothing is
    /// written down: a file a record would be slower than the log.
    ///
    /// # Errors
    /// [`QuotaError`] of the first quota that does not allow it; [`FileError`].
    pub fn charge_record(&self, owner: &Digest, limits: &Limits, now: u64) -> Result<(), AccessError> {
        if limits.records == 0 && limits.records_per_day == 0 {
            return Ok(());
        }
        self.change(|all| {
            let owner = all.entry(owner.to_string()).or_default();
            let refused = |kind, limit, used, frees| Err(QuotaError { kind, limit, used, needed: 1, frees }.into());
            if limits.records != 0 && owner.records >= limits.records {
                return refused(Kind::Records, limits.records, owner.records, Frees::OnRaise);
            }
            let (today, frees_at) = of_the_day(&owner.records_by_hour, now);
            if limits.records_per_day != 0 && today >= limits.records_per_day {
                return refused(Kind::RecordsPerDay, limits.records_per_day, today, Frees::At(frees_at));
            }
            owner.records = owner.records.saturating_add(1);
            count(&mut owner.records_by_hour, 1, now);
            Ok(())
        })
    }

    /// Takes back a charge of [`Quotas::charge_record`]: the record did not get into the log, or was in it before.
    ///
    /// # Errors
    /// [`FileError`]; the charge still stands then.
    pub fn forgive_record(&self, owner: &Digest, limits: &Limits, now: u64) -> Result<(), FileError> {
        if limits.records == 0 && limits.records_per_day == 0 {
            return Ok(());
        }
        self.change(|all| {
            if let Some(owner) = all.get_mut(&owner.to_string()) {
                owner.records = owner.records.saturating_sub(1);
                let counted = owner.records_by_hour.get(&(now / HOUR_S)).copied().unwrap_or(0);
                match counted.saturating_sub(1) {
                    0 => drop(owner.records_by_hour.remove(&(now / HOUR_S))),
                    left => drop(owner.records_by_hour.insert(now / HOUR_S, left)),
                }
            }
            Ok(())
        })
    }

    /// What `owner` uses.
    pub fn usage(&self, owner: &Digest, now: u64) -> Usage {
        let used = self.lock();
        let Some(owner) = used.owners.get(&owner.to_string()) else { return Usage::default() };
        let Charge { bytes, views } = owner.sum();
        let (trained_ms, training_frees_at) = of_the_day(&owner.trained_ms, now);
        Usage {
            bytes,
            views,
            training_seconds: trained_ms.div_ceil(1000),
            training_frees_at,
            records: owner.records,
            records_per_day: of_the_day(&owner.records_by_hour, now).0,
        }
    }

    /// Changes a copy, writes that down, and only then lets it count.
    fn change<E: From<FileError>>(
        &self,
        change: impl FnOnce(&mut BTreeMap<String, Owner>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut used = self.lock();
        let mut next = used.clone();
        change(&mut next.owners)?;
        next.owners.retain(|_, owner| *owner != Owner::default());
        if next != *used {
            file::write(&self.path, &next)?;
            *used = next;
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Stored> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether one more training fits, where `open` of the owner's have not ended.
///
/// # Errors
/// [`QuotaError`].
pub fn check_jobs(limits: &Limits, open: u64) -> Result<(), QuotaError> {
    if limits.queued_jobs == 0 || open < limits.queued_jobs {
        return Ok(());
    }
    let (kind, limit) = (Kind::QueuedJobs, limits.queued_jobs);
    Err(QuotaError { kind, limit, used: open, needed: 1, frees: Frees::OnEnd })
}

impl Owner {
    fn sum(&self) -> Charge {
        self.stored.values().fold(Charge::default(), |sum, c| Charge {
            bytes: sum.bytes.saturating_add(c.bytes),
            views: sum.views.saturating_add(c.views),
        })
    }
}

/// Counts `amount` in the present hour, and forgets hours before the rolling day.
fn count(by_hour: &mut BTreeMap<u64, u64>, amount: u64, now: u64) {
    by_hour.retain(|hour, _| hour + WINDOW_H > now / HOUR_S);
    let hour = by_hour.entry(now / HOUR_S).or_default();
    *hour = hour.saturating_add(amount);
}

/// The sum within the rolling day, and when the oldest hour of it is forgiven, seconds since 1970;
/// 0 where there is none. Hours that a clock set back put into the future count.
fn of_the_day(by_hour: &BTreeMap<u64, u64>, now: u64) -> (u64, u64) {
    let counted = || by_hour.iter().filter(|(hour, amount)| *hour + WINDOW_H > now / HOUR_S && **amount > 0);
    let sum = counted().fold(0_u64, |sum, (_, amount)| sum.saturating_add(*amount));
    (sum, counted().next().map_or(0, |(hour, _)| (hour + WINDOW_H) * HOUR_S))
}

/// A charge for an import under way: taken back when dropped, unless the import became something.
#[derive(Debug)]
pub struct Reserved {
    quotas: Arc<Quotas>,
    owner: Digest,
    item: Option<String>,
}

impl Reserved {
    /// Charges `owner` with an item that is not there yet. `item` must be like no other.
    ///
    /// # Errors
    /// As [`Quotas::charge`].
    pub fn new(
        quotas: &Arc<Quotas>,
        owner: Digest,
        limits: &Limits,
        item: String,
        charge: Charge,
    ) -> Result<Self, AccessError> {
        quotas.charge(&owner, limits, &item, charge)?;
        Ok(Self { quotas: quotas.clone(), owner, item: Some(item) })
    }

    /// It is there now, as `name`.
    ///
    /// # Errors
    /// [`FileError`]. The charge stands under its old name then, until the next [`Quotas::reconcile`].
    pub fn became(mut self, name: &str) -> Result<(), FileError> {
        match self.item.take() {
            Some(item) => self.quotas.rename(&self.owner, &item, name),
            None => Ok(()),
        }
    }
}

impl Drop for Reserved {
    fn drop(&mut self) {
        if let Some(item) = self.item.take() {
            // Where this cannot be written, it is set right at the next start.
            let _ = self.quotas.release(&self.owner, &item);
        }
    }
}

#[cfg(test)]
#[path = "quota_tests.rs"]
mod tests;
