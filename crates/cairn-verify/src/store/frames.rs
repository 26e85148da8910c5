//! A file of envelopes: up to 256 frames, `u32 BE length | slot`.

use crate::map::Key;

use super::files::{CHUNK, MAX_SLOT};

/// First byte of a record's slot.
const RECORD: u8 = 1;
/// First byte of an erased record's slot.
const ERASED: u8 = 2;

/// What a slot holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Slot<'a> {
    /// An envelope's JSON.
    Record(&'a [u8]),
    /// The map keys of a record that was erased.
    Erased(Vec<Key>),
    /// Nothing: the log has a map leaf here.
    Map,
}

/// The frames of a file as far as they can be read.
#[derive(Debug, Default)]
pub(super) struct Frames<'a> {
    pub(super) slots: Vec<Slot<'a>>,
    /// Why the rest cannot be read.
    pub(super) broken: Option<String>,
}

impl<'a> Frames<'a> {
    pub(super) fn parse(bytes: &'a [u8]) -> Self {
        let mut frames = Self::default();
        let mut rest = bytes;
        while !rest.is_empty() {
            match next(rest, frames.slots.len()) {
                Ok((slot, behind)) => {
                    frames.slots.push(slot);
                    rest = behind;
                }
                Err(cause) => {
                    frames.broken = Some(cause);
                    break;
                }
            }
        }
        frames
    }
}

fn next(bytes: &[u8], at: usize) -> Result<(Slot<'_>, &[u8]), String> {
    if at as u64 == CHUNK {
        return Err(format!("{} bytes behind frame {}, the last", bytes.len(), CHUNK - 1));
    }
    let (length, behind) = bytes.split_first_chunk::<4>().ok_or_else(|| format!("frame {at} ends in its length"))?;
    let length = u32::from_be_bytes(*length) as usize;
    if length > MAX_SLOT {
        return Err(format!("frame {at} of {length} bytes, at most {MAX_SLOT} are read"));
    }
    let (slot, behind) = behind
        .split_at_checked(length)
        .ok_or_else(|| format!("frame {at} of {length} bytes, of which {} are there", behind.len()))?;
    let slot = match slot.split_first() {
        None => Slot::Map,
        Some((&RECORD, json)) => Slot::Record(json),
        Some((&ERASED, keys)) => {
            Slot::Erased(erased(keys).ok_or_else(|| format!("frame {at} is no list of map keys"))?)
        }
        Some((kind, _)) => return Err(format!("frame {at} of kind {kind}, 1 (record) or 2 (erased) expected")),
    };
    Ok((slot, behind))
}

/// At least one key (every record has its scene's), ascending, each once.
fn erased(bytes: &[u8]) -> Option<Vec<Key>> {
    let (keys, []) = bytes.as_chunks::<32>() else { return None };
    let rising = keys.windows(2).all(|pair| pair[0] < pair[1]);
    (rising && !keys.is_empty()).then(|| keys.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(slot: &[u8]) -> Vec<u8> {
        [&(slot.len() as u32).to_be_bytes()[..], slot].concat()
    }

    #[test]
    fn frames_are_read_up_to_the_first_that_is_broken() {
        let keys = [[&[2][..], &[3; 32], &[4; 32]].concat(), [&[2][..], &[4; 32], &[3; 32]].concat()];
        let bytes = [frame(b"\x01{}"), frame(b""), frame(&keys[0])].concat();
        let whole = Frames::parse(&bytes);
        assert_eq!(whole.slots, [Slot::Record(b"{}"), Slot::Map, Slot::Erased(vec![[3; 32], [4; 32]])]);
        assert_eq!(whole.broken, None);
        for (more, part) in [
            (frame(b"\x03"), "kind 3"),
            (frame(&keys[1]), "map keys"),
            (frame(b"\x02"), "map keys"),
            (frame(b"\x02short"), "map keys"),
            (vec![0, 0, 0], "ends in its length"),
            (vec![0, 0, 0, 9, 1], "of which 1 are there"),
            (vec![0xff; 8], "4294967295 bytes"),
        ] {
            let bytes = [bytes.clone(), more].concat();
            let frames = Frames::parse(&bytes);
            assert_eq!(frames.slots.len(), 3);
            assert!(frames.broken.as_ref().is_some_and(|b| b.contains(part)), "{part}: {frames:?}");
        }
        let many = frame(b"").repeat(257);
        let frames = Frames::parse(&many);
        assert!(frames.slots.len() == 256 && frames.broken.is_some());
    }
}
