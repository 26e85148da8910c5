//! The captures that the suites measure, by name.

/// A capture's folder and what it is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Name {
    /// Forward-facing, 504 x 378 px
    Fern,
    /// Forward-facing, 504 x 378 px
    Flower,
    /// Forward-facing, 400 x 300 px
    Trex,
    /// An object in front of nothing, 400 x 400 px
    Lego,
    /// A statue photographed by many, 400 x 600 px
    Liberty,
}

impl Name {
    /// Every capture there is.
    pub const ALL: [Self; 5] = [Self::Fern, Self::Flower, Self::Trex, Self::Lego, Self::Liberty];

    /// As it stands on the command line and in the results.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Fern => "fern",
            Self::Flower => "flower",
            Self::Trex => "trex",
            Self::Lego => "lego",
            Self::Liberty => "liberty",
        }
    }
}
