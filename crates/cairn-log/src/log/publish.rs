//! Publishing: the files that monitors, mirrors and auditors read.
//!
//! Not in the way of submitters: what they wait for is durable without it, and one publication covers all
//! that came in since the last. Tiles first, then the checkpoint, so that whoever reads a
//! checkpoint finds what it speaks of. Leaves go out of the store only once the tile and the bundle that hold them
//! are full and durable.

use std::collections::BTreeMap;

use super::{
    error::{RegistryError, inconsistent},
    layout,
    nonce::NONCE_LIFETIME,
    read, reload,
    shared::{Published, Shared, lock},
    tiles,
};
use crate::format::{
    checkpoint::Checkpoint,
    note::Note,
    tile::{TILE_WIDTH, TileKind, TilePath},
};

/// As [`super::Registry::publish`].
pub(super) fn publish(shared: &Shared) -> Result<Published, RegistryError> {
    let mut publisher = lock(&shared.publisher);
    let (size, checkpoint, full, partial) = snapshot(shared)?;
    if let Some(published) = publisher.published.as_ref().filter(|published| published.size == size) {
        return Ok(published.clone());
    }
    let filed = size - size % u64::from(TILE_WIDTH);
    let mut files = partial;
    for ((level, index), hashes) in &full {
        let path = TilePath { kind: TileKind::Hashes(*level), index: *index, width: TILE_WIDTH };
        files.push((path, tiles::bytes_of(hashes)));
    }
    for index in publisher.filed / u64::from(TILE_WIDTH)..=filed / u64::from(TILE_WIDTH) {
        let Some(path) = TilePath::in_tree(TileKind::Entries, index, size) else { continue };
        let bundle = read::tile(shared, &path)?;
        files.push((path, bundle.ok_or_else(|| inconsistent(&path.to_string(), "not all of it is there".into()))?));
    }
    let written: Vec<_> = files.iter().map(|(path, bytes)| (layout::public(path), bytes.clone())).collect();
    shared.files.replace(&written)?;
    shared.files.replace(&[(layout::CHECKPOINT.to_owned(), checkpoint.clone().into_bytes())])?;
    let published = Published { size, checkpoint };
    publisher.published = Some(published.clone());
    if shared.halted().is_none() {
        let_go(shared, publisher.filed, filed)?;
        publisher.filed = filed;
    }
    shared.write().tree.filed(&full);
    // Full tiles hold all that their partial forms held, and readers are served from those.
    for (path, _) in files.iter().filter(|(path, _)| path.width == TILE_WIDTH) {
        shared.files.remove(&format!("{}.p", layout::public(path)))?;
    }
    Ok(published)
}

/// As [`super::Registry::cosign`].
pub(super) fn cosign(shared: &Shared, note: &str) -> Result<(), RegistryError> {
    let refuse = |what: String| inconsistent("cosigned checkpoint", what);
    let checkpoint = Checkpoint::verify(note, &shared.verifier()?).map_err(|e| refuse(e.to_string()))?;
    {
        let state = shared.read();
        reload::extends(&state.tree, state.size, &checkpoint)?;
    }
    // Fewer cosignatures may be too few for somebody's policy: then the older note goes on proving what it covers.
    let worth = |note: &str| Note::parse(note).map_or(0, |note| note.signatures.len());
    let mut publisher = lock(&shared.publisher);
    let same = |p: &&mut Published| p.size == checkpoint.size && worth(&p.checkpoint) <= worth(note);
    if let Some(published) = publisher.published.as_mut().filter(same) {
        shared.files.replace(&[(layout::CHECKPOINT.to_owned(), note.as_bytes().to_vec())])?;
        published.checkpoint = note.to_owned();
    }
    let mut state = shared.write();
    let better = |(size, old): &(u64, String)| *size <= checkpoint.size && worth(old) <= worth(note);
    if state.cosigned.as_ref().is_none_or(better) {
        state.cosigned = Some((checkpoint.size, note.to_owned()));
    }
    Ok(())
}

/// Size and checkpoint of what is durable, the full tiles of it that are not in files, and its partial tiles.
#[expect(clippy::type_complexity, reason = "four parts of one moment, taken under one lock and used once")]
fn snapshot(
    shared: &Shared,
) -> Result<(u64, String, Vec<(tiles::TileName, tiles::Hashes)>, Vec<(TilePath, Vec<u8>)>), RegistryError> {
    let state = shared.read();
    let size = state.size;
    let within = |level: u8, index: u64| {
        TilePath::in_tree(TileKind::Hashes(level), index, size).is_some_and(|held| held.width == TILE_WIDTH)
    };
    // Tiles that a batch on its way has filled hold leaves that are not durable yet.
    let full: Vec<_> = state.tree.fresh().into_iter().filter(|((level, index), _)| within(*level, *index)).collect();
    let mut partial = BTreeMap::new();
    for level in 0..=crate::format::tile::MAX_LEVEL {
        let count = size.checked_shr(8 * u32::from(level)).unwrap_or(0);
        let last = TilePath::in_tree(TileKind::Hashes(level), count / u64::from(TILE_WIDTH), size);
        if let Some(path) = last.filter(|last| last.width < TILE_WIDTH)
            && let Some(bytes) = state.tree.tile(&path, size)?
        {
            partial.insert(level, (path, bytes));
        }
    }
    Ok((size, state.checkpoint.clone(), full, partial.into_values().collect()))
}

/// Leaves that stand in files go out of the store, and nonces that are too old to be used again.
fn let_go(shared: &Shared, from: u64, to: u64) -> Result<(), RegistryError> {
    if from == to {
        return Ok(());
    }
    let mut changes: Vec<_> = (from..to).map(|index| (layout::leaf(index), None)).collect();
    let old = from.saturating_sub(NONCE_LIFETIME)..to.saturating_sub(NONCE_LIFETIME);
    changes.extend(old.map(|index| (layout::nonce(index), None)));
    changes.push((layout::FILED.to_vec(), Some(to.to_be_bytes().to_vec())));
    // Not flushed: should it be lost, the next start reads leaves from the store that are in files as well.
    Ok(shared.store.put(changes)?)
}
