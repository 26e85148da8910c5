//! Stage 2 as the engine drives it: the plan from a scene, judging at fixed
//! steps, and what comes out.

use std::sync::Arc;

use cairn_field::{Field, NamedView};
use cairn_mark::{
    Detector, Earlier, Judgement, Known, MarkError, MarkPlan, MarkScene, MarkTrainer, MarkedField, PlannedView, Recipe,
    Recovered, Signal, at_most,
};
use cairn_scene::SceneFolder;
use cairn_scene::cluster::Clusters;
use cairn_scene::metrics::psnr_db_from_mse;

use crate::error::EngineError;
use crate::store::given::QUIET_DB;
use crate::train::stages::{self, Photographs, Preparing, Stage, Step};

/// Steps between judgements of a state on poses it was not trained on; fixed, so
/// that every run of a job judges at the same steps.
pub const JUDGE_EVERY: u64 = 50;

/// Photographs of a scene that tell how well its field explains them.
const EXPLAINED_BY: usize = 12;
/// Longest side at which they do, pixels.
const EXPLAINED_PX: usize = 640;

/// Shares (and SSIM) of what comes back below which people are told so.
const WEAK: f64 = 0.9;
/// The same of sounds, SNR in dB.
const WEAK_SNR_DB: f64 = 15.0;
/// Below this share of those an identity is lost, whatever comes back of others.
const LOST: f64 = 0.5;

/// Trains the marked fields and the detector, and keeps the best state judged.
pub struct Marking {
    trainer: MarkTrainer,
    /// What each identity is called, the first scene's first.
    whose: Vec<String>,
    /// The quietest hidden sound: the place of its identity in `whose`, and its level, RMS in dB of full scale.
    quietest: Option<(usize, f64)>,
    /// What to say of each scene's budget.
    notes: Vec<String>,
}

/// A scene to mark.
pub struct ToMark<'a> {
    /// What it is called.
    pub name: &'a str,
    /// The scene with the views to train on.
    pub scene: &'a SceneFolder,
    /// Their photographs; stage 2 lets them go.
    pub photographs: &'a Photographs,
    /// theta_0.
    pub base: Field,
    /// Over the scene's training views.
    pub clusters: &'a Clusters,
    /// What each identity hides.
    pub signals: Vec<Signal>,
    /// What marks are made by in it. Several scenes share networks, steps and losses.
    pub settings: &'a Recipe,
}

/// What is gone on from. Identities are counted through all scenes.
pub struct Grown {
    /// What reads the earlier marks.
    pub detector: Detector,
    /// The earlier marked fields.
    pub fields: Vec<MarkedField>,
    /// Of each identity where it was: which field, its number there, its class; `None` for a new one.
    pub known: Vec<Option<(usize, u32, usize)>>,
    /// What each known identity hides.
    pub signals: Vec<Option<Signal>>,
}

impl Grown {
    fn earlier(&self) -> Earlier<'_> {
        let known = |(field, number, class): (usize, u32, usize)| {
            // None where marks have no carrier each: the trainer says so.
            let carrier = self.fields[field].carrier(number).unwrap_or_default();
            Known { class, carrier }
        };
        Earlier { detector: &self.detector, identities: self.known.iter().map(|k| k.map(known)).collect() }
    }
}

/// What comes of stage 2, as bytes of files.
#[derive(PartialEq, Eq)]
pub struct Marked {
    /// The marked fields, a scene each.
    pub fields: Vec<Vec<u8>>,
    /// The detector of them all.
    pub detector: Vec<u8>,
}

impl Marking {
    /// Stage 2 for the scenes' training views, new, from earlier models or from a checkpoint. Works
    /// out every view's ray weights first; `None` when `preparing` did not want to
    /// go on.
    ///
    /// # Errors
    /// For photographs that were altered, settings out of range, a cluster without
    /// views, a checkpoint of another plan, earlier models that do not fit.
    pub fn start(
        scenes: Vec<ToMark<'_>>,
        grown: Option<&Grown>,
        settings: &Recipe,
        seed: u64,
        checkpoint: Option<&[u8]>,
        preparing: Preparing<'_>,
    ) -> Result<Option<Self>, EngineError> {
        let (mut planned, mut whose) = (Vec::with_capacity(scenes.len()), Vec::new());
        let mut levels: Vec<(usize, f64)> = Vec::new();
        let several = scenes.len() > 1;
        let mut asked = Vec::with_capacity(scenes.len());
        for ToMark { name, scene, photographs: kept, base, clusters, signals, settings: own } in scenes {
            let of_scene = if several { format!(" of scene {name:?}") } else { String::new() };
            let sounds = (whose.len()..).zip(&signals).filter_map(|(at, s)| Some((at, s.audio.as_ref()?.rms_db())));
            levels.extend(sounds);
            whose.extend((1..=signals.len()).map(|number| format!("identity {number}{of_scene}")));
            let capture = scene.capture();
            // Photographs carry no mark: the detector has to stay silent on them.
            let Some(photographs) = kept.views(scene, preparing)? else { return Ok(None) };
            kept.forget();
            // What was begun goes on with the budget that it has.
            let explained_db = checkpoint.is_none().then(|| explained(&base, &photographs));
            asked.push((of_scene, own, explained_db));
            let views = scene.training().map(|index| {
                let view = &capture.views[index];
                PlannedView { camera: view.camera, appearance: base.appearance_of(&view.name).clone() }
            });
            let negatives = photographs.into_iter().map(|view| Arc::unwrap_or_clone(view.view).rgb8).collect();
            let plan = MarkPlan { clusters: clusters.clone(), views: views.collect(), signals, negatives };
            let affordable = explained_db.map(|db| own.affording(db));
            planned.push(MarkScene { field: Arc::new(base), plan, settings: affordable });
        }
        // One scene's settings are the training's.
        let own = if several { None } else { planned.first_mut().and_then(|scene| scene.settings.take()) };
        let affordable = own.unwrap_or_else(|| settings.clone());
        let progress = &mut |done, total| preparing(stages::RAY_WEIGHTS, done, total);
        let made = match (checkpoint, grown) {
            (Some(bytes), _) => MarkTrainer::resume_joint(bytes, planned, progress),
            (None, Some(grown)) => MarkTrainer::growing(planned, &grown.earlier(), affordable, seed, progress),
            (None, None) => MarkTrainer::joint(planned, affordable, seed, progress),
        };
        match made {
            Ok(trainer) => {
                let quietest = levels.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
                let notes = asked.into_iter().enumerate().filter_map(|(at, (of_scene, own, explained_db))| {
                    budget_note(trainer.config_of(at), own, &of_scene, explained_db)
                });
                Ok(Some(Self { notes: notes.collect(), whose, quietest, trainer }))
            }
            Err(MarkError::Stopped) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// What comes of it, at the best state judged; `None` when `preparing` did
    /// not want to go on.
    ///
    /// # Errors
    /// When marks were never read, and when the parts cannot be written out.
    pub fn finish(self, preparing: Preparing<'_>) -> Result<Option<Marked>, EngineError> {
        if let Some(best) = self.trainer.best() {
            let (step, accuracy, recovered) = (best.step, best.accuracy, best.recovered);
            tracing::info!(step, accuracy, ?recovered, "best state on virtual poses");
        }
        let progress = &mut |done, total| preparing(stages::MARKED_RENDERS, done, total);
        let (fields, detector) = match self.trainer.finish_joint(progress) {
            Err(MarkError::Stopped) => return Ok(None),
            finished => finished?,
        };
        let fields = fields.iter().map(MarkedField::to_bytes).collect::<Result<_, _>>()?;
        Ok(Some(Marked { fields, detector: detector.to_bytes()? }))
    }
}

impl Stage for Marking {
    fn step(&mut self) -> Result<Step, EngineError> {
        let stats = self.trainer.step()?;
        if stats.step.is_multiple_of(JUDGE_EVERY) || stats.step == stats.total {
            self.trainer.judge()?;
        }
        Ok(Step { loss: stats.loss, psnr_db: stats.kept_db })
    }

    fn steps(&self) -> (u64, u64) {
        (self.trainer.steps_done(), self.trainer.steps_total())
    }

    fn checkpoint(&self) -> Result<Vec<u8>, EngineError> {
        Ok(self.trainer.checkpoint()?)
    }

    fn notes(&self) -> Vec<String> {
        let is_done = self.trainer.steps_done() >= self.trainer.steps_total();
        let weak = self.trainer.best().filter(|_| is_done).and_then(|kept| weak_note(kept, &self.whose, self.quietest));
        let restarted = self.trainer.restarted().iter().map(ToString::to_string);
        self.notes.iter().cloned().chain(restarted).chain(weak).collect()
    }
}

/// What to say where marks or signals do not come back well from the virtual poses of the state that is kept, of all
/// identities or of the one that does worst; `whose` are their names, class 1 first. What is lost of a sound that was quiet
/// from the first no step brings back: of the quietest its place in `whose` and its level are said.
fn weak_note(kept: &Judgement, whose: &[String], quietest: Option<(usize, f64)>) -> Option<String> {
    let called = |at: usize| whose.get(at).map_or("one identity", String::as_str);
    let mut weak = weak_figures(kept.accuracy, &kept.recovered, 1.0);
    if let Some(worst) = kept.weakest {
        let lost = weak_figures(worst.told, &worst.recovered, LOST);
        let name = called(worst.identity.wrapping_sub(1));
        weak.extend((!lost.is_empty()).then(|| format!("worst of all, {name}: {}", lost.join(", "))));
    }
    let (is_heard, quiet) =
        (weak.iter().any(|figure| figure.contains("SNR")), quietest.filter(|(_, db)| *db < QUIET_DB));
    let level = quietest.filter(|_| is_heard).map_or(String::new(), |(at, db)| {
        let louder = quiet.map_or("", |_| ", too quiet to come back well: bring it louder");
        format!(". The quietest hidden sound, that of {}, is at {db:.0} dB of full scale (RMS){louder}", called(at))
    });
    (!weak.is_empty()).then(|| {
        format!(
            "train with a higher quality (--quality), with stronger marks (--robust) or with fewer identities. Seen from \
             between the photographs, the marks do not come back well enough ({}){level}",
            weak.join("; ")
        )
    })
}

/// Each figure that is below `share` of what is enough, as people are told it.
fn weak_figures(right: f64, recovered: &Recovered, share: f64) -> Vec<String> {
    let Recovered { picture_ssim, audio_snr_db, text_characters } = *recovered;
    let (weak, weak_snr_db) = (share * WEAK, share * WEAK_SNR_DB);
    let percent = |what: &str, of: f64| (of < weak).then(|| format!("{what} {:.1} %", 100.0 * of));
    let figures = [
        percent("answers right:", right),
        picture_ssim.filter(|ssim| *ssim < weak).map(|ssim| format!("hidden pictures' SSIM: {ssim:.2}")),
        audio_snr_db.filter(|snr| *snr < weak_snr_db).map(|snr| format!("hidden sounds' SNR: {snr:.1} dB")),
        text_characters.and_then(|characters| percent("hidden texts' characters:", characters)),
    ];
    figures.into_iter().flatten().collect()
}

/// What to say where marks `of_scene` are `kept` fainter than was `asked` for; a resumed training does not
/// know any more how well its photographs are explained.
fn budget_note(kept: &Recipe, asked: &Recipe, of_scene: &str, explained_db: Option<f64>) -> Option<String> {
    let why = explained_db.map_or(String::new(), |db| format!("it explains photographs to {db:.1} dB, and "));
    (kept.budget_db > asked.budget_db).then(|| {
        format!(
            "marks{of_scene} are kept {:.1} dB below the base field's renders instead of {:.1}: {why}they are to cost photographs at most \
             {} dB (mark.max_cost_db)",
            kept.budget_db, asked.budget_db, kept.max_cost_db
        )
    })
}

/// How well a field explains the photographs that it was trained on: PSNR in dB over some of them, evenly, all
/// their pixels together that their masks use. For
/// [`Recipe::affording`]; negative infinity of none.
pub fn explained(base: &Field, photographs: &[NamedView]) -> f64 {
    let (mut squares, mut count) = (0.0, 0usize);
    for NamedView { name, view } in photographs.iter().step_by(photographs.len().div_ceil(EXPLAINED_BY).max(1)) {
        let camera = at_most(&view.camera, EXPLAINED_PX);
        let render = base.render(&camera, base.appearance_of(name)).clamped();
        let (w, h) = (render.width(), render.height());
        let seen = view.rgb8.to_picture().resized(w, h);
        let mask = view.mask.as_ref().map(|mask| mask.resized(w, h));
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            if mask.as_ref().is_none_or(|mask| mask.uses(x, y)) {
                let pair = render.pixel(x, y).into_iter().zip(seen.pixel(x, y));
                squares += pair.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
                count += 3;
            }
        }
    }
    if count > 0 { psnr_db_from_mse(squares / count as f64) } else { f64::NEG_INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_mark::Weakest;

    #[test]
    fn what_does_not_come_back_is_said_and_what_does_is_not() {
        let recovered = |picture_ssim, audio_snr_db, text_characters| Judgement {
            step: 1400,
            accuracy: 1.0,
            attacked: 1.0,
            recovered: Recovered { picture_ssim, audio_snr_db, text_characters },
            weakest: None,
        };
        let weak_note = |kept: &Judgement| weak_note(kept, &[], None);
        assert_eq!(weak_note(&recovered(Some(0.97), Some(30.0), Some(1.0))), None);
        assert_eq!(weak_note(&recovered(None, None, None)), None);
        let note = weak_note(&recovered(Some(0.02), Some(3.0), Some(0.5))).unwrap();
        assert!(
            note.contains(
                "(hidden pictures' SSIM: 0.02; hidden sounds' SNR: 3.0 dB; hidden texts' characters: 50.0 %)"
            ),
            "{note}"
        );
        // The remedy goes first.
        assert!(note.starts_with("train with a higher quality (--quality)"), "{note}");
        let confused = weak_note(&Judgement { accuracy: 0.6, ..recovered(None, None, None) }).unwrap();
        assert!(confused.contains("(answers right: 60.0 %)"), "{confused}");
    }

    #[test]
    fn a_sound_that_comes_back_badly_is_told_with_its_level() {
        let kept = |audio_snr_db| Judgement {
            step: 1400,
            accuracy: 1.0,
            attacked: 1.0,
            recovered: Recovered { picture_ssim: Some(0.5), audio_snr_db, text_characters: None },
            weakest: None,
        };
        let whose = ["identity 1".to_owned(), "identity 2".to_owned()];
        let note = |snr, level| weak_note(&kept(snr), &whose, Some((1, level))).unwrap();
        let quiet = note(Some(3.0), -52.4);
        assert!(quiet.contains("that of identity 2, is at -52 dB") && quiet.ends_with("bring it louder"), "{quiet}");
        let loud = note(Some(3.0), -20.6);
        assert!(loud.ends_with("is at -21 dB of full scale (RMS)"), "{loud}");
        // Where sounds are not what is weak, their level is no news.
        assert!(!note(Some(30.0), -52.4).contains("quietest"));
    }

    #[test]
    fn an_identity_that_is_lost_among_others_is_named() {
        let of = |told, ssim| {
            let recovered = |ssim| Recovered { picture_ssim: Some(ssim), ..Recovered::default() };
            let weakest = Some(Weakest { identity: 7, told, recovered: recovered(ssim) });
            Judgement { step: 1400, accuracy: 0.95, attacked: 0.95, recovered: recovered(0.93), weakest }
        };
        let whose: Vec<String> =
            (1..=7).map(|class: i32| format!("identity {} of scene \"fern\"", class - 4)).collect();
        let weak_note = |kept| weak_note(&kept, &whose, None);
        let note = weak_note(of(0.0, 0.1)).unwrap();
        assert!(
            note.contains(
                "(worst of all, identity 3 of scene \"fern\": answers right: 0.0 %, hidden pictures' SSIM: 0.10)"
            ),
            "{note}"
        );
        // One of its few poses missed is no loss.
        assert_eq!(weak_note(of(0.67, 0.7)), None);
    }
}
