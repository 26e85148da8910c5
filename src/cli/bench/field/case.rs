//! Which captures are measured, and what each is to reach on two cores.

/// A capture's folder and what it is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Name {
    /// Forward-facing, 504 x 378 px
    Fern,
    /// Forward-facing, 400 x 300 px
    Trex,
    /// An object in front of nothing, 400 x 400 px
    Lego,
    /// A statue photographed by many, 400 x 600 px
    Liberty,
}

impl Name {
    /// As it stands on the command line and in the ledger.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Fern => "fern",
            Self::Trex => "trex",
            Self::Lego => "lego",
            Self::Liberty => "liberty",
        }
    }
}

/// A capture's targets.
#[derive(Clone, Debug)]
pub struct Case {
    /// Which capture.
    pub name: Name,
    /// Whether a held-out view's light is fitted on its left half and its right half is
    /// scored (NeRF-W's protocol, for visitors' photographs).
    pub right_half: bool,
    /// Least PSNR on held-out views, dB.
    pub psnr_db: f64,
    /// Least PSNR on the mask, dB, where it has masks.
    pub mask_psnr_db: Option<f64>,
    /// Most seconds of training.
    pub seconds: f64,
    /// Least rays/s of rendering.
    pub rays_per_s: Option<f64>,
}

/// Most memory a training may take, MiB.
pub const TRAINING_MIB: f64 = 2048.0;
/// Most memory that rendering a stored field may take, MiB.
pub const SERVING_MIB: f64 = 500.0;

/// The captures, in the order they are measured.
pub const CASES: [Case; 4] = [
    Case { name: Name::Fern, right_half: false, psnr_db: 27.0, mask_psnr_db: None, seconds: 180.0, rays_per_s: None },
    Case { name: Name::Trex, right_half: false, psnr_db: 28.0, mask_psnr_db: None, seconds: 240.0, rays_per_s: None },
    Case {
        name: Name::Lego,
        right_half: false,
        psnr_db: 33.0,
        mask_psnr_db: None,
        seconds: 360.0,
        rays_per_s: Some(3e6),
    },
    Case {
        name: Name::Liberty,
        right_half: true,
        psnr_db: 21.0,
        mask_psnr_db: Some(23.0),
        seconds: 600.0,
        rays_per_s: Some(3e6),
    },
];
