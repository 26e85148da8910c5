//! Suite `registration`: what is done to pictures before their camera is looked for, and what is found.

pub mod condition;
pub mod follow;
mod place;
mod strangers;
pub mod trial;
pub mod work;
