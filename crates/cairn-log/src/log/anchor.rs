//! The anchor: what the log signed last, in a file where a restored data folder does not reach.
//!
//! A data folder that is restored whole from an older backup agrees with itself, and what it signs next contradicts what it
//! signed before. The anchor lies elsewhere and does not go back with it:
//!
//! ```text
//! cairn-anchor/1
//! <origin>
//! <size>
//! <base64 root>
//! sha256 <hex digest of the lines above>
//! ```
//!
//! It is flushed before a signature over its size leaves: its bytes at the same time as the round's envelopes, its
//! name at the same time as the round's rows. A crash leaves either of anchor and rows one round ahead. Where that is
//! the store, the anchor catches up. Where it is the anchor, the round's envelopes are in their pack, which was flushed
//! before both, and the start takes that round in again ([`round_behind`]), which comes to the anchor's very root. A
//! log that can do neither is older than its own word.

use std::{io, path::Path};

use super::{error::RegistryError, layout, tiles::TileTree};
use crate::{
    format::{
        checkpoint::Checkpoint,
        digest::Digest,
        dsse::Envelope,
        merkle,
        packs::{self, Slot},
        tile::TILE_WIDTH,
    },
    log::store::StoreError,
};
use cairn_durable::{Disk, Files, RealDisk};

const FORMAT: &str = "cairn-anchor/1";
/// Largest anchor that is read, bytes: an origin of 256, and room to spare.
const MAX_BYTES: u64 = 1024;

/// A log's anchor. One file serves one log.
pub struct Anchor {
    files: Files,
    name: String,
    /// The file, as errors name it.
    place: String,
    made_where_missing: bool,
}

/// What a start finds of its anchor.
pub(super) enum Standing {
    /// The log goes on from it, or it is to be written for the first time.
    Behind,
    /// It is one round ahead, and here is that round.
    Ahead(Round),
}

/// A round whose envelopes were flushed before a crash, and its rows not.
pub(super) struct Round {
    pub(super) envelopes: Vec<Envelope>,
    /// Bytes of the pack that the next entry goes into.
    pub(super) pack_length: u64,
    /// What it has to come to.
    pub(super) signed: Checkpoint,
    /// The anchor that knows of it, as errors name it.
    pub(super) place: String,
}

impl Round {
    /// Bytes of the pack that the next entry goes into, if this is what was about to be signed.
    pub(super) fn comes_to(&self, signed: &Checkpoint, size: u64) -> Result<u64, RegistryError> {
        if *signed == self.signed {
            return Ok(self.pack_length);
        }
        let what = format!("root {} at size {}, {} was signed", signed.root, signed.size, self.signed.root);
        Err(self.refuse(size, &what))
    }

    pub(super) fn refuse(&self, size: u64, problem: &str) -> RegistryError {
        let what = format!("the envelopes of one more round are there and give {problem}");
        RegistryError::RolledBack { anchor: self.place.clone(), anchored: self.signed.size, size, what }
    }
}

impl Anchor {
    /// The anchor in the file `path`, whose folder is there: what is misspelt must not become a new folder.
    ///
    /// # Errors
    /// [`StoreError`] for a folder that is not there, or a path that ends in none.
    pub fn at(path: &Path) -> Result<Self, StoreError> {
        let place = path.display().to_string();
        let refuse = |cause: String| StoreError { operation: "open the anchor", place: place.clone(), cause };
        let name = path.file_name().and_then(|name| name.to_str());
        let name = name.ok_or_else(|| refuse("its path names no file in UTF-8".into()))?.to_owned();
        // A bare name lies in the working directory.
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let found = folder.metadata().and_then(|there| match there.is_dir() {
            true => Ok(()),
            false => Err(io::Error::from(io::ErrorKind::NotADirectory)),
        });
        found.map_err(|e| refuse(format!("its folder: {e}; make the folder, or mount the disk that it is on")))?;
        Ok(Self { files: Files::new(Box::new(RealDisk::new(folder))), name, place, made_where_missing: false })
    }

    /// The anchor in the file `name` on a disk of the caller's.
    pub fn on(disk: Box<dyn Disk>, name: &str) -> Self {
        let files = Files::new(disk);
        Self { files, name: name.to_owned(), place: name.to_owned(), made_where_missing: false }
    }

    /// Writes it from the log that is opened where it is missing, also where that log is not empty: somebody looked at
    /// what the log is and takes it for the newest. One that is there is held to all the same.
    #[must_use]
    pub fn made_where_missing(self) -> Self {
        Self { made_where_missing: true, ..self }
    }

    /// Writes down what is about to be signed; durable on return.
    pub(super) fn write(&self, signed: &Checkpoint) -> Result<(), StoreError> {
        self.prepare(signed)?;
        self.adopt()
    }

    /// Half of that: everything is on the disk, and the anchor is still the one before.
    pub(super) fn prepare(&self, signed: &Checkpoint) -> Result<(), StoreError> {
        let text = format!("{FORMAT}\n{}", signed.to_text());
        let text = format!("{text}sha256 {}\n", Digest::of(&text));
        Ok(self.files.prepare(&self.name, text.as_bytes())?)
    }

    /// The other half.
    pub(super) fn adopt(&self) -> Result<(), StoreError> {
        Ok(self.files.adopt(&self.name)?)
    }

    fn read(&self, origin: &str) -> Result<Option<Checkpoint>, RegistryError> {
        let Some(bytes) = self.files.read(&self.name, MAX_BYTES)? else { return Ok(None) };
        let refuse = |what: String| RegistryError::BadAnchor { anchor: self.place.clone(), what };
        let text = String::from_utf8(bytes).map_err(|e| refuse(e.to_string()))?;
        let (format, rest) = text.split_once('\n').unwrap_or((&text, ""));
        if format != FORMAT {
            let got: String = format.chars().take(40).collect();
            return Err(refuse(format!("its format is {got:?}, this release reads {FORMAT:?}")));
        }
        let damaged = || refuse("it is damaged: its last line is not the SHA-256 of those above".into());
        let (body, sum) = rest.rsplit_once("sha256 ").ok_or_else(damaged)?;
        if sum != format!("{}\n", Digest::of(&text[..format.len() + 1 + body.len()])) {
            return Err(damaged());
        }
        let known = Checkpoint::parse_text(body).map_err(|e| refuse(e.to_string()))?;
        if known.origin != origin {
            return Err(refuse(format!("it is of log {:?}, this is {origin:?}; give each log its own", known.origin)));
        }
        Ok(Some(known))
    }

    /// Holds a log to it.
    ///
    /// # Errors
    /// [`RegistryError::RolledBack`], [`RegistryError::AnchorMissing`], [`RegistryError::BadAnchor`].
    pub(super) fn hold(
        &self,
        tree: &TileTree,
        size: u64,
        files: &Files,
        origin: &str,
    ) -> Result<Standing, RegistryError> {
        let Some(known) = self.read(origin)? else {
            // Of a log that signed nothing yet there is nothing to forget.
            return match size {
                0 => Ok(Standing::Behind),
                _ if self.made_where_missing => Ok(Standing::Behind),
                _ => Err(RegistryError::AnchorMissing { anchor: self.place.clone(), size }),
            };
        };
        if known.size <= size {
            let root = merkle::root_at(tree, known.size)?;
            if root == known.root {
                return Ok(Standing::Behind);
            }
            let what = format!("its root at that size is {root}, {} was signed", known.root);
            return Err(self.rolled_back(&known, size, what));
        }
        match round_behind(files, size)? {
            Some((envelopes, end, pack_length)) if end == known.size => {
                Ok(Standing::Ahead(Round { envelopes, pack_length, signed: known, place: self.place.clone() }))
            }
            _ => Err(self.rolled_back(&known, size, "the entries in between are not there".into())),
        }
    }

    fn rolled_back(&self, known: &Checkpoint, size: u64, what: String) -> RegistryError {
        RegistryError::RolledBack { anchor: self.place.clone(), anchored: known.size, size, what }
    }
}

/// The round whose envelopes stand in packs behind the log's end, the log's size with it, and the bytes of its last pack that
/// are the log's then; none where there is no whole round.
fn round_behind(files: &Files, size: u64) -> Result<Option<(Vec<Envelope>, u64, u64)>, RegistryError> {
    let width = u64::from(TILE_WIDTH);
    let (mut envelopes, mut end) = (Vec::new(), size);
    for number in size / width.. {
        let path = layout::pack(number);
        let Some(pack) = files.read(&path, packs::MAX_PACK)? else { return Ok(None) };
        let (slots, _) = packs::parse_whole(&pack);
        let mut length = 0;
        for (at, slot) in slots.iter().enumerate() {
            length += slot.to_frame().len() as u64;
            if at as u64 + number * width < end {
                continue;
            }
            end += 1;
            match slot {
                Slot::Record(json) => match Envelope::parse(json) {
                    Ok(envelope) => envelopes.push(envelope),
                    Err(_) => return Ok(None),
                },
                Slot::MapLeaf if envelopes.is_empty() => return Ok(None),
                Slot::MapLeaf => {
                    let length = if end.is_multiple_of(width) { 0 } else { length };
                    return Ok(Some((envelopes, end, length)));
                }
                // Nobody erases what is in no log.
                Slot::Erased(_) => return Ok(None),
            }
        }
        if (slots.len() as u64) < width {
            return Ok(None);
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{format::key::OwnerKey, log::store::FaultyStore};

    const WIDTH: usize = TILE_WIDTH as usize;

    fn record(number: usize) -> Slot {
        let mut envelope = Envelope::new("test", number.to_string());
        envelope.sign(&OwnerKey::from_seed(&[1; 32]));
        Slot::Record(envelope.to_json().into_bytes())
    }

    /// What is found behind `size` where the packs hold these slots.
    fn found(slots: &[Slot], size: usize) -> Option<(Vec<Vec<u8>>, u64, u64)> {
        let files = Files::new(Box::new(FaultyStore::new()));
        for (number, slots) in (0..).zip(slots.chunks(WIDTH)) {
            let pack: Vec<u8> = slots.iter().flat_map(Slot::to_frame).collect();
            files.append(&layout::pack(number), 0, &pack).unwrap();
        }
        let round = round_behind(&files, size as u64).unwrap();
        round.map(|(envelopes, end, length)| (envelopes.into_iter().map(|e| e.payload).collect(), end, length))
    }

    #[test]
    fn a_round_is_found_wherever_packs_end() {
        for (size, records) in
            [(0, 1), (2, 3), (WIDTH - 2, 1), (WIDTH - 1, 1), (WIDTH - 3, 8), (WIDTH, 2), (5, 2 * WIDTH)]
        {
            let before = (0..size).map(|at| if at + 1 == size { Slot::MapLeaf } else { record(at) });
            let round = (0..records).map(record).chain([Slot::MapLeaf]);
            let slots: Vec<Slot> = before.chain(round).collect();
            let end = size + records + 1;
            let length: usize = slots[end - end % WIDTH..end].iter().map(|slot| slot.to_frame().len()).sum();
            let payloads = (0..records).map(|number| number.to_string().into_bytes()).collect();
            let wanted = Some((payloads, end as u64, length as u64));
            assert_eq!(found(&slots, size), wanted, "{records} behind {size}");
            // What is left of something longer that stood there changes nothing.
            let further: Vec<Slot> = slots.iter().cloned().chain([record(7)]).collect();
            assert_eq!(found(&further, size), wanted, "{records} behind {size}, and more");
            for end in size..slots.len() {
                assert_eq!(found(&slots[..end], size), None, "{records} behind {size}, cut at {end}");
            }
        }
        assert_eq!(found(&[Slot::MapLeaf], 0), None, "no record at all");
        assert_eq!(found(&[Slot::Record(b"{}".to_vec()), Slot::MapLeaf], 0), None);
        assert_eq!(found(&[Slot::Erased(vec![crate::format::map::MapKey::scene("a")]), Slot::MapLeaf], 0), None);
    }
}
