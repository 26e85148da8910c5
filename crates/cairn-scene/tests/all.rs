//! All of these tests as one program: linked once, and short ones run beside long ones.
//! What counts allocations is a program of its own, since it takes the allocator.

mod common;

mod bad_input;
mod clusters;
mod clusters_real;
mod masks;
mod metrics_reference;
mod names;
mod photographs;
mod real_captures;
mod reference_cameras;
mod scenes;
mod support;
mod which_format;
