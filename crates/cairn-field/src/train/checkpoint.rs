//! Stage 1 interrupted and taken up again: everything the next step depends on,
//! in one versioned safetensors file, so that a resumed run ends in the same
//! bytes as one that was never stopped.

use super::light::LightVerdict;
use super::mean::{Mean, codes_of};
use super::optimise::{Adam, RowState};
use super::trainer::BaseTrainer;
use super::views::{NamedView, Prepared, prepare};
use crate::appearance::code::Appearance;
use crate::config::FieldConfig;
use crate::error::FieldError;
use crate::grid::lattice::{Grid, ROW, fits};
use crate::io::tensors::{Part, numbers_of, packed, read_header, stored};
use crate::rays::frame::SceneFrame;
use safetensors::tensor::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::sync::Arc;

/// Format of a stage-1 checkpoint; another number is refused by name.
const CHECKPOINT_FORMAT: &str = "cairn.field.checkpoint/10";

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    config: FieldConfig,
    frame: SceneFrame,
    seed: u64,
    step: u64,
    drawn: u64,
    level: usize,
    dims: [usize; 3],
    adam_steps: u64,
    appearance_steps: u64,
    neutral: Appearance,
    background: Option<[f32; 3]>,
    views: Vec<String>,
    appearances: usize,
    light: LightVerdict,
    /// States averaged so far.
    averaged: u64,
    /// SHA-256 of the rest of the file; see [`digest`].
    digest: String,
}

impl BaseTrainer {
    /// The whole state. Equal states give equal bytes.
    ///
    /// # Errors
    /// [`FieldError::Stored`] when it cannot be written out, [`FieldError::NotFinite`] where a number of it
    /// is not finite, so that it could not be resumed.
    pub fn checkpoint(&self) -> Result<Vec<u8>, FieldError> {
        let mut header = Header {
            format: CHECKPOINT_FORMAT.into(),
            config: self.config.clone(),
            frame: self.frame.clone(),
            seed: self.seed,
            step: self.step,
            drawn: self.drawn,
            level: self.level,
            dims: self.grid.dims,
            adam_steps: self.rows.adam.steps,
            appearance_steps: self.appearance_adam.steps,
            neutral: self.neutral.clone(),
            background: self.background,
            views: self.views.iter().map(|v| v.name.clone()).collect(),
            appearances: self.appearances.len(),
            light: self.light,
            averaged: self.mean.states,
            digest: String::new(),
        };
        let codes = codes_of(&self.appearances);
        let vertex: Vec<u8> = self.grid.vertex[1..].iter().flat_map(|v| v.to_le_bytes()).collect();
        let occupancy: Vec<u8> = self.grid.occupancy.words().iter().flat_map(|v| v.to_le_bytes()).collect();
        let raw: Vec<f32> = self.grid.raw_rows().collect();
        let float: [(&str, &[f32]); 12] = [
            ("raw", &raw),
            ("colour", &self.grid.colour),
            ("first", &self.rows.adam.first),
            ("second", &self.rows.adam.second),
            ("square", &self.rows.square),
            ("seen", &self.rows.seen),
            ("codes", &codes),
            ("codes_first", &self.appearance_adam.first),
            ("codes_second", &self.appearance_adam.second),
            ("mean_raw", &self.mean.raw),
            ("mean_colour", &self.mean.colour),
            ("mean_codes", &self.mean.codes),
        ];
        // A number that the next step would refuse must not take the place of a state that can be resumed.
        if let Some((name, _)) = float.iter().find(|(_, values)| values.iter().any(|v| !v.is_finite())) {
            return Err(FieldError::NotFinite { step: self.step, place: format!("`{name}`") });
        }
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let mut tensors: Vec<(&str, Dtype, Vec<u8>)> =
            float.iter().map(|(name, values)| (*name, Dtype::F32, bytes(values))).collect();
        tensors.push(("vertex", Dtype::U32, vertex));
        tensors.push(("occupancy", Dtype::U64, occupancy));
        let json = serde_json::to_string(&header).map_err(|e| stored("checkpoint", e.to_string()))?;
        header.digest = digest(&json, tensors.iter().map(|(name, _, data)| (*name, data.as_slice())).collect());
        packed("checkpoint", &header, tensors.iter().map(|(name, dtype, data)| Part::row(name, *dtype, data)))
    }

    /// Takes training up where `bytes` left it. The views must be those the
    /// checkpoint was made with (their names are compared).
    ///
    /// # Errors
    /// [`FieldError::Stored`] for an unknown format or a damaged file;
    /// [`FieldError::Views`] for other views.
    pub fn resume(bytes: &[u8], views: Vec<NamedView>) -> Result<Self, FieldError> {
        let header: Header = read_header(bytes, "checkpoint", CHECKPOINT_FORMAT)?;
        header.config.validate()?;
        Self::resume_with(bytes, prepare(views)?)
    }

    /// As [`BaseTrainer::resume`], with views that were prepared.
    pub(crate) fn resume_with(bytes: &[u8], views: Vec<Arc<Prepared>>) -> Result<Self, FieldError> {
        let refuse = |why: String| Err(stored("checkpoint", why));
        let header: Header = read_header(bytes, "checkpoint", CHECKPOINT_FORMAT)?;
        if !views.iter().map(|v| &v.name).eq(&header.views) {
            return Err(FieldError::Views(
                "they are not the views this checkpoint was made with; start the training anew".into(),
            ));
        }
        let file = SafeTensors::deserialize(bytes).map_err(|e| stored("checkpoint", e.to_string()))?;
        // No training gets there, and the next step would count on from it.
        let counted = header.adam_steps.max(header.appearance_steps).max(header.step);
        if counted > header.config.steps || header.drawn > u64::MAX / 2 {
            return refuse("it counts more steps than its training has".into());
        }
        let sound = is_sound(bytes, &file, &header.digest);
        header.config.validate()?;
        let mut trainer = Self::of(views, header.frame, header.background, header.config, header.seed);
        let vertex = numbers_of(&file, "vertex", Dtype::U32, u32::from_le_bytes)?;
        if !fits(header.dims, &vertex) || header.level >= trainer.config.levels {
            return refuse("its grid and its vertices or level do not fit together".into());
        }
        // What is settled is never looked into, and the other way round.
        if (header.light == LightVerdict::Settled) != (trainer.light == LightVerdict::Settled) {
            return refuse(format!("what it says of the light ({:?}) is not what its settings allow", header.light));
        }
        let one_light = matches!(header.light, LightVerdict::OneLight { .. });
        let expected = if one_light { 0 } else { trainer.appearances.len() };
        if header.appearances != expected {
            return refuse(format!("{} appearances for {} views", header.appearances, trainer.views.len()));
        }
        let mut grid = Grid::with_vertices(header.dims, vertex);
        let rows = grid.rows();
        let read = |name: &'static str, len: usize| -> Result<Vec<f32>, FieldError> {
            let values = numbers_of(&file, name, Dtype::F32, f32::from_le_bytes)?;
            if values.len() != len {
                return Err(stored("checkpoint", format!("`{name}` has {} numbers, expected {len}", values.len())));
            }
            if let Some(at) = values.iter().position(|v| !v.is_finite()) {
                return Err(stored("checkpoint", format!("number {at} of `{name}` is not finite")));
            }
            Ok(values)
        };
        grid.set_raw_rows(&read("raw", rows - 1)?);
        grid.colour = read("colour", rows * ROW)?;
        if !grid.occupancy.restore(numbers_of(&file, "occupancy", Dtype::U64, u64::from_le_bytes)?) {
            return refuse("its occupancy does not fit its grid".into());
        }
        let adam = Adam { first: read("first", rows)?, second: read("second", rows)?, steps: header.adam_steps };
        trainer.rows = RowState::from_parts(adam, read("square", rows)?, read("seen", rows)?);
        trainer.grid = grid;
        let n = header.neutral.code().len();
        let codes = read("codes", header.appearances * n)?;
        trainer.appearances = codes
            .chunks_exact(n)
            .map(|c| Appearance::from_code(c.to_vec()))
            .collect::<Option<_>>()
            .ok_or_else(|| stored("checkpoint", "an appearance is not finite".into()))?;
        trainer.appearance_adam = Adam {
            first: read("codes_first", header.appearances * n)?,
            second: read("codes_second", header.appearances * n)?,
            steps: header.appearance_steps,
        };
        // Without states their mean has no numbers.
        let some = usize::from(header.averaged > 0);
        trainer.mean = Mean {
            states: header.averaged,
            raw: read("mean_raw", some * (rows - 1))?,
            colour: read("mean_colour", some * rows * ROW)?,
            codes: read("mean_codes", some * header.appearances * n)?,
        };
        trainer.neutral = header.neutral;
        trainer.light = header.light;
        trainer.step = header.step;
        trainer.level = header.level;
        trainer.lay_tiles();
        trainer.drawn = header.drawn;
        if header.averaged > header.step.saturating_sub(trainer.averaged_from()) {
            return refuse("it has a mean of more states than its training can have averaged".into());
        }
        // Last: what is wrong is better said by name.
        if !sound {
            return refuse("its SHA-256 is another than it says: the file was damaged; start the training anew".into());
        }
        Ok(trainer)
    }
}

/// Whether a checkpoint's SHA-256 is `stated`.
fn is_sound(bytes: &[u8], file: &SafeTensors<'_>, stated: &str) -> bool {
    let metadata = SafeTensors::read_metadata(bytes).ok().and_then(|(_, m)| m.metadata().clone()).unwrap_or_default();
    let json = metadata.get("cairn").map_or("", String::as_str);
    let unsigned = json.replacen(&format!("\"digest\":\"{stated}\""), "\"digest\":\"\"", 1);
    digest(&unsigned, file.iter().map(|(name, tensor)| (name, tensor.data())).collect()) == stated
}

/// SHA-256 over the header (with an empty digest) and every tensor in order of name,
/// each with its name's and its own length, 64 bits little-endian.
fn digest(header: &str, mut tensors: Vec<(&str, &[u8])>) -> String {
    tensors.sort_unstable();
    let mut hash = Sha256::new();
    for (name, data) in [("", header.as_bytes())].into_iter().chain(tensors) {
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(name);
        hash.update((data.len() as u64).to_le_bytes());
        hash.update(data);
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}
