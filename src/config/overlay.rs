//! Laying one settings text over another: a key may replace what is there and
//! nothing else, so a misspelt one is found however deep it lies.

use cairn_field::{FieldConfig, FieldError, QuarantineConfig};
use cairn_stega::{MarkConfig, MarkError};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::{ConfigError, out_of_range};

/// The settings that a training runs with; kept beside its model, and what the
/// record's `training_configuration` digest covers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingSettings {
    /// Stage 1.
    pub field: FieldConfig,
    /// Stage 2.
    pub mark: MarkConfig,
    /// Which views are left out of both. Absent in settings of before there was a quarantine.
    #[serde(default)]
    pub quarantine: QuarantineConfig,
}

impl TrainingSettings {
    /// Checks every range.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`] for the first value that is not allowed.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.field.validate().and_then(|()| self.quarantine.validate()).map_err(|e| match e {
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

/// `base` with each of `overlays` (what to call it, TOML text with the tables of
/// [`TrainingSettings`]) laid over it in turn, checked.
///
/// # Errors
/// [`ConfigError`] for an unknown or out-of-range key.
pub fn training_settings(base: &TrainingSettings, overlays: &[(&str, &str)]) -> Result<TrainingSettings, ConfigError> {
    let mut table = parse(&base.to_toml()?, "the training settings")?;
    let mut last = "the training settings";
    for (place, text) in overlays {
        table = laid_over(table, text, place)?;
        last = place;
    }
    let settings: TrainingSettings = table.try_into().map_err(|e| toml_error(last, &e))?;
    settings.check()?;
    Ok(settings)
}

/// Parses TOML; `place` names it in errors.
pub(super) fn parse(text: &str, place: &str) -> Result<Table, ConfigError> {
    text.parse::<Table>().map_err(|e| toml_error(place, &e))
}

pub(super) fn toml_error(place: &str, error: &toml::de::Error) -> ConfigError {
    ConfigError::Toml { place: place.into(), cause: error.to_string().trim_end().to_owned() }
}

/// `text` over `base`.
pub(super) fn laid_over(mut base: Table, text: &str, place: &str) -> Result<Table, ConfigError> {
    lay(&mut base, parse(text, place)?, "", place)?;
    Ok(base)
}

fn lay(base: &mut Table, over: Table, prefix: &str, place: &str) -> Result<(), ConfigError> {
    for (name, value) in over {
        let key = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        let allowed = || base.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        let Some(slot) = base.get(&name) else {
            return Err(ConfigError::UnknownKey {
                place: place.into(),
                key,
                value: value.to_string(),
                allowed: allowed(),
            });
        };
        let value = match (slot, value) {
            (Value::Table(slot), Value::Table(over)) => {
                let mut slot = slot.clone();
                lay(&mut slot, over, &key, place)?;
                Value::Table(slot)
            }
            // A whole number is a fine fraction, but not the other way round.
            (Value::Float(_), Value::Integer(whole)) => Value::Float(whole as f64),
            (slot, value) if slot.same_type(&value) => value,
            (slot, value) => return Err(out_of_range(&key, value, format!("a value of type {}", slot.type_str()))),
        };
        base.insert(name, value);
    }
    Ok(())
}
