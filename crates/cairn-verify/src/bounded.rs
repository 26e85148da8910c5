//! Reading files without believing their size.

use std::{
    fs::File,
    io::{self, Read as _},
    path::Path,
};

/// A file of at most `limit` bytes; none where there is no such file.
pub(crate) fn read(path: &Path, limit: usize) -> Result<Option<Vec<u8>>, String> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
    };
    let mut bytes = Vec::new();
    file.take(limit as u64 + 1).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    if bytes.len() > limit { Err(format!("more than {limit} bytes")) } else { Ok(Some(bytes)) }
}
