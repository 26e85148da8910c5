//! The erasure request, version 1: an owner asks that the envelope of a record of theirs be forgotten.
//!
//! The record's leaf stays in the log, since nothing can be taken out of it, and every proof goes on verifying; with the
//! envelope go the salts, and without those the leaf says nothing about anybody. The request is a DSSE envelope of a type
//! of its own, so that no record can pass for one. It binds log, record, index, key and a nonce of the registry, good
//! once: an old request erases nothing else, and says nothing to another log.

use serde::{Deserialize, Serialize};

use crate::format::{
    digest::Digest,
    dsse::Envelope,
    key::{OwnerKey, PublicKey},
    record::{EXACT_IN_JSON, RecordError, check_text},
    statement::{self, Statement},
};

/// The DSSE payloadType of an erasure request.
pub const PAYLOAD_TYPE: &str = "application/vnd.cairn.erasure-request.v1+json";

/// The body's format version.
pub const VERSION: u32 = 1;

/// Body of an erasure request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErasureRequest {
    /// Format version, [`VERSION`].
    pub version: u32,
    /// The log it is meant for.
    pub origin: String,
    /// Digest (SHA-256 of the PAE) of the record (hex).
    pub record: Digest,
    /// The record's place in the log.
    pub index: u64,
    /// The key that asks (hex): the record's owner's, or the one that a rotation put in its place.
    pub owner_key: PublicKey,
    /// The registry's nonce for the record's scene and this key (hex).
    pub nonce: Digest,
}

impl Statement for ErasureRequest {
    const NAME: &'static str = "erasure request";
    const PAYLOAD_TYPE: &'static str = PAYLOAD_TYPE;
    const VERSION: u32 = VERSION;

    fn signer(&self) -> PublicKey {
        self.owner_key
    }

    fn check(&self) -> Result<(), RecordError> {
        if self.version != VERSION {
            return Err(statement::version::<Self>(self.version.into()));
        }
        if self.index >= EXACT_IN_JSON {
            let (what, expected) = (Self::NAME, "less than 2^53");
            return Err(RecordError::Field { what, field: "index", expected, got: self.index.to_string() });
        }
        check_text(Self::NAME, "origin", &self.origin)
    }
}

impl ErasureRequest {
    /// The request in an envelope signed by `key`.
    ///
    /// # Errors
    /// [`RecordError`]; [`RecordError::OwnerSignature`] where `key` is not the one that it names.
    pub fn seal(&self, key: &OwnerKey) -> Result<Envelope, RecordError> {
        statement::seal(self, key)
    }
}

/// An erasure request whose signature holds. Exists in no other way than through [`Erasure::open`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Erasure {
    request: ErasureRequest,
}

impl Erasure {
    /// Reads the request of an envelope and verifies that the key named in it signed exactly these bytes.
    ///
    /// Whether that key may ask, and whether nonce and record are this log's, is for the registry to say.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn open(envelope: &Envelope) -> Result<Self, RecordError> {
        Ok(Self { request: statement::open(envelope)?.0 })
    }

    /// What is asked for.
    pub const fn request(&self) -> &ErasureRequest {
        &self.request
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> ErasureRequest {
        ErasureRequest {
            version: VERSION,
            origin: "cairn.test/owners".into(),
            record: Digest::of("record"),
            index: 7,
            owner_key: OwnerKey::from_seed(&[1; 32]).public(),
            nonce: Digest::of("nonce"),
        }
    }

    #[test]
    fn a_request_goes_through_its_envelope() {
        let envelope = request().seal(&OwnerKey::from_seed(&[1; 32])).unwrap();
        let read = Envelope::parse(envelope.to_json().as_bytes()).unwrap();
        assert_eq!(Erasure::open(&read).unwrap().request(), &request());
    }

    #[test]
    fn only_the_key_that_it_names_signs_it() {
        let (owner, other) = (OwnerKey::from_seed(&[1; 32]), OwnerKey::from_seed(&[2; 32]));
        assert!(matches!(request().seal(&other), Err(RecordError::OwnerSignature { .. })));
        let mut envelope = request().seal(&owner).unwrap();
        envelope.signatures.clear();
        envelope.sign(&other);
        assert_eq!(
            Erasure::open(&envelope),
            Err(RecordError::OwnerSignature { what: "erasure request", owner: owner.public() })
        );
        let mut envelope = request().seal(&owner).unwrap();
        for at in 0..envelope.payload.len() {
            envelope.payload[at] ^= 1;
            assert!(Erasure::open(&envelope).is_err(), "byte {at}");
            envelope.payload[at] ^= 1;
        }
        assert!(Erasure::open(&envelope).is_ok());
    }

    #[test]
    fn what_is_no_request_of_this_version_is_refused() {
        let key = OwnerKey::from_seed(&[1; 32]);
        let signed = |payload_type: &str, body: String| {
            let mut envelope = Envelope::new(payload_type, body);
            envelope.sign(&key);
            Erasure::open(&envelope)
        };
        let good = serde_json::to_string(&request()).unwrap();
        assert!(signed(PAYLOAD_TYPE, good.clone()).is_ok());
        assert!(matches!(signed(crate::format::record::PAYLOAD_TYPE, good.clone()), Err(RecordError::Envelope(_))));
        let newer = good.replace(r#""version":1"#, r#""version":2,"more":true"#);
        assert_eq!(
            signed(PAYLOAD_TYPE, newer),
            Err(RecordError::Version { what: "erasure request", got: 2, expected: 1 })
        );
        for body in [good.replace('}', r#","more":1}"#), good.replace(r#""index":7"#, r#""index":-7"#), "{}".into()] {
            assert!(matches!(signed(PAYLOAD_TYPE, body.clone()), Err(RecordError::Json { .. })), "{body}");
        }
        let far = good.replace(r#""index":7"#, r#""index":9007199254740992"#);
        assert!(matches!(signed(PAYLOAD_TYPE, far), Err(RecordError::Field { field: "index", .. })));
        let nameless = good.replace("cairn.test/owners", "");
        assert!(matches!(signed(PAYLOAD_TYPE, nameless), Err(RecordError::Field { field: "origin", .. })));
    }
}
