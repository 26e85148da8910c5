//! What a training runs with: the choice that a user made, and the settings of both stages that it stands for.

use cairn_field::{FieldConfig, FieldError};
use cairn_mark::{MarkError, Recipe};
use cairn_scene::SceneKind;
use serde::{Deserialize, Serialize};

use super::error::{ConfigError, out_of_range};

/// The kind of scene that a training is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// All cameras look the same way from about the same place.
    Forward,
    /// An object within a box, nothing behind it.
    Object,
    /// A landmark in the open.
    Outdoor,
}

impl From<SceneKind> for Preset {
    fn from(kind: SceneKind) -> Self {
        match kind {
            SceneKind::ForwardFacing => Self::Forward,
            SceneKind::Bounded => Self::Object,
            SceneKind::Unbounded => Self::Outdoor,
        }
    }
}

/// How long a training takes, and how good it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// Seconds; for a program's own tests and for trying an installation.
    Smoke,
    /// Minutes; for trying things out.
    Draft,
    /// What the measurements are of.
    Balanced,
    /// Twice the work of `balanced`.
    Archival,
}

/// The preset that a user asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PresetChoice {
    /// The one of the scene's kind.
    Auto,
    /// [`Preset::Forward`].
    Forward,
    /// [`Preset::Object`].
    Object,
    /// [`Preset::Outdoor`].
    Outdoor,
}

impl PresetChoice {
    /// The preset for a scene of `kind`.
    pub fn of(self, kind: SceneKind) -> Preset {
        match self {
            Self::Auto => kind.into(),
            Self::Forward => Preset::Forward,
            Self::Object => Preset::Object,
            Self::Outdoor => Preset::Outdoor,
        }
    }
}

/// A choice of named presets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chosen {
    /// The kind of scene.
    pub preset: Preset,
    /// How long it takes.
    pub quality: Quality,
    /// Whether marks outlast what happens to pictures.
    pub robust: bool,
}

/// The settings that a training runs with; kept beside its model, and what the
/// record's `training_configuration` digest covers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingSettings {
    /// The choice that they follow from; `None` where a program gave them itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chosen: Option<Chosen>,
    /// Whether views are screened for outliers before stage 1.
    pub screened: bool,
    /// Stage 1.
    pub field: FieldConfig,
    /// Stage 2.
    pub mark: Recipe,
}

impl TrainingSettings {
    /// Settings that a program gives itself, without a preset: for experiments, and not to be reached over the network.
    pub fn given(field: FieldConfig, mark: Recipe) -> Self {
        Self { chosen: None, screened: true, field, mark }
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`] for the first value that is not allowed.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.field.validate().map_err(|e| match e {
            FieldError::Setting { key, value, allowed } => out_of_range(key, value, allowed),
            other => out_of_range("field", other.to_string(), "settings that stage 1 accepts"),
        })?;
        self.mark.validate().map_err(|e| match e {
            MarkError::Setting { key, value, allowed } => out_of_range(key, value, allowed),
            other => out_of_range("mark", other.to_string(), "settings that stage 2 accepts"),
        })
    }

    /// As TOML: equal settings give equal text.
    ///
    /// # Errors
    /// [`ConfigError::Toml`] when a value cannot be written.
    pub fn to_toml(&self) -> Result<String, ConfigError> {
        toml::to_string(self)
            .map_err(|e| ConfigError::Toml { place: "the training settings".into(), cause: e.to_string() })
    }
}
