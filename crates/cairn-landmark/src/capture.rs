//! Who stands where, and the capture on disk: folders that the ordinary importer
//! reads, so that a demonstration takes the same road as real photographs.

use std::path::{Path, PathBuf};

use cairn_scene::{Camera, CaptureError, Distortion, Fisheye, Intrinsics, Picture, Pose, PoseError};
use glam::{DVec3, Vec2};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde_json::json;
use thiserror::Error;

use crate::config::{ConfigError, LandmarkConfig};
use crate::light::Light;
use crate::people::Person;
use crate::render::{Shot, photograph};

/// Field of view along the longer side of a photograph, degrees.
const FIELD_OF_VIEW_DEG: f64 = 50.0;
/// k1 to k4 of the fisheye, of about the size that action cameras have.
const FISHEYE: [f64; 4] = [-0.03, 0.004, -0.003, 0.0004];

/// Who the photographers are, in order; nobody in particular.
const NAMES: [&str; 16] = [
    "ada", "bela", "chidi", "dara", "emre", "farah", "goro", "hana", "ines", "jonas", "kofi", "lena", "mina", "noor",
    "olek", "pia",
];

/// Why a capture was not made or not written.
#[derive(Debug, Error)]
pub enum LandmarkError {
    /// A setting is out of range.
    #[error("the landmark's setting {0}")]
    Config(#[from] ConfigError),
    /// A camera could not be placed.
    #[error("photograph {name} has no pose: {source}")]
    Pose {
        /// The photograph.
        name: String,
        /// Why.
        source: PoseError,
    },
    /// A photograph could not be saved.
    #[error("cannot save the photograph {name}: {source}")]
    Save {
        /// The photograph.
        name: String,
        /// Why.
        source: Box<CaptureError>,
    },
    /// A file or folder could not be written.
    #[error("cannot write {path}: {source}; check that the folder exists and is yours to write")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// One photograph of the landmark.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkView {
    /// Its path in the capture, such as `images/ada_03.png`; unique, and in
    /// order of name over the capture.
    pub name: String,
    /// Exactly the camera that took it. The scene's z axis points up, the
    /// ground is z = 0, and the landmark stands on the origin, 2.37 units tall.
    pub camera: Camera,
    /// Who took it.
    pub contributor: String,
    /// The photograph, passers-by and all, values in [0, 1].
    pub picture: Picture,
    /// The same photograph without passers-by: what the place looks like.
    pub clean: Picture,
}

/// All photographs of the landmark.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkCapture {
    /// The photographs, contributor by contributor along each one's arc.
    pub views: Vec<LandmarkView>,
}

/// The made-up landmark.
pub struct Landmark;

/// What is drawn for a photograph before anything is rendered.
struct Plan {
    name: String,
    contributor: usize,
    camera: Camera,
    exposure: f32,
    people: Vec<Person>,
}

impl Landmark {
    /// Photographs the landmark: `config.contributors` people walk an arc each
    /// and take `config.photographs`. The same configuration and seed give the
    /// same bytes on any number of threads.
    ///
    /// # Errors
    /// [`LandmarkError::Config`] for a setting out of range.
    pub fn generate(config: &LandmarkConfig, seed: u64) -> Result<LandmarkCapture, LandmarkError> {
        config.check()?;
        let lights: Vec<Light> = (0..config.contributors)
            .map(|i| Light::of(i, arc_centre(config, i) as f32, config.light_variation, &mut generator(seed, i, 0)))
            .collect();
        let plans = (0..config.contributors)
            .flat_map(|i| (0..config.photographs).map(move |k| (i, k)))
            .map(|(i, k)| plan(config, seed, i, k))
            .collect::<Result<Vec<_>, _>>()?;
        let views = plans.into_par_iter().enumerate().map(|(index, plan)| {
            let shot = Shot {
                camera: &plan.camera,
                light: &lights[plan.contributor],
                exposure: plan.exposure,
                people: &plan.people,
                grain_salt: index as u32 + 1000,
            };
            let (picture, clean) = photograph(&shot);
            let contributor = NAMES[plan.contributor].to_owned();
            LandmarkView { name: plan.name, camera: plan.camera, contributor, picture, clean }
        });
        Ok(LandmarkCapture { views: views.collect() })
    }
}

/// A generator of its own for each purpose, so that one more photograph or
/// passer-by leaves all others as they were.
fn generator(seed: u64, contributor: usize, purpose: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((contributor as u64) << 32 | purpose as u64);
    rng
}

/// Where the middle of a contributor's arc lies, radians from the x axis.
fn arc_centre(config: &LandmarkConfig, contributor: usize) -> f64 {
    std::f64::consts::TAU * contributor as f64 / config.contributors as f64
}

fn plan(config: &LandmarkConfig, seed: u64, contributor: usize, index: usize) -> Result<Plan, LandmarkError> {
    let mut rng = generator(seed, contributor, index + 1);
    let name = format!("images/{}_{:03}.png", NAMES[contributor], index + 1);
    let arc = (360.0 / config.contributors as f64 + f64::from(config.overlap_deg)).min(360.0).to_radians();
    let along = (index as f64 + 0.5 + rng.random_range(-0.3..0.3)) / config.photographs as f64 - 0.5;
    let (sin, cos) = (arc_centre(config, contributor) + arc * along).sin_cos();
    let radius = rng.random_range(2.75..3.35);
    let position = DVec3::new(radius * cos, radius * sin, rng.random_range(0.35..0.85));
    let target = DVec3::new(rng.random_range(-0.07..0.07), rng.random_range(-0.07..0.07), rng.random_range(0.94..1.06));
    let pose = Pose::look_at(position, target, DVec3::Z)
        .map_err(|source| LandmarkError::Pose { name: name.clone(), source })?;
    let camera = Camera { intrinsics: intrinsics(config), pose };
    let exposure = 1.0 + config.light_variation * rng.random_range(-0.06..0.06f32);
    let people = if config.passers_by { crowd(position, &mut rng) } else { Vec::new() };
    Ok(Plan { name, contributor, camera, exposure, people })
}

/// A pinhole without distortion whose longer side sees [`FIELD_OF_VIEW_DEG`], or the fisheye that is asked for.
fn intrinsics(config: &LandmarkConfig) -> Intrinsics {
    let (width, height) = (config.width, config.height);
    let (w, h) = (width as f64, height as f64);
    let half = w.max(h) / 2.0;
    let (focal, distortion) = match config.fisheye_deg {
        None => (half / (FIELD_OF_VIEW_DEG.to_radians() / 2.0).tan(), Distortion::default()),
        Some(degrees) => {
            let lens = Fisheye::new(FISHEYE);
            (half / lens.radius(f64::from(degrees).to_radians() / 2.0), lens.into())
        }
    };
    Intrinsics { width, height, fx: focal, fy: focal, cx: w / 2.0, cy: h / 2.0, distortion }
}

/// Nobody in half of the photographs, else one to three people between the
/// camera and the landmark.
fn crowd(camera: DVec3, rng: &mut ChaCha8Rng) -> Vec<Person> {
    if rng.random_bool(0.5) {
        return Vec::new();
    }
    let from = Vec2::new(camera.x as f32, camera.y as f32);
    let ahead = -from.normalize();
    let count = rng.random_range(1..=3);
    let people = (0..count).map(|_| {
        let distance = rng.random_range(1.0..1.75f32).min(from.length() - 1.3);
        let aside = rng.random_range(-0.33..0.33f32) * distance;
        Person::at(from + ahead * distance + ahead.perp() * aside, rng)
    });
    people.collect()
}

impl LandmarkCapture {
    /// The contributors' names, each once, in order.
    pub fn contributors(&self) -> Vec<&str> {
        let mut names: Vec<&str> = self.views.iter().map(|v| v.contributor.as_str()).collect();
        names.dedup();
        names
    }

    /// Writes the capture into `folder` (created where absent): the photographs
    /// under `images/`, `transforms.json` (nerfstudio's form: camera-to-world,
    /// OpenGL axes, intrinsics for each frame) and `contributors.csv`. The clean
    /// pictures stay out: no contributor has them.
    ///
    /// # Errors
    /// [`LandmarkError::Write`] or [`LandmarkError::Save`], naming the file.
    pub fn write(&self, folder: &Path) -> Result<(), LandmarkError> {
        let images = folder.join("images");
        std::fs::create_dir_all(&images).map_err(|source| LandmarkError::Write { path: images.clone(), source })?;
        for view in &self.views {
            cairn_scene::save_png(&folder.join(&view.name), &view.picture)
                .map_err(|e| LandmarkError::Save { name: view.name.clone(), source: Box::new(e) })?;
        }
        let frames: Vec<_> = self.views.iter().map(frame).collect();
        let fisheye = |view: &LandmarkView| matches!(view.camera.intrinsics.distortion, Distortion::Fisheye(_));
        let model = if self.views.iter().any(fisheye) { "OPENCV_FISHEYE" } else { "PINHOLE" };
        // An aabb_scale over 1 says that the scene does not end at a box.
        let document = json!({ "camera_model": model, "aabb_scale": 16, "frames": frames });
        put(folder.join("transforms.json"), format!("{document:#}\n").as_bytes())?;
        put(folder.join("contributors.csv"), self.table().as_bytes())
    }

    /// The table of who took what. Names need no quoting: they are ours.
    fn table(&self) -> String {
        let rows = self.views.iter().map(|v| format!("{},{}\n", v.name, v.contributor));
        std::iter::once("image,contributor\n".to_owned()).chain(rows).collect()
    }
}

fn put(path: PathBuf, bytes: &[u8]) -> Result<(), LandmarkError> {
    std::fs::write(&path, bytes).map_err(|source| LandmarkError::Write { path, source })
}

/// One entry of `transforms.json`. OpenGL's camera has y up and looks along -z.
fn frame(view: &LandmarkView) -> serde_json::Value {
    let (i, pose) = (&view.camera.intrinsics, &view.camera.pose);
    let (x, y, z, p) = (pose.rotation.x_axis, -pose.rotation.y_axis, -pose.rotation.z_axis, pose.position);
    let mut frame = json!({
        "file_path": view.name,
        "w": i.width, "h": i.height, "fl_x": i.fx, "fl_y": i.fy, "cx": i.cx, "cy": i.cy,
        "transform_matrix": [
            [x.x, y.x, z.x, p.x],
            [x.y, y.y, z.y, p.y],
            [x.z, y.z, z.z, p.z],
            [0.0, 0.0, 0.0, 1.0],
        ],
    });
    if let Distortion::Fisheye(lens) = &i.distortion {
        for (name, k) in ["k1", "k2", "k3", "k4"].into_iter().zip(lens.k()) {
            frame[name] = json!(k);
        }
    }
    frame
}
