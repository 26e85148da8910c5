//! The real `cairn` at work: daemons on a free port, commands, and tiny captures of a made-up
//! landmark.
//!
//! The program is the one that Cargo built beside the running test: `target/PROFILE/cairn`. Tests of
//! the package `cairn` have it, and so has `cargo test --workspace`.

pub mod accounts;
pub mod files;
pub mod wire;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use cairn_api::v1;
use cairn_landmark::{Landmark, LandmarkCapture, LandmarkConfig};
use cairn_scene::cluster::Grouping;
use cairn_service::config::{Chosen, Config, Preset, Quality, TrainingSettings, preset};
use cairn_service::engine::{Engine, Opening};
use cairn_service::train::job::JobState;
use cairn_service::train::request::{Plan, TrainingRequest};
use tempfile::TempDir;

/// Runs `cairn`, which Cargo puts into the folder above the one of test programs.
///
/// # Panics
/// Where it is not there, with the command that builds it.
pub fn command() -> Command {
    let test = std::env::current_exe().unwrap();
    let folder = test.ancestors().nth(2).unwrap();
    let program = folder.join(format!("cairn{}", std::env::consts::EXE_SUFFIX));
    assert!(program.is_file(), "{} is not there; build it with `cargo build -p cairn`", program.display());
    Command::new(program)
}

/// Options of a training that takes a moment.
pub fn smoke() -> v1::TrainingOptions {
    v1::TrainingOptions { quality: v1::Quality::Smoke.into(), ..v1::TrainingOptions::default() }
}

/// Options of a training of small steps that no test waits for.
pub fn endless() -> v1::TrainingOptions {
    v1::TrainingOptions {
        preset: v1::Preset::Object.into(),
        quality: v1::Quality::Archival.into(),
        max_voxels: Some(4096),
        ..v1::TrainingOptions::default()
    }
}

/// A folder that goes with the test, with a capture in it.
pub struct Place {
    /// The folder; the capture is in `capture`.
    pub dir: TempDir,
}

impl Place {
    /// Two contributors' photographs of the landmark, 12 views of 32 x 32 px.
    pub fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        Self::landmark().write(&dir.path().join("capture")).unwrap();
        Self { dir }
    }

    fn landmark() -> LandmarkCapture {
        let config =
            LandmarkConfig { contributors: 2, photographs: 6, width: 32, height: 32, ..LandmarkConfig::default() };
        Landmark::generate(&config, 3).unwrap()
    }

    /// The camera of view `name`, with so many times as many pixels along each side, as a file for `--pose`.
    pub fn pose(&self, name: &str, times: usize) -> String {
        let view = Self::landmark().views.into_iter().find(|view| view.name == name).unwrap();
        let camera = view.camera.resized(32 * times, 32 * times);
        let (i, r, at) = (camera.intrinsics, camera.pose.rotation.transpose(), camera.pose.position.to_array());
        let row = |n: usize| -> Vec<f64> { r.col(n).to_array().into_iter().chain([at[n]]).collect() };
        let json = serde_json::json!({
            "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy,
            "camera_to_world": [row(0), row(1), row(2)],
        });
        std::fs::write(self.path("pose.json"), json.to_string()).unwrap();
        self.text("pose.json")
    }

    /// The path of `name` in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// As [`Place::path`], as text for a command.
    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// The path of a daemon's token, `a-token-of-the-test`, which is written there.
    pub fn token(&self) -> String {
        std::fs::write(self.path("token"), "a-token-of-the-test\n").unwrap();
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            std::fs::set_permissions(self.path("token"), std::fs::Permissions::from_mode(0o600)).unwrap();
        }
        self.text("token")
    }

    /// Runs `cairn` with `arguments`, in this folder.
    pub fn cairn(&self, arguments: &[&str]) -> Output {
        command().args(arguments).current_dir(self.dir.path()).output().unwrap()
    }

    /// As [`Place::cairn`]; it must succeed. What it printed.
    pub fn cairn_ok(&self, arguments: &[&str]) -> String {
        let output = self.cairn(arguments);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "cairn {arguments:?}: {said}{}", String::from_utf8_lossy(&output.stderr));
        said
    }

    /// As [`Place::cairn_ok`], of a command that prints JSON.
    pub fn cairn_json(&self, arguments: &[&str]) -> serde_json::Value {
        let said = self.cairn_ok(arguments);
        serde_json::from_str(&said).unwrap_or_else(|e| panic!("cairn {arguments:?}: {e} in {said}"))
    }

    /// What `cairn` is refused with, which is exit code 2.
    pub fn cairn_refused(&self, arguments: &[&str]) -> String {
        let output = self.cairn(arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "cairn {arguments:?}: {said}");
        said
    }

    /// Imports the capture as `scene` wherever `place` (--connect or --data) says, every 8th view held out.
    pub fn import(&self, scene: &str, place: [&str; 2]) -> String {
        let capture = self.text("capture");
        let contributors = self.text("capture/contributors.csv");
        let import = ["scene", "import", scene, "--from", &capture, "--contributors", &contributors];
        self.cairn_ok(&[&import[..], &["--hold-out", "8"], &place].concat())
    }
}

impl Default for Place {
    fn default() -> Self {
        Self::new()
    }
}

/// A daemon of our own.
pub struct Daemon {
    child: Child,
    /// Its address, `http://127.0.0.1:PORT`.
    pub url: String,
}

impl Daemon {
    /// Starts `cairn serve` on a free port; `settings` is TOML over the defaults.
    pub fn start(data: &Path, settings: &str) -> Self {
        Self::start_logging(data, settings, Stdio::inherit())
    }

    /// As [`Daemon::start`], with its standard error somewhere else.
    pub fn start_logging(data: &Path, settings: &str, log: impl Into<Stdio>) -> Self {
        let config = data.with_extension("toml");
        let settings = format!("{settings}\n[server]\nbind = \"127.0.0.1:0\"\nshutdown_grace_s = 1\n");
        std::fs::write(&config, settings).unwrap();
        let mut child = command()
            .args(["serve", "--data", data.to_str().unwrap(), "--config", config.to_str().unwrap()])
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().rsplit(' ').next().unwrap().to_owned();
        assert!(url.contains("://127.0.0.1:"), "the daemon said {line:?}");
        Self { child, url }
    }

    /// Starts a daemon on settings that were written before, and kills it `after` that, however far it came.
    pub fn start_and_kill(data: &Path, after: std::time::Duration) {
        let mut child = command()
            .args(["serve", "--data", data.to_str().unwrap(), "--config"])
            .arg(data.with_extension("toml"))
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(after);
        child.kill().unwrap();
        child.wait().unwrap();
    }

    /// The process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// SIGKILL: no chance to clean up.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// SIGTERM, and the exit status.
    pub fn terminate(mut self) -> std::process::ExitStatus {
        let sent = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        self.child.wait().unwrap()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // Already gone where the test ended it itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A training of `scene` by contributor, both stages.
pub fn training(scene: &str, seed: u64, options: v1::TrainingOptions) -> v1::StartTrainingRequest {
    v1::StartTrainingRequest { base_only: false, ..base_only(scene, seed, options) }
}

/// A training of `scene` by contributor that stops after stage 1.
pub fn base_only(scene: &str, seed: u64, options: v1::TrainingOptions) -> v1::StartTrainingRequest {
    let by_contributor = v1::ByContributor { min_views: 2 };
    v1::StartTrainingRequest {
        scene: scene.into(),
        clusters: Some(v1::start_training_request::Clusters::ByContributor(by_contributor)),
        seed,
        options: Some(options),
        base_only: true,
        ..v1::StartTrainingRequest::default()
    }
}

/// Accepts a training of `scene` in the data folder `data`, which no daemon has, with settings that are no preset's; the
/// job's id. The daemon that opens the folder next trains it.
pub fn accept(data: &Path, scene: &str, settings: TrainingSettings) -> String {
    let engine =
        Engine::open(data, &Config::from_toml("[training]\ncheckpoint_every_s = 0", "test").unwrap(), Opening::Serve)
            .unwrap();
    engine.train(given(scene, settings, false)).unwrap().id
}

/// As [`accept`], trained to its end without a break; `base_only` stops after stage 1.
pub fn train_to_end(data: &Path, scene: &str, settings: TrainingSettings, base_only: bool) {
    let engine = Engine::open(data, &Config::from_toml("", "test").unwrap(), Opening::Serve).unwrap();
    let id = engine.train(given(scene, settings, base_only)).unwrap().id;
    let job = engine.jobs().watch(&id).unwrap();
    while !job.borrow().state.has_ended() {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert_eq!(job.borrow().state, JobState::Done, "{}", job.borrow().error);
}

/// A training by contributor as a program asks for it.
fn given(scene: &str, settings: TrainingSettings, base_only: bool) -> TrainingRequest {
    TrainingRequest {
        scene: scene.into(),
        also: Vec::new(),
        grow: false,
        grouping: Grouping::ByContributor { min_views: 2, direction_weight: 1.0 },
        seed: 7,
        plan: Plan::Given(Box::new(settings)),
        signals: Vec::new(),
        base_only,
        owner: None,
    }
}

/// The settings of the `smoke` quality.
pub fn smoke_settings() -> TrainingSettings {
    preset::settings(Chosen { preset: Preset::Outdoor, quality: Quality::Smoke, robust: false })
}
