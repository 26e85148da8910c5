//! What a training leaves behind: fields, detector, and `model.json`, which says
//! what belongs together and under which digests, and `manifest.json` over them all. A model appears whole: its
//! folder is filled under another name, flushed, renamed, and only then named in
//! `current.json`.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use cairn_durable::{remove, rename, sync_folder, write_atomic};
use cairn_field::{Field, FieldError};
use cairn_log::Digest;
use cairn_log::format::record::photographs_root;
use cairn_mark::{Detector, MarkError, MarkedField, Signal};
use cairn_register::Index;
use cairn_scene::UnusedPhotographs;
use cairn_scene::cluster::Clusters;
use cairn_share::{ShareError, ShareTable};
use serde::{Deserialize, Serialize};

use crate::config::TrainingSettings;
use crate::error::EngineError;
use crate::store::checked::{open_checked, read_checked};
use crate::store::classes::{Classes, Share};
use crate::store::folder::{read_json, write_json};
use crate::store::hidden::{self, Parts};

/// Largest field or detector file that is read, bytes.
const MAX_FIELD_BYTES: u64 = 64 << 30;
/// Largest share table that is read, bytes.
const MAX_SHARES_BYTES: u64 = 16 << 30;
/// Largest index of places that is read, bytes: one of the most views has a fortieth of that.
const MAX_PLACES_BYTES: u64 = 1 << 30;
/// Largest file of settings that is read, bytes.
const MAX_SETTINGS_BYTES: u64 = 1 << 20;
/// Format version of `model.json`, and of the settings beside it.
pub const VERSION: u32 = 5;
/// Format version of `current.json`.
const CURRENT_VERSION: u32 = 1;

/// `model.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelInfo {
    /// [`VERSION`].
    pub format_version: u32,
    /// The scene.
    pub scene: String,
    /// The job that made it.
    pub job: String,
    /// The seed, decimal.
    pub seed: String,
    /// Identities 1..=M, in order.
    pub identities: Vec<IdentityInfo>,
    /// Where each cluster lies; its indices count the scene's training views.
    pub clusters: Clusters,
    /// SHA-256 of `base.field`.
    pub base_field: Digest,
    /// SHA-256 of `base.shares`.
    pub share_table: Digest,
    /// SHA-256 of `base.places`.
    pub places: Digest,
    /// The contributors of the scene whom the share table gives nothing, with all of their photographs as they stood in
    /// the training, by contributor and reason.
    pub without_share: Vec<UnusedPhotographs>,
    /// SHA-256 of `settings.toml`.
    pub settings: Digest,
    /// Stage 2's half; none where only the base field was trained.
    pub mark: Option<MarkInfo>,
}

/// What stage 2 made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkInfo {
    /// SHA-256 of `marked.field`.
    pub marked_field: Digest,
    /// SHA-256 of `detector`.
    pub detector: Digest,
    /// SHA-256 of each identity's `signal-<number>.png`, `.wav` and `.txt`, as far as there are any, identity 1 first.
    pub signals: Vec<Parts<Digest>>,
    /// The scenes that share the detector, in the order of its classes, this one among them;
    /// empty where it has one to itself.
    pub shared: Vec<Share>,
}

/// One identity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IdentityInfo {
    /// 1 and up.
    pub number: u32,
    /// Who it stands for.
    pub label: String,
    /// Names of its cluster's views.
    pub views: Vec<String>,
    /// SHA-256 of its views' photographs, in their order.
    pub photographs: Vec<Digest>,
    /// Who took the photographs and how many each, most first, then by name.
    pub contributors: Vec<(String, usize)>,
}

impl IdentityInfo {
    /// Merkle root over the photographs' digests, as owner records bind it.
    pub fn photographs_root(&self) -> Digest {
        photographs_root(&self.photographs)
    }
}

/// Stage 2's files before they are in their place.
pub struct MarkFiles {
    /// The marked field's bytes.
    pub field: Vec<u8>,
    /// The detector's bytes.
    pub detector: Vec<u8>,
    /// The files of each identity's hidden signal, identity 1 first.
    pub signals: Vec<Parts<Vec<u8>>>,
}

impl MarkFiles {
    /// Their digests, and who shares the detector.
    pub fn info(&self, shared: &[Share]) -> MarkInfo {
        MarkInfo {
            shared: shared.to_vec(),
            marked_field: Digest::of(&self.field),
            detector: Digest::of(&self.detector),
            signals: self.signals.iter().map(|parts| parts.map(|bytes| Digest::of(bytes))).collect(),
        }
    }
}

/// Stage 1's files.
pub struct BaseFiles {
    /// The base field's bytes.
    pub field: Vec<u8>,
    /// The bytes of its share table.
    pub share_table: Vec<u8>,
    /// Whom that gives nothing.
    pub without_share: Vec<UnusedPhotographs>,
    /// The bytes of the index of its places.
    pub places: Vec<u8>,
}

/// A model, loaded.
pub struct Model {
    /// What it says of itself.
    pub info: ModelInfo,
    /// Where its files lie.
    folder: PathBuf,
    /// What each photograph taught the base field: read when first asked for.
    share_table: OnceLock<ShareTable>,
    /// Which keypoints its places have: read when first asked for.
    places: OnceLock<Arc<Index>>,
    /// One reads either, and those who ask meanwhile wait for that.
    reading: Mutex<()>,
    /// After stage 1.
    pub base: Arc<Field>,
    /// After stage 2, where there was one.
    pub mark: Option<Mark>,
}

/// The marked field and what reads its marks.
pub struct Mark {
    /// After stage 2.
    pub field: MarkedField,
    /// Recovers and classifies.
    pub detector: Detector,
    /// Each identity's hidden signal, identity 1 first.
    pub signals: Vec<Signal>,
    /// Which of the detector's classes are the scene's.
    pub classes: Classes,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Current {
    format_version: u32,
    job: String,
    /// SHA-256 of the model's `manifest.json`.
    manifest: Digest,
}

/// Puts a model in its place and makes it the scene's newest: what stage 1 made, the
/// `settings`, and what stage 2 made. Durable on return.
///
/// # Errors
/// The file system's; [`EngineError::Stored`] for a file that is not as it was written.
pub fn publish(
    models: &Path,
    info: &ModelInfo,
    base: &BaseFiles,
    settings: &str,
    mark: Option<&MarkFiles>,
) -> Result<(), EngineError> {
    let of_scene = models.join(&info.scene);
    let (filling, folder) = (of_scene.join(format!(".{}", info.job)), of_scene.join(&info.job));
    remove(&filling)?;
    // A run that was cut off between the rename and the end of the job left it: the same bytes come again.
    remove(&folder)?;
    std::fs::create_dir_all(&filling).map_err(EngineError::io("create", &filling))?;
    write_atomic(&filling.join("base.field"), &base.field)?;
    write_atomic(&filling.join("base.shares"), &base.share_table)?;
    write_atomic(&filling.join("base.places"), &base.places)?;
    write_atomic(&filling.join("settings.toml"), settings.as_bytes())?;
    if let Some(mark) = mark {
        write_atomic(&filling.join("marked.field"), &mark.field)?;
        write_atomic(&filling.join("detector"), &mark.detector)?;
        for (i, signal) in mark.signals.iter().enumerate() {
            hidden::write(&filling, i + 1, signal)?;
        }
    }
    write_json(&filling.join("model.json"), info)?;
    let manifest = Digest::from_bytes(cairn_scene::write_manifest(&filling)?);
    rename(&filling, &folder)?;
    sync_folder(models)?;
    write_json(
        &of_scene.join("current.json"),
        &Current { format_version: CURRENT_VERSION, job: info.job.clone(), manifest },
    )
}

/// What the newest model of `scene` says of itself; `None` before the first.
///
/// # Errors
/// The file system's; [`EngineError::Stored`] for a file that is not as it was written.
pub fn newest(models: &Path, scene: &str) -> Result<Option<ModelInfo>, EngineError> {
    let current = models.join(scene).join("current.json");
    if !current.exists() {
        return Ok(None);
    }
    let Current { job, .. } = read_json(&current, CURRENT_VERSION)?;
    of_job(models, scene, &job).map(Some)
}

/// What the model of `scene` that `job` made says of itself.
///
/// # Errors
/// [`EngineError::Stored`] where there is none any more, or it is damaged.
pub fn of_job(models: &Path, scene: &str, job: &str) -> Result<ModelInfo, EngineError> {
    read_json(&models.join(scene).join(job).join("model.json"), VERSION)
}

/// What every model of `scene` says of itself, newest first: trainings leave the models before them in their place.
///
/// # Errors
/// [`EngineError::Stored`] for a damaged `model.json`, and the file system's.
pub fn all(models: &Path, scene: &str) -> Result<Vec<ModelInfo>, EngineError> {
    let of_scene = models.join(scene);
    if !of_scene.exists() {
        return Ok(Vec::new());
    }
    let mut jobs = Vec::new();
    for entry in std::fs::read_dir(&of_scene).map_err(EngineError::io("list", &of_scene))? {
        let name = entry.map_err(EngineError::io("list", &of_scene))?.file_name().to_string_lossy().into_owned();
        // A name with a dot in front is a model that is not whole yet.
        if !name.starts_with('.') && of_scene.join(&name).join("model.json").exists() {
            jobs.push(name);
        }
    }
    jobs.sort_unstable_by(|a, b| b.cmp(a));
    let read = |job: &String| {
        let path = of_scene.join(job).join("model.json");
        let info: ModelInfo = read_json(&path, VERSION)?;
        // The folder of its other files is found by these names.
        if (info.scene.as_str(), &info.job) != (scene, job) {
            let problem = format!("it says that it is of scene {:?} and job {:?}", info.scene, info.job);
            return Err(EngineError::Stored { path, problem });
        }
        Ok(info)
    };
    jobs.iter().map(read).collect()
}

impl Model {
    /// Loads the model that `info` describes; every file is held to its digest. Nobody may write into a model's files: fields
    /// are read once for their digest and once more for what they hold.
    ///
    /// # Errors
    /// The file system's; [`EngineError::Stored`] for a file that is not as it was written.
    pub fn load(models: &Path, info: ModelInfo) -> Result<Self, EngineError> {
        let folder = info.folder(models);
        let path = folder.join("base.field");
        let mut file = open_checked(&path, &info.base_field, MAX_FIELD_BYTES)?;
        let base = Arc::new(Field::read_from(&mut file).map_err(|e| of_file(&path, e))?);
        let mark = match &info.mark {
            None => None,
            Some(mark) => Some(load_mark(&folder, mark, info.classes()?, &base, &info.base_field)?),
        };
        let (share_table, places) = (OnceLock::new(), OnceLock::new());
        Ok(Self { info, folder, share_table, places, reading: Mutex::default(), base, mark })
    }

    /// What each photograph taught the base field.
    ///
    /// # Errors
    /// The file system's; [`EngineError::Stored`] for a file that is not as it was written, or of another field.
    pub fn share_table(&self) -> Result<&ShareTable, EngineError> {
        self.read_once(&self.share_table, || {
            let path = self.folder.join("base.shares");
            let mut file = open_checked(&path, &self.info.share_table, MAX_SHARES_BYTES)?;
            let table = ShareTable::read_from(&mut file).map_err(|error| match error {
                ShareError::File(error) => of_file(&path, error),
                error => error.into(),
            })?;
            table.must_be_of(&*self.base)?;
            Ok(table)
        })
    }

    /// Which keypoints the base field's places have: what a picture's camera is found with.
    ///
    /// # Errors
    /// The file system's; [`EngineError::Stored`] for a file that is not as it was written.
    pub fn places(&self) -> Result<Arc<Index>, EngineError> {
        let places = self.read_once(&self.places, || {
            let path = self.folder.join("base.places");
            let mut file = open_checked(&path, &self.info.places, MAX_PLACES_BYTES)?;
            Ok(Arc::new(Index::read_from(&mut file).map_err(|error| of_file(&path, error))?))
        })?;
        Ok(places.clone())
    }

    /// What `read` gives the first time.
    fn read_once<'a, T>(
        &self,
        kept: &'a OnceLock<T>,
        read: impl FnOnce() -> Result<T, EngineError>,
    ) -> Result<&'a T, EngineError> {
        if let Some(there) = kept.get() {
            return Ok(there);
        }
        let _reading = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(there) = kept.get() {
            return Ok(there);
        }
        let made = read()?;
        Ok(kept.get_or_init(|| made))
    }

    /// Stage 2's half.
    ///
    /// # Errors
    /// [`EngineError::WrongState`] where only the base field was trained.
    pub fn mark(&self) -> Result<&Mark, EngineError> {
        self.mark.as_ref().ok_or_else(|| {
            let why = "its newest model is a base field alone; train it with marks";
            EngineError::wrong_state(format!("scene {:?}", self.info.scene), "asked for marks", why)
        })
    }

    /// The marked field, to render it.
    ///
    /// # Errors
    /// [`EngineError::WrongState`] where only the base field was trained: that is there to be rendered.
    pub fn marked_field(&self) -> Result<&MarkedField, EngineError> {
        let none = || {
            let why = "its newest model is a base field alone; ask for that (--base, or FIELD_KIND_BASE), or train it with marks";
            EngineError::wrong_state(format!("scene {:?}", self.info.scene), "rendered with marks", why)
        };
        self.mark.as_ref().map(|mark| &mark.field).ok_or_else(none)
    }
}

/// `base` is the field of stage 1, `base_file` its file's digest. A marked field on that same base shares it.
fn load_mark(
    folder: &Path,
    info: &MarkInfo,
    classes: Classes,
    base: &Arc<Field>,
    base_file: &Digest,
) -> Result<Mark, EngineError> {
    let path = folder.join("marked.field");
    let mut file = open_checked(&path, &info.marked_field, MAX_FIELD_BYTES)?;
    let is_base = |stored: &mut dyn Read| Ok(Digest::of_all(stored)?.0 == *base_file);
    let field = MarkedField::read_sharing(&mut file, base, is_base).map_err(|error| match error {
        MarkError::Field(error) => of_file(&path, error),
        error => error.into(),
    })?;
    let detector = read_checked(&folder.join("detector"), &info.detector, MAX_FIELD_BYTES)?;
    let mut signals = Vec::with_capacity(info.signals.len());
    for (i, digest) in info.signals.iter().enumerate() {
        signals.push(hidden::decoded(&hidden::read(folder, i + 1, digest)?)?);
    }
    let detector = Detector::from_bytes(&detector)?;
    if detector.classes() != classes.count() {
        let (got, expected) = (detector.classes(), classes.count());
        let problem = format!("it has {got} classes, model.json speaks of {expected}");
        return Err(EngineError::Stored { path: folder.join("detector"), problem });
    }
    Ok(Mark { field, detector, signals, classes })
}

impl ModelInfo {
    /// Where its files lie in `models`.
    fn folder(&self, models: &Path) -> PathBuf {
        models.join(&self.scene).join(&self.job)
    }

    /// Which of the detector's classes are the scene's.
    ///
    /// # Errors
    /// [`EngineError::Stored`] where what it says is shared leaves the scene out.
    pub fn classes(&self) -> Result<Classes, EngineError> {
        let own = || Share {
            scene: self.scene.clone(),
            labels: self.identities.iter().map(|identity| identity.label.clone()).collect(),
        };
        let shared = self.mark.as_ref().map(|mark| mark.shared.clone()).unwrap_or_default();
        Classes::new(&self.scene, if shared.is_empty() { vec![own()] } else { shared }).ok_or_else(|| {
            let path = Path::new(&self.scene).join(&self.job).join("model.json");
            EngineError::Stored { path, problem: format!("`mark.shared` does not name the scene {}", self.scene) }
        })
    }

    /// The base field's file.
    ///
    /// # Errors
    /// [`EngineError::Stored`] for one that was altered.
    pub fn base_field_bytes(&self, models: &Path) -> Result<Vec<u8>, EngineError> {
        let path = self.folder(models).join("base.field");
        read_checked(&path, &self.base_field, MAX_FIELD_BYTES)
    }

    /// The base field's share table.
    ///
    /// # Errors
    /// [`EngineError::Stored`] for one that was altered.
    pub fn share_table_bytes(&self, models: &Path) -> Result<Vec<u8>, EngineError> {
        let path = self.folder(models).join("base.shares");
        read_checked(&path, &self.share_table, MAX_SHARES_BYTES)
    }

    /// The index of the base field's places.
    ///
    /// # Errors
    /// [`EngineError::Stored`] for one that was altered.
    pub fn places_bytes(&self, models: &Path) -> Result<Vec<u8>, EngineError> {
        read_checked(&self.folder(models).join("base.places"), &self.places, MAX_PLACES_BYTES)
    }

    /// The settings that it was trained with.
    ///
    /// # Errors
    /// [`EngineError::Stored`] for a file that was altered or is of another release.
    pub fn settings(&self, models: &Path) -> Result<TrainingSettings, EngineError> {
        let path = self.folder(models).join("settings.toml");
        let bytes = read_checked(&path, &self.settings, MAX_SETTINGS_BYTES)?;
        toml::from_slice(&bytes)
            .map_err(|e| EngineError::Stored { path, problem: format!("it holds no training's settings: {e}") })
    }

    /// Identity `number`.
    ///
    /// # Errors
    /// [`EngineError::NotFound`].
    pub fn identity(&self, number: u32) -> Result<&IdentityInfo, EngineError> {
        self.identities.iter().find(|i| i.number == number).ok_or_else(|| {
            let there: Vec<String> = self.identities.iter().map(|i| format!("{} ({})", i.number, i.label)).collect();
            EngineError::not_found("identity", &number.to_string(), there.iter().map(String::as_str))
        })
    }

    /// The files of identity `number`'s hidden signal.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] where there is none, [`EngineError::Stored`].
    pub fn signal(&self, models: &Path, number: u32) -> Result<Parts<Vec<u8>>, EngineError> {
        let digests = self.mark.iter().flat_map(|m| &m.signals).collect::<Vec<_>>();
        let Some(digest) = (number as usize).checked_sub(1).and_then(|at| digests.get(at)) else {
            return Err(EngineError::not_found("hidden signal", &number.to_string(), std::iter::empty()));
        };
        hidden::read(&self.folder(models), number as usize, digest)
    }
}

/// What went wrong with the field in the file at `path`.
fn of_file(path: &Path, error: FieldError) -> EngineError {
    match error {
        FieldError::Read { source, .. } => EngineError::io("read", path)(source),
        error => error.into(),
    }
}
