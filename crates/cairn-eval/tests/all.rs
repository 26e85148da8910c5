//! All of these tests as one program.

mod common;

mod deepstega;
mod field;
mod mark;
mod registration;
mod results;
