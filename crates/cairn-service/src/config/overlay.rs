//! Laying one settings text over another: a key may replace what is there and
//! nothing else, so a misspelt one is found however deep it lies.

use toml::{Table, Value};

use super::error::{ConfigError, out_of_range};
use super::training::TrainingSettings;

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

/// What `file`, a settings file over `defaults`, says of training ([`TrainingSettings`]' tables), as TOML. It is laid over what the kind of a
/// scene chooses, which takes more than knowing the settings: what is not said is the kind's to choose. Of a table that
/// repeats more than half of the defaults, a copy of the default file, only what differs from them was said.
///
/// # Errors
/// [`ConfigError::Toml`] when a value cannot be written.
pub(super) fn configured(file: &Table, defaults: &Table, place: &str) -> Result<String, ConfigError> {
    let mut said = Table::new();
    for name in ["field", "mark", "quarantine"] {
        let (Some(Value::Table(table)), Some(default)) = (file.get(name), defaults.get(name)) else { continue };
        let (all, mut changed) = (keys_of(default).len(), table.clone());
        let repeated = default.as_table().map_or(0, |defaults| remove_repeated(&mut changed, defaults));
        let is_copy = 2 * repeated > all;
        said.insert(name.to_owned(), Value::Table(if is_copy { changed } else { table.clone() }));
    }
    toml::to_string(&said).map_err(|e| ConfigError::Toml { place: place.into(), cause: e.to_string() })
}

/// Removes from `table` what is as in `defaults`; how many keys those were.
fn remove_repeated(table: &mut Table, defaults: &Table) -> usize {
    let mut removed = 0;
    table.retain(|name, value| match (value, defaults.get(name)) {
        (Value::Table(inner), Some(Value::Table(defaults))) => {
            removed += remove_repeated(inner, defaults);
            !inner.is_empty()
        }
        (value, Some(default)) => {
            let same = is_same(value, default);
            removed += usize::from(same);
            !same
        }
        (_, None) => true,
    });
    removed
}

/// The whole keys that `over` sets to something else than `under` does, each with both values; without what is only in one, and
/// what one of `later` sets again. Each is a name and TOML.
///
/// # Errors
/// [`ConfigError::Toml`] for what is no TOML.
pub fn overridden(under: (&str, &str), over: (&str, &str), later: &[(&str, &str)]) -> Result<Vec<String>, ConfigError> {
    let keys = |(place, text): (&str, &str)| parse(text, place).map(|table| keys_of(&Value::Table(table)));
    let (under, over) = (keys(under)?, keys(over)?);
    let mut again = Vec::new();
    for text in later {
        again.extend(keys(*text)?.into_iter().map(|(key, _)| key));
    }
    let differs = |(key, value): (String, Value)| {
        let (_, chosen) = under.iter().find(|(name, chosen)| *name == key && !is_same(chosen, &value))?;
        (!again.contains(&key)).then(|| format!("{key} = {value} ({chosen} there)"))
    };
    Ok(over.into_iter().filter_map(differs).collect())
}

/// Whether two values say the same; a whole number is a fraction, too.
fn is_same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Integer(whole), Value::Float(fraction)) | (Value::Float(fraction), Value::Integer(whole)) => {
            *whole as f64 == *fraction
        }
        _ => a == b,
    }
}

/// Every key of a table with its value, inner tables' by their whole path.
fn keys_of(value: &Value) -> Vec<(String, Value)> {
    let Value::Table(table) = value else { return Vec::new() };
    let of = |(name, value): (&String, &Value)| match value {
        Value::Table(_) => keys_of(value).into_iter().map(|(key, value)| (format!("{name}.{key}"), value)).collect(),
        _ => vec![(name.clone(), value.clone())],
    };
    table.iter().flat_map(of).collect()
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
