//! What a request says of its training. Precedence: the request, then the daemon's file, then the preset.

use cairn_field::AppearanceMode;
use cairn_scene::SceneKind;

use super::error::ConfigError;
use super::preset;
use super::read;
use super::settings::Training;
use super::training::{Chosen, PresetChoice, Quality, TrainingSettings};

/// What a request sets of `[training]`; `None` leaves it to the daemon's file. Ranges are the file's.
#[derive(Clone, Debug, Default, PartialEq)]
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
        let asked = Training {
            preset: self.preset.unwrap_or(file.preset),
            quality: self.quality.unwrap_or(file.quality),
            robust: self.robust.unwrap_or(file.robust),
            checkpoint_every_s: file.checkpoint_every_s,
            max_voxels: self.max_voxels.unwrap_or(file.max_voxels),
            appearance: self.appearance.unwrap_or(file.appearance),
            payload_picture_px: self.payload_picture_px.unwrap_or(file.payload_picture_px),
            payload_sound_s: self.payload_sound_s.unwrap_or(file.payload_sound_s),
            payload_sound_hz: self.payload_sound_hz.unwrap_or(file.payload_sound_hz),
            payload_text_bytes: self.payload_text_bytes.unwrap_or(file.payload_text_bytes),
        };
        let unwritten = |e: toml::ser::Error| ConfigError::Toml { place: "the options".into(), cause: e.to_string() };
        read::check("training", &toml::Table::try_from(&asked).map_err(unwritten)?)?;
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
