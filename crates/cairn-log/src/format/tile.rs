//! Tiles (C2SP tlog-tiles): the log as static files that existing monitors read.
//!
//! A full tile holds 256 hashes of one level; levels step by eight, so a tile at
//! level L + 1 is made of the roots of full tiles at level L. The rightmost tile of a level
//! may be partial and says so in its path. Entries lie in bundles of up to 256,
//! each with its length in front.

use std::{fmt, str::FromStr};

use crate::format::digest::{clip, decimal};

/// Hashes of a full tile, entries of a full bundle.
pub const TILE_WIDTH: u16 = 256;

/// Highest level that a path may name.
pub const MAX_LEVEL: u8 = 63;

/// What a tile holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TileKind {
    /// Hashes of a level, 0 (leaves) to 63.
    Hashes(u8),
    /// The entries themselves.
    Entries,
}

/// The path of a tile under the log's prefix: `tile/<L>/<N>[.p/<W>]` or `tile/entries/<N>[.p/<W>]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct TilePath {
    /// What it holds.
    pub kind: TileKind,
    /// Its index in its level.
    pub index: u64,
    /// How many hashes or entries, 1 to 256.
    pub width: u16,
}

/// Why a text is no tile's path, or bytes are no bundle of entries.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TileError {
    /// Not a path of the format.
    #[error("{got:?} is no tile path: {what}")]
    Path {
        /// The start of the text.
        got: String,
        /// What is wrong.
        what: &'static str,
    },
    /// A bundle that ends inside an entry.
    #[error("entry bundle of {size} bytes ends inside entry {entry}")]
    Truncated {
        /// The bundle's size.
        size: usize,
        /// Which entry, from 0.
        entry: usize,
    },
    /// An entry too long for its length field.
    #[error("entry {entry} of {size} bytes, at most 65535 fit into a bundle")]
    EntryTooLong {
        /// Which entry, from 0.
        entry: usize,
        /// Its size.
        size: usize,
    },
}

impl TilePath {
    /// The path of the tile at `index` of a level as it is in a tree of `size` leaves; none where it would be empty.
    pub fn in_tree(kind: TileKind, index: u64, size: u64) -> Option<Self> {
        let level = match kind {
            TileKind::Hashes(level) if level <= MAX_LEVEL => level,
            TileKind::Hashes(_) => return None,
            TileKind::Entries => 0,
        };
        let hashes = size.checked_shr(8 * u32::from(level)).unwrap_or(0);
        let left = hashes.checked_sub(index.checked_mul(TILE_WIDTH.into())?)?;
        let width = u16::try_from(left).map_or(TILE_WIDTH, |left| left.min(TILE_WIDTH));
        (width > 0).then_some(Self { kind, index, width })
    }

    /// The index of the first hash or entry in its level; none where it exceeds 64 bits.
    pub fn first(&self) -> Option<u64> {
        self.index.checked_mul(TILE_WIDTH.into())
    }
}

/// A bundle: each entry behind its length, `u16` big-endian.
///
/// # Errors
/// [`TileError::EntryTooLong`].
pub fn encode_entries<'a>(entries: impl IntoIterator<Item = &'a [u8]>) -> Result<Vec<u8>, TileError> {
    let mut bundle = Vec::new();
    for (i, entry) in entries.into_iter().enumerate() {
        let length = u16::try_from(entry.len()).map_err(|_| TileError::EntryTooLong { entry: i, size: entry.len() })?;
        bundle.extend_from_slice(&length.to_be_bytes());
        bundle.extend_from_slice(entry);
    }
    Ok(bundle)
}

/// The entries of a bundle.
///
/// # Errors
/// [`TileError::Truncated`].
pub fn decode_entries(bundle: &[u8]) -> Result<Vec<&[u8]>, TileError> {
    let mut entries = Vec::new();
    let mut rest = bundle;
    while !rest.is_empty() {
        let truncated = TileError::Truncated { size: bundle.len(), entry: entries.len() };
        let Some((length, behind)) = rest.split_first_chunk::<2>() else { return Err(truncated) };
        let Some((entry, behind)) = behind.split_at_checked(u16::from_be_bytes(*length).into()) else {
            return Err(truncated);
        };
        entries.push(entry);
        rest = behind;
    }
    Ok(entries)
}

impl fmt::Display for TilePath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            TileKind::Hashes(level) => write!(f, "tile/{level}")?,
            TileKind::Entries => write!(f, "tile/entries")?,
        }
        write!(f, "/{}", index_path(self.index))?;
        if self.width < TILE_WIDTH { write!(f, ".p/{}", self.width) } else { Ok(()) }
    }
}

impl FromStr for TilePath {
    type Err = TileError;

    fn from_str(text: &str) -> Result<Self, TileError> {
        let refuse = |what| TileError::Path { got: clip(text), what };
        let rest = text.strip_prefix("tile/").ok_or_else(|| refuse("does not begin with `tile/`"))?;
        let (level, rest) = rest.split_once('/').ok_or_else(|| refuse("no index"))?;
        let kind = match level {
            "entries" => TileKind::Entries,
            level => match decimal(level) {
                Some(number) if number <= MAX_LEVEL => TileKind::Hashes(number),
                _ => return Err(refuse("the level is neither `entries` nor 0 to 63")),
            },
        };
        let (index, width) = match rest.split_once(".p/") {
            None => (rest, TILE_WIDTH),
            Some((index, width)) => match decimal(width) {
                Some(number) if (1..TILE_WIDTH).contains(&number) => (index, number),
                _ => return Err(refuse("the width is not 1 to 255")),
            },
        };
        let path = Self { kind, index: parse_index(index).ok_or_else(|| refuse("the index"))?, width };
        // One spelling: this refuses groups that only pad.
        if path.to_string() == text { Ok(path) } else { Err(refuse("the index has needless groups")) }
    }
}

/// 1234067 -> `x001/x234/067`: groups of three digits, all but the last behind an `x`.
pub fn index_path(index: u64) -> String {
    let digits = index.to_string();
    let padded = format!("{digits:0>width$}", width = digits.len().div_ceil(3) * 3);
    let mut path = String::with_capacity(padded.len() * 5 / 3);
    for at in (0..padded.len()).step_by(3) {
        let (before, behind) = if at + 3 < padded.len() { ("x", "/") } else { ("", "") };
        path.extend([before, &padded[at..at + 3], behind]);
    }
    path
}

/// `x001/x234/067` -> 1234067.
fn parse_index(text: &str) -> Option<u64> {
    let mut groups = text.split('/').rev();
    let mut digits = vec![groups.next()?];
    for group in groups {
        digits.push(group.strip_prefix('x')?);
    }
    let whole = digits.iter().all(|group| group.len() == 3 && group.bytes().all(|b| b.is_ascii_digit()));
    digits.reverse();
    whole.then(|| digits.concat().parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::{
        digest::Digest,
        merkle::{leaf_hash, root},
        testing::Tree,
    };

    #[test]
    fn paths_are_the_ones_of_the_specification() {
        for (index, path) in [
            (0, "000"),
            (67, "067"),
            (999, "999"),
            (1000, "x001/000"),
            (1_234_067, "x001/x234/067"),
            (u64::MAX, "x018/x446/x744/x073/x709/x551/615"),
        ] {
            for (kind, part) in
                [(TileKind::Hashes(0), "0"), (TileKind::Hashes(63), "63"), (TileKind::Entries, "entries")]
            {
                for (width, end) in [(256, ""), (1, ".p/1"), (255, ".p/255")] {
                    let text = format!("tile/{part}/{path}{end}");
                    let tile = TilePath { kind, index, width };
                    assert_eq!(tile.to_string(), text);
                    assert_eq!(text.parse(), Ok(tile));
                }
            }
        }
    }

    #[test]
    fn other_spellings_are_refused() {
        for text in [
            "",
            "tile",
            "tile/0",
            "tile/0/",
            "tile/0/67",
            "tile/0/0067",
            "tile/00/067",
            "tile/64/067",
            "tile/-1/067",
            "tile/0/x067",
            "tile/0/x000/067",
            "tile/0/001/067",
            "tile/0/x001/67",
            "tile/0/+67",
            "tile/0/067.p/0",
            "tile/0/067.p/256",
            "tile/0/067.p/01",
            "tile/0/067.p/",
            "tile/0/067/",
            "/tile/0/067",
            "tile/entry/067",
            "tile/0/x018/x446/x744/x073/x709/x551/616",
            "tile/0/../067",
        ] {
            assert!(text.parse::<TilePath>().is_err(), "{text}");
        }
    }

    fn hashes(tile: &[u8]) -> Vec<Digest> {
        tile.chunks(32).map(|hash| Digest::try_from(hash).unwrap()).collect()
    }

    #[test]
    fn a_tree_of_70000_has_the_tiles_of_the_specification() {
        let mut tree = Tree::new();
        for i in 0..70_000_u32 {
            tree.push(leaf_hash(&i.to_be_bytes()));
        }
        let tiles: Vec<_> = TilePath::all(70_000).collect();
        let of = |level, full: bool| {
            let right = |t: &&TilePath| t.kind == TileKind::Hashes(level) && (t.width == 256) == full;
            tiles.iter().filter(right).map(|t| t.width).collect::<Vec<_>>()
        };
        assert_eq!((of(0, true).len(), of(0, false)), (273, vec![112]));
        assert_eq!((of(1, true).len(), of(1, false)), (1, vec![17]));
        assert_eq!((of(2, true).len(), of(2, false)), (0, vec![1]));
        assert_eq!(tiles.len(), 273 + 1 + 1 + 1 + 1);
        // Each hash above level 0 is the root of the full tile below it.
        for tile in &tiles {
            let TileKind::Hashes(level) = tile.kind else { panic!() };
            let bytes = tile.cut(&tree, 70_000).unwrap();
            assert_eq!(bytes.len(), 32 * usize::from(tile.width));
            for (i, hash) in (0..).zip(hashes(&bytes)).filter(|_| level > 0) {
                let below = TilePath { kind: TileKind::Hashes(level - 1), index: tile.index * 256 + i, width: 256 };
                assert_eq!(root(&hashes(&below.cut(&tree, 70_000).unwrap())), hash);
            }
        }
        let leaves: Vec<_> = (0..274)
            .filter_map(|index| TilePath::in_tree(TileKind::Hashes(0), index, 70_000))
            .flat_map(|tile| hashes(&tile.cut(&tree, 70_000).unwrap()))
            .collect();
        assert_eq!(root(&leaves), tree.root());
        assert_eq!(TilePath::all(256).map(|t| t.to_string()).collect::<Vec<_>>(), ["tile/0/000", "tile/1/000.p/1"]);
        assert_eq!(TilePath::all(0).count(), 0);
    }

    #[test]
    fn only_what_the_tree_holds_is_cut() {
        let mut tree = Tree::new();
        for i in 0..300_u32 {
            tree.push(leaf_hash(&i.to_be_bytes()));
        }
        let tile = |index, width| TilePath { kind: TileKind::Hashes(0), index, width };
        assert!(tile(1, 44).cut(&tree, 300).is_some());
        assert!(tile(1, 45).cut(&tree, 300).is_none());
        assert!(tile(1, 44).cut(&tree, 299).is_none(), "beyond the published size");
        assert!(tile(0, 7).cut(&tree, 300).is_some(), "partial tiles of earlier sizes stay");
        assert!(tile(2, 1).cut(&tree, 300).is_none());
        assert!(tile(u64::MAX, 1).cut(&tree, 300).is_none());
        assert!(TilePath { kind: TileKind::Hashes(63), index: 0, width: 1 }.cut(&tree, 300).is_none());
    }

    #[test]
    fn entries_go_through_their_bundle() {
        let entries: [&[u8]; 3] = [b"one", b"", &[7; 65_535]];
        let bundle = encode_entries(entries).unwrap();
        assert_eq!(bundle[..5], *b"\x00\x03one");
        assert_eq!(decode_entries(&bundle).unwrap(), entries);
        assert_eq!(decode_entries(&[]).unwrap(), Vec::<&[u8]>::new());
        assert!(matches!(encode_entries([&[0; 65_536][..]]), Err(TileError::EntryTooLong { entry: 0, .. })));
        let one = encode_entries([b"one".as_slice(), b"two"]).unwrap();
        for end in 1..one.len() {
            let whole = end == 5;
            assert_eq!(decode_entries(&one[..end]).is_ok(), whole, "cut at {end}");
        }
    }
}
