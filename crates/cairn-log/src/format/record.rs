//! The owner record, version 1: the signed sentence "these photographs, and this mark of
//! them, are mine".
//!
//! It binds the owner's key to the digests of the photographs and of everything that made a mark, to
//! one log, one scene and one purpose, and to a nonce of the registry and a
//! checkpoint of its log, so that it can be neither moved elsewhere nor dated
//! back. That a contributor's *name* is a key's, a curator says in a record of its own, a binding. Serialised as JSON inside a DSSE envelope; reading is strict, since a
//! field that one reader skips and another obeys is a hole.

use serde::{Deserialize, Serialize};

pub use super::statement::RecordError;
use super::{
    digest::{Digest, clip, commitment, decimal},
    dsse::{Envelope, EnvelopeSignature},
    key::{KeyError, OwnerKey, PublicKey},
    merkle,
    statement::{self, Statement},
};

/// The DSSE payloadType of an owner record.
pub const PAYLOAD_TYPE: &str = "application/vnd.cairn.owner-record.v1+json";

/// The body's format version.
pub const VERSION: u32 = 1;

/// Longest scene, contributor, origin or purpose, in bytes.
pub const MAX_TEXT_BYTES: usize = 256;

/// Most photographs that [`OwnerRecord::views`] may list: their digests still fit into an envelope.
pub const MAX_VIEWS: usize = 512;

/// Numbers at or above this are rounded by readers that keep JSON numbers as floats.
pub(crate) const EXACT_IN_JSON: u64 = 1 << 53;

/// What a record says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordKind {
    /// Photographs belong to the owner; with an identity's number, so does its mark in a marked field.
    Claim,
    /// The owner contributed the photographs.
    Contribution,
    /// A training run made this share table, and this marked field and detector where there are some.
    Training,
    /// The owner's key is good no longer: records behind this one do not count, those before it stay good, except
    /// the one named in `replaces`, if any, which its owner takes back.
    Revocation,
    /// The owner of the record named in `replaces` goes on under this record's key; both keys sign, and the old one is
    /// good no longer, as after a revocation.
    Rotation,
    /// The record named in `replaces` is contested.
    Dispute,
    /// A curator says that the contributor's name stands for the key `identity.key`. Of a name's bindings that stand the
    /// newest counts, whichever curator signed it.
    Binding,
}

/// What a record does to the one that it names in `replaces`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// It stands, contested.
    Contests,
    /// Its owner takes it back: it counts no more.
    TakesBack,
    /// Its owner puts another in its place: it counts no more.
    Replaces,
    /// Its owner goes on under another key, and it counts as before.
    LeavesIt,
}

impl RecordKind {
    /// Whether a record of this kind credits its owner, for as long as no other takes it back or replaces it.
    pub const fn credits(self) -> bool {
        matches!(self, Self::Claim | Self::Contribution)
    }

    /// What a record of this kind does to the one that it names in `replaces`, where its signer may speak for that one's owner.
    pub const fn effect(self) -> Effect {
        match self {
            Self::Dispute => Effect::Contests,
            Self::Revocation => Effect::TakesBack,
            // A binding names no other record.
            Self::Claim | Self::Contribution | Self::Training | Self::Binding => Effect::Replaces,
            Self::Rotation => Effect::LeavesIt,
        }
    }

    /// All kinds, in the order of their codes.
    pub const ALL: [Self; 7] = [
        Self::Claim,
        Self::Contribution,
        Self::Training,
        Self::Revocation,
        Self::Rotation,
        Self::Dispute,
        Self::Binding,
    ];

    /// The kind's byte in a leaf: 1 to 6, and 8; 7 is the registry's own leaf's.
    pub const fn code(self) -> u8 {
        match self {
            Self::Claim => 1,
            Self::Contribution => 2,
            Self::Training => 3,
            Self::Revocation => 4,
            Self::Rotation => 5,
            Self::Dispute => 6,
            Self::Binding => 8,
        }
    }

    /// The kind of a leaf's byte.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.code() == code)
    }
}

/// Whom the record is about.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// The class that the classifier answers, 1..=M (0 is `unmarked`); none where the record is about photographs alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<u32>,
    /// The contributor's name.
    pub contributor: String,
    /// The key that a binding says the name stands for (hex); of no other kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<PublicKey>,
}

impl Identity {
    /// A contributor by name alone.
    pub fn named(contributor: &str) -> Self {
        Self { number: None, contributor: contributor.to_owned(), key: None }
    }

    /// Identity `number` of a model, which stands for `contributor`.
    pub fn numbered(number: u32, contributor: &str) -> Self {
        Self { number: Some(number), ..Self::named(contributor) }
    }
}

/// SHA-256 digests of what made the mark. Which of them a kind needs: see [`OwnerRecord::check`].
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Digests {
    /// The marked field's file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub marked_field: Option<Digest>,
    /// The detector's file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detector: Option<Digest>,
    /// Salted commitment to the hidden signal: see [`hidden_signal_commitment`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hidden_signal: Option<Digest>,
    /// The photographs: see [`photographs_root`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub photographs: Option<Digest>,
    /// The base field's file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_field: Option<Digest>,
    /// The base field's share table: which photograph taught which part of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share_table: Option<Digest>,
    /// The training configuration's file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training_configuration: Option<Digest>,
}

/// The newest checkpoint that the signer had seen: the record is not older than it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seen {
    /// The log's size.
    pub size: u64,
    /// The log's root at that size.
    pub root: Digest,
}

/// Body of an owner record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnerRecord {
    /// Format version, [`VERSION`].
    pub version: u32,
    /// What it says.
    pub kind: RecordKind,
    /// The log it is meant for; no other takes it.
    pub origin: String,
    /// The scene's name.
    pub scene: String,
    /// 32 random bytes of the signer (hex): without them the leaf's scene commitment says nothing.
    pub scene_salt: Digest,
    /// Whose photographs, whose mark.
    pub identity: Identity,
    /// The owner's key (hex).
    pub owner_key: PublicKey,
    /// Which photographs, and what made the mark.
    pub digests: Digests,
    /// Training seed; text in JSON, since it uses all 64 bits.
    #[serde(default, with = "seed_as_text", skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// What the record is for, in words.
    pub purpose: String,
    /// The registry's nonce for this scene and owner (hex).
    pub nonce: Digest,
    /// The newest checkpoint seen by the signer.
    pub seen: Seen,
    /// Digest (SHA-256 of the PAE) of the record that this one is about or replaces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub replaces: Option<Digest>,
    /// SHA-256 digests of the photographs (hex), ascending, each once, 1 to [`MAX_VIEWS`]: what makes the
    /// record answer for single views. They must be the photographs under `digests.photographs`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub views: Option<Vec<Digest>>,
}

impl Statement for OwnerRecord {
    const NAME: &'static str = "owner record";
    const PAYLOAD_TYPE: &'static str = PAYLOAD_TYPE;
    const VERSION: u32 = VERSION;

    fn signer(&self) -> PublicKey {
        self.owner_key
    }

    fn check(&self) -> Result<(), RecordError> {
        Self::check(self)
    }
}

impl OwnerRecord {
    /// The record as the bytes to sign, in an envelope signed by the owner.
    ///
    /// # Errors
    /// [`RecordError::Field`] where [`OwnerRecord::check`] finds one wrong, [`RecordError::OwnerSignature`] where
    /// `key` is not the owner's.
    pub fn seal(&self, key: &OwnerKey) -> Result<Envelope, RecordError> {
        statement::seal(self, key)
    }

    /// Reads the record of an envelope and verifies that the owner named in it signed exactly these bytes.
    ///
    /// The key stands in the body, so the body is read first; nothing of it is handed out unless the signature holds.
    /// Gives the record and the owner's signature.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn open(envelope: &Envelope) -> Result<(Self, &EnvelopeSignature), RecordError> {
        statement::open(envelope)
    }

    /// Reads and checks a body, without its signature.
    ///
    /// # Errors
    /// [`RecordError`] other than [`RecordError::OwnerSignature`].
    pub fn parse(body: &[u8]) -> Result<Self, RecordError> {
        statement::parse(body)
    }

    /// Checks every rule that needs nothing but the record.
    ///
    /// Needed per kind: a claim and a contribution name their photographs, which are what is owned. A claim with an
    /// identity's number is about its mark, too, and names marked field, detector and hidden signal. A training names
    /// share table, training configuration and seed, and of marked field and detector both or none. A rotation or
    /// dispute names the record that it is about. A binding names a key, and no identity's number, other record or views.
    ///
    /// # Errors
    /// [`RecordError::Version`] or [`RecordError::Field`].
    pub fn check(&self) -> Result<(), RecordError> {
        if self.version != VERSION {
            return Err(statement::version::<Self>(self.version.into()));
        }
        check_text(Self::NAME, "origin", &self.origin)?;
        check_text(Self::NAME, "scene", &self.scene)?;
        check_text(Self::NAME, "identity.contributor", &self.identity.contributor)?;
        check_text(Self::NAME, "purpose", &self.purpose)?;
        if self.identity.number == Some(0) {
            return Err(field("identity.number", "1 or more (0 is `unmarked`), or no such field", "0"));
        }
        self.check_binding()?;
        if self.seen.size >= EXACT_IN_JSON {
            return Err(field("seen.size", "less than 2^53", self.seen.size));
        }
        let (digests, of_mark) = (&self.digests, self.identity.number.is_some());
        let needs: &[(&'static str, bool)] = match self.kind {
            RecordKind::Claim => &[
                ("digests.photographs", digests.photographs.is_some()),
                ("digests.marked_field", !of_mark || digests.marked_field.is_some()),
                ("digests.detector", !of_mark || digests.detector.is_some()),
                ("digests.hidden_signal", !of_mark || digests.hidden_signal.is_some()),
            ],
            RecordKind::Contribution => &[("digests.photographs", digests.photographs.is_some())],
            RecordKind::Training => &[
                ("digests.share_table", digests.share_table.is_some()),
                ("digests.marked_field", digests.marked_field.is_some() || digests.detector.is_none()),
                ("digests.detector", digests.detector.is_some() || digests.marked_field.is_none()),
                ("digests.training_configuration", digests.training_configuration.is_some()),
                ("seed", self.seed.is_some()),
            ],
            RecordKind::Binding => &[("identity.key", self.identity.key.is_some())],
            RecordKind::Revocation => &[],
            RecordKind::Rotation | RecordKind::Dispute => &[("replaces", self.replaces.is_some())],
        };
        match needs.iter().find(|(_, there)| !there) {
            Some((name, _)) => Err(field(name, "a value, for a record of this kind", "nothing")),
            None => self.check_views(),
        }
    }

    /// A binding is about a name and a key alone, and no other kind names a key.
    fn check_binding(&self) -> Result<(), RecordError> {
        let is_binding = self.kind == RecordKind::Binding;
        if !is_binding && self.identity.key.is_some() {
            return Err(field("identity.key", "no such field, for a record of this kind", "a key"));
        }
        let none = "no such field, for a binding: it is about a name and a key, and of a name's the newest counts";
        match (self.identity.number, self.replaces, &self.views) {
            (Some(number), ..) if is_binding => Err(field("identity.number", none, number)),
            (_, Some(replaces), _) if is_binding => Err(field("replaces", none, replaces)),
            (.., Some(views)) if is_binding => Err(field("views", none, views.len())),
            _ => Ok(()),
        }
    }

    fn check_views(&self) -> Result<(), RecordError> {
        let Some(views) = &self.views else { return Ok(()) };
        if views.is_empty() || views.len() > MAX_VIEWS {
            return Err(field("views", "1 to 512 digests of photographs, or no such field", views.len()));
        }
        if let Some(pair) = views.windows(2).find(|pair| pair[0] >= pair[1]) {
            let got = format!("{} before {}", pair[0], pair[1]);
            return Err(field("views", "digests in ascending order, each once", got));
        }
        let root = photographs_root(views);
        if self.digests.photographs != Some(root) {
            let named = self.digests.photographs.map_or_else(|| "none".to_owned(), |d| d.to_string());
            let got = format!("digests with root {root}, where digests.photographs is {named}");
            return Err(field("views", "the photographs under digests.photographs, all of them", got));
        }
        Ok(())
    }
}

/// Merkle root (RFC 6962) over the photographs' SHA-256 digests in ascending order, each digest's 32 bytes being a leaf.
///
/// Ascending, so that neither file names nor their order matter. No photographs: SHA-256 of nothing.
pub fn photographs_root(photographs: &[Digest]) -> Digest {
    let mut sorted = photographs.to_vec();
    sorted.sort_unstable();
    let leaves: Vec<_> = sorted.iter().map(|digest| merkle::leaf_hash(digest.as_bytes())).collect();
    merkle::root(&leaves)
}

/// The files of a hidden signal as stored; what it has none of is empty.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SignalFiles<'a> {
    /// PNG.
    pub picture: &'a [u8],
    /// WAV.
    pub audio: &'a [u8],
    /// UTF-8.
    pub text: &'a [u8],
}

impl<'a> SignalFiles<'a> {
    /// A picture alone.
    pub fn picture(picture: &'a [u8]) -> Self {
        Self { picture, ..Self::default() }
    }

    /// Whether nothing is hidden.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Commitment to the hidden signal's bytes (its files as stored), so that the log cannot be searched for a known signal.
///
/// Of a picture alone, version 1: the picture's bytes. With a sound or a text, version 2: picture, sound and text in this
/// order, before each its length in bytes (64 bits, big-endian), 0 for what is not there; so that no two signals run
/// together into the same bytes.
pub fn hidden_signal_commitment(salt: &Digest, files: &SignalFiles<'_>) -> Digest {
    if files.audio.is_empty() && files.text.is_empty() {
        return commitment("cairn hidden signal v1", salt, files.picture);
    }
    let mut all = Vec::new();
    for part in [files.picture, files.audio, files.text] {
        all.extend((part.len() as u64).to_be_bytes());
        all.extend(part);
    }
    commitment("cairn hidden signal v2", salt, &all)
}

/// Commitment to the scene's name, as leaves carry it.
pub fn scene_commitment(salt: &Digest, scene: &str) -> Digest {
    commitment("cairn scene v1", salt, scene.as_bytes())
}

/// 32 random bytes for a salt.
///
/// # Errors
/// [`KeyError::Random`] where the system has none to give.
pub fn random_salt() -> Result<Digest, KeyError> {
    let mut salt = [0; 32];
    getrandom::fill(&mut salt).map_err(|e| KeyError::Random(e.to_string()))?;
    Ok(Digest::from_bytes(salt))
}

/// A field of an owner record with a value that is not allowed.
pub(crate) fn field(field: &'static str, expected: &'static str, got: impl ToString) -> RecordError {
    RecordError::Field { what: OwnerRecord::NAME, field, expected, got: got.to_string() }
}

/// `what` is the body whose field `field` holds `text`.
pub(crate) fn check_text(what: &'static str, field: &'static str, text: &str) -> Result<(), RecordError> {
    if text.is_empty() || text.len() > MAX_TEXT_BYTES || text.trim() != text || text.chars().any(char::is_control) {
        let expected = "1 to 256 bytes without control characters or outer blanks";
        let got = format!("{:?} ({} bytes)", clip(text), text.len());
        return Err(RecordError::Field { what, field, expected, got });
    }
    Ok(())
}

/// A seed as decimal text: JSON numbers above 2^53 are rounded by many readers.
mod seed_as_text {
    use super::decimal;
    use serde::{Deserialize, Deserializer, Serializer, de::Error as _};

    pub fn serialize<S: Serializer>(seed: &Option<u64>, serializer: S) -> Result<S::Ok, S::Error> {
        match seed {
            Some(seed) => serializer.collect_str(seed),
            None => serializer.serialize_none(),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
        let text = String::deserialize(deserializer)?;
        decimal(&text)
            .map(Some)
            .ok_or_else(|| D::Error::custom(format!("seed {text:?} is not a decimal number below 2^64")))
    }
}
