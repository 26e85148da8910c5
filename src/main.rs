//! The one binary: parse, build, run.

mod config;
mod daemon;
mod engine;

fn main() {}
