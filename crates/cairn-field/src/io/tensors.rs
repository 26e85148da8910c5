//! A safetensors file read tensor by tensor: held in memory whole beside the field that is made of it, a field's file
//! was a quarter of the most that serving took.

use crate::error::FieldError;
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorView};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

/// The one key of our metadata.
const HEADER: &str = "cairn";
/// Bytes of a header's length, with which a file starts.
const LENGTH: u64 = 8;
/// Largest header that is read, bytes: safetensors' own limit.
const LARGEST_HEADER: u64 = 100_000_000;
/// About what is read at once, bytes.
const PIECE: usize = 1 << 18;

/// A safetensors file with a Cairn header; see the module's text.
pub struct TensorFile<'r, R> {
    reader: &'r mut R,
    /// What errors call it.
    what: &'static str,
    /// Where its tensors begin in the reader.
    data: u64,
    metadata: Metadata,
}

impl<'r, R: Read + Seek> TensorFile<'r, R> {
    /// The file that `reader` holds from its first byte to its last; errors call it `what`. Tensors stay unread.
    ///
    /// # Errors
    /// [`FieldError::Stored`] for a damaged file, [`FieldError::Read`] for one that cannot be read.
    pub fn open(reader: &'r mut R, what: &'static str) -> Result<Self, FieldError> {
        let end = reader.seek(SeekFrom::End(0)).map_err(|e| unread(what, e))?;
        Self::open_at(reader, 0..end, what)
    }

    /// The file that is stored as tensor `name`, bytes, of this one.
    ///
    /// # Errors
    /// As [`TensorFile::open`].
    pub fn within(&mut self, name: &str, what: &'static str) -> Result<TensorFile<'_, R>, FieldError> {
        let place = self.place(name, Dtype::U8)?;
        TensorFile::open_at(self.reader, place, what)
    }

    fn open_at(reader: &'r mut R, place: Range<u64>, what: &'static str) -> Result<Self, FieldError> {
        let failed = |e| unread(what, e);
        let Some(room) = (place.end - place.start).checked_sub(LENGTH) else {
            return Err(stored(what, "it ends before its header begins".into()));
        };
        reader.seek(SeekFrom::Start(place.start)).map_err(failed)?;
        let mut length = [0; LENGTH as usize];
        reader.read_exact(&mut length).map_err(failed)?;
        let length = u64::from_le_bytes(length);
        let max = room.min(LARGEST_HEADER);
        if length > max {
            return Err(stored(what, format!("its header would be of {length} bytes, and can be of {max} at most")));
        }
        let mut json = vec![0; length as usize];
        reader.read_exact(&mut json).map_err(failed)?;
        // Checked as it is read: tensors follow one another without gaps, each as long as its shape says.
        let metadata: Metadata =
            serde_json::from_slice(&json).map_err(|e| stored(what, format!("its tensors' places: {e}")))?;
        let (expected, got) = (metadata.data_len() as u64, room - length);
        if expected != got {
            return Err(stored(what, format!("its tensors are {got} bytes, {expected} by its header")));
        }
        Ok(Self { reader, what, data: place.start + LENGTH + length, metadata })
    }

    /// Our JSON header, of a file of `format`.
    ///
    /// # Errors
    /// [`FieldError::Stored`] where there is none, or another one; another format is refused by name.
    pub fn header<H: DeserializeOwned>(&self, format: &str) -> Result<H, FieldError> {
        header_of(&self.metadata, self.what, format)
    }

    /// Bytes of tensor `name`, whose numbers are to be of `dtype`.
    ///
    /// # Errors
    /// [`FieldError::Stored`] where there is none, or its numbers are others.
    pub fn size(&self, name: &str, dtype: Dtype) -> Result<u64, FieldError> {
        self.place(name, dtype).map(|place| place.end - place.start)
    }

    /// Where tensor `name` lies in the reader.
    fn place(&self, name: &str, dtype: Dtype) -> Result<Range<u64>, FieldError> {
        let info = self.metadata.info(name).ok_or_else(|| stored(self.what, format!("it has no tensor `{name}`")))?;
        if info.dtype != dtype {
            return Err(stored(self.what, format!("`{name}` is of {:?}, expected {dtype:?}", info.dtype)));
        }
        let (from, to) = info.data_offsets;
        Ok(self.data + from as u64..self.data + to as u64)
    }

    /// The bytes of tensor `name`, to be read in order.
    ///
    /// # Errors
    /// As [`TensorFile::size`], and where the reader fails.
    pub fn bytes(&mut self, name: &str, dtype: Dtype) -> Result<impl Read + use<'_, R>, FieldError> {
        let place = self.place(name, dtype)?;
        self.reader.seek(SeekFrom::Start(place.start)).map_err(|e| unread(self.what, e))?;
        Ok(self.reader.by_ref().take(place.end - place.start))
    }

    /// Shows `visit` the bytes of tensor `name` in order, in pieces of whole `unit`s but for what is left at the end.
    ///
    /// # Errors
    /// As [`TensorFile::bytes`].
    ///
    /// # Panics
    /// When a unit is of no bytes.
    pub fn each_piece(
        &mut self,
        name: &str,
        dtype: Dtype,
        unit: usize,
        mut visit: impl FnMut(&[u8]),
    ) -> Result<(), FieldError> {
        let (mut left, what) = (self.size(name, dtype)?, self.what);
        let mut bytes = self.bytes(name, dtype)?;
        let mut piece = vec![0; (PIECE / unit).max(1) * unit];
        while left > 0 {
            let count = left.min(piece.len() as u64) as usize;
            bytes.read_exact(&mut piece[..count]).map_err(|e| unread(what, e))?;
            visit(&piece[..count]);
            left -= count as u64;
        }
        Ok(())
    }

    /// The numbers of tensor `name`, whatever its shape, each of `of` its `N` bytes.
    ///
    /// # Errors
    /// As [`TensorFile::bytes`].
    ///
    /// # Panics
    /// When numbers of `dtype` are not of `N` bytes.
    pub fn numbers<T, const N: usize>(
        &mut self,
        name: &str,
        dtype: Dtype,
        of: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>, FieldError> {
        assert_eq!(dtype.bitsize(), 8 * N, "bits of a number");
        let mut numbers = Vec::with_capacity(self.size(name, dtype)? as usize / N);
        self.each_piece(name, dtype, N, |piece| {
            numbers.extend(piece.chunks_exact(N).map(|bytes| of(bytes.try_into().expect("N bytes"))));
        })?;
        Ok(numbers)
    }
}

/// What a reader's failure says of the file: that it ends too early, or nothing.
fn unread(what: &'static str, source: io::Error) -> FieldError {
    match source.kind() {
        io::ErrorKind::UnexpectedEof => stored(what, "it was cut short while it was read".into()),
        _ => FieldError::Read { what, source },
    }
}

/// A [`FieldError::Stored`].
pub(crate) fn stored(what: &'static str, why: String) -> FieldError {
    FieldError::Stored { what, why }
}

/// A tensor of a file to be: its name, the kind of its numbers, its shape, and its numbers little-endian.
pub struct Part<'a> {
    name: &'a str,
    dtype: Dtype,
    shape: Vec<usize>,
    data: &'a [u8],
}

impl<'a> Part<'a> {
    /// Numbers of `dtype` in an array of `shape`.
    pub fn new(name: &'a str, dtype: Dtype, shape: Vec<usize>, data: &'a [u8]) -> Self {
        Self { name, dtype, shape, data }
    }

    /// A row of numbers of `dtype`.
    pub fn row(name: &'a str, dtype: Dtype, data: &'a [u8]) -> Self {
        Self::new(name, dtype, vec![data.len() * 8 / dtype.bitsize()], data)
    }
}

/// A safetensors file of `parts` and our JSON `header`. Equal parts give equal bytes.
///
/// # Errors
/// [`FieldError::Stored`] where a shape is not that of its numbers, or the header is no JSON.
pub fn packed<'a>(
    what: &'static str,
    header: &impl Serialize,
    parts: impl IntoIterator<Item = Part<'a>>,
) -> Result<Vec<u8>, FieldError> {
    let bad = |e: SafeTensorError| stored(what, e.to_string());
    let view = |p: Part<'a>| Ok((p.name, TensorView::new(p.dtype, p.shape, p.data)?));
    let tensors = parts.into_iter().map(view).collect::<Result<Vec<_>, _>>().map_err(bad)?;
    let json = serde_json::to_string(header).map_err(|e| stored(what, e.to_string()))?;
    // One metadata entry only: a map of several would be written in random order.
    safetensors::serialize(tensors, Some(HashMap::from([(HEADER.to_owned(), json)]))).map_err(bad)
}

/// Our JSON header of a whole file of `format`.
///
/// # Errors
/// As [`TensorFile::header`].
pub fn read_header<H: DeserializeOwned>(bytes: &[u8], what: &'static str, format: &str) -> Result<H, FieldError> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|e| stored(what, e.to_string()))?;
    header_of(&metadata, what, format)
}

/// The one key that every format's header has.
#[derive(Deserialize)]
struct Format {
    format: String,
}

/// The format is asked before the rest is read, whose settings have other names in a later program's.
fn header_of<H: DeserializeOwned>(metadata: &Metadata, what: &'static str, format: &str) -> Result<H, FieldError> {
    let json = metadata.metadata().as_ref().and_then(|m| m.get(HEADER));
    let json = json.ok_or_else(|| stored(what, "it has no Cairn header".into()))?;
    let wrong = |e: serde_json::Error| stored(what, format!("its header: {e}"));
    let Format { format: got } = serde_json::from_str(json).map_err(wrong)?;
    if got != format {
        return Err(stored(what, format!("format `{got}`, this program reads `{format}`")));
    }
    serde_json::from_str(json).map_err(wrong)
}

/// The numbers of a file's tensor, whatever its shape, each of `of` its `N` bytes.
pub(crate) fn numbers_of<T, const N: usize>(
    file: &SafeTensors<'_>,
    name: &'static str,
    dtype: Dtype,
    of: impl Fn([u8; N]) -> T,
) -> Result<Vec<T>, FieldError> {
    let tensor = file.tensor(name).map_err(|e| stored(name, e.to_string()))?;
    if tensor.dtype() != dtype {
        return Err(stored(name, format!("expected {dtype:?}, got {:?}", tensor.dtype())));
    }
    Ok(tensor.data().chunks_exact(N).map(|bytes| of(bytes.try_into().expect("N bytes"))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    /// A file with `numbers`, another file within, and a header that says 7.
    fn file(numbers: &[u32], within: &[u8]) -> Vec<u8> {
        let bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
        let parts = [Part::row("numbers", Dtype::U32, &bytes), Part::row("within", Dtype::U8, within)];
        packed("file", &serde_json::json!({ "format": "numbers/1", "seven": 7 }), parts).unwrap()
    }

    fn numbers(file: &mut TensorFile<'_, impl Read + Seek>) -> Vec<u32> {
        file.numbers("numbers", Dtype::U32, u32::from_le_bytes).unwrap()
    }

    #[test]
    fn tensors_are_read_in_any_order_and_within_another() {
        // Pieces and a half.
        let many: Vec<u32> = (0..PIECE as u32 * 5 / 8).map(|i| i.wrapping_mul(0x9E37_79B9)).collect();
        let bytes = file(&many, &file(&[1, 2, 3], &[9; 5]));
        let mut reader = Cursor::new(&bytes);
        let mut outer = TensorFile::open(&mut reader, "outer").unwrap();
        assert_eq!(outer.header::<serde_json::Value>("numbers/1").unwrap()["seven"], 7);
        for _ in 0..2 {
            let mut inner = outer.within("within", "inner").unwrap();
            assert_eq!(numbers(&mut inner), [1, 2, 3]);
            let mut rest = Vec::new();
            inner.bytes("within", Dtype::U8).unwrap().read_to_end(&mut rest).unwrap();
            assert_eq!(rest, [9; 5]);
            assert!(numbers(&mut outer) == many);
        }
        // Units of three numbers: every piece is whole ones.
        let (mut sizes, mut sum) = (Vec::new(), 0);
        outer
            .each_piece("numbers", Dtype::U32, 12, |piece| {
                sizes.push(piece.len());
                sum += piece.len();
            })
            .unwrap();
        let (last, others) = sizes.split_last().unwrap();
        assert!(others.len() == 2 && others.iter().all(|size| size % 12 == 0 && size >= last), "{sizes:?}");
        assert_eq!(sum, 4 * many.len());
    }

    #[test]
    fn what_is_not_there_or_damaged_is_told() {
        let bytes = file(&[1, 2, 3], &[9; 5]);
        let open = |bytes: &[u8]| TensorFile::open(&mut Cursor::new(bytes), "thing").err().map(|e| e.to_string());
        assert_eq!(open(&bytes), None);
        for cut in 0..bytes.len() {
            let text = open(&bytes[..cut]).expect("an error");
            assert!(text.starts_with("thing: "), "cut at {cut}: {text}");
        }
        assert!(open(&[&bytes[..], &[0]].concat()).is_some_and(|text| text.contains("18 bytes, 17 by its header")));
        let long = [&u64::MAX.to_le_bytes()[..], &bytes[8..]].concat();
        assert!(open(&long).is_some_and(|text| text.contains(&u64::MAX.to_string())));
        let long = [&(LARGEST_HEADER + 1).to_le_bytes()[..], &vec![b' '; LARGEST_HEADER as usize + 9]].concat();
        assert!(open(&long).is_some_and(|text| text.contains("100000001") && text.contains("100000000 at most")));
        let mut reader = Cursor::new(&bytes);
        let mut file = TensorFile::open(&mut reader, "thing").unwrap();
        for (name, dtype, told) in [("letters", Dtype::U8, "no tensor `letters`"), ("numbers", Dtype::F32, "U32")] {
            assert!(file.size(name, dtype).unwrap_err().to_string().contains(told));
        }
        assert!(file.header::<String>("numbers/1").unwrap_err().to_string().contains("its header"));
        let other = file.header::<String>("numbers/2").unwrap_err().to_string();
        assert!(other.contains("format `numbers/1`, this program reads `numbers/2`"), "{other}");
        assert!(file.within("within", "inner").err().unwrap().to_string().starts_with("inner: "));
    }

    /// Gives a byte at a time, and fails or ends at one.
    struct Faulty<'b> {
        file: Cursor<&'b [u8]>,
        at: u64,
        fault: Option<io::ErrorKind>,
    }

    impl Read for Faulty<'_> {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            match (self.file.position() < self.at, self.fault) {
                (true, _) => self.file.by_ref().take(1).read(into),
                (false, None) => Ok(0),
                (false, Some(kind)) => Err(kind.into()),
            }
        }
    }

    impl Seek for Faulty<'_> {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.file.seek(to)
        }
    }

    #[test]
    fn a_disk_that_fails_is_no_damaged_file() {
        let bytes = file(&[1, 2, 3], &[9; 5]);
        let end = bytes.len() as u64;
        let read = |at, fault| {
            let mut reader = Faulty { file: Cursor::new(&bytes), at, fault };
            let mut file = TensorFile::open(&mut reader, "thing")?;
            file.numbers("numbers", Dtype::U32, u32::from_le_bytes)
        };
        assert_eq!(read(end, None).unwrap(), [1, 2, 3]);
        for at in [0, 3, 20, end - 8] {
            let failed = read(at, Some(io::ErrorKind::StaleNetworkFileHandle)).unwrap_err();
            assert!(matches!(failed, FieldError::Read { what: "thing", .. }), "{failed}");
            assert!(matches!(read(at, None), Err(FieldError::Stored { what: "thing", .. })), "cut at {at}");
        }
    }
}
