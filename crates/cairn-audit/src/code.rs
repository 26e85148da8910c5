//! The codes of findings: stable names that scripts may rely on.

use serde::{Serialize, Serializer};

use crate::report::Severity;

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
    OwnerSignatureInvalid = "signature.owner.invalid", Error, "get the envelope again; somebody changed it, or the owner never signed";
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
    SignatureKeyidMismatch = "signature.keyid.mismatch", Warning, "nothing rests on the label; tell whoever wrote it";
    /// The marked field in hand is the record's.
    MarkedFieldMatch = "digest.marked_field.match", Passed, "";
    /// The marked field in hand is another.
    MarkedFieldMismatch = "digest.marked_field.mismatch", Error, "use the marked field that the record is about, or the record of this one";
    /// The record names a marked field, and none is in hand.
    MarkedFieldUnchecked = "digest.marked_field.unchecked", Info, "hand in the file to have it compared";
    /// The detector in hand is the record's.
    DetectorMatch = "digest.detector.match", Passed, "";
    /// The detector in hand is another.
    DetectorMismatch = "digest.detector.mismatch", Error, "use the detector that the record is about: another one proves nothing";
    /// The record names a detector, and none is in hand.
    DetectorUnchecked = "digest.detector.unchecked", Info, "hand in the file to have it compared";
    /// The hidden signal in hand is the record's.
    HiddenSignalMatch = "digest.hidden_signal.match", Passed, "";
    /// The hidden signal or salt in hand is another.
    HiddenSignalMismatch = "digest.hidden_signal.mismatch", Error, "use the signal and the salt that the record was made with";
    /// The record commits to a hidden signal, and none is in hand.
    HiddenSignalUnchecked = "digest.hidden_signal.unchecked", Info, "hand in the signal and its salt to have them compared";
    /// The photographs in hand are the record's.
    PhotographsMatch = "digest.photographs.match", Passed, "";
    /// The photographs in hand are others, or not all of them.
    PhotographsMismatch = "digest.photographs.mismatch", Error, "hand in all photographs of the cluster, unchanged, and no others";
    /// The record names photographs, and none are in hand.
    PhotographsUnchecked = "digest.photographs.unchecked", Info, "hand in the photographs' digests to have them compared";
    /// The training configuration in hand is the record's.
    ConfigurationMatch = "digest.training_configuration.match", Passed, "";
    /// The training configuration in hand is another.
    ConfigurationMismatch = "digest.training_configuration.mismatch", Error, "use the configuration file that the training run wrote";
    /// The record names a training configuration, and none is in hand.
    ConfigurationUnchecked = "digest.training_configuration.unchecked", Info, "hand in the file to have it compared";
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
    /// The owner took this very record back.
    RecordRevoked = "record.revoked", Error, "ask the owner for the record that holds now";
    /// The owner's key was ended before this record.
    RecordAfterRevocation = "record.after_revocation", Error, "trust nothing that this key signed behind that index";
    /// The owner's key was ended behind this record, which stays good.
    KeyEndedLater = "key.ended_later", Info, "";
    /// Somebody contests the record.
    RecordDisputed = "record.disputed", Warning, "read the dispute before you rely on the record";
    /// The answer cannot be read.
    AnswerMalformed = "answer.malformed", Error, "get the answer again from the registry";
    /// An answer of a format that this release does not know.
    AnswerFormatUnknown = "answer.format.unknown", Error, "use a release that knows this format";
    /// The answer names another log than its checkpoint.
    AnswerOriginMismatch = "answer.origin.mismatch", Error, "get the answer again; somebody put it together from two logs";
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
    /// Something about the record changed behind the checkpoint asked for.
    AnswerChangedLater = "answer.record.changed_later", Info, "";
}

impl Serialize for Code {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}
