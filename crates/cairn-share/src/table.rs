//! The share table: for each row of a field and each photograph, how much of the photograph's light came from that
//! row: `A[v,i] = sum_p m[p] W_i[p,v]` over the photograph's pixels, m what a pixel counted in training.
//!
//! Photographs are kept apart, not only contributors: how well a photograph shows a place depends on where it was taken
//! from, and people ask which of their photographs it was. An entry is the photograph's number and the logarithm of its
//! weight in eight bits, three bytes in all. Nothing is cut to the largest few: that would starve who has few photographs.

use std::io::{Read, Seek};

use cairn_field::{Part, RowWeights, TensorFile, VisibleField, packed};
use glam::DVec3;
use safetensors::Dtype;
use serde::{Deserialize, Serialize};

use crate::error::ShareError;

/// Format of a stored share table; another one is refused by name.
pub const SHARES_FORMAT: &str = "cairn.shares/1";
/// Photographs that a table has numbers for.
const MAX_PHOTOGRAPHS: usize = 1 << 16;
/// Codes an octave of weight: a weight is off by 3.5 % at most.
const CODES_AN_OCTAVE: f32 = 10.0;
/// Binary logarithm of the smallest weight that is kept, pixels: what a photograph shows of a row less than that would
/// be a 250th of a pixel. The largest code stands for 185,000 pixels.
const LOWEST: f32 = -8.0;

/// A photograph that taught a field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Photograph {
    /// The view's name, unique in the scene.
    pub name: String,
    /// Where its camera stood, capture units.
    pub position: DVec3,
}

/// What each photograph taught each row; see the module's text.
#[derive(Clone, Debug, PartialEq)]
pub struct ShareTable {
    photographs: Vec<Photograph>,
    /// First entry of each row, and one more.
    starts: Vec<u32>,
    /// By entry, the photograph; a row's rise.
    of: Vec<u16>,
    /// By entry, the weight's code.
    codes: Vec<u8>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format: String,
    photographs: Vec<Photograph>,
}

/// A share table that photographs are added to, one after another.
#[derive(Clone, Debug)]
pub struct Builder {
    rows: usize,
    photographs: Vec<Photograph>,
    /// Rows that each photograph shows, ascending, and the codes of their weights.
    seen: Vec<(Vec<u32>, Vec<u8>)>,
}

impl Builder {
    /// Of a field with `rows` rows, the unused row 0 included.
    pub fn new(rows: usize) -> Self {
        Self { rows, photographs: Vec::new(), seen: Vec::new() }
    }

    /// Adds a photograph, which sees `weights`.
    ///
    /// # Errors
    /// [`ShareError::Photographs`].
    ///
    /// # Panics
    /// When it sees a row that the field has not.
    pub fn add(&mut self, photograph: Photograph, weights: &RowWeights) -> Result<(), ShareError> {
        let got = self.photographs.len() + 1;
        if got > MAX_PHOTOGRAPHS {
            return Err(ShareError::Photographs { got, max: MAX_PHOTOGRAPHS });
        }
        assert!(weights.rows.last().is_none_or(|(row, _)| (*row as usize) < self.rows), "rows of the field");
        let seen = weights.rows.iter().filter_map(|(row, weight)| Some((*row, code(*weight)?))).unzip();
        self.photographs.push(photograph);
        self.seen.push(seen);
        Ok(())
    }

    /// The table of all photographs that were added.
    ///
    /// # Errors
    /// [`ShareError::Entries`].
    pub fn finish(self) -> Result<ShareTable, ShareError> {
        let mut starts = vec![0u32; self.rows + 1];
        for row in self.seen.iter().flat_map(|(rows, _)| rows) {
            starts[*row as usize + 1] += 1;
        }
        for row in 0..self.rows {
            starts[row + 1] = starts[row + 1].checked_add(starts[row]).ok_or(ShareError::Entries)?;
        }
        let entries = starts[self.rows] as usize;
        let (mut next, mut of, mut codes) = (starts.clone(), vec![0; entries], vec![0; entries]);
        for (photograph, (rows, seen)) in self.seen.into_iter().enumerate() {
            for (row, code) in rows.into_iter().zip(seen) {
                let at = &mut next[row as usize];
                (of[*at as usize], codes[*at as usize]) = (photograph as u16, code);
                *at += 1;
            }
        }
        Ok(ShareTable { photographs: self.photographs, starts, of, codes })
    }
}

/// A weight's code; none where it is too small to count.
fn code(weight: f32) -> Option<u8> {
    let code = ((weight.log2() - LOWEST) * CODES_AN_OCTAVE).round();
    // Of what is no number nothing is kept.
    (code >= 0.0).then_some(code.min(255.0) as u8)
}

/// What a code stands for, pixels.
fn weight(code: u8) -> f32 {
    (f32::from(code) / CODES_AN_OCTAVE + LOWEST).exp2()
}

/// What every code stands for, pixels.
pub(crate) fn weights() -> [f32; 256] {
    std::array::from_fn(|code| weight(code as u8))
}

impl ShareTable {
    /// The photographs, in the order of their numbers.
    pub fn photographs(&self) -> &[Photograph] {
        &self.photographs
    }

    /// How many rows each photograph shows, in the order of their numbers; 0 for one that taught nothing.
    pub fn entries(&self) -> Vec<usize> {
        let mut entries = vec![0; self.photographs.len()];
        self.of.iter().for_each(|of| entries[usize::from(*of)] += 1);
        entries
    }

    /// Rows of the field, the unused row 0 included.
    pub fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// The photographs that show `row` by their numbers, which rise, and the codes of what they show of it.
    pub(crate) fn of_row(&self, row: usize) -> (&[u16], &[u8]) {
        let range = self.starts[row] as usize..self.starts[row + 1] as usize;
        (&self.of[range.clone()], &self.codes[range])
    }

    /// The photographs that show `row` by their numbers, which rise, and what each shows of it, pixels, as it was rounded.
    ///
    /// # Panics
    /// When there is no such row.
    pub fn shown_of(&self, row: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let (of, codes) = self.of_row(row);
        of.iter().zip(codes).map(|(of, code)| (usize::from(*of), weight(*code)))
    }

    /// The rows that photograph `number` shows, rising, and what it shows of each, pixels, as it was rounded.
    pub fn of_photograph(&self, number: usize) -> Vec<(u32, f32)> {
        let known = weights();
        let of_row = |row: usize| {
            let (of, codes) = self.of_row(row);
            of.iter().position(|of| usize::from(*of) == number).map(|at| codes[at])
        };
        let shown = (0..self.rows()).filter_map(|row| Some((row as u32, known[usize::from(of_row(row)?)])));
        shown.collect()
    }

    /// Refuses another field than the one that the photographs taught.
    ///
    /// # Errors
    /// [`ShareError::OtherField`].
    pub fn must_be_of(&self, field: &dyn VisibleField) -> Result<(), ShareError> {
        let (table, field) = (self.rows(), field.rows());
        if table == field { Ok(()) } else { Err(ShareError::OtherField { table, field }) }
    }

    /// The table as safetensors with a versioned header. Equal tables give equal bytes.
    ///
    /// # Errors
    /// [`ShareError::File`] when it cannot be written out.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ShareError> {
        let header = Header { format: SHARES_FORMAT.into(), photographs: self.photographs.clone() };
        let starts: Vec<u8> = self.starts.iter().flat_map(|v| v.to_le_bytes()).collect();
        let of: Vec<u8> = self.of.iter().flat_map(|v| v.to_le_bytes()).collect();
        let parts = [
            Part::row("photograph", Dtype::U16, &of),
            Part::row("start", Dtype::U32, &starts),
            Part::row("weight", Dtype::U8, &self.codes),
        ];
        Ok(packed(WHAT, &header, parts)?)
    }

    /// Reads what [`ShareTable::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`ShareError::File`] for an unknown format, a damaged file, or one that cannot be read.
    pub fn read_from(file: &mut (impl Read + Seek)) -> Result<Self, ShareError> {
        let mut file = TensorFile::open(file, WHAT)?;
        let Header { photographs, .. } = file.header(SHARES_FORMAT)?;
        let starts = file.numbers("start", Dtype::U32, u32::from_le_bytes)?;
        let of = file.numbers("photograph", Dtype::U16, u16::from_le_bytes)?;
        let codes = file.numbers("weight", Dtype::U8, |[code]| code)?;
        let table = Self { photographs, starts, of, codes };
        table.check().map_err(|why| cairn_field::FieldError::Stored { what: WHAT, why: why.into() })?;
        Ok(table)
    }

    /// Whether its parts fit together.
    fn check(&self) -> Result<(), &'static str> {
        let Self { photographs, starts, of, codes } = self;
        if photographs.len() > MAX_PHOTOGRAPHS || photographs.iter().any(|p| !p.position.is_finite()) {
            return Err("its photographs are too many, or stand nowhere");
        }
        let rising = starts.first() == Some(&0) && starts.windows(2).all(|pair| pair[0] <= pair[1]);
        if !rising || starts.last().map(|end| *end as usize) != Some(of.len()) || of.len() != codes.len() {
            return Err("its rows and its entries do not fit together");
        }
        let known = |pair: &[u32]| {
            let own = &of[pair[0] as usize..pair[1] as usize];
            own.windows(2).all(|two| two[0] < two[1])
                && own.last().is_none_or(|last| usize::from(*last) < photographs.len())
        };
        if starts.windows(2).all(known) {
            Ok(())
        } else {
            Err("its entries name photographs that it has not, or twice")
        }
    }
}

/// What errors call the file.
const WHAT: &str = "share table";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weight_s_code_is_off_by_less_than_four_per_cent_and_dust_has_none() {
        let known = weights();
        for k in 0..2000 {
            let weight = 0.0042f32 * 1.009f32.powi(k);
            let Some(code) = code(weight) else { panic!("{weight} px counts") };
            let off = known[usize::from(code)] / weight - 1.0;
            assert!(off.abs() < 0.036 || code == 255, "{weight} px is held as {} px", known[usize::from(code)]);
        }
        assert_eq!([code(0.0), code(0.003), code(f32::NAN), code(-1.0)], [None; 4]);
        assert_eq!(code(f32::INFINITY), Some(255));
    }

    fn seen(rows: &[(u32, f32)]) -> RowWeights {
        RowWeights { rows: rows.to_vec(), behind: 0.0, pixels: 1.0 }
    }

    fn some() -> ShareTable {
        let mut builder = Builder::new(5);
        let at = |name: &str| Photograph { name: name.into(), position: DVec3::X };
        builder.add(at("a"), &seen(&[(1, 1.0), (3, 2.0)])).unwrap();
        builder.add(at("b"), &seen(&[])).unwrap();
        builder.add(at("c"), &seen(&[(1, 0.5), (2, 1e-6), (4, 8.0)])).unwrap();
        builder.finish().unwrap()
    }

    #[test]
    fn rows_know_who_shows_them_and_a_file_brings_the_table_back() {
        let (table, known) = (some(), weights());
        let of = |row| {
            let (of, codes) = table.of_row(row);
            of.iter().zip(codes).map(|(of, code)| (*of, known[usize::from(*code)])).collect::<Vec<_>>()
        };
        assert_eq!(
            [of(0), of(1), of(2), of(3), of(4)],
            [vec![], vec![(0, 1.0), (2, 0.5)], vec![], vec![(0, 2.0)], vec![(2, 8.0)],]
        );
        assert_eq!(table.entries(), [2, 0, 2]);
        let of_photographs = [0, 1, 2].map(|number| table.of_photograph(number));
        assert_eq!(of_photographs, [vec![(1, 1.0), (3, 2.0)], vec![], vec![(1, 0.5), (4, 8.0)]]);
        let bytes = table.to_bytes().unwrap();
        assert_eq!(ShareTable::read_from(&mut std::io::Cursor::new(&bytes)).unwrap(), table);
        for end in 0..bytes.len() {
            assert!(ShareTable::read_from(&mut std::io::Cursor::new(&bytes[..end])).is_err(), "cut at {end}");
        }
    }

    #[test]
    fn a_table_whose_parts_do_not_fit_is_refused() {
        let refused = |change: fn(&mut ShareTable)| {
            let mut table = some();
            change(&mut table);
            let read = ShareTable::read_from(&mut std::io::Cursor::new(table.to_bytes().unwrap()));
            read.expect_err("refused").to_string()
        };
        assert!(refused(|t| t.of[3] = 3).contains("name photographs that it has not"));
        assert!(refused(|t| t.of[1] = 0).contains("or twice"));
        assert!(refused(|t| t.starts[2] = 9).contains("do not fit together"));
        assert!(refused(|t| t.starts[5] = 3).contains("do not fit together"));
        assert!(refused(|t| t.photographs[0].position.x = f64::INFINITY).contains("header"), "JSON has no infinity");
    }
}
