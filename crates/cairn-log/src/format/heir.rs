//! Who speaks for a key once it ended: its heir.
//!
//! A rotation ends one key in favour of another by naming *one* of its records; the new key then goes on for *all* of
//! them. So whoever judges a replacement, a record taken back or an erasure asks [`heir`], the registry as well as
//! verifiers, who each bring what they know of ended keys.
//!
//! Time is counted in log indices. A key ends once: what is signed in its name behind its end counts for
//! nothing, a rotation by a thief who comes after the revocation included.

use crate::format::{
    digest::Digest,
    dsse::Envelope,
    key::PublicKey,
    record::{OwnerRecord, RecordKind},
};

/// How a key ended: by the first record of the log that ends it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ending {
    /// Index of the revocation or rotation.
    pub index: u64,
    /// Id of the key that a rotation puts in its place; none after a revocation.
    pub to: Option<Digest>,
}

/// Who speaks for a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heir {
    /// The key with this id: the one asked about, or the last that rotations led to.
    Key {
        /// SHA-256 of the public key.
        id: Digest,
        /// Index of the rotation that led to it; none where it is the key asked about.
        since: Option<u64>,
    },
    /// Nobody: a revoked key may be in other hands.
    Nobody {
        /// The key that ended without another in its place, by its id.
        id: Digest,
        /// Index of the record that ended it.
        ended_by: u64,
    },
}

impl Heir {
    /// The key that rotations led to, whether it still speaks or ended.
    pub fn id(&self) -> Digest {
        let (Self::Key { id, .. } | Self::Nobody { id, .. }) = self;
        *id
    }

    /// Whether this key (by its id) is the one that speaks.
    pub fn is(&self, key: &Digest) -> bool {
        matches!(self, Self::Key { id, .. } if id == key)
    }
}

/// Who speaks for `key` (an id) just before log index `before`: follows rotations from key to key, as far as a key that
/// has not ended by then.
///
/// `ending` gives the first ending of a key, by its id; what is no valid end ([`ends`]) it must leave out. A rotation to a
/// key that had ended already, or back to a key of the chain, leads to nobody.
///
/// # Errors
/// What `ending` answers with.
pub fn heir<E>(
    key: &Digest,
    before: u64,
    mut ending: impl FnMut(&Digest) -> Result<Option<Ending>, E>,
) -> Result<Heir, E> {
    let (mut id, mut since) = (*key, None);
    // Comes to an end: every step lies behind the last.
    loop {
        match ending(&id)?.filter(|end| end.index < before) {
            None => return Ok(Heir::Key { id, since }),
            Some(Ending { index, to: Some(to) }) if since.is_none_or(|since| since < index) => {
                (id, since) = (to, Some(index));
            }
            Some(end) => return Ok(Heir::Nobody { id, ended_by: end.index }),
        }
    }
}

/// Whether two keys (ids) are one owner's just before log index `before`: they are the same, or rotations lead from one to
/// the other. `ending` is as for [`heir`].
///
/// # Errors
/// What `ending` answers with.
pub fn same_owner<E>(
    one: &Digest,
    other: &Digest,
    before: u64,
    mut ending: impl FnMut(&Digest) -> Result<Option<Ending>, E>,
) -> Result<bool, E> {
    Ok(leads_to(one, other, before, &mut ending)? || leads_to(other, one, before, &mut ending)?)
}

/// Whether rotations lead from one key to another.
fn leads_to<E>(
    from: &Digest,
    to: &Digest,
    before: u64,
    ending: &mut impl FnMut(&Digest) -> Result<Option<Ending>, E>,
) -> Result<bool, E> {
    let (mut id, mut since) = (*from, None);
    // Comes to an end, as in `heir`.
    while id != *to {
        match ending(&id)?.filter(|end| end.index < before) {
            Some(Ending { index, to: Some(next) }) if since.is_none_or(|since| since < index) => {
                (id, since) = (next, Some(index));
            }
            _ => return Ok(false),
        }
    }
    Ok(true)
}

/// Whether a record ends `key`, and then (`Some`) the id of the key that follows it, which a revocation has not.
///
/// The record's own signature was verified when it was opened. A rotation ends the old key by that key's signature, not
/// by the new owner's word, and leads to another key.
pub fn ends(key: &PublicKey, record: &OwnerRecord, envelope: &Envelope) -> Option<Option<Digest>> {
    match record.kind {
        RecordKind::Revocation => (record.owner_key == *key).then_some(None),
        RecordKind::Rotation => {
            let agreed = record.owner_key != *key && envelope.signature_by(key).is_some();
            agreed.then(|| Some(record.owner_key.id()))
        }
        RecordKind::Claim
        | RecordKind::Contribution
        | RecordKind::Training
        | RecordKind::Dispute
        | RecordKind::Binding => None,
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, convert::Infallible};

    use super::*;

    fn id(name: &str) -> Digest {
        Digest::of(name)
    }

    /// Endings as (key, index, heir); asked about `a`.
    fn of_a(before: u64, endings: &[(&str, u64, Option<&str>)]) -> Heir {
        let known: BTreeMap<Digest, Ending> =
            endings.iter().map(|(key, index, to)| (id(key), Ending { index: *index, to: to.map(id) })).collect();
        heir(&id("a"), before, |key| Ok::<_, Infallible>(known.get(key).copied())).unwrap()
    }

    fn key(name: &str, since: Option<u64>) -> Heir {
        Heir::Key { id: id(name), since }
    }

    #[test]
    fn chains_are_followed_to_the_key_of_that_moment() {
        let chain = [("a", 3, Some("b")), ("b", 5, Some("c")), ("x", 1, None)];
        for (before, expected) in [
            (0, key("a", None)),
            (3, key("a", None)),
            (4, key("b", Some(3))),
            (5, key("b", Some(3))),
            (6, key("c", Some(5))),
            (u64::MAX, key("c", Some(5))),
        ] {
            assert_eq!(of_a(before, &chain), expected, "before {before}");
        }
        assert!(of_a(6, &chain).is(&id("c")) && !of_a(6, &chain).is(&id("a")));
    }

    #[test]
    fn a_revocation_leaves_nobody_also_at_the_end_of_a_chain() {
        assert_eq!(of_a(9, &[("a", 3, None)]), Heir::Nobody { id: id("a"), ended_by: 3 });
        let revoked = [("a", 3, Some("b")), ("b", 5, None)];
        assert_eq!(of_a(9, &revoked), Heir::Nobody { id: id("b"), ended_by: 5 });
        assert_eq!(of_a(5, &revoked), key("b", Some(3)), "until then it spoke");
        assert!(!of_a(9, &revoked).is(&id("b")));
    }

    #[test]
    fn one_owner_has_the_keys_that_rotations_join_and_no_others() {
        let endings = [("a", 3, Some("b")), ("b", 5, Some("c")), ("x", 4, Some("c")), ("y", 6, None)];
        let known: BTreeMap<Digest, Ending> =
            endings.iter().map(|(key, index, to)| (id(key), Ending { index: *index, to: to.map(id) })).collect();
        let same = |one, other, before| {
            same_owner(&id(one), &id(other), before, |key| Ok::<_, Infallible>(known.get(key).copied())).unwrap()
        };
        for (one, other, before, wanted) in [
            ("a", "a", 0, true),
            ("a", "b", 3, false),
            ("a", "b", 4, true),
            ("b", "a", 4, true),
            ("a", "c", 5, false),
            ("c", "a", 9, true),
            ("y", "y", 9, true),
            ("y", "a", 9, false),
            // Two that lead to a third are two: each may be a thief of the other's.
            ("a", "x", 9, false),
        ] {
            assert_eq!(same(one, other, before), wanted, "{one} and {other} before {before}");
        }
    }

    #[test]
    fn rotations_that_lead_nowhere_leave_nobody_and_come_to_an_end() {
        // To a key that had ended, to itself, and in a circle.
        assert_eq!(of_a(9, &[("a", 3, Some("b")), ("b", 2, Some("c"))]), Heir::Nobody { id: id("b"), ended_by: 2 });
        assert_eq!(of_a(9, &[("a", 3, Some("a"))]), Heir::Nobody { id: id("a"), ended_by: 3 });
        let circle = [("a", 3, Some("b")), ("b", 5, Some("a"))];
        assert_eq!(of_a(9, &circle), Heir::Nobody { id: id("a"), ended_by: 3 });
    }
}
