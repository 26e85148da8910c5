//! Registration by proof of possession: who wants an account signs the daemon's
//! nonce with the account's key.
//!
//! Nonces take no memory (nobody can fill it by asking): 8 bytes of time, 8 random
//! ones, and a MAC over them, the origin and the key, under a secret that is made at
//! every start and kept nowhere. One nonce is good for [`NONCE_LIFETIME_S`] and one
//! key; used again, it registers the same key again, which changes nothing.

use cairn_log::{Digest, OwnerKey, PublicKey};
use hmac::{Hmac, KeyInit as _, Mac as _};
use sha2::Sha256;
use zeroize::Zeroizing;

use crate::auth::roles::Role;

/// What the signed bytes begin with.
const DOMAIN: &[u8] = b"cairn registration v1\n";
/// How long a nonce is good, seconds.
pub const NONCE_LIFETIME_S: u64 = 600;
const TAG: usize = 16;

/// Why a registration is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RegistrationError {
    /// The operating system gave no random bytes.
    #[error("no nonce can be made: the operating system gave no random bytes ({0})")]
    Random(String),
    /// The nonce is not this daemon's for this key, or of an earlier run.
    #[error("the nonce is not one that this daemon gave for this key since its start; ask for a new one")]
    ForeignNonce,
    /// The nonce is too old.
    #[error(
        "the nonce was given at {issued}, it is {now}, and a nonce is good for {NONCE_LIFETIME_S} s; ask for a new one"
    )]
    ExpiredNonce {
        /// When it was given.
        issued: u64,
        /// The daemon's time.
        now: u64,
    },
    /// The signature does not verify.
    #[error(
        "the registration is not signed by the key that it brings, {key}; sign nonce, origin, name and role with it"
    )]
    BadSignature {
        /// The key.
        key: PublicKey,
    },
}

/// What somebody who wants an account signs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Registration {
    /// The daemon's nonce.
    pub nonce: Digest,
    /// The daemon's registry's origin line.
    pub origin: String,
    /// The account's key.
    pub key: PublicKey,
    /// What to call the account.
    pub name: String,
    /// The role asked for.
    pub role: Role,
}

impl Registration {
    /// The bytes that are signed: every field after its length, u64 big-endian.
    fn bytes(&self) -> Vec<u8> {
        let mut out = DOMAIN.to_vec();
        let (key, role) = (self.key.to_bytes(), self.role.to_string());
        for part in [self.nonce.as_bytes(), self.origin.as_bytes(), &key, self.name.as_bytes(), role.as_bytes()] {
            out.extend_from_slice(&(part.len() as u64).to_be_bytes());
            out.extend_from_slice(part);
        }
        out
    }

    /// Signs it.
    pub fn sign(&self, key: &OwnerKey) -> [u8; cairn_log::format::key::SIGNATURE_LEN] {
        key.sign(&self.bytes())
    }
}

/// Gives and recognises nonces.
pub struct Nonces {
    secret: Zeroizing<[u8; 32]>,
    origin: String,
}

impl std::fmt::Debug for Nonces {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Nonces(of {})", self.origin)
    }
}

impl Nonces {
    /// Nonces of the daemon with this origin, under a new secret.
    ///
    /// # Errors
    /// [`RegistrationError::Random`].
    pub fn new(origin: &str) -> Result<Self, RegistrationError> {
        let mut secret = Zeroizing::new([0; 32]);
        getrandom::fill(secret.as_mut()).map_err(|e| RegistrationError::Random(e.to_string()))?;
        Ok(Self { secret, origin: origin.to_owned() })
    }

    /// A nonce for a registration of `key`.
    ///
    /// # Errors
    /// [`RegistrationError::Random`].
    pub fn issue(&self, key: &PublicKey, now: u64) -> Result<Digest, RegistrationError> {
        let mut nonce = [0; 32];
        nonce[..8].copy_from_slice(&now.to_be_bytes());
        getrandom::fill(&mut nonce[8..16]).map_err(|e| RegistrationError::Random(e.to_string()))?;
        let tag = self.mac(&nonce[..16], key).finalize().into_bytes();
        nonce[16..].copy_from_slice(&tag[..TAG]);
        Ok(Digest::from_bytes(nonce))
    }

    /// Whether a registration is for here and now, and signed by the key that it brings.
    ///
    /// # Errors
    /// [`RegistrationError`].
    pub fn verify(&self, registration: &Registration, signature: &[u8], now: u64) -> Result<(), RegistrationError> {
        let (head, tag) = registration.nonce.as_bytes().split_at(16);
        let foreign = RegistrationError::ForeignNonce;
        if registration.origin != self.origin {
            return Err(foreign);
        }
        self.mac(head, &registration.key).verify_truncated_left(tag).map_err(|_| foreign)?;
        let mut issued = [0; 8];
        issued.copy_from_slice(&head[..8]);
        let issued = u64::from_be_bytes(issued);
        // Its own clock may have been set back; a nonce of the future is as good as an old one.
        if now.abs_diff(issued) > NONCE_LIFETIME_S {
            return Err(RegistrationError::ExpiredNonce { issued, now });
        }
        let key = registration.key;
        key.verify(&registration.bytes(), signature).map_err(|_| RegistrationError::BadSignature { key })
    }

    fn mac(&self, head: &[u8], key: &PublicKey) -> Hmac<Sha256> {
        let mut mac = Hmac::<Sha256>::new_from_slice(self.secret.as_ref()).expect("HMAC takes keys of any length");
        for part in [head, self.origin.as_bytes(), &key.to_bytes()] {
            mac.update(&(part.len() as u64).to_be_bytes());
            mac.update(part);
        }
        mac
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registration(nonces: &Nonces, key: &OwnerKey) -> Registration {
        let nonce = nonces.issue(&key.public(), 1000).unwrap();
        Registration { nonce, origin: "log".into(), key: key.public(), name: "ada".into(), role: Role::Contributor }
    }

    #[test]
    fn a_registration_is_good_for_its_key_name_role_daemon_and_time_only() {
        let (key, other) = (OwnerKey::from_seed(&[1; 32]), OwnerKey::from_seed(&[2; 32]));
        let nonces = Nonces::new("log").unwrap();
        let good = registration(&nonces, &key);
        let signature = good.sign(&key);
        assert_eq!(nonces.verify(&good, &signature, 1000), Ok(()));
        assert_eq!(nonces.verify(&good, &signature, 1000 + NONCE_LIFETIME_S), Ok(()));
        let late = nonces.verify(&good, &signature, 1001 + NONCE_LIFETIME_S);
        assert_eq!(late, Err(RegistrationError::ExpiredNonce { issued: 1000, now: 1001 + NONCE_LIFETIME_S }));

        let bad = Err(RegistrationError::BadSignature { key: key.public() });
        let renamed = Registration { name: "bob".into(), ..good.clone() };
        assert_eq!(nonces.verify(&renamed, &signature, 1000), bad);
        let raised = Registration { role: Role::Operator, ..good.clone() };
        assert_eq!(nonces.verify(&raised, &signature, 1000), bad);
        assert_eq!(nonces.verify(&good, &good.sign(&other), 1000), bad);
        assert_eq!(nonces.verify(&good, &signature[1..], 1000), bad);

        let foreign = Err(RegistrationError::ForeignNonce);
        let taken = Registration { key: other.public(), ..good.clone() };
        assert_eq!(nonces.verify(&taken, &taken.sign(&other), 1000), foreign);
        let elsewhere = Registration { origin: "log2".into(), ..good.clone() };
        assert_eq!(nonces.verify(&elsewhere, &elsewhere.sign(&key), 1000), foreign);
        assert_eq!(Nonces::new("log").unwrap().verify(&good, &signature, 1000), foreign, "an earlier run's");
        for at in 0..32 {
            let mut bytes = *good.nonce.as_bytes();
            bytes[at] ^= 1;
            let changed = Registration { nonce: Digest::from_bytes(bytes), ..good.clone() };
            assert_eq!(nonces.verify(&changed, &changed.sign(&key), 1000), foreign, "byte {at}");
        }
    }
}
