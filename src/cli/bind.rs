//! `cairn owners bind`: a curator says which key a contributor's name stands for.

use std::path::{Path, PathBuf};

use cairn_log::format::record::{Digests, Identity, VERSION, random_salt};
use cairn_log::{OwnerKey, OwnerRecord, PublicKey, RecordKind};

use super::connect::Connection;
use super::records::{Bundle, Ground};
use super::unlock::UnlockArgs;

/// `cairn owners bind`.
#[derive(Clone, Debug, clap::Args)]
pub struct BindArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    /// The contributor, as the import named them
    #[arg(long, value_name = "NAME", requires = "owner_key", required_unless_present = "from_table")]
    contributor: Option<String>,
    /// The contributor's public key, 64 hexadecimal digits (see `cairn keys show`)
    #[arg(long, value_name = "HEX", requires = "contributor")]
    owner_key: Option<PublicKey>,
    /// Bind every contributor to the key that the table of contributors gives (see `cairn scene show`), each in a bundle
    /// of its own below --out
    #[arg(long, conflicts_with_all = ["contributor", "owner_key"])]
    from_table: bool,
    /// The curator's own key; where the daemon has accounts, that of a curator or operator
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    #[command(flatten)]
    unlock: UnlockArgs,
    /// How the curator knows, in words
    #[arg(long, value_name = "TEXT", default_value = "the contributor is known to the curator")]
    purpose: String,
    /// Where the bundle goes: a new folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Whose name stands for which key.
struct Name<'a> {
    contributor: &'a str,
    key: PublicKey,
}

/// Signs bindings and enters them.
pub async fn run(line: &Connection, args: &BindArgs) -> anyhow::Result<()> {
    Bundle::must_be_new(&args.out)?;
    let key = args.unlock.load(&args.key)?;
    let (scene, shown) = (&args.name, super::scene::get(line, &args.name).await?);
    if args.from_table {
        let keys = super::scene::keys(&shown)?;
        anyhow::ensure!(
            !keys.is_empty(),
            "the table of contributors of scene {scene:?} has no keys; name one (--contributor, --owner-key)"
        );
        for (number, (contributor, owner)) in (1..).zip(keys) {
            let out = args.out.join(number.to_string());
            bind(line, args, &Name { contributor: &contributor, key: owner }, &key, &out).await?;
        }
        return Ok(());
    }
    let (Some(contributor), Some(owner)) = (&args.contributor, args.owner_key) else {
        anyhow::bail!("give --contributor and --owner-key, or --from-table");
    };
    anyhow::ensure!(
        shown.views.iter().any(|view| view.contributor == *contributor),
        "scene {scene:?} has no photograph by {contributor:?}; `cairn scene show {scene}` names who took them"
    );
    bind(line, args, &Name { contributor, key: owner }, &key, &args.out).await
}

async fn bind(
    line: &Connection,
    args: &BindArgs,
    name: &Name<'_>,
    curator: &OwnerKey,
    out: &Path,
) -> anyhow::Result<()> {
    let bundle = Bundle::begin(out)?;
    let ground = Ground::ask(line, &args.name, &curator.public()).await?;
    let record = OwnerRecord {
        version: VERSION,
        kind: RecordKind::Binding,
        origin: ground.origin,
        scene: args.name.clone(),
        scene_salt: random_salt()?,
        identity: Identity { key: Some(name.key), ..Identity::named(name.contributor) },
        owner_key: curator.public(),
        digests: Digests::default(),
        seed: None,
        purpose: args.purpose.clone(),
        nonce: ground.nonce,
        seen: ground.seen,
        replaces: None,
        views: None,
    };
    let place = bundle.enter(line, &record, &[curator], &[]).await?;
    println!("{place}: {:?} stands for key {}; its bundle is in {}", name.contributor, name.key, out.display());
    Ok(())
}
