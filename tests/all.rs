//! All of these tests as one program: linked once, and short ones run beside long ones.

#[path = "../crates/cairn-log/tests/edges/mod.rs"]
mod edges;
#[path = "../crates/cairn-verify/tests/handmade/mod.rs"]
mod handmade;

mod access;
mod audit;
mod auditing;
mod base_only;
mod chosen_light;
mod fuzz_requests;
mod hands;
mod keys;
mod locate;
mod log;
mod lost;
mod marks;
mod owners;
mod pipe;
mod python;
mod readme;
mod requests;
mod threats;
mod tidy;
mod tls;
mod training;
mod views;
mod witness;
