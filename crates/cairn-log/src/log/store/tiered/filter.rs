//! A Bloom filter (Bloom 1970): says that a key is in no case there, or that it may be.
//!
//! Looking a record up that the log does not have is what every submission does; without this it would read a block of
//! every run. Ten bits a key and seven probes let about one absent key in a hundred through.
//!
//! The keys are digests behind a prefix, so their own last bytes serve as hashes (Kirsch and Mitzenmacher 2006: two are as
//! good as seven). Whoever picks digests to be let through makes his own submissions dearer by a read.

const BITS_A_KEY: u64 = 10;
const PROBES: u64 = 7;

/// The filter of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Filter(Vec<u8>);

impl Filter {
    /// An empty filter with room for `keys` keys.
    pub(super) fn with_room(keys: u64) -> Self {
        Self(vec![0; (keys * BITS_A_KEY).div_ceil(8) as usize])
    }

    pub(super) const fn from_bytes(bytes: Vec<u8>) -> Self {
        Self(bytes)
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Adds a key; beyond the room that was made the filter lets more and more through.
    pub(super) fn add(&mut self, key: &[u8]) {
        let bits = self.bits();
        for bit in probes(key, bits) {
            self.0[(bit / 8) as usize] |= 1 << (bit % 8);
        }
    }

    /// Whether the key may have been added.
    pub(super) fn may_hold(&self, key: &[u8]) -> bool {
        let bits = self.bits();
        bits != 0 && probes(key, bits).all(|bit| self.0[(bit / 8) as usize] & 1 << (bit % 8) != 0)
    }

    const fn bits(&self) -> u64 {
        self.0.len() as u64 * 8
    }
}

fn probes(key: &[u8], bits: u64) -> impl Iterator<Item = u64> {
    let mut tail = [0; 16];
    let length = key.len().min(16);
    tail[16 - length..].copy_from_slice(&key[key.len() - length..]);
    let [first, step] = [&tail[..8], &tail[8..]].map(|half| half.iter().fold(0, |sum, b| sum << 8 | u64::from(*b)));
    let count = if bits == 0 { 0 } else { PROBES };
    (0..count).map(move |i| first.wrapping_add(i.wrapping_mul(step | 1)) % bits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::digest::Digest;

    #[test]
    fn every_key_is_held_and_few_others() {
        let key = |i: u32| [b"index/", &Digest::of(i.to_be_bytes()).as_bytes()[..]].concat();
        let mut filter = Filter::with_room(2000);
        (0..2000).for_each(|i| filter.add(&key(i)));
        assert!((0..2000).all(|i| filter.may_hold(&key(i))));
        let again = Filter::from_bytes(filter.bytes().to_vec());
        let let_through = (2000..22_000).filter(|i| again.may_hold(&key(*i))).count();
        assert!((50..500).contains(&let_through), "{let_through} of 20000, about 160 expected");
        let none = Filter::with_room(0);
        assert!(!none.may_hold(&key(1)) && !none.may_hold(b""));
    }
}
