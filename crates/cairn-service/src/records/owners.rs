//! Owner records as the engine serves them: what a record must state, taking it
//! in, finding and proving it. Signing happens at the owner's, never here.

use std::collections::BTreeSet;
use std::path::Path;

use cairn_log::format::record::Seen;
use cairn_log::format::shares::Shares;
use cairn_log::{Checkpoint, CheckpointError, Digest, LogEntry, OwnerRecord, RecordKind, Registry, SignedRecord};

use crate::error::EngineError;
use crate::records::corrections;
use crate::records::publisher::Publisher;
use crate::store::access::Access;
use crate::store::hidden::Parts;
use crate::store::model::{IdentityInfo, ModelInfo};
use crate::store::snapshot::SceneSnapshot;

/// What the daemon knows of what a record is to be signed about.
pub struct Material {
    /// The newest model; none before the first, where only a contributor can be signed for.
    pub info: Option<ModelInfo>,
    /// Who the identity stands for, or the contributor's name.
    pub label: String,
    /// SHA-256 of the identity's photographs, or of the contributor's that are not excluded.
    pub photographs: Vec<Digest>,
    /// The hidden signal's files; none where nothing is hidden, and for a contributor.
    pub signal: Parts<Vec<u8>>,
}

/// What a record is to be signed about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum About {
    /// The identity of this number.
    Identity(u32),
    /// The photographs of the contributor of this name.
    Contributor(String),
}

/// Log entries read at a time.
const PAGE: usize = 64;

/// Which view of a scene a complete answer is about.
#[derive(Clone, Debug)]
pub enum AskedView {
    /// The view of this name.
    Named(String),
    /// The view with this photograph, by its SHA-256; it need not be here any more.
    Photograph(Digest),
}

/// What a record about an identity of the newest model, or about a contributor's photographs, has to state; the hidden
/// signal's files lie in `models`.
///
/// # Errors
/// [`EngineError::NotTrained`], [`EngineError::NotFound`]; [`EngineError::WrongState`] where a view of an identity is
/// excluded since, or all of a contributor are.
pub fn material(snapshot: &SceneSnapshot, models: &Path, about: &About) -> Result<Material, EngineError> {
    match about {
        About::Identity(identity) => of_identity(snapshot, models, *identity),
        About::Contributor(name) => of_contributor(snapshot, name),
    }
}

fn of_contributor(snapshot: &SceneSnapshot, name: &str) -> Result<Material, EngineError> {
    let views = &snapshot.scene.capture().views;
    let own = || (0..views.len()).filter(|i| views[*i].contributor == name);
    if own().next().is_none() {
        let there: BTreeSet<&str> = views.iter().map(|view| view.contributor.as_str()).collect();
        return Err(EngineError::not_found("contributor", name, there.into_iter()));
    }
    let kept = own().filter(|i| !snapshot.is_out(&views[*i].name));
    let photographs: Vec<Digest> = kept.map(|i| Digest::from_bytes(snapshot.scene.photograph_digest(i))).collect();
    if photographs.is_empty() {
        let what = format!("contributor {name:?} of scene {:?}", snapshot.name);
        let why = "all their views are excluded; include one, or ask who curates the scene why";
        return Err(EngineError::wrong_state(what, "signed for", why));
    }
    Ok(Material { info: snapshot.newest.clone(), label: name.to_owned(), photographs, signal: Parts::default() })
}

fn of_identity(snapshot: &SceneSnapshot, models: &Path, identity: u32) -> Result<Material, EngineError> {
    let info = snapshot.info()?;
    let known = info.identity(identity)?.clone();
    let out = &snapshot.out_of_clusters;
    let members = info.clusters.clusters.iter().find(|c| c.identity == identity).map_or(&[][..], |c| &c.members);
    if let Some(at) = members.iter().position(|m| out.contains(m)) {
        let view = known.views.get(at).map_or("", String::as_str);
        let what = format!("identity {identity} of scene {:?}", snapshot.name);
        let why = format!("its view {view:?} is excluded; train the scene again, or include the view");
        return Err(EngineError::wrong_state(what, "signed for", why));
    }
    let signal = if info.mark.is_some() { info.signal(models, identity)? } else { Parts::default() };
    Ok(Material { info: Some(info.clone()), label: known.label, photographs: known.photographs, signal })
}

/// Takes a record in, at the cost of `payer`, an account's id, if any; durable on return, and published soon after. What
/// it says of a key's end holds for that key's account from then on. A revocation costs nothing: there is one a key, and
/// whoever's key was stolen must not wait for a quota.
///
/// # Errors
/// The quota's, the registry's.
pub fn submit(
    registry: &Registry,
    access: &Access,
    publisher: &Publisher,
    signed: &SignedRecord,
    payer: Option<Digest>,
) -> Result<cairn_log::Receipt, EngineError> {
    let record = signed.record();
    // What is there already costs nothing, or whoever used up a quota could not ask again for their last answer.
    let is_new = registry.find(&signed.digest())?.is_none();
    let payer = payer.filter(|_| is_new && record.kind != RecordKind::Revocation);
    if let Some(payer) = &payer {
        access.charge_record(payer)?;
    }
    let submitted = registry.submit(signed.clone());
    if let Some(payer) = payer.filter(|_| !matches!(&submitted, Ok(receipt) if !receipt.resubmitted)) {
        access.forgive_record(&payer);
    }
    let receipt = submitted?;
    publisher.wake();
    if matches!(record.kind, RecordKind::Revocation | RecordKind::Rotation) {
        access.follow(registry, record)?;
    }
    Ok(receipt)
}

/// A page of log entries, each as `convert` makes it: at most `limit` of them, and no more than about `most` bytes as
/// `bytes_of` counts them, but one at least; and where to go on, if anywhere.
///
/// # Errors
/// The registry's.
pub fn page<T>(
    registry: &Registry,
    scene: Option<&str>,
    from: u64,
    limit: usize,
    most: usize,
    convert: impl Fn(&LogEntry) -> Result<Option<T>, EngineError>,
    bytes_of: impl Fn(&T) -> usize,
) -> Result<(Vec<T>, Option<u64>), EngineError> {
    let (mut taken, mut bytes, mut looked_at, mut next) = (Vec::new(), 0, 0, from);
    while looked_at < limit {
        let page = registry.page(scene, next, PAGE.min(limit - looked_at))?;
        let Some(last) = page.last() else { return Ok((taken, None)) };
        next = last.index() + 1;
        looked_at += page.len();
        for entry in &page {
            if bytes > most {
                return Ok((taken, Some(entry.index())));
            }
            if let Some(converted) = convert(entry)? {
                bytes += bytes_of(&converted);
                taken.push(converted);
            }
        }
    }
    Ok((taken, Some(next)))
}

/// The photograph that `view` asks about, by its SHA-256.
///
/// # Errors
/// [`EngineError::NotFound`] for a view's name, [`EngineError::WrongState`] for one that is excluded.
pub fn photograph_of(snapshot: &SceneSnapshot, name: &str) -> Result<Digest, EngineError> {
    let photograph = snapshot.photograph_of(name)?;
    if snapshot.is_out(snapshot.full_name(name)?) {
        let why = "it is excluded, and no contributor is credited with it; ask by the SHA-256 of its photograph for what \
                   the log says of that";
        let what = format!("view {name:?} of scene {:?}", snapshot.name);
        return Err(EngineError::wrong_state(what, "asked about", why));
    }
    Ok(photograph)
}

/// Who contributed to a scene or a view of it, complete, as JSON (format `cairn-answer/3`) of at most `most` bytes; with the statement that
/// `shares` gives for the answer's checkpoint, signed.
///
/// # Errors
/// [`EngineError::OverLimit`]; the registry's; what `shares` fails with.
pub fn complete_answer(
    registry: &Registry,
    scene: &str,
    photograph: Option<&Digest>,
    as_of: Option<&str>,
    most: usize,
    shares: Option<&dyn Fn(Seen) -> Result<Shares, EngineError>>,
) -> Result<Vec<u8>, EngineError> {
    let limit = most.min(cairn_log::format::answer::MAX_ANSWER_BYTES);
    let mut answer = registry.answer(scene, photograph, as_of, limit)?;
    if let Some(shares) = shares {
        let unread = |e: CheckpointError| EngineError::wrong_state("the log's checkpoint", "read", e.to_string());
        let checkpoint = Checkpoint::read(&answer.checkpoint).map_err(unread)?.1;
        let shares = shares(Seen { size: checkpoint.size, root: checkpoint.root })?;
        answer.shares = Some(registry.sign_shares(&shares)?);
    }
    let answer = answer.to_json();
    let what = "the complete answer in bytes (ask about a view)";
    EngineError::within(what, "limits.max_message_bytes", limit as u64, answer.len() as u64)?;
    Ok(answer.into_bytes())
}

/// Log indices of the records that count for an identity, rising: claims of this very marked field, and claims and
/// contributions of the identity's photographs, that their owners uphold. A rotation ends a key and leaves what that signed.
///
/// # Errors
/// The registry's.
pub fn bearing_on(
    registry: &Registry,
    scene: &str,
    marked_field: Option<Digest>,
    identity: &IdentityInfo,
) -> Result<Vec<u64>, EngineError> {
    let mut indices = Vec::new();
    let mut page = registry.page(Some(scene), 0, PAGE)?;
    // A page at a time: what a scene's records take is up to whoever submits them.
    while let Some(last) = page.last() {
        let next = last.index() + 1;
        for entry in &page {
            let LogEntry::Record(stored) = entry else { continue };
            let credits = stored.record.kind.credits() && is_about(&stored.record, marked_field, identity);
            if credits && corrections::standing(registry, stored)?.is_upheld() {
                indices.push(stored.index);
            }
        }
        page = registry.page(Some(scene), next, PAGE)?;
    }
    Ok(indices)
}

/// Whether a record is about the marked field, for a claim of a mark, or about the identity's photographs, by its digests.
/// The number alone says nothing: the next training may give it to another contributor. A record without a number may
/// list more photographs than the identity's.
fn is_about(record: &OwnerRecord, marked_field: Option<Digest>, identity: &IdentityInfo) -> bool {
    let bound = &record.digests;
    let photographs = identity.photographs_root();
    let lists = |views: &Vec<Digest>| identity.photographs.iter().all(|own| views.binary_search(own).is_ok());
    match record.identity.number {
        None => return bound.photographs == Some(photographs) || record.views.as_ref().is_some_and(lists),
        Some(_) if record.kind != RecordKind::Claim => return bound.photographs == Some(photographs),
        Some(_) => {}
    }
    record.identity.number == Some(identity.number)
        && marked_field.is_some()
        && bound.marked_field == marked_field
        && bound.photographs.is_none_or(|root| root == photographs)
}

#[cfg(test)]
#[path = "owners_tests.rs"]
mod tests;
