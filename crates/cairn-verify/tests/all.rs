//! All of these tests as one program: linked once, and short ones run beside long ones.

mod common;
mod handmade;

mod answer;
mod answer_bent;
mod audit;
mod folders;
mod follow;
mod heirs;
mod shares;
mod store;
mod store_heirs;
