//! From a camera and a light to a photograph: sphere tracing for the landmark,
//! closed forms for the ground and the people, sun with soft shadows, ambient
//! occlusion, and reflections of the sky in metal.
//!
//! Each sample is lit twice, with and without the passers-by, because the hit
//! on the scene behind them is the expensive part and the same for both.

use cairn_scene::{Camera, Picture};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::light::{Light, grain};
use crate::monument::{self, HEIGHT, RADIUS, Surface};
use crate::people::Person;

/// Sub-pixel offsets of the four samples: a rotated grid, no two in one row or column.
const SAMPLES: [(f64, f64); 4] = [(0.375, 0.125), (0.875, 0.375), (0.125, 0.625), (0.625, 0.875)];
/// Half the spread of the sensor grain, in encoded units (about one 8-bit step).
const GRAIN: f32 = 0.006;

/// Everything a photograph depends on.
pub(crate) struct Shot<'a> {
    pub camera: &'a Camera,
    pub light: &'a Light,
    pub exposure: f32,
    pub people: &'a [Person],
    pub grain_salt: u32,
}

/// Where a ray ends.
struct Hit {
    distance: f32,
    point: Vec3,
    normal: Vec3,
    surface: Surface,
    /// Share of the sun that the landmark lets through, and of the sky.
    sun: f32,
    sky: f32,
}

/// The photograph as taken, and the same without its passers-by.
pub(crate) fn photograph(shot: &Shot<'_>) -> (Picture, Picture) {
    let (width, height) = (shot.camera.intrinsics.width, shot.camera.intrinsics.height);
    let mut taken = Picture::constant(width, height, [0.0; 3]);
    let mut clean = taken.clone();
    let rows = taken.rgb_mut().par_chunks_mut(width * 3).zip(clean.rgb_mut().par_chunks_mut(width * 3));
    rows.enumerate().for_each(|(y, (taken, clean))| {
        for x in 0..width {
            let (with, without) = pixel(shot, x, y);
            let noise = GRAIN * grain(x, y, shot.grain_salt);
            for c in 0..3 {
                taken[x * 3 + c] = (with[c] + noise).clamp(0.0, 1.0);
                clean[x * 3 + c] = (without[c] + noise).clamp(0.0, 1.0);
            }
        }
    });
    (taken, clean)
}

/// The mean of a pixel's samples, with and without people, sRGB-encoded.
/// Samples are averaged after the tone curve: a bright edge then has no jaggies.
fn pixel(shot: &Shot<'_>, x: usize, y: usize) -> (Vec3, Vec3) {
    let mut sums = (Vec3::ZERO, Vec3::ZERO);
    for (dx, dy) in SAMPLES {
        let (origin, way) = shot.camera.ray(x as f64 + dx, y as f64 + dy);
        let (with, without) = sample(shot, origin.as_vec3(), way.as_vec3());
        let clean = Vec3::from(shot.light.develop(without, shot.exposure));
        let taken = with.map_or(clean, |light| Vec3::from(shot.light.develop(light, shot.exposure)));
        sums = (sums.0 + taken, sums.1 + clean);
    }
    (sums.0 / SAMPLES.len() as f32, sums.1 / SAMPLES.len() as f32)
}

/// Light along one ray: with people, where that differs, and without.
fn sample(shot: &Shot<'_>, origin: Vec3, way: Vec3) -> (Option<Vec3>, Vec3) {
    let light = shot.light;
    let hit = trace(light, origin, way);
    let far = hit.as_ref().map_or(f32::MAX, |h| h.distance);
    let person = shot.people.iter().filter_map(|p| p.hit(origin, way, far)).min_by(|a, b| a.0.total_cmp(&b.0));
    let without = match &hit {
        None => light.backdrop(way),
        Some(hit) => shade(light, way, hit, hit.sun),
    };
    let with = match (person, &hit) {
        (Some((distance, normal, colour)), _) => {
            let point = origin + way * distance;
            let (sun, sky) = (sun_share(point + normal * 0.01, light.sun), 0.6 + 0.4 * (point.z / 0.3).min(1.0));
            let body = Hit { distance, point, normal, surface: Surface::matt(colour), sun, sky };
            Some(shade(light, way, &body, sun))
        }
        (None, Some(hit)) if hit.sun > 0.0 => {
            let start = hit.point + hit.normal * 0.004;
            shot.people.iter().any(|p| p.blocks(start, light.sun)).then(|| shade(light, way, hit, 0.0))
        }
        _ => None,
    };
    (with, without)
}

/// The landmark or the ground, whichever the ray meets first.
fn trace(light: &Light, origin: Vec3, way: Vec3) -> Option<Hit> {
    let ground = if way.z < -1e-4 { -origin.z / way.z } else { f32::MAX };
    if let Some(distance) = march(origin, way, ground) {
        let point = origin + way * distance;
        let normal = monument::normal(point);
        let surface = monument::surface(point, normal);
        let facing = normal.dot(light.sun) > 0.0;
        let sun = if facing { sun_share(point + normal * 0.006, light.sun) } else { 0.0 };
        return Some(Hit { distance, point, normal, surface, sun, sky: occlusion(point, normal) });
    }
    // Beyond this the hills begin, and the ground would only alias.
    if ground > 60.0 {
        return None;
    }
    let point = origin + way * ground;
    let near = point.truncate().length() < RADIUS + 0.6;
    let sky = if near { occlusion(point, Vec3::Z) } else { 1.0 };
    let sun = sun_share(point + Vec3::Z * 0.003, light.sun);
    let surface = monument::ground(point.truncate());
    Some(Hit { distance: ground, point, normal: Vec3::Z, surface, sun, sky })
}

/// The stretch of a ray (unit `way`) inside the landmark's cylinder.
fn stretch(origin: Vec3, way: Vec3) -> Option<(f32, f32)> {
    let (o, w) = (Vec2::new(origin.x, origin.y), Vec2::new(way.x, way.y));
    let (mut low, mut high) = (0.0f32, f32::MAX);
    let a = w.length_squared();
    let c = o.length_squared() - RADIUS * RADIUS;
    if a > 1e-9 {
        let b = o.dot(w);
        let h = b * b - a * c;
        if h < 0.0 {
            return None;
        }
        (low, high) = (low.max((-b - h.sqrt()) / a), (-b + h.sqrt()) / a);
    } else if c > 0.0 {
        return None;
    }
    if way.z.abs() > 1e-6 {
        let (p, q) = ((0.0 - origin.z) / way.z, (HEIGHT + 0.01 - origin.z) / way.z);
        (low, high) = (low.max(p.min(q)), high.min(p.max(q)));
    } else if !(0.0..=HEIGHT).contains(&origin.z) {
        return None;
    }
    (low < high).then_some((low, high))
}

/// Sphere tracing (Hart 1996): steps as long as the distance to the surface.
fn march(origin: Vec3, way: Vec3, limit: f32) -> Option<f32> {
    let (mut t, end) = stretch(origin, way)?;
    let end = end.min(limit);
    for _ in 0..96 {
        let d = monument::distance(origin + way * t);
        if d < 4e-4 * t {
            return Some(t);
        }
        t += d;
        if t > end {
            return None;
        }
    }
    None
}

/// Share of the sun's disc seen from `point`, 0 to 1: the narrowest the
/// landmark leaves free along the way, over the sun's (generous) width.
fn sun_share(point: Vec3, sun: Vec3) -> f32 {
    let Some((start, end)) = stretch(point, sun) else { return 1.0 };
    let (mut t, mut share) = (start.max(0.004), 1.0f32);
    for _ in 0..40 {
        let d = monument::distance(point + sun * t);
        share = share.min(28.0 * d / t);
        if share < 0.01 {
            return 0.0;
        }
        t += d.clamp(0.012, 0.3);
        if t > end {
            break;
        }
    }
    share * share * (3.0 - 2.0 * share)
}

/// Share of the sky seen from `point`, by how fast the free distance grows
/// along the normal.
fn occlusion(point: Vec3, normal: Vec3) -> f32 {
    let mut closed = 0.0;
    for (reach, weight) in [(0.03, 1.0), (0.09, 0.7), (0.24, 0.45)] {
        let free = monument::distance(point + normal * reach).min(reach);
        closed += weight * (reach - free) / reach;
    }
    (1.0 - 0.47 * closed).clamp(0.12, 1.0)
}

/// Light that leaves a hit towards the viewer: Lambert plus a microfacet
/// highlight (Blinn-Phong with Schlick's Fresnel) and, in what is smooth, the
/// mirrored sky.
fn shade(light: &Light, way: Vec3, hit: &Hit, sun: f32) -> Vec3 {
    let (n, s) = (hit.normal, &hit.surface);
    let facing = n.dot(light.sun).max(0.0) * sun;
    let diffuse = s.colour * (light.sun_colour * facing * 0.55 + light.ambient(n) * hit.sky) * (1.0 - 0.6 * s.metal);
    let base = Vec3::splat(0.04).lerp(s.colour, s.metal);
    let grazing = (1.0 + n.dot(way)).clamp(0.0, 1.0).powi(5);
    let fresnel = base + (Vec3::ONE - base) * grazing * (1.0 - s.roughness);
    let half = (light.sun - way).normalize_or(n);
    let power = 2.0 / s.roughness.powi(4).max(1e-3) - 1.0;
    let highlight = (power + 2.0) / 8.0 * n.dot(half).max(0.0).powf(power.max(1.0)) * facing;
    let mut out = diffuse + light.sun_colour * base * highlight.min(12.0) * 0.5 + s.glow;
    if s.roughness < 0.7 {
        let mirror = way - n * (2.0 * way.dot(n));
        let seen = if mirror.z > 0.0 { light.sky(mirror) } else { light.ambient(Vec3::Z) * 0.3 };
        out += fresnel * seen * hit.sky * (1.0 - s.roughness);
    }
    haze(light, hit.distance, out)
}

/// Air between the viewer and the hit, which joins the ground to the hills.
fn haze(light: &Light, distance: f32, colour: Vec3) -> Vec3 {
    colour.lerp(light.horizon * 0.7, 1.0 - (-0.012 * distance).exp())
}

#[cfg(test)]
mod tests {
    use cairn_scene::{Distortion, Intrinsics, Pose};
    use glam::DVec3;
    use rand::SeedableRng as _;

    use super::*;

    /// Rays through the pixels that known points project to must end on those
    /// points: camera, march and scene agree on where things are.
    #[test]
    fn known_points_are_seen_where_they_project_to() {
        let light = Light::of(1, 0.0, 0.0, &mut rand_chacha::ChaCha8Rng::seed_from_u64(0));
        let pose = Pose::look_at(DVec3::new(2.6, 1.3, 0.7), DVec3::new(0.0, 0.0, 1.0), DVec3::Z).unwrap();
        let intrinsics = Intrinsics {
            width: 96,
            height: 128,
            fx: 137.0,
            fy: 137.0,
            cx: 48.0,
            cy: 64.0,
            distortion: Distortion::default(),
        };
        let camera = Camera { intrinsics, pose };
        // Ground, corner of the upper stair's face, plinth's cornice, dome's ball and a bollard's.
        let flat = [(2.0, 0.4, 0.0, 1e-3), (0.85, 0.0, 0.2, 2e-3), (0.55, 0.1, 0.63, 2e-3)];
        let balls = [(0.0, 0.0, 2.26, 0.061), (0.7, 0.7, 0.42, 0.076)];
        for (x, y, z, within) in flat.into_iter().chain(balls) {
            let point = DVec3::new(x, y, z);
            let at = camera.project(point).unwrap();
            let (origin, way) = camera.ray(at.x, at.y);
            let hit = trace(&light, origin.as_vec3(), way.as_vec3()).expect("there is something");
            let off = (hit.point - point.as_vec3()).length();
            assert!(off <= within && off >= 0.9 * within * f32::from(within > 0.01), "{point}: seen {off} away");
            assert!(hit.normal.dot(way.as_vec3()) < 0.0, "{point}: its surface faces away");
        }
    }
}
