//! Stage 2 interrupted and taken up again, to the same bytes. Ray weights are
//! worked out anew: they follow from the field, the plan, and how many steps were taken.

use crate::error::MarkError;
use crate::marked::stored;
use crate::stega::carrier::Carrier;
use crate::stega::growth::Restarted;
use crate::stega::judgement::{Best, Judgement, Recovered, Weakest};
use crate::stega::plan::{MarkScene, fingerprint};
use crate::stega::recipe::Recipe;
use crate::stega::state::State;
use crate::tensors::f32_bytes;
use cairn_field::{Part, packed, read_header};
use safetensors::tensor::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

/// Format of a stage-2 checkpoint; another version is refused by name.
const CHECKPOINT_FORMAT: &str = "cairn.marked.checkpoint/8";

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    config: Recipe,
    seed: u64,
    step: u64,
    /// Bits of how far from read marks are, the running mean: infinity has no place in JSON.
    classify_bits: u64,
    joined: bool,
    /// After which step; 0 where it has not.
    joined_at: u64,
    enough: bool,
    converged: bool,
    carrier_steps: Vec<u64>,
    /// What each scene has to itself; none where they have the same.
    of_scenes: Vec<Recipe>,
    /// Which carriers stay as they are.
    settled: Vec<bool>,
    /// Heads that could not go on from an earlier training's.
    restarted: Vec<Restarted>,
    /// Step, bits of accuracy and of accuracy under attack, and of what was recovered, of the best state.
    best: Option<(u64, [u64; 2], [Option<u64>; 3])>,
    /// The same of the identity that does worst in it: class, bits of its share of right answers, and of what was recovered.
    weakest: Option<(usize, u64, [Option<u64>; 3])>,
    /// [`fingerprint`] of the plan and the base field: others are refused.
    plan: String,
}

/// The whole state. Equal states give equal bytes.
///
/// # Errors
/// [`MarkError::Stored`] when it cannot be written out.
pub(crate) fn write(state: &State) -> Result<Vec<u8>, MarkError> {
    let best = state.best.as_ref();
    let header = Header {
        format: CHECKPOINT_FORMAT.into(),
        config: state.config.clone(),
        of_scenes: match state.sites.iter().all(|site| site.config == state.config) {
            true => Vec::new(),
            false => state.sites.iter().map(|site| site.config.clone()).collect(),
        },
        seed: state.seed,
        step: state.step,
        classify_bits: state.unread.to_bits(),
        joined: state.joined.is_some(),
        joined_at: state.joined.unwrap_or(0),
        enough: state.enough,
        converged: state.converged,
        carrier_steps: state.carriers.iter().map(|c| c.steps).collect(),
        settled: state.settled.clone(),
        restarted: state.restarted.clone(),
        best: best.map(|b| {
            let Judgement { step, accuracy, attacked, recovered, .. } = b.judgement;
            (step, [accuracy, attacked].map(f64::to_bits), recovered.parts().map(|v| v.map(f64::to_bits)))
        }),
        weakest: best
            .and_then(|b| b.judgement.weakest)
            .map(|w| (w.identity, w.told.to_bits(), w.recovered.parts().map(|v| v.map(f64::to_bits)))),
        plan: state.fingerprint.clone(),
    };
    let mut parts: Vec<(String, Vec<u8>)> = vec![
        ("networks".into(), state.networks.params.to_bytes()?),
        ("adam".into(), state.adam.to_bytes()?),
        ("average".into(), state.average.to_bytes()?),
    ];
    for (i, carrier) in state.carriers.iter().enumerate() {
        parts.push((format!("carrier{i}.values"), f32_bytes(&carrier.values)));
        parts.push((format!("carrier{i}.first"), f32_bytes(&carrier.first)));
        parts.push((format!("carrier{i}.second"), f32_bytes(&[carrier.second])));
    }
    for (i, site) in state.sites.iter().enumerate() {
        parts.push((format!("draws{i}"), f32_bytes(site.bank.draws.losses())));
    }
    if let Some(best) = best {
        parts.push(("best.networks".into(), best.params.clone()));
        for (i, values) in best.carriers.iter().enumerate() {
            parts.push((format!("best.carrier{i}"), f32_bytes(values)));
        }
    }
    Ok(packed("checkpoint", &header, parts.iter().map(|(name, bytes)| Part::row(name, Dtype::U8, bytes)))?)
}

/// What `bytes` hold of a training of `scenes`, in the order they were begun in. Ray weights are worked out anew.
///
/// # Errors
/// [`MarkError::Stored`] for an unknown format, a damaged file, another plan or field; [`MarkError::Stopped`].
pub(crate) fn read(
    bytes: &[u8],
    mut scenes: Vec<MarkScene>,
    progress: &mut dyn FnMut(usize, usize) -> bool,
) -> Result<State, MarkError> {
    let header: Header = read_header(bytes, "checkpoint", CHECKPOINT_FORMAT)?;
    let fingerprint = fingerprint(&scenes)?;
    if header.plan != fingerprint {
        let why = "it was made with another base field, or other views, clusters, signals or photographs";
        return Err(stored("checkpoint", why.into()));
    }
    if header.step > header.config.steps {
        return Err(stored("checkpoint", format!("step {} of {}", header.step, header.config.steps)));
    }
    let (own, expected) = (header.of_scenes.len(), scenes.len());
    if ![0, expected].contains(&own) {
        return Err(stored("checkpoint", format!("`of_scenes` has {own} entries for {expected} scenes")));
    }
    // As it was begun, whatever they would be by now.
    let mut own = header.of_scenes.iter().cloned();
    scenes.iter_mut().for_each(|scene| scene.settings = own.next());
    let file = SafeTensors::deserialize(bytes).map_err(|e| stored("checkpoint", e.to_string()))?;
    let config = header.config.clone();
    let mut state = State::new(scenes, fingerprint, config, header.seed, header.step, progress)?;
    restore(&mut state, &header, &file)?;
    Ok(state)
}

/// Takes over a checkpoint's state, every number of it checked.
fn restore(state: &mut State, header: &Header, file: &SafeTensors<'_>) -> Result<(), MarkError> {
    let damaged = |why: String| Err(stored("checkpoint", why));
    let (steps, expected) = (header.carrier_steps.len(), state.carriers.len());
    if steps != expected {
        return damaged(format!("`carrier_steps` has {steps} entries for {expected} carriers"));
    }
    if header.settled.len() != expected {
        return damaged(format!("`settled` has {} entries for {expected} carriers", header.settled.len()));
    }
    let unread = f64::from_bits(header.classify_bits);
    // Infinite until the first step.
    if unread.is_nan() || (header.step > 0 && !unread.is_finite()) {
        return damaged(format!("`classify_bits` says {unread}"));
    }
    state.adam.load(&state.networks.params, &part(file, "adam")?)?;
    state.average.load(&part(file, "average")?)?;
    for (i, (carrier, steps)) in state.carriers.iter_mut().zip(&header.carrier_steps).enumerate() {
        let len = carrier.values.len();
        *carrier = Carrier::from_values(carrier.shape, numbers(file, &format!("carrier{i}.values"), len)?);
        carrier.first = numbers(file, &format!("carrier{i}.first"), len)?;
        carrier.second = numbers(file, &format!("carrier{i}.second"), 1)?[0];
        carrier.steps = *steps;
    }
    for (i, site) in state.sites.iter_mut().enumerate() {
        let draws = &mut site.bank.draws;
        draws.restore(numbers(file, &format!("draws{i}"), draws.losses().len())?);
    }
    if let Some((step, right, parts)) = header.best {
        let recovered = Recovered::from_parts(parts.map(|v| v.map(f64::from_bits)));
        let [accuracy, attacked] = right.map(f64::from_bits);
        let weakest = header.weakest.map(|(identity, told, parts)| Weakest {
            identity,
            told: f64::from_bits(told),
            recovered: Recovered::from_parts(parts.map(|v| v.map(f64::from_bits))),
        });
        let judgement = Judgement { step, accuracy, attacked, recovered, weakest };
        // Perfect and hopeless sounds have an infinite SNR.
        let right = accuracy.is_finite() && attacked.is_finite();
        if !right || recovered.parts().iter().flatten().any(|v| v.is_nan()) {
            return damaged(format!("`best` says {judgement:?}"));
        }
        let known = |w: &Weakest| (1..=state.signals.len()).contains(&w.identity);
        let sane = |w: &Weakest| w.told.is_finite() && !w.recovered.parts().iter().flatten().any(|v| v.is_nan());
        if weakest.is_some_and(|w| !known(&w) || !sane(&w)) {
            return damaged(format!("`weakest` says {weakest:?} of {} identities", state.signals.len()));
        }
        let values = state.carriers.iter().enumerate();
        let carriers = values
            .map(|(i, c)| numbers(file, &format!("best.carrier{i}"), c.values.len()))
            .collect::<Result<_, _>>()?;
        let params = part(file, "best.networks")?;
        // Loaded now to be checked, not at the end of training.
        state.networks.params.load(&params)?;
        state.best = Some(Best { judgement, params, carriers });
    }
    if header.joined_at > header.step {
        return damaged(format!("`joined_at` is {}, after {} steps", header.joined_at, header.step));
    }
    state.networks.params.load(&part(file, "networks")?)?;
    state.settled.clone_from(&header.settled);
    state.step = header.step;
    state.unread = unread;
    state.restarted.clone_from(&header.restarted);
    state.joined = header.joined.then_some(header.joined_at);
    (state.enough, state.converged) = (header.enough, header.converged);
    Ok(())
}

fn part(file: &SafeTensors<'_>, name: &str) -> Result<Vec<u8>, MarkError> {
    let tensor = file.tensor(name).map_err(|e| stored("checkpoint", format!("`{name}`: {e}")))?;
    Ok(tensor.data().to_vec())
}

/// The `len` numbers of part `name`, all finite.
fn numbers(file: &SafeTensors<'_>, name: &str, len: usize) -> Result<Vec<f32>, MarkError> {
    let data = part(file, name)?;
    if data.len() != len * 4 {
        let why = format!("`{name}` has {} bytes, {len} numbers take {}", data.len(), len * 4);
        return Err(stored("checkpoint", why));
    }
    let values: Vec<f32> = data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(stored("checkpoint", format!("`{name}` is not finite at number {at}"))),
        None => Ok(values),
    }
}
