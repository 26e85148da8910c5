//! Reading a run: its index and filter are in memory, its rows come from the file, a block at a time.

use std::sync::Arc;

use super::{
    filter::Filter,
    format::{CRC, FOOTER, Footer, MAGIC, RESTORE, opened, row},
    manifest::RunInfo,
};
use crate::log::store::{Entry, StoreError};
use cairn_durable::{Files, OpenFile};

/// A run that is open.
pub(super) struct Run {
    pub(super) info: RunInfo,
    path: String,
    file: Box<dyn OpenFile>,
    blocks: Blocks,
    filter: Filter,
}

/// Where blocks begin: all separators one after the other, and where each ends.
#[derive(Default)]
struct Blocks {
    separators: Vec<u8>,
    /// For each block: the end of its separator, its offset in the file, its length.
    places: Vec<(u32, u64, u32)>,
}

impl Run {
    /// Opens a run and holds it to what is known of it.
    pub(super) fn open(files: &Files, path: String, info: RunInfo) -> Result<Self, StoreError> {
        let refuse = |cause: String| StoreError::new("open", &path, cause);
        let file = files.open(&path)?.ok_or_else(|| refuse(format!("the file is missing; {RESTORE}")))?;
        let size = file.size()?;
        if size != info.size || size < (MAGIC.len() + FOOTER) as u64 {
            return Err(refuse(format!("{size} bytes, {} were written; {RESTORE}", info.size)));
        }
        if file.read_at(0, MAGIC.len())? != MAGIC {
            return Err(refuse("not a sorted run of version 1 (`cairn-run/1`)".into()));
        }
        let damaged = |what: &str| refuse(format!("its {what} is damaged; {RESTORE}"));
        let end = size - FOOTER as u64;
        let footer = Footer::decode(&file.read_at(end, FOOTER)?).ok_or_else(|| damaged("footer"))?;
        if (footer.rows, footer.filtered) != (info.rows, info.filtered) {
            return Err(damaged("footer"));
        }
        let piece = |from: u64, to: u64| match to.checked_sub(from) {
            Some(length) if to <= end => Ok(file.read_at(from, length as usize)?),
            _ => Err(damaged("footer")),
        };
        let index = piece(footer.index, footer.filter)?;
        let blocks = opened(&index).and_then(|index| Blocks::parse(index, &footer)).ok_or_else(|| damaged("index"))?;
        let filter = piece(footer.filter, end)?;
        let filter = Filter::from_bytes(opened(&filter).ok_or_else(|| damaged("filter"))?.to_vec());
        Ok(Self { info, path, file, blocks, filter })
    }

    /// Whether it may hold a key that is in the filter if it is here.
    pub(super) fn may_hold(&self, key: &[u8]) -> bool {
        self.filter.may_hold(key)
    }

    /// The value of a key.
    pub(super) fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(number) = self.blocks.of(key) else { return Ok(None) };
        let block = self.block(number)?;
        let mut rest = block.as_slice();
        while let Some((found, value, behind)) = row(rest) {
            if found >= key {
                return Ok((found == key).then(|| value.to_vec()));
            }
            rest = behind;
        }
        Ok(None)
    }

    /// Its rows from the key `from` on.
    pub(super) fn rows_from(self: &Arc<Self>, from: &[u8]) -> Rows {
        // A key before all of them begins with the first block.
        let next = self.blocks.of(from).unwrap_or(0);
        Rows { run: self.clone(), next, block: Vec::new(), at: 0, from: from.to_vec() }
    }

    /// The rows of a block, its checksum verified.
    fn block(&self, number: usize) -> Result<Vec<u8>, StoreError> {
        let (_, offset, length) = self.blocks.places[number];
        let mut block = self.file.read_at(offset, length as usize)?;
        if block.len() != length as usize || opened(&block).is_none() {
            return Err(self.damaged(number));
        }
        block.truncate(block.len() - CRC);
        Ok(block)
    }

    fn damaged(&self, block: usize) -> StoreError {
        StoreError::new("read", &self.path, format!("block {block} is damaged; {RESTORE}"))
    }
}

impl Blocks {
    /// None for bytes that are no index of this file's blocks.
    fn parse(mut index: &[u8], footer: &Footer) -> Option<Self> {
        let (mut blocks, mut offset) = (Self::default(), MAGIC.len() as u64);
        while let Some((length, rest)) = index.split_first_chunk::<2>() {
            let (separator, rest) = rest.split_at_checked(u16::from_be_bytes(*length).into())?;
            let (length, rest) = rest.split_first_chunk::<4>()?;
            let length = u32::from_be_bytes(*length);
            blocks.separators.extend_from_slice(separator);
            blocks.places.push((u32::try_from(blocks.separators.len()).ok()?, offset, length));
            offset += u64::from(length);
            index = rest;
        }
        (index.is_empty() && offset == footer.index && blocks.places.len() as u64 == footer.blocks).then_some(blocks)
    }

    /// The block that a key is in, if it is anywhere; none for a key before all blocks.
    fn of(&self, key: &[u8]) -> Option<usize> {
        let (mut low, mut high) = (0, self.places.len());
        while low < high {
            let middle = usize::midpoint(low, high);
            if self.separator(middle) <= key { low = middle + 1 } else { high = middle }
        }
        low.checked_sub(1)
    }

    fn separator(&self, block: usize) -> &[u8] {
        let from = block.checked_sub(1).map_or(0, |before| self.places[before].0);
        &self.separators[from as usize..self.places[block].0 as usize]
    }
}

/// Rows of a run, ascending.
pub(super) struct Rows {
    run: Arc<Run>,
    next: usize,
    block: Vec<u8>,
    at: usize,
    /// Rows before this key are passed over.
    from: Vec<u8>,
}

impl Iterator for Rows {
    type Item = Result<Entry, StoreError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if self.at == self.block.len() {
                if self.next == self.run.blocks.places.len() {
                    return None;
                }
                match self.run.block(self.next) {
                    Ok(block) => (self.block, self.at) = (block, 0),
                    Err(e) => return Some(Err(e)),
                }
                self.next += 1;
            }
            let rest = &self.block[self.at..];
            let Some((key, value, behind)) = row(rest) else { return Some(Err(self.run.damaged(self.next - 1))) };
            self.at += rest.len() - behind.len();
            if key >= self.from.as_slice() {
                return Some(Ok((key.to_vec(), value.to_vec())));
            }
        }
    }
}
