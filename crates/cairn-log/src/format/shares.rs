//! A statement of shares, version 1: the registry's signed sentence "so much of what this view shows was shown to the
//! training by these photographs".
//!
//! It names everything that the shares were worked out from: the view's camera, and the digests of base field and share
//! table. So who has those files can work the shares out again. It is a JSON body in a DSSE envelope that the
//! registry's key signed, and stands beside a complete answer about the view ([`crate::format::answer::Answer::shares`]).
//! Unlike records it is in no log: it says what the registry said, under the checkpoint that it names.

use serde::{Deserialize, Serialize};

use super::{
    digest::Digest,
    dsse::Envelope,
    key::{OwnerKey, PublicKey},
    record::{EXACT_IN_JSON, Seen, check_text},
    serial,
    statement::{self, RecordError, Statement},
};

/// The DSSE payloadType of a statement of shares.
pub const PAYLOAD_TYPE: &str = "application/vnd.cairn.shares.v1+json";

/// The body's format version.
pub const VERSION: u32 = 1;

/// Most contributors of a statement, and most photographs of one: as many as a share table has numbers for.
pub const MAX_SHARES: usize = 65_536;

/// How far the sum of all shares may be from 1: what rounding does.
pub const MAX_SUM_ERROR: f64 = 1e-3;

/// Body of a statement of shares. All shares are from 0 to 1, and together 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shares {
    /// Format version, [`VERSION`].
    pub version: u32,
    /// The log whose registry says so.
    pub origin: String,
    /// The registry's key (hex), which signs.
    pub registry_key: PublicKey,
    /// The scene's name.
    pub scene: String,
    /// The view.
    pub view: SharedView,
    /// The view's camera, as the scene's table holds it.
    pub camera: serde_json::Value,
    /// What the shares were worked out from.
    pub files: SharedFiles,
    /// How sharply coverage goes by the angle: the power of its cosine.
    pub power: u32,
    /// The size of the picture whose pixels were looked at.
    pub sampled: Sampled,
    /// Whose photographs show what is seen, largest share first.
    #[serde(deserialize_with = "serial::up_to::<MAX_SHARES, _, _>")]
    pub contributors: Vec<ContributorShares>,
    /// What photographs show that were excluded since the training.
    pub excluded: f64,
    /// The scene's views that are excluded, and so credited to no contributor.
    #[serde(deserialize_with = "serial::up_to::<MAX_SHARES, _, _>")]
    pub excluded_views: Vec<SharedView>,
    /// What no photograph shows.
    pub unseen: f64,
    /// What lies behind the scene.
    pub behind: f64,
    /// The log's newest checkpoint when it was signed.
    pub checkpoint: Seen,
}

/// A view of the scene.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SharedView {
    /// Its name in the scene.
    pub name: String,
    /// SHA-256 of its photograph (hex).
    pub photograph: Digest,
}

/// SHA-256 digests (hex) of the model's files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SharedFiles {
    /// The base field.
    pub base_field: Digest,
    /// Its share table.
    pub share_table: Digest,
    /// The settings that both were made with.
    pub settings: Digest,
    /// The marked field; none where only the base field was trained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub marked_field: Option<Digest>,
}

/// A picture's size, px.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sampled {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
}

/// A contributor's part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContributorShares {
    /// Their name, as the import brought it.
    pub name: String,
    /// The sum of their photographs' shares.
    pub share: f64,
    /// Their photographs that show some of it, largest share first.
    #[serde(deserialize_with = "serial::up_to::<MAX_SHARES, _, _>")]
    pub photographs: Vec<PhotographShare>,
}

/// A photograph's part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhotographShare {
    /// The view's name in the scene.
    pub view: String,
    /// SHA-256 of the photograph (hex).
    pub photograph: Digest,
    /// Its share.
    pub share: f64,
}

impl Statement for Shares {
    const NAME: &'static str = "statement of shares";
    const PAYLOAD_TYPE: &'static str = PAYLOAD_TYPE;
    const VERSION: u32 = VERSION;

    fn signer(&self) -> PublicKey {
        self.registry_key
    }

    fn check(&self) -> Result<(), RecordError> {
        Self::check(self)
    }
}

impl Shares {
    /// The statement in an envelope signed by the registry.
    ///
    /// # Errors
    /// [`RecordError::Field`] where [`Shares::check`] finds one wrong, [`RecordError::OwnerSignature`] where `key` is not
    /// the one that it names.
    pub fn seal(&self, key: &OwnerKey) -> Result<Envelope, RecordError> {
        statement::seal(self, key)
    }

    /// Reads the statement of an envelope and verifies that the key named in it signed exactly these bytes. Whether that is
    /// the registry's is for who knows that key to say.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn open(envelope: &Envelope) -> Result<Self, RecordError> {
        Ok(statement::open(envelope)?.0)
    }

    /// Checks every rule that needs nothing but the statement, sums aside.
    ///
    /// # Errors
    /// [`RecordError::Version`] or [`RecordError::Field`].
    pub fn check(&self) -> Result<(), RecordError> {
        if self.version != VERSION {
            return Err(statement::version::<Self>(self.version.into()));
        }
        check_text(Self::NAME, "origin", &self.origin)?;
        check_text(Self::NAME, "scene", &self.scene)?;
        let refuse = |field, expected, got: String| Err(RecordError::Field { what: Self::NAME, field, expected, got });
        if self.checkpoint.size >= EXACT_IN_JSON {
            return refuse("checkpoint.size", "less than 2^53", self.checkpoint.size.to_string());
        }
        let of_photographs = self.contributors.iter().flat_map(|of| &of.photographs).map(|of| of.share);
        let of_contributors = self.contributors.iter().map(|of| of.share);
        let rest = [self.excluded, self.unseen, self.behind];
        match of_photographs
            .chain(of_contributors)
            .chain(rest)
            .find(|share| !(0.0..=1.0 + MAX_SUM_ERROR).contains(share))
        {
            Some(share) => refuse("shares", "numbers from 0 to 1", share.to_string()),
            None => Ok(()),
        }
    }

    /// Where shares do not add up: to 1 all together, and to a contributor's its photographs'. What does not, and its sum.
    pub fn wrong_sum(&self) -> Option<(String, f64)> {
        let is_wrong = |sum: f64, expected: f64| (sum - expected).abs() > MAX_SUM_ERROR;
        for of in &self.contributors {
            let sum = of.photographs.iter().map(|photograph| photograph.share).sum();
            if is_wrong(sum, of.share) {
                return Some((format!("the photographs of {:?}, whose share is {}", of.name, of.share), sum));
            }
        }
        let sum = self.contributors.iter().map(|of| of.share).sum::<f64>() + self.excluded + self.unseen + self.behind;
        is_wrong(sum, 1.0).then(|| ("all parts, which are 1 together".to_owned(), sum))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shares() -> Shares {
        let photograph = |view: &str, share| PhotographShare { view: view.into(), photograph: Digest::of(view), share };
        Shares {
            version: VERSION,
            origin: "cairn.example/log".into(),
            registry_key: OwnerKey::from_seed(&[9; 32]).public(),
            scene: "liberty".into(),
            view: SharedView { name: "a.png".into(), photograph: Digest::of("a.png") },
            camera: serde_json::json!({ "anything": [0.1, 1.0 / 3.0] }),
            files: SharedFiles {
                base_field: Digest::of("base"),
                share_table: Digest::of("table"),
                settings: Digest::of("settings"),
                marked_field: None,
            },
            power: 8,
            sampled: Sampled { width: 40, height: 30 },
            contributors: vec![ContributorShares {
                name: "ada".into(),
                share: 0.75,
                photographs: vec![photograph("b.png", 0.5), photograph("c.png", 0.25)],
            }],
            excluded: 0.0,
            excluded_views: Vec::new(),
            unseen: 0.125,
            behind: 0.125,
            checkpoint: Seen { size: 3, root: Digest::of("root") },
        }
    }

    #[test]
    fn a_statement_opens_to_itself_and_to_nothing_else() {
        let (key, other) = (OwnerKey::from_seed(&[9; 32]), OwnerKey::from_seed(&[8; 32]));
        let envelope = shares().seal(&key).unwrap();
        let read = Envelope::parse(envelope.to_json().as_bytes()).unwrap();
        assert_eq!(Shares::open(&read).unwrap(), shares());
        assert!(matches!(shares().seal(&other), Err(RecordError::OwnerSignature { .. })));
        let mut forged = read.clone();
        let said = String::from_utf8(forged.payload).unwrap();
        forged.payload = said.replace("\"ada\"", "\"eve\"").into_bytes();
        assert!(matches!(Shares::open(&forged), Err(RecordError::OwnerSignature { .. })));
        // An owner's record is none, and a statement is no record.
        let mut record = read;
        record.payload_type = crate::format::record::PAYLOAD_TYPE.into();
        assert!(matches!(Shares::open(&record), Err(RecordError::Envelope(_))));
        assert!(crate::format::record::OwnerRecord::open(&envelope).is_err());
    }

    #[test]
    fn reading_is_strict_and_shares_are_parts_of_one() {
        let with = |from: &str, to: &str| {
            let body = serde_json::to_string(&shares()).unwrap();
            let changed = body.replacen(from, to, 1);
            assert_ne!(changed, body, "{from}");
            statement::parse::<Shares>(changed.as_bytes()).unwrap_err().to_string()
        };
        assert!(with("{", r#"{"more":1,"#).contains("unknown field `more`"));
        assert!(with(r#""version":1"#, r#""version":2"#).contains("version 2, this release reads version 1"));
        for wrong in ["-0.1", "1.2"] {
            assert!(with(r#""share":0.5"#, &format!(r#""share":{wrong}"#)).contains("numbers from 0 to 1"), "{wrong}");
            assert!(with(r#""behind":0.125"#, &format!(r#""behind":{wrong}"#)).contains("numbers from 0 to 1"));
        }
        assert!(with(r#""share":0.5"#, r#""share":1e999"#).contains("out of range"));
        assert!(with("liberty", " liberty").contains("field scene"));
    }

    #[test]
    fn what_does_not_add_up_is_named() {
        assert_eq!(shares().wrong_sum(), None);
        let mut of_photographs = shares();
        of_photographs.contributors[0].photographs[0].share = 0.6;
        assert!(of_photographs.wrong_sum().unwrap().0.contains("\"ada\""));
        let whole = Shares { unseen: 0.2, ..shares() }.wrong_sum().unwrap();
        assert!(whole.0.contains("all parts") && (whole.1 - 1.075).abs() < 1e-9);
    }
}
