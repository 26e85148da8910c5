//! What lies behind the last entry, and what does not belong: records that were
//! accepted and not published yet, and files that nothing of the registry's is.

use cairn_log::format::{
    NoteVerifier,
    packs::{self, Slot},
    tile::TilePath,
};

use super::{
    StoreError,
    chunk::Context,
    files::{self, CHUNK},
    record,
};
use crate::{code::Code, report::Findings};

/// How the names end that files have until they are complete; nothing reads them.
const UNFINISHED: &str = ".new";

/// Checks the envelopes behind the last entry, and names every file that the registry does not write.
pub(super) fn check(context: &Context<'_>, chunks: u64, findings: &mut Findings) -> Result<(), StoreError> {
    let files = context.files;
    if context.extent > context.size {
        let got = format!("{} entries behind size {}", context.extent - context.size, context.size);
        findings.add(Code::StoreTail, files.name_public("tile"), "", got);
    }
    let mut unknown = Vec::new();
    files::walk(&files.public(), &mut |name| {
        let tile = || name.parse::<TilePath>().ok().filter(|tile| belongs(tile, context.extent));
        if name != "checkpoint" && tile().is_none() {
            unknown.push(files.name_public(name));
        }
    })?;
    for place in unknown {
        if place.ends_with(UNFINISHED) {
            findings.add(Code::FileUncovered, place, "", "left of a write that was cut off");
            continue;
        }
        findings.add(Code::StoreFileUnknown, place, "checkpoint, or a tile of this log", "another file");
    }
    let last = context.extent / CHUNK;
    let mut tail = Vec::new();
    let mut strangers = Vec::new();
    files::walk(&files.registry().join("envelopes"), &mut |name| {
        // Paths of tiles, so that they are read in one way only.
        match format!("tile/entries/{name}").parse::<TilePath>() {
            Ok(path) if u64::from(path.width) < CHUNK => strangers.push(name.to_owned()),
            Ok(path) if path.index < chunks.min(last) => {}
            Ok(path) => tail.push(path.index),
            Err(_) => strangers.push(name.to_owned()),
        }
    })?;
    for name in strangers {
        let place = format!("registry/envelopes/{name}");
        if name.ends_with(UNFINISHED) {
            findings.add(Code::FileUncovered, place, "", "left of a write that was cut off");
            continue;
        }
        findings.add(Code::StoreEnvelopeFile, place, "a file of 256 envelopes", "another file");
    }
    tail.sort_unstable();
    tail.iter().for_each(|index| behind(context, *index, findings));
    Ok(())
}

/// Whether a tree of `extent` leaves has this tile, or had it when it was smaller.
fn belongs(tile: &TilePath, extent: u64) -> bool {
    TilePath::in_tree(tile.kind, tile.index, extent).is_some_and(|newest| tile.width <= newest.width)
}

/// Records that no entry speaks of yet: durable, and published when the registry starts.
fn behind(context: &Context<'_>, index: u64, findings: &mut Findings) {
    let Ok(Some(bytes)) = context.files.envelopes(index) else { return };
    let (slots, broken) = packs::parse_whole(&bytes);
    let from = context.extent.saturating_sub(index * CHUNK).min(CHUNK) as usize;
    let place = context.files.name_envelopes(index);
    let more = slots.len().saturating_sub(from);
    if more > 0 || (broken.is_some() && from < CHUNK as usize && slots.len() >= from) {
        let torn = broken.as_ref().map_or_else(String::new, |cause| format!("; {cause}"));
        findings.add(Code::StoreTail, place.clone(), "", format!("{more} frames behind the last entry{torn}"));
    }
    for (at, slot) in slots.iter().enumerate().skip(from) {
        let Slot::Record(json) = slot else { continue };
        if let Err(fault) = record::check(json, context.origin, context.key.map(NoteVerifier::key)) {
            let place = format!("{place}, record {}", index * CHUNK + at as u64);
            findings.add(fault.code, place, fault.expected, fault.got);
        }
    }
}
