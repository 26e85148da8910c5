//! What a photograph's day and camera make of the field's light, and how that is fitted to a photograph.

pub mod cholesky;
pub mod code;
pub mod prior;
