//! What an auditor believes, and what else is known of the folder.

use cairn_log::format::{Digest, NoteVerifier, Policy};

/// Whom to believe, and what else is known of the folder.
#[derive(Debug, Clone, Copy, Default)]
pub struct StoreOptions<'a> {
    /// The log's verifier key, obtained from elsewhere. Without it nothing is trusted.
    pub pinned: Option<&'a NoteVerifier>,
    /// The log's key as it lies in the folder: good for telling damage, not for trust.
    pub found: Option<&'a NoteVerifier>,
    /// Whose cosignatures the published checkpoint must carry.
    pub policy: Option<&'a Policy>,
    /// The models that lie in the folder, to be held to the records about them.
    pub stock: Option<&'a Stock>,
}

/// Digests that the folder's models have, a set a scene.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Stock {
    /// Scene, and the digests of its models' files and photographs' roots.
    pub scenes: std::collections::BTreeMap<String, std::collections::BTreeSet<Digest>>,
}
