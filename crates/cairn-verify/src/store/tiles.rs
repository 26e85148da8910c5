//! Tiles of hashes: those of level 1 and up are made from below as the log goes by, and
//! every stored one is compared.

use cairn_log::format::{
    Digest, merkle,
    tile::{TILE_WIDTH, TileKind, TilePath},
};

use super::files::Files;
use crate::{code::Code, report::Findings};

/// The right border of the tree of tiles, levels 1 and up.
#[derive(Debug, Default)]
pub(super) struct Stack {
    levels: Vec<Level>,
}

#[derive(Debug, Default)]
struct Level {
    index: u64,
    hashes: Vec<Digest>,
}

impl Stack {
    /// Takes the root of the next full tile of level 0. `size`: of the published tree.
    pub(super) fn push(&mut self, root: Digest, files: &Files, size: u64, findings: &mut Findings) {
        let mut hash = root;
        for at in 0.. {
            if self.levels.len() == at {
                self.levels.push(Level::default());
            }
            let level = &mut self.levels[at];
            level.hashes.push(hash);
            if level.hashes.len() < usize::from(TILE_WIDTH) {
                return;
            }
            compare(files, at as u8 + 1, level.index, &level.hashes, size, findings);
            hash = merkle::root(&level.hashes);
            level.hashes.clear();
            level.index += 1;
        }
    }

    /// Compares the tiles that are not full.
    pub(super) fn finish(&self, files: &Files, size: u64, findings: &mut Findings) {
        for (at, level) in self.levels.iter().enumerate().filter(|(_, level)| !level.hashes.is_empty()) {
            compare(files, at as u8 + 1, level.index, &level.hashes, size, findings);
        }
    }
}

/// Holds every stored tile at this place, stale partial ones included, to the hashes that belong there; the one that a
/// tree of `size` leaves has, or a wider one, must be there.
pub(super) fn compare(files: &Files, level: u8, index: u64, hashes: &[Digest], size: u64, findings: &mut Findings) {
    let kind = TileKind::Hashes(level);
    let needed = TilePath::in_tree(kind, index, size).map_or(0, |tile| tile.width);
    let mut widest = 0;
    for path in stored(files, kind, index).filter(|path| usize::from(path.width) <= hashes.len()) {
        let expected: Vec<u8> = hashes[..path.width.into()].iter().flat_map(|h| *h.as_bytes()).collect();
        match files.tile(&path) {
            Ok(Some(got)) if got == expected => {}
            Ok(Some(got)) => {
                let place = match expected.iter().zip(&got).position(|(a, b)| a != b) {
                    Some(at) => format!("{}, hash {}", files.name_tile(&path), at / 32),
                    None => files.name_tile(&path),
                };
                let got = format!("other bytes ({} of them)", got.len());
                findings.add(Code::StoreTileMismatch, place, format!("{} hashes that the log makes", path.width), got);
            }
            Ok(None) => continue,
            Err(cause) => findings.add(Code::StoreTileMismatch, files.name_tile(&path), "a tile", cause),
        }
        widest = path.width;
    }
    if widest < needed {
        let path = TilePath { kind, index, width: needed };
        findings.add(Code::StoreTileMissing, files.name_tile(&path), format!("{needed} hashes"), "no file");
    }
}

/// The tiles that may be stored at a place: partial ones as they are listed, then the full one.
pub(super) fn stored(files: &Files, kind: TileKind, index: u64) -> impl Iterator<Item = TilePath> {
    let widths = files.partial_widths(kind, index).into_iter().chain([TILE_WIDTH]);
    widths.map(move |width| TilePath { kind, index, width })
}

/// The widest stored tile or bundle at a place that has its full length, and its bytes.
pub(super) fn widest(files: &Files, kind: TileKind, index: u64, each: usize) -> Option<(TilePath, Vec<u8>)> {
    let mut paths: Vec<TilePath> = stored(files, kind, index).collect();
    paths.reverse();
    let whole = |path: TilePath| {
        let bytes = files.tile(&path).ok().flatten()?;
        (bytes.len() == usize::from(path.width) * each).then_some((path, bytes))
    };
    paths.into_iter().find_map(whole)
}
