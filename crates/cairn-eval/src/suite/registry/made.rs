//! Records to submit and entries to fill with, all of them drawn from one seed.

use cairn_log::format::map::MapKey;
use cairn_log::format::record::{self, Digests, Identity, Seen, photographs_root};
use cairn_log::{Digest, Envelope, Leaf, OwnerKey, OwnerRecord, RecordKind, Registry};

/// The benchmark's log.
pub const ORIGIN: &str = "cairn.bench/owners";

/// Scenes that records are spread over: one for every thousand records.
const RECORDS_A_SCENE: u64 = 1000;
/// Photographs of a scene.
const PHOTOGRAPHS: u64 = 200;

/// The key that signs the benchmark's log.
pub fn registry_key() -> OwnerKey {
    OwnerKey::from_seed(&[0x5a; 32])
}

fn scene(number: u64) -> String {
    format!("landmark-{}", number / RECORDS_A_SCENE)
}

fn photograph(scene: &str, number: u64) -> Digest {
    Digest::of(format!("{scene}/{number}"))
}

/// A contribution of `views` photographs, signed, with a fresh nonce.
///
/// # Errors
/// The registry's, for a nonce that it cannot issue.
pub fn record(registry: &Registry, seed: u64, number: u64, views: u64) -> anyhow::Result<(Envelope, OwnerRecord)> {
    let owner = OwnerKey::from_seed(Digest::of(format!("owner {seed} {}", number % 1000)).as_bytes());
    let (scene, head) = (scene(number), registry.head()?);
    let mut listed: Vec<_> = (0..views).map(|i| photograph(&scene, (number * 7 + i) % PHOTOGRAPHS)).collect();
    listed.sort_unstable();
    let record = OwnerRecord {
        version: record::VERSION,
        kind: RecordKind::Contribution,
        origin: ORIGIN.into(),
        scene_salt: Digest::of(format!("salt {seed} {number}")),
        identity: Identity::numbered(1, &format!("contributor {}", number % 1000)),
        owner_key: owner.public(),
        digests: Digests { photographs: Some(photographs_root(&listed)), ..Digests::default() },
        seed: None,
        purpose: "credit for the photographs".into(),
        nonce: registry.nonce(&scene, &owner.public())?,
        seen: Seen { size: head.size, root: head.root },
        replaces: None,
        views: Some(listed),
        scene,
    };
    Ok((record.seal(&owner)?, record))
}

/// A made-up entry: its leaf, and the keys of its scene and of `views` photographs.
pub fn entry(seed: u64, number: u64, views: u64) -> (Leaf, Vec<MapKey>) {
    let scene = scene(number);
    let part = |what: &str| Digest::of(format!("{what} {seed} {number}"));
    let mut signature = [0; 64];
    signature[..32].copy_from_slice(part("signature").as_bytes());
    let leaf = Leaf {
        kind: RecordKind::Contribution,
        record: part("record"),
        owner: Digest::of(format!("owner {seed} {}", number % 1000)),
        scene: part("scene"),
        signature,
    };
    let photographs = (0..views).map(|i| MapKey::view(&scene, &photograph(&scene, (number * 7 + i) % PHOTOGRAPHS)));
    let mut keys: Vec<_> = photographs.chain([MapKey::scene(&scene)]).collect();
    keys.sort_unstable();
    (leaf, keys)
}
