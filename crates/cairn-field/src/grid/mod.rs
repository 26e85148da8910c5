//! The sparse voxel grid and what it is counted with.

pub mod lattice;
pub(crate) mod memory;
pub mod occupancy;
pub mod real;
pub mod sh;
pub(crate) mod table;
