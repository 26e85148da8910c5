//! What the networks are shown in a step: marked renders, the same renders
//! without the mark, and what cameras and files do to either.

use crate::attack::{Attack, Attacked};
use crate::stega::bank::BankView;
use crate::stega::carrier::Carrier;
use crate::stega::grain::Grain;
use crate::stega::site::Site;
use crate::stega::state::State;
use crate::stega::window::Window;
use cairn_field::{Appearance, Field};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// One marked render in so many shows a mark on a view of anybody's cluster: the
/// class must come from the mark and not from what the view shows. Oftener, and
/// too few renders would be those that a mark is judged by, its own cluster's.
const ONE_IN_STRANGERS: i32 = 3;
/// What everybody counts who may be shown once more in a step, beside how badly their mark is told, nats.
const MIN_TOLD: f32 = 0.01;
/// Standard deviation of the faintest and of the strongest noise of a noisy picture.
const NOISY: [f32; 2] = [1.0 / 255.0, 6.0 / 255.0];
/// Share of it that is of one hue.
const ONE_HUE: f64 = 0.5;
/// Share of a step's unmarked pictures that are JPEGs where marks are not trained to outlast one.
const JPEGS: f64 = 0.2;

/// A render of the marked field in this step.
pub(crate) struct Render {
    /// What the classifier is to say: the identity, 1 and up, or 0 outside all clusters.
    pub(crate) class: u32,
    /// Which carrier the render shows.
    pub(crate) carrier: usize,
    /// The scene's number, and its bank's of the view.
    pub(crate) site: usize,
    pub(crate) view: usize,
    /// Whether the view is of another identity's cluster, where nobody will see this mark.
    pub(crate) stranger: bool,
    pub(crate) appearance: Appearance,
    /// Marked minus base, `height x width x 3`.
    pub(crate) change: Vec<f32>,
    /// Whether each number is inside [0, 1], where a gradient passes.
    pub(crate) inside: Vec<bool>,
    /// What was done to the render before the networks saw it, in this order: the attack, the window, the tone.
    pub(crate) attacked: Attacked,
    pub(crate) window: Window,
    pub(crate) gain: f32,
    /// Whether it got much noise, which may have taken its mark.
    pub(crate) noisy: bool,
}

/// The pictures of one step, `side x side x 3` each.
#[derive(Default)]
pub(crate) struct Shown {
    /// One a render: first those of identities, then that of no cluster, if any.
    pub(crate) marked: Vec<Vec<f32>>,
    /// The same as the first of them, without the mark.
    pub(crate) pairs: Vec<Vec<f32>>,
    pub(crate) renders: Vec<Render>,
}

/// Renders one view of each of [`State::batch`] identities, marked and not. Where one
/// carrier is seen from everywhere, also a view of nobody's cluster: what theta
/// shows there is to be silent (equation 2).
pub(crate) fn marked_renders(state: &State, rng: &mut ChaCha8Rng) -> Shown {
    let mut shown = Shown::default();
    for identity in whose(state, rng) {
        let site = state.site_of(identity);
        let of_site = state.sites[site].identities.clone();
        // A mark is made for its own scene's field and cannot be shown in another.
        let stranger = state.sites[site].carriers.len() > 1 && rng.random_range(0..ONE_IN_STRANGERS) == 0;
        let of = if stranger { rng.random_range(of_site.clone()) } else { identity };
        let view = state.sites[site].bank.draw(of - of_site.start, rng);
        let (marked, pair, mut render) = render(state, site, view, Some(identity), rng);
        render.stranger = of != identity;
        shown.marked.push(marked);
        shown.pairs.push(pair);
        shown.renders.push(render);
    }
    for (site, at) in state.sites.iter().enumerate() {
        if let Some(view) = at.bank.draw_outside(rng) {
            let (marked, _, render) = render(state, site, view, None, rng);
            shown.marked.push(marked);
            shown.renders.push(render);
        }
    }
    shown
}

/// Whose marks the step shows, identities from 0.
fn whose(state: &State, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let (identities, in_turn) = (state.signals.len(), state.in_turn());
    let first = (state.step as usize * in_turn) % identities;
    let told = |i: usize| {
        let site = &state.sites[state.site_of(i)];
        site.bank.told(i - site.identities.start)
    };
    let told: Vec<f32> = (0..identities).map(told).collect();
    owners(first, in_turn, state.batch() - in_turn, &told, rng)
}

/// A view with the mark of `identity` (from 0), or of nobody, as the networks see it from a file, after
/// `attack`; the whole picture, or a part where something `happened` to it.
pub(crate) fn as_a_file(
    state: &State,
    site: &Site,
    identity: Option<usize>,
    view: usize,
    attack: &Attack,
    happened: bool,
    rng: &mut ChaCha8Rng,
) -> Vec<f32> {
    let view = site.bank.view(view);
    let carrier = identity.map(|identity| &state.carriers[site.carrier_of(identity)]);
    let file = file(&site.scene.field, view, carrier, attack);
    let [w, h] = file.size;
    let side = state.config.shown_px();
    let window = if happened { Window::draw(w, h, side, rng) } else { Window::whole(w, h, side) };
    window.apply(&file.rgb)
}

/// A scene's view with the mark of `identity` (from 0) and without it, as the networks see
/// them; `None` where one carrier is seen from everywhere and nobody's cluster is shown.
fn render(
    state: &State,
    site: usize,
    view: usize,
    identity: Option<usize>,
    rng: &mut ChaCha8Rng,
) -> (Vec<f32>, Vec<f32>, Render) {
    let Site { scene, bank, identities, .. } = &state.sites[site];
    let appearance = bank.appearance(view, rng);
    let seen_from = bank.view(view);
    let linear = &seen_from.linear;
    let at = state.sites[site].carrier_of(identity.unwrap_or(identities.start));
    let class = identity.map_or(0, |i| i as u32 + 1);
    let mut base = linear.base(&appearance);
    let mut picture = base.clone();
    let attack = attack(state, rng);
    state.carriers[at].after(&attack).show(&scene.field, seen_from, &appearance, &mut picture);
    let change = picture.iter().zip(&base).map(|(a, b)| a - b).collect();
    let inside = picture.iter().map(|v| (0.0..=1.0).contains(v)).collect();
    picture.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    base.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    let size = [linear.width(), linear.height()];
    let (mut attacked, pair) = rayon::join(|| attack.apply(picture, size), || attack.apply(base, size));
    let window = Window::draw(attacked.size[0], attacked.size[1], state.config.shown_px(), rng);
    let tone = tone(state, rng);
    let seen = |full: &[f32]| {
        let mut seen = window.apply(full);
        tone.apply(&mut seen, state.config.shown_px());
        seen
    };
    let full = std::mem::take(&mut attacked.rgb);
    let (marked, pair) = rayon::join(|| seen(&full), || seen(&pair.rgb));
    let (gain, noisy) = (tone.gain, tone.is_noisy());
    let stranger = false;
    let render =
        Render { class, carrier: at, site, view, stranger, appearance, change, inside, attacked, window, gain, noisy };
    (marked, pair, render)
}

/// What happens to a picture of this step. Not before marks are read at all:
/// what is not there yet cannot be made to last.
pub(crate) fn attack(state: &State, rng: &mut ChaCha8Rng) -> Attack {
    if state.joined.is_some() { Attack::draw(&state.config.robust, rng) } else { Attack::none() }
}

/// The tone of a picture of this step. Noise not before marks are read at all, either, and only where there is a classifier that
/// could take it for a mark.
pub(crate) fn tone(state: &State, rng: &mut ChaCha8Rng) -> Tone {
    let noisy = state.joined.is_some() && state.config.has_classifier();
    let share = if noisy { state.config.noisy_share } else { 0.0 };
    Tone::draw(share, rng)
}

/// What happens to a picture of this step that was never marked: a JPEG also where marks are not
/// trained to outlast one. One may be lost there, but none may be found: blocks and ringing
/// edges look most like a mark. Nothing else: what a mark outlasts by itself must not speak against it.
pub(crate) fn attack_on_unmarked(state: &State, rng: &mut ChaCha8Rng) -> Attack {
    let robust = &state.config.robust;
    match robust.has_jpegs() || state.joined.is_none() || rng.random_bool(1.0 - JPEGS) {
        true => attack(state, rng),
        false => Attack::jpeg(robust, rng),
    }
}

/// What cameras, screens and files do to a picture without harm: a little
/// brightness and contrast, the noise of eight bits. Some have more noise, which a classifier that never saw
/// any takes for a mark.
pub(crate) struct Tone {
    gain: f32,
    shift: f32,
    noise: f32,
    seed: u64,
    grain: Option<Grain>,
}

impl Tone {
    /// `noisy`: how often there is more noise, 0 to 1.
    fn draw(noisy: f64, rng: &mut ChaCha8Rng) -> Self {
        Self {
            gain: rng.random_range(0.9..1.1),
            shift: rng.random_range(-0.05..0.05),
            noise: rng.random_range(0.0..1.5 / 255.0),
            seed: rng.random(),
            grain: rng.random_bool(noisy).then(|| Grain::draw(NOISY, ONE_HUE, rng)),
        }
    }

    pub(crate) fn is_noisy(&self) -> bool {
        self.grain.is_some()
    }

    /// The same on every picture of `side x side x 3` it is applied to, noise included: a marked
    /// render and its unmarked pair shall differ by the mark alone.
    pub(crate) fn apply(&self, picture: &mut [f32], side: usize) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        for v in picture.iter_mut() {
            *v = 0.5 + (*v - 0.5) * self.gain + self.shift + self.noise * rng.random_range(-1.0f32..1.0);
        }
        self.grain.iter().for_each(|grain| grain.apply(picture, side));
    }
}

/// `in_turn` identities from `first` on, round all of them, and so many `more`, rather of those that are `told` worst (nats, one an identity):
/// some scenes' marks are read with ease within a few hundred steps, and others' need all the renders that a training of their own would have.
fn owners(first: usize, in_turn: usize, more: usize, told: &[f32], rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut owners: Vec<usize> = (0..in_turn).map(|k| (first + k) % told.len()).collect();
    for _ in 0..more {
        let mut left = rng.random_range(0.0..told.iter().map(|nats| nats + MIN_TOLD).sum());
        let chosen = told.iter().position(|nats| {
            left -= nats + MIN_TOLD;
            left < 0.0
        });
        // Rounding may leave a little beyond the last.
        owners.push(chosen.unwrap_or(told.len() - 1));
    }
    owners
}

/// A view as the networks read it from a file, `side x side x 3`.
pub(crate) fn seen(
    field: &Field,
    view: &BankView,
    carrier: Option<&Carrier>,
    attack: &Attack,
    side: usize,
) -> Vec<f32> {
    let file = file(field, view, carrier, attack);
    Window::whole(file.size[0], file.size[1], side).apply(&file.rgb)
}

/// A view in its own light as it is in a file of 8 bits, with a mark or without, `attack` done to it.
pub(crate) fn file(field: &Field, view: &BankView, carrier: Option<&Carrier>, attack: &Attack) -> Attacked {
    let mut rgb = view.linear.base(&view.appearance);
    if let Some(carrier) = carrier {
        carrier.after(attack).show(field, view, &view.appearance, &mut rgb);
    }
    attack.apply(eight_bits(rgb), [view.linear.width(), view.linear.height()])
}

/// What remains of a render in an 8-bit file.
fn eight_bits(mut rgb: Vec<f32>) -> Vec<f32> {
    rgb.iter_mut().for_each(|v| *v = (v.clamp(0.0, 1.0) * 255.0).round() / 255.0);
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everybody_is_shown_in_turn_and_who_is_told_worst_more_often() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let told = [0.0, 0.02, 0.3, 0.0];
        let mut more = [0; 4];
        for step in 0..1000 {
            let owners = owners(3 * step % 4, 3, 2, &told, &mut rng);
            assert_eq!(owners[..3], [3 * step % 4, (3 * step + 1) % 4, (3 * step + 2) % 4]);
            assert_eq!(owners.len(), 5);
            owners[3..].iter().for_each(|owner| more[*owner] += 1);
        }
        // Of 2000: shares 1, 3, 31 and 1 of 36.
        assert!((1650..1800).contains(&more[2]) && (110..230).contains(&more[1]), "{more:?}");
        assert!(more[0] > 20 && more[3] > 20, "nobody is forgotten: {more:?}");
        let (mut one, mut other) = (ChaCha8Rng::seed_from_u64(3), ChaCha8Rng::seed_from_u64(3));
        assert_eq!(owners(2, 3, 0, &told, &mut one), [2, 3, 0]);
        assert_eq!(one.random::<u64>(), other.random::<u64>(), "one scene's trainings draw no number for this");
    }

    #[test]
    fn a_tone_does_the_same_to_a_render_and_to_its_twin_and_some_are_noisy() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut noisy = 0;
        for _ in 0..200 {
            let tone = Tone::draw(0.25, &mut rng);
            let [mut dark, mut light] = [0.3f32, 0.6].map(|level| vec![level; 16 * 16 * 3]);
            tone.apply(&mut dark, 16);
            tone.apply(&mut light, 16);
            let mut apart = light.iter().zip(&dark).map(|(l, d)| l - d);
            assert!(apart.all(|v| (v - 0.3 * tone.gain).abs() < 1e-5));
            let mean = dark.iter().sum::<f32>() / dark.len() as f32;
            let spread = (dark.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / dark.len() as f32).sqrt();
            // Eight bits' is 0.87 levels at most.
            let is_noise = if tone.is_noisy() { spread > 0.9 * NOISY[0] } else { spread < 0.9 * NOISY[0] };
            assert!(is_noise, "{spread}");
            noisy += usize::from(tone.is_noisy());
        }
        assert!((25..80).contains(&noisy), "{noisy} of 200");
        assert!((0..50).all(|_| !Tone::draw(0.0, &mut rng).is_noisy()));
    }
}
