//! Which tokens were used: each is remembered until it would be refused for its
//! age anyway. The memory is bounded, and so is one account's share of it, or one
//! busy account could shut out all others. A full memory refuses: forgetting a
//! token early would let it be used twice.

use std::collections::{BTreeSet, HashMap, HashSet};

use cairn_log::Digest;

use crate::auth::error::TokenError;

/// The used tokens.
#[derive(Debug)]
pub(crate) struct Replays {
    limit: usize,
    of_one: usize,
    seen: HashSet<Digest>,
    /// The same by when they are forgotten: time, token, account.
    by_time: BTreeSet<(u64, Digest, Digest)>,
    counts: HashMap<Digest, usize>,
}

impl Replays {
    pub(crate) fn new(limit: usize, of_one: usize) -> Self {
        Self { limit, of_one, seen: HashSet::new(), by_time: BTreeSet::new(), counts: HashMap::new() }
    }

    /// Remembers `token` of `account` until after `until`, once.
    pub(crate) fn remember(&mut self, token: Digest, account: Digest, until: u64, now: u64) -> Result<(), TokenError> {
        self.forget(now);
        if self.seen.contains(&token) {
            return Err(TokenError::Replayed);
        }
        let count = self.counts.get(&account).copied().unwrap_or(0);
        if count >= self.of_one {
            let first = self.by_time.iter().find(|(_, _, whose)| *whose == account);
            let (whose, limit) = ("this account", self.of_one);
            return Err(TokenError::MemoryFull { whose, limit, frees: first.map_or(now, |f| f.0 + 1) });
        }
        if self.seen.len() >= self.limit {
            let frees = self.by_time.first().map_or(now, |f| f.0 + 1);
            return Err(TokenError::MemoryFull { whose: "all accounts", limit: self.limit, frees });
        }
        self.seen.insert(token);
        self.by_time.insert((until, token, account));
        self.counts.insert(account, count + 1);
        Ok(())
    }

    /// Forgets what is refused for its age from now on.
    fn forget(&mut self, now: u64) {
        while let Some((until, token, account)) = self.by_time.first().copied().filter(|(until, ..)| *until < now) {
            self.by_time.remove(&(until, token, account));
            self.seen.remove(&token);
            if let Some(count) = self.counts.get_mut(&account) {
                *count -= 1;
                if *count == 0 {
                    self.counts.remove(&account);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn digest(number: u8) -> Digest {
        Digest::of([number])
    }

    #[test]
    fn a_full_memory_refuses_and_says_when_there_is_room() {
        let mut replays = Replays::new(3, 2);
        let (ada, bob) = (digest(200), digest(201));
        let full = |whose, limit| TokenError::MemoryFull { whose, limit, frees: 51 };
        assert_eq!(replays.remember(digest(1), ada, 100, 10), Ok(()));
        assert_eq!(replays.remember(digest(1), ada, 100, 10), Err(TokenError::Replayed));
        assert_eq!(replays.remember(digest(2), ada, 50, 10), Ok(()));
        assert_eq!(replays.remember(digest(3), ada, 60, 10), Err(full("this account", 2)));
        assert_eq!(replays.remember(digest(3), bob, 60, 10), Ok(()));
        assert_eq!(replays.remember(digest(4), bob, 60, 10), Err(full("all accounts", 3)));
        // Still good at 50, so still remembered; forgotten a second later.
        assert_eq!(replays.remember(digest(2), bob, 50, 50), Err(TokenError::Replayed));
        assert_eq!(replays.remember(digest(4), bob, 60, 51), Ok(()));
        assert_eq!(replays.seen.len(), 3);
        assert_eq!(replays.counts[&ada], 1);
        assert_eq!(replays.remember(digest(9), ada, 300, 200), Ok(()));
        assert_eq!((replays.seen.len(), replays.by_time.len(), replays.counts.len()), (1, 1, 1));
    }
}
