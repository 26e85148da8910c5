//! One stored record: its envelope byte for byte as the registry writes it, and every
//! signature on it.

use cairn_log::format::{
    Digest, DsseError, Envelope, OwnerRecord, PublicKey, RecordError, RecordKind, SignedRecord,
    dsse::EnvelopeSignature, leaf::LEAF_LEN, record::VERSION,
};

use crate::code::Code;

/// A record that holds.
pub(super) struct Sound {
    pub(super) record: OwnerRecord,
    pub(super) leaf: [u8; LEAF_LEN],
    /// What it does to another record, where it stands in that one's place or takes it back.
    pub(super) replacing: Option<Replacing>,
}

/// A record that bears on another: whether it may, the log as a whole tells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Replacing {
    /// The record replaced.
    pub(super) replaces: Digest,
    /// What the record is.
    pub(super) kind: RecordKind,
    /// Key id of its owner.
    pub(super) owner: Digest,
    /// Whether there is a signature by neither the owner nor the registry: of who may agree to it.
    pub(super) agreed: bool,
}

/// What is wrong with a stored record.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) code: Code,
    pub(super) expected: String,
    pub(super) got: String,
}

fn fault(code: Code, expected: impl ToString, got: impl ToString) -> Fault {
    Fault { code, expected: expected.to_string(), got: got.to_string() }
}

/// Checks an envelope's JSON as it lies in a slot. Without the registry's key its signature is taken as it is.
pub(super) fn check(json: &[u8], origin: Option<&str>, registry: Option<&PublicKey>) -> Result<Sound, Fault> {
    let envelope = Envelope::parse(json).map_err(|e| fault(Code::StoreEnvelope, "an envelope", e))?;
    if envelope.to_json().as_bytes() != json {
        let expected = "an envelope's JSON exactly as the registry writes it";
        return Err(fault(Code::StoreEnvelope, expected, "another spelling of it"));
    }
    let signed = SignedRecord::open(envelope).map_err(|e| match &e {
        RecordError::OwnerSignature { .. } => fault(Code::StoreRecordSignature, "signed by the owner that it names", e),
        RecordError::Envelope(DsseError::PayloadType { .. }) => fault(Code::StoreEnvelope, "an owner record", e),
        _ => fault(Code::StoreEnvelope, format!("an owner record of version {VERSION}"), e),
    })?;
    let named = &signed.record().origin;
    if let Some(origin) = origin.filter(|origin| *origin != named) {
        return Err(fault(Code::StoreRecordRule, format!("a record for {origin}"), named));
    }
    let replacing = signatures(signed.envelope(), signed.record(), registry)?;
    let (_, record, leaf) = signed.into_parts();
    Ok(Sound { leaf: leaf.encode(), record, replacing })
}

/// The owner's, where the record replaces another owner's that owner's, and the registry's; each under its key's id.
fn signatures(
    envelope: &Envelope,
    record: &OwnerRecord,
    registry: Option<&PublicKey>,
) -> Result<Option<Replacing>, Fault> {
    let refuse = |expected: &str, got: String| Err(fault(Code::StoreRecordSignature, expected, got));
    let pae = envelope.pae();
    let holds = |signature: &EnvelopeSignature, key: &PublicKey| {
        signature.keyid == key.id().to_string() && key.verify(&pae, &signature.sig).is_ok()
    };
    let (first, middle, last) = match envelope.signatures.as_slice() {
        [first, last] => (first, None, last),
        [first, middle, last] => (first, Some(middle), last),
        other => return refuse("signatures of the owner and of the registry", format!("{} signatures", other.len())),
    };
    if !holds(first, &record.owner_key) {
        return refuse("signatures[0] by the owner, under its key id", format!("one labelled {:?}", first.keyid));
    }
    if let Some(key) = registry.filter(|key| !holds(last, key)) {
        let expected = format!("the last signature by the registry's key {key}, under its key id");
        return refuse(&expected, format!("one labelled {:?} that does not verify", last.keyid));
    }
    let replaces = record.replaces.filter(|_| record.kind != RecordKind::Dispute);
    match (middle, replaces) {
        (None, _) if record.kind == RecordKind::Rotation => {
            refuse("a signature of the replaced record's owner", "none".to_owned())
        }
        (_, Some(replaces)) => {
            let (kind, owner) = (record.kind, record.owner_key.id());
            Ok(Some(Replacing { replaces, kind, owner, agreed: middle.is_some() }))
        }
        (None, None) => Ok(None),
        (Some(stranger), None) => refuse("no third signature", format!("one labelled {:?}", stranger.keyid)),
    }
}

/// Whether the middle signature of `json` is by the owner of the record in `other`.
pub(super) fn agreed_by(json: &[u8], other: &[u8]) -> bool {
    let (Ok(envelope), Ok(other)) = (Envelope::parse(json), Envelope::parse(other)) else { return false };
    let Ok(other) = OwnerRecord::parse(&other.payload) else { return false };
    let middle = envelope.signatures.get(1).filter(|_| envelope.signatures.len() == 3);
    let key = other.owner_key;
    middle.is_some_and(|s| s.keyid == key.id().to_string() && key.verify(&envelope.pae(), &s.sig).is_ok())
}
