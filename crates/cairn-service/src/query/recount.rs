//! Shares worked out again from files, for who audits a registry's statement of them: the base field, its share table, the
//! view's camera, and where they are in hand the photographs that the table was made from.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::Path;

use cairn_field::{Field, OfPixel, RowWeights, VisibleField as _};
use cairn_scene::{Camera, SceneFolder};
use cairn_share::{Builder, SeenFrom, ShareError, ShareTable, Shares, Sharpness, taught};
use glam::DVec3;

use crate::config::TrainingSettings;
use crate::error::EngineError;
use crate::query::coverage::sampled;

/// Longest side of a picture whose shares are worked out again, px.
const MAX_SIDE_PX: usize = 65_536;
/// How far a camera of the table may be from the scene's, as a part of its way from the origin: what reading numbers
/// from text does.
const MAX_POSITION_ERROR: f64 = 1e-9;
/// Largest file of settings that is read, bytes.
const MAX_SETTINGS_BYTES: u64 = 1 << 20;

/// A base field and its share table, read from their files.
pub struct Taught {
    field: Field,
    table: ShareTable,
}

/// What some pixels show, worked out again. All parts together are 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Recount {
    /// Each photograph's share, by its view's name, in the table's order.
    pub photographs: Vec<(String, f64)>,
    /// What no photograph shows.
    pub unseen: f64,
    /// What lies behind the field.
    pub behind: f64,
}

/// How the pixels of a picture are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Method {
    /// The power of the angle's cosine.
    pub power: u32,
    /// Pixels across, of the picture that is looked at.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
}

/// A photograph whose camera stands elsewhere in the scene than in the table, capture units.
#[derive(Clone, Debug, PartialEq)]
pub struct Misplaced {
    /// The view's name.
    pub view: String,
    /// Where the table has its camera.
    pub in_table: [f64; 3],
    /// Where the scene has it; `None` without such a view.
    pub in_scene: Option<[f64; 3]>,
}

/// What a photograph taught, in the table and worked out again.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// The view's name.
    pub view: String,
    /// The sum of the table's entries, pixels.
    pub in_table: f64,
    /// The sum of those worked out again, pixels.
    pub again: f64,
    /// What is in one and not in the other, by rows, as a part of the larger sum: 0 to 2.
    pub apart: f64,
}

impl Taught {
    /// Reads a base field and a share table.
    ///
    /// # Errors
    /// For a file that cannot be read or is something else, and a table of another field.
    pub fn read(field: &Path, table: &Path) -> Result<Self, EngineError> {
        let open = |path: &Path| File::open(path).map_err(EngineError::io("open", path));
        let of = |path: &Path, problem: String| EngineError::Stored { path: path.to_path_buf(), problem };
        let field = Field::read_from(&mut open(field)?).map_err(|e| of(field, e.to_string()))?;
        let read = ShareTable::read_from(&mut open(table)?).map_err(|e: ShareError| of(table, e.to_string()))?;
        read.must_be_of(&field)?;
        Ok(Self { field, table: read })
    }

    /// Names of the views whose photographs the table has, in its order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.table.photographs().iter().map(|photograph| photograph.name.as_str())
    }

    /// Whose photographs show what `camera` sees, by this release's method.
    ///
    /// # Errors
    /// As [`method`].
    pub fn shares(&self, camera: &Camera) -> Result<Recount, EngineError> {
        method(camera)?;
        let from = SeenFrom::new(&self.table, &self.field, camera.pose.position, Sharpness::default());
        let seen = self.field.row_weights(&sampled(camera), OfPixel::All);
        let Shares { of_photographs, unseen, behind } = from.shares(&seen);
        let names = self.names().map(str::to_owned);
        Ok(Recount { photographs: names.zip(of_photographs).collect(), unseen, behind })
    }

    /// The photographs of the table whose cameras do not stand where the scene's do: shares go by these places.
    pub fn misplaced(&self, scene: &SceneFolder) -> Vec<Misplaced> {
        let views = scene.capture().views.iter();
        let known: BTreeMap<&str, DVec3> = views.map(|view| (view.name.as_str(), view.camera.pose.position)).collect();
        let mut wrong = Vec::new();
        for photograph in self.table.photographs() {
            let (at, there) = (photograph.position, known.get(photograph.name.as_str()));
            let is_there = |there: &DVec3| at.distance(*there) <= MAX_POSITION_ERROR * at.length().max(there.length());
            if !there.is_some_and(is_there) {
                let in_scene = there.map(DVec3::to_array);
                wrong.push(Misplaced { view: photograph.name.clone(), in_table: at.to_array(), in_scene });
            }
        }
        wrong
    }

    /// What the photographs of these views taught the field, compared with what the scene's own photographs and cameras
    /// say. `huber` is the training's.
    ///
    /// # Errors
    /// [`EngineError::NotFound`] for a photograph that the table or the scene has not; for one that was altered.
    pub fn compare(
        &self,
        scene: &SceneFolder,
        huber: f64,
        names: &BTreeSet<String>,
    ) -> Result<Vec<Compared>, EngineError> {
        let views = &scene.capture().views;
        let mut compared = Vec::new();
        for name in names {
            let number = self.names().position(|known| known == name);
            let number = number.ok_or_else(|| EngineError::not_found("photograph", name, self.names()))?;
            let Some(index) = views.iter().position(|view| view.name == *name) else {
                return Err(EngineError::not_found("view", name, views.iter().map(|view| view.name.as_str())));
            };
            let weights = taught(&self.field, name, &scene.train_view(index)?, huber);
            compared.push(self.compared(number, &weights)?);
        }
        Ok(compared)
    }

    fn compared(&self, number: usize, weights: &RowWeights) -> Result<Compared, EngineError> {
        let photograph = self.table.photographs()[number].clone();
        let view = photograph.name.clone();
        // Through a table of its own, so that it is rounded as the other was.
        let mut builder = Builder::new(self.table.rows());
        builder.add(photograph, weights)?;
        let (stored, again) = (self.table.of_photograph(number), builder.finish()?.of_photograph(0));
        let sum = |rows: &[(u32, f32)]| rows.iter().map(|(_, weight)| f64::from(*weight)).sum::<f64>();
        let (in_table, again_sum) = (sum(&stored), sum(&again));
        let mut apart = 0.0;
        let (mut one, mut other) = (stored.iter().peekable(), again.iter().peekable());
        // Both rise by row.
        loop {
            apart += match (one.peek(), other.peek()) {
                (Some((a, weight)), Some((b, with))) if a == b => {
                    let difference = f64::from((weight - with).abs());
                    one.next();
                    other.next();
                    difference
                }
                (Some((a, weight)), with) if with.is_none_or(|(b, _)| a < b) => {
                    one.next();
                    f64::from(*weight)
                }
                (_, Some((_, weight))) => {
                    other.next();
                    f64::from(*weight)
                }
                (_, None) => break,
            };
        }
        let apart = apart / in_table.max(again_sum).max(f64::MIN_POSITIVE);
        Ok(Compared { view, in_table, again: again_sum, apart })
    }
}

/// How this release looks at what `camera` sees.
///
/// # Errors
/// [`EngineError::Invalid`] for a camera without pixels, with too many, or that stands nowhere.
pub fn method(camera: &Camera) -> Result<Method, EngineError> {
    let i = camera.intrinsics;
    let side = 1..=MAX_SIDE_PX;
    if !side.contains(&i.width) || !side.contains(&i.height) {
        let got = format!("{} x {} px", i.width, i.height);
        return Err(EngineError::invalid("the camera's picture", got, format!("1 to {MAX_SIDE_PX} px each way")));
    }
    let numbers = [i.fx, i.fy, i.cx, i.cy];
    if !camera.pose.position.is_finite()
        || !numbers.iter().all(|number| number.is_finite())
        || i.fx <= 0.0
        || i.fy <= 0.0
    {
        return Err(EngineError::invalid(
            "the camera",
            "numbers that are none",
            "finite numbers, focal lengths above 0",
        ));
    }
    let looked_at = sampled(camera).intrinsics;
    Ok(Method { power: Sharpness::default().power(), width: looked_at.width, height: looked_at.height })
}

/// Where residuals stop to count in full, by a training's settings.
///
/// # Errors
/// For a file that cannot be read or holds no settings.
pub fn huber(settings: &Path) -> Result<f64, EngineError> {
    let bytes = cairn_durable::read_limited(settings, MAX_SETTINGS_BYTES)?;
    let read: Result<TrainingSettings, _> = toml::from_slice(&bytes);
    let settings = read.map_err(|e| EngineError::Stored { path: settings.to_path_buf(), problem: e.to_string() })?;
    Ok(settings.field.huber)
}
