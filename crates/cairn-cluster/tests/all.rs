//! All of these tests as one program: linked once, and short ones run beside long ones.

mod clusters;
mod real_captures;
