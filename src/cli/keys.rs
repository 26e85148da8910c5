//! `cairn keys`: owners' keys, which never leave this machine, from making to ending them.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_log::{OwnerKey, OwnerRecord, RecordKind};
use cairn_log::{
    format::sealed::SealingKey,
    keys::{Seal, StoredKey, reseal_key, save_key, save_sealing_key},
};

use super::connect::Connection;
use super::json::{self, Json};
use super::records::{self, Bundle, Ground, Stored};
use super::unlock::UnlockArgs;

/// What to do with keys.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Make a new Ed25519 key, sealed by a passphrase (asked for) unless told otherwise
    #[command(after_help = "Example:\n  cairn keys new ada.key")]
    New {
        /// Where it goes; a file that is there is never replaced
        file: PathBuf,
        /// Leave it unsealed: every reader of the file has the key
        #[arg(long, conflicts_with_all = ["passphrase_file", "key_file"])]
        plain: bool,
        #[command(flatten)]
        seal: UnlockArgs,
    },
    /// Show the public half; needs no passphrase
    #[command(after_help = "Example:\n  cairn keys show ada.key")]
    Show {
        /// The key's file
        file: PathBuf,
        #[command(flatten)]
        json: Json,
    },
    /// Make a key file: 32 random bytes to seal keys with where no person is there to type a
    /// passphrase
    #[command(after_help = "Example:\n  cairn keys new-key-file sealing.key")]
    NewKeyFile {
        /// Where it goes; keep it apart from the keys that it seals
        file: PathBuf,
    },
    /// Seal a plain key, or give a sealed one another passphrase or key file
    #[command(after_help = "Example:\n  cairn keys seal ada.key")]
    Seal(SealArgs),
    /// Go on under a new key: a record signed by both says so, and ends the old one
    #[command(
        after_help = "Example:\n  cairn keys rotate liberty --record 2 --key ada.key --new-key ada-2.key --out rotation"
    )]
    Rotate(RotateArgs),
    /// End a key, because it may be in other hands; records before this stay good
    #[command(after_help = "Example:\n  cairn keys revoke liberty --key ada-2.key --purpose stolen --out revocation")]
    Revoke(RevokeArgs),
}

/// `cairn keys seal`.
#[derive(Debug, clap::Args)]
pub struct SealArgs {
    /// The key's file, replaced at one stroke
    pub file: PathBuf,
    #[command(flatten)]
    pub seal: UnlockArgs,
    /// The file with the passphrase that it has now; without it that is asked for
    #[arg(long, value_name = "FILE", conflicts_with = "old_key_file")]
    pub old_passphrase_file: Option<PathBuf>,
    /// The key file that it is sealed with now
    #[arg(long, value_name = "FILE")]
    pub old_key_file: Option<PathBuf>,
}

/// `cairn keys rotate`.
#[derive(Debug, clap::Args)]
pub struct RotateArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    pub name: String,
    /// The record to go on with under the new key (see `cairn owners list`)
    #[arg(long, value_name = "INDEX")]
    pub record: u64,
    /// The key that it belongs to
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// The key that takes its place, made before by `cairn keys new`
    #[arg(long, value_name = "FILE")]
    pub new_key: PathBuf,
    #[command(flatten)]
    pub unlock: UnlockArgs,
    /// The file with the new key's passphrase, where it has another than the old one
    #[arg(long, value_name = "FILE", conflicts_with = "new_key_file")]
    pub new_passphrase_file: Option<PathBuf>,
    /// The key file that the new key is sealed with, where it is another
    #[arg(long, value_name = "FILE")]
    pub new_key_file: Option<PathBuf>,
    /// What the record is for, in words
    #[arg(long, default_value = "goes on under a new key")]
    pub purpose: String,
    /// Where the bundle goes: a new folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// `cairn keys revoke`.
#[derive(Debug, clap::Args)]
pub struct RevokeArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    pub name: String,
    /// The key to end
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    #[command(flatten)]
    pub unlock: UnlockArgs,
    /// Also take back this record of the key
    #[arg(long, value_name = "INDEX")]
    pub record: Option<u64>,
    /// Why, in words
    #[arg(long, value_name = "TEXT")]
    pub purpose: String,
    /// Where the bundle goes: a new folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

impl Command {
    /// Whether it needs nothing but files of this machine.
    pub const fn is_local(&self) -> bool {
        !matches!(self, Self::Rotate(_) | Self::Revoke(_))
    }
}

/// Answers the commands that need no registry.
pub fn local(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::New { file, plain, seal } => new(file, *plain, seal),
        Command::Show { file, json } => {
            let key = StoredKey::read(file)?;
            if json.json {
                return json::print_value(&serde_json::json!({
                    "public_key": key.public().to_string(),
                    "key_id": key.public().id().to_string(),
                    "sealed_by": key.sealed_by().map(|by| by.to_string()),
                }));
            }
            show(&key);
            Ok(())
        }
        Command::NewKeyFile { file } => {
            save_sealing_key(file, &SealingKey::generate()?)?;
            println!("new key file {}; keep it apart from the keys that it seals, and a copy of it", file.display());
            Ok(())
        }
        Command::Seal(args) => seal(args),
        Command::Rotate(_) | Command::Revoke(_) => Ok(()),
    }
}

/// Answers the commands that enter a record.
pub async fn run(line: &Connection, command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Rotate(args) => rotate(line, args).await,
        Command::Revoke(args) => revoke(line, args).await,
        Command::New { .. } | Command::Show { .. } | Command::NewKeyFile { .. } | Command::Seal(_) => local(command),
    }
}

fn new(file: &Path, plain: bool, seal: &UnlockArgs) -> anyhow::Result<()> {
    // Before a passphrase is typed for nothing.
    anyhow::ensure!(!file.exists(), "{}: exists already and is not overwritten; move it away first", file.display());
    let seal = if plain { Seal::Plain } else { seal.seal(file)? };
    let key = OwnerKey::generate()?;
    save_key(file, &key, &seal)?;
    println!("new key in {}; keep it safe, since it cannot be made again", file.display());
    match seal {
        Seal::Plain => {
            println!("it is not sealed: every reader of the file has the key (`cairn keys seal` mends that)")
        }
        Seal::Passphrase(_) => println!("it is sealed by its passphrase, without which it is lost"),
        Seal::KeyFile(_) => println!("it is sealed by the key file, without which it is lost"),
    }
    show(&StoredKey::read(file)?);
    Ok(())
}

fn show(key: &StoredKey) {
    println!("public key {}", key.public());
    println!("key id     {}", key.public().id());
    match key.sealed_by() {
        Some(by) => println!("sealed by  {by}"),
        None => println!("sealed by  nothing"),
    }
}

fn seal(args: &SealArgs) -> anyhow::Result<()> {
    let was_sealed = StoredKey::read(&args.file)?.sealed_by().is_some();
    let old = UnlockArgs { passphrase_file: args.old_passphrase_file.clone(), key_file: args.old_key_file.clone() };
    let key = old.load(&args.file)?;
    reseal_key(&args.file, &key, &args.seal.seal(&args.file)?)?;
    println!("sealed {} anew", args.file.display());
    if !was_sealed {
        println!(
            "backups, and the disk's unused blocks, may still hold the plain key; to be sure, rotate to a new one"
        );
    }
    show(&StoredKey::read(&args.file)?);
    Ok(())
}

async fn rotate(line: &Connection, args: &RotateArgs) -> anyhow::Result<()> {
    Bundle::must_be_new(&args.out)?;
    let old = args.unlock.load(&args.key)?;
    let of_new = match (&args.new_passphrase_file, &args.new_key_file) {
        (None, None) => args.unlock.clone(),
        (passphrase, key) => UnlockArgs { passphrase_file: passphrase.clone(), key_file: key.clone() },
    };
    let new = of_new.load(&args.new_key)?;
    let bundle = Bundle::begin(&args.out)?;
    let earlier = Stored::of_scene(line, &args.name, args.record).await?;
    earlier.belongs_to(&old)?;
    let ground = Ground::ask(line, &args.name, &new.public()).await?;
    // It binds what the earlier record binds, so that an answer about these photographs lists it. It credits nobody: the
    // earlier record goes on to credit, and the new key speaks for it.
    let record = OwnerRecord {
        kind: RecordKind::Rotation,
        replaces: Some(earlier.digest),
        ..ground.anew(&earlier, &new, &args.purpose)?
    };
    let index = bundle.enter(line, &record, &[&new, &old], &[]).await?.index;
    println!("record {index}: key {} took the place of {}", new.public(), old.public());
    println!("the old key signs no further records; the bundle is in {}", args.out.display());
    Ok(())
}

async fn revoke(line: &Connection, args: &RevokeArgs) -> anyhow::Result<()> {
    Bundle::must_be_new(&args.out)?;
    let key = args.unlock.load(&args.key)?;
    let bundle = Bundle::begin(&args.out)?;
    let about = match args.record {
        Some(index) => index,
        None => newest_of(line, &args.name, &key).await?,
    };
    let earlier = Stored::of_scene(line, &args.name, about).await?;
    if args.record.is_some() {
        earlier.spoken_for_by(&key)?;
    }
    let ground = Ground::ask(line, &args.name, &key.public()).await?;
    let mut record = ground.about(&earlier, RecordKind::Revocation, &key, &args.purpose)?;
    record.replaces = args.record.and(record.replaces);
    let index = bundle.enter(line, &record, &[&key], &[]).await?.index;
    println!("record {index}: key {} is good no longer; its records before this one are", key.public());
    if let Some(index) = args.record {
        println!("record {index} is taken back");
    }
    println!("the bundle is in {}", args.out.display());
    Ok(())
}

/// The newest record of a key about a scene: a revocation names an identity, and this one's it takes.
async fn newest_of(line: &Connection, scene: &str, key: &OwnerKey) -> anyhow::Result<u64> {
    let records = records::list(line, scene).await?;
    let id = key.public().id();
    let own = |r: &&v1::Record| r.owner_key_sha256.as_ref() == id.as_bytes() && !r.envelope.is_empty();
    let newest = records.iter().rev().find(own).map(|r| r.index);
    newest
        .with_context(|| format!("key {} has no record about scene {scene:?}; name a scene where it has", key.public()))
}
