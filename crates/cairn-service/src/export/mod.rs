//! What is written out for people to look at: camera paths, their frames, contact sheets and drawings of a scene.

pub mod drawing;
pub mod layout;
pub mod paths;
pub mod poses;
pub mod sheet;
pub mod sound;
pub mod tour;
pub mod words;
