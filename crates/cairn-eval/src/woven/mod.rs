//! Suite `woven`: keyed marks woven into a field, and whom pictures of it name.

pub mod work;
