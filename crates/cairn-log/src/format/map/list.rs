//! A key's value: the RFC 6962 root over the records that are listed under it.
//!
//! A list only ever grows, so its root needs no more than the hashes of its full
//! subtrees, one for each binary digit of its length: [`ListState`].

use serde::{Deserialize, Serialize};

use crate::format::{
    digest::Digest,
    merkle::{self, Frontier},
    serial,
};

/// One record of a list, by its place in the log and its leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapEntry {
    /// The record's index in the log.
    pub index: u64,
    /// Hash of its leaf in the log; base64 in JSON.
    #[serde(with = "serial::hash")]
    pub leaf_hash: Digest,
}

impl MapEntry {
    /// The entry's own leaf hash in its list: `H(0x00 | index u64 BE | leaf hash)`.
    pub fn hash(&self) -> Digest {
        let mut data = [0; 8 + Digest::LEN];
        data[..8].copy_from_slice(&self.index.to_be_bytes());
        data[8..].copy_from_slice(self.leaf_hash.as_bytes());
        merkle::leaf_hash(&data)
    }
}

/// Root over entries in log order: what a key maps to. Over none, SHA-256 of nothing, which no key maps to.
pub fn list_root(entries: &[MapEntry]) -> Digest {
    let mut state = ListState::default();
    entries.iter().for_each(|entry| state.append(entry));
    state.root()
}

/// A list in compact form: how many entries, and the hashes of its full subtrees, largest first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ListState(Frontier);

/// Why stored bytes are no list.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("list of a map key: {expected} bytes expected, got {got}")]
pub struct ListError {
    /// How many bytes the list needs, as far as that can be told.
    pub expected: usize,
    /// How many there are.
    pub got: usize,
}

impl ListState {
    /// How many entries.
    pub fn count(&self) -> u64 {
        self.0.size()
    }

    /// Appends an entry, which MUST lie behind all others in the log.
    pub fn append(&mut self, entry: &MapEntry) {
        self.0.push(entry.hash());
    }

    /// Root over the entries; see [`list_root`].
    pub fn root(&self) -> Digest {
        self.0.root()
    }

    /// Writes `count u64 BE | hashes` behind `out`.
    pub fn encode(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.count().to_be_bytes());
        for hash in self.0.peaks() {
            out.extend_from_slice(hash.as_bytes());
        }
    }

    /// Reads a list from the front of `bytes`; gives what lies behind it as well.
    ///
    /// # Errors
    /// [`ListError`] where there are too few bytes for the count that they state.
    pub fn decode(bytes: &[u8]) -> Result<(Self, &[u8]), ListError> {
        let refuse = |expected| ListError { expected, got: bytes.len() };
        let (count, rest) = bytes.split_first_chunk::<8>().ok_or_else(|| refuse(8))?;
        let count = u64::from_be_bytes(*count);
        let length = count.count_ones() as usize * Digest::LEN;
        let (hashes, rest) = rest.split_at_checked(length).ok_or_else(|| refuse(8 + length))?;
        let (hashes, _) = hashes.as_chunks::<{ Digest::LEN }>();
        let peaks = hashes.iter().map(|hash| Digest::from_bytes(*hash)).collect();
        Ok((Self(Frontier::of(count, peaks)), rest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(count: u64) -> Vec<MapEntry> {
        (0..count).map(|i| MapEntry { index: i * 3, leaf_hash: Digest::of(i.to_be_bytes()) }).collect()
    }

    #[test]
    fn a_growing_list_has_the_logs_own_root_at_every_length() {
        let all = entries(70);
        let hashes: Vec<_> = all.iter().map(MapEntry::hash).collect();
        let mut state = ListState::default();
        for count in 0..=70 {
            assert_eq!(state.root(), merkle::root(&hashes[..count]), "{count} entries");
            assert_eq!(state.root(), list_root(&all[..count]));
            assert_eq!(state.count(), count as u64);
            let mut bytes = Vec::new();
            state.encode(&mut bytes);
            bytes.push(9);
            assert_eq!(ListState::decode(&bytes), Ok((state.clone(), &[9][..])));
            if let Some(next) = all.get(count) {
                state.append(next);
            }
        }
    }

    #[test]
    fn an_entry_is_hashed_as_written_down() {
        let entry = MapEntry { index: 258, leaf_hash: Digest::of("leaf") };
        let mut data = vec![0, 0, 0, 0, 0, 0, 0, 1, 2];
        data.extend_from_slice(Digest::of("leaf").as_bytes());
        assert_eq!(data.len(), 1 + 8 + 32);
        assert_eq!(entry.hash(), Digest::of(&data), "H(0x00 | index | leaf hash)");
        assert_eq!(list_root(&[entry]), entry.hash());
    }

    #[test]
    fn lists_cut_short_are_refused_by_length() {
        let mut state = ListState::default();
        entries(7).iter().for_each(|entry| state.append(entry));
        let mut bytes = Vec::new();
        state.encode(&mut bytes);
        for cut in 0..bytes.len() {
            let expected = if cut < 8 { 8 } else { bytes.len() };
            assert_eq!(ListState::decode(&bytes[..cut]), Err(ListError { expected, got: cut }));
        }
        // A count that nothing can hold allocates nothing.
        assert_eq!(ListState::decode(&[0xff; 40]), Err(ListError { expected: 8 + 64 * 32, got: 40 }));
    }
}
