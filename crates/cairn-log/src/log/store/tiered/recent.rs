//! Rows that are in no run yet: in memory, ascending, and in the store as they came, many to one of its rows (the journal).
//!
//! Row by row, sled copied a page for every one of them, which was most of the time that a batch took.
//!
//! ```text
//! journal entry = version 1 | row ...        rows as in a run; at most about 8 KiB of them
//! ```

use std::collections::BTreeMap;

use super::format::{RESTORE, push_row, row};
use crate::log::store::{Change, Entry, Store, StoreError};

/// What the keys of journal entries begin with; their number follows.
const JOURNAL: &[u8] = b"journal/";
/// Version byte of a journal entry.
const VERSION: u8 = 1;
/// Bytes after which an entry is closed. Sled puts a dozen of them into a page before it writes the page anew, and pages of
/// 128 KiB and more it writes into files of their own.
const PIECE: usize = 8 << 10;
/// Entries read at a time.
const PAGE: usize = 256;

/// Rows in memory, and the journal entries that they are in.
#[derive(Default)]
pub(super) struct Recent {
    pub(super) rows: BTreeMap<Vec<u8>, Vec<u8>>,
    entries: Vec<u64>,
}

impl Recent {
    /// What a store's journal holds, and the number of its next entry.
    pub(super) fn load(store: &dyn Store) -> Result<(Self, u64), StoreError> {
        let (mut recent, mut next) = (Self::default(), 0_u64);
        loop {
            let page = store.scan(JOURNAL, &next.to_be_bytes(), PAGE)?;
            if page.is_empty() {
                return Ok((recent, next));
            }
            for (key, entry) in page {
                let place = format!("journal entry {key:02x?}");
                let refuse = || StoreError::new("open", &place, format!("damaged or of another version; {RESTORE}"));
                let number = key[JOURNAL.len()..].try_into().map(u64::from_be_bytes).map_err(|_| refuse())?;
                let rows = decode(&entry).ok_or_else(refuse)?;
                recent.add(rows, vec![number]);
                next = number.checked_add(1).ok_or_else(refuse)?;
            }
        }
    }

    /// Takes in rows that are in these journal entries; newer than all before.
    pub(super) fn add(&mut self, rows: Vec<Entry>, entries: Vec<u64>) {
        self.rows.extend(rows);
        self.entries.extend(entries);
    }

    /// What takes the journal entries of its rows away.
    pub(super) fn forgotten(&self) -> impl Iterator<Item = Change> {
        self.entries.iter().map(|number| (key_of(*number), None))
    }
}

/// Journal entries for rows, numbered from `next` on, and their numbers.
pub(super) fn entries_of(rows: &[Entry], next: &mut u64) -> (Vec<Change>, Vec<u64>) {
    let (mut entries, mut numbers, mut entry) = (Vec::new(), Vec::new(), vec![VERSION]);
    for (at, (key, value)) in rows.iter().enumerate() {
        // Longer ones were refused.
        push_row(&mut entry, key, value);
        if entry.len() >= PIECE || at + 1 == rows.len() {
            entries.push((key_of(*next), Some(std::mem::replace(&mut entry, vec![VERSION]))));
            numbers.push(*next);
            *next += 1;
        }
    }
    (entries, numbers)
}

fn key_of(number: u64) -> Vec<u8> {
    [JOURNAL, &number.to_be_bytes()].concat()
}

fn decode(entry: &[u8]) -> Option<Vec<Entry>> {
    let (&VERSION, mut rest) = entry.split_first()? else { return None };
    let mut rows = Vec::new();
    while !rest.is_empty() {
        let (key, value, behind) = row(rest)?;
        rows.push((key.to_vec(), value.to_vec()));
        rest = behind;
    }
    Some(rows)
}
