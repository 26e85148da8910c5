//! Good input spoilt: what truncation, repetition, flipped bits, huge numbers, deep nesting and pieces of other input
//! make of it. A case is a list of such mutations, so a failing one shrinks to those that matter.

use std::{fmt, sync::Arc};

use proptest::{collection::vec, prelude::*, sample::Index, strategy::Union};

/// One input, and how it came about.
#[derive(Clone)]
pub struct Input {
    bytes: Vec<u8>,
    story: String,
}

impl Input {
    /// The bytes to feed.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

impl fmt::Debug for Input {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = &self.bytes[..self.bytes.len().min(2000)];
        write!(f, "{} -> {} bytes: b\"{}\"", self.story, self.bytes.len(), shown.escape_ascii())
    }
}

/// Numbers that readers trip over, as text.
const NUMBERS: [&str; 12] = [
    "0",
    "-1",
    "00",
    "65536",
    "2147483648",
    "4294967296",
    "9007199254740993",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "1e999",
    "NaN",
];

/// The same as fixed-width fields.
const FIELDS: [u64; 8] = [0, 1, u64::MAX, u64::MAX / 24, 1 << 63, 1 << 40, 1 << 32, 0x7fff_ffff];

/// What nests.
const OPENERS: [&str; 5] = ["[", "{\"a\":", "(", "\"", "\n\n"];

#[derive(Clone, Debug)]
enum Mutation {
    Truncate(Index),
    Insert(Index, Vec<u8>),
    Flip(Index, u8),
    Remove(Index, usize),
    /// A stretch twice, or many times.
    Repeat(Index, usize, usize),
    /// A run of digits becomes one of [`NUMBERS`].
    Number(Index, usize),
    /// 2, 4 or 8 bytes become one of [`FIELDS`], in either order.
    Field(Index, usize, usize, bool),
    Nest(Index, usize, usize),
    /// A stretch of another good input.
    Splice(Index, Index, Index, usize),
}

fn mutation() -> impl Strategy<Value = Mutation> {
    let place = any::<Index>;
    prop_oneof![
        place().prop_map(Mutation::Truncate),
        (place(), vec(any::<u8>(), 1..9)).prop_map(|(at, bytes)| Mutation::Insert(at, bytes)),
        (place(), 0..8_u8).prop_map(|(at, bit)| Mutation::Flip(at, bit)),
        (place(), 1..65_usize).prop_map(|(at, length)| Mutation::Remove(at, length)),
        (place(), 1..129_usize, prop_oneof![4 => 1..4_usize, 1 => 4..200_usize])
            .prop_map(|(at, length, times)| Mutation::Repeat(at, length, times)),
        (place(), 0..NUMBERS.len()).prop_map(|(at, number)| Mutation::Number(at, number)),
        (place(), 1..4_usize, 0..FIELDS.len(), any::<bool>()).prop_map(|(at, width, value, big)| Mutation::Field(
            at,
            1 << width,
            value,
            big
        )),
        (place(), 0..OPENERS.len(), 1..2000_usize).prop_map(|(at, opener, depth)| Mutation::Nest(at, opener, depth)),
        (place(), place(), place(), 1..129_usize)
            .prop_map(|(other, from, to, length)| Mutation::Splice(other, from, to, length)),
    ]
}

impl Mutation {
    fn apply(&self, bytes: &mut Vec<u8>, good: &[Vec<u8>]) {
        // One place behind the last byte counts as well.
        let place = |at: &Index, bytes: &[u8]| at.index(bytes.len() + 1);
        let stretch = |from: usize, length: usize, bytes: &[u8]| from..bytes.len().min(from + length);
        match self {
            Self::Truncate(at) => bytes.truncate(place(at, bytes)),
            Self::Insert(at, more) => insert(bytes, place(at, bytes), more),
            Self::Flip(at, bit) => {
                let at = place(at, bytes);
                bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << bit);
            }
            Self::Remove(at, length) => drop(bytes.drain(stretch(place(at, bytes), *length, bytes))),
            Self::Repeat(at, length, times) => {
                let at = place(at, bytes);
                let again = bytes[stretch(at, *length, bytes)].repeat(*times);
                insert(bytes, at, &again);
            }
            Self::Number(at, number) => {
                let at = place(at, bytes);
                let Some(first) = bytes[at..].iter().position(u8::is_ascii_digit).map(|n| at + n) else { return };
                let length = bytes[first..].iter().take_while(|b| b.is_ascii_digit()).count();
                bytes.splice(first..first + length, NUMBERS[*number].bytes());
            }
            Self::Field(at, width, value, big) => {
                let value = FIELDS[*value];
                let field = if *big {
                    value.to_be_bytes()[8 - width..].to_vec()
                } else {
                    value.to_le_bytes()[..*width].to_vec()
                };
                let at = stretch(place(at, bytes), *width, bytes);
                bytes[at.clone()].copy_from_slice(&field[..at.len()]);
            }
            Self::Nest(at, opener, depth) => {
                insert(bytes, place(at, bytes), OPENERS[*opener].repeat(*depth).as_bytes())
            }
            Self::Splice(other, from, to, length) => {
                let other = &good[other.index(good.len())];
                let piece = other[stretch(place(from, other), *length, other)].to_vec();
                insert(bytes, place(to, bytes), &piece);
            }
        }
    }
}

fn insert(bytes: &mut Vec<u8>, at: usize, more: &[u8]) {
    bytes.splice(at..at, more.iter().copied());
}

/// Mutations of `good` inputs, eight in nine, and noise. `good` MUST NOT be empty.
pub fn inputs(good: &[&[u8]]) -> impl Strategy<Value = Input> + use<> {
    let good: Arc<Vec<Vec<u8>>> = Arc::new(good.iter().map(|input| input.to_vec()).collect());
    let noise = vec(any::<u8>(), 0..300).prop_map(|bytes| Input { bytes, story: "noise".into() });
    // One mutation reaches deepest, several reach what none alone does.
    let some = prop_oneof![1 => vec(mutation(), 1..2), 1 => vec(mutation(), 2..6)];
    let spoilt = (any::<Index>(), some).prop_map(move |(which, mutations)| {
        let which = which.index(good.len());
        let mut bytes = good[which].clone();
        mutations.iter().for_each(|mutation| mutation.apply(&mut bytes, &good));
        Input { bytes, story: format!("good input {which} after {mutations:?}") }
    });
    Union::new_weighted(vec![(1, noise.boxed()), (8, spoilt.boxed())])
}
