//! Ed25519 signatures on which verifiers disagree: the twelve cases of "Taming the many EdDSAs" (Chalkias, Garillot,
//! Nikolaenko, SSR 2020, section 5), made here from their definitions, with keys and messages of our own.
//!
//! B is the base point, T a point of order 8, L the base point's order, h = SHA-512(R | A | M) mod L. A signature (R, S) by A
//! holds *without cofactor* where S B = R + h A, and *with* where that times 8 holds. RFC 8032 allows either.
#![allow(dead_code)] // Every binary that takes these uses its own part.

use curve25519_dalek::{EdwardsPoint, Scalar, constants::EIGHT_TORSION, edwards::CompressedEdwardsY};
use sha2::{Digest as _, Sha512};

/// One signature.
pub struct Edge {
    pub name: &'static str,
    pub key: [u8; 32],
    pub message: [u8; 32],
    pub signature: [u8; 64],
    /// Encodings and orders aside.
    pub holds: Holds,
}

/// Whether a signature's equation holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Holds {
    /// As it stands.
    pub without_cofactor: bool,
    /// Times 8.
    pub with_cofactor: bool,
}

/// What a strict verifier says to each of [`edges`], in order: V takes it, X does not. Only the fourth is taken, whose key
/// and R are of mixed order, which has no second reading: both equations hold and every encoding is the one.
pub const STRICT: &str = "XXXVXXXXXXXX";

/// L, little-endian (RFC 8032, 5.1).
const ORDER: [u8; 32] = [
    0xed, 0xd3, 0xf5, 0x5c, 0x1a, 0x63, 0x12, 0x58, 0xd6, 0x9c, 0xf7, 0xa2, 0xde, 0xf9, 0xde, 0x14, 0, 0, 0, 0, 0, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0x10,
];

/// The identity, y = 1, written as y = p + 1.
const IDENTITY_AGAIN: [u8; 32] = {
    let mut bytes = [0xff; 32];
    (bytes[0], bytes[31]) = (0xee, 0x7f);
    bytes
};

/// A point as it is and as it is written.
#[derive(Clone, Copy)]
struct Written {
    point: EdwardsPoint,
    bytes: [u8; 32],
}

fn written(point: EdwardsPoint) -> Written {
    Written { point, bytes: point.compress().to_bytes() }
}

fn challenge(r: &[u8; 32], a: &[u8; 32], message: &[u8; 32]) -> Scalar {
    let hash = Sha512::new().chain_update(r).chain_update(a).chain_update(message).finalize();
    Scalar::from_bytes_mod_order_wide(&hash.into())
}

/// S B - R - h A, which is the identity, or of order 8 at most, where the signature holds.
fn defect(r: Written, a: Written, message: &[u8; 32], s: Scalar) -> EdwardsPoint {
    EdwardsPoint::mul_base(&s) - r.point - a.point * challenge(&r.bytes, &a.bytes, message)
}

/// Tries messages until one makes the signature as wanted; `make` gives R and S for h's key and message.
fn search(
    name: &'static str,
    a: Written,
    wanted: Holds,
    make: impl Fn(&[u8; 32]) -> Option<(Written, Scalar)>,
) -> Edge {
    let messages = (0..10_000_u32).map(|n| <[u8; 32]>::from(sha2::Sha256::digest(n.to_be_bytes())));
    let found =
        messages.filter_map(|message| make(&message).map(|(r, s)| (message, r, s))).find_map(|(message, r, s)| {
            let defect = defect(r, a, &message, s);
            let is_zero = |point: EdwardsPoint| point == EdwardsPoint::default();
            let holds = Holds { without_cofactor: is_zero(defect), with_cofactor: is_zero(defect.mul_by_cofactor()) };
            (holds == wanted).then(|| {
                let mut signature = [0; 64];
                signature[..32].copy_from_slice(&r.bytes);
                signature[32..].copy_from_slice(&s.to_bytes());
                Edge { name, key: a.bytes, message, signature, holds }
            })
        });
    found.unwrap_or_else(|| panic!("no message makes the case {name}"))
}

/// `edge` with `times` L added to its S.
fn add_order(name: &'static str, edge: &Edge, times: usize) -> Edge {
    let mut signature = edge.signature;
    for _ in 0..times {
        let mut carry = 0;
        for (byte, order) in signature[32..].iter_mut().zip(ORDER) {
            carry += u16::from(*byte) + u16::from(order);
            *byte = carry.to_le_bytes()[0];
            carry >>= 8;
        }
        assert_eq!(carry, 0, "S is beyond 256 bits");
    }
    Edge { name, signature, ..*edge }
}

/// The twelve cases, in the paper's order.
pub fn edges() -> Vec<Edge> {
    let [a, r] = [7_u64, 11].map(|n| Scalar::from_bytes_mod_order(sha2::Sha256::digest(n.to_be_bytes()).into()));
    let torsion = EIGHT_TORSION[1];
    let (prime_a, prime_r) = (written(EdwardsPoint::mul_base(&a)), written(EdwardsPoint::mul_base(&r)));
    let (small, mixed) = (written(torsion), written(prime_a.point + torsion));
    let mixed_r = |n: usize| written(prime_r.point + EIGHT_TORSION[n]);
    let zero = Scalar::ZERO;
    let own = |r: Written, a_: Written, m: &[u8; 32], secret: Scalar| secret + challenge(&r.bytes, &a_.bytes, m) * a;
    let with = Holds { without_cofactor: false, with_cofactor: true };
    let (both, never) = (Holds { without_cofactor: true, ..with }, Holds { with_cofactor: false, ..with });
    let again = Written { point: EdwardsPoint::default(), bytes: IDENTITY_AGAIN };
    let canonical = |w: Written| written(w.point);
    let plain = search("S below L", prime_a, both, |m| Some((prime_r, own(prime_r, prime_a, m, r))));
    vec![
        search("small A, small R, S = 0", small, both, |_| Some((written(EIGHT_TORSION[3]), zero))),
        search("small A, mixed R", small, both, |_| Some((mixed_r(3), r))),
        search("mixed A, small R", mixed, both, |m| Some((small, own(small, mixed, m, zero)))),
        search("mixed A, mixed R", mixed, both, |m| Some((mixed_r(3), own(mixed_r(3), mixed, m, r)))),
        search("mixed A, mixed R, with cofactor only", mixed, with, |m| {
            Some((mixed_r(3), own(mixed_r(3), mixed, m, r)))
        }),
        search("mixed A, with cofactor where 8 h is not reduced", mixed, with, |m| {
            Some((prime_r, own(prime_r, mixed, m, r)))
        }),
        add_order("S + L", &plain, 1),
        add_order("S + 14 L, the high bits set", &plain, 14),
        search("second spelling of R, hashed as it came", prime_a, both, |m| {
            Some((again, own(again, prime_a, m, zero)))
        }),
        search("second spelling of R, hashed as the first", prime_a, never, |m| {
            Some((again, own(canonical(again), prime_a, m, zero)))
        }),
        search("second spelling of A, hashed as it came", again, both, |_| Some((prime_r, r))),
        search("second spelling of a small A, mixed R", again, with, |_| Some((mixed_r(3), r))),
    ]
}

/// Whether these 32 bytes are a point's one spelling.
pub fn is_canonical(bytes: [u8; 32]) -> bool {
    CompressedEdwardsY(bytes).decompress().is_some_and(|point| point.compress().to_bytes() == bytes)
}
