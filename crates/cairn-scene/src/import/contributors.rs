//! Who took what, and under which key they sign: a CSV table with one row a photograph. Credit is the point of
//! the whole program, so a table that is almost right is refused, not patched.

use std::collections::HashMap;
use std::path::Path;

use cairn_durable::read_limited;
use serde::Deserialize;

use crate::capture::few;
use crate::error::CaptureError;
use crate::images::format::Limits;
use crate::import::named::{composed, left_away};

/// How many rows or photographs an error names.
const NAMED: usize = 20;

#[derive(Deserialize)]
struct Row {
    image: String,
    contributor: String,
    /// 64 hexadecimal digits; a table may lack the column, and a row the key.
    #[serde(default)]
    key: Option<String>,
}

/// Who took a photograph.
#[derive(Clone, Debug)]
pub(crate) struct Contributor {
    /// Their name.
    pub(crate) name: String,
    /// Their public key, where a row of theirs has one.
    pub(crate) key: Option<[u8; 32]>,
}

/// Who took a capture's photographs, as its table says.
pub(crate) struct Takers {
    /// Of each view.
    pub of_views: Vec<Contributor>,
    /// Of each photograph that is left out; `None` where it has no row.
    pub of_left_out: Vec<Option<String>>,
}

/// The contributor of each of `names` and of each that is `left_out`, in order, from the table at `table`.
///
/// The table has a heading with at least `image` and `contributor`, and may have `key`, which any row of a contributor's
/// says for all of them. An image is
/// named as the camera file names it, or by its file name where only one
/// photograph has that, in any Unicode normalisation.
///
/// # Errors
/// For rows that name no photograph, photographs of `names` without a row, one with two rows, an empty contributor, what is
/// no key, or a contributor with two keys.
pub(crate) fn read(table: &Path, names: &[&str], left_out: &[&str], limits: &Limits) -> Result<Takers, CaptureError> {
    let wrong = |entry: String, problem: String, remedy: &'static str| CaptureError::Contributors {
        table: table.to_path_buf(),
        entry,
        problem,
        remedy,
    };
    // Those that are left out count as well: a file name that two photographs had names neither.
    let all: Vec<&str> = names.iter().chain(left_out).copied().collect();
    let index = index_of(&all);
    let of_any_form: Vec<String> = all.iter().map(|name| composed(name)).collect();
    let of_any_form = index_of(&of_any_form);
    let bytes = read_limited(table, limits.max_file_bytes)?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes.as_slice());
    let endings = left_away();
    let mut found: Vec<Option<(String, usize)>> = vec![None; all.len()];
    let mut unknown = Vec::new();
    let mut keys: HashMap<String, StatedKey> = HashMap::new();
    for (number, row) in reader.deserialize::<Row>().enumerate() {
        // The heading is line 1; a quoted line break would shift this, and no file name has one.
        let line = number + 2;
        let row = row.map_err(|e| {
            wrong(format!("line {line}"), e.to_string(), "write a heading `image,contributor` and one row a photograph")
        })?;
        let entry = format!("line {line} ({})", row.image);
        // A missing photograph's ending is not known where the camera file leaves it away.
        let bare = || {
            let without = |ending: &String| index.get(row.image.strip_suffix(ending.as_str())?);
            endings.iter().filter_map(without).find(|view| **view >= names.len())
        };
        let other_form = || of_any_form.get(composed(&row.image).as_str());
        let Some(&view) = index.get(row.image.as_str()).or_else(bare).or_else(other_form) else {
            unknown.push(entry);
            continue;
        };
        if row.contributor.is_empty() || row.contributor.chars().any(char::is_control) {
            let problem = format!("the contributor {:?} is empty or has control characters", row.contributor);
            return Err(wrong(entry, problem, "write who took it"));
        }
        if let Some((_, first)) = &found[view] {
            let problem = format!("the photograph already has a row, line {first}");
            return Err(wrong(entry, problem, "keep one of the rows"));
        }
        if let Some(text) = row.key.filter(|text| !text.is_empty()) {
            let mut key = [0; 32];
            if hex::decode_to_slice(&text, &mut key).is_err() {
                let problem = format!("the key {text:?} of {:?} is no public key", row.contributor);
                return Err(wrong(
                    entry,
                    problem,
                    "write its 64 hexadecimal digits (`cairn keys show`), or leave it empty",
                ));
            }
            let stated = keys.entry(row.contributor.clone()).or_insert(StatedKey { key, line });
            if stated.key != key {
                let problem = format!("{:?} has another key in line {}", row.contributor, stated.line);
                return Err(wrong(entry, problem, "write one key for each contributor"));
            }
        }
        found[view] = Some((row.contributor, line));
    }
    if !unknown.is_empty() {
        let these = if unknown.len() == 1 { "that name" } else { "these names" };
        let problem = format!("the capture has no photograph of {these}, or several");
        return Err(wrong(few(&unknown, NAMED), problem, "name it as the camera file does, or remove the row"));
    }
    let without = found.iter().zip(names).filter(|(row, _)| row.is_none()).map(|(_, name)| name);
    let without: Vec<&str> = without.copied().collect();
    if !without.is_empty() {
        let (photographs, it_has) =
            if without.len() == 1 { ("photograph", "it has") } else { ("photographs", "they have") };
        let entry = format!("{photographs} {}", few(&without, NAMED));
        return Err(wrong(entry, format!("{it_has} no row"), "add a row that says who took it"));
    }
    let taker = |(name, _): (String, usize)| Contributor { key: keys.get(&name).map(|stated| stated.key), name };
    let mut takers = found.into_iter().map(|row| row.map(taker));
    let of_views = takers.by_ref().take(names.len()).flatten().collect();
    Ok(Takers { of_views, of_left_out: takers.map(|taker| Some(taker?.name)).collect() })
}

/// A contributor's key, and the line that says so first.
struct StatedKey {
    key: [u8; 32],
    line: usize,
}

/// Every name, and every file name that only one view has.
fn index_of<T: AsRef<str>>(names: &[T]) -> HashMap<&str, usize> {
    let mut short: HashMap<&str, Option<usize>> = HashMap::new();
    for (i, name) in names.iter().map(AsRef::as_ref).enumerate() {
        let file = name.rsplit('/').next().unwrap_or(name);
        short.entry(file).and_modify(|at| *at = None).or_insert(Some(i));
    }
    let mut index: HashMap<&str, usize> = short.into_iter().filter_map(|(name, at)| Some((name, at?))).collect();
    index.extend(names.iter().enumerate().map(|(i, name)| (name.as_ref(), i)));
    index
}
