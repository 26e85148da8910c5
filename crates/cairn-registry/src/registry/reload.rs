//! Reading the store: at the start all of it that the root rests on, later single records.

use super::{RegistryError, State, StoredRecord, layout};
use crate::{
    checkpoint::Checkpoint,
    digest::Digest,
    dsse::Envelope,
    keys::OwnerKey,
    leaf::{LEAF_LEN, Leaf},
    merkle::{Tree, leaf_hash},
    note::check_name,
    record::OwnerRecord,
    store::Store,
};

/// Leaves read at a time.
const PAGE: usize = 4096;

/// Reads the log and refuses it where it contradicts what was signed; makes an empty one in an empty store.
pub(super) fn reload(store: &dyn Store, key: &OwnerKey, origin: &str) -> Result<State, RegistryError> {
    check_name(origin)?;
    match store.get(layout::FORMAT)? {
        Some(format) => {
            expect("format", layout::FORMAT_VERSION, Some(format))?;
            expect("origin", origin, store.get(layout::ORIGIN)?)?;
            expect("registry key", &key.public().to_string(), store.get(layout::REGISTRY_KEY)?)?;
        }
        None => create(store, key, origin)?,
    }
    let tree = read_leaves(store)?;
    let (size, root) = (tree.size(), tree.root());
    let signed = store.get(layout::SIGNED)?.as_deref().and_then(layout::parse_signed);
    let Some((signed_size, signed_root)) = signed else {
        return Err(inconsistent("last signed checkpoint", "missing or not 40 bytes".into()));
    };
    if signed_size > size {
        let what = format!("{size} leaves, a checkpoint over {signed_size} was signed");
        return Err(inconsistent("leaves", what));
    }
    let root_then = tree.root_at(signed_size)?;
    if root_then != signed_root {
        let what = format!("root over the first {signed_size} is {root_then}, {signed_root} was signed");
        return Err(inconsistent("leaves", what));
    }
    if signed_size != size {
        store.put(vec![(layout::SIGNED.to_vec(), layout::signed(size, &root))])?;
    }
    // Also where nothing changed: what was read may be written and not yet durable.
    store.flush()?;
    let checkpoint = Checkpoint::new(origin, size, root).sign(key)?.to_string();
    Ok(State { tree, size, checkpoint, halted: None })
}

fn create(store: &dyn Store, key: &OwnerKey, origin: &str) -> Result<(), RegistryError> {
    if let Some((key, _)) = store.scan(&[], &[], 1)?.first() {
        let what = format!("begins with {key:?}, but no format version is there");
        return Err(inconsistent("first entry", what));
    }
    let empty = Tree::new().root();
    store.put(vec![
        (layout::FORMAT.to_vec(), layout::FORMAT_VERSION.into()),
        (layout::ORIGIN.to_vec(), origin.into()),
        (layout::REGISTRY_KEY.to_vec(), key.public().to_string().into()),
        (layout::SIGNED.to_vec(), layout::signed(0, &empty)),
    ])?;
    store.flush()?;
    Ok(())
}

fn read_leaves(store: &dyn Store) -> Result<Tree, RegistryError> {
    let mut tree = Tree::new();
    loop {
        let page = store.scan(layout::LEAVES, &tree.size().to_be_bytes(), PAGE)?;
        if page.is_empty() {
            return Ok(tree);
        }
        for (key, leaf) in page {
            let index = key.strip_prefix(layout::LEAVES).and_then(layout::number);
            if index != Some(tree.size()) {
                return Err(inconsistent(&format!("leaf {}", tree.size()), format!("missing, {index:?} follows")));
            }
            if leaf.len() != LEAF_LEN {
                let what = format!("{} bytes, expected {LEAF_LEN}", leaf.len());
                return Err(inconsistent(&format!("leaf {}", tree.size()), what));
            }
            tree.push(leaf_hash(&leaf));
        }
    }
}

/// `count` leaves from `first` on, which must be there.
pub(super) fn leaves(store: &dyn Store, first: u64, count: usize) -> Result<Vec<Vec<u8>>, RegistryError> {
    let entries = store.scan(layout::LEAVES, &first.to_be_bytes(), count)?;
    let leaves: Vec<_> =
        (first..).zip(entries).map_while(|(index, (key, leaf))| (key == layout::leaf(index)).then_some(leaf)).collect();
    if leaves.len() != count {
        return Err(inconsistent(&format!("leaf {}", first + leaves.len() as u64), "missing".into()));
    }
    Ok(leaves)
}

/// Record `index` with everything that one record can tell about itself verified.
pub(super) fn stored(store: &dyn Store, index: u64) -> Result<StoredRecord, RegistryError> {
    let place = format!("record {index}");
    let bytes = store.get(&layout::leaf(index))?.ok_or_else(|| inconsistent(&place, "its leaf is missing".into()))?;
    let leaf = Leaf::decode(&bytes).map_err(|e| inconsistent(&place, e.to_string()))?;
    let json = store.get(&layout::envelope(&leaf.record))?;
    let json = json.ok_or_else(|| inconsistent(&place, "its envelope is missing".into()))?;
    let envelope = Envelope::parse(&json).map_err(|e| inconsistent(&place, e.to_string()))?;
    let opened = OwnerRecord::open(&envelope).and_then(|(record, signature)| {
        let again = Leaf::of_opened(&envelope, &record, &signature.sig)?;
        Ok((record, again))
    });
    let (record, again) = opened.map_err(|e| inconsistent(&place, e.to_string()))?;
    if again != leaf {
        return Err(inconsistent(&place, "the leaf is not this envelope's".into()));
    }
    Ok(StoredRecord { index, leaf, envelope, record })
}

pub(super) fn index_of(store: &dyn Store, record: &Digest) -> Result<Option<u64>, RegistryError> {
    number_at(store, &layout::index_of(record), || format!("index of {record}"))
}

pub(super) fn number_at(
    store: &dyn Store,
    key: &[u8],
    place: impl Fn() -> String,
) -> Result<Option<u64>, RegistryError> {
    let Some(bytes) = store.get(key)? else { return Ok(None) };
    match layout::number(&bytes) {
        Some(number) => Ok(Some(number)),
        None => Err(inconsistent(&place(), format!("{} bytes, expected 8", bytes.len()))),
    }
}

fn expect(what: &'static str, expected: &str, got: Option<Vec<u8>>) -> Result<(), RegistryError> {
    let got = String::from_utf8_lossy(&got.unwrap_or_default()).into_owned();
    if got == expected {
        return Ok(());
    }
    Err(RegistryError::WrongStore { what, expected: expected.to_owned(), got })
}

pub(super) fn inconsistent(place: &str, what: String) -> RegistryError {
    RegistryError::Inconsistent { place: place.to_owned(), what }
}
