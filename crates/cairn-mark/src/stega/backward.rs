//! How a step's gradient moves the carriers, and how the budget holds them.
//!
//! A step is taken whole or not at all: what every carrier is owed is worked out
//! and checked before the first of them, or a network, moves.

use crate::error::MarkError;
use crate::stega::carrier::Move;
use crate::stega::recipe::LossKind;
use crate::stega::sample::Render;
use crate::stega::site::Site;
use crate::stega::state::State;
use crate::tensors::interleaved;
use candle_core::Tensor;

/// As much as a step makes a mark stronger, at most: a view that hardly shows it says little of the others.
const MAX_STRONGER: f64 = 1.1;

/// A checked step that may be taken.
pub(crate) struct Owed {
    /// A carrier's next mean square and its scale, where this step moves it.
    carriers: Vec<Option<(f32, f32)>>,
    /// Equation 4, summed over the step's renders or their mean (`mark.loss_per_render`), as much of it as counts.
    pub(crate) picture: f64,
    /// PSNR of theta's renders against theta_0's, dB.
    pub(crate) kept_db: f64,
}

/// Equation 4 of one render: the mean of how far each number strays, `change`, from the base field's.
fn strayed(kind: LossKind, change: &[f32]) -> f64 {
    let each = |v: &f32| match kind {
        LossKind::Absolute => f64::from(*v).abs(),
        LossKind::Squared => f64::from(*v).powi(2),
    };
    change.iter().map(each).sum::<f64>() / change.len() as f64
}

/// Turns `slope`, d(loss)/d(what the networks saw) of a render, into d(loss)/d(render), and adds `weight` times
/// [`strayed`]'s. The networks' part passes where the render is inside [0, 1], times the tone's gain; the picture's passes
/// everywhere, so that what strays beyond comes back.
fn keep(slope: &mut [f32], inside: &[bool], gain: f32, change: &[f32], kind: LossKind, weight: f32) {
    let weight = weight / change.len() as f32;
    for ((s, change), inside) in slope.iter_mut().zip(change).zip(inside) {
        let own = match kind {
            LossKind::Absolute => change.signum() * f32::from(*change != 0.0),
            LossKind::Squared => 2.0 * change,
        };
        *s = if *inside { *s * gain } else { 0.0 } + weight * own;
    }
}

/// How much of the picture loss counts now, 0 to 1: as much as marks are read with ease; all of it without
/// a budget, since nothing else would hold them then.
fn fading(state: &State) -> f32 {
    if state.config.budget { state.ease() } else { 1.0 }
}

/// Pushes the pictures' gradients into the carriers and checks that all of them
/// can be moved.
///
/// # Errors
/// [`MarkError::NotFinite`]; the carriers are then still owed and the caller
/// forgets it.
pub(crate) fn backward(state: &mut State, renders: &[Render], slopes: &Tensor) -> Result<Owed, MarkError> {
    // Of each carrier that was seen, how far it strays where its own identity's renders show it.
    let mut worst = vec![None::<f64>; state.carriers.len()];
    let (mut mean, mut picture) = (0.0, 0.0);
    let fading = fading(state);
    let over = if state.config.loss_per_render { renders.len() as f32 } else { 1.0 };
    for (i, m) in renders.iter().enumerate() {
        let small = interleaved(&slopes.get(i)?.flatten_all()?.to_vec1::<f32>()?);
        let mut slope = m.attacked.back(m.window.transpose(&small));
        let (kind, weight) = (state.config.picture_loss, fading * state.config.weight_picture as f32 / over);
        keep(&mut slope, &m.inside, m.gain, &m.change, kind, weight);
        picture += f64::from(fading) * strayed(kind, &m.change) / f64::from(over);
        // A mark of an earlier training stays as it is.
        if !state.settled[m.carrier] {
            let site = &state.sites[m.site];
            state.carriers[m.carrier].owe(&site.scene.field, site.bank.view(m.view), &slope, &m.appearance);
        }
        let square = m.change.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / m.change.len() as f64;
        finite(state, square, "a marked render")?;
        if !state.settled[m.carrier] {
            let own = if m.stranger { 0.0 } else { square };
            worst[m.carrier] = Some(worst[m.carrier].unwrap_or(0.0).max(own));
        }
        mean += square / renders.len() as f64;
    }
    let mut carriers = Vec::with_capacity(worst.len());
    for site in &state.sites {
        for (carrier, worst) in state.carriers[site.carriers.clone()].iter().zip(&worst[site.carriers.clone()]) {
            carriers.push(match worst {
                Some(worst) => Some((carrier.check(state.step)?, scale(state, site, *worst)?)),
                None => None,
            });
        }
    }
    Ok(Owed { carriers, picture, kept_db: -10.0 * mean.max(1e-20).log10() })
}

/// The factor that brings a carrier of `site` to its budget, neither above nor below it, whose renders of this step
/// strayed `worst` (mean square) from the base field's; 1 where there is no budget, or nothing to go by. Marks that were
/// read with ease could once fade below it: views that no step saw were the first to be lost.
fn scale(state: &State, site: &Site, worst: f64) -> Result<f32, MarkError> {
    let allowed = 10f64.powf(-site.budget_db(state.tightened()) / 10.0);
    if !state.config.budget || worst == 0.0 {
        return Ok(1.0);
    }
    let factor = (allowed / worst).sqrt().min(MAX_STRONGER) as f32;
    finite(state, f64::from(factor), "a carrier's scale")?;
    Ok(factor)
}

fn finite(state: &State, value: f64, place: &str) -> Result<(), MarkError> {
    match value.is_finite() {
        true => Ok(()),
        false => Err(MarkError::NotFinite { step: Some(state.step), place: place.into() }),
    }
}

/// Moves the carriers by what they are owed, and scales back (or up) those that
/// the budget holds.
pub(crate) fn apply(state: &mut State, owed: &Owed) {
    let decay = state.config.final_rate.powf(state.step as f64 / state.config.steps as f64) as f32;
    // What a budget holds need not be pulled: what few views show would be pulled least, and grow beside the rest.
    let pull = if state.config.budget { 0.0 } else { state.config.pull as f32 };
    let rate = state.config.learning_rate_carrier as f32 * decay;
    for site in &state.sites {
        let (how, own) = (Move { mask: &site.mask, rate, pull }, site.carriers.clone());
        for (carrier, owed) in state.carriers[own.clone()].iter_mut().zip(&owed.carriers[own]) {
            if let Some((second, factor)) = owed {
                carrier.apply(*second, &how);
                // Times one changes nothing, but goes through all of a large carrier.
                if *factor != 1.0 {
                    carrier.scale(*factor);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHANGE: [f32; 4] = [0.5, -0.25, 0.0, 2.0];

    #[test]
    fn the_picture_loss_is_the_mean_error_of_a_render() {
        // (0.5 + 0.25 + 0 + 2) / 4 and (0.25 + 0.0625 + 0 + 4) / 4.
        assert_eq!(strayed(LossKind::Absolute, &CHANGE), 0.6875);
        assert_eq!(strayed(LossKind::Squared, &CHANGE), 1.078_125);
    }

    #[test]
    fn the_picture_loss_pulls_by_the_sign_or_by_twice_the_change() {
        // Weight 8 over 4 numbers: 2 each. The networks' slopes count twice (gain), and not for the last, which is outside.
        let slope = |kind| {
            let mut slope = [1.0f32, 1.0, -3.0, 5.0];
            keep(&mut slope, &[true, true, true, false], 2.0, &CHANGE, kind, 8.0);
            slope
        };
        // 2 + 2 x 1, 2 + 2 x -1, -6 + 2 x 0, 0 + 2 x 1.
        assert_eq!(slope(LossKind::Absolute), [4.0, 0.0, -6.0, 2.0]);
        // 2 + 2 x 1, 2 + 2 x -0.5, -6 + 2 x 0, 0 + 2 x 4.
        assert_eq!(slope(LossKind::Squared), [4.0, 1.0, -6.0, 8.0]);
    }

    #[test]
    fn the_picture_loss_is_what_its_slope_is_of() {
        // A step of 1e-3 along the slope changes the loss by the slope's squares times 1e-3, to first order.
        for kind in [LossKind::Absolute, LossKind::Squared] {
            let mut slope = [0.0f32; 4];
            keep(&mut slope, &[true; 4], 1.0, &CHANGE, kind, 1.0);
            let moved: Vec<f32> = CHANGE.iter().zip(slope).map(|(v, s)| v + 1e-3 * s).collect();
            let expected = slope.iter().map(|s| f64::from(*s).powi(2)).sum::<f64>() * 1e-3;
            let got = strayed(kind, &moved) - strayed(kind, &CHANGE);
            assert!((got / expected - 1.0).abs() < 2e-3, "{kind:?}: {got} for {expected}");
        }
    }
}
