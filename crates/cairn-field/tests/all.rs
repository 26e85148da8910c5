//! All of these tests as one program: linked once, and short ones run beside long ones.
//! What counts allocations is a program of its own, since it takes the allocator.

mod common;

mod appearance;
mod background;
mod coverage;
mod extremes;
mod few_views;
mod finer;
mod fisheye;
mod gradients;
mod hostile;
mod light;
mod marched;
mod masks;
mod mean;
mod operator;
mod pictures;
mod rays;
mod reference;
mod repeatable;
mod screening;
mod screening_real;
mod sizes;
mod stability;
mod survey;
mod units;
