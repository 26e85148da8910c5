//! Pictures that carry no mark: base renders, photographs, and pictures of
//! anything else. Without them a classifier says yes to everything, and a
//! detector recognises the scene and not the mark.

use crate::attack::Blur;
use crate::stega::grain::Grain;
use crate::stega::recipe::{OtherColours, Recipe};
use cairn_scene::AreaFilter;
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Standard deviation of the faintest and of the strongest grain.
const GRAIN: [f32; 2] = [0.5 / 255.0, 12.0 / 255.0];
/// Share of the pictures in other colours that are without any.
const GREY: f64 = 0.1;
/// Share of them that are cast in one light, so that what is grey has its colour.
const CAST: f64 = 0.5;
/// Share of the pictures from the bank that are shown as they are.
const AS_IT_IS: f64 = 0.4;

/// A bank of unmarked pictures at the networks' size.
pub(crate) struct Negatives {
    side: usize,
    /// What their colours become.
    colours: OtherColours,
    /// How often one of them is made into an object on a flat background, 0 to 1.
    cutout_share: f64,
    /// Each as it is, and as it is read from a JPEG; `side x side x 3`.
    pictures: Vec<[Vec<f32>; 2]>,
}

impl Negatives {
    /// A bank of `pictures` of `side` pixels each way, of which those of something else are made as `config` says.
    pub(crate) fn new(side: usize, config: &Recipe, pictures: impl Iterator<Item = [Vec<f32>; 2]>) -> Self {
        Self {
            side,
            colours: config.others_colours,
            cutout_share: config.others_cutout_share,
            pictures: pictures.collect(),
        }
    }

    /// One of the bank as it is, or made into a picture of something else: cropped,
    /// mirrored, in other colours, sharpened, with coloured edges, where colours may be any with coloured grain, two
    /// laid over one another, an object on a flat background, or plain noise.
    /// A project has photographs of its landmark only, and the world has others: what
    /// their colours are like must not be what tells a mark.
    /// With `jpegs`, half come as JPEGs.
    pub(crate) fn draw(&self, jpegs: bool, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let n = self.side * self.side * 3;
        if self.pictures.is_empty() || rng.random_range(0..12) == 0 {
            let (level, depth) = (rng.random_range(0.0f32..1.0), rng.random_range(0.0f32..0.5));
            return (0..n).map(|_| (level + depth * rng.random_range(-1.0f32..1.0)).clamp(0.0, 1.0)).collect();
        }
        let [plain, jpeg] = &self.pictures[rng.random_range(0..self.pictures.len())];
        let mut picture = if jpegs && rng.random_bool(0.5) { jpeg.clone() } else { plain.clone() };
        if rng.random_bool(AS_IT_IS) {
            return picture;
        }
        if rng.random_range(0..2) == 0 {
            picture = self.cropped(&picture, rng);
        }
        if rng.random_range(0..2) == 0 {
            for row in picture.chunks_exact_mut(self.side * 3) {
                for x in 0..self.side / 2 {
                    for c in 0..3 {
                        row.swap(x * 3 + c, (self.side - 1 - x) * 3 + c);
                    }
                }
            }
        }
        if rng.random_range(0..3) == 0 {
            let [other, _] = &self.pictures[rng.random_range(0..self.pictures.len())];
            let share = rng.random_range(0.2f32..0.8);
            picture.iter_mut().zip(other).for_each(|(v, o)| *v += share * (o - *v));
        }
        if rng.random_range(0..3) == 0 {
            picture = self.sharpened(picture, rng.random_range(0.3f32..2.0));
        }
        if rng.random_range(0..3) == 0 {
            self.fringe(&mut picture, rng);
        }
        match self.colours {
            OtherColours::Near => recoloured(&mut picture, rng),
            OtherColours::Any => {
                recast(&mut picture, rng);
                if rng.random_range(0..2) == 0 {
                    self.grain(&mut picture, rng);
                }
            }
        }
        // Asked for first: without it, trainings go on with the draws that they began with.
        if self.cutout_share > 0.0 && rng.random_bool(self.cutout_share) {
            self.cut_out(&mut picture, rng);
        }
        picture
    }

    /// All but a blob of the picture in one flat colour, as renders and cut-outs show objects: grain, a cast and whatever else
    /// is all over a photograph then ends where the object does.
    fn cut_out(&self, picture: &mut [f32], rng: &mut ChaCha8Rng) {
        let outline = Outline::draw(self.side as f32, rng);
        let flat: [f32; 3] = match rng.random_range(0..4) {
            0 => [1.0; 3],
            1 => [0.0; 3],
            2 => [rng.random_range(0.0f32..1.0); 3],
            _ => std::array::from_fn(|_| rng.random_range(0.0f32..1.0)),
        };
        for (i, pixel) in picture.chunks_exact_mut(3).enumerate() {
            let outside = 1.0 - outline.covers((i % self.side) as f32, (i / self.side) as f32);
            pixel.iter_mut().zip(flat).for_each(|(v, f)| *v += outside * (f - *v));
        }
    }

    /// Texture of a hue or two all over the picture: a mark is not any texture.
    fn grain(&self, picture: &mut [f32], rng: &mut ChaCha8Rng) {
        for _ in 0..rng.random_range(1..3) {
            Grain::draw(GRAIN, 1.0, rng).apply(picture, self.side);
            picture.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        }
    }

    /// One channel moved by up to a pixel and a half each way: coloured edges, as lenses,
    /// resampling and painters make them. They are what looks most like a mark.
    fn fringe(&self, picture: &mut [f32], rng: &mut ChaCha8Rng) {
        let channel = rng.random_range(0..3);
        let [dx, dy] = [0; 2].map(|_| rng.random_range(-1.5f32..1.5));
        let plane: Vec<f32> = picture.iter().skip(channel).step_by(3).copied().collect();
        let most = self.side as f32 - 1.0;
        let at = |x: usize, y: usize| plane[y.min(self.side - 1) * self.side + x.min(self.side - 1)];
        for (i, pixel) in picture.chunks_exact_mut(3).enumerate() {
            let x = ((i % self.side) as f32 + dx).clamp(0.0, most);
            let y = ((i / self.side) as f32 + dy).clamp(0.0, most);
            let (u, v) = (x as usize, y as usize);
            let row = |v: usize| at(u, v) + x.fract() * (at(u + 1, v) - at(u, v));
            pixel[channel] = row(v) + y.fract() * (row(v + 1) - row(v));
        }
    }

    /// Fine detail made larger by `more`, as cameras and programs do.
    fn sharpened(&self, mut picture: Vec<f32>, more: f32) -> Vec<f32> {
        let soft = Blur::new(1.0).apply(&picture, [self.side; 2]);
        picture.iter_mut().zip(soft).for_each(|(v, s)| *v = (*v + more * (*v - s)).clamp(0.0, 1.0));
        picture
    }

    fn cropped(&self, picture: &[f32], rng: &mut ChaCha8Rng) -> Vec<f32> {
        let size = rng.random_range(self.side / 2..=self.side);
        let (x, y) = (rng.random_range(0..=self.side - size), rng.random_range(0..=self.side - size));
        let mut part = Vec::with_capacity(size * size * 3);
        for row in y..y + size {
            part.extend_from_slice(&picture[(row * self.side + x) * 3..(row * self.side + x + size) * 3]);
        }
        AreaFilter::new([size, size], [self.side, self.side]).apply(&part)
    }
}

/// A blob: how far its edge is from its centre goes up and down with the direction.
struct Outline {
    centre: [f32; 2],
    /// Mean distance of the edge, px.
    radius: f32,
    /// Amplitude (a share of `radius`) and phase of one, two, three and four waves around.
    waves: [[f32; 2]; 4],
}

impl Outline {
    /// One in a picture of `side` pixels each way: its centre in the middle half, its edge mostly within.
    fn draw(side: f32, rng: &mut ChaCha8Rng) -> Self {
        let centre = [0; 2].map(|_| side * rng.random_range(0.25f32..0.75));
        let radius = side * rng.random_range(0.15f32..0.5);
        let waves = std::array::from_fn(|k| {
            let most = 0.3 / (k + 1) as f32;
            [rng.random_range(0.0..most), rng.random_range(0.0..std::f32::consts::TAU)]
        });
        Self { centre, radius, waves }
    }

    /// How much of the pixel `(x, y)` lies within, 0 to 1: its edge is a pixel wide.
    fn covers(&self, x: f32, y: f32) -> f32 {
        let [dx, dy] = [x - self.centre[0], y - self.centre[1]];
        let angle = dy.atan2(dx);
        let waves = self.waves.iter().zip(1u8..).map(|([size, phase], k)| size * (f32::from(k) * angle + phase).cos());
        let edge = self.radius * (1.0 + waves.sum::<f32>());
        (edge - dx.hypot(dy) + 0.5).clamp(0.0, 1.0)
    }
}

/// Channels exchanged by turns, then mixed by a matrix near the identity, then a curve: other materials, lights and
/// cameras. Grey stays grey.
fn recoloured(picture: &mut [f32], rng: &mut ChaCha8Rng) {
    let shift = rng.random_range(0..3);
    let strength = rng.random_range(0.0f32..0.6);
    let gamma = rng.random_range(0.6f32..1.6);
    let matrix = mixing(strength, rng);
    for pixel in picture.chunks_exact_mut(3) {
        pixel.rotate_left(shift);
        let mixed = matrix.map(|mix| mix[0] * pixel[0] + mix[1] * pixel[1] + mix[2] * pixel[2]);
        pixel.iter_mut().zip(mixed).for_each(|(v, m)| *v = m.clamp(0.0, 1.0).powf(gamma));
    }
}

/// Channels exchanged in any way, mixed further, with none of the colour to more than twice as much, half of them cast in one
/// light. How colours vary together is what tells a mark most easily, and other places' photographs have it, too.
fn recast(picture: &mut [f32], rng: &mut ChaCha8Rng) {
    let mut order = [0, 1, 2];
    order.shuffle(rng);
    let strength = rng.random_range(0.0f32..0.8);
    let saturation = if rng.random_bool(GREY) { 0.0 } else { 2.5 * rng.random_range(0.0f32..1.0) };
    let gamma = rng.random_range(0.6f32..1.6);
    let cast: [f32; 3] = match rng.random_bool(CAST) {
        true => std::array::from_fn(|_| rng.random_range(0.15f32..1.0)),
        false => [1.0; 3],
    };
    let matrix = mixing(strength, rng);
    for pixel in picture.chunks_exact_mut(3) {
        let of = order.map(|c| pixel[c]);
        let mixed = matrix.map(|mix| mix[0] * of[0] + mix[1] * of[1] + mix[2] * of[2]);
        let grey = of.iter().sum::<f32>() / 3.0;
        for ((v, mixed), cast) in pixel.iter_mut().zip(mixed).zip(cast) {
            *v = (cast * (grey + saturation * (mixed - grey))).clamp(0.0, 1.0).powf(gamma);
        }
    }
}

/// A matrix near the identity, by up to `strength`, that keeps grey.
fn mixing(strength: f32, rng: &mut ChaCha8Rng) -> [[f32; 3]; 3] {
    std::array::from_fn(|row| {
        let mut mix: [f32; 3] =
            std::array::from_fn(|c| f32::from(u8::from(c == row)) + strength * rng.random_range(-1.0f32..1.0));
        let off = (mix.iter().sum::<f32>() - 1.0) / 3.0;
        mix.iter_mut().for_each(|m| *m -= off);
        mix
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use std::collections::BTreeMap;

    fn of(others_colours: OtherColours) -> Recipe {
        Recipe { others_colours, ..Recipe::default() }
    }

    #[test]
    fn near_colours_keep_grey_grey_and_stay_in_range() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            let mut picture = vec![0.4, 0.4, 0.4, 1.0, 0.0, 0.3, 0.0, 0.0, 0.0];
            recoloured(&mut picture, &mut rng);
            assert!(picture.iter().all(|v| (0.0..=1.0).contains(v)), "{picture:?}");
            let grey = &picture[..3];
            assert!(grey.iter().all(|v| (v - grey[0]).abs() < 1e-5), "{grey:?}");
        }
    }

    #[test]
    fn any_colours_stay_in_range_and_some_are_none_or_cast_on_what_is_grey() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        // Of as many pictures: those in which a grey pixel stays grey, and those in which a coloured one becomes so.
        let (mut uncast, mut grey) = (0, 0);
        for _ in 0..400 {
            let mut picture = vec![0.4, 0.4, 0.4, 1.0, 0.0, 0.3, 0.0, 0.0, 0.0];
            recast(&mut picture, &mut rng);
            assert!(picture.iter().all(|v| (0.0..=1.0).contains(v)), "{picture:?}");
            let same = |pixel: &[f32]| pixel.iter().all(|v| (v - pixel[0]).abs() < 1e-5);
            uncast += usize::from(same(&picture[..3]));
            grey += usize::from(same(&picture[..3]) && same(&picture[3..6]));
        }
        assert!((160..240).contains(&uncast), "half are cast, and {uncast} of 400 are not");
        assert!((8..40).contains(&grey), "one in ten has no colour, of those not cast {grey}");
    }

    /// How red-green and lightness vary together over `picture`.
    fn together(picture: &[f32]) -> f32 {
        let of = |pixel: &[f32]| (pixel[0] - pixel[1], pixel.iter().sum::<f32>());
        let n = (picture.len() / 3) as f32;
        let (red, light) = picture.chunks_exact(3).map(of).fold((0.0, 0.0), |sum, of| (sum.0 + of.0, sum.1 + of.1));
        picture.chunks_exact(3).map(of).map(|(r, l)| (r - red / n) * (l - light / n)).sum()
    }

    #[test]
    fn colour_goes_with_light_either_way() {
        // Grey stripes: a mark of one hue, tilted towards grey, has colour that goes with light.
        let stripes: Vec<f32> = (0..64).flat_map(|i| [if i % 2 == 0 { 0.3 } else { 0.7 }; 3]).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut ways = [0; 2];
        for _ in 0..200 {
            let mut picture = stripes.clone();
            recast(&mut picture, &mut rng);
            let with = together(&picture);
            ways[0] += usize::from(with > 0.1);
            ways[1] += usize::from(with < -0.1);
        }
        assert!(ways.iter().all(|way| (30..80).contains(way)), "{ways:?} of 200");
    }

    #[test]
    fn grain_is_faint_and_not_grey() {
        let bank = Negatives::new(32, &of(OtherColours::Any), std::iter::empty());
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        for _ in 0..40 {
            let mut picture = vec![0.5; 32 * 32 * 3];
            bank.grain(&mut picture, &mut rng);
            let off: Vec<f32> = picture.iter().map(|v| v - 0.5).collect();
            let size = (off.iter().map(|v| v * v).sum::<f32>() / off.len() as f32).sqrt();
            // One or two, each between these.
            assert!((0.9 * GRAIN[0]..2.1 * GRAIN[1]).contains(&size), "{size}");
            let coloured =
                off.chunks_exact(3).filter(|p| (p[0] - p[1]).abs() + (p[1] - p[2]).abs() > 0.1 * size).count();
            assert!(coloured > 32 * 16, "{coloured} of 1024");
        }
    }

    #[test]
    fn a_fringe_moves_one_channel_and_leaves_the_others() {
        let ramp: Vec<f32> = (0..16 * 16).flat_map(|i| [(i % 16) as f32 / 16.0; 3]).collect();
        let bank = Negatives::new(16, &of(OtherColours::Near), std::iter::empty());
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        for _ in 0..20 {
            let mut moved = ramp.clone();
            bank.fringe(&mut moved, &mut rng);
            let off = |c: usize| (0..256).map(|i| (moved[i * 3 + c] - ramp[i * 3 + c]).abs()).fold(0.0f32, f32::max);
            let changed: Vec<f32> = (0..3).map(off).filter(|o| *o > 1e-6).collect();
            assert_eq!(changed.len(), 1, "{changed:?}");
            assert!(changed[0] < 1.51 / 16.0, "{changed:?}");
        }
    }

    #[test]
    fn cutouts_are_photographs_within_one_outline_and_flat_beyond() {
        // No colour of the picture comes twice, and none is what "nothing" may be.
        let photograph: Vec<f32> = (0..32 * 32).flat_map(|i| [0.2 + 0.5 * i as f32 / 1024.0, 0.31, 0.47]).collect();
        let bank = Negatives::new(32, &of(OtherColours::Near), std::iter::empty());
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (mut white, mut black, mut kept_all) = (0, 0, 0.0);
        for _ in 0..200 {
            let mut seen = photograph.clone();
            bank.cut_out(&mut seen, &mut rng);
            let pixels = || seen.chunks_exact(3).zip(photograph.chunks_exact(3));
            let kept = pixels().filter(|(now, before)| now == before).count();
            let mut changed = BTreeMap::new();
            for (now, _) in pixels().filter(|(now, before)| now != before) {
                *changed.entry([0, 1, 2].map(|c| (now[c] * 1e4).round() as u32)).or_insert(0) += 1;
            }
            let (colour, flat) = changed.into_iter().max_by_key(|(_, count)| *count).unwrap();
            // What is neither is the edge, and it is as long as an outline of a pixel's width.
            assert!(kept + flat > 1024 - 160, "{kept} of the photograph, {flat} flat");
            assert!(kept > 10 && flat > 10, "{kept} of the photograph, {flat} flat");
            white += usize::from(colour == [10_000; 3]);
            black += usize::from(colour == [0; 3]);
            kept_all += kept as f32 / (200.0 * 1024.0);
        }
        assert!((30..75).contains(&white) && (30..75).contains(&black), "{white} white, {black} black of 200");
        assert!((0.15..0.5).contains(&kept_all), "{kept_all} of all pixels are an object's");
    }

    #[test]
    fn objects_cut_out_as_often_as_asked_for() {
        let striped: Vec<f32> = (0..16 * 16 * 3).map(|i| if i % 48 < 24 { 0.2 } else { 0.9 }).collect();
        let drawn = |share: f64| {
            let config = Recipe { others_cutout_share: share, ..of(OtherColours::Near) };
            let bank = Negatives::new(16, &config, std::iter::once([striped.clone(), striped.clone()]));
            (0..300).map(|seed| bank.draw(false, &mut ChaCha8Rng::seed_from_u64(seed))).collect::<Vec<Vec<f32>>>()
        };
        let [without, some, all] = [0.0, 0.25, 1.0].map(drawn);
        let changed = |with: &[Vec<f32>]| with.iter().zip(&without).filter(|(with, without)| with != without).count();
        // Plain noise, one in twelve, and what is shown as it is, four in ten of the others, stay: 165 of 300 are left.
        assert!((135..195).contains(&changed(&all)), "{} of 300", changed(&all));
        assert!((20..65).contains(&changed(&some)), "{} of 300", changed(&some));
    }

    #[test]
    fn what_makes_no_objects_draws_no_number_for_them() {
        // Trainings that began before there were any go on as they would have.
        let striped: Vec<f32> = (0..16 * 16 * 3).map(|i| if i % 48 < 24 { 0.2 } else { 0.9 }).collect();
        let drawn = |share: f64| {
            let config = Recipe { others_cutout_share: share, ..of(OtherColours::Near) };
            let bank = Negatives::new(16, &config, std::iter::once([striped.clone(), striped.clone()]));
            let mut rng = ChaCha8Rng::seed_from_u64(11);
            (0..40).for_each(|_| drop(bank.draw(false, &mut rng)));
            rng.get_word_pos()
        };
        // The same pictures, but for a number each that may become an object and, by so small a share, does not.
        assert_ne!(drawn(0.0), drawn(1e-12));
    }

    #[test]
    fn what_is_drawn_differs_and_is_a_picture() {
        let half: Vec<f32> = (0..16 * 16 * 3).map(|i| if i % 48 < 24 { 0.2 } else { 0.9 }).collect();
        let bank = Negatives::new(16, &of(OtherColours::Near), std::iter::once([half.clone(), half]));
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let drawn: Vec<Vec<f32>> = (0..40).map(|_| bank.draw(true, &mut rng)).collect();
        assert!(drawn.iter().all(|p| p.len() == 16 * 16 * 3 && p.iter().all(|v| (0.0..=1.0).contains(v))));
        let different = drawn.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!(different > 30, "{different} of 39");
    }

    #[test]
    fn what_is_grey_gets_colour_where_colours_may_be_any() {
        let grey: Vec<f32> = (0..16 * 16).flat_map(|i| [(i % 16) as f32 / 16.0; 3]).collect();
        let coloured = |colours: OtherColours| {
            let bank = Negatives::new(16, &of(colours), std::iter::once([grey.clone(), grey.clone()]));
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let has_colour = |picture: &Vec<f32>| picture.chunks_exact(3).any(|p| (p[0] - p[1]).abs() > 0.01);
            (0..300).filter(|_| has_colour(&bank.draw(false, &mut rng))).count()
        };
        // Plain noise, one in twelve, and moved channels, one in three of those that are not shown as they are.
        let [near, any] = [OtherColours::Near, OtherColours::Any].map(coloured);
        assert!((50..110).contains(&near), "{near} of 300");
        assert!((130..200).contains(&any), "{any} of 300");
    }

    #[test]
    fn jpegs_are_drawn_when_asked_for_and_never_else() {
        let [plain, jpeg] = [0.2, 0.9].map(|v| vec![v; 16 * 16 * 3]);
        let bank = Negatives::new(16, &of(OtherColours::Near), std::iter::once([plain.clone(), jpeg.clone()]));
        let drawn = |jpegs: bool| {
            let mut rng = ChaCha8Rng::seed_from_u64(4);
            let all: Vec<Vec<f32>> = (0..400).map(|_| bank.draw(jpegs, &mut rng)).collect();
            [&plain, &jpeg].map(|of| all.iter().filter(|picture| *picture == of).count())
        };
        // Four in ten come as they are.
        assert!(matches!(drawn(false), [120..=200, 0]), "{:?}", drawn(false));
        assert!(matches!(drawn(true), [50..=110, 50..=110]), "{:?}", drawn(true));
    }
}
