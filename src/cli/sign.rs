//! `cairn owners sign`: records about a contributor's photographs, or about an identity of a scene's newest model, signed
//! at the owner's side.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1::{self, material_request::Of};
use cairn_log::format::record::{
    Digests, Identity, MAX_VIEWS, SignalFiles, hidden_signal_commitment, photographs_root, random_salt,
};
use cairn_log::keys::{Seal, save_key};
use cairn_log::{Digest, OwnerKey, OwnerRecord, RecordKind};

use super::connect::Connection;
use super::records::{Bundle, Ground, Place, SALT, Stored};
use super::unlock::UnlockArgs;

/// `cairn owners sign`.
#[derive(Clone, Debug, clap::Args)]
pub struct SignArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    pub name: String,
    #[command(flatten)]
    pub about: About,
    /// The owner's key (see `cairn keys new`)
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    #[command(flatten)]
    pub unlock: UnlockArgs,
    /// What the record says
    #[arg(long, value_enum, default_value_t = Kind::Claim)]
    pub kind: Kind,
    /// What the record is for, in words
    #[arg(long, default_value = PURPOSE)]
    pub purpose: String,
    /// Put it in the place of an older record of the same key, or of a key that rotations led from to this one
    #[arg(long, value_name = "INDEX")]
    pub replaces: Option<u64>,
    /// Where the bundle goes: a new folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// What a record is about: exactly one of them.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub struct About {
    /// All photographs of this contributor in the scene that are not excluded; the scene needs no model
    #[arg(long, value_name = "NAME")]
    pub contributor: Option<String>,
    /// The identity, 1 and up (see `cairn scene show`): its cluster's photographs, and its mark
    #[arg(long, value_name = "N")]
    pub identity: Option<u32>,
}

impl About {
    /// An identity.
    pub const fn identity(number: u32) -> Self {
        Self { contributor: None, identity: Some(number) }
    }

    fn asked(&self) -> Option<Of> {
        let contributor = self.contributor.clone().map(Of::Contributor);
        contributor.or(self.identity.map(Of::Identity))
    }
}

const PURPOSE: &str = "credit for the photographs";

/// The records that can be signed here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// The photographs are the owner's, and so is the identity's mark in the marked field
    Claim,
    /// The owner contributed the photographs
    Contribution,
    /// This training made the share table, and the marked field where there is one
    Training,
}

/// Signs a record and enters it.
pub async fn sign(line: &Connection, args: &SignArgs) -> anyhow::Result<Place> {
    Bundle::must_be_new(&args.out)?;
    let key = args.unlock.load(&args.key)?;
    let bundle = Bundle::begin(&args.out)?;
    let replaced = match args.replaces {
        None => None,
        Some(index) => {
            let older = Stored::of_scene(line, &args.name, index).await?;
            older.spoken_for_by(&key)?;
            Some(older.digest)
        }
    };
    let request = v1::MaterialRequest { scene: args.name.clone(), of: args.about.asked() };
    let material = line.about(&args.name).owners().material(request).await?.into_inner();
    must_be_there(args, &material)?;
    let ground = Ground::ask(line, &args.name, &key.public()).await?;
    let salt = random_salt()?;
    let record = OwnerRecord { replaces: replaced, ..record(args, &key, &material, ground, &salt)? };
    let (files, salt) = (signal_files(&material), format!("{salt}\n"));
    let mut secrets = Vec::new();
    if record.digests.hidden_signal.is_some() {
        secrets = vec![("signal.png", files.picture), ("signal.wav", files.audio), ("signal.txt", files.text)];
        secrets.retain(|(_, bytes)| !bytes.is_empty());
        secrets.push((SALT, salt.as_bytes()));
    }
    bundle.enter(line, &record, &[&key], &secrets).await
}

/// Refuses a record about what the scene has not.
fn must_be_there(args: &SignArgs, material: &v1::MaterialResponse) -> anyhow::Result<()> {
    let scene = &args.name;
    anyhow::ensure!(
        args.kind != Kind::Training || !material.settings_sha256.is_empty(),
        "scene {scene:?} has no model yet; train it first"
    );
    let claims_a_mark = args.kind == Kind::Claim && args.about.identity.is_some();
    anyhow::ensure!(
        !claims_a_mark || !material.marked_field_sha256.is_empty(),
        "scene {scene:?} has a base field alone, and no mark to claim; claim the photographs instead (--contributor {:?}), or \
         train the scene with marks",
        material.label
    );
    Ok(())
}

fn record(
    args: &SignArgs,
    key: &OwnerKey,
    material: &v1::MaterialResponse,
    ground: Ground,
    salt: &Digest,
) -> anyhow::Result<OwnerRecord> {
    let kind = match args.kind {
        Kind::Claim => RecordKind::Claim,
        Kind::Contribution => RecordKind::Contribution,
        Kind::Training => RecordKind::Training,
    };
    let photographs = photographs(material)?;
    let of_photographs = matches!(args.kind, Kind::Claim | Kind::Contribution);
    Ok(OwnerRecord {
        version: cairn_log::format::record::VERSION,
        kind,
        origin: ground.origin,
        scene: args.name.clone(),
        scene_salt: random_salt()?,
        identity: Identity { number: args.about.identity, ..Identity::named(&material.label) },
        owner_key: key.public(),
        digests: digests(args, material, &photographs, salt)?,
        seed: (kind == RecordKind::Training || args.about.identity.is_some()).then_some(material.seed),
        purpose: args.purpose.clone(),
        nonce: ground.nonce,
        seen: ground.seen,
        replaces: None,
        views: if of_photographs { views(&photographs) } else { None },
    })
}

/// The photographs one by one, so that the record answers for single views; `None`, and a note, where the format has no
/// room for them.
fn views(photographs: &[Digest]) -> Option<Vec<Digest>> {
    let mut views = photographs.to_vec();
    views.sort_unstable();
    views.dedup();
    let why = if views.len() > MAX_VIEWS {
        format!("{} photographs, at most {MAX_VIEWS} are listed", views.len())
    } else if views.len() < photographs.len() {
        "some photographs are the same file".to_owned()
    } else if views.is_empty() {
        "no photographs".to_owned()
    } else {
        return Some(views);
    };
    eprintln!("note: the record lists no single views ({why}); it still binds all photographs by their root");
    None
}

fn photographs(material: &v1::MaterialResponse) -> anyhow::Result<Vec<Digest>> {
    let one = |bytes: &[u8]| digest("a photograph", bytes)?.context("the daemon's digest of a photograph is empty");
    material.photograph_sha256.iter().map(|bytes| one(bytes)).collect()
}

fn signal_files(material: &v1::MaterialResponse) -> SignalFiles<'_> {
    SignalFiles { picture: &material.signal, audio: &material.audio, text: material.text.as_bytes() }
}

/// Of a training all that it made, of an identity its mark and photographs, of a contributor the photographs.
fn digests(
    args: &SignArgs,
    material: &v1::MaterialResponse,
    photographs: &[Digest],
    salt: &Digest,
) -> anyhow::Result<Digests> {
    let photographs = Some(photographs_root(photographs));
    let is_training = args.kind == Kind::Training;
    if !is_training && args.about.identity.is_none() {
        return Ok(Digests { photographs, ..Digests::default() });
    }
    let signal = signal_files(material);
    let of_training = |what: &str, bytes: &[u8]| if is_training { digest(what, bytes) } else { anyhow::Ok(None) };
    Ok(Digests {
        marked_field: digest("the marked field", &material.marked_field_sha256)?,
        detector: digest("the detector", &material.detector_sha256)?,
        hidden_signal: (!signal.is_empty()).then(|| hidden_signal_commitment(salt, &signal)),
        photographs,
        base_field: of_training("the base field", &material.base_field_sha256)?,
        share_table: of_training("the share table", &material.share_table_sha256)?,
        training_configuration: digest("the settings", &material.settings_sha256)?,
    })
}

/// A digest from the daemon; `None` where it has none.
fn digest(what: &str, bytes: &[u8]) -> anyhow::Result<Option<Digest>> {
    if bytes.is_empty() {
        return Ok(None);
    }
    let bytes = bytes.try_into().with_context(|| format!("the daemon's digest of {what} is not 32 bytes"))?;
    Ok(Some(Digest::from_bytes(bytes)))
}

/// A record that [`sign_all`] signed.
pub struct Signed {
    /// The identity's number.
    pub identity: u32,
    /// The record's place in the log.
    pub index: u64,
    /// The bundle's folder.
    pub bundle: PathBuf,
}

/// Makes a key for every identity of the scene's model and signs a record with it: `FOLDER/<number>.key`, plain, and the
/// bundle `FOLDER/<number>`. For trying things out: in earnest every owner makes their own key where they are, sealed.
pub async fn sign_all(line: &Connection, scene: &str, folder: &Path) -> anyhow::Result<Vec<Signed>> {
    let model = super::scene::get(line, scene).await?.model.context("the scene has no model yet; train it first")?;
    std::fs::create_dir(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let kind = if model.marked_field_sha256.is_empty() { Kind::Contribution } else { Kind::Claim };
    let mut signed = Vec::with_capacity(model.identities.len());
    for identity in &model.identities {
        let key = folder.join(format!("{}.key", identity.number));
        save_key(&key, &OwnerKey::generate()?, &Seal::Plain)?;
        let args = SignArgs {
            name: scene.to_owned(),
            about: About::identity(identity.number),
            key,
            unlock: UnlockArgs::default(),
            kind,
            purpose: PURPOSE.to_owned(),
            replaces: None,
            out: folder.join(identity.number.to_string()),
        };
        let place = sign(line, &args).await?;
        signed.push(Signed { identity: identity.number, index: place.index, bundle: args.out });
    }
    Ok(signed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_listed_as_the_format_wants_them_or_not_at_all() {
        let some = [Digest::of("b"), Digest::of("a"), Digest::of("c")];
        let listed = views(&some).unwrap();
        assert!(listed.is_sorted() && listed.len() == 3);
        assert_eq!(photographs_root(&listed), photographs_root(&some));
        // A photograph twice changes the root: listed once, the record would be refused.
        assert_eq!(views(&[some[0], some[1], some[0]]), None);
        assert_eq!(views(&[]), None);
        let many: Vec<Digest> = (0..=MAX_VIEWS).map(|i| Digest::of(i.to_string())).collect();
        assert_eq!(views(&many), None);
        assert_eq!(views(&many[1..]).map(|v| v.len()), Some(MAX_VIEWS));
    }
}
