//! A screening interrupted and taken up again: a line of JSON that says how far it is, and after it the
//! checkpoint of the scout at hand. A resumed screening comes to the same verdict.

use super::Screening;
use super::fit::ViewFit;
use crate::config::FieldConfig;
use crate::error::FieldError;
use crate::io::tensors::stored;
use crate::rays::frame::SceneFrame;
use crate::train::trainer::BaseTrainer;
use crate::train::views::NamedView;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;

/// Format of a screening's checkpoint; another number is refused by name.
const FORMAT: &str = "cairn.screening.checkpoint/8";
/// Longest first line that is read, bytes: 10,000 views take about two million.
const MAX_HEADER_BYTES: usize = 64 << 20;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format: String,
    field: FieldConfig,
    frame: SceneFrame,
    background: Option<[f32; 3]>,
    seed: u64,
    views: Vec<String>,
    trusted: BTreeSet<String>,
    phase: usize,
    before: u64,
    suspects: Vec<usize>,
    fits: Vec<Option<ViewFit>>,
    /// SHA-256 of this line with an empty digest, and of what follows it.
    digest: String,
}

#[derive(Deserialize)]
struct Format {
    format: String,
}

fn refuse<T>(why: impl Into<String>) -> Result<T, FieldError> {
    Err(stored("screening", format!("{}; start the training anew", why.into())))
}

fn line_of(header: &Header) -> Result<String, FieldError> {
    serde_json::to_string(header).map_err(|e| stored("screening", e.to_string()))
}

fn digest(line: &str, rest: &[u8]) -> String {
    let mut hash = Sha256::new();
    hash.update((line.len() as u64).to_le_bytes());
    hash.update(line);
    hash.update(rest);
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

impl Screening {
    /// The whole state. Equal states give equal bytes.
    ///
    /// # Errors
    /// [`FieldError::Stored`] when it cannot be written out.
    pub fn checkpoint(&self) -> Result<Vec<u8>, FieldError> {
        let scout = self.scout.as_ref().map(BaseTrainer::checkpoint).transpose()?.unwrap_or_default();
        let mut header = Header {
            format: FORMAT.into(),
            field: self.field.clone(),
            frame: self.frame.clone(),
            background: self.background,
            seed: self.seed,
            views: self.views.iter().map(|v| v.name.clone()).collect(),
            trusted: self.trusted.iter().map(|v| self.views[*v].name.clone()).collect(),
            phase: self.phase,
            before: self.before,
            suspects: self.suspects.clone(),
            fits: self.fits.clone(),
            digest: String::new(),
        };
        header.digest = digest(&line_of(&header)?, &scout);
        let mut bytes = line_of(&header)?.into_bytes();
        bytes.push(b'\n');
        bytes.extend(scout);
        Ok(bytes)
    }

    /// Takes screening up where `bytes` left it. The views must be those that it began with.
    ///
    /// # Errors
    /// [`FieldError::Stored`] for an unknown format or a damaged file;
    /// [`FieldError::Views`] for other views.
    pub fn resume(bytes: &[u8], views: Vec<NamedView>) -> Result<Self, FieldError> {
        let end = bytes.iter().take(MAX_HEADER_BYTES).position(|b| *b == b'\n');
        let Some(end) = end else { return refuse("it has no first line") };
        let (line, rest) = (&bytes[..end], &bytes[end + 1..]);
        let wrong = |e: serde_json::Error| stored("screening", format!("its first line: {e}; start the training anew"));
        let Format { format } = serde_json::from_slice(line).map_err(wrong)?;
        if format != FORMAT {
            return refuse(format!("format `{format}`, this program reads `{FORMAT}`"));
        }
        let mut header: Header = serde_json::from_slice(line).map_err(wrong)?;
        let stated = std::mem::take(&mut header.digest);
        if digest(&line_of(&header)?, rest) != stated {
            return refuse("its SHA-256 is another than it says: the file was damaged");
        }
        if !views.iter().map(|v| &v.name).eq(&header.views) {
            let why = "they are not the views this screening began with; start the training anew";
            return Err(FieldError::Views(why.into()));
        }
        let Header { frame, background, .. } = header;
        let mut made = Self::new(views, &header.trusted, frame, background, &header.field, header.seed)?;
        let count = made.views.len();
        let fold = made.folds.len();
        if header.fits.len() != count || header.suspects.iter().any(|v| *v >= count) || header.phase > fold + 1 {
            return refuse("its fits, suspects and phase do not fit together");
        }
        (made.phase, made.before, made.suspects, made.fits) =
            (header.phase, header.before, header.suspects, header.fits);
        made.scout = match rest {
            [] => None,
            rest => Some(BaseTrainer::resume_with(rest, made.shown())?),
        };
        if made.scout.is_some() != (made.phase < fold || (made.phase == fold && !made.suspects.is_empty())) {
            return refuse("its phase and its scout do not fit together");
        }
        Ok(made)
    }
}
