//! Erasing a record's contents at its owner's wish.
//!
//! The leaf stays, and with it every root and every proof that was ever given. What goes is the envelope: the
//! name, the scene's salt and whatever else the record said. Without the salt the leaf's commitment to the scene says
//! nothing. The map keys stay (digests of scene and photographs), or nobody could work out the map again.

use super::{LogEntry, Registry, RegistryError, commit::lock, layout, reload::inconsistent};
use crate::format::{
    erasure::Erasure,
    map::MapKey,
    packs::{self, Slot},
    record::RecordKind,
    tile::TILE_WIDTH,
};

impl Registry {
    /// Erases the record that a signed request names; gives its index. That the request is for this log, names the record
    /// that stands there, and carries a fresh nonce is checked here; whether its key may speak for the record is the
    /// caller's to say, who knows what has become of the record since.
    ///
    /// # Errors
    /// [`RegistryError::WrongOrigin`], [`RegistryError::NonceForeign`], [`RegistryError::NonceExpired`],
    /// [`RegistryError::NoSuchRecord`], and as [`Registry::erase_index`].
    pub fn erase(&self, erasure: &Erasure) -> Result<u64, RegistryError> {
        let request = erasure.request();
        if request.origin != self.origin {
            return Err(RegistryError::WrongOrigin { expected: self.origin.clone(), got: request.origin.clone() });
        }
        let size = self.size();
        if self.find(&request.record)? != Some(request.index) {
            return Err(RegistryError::NoSuchRecord { index: request.index, size });
        }
        // Erased already: the scene that the nonce is for is gone with it, and there is nothing left to do.
        if let LogEntry::Record(stored) = self.entry(request.index)? {
            self.check_issued(&request.nonce, size, &stored.record.scene, &request.owner_key)?;
            self.erase_index(request.index)?;
        }
        Ok(request.index)
    }

    /// Erases record `index`, durably on return; a record that is erased already stays so. Who may ask for it is the
    /// caller's to decide ([`Registry::erase`] does for owners).
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`], [`RegistryError::NotARecord`]; [`RegistryError::Halted`];
    /// [`RegistryError::Store`]: then it is erased or not, and asking again is safe.
    pub fn erase_index(&self, index: u64) -> Result<(), RegistryError> {
        // Its leaf must be in a file before its envelope goes: the working state can be made again from files only.
        if index < self.size() && self.published().is_none_or(|published| published.size <= index) {
            self.publish()?;
        }
        let _turn = self.turn()?;
        if let Some(cause) = self.halted() {
            return Err(RegistryError::Halted { cause });
        }
        let stored = match self.record(index) {
            Ok(stored) => stored,
            Err(RegistryError::Erased { .. }) => return Ok(()),
            Err(e) => return Err(e),
        };
        let replaced = stored.record.replaces.filter(|_| stored.record.kind == RecordKind::Rotation);
        let replaced_owner = match replaced.map(|digest| self.index_of(&digest)).transpose()?.flatten() {
            Some(index) => Some(self.record_leaf(index)?.owner),
            None => None,
        };
        let keys = crate::format::map::keys_of(&stored.record, replaced_owner);
        self.rewrite(index, keys).inspect_err(|e| drop(self.halt(&e.to_string())))
    }

    /// Writes a pack anew with one slot replaced.
    fn rewrite(&self, index: u64, keys: Vec<MapKey>) -> Result<(), RegistryError> {
        let width = u64::from(TILE_WIDTH);
        let (number, at) = (index / width, (index % width) as usize);
        let path = layout::pack(number);
        let pack = self.files.read(&path, packs::MAX_PACK)?;
        let pack = pack.ok_or_else(|| inconsistent(&path, "the file is missing".into()))?;
        // What a crash left behind the log's end is left out.
        let held = (self.size() - number * width).min(width) as usize;
        let (mut slots, _) = packs::parse(&pack, held).map_err(|e| inconsistent(&path, e.to_string()))?;
        if slots.len() != held {
            return Err(inconsistent(&path, format!("{} entries, {held} expected", slots.len())));
        }
        slots[at] = Slot::Erased(keys);
        let pack: Vec<u8> = slots.iter().flat_map(Slot::to_frame).collect();
        let length = pack.len() as u64;
        self.files.replace(&[(path, pack)])?;
        if held < TILE_WIDTH as usize {
            lock(&self.writer).pack_length = length;
        }
        Ok(())
    }
}
