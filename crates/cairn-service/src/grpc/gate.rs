//! The gate: every call of every service comes through here before its handler.
//!
//! Contract. A method that stands in no row of cairn-service's table is refused. Where its
//! row wants a token, the token MUST be verified here, whatever the handler does or
//! forgets. What the call is about is known to its handler alone, which MUST hold the
//! caller to it with [`Shared::authorise`] before it changes or stores anything.

use std::pin::Pin;
use std::task::{Context, Poll};

use crate::auth::AccountError;
use crate::auth::{AccessError, Account, Call, Claims, Denied, Need, Reach, Role, TokenError, roles};
use cairn_log::{Digest, Envelope};
use sha2::{Digest as _, Sha256};
use tonic::codegen::http::{self, HeaderMap};
use tonic::{Extensions, Status};

use super::status::refuse;
use super::{Loaded, Shared};
use crate::config::Mode;
use crate::error::EngineError;
use crate::store::access::unix_s;

/// The one call that a key makes which the log ended: to be told again what became of its last record.
const SUBMIT: &str = "/cairn.v1.OwnerService/Submit";

/// What the gate found out about a call.
#[derive(Clone, Debug)]
pub struct Admitted {
    method: String,
    need: Need,
    caller: Caller,
}

/// Who calls.
#[derive(Clone, Debug)]
enum Caller {
    /// Whoever it is, they may: no mode, or a shared token, that tells callers apart.
    Everybody,
    /// Somebody without a token, on a call that needs none so far.
    Nobody,
    /// An account, and what its token says.
    Account(Box<(Account, Claims)>),
}

/// What a call is about.
#[derive(Clone, Copy, Debug)]
pub enum About<'a> {
    /// No scene.
    Nothing,
    /// A scene, there or new.
    Scene(&'a str),
    /// A scene that is taken along in a call about another, which the token names.
    Beside(&'a str),
    /// A training, and so its scene.
    Job(&'a str),
    /// A scene that is only named: nothing of it is touched.
    Place(&'a str),
    /// A record about a scene, or a request about one, as somebody signed it.
    Signed(&'a str, &'a Envelope),
    /// A record about a scene, which each caller enters for themselves.
    Own(&'a str, &'a Envelope),
}

impl Shared {
    /// Whether a call may go on to its handler; `None` for services that are not Cairn's (health, reflection).
    fn admit(&self, path: &str, headers: &HeaderMap) -> Result<Option<Admitted>, Status> {
        let Some(need) = roles::need(path) else {
            if path.starts_with("/cairn.") {
                return Err(Status::unimplemented("there is no such method, or nobody may call it"));
            }
            return Ok(None);
        };
        let wanted = need.is_guarded() || (need == Need::Read && self.access.read_closed);
        let given = headers.get("authorization").and_then(|value| value.to_str().ok());
        let caller = match self.access.mode {
            Mode::Open => Caller::Everybody,
            Mode::Token => match self.check_bearer(given) {
                Ok(()) => Caller::Everybody,
                Err(refused) if wanted => return Err(refused),
                Err(_) => Caller::Nobody,
            },
            Mode::Accounts => match given.and_then(|text| text.strip_prefix("Cairn ")) {
                Some(token) if need != Need::Anyone => {
                    let call = Call { method: path, need, now: unix_s(), ended_too: path == SUBMIT };
                    match verify(self.at_work()?, call, token) {
                        Ok(caller) => caller,
                        // Whoever just ended their key reads on as anybody may: the proof of that very record, for one.
                        Err(AccessError::Account(AccountError::Rotated { .. } | AccountError::Ended { .. }))
                            if !wanted =>
                        {
                            Caller::Nobody
                        }
                        Err(refused) => return Err(refuse(refused)),
                    }
                }
                None if wanted => return Err(missing(path)),
                Some(_) | None => Caller::Nobody,
            },
        };
        Ok(Some(Admitted { method: path.to_owned(), need, caller }))
    }

    /// Whether the caller brings the daemon's one token.
    fn check_bearer(&self, given: Option<&str>) -> Result<(), Status> {
        let Some(token) = &self.token else { return Ok(()) };
        let remedy = "send `authorization: Bearer <token>` (--token-file) with the daemon's token";
        let Some(given) = given else {
            return Err(Status::unauthenticated(format!("this call needs a token; {remedy}")));
        };
        let given = given.strip_prefix("Bearer ").unwrap_or_default();
        // Compared by digest: how long that takes says nothing of the secret.
        if Sha256::digest(given) != Sha256::digest(token.secret()) {
            return Err(Status::unauthenticated(format!("the token is not the daemon's; {remedy}")));
        }
        Ok(())
    }

    /// Holds the caller to what the call is about: the token's scene is the call's, and contributors keep to
    /// what is theirs. The id of the account that pays; `None` where none does.
    pub(super) fn authorise(&self, extensions: &Extensions, about: About<'_>) -> Result<Option<Digest>, Status> {
        let need = extensions.get::<Admitted>().map_or(Need::Operate, |admitted| admitted.need);
        self.authorise_as(extensions, need, about)
    }

    /// As [`Shared::authorise`], for a call that turned out to need more than its method's row says.
    pub(super) fn authorise_as(
        &self,
        extensions: &Extensions,
        need: Need,
        about: About<'_>,
    ) -> Result<Option<Digest>, Status> {
        let Some(Admitted { method, caller, .. }) = extensions.get() else {
            return Err(Status::internal("the call did not come through the gate"));
        };
        let (account, claims) = match caller {
            Caller::Everybody => return Ok(None),
            Caller::Nobody if self.access.mode == Mode::Token => {
                self.check_bearer(None)?;
                return Ok(None);
            }
            Caller::Nobody => return Err(missing(method)),
            Caller::Account(verified) => &**verified,
        };
        let engine = self.engine()?;
        let job = match about {
            About::Job(id) => Some(engine.jobs().get(id)?),
            _ => None,
        };
        let scene = match about {
            About::Nothing => "",
            About::Scene(scene) | About::Beside(scene) | About::Place(scene) => scene,
            About::Signed(scene, _) | About::Own(scene, _) => scene,
            About::Job(_) => job.as_ref().map_or("", |job| job.spec.scene.as_str()),
        };
        if !matches!(about, About::Beside(_)) {
            claims.about(scene).map_err(refuse)?;
        }
        let id = account.id();
        if let Some(index) = account.ended_by
            && !self.entered_before(account, about)?
        {
            return Err(refuse(AccountError::Ended { key: account.signer().id(), index }));
        }
        let (reach, contributor) = (account.role.reach(need), account.role == Role::Contributor);
        let theirs = match about {
            // What they signed themselves is all that a contributor submits, whatever scene it is about: a record under
            // their key, or the rotation that leads from it to another; and again, what they signed with an earlier one.
            About::Signed(_, envelope) => {
                !contributor
                    || envelope.signature_by(account.signer()).is_some()
                    || self.entered_before(account, about)?
            }
            About::Own(_, envelope) => {
                envelope.signature_by(account.signer()).is_some() || self.entered_before(account, about)?
            }
            About::Nothing | About::Place(_) => true,
            _ if reach != Reach::Own => true,
            About::Job(_) => match job.as_ref().and_then(|job| job.owner) {
                Some(owner) => owner == id || self.speaks_for(account, &owner)?,
                None => false,
            },
            // What is not there is nobody's: its handler says so.
            About::Scene(scene) | About::Beside(scene) => match engine.access().owner_of(scene)? {
                Some(owner) => owner == id || self.speaks_for(account, &owner)?,
                None => engine.scene(scene).is_err(),
            },
        };
        if reach == Reach::None {
            let (name, needed) = (account.name.clone(), need.roles());
            return Err(refuse(Denied::Role { name, role: account.role, method: method.clone(), needed }));
        }
        if !theirs {
            return Err(refuse(Denied::NotYours { what: what(about) }));
        }
        Ok(Some(id))
    }
}

impl Shared {
    /// Whether a call submits again what the log has, signed by the account's key or by one that was rotated to it: that
    /// changes nothing, and whoever ended their key since, or with it, may not have heard the first answer.
    fn entered_before(&self, account: &Account, about: About<'_>) -> Result<bool, Status> {
        let (About::Signed(_, envelope) | About::Own(_, envelope)) = about else { return Ok(false) };
        let (engine, key) = (self.engine()?, account.signer());
        let registry = engine.registry();
        let Some(index) = registry.find(&envelope.digest()).map_err(EngineError::from)? else { return Ok(false) };
        if envelope.signature_by(key).is_some() {
            return Ok(true);
        }
        let owner = registry.leaf(index).map_err(EngineError::from)?.owner;
        // Where that key ended, too, it hears still what it asks about.
        Ok(registry.heir(&owner).map_err(EngineError::from)?.id() == key.id())
    }

    /// Whether an account's key took the place of the key with this id, whose account may be another: then what is that
    /// one's is this one's.
    fn speaks_for(&self, account: &Account, owner: &Digest) -> Result<bool, Status> {
        let heir = self.engine()?.registry().heir(owner).map_err(EngineError::from)?;
        Ok(heir.is(&account.signer().id()))
    }
}

fn verify(loaded: &Loaded, call: Call<'_>, token: &str) -> Result<Caller, AccessError> {
    let verified = loaded.verifier.verify(token, call, loaded.engine.access().accounts())?;
    Ok(Caller::Account(Box::new(verified)))
}

fn what(about: About<'_>) -> String {
    match about {
        About::Nothing => "this".into(),
        About::Scene(scene) | About::Beside(scene) | About::Place(scene) => format!("the scene {scene:?}"),
        About::Job(id) => format!("the training {id}"),
        About::Signed(..) | About::Own(..) => "a record that your account's key did not sign".into(),
    }
}

fn missing(method: &str) -> Status {
    refuse(TokenError::Missing { method: method.to_owned() })
}

/// Puts [`Gate`] before services.
#[derive(Clone)]
pub struct GateLayer(pub Shared);

impl<S> tower::Layer<S> for GateLayer {
    type Service = Gate<S>;

    fn layer(&self, inner: S) -> Gate<S> {
        Gate { inner, shared: self.0.clone() }
    }
}

/// Services that only those reach who may.
#[derive(Clone)]
pub struct Gate<S> {
    inner: S,
    shared: Shared,
}

impl<S, In, Out> tower::Service<http::Request<In>> for Gate<S>
where
    S: tower::Service<http::Request<In>, Response = http::Response<Out>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
    Out: Default + Send + 'static,
{
    type Response = http::Response<Out>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, Self::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: http::Request<In>) -> Self::Future {
        match self.shared.admit(request.uri().path(), request.headers()) {
            Ok(admitted) => {
                if let Some(admitted) = admitted {
                    request.extensions_mut().insert(admitted);
                }
                Box::pin(self.inner.call(request))
            }
            Err(refused) => Box::pin(std::future::ready(Ok(refused.into_http()))),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    #[test]
    fn every_method_has_its_row_in_the_table() {
        let rows: BTreeSet<&str> = crate::auth::roles::METHODS.iter().map(|(path, _)| *path).collect();
        let methods: BTreeSet<&str> = cairn_api::v1::METHODS.iter().copied().collect();
        assert!(methods.len() > 20, "{methods:?}");
        let missing: Vec<_> = methods.difference(&rows).collect();
        assert!(missing.is_empty(), "crates/cairn-service/src/auth/roles.rs has no row for {missing:?}");
        let stale: Vec<_> = rows.difference(&methods).collect();
        assert!(
            stale.is_empty(),
            "crates/cairn-service/src/auth/roles.rs has rows for methods that are gone: {stale:?}"
        );
    }
}
