//! What owner records, erasure requests and statements of shares have in common: a JSON body of one version that names a key, in a DSSE envelope
//! which that key signed.

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    dsse::{DsseError, Envelope, EnvelopeSignature},
    key::{OwnerKey, PublicKey},
};

/// Why an envelope is no owner record, or no erasure request.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// The envelope carries something else.
    #[error(transparent)]
    Envelope(#[from] DsseError),
    /// A format version that this release does not know.
    #[error("{what} of version {got}, this release reads version {expected}")]
    Version {
        /// Owner record or erasure request.
        what: &'static str,
        /// The version that the body states.
        got: u64,
        /// The version that is read.
        expected: u32,
    },
    /// Not the JSON of such a body.
    #[error("{what}: {cause}")]
    Json {
        /// Owner record or erasure request.
        what: &'static str,
        /// What the JSON reader said, with line and column.
        cause: String,
    },
    /// A field with a value that is not allowed.
    #[error("{what}, field {field}: {got}, expected {expected}")]
    Field {
        /// Owner record or erasure request.
        what: &'static str,
        /// Its name.
        field: &'static str,
        /// What is allowed.
        expected: &'static str,
        /// What it holds.
        got: String,
    },
    /// The key named in the body did not sign these bytes.
    #[error("no signature of the envelope is by the key {owner} that the {what} names")]
    OwnerSignature {
        /// Owner record or erasure request.
        what: &'static str,
        /// The key named in the body.
        owner: PublicKey,
    },
}

/// A body that the key named in it signs.
pub(crate) trait Statement: Serialize + DeserializeOwned {
    /// What errors call it.
    const NAME: &'static str;
    /// The DSSE payloadType.
    const PAYLOAD_TYPE: &'static str;
    /// The only format version that is read.
    const VERSION: u32;

    /// The key that has to sign.
    fn signer(&self) -> PublicKey;

    /// Every rule that needs nothing but the body.
    fn check(&self) -> Result<(), RecordError>;
}

/// The body in an envelope signed by `key`, which has to be the one that it names.
pub(crate) fn seal<S: Statement>(statement: &S, key: &OwnerKey) -> Result<Envelope, RecordError> {
    statement.check()?;
    let owner = statement.signer();
    if key.public() != owner {
        return Err(RecordError::OwnerSignature { what: S::NAME, owner });
    }
    let body = serde_json::to_vec(statement).map_err(|e| json::<S>(&e))?;
    let mut envelope = Envelope::new(S::PAYLOAD_TYPE, body);
    envelope.sign(key);
    Ok(envelope)
}

/// Reads and checks a body, without its signature.
pub(crate) fn parse<S: Statement>(body: &[u8]) -> Result<S, RecordError> {
    #[derive(Deserialize)]
    struct Stated {
        version: u64,
    }
    // The version first, so that a newer body is refused by name and not for its fields.
    let stated: Stated = serde_json::from_slice(body).map_err(|e| json::<S>(&e))?;
    if stated.version != u64::from(S::VERSION) {
        return Err(version::<S>(stated.version));
    }
    let statement: S = serde_json::from_slice(body).map_err(|e| json::<S>(&e))?;
    statement.check()?;
    Ok(statement)
}

/// Reads the body of an envelope, and verifies that the key named in it signed exactly these bytes.
///
/// The key stands in the body, so the body is read first; nothing of it is handed out unless the signature holds.
pub(crate) fn open<S: Statement>(envelope: &Envelope) -> Result<(S, &EnvelopeSignature), RecordError> {
    let statement: S = parse(envelope.body(S::PAYLOAD_TYPE)?)?;
    let owner = statement.signer();
    let signature = envelope.signature_by(&owner).ok_or(RecordError::OwnerSignature { what: S::NAME, owner })?;
    Ok((statement, signature))
}

/// The refusal of another version.
pub(crate) fn version<S: Statement>(got: u64) -> RecordError {
    RecordError::Version { what: S::NAME, got, expected: S::VERSION }
}

fn json<S: Statement>(cause: &serde_json::Error) -> RecordError {
    RecordError::Json { what: S::NAME, cause: cause.to_string() }
}
