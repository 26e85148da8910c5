//! The suites, a module each.

pub mod ablation;
pub mod baseline;
pub mod contribution;
pub mod conv;
pub mod demo;
pub mod field;
pub mod liberty;
pub mod mark;
pub mod registration;
pub mod registry;
pub mod scenes;
pub mod tradeoff;
pub mod woven;
