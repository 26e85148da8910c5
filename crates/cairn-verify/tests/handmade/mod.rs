//! A log made by hand, from the formats alone: written as a data folder, or served from
//! memory. Its map is computed word for word by the definition, which the audit's is not.
#![allow(dead_code)] // The daemon's tests use a part of this.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use cairn_log::format::{
    Checkpoint, Digest, Envelope, Leaf, NoteVerifier, OwnerKey, OwnerRecord, RecordKind,
    dsse::pae,
    leaf::LEAF_LEN,
    merkle::{self, leaf_hash},
    record::{self, Digests, Identity, Seen, photographs_root},
    testing::Tree,
    tile::{TileKind, TilePath, encode_entries},
};

pub const ORIGIN: &str = "cairn.example/log";

pub fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

/// A log that grows batch by batch.
#[derive(Clone)]
pub struct Log {
    pub origin: String,
    pub signer: OwnerKey,
    /// Leaves, 162 bytes each.
    pub entries: Vec<Vec<u8>>,
    /// Slots, as `envelopes/` has them.
    pub slots: Vec<Vec<u8>>,
    pub tree: Tree,
    /// Sizes at which a checkpoint was signed.
    pub sizes: Vec<u64>,
    map: BTreeMap<[u8; 32], Vec<(u64, Digest)>>,
}

impl Default for Log {
    fn default() -> Self {
        Self {
            origin: ORIGIN.into(),
            signer: key(200),
            entries: vec![],
            slots: vec![],
            tree: Tree::new(),
            sizes: vec![],
            map: BTreeMap::new(),
        }
    }
}

impl Log {
    /// Three batches: claims of two owners, a rotation, a dispute, a revocation, and one record erased.
    pub fn small() -> Self {
        let mut log = Self::default();
        let first = log.add(&log.record(RecordKind::Claim, 1, "liberty"), &[]);
        let other = log.add(&log.record(RecordKind::Contribution, 2, "town"), &[]);
        log.end_batch();
        let mut rotation = log.record(RecordKind::Rotation, 3, "liberty");
        rotation.replaces = Some(first);
        log.add(&rotation, &[1]);
        let mut dispute = log.record(RecordKind::Dispute, 4, "town");
        dispute.replaces = Some(other);
        log.add(&dispute, &[]);
        log.end_batch();
        log.add(&log.record(RecordKind::Revocation, 2, "town"), &[]);
        log.end_batch();
        log.erase(1);
        log
    }

    /// Two batches, three records: one replaced, one erased, one signed by three keys.
    pub fn tiny() -> Self {
        let mut log = Self::default();
        let first = log.add(&log.record(RecordKind::Contribution, 1, "a"), &[]);
        log.add(&log.record(RecordKind::Contribution, 2, "b"), &[]);
        log.end_batch();
        let mut rotation = log.record(RecordKind::Rotation, 3, "a");
        rotation.replaces = Some(first);
        log.add(&rotation, &[1]);
        log.end_batch();
        log.erase(1);
        log
    }

    pub fn verifier(&self) -> NoteVerifier {
        NoteVerifier::new(&self.origin, self.signer.public()).unwrap()
    }

    pub fn size(&self) -> u64 {
        self.tree.size()
    }

    /// A record as this log takes it now.
    pub fn record(&self, kind: RecordKind, owner: u8, scene: &str) -> OwnerRecord {
        let size = self.sizes.last().copied().unwrap_or(0);
        let mut views = ["one", "two"].map(|v| Digest::of(format!("{scene} {v}"))).to_vec();
        views.sort_unstable();
        OwnerRecord {
            version: record::VERSION,
            kind,
            origin: self.origin.clone(),
            scene: scene.into(),
            scene_salt: Digest::of(self.size().to_be_bytes()),
            identity: Identity::numbered(1, "Ada"),
            owner_key: key(owner).public(),
            digests: Digests {
                marked_field: Some(Digest::of("field")),
                detector: Some(Digest::of("detector")),
                hidden_signal: Some(Digest::of("signal")),
                photographs: Some(photographs_root(&views)),
                base_field: None,
                share_table: None,
                training_configuration: None,
            },
            seed: None,
            purpose: "credit".into(),
            nonce: Digest::of(self.size().to_be_bytes()),
            seen: Seen { size, root: self.tree.root_at(size).unwrap() },
            replaces: None,
            views: Some(views),
        }
    }

    /// Seals and appends a record, with signatures of `also` between owner and registry; its digest.
    pub fn add(&mut self, record: &OwnerRecord, also: &[u8]) -> Digest {
        let owner = (1..=255).map(key).find(|key| key.public() == record.owner_key).unwrap();
        let mut envelope = record.seal(&owner).unwrap();
        also.iter().for_each(|other| envelope.sign(&key(*other)));
        envelope.sign(&self.signer);
        self.add_sealed(record, &envelope);
        envelope.digest()
    }

    /// Appends a record as it is sealed, whatever a registry would say.
    pub fn add_sealed(&mut self, record: &OwnerRecord, envelope: &Envelope) {
        let leaf = Leaf::of(envelope).unwrap();
        let (index, hash) = (self.size(), leaf.hash());
        for key in self.keys_of(record) {
            self.map.entry(key).or_default().push((index, hash));
        }
        self.push(leaf.encode().to_vec(), [&[1], envelope.to_json().as_bytes()].concat());
    }

    pub fn push(&mut self, entry: Vec<u8>, slot: Vec<u8>) {
        self.tree.push(leaf_hash(&entry));
        self.entries.push(entry);
        self.slots.push(slot);
    }

    /// Appends the map leaf and counts as signed what is there.
    pub fn end_batch(&mut self) {
        let root = by_definition(&self.map.iter().collect::<Vec<_>>(), 0);
        self.push_map_leaf(root);
    }

    /// Appends a map leaf with a root of one's own.
    pub fn push_map_leaf(&mut self, root: Digest) {
        let statement = format!(
            r#"{{"version":1,"kind":"map","origin":"{}","size":{},"root":"{root}"}}"#,
            self.origin,
            self.size()
        );
        let signed = pae("application/vnd.cairn.map-root.v1+json", statement.as_bytes());
        let mut entry = vec![1, 7];
        entry.extend_from_slice(Digest::of(&signed).as_bytes());
        entry.extend_from_slice(self.signer.public().id().as_bytes());
        entry.extend_from_slice(root.as_bytes());
        entry.extend_from_slice(&self.signer.sign(&signed));
        assert_eq!(entry.len(), LEAF_LEN);
        self.push(entry, vec![]);
        self.sizes.push(self.size());
    }

    fn keys_of(&self, record: &OwnerRecord) -> BTreeSet<[u8; 32]> {
        let field = |bytes: &[u8]| [&(bytes.len() as u64).to_be_bytes()[..], bytes].concat();
        let key = |label: &str, fields: Vec<u8>| *Digest::of([label.as_bytes(), &[0], &fields].concat()).as_bytes();
        let scene = field(record.scene.as_bytes());
        let mut keys = BTreeSet::from([key("cairn map scene v1", scene.clone())]);
        for view in record.views.iter().flatten() {
            keys.insert(key("cairn map view v1", [scene.clone(), field(view.as_bytes())].concat()));
        }
        let named = [scene.clone(), field(record.identity.contributor.as_bytes())].concat();
        if matches!(record.kind, RecordKind::Claim | RecordKind::Contribution) {
            keys.insert(key("cairn map contributor v1", named));
        } else if record.kind == RecordKind::Binding {
            keys.insert(key("cairn map binding v1", named));
        }
        if record.kind == RecordKind::Revocation {
            keys.insert(key("cairn map ended v1", field(record.owner_key.id().as_bytes())));
        }
        if let Some(replaces) = record.replaces {
            keys.insert(key("cairn map about v1", field(replaces.as_bytes())));
            if record.kind == RecordKind::Rotation {
                let leaf = self.entries.iter().filter_map(|e| Leaf::decode(e).ok()).find(|l| l.record == replaces);
                keys.insert(key("cairn map ended v1", field(leaf.unwrap().owner.as_bytes())));
            }
        }
        keys
    }

    /// Leaves only the map keys of record `index`.
    pub fn erase(&mut self, index: usize) {
        let hash = leaf_hash(&self.entries[index]);
        let keys = self.map.iter().filter(|(_, entries)| entries.contains(&(index as u64, hash)));
        self.slots[index] = keys.fold(vec![2], |slot, (key, _)| [&slot[..], key].concat());
    }

    /// The signed checkpoint at a size.
    pub fn checkpoint(&self, size: u64) -> String {
        let root = self.tree.root_at(size).unwrap();
        Checkpoint::new(self.origin.clone(), size, root).sign(&self.signer).unwrap().to_string()
    }

    /// The bytes at a path below `public/`, as they are at a size.
    pub fn file(&self, path: &str, size: u64) -> Option<Vec<u8>> {
        if path == "checkpoint" {
            return Some(self.checkpoint(size).into_bytes());
        }
        let tile: TilePath = path.parse().ok()?;
        match tile.kind {
            TileKind::Hashes(_) => tile.cut(&self.tree, size),
            TileKind::Entries => {
                let first = tile.first()? as usize;
                let entries = self.entries[..size as usize].get(first..first + usize::from(tile.width))?;
                encode_entries(entries.iter().map(Vec::as_slice)).ok()
            }
        }
    }

    /// Writes the data folder as the registry would have, stale partial tiles included.
    pub fn write(&self, dir: &Path) {
        let public = dir.join("registry/public");
        for size in &self.sizes {
            let bundles = (0..size.div_ceil(256)).filter_map(|i| TilePath::in_tree(TileKind::Entries, i, *size));
            for tile in TilePath::all(*size).chain(bundles) {
                put(&public.join(tile.to_string()), &self.file(&tile.to_string(), *size).unwrap());
            }
            put(&public.join("checkpoint"), self.checkpoint(*size).as_bytes());
        }
        for (index, slots) in (0..).zip(self.slots.chunks(256)) {
            let path = TilePath { kind: TileKind::Entries, index, width: 256 }.to_string();
            let path = path.replace("tile/entries", "registry/envelopes");
            put(&dir.join(path), &slots.iter().flat_map(|slot| frame(slot)).collect::<Vec<_>>());
        }
        put(&dir.join("registry/working/db"), b"private state");
        put(&dir.join("registry/working/blobs/1"), b"more of it");
        seal(&dir.join("registry"), &["working/blobs/1", "working/db"], &dir.join("registry/working.seal"));
    }
}

pub fn frame(slot: &[u8]) -> Vec<u8> {
    [&(slot.len() as u32).to_be_bytes()[..], slot].concat()
}

pub fn put(path: &Path, bytes: &[u8]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

/// Writes a manifest of `paths` in `folder`.
pub fn seal(folder: &Path, paths: &[&str], to: &Path) {
    let row = |path: &&str| {
        let bytes = std::fs::read(folder.join(path)).unwrap();
        format!(r#"{{"path":"{path}","size":{},"sha256":"{}"}}"#, bytes.len(), Digest::of(&bytes))
    };
    let rows: Vec<String> = paths.iter().map(row).collect();
    put(to, format!(r#"{{"format_version":1,"files":[{}]}}"#, rows.join(",")).as_bytes());
}

type Entries<'a> = (&'a [u8; 32], &'a Vec<(u64, Digest)>);

/// The map's root, word for word.
fn by_definition(map: &[Entries<'_>], depth: usize) -> Digest {
    match map {
        [] => Digest::from_bytes([0; 32]),
        [(key, entries)] => {
            let leaf = |(i, h): &(u64, Digest)| leaf_hash(&[&i.to_be_bytes()[..], h.as_bytes()].concat());
            let value = merkle::root(&entries.iter().map(leaf).collect::<Vec<_>>());
            Digest::of([&[2], &key[..], value.as_bytes()].concat())
        }
        _ => {
            let (left, right): (Vec<_>, Vec<_>) =
                map.iter().partition(|(key, _)| key[depth / 8] >> (7 - depth % 8) & 1 == 0);
            let (left, right) = (by_definition(&left, depth + 1), by_definition(&right, depth + 1));
            Digest::of([&[3], &left.as_bytes()[..], right.as_bytes()].concat())
        }
    }
}
