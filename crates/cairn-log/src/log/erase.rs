//! Erasing a record's contents at its owner's wish.
//!
//! The leaf stays, and with it every root and every proof that was ever given. What goes is the envelope: the
//! name, the scene's salt and whatever else the record said. Without the salt the leaf's commitment to the scene says
//! nothing. The map keys stay (digests of scene and photographs), or nobody could work out the map again.

use super::{
    error::RegistryError,
    layout, publish,
    read::{self, LogEntry},
    reload,
    shared::{Shared, lock},
    submit,
};
use crate::format::{erasure::Erasure, map::MapKey, packs::Slot, record::RecordKind, tile::TILE_WIDTH};

/// As [`super::Registry::erase`].
pub(super) fn erase(shared: &Shared, erasure: &Erasure) -> Result<u64, RegistryError> {
    let request = erasure.request();
    if request.origin != shared.origin {
        return Err(RegistryError::WrongOrigin { expected: shared.origin.clone(), got: request.origin.clone() });
    }
    let size = shared.size();
    if read::find(shared, &request.record)? != Some(request.index) {
        return Err(RegistryError::NoSuchRecord { index: request.index, size });
    }
    // Erased already: the scene that the nonce is for is gone with it, and there is nothing left to do.
    if let LogEntry::Record(stored) = read::entry(shared, request.index)? {
        submit::check_issued(shared, &request.nonce, size, &stored.record.scene, &request.owner_key)?;
        erase_index(shared, request.index)?;
    }
    Ok(request.index)
}

/// As [`super::Registry::erase_index`].
pub(super) fn erase_index(shared: &Shared, index: u64) -> Result<(), RegistryError> {
    // Its leaf must be in a file before its envelope goes: the working state can be made again from files only.
    if index < shared.size() && shared.published().is_none_or(|published| published.size <= index) {
        publish::publish(shared)?;
    }
    let _turn = shared.turn()?;
    if let Some(cause) = shared.halted() {
        return Err(RegistryError::Halted { cause });
    }
    let stored = match read::record(shared, index) {
        Ok(stored) => stored,
        Err(RegistryError::Erased { .. }) => return Ok(()),
        Err(e) => return Err(e),
    };
    let replaced = stored.record.replaces.filter(|_| stored.record.kind == RecordKind::Rotation);
    let replaced_owner = match replaced.map(|digest| read::index_of(shared, &digest)).transpose()?.flatten() {
        Some(index) => Some(read::record_leaf(shared, index)?.owner),
        None => None,
    };
    let keys = crate::format::map::keys_of(&stored.record, replaced_owner);
    rewrite(shared, index, keys).inspect_err(|e| drop(shared.halt(&e.to_string())))
}

/// Writes a pack anew with one slot replaced.
fn rewrite(shared: &Shared, index: u64, keys: Vec<MapKey>) -> Result<(), RegistryError> {
    let width = u64::from(TILE_WIDTH);
    let (number, at) = (index / width, (index % width) as usize);
    // What a crash left behind the log's end is left out.
    let held = (shared.size() - number * width).min(width) as usize;
    let (mut slots, _) = reload::held_slots(&shared.files, number, held)?;
    slots[at] = Slot::Erased(keys);
    let pack: Vec<u8> = slots.iter().flat_map(Slot::to_frame).collect();
    let length = pack.len() as u64;
    shared.files.replace(&[(layout::pack(number), pack)])?;
    if held < TILE_WIDTH as usize {
        lock(&shared.writer).pack_length = length;
    }
    Ok(())
}
