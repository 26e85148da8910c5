//! Which runs there are: one row of the store, so that it changes as one with everything else in there.
//!
//! ```text
//! version 1 | next number u64 | run count u32 | run ... (newest first) | number u64 ... of files to be removed
//! run = number u64 | level u8 | size u64 | rows u64 | keys in the filter u64 | SHA-256 of the file 32
//! ```

use crate::format::digest::Digest;

const VERSION: u8 = 1;
const RUN: usize = 8 + 1 + 8 + 8 + 8 + Digest::LEN;

/// What is known of a run without opening it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RunInfo {
    pub(super) number: u64,
    /// 0 for one out of the store, one more than its parts' for one that was merged.
    pub(super) level: u8,
    /// Bytes of the file.
    pub(super) size: u64,
    pub(super) rows: u64,
    /// Keys in its filter.
    pub(super) filtered: u64,
    /// Of the whole file.
    pub(super) sha256: Digest,
}

/// The runs of a store.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Manifest {
    /// The number of the next run.
    pub(super) next: u64,
    /// Newest first.
    pub(super) runs: Vec<RunInfo>,
    /// Runs that were merged into others, whose files may still be there.
    pub(super) replaced: Vec<u64>,
}

impl Manifest {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![VERSION];
        bytes.extend_from_slice(&self.next.to_be_bytes());
        bytes.extend_from_slice(&(self.runs.len() as u32).to_be_bytes());
        for run in &self.runs {
            bytes.extend_from_slice(&run.number.to_be_bytes());
            bytes.push(run.level);
            for number in [run.size, run.rows, run.filtered] {
                bytes.extend_from_slice(&number.to_be_bytes());
            }
            bytes.extend_from_slice(run.sha256.as_bytes());
        }
        bytes.extend(self.replaced.iter().flat_map(|number| number.to_be_bytes()));
        bytes
    }

    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (&VERSION, rest) = bytes.split_first()? else { return None };
        let (next, rest) = rest.split_first_chunk::<8>()?;
        let (count, rest) = rest.split_first_chunk::<4>()?;
        let length = (u32::from_be_bytes(*count) as usize).checked_mul(RUN)?;
        let (runs, replaced) = rest.split_at_checked(length)?;
        let runs = runs.as_chunks::<RUN>().0.iter().map(|run| decode_run(run)).collect::<Option<_>>()?;
        let (replaced, rest) = replaced.as_chunks::<8>();
        let replaced = replaced.iter().map(|number| u64::from_be_bytes(*number)).collect();
        rest.is_empty().then_some(Self { next: u64::from_be_bytes(*next), runs, replaced })
    }
}

fn decode_run(bytes: &[u8]) -> Option<RunInfo> {
    let (number, rest) = bytes.split_first_chunk::<8>()?;
    let (level, rest) = rest.split_first()?;
    let (size, rest) = rest.split_first_chunk::<8>()?;
    let (rows, rest) = rest.split_first_chunk::<8>()?;
    let (filtered, sha256) = rest.split_first_chunk::<8>()?;
    Some(RunInfo {
        number: u64::from_be_bytes(*number),
        level: *level,
        size: u64::from_be_bytes(*size),
        rows: u64::from_be_bytes(*rows),
        filtered: u64::from_be_bytes(*filtered),
        sha256: Digest::try_from(sha256).ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_through_its_bytes_and_every_cut_or_foreign_version_is_refused() {
        let run = |number| RunInfo { number, level: 2, size: 9, rows: 3, filtered: 1, sha256: Digest::of("run") };
        for (runs, replaced) in [(vec![], vec![]), (vec![run(7), run(2)], vec![]), (vec![run(1)], vec![4, 5])] {
            let manifest = Manifest { next: 8, runs, replaced };
            let bytes = manifest.encode();
            assert_eq!(Manifest::decode(&bytes), Some(manifest.clone()));
            for cut in 0..bytes.len() {
                // A list of replaced runs may end after any of them.
                let whole = cut >= 13 + manifest.runs.len() * RUN && (bytes.len() - cut).is_multiple_of(8);
                assert_eq!(Manifest::decode(&bytes[..cut]).is_some(), whole, "cut at {cut}");
            }
            assert_eq!(Manifest::decode(&[&[2], &bytes[1..]].concat()), None);
        }
    }
}
