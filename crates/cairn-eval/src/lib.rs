//! Benchmarks of Cairn: what was measured, against which target, by which command, from which seed and commit, on what
//! machine.
//!
//! The page of results is generated and never written by hand. A figure without its origin cannot get into it, and a
//! missed target stays visible.

pub mod args;
pub mod baseline;
pub mod bootstrap;
mod captures;
mod chart;
pub mod children;
pub mod contribution;
mod file;
mod marked;
mod marks;
mod measures;
mod memory;
mod origin;
pub mod page;
pub mod parts;
mod progress;
mod registration;
pub mod results;
mod rows;
pub mod run;
mod settings;
mod source;
mod suite;
mod timing;
mod trained;
mod woven;
