//! All of these tests as one program.

mod deepstega;
mod results;
