//! What the marks are compared with: pictures hidden in photographs before a field is trained on them.

pub mod deepstega;
pub mod lowest_bits;
pub mod stego;
