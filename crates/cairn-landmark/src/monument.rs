//! The landmark's shape and surfaces: a stone beacon on an octagonal stair, with
//! an arched niche in each face of its plinth, four banners, a colonnade around
//! the lamp, and a ribbed dome of old copper under a gilded ball.
//!
//! The shape is a signed distance field (Hart 1996) and so has exact edges,
//! normals and shadows: whatever a radiance field gets wrong of it is the
//! field's own error. Four sides look alike but are dressed differently, so that
//! a view tells where it was taken from, as with real buildings.

use glam::{Vec2, Vec3};

use crate::noise::{cell, fractal, smoothstep, value};

/// The landmark stands inside this upright cylinder around the z axis.
pub(crate) const RADIUS: f32 = 1.25;
/// Highest point, in the scene's unit.
pub(crate) const HEIGHT: f32 = 2.37;

/// Bottom of the shaft and bottom of the gallery.
const SHAFT: (f32, f32) = (0.66, 1.5);

/// What a point of the landmark is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    /// Linear reflectance, per channel, 0 to 1.
    pub colour: Vec3,
    /// 0 stone, 1 metal (reflections take the colour).
    pub metal: f32,
    /// 0 mirror, 1 chalk.
    pub roughness: f32,
    /// Light of its own, linear.
    pub glow: Vec3,
}

impl Surface {
    pub(crate) fn matt(colour: Vec3) -> Self {
        Self { colour, metal: 0.0, roughness: 0.9, glow: Vec3::ZERO }
    }

    fn metal(colour: Vec3, roughness: f32) -> Self {
        Self { colour, metal: 1.0, roughness, glow: Vec3::ZERO }
    }
}

/// Distance from `p` to the landmark, negative inside; never too large, so a
/// ray may step that far.
pub(crate) fn distance(p: Vec3) -> f32 {
    // Eight-fold symmetry: fold into the wedge between 0 and 45 degrees.
    let (x, y) = (p.x.abs().max(p.y.abs()), p.x.abs().min(p.y.abs()));
    let r = Vec2::new(x, y).length();
    let mut d = shaft(r, p.z);
    if p.z - 0.7 < d {
        d = d.min(base(x, y, p.z));
    }
    if 1.47 - p.z < d {
        d = d.min(head(x, y, r, p.z));
    }
    d
}

/// A round tower that narrows upwards, with a torus of moulding at its foot.
fn shaft(r: f32, z: f32) -> f32 {
    let side = (r - shaft_radius(z)) * 0.99;
    let tower = side.max(SHAFT.0 - z).max(z - SHAFT.1);
    let foot = Vec2::new(r - 0.36, z - 0.69).length() - 0.035;
    tower.min(foot)
}

fn shaft_radius(z: f32) -> f32 {
    0.35 - 0.1 * (z - SHAFT.0) / (SHAFT.1 - SHAFT.0)
}

/// Stair, plinth with niches and mouldings, and the four gilded bollards.
fn base(x: f32, y: f32, z: f32) -> f32 {
    let octagon = x.max((x + y) * std::f32::consts::FRAC_1_SQRT_2);
    let mut d = f32::MAX;
    for step in 0..3 {
        let (radius, top) = (1.15 - 0.15 * step as f32, 0.07 * (step + 1) as f32);
        d = d.min(corner(octagon - radius, z - top));
    }
    let block = Vec3::new(x, y, z);
    let plinth = slab(block, 0.5, 0.2, 0.62);
    let niche_side = (y - 0.19).max(z - 0.32).min(Vec2::new(y, z - 0.32).length() - 0.19);
    let niche = niche_side.max(0.44 - x).max(0.24 - z);
    d = d.min(plinth.max(-niche));
    d = d.min(slab(block, 0.55, 0.6, 0.66)).min(slab(block, 0.54, 0.2, 0.245));
    let post = (Vec2::new(x - 0.7, y - 0.7).length() - 0.035).max(z - 0.36);
    let ball = (block - Vec3::new(0.7, 0.7, 0.42)).length() - 0.075;
    d.min(post).min(ball)
}

/// Gallery, lamp and its columns, entablature, dome and finial.
fn head(x: f32, y: f32, r: f32, z: f32) -> f32 {
    let disc = |radius: f32, low: f32, high: f32| corner(r - radius, (z - high).max(low - z));
    let mut d = disc(0.4, 1.48, 1.55).min(disc(0.34, 1.82, 1.87));
    let (sin, cos) = (0.382_683_43, 0.923_879_5);
    let column = Vec2::new(x - 0.26 * cos, y - 0.26 * sin).length() - 0.028;
    d = d.min(column.max(z - 1.84).max(1.5 - z));
    let lamp = Vec2::new(r, z - 1.68).length() - 0.11;
    d = d.min(lamp).min(disc(0.05, 1.5, 1.7));
    // An ellipsoid's implicit function over its gradient: a distance near the surface.
    let scaled = Vec2::new(r / 0.31, (z - 1.86) / 0.3);
    let slope = Vec2::new(r / (0.31 * 0.31), (z - 1.86) / (0.3 * 0.3)).length().max(1e-3);
    let dome = (scaled.length_squared() - 1.0).min(4.0) * 0.5 / slope;
    d = d.min((dome * 0.9).max(1.86 - z));
    let ball = Vec2::new(r, z - 2.26).length() - 0.06;
    let spike = corner(r - 0.012, z - 2.37);
    d.min(ball).min(spike.max(1.9 - z))
}

/// Distance to an edge of two half planes: exact outside.
fn corner(a: f32, b: f32) -> f32 {
    a.max(b).min(0.0) + Vec2::new(a.max(0.0), b.max(0.0)).length()
}

/// An upright square block of half side `half` between two heights, edges
/// rounded a little so that they catch the light.
fn slab(p: Vec3, half: f32, low: f32, high: f32) -> f32 {
    let round = 0.012;
    let q = Vec2::new(p.x - half, (p.z - (low + high) / 2.0).abs() - (high - low) / 2.0) + Vec2::splat(round);
    corner(q.x.max(p.y - half + round), q.y) - round
}

/// The outward direction at `p` on the surface, unit length.
pub(crate) fn normal(p: Vec3) -> Vec3 {
    let h = 8e-4;
    let corners =
        [Vec3::new(1.0, -1.0, -1.0), Vec3::new(-1.0, -1.0, 1.0), Vec3::new(-1.0, 1.0, -1.0), Vec3::new(1.0, 1.0, 1.0)];
    corners.iter().map(|&c| c * distance(p + c * h)).sum::<Vec3>().normalize_or(Vec3::Z)
}

/// What the landmark is made of at a point on its surface.
pub(crate) fn surface(p: Vec3, n: Vec3) -> Surface {
    let r = Vec2::new(p.x, p.y).length();
    let bollard = p.z < 0.6 && p.x.abs().min(p.y.abs()) > 0.6;
    if bollard && p.z > 0.34 || r < 0.075 && p.z > 2.17 {
        return Surface::metal(Vec3::new(1.0, 0.6, 0.13), 0.22);
    }
    if p.z > 1.872 {
        return dome(p);
    }
    if (1.56..1.81).contains(&p.z) && r < 0.2 {
        let glow = Vec3::new(1.0, 0.62, 0.22) * (0.75 + 0.25 * (p.z * 90.0).sin());
        return Surface { colour: Vec3::new(0.9, 0.7, 0.4), metal: 0.0, roughness: 0.25, glow };
    }
    if (SHAFT.0 + 0.06..SHAFT.1 - 0.02).contains(&p.z) && r < 0.4 {
        return shaft_surface(p);
    }
    if p.z < 0.6 && p.x.abs().max(p.y.abs()) < 0.47 {
        return niche_surface(p);
    }
    stone(p, n)
}

/// Copper with verdigris in streaks between its ribs.
fn dome(p: Vec3) -> Surface {
    let angle = p.y.atan2(p.x);
    let rib = (angle * 12.0).cos();
    let streak = value(Vec2::new(angle * 9.0, p.z * 6.0), 41);
    let green = smoothstep(0.25, 0.8, streak * 0.9 + 0.35 * (2.05 - p.z) * 2.0);
    let copper = Vec3::new(0.86, 0.42, 0.22);
    let verdigris = Vec3::new(0.16, 0.50, 0.42);
    let ridge = smoothstep(0.86, 0.97, rib);
    let colour = copper.lerp(verdigris, green * (1.0 - 0.8 * ridge));
    Surface { colour, metal: 1.0 - 0.75 * green * (1.0 - ridge), roughness: 0.28 + 0.5 * green, glow: Vec3::ZERO }
}

/// Courses of stone, four hanging banners and a spiral of small windows.
fn shaft_surface(p: Vec3) -> Surface {
    let turn = p.y.atan2(p.x) / std::f32::consts::TAU + 1.0;
    let height = (p.z - SHAFT.0) / (SHAFT.1 - SHAFT.0);
    let side = (turn * 4.0 + 0.5).floor();
    let across = turn * 4.0 + 0.5 - side - 0.5;
    if across.abs() < 0.2 && (0.3..0.93).contains(&height) {
        return banner(side as i32 % 4, across / 0.2, (height - 0.3) / 0.63);
    }
    // Windows climb between the banners, one an eighth of a turn.
    let window = ((turn * 4.0).floor() as i32).rem_euclid(4) as f32;
    let lift = 0.34 + 0.14 * window;
    let off = Vec2::new((turn * 4.0).fract() - 0.5, (height - lift) * 1.5);
    let arch = off.x.abs().max((off.y.abs() - 0.07).max(0.0) * 0.9 + off.x.abs() * 0.4);
    if arch < 0.065 && off.y.abs() < 0.13 {
        return Surface { colour: Vec3::new(0.02, 0.03, 0.05), metal: 0.0, roughness: 0.08, glow: Vec3::ZERO };
    }
    let course = height * 11.0;
    blocks(Vec2::new(turn * 16.0 + 0.5 * (course.floor() % 2.0), course), 0.05, 5, Vec3::new(0.66, 0.58, 0.46))
}

/// One of four banners; `u` in -1 to 1 across, `v` in 0 to 1 upwards.
fn banner(side: i32, u: f32, v: f32) -> Surface {
    let (field, charge) = BANNERS[side.rem_euclid(4) as usize];
    let fold = 0.85 + 0.15 * (u * 7.0 + v * 3.0).sin();
    let at = Vec2::new(u, (v - 0.55) * 3.2);
    let device = match side.rem_euclid(4) {
        0 => (at.length() - 0.45).abs() < 0.16,
        1 => at.x.abs() + at.y.abs() < 0.62,
        2 => at.x.abs().min(at.y.abs()) < 0.15 && at.length() < 0.75,
        _ => (at.y + (at.x.abs() - 0.5)).abs() < 0.18 || (at.y - 0.55 + (at.x.abs() - 0.5)).abs() < 0.18,
    };
    let hem = u.abs() > 0.84 || !(0.05..=0.95).contains(&v);
    Surface::matt(if device || hem { charge } else { field } * fold)
}

/// Cloth and device of each banner, linear.
const BANNERS: [(Vec3, Vec3); 4] = [
    (Vec3::new(0.45, 0.02, 0.03), Vec3::new(0.85, 0.62, 0.18)),
    (Vec3::new(0.02, 0.07, 0.38), Vec3::new(0.85, 0.85, 0.82)),
    (Vec3::new(0.03, 0.24, 0.09), Vec3::new(0.88, 0.76, 0.25)),
    (Vec3::new(0.75, 0.42, 0.05), Vec3::new(0.22, 0.03, 0.16)),
];

/// What stands in the niche of each side: a red door, a relief, tiles, a grille.
fn niche_surface(p: Vec3) -> Surface {
    let on_x = p.x.abs() > p.y.abs();
    let (depth, across) = if on_x { (p.x, p.y) } else { (p.y, p.x) };
    if depth.abs() > 0.445 {
        return Surface::matt(Vec3::new(0.5, 0.43, 0.34));
    }
    match (on_x, depth > 0.0) {
        (true, true) => {
            let plank = ((across * 24.0).fract() - 0.5).abs() > 0.42;
            let colour = Vec3::new(0.42, 0.05, 0.04) * if plank { 0.45 } else { 1.0 };
            Surface { roughness: 0.5, ..Surface::matt(colour) }
        }
        (false, true) => {
            let wave = (across * 60.0).sin() * (p.z * 60.0).sin();
            Surface::metal(Vec3::new(0.62, 0.42, 0.2) * (0.75 + 0.25 * wave), 0.3)
        }
        (true, false) => {
            let tile = Vec2::new(across, p.z) * 22.0;
            let (x, y) = (tile.x.floor() as i32, tile.y.floor() as i32);
            let white = (x + y).rem_euclid(2) == 0;
            let colour = if white { Vec3::new(0.75, 0.78, 0.76) } else { Vec3::new(0.03, 0.16, 0.42) };
            Surface { roughness: 0.2, ..Surface::matt(colour * (0.8 + 0.2 * cell(x, y, 9))) }
        }
        (false, false) => {
            let bar = ((across * 18.0).fract() - 0.5).abs() < 0.2 || ((p.z * 18.0).fract() - 0.5).abs() < 0.14;
            if bar { Surface::metal(Vec3::new(0.3, 0.3, 0.32), 0.35) } else { Surface::matt(Vec3::splat(0.015)) }
        }
    }
}

/// Dressed stone: blocks laid along whichever direction the surface runs.
fn stone(p: Vec3, n: Vec3) -> Surface {
    let flat = n.z.abs() > 0.7;
    let along = if n.x.abs() > n.y.abs() { p.y } else { p.x };
    let (uv, salt) = match (flat, p.z < 0.215) {
        (true, true) => (Vec2::new(p.y.atan2(p.x) * 5.0, Vec2::new(p.x, p.y).length() / 0.15), 3),
        (true, false) => (Vec2::new(p.x, p.y) * 5.0, 4),
        (false, true) => (Vec2::new(p.y.atan2(p.x) * 5.0, p.z / 0.07), 6),
        (false, false) => {
            let course = (p.z - 0.24) * 9.0;
            (Vec2::new(along * 5.0 + 0.5 * (course.floor() % 2.0), course), 7)
        }
    };
    let tone = if p.z < 0.215 { Vec3::new(0.48, 0.45, 0.42) } else { Vec3::new(0.63, 0.56, 0.45) };
    blocks(uv, 0.035, salt, tone)
}

/// Blocks of stone, one a unit cell of `uv`, each a little different, with
/// darker joints and weathering.
fn blocks(uv: Vec2, joint: f32, salt: u32, tone: Vec3) -> Surface {
    let inside = uv - uv.floor();
    let edge = inside.x.min(1.0 - inside.x).min(inside.y.min(1.0 - inside.y) * 0.8);
    let shade = cell(uv.x.floor() as i32, uv.y.floor() as i32, salt);
    let hue = cell(uv.x.floor() as i32, uv.y.floor() as i32, salt + 50) - 0.5;
    let grain = fractal(uv * 5.0, salt + 7);
    let wear = 0.55 + 0.45 * smoothstep(0.0, joint * 2.0, edge);
    let tint = Vec3::new(1.0 + 0.12 * hue, 1.0, 1.0 - 0.16 * hue);
    Surface { roughness: 0.75, ..Surface::matt(tone * tint * wear * (0.72 + 0.36 * shade) * (0.75 + 0.5 * grain)) }
}

/// The square around the landmark: rings of setts, then grass.
pub(crate) fn ground(p: Vec2) -> Surface {
    let (r, turn) = (p.length(), p.y.atan2(p.x) / std::f32::consts::TAU);
    let ring = (r / 0.24).floor();
    let stones = (ring * 5.0).max(4.0).round();
    let uv = Vec2::new((turn + 0.5) * stones + 0.5 * (ring % 2.0), r / 0.24);
    let dark = ring as i32 % 4 == 0;
    let tone = if dark { Vec3::new(0.25, 0.21, 0.2) } else { Vec3::new(0.42, 0.39, 0.36) };
    let paved = blocks(uv, 0.06, 21, tone);
    let tuft = fractal(p * 3.5, 31);
    let blade = value(p * 26.0, 35);
    let grass = Vec3::new(0.11, 0.2, 0.05).lerp(Vec3::new(0.25, 0.28, 0.09), tuft) * (0.7 + 0.5 * blade);
    let edge = smoothstep(3.9, 4.1, r + 0.25 * (value(p * 4.0, 33) - 0.5));
    Surface { roughness: 0.8, ..Surface::matt(paved.colour.lerp(grass, edge)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_points_are_inside_and_outside() {
        for inside in [Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 0.1, 0.03), Vec3::new(0.0, 0.0, 2.36)] {
            assert!(distance(inside) < 0.0, "{inside} lies in the landmark");
        }
        for outside in [Vec3::new(1.0, 1.0, 0.1), Vec3::new(0.0, 0.0, 2.45), Vec3::new(0.48, 0.0, 0.4)] {
            assert!(distance(outside) > 0.0, "{outside} lies in the air");
        }
    }

    #[test]
    fn nothing_of_it_sticks_out_of_its_cylinder() {
        for i in 0..720 {
            let (sin, cos) = (i as f32 * 0.5f32.to_radians()).sin_cos();
            for z in 0..60 {
                let p = Vec3::new(cos * RADIUS * 1.02, sin * RADIUS * 1.02, z as f32 * 0.05);
                assert!(distance(p) > 0.0, "{p}");
            }
        }
        assert!(distance(Vec3::new(0.0, 0.0, HEIGHT + 0.01)) > 0.0);
    }

    #[test]
    fn a_step_of_the_distance_never_goes_through() {
        for i in 0..20_000u32 {
            let unit = |salt| cell(i as i32, 0, salt) * 2.0 - 1.0;
            let p = Vec3::new(unit(1) * 1.3, unit(2) * 1.3, cell(i as i32, 1, 3) * 2.4);
            let d = distance(p);
            let way = Vec3::new(unit(4), unit(5), unit(6)).normalize_or(Vec3::X);
            if d > 1e-3 {
                assert!(distance(p + way * d * 0.98) > -2e-3, "{p} said {d}");
            }
        }
    }
}
