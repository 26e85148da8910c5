//! All of these tests as one program: linked once, and short ones run beside long ones.
//! What counts allocations is a program of its own, since it takes the allocator.

mod common;
mod edges;

mod anchor;
mod answers;
mod cosigned;
mod crash;
mod faults;
mod heirs;
mod keys;
mod lifecycle;
mod map;
mod map_leaf;
mod merkle_vectors;
mod notes;
mod publishing;
mod rebuild;
mod records;
mod sealed_keys;
mod stores;
mod strace;
mod tiered;
mod witness_common;
mod witness_faults;
mod witness_http;
mod witness_protocol;
