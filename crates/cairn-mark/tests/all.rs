//! All of these tests as one program: linked once, and short ones run beside long ones.

mod common;

mod density;
mod digest;
mod heads;
mod hostile;
mod paper;
mod permuted;
mod robust;
mod scenes;
mod switches;
mod training;
mod woven;
