//! All of these tests as one program: linked once, and short ones run beside long ones.

mod conv;
mod heads;
mod networks;
mod params;
mod reference;
