//! `cairn access`: accounts, their roles and quotas.
//!
//! Without --connect these commands work on a data folder that no daemon has open, as
//! its operator: a user who can write there needs no account.

use std::path::Path;

use anyhow::Context as _;
use cairn_api::v1::{self, change_account_request::Change};
use cairn_log::keys::StoredKey;
use cairn_log::{Digest, PublicKey};
use cairn_service::auth::{Registration, Role};
use cairn_service::error::EngineError;

use super::connect::{Connection, Where};
use super::json::{self, Json};
use super::words::word;

/// What to do with accounts.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Ask a daemon for an account with the key of --account
    #[command(
        after_help = "Example:\n  cairn access register --name ada --connect https://cairn.example:7341 --tls-ca daemon.pem --account ada.key"
    )]
    Register {
        /// What to call it
        #[arg(long, value_name = "NAME")]
        name: String,
        /// The role to ask for; more than contributor is an operator's to give
        #[arg(long, default_value_t = Role::Contributor)]
        role: Role,
    },
    /// Approve an account that waits (operators)
    #[command(
        after_help = "Example:\n  cairn access approve d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a --role curator --account grace.key"
    )]
    Approve {
        /// Its public key, 64 hexadecimal digits: the line `public key` of `cairn keys show`
        key: PublicKey,
        /// Another role than it asked for
        #[arg(long)]
        role: Option<Role>,
    },
    /// All accounts, oldest first (auditors and operators)
    #[command(after_help = "Example:\n  cairn access list")]
    List {
        #[command(flatten)]
        json: Json,
    },
    /// Give an account another role, shut it out, or let it in again (operators)
    #[command(
        after_help = "Example:\n  cairn access set d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a --disable"
    )]
    Set(SetArgs),
    /// What an account uses and may use: your own, or anybody's; with limits, set them (operators)
    #[command(
        after_help = "Example:\n  cairn access quota d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a --views 500"
    )]
    Quota(QuotaArgs),
    /// Add an account to the data folder of a daemon that is not running: how the first operator is made
    #[command(
        after_help = "Example:\n  cairn access add --name grace --role operator --key d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a"
    )]
    Add(AddArgs),
}

/// `cairn access set`.
#[derive(Debug, clap::Args)]
#[group(skip)]
#[command(group(clap::ArgGroup::new("change").required(true).args(["role", "disable", "enable"])))]
pub struct SetArgs {
    /// The account's public key
    key: PublicKey,
    /// The role: contributor, curator, auditor or operator
    #[arg(long)]
    role: Option<Role>,
    /// Shut the account out
    #[arg(long)]
    disable: bool,
    /// Let the account in again
    #[arg(long)]
    enable: bool,
}

/// `cairn access quota`.
#[derive(Debug, clap::Args)]
pub struct QuotaArgs {
    /// A public key; your own where not given
    pub key: Option<PublicKey>,
    /// Bytes of photographs stored, 0 for no limit
    #[arg(long, value_name = "N", requires = "key")]
    pub bytes: Option<u64>,
    /// Views stored, 0 for no limit
    #[arg(long, value_name = "N", requires = "key")]
    pub views: Option<u64>,
    /// Seconds of training within a rolling day, 0 for no limit
    #[arg(long, value_name = "N", requires = "key")]
    pub training_seconds: Option<u64>,
    /// Trainings accepted or running, 0 for no limit
    #[arg(long, value_name = "N", requires = "key")]
    pub queued_jobs: Option<u64>,
    /// Owner records submitted, in all, 0 for no limit
    #[arg(long, value_name = "N", requires = "key")]
    pub records: Option<u64>,
    /// Owner records submitted within a rolling day, 0 for no limit
    #[arg(long, value_name = "N", requires = "key")]
    pub records_per_day: Option<u64>,
    /// The daemon's own limits again
    #[arg(long, requires = "key", conflicts_with_all = ["bytes", "views", "training_seconds", "queued_jobs", "records",
        "records_per_day"])]
    pub default: bool,
    #[command(flatten)]
    pub json: Json,
}

/// `cairn access add`.
#[derive(Debug, clap::Args)]
pub struct AddArgs {
    /// Its public key: the line `public key` of `cairn keys show` (not `key id`); or the key's file
    #[arg(long, value_name = "PUBLIC|FILE")]
    pub key: String,
    /// Its role: contributor, curator, auditor or operator
    #[arg(long)]
    pub role: Role,
    /// What to call it; its role where not given
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
}

/// A public key as it is written, or that of a key file.
fn public_key(text: &str) -> anyhow::Result<PublicKey> {
    let path = Path::new(text);
    match text.parse() {
        Ok(key) => Ok(key),
        Err(_) if path.exists() => Ok(StoredKey::read(path)?.public()),
        Err(_) => anyhow::bail!(
            "--key {text} is neither a public key (64 hexadecimal digits, see `cairn keys show`) nor a key's file"
        ),
    }
}

impl QuotaArgs {
    /// Whether it sets limits.
    fn changes(&self) -> bool {
        let given =
            [self.bytes, self.views, self.training_seconds, self.queued_jobs, self.records, self.records_per_day];
        self.default || given.iter().any(Option::is_some)
    }
}

impl Command {
    /// Whether it only reads.
    pub fn reads(&self) -> bool {
        match self {
            Self::List { .. } => true,
            Self::Quota(args) => !args.changes(),
            Self::Register { .. } | Self::Approve { .. } | Self::Set(_) | Self::Add(_) => false,
        }
    }
}

/// Answers `cairn access add`.
pub fn add(place: &Where, args: &AddArgs) -> anyhow::Result<()> {
    anyhow::ensure!(
        place.connect.is_none(),
        "accounts are added on the daemon's machine, without --connect, while the daemon does not run; over the network \
         they register (`cairn access register`)"
    );
    let name = args.name.clone().unwrap_or_else(|| args.role.to_string());
    let key = public_key(&args.key)?;
    let is_new = !place.data.exists();
    let account = match cairn_service::store::access::add_account(&place.data, key, &name, args.role) {
        Err(EngineError::Locked { path, pid }) => anyhow::bail!(
            "the data folder {} is in use by process {pid}; stop the daemon first, or register over the network \
             (`cairn access register`)",
            path.display()
        ),
        added => added?,
    };
    if is_new {
        println!("began a new data folder {}", place.data.display());
    }
    println!("added {}, {}", account.name, account.role);
    Ok(())
}

/// Answers `cairn access`.
pub async fn run(line: &Connection, command: Command) -> anyhow::Result<()> {
    let mut client = line.access();
    let (key, change) = match command {
        Command::Register { name, role } => return register(line, name, role).await,
        Command::Approve { key, role } => {
            let role = role.map_or(v1::Role::Unspecified, cairn_service::grpc::to_proto::role);
            (key, Change::Approve(role.into()))
        }
        Command::List { json } => {
            let request = v1::ListAccountsRequest {};
            let answer = client.list(request).await?.into_inner();
            if json.json {
                return json::print(&answer);
            }
            if answer.accounts.is_empty() {
                eprintln!(
                    "no accounts yet; the first operator is made with `cairn access add` on the daemon's machine"
                );
            }
            answer.accounts.iter().for_each(|account| println!("{}", one_line(account)));
            return Ok(());
        }
        Command::Set(SetArgs { key, role: Some(role), .. }) => {
            (key, Change::Role(cairn_service::grpc::to_proto::role(role).into()))
        }
        Command::Set(SetArgs { key, disable, .. }) => (key, Change::Disabled(disable)),
        Command::Quota(args) => return quota(line, &args).await,
        // It needs no line, and was answered before there was one.
        Command::Add(_) => return Ok(()),
    };
    let request = v1::ChangeAccountRequest { public_key: key.to_bytes().to_vec().into(), change: Some(change) };
    let changed = client.change(request).await?.into_inner().account;
    println!("{}", one_line(&changed.context("the daemon's answer names no account")?));
    Ok(())
}

fn one_line(account: &v1::Account) -> String {
    let standing = word(account.standing().as_str_name(), "ACCOUNT_STANDING_");
    let role = |role: v1::Role| word(role.as_str_name(), "ROLE_");
    let asked = match account.asked() {
        asked if asked == account.role() => String::new(),
        asked => format!(", asked for {}", role(asked)),
    };
    let key = |bytes: &[u8]| {
        <[u8; 32]>::try_from(bytes).map_or_else(
            |_| "a key that is not 32 bytes".into(),
            // Written as every public key is; it need not be a digest for that.
            |bytes| Digest::from_bytes(bytes).to_string(),
        )
    };
    let mut line =
        format!("{}  {}  {}{asked}  {standing}", key(&account.public_key), account.name, role(account.role()));
    if !account.heir.is_empty() {
        line.push_str(&format!(", signed for by {}", key(&account.heir)));
    }
    if let Some(index) = account.ended_by {
        line.push_str(&format!(", its key ended by record {index}"));
    }
    line
}

async fn register(line: &Connection, name: String, role: Role) -> anyhow::Result<()> {
    let key = line.account.as_ref().context("say whose account it is to be: --account FILE (see `cairn keys new`)")?;
    let mut client = line.access();
    let public_key = key.public().to_bytes().to_vec();
    let request = v1::RegistrationNonceRequest { public_key: public_key.clone().into() };
    let given = client.nonce(request).await?.into_inner();
    let nonce: [u8; 32] = given.nonce.as_ref().try_into().context("the daemon's nonce is not 32 bytes")?;
    let nonce = Digest::from_bytes(nonce);
    let registration = Registration { nonce, origin: given.origin, key: key.public(), name, role };
    let request = v1::RegisterRequest {
        public_key: public_key.into(),
        signature: registration.sign(key).to_vec().into(),
        name: registration.name,
        role: cairn_service::grpc::to_proto::role(role).into(),
        nonce: given.nonce,
    };
    let account = client.register(request).await?.into_inner().account;
    println!("{}", one_line(&account.context("the daemon's answer names no account")?));
    Ok(())
}

async fn quota(line: &Connection, args: &QuotaArgs) -> anyhow::Result<()> {
    let mut client = line.access();
    let public_key = || args.key.map(|key| key.to_bytes().to_vec()).unwrap_or_default().into();
    let ask = || v1::QuotaRequest { public_key: public_key() };
    let mut now = client.quota(ask()).await?.into_inner();
    if args.changes() {
        let old = now.limits.unwrap_or_default();
        let quota = v1::QuotaLimits {
            bytes: args.bytes.unwrap_or(old.bytes),
            views: args.views.unwrap_or(old.views),
            training_seconds: args.training_seconds.unwrap_or(old.training_seconds),
            queued_jobs: args.queued_jobs.unwrap_or(old.queued_jobs),
            records: args.records.unwrap_or(old.records),
            records_per_day: args.records_per_day.unwrap_or(old.records_per_day),
        };
        let change = if args.default { Change::DaemonQuota(v1::DaemonQuota {}) } else { Change::Quota(quota) };
        let request = v1::ChangeAccountRequest { public_key: public_key(), change: Some(change) };
        client.change(request).await?;
        now = client.quota(ask()).await?.into_inner();
    }
    if args.json.json {
        return json::print(&now);
    }
    let (limits, used) = (now.limits.unwrap_or_default(), now.used.unwrap_or_default());
    let of = |limit: u64| if limit == 0 { "no limit".to_owned() } else { format!("of {limit}") };
    println!("bytes             {} {}", used.bytes, of(limits.bytes));
    println!("views             {} {}", used.views, of(limits.views));
    println!("training seconds  {} {} in a day", used.training_seconds, of(limits.training_seconds));
    println!("queued jobs       {} {}", used.queued_jobs, of(limits.queued_jobs));
    println!("records           {} {}", used.records, of(limits.records));
    println!("records per day   {} {}", used.records_per_day, of(limits.records_per_day));
    Ok(())
}
