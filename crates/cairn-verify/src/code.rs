//! The codes of findings: stable names that scripts may rely on.

use std::fmt;

use serde::{Serialize, Serializer};

/// How much a finding weighs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// A check that held.
    Passed,
    /// Something that could not be checked, or is worth knowing.
    Info,
    /// Something that limits what the report says.
    Warning,
    /// A check that failed: the outcome is [`crate::Outcome::Invalid`].
    Error,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Passed => "passed",
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        })
    }
}

macro_rules! codes {
    ($($(#[$doc:meta])* $name:ident = $text:literal, $severity:ident, $remedy:literal;)*) => {
        /// What a finding is about.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Code {
            $($(#[$doc])* $name,)*
        }

        impl Code {
            /// All codes.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// The stable name, as in JSON.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }

            /// How much it weighs.
            pub const fn severity(self) -> Severity {
                match self { $(Self::$name => Severity::$severity,)* }
            }

            /// What to do about it; empty where there is nothing to do.
            pub const fn remedy(self) -> &'static str {
                match self { $(Self::$name => $remedy,)* }
            }
        }
    };
}

codes! {
    /// The envelope cannot be read.
    EnvelopeMalformed = "envelope.malformed", Error, "get the envelope again from the registry or the owner";
    /// The envelope carries something that is no owner record.
    EnvelopeTypeUnknown = "envelope.type.unknown", Error, "use a release that knows this payloadType";
    /// JSON fields around the signed body that nobody signed and nobody reads.
    EnvelopeFieldIgnored = "envelope.field.ignored", Warning, "do not rely on these fields: they are not signed";
    /// The signed body is no owner record.
    RecordMalformed = "record.malformed", Error, "get the envelope again; if it stays so, its maker wrote a wrong record";
    /// A format version that this release does not know.
    RecordVersionUnknown = "record.version.unknown", Error, "use a release that knows this version";
    /// The record is meant for another log.
    RecordOriginMismatch = "record.origin.mismatch", Error, "pin the key of the log that the record names, or get the right record";
    /// The record claims to have seen a log larger than its own place.
    RecordSeenContradiction = "record.seen.contradiction", Error, "report both to the registry: one of them is not what it says";
    /// The owner's key has small order, so that anybody could have signed.
    KeySmallOrder = "key.small_order", Error, "trust nothing under this key";
    /// The owner named in the record signed it.
    OwnerSignatureValid = "signature.owner.valid", Passed, "";
    /// The owner named in the record did not sign these bytes.
    OwnerSignatureInvalid = "signature.owner.invalid", Error, "get the envelope again; it was changed, or the owner never signed";
    /// The pinned registry signed.
    RegistrySignatureValid = "signature.registry.valid", Passed, "";
    /// There is a signature besides the owner's, and none is by the pinned registry.
    RegistrySignatureInvalid = "signature.registry.invalid", Error, "check the pinned key, and get the envelope again from that registry";
    /// Nobody but the owner signed.
    RegistrySignatureMissing = "signature.registry.missing", Warning, "submit the record, and keep the envelope that the registry returns";
    /// No registry key is pinned.
    RegistryUnpinned = "registry.unpinned", Warning, "pin the registry's verifier key, obtained from somewhere other than this bundle";
    /// A signature by nobody known.
    SignatureUnknown = "signature.unknown", Warning, "do not count it as anybody's";
    /// A signature that holds, labelled as another key's, or unlabelled.
    SignatureKeyidMismatch = "signature.keyid.mismatch", Warning, "nothing rests on the label; tell the one who wrote it";
    /// The marked field in hand is the record's.
    MarkedFieldMatch = "digest.marked_field.match", Passed, "";
    /// The marked field in hand is another.
    MarkedFieldMismatch = "digest.marked_field.mismatch", Error, "use the marked field that the record is about, or the record of this one";
    /// The record names a marked field, and none is in hand.
    MarkedFieldUnchecked = "digest.marked_field.unchecked", Info, "hand in the file (--field, --against) to have it compared";
    /// The base field in hand is the record's.
    BaseFieldMatch = "digest.base_field.match", Passed, "";
    /// The base field in hand is another.
    BaseFieldMismatch = "digest.base_field.mismatch", Error, "use the base field that the record is about, or the record of this one";
    /// The record names a base field, and none is in hand.
    BaseFieldUnchecked = "digest.base_field.unchecked", Info, "hand in the file (--base-field, --against) to have it compared";
    /// The share table in hand is the record's.
    ShareTableMatch = "digest.share_table.match", Passed, "";
    /// The share table in hand is another.
    ShareTableMismatch = "digest.share_table.mismatch", Error, "use the share table that the record is about, or the record of this one";
    /// The record names a share table, and none is in hand.
    ShareTableUnchecked = "digest.share_table.unchecked", Info, "hand in the file (--share-table, --against) to have it compared";
    /// The detector in hand is the record's.
    DetectorMatch = "digest.detector.match", Passed, "";
    /// The detector in hand is another.
    DetectorMismatch = "digest.detector.mismatch", Error, "use the detector that the record is about: another one proves nothing";
    /// The record names a detector, and none is in hand.
    DetectorUnchecked = "digest.detector.unchecked", Info, "hand in the file (--detector, --against) to have it compared";
    /// The hidden signal in hand is the record's.
    HiddenSignalMatch = "digest.hidden_signal.match", Passed, "";
    /// The hidden signal or salt in hand is another.
    HiddenSignalMismatch = "digest.hidden_signal.mismatch", Error, "use the signal and the salt that the record was made with";
    /// The record commits to a hidden signal, and none is in hand.
    HiddenSignalUnchecked = "digest.hidden_signal.unchecked", Info, "ask the owner for the signal and its salt, and put them into the bundle's folder";
    /// The photographs in hand are the record's.
    PhotographsMatch = "digest.photographs.match", Passed, "";
    /// The photographs in hand are others, or not all of them.
    PhotographsMismatch = "digest.photographs.mismatch", Error, "hand in all photographs of the record, unchanged (`cairn owners show` names them). Where they were scaled at import, the record is about the scene's copies (--against)";
    /// The record names photographs, and none are in hand.
    PhotographsUnchecked = "digest.photographs.unchecked", Info, "hand in the photographs (--photographs, --against) to have them compared";
    /// The training configuration in hand is the record's.
    ConfigurationMatch = "digest.training_configuration.match", Passed, "";
    /// The training configuration in hand is another.
    ConfigurationMismatch = "digest.training_configuration.mismatch", Error, "use the configuration file that the training run wrote";
    /// The record names a training configuration, and none is in hand.
    ConfigurationUnchecked = "digest.training_configuration.unchecked", Info, "hand in the file (--settings, --against) to have it compared";
    /// The proof cannot be read.
    ProofMalformed = "proof.malformed", Error, "get the .tlog-proof again from the registry";
    /// The checkpoint cannot be read.
    CheckpointMalformed = "checkpoint.malformed", Error, "get the .tlog-proof again from the registry";
    /// The checkpoint is of a log that is not pinned.
    CheckpointOriginUnknown = "checkpoint.origin.unknown", Error, "pin that log's key if you trust it, or get a proof from the pinned log";
    /// The pinned log did not sign the checkpoint.
    CheckpointSignatureInvalid = "checkpoint.signature.invalid", Error, "get the .tlog-proof again; if it stays so, do not trust this copy";
    /// The pinned log signed the checkpoint.
    CheckpointVerified = "checkpoint.verified", Passed, "";
    /// The record is in the log of the checkpoint.
    InclusionProven = "inclusion.proven", Passed, "";
    /// The record is not where the proof says.
    InclusionFailed = "inclusion.failed", Error, "get the proof of this very record; if it stays so, the registry broke its word";
    /// There is no proof.
    InclusionMissing = "inclusion.missing", Warning, "get the record's .tlog-proof from the registry";
    /// There is no view of the log, so what came after the record is unknown.
    FreshnessUnknown = "freshness.unknown", Warning, "hand in the log's later records to learn of revocations and disputes";
    /// Later records are known up to some size.
    FreshnessKnown = "freshness.known", Passed, "";
    /// A later record that was handed in does not hold.
    LaterRecordInvalid = "later.invalid", Warning, "get the log's records again; this one was not counted";
    /// The owner, or the key that rotations put in the owner's place, took this very record back.
    RecordRevoked = "record.revoked", Error, "ask the owner for the record that holds now";
    /// The owner, or the key that rotations put in the owner's place, put another record in this one's.
    RecordReplaced = "record.replaced", Warning, "ask for the record that its owner put in its place, and use that";
    /// The owner's key was ended before this record.
    RecordAfterRevocation = "record.after_revocation", Error, "trust nothing that this key signed behind that index";
    /// The owner's key was ended behind this record, which stays good.
    KeyEndedLater = "key.ended_later", Info, "";
    /// Somebody contests the record.
    RecordDisputed = "record.disputed", Warning, "read the dispute before you rely on the record";
    /// There is no published checkpoint.
    StoreCheckpointMissing = "store.checkpoint.missing", Error, "restore public/checkpoint from a copy; the registry writes it when it starts";
    /// The published checkpoint cannot be read.
    StoreCheckpointMalformed = "store.checkpoint.malformed", Error, "restore public/checkpoint from a copy; the registry writes it when it starts";
    /// The published checkpoint is not one that the log's key signed.
    StoreCheckpointSignature = "store.checkpoint.signature", Error, "check the pinned key; if it is right, do not trust this copy of the log";
    /// The published checkpoint is the pinned log's.
    StoreCheckpointVerified = "store.checkpoint.verified", Passed, "";
    /// No key of the log was given or found, so none of its signatures were verified.
    StoreKeyMissing = "store.key.missing", Warning, "pin the log's verifier key: without it a changed signature cannot be told";
    /// The log's key was found beside the log and not pinned.
    StoreKeyUnpinned = "store.key.unpinned", Warning, "pin the log's verifier key, obtained from somewhere other than this folder";
    /// A signature line of the checkpoint that nobody known made.
    StoreCosignatureUnknown = "store.cosignature.unknown", Info, "name the witness in the policy to have its line verified";
    /// An entry bundle is missing, cut off, or holds another leaf than its record makes.
    StoreEntry = "store.entry", Error, "restore the file from a copy, or have the registry write it anew from the envelopes";
    /// A tile of hashes is missing.
    StoreTileMissing = "store.tile.missing", Error, "restore the file from a copy, or have the registry write it anew";
    /// A tile of hashes is not what the log's leaves make.
    StoreTileMismatch = "store.tile.mismatch", Error, "restore the file from a copy, or have the registry write it anew";
    /// The log's leaves lead to another root than the one signed.
    StoreRoot = "store.root", Error, "restore the files named beside it; where none is, the registry broke its word: keep this copy";
    /// The log's leaves lead to the root that was signed.
    StoreRootVerified = "store.root.verified", Passed, "";
    /// A file that does not belong there.
    StoreFileUnknown = "store.file.unknown", Error, "find out who put it there; nothing reads it";
    /// Entries behind the published checkpoint.
    StoreTail = "store.tail", Info, "they were on their way when the registry stopped; it publishes them when it starts";
    /// A file of envelopes is missing, cut off, or framed wrongly.
    StoreEnvelopeFile = "store.envelope.file", Error, "restore the file from a copy: the registry cannot make records anew";
    /// An envelope that is not exactly as the registry writes it.
    StoreEnvelope = "store.envelope", Error, "restore the file from a copy: the registry cannot make records anew";
    /// A record that its owner or the log did not sign.
    StoreRecordSignature = "store.record.signature", Error, "restore the file from a copy: the registry cannot make records anew";
    /// The signature of a replaced record's owner, who cannot be known any more.
    StorePredecessorUnknown = "store.record.predecessor.unknown", Info, "";
    /// A record that the log's rules do not let in.
    StoreRecordRule = "store.record.rule", Error, "ask the registry why it took the record; until then do not rely on it";
    /// A record that says it had seen what the log never was.
    StoreRecordSeen = "store.record.seen", Error, "ask the registry why it took the record; its time bound is void";
    /// All records hold.
    StoreRecordsVerified = "store.records.verified", Passed, "";
    /// A map leaf that is misplaced, malformed or not signed by the log.
    StoreMapLeaf = "store.map.leaf", Error, "keep this copy: the log signed, or holds, what it must not";
    /// The map that follows from the records has another root than the one logged.
    StoreMapRoot = "store.map.root", Error, "restore the files named; where all records hold, the log's answers leave something out";
    /// Map roots that could not be recomputed, for want of a record's keys.
    StoreMapUnchecked = "store.map.unchecked", Warning, "restore the records named, then audit again";
    /// Every map root is the one that follows from the records.
    StoreMapVerified = "store.map.verified", Passed, "";
    /// The working state is not sealed, so its files were not compared.
    WorkingUnsealed = "working.unsealed", Info, "stop the registry cleanly to have it sealed; everything public is checked all the same";
    /// The seal of the working state cannot be read.
    WorkingSeal = "working.seal", Error, "restore working/ with its seal from a backup that is as new as the published checkpoint; the public files are what counts for others";
    /// A file of the working state is missing, changed, or not in the seal.
    WorkingMismatch = "working.mismatch", Error, "restore working/ with its seal from a backup that is as new as the published checkpoint; the public files are what counts for others";
    /// The working state is as it was sealed.
    WorkingVerified = "working.verified", Passed, "";
    /// The daemon's own state is not sealed, so its files were not compared.
    StateUnsealed = "state.unsealed", Info, "stop the daemon cleanly to have it sealed";
    /// The seal of the daemon's own state cannot be read.
    StateSeal = "state.seal", Error, "restore access/, owners/ and registry.key with state.seal from one backup";
    /// A file of the daemon's own state is missing, changed, or not in the seal.
    StateMismatch = "state.mismatch", Error, "restore access/, owners/ and registry.key with state.seal from one backup";
    /// The daemon's own state is as it was sealed.
    StateVerified = "state.verified", Passed, "";
    /// A manifest cannot be read, or is not as it is written.
    ManifestMalformed = "manifest.malformed", Error, "restore the folder from a copy";
    /// A folder without a manifest: files that no digest names were not compared.
    ManifestMissing = "manifest.missing", Info, "it is still being worked on; where no process does, restore the folder from a copy";
    /// A file is missing, or is not the one that its manifest, record or table names.
    FileMismatch = "file.mismatch", Error, "restore the file from a copy";
    /// A file that no manifest names.
    FileUnknown = "file.unknown", Error, "find out who put it there; nothing reads it";
    /// A folder's files are those of its manifest.
    FolderVerified = "folder.verified", Passed, "";
    /// A file whose bytes nothing can vouch for.
    FileUncovered = "file.uncovered", Info, "nothing rests on it";
    /// A stored view or model cannot be rendered.
    RenderFailed = "render.failed", Error, "restore the scene's and the model's files from a copy";
    /// In none of the sampled renders was the cluster's identity found.
    RenderMarkLost = "render.mark.lost", Warning, "score the scene with `cairn evaluate`; a model trained too briefly marks nothing";
    /// Renders of the marked field lead to the cluster's identity.
    RenderMarkFound = "render.mark.found", Passed, "";
    /// The witnesses' quorum cosigned the checkpoint.
    PolicyQuorumMet = "policy.quorum.met", Passed, "";
    /// Fewer witnesses than the policy asks for cosigned the checkpoint.
    PolicyQuorumMissing = "policy.quorum.missing", Error, "get a proof with the witnesses' cosignatures (`cairn owners submit` on the bundle's folder); without them a forked log cannot be told";
    /// A witness of the policy signed this line, and the signature does not hold.
    PolicySignatureInvalid = "policy.signature.invalid", Error, "get the proof again; if it stays so, do not trust this copy";
    /// The record is not younger than this.
    TimeNotLaterThan = "time.not_later_than", Passed, "";
    /// The record is not older than this.
    TimeNotEarlierThan = "time.not_earlier_than", Passed, "";
    /// The log is the one last seen, grown or not.
    FollowConsistent = "follow.consistent", Passed, "";
    /// The first look at a log: there is nothing to compare with.
    FollowFirst = "follow.first", Info, "keep the state: the next look is held to this one";
    /// Two signed checkpoints of one log contradict each other.
    FollowContradiction = "follow.contradiction", Error, "keep the evidence, send it to the log's witnesses and users, and stop relying on the log";
    /// What the log serves does not make the tree that it signed.
    FollowTiles = "follow.tiles", Error, "try again; if it stays so, the log serves other data than it signed";
    /// The evidence proves that the log signed two histories.
    EvidenceProven = "evidence.proven", Passed, "";
    /// Both checkpoints are signed, and whether they exclude each other cannot be told.
    EvidenceUntold = "evidence.untold", Warning, "get the tiles of the larger tree; a log that only steps back shows an old state, which its witnesses' times can tell";
    /// The evidence shows no contradiction.
    EvidenceNone = "evidence.none", Error, "look for the files that were kept when the contradiction was found";
    /// The new entries are those of the tree.
    FollowEntries = "follow.entries.verified", Passed, "";
    /// The newest leaf of a log must be a map leaf, and every map leaf signed by the log.
    FollowMapLeaf = "follow.map.leaf", Error, "keep the answer: the log holds what it must not";
    /// The answer cannot be read.
    AnswerMalformed = "answer.malformed", Error, "get the answer again from the registry";
    /// An answer of a format that this release does not know.
    AnswerFormatUnknown = "answer.format.unknown", Error, "use a release that knows this format";
    /// The answer is to what was asked.
    AnswerQuestionMatch = "answer.question.match", Passed, "";
    /// The answer is to another question.
    AnswerQuestionMismatch = "answer.question.mismatch", Error, "ask the registry again, and audit the answer to your own question. A photograph that was scaled at import goes by the scene's copy, or that one's SHA-256";
    /// The answer names another log than its checkpoint.
    AnswerOriginMismatch = "answer.origin.mismatch", Error, "get the answer again; it was put together from two logs";
    /// The log of the answer begins with the one of the older checkpoint asked for.
    AnswerAsOfProven = "answer.as_of.proven", Passed, "";
    /// The log of the answer does not begin with the one of the older checkpoint.
    AnswerAsOfInconsistent = "answer.as_of.inconsistent", Error, "keep both checkpoints: if the registry signed both, it rewrote its log";
    /// The registry signed the map's root for this place in the log.
    MapLeafValid = "map.leaf.valid", Passed, "";
    /// The map leaf is broken, by somebody else, or made for another place.
    MapLeafInvalid = "map.leaf.invalid", Error, "get the answer again; if it stays so, do not trust this registry's map";
    /// The map leaf is not the checkpoint's last, so later records may be left out.
    MapLeafNotLast = "map.leaf.not_last", Error, "ask again for an answer under the newest map";
    /// The map leaf is not in the log of the checkpoint.
    MapLeafNotIncluded = "map.leaf.not_included", Error, "get the answer again; if it stays so, the registry broke its word";
    /// A list is proven to be the whole one.
    MapMembershipProven = "map.membership.proven", Passed, "";
    /// It is proven that nothing is listed.
    MapAbsenceProven = "map.absence.proven", Passed, "";
    /// A list is not the whole one, or holds what is not in the map.
    MapProofFailed = "map.proof.failed", Error, "do not rely on this answer: something was left out of it or put into it";
    /// A list that the question needs is not there.
    AnswerIncomplete = "answer.incomplete", Error, "get the whole answer: without this list it is unknown what the records are worth";
    /// A list that the question does not need.
    AnswerListForeign = "answer.list.foreign", Error, "get the answer again; this part answers another question";
    /// All records that the lists name are in the log.
    AnswerRecordsProven = "answer.records.proven", Passed, "";
    /// A list names a record that is not there.
    AnswerRecordMissing = "answer.record.missing", Error, "get the whole answer: a record was left out of it";
    /// A record that no list names, or that does not concern what it is listed under.
    AnswerRecordForeign = "answer.record.foreign", Error, "do not count this record: it does not belong to the answer";
    /// A record that is not the one listed, or an envelope that is not the leaf's.
    AnswerRecordMismatch = "answer.record.mismatch", Error, "get the answer again: this record was exchanged or changed";
    /// The record's envelope was erased; its place in the log stays proven.
    AnswerRecordErased = "answer.record.erased", Info, "";
    /// The record lies behind the checkpoint asked for.
    AnswerRecordLater = "answer.record.later", Info, "";
    /// The record's owner took it back.
    AnswerRecordRevoked = "answer.record.revoked", Warning, "do not count this record";
    /// The record's owner put another in its place.
    AnswerRecordReplaced = "answer.record.replaced", Info, "";
    /// The owner's key had ended before the record.
    AnswerRecordKeyEnded = "answer.record.key_ended", Warning, "do not count this record";
    /// A curator bound the contributor's name to the owner's key, or to one that rotations join with it.
    AnswerRecordConfirmed = "answer.record.confirmed", Passed, "";
    /// No curator bound the contributor's name to the owner's key: anybody may have entered the record.
    AnswerRecordUnconfirmed = "answer.record.unconfirmed", Warning, "ask who curates the scene whether the key is the contributor's; they say so by `cairn owners bind`";
    /// The registry signed the shares, about what was asked, and they add up.
    SharesVerified = "shares.verified", Passed, "";
    /// The answer about a view has no shares.
    SharesMissing = "shares.missing", Info, "";
    /// The statement of shares cannot be read.
    SharesMalformed = "shares.malformed", Error, "ask for the answer about the view again (`cairn owners answer --view`)";
    /// The pinned registry did not sign these shares.
    SharesSignatureInvalid = "shares.signature.invalid", Error, "get the answer again; the statement was changed, or another registry made it";
    /// The shares are of another log, scene or photograph than the answer.
    SharesSubjectMismatch = "shares.subject.mismatch", Error, "get the answer again; it was put together from two";
    /// The shares were signed under another checkpoint than the answer's.
    SharesCheckpointMismatch = "shares.checkpoint.mismatch", Error, "get the answer again; it was put together from two";
    /// The shares do not add up.
    SharesSumMismatch = "shares.sum.mismatch", Error, "keep the answer: the registry signed what cannot be";
    /// The file in hand is the one that the shares were worked out from.
    SharesFileMatch = "shares.file.match", Passed, "";
    /// The file in hand is another than the one that the shares were worked out from.
    SharesFileMismatch = "shares.file.mismatch", Error, "use the file whose digest the statement names";
    /// The scene's view has the statement's camera and photograph, and its photographs are their contributors'.
    SharesCameraMatch = "shares.camera.match", Passed, "";
    /// The scene's view has another camera or photograph.
    SharesCameraMismatch = "shares.camera.mismatch", Error, "use the scene that the statement is about; if it is that one, the shares are of another view";
    /// A photograph that the statement names is another one in the scene, or another contributor's.
    SharesPhotographMismatch = "shares.photograph.mismatch", Error, "use the scene that the statement is about; if it is that one, the shares credit the wrong contributor";
    /// A photograph of the scene that is not held out, and that the share table does not have.
    SharesPhotographLeftOut = "shares.photograph.left_out", Warning, "ask who runs the registry why it taught the field nothing: its contributor gets no share anywhere";
    /// Every camera of the share table stands where the scene's does.
    SharesPositionMatch = "shares.position.match", Passed, "";
    /// A camera of the share table stands elsewhere in the scene, and shares go by where cameras stand.
    SharesPositionMismatch = "shares.position.mismatch", Error, "use the scene that the statement is about; if it is that one, keep the files: the table moves a camera";
    /// The shares were worked out in another way than this release's.
    SharesMethodUnknown = "shares.method.unknown", Error, "use the release that the statement was made with";
    /// The shares are those that field, table and camera give.
    SharesRecomputed = "shares.recomputed", Passed, "";
    /// A share is not the one that field, table and camera give.
    SharesRecomputedMismatch = "shares.recomputed.mismatch", Error, "keep the answer: the registry signed a share that its own field and table contradict";
    /// What the table says of a photograph is what it teaches the field.
    SharesRowsMatch = "shares.rows.match", Passed, "";
    /// What the table says of a photograph is not what it teaches the field.
    SharesRowsMismatch = "shares.rows.mismatch", Error, "keep the files: the table was not made from this field and these photographs";
    /// Cameras, names and photographs of the statement were not held to the scene.
    SharesSceneUnchecked = "shares.scene.unchecked", Info, "hand in the scene's folder (--scene-folder) to have them compared";
    /// What the table says of photographs was not worked out again.
    SharesRowsUnchecked = "shares.rows.unchecked", Info, "hand in the scene's folder (--scene-folder), or have more photographs looked at (--photographs)";
    /// Something about the record changed behind the checkpoint asked for.
    AnswerChangedLater = "answer.record.changed_later", Info, "";
}

impl Serialize for Code {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}
