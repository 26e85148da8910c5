//! `cairn owners dispute`, `show` and `erase`: what happens to a record after it was entered.

use std::collections::HashMap;
use std::path::PathBuf;

use anyhow::Context as _;
use cairn_api::v1;
use cairn_log::{ErasureRequest, RecordKind, format::erasure};

use super::connect::Connection;
use super::json::{self, Json};
use super::records::{self, Bundle, Ground, Stored};
use super::unlock::UnlockArgs;

/// `cairn owners dispute`.
#[derive(Clone, Debug, clap::Args)]
pub struct DisputeArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    pub name: String,
    /// The record that is contested (see `cairn owners list`)
    #[arg(long, value_name = "INDEX")]
    pub record: u64,
    /// The key of the owner who contests it (see `cairn keys new`)
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    #[command(flatten)]
    pub unlock: UnlockArgs,
    /// Why it is contested, in words
    #[arg(long, value_name = "TEXT")]
    pub purpose: String,
    /// Where the bundle goes: a new folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// `cairn owners erase`.
#[derive(Clone, Debug, clap::Args)]
pub struct EraseArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    pub name: String,
    /// The record whose envelope is to go (see `cairn owners list`)
    #[arg(long, value_name = "INDEX")]
    pub record: u64,
    /// The key that the record belongs to, or the one that took its place
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    #[command(flatten)]
    pub unlock: UnlockArgs,
}

/// Enters a dispute; its index in the log.
pub async fn dispute(line: &Connection, args: &DisputeArgs) -> anyhow::Result<u64> {
    Bundle::must_be_new(&args.out)?;
    let key = args.unlock.load(&args.key)?;
    let bundle = Bundle::begin(&args.out)?;
    let contested = Stored::of_scene(line, &args.name, args.record).await?;
    let ground = Ground::ask(line, &args.name, &key.public()).await?;
    let record = ground.about(&contested, RecordKind::Dispute, &key, &args.purpose)?;
    Ok(bundle.enter(line, &record, &[&key], &[]).await?.index)
}

/// Has a record's envelope erased.
pub async fn erase(line: &Connection, args: &EraseArgs) -> anyhow::Result<()> {
    let key = args.unlock.load(&args.key)?;
    let stored = Stored::of_scene(line, &args.name, args.record).await?;
    let ground = Ground::ask(line, &args.name, &key.public()).await?;
    let request = ErasureRequest {
        version: erasure::VERSION,
        origin: ground.origin,
        record: stored.digest,
        index: stored.index,
        owner_key: key.public(),
        nonce: ground.nonce,
    };
    let request = request.seal(&key)?.to_json().into_bytes().into();
    let request = v1::EraseRecordRequest { request };
    let index = line.about(&args.name).owners().erase(request).await?.into_inner().index;
    anyhow::ensure!(index == stored.index, "the daemon says that it erased record {index}, not {}", stored.index);
    println!("record {index} is erased: its envelope is gone, its leaf stays, and every proof goes on verifying");
    println!("copies in bundles and backups are their holders' to delete");
    Ok(())
}

/// Prints a record and its state.
pub async fn show(line: &Connection, index: u64, json: Json) -> anyhow::Result<()> {
    if json.json {
        let answer = line.owners().get(v1::GetRecordRequest { index }).await?.into_inner();
        let record = answer.record.context("the daemon's answer names no record")?;
        return json::print_value(&records::as_json(&record)?);
    }
    let Some(stored) = Stored::find(line, index).await? else {
        println!("record {index}");
        println!("  state          erased; its leaf is in the log, and says nothing about any person");
        return Ok(());
    };
    let record = &stored.record;
    let kind = serde_json::to_value(record.kind)?;
    println!("record {index}: {}, scene {}", kind.as_str().context("the record's kind has no name")?, record.scene);
    // A dispute mostly names another than its own owner, whom its key tells; a binding always may.
    let whose = match (record.kind, record.identity.number) {
        (RecordKind::Dispute | RecordKind::Binding, _) => "names",
        (_, Some(_)) => "identity",
        (_, None) => "contributor",
    };
    let number = record.identity.number.map(|number| format!("{number}, ")).unwrap_or_default();
    let mut facts = vec![
        ("state", state(&stored.standing, record.kind.credits())),
        (whose, format!("{number}{}", record.identity.contributor)),
        ("purpose", record.purpose.clone()),
        ("owner key", record.owner_key.to_string()),
        ("key id", record.owner_key.id().to_string()),
        ("digest", stored.digest.to_string()),
        ("not before", format!("the checkpoint of size {}", record.seen.size)),
        ("log", record.origin.clone()),
    ];
    let digests = &record.digests;
    for (name, digest) in [
        ("about", record.replaces),
        ("marked field", digests.marked_field),
        ("detector", digests.detector),
        ("hidden signal", digests.hidden_signal),
        ("photographs", digests.photographs),
        ("base field", digests.base_field),
        ("share table", digests.share_table),
        ("settings", digests.training_configuration),
    ] {
        facts.extend(digest.map(|digest| (name, digest.to_string())));
    }
    facts.extend(record.identity.key.map(|key| ("stands for", format!("key {key}"))));
    facts.extend(record.seed.map(|seed| ("seed", seed.to_string())));
    let views = record.views.as_deref().unwrap_or_default();
    facts.extend(record.views.as_ref().map(|views| ("views", format!("{} photographs:", views.len()))));
    for (name, fact) in facts {
        println!("  {name:14} {fact}");
    }
    if views.is_empty() {
        return Ok(());
    }
    let named = names(line, &record.scene).await;
    for digest in views {
        let name = named.as_ref().map_or("", |names| {
            names.get(digest.as_bytes().as_slice()).map_or("  (not in the scene now)", String::as_str)
        });
        println!("  {:14} {digest}{name}", "");
    }
    if let Err(error) = named {
        println!("the scene's names cannot be asked for: {error:#}");
    }
    Ok(())
}

/// What the scene's views are called, each behind two blanks, by their photographs' digests.
async fn names(line: &Connection, scene: &str) -> anyhow::Result<HashMap<Vec<u8>, String>> {
    let views = super::scene::get(line, scene).await?.views;
    Ok(views.into_iter().map(|view| (view.photograph_sha256.to_vec(), format!("  {}", view.name))).collect())
}

/// The state of a record that was not erased, in words.
pub fn state_of(record: &v1::Record) -> String {
    let credits = ["claim", "contribution"].contains(&record.kind.as_str());
    state(&record.standing.clone().unwrap_or_default(), credits)
}

/// A record's state in words, as the daemon has it; of one that credits its owner whether a curator confirmed the name.
fn state(standing: &v1::Standing, credits: bool) -> String {
    let mut words = match (standing.taken_back_by, standing.replaced_by, standing.confirmed_by) {
        (Some(index), ..) => format!("taken back by record {index}"),
        (None, Some(index), _) => format!("replaced by record {index}"),
        (None, None, Some(index)) => format!("stands, name confirmed by record {index}"),
        (None, None, None) if credits => "stands, name unconfirmed".to_owned(),
        (None, None, None) => "stands".to_owned(),
    };
    if !standing.disputed_by.is_empty() {
        let indices: Vec<String> = standing.disputed_by.iter().map(u64::to_string).collect();
        words.push_str(&format!("; disputed by record {}", indices.join(", ")));
    }
    if let Some(index) = standing.key_ended_by {
        let how = if standing.key_rotated { "rotated" } else { "revoked" };
        words.push_str(&format!("; its key was {how} by record {index}, after it"));
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_names_every_record_that_bears_on_it() {
        let standing = v1::Standing::default();
        let state = |standing: &v1::Standing| super::state(standing, false);
        assert_eq!(state(&standing), "stands");
        assert_eq!(super::state(&standing, true), "stands, name unconfirmed");
        let confirmed = v1::Standing { confirmed_by: Some(7), ..standing.clone() };
        assert_eq!(super::state(&confirmed, true), "stands, name confirmed by record 7");
        let disputed = v1::Standing { disputed_by: vec![3, 5], ..standing.clone() };
        assert_eq!(state(&disputed), "stands; disputed by record 3, 5");
        let rotated = v1::Standing { key_ended_by: Some(2), key_rotated: true, ..standing.clone() };
        assert_eq!(state(&rotated), "stands; its key was rotated by record 2, after it");
        let revoked = v1::Standing { replaced_by: Some(1), key_ended_by: Some(2), ..standing };
        assert_eq!(state(&revoked), "replaced by record 1; its key was revoked by record 2, after it");
        let taken_back = v1::Standing { taken_back_by: Some(4), key_ended_by: None, ..revoked };
        assert_eq!(state(&taken_back), "taken back by record 4");
    }
}
