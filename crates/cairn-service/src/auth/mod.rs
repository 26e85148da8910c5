//! Who may do what on a daemon: registration by proof of possession, roles, short-lived signed tokens, quotas.
//!
//! Pure: no gRPC, and no clock of its own. The time, seconds since 1970, comes in
//! as an argument wherever it matters. A call is let in in this order: its token
//! is verified ([`Verifier::verify`]), the account's role is held to what the method
//! needs ([`roles`]), the token's scene to the call's ([`Claims::about`]), and what
//! the call would use up to the owner's quota ([`Quotas`]).

pub mod accounts;
pub mod error;
mod file;
pub mod quota;
pub mod registration;
mod replay;
pub mod roles;
pub mod token;
mod wire;

pub use accounts::{Account, Accounts, Change, Policy, Standing};
pub use error::{AccessError, AccountError, Denied, FileError, Frees, Kind, QuotaError, TokenError};
pub use quota::{Charge, Limits, Quotas, Reserved, Usage};
pub use registration::{Nonces, Registration, RegistrationError};
pub use roles::{Need, Reach, Role};
pub use token::{Call, Claims, Daemon, Verifier, sign};
