//! Questions about a trained scene: renders, who contributed, what a picture hides, how well all of that is answered.

pub mod check;
pub mod coverage;
pub mod crowd;
pub mod detection;
pub mod evaluate;
pub mod light;
pub mod locate;
pub mod look;
pub mod maps;
pub mod necessity;
pub mod recount;
pub mod recovery;
pub mod report;
pub mod statement;
pub mod viewpoint;
pub(crate) mod whose_map;
