//! What may be chosen about a made-up capture, and what is allowed.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Settings of [`crate::Landmark::generate`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandmarkConfig {
    /// People with cameras, 1 to 16. Each keeps to an arc of their own.
    pub contributors: usize,
    /// Photographs each of them takes, 1 to 512.
    pub photographs: usize,
    /// Pixels across, 16 to 2048.
    pub width: usize,
    /// Pixels down, 16 to 2048.
    pub height: usize,
    /// Whether passers-by stand in about half of the photographs.
    pub passers_by: bool,
    /// How far the contributors' light and cameras differ: 0 all alike, 1 each
    /// their own day.
    pub light_variation: f32,
    /// Degrees of each contributor's arc, over an equal share of the circle,
    /// that reach into the neighbours' arcs (half at each end), 0 to 90.
    pub overlap_deg: f32,
    /// Degrees that the longer side of a photograph sees through a fisheye, 10 to 220; `None` is a pinhole, 50 degrees.
    pub fisheye_deg: Option<f32>,
}

impl Default for LandmarkConfig {
    /// Four contributors, 14 photographs each, 96 x 128, with passers-by.
    fn default() -> Self {
        Self {
            contributors: 4,
            photographs: 14,
            width: 96,
            height: 128,
            passers_by: true,
            light_variation: 1.0,
            overlap_deg: 12.0,
            fisheye_deg: None,
        }
    }
}

/// A setting that is out of range.
#[derive(Debug, Clone, Error, PartialEq)]
#[error("{key} is {got}; allowed is {allowed}")]
pub struct ConfigError {
    /// The setting's name.
    pub key: &'static str,
    /// Its value.
    pub got: String,
    /// What it may be.
    pub allowed: &'static str,
}

impl LandmarkConfig {
    /// Checks every setting against its range.
    ///
    /// # Errors
    /// [`ConfigError`] with the first setting that is out of range.
    pub fn check(&self) -> Result<(), ConfigError> {
        let number = |key, got: f32, high: f32, allowed| match (0.0..=high).contains(&got) {
            true => Ok(()),
            false => Err(ConfigError { key, got: got.to_string(), allowed }),
        };
        let count = |key, got: usize, range: std::ops::RangeInclusive<usize>, allowed| match range.contains(&got) {
            true => Ok(()),
            false => Err(ConfigError { key, got: got.to_string(), allowed }),
        };
        count("contributors", self.contributors, 1..=16, "1 to 16")?;
        count("photographs", self.photographs, 1..=512, "1 to 512")?;
        count("width", self.width, 16..=2048, "16 to 2048 px")?;
        count("height", self.height, 16..=2048, "16 to 2048 px")?;
        number("light_variation", self.light_variation, 1.0, "0 to 1")?;
        number("overlap_deg", self.overlap_deg, 90.0, "0 to 90 degrees")?;
        match self.fisheye_deg {
            Some(got) if !(10.0..=220.0).contains(&got) => {
                Err(ConfigError { key: "fisheye_deg", got: got.to_string(), allowed: "10 to 220 degrees, or none" })
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_allowed_and_the_rest_is_named() {
        LandmarkConfig::default().check().unwrap();
        let error = LandmarkConfig { photographs: 0, ..Default::default() }.check().unwrap_err();
        assert_eq!(error.to_string(), "photographs is 0; allowed is 1 to 512");
        assert_eq!(
            LandmarkConfig { light_variation: f32::NAN, ..Default::default() }.check().unwrap_err().key,
            "light_variation"
        );
        let wide = LandmarkConfig { fisheye_deg: Some(230.0), ..Default::default() }.check().unwrap_err();
        assert_eq!(wide.to_string(), "fisheye_deg is 230; allowed is 10 to 220 degrees, or none");
        let unknown = serde_json::from_str::<LandmarkConfig>(r#"{"fog": 1}"#).unwrap_err();
        assert!(unknown.to_string().contains("fog"));
    }
}
