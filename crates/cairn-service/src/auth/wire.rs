//! Reading and writing the few binary fields that are signed. A reader never
//! takes more than there is, and says which field was short.

pub(crate) const VERSION: u8 = 1;
/// How far clocks may be apart, seconds.
pub const SKEW_S: u64 = 30;
pub(crate) const MAX_METHOD: usize = 128;
pub(crate) const MAX_SCENE: usize = 64;
pub(crate) const MAX_ORIGIN: usize = 256;
/// Everything at its longest, and the signature.
pub(crate) const MAX_BYTES: usize =
    1 + 32 + (2 + MAX_METHOD) + (2 + MAX_SCENE) + (2 + MAX_ORIGIN) + 32 + 16 + 8 + 8 + 16 + 64;
/// The same in base64.
pub(crate) const MAX_TEXT: usize = MAX_BYTES.div_ceil(3) * 4;

/// Reads fields one after the other.
pub(crate) struct Reader<'a> {
    /// What was not read yet.
    pub(crate) rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// The next `count` bytes; the field's name where there are fewer.
    pub(crate) fn take(&mut self, what: &'static str, count: usize) -> Result<&'a [u8], &'static str> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(what)?;
        self.rest = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], &'static str> {
        self.take(what, N)?.try_into().map_err(|_| what)
    }

    pub(crate) fn u64(&mut self, what: &'static str) -> Result<u64, &'static str> {
        self.array(what).map(u64::from_be_bytes)
    }

    /// UTF-8 text after its length in bytes, u16 big-endian, at most `longest`.
    pub(crate) fn text(&mut self, what: &'static str, longest: usize) -> Result<&'a str, &'static str> {
        let length = usize::from(u16::from_be_bytes(self.array(what)?));
        if length > longest {
            return Err(what);
        }
        std::str::from_utf8(self.take(what, length)?).map_err(|_| what)
    }
}

/// Appends text after its length, u16 big-endian; the field's name where it is longer than `longest`.
pub(crate) fn put_text(out: &mut Vec<u8>, what: &'static str, text: &str, longest: usize) -> Result<(), &'static str> {
    let length = u16::try_from(text.len()).ok().filter(|l| usize::from(*l) <= longest).ok_or(what)?;
    out.extend_from_slice(&length.to_be_bytes());
    out.extend_from_slice(text.as_bytes());
    Ok(())
}
