//! A daemon with accounts, and people who call it with their keys.

use cairn_api::v1;
use cairn_api::v1::access_service_client::AccessServiceClient;
use cairn_log::keys::{Seal, Unlock, load_key, save_key};
use cairn_log::{OwnerKey, PublicKey};
use cairn_service::auth::Daemon as Identity;
use tonic::transport::{Channel, Endpoint};

use super::{Daemon, Place};

/// Settings: who changes something needs an account.
pub const ACCOUNTS: &str = "[access]\nmode = \"accounts\"\n";
/// Settings: readers need an account too.
pub const CLOSED: &str = "[access]\nmode = \"accounts\"\nread = \"closed\"\n";

/// A daemon with an operator, and people with keys.
pub struct World {
    /// Keys, the capture and the data folder.
    pub place: Place,
    /// The daemon.
    pub daemon: Daemon,
}

impl World {
    /// A daemon with an operator, `root`; `settings` are its own.
    pub fn new(settings: &str) -> Self {
        let place = Place::new();
        let root = key(&place, "root");
        let data = place.text("data");
        place.cairn_ok(&["access", "add", "--role", "operator", "--key", &root.to_string(), "--data", &data]);
        let daemon = Daemon::start(&place.path("data"), settings);
        Self { place, daemon }
    }

    /// A new key with an account of this role.
    pub fn with(&self, name: &str, role: &str) -> PublicKey {
        let public = key(&self.place, name);
        self.ok(name, &["access", "register", "--name", name]);
        self.ok("root", &["access", "approve", &public.to_string(), "--role", role]);
        public
    }

    /// Runs a command as the account `who`: what it printed, or the error that it printed.
    ///
    /// # Errors
    /// What it printed to standard error, where it failed.
    pub fn run(&self, who: &str, arguments: &[&str]) -> Result<String, String> {
        self.run_at(&self.daemon.url, who, arguments)
    }

    /// As [`World::run`], where the daemon is reached in another way.
    ///
    /// # Errors
    /// As [`World::run`].
    pub fn run_at(&self, url: &str, who: &str, arguments: &[&str]) -> Result<String, String> {
        let key = self.place.text(&format!("{who}.key"));
        let line = ["--connect", url, "--account", &key];
        let output = self.place.cairn(&[arguments, &line].concat());
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
    }

    /// As [`World::run`]; it must succeed.
    pub fn ok(&self, who: &str, arguments: &[&str]) -> String {
        self.run(who, arguments).unwrap_or_else(|e| panic!("{who}: cairn {arguments:?}: {e}"))
    }

    /// As [`World::run`]; it must fail with a message that has `says` in it.
    pub fn refused(&self, who: &str, arguments: &[&str], says: &str) {
        let said = self.run(who, arguments).expect_err(&format!("{who} may cairn {arguments:?}"));
        assert!(said.contains(says), "{who}: cairn {arguments:?} was refused, but not for {says:?}: {said}");
    }

    /// Imports the capture as `scene`, every 8th view held out.
    ///
    /// # Errors
    /// As [`World::run`].
    pub fn import(&self, who: &str, scene: &str) -> Result<String, String> {
        let capture = self.place.text("capture");
        let import = ["scene", "import", scene, "--from", &capture, "--contributors", "contributors.csv"];
        self.run(who, &[&import[..], &["--hold-out", "8"]].concat())
    }

    /// A connection to the daemon.
    pub async fn channel(&self) -> Channel {
        Endpoint::from_shared(self.daemon.url.clone()).unwrap().connect().await.unwrap()
    }

    /// What tokens for this run of the daemon name.
    pub async fn identity(&self) -> Identity {
        let mut client = AccessServiceClient::new(self.channel().await);
        let about = client.about(v1::AboutRequest {}).await.unwrap().into_inner();
        let registry: [u8; 32] = about.registry_key.as_ref().try_into().unwrap();
        let registry = PublicKey::from_bytes(&registry).unwrap().id();
        Identity { origin: about.origin, registry, run: about.run.as_ref().try_into().unwrap() }
    }

    /// The key of the account `who`.
    pub fn key(&self, who: &str) -> OwnerKey {
        load_key(&self.place.path(&format!("{who}.key")), &Unlock::Nothing).unwrap()
    }
}

/// A new key in `NAME.key`.
pub fn key(place: &Place, name: &str) -> PublicKey {
    let key = OwnerKey::generate().unwrap();
    save_key(&place.path(&format!("{name}.key")), &key, &Seal::Plain).unwrap();
    key.public()
}
