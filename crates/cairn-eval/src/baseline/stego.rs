//! The two ways of the baselines to hide a picture in photographs, as one thing to use.

use std::path::PathBuf;

use cairn_scene::Picture;
use serde::{Deserialize, Serialize};

use super::deepstega::DeepStega;
use super::lowest_bits::{hide_in_lowest_bits, read_lowest_bits};
use crate::file::{decoded, read};

/// How a picture is hidden in photographs.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stego {
    /// In their least significant bits.
    LowestBits {
        /// The picture's file.
        hidden: PathBuf,
    },
    /// By networks (Baluja 2017).
    DeepStega {
        /// The picture's file.
        hidden: PathBuf,
        /// The trained networks' file.
        networks: PathBuf,
    },
}

/// [`Stego`] with its files read.
pub struct Opened {
    hidden: Picture,
    /// `None` for the lowest bits.
    networks: Option<DeepStega>,
}

impl Stego {
    /// What tables call it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::LowestBits { .. } => "lowest bits",
            Self::DeepStega { .. } => "DeepStega",
        }
    }

    /// Reads its files.
    ///
    /// # Errors
    /// For files that do not read or decode.
    pub fn open(&self) -> anyhow::Result<Opened> {
        Ok(match self {
            Self::LowestBits { hidden } => Opened { hidden: decoded(hidden)?, networks: None },
            Self::DeepStega { hidden, networks } => {
                Opened { hidden: decoded(hidden)?, networks: Some(DeepStega::from_bytes(&read(networks)?)?) }
            }
        })
    }
}

impl Opened {
    /// What is hidden.
    pub fn hidden(&self) -> &Picture {
        &self.hidden
    }

    /// `photograph` with the picture in it, in 8 bits.
    ///
    /// # Errors
    /// As [`hide_in_lowest_bits`] and [`DeepStega::hide`].
    pub fn hide(&self, photograph: &Picture) -> anyhow::Result<Picture> {
        match &self.networks {
            None => hide_in_lowest_bits(photograph, &self.hidden),
            Some(networks) => networks.hide(photograph, &self.hidden),
        }
    }

    /// What `picture` hides, as large as what was hidden.
    ///
    /// # Errors
    /// As [`read_lowest_bits`] and [`DeepStega::reveal`].
    pub fn reveal(&self, picture: &Picture) -> anyhow::Result<Picture> {
        let size = [self.hidden.width(), self.hidden.height()];
        match &self.networks {
            None => read_lowest_bits(picture, size),
            Some(networks) => networks.reveal(picture, size),
        }
    }
}
