//! Passers-by: figures of capsules who stand before the lens on some
//! photographs and on no other. They are what must not end up in the field.

use glam::{Vec2, Vec3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// A capsule: a segment with a radius, in one colour (linear).
#[derive(Clone, Copy, Debug)]
struct Limb {
    from: Vec3,
    to: Vec3,
    radius: f32,
    colour: Vec3,
}

/// Somebody in the way.
#[derive(Clone, Debug)]
pub(crate) struct Person {
    limbs: Vec<Limb>,
    /// A sphere around all of them.
    centre: Vec3,
    reach: f32,
}

/// Clothes, linear.
const CLOTHES: [Vec3; 8] = [
    Vec3::new(0.55, 0.05, 0.05),
    Vec3::new(0.05, 0.12, 0.42),
    Vec3::new(0.75, 0.72, 0.66),
    Vec3::new(0.03, 0.03, 0.04),
    Vec3::new(0.80, 0.50, 0.05),
    Vec3::new(0.05, 0.28, 0.16),
    Vec3::new(0.36, 0.08, 0.32),
    Vec3::new(0.14, 0.32, 0.40),
];
const SKIN: [Vec3; 4] = [
    Vec3::new(0.62, 0.38, 0.27),
    Vec3::new(0.42, 0.23, 0.14),
    Vec3::new(0.22, 0.11, 0.06),
    Vec3::new(0.70, 0.47, 0.36),
];
const HAIR: [Vec3; 3] = [Vec3::new(0.02, 0.015, 0.012), Vec3::new(0.16, 0.08, 0.03), Vec3::new(0.45, 0.32, 0.15)];

impl Person {
    /// Somebody at `place` on the ground, facing anywhere, mid-stride.
    pub(crate) fn at(place: Vec2, rng: &mut ChaCha8Rng) -> Self {
        let tall = rng.random_range(0.31..0.37f32);
        let (sin, cos) = rng.random_range(0.0..std::f32::consts::TAU).sin_cos();
        let point = |side: f32, ahead: f32, up: f32| {
            Vec3::new(
                place.x + (side * cos - ahead * sin) * tall,
                place.y + (side * sin + ahead * cos) * tall,
                up * tall,
            )
        };
        let mut pick = |colours: &[Vec3]| colours[rng.random_range(0..colours.len())];
        let (shirt, trousers, skin, hair) = (pick(&CLOTHES), pick(&CLOTHES) * 0.6, pick(&SKIN), pick(&HAIR));
        let stride = rng.random_range(0.02..0.13f32);
        let limb = |from, to, radius: f32, colour| Limb { from, to, radius: radius * tall, colour };
        let limbs = vec![
            limb(point(0.06, stride, 0.05), point(0.055, 0.0, 0.47), 0.052, trousers),
            limb(point(-0.06, -stride, 0.05), point(-0.055, 0.0, 0.47), 0.052, trousers),
            limb(point(0.0, 0.0, 0.52), point(0.0, 0.0, 0.74), 0.105, shirt),
            limb(point(0.14, -stride, 0.5), point(0.125, 0.0, 0.77), 0.036, shirt),
            limb(point(-0.14, stride, 0.5), point(-0.125, 0.0, 0.77), 0.036, shirt),
            limb(point(0.145, -stride, 0.45), point(0.145, -stride, 0.46), 0.035, skin),
            limb(point(-0.145, stride, 0.45), point(-0.145, stride, 0.46), 0.035, skin),
            limb(point(0.0, 0.01, 0.91), point(0.0, 0.012, 0.93), 0.066, skin),
            limb(point(0.0, -0.012, 0.94), point(0.0, -0.012, 0.95), 0.066, hair),
        ];
        Self { limbs, centre: point(0.0, 0.0, 0.5), reach: 0.56 * tall }
    }

    /// Nearest hit along the ray before `far`: distance, normal, colour.
    pub(crate) fn hit(&self, origin: Vec3, way: Vec3, far: f32) -> Option<(f32, Vec3, Vec3)> {
        if !self.near(origin, way) {
            return None;
        }
        let hits = self.limbs.iter().filter_map(|limb| Some((limb.hit(origin, way)?, limb)));
        let (t, limb) = hits.filter(|(t, _)| *t < far).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let p = origin + way * t;
        let axis = limb.to - limb.from;
        let along = ((p - limb.from).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
        Some((t, (p - limb.from - axis * along) / limb.radius, limb.colour))
    }

    /// Whether the ray meets this person at all.
    pub(crate) fn blocks(&self, origin: Vec3, way: Vec3) -> bool {
        self.near(origin, way) && self.limbs.iter().any(|limb| limb.hit(origin, way).is_some())
    }

    fn near(&self, origin: Vec3, way: Vec3) -> bool {
        let to = self.centre - origin;
        let along = to.dot(way).max(0.0);
        (to - way * along).length_squared() < self.reach * self.reach
    }
}

impl Limb {
    /// Distance along a ray from outside (unit `way`) to this capsule: the
    /// quadratic of its cylinder, then of the nearer end's sphere.
    fn hit(&self, origin: Vec3, way: Vec3) -> Option<f32> {
        let axis = self.to - self.from;
        let off = origin - self.from;
        let (aa, aw, ao) = (axis.length_squared(), axis.dot(way), axis.dot(off));
        let (wo, oo) = (way.dot(off), off.length_squared());
        let a = aa - aw * aw;
        let b = aa * wo - ao * aw;
        let c = aa * oo - ao * ao - self.radius * self.radius * aa;
        let h = b * b - a * c;
        if h < 0.0 {
            return None;
        }
        // A ray along the axis only ever meets an end.
        if a > 1e-9 {
            let t = (-b - h.sqrt()) / a;
            let along = ao + t * aw;
            if along > 0.0 && along < aa {
                return (t > 0.0).then_some(t);
            }
        }
        [self.from, self.to].iter().filter_map(|&end| sphere(origin - end, way, self.radius)).min_by(f32::total_cmp)
    }
}

fn sphere(off: Vec3, way: Vec3, radius: f32) -> Option<f32> {
    let b = off.dot(way);
    let h = b * b - off.length_squared() + radius * radius;
    (h >= 0.0).then(|| -b - h.sqrt()).filter(|t| *t > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;

    #[test]
    fn a_hit_lies_on_the_figure_and_faces_the_viewer() {
        let person = Person::at(Vec2::new(0.0, 2.0), &mut ChaCha8Rng::seed_from_u64(1));
        let origin = Vec3::new(0.0, 0.0, 0.25);
        let way = (Vec3::new(0.0, 2.0, 0.22) - origin).normalize();
        let (t, n, _) = person.hit(origin, way, f32::MAX).expect("the torso is in the way");
        assert!((1.7..2.1).contains(&t), "at {t}");
        assert!((n.length() - 1.0).abs() < 1e-3 && n.dot(way) < 0.0);
        assert!(person.hit(origin, way, 1.0).is_none(), "it is beyond what was asked");
        assert!(!person.blocks(origin, -way) && !person.blocks(origin, Vec3::X));
    }
}
