//! `cairn owners bind`: a curator says which key a contributor's name stands for.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_log::format::record::{Digests, Identity, VERSION, random_salt};
use cairn_log::{OwnerKey, OwnerRecord, PublicKey, RecordKind, SignedRecord};

use super::connect::Connection;
use super::records::{self, Bundle, Ground};
use super::unlock::UnlockArgs;

/// What a binding says where its curator gives no purpose.
const FROM_CURATOR: &str = "the curator says so";
/// The same of a binding that the table of contributors asks for.
const FROM_TABLE: &str = "as the scene's table of contributors says";

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
    /// How the curator knows, in words; where not given that the curator says so, and with --from-table that the table
    /// does
    #[arg(long, value_name = "TEXT")]
    purpose: Option<String>,
    /// Where the bundle goes: a new folder; with --from-table one that an earlier run began will do
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Whose name stands for which key.
struct Name<'a> {
    contributor: &'a str,
    key: PublicKey,
}

impl BindArgs {
    /// How the curator knows.
    fn purpose(&self) -> &str {
        let known = if self.from_table { FROM_TABLE } else { FROM_CURATOR };
        self.purpose.as_deref().unwrap_or(known)
    }
}

/// A name, and where its bundle goes.
struct Numbered<'a> {
    name: Name<'a>,
    out: PathBuf,
}

/// Signs bindings and enters them.
pub async fn run(line: &Connection, args: &BindArgs) -> anyhow::Result<()> {
    let (scene, shown) = (&args.name, super::scene::get(line, &args.name).await?);
    if args.from_table {
        return from_table(line, args, super::scene::keys(&shown)?).await;
    }
    let (Some(contributor), Some(owner)) = (&args.contributor, args.owner_key) else {
        anyhow::bail!("give --contributor and --owner-key, or --from-table");
    };
    anyhow::ensure!(
        shown.views.iter().any(|view| view.contributor == *contributor),
        "scene {scene:?} has no photograph by {contributor:?}; `cairn scene show {scene}` names who took them"
    );
    Bundle::must_be_new(&args.out)?;
    let key = args.unlock.load(&args.key)?;
    bind(line, args, &Name { contributor, key: owner }, &key, &args.out).await
}

/// Binds every contributor to the key that the table gives, but for those whose name is bound to it: so a run that was cut
/// off goes on with the next.
async fn from_table(line: &Connection, args: &BindArgs, keys: BTreeMap<String, PublicKey>) -> anyhow::Result<()> {
    let scene = &args.name;
    anyhow::ensure!(
        !keys.is_empty(),
        "the table of contributors of scene {scene:?} has no keys; name one (--contributor, --owner-key)"
    );
    let bound = bound(&records::list(line, scene).await?)?;
    // A name has the same folder in each run.
    let numbered = (1..).zip(&keys).map(|(number, (contributor, key))| Numbered {
        name: Name { contributor, key: *key },
        out: args.out.join(number.to_string()),
    });
    let (done, left): (Vec<_>, Vec<_>) = numbered.partition(|of| bound.get(of.name.contributor) == Some(&of.name.key));
    for Numbered { name, .. } in &done {
        println!("{:?} stands for key {} already", name.contributor, name.key);
    }
    for Numbered { name, out } in &left {
        Bundle::must_be_new(out)?;
        println!("{:?} is to stand for key {}", name.contributor, name.key);
    }
    if left.is_empty() {
        return Ok(());
    }
    let key = args.unlock.load(&args.key)?;
    for Numbered { name, out } in &left {
        bind(line, args, name, &key, out).await?;
    }
    Ok(())
}

/// Which key each contributor's name stands for, by the newest of its bindings that stand.
fn bound(records: &[v1::Record]) -> anyhow::Result<BTreeMap<String, PublicKey>> {
    let mut bound = BTreeMap::new();
    for record in records.iter().filter(|record| record.kind == "binding") {
        if record.envelope.is_empty() {
            // An erased one may have been of any name, and then it stands for no key: binding that anew does no harm.
            bound.clear();
            continue;
        }
        let standing = record.standing.as_ref();
        if standing.is_some_and(|s| s.replaced_by.is_some() || s.taken_back_by.is_some()) {
            continue;
        }
        let signed = SignedRecord::parse(&record.envelope).with_context(|| format!("record {}", record.index))?;
        let identity = &signed.record().identity;
        if let Some(key) = identity.key {
            bound.insert(identity.contributor.clone(), key);
        }
    }
    Ok(bound)
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
        purpose: args.purpose().to_owned(),
        nonce: ground.nonce,
        seen: ground.seen,
        replaces: None,
        views: None,
    };
    let place = bundle.enter(line, &record, &[curator], &[]).await?;
    println!("{place}: {:?} stands for key {}; its bundle is in {}", name.contributor, name.key, out.display());
    Ok(())
}
