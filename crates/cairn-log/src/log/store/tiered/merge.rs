//! Several ascending sequences of rows as one; where two have the same key, the newer sequence's row counts.

use crate::log::store::{Entry, StoreError};

/// Rows in ascending order of keys.
pub(super) type Sorted<'a> = Box<dyn Iterator<Item = Result<Entry, StoreError>> + 'a>;

/// The merged rows. Sequences are few, so the smallest head is looked for among all.
pub(super) struct Merge<'a> {
    /// Newest first, each with its next row.
    sources: Vec<(Sorted<'a>, Option<Entry>)>,
}

impl<'a> Merge<'a> {
    /// Merges `sources`, newest first.
    pub(super) fn new(sources: Vec<Sorted<'a>>) -> Result<Self, StoreError> {
        let begun = sources.into_iter().map(|mut source| {
            let head = source.next().transpose()?;
            Ok((source, head))
        });
        Ok(Self { sources: begun.collect::<Result<_, StoreError>>()? })
    }

    fn smallest(&self) -> Option<usize> {
        let heads = self.sources.iter().enumerate().filter_map(|(at, (_, head))| Some((&head.as_ref()?.0, at)));
        heads.min().map(|(_, at)| at)
    }
}

impl Iterator for Merge<'_> {
    type Item = Result<Entry, StoreError>;

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.smallest()?;
        let (newest, older) = self.sources[at..].split_first_mut()?;
        let smallest = newest.1.take()?;
        let same = older.iter_mut().filter(|(_, head)| head.as_ref().is_some_and(|(key, _)| *key == smallest.0));
        for (source, head) in std::iter::once(newest).chain(same) {
            match source.next().transpose() {
                Ok(next) => *head = next,
                Err(e) => return Some(Err(e)),
            }
        }
        Some(Ok(smallest))
    }
}
