//! The weaving secret, and the keys that follow from it (HKDF, RFC 5869, with SHA-256).
//!
//! A contributor's key is never used as a whole: its cells are dealt to [`PARTS`] parts with a sub-key each, so that one
//! part can be shown in a dispute and the others stay good. A cell's signs are the first bits of HMAC-SHA-256 (RFC 2104) of
//! its number, under the sub-key of its part.

use hkdf::Hkdf;
use hmac::{Hmac, KeyInit as _, Mac as _};
use sha2::{Digest as _, Sha256};
use std::fmt;
use zeroize::Zeroizing;

/// Parts of a contributor's cells, a sub-key each.
pub const PARTS: usize = 10;
/// What a secret is expanded with.
const SALT: &[u8] = b"cairn weaving 1";

type Mac = Hmac<Sha256>;

/// What all mark keys of one weaving follow from. It is drawn afresh for each.
pub struct WeavingSecret(Zeroizing<[u8; 32]>);

/// A contributor's mark key.
pub struct MarkKey(Zeroizing<[u8; 32]>);

/// The sub-key of one part of a contributor's cells.
pub struct PartKey(Zeroizing<[u8; 32]>);

/// Gives the signs of cells.
pub struct Signs(Mac);

/// Draws the owner and the part of cells.
pub struct Lottery(Mac);

/// A cell's lot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lot {
    /// Uniform in [0, 1).
    pub share: f64,
    /// Which part of its owner's cells it belongs to, below [`PARTS`].
    pub part: u8,
}

impl WeavingSecret {
    /// Of 32 random bytes.
    pub fn new(bytes: [u8; 32]) -> Self {
        Self(Zeroizing::new(bytes))
    }

    /// The mark key of the contributor of that name.
    pub fn mark_key(&self, contributor: &str) -> MarkKey {
        MarkKey(derived(&self.0, &[b"mark key", contributor.as_bytes()]))
    }

    /// What draws cells' owners.
    pub fn lottery(&self) -> Lottery {
        Lottery(mac(&derived(&self.0, &[b"lots"])))
    }
}

impl MarkKey {
    /// The sub-key of part `part`.
    ///
    /// # Panics
    /// When there is no such part.
    pub fn part(&self, part: usize) -> PartKey {
        assert!(part < PARTS, "one of {PARTS} parts");
        PartKey(derived(&self.0, &[b"part", &[part as u8]]))
    }
}

impl PartKey {
    /// Of a part that was revealed.
    pub fn of_bytes(bytes: [u8; 32]) -> Self {
        Self(Zeroizing::new(bytes))
    }

    /// What is revealed in a dispute. The part is spent then.
    pub fn to_bytes(&self) -> [u8; 32] {
        *self.0
    }

    /// What is published of it before anything is woven: SHA-256 of it, behind its purpose, the contributor and the part. It
    /// is 256 random bits, so that the digest tells nothing of it; and each part's is a commitment of its own, so that one
    /// can be shown without the others.
    pub fn commitment(&self, contributor: &str, part: usize) -> [u8; 32] {
        let name = Sha256::digest(contributor.as_bytes());
        let head = Sha256::new().chain_update(b"cairn mark key 1\0").chain_update(name).chain_update([part as u8]);
        head.chain_update(self.0.as_ref()).finalize().into()
    }

    /// What gives its cells' signs.
    pub fn signs(&self) -> Signs {
        Signs(mac(&self.0))
    }
}

impl Signs {
    /// The signs of `cell` in lightness, red-green and yellow-blue: -1 or 1.
    pub fn of(&self, cell: u64) -> [f32; 3] {
        let bits = first_bytes(&self.0, cell)[0];
        [0, 1, 2].map(|k| if bits >> k & 1 == 0 { 1.0 } else { -1.0 })
    }
}

impl Lottery {
    /// The lot of `cell`.
    pub fn draw(&self, cell: u64) -> Lot {
        let bytes = first_bytes(&self.0, cell);
        let [high, low] = [0, 8].map(|at| u64::from_le_bytes(std::array::from_fn(|k| bytes[at + k])));
        // 53 bits, which an f64 holds exactly.
        Lot { share: (high >> 11) as f64 * (-53f64).exp2(), part: (low % PARTS as u64) as u8 }
    }
}

/// HKDF of a secret, for a purpose: its words, with their lengths before, so that no two purposes are the same bytes.
fn derived(secret: &[u8; 32], purpose: &[&[u8]]) -> Zeroizing<[u8; 32]> {
    let info: Vec<u8> =
        purpose.iter().flat_map(|w| (w.len() as u32).to_le_bytes().into_iter().chain(w.to_vec())).collect();
    let mut key = Zeroizing::new([0; 32]);
    Hkdf::<Sha256>::new(Some(SALT), secret).expand(&info, key.as_mut()).expect("32 bytes are one block");
    key
}

fn mac(key: &[u8; 32]) -> Mac {
    Mac::new_from_slice(key).expect("HMAC takes keys of any length")
}

/// The first 16 bytes of the MAC of a cell's number.
fn first_bytes(mac: &Mac, cell: u64) -> [u8; 16] {
    let whole = mac.clone().chain_update(cell.to_le_bytes()).finalize().into_bytes();
    std::array::from_fn(|k| whole[k])
}

impl fmt::Debug for WeavingSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("WeavingSecret(..)")
    }
}

impl fmt::Debug for MarkKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("MarkKey(..)")
    }
}

impl fmt::Debug for PartKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PartKey(..)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_differ_by_contributor_and_part_and_say_nothing_of_themselves() {
        let secret = WeavingSecret::new([7; 32]);
        let (a, b) = (secret.mark_key("ann"), secret.mark_key("ben"));
        let of = |key: &MarkKey, who: &str, part: usize| key.part(part).commitment(who, part);
        let other = WeavingSecret::new([8; 32]).mark_key("ann");
        let all = [of(&a, "ann", 0), of(&a, "ann", 1), of(&a, "ben", 0), of(&b, "ben", 0), of(&other, "ann", 0)];
        assert!((0..all.len()).all(|k| !all[..k].contains(&all[k])));
        assert_ne!(a.part(0).to_bytes(), a.part(1).to_bytes());
        assert_eq!(PartKey::of_bytes(a.part(3).to_bytes()).signs().of(99), a.part(3).signs().of(99));
        assert_eq!(format!("{secret:?} {a:?} {:?}", a.part(0)), "WeavingSecret(..) MarkKey(..) PartKey(..)");
    }

    #[test]
    fn signs_and_lots_are_even() {
        let secret = WeavingSecret::new([1; 32]);
        let (signs, lottery) = (secret.mark_key("ann").part(0).signs(), secret.lottery());
        let n = 20_000u64;
        let (mut sums, mut products, mut shares, mut parts) = ([0f32; 3], 0.0, 0.0, [0u32; PARTS]);
        for cell in 0..n {
            let own = signs.of(cell);
            (0..3).for_each(|k| sums[k] += own[k]);
            products += own[0] * own[1];
            let lot = lottery.draw(cell);
            assert!((0.0..1.0).contains(&lot.share));
            shares += lot.share;
            parts[usize::from(lot.part)] += 1;
        }
        // Five standard deviations.
        let far = 5.0 * (n as f32).sqrt();
        assert!(sums.iter().chain([&products]).all(|sum| sum.abs() < far), "{sums:?} {products}");
        assert!((shares / n as f64 - 0.5).abs() < 5.0 * (1.0 / 12.0 / n as f64).sqrt());
        assert!(parts.iter().all(|part| part.abs_diff(2000) < 220), "{parts:?}");
    }
}
