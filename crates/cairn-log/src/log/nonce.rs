//! Nonces: the registry's half of proof of possession.
//!
//! A nonce is good for one record, one scene and one owner's key. It carries the log's size when
//! it was issued, random bytes, and a MAC over them under a secret derived from
//! the registry's key. So issued nonces take no memory (nobody can fill it by asking),
//! survive a restart, and age by the log's growth, not by anybody's clock; used ones stand in the store. Where that was made
//! again, nobody knows which nonces erased records used: then none that one of them can have used is good any more.

use hmac::{Hmac, KeyInit as _, Mac as _};
use sha2::Sha256;
use zeroize::Zeroizing;

use crate::format::{
    digest::Digest,
    key::{KeyError, OwnerKey, PublicKey},
};

/// Entries, records and map leaves, that the log may grow by until a nonce is no longer good.
pub const NONCE_LIFETIME: u64 = 65_536;

const TAG: usize = 16;

/// Issues and recognises nonces.
pub(super) struct Nonces {
    secret: Zeroizing<[u8; 32]>,
    origin: String,
    /// Those issued at a smaller size are no longer good, whatever their age.
    from: u64,
}

/// Why a nonce is no good.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum BadNonce {
    Foreign,
    Expired { issued: u64 },
}

impl Nonces {
    pub(super) fn new(key: &OwnerKey, origin: &str, from: u64) -> Self {
        Self { secret: key.derive("cairn registry nonces v1"), origin: origin.to_owned(), from }
    }

    pub(super) fn issue(&self, size: u64, scene: &str, owner: &PublicKey) -> Result<Digest, KeyError> {
        let mut nonce = [0; 32];
        nonce[..8].copy_from_slice(&size.to_be_bytes());
        getrandom::fill(&mut nonce[8..16]).map_err(|e| KeyError::Random(e.to_string()))?;
        let tag = self.mac(&nonce[..16], scene, owner).finalize().into_bytes();
        nonce[16..].copy_from_slice(&tag[..TAG]);
        Ok(Digest::from_bytes(nonce))
    }

    pub(super) fn check(&self, nonce: &Digest, size: u64, scene: &str, owner: &PublicKey) -> Result<(), BadNonce> {
        let (head, tag) = nonce.as_bytes().split_at(16);
        let mac = self.mac(head, scene, owner);
        mac.verify_truncated_left(tag).map_err(|_| BadNonce::Foreign)?;
        let mut issued = [0; 8];
        issued.copy_from_slice(&head[..8]);
        let issued = u64::from_be_bytes(issued);
        // Issued at a size that the log has not: the store is older than the nonce.
        if issued > size || size - issued > NONCE_LIFETIME || issued < self.from {
            return Err(BadNonce::Expired { issued });
        }
        Ok(())
    }

    fn mac(&self, head: &[u8], scene: &str, owner: &PublicKey) -> Hmac<Sha256> {
        let mut mac = Hmac::<Sha256>::new_from_slice(self.secret.as_ref()).expect("HMAC takes keys of any length");
        for part in [head, self.origin.as_bytes(), scene.as_bytes(), &owner.to_bytes()] {
            mac.update(&(part.len() as u64).to_be_bytes());
            mac.update(part);
        }
        mac
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nonce_is_good_for_its_scene_owner_log_and_age_only() {
        let key = OwnerKey::from_seed(&[7; 32]);
        let (owner, other) = (OwnerKey::from_seed(&[8; 32]).public(), OwnerKey::from_seed(&[9; 32]).public());
        let nonces = Nonces::new(&key, "log", 0);
        let nonce = nonces.issue(10, "liberty", &owner).unwrap();
        assert_ne!(nonce, nonces.issue(10, "liberty", &owner).unwrap());
        assert_eq!(nonces.check(&nonce, 10, "liberty", &owner), Ok(()));
        assert_eq!(nonces.check(&nonce, 10 + NONCE_LIFETIME, "liberty", &owner), Ok(()));
        let expired = Err(BadNonce::Expired { issued: 10 });
        assert_eq!(nonces.check(&nonce, 11 + NONCE_LIFETIME, "liberty", &owner), expired);
        assert_eq!(nonces.check(&nonce, 9, "liberty", &owner), expired);
        assert_eq!(nonces.check(&nonce, 10, "fern", &owner), Err(BadNonce::Foreign));
        assert_eq!(nonces.check(&nonce, 10, "liberty", &other), Err(BadNonce::Foreign));
        assert_eq!(Nonces::new(&key, "log2", 0).check(&nonce, 10, "liberty", &owner), Err(BadNonce::Foreign));
        let restarted = |from| Nonces::new(&key, "log", from);
        assert_eq!(restarted(0).check(&nonce, 10, "liberty", &owner), Ok(()));
        assert_eq!(restarted(10).check(&nonce, 10, "liberty", &owner), Ok(()));
        assert_eq!(restarted(11).check(&nonce, 12, "liberty", &owner), expired);
        for at in 0..32 {
            let mut bytes = *nonce.as_bytes();
            bytes[at] ^= 1;
            let changed = Digest::from_bytes(bytes);
            assert_eq!(nonces.check(&changed, 10, "liberty", &owner), Err(BadNonce::Foreign), "byte {at}");
        }
    }
}
