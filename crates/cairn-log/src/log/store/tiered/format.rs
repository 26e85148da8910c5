//! A sorted run: rows that never change, in one file, ascending by key.
//!
//! ```text
//! file   = "cairn-run/1\n" | block ... | index | filter | footer
//! block  = row ... | CRC-32 of the rows                                  about 4 KiB
//! row    = key length u16 | value length u32 | key | value
//! index  = for each block: separator length u16 | separator | block length u32, CRC included; then CRC-32 of all that
//! filter = bits of the Bloom filter | CRC-32 of them
//! footer = offset of index u64 | of filter u64 | blocks u64 | rows u64 | keys in the filter u64 | CRC-32 of the footer so far
//! ```
//!
//! Numbers are big-endian. A separator is greater than every key before its block and not greater than the first key in it.
//! Every byte is under a checksum, so that a disk that rots shows as an error with a place and not as a missing record.

/// What to do where a run, or the list of them, is damaged.
pub(super) const RESTORE: &str =
    "restore the newest backup, or have the working state made again (`cairn registry rebuild`)";
/// First bytes of the file, with the format's version.
pub(super) const MAGIC: &[u8] = b"cairn-run/1\n";
/// Bytes of rows after which a block is closed.
pub(super) const BLOCK: usize = 4096;
/// Bytes of a checksum.
pub(super) const CRC: usize = 4;
/// Bytes of the footer.
pub(super) const FOOTER: usize = 5 * 8 + CRC;

/// What stands at the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Footer {
    pub(super) index: u64,
    pub(super) filter: u64,
    pub(super) blocks: u64,
    pub(super) rows: u64,
    pub(super) filtered: u64,
}

impl Footer {
    pub(super) fn encode(&self) -> Vec<u8> {
        let numbers = [self.index, self.filter, self.blocks, self.rows, self.filtered];
        sealed(numbers.iter().flat_map(|number| number.to_be_bytes()).collect())
    }

    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (numbers, rest) = opened(bytes)?.as_chunks::<8>();
        let [index, filter, blocks, rows, filtered] = *numbers else { return None };
        let number = u64::from_be_bytes;
        let footer = Self {
            index: number(index),
            filter: number(filter),
            blocks: number(blocks),
            rows: number(rows),
            filtered: number(filtered),
        };
        rest.is_empty().then_some(footer)
    }
}

/// Bytes with their checksum behind them.
pub(super) fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let crc = crc32fast::hash(&bytes);
    bytes.extend_from_slice(&crc.to_be_bytes());
    bytes
}

/// Bytes without their checksum, if that is theirs.
pub(super) fn opened(bytes: &[u8]) -> Option<&[u8]> {
    let (bytes, crc) = bytes.split_last_chunk::<CRC>()?;
    (crc32fast::hash(bytes) == u32::from_be_bytes(*crc)).then_some(bytes)
}

/// Appends a row whose key and value are not too long for it.
pub(super) fn push_row(rows: &mut Vec<u8>, key: &[u8], value: &[u8]) {
    rows.extend_from_slice(&(key.len() as u16).to_be_bytes());
    rows.extend_from_slice(&(value.len() as u32).to_be_bytes());
    rows.extend_from_slice(key);
    rows.extend_from_slice(value);
}

/// The row at the front of `rows`, and what lies behind it.
pub(super) fn row(rows: &[u8]) -> Option<(&[u8], &[u8], &[u8])> {
    let (key_length, rest) = rows.split_first_chunk::<2>()?;
    let (value_length, rest) = rest.split_first_chunk::<4>()?;
    let (key, rest) = rest.split_at_checked(u16::from_be_bytes(*key_length).into())?;
    let (value, rest) = rest.split_at_checked(u32::from_be_bytes(*value_length) as usize)?;
    Some((key, value, rest))
}
