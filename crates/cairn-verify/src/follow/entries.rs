//! The entries that are new since the last look: they, and nothing else, make the new
//! root out of the old tree.

use cairn_log::format::{
    Digest, Leaf, MapLeaf, NoteVerifier,
    leaf::{LEAF_LEN, MAP_KIND},
    merkle::{Frontier, leaf_hash},
    tile::{TILE_WIDTH, TileKind, TilePath},
};

use super::{
    fetch::{Fetch, FollowError, MAX_NEW_ENTRIES, Signed},
    reader,
};
use crate::{code::Code, report::Findings};

const CHUNK: u64 = TILE_WIDTH as u64;
const ENTRY: usize = 2 + LEAF_LEN;

/// Fetches and checks the entries from `from` on. `peaks`: of the tree of `from` leaves, verified.
pub(super) fn check(
    log: &dyn Fetch,
    peaks: &[Digest],
    from: u64,
    now: &Signed,
    pinned: &NoteVerifier,
    findings: &mut Findings,
) -> Result<(), FollowError> {
    let size = now.checkpoint.size;
    let new = size.saturating_sub(from);
    if new > MAX_NEW_ENTRIES {
        return Err(FollowError::TooMany { got: new });
    }
    let mut tree = Frontier::of(from, peaks.to_vec());
    let (mut map_leaves, mut last_is_map) = (0, false);
    for index in from / CHUNK..size.div_ceil(CHUNK) {
        let (bundle, hashes) = chunk(log, index, size)?;
        for (at, (entry, hash)) in (index * CHUNK..).zip(bundle.as_chunks::<ENTRY>().0.iter().zip(&hashes)) {
            if at < from {
                continue;
            }
            let leaf = leaf_hash(&entry[2..]);
            if entry[..2] != (LEAF_LEN as u16).to_be_bytes() || leaf != *hash {
                let expected = format!("the entry whose hash is {hash}, as in tile/0");
                findings.add(Code::FollowTiles, format!("entry {at}"), expected, format!("one of hash {leaf}"));
                return Ok(());
            }
            last_is_map = entry[3] == MAP_KIND;
            if last_is_map {
                map_leaves += 1;
                let checked = MapLeaf::decode(&entry[2..]).map_err(|e| e.to_string());
                let verify = |leaf: MapLeaf| leaf.verify(pinned.name(), at, pinned.key()).map_err(|e| e.to_string());
                if let Err(cause) = checked.and_then(verify) {
                    findings.add(Code::FollowMapLeaf, format!("entry {at}"), "a map leaf signed by the log", cause);
                }
            } else if let Err(e) = Leaf::decode(&entry[2..]) {
                findings.add(Code::FollowTiles, format!("entry {at}"), "a leaf of version 1", e);
            }
            tree.push(leaf);
        }
    }
    if size > 0 && !last_is_map {
        findings.add(Code::FollowMapLeaf, format!("entry {}", size - 1), "a map leaf as the log's last", "none");
    }
    let (root, got) = (now.checkpoint.root, tree.root());
    if got == root {
        findings.add(Code::FollowEntries, "entries", "", format!("{new} new, {map_leaves} of them map leaves"));
    } else {
        findings.add(Code::FollowTiles, "entries", format!("root {root}"), format!("entries that make root {got}"));
    }
    Ok(())
}

/// A chunk's bundle and its hashes.
fn chunk(log: &dyn Fetch, index: u64, size: u64) -> Result<(Vec<u8>, Vec<Digest>), FollowError> {
    let read = |kind| {
        let missing = || FollowError::Missing { path: format!("chunk {index}") };
        reader::tile(log, TilePath::in_tree(kind, index, size).ok_or_else(missing)?)
    };
    let (bundle, hashes) = (read(TileKind::Entries)?, read(TileKind::Hashes(0))?);
    Ok((bundle, hashes.as_chunks::<32>().0.iter().map(|h| Digest::from_bytes(*h)).collect()))
}
