//! The day a contributor came: sun, sky, and what their camera made of it.
//!
//! Every contributor has one of four characters of day (clear morning, high
//! noon, overcast, sunset), moved by their own random numbers, and an exposure
//! and white balance of their own: this is what a field has to explain by
//! appearance and not by geometry.

use glam::{Vec2, Vec3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use crate::noise::{cell, fractal, smoothstep};

/// Sun, sky and camera response. Colours are linear.
#[derive(Clone, Debug)]
pub(crate) struct Light {
    /// Unit direction to the sun.
    pub sun: Vec3,
    /// The sun's colour and strength.
    pub sun_colour: Vec3,
    /// Overhead, and along the horizon.
    pub zenith: Vec3,
    pub horizon: Vec3,
    /// Share of the sky that is cloud, 0 to 1, and which clouds.
    clouds: f32,
    salt: u32,
    /// Multiplies light before the tone curve.
    pub exposure: f32,
    /// Per channel, mean one.
    pub white_balance: Vec3,
}

/// Azimuth offset and elevation of the sun in degrees, sun, zenith, horizon, clouds.
type Day = (f32, f32, Vec3, Vec3, Vec3, f32);

/// Clear morning, high noon, overcast, sunset.
const DAYS: [Day; 4] = [
    (-65.0, 30.0, Vec3::new(3.1, 2.5, 1.75), Vec3::new(0.13, 0.30, 0.66), Vec3::new(0.66, 0.74, 0.80), 0.25),
    (-35.0, 52.0, Vec3::new(3.0, 2.85, 2.55), Vec3::new(0.10, 0.26, 0.70), Vec3::new(0.50, 0.68, 0.88), 0.45),
    (40.0, 42.0, Vec3::new(0.75, 0.76, 0.78), Vec3::new(0.52, 0.57, 0.64), Vec3::new(0.78, 0.80, 0.82), 0.95),
    (62.0, 15.0, Vec3::new(3.3, 1.55, 0.62), Vec3::new(0.16, 0.20, 0.42), Vec3::new(0.98, 0.52, 0.28), 0.55),
];

impl Light {
    /// The light of contributor `index`, whose arc looks from `azimuth`
    /// (radians). `variation` 0 gives everyone the same noon, 1 their own day.
    pub(crate) fn of(index: usize, azimuth: f32, variation: f32, rng: &mut ChaCha8Rng) -> Self {
        let (turn, elevation, sun, zenith, horizon, clouds) = DAYS[index % 4];
        let noon = DAYS[1];
        let mix = |shared: Vec3, own: Vec3| shared.lerp(own, variation);
        let scalar = |shared: f32, own: f32| shared + (own - shared) * variation;
        let mut jitter = |spread: f32| rng.random_range(-spread..=spread) * variation;
        let turn = turn + jitter(12.0);
        // Shared noon stands still in the world; own days are lit from the
        // photographer's side, as people choose their light.
        let heading = scalar(0.6, azimuth + turn.to_radians());
        let height = scalar(noon.1, elevation + jitter(4.0)).to_radians();
        let warmth = jitter(0.06);
        let (exposure, tint) = (0.95 * (1.0 + jitter(0.2)), jitter(0.03));
        let salt = 100 + (variation * (7 * index) as f32) as u32 + (jitter(40.0).abs() as u32);
        Self {
            sun: Vec3::new(height.cos() * heading.cos(), height.cos() * heading.sin(), height.sin()),
            sun_colour: mix(noon.2, sun),
            zenith: mix(noon.3, zenith),
            horizon: mix(noon.4, horizon),
            clouds: scalar(noon.5, clouds),
            salt,
            exposure,
            white_balance: Vec3::new(1.0 + warmth, 1.0 - tint, 1.0 - warmth + tint),
        }
    }

    /// Light that comes from the sky or the far hills along `way` (unit).
    pub(crate) fn backdrop(&self, way: Vec3) -> Vec3 {
        let azimuth = way.y.atan2(way.x);
        let ridge = |scale: f32, salt: u32| {
            // Two lattices blended over the turn, so that the ridge closes.
            let t = (azimuth / std::f32::consts::TAU + 0.5).fract();
            let at = |t: f32| fractal(Vec2::new(t * scale, 0.5), salt);
            at(t) * (1.0 - t) + at(t - 1.0) * t
        };
        let far = 0.02 + 0.13 * ridge(9.0, 61);
        let near = 0.01 + 0.07 * ridge(26.0, 67);
        if way.z < near {
            let leaves = 0.6 + 0.8 * fractal(Vec2::new(azimuth * 60.0, way.z * 60.0), 71);
            return (Vec3::new(0.05, 0.1, 0.035) * leaves).lerp(self.horizon, 0.18) * self.daylight();
        }
        if way.z < far {
            return Vec3::new(0.10, 0.16, 0.17).lerp(self.horizon, 0.5) * self.daylight();
        }
        self.sky(way)
    }

    /// Light that comes from the sky along `way` (unit, not below the horizon).
    pub(crate) fn sky(&self, way: Vec3) -> Vec3 {
        let up = way.z.max(0.0);
        let clear = self.horizon.lerp(self.zenith, up.powf(0.55));
        let towards = way.dot(self.sun).max(0.0);
        let glow = self.sun_colour * (0.09 * towards.powi(6) + 0.35 * towards.powi(90));
        let at = Vec2::new(way.x, way.y) / (up + 0.22) * 1.7;
        let billow = fractal(at, self.salt);
        let threshold = 0.72 - 0.42 * self.clouds;
        let cover = smoothstep(threshold, threshold + 0.22, billow) * smoothstep(0.0, 0.12, up);
        let shade = fractal(at + Vec2::new(self.sun.x, self.sun.y) * 0.25, self.salt);
        let lit = 0.75 + 1.1 * (billow - shade) + 0.25 * towards;
        let cloud = (self.horizon * 0.45 + self.sun_colour * 0.16 + Vec3::splat(0.12)) * lit;
        (clear + glow * (1.0 - 0.7 * cover)).lerp(cloud, cover * 0.9)
    }

    /// Diffuse light of the whole sky on a surface that faces `n`.
    pub(crate) fn ambient(&self, n: Vec3) -> Vec3 {
        let sky = (self.zenith * 0.55 + self.horizon * 0.45) * (0.5 + 0.5 * n.z);
        let bounce = self.sun_colour * self.sun.z * Vec3::new(0.11, 0.1, 0.09) * (0.5 - 0.5 * n.z);
        (sky + bounce) * 0.9
    }

    /// How bright distant things are.
    fn daylight(&self) -> f32 {
        0.55 + 0.2 * (self.sun_colour.element_sum() * self.sun.z)
    }

    /// Light in the scene to what the camera stores: sRGB-encoded, 0 to 1.
    /// `exposure` is this photograph's own factor.
    pub(crate) fn develop(&self, light: Vec3, exposure: f32) -> [f32; 3] {
        let seen = (light * self.white_balance * self.exposure * exposure).max(Vec3::ZERO);
        // Narkowicz' fit of the ACES film curve: highlights roll off as on film.
        let film = |x: f32| (x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)).clamp(0.0, 1.0);
        seen.to_array().map(|v| encode(film(v * 0.62)))
    }
}

/// Linear to sRGB-encoded (IEC 61966-2-1).
fn encode(v: f32) -> f32 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// A tiny per-pixel grain, as a sensor has; -0.5 to 0.5.
pub(crate) fn grain(x: usize, y: usize, salt: u32) -> f32 {
    cell(x as i32, y as i32, salt) - 0.5
}
