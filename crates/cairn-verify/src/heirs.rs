//! Who may say something about a record: its owner's key, or the key that rotations put in its place.

use std::convert::Infallible;

use cairn_log::format::{
    Digest,
    heir::{Ending, Heir, heir},
};

/// Whether a record at `index` may speak for the owner with this key id; else what would have been expected.
///
/// `ending` gives the end of a key, `spoke` whether the record is by a key or has its signature, both by the key's id.
pub(crate) fn may_speak(
    owner: &Digest,
    index: u64,
    mut ending: impl FnMut(&Digest) -> Option<Ending>,
    spoke: impl FnOnce(&Digest) -> bool,
) -> Result<(), String> {
    let Ok(speaks) = heir(owner, index, |key| Ok::<_, Infallible>(ending(key)));
    match speaks {
        Heir::Key { id, .. } if spoke(&id) => Ok(()),
        Heir::Key { id, .. } => Err(format!("a record by the owner's key (id {id}), or with its signature")),
        Heir::Nobody { ended_by, .. } => {
            Err(format!("a record before index {ended_by}, where the owner's key ended with none in its place"))
        }
    }
}
