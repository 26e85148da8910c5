//! Writing a run, row by row, in memory that does not grow with it but for its index and filter.

use sha2::{Digest as _, Sha256};

use super::{
    filter::Filter,
    format::{BLOCK, Footer, MAGIC, push_row, sealed},
    manifest::RunInfo,
};
use crate::{format::digest::Digest, log::store::StoreError};
use cairn_durable::Files;

/// Bytes gathered before they are handed to the file system.
const PIECE: usize = 1 << 20;

/// A run on its way. Nothing of it has a name before [`RunWriter::finish`]; dropped before that it leaves nothing behind.
pub(super) struct RunWriter<'a> {
    files: &'a Files,
    path: String,
    /// Bytes handed over.
    written: u64,
    /// Bytes that are not handed over yet, whole blocks.
    piece: Vec<u8>,
    /// Rows of the block that is being filled.
    block: Vec<u8>,
    separator: Vec<u8>,
    last_key: Option<Vec<u8>>,
    index: Vec<u8>,
    filter: Filter,
    footer: Footer,
    hasher: Sha256,
    finished: bool,
}

impl<'a> RunWriter<'a> {
    /// A run to be at `path`, of which at most `filtered` keys go into its filter.
    pub(super) fn new(files: &'a Files, path: String, filtered: u64) -> Self {
        Self {
            files,
            path,
            written: 0,
            piece: MAGIC.to_vec(),
            block: Vec::new(),
            separator: Vec::new(),
            last_key: None,
            index: Vec::new(),
            filter: Filter::with_room(filtered),
            footer: Footer { index: 0, filter: 0, blocks: 0, rows: 0, filtered: 0 },
            hasher: Sha256::new(),
            finished: false,
        }
    }

    /// Appends a row, whose key must be greater than the last one's; `looked_up` keys go into the filter.
    pub(super) fn push(&mut self, key: &[u8], value: &[u8], looked_up: bool) -> Result<(), StoreError> {
        if u16::try_from(key.len()).is_err() || u32::try_from(value.len()).is_err() {
            return Err(self.refuse(format!("a row of {} and {} bytes is too long", key.len(), value.len())));
        }
        if self.last_key.as_deref().is_some_and(|last| last >= key) {
            return Err(self.refuse(format!("key {key:02x?} is out of order")));
        }
        if self.block.is_empty() {
            self.separator = separator(self.last_key.as_deref().unwrap_or_default(), key).to_vec();
        }
        push_row(&mut self.block, key, value);
        self.footer.rows += 1;
        if looked_up {
            self.filter.add(key);
            self.footer.filtered += 1;
        }
        let last = self.last_key.get_or_insert_default();
        last.clear();
        last.extend_from_slice(key);
        if self.block.len() >= BLOCK { self.close_block() } else { Ok(()) }
    }

    /// Completes the file, durably, under its name.
    pub(super) fn finish(mut self, number: u64, level: u8) -> Result<RunInfo, StoreError> {
        if !self.block.is_empty() {
            self.close_block()?;
        }
        self.footer.index = self.written + self.piece.len() as u64;
        let index = sealed(std::mem::take(&mut self.index));
        self.footer.filter = self.footer.index + index.len() as u64;
        self.piece.extend(index);
        self.piece.extend(sealed(self.filter.bytes().to_vec()));
        self.piece.extend(self.footer.encode());
        self.hand_over()?;
        self.files.complete(&self.path)?;
        self.finished = true;
        let Footer { rows, filtered, .. } = self.footer;
        let sha256 = Digest::from_bytes(self.hasher.clone().finalize().into());
        Ok(RunInfo { number, level, size: self.written, rows, filtered, sha256 })
    }

    fn close_block(&mut self) -> Result<(), StoreError> {
        let block = sealed(std::mem::take(&mut self.block));
        // Keys are at most 64 KiB, and a separator is no longer than its key.
        self.index.extend_from_slice(&(self.separator.len() as u16).to_be_bytes());
        self.index.extend_from_slice(&self.separator);
        self.index.extend_from_slice(&(block.len() as u32).to_be_bytes());
        self.footer.blocks += 1;
        self.piece.extend(block);
        if self.piece.len() >= PIECE { self.hand_over() } else { Ok(()) }
    }

    fn hand_over(&mut self) -> Result<(), StoreError> {
        self.hasher.update(&self.piece);
        self.files.draft(&self.path, self.written, &self.piece)?;
        self.written += self.piece.len() as u64;
        self.piece.clear();
        Ok(())
    }

    fn refuse(&self, cause: String) -> StoreError {
        StoreError::new("write", &self.path, cause)
    }
}

impl Drop for RunWriter<'_> {
    fn drop(&mut self) {
        if !self.finished {
            // What stays is removed with what the next list of runs replaces, or by the next start.
            let _ = self.files.discard(&self.path);
        }
    }
}

/// The shortest key that is greater than `before` and not greater than `first`.
fn separator<'a>(before: &[u8], first: &'a [u8]) -> &'a [u8] {
    let shared = before.iter().zip(first).take_while(|(a, b)| a == b).count();
    &first[..(shared + 1).min(first.len())]
}
