//! Stage 2 interrupted and taken up again, to the same bytes. Ray weights are
//! worked out anew: they follow from the field, the plan, and how many steps were taken.

use crate::error::MarkError;
use crate::marked::{read_format, read_header, stored};
use crate::stega::carrier::Carrier;
use crate::stega::growth::Restarted;
use crate::stega::judge::{Judgement, Recovered, State, Weakest};
use crate::stega::recipe::Recipe;
use crate::stega::site::MarkScene;
use crate::stega::trainer::{MarkPlan, MarkTrainer};
use cairn_field::Field;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::sync::Arc;

/// Format of a stage-2 checkpoint; another number is refused by name.
const CHECKPOINT_FORMAT: &str = "cairn.marked.checkpoint/7";

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    config: Recipe,
    seed: u64,
    step: u64,
    /// Bits of how far from read marks are, the running mean: infinity has no place in JSON.
    classify_bits: u64,
    joined: bool,
    /// After which step; none in checkpoints of before it was asked.
    #[serde(default)]
    joined_at: u64,
    enough: bool,
    converged: bool,
    carrier_steps: Vec<u64>,
    /// What each scene has to itself; none where they have the same, and in checkpoints of before they could have.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    of_scenes: Vec<Recipe>,
    /// Carriers that stay as they are; none in checkpoints of before there were any.
    #[serde(default)]
    settled: Vec<bool>,
    /// Heads that could not go on from an earlier training's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    restarted: Vec<Restarted>,
    /// Step, bits of accuracy and of accuracy under attack, and of what was recovered, of the best state.
    best: Option<(u64, [u64; 2], [Option<u64>; 3])>,
    /// The same of who does worst in it: class, bits of what is told, and of what was recovered; none in checkpoints of before
    /// it was asked.
    #[serde(default)]
    weakest: Option<(usize, u64, [Option<u64>; 3])>,
    /// [`fingerprint`] of the plan and the base field: others are refused.
    plan: String,
}

/// A digest of what a checkpoint must meet again: each scene's cameras, appearances, clusters,
/// signals, photographs and base field. Lengths go in as well, so that no two plans run
/// together into the same bytes.
pub(crate) fn fingerprint(scenes: &[MarkScene]) -> Result<String, MarkError> {
    let mut hash = Sha256::new();
    let mut part = |bytes: &[u8]| {
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    };
    for MarkScene { field, plan, .. } in scenes {
        let views: Vec<_> = plan.views.iter().map(|v| (&v.camera, &v.appearance)).collect();
        let json = serde_json::to_vec(&(views, &plan.clusters, plan.signals.len()));
        part(&json.map_err(|e| stored("checkpoint", format!("its plan: {e}")))?);
        for signal in &plan.signals {
            // One part each, empty where it is not there: none can be taken for another.
            let picture = signal.picture.as_ref();
            part(&picture.map(|p| (p.width() as u64).to_le_bytes().to_vec()).unwrap_or_default());
            part(&picture.map(|p| p.to_rgb8()).unwrap_or_default());
            part(&signal.audio.as_ref().map(|a| floats(a.samples())).unwrap_or_default());
            part(signal.text.as_deref().unwrap_or_default().as_bytes());
        }
        for picture in &plan.negatives {
            part(&(picture.width() as u64).to_le_bytes());
            part(picture.rgb());
        }
        part(&field.to_bytes()?);
    }
    Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

impl MarkTrainer {
    /// The whole state. Equal states give equal bytes.
    ///
    /// # Errors
    /// [`MarkError::Stored`] when it cannot be written out.
    pub fn checkpoint(&self) -> Result<Vec<u8>, MarkError> {
        let best = self.best.as_ref();
        let header = Header {
            format: CHECKPOINT_FORMAT.into(),
            config: self.config.clone(),
            of_scenes: match self.sites.iter().all(|site| site.config == self.config) {
                true => Vec::new(),
                false => self.sites.iter().map(|site| site.config.clone()).collect(),
            },
            seed: self.seed,
            step: self.step,
            classify_bits: self.unread.to_bits(),
            joined: self.joined.is_some(),
            joined_at: self.joined.unwrap_or(0),
            enough: self.enough,
            converged: self.converged,
            carrier_steps: self.carriers.iter().map(|c| c.steps).collect(),
            settled: self.settled.clone(),
            restarted: self.restarted.clone(),
            best: best.map(|b| {
                let Judgement { step, accuracy, attacked, recovered, .. } = b.judgement;
                (step, [accuracy, attacked].map(f64::to_bits), recovered.parts().map(|v| v.map(f64::to_bits)))
            }),
            weakest: best
                .and_then(|b| b.judgement.weakest)
                .map(|w| (w.identity, w.told.to_bits(), w.recovered.parts().map(|v| v.map(f64::to_bits)))),
            plan: self.fingerprint.clone(),
        };
        let mut parts: Vec<(String, Vec<u8>)> = vec![
            ("networks".into(), self.networks.params.to_bytes()?),
            ("adam".into(), self.adam.to_bytes()?),
            ("average".into(), self.average.to_bytes()?),
        ];
        for (i, carrier) in self.carriers.iter().enumerate() {
            parts.push((format!("carrier{i}.values"), floats(&carrier.values)));
            parts.push((format!("carrier{i}.first"), floats(&carrier.first)));
            parts.push((format!("carrier{i}.second"), floats(&[carrier.second])));
        }
        for (i, site) in self.sites.iter().enumerate() {
            parts.push((format!("draws{i}"), floats(site.bank.draws.losses())));
        }
        if let Some(best) = best {
            parts.push(("best.networks".into(), best.params.clone()));
            for (i, values) in best.carriers.iter().enumerate() {
                parts.push((format!("best.carrier{i}"), floats(values)));
            }
        }
        let bad = |e: safetensors::SafeTensorError| stored("checkpoint", e.to_string());
        let mut tensors = Vec::new();
        for (name, bytes) in &parts {
            tensors.push((name.as_str(), TensorView::new(Dtype::U8, vec![bytes.len()], bytes).map_err(bad)?));
        }
        let json = serde_json::to_string(&header).map_err(|e| stored("checkpoint", e.to_string()))?;
        safetensors::serialize(tensors, Some(HashMap::from([("cairn".to_owned(), json)]))).map_err(bad)
    }

    /// Takes stage 2 of one scene up where `bytes` left it, on the same field and plan. Ray
    /// weights are worked out anew, with `progress` as in [`MarkTrainer::new`].
    ///
    /// # Errors
    /// [`MarkError::Stored`] for an unknown format, a damaged file, another plan or
    /// field; [`MarkError::Stopped`].
    pub fn resume(
        bytes: &[u8],
        field: Arc<Field>,
        plan: MarkPlan,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        Self::resume_joint(bytes, vec![MarkScene::new(field, plan)], progress)
    }

    /// As [`MarkTrainer::resume`], of several scenes in the order they were begun in.
    ///
    /// # Errors
    /// As [`MarkTrainer::resume`].
    pub fn resume_joint(
        bytes: &[u8],
        mut scenes: Vec<MarkScene>,
        progress: &mut dyn FnMut(usize, usize) -> bool,
    ) -> Result<Self, MarkError> {
        let format = read_format(bytes, "checkpoint")?;
        if format != CHECKPOINT_FORMAT {
            let why = format!("format `{format}`, this program reads `{CHECKPOINT_FORMAT}`; start the training anew");
            return Err(stored("checkpoint", why));
        }
        let header: Header = read_header(bytes, "checkpoint")?;
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
        let (config, at) = (header.config.clone(), (header.seed, header.step));
        let mut trainer = Self::prepared((scenes, fingerprint), config, at, progress)?;
        trainer.restore(&header, &file)?;
        Ok(trainer)
    }

    /// Takes over a checkpoint's state, every number of it checked.
    fn restore(&mut self, header: &Header, file: &SafeTensors<'_>) -> Result<(), MarkError> {
        let damaged = |why: String| Err(stored("checkpoint", why));
        let (steps, expected) = (header.carrier_steps.len(), self.carriers.len());
        if steps != expected {
            return damaged(format!("`carrier_steps` has {steps} entries for {expected} carriers"));
        }
        if ![0, expected].contains(&header.settled.len()) {
            return damaged(format!("`settled` has {} entries for {expected} carriers", header.settled.len()));
        }
        let unread = f64::from_bits(header.classify_bits);
        // Infinite until the first step.
        if unread.is_nan() || (header.step > 0 && !unread.is_finite()) {
            return damaged(format!("`classify_bits` says {unread}"));
        }
        self.adam.load(&self.networks.params, &part(file, "adam")?)?;
        self.average.load(&part(file, "average")?)?;
        for (i, (carrier, steps)) in self.carriers.iter_mut().zip(&header.carrier_steps).enumerate() {
            let len = carrier.values.len();
            *carrier = Carrier::from_values(carrier.shape, numbers(file, &format!("carrier{i}.values"), len)?);
            carrier.first = numbers(file, &format!("carrier{i}.first"), len)?;
            carrier.second = numbers(file, &format!("carrier{i}.second"), 1)?[0];
            carrier.steps = *steps;
        }
        for (i, site) in self.sites.iter_mut().enumerate() {
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
            let known = |w: &Weakest| (1..=self.signals.len()).contains(&w.identity);
            let sane = |w: &Weakest| w.told.is_finite() && !w.recovered.parts().iter().flatten().any(|v| v.is_nan());
            if weakest.is_some_and(|w| !known(&w) || !sane(&w)) {
                return damaged(format!("`weakest` says {weakest:?} of {} identities", self.signals.len()));
            }
            let values = self.carriers.iter().enumerate();
            let carriers = values
                .map(|(i, c)| numbers(file, &format!("best.carrier{i}"), c.values.len()))
                .collect::<Result<_, _>>()?;
            let params = part(file, "best.networks")?;
            // Loaded now to be checked, not at the end of training.
            self.networks.params.load(&params)?;
            self.best = Some(State { judgement, params, carriers });
        }
        if header.joined_at > header.step {
            return damaged(format!("`joined_at` is {}, after {} steps", header.joined_at, header.step));
        }
        self.networks.params.load(&part(file, "networks")?)?;
        if !header.settled.is_empty() {
            self.settled.clone_from(&header.settled);
        }
        self.step = header.step;
        self.unread = unread;
        self.restarted.clone_from(&header.restarted);
        self.joined = header.joined.then_some(header.joined_at);
        (self.enough, self.converged) = (header.enough, header.converged);
        Ok(())
    }
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
