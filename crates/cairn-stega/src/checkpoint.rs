//! Stage 2 interrupted and taken up again, to the same bytes. Ray weights are
//! worked out anew: they follow from the field and the plan.

use crate::carrier::Carrier;
use crate::config::MarkConfig;
use crate::error::MarkError;
use crate::judge::{Judgement, State};
use crate::marked::{read_header, stored};
use crate::trainer::{MarkPlan, MarkTrainer};
use cairn_field::Field;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::sync::Arc;

/// Format of a stage-2 checkpoint; another number is refused by name.
const CHECKPOINT_FORMAT: &str = "cairn.marked.checkpoint/1";

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    config: MarkConfig,
    seed: u64,
    step: u64,
    /// Bits of the running cross-entropy: infinity has no place in JSON.
    classify_bits: u64,
    joined: bool,
    converged: bool,
    carrier_steps: Vec<u64>,
    /// Step, and bits of accuracy and SSIM, of the best state.
    best: Option<(u64, u64, u64)>,
    /// SHA-256 of signals and cameras: another plan is refused.
    plan: String,
}

/// A digest of what a checkpoint must meet again.
fn fingerprint(plan: &MarkPlan) -> String {
    let mut hash = Sha256::new();
    for view in &plan.views {
        for number in view.camera.pose.rotation.to_cols_array().iter().chain(&view.camera.pose.position.to_array()) {
            hash.update(number.to_le_bytes());
        }
    }
    for picture in plan.signals.iter().chain(&plan.negatives) {
        hash.update((picture.width() as u64).to_le_bytes());
        hash.update(picture.to_rgb8());
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
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
            seed: self.seed,
            step: self.step,
            classify_bits: self.classify.to_bits(),
            joined: self.joined,
            converged: self.converged,
            carrier_steps: self.carriers.iter().map(|c| c.steps).collect(),
            best: best.map(|b| (b.judgement.step, b.judgement.accuracy.to_bits(), b.judgement.hidden_ssim.to_bits())),
            plan: fingerprint(&self.plan),
        };
        let mut parts: Vec<(String, Vec<u8>)> =
            vec![("networks".into(), self.networks.params.to_bytes()?), ("adam".into(), self.adam.to_bytes()?)];
        for (i, carrier) in self.carriers.iter().enumerate() {
            parts.push((format!("carrier{i}.values"), floats(&carrier.values)));
            parts.push((format!("carrier{i}.first"), floats(&carrier.first)));
            parts.push((format!("carrier{i}.second"), floats(&[carrier.second])));
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

    /// Takes stage 2 up where `bytes` left it, on the same field and plan.
    ///
    /// # Errors
    /// [`MarkError::Stored`] for an unknown format, a damaged file or another plan.
    pub fn resume(bytes: &[u8], field: Arc<Field>, plan: MarkPlan) -> Result<Self, MarkError> {
        let header: Header = read_header(bytes, "checkpoint")?;
        if header.format != CHECKPOINT_FORMAT {
            let why = format!("format `{}`, this program reads `{CHECKPOINT_FORMAT}`", header.format);
            return Err(stored("checkpoint", why));
        }
        if header.plan != fingerprint(&plan) {
            return Err(stored("checkpoint", "it was made with other views, signals or photographs".into()));
        }
        let bad = |e: safetensors::SafeTensorError| stored("checkpoint", e.to_string());
        let file = SafeTensors::deserialize(bytes).map_err(bad)?;
        let part = |name: &str| file.tensor(name).map(|t| t.data().to_vec()).map_err(bad);
        let mut trainer = Self::new(field, plan, header.config, header.seed)?;
        let read = |name: &str, len: usize| -> Result<Vec<f32>, MarkError> {
            let data = part(name)?;
            if data.len() != len * 4 {
                return Err(stored("checkpoint", format!("`{name}` is of another length")));
            }
            Ok(data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        };
        trainer.networks.params.load(&part("networks")?)?;
        trainer.adam.load(&trainer.networks.params, &part("adam")?)?;
        let mut carriers = Vec::new();
        for (i, old) in trainer.carriers.iter().enumerate() {
            let len = old.values.len();
            let mut carrier = Carrier::from_values(old.basis, read(&format!("carrier{i}.values"), len)?);
            carrier.first = read(&format!("carrier{i}.first"), len)?;
            carrier.second = read(&format!("carrier{i}.second"), 1)?[0];
            carrier.steps = header.carrier_steps.get(i).copied().unwrap_or_default();
            carriers.push(carrier);
        }
        if let Some((step, accuracy, ssim)) = header.best {
            let judgement = Judgement { step, accuracy: f64::from_bits(accuracy), hidden_ssim: f64::from_bits(ssim) };
            let values = carriers.iter().enumerate();
            let carriers =
                values.map(|(i, c)| read(&format!("best.carrier{i}"), c.values.len())).collect::<Result<_, _>>()?;
            trainer.best = Some(State { judgement, params: part("best.networks")?, carriers });
        }
        trainer.carriers = carriers;
        trainer.step = header.step;
        trainer.classify = f64::from_bits(header.classify_bits);
        trainer.joined = header.joined;
        trainer.converged = header.converged;
        Ok(trainer)
    }
}
