//! A small hash table from numbers to numbers that is emptied at no cost: what a tile's rays
//! or a pixel's met is told apart by one, many thousand times a second.

/// See the module's text.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    /// A power of two of places, at most half of them taken.
    entries: Vec<Entry>,
    /// Entries with another stamp are from before the last clearing.
    stamp: u32,
    used: usize,
}

#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    stamp: u32,
    key: u32,
    value: u32,
}

impl Default for Table {
    fn default() -> Self {
        Self { entries: vec![Entry::default(); 1024], stamp: 1, used: 0 }
    }
}

impl Table {
    pub(crate) fn clear(&mut self) {
        self.used = 0;
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.entries.fill(Entry::default());
            self.stamp = 1;
        }
    }

    /// The value of `key`, which becomes `fresh` if it had none.
    #[inline(always)]
    pub(crate) fn find_or_insert(&mut self, key: u32, fresh: u32) -> u32 {
        let mask = self.entries.len() - 1;
        // Fibonacci hashing (Knuth, TAOCP 3, 6.4): neighbours land far apart.
        let mut at = (u64::from(key).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as usize & mask;
        loop {
            let entry = self.entries[at];
            if entry.stamp != self.stamp {
                break;
            }
            if entry.key == key {
                return entry.value;
            }
            at = (at + 1) & mask;
        }
        self.entries[at] = Entry { stamp: self.stamp, key, value: fresh };
        self.used += 1;
        if 2 * self.used > self.entries.len() {
            self.grow();
        }
        fresh
    }

    #[cold]
    fn grow(&mut self) {
        let old = std::mem::take(&mut self.entries);
        self.entries = vec![Entry::default(); 2 * old.len()];
        self.used = 0;
        let stamp = self.stamp;
        for entry in old.into_iter().filter(|e| e.stamp == stamp) {
            self.find_or_insert(entry.key, entry.value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_keeps_what_it_is_given_until_cleared() {
        // Near the last stamp, so that it runs over once.
        let mut table = Table { stamp: u32::MAX - 1, ..Table::default() };
        for round in 0..4u32 {
            for key in (0..5000).map(|i| i * 37) {
                assert_eq!(table.find_or_insert(key, key + round), key + round, "new in round {round}");
            }
            for key in (0..5000).map(|i| i * 37) {
                assert_eq!(table.find_or_insert(key, 0), key + round, "found in round {round}");
            }
            table.clear();
        }
    }
}
