//! The engine: everything the daemon does, knowing no gRPC. It owns one data
//! folder: scenes, training jobs, models, and the log of owner records.
//!
//! All calls block, some for long; the edge puts them on threads of their own.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use cairn_log::format::record::Seen;
use cairn_log::format::shares::Shares;
use cairn_log::witness::WitnessClient;
use cairn_log::{Digest, PublicKey, Registry, RegistryError};
use cairn_log::{Receipt, SignedRecord};
use cairn_register::NotLocated;
use cairn_scene::cluster::Grouping;
use cairn_scene::{Capture, Picture, SceneFolder};

use crate::config::{Config, Limits, TrainingOptions};
use crate::error::EngineError;
use crate::export::poses::{self, PoseSheet};
use crate::export::tour::{self, PathRequest, Tour};
use crate::query::check::{self, Checked, Looks};
use crate::query::coverage::{self, Asked, Contributors};
use crate::query::evaluate;
use crate::query::light::{Light, appearance};
use crate::query::locate::{self, FoundCamera};
use crate::query::look::{self, FieldRegistration, Identified, Who};
use crate::query::maps::Maps;
use crate::query::necessity::{Question, Said};
use crate::query::report::Report;
use crate::query::statement::{self, Signer};
use crate::query::viewpoint::{FieldKind, Viewpoint, camera_of, decode, decode_on};
use crate::records::credits::LookUp;
use crate::records::owners::{self, About, AskedView, Material};
use crate::records::publisher::Publisher;
use crate::records::{anchor, registry_key};
use crate::store::access::Access;
use crate::store::exclusions::{Decision, Exclusions, leaving_out};
use crate::store::folder::{DataFolder, LAYOUT};
use crate::store::import::{self, Import, ImportPlan, Imported};
use crate::store::model::{self, Model, ModelInfo};
use crate::store::scenes;
use crate::store::shadow::{self, Shadow};
use crate::store::snapshot::SceneSnapshot;
use crate::train::jobs::Jobs;
use crate::train::screen;
use crate::train::training::Training;

/// What a data folder is opened for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Opening {
    /// To serve: it is made where absent, and trainings that were cut off go on.
    Serve,
    /// For one command that may begin it: it is made where absent. Trainings that were cut off wait for a person to
    /// resume them.
    Begin,
    /// As [`Opening::Begin`], for a command that changes what is there: nothing is made.
    Change,
    /// For one command that reads: nothing is made, and a folder that cannot be written is read through a
    /// shadow (`store/shadow.rs`).
    Read,
}

/// A complete answer, and what is to be said of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompleteAnswer {
    /// JSON, format `cairn-answer/3`.
    pub json: Vec<u8>,
    /// Why an answer about a view has no shares; `None` where it has them, and for a whole scene.
    pub without_shares: Option<String>,
}

/// One data folder at work.
pub struct Engine {
    pub(crate) jobs: Jobs,
    /// Before the registry: it publishes a last time when it is dropped.
    /// None where nothing can be written.
    publisher: Option<Publisher>,
    /// How many witnesses are asked for cosignatures.
    witnesses: usize,
    registry: Arc<Registry>,
    access: Arc<Access>,
    pub(crate) exclusions: Arc<Exclusions>,
    pub(crate) limits: Limits,
    /// How trainings are made where a request does not say.
    pub(crate) training: crate::config::Training,
    /// The model used last: loading one takes seconds, and queries come in rows.
    cache: Mutex<Option<Arc<Model>>>,
    /// The snapshot used last.
    snapshot: Mutex<Option<Arc<SceneSnapshot>>>,
    // Last, so that the folder is let go when all else in it is closed.
    pub(crate) folder: DataFolder,
    /// What stands for a folder that cannot be written.
    shadow: Option<Shadow>,
}

impl Engine {
    /// Opens the data folder and re-reads the log of owner records.
    ///
    /// # Errors
    /// [`EngineError::Locked`] while another process has the folder; [`EngineError::NoFolder`] where there is none to
    /// read; [`EngineError::WrongState`] where the registry's key is missing; what the stored files say.
    pub fn open(data: &Path, config: &Config, opening: Opening) -> Result<Self, EngineError> {
        if matches!(opening, Opening::Change | Opening::Read) && !data.join(LAYOUT).is_file() {
            return Err(EngineError::NoFolder { path: data.to_path_buf() });
        }
        let shadow = if opening == Opening::Read { shadow::of(data)? } else { None };
        Self::open_in(data, config, opening, shadow)
    }

    /// As [`Engine::open`], through `shadow` where there is one.
    pub(crate) fn open_in(
        data: &Path,
        config: &Config,
        opening: Opening,
        shadow: Option<Shadow>,
    ) -> Result<Self, EngineError> {
        let folder = DataFolder::open(shadow.as_ref().map_or(data, Shadow::path))?;
        let key = registry_key::open(&folder, config.registry_key_file.as_deref())?;
        let registry = match shadow {
            None => {
                let anchor = anchor::of(data, &key.public(), config.anchor_file.as_deref())?;
                Registry::open_anchored(&folder.registry(), key, &config.origin, Some(anchor))?
            }
            // Nothing is signed through a shadow: there is nothing for the anchor to hold it to.
            Some(_) => Registry::open_reading(&folder.registry(), key, &config.origin)?,
        };
        let registry = Arc::new(registry);
        let witnesses = config
            .witnesses
            .iter()
            .map(|w| WitnessClient::new(w.verifier.clone(), &w.url))
            .collect::<Result<_, _>>()?;
        let publisher = match shadow {
            None => Some(Publisher::start(registry.clone(), witnesses)?),
            Some(_) => None,
        };
        let exclusions = Arc::new(Exclusions::open(folder.exclusions(), &folder.scenes())?);
        let work = Training {
            exclusions: exclusions.clone(),
            scenes: folder.scenes(),
            models: folder.models(),
            jobs: folder.jobs(),
            checkpoint_every: Duration::from_secs(config.training.checkpoint_every_s),
        };
        let access = Arc::new(Access::open(&folder, config.access.quota)?);
        access.follow_all(&registry)?;
        let jobs = Jobs::open(
            folder.jobs(),
            config.limits.queue_length,
            Some(access.clone()),
            opening == Opening::Serve,
            work,
        )?;
        folder.seal_at_end();
        Ok(Self {
            folder,
            jobs,
            registry,
            publisher,
            witnesses: config.witnesses.len(),
            access,
            exclusions,
            limits: config.limits.clone(),
            training: config.training.clone(),
            cache: Mutex::new(None),
            snapshot: Mutex::new(None),
            shadow,
        })
    }

    /// Whether it holds the data folder itself, and not a shadow of it.
    pub fn holds_the_folder(&self) -> bool {
        self.shadow.is_none()
    }

    /// The training jobs.
    pub fn jobs(&self) -> &Jobs {
        &self.jobs
    }

    /// The log of owner records.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

    /// Accounts, quotas and owners.
    pub fn access(&self) -> &Access {
        &self.access
    }

    /// Begins an import, which `owner` is charged with from now on.
    ///
    /// # Errors
    /// As [`Import::begin`]; the quota's.
    pub fn begin_import(&self, plan: ImportPlan, owner: Option<Digest>) -> Result<Import, EngineError> {
        let mut import = Import::begin(plan, &self.limits, &self.folder.scenes(), &self.folder.staging())?;
        if let Some(owner) = owner {
            import.owned = Some(self.access.reserve(owner, &import.id(), import.takes())?);
        }
        Ok(import)
    }

    /// Ends an import; the scene is durable on return.
    ///
    /// # Errors
    /// As [`Import::finish`].
    pub fn finish_import(&self, mut import: Import) -> Result<Imported, EngineError> {
        let place = self.access.place(import.scene(), self.folder.scenes().join(import.scene()))?;
        let owned = import.owned.take();
        self.access.announce(&place, owned.as_ref())?;
        match import.finish(&self.folder.scenes()) {
            Ok(imported) => {
                self.access.became(&place, owned);
                Ok(imported)
            }
            Err(error) => {
                // The first error is the one to tell; what is left of the second is cleared at the next start.
                let _ = self.access.announce(&place, None);
                Err(error)
            }
        }
    }

    /// Imports a capture that lies on this machine; the scene is durable on return and belongs to nobody.
    ///
    /// # Errors
    /// For a name that is taken or not allowed, a photograph that does not decode, and the file system's.
    pub fn import_capture(&self, name: &str, capture: &Capture) -> Result<Imported, EngineError> {
        scenes::check_scene_name(name)?;
        import::check_keys(capture.views.iter())?;
        let place = self.access.place(name, self.folder.scenes().join(name))?;
        self.access.announce(&place, None)?;
        Imported::store(&self.folder.scenes(), name, capture)
    }

    /// Names of all scenes, sorted.
    ///
    /// # Errors
    /// The file system's.
    pub fn scene_names(&self) -> Result<Vec<String>, EngineError> {
        scenes::list(&self.folder.scenes())
    }

    /// One scene.
    ///
    /// # Errors
    /// [`EngineError::NotFound`], and cairn-scene's.
    pub fn scene(&self, name: &str) -> Result<SceneFolder, EngineError> {
        scenes::open(&self.folder.scenes(), name)
    }

    /// What the scene's newest model says of itself; `None` before the first.
    ///
    /// # Errors
    /// [`EngineError::Stored`].
    pub fn newest_model(&self, scene: &str) -> Result<Option<ModelInfo>, EngineError> {
        scenes::check_scene_name(scene)?;
        model::newest(&self.folder.models(), scene)
    }

    /// Deletes a scene with its models.
    ///
    /// # Errors
    /// [`EngineError::WrongState`] while a job trains on it.
    pub fn delete_scene(&self, name: &str) -> Result<(), EngineError> {
        scenes::check_scene_name(name)?;
        let path = self.folder.scenes().join(name);
        if !path.is_dir() {
            self.scene(name)?;
        }
        if let Some(job) = self.jobs.list().iter().find(|j| j.spec.is_of(name) && !j.state.is_over()) {
            let why = format!("{} is {} on it; cancel that first", job.id, job.state);
            return Err(EngineError::wrong_state(format!("scene {name:?}"), "deleted", why));
        }
        // Out of the way at once, so that no half of it can be read.
        let gone = self.folder.staging().join(format!("deleted-{name}"));
        cairn_durable::remove(&gone)?;
        std::fs::rename(&path, &gone).map_err(EngineError::io("delete", &path))?;
        cairn_durable::sync_folder(&self.folder.scenes())?;
        self.access.forget(name)?;
        self.exclusions.forget(name)?;
        cairn_durable::remove(&self.folder.models().join(name))?;
        *self.cache.lock().unwrap_or_else(PoisonError::into_inner) = None;
        *self.snapshot.lock().unwrap_or_else(PoisonError::into_inner) = None;
        Ok(cairn_durable::remove(&gone)?)
    }

    /// The scene's newest model, loaded.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`]; [`EngineError::Stored`] for a file that was altered.
    pub fn model(&self, scene: &str) -> Result<Arc<Model>, EngineError> {
        let Some(info) = self.newest_model(scene)? else {
            self.scene(scene)?;
            return Err(EngineError::NotTrained { scene: scene.to_owned() });
        };
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(model) = cache.as_ref().filter(|m| m.info == info) {
            return Ok(model.clone());
        }
        // The old one goes first: two large fields may not fit at once.
        *cache = None;
        let model = Arc::new(Model::load(&self.folder.models(), info)?);
        *cache = Some(model.clone());
        Ok(model)
    }

    /// The scene with its newest model's description and what is left out of it, read once for all questions.
    ///
    /// # Errors
    /// As [`Engine::scene`]; [`EngineError::Stored`].
    pub fn snapshot(&self, scene: &str) -> Result<Arc<SceneSnapshot>, EngineError> {
        let info = self.newest_model(scene)?;
        let mut last = self.snapshot.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = last.as_ref().filter(|s| s.is_current(&self.exclusions, scene, info.as_ref())) {
            return Ok(known.clone());
        }
        *last = None;
        let read = Arc::new(SceneSnapshot::read(&self.folder.scenes(), &self.exclusions, scene, info)?);
        *last = Some(read.clone());
        Ok(read)
    }

    /// Excludes or includes views of a scene; see [`Exclusions::decide`]. How many are excluded then.
    ///
    /// # Errors
    /// As there, and [`Engine::scene`]'s.
    pub fn decide(&self, scene: &str, views: &[String], decision: &Decision) -> Result<usize, EngineError> {
        self.exclusions.decide(scene, &self.scene(scene)?, views, decision)
    }

    /// How far each view of a scene is to be trusted. Reads what was measured last; measures where there is nothing, and
    /// where `anew` asks for it, which takes minutes. With a picture, and with where the most suspicious photographs
    /// are found among the others' places, where these are asked for. It is given up once it is no longer `wanted`.
    ///
    /// # Errors
    /// As [`Engine::scene`]; with a picture or places [`EngineError::NotTrained`].
    pub fn check(
        &self,
        scene: &str,
        anew: bool,
        looks: Looks,
        wanted: &dyn Fn() -> bool,
    ) -> Result<Checked, EngineError> {
        let folder = self.scene(scene)?;
        let Looks { picture, places } = looks;
        let model = if picture || places { Some(self.model(scene)?) } else { None };
        let mut entries = self.exclusions.of(scene)?;
        if anew || entries.measured.is_none() {
            let kept = leaving_out(folder.clone(), &entries.excluded());
            let settings = TrainingOptions::default().settings(&self.training, folder.capture().kind)?;
            if let Some(measured) = screen::measure(&kept, &settings, &entries.included(), wanted)? {
                // Nothing is excluded here: a check looks.
                self.exclusions.screened(scene, &folder, measured, &[])?;
                entries = self.exclusions.of(scene)?;
            }
        }
        let mut views = check::views(&folder, &entries);
        if let Some(model) = model.as_ref().filter(|_| places) {
            check::look_for(&folder, model, &mut views, wanted)?;
        }
        let model = model.filter(|_| picture);
        let picture = model.map(|model| check::picture(&folder, &model, &views)).transpose()?;
        Ok(Checked { views, measured: entries.measured, picture })
    }

    /// Renders a view, clamped to [0, 1]; with accumulation and depth where `maps` asks for them.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`], [`EngineError::NotFound`], [`EngineError::Invalid`]; in a photograph's light what is
    /// said of [`Light::Photograph`].
    pub fn render(
        &self,
        scene: &str,
        viewpoint: &Viewpoint,
        field: FieldKind,
        light: &Light,
        maps: bool,
    ) -> Result<(Picture, Option<Maps>), EngineError> {
        let (model, snapshot) = (self.model(scene)?, self.snapshot(scene)?);
        let camera = camera_of("the render", &snapshot, viewpoint, &self.limits)?;
        let appearance = appearance(&model, &snapshot, light, &self.limits)?;
        look::render(&model, &camera, field, &appearance, maps)
    }

    /// Plans a camera path; renders nothing yet.
    ///
    /// # Errors
    /// As [`tour::plan`]; [`EngineError::NotTrained`].
    pub fn tour(&self, request: &PathRequest) -> Result<Tour, EngineError> {
        tour::plan(&*self.snapshot(&request.scene)?, request, &self.limits, || self.model(&request.scene))
    }

    /// Renders frame `i` of a path, clamped to [0, 1].
    ///
    /// # Errors
    /// As [`tour::frame`]; [`Engine::model`]'s.
    pub fn frame(&self, tour: &Tour, i: usize) -> Result<Picture, EngineError> {
        tour::frame(&*self.model(&tour.scene)?, tour, i)
    }

    /// Draws the scene's cameras, as [`poses::draw_poses`] does.
    ///
    /// # Errors
    /// As there, and [`Engine::scene`]'s.
    pub fn draw_poses(&self, scene: &str, grouping: Option<(Grouping, u64)>) -> Result<PoseSheet, EngineError> {
        let folder = self.exclusions.without(scene, self.scene(scene)?)?;
        poses::draw_poses(scene, &folder, grouping, self.newest_model(scene)?)
    }

    /// The identity that a place is of, by where the camera stands, and who contributed to it, with the records that credit
    /// them.
    ///
    /// # Errors
    /// As [`coverage::contributors`]; [`EngineError::NotTrained`]; the registry's.
    pub fn contributors(&self, scene: &str, asked: &Asked) -> Result<(Who, Contributors), EngineError> {
        let snapshot = self.snapshot(scene)?;
        let place = look::place_of(&snapshot, &asked.viewpoint, &self.limits)?;
        let (mark, model) = (self.with_records(&snapshot, place)?, self.current_model(&snapshot)?);
        let mut found = coverage::contributors(&model, &snapshot, asked, &self.limits)?;
        let mut look_up = LookUp::new(&self.registry, scene);
        for of in &mut found.shares {
            let photographs = of.photographs.iter().map(|(view, _)| snapshot.photograph_of(view));
            of.credits = look_up.of(&of.name, &photographs.collect::<Result<Vec<_>, _>>()?)?;
        }
        Ok((mark, found))
    }

    /// How much a view would change without some contributors. `goes_on` hears the cost first, then how far it is, then
    /// the answer; where it says no, the work ends without one.
    ///
    /// # Errors
    /// As [`Question::plan`] and [`Plan::work_out`](crate::query::necessity::Plan::work_out); [`EngineError::NotTrained`].
    pub fn necessity(
        &self,
        scene: &str,
        question: &Question,
        goes_on: &mut dyn FnMut(Said) -> bool,
    ) -> Result<(), EngineError> {
        let snapshot = self.snapshot(scene)?;
        let model = self.current_model(&snapshot)?;
        let plan = question.plan(&model, &snapshot, &self.limits)?;
        if !goes_on(Said::Cost(plan.cost)) {
            return Ok(());
        }
        let begun = Instant::now();
        let mut progress = |done: f64| {
            let seconds_left = begun.elapsed().as_secs_f64() / done * (1.0 - done);
            goes_on(Said::Progress { done, seconds_left })
        };
        let huber = model.info.settings(&self.folder.models())?.field.huber;
        if let Some(needed) = plan.work_out(&model, &snapshot, huber, &mut progress)? {
            goes_on(Said::Answer(needed));
        }
        Ok(())
    }

    /// The newest model, which `snapshot` is of.
    fn current_model(&self, snapshot: &SceneSnapshot) -> Result<Arc<Model>, EngineError> {
        let model = self.model(&snapshot.name)?;
        if snapshot.newest.as_ref() == Some(&model.info) {
            return Ok(model);
        }
        let why = "a training published another model just now; ask again";
        Err(EngineError::wrong_state(format!("scene {:?}", snapshot.name), "asked about", why))
    }

    /// Whose mark a picture carries, as the classifier reads it; or, with `register`, as
    /// registration with the field tells it.
    ///
    /// # Errors
    /// For a picture that does not decode, and [`look::read_picture`]'s.
    pub fn identify(
        &self,
        scene: &str,
        bytes: &[u8],
        register: Option<FieldRegistration>,
    ) -> Result<Identified, EngineError> {
        let picture = decode(bytes, &self.limits)?;
        let (model, snapshot) = (self.model(scene)?, self.snapshot(scene)?);
        let found = look::read_picture(&model, &snapshot, &picture, register, &self.limits)?;
        let who = Who::of(&snapshot, found.identity, found.confidence.into())?;
        let labels = model.info.identities.iter().map(|identity| identity.label.clone()).collect();
        Ok(Identified { who: self.with_records(&snapshot, who)?, found, labels })
    }

    /// Which camera took a picture of the scene, or why none was found; given up once it is no longer `wanted`. With what
    /// was `compared` where that is asked for.
    ///
    /// # Errors
    /// For a picture that does not decode, [`Engine::model`]'s, and [`locate::locate`]'s.
    pub fn locate(
        &self,
        scene: &str,
        bytes: &[u8],
        compared: bool,
        wanted: &dyn Fn() -> bool,
    ) -> Result<Result<FoundCamera, NotLocated>, EngineError> {
        let snapshot = self.snapshot(scene)?;
        let picture = decode_on(bytes, &self.limits, snapshot.scene.capture().background)?;
        locate::locate(&*self.model(scene)?, &snapshot, &picture, compared, wanted)
    }

    /// `who` with the owner records that bear on the identity.
    fn with_records(&self, snapshot: &SceneSnapshot, who: Who) -> Result<Who, EngineError> {
        let Some((number, _)) = who.identity else { return Ok(who) };
        let (info, (identity, _)) = (snapshot.info()?, snapshot.identity(number)?);
        let marked_field = info.mark.as_ref().map(|mark| mark.marked_field);
        let records = owners::bearing_on(&self.registry, &info.scene, marked_field, identity)?;
        Ok(Who { records, ..who })
    }

    /// Scores the scene's newest model; with a contact sheet where asked. Slow.
    ///
    /// # Errors
    /// [`EngineError::NotTrained`]; as [`evaluate::evaluate`].
    pub fn evaluate(&self, scene: &str, sheet: bool) -> Result<(Report, Option<Picture>), EngineError> {
        evaluate::evaluate(&*self.model(scene)?, &*self.snapshot(scene)?, sheet)
    }

    /// What a record about an identity of the newest model, or about a contributor's photographs, has to state.
    ///
    /// # Errors
    /// As [`owners::material`].
    pub fn material(&self, scene: &str, about: &About) -> Result<Material, EngineError> {
        owners::material(&*self.snapshot(scene)?, &self.folder.models(), about)
    }

    /// Takes a record in; see [`owners::submit`].
    ///
    /// # Errors
    /// As there.
    pub fn submit_record(&self, signed: &SignedRecord, payer: Option<Digest>) -> Result<Receipt, EngineError> {
        let publisher = self.publisher.as_ref().ok_or_else(|| {
            EngineError::wrong_state("the record", "entered", "the data folder cannot be written; ask its owner")
        })?;
        owners::submit(&self.registry, &self.access, publisher, signed, payer)
    }

    /// A nonce for a record of `owner` about `scene`, in hexadecimal.
    ///
    /// # Errors
    /// For 32 bytes that are no public key.
    pub fn nonce(&self, scene: &str, owner: &[u8; 32]) -> Result<String, EngineError> {
        let owner = PublicKey::from_bytes(owner).map_err(RegistryError::from)?;
        Ok(self.registry.nonce(scene, &owner)?.to_string())
    }

    /// Who contributed to a scene or a view of it, complete; with a signed statement of shares for a view of a scene that
    /// was trained. The proof does not wait for the shares: where model or share table is not to be had, the answer says
    /// why it has none.
    ///
    /// # Errors
    /// As [`owners::photograph_of`] and [`owners::complete_answer`].
    pub fn complete_answer(
        &self,
        scene: &str,
        view: Option<AskedView>,
        as_of: Option<&str>,
        most: usize,
    ) -> Result<CompleteAnswer, EngineError> {
        let (photograph, snapshot, view) = match view {
            None => (None, None, None),
            Some(AskedView::Photograph(digest)) => {
                // The log outlives scenes, and takes names that no scene can have.
                let is_there = scenes::check_scene_name(scene).is_ok() && self.folder.scenes().join(scene).is_dir();
                let snapshot = if is_there { Some(self.snapshot(scene)?) } else { None };
                let view = snapshot.as_ref().and_then(|snapshot| snapshot.view_of(&digest)).map(str::to_owned);
                (Some(digest), snapshot, view)
            }
            Some(AskedView::Named(name)) => {
                let snapshot = self.snapshot(scene)?;
                let photograph = owners::photograph_of(&snapshot, &name)?;
                let view = snapshot.full_name(&name)?.to_owned();
                (Some(photograph), Some(snapshot), Some(view))
            }
        };
        let answered = |shares: Option<&dyn Fn(Seen) -> Result<Shares, EngineError>>| {
            owners::complete_answer(&self.registry, scene, photograph.as_ref(), as_of, most, shares)
        };
        let without = |why: String| Ok(CompleteAnswer { json: answered(None)?, without_shares: Some(why) });
        let (snapshot, view) = match (snapshot, view) {
            (Some(snapshot), Some(view)) => (snapshot, view),
            _ if photograph.is_some() => return without(format!("scene {scene:?} has no such view to credit")),
            _ => return Ok(CompleteAnswer { json: answered(None)?, without_shares: None }),
        };
        let found = match self.credited_by(&snapshot, &view) {
            Ok(found) => found,
            Err(e) => return without(e.to_string()),
        };
        let (origin, key) = (self.registry.origin(), self.registry.public_key());
        let shares = |checkpoint| {
            let signer = Signer { origin, key, checkpoint };
            statement::shares(&snapshot, snapshot.info()?, &view, &found, signer)
        };
        Ok(CompleteAnswer { json: answered(Some(&shares))?, without_shares: None })
    }

    /// Whose photographs show a view of the scene as `snapshot` has it; whose mark its renders carry is not looked up.
    fn credited_by(&self, snapshot: &SceneSnapshot, view: &str) -> Result<Contributors, EngineError> {
        snapshot.info()?;
        let model = self.current_model(snapshot)?;
        let asked = Asked::about(Viewpoint::View(view.to_owned()));
        coverage::contributors(&model, snapshot, &asked, &self.limits)
    }

    /// The offline proof of a record (C2SP tlog-proof): index, inclusion hashes, the newest checkpoint, or the newest one
    /// that witnesses cosigned.
    ///
    /// # Errors
    /// [`RegistryError::NoSuchRecord`].
    pub fn tlog_proof(&self, index: u64) -> Result<String, EngineError> {
        let size = self.registry.size();
        if index >= size {
            return Err(RegistryError::NoSuchRecord { index, size }.into());
        }
        if let Some(publisher) = &self.publisher {
            publisher.await_cosigned(&self.registry, index);
        }
        Ok(self.registry.tlog_proof(index)?.to_text())
    }

    /// How many witnesses are asked to cosign the log's checkpoints.
    pub const fn witnesses(&self) -> usize {
        self.witnesses
    }

    /// Checkpoints and stops training, and lets the folder go when dropped. Blocks.
    pub fn shut_down(&self) {
        self.jobs.shut_down();
    }

    /// Publishes what is left. After the last request: what comes in later is published at the next start.
    pub fn close(&self) {
        if let Some(publisher) = &self.publisher {
            publisher.stop();
        }
    }
}
