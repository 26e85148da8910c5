//! From a settings file's text to typed settings: a key that is not declared, and a value that is not allowed, are
//! refused with their names and what would do.

use cairn_log::format::key::is_secret;
use toml::{Table, Value};

use super::declare;
use super::error::{ConfigError, out_of_range};
use super::settings::{Settings, TABLES};

/// The defaults with `text` over them; `place` names it in errors.
///
/// # Errors
/// [`ConfigError`] for what is no TOML, and for an unknown or out-of-range key.
pub(super) fn settings(text: &str, place: &str) -> Result<Settings, ConfigError> {
    let toml_error = |cause: String| ConfigError::Toml { place: place.into(), cause: cause.trim_end().to_owned() };
    let file: Table = text.parse().map_err(|e: toml::de::Error| toml_error(no_toml(text, &e)))?;
    let mut tables = Settings::default().values().map_err(|e| toml_error(e.to_string()))?;
    put(&mut tables, file, "", place)?;
    for (path, values) in &tables {
        check(path, values)?;
    }
    let of = |path| tables.iter().find(|(of, _)| *of == path).map(|(_, values)| values.clone()).unwrap_or_default();
    Settings::typed(of).map_err(|e| toml_error(e.to_string()))
}

/// What is wrong with a text that is no TOML, and where. The line itself is left out: another file given by mistake may be a
/// token or a key.
fn no_toml(text: &str, error: &toml::de::Error) -> String {
    if is_secret(text) {
        return "this is a private key; give a file of settings (see configs/daemon.toml)".into();
    }
    let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
    format!("no TOML at line {line}, column {column}: {}; is it a file of settings?", error.message())
}

/// Checks every value of the declared table at `path`.
///
/// # Errors
/// [`ConfigError::OutOfRange`] for the first that is not allowed.
pub(super) fn check(path: &str, values: &Table) -> Result<(), ConfigError> {
    let table: Option<&declare::Table> = TABLES.iter().find(|table| table.path == path);
    for setting in table.into_iter().flat_map(|table| table.settings) {
        if let Some(value) = values.get(setting.key)
            && !setting.allowed.takes(value)
        {
            return Err(out_of_range(&format!("{path}.{}", setting.key), shown(value), setting.allowed.words()));
        }
    }
    Ok(())
}

/// Puts what `file`, the table at `path` of a file, says over the defaults in `tables`.
fn put(tables: &mut [(&str, Table)], file: Table, path: &str, place: &str) -> Result<(), ConfigError> {
    for (name, value) in file {
        let key = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        if let (true, Value::Table(inner)) = (tables.iter().any(|(of, _)| *of == key), &value) {
            put(tables, inner.clone(), &key, place)?;
            continue;
        }
        let allowed = keys_of(tables, path);
        let slot = tables.iter_mut().find(|(of, _)| *of == path).and_then(|(_, values)| values.get_mut(&name));
        let Some(slot) = slot else {
            return Err(ConfigError::UnknownKey { place: place.into(), key, allowed: allowed.join(", ") });
        };
        *slot = match (&*slot, value) {
            // A whole number is a fine fraction, but not the other way round.
            (Value::Float(_), Value::Integer(whole)) => Value::Float(whole as f64),
            (slot, value) if slot.same_type(&value) => value,
            (slot, value) => return Err(out_of_range(&key, value, format!("a value of type {}", slot.type_str()))),
        };
    }
    Ok(())
}

/// What may stand in the table at `path`: its keys, and the tables within it.
fn keys_of(tables: &[(&str, Table)], path: &str) -> Vec<String> {
    let own = tables.iter().filter(|(of, _)| *of == path).flat_map(|(_, values)| values.keys().cloned());
    let within = tables.iter().filter_map(|(of, _)| match path.is_empty() {
        true => (!of.contains('.')).then(|| (*of).to_owned()),
        false => of.strip_prefix(path)?.strip_prefix('.').map(str::to_owned),
    });
    own.chain(within).collect()
}

/// A value as a message shows it: text without quotes.
fn shown(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}
