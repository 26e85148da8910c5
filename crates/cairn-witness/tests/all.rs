//! All of these tests as one program: linked once, and short ones run beside long ones.

mod common;

mod faults;
mod http;
mod protocol;
