//! TOML over settings, for benchmarks.

use cairn_scene::SceneKind;
use toml::{Table, Value};

use super::error::{ConfigError, out_of_range};
use super::training::TrainingSettings;

/// Smaller settings.
pub const QUICK_TOML: &str = include_str!("../../../../configs/draft.toml");

/// The settings of a kind of scene: the file's name and its text.
pub fn overlay_for(kind: SceneKind) -> (&'static str, &'static str) {
    match kind {
        SceneKind::ForwardFacing => ("configs/forward.toml", include_str!("../../../../configs/forward.toml")),
        SceneKind::Bounded => ("configs/object.toml", include_str!("../../../../configs/object.toml")),
        SceneKind::Unbounded => ("configs/outdoor.toml", include_str!("../../../../configs/outdoor.toml")),
    }
}

/// `base` with overlays.
///
/// # Errors
/// As they are.
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
