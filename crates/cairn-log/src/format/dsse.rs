//! DSSE envelopes (secure-systems-lab/dsse 1.0): signatures over raw bytes.
//!
//! What is signed is the pre-authentication encoding of type and body, never
//! JSON that somebody has to write again the same way. So the order is always:
//! verify over the bytes that came, then parse exactly those bytes.
//!
//! Policy on fields, as DSSE has it: fields unknown to us are ignored, but kept by name
//! so that an audit can mention them; a field twice is refused, since two readers could
//! then see two envelopes. `keyid` is a hint and decides nothing.

use std::collections::BTreeMap;

use base64::{
    Engine as _,
    alphabet::{self, Alphabet},
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig, general_purpose::STANDARD},
};
use serde::{Deserialize, Serialize, Serializer, de::IgnoredAny};

use crate::format::{
    digest::{Digest, clip},
    key::{OwnerKey, PublicKey},
};

/// Largest envelope that is read, in bytes of JSON.
pub const MAX_ENVELOPE_BYTES: usize = 64 * 1024;

/// Most signatures on one envelope: owner, registry and room for rotations.
pub const MAX_SIGNATURES: usize = 16;

/// Why an envelope is refused before any signature was looked at.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DsseError {
    /// Larger than [`MAX_ENVELOPE_BYTES`].
    #[error("envelope of {got} bytes, at most {limit} are read", limit = MAX_ENVELOPE_BYTES)]
    TooLarge {
        /// Its size.
        got: usize,
    },
    /// Not the JSON of an envelope.
    #[error("envelope is not DSSE JSON: {cause}")]
    Json {
        /// What the JSON reader said, with line and column.
        cause: String,
    },
    /// Neither standard nor URL-safe base64.
    #[error("envelope field {field}: neither standard nor URL-safe base64")]
    Base64 {
        /// `payload` or `signatures[i].sig`.
        field: String,
    },
    /// None, or more than [`MAX_SIGNATURES`].
    #[error("envelope with {got} signatures, 1 to {limit} expected", limit = MAX_SIGNATURES)]
    Signatures {
        /// How many there were.
        got: usize,
    },
    /// The body is not of the type that the caller reads.
    #[error("payloadType {got:?} is unknown here, expected {expected:?}")]
    PayloadType {
        /// What is read.
        expected: &'static str,
        /// What the envelope says.
        got: String,
    },
}

/// One signature of an envelope.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EnvelopeSignature {
    /// A hint which key made it; empty where unset. Decides nothing.
    #[serde(serialize_with = "hint")]
    pub keyid: String,
    /// The signature's bytes.
    #[serde(serialize_with = "base64")]
    pub sig: Vec<u8>,
}

/// A DSSE envelope as it came, nothing verified.
///
/// As part of other JSON it reads and writes as [`Envelope::parse`] and [`Envelope::to_json`] do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "JsonEnvelope")]
pub struct Envelope {
    /// The body's bytes.
    #[serde(serialize_with = "base64")]
    pub payload: Vec<u8>,
    /// How the body is to be read.
    #[serde(rename = "payloadType")]
    pub payload_type: String,
    /// The signatures over [`Envelope::pae`].
    pub signatures: Vec<EnvelopeSignature>,
    /// Names of JSON fields that this reader ignored.
    #[serde(skip)]
    pub ignored_fields: Vec<String>,
}

/// An envelope as it is read: fields unknown to us by their names.
#[derive(Deserialize)]
struct JsonEnvelope {
    payload: String,
    #[serde(rename = "payloadType")]
    payload_type: String,
    signatures: Vec<JsonSignature>,
    #[serde(flatten)]
    ignored: BTreeMap<String, IgnoredAny>,
}

#[derive(Deserialize)]
struct JsonSignature {
    #[serde(default)]
    keyid: Option<String>,
    sig: String,
    #[serde(flatten)]
    ignored: BTreeMap<String, IgnoredAny>,
}

impl Envelope {
    /// An envelope without signatures yet.
    pub fn new(payload_type: impl Into<String>, payload: impl Into<Vec<u8>>) -> Self {
        Self {
            payload_type: payload_type.into(),
            payload: payload.into(),
            signatures: Vec::new(),
            ignored_fields: Vec::new(),
        }
    }

    /// The bytes that signatures cover: `DSSEv1 SP len(type) SP type SP len(body) SP body`.
    pub fn pae(&self) -> Vec<u8> {
        pae(&self.payload_type, &self.payload)
    }

    /// SHA-256 of [`Envelope::pae`]: what names this record everywhere.
    pub fn digest(&self) -> Digest {
        Digest::of(self.pae())
    }

    /// Adds a signature by `key`.
    pub fn sign(&mut self, key: &OwnerKey) {
        let keyid = key.public().id().to_string();
        let sig = key.sign(&self.pae()).to_vec();
        self.signatures.push(EnvelopeSignature { keyid, sig });
    }

    /// The first signature that verifies under `key`, whatever its `keyid` says.
    pub fn signature_by(&self, key: &PublicKey) -> Option<&EnvelopeSignature> {
        let pae = self.pae();
        self.signatures.iter().find(|s| key.verify(&pae, &s.sig).is_ok())
    }

    /// The body, where its type is the `expected` one.
    ///
    /// # Errors
    /// [`DsseError::PayloadType`].
    pub fn body(&self, expected: &'static str) -> Result<&[u8], DsseError> {
        if self.payload_type != expected {
            return Err(DsseError::PayloadType { expected, got: clip(&self.payload_type) });
        }
        Ok(&self.payload)
    }

    /// Reads an envelope's JSON. Verifies nothing.
    ///
    /// # Errors
    /// [`DsseError`] other than [`DsseError::PayloadType`].
    pub fn parse(json: &[u8]) -> Result<Self, DsseError> {
        if json.len() > MAX_ENVELOPE_BYTES {
            return Err(DsseError::TooLarge { got: json.len() });
        }
        let raw: JsonEnvelope = serde_json::from_slice(json).map_err(|e| DsseError::Json { cause: e.to_string() })?;
        raw.try_into()
    }

    /// The envelope as compact JSON with standard base64. Fields that were ignored on reading are left out.
    pub fn to_json(&self) -> String {
        // Strings and lists only: there is nothing that could fail to serialise.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl TryFrom<JsonEnvelope> for Envelope {
    type Error = DsseError;

    fn try_from(raw: JsonEnvelope) -> Result<Self, DsseError> {
        if raw.signatures.is_empty() || raw.signatures.len() > MAX_SIGNATURES {
            return Err(DsseError::Signatures { got: raw.signatures.len() });
        }
        let payload = decode(&raw.payload, || "payload".into())?;
        let mut ignored_fields: Vec<String> = raw.ignored.into_keys().collect();
        let mut signatures = Vec::with_capacity(raw.signatures.len());
        for (i, signature) in raw.signatures.into_iter().enumerate() {
            let sig = decode(&signature.sig, || format!("signatures[{i}].sig"))?;
            ignored_fields.extend(signature.ignored.into_keys().map(|name| format!("signatures[{i}].{name}")));
            signatures.push(EnvelopeSignature { keyid: signature.keyid.unwrap_or_default(), sig });
        }
        Ok(Self { payload_type: raw.payload_type, payload, signatures, ignored_fields })
    }
}

fn base64<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&STANDARD.encode(bytes))
}

fn hint<S: Serializer>(keyid: &str, serializer: S) -> Result<S::Ok, S::Error> {
    if keyid.is_empty() { serializer.serialize_none() } else { serializer.serialize_str(keyid) }
}

/// Pre-authentication encoding (DSSE protocol, "Signature definition").
pub fn pae(payload_type: &str, body: &[u8]) -> Vec<u8> {
    let mut out = format!("DSSEv1 {} {} {} ", payload_type.len(), payload_type, body.len()).into_bytes();
    out.extend_from_slice(body);
    out
}

fn decode(text: &str, field: impl Fn() -> String) -> Result<Vec<u8>, DsseError> {
    const fn engine(alphabet: &Alphabet) -> GeneralPurpose {
        let config = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
        GeneralPurpose::new(alphabet, config)
    }
    const EITHER: [GeneralPurpose; 2] = [engine(&alphabet::STANDARD), engine(&alphabet::URL_SAFE)];
    EITHER.iter().find_map(|e| e.decode(text).ok()).ok_or_else(|| DsseError::Base64 { field: field() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pae_is_the_one_of_the_protocol() {
        // The protocol's own example.
        assert_eq!(
            pae("http://example.com/HelloWorld", b"hello world"),
            b"DSSEv1 29 http://example.com/HelloWorld 11 hello world"
        );
        assert_eq!(pae("", b""), b"DSSEv1 0  0 ");
        // Lengths are bytes, not characters.
        assert_eq!(pae("é", "ü".as_bytes()), "DSSEv1 2 é 2 ü".as_bytes());
    }

    #[test]
    fn both_alphabets_with_and_without_padding_are_read() {
        let body = [0xfb, 0xff, 0xfe, 0x3e];
        for text in ["+//+Pg==", "-__-Pg==", "+//+Pg", "-__-Pg"] {
            let json = format!(r#"{{"payload":"{text}","payloadType":"t","signatures":[{{"sig":"{text}"}}]}}"#);
            let envelope = Envelope::parse(json.as_bytes()).unwrap();
            assert_eq!((envelope.payload, envelope.signatures[0].sig.as_slice()), (body.to_vec(), &body[..]), "{text}");
        }
        for text in ["+/_+Pg==", "+//+Ph==", "+//+P", "+//+ Pg=="] {
            let json = format!(r#"{{"payload":"{text}","payloadType":"t","signatures":[{{"sig":""}}]}}"#);
            assert_eq!(Envelope::parse(json.as_bytes()), Err(DsseError::Base64 { field: "payload".into() }), "{text}");
        }
    }

    #[test]
    fn fields_unknown_are_named_and_fields_twice_refused() {
        let json = br#"{"payload":"","payloadType":"t","x":[1],"signatures":[{"sig":"","keyid":null,"y":{}}]}"#;
        assert_eq!(Envelope::parse(json).unwrap().ignored_fields, ["x", "signatures[0].y"]);
        for json in [
            r#"{"payload":"","payload":"","payloadType":"t","signatures":[{"sig":""}]}"#,
            r#"{"payload":"","payloadType":"t","signatures":[{"sig":"","sig":""}]}"#,
            r#"{"payload":"","signatures":[{"sig":""}]}"#,
            r#"{"payload":"","payloadType":"t","signatures":[{"keyid":""}]}"#,
            r#"{"payload":"","payloadType":"t","signatures":[{"sig":""}]} x"#,
            "",
            "[]",
        ] {
            assert!(matches!(Envelope::parse(json.as_bytes()), Err(DsseError::Json { .. })), "{json}");
        }
        let none = br#"{"payload":"","payloadType":"t","signatures":[]}"#;
        assert_eq!(Envelope::parse(none), Err(DsseError::Signatures { got: 0 }));
        let large = vec![b' '; MAX_ENVELOPE_BYTES + 1];
        assert_eq!(Envelope::parse(&large), Err(DsseError::TooLarge { got: MAX_ENVELOPE_BYTES + 1 }));
    }

    #[test]
    fn a_signature_is_found_by_key_and_not_by_its_hint() {
        let (owner, other) = (OwnerKey::from_seed(&[1; 32]), OwnerKey::from_seed(&[2; 32]));
        let mut envelope = Envelope::new("t", "body");
        envelope.sign(&owner);
        let read = Envelope::parse(envelope.to_json().as_bytes()).unwrap();
        assert_eq!(read, envelope);
        assert!(read.signature_by(&owner.public()).is_some());
        let mut renamed = read.clone();
        renamed.signatures[0].keyid = other.public().id().to_string();
        assert!(renamed.signature_by(&owner.public()).is_some());
        assert!(renamed.signature_by(&other.public()).is_none());
        // Type and body cannot trade bytes.
        let mut moved = read;
        moved.payload_type = "t b".into();
        assert!(moved.signature_by(&owner.public()).is_none());
    }
}
