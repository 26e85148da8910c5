//! What a request says of its training. Precedence: the request, then the daemon's file, then the preset.

use cairn_field::AppearanceMode;
use cairn_scene::SceneKind;
use serde::Serialize;

use super::error::ConfigError;
use super::preset;
use super::read;
use super::settings::Training;
use super::training::{Chosen, PresetChoice, Quality, TrainingSettings};

/// What a request sets of `[training]`; `None` leaves it to the daemon's file. Ranges are the file's.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TrainingOptions {
    /// The preset.
    pub preset: Option<PresetChoice>,
    /// How long it takes.
    pub quality: Option<Quality>,
    /// Whether marks outlast what happens to pictures.
    pub robust: Option<bool>,
    /// The most vertices of the field's grid; 0 for the preset's.
    pub max_voxels: Option<usize>,
    /// Whether views get appearances of their own.
    pub appearance: Option<AppearanceMode>,
    /// Side of hidden pictures, px; 0 for the preset's.
    pub payload_picture_px: Option<usize>,
    /// Longest hidden sound, seconds; 0 for the preset's.
    pub payload_sound_s: Option<f64>,
    /// Samples a second of hidden sounds; 0 for the preset's.
    pub payload_sound_hz: Option<u32>,
    /// Longest hidden text, bytes of UTF-8; 0 for the preset's.
    pub payload_text_bytes: Option<usize>,
}

impl TrainingOptions {
    /// The settings of a training on a scene of `kind`: these options, else `file`'s, else the preset's.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`] for a value that is not allowed.
    pub fn settings(&self, file: &Training, kind: SceneKind) -> Result<TrainingSettings, ConfigError> {
        let of = |cause: String| ConfigError::Toml { place: "the options".into(), cause };
        let written = toml::Table::try_from(file).and_then(|file| Ok((file, toml::Table::try_from(self)?)));
        let (mut table, own) = written.map_err(|e| of(e.to_string()))?;
        table.extend(own);
        read::check("training", &table)?;
        let asked: Training = table.try_into().map_err(|e: toml::de::Error| of(e.to_string()))?;
        let (quality, robust) = (asked.quality, asked.robust);
        let mut settings = preset::settings(Chosen { preset: asked.preset.of(kind), quality, robust });
        let TrainingSettings { field, mark, .. } = &mut settings;
        field.appearance = asked.appearance;
        if asked.max_voxels > 0 {
            field.voxels = field.voxels.min(asked.max_voxels);
            field.max_voxels = field.max_voxels.min(asked.max_voxels);
        }
        if asked.payload_picture_px > 0 {
            mark.detector.size = [asked.payload_picture_px; 2];
        }
        if asked.payload_sound_s > 0.0 {
            mark.audio.longest_s = asked.payload_sound_s;
        }
        if asked.payload_sound_hz > 0 {
            mark.audio.sample_rate_hz = asked.payload_sound_hz;
        }
        if asked.payload_text_bytes > 0 {
            mark.text.longest_bytes = asked.payload_text_bytes;
        }
        settings.check()?;
        Ok(settings)
    }
}
