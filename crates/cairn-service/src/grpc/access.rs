//! `AccessService`: who is known here, and what they may use.

use crate::auth::{
    AccessError, AccountError, Change as AccountChange, Limits, Need, Registration, Role,
    registration::NONCE_LIFETIME_S,
};
use cairn_api::v1::{self, access_service_server::AccessService};
use cairn_log::{Digest, Heir};
use tonic::{Request, Response, Status};

use super::gate::About;
use super::status::refuse;
use super::{Answer, Shared, from_proto, to_proto};
use crate::config::Mode;
use crate::error::EngineError;
use crate::store::access::unix_s;

/// Longest signature that is looked at, bytes; one of Ed25519 has 64.
const MAX_SIGNATURE_BYTES: usize = 64;

/// Accounts are changed where they count, or by whoever has the data folder in hand: not by anybody who
/// happens to reach a daemon that asks nobody who they are.
fn accounts_count(shared: &Shared) -> Result<(), Status> {
    if shared.in_process || shared.access.mode == Mode::Accounts {
        return Ok(());
    }
    let why = "the daemon runs without them; set access.mode = \"accounts\"";
    Err(EngineError::wrong_state("accounts", "used", why).into())
}

#[tonic::async_trait]
impl AccessService for Shared {
    async fn about(&self, _: Request<v1::AboutRequest>) -> Answer<v1::AboutResponse> {
        let verifier = &self.at_work()?.verifier;
        let daemon = &verifier.daemon;
        let mode = match self.access.mode {
            Mode::Open => v1::AccessMode::Open,
            Mode::Token => v1::AccessMode::Token,
            Mode::Accounts => v1::AccessMode::Accounts,
        };
        Ok(Response::new(v1::AboutResponse {
            origin: daemon.origin.clone(),
            registry_key: self.engine()?.registry().public_key().to_bytes().to_vec().into(),
            run: daemon.run.to_vec().into(),
            mode: mode.into(),
            read_closed: self.access.read_closed,
            token_lifetime_s: verifier.longest_s,
            now_unix_s: unix_s(),
        }))
    }

    async fn nonce(&self, request: Request<v1::RegistrationNonceRequest>) -> Answer<v1::RegistrationNonceResponse> {
        let v1::RegistrationNonceRequest { public_key } = request.into_inner();
        accounts_count(self)?;
        let key = from_proto::public_key("public_key", &public_key)?;
        let loaded = self.at_work()?;
        let nonce = loaded.nonces.issue(&key, unix_s()).map_err(refuse)?;
        Ok(Response::new(v1::RegistrationNonceResponse {
            nonce: nonce.as_bytes().to_vec().into(),
            origin: loaded.engine.registry().origin().to_owned(),
            good_for_s: NONCE_LIFETIME_S,
        }))
    }

    async fn register(&self, request: Request<v1::RegisterRequest>) -> Answer<v1::RegisterResponse> {
        let v1::RegisterRequest { public_key, name, role, nonce, signature } = request.into_inner();
        accounts_count(self)?;
        let key = from_proto::public_key("public_key", &public_key)?;
        let nonce = Digest::from_bytes(from_proto::bytes32("nonce", &nonce)?);
        if signature.len() > MAX_SIGNATURE_BYTES {
            let got = format!("{} bytes", signature.len());
            return Err(EngineError::invalid("signature", got, format!("{MAX_SIGNATURE_BYTES} bytes")).into());
        }
        let role = from_proto::role(role)?.unwrap_or(Role::Contributor);
        let loaded = self.at_work()?;
        let origin = loaded.engine.registry().origin().to_owned();
        let registration = Registration { nonce, origin, key, name, role };
        loaded.nonces.verify(&registration, &signature, unix_s()).map_err(refuse)?;
        let policy = self.access.registration;
        let account = self
            .run(move |engine| {
                let id = registration.key.id();
                // A key that was rotated away is in nobody's hands either, as far as anybody can rely on it.
                if let Heir::Key { since: Some(index), .. } | Heir::Nobody { ended_by: index, .. } =
                    engine.registry().heir(&id)?
                {
                    return Err(AccessError::from(AccountError::Ended { key: id, index }).into());
                }
                Ok(engine.access().accounts().register(&registration, policy, unix_s())?)
            })
            .await?;
        tracing::info!(account = account.name, key = %account.key, standing = %account.standing, "registered");
        let account = Some(to_proto::account(&account));
        Ok(Response::new(v1::RegisterResponse { account }))
    }

    async fn list(&self, request: Request<v1::ListAccountsRequest>) -> Answer<v1::ListAccountsResponse> {
        accounts_count(self)?;
        self.authorise(request.extensions(), About::Nothing)?;
        let accounts = self.engine()?.access().accounts().list().iter().map(to_proto::account).collect();
        Ok(Response::new(v1::ListAccountsResponse { accounts }))
    }

    async fn change(&self, request: Request<v1::ChangeAccountRequest>) -> Answer<v1::ChangeAccountResponse> {
        use v1::change_account_request::Change;
        accounts_count(self)?;
        self.authorise(request.extensions(), About::Nothing)?;
        let v1::ChangeAccountRequest { public_key, change } = request.into_inner();
        let key = from_proto::public_key("public_key", &public_key)?;
        let change = match change {
            Some(Change::Approve(asked)) => AccountChange::Approve(from_proto::role(asked)?),
            Some(Change::Role(wanted)) => {
                AccountChange::Role(from_proto::role(wanted)?.ok_or_else(|| {
                    EngineError::invalid("role", "not set", "contributor, curator, auditor or operator")
                })?)
            }
            Some(Change::Disabled(disabled)) => AccountChange::Disabled(disabled),
            Some(Change::Quota(q)) => {
                let v1::QuotaLimits { bytes, views, training_seconds, queued_jobs, records, records_per_day } = q;
                let limits = Limits { bytes, views, training_seconds, queued_jobs, records, records_per_day };
                AccountChange::Quota(Some(limits))
            }
            Some(Change::DaemonQuota(_)) => AccountChange::Quota(None),
            None => {
                return Err(EngineError::invalid("what to change", "not set", "one of the request's changes").into());
            }
        };
        let account = self.run(move |engine| Ok(engine.access().accounts().change(&key, change)?)).await?;
        tracing::info!(
            account = account.name,
            key = %account.key,
            role = %account.role,
            standing = %account.standing,
            "account changed"
        );
        Ok(Response::new(v1::ChangeAccountResponse { account: Some(to_proto::account(&account)) }))
    }

    async fn quota(&self, request: Request<v1::QuotaRequest>) -> Answer<v1::QuotaResponse> {
        let v1::QuotaRequest { ref public_key } = *request.get_ref();
        accounts_count(self)?;
        let own = self.authorise(request.extensions(), About::Nothing)?;
        let asked = match public_key.is_empty() {
            true => None,
            false => {
                let key = from_proto::public_key("public_key", public_key)?;
                Some(self.engine()?.access().payer(&key.id()))
            }
        };
        if asked.is_some() && asked != own {
            self.authorise_as(request.extensions(), Need::Oversee, About::Nothing)?;
        }
        let Some(owner) = asked.or(own) else {
            let allowed = "its public key (`cairn access quota KEY`), or with --connect your own (--account FILE)";
            return Err(EngineError::invalid("the account", "not named", allowed).into());
        };
        let engine = self.engine()?;
        let (limits, used) = (engine.access().limits(&owner), engine.access().usage(&owner));
        Ok(Response::new(v1::QuotaResponse {
            limits: Some(to_proto::quota(&limits)),
            used: Some(v1::QuotaLimits {
                bytes: used.bytes,
                views: used.views,
                training_seconds: used.training_seconds,
                queued_jobs: engine.jobs().open_of(&owner),
                records: used.records,
                records_per_day: used.records_per_day,
            }),
            training_frees_unix_s: used.training_frees_at,
        }))
    }
}
