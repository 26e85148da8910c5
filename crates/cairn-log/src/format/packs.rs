//! Packs: the envelopes of 256 log entries in one file, beside the log.
//!
//! ```text
//! frame = u32 big-endian length | slot, one a log entry, in the log's order
//! slot  = 0x01 | envelope, JSON as `Envelope::to_json` writes it   a record
//!       | 0x02 | map keys, 32 bytes each                           an erased record
//!       | nothing                                                  a map leaf, which is made again from its index and root
//! ```
//!
//! A pack grows in place and is rewritten only to erase a record. What is left of
//! that are the keys under which the map lists it: without them nobody could work out the map again.

use crate::format::{digest::Digest, dsse::MAX_ENVELOPE_BYTES, map::MapKey, tile::TILE_WIDTH};

/// Most bytes of a slot: a record's envelope. The keys of an erased record take less.
pub const MAX_SLOT: usize = 1 + MAX_ENVELOPE_BYTES;

/// Most bytes of a pack.
pub const MAX_PACK: u64 = (TILE_WIDTH as u64) * (4 + MAX_SLOT as u64);

/// Bytes read at once while slots are passed over.
const AHEAD: usize = 16 << 10;

const RECORD: u8 = 1;
const ERASED: u8 = 2;

/// What a pack holds of a log entry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Slot {
    /// A record's envelope, JSON.
    Record(Vec<u8>),
    /// What is left of an erased record.
    Erased(Vec<MapKey>),
    /// Nothing, for a map leaf.
    MapLeaf,
}

/// Why bytes are no pack.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PackError {
    /// It ends inside a frame.
    #[error("pack of {size} bytes ends inside slot {slot}")]
    Truncated {
        /// The pack's size.
        size: usize,
        /// Which slot, from 0.
        slot: usize,
    },
    /// A slot too long, of a kind that this release does not know, or of keys that are not 32 bytes each.
    #[error("pack, slot {slot}: {what}")]
    Slot {
        /// Which slot, from 0.
        slot: usize,
        /// What is wrong.
        what: String,
    },
}

impl Slot {
    /// The slot's frame.
    pub fn to_frame(&self) -> Vec<u8> {
        let slot = match self {
            Self::Record(json) => [&[RECORD], json.as_slice()].concat(),
            Self::Erased(keys) => {
                let keys = keys.iter().flat_map(|key| *key.as_bytes());
                std::iter::once(ERASED).chain(keys).collect()
            }
            Self::MapLeaf => Vec::new(),
        };
        // Slots are far below 4 GiB: envelopes are capped on the way in.
        [&(slot.len() as u32).to_be_bytes()[..], &slot].concat()
    }

    fn parse(bytes: &[u8], slot: usize) -> Result<Self, PackError> {
        let refuse = |what: String| PackError::Slot { slot, what };
        match bytes.split_first() {
            None => Ok(Self::MapLeaf),
            Some((&RECORD, json)) => Ok(Self::Record(json.to_vec())),
            Some((&ERASED, keys)) => {
                let (keys, rest) = keys.as_chunks::<{ Digest::LEN }>();
                if !rest.is_empty() || keys.is_empty() {
                    return Err(refuse(format!("{} bytes of map keys, a multiple of 32 expected", bytes.len() - 1)));
                }
                if keys.windows(2).any(|pair| pair[0] >= pair[1]) {
                    return Err(refuse("map keys out of order, or one twice".into()));
                }
                Ok(Self::Erased(keys.iter().map(|key| MapKey::from_bytes(*key)).collect()))
            }
            Some((kind, _)) => Err(refuse(format!("kind {kind}, this release reads 1 (record) and 2 (erased)"))),
        }
    }
}

/// A pack's slots, at most `most` of them, and how many bytes these take.
///
/// # Errors
/// [`PackError`] names the slot.
pub fn parse(pack: &[u8], most: usize) -> Result<(Vec<Slot>, usize), PackError> {
    match slots_of(pack, most) {
        (_, _, Some(e)) => Err(e),
        (slots, length, None) => Ok((slots, length)),
    }
}

/// A pack's slots as far as they are whole, and what is wrong with the bytes behind them, if there are any.
pub fn parse_whole(pack: &[u8]) -> (Vec<Slot>, Option<PackError>) {
    let (slots, length, broken) = slots_of(pack, TILE_WIDTH.into());
    let behind = pack.len() - length;
    let beyond = || (behind > 0).then(|| format!("{behind} bytes behind the last slot of a pack"));
    let slot = slots.len();
    (slots, broken.or_else(|| beyond().map(|what| PackError::Slot { slot, what })))
}

/// At most `most` slots, how many bytes they take, and what is wrong with the next one.
fn slots_of(pack: &[u8], most: usize) -> (Vec<Slot>, usize, Option<PackError>) {
    let (mut slots, mut at) = (Vec::new(), 0);
    while at < pack.len() && slots.len() < most {
        let parsed = frame(pack, at, slots.len()).and_then(|bytes| Ok((Slot::parse(bytes, slots.len())?, bytes.len())));
        match parsed {
            Ok((slot, length)) => {
                slots.push(slot);
                at += 4 + length;
            }
            Err(e) => return (slots, at, Some(e)),
        }
    }
    (slots, at, None)
}

/// Slot `number` alone, counted from 0, read through `read_at` (offset, length) without the rest of the pack; none where the
/// pack ends before it.
///
/// # Errors
/// [`PackError`] names the slot; `read_at`'s.
pub fn nth<E: From<PackError>>(
    number: usize,
    read_at: impl Fn(u64, usize) -> Result<Vec<u8>, E>,
) -> Result<Option<Slot>, E> {
    let (mut at, mut ahead, mut ahead_at) = (0_u64, Vec::new(), 0_u64);
    for slot in 0..=number {
        let within = (at - ahead_at) as usize;
        if ahead.len() < within + 4 {
            (ahead, ahead_at) = (read_at(at, AHEAD)?, at);
        }
        let head = &ahead[(at - ahead_at) as usize..];
        if head.is_empty() {
            return Ok(None);
        }
        let truncated = |end: u64| PackError::Truncated { size: end as usize, slot };
        let length = head.first_chunk::<4>().ok_or_else(|| truncated(at + head.len() as u64))?;
        let length = u32::from_be_bytes(*length) as usize;
        if length > MAX_SLOT {
            return Err(too_long(slot, length).into());
        }
        at += 4;
        if slot == number {
            let bytes = match head.get(4..4 + length) {
                Some(bytes) => bytes.to_vec(),
                None => read_at(at, length)?,
            };
            if bytes.len() != length {
                return Err(truncated(at + bytes.len() as u64).into());
            }
            return Ok(Some(Slot::parse(&bytes, slot)?));
        }
        at += length as u64;
        // A slot that leads beyond what was read ahead is passed without being read.
        if at - ahead_at > ahead.len() as u64 {
            (ahead, ahead_at) = (Vec::new(), at);
        }
    }
    Ok(None)
}

fn too_long(slot: usize, length: usize) -> PackError {
    PackError::Slot { slot, what: format!("{length} bytes, at most {MAX_SLOT} are allowed") }
}

/// The bytes of slot `slot`, whose frame begins at `at`.
fn frame(pack: &[u8], at: usize, slot: usize) -> Result<&[u8], PackError> {
    let truncated = PackError::Truncated { size: pack.len(), slot };
    let Some((length, rest)) = pack[at..].split_first_chunk::<4>() else { return Err(truncated) };
    let length = u32::from_be_bytes(*length) as usize;
    if length > MAX_SLOT {
        return Err(too_long(slot, length));
    }
    rest.get(..length).ok_or(truncated)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slots() -> Vec<Slot> {
        let mut keys = vec![MapKey::scene("a"), MapKey::scene("b")];
        keys.sort_unstable();
        vec![Slot::Record(b"{}".to_vec()), Slot::MapLeaf, Slot::Erased(keys), Slot::MapLeaf]
    }

    #[test]
    fn a_pack_goes_through_its_bytes_and_says_where_it_ends() {
        let pack: Vec<u8> = slots().iter().flat_map(Slot::to_frame).collect();
        assert_eq!(pack[..7], *b"\x00\x00\x00\x03\x01{}");
        assert_eq!(parse(&pack, 256), Ok((slots(), pack.len())));
        assert_eq!(parse(&pack, 2), Ok((slots()[..2].to_vec(), 11)));
        let read_at = |offset: u64, length: usize| -> Result<Vec<u8>, PackError> {
            Ok(pack.iter().skip(offset as usize).take(length).copied().collect())
        };
        for (number, slot) in slots().into_iter().enumerate() {
            assert_eq!(nth(number, read_at), Ok(Some(slot)));
        }
        assert_eq!((nth(4, read_at), nth(9, read_at)), (Ok(None), Ok(None)));
        let ends = [0, 7, 11, 11 + 4 + 65];
        for end in 0..pack.len() {
            let (whole, rest) = parse_whole(&pack[..end]);
            assert_eq!(whole, slots()[..ends.iter().filter(|at| **at > 0 && **at <= end).count()], "cut at {end}");
            assert_eq!(rest.is_none(), ends.contains(&end), "cut at {end}");
            assert_eq!(parse(&pack[..end], 256).is_ok(), ends.contains(&end), "cut at {end}");
        }
    }

    #[test]
    fn foreign_slots_are_refused_by_name() {
        for (slot, what) in [(&b"\x03x"[..], "kind 3"), (b"\x02", "0 bytes"), (&[2; 34], "33 bytes")] {
            let pack = [&(slot.len() as u32).to_be_bytes()[..], slot].concat();
            let said = parse(&pack, 256).unwrap_err().to_string();
            assert!(said.contains(what), "{said}");
        }
        assert!(matches!(parse(&[0xff; 4], 256), Err(PackError::Slot { slot: 0, .. })));
    }
}
