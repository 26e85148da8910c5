//! A field woven, held-out views rendered by it, distorted, and read where the camera is known; as work of a process of its own.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use cairn_field::{Field, NamedView, OfPixel, VisibleField};
use cairn_mark::Distortion::{self, Blur, Crop, EightBits, Jpeg, Light, Noise, Rotate, Scale};
use cairn_mark::weave::keys::WeavingSecret;
use cairn_mark::weave::woven::{Looked, Weave, weave};
use cairn_mark::{Evidence, WAYS, threshold};
use cairn_register::Registrar;
use cairn_scene::metrics::psnr_db;
use cairn_scene::{Camera, Picture, encode_png};
use cairn_service::export::sheet::{Tile, contact_sheet};
use cairn_service::query::evaluate::difference;
use cairn_service::query::report::PERFECT_DB;
use cairn_share::{Builder, Photograph, SeenFrom, ShareTable, Sharpness, taught};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

use crate::children::Work;
use crate::contribution::groups::{Deal, contributors};
use crate::file::{read, write};
use crate::progress::Progress;
use crate::registration::follow::follow;
use crate::source::{Opened, Source};

/// Training views that a weaving is judged by.
const LOOKED_AT: usize = 48;
/// Secrets that have woven nothing, under which every picture is read too.
const OTHERS: u64 = 20;
/// The probability of any wrong name that a picture is read with.
pub const WRONG: f64 = 1e-6;
/// How faint marks are, dB.
const PSNR_DB: f64 = 45.0;
/// How many times differences are shown on the sheet.
const TIMES: f32 = 10.0;
/// Its tiles' width and height, px.
const TILE: [usize; 2] = [400, 400];
/// Views on the sheet, at most.
const SHEET_ROWS: usize = 4;

/// What is done to a render before it is read.
pub struct Condition {
    /// What rows call it.
    pub name: &'static str,
    /// What is done, in this order.
    pub chain: &'static [Distortion],
    /// Whether it is shown in the light of another photograph.
    pub in_another_light: bool,
}

const fn of(name: &'static str, chain: &'static [Distortion]) -> Condition {
    Condition { name, chain, in_another_light: false }
}

/// 60 % of the area.
const CROP: Distortion = Crop { kept: 0.774_6, across: 0.2, down: 0.7 };

/// The conditions, in the order of the rows.
pub const CONDITIONS: [Condition; 13] = [
    of("clean", &[EightBits]),
    of("JPEG 90", &[Jpeg { quality: 90 }]),
    of("JPEG 75", &[Jpeg { quality: 75 }]),
    of("JPEG 50", &[Jpeg { quality: 50 }]),
    of("JPEG 30", &[Jpeg { quality: 30 }]),
    of("noise 0.05", &[Noise { sigma: 0.05 }, EightBits]),
    of("blur 2 px", &[Blur { sigma_px: 2.0 }, EightBits]),
    of("crop 60 %", &[CROP, EightBits]),
    of("turn 30 deg", &[Rotate { degrees: 30.0 }, EightBits]),
    of("scale 75 %", &[Scale { factor: 0.75 }, EightBits]),
    of("brightness + 20 %", &[Light { brightness: 1.2, contrast: 1.0 }, EightBits]),
    Condition { in_another_light: true, ..of("another light", &[EightBits]) },
    of(
        "all together",
        &[Rotate { degrees: 30.0 }, CROP, Scale { factor: 0.75 }, Noise { sigma: 0.1 }, Jpeg { quality: 50 }],
    ),
];

/// The work.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ReadBack {
    /// The capture.
    pub source: Source,
    /// Its stored base field.
    pub field: PathBuf,
    /// Whose its photographs are.
    pub deal: Deal,
    /// From which residual on a colour counted less in training.
    pub huber: f64,
    /// Names of views that are not read.
    pub tuned_on: Vec<String>,
    /// Held-out views at most.
    pub max_views: usize,
    /// The seed of the weaving secret, of noise and of other lights.
    pub seed: u64,
    /// The file for a contact sheet.
    pub sheet: PathBuf,
    /// What is shown while it runs.
    pub label: String,
}

/// What came of it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct WasRead {
    /// Contributors with a photograph that the training had.
    pub contributors: usize,
    /// Views that were read.
    pub views: usize,
    /// Vertices on a side of a cell.
    pub side: u32,
    /// Seconds of weaving.
    pub weaving_seconds: f64,
    /// Seconds of reading a clean picture, a view each: registration at the known camera, evidence and scores.
    pub reading_seconds: Vec<f64>,
    /// PSNR of woven renders against the base's by view, dB.
    pub psnr_db: Vec<f64>,
    /// The largest change of a colour of a view, levels, by view.
    pub max_levels: Vec<f64>,
    /// What a view's PSNR against its photograph falls by, dB, by view.
    pub cost_db: Vec<f64>,
    /// The scores, by condition.
    pub scores: Vec<Vec<Scored>>,
    /// Largest scores of unmarked pictures: photographs, base renders, and these as JPEG; a picture each.
    pub unmarked: Vec<f64>,
    /// Scores under secrets that have woven nothing, of all pictures, marked and unmarked: how many, their sum, the sum of
    /// their squares, and the largest.
    pub under_others: Null,
    /// Scores of all of a scene's pictures with all together, added up.
    pub together: Vec<Scored>,
}

/// A contributor's score.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Scored {
    /// Which view, by its number.
    pub view: usize,
    /// Their share of it: coverage by which lots are drawn, from wherever it is seen (power 0).
    pub share: f64,
    /// The best score of all ways.
    pub z: f64,
}

/// Scores that are normal about 0 if all is well.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Null {
    /// How many.
    pub count: u64,
    /// Their sum.
    pub sum: f64,
    /// The sum of their squares.
    pub squares: f64,
    /// The largest.
    pub max: f64,
    /// How many are above the threshold of a picture.
    pub above: u64,
}

impl Null {
    fn add(&mut self, z: f64, from: f64) {
        // No cell of theirs is seen.
        if z == 0.0 {
            return;
        }
        self.count += 1;
        self.sum += z;
        self.squares += z * z;
        self.max = self.max.max(z);
        self.above += u64::from(z > from);
    }

    /// The variance about 0.
    pub fn variance(&self) -> f64 {
        self.squares / self.count.max(1) as f64
    }
}

impl Work for ReadBack {
    const NAME: &'static str = "read-back";
    type Result = WasRead;

    fn label(&self) -> &str {
        &self.label
    }

    fn run(&self) -> anyhow::Result<WasRead> {
        let base = Arc::new(Field::from_bytes(&read(&self.field)?)?.with_stored_colours());
        let opened = self.source.open()?;
        let held_out = opened.held_out().into_iter().filter(|v| !self.tuned_on.iter().any(|t| t == opened.name(*v)));
        let held_out: Vec<usize> = held_out.take(self.max_views).collect();
        anyhow::ensure!(!held_out.is_empty(), "{} holds no view out to read", self.source.folder.display());
        let owners = Owners::of(&opened, self.deal);
        let table = self.table(&base, &opened)?;
        let looked = self.looked(&base, &opened);
        let secret = secret(self.seed);
        let begun = Instant::now();
        let woven = weave(&base, &table, owners.names.clone(), &owners.of_photographs, &secret, &looked, PSNR_DB);
        let woven = woven.context("its views see nothing that a contributor's photographs taught")?;
        let mut was_read = WasRead {
            contributors: owners.names.len(),
            views: held_out.len(),
            side: woven.weave.lots.side,
            weaving_seconds: begun.elapsed().as_secs_f64(),
            scores: vec![Vec::new(); CONDITIONS.len()],
            ..WasRead::default()
        };
        let registrar = Registrar::new(base.clone(), None);
        let reader = Reader { base: &base, weave: &woven.weave, registrar: &registrar, seed: self.seed };
        let mut sheet = Vec::new();
        let mut together: Option<(Evidence, Vec<f64>)> = None;
        let mut progress = Progress::new(&self.label, (held_out.len() * CONDITIONS.len()) as u64);
        for (number, index) in held_out.iter().enumerate() {
            let view = opened.view(*index)?;
            let light = base.fit_appearance(&view.camera, &view.picture)?;
            let [plain, marked] = [&*base, &woven.field].map(|field| field.render(&view.camera, &light).clamped());
            let shares = owners.shares(
                &SeenFrom::new(&table, &*base, view.camera.pose.position, Sharpness::new(0)),
                &base,
                &view.camera,
            );
            was_read.psnr_db.push(psnr_db(&plain, &marked)?.min(PERFECT_DB));
            was_read.cost_db.push(psnr_db(&view.picture, &plain)? - psnr_db(&view.picture, &marked)?);
            let change = plain.rgb().iter().zip(marked.rgb()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            was_read.max_levels.push(f64::from(change) * 255.0);
            if sheet.len() < SHEET_ROWS {
                sheet.push(row(&plain, &marked));
            }
            for (at, condition) in CONDITIONS.iter().enumerate() {
                progress.at((number * CONDITIONS.len() + at) as u64, "");
                let lights = base.appearances();
                let shown = if !condition.in_another_light {
                    marked.clone()
                } else if lights.is_empty() {
                    continue;
                } else {
                    let other = &lights[(self.seed as usize + 7 * number) % lights.len()].1;
                    woven.field.render(&view.camera, other).clamped()
                };
                let noise = self.seed.wrapping_add((number * CONDITIONS.len() + at) as u64);
                let begun = Instant::now();
                let Some(evidence) = reader.evidence(&shown, &view.camera, condition.chain, noise) else { continue };
                let scores = evidence.scores(&woven.weave, &secret);
                if at == 0 {
                    was_read.reading_seconds.push(begun.elapsed().as_secs_f64());
                }
                was_read.scores[at].extend(scored(number, &shares, &scores));
                reader.add_others(&evidence, &mut was_read.under_others);
                if condition.name == "all together" {
                    match &mut together {
                        None => together = Some((evidence, shares.clone())),
                        Some((sum, of)) => {
                            sum.add(&evidence);
                            of.iter_mut().zip(&shares).for_each(|(a, b)| *a += b);
                        }
                    }
                }
            }
            for (picture, chain) in [
                (&view.picture, &[EightBits][..]),
                (&plain, &[EightBits]),
                (&view.picture, &[Jpeg { quality: 50 }]),
                (&plain, &[Jpeg { quality: 50 }]),
            ] {
                let Some(evidence) = reader.evidence(picture, &view.camera, chain, number as u64) else { continue };
                let scores = evidence.scores(&woven.weave, &secret);
                was_read.unmarked.push(scores.as_flattened().iter().copied().fold(f64::MIN, f64::max));
                reader.add_others(&evidence, &mut was_read.under_others);
            }
        }
        drop(progress);
        if let Some((evidence, shares)) = together {
            let shares: Vec<f64> = shares.iter().map(|share| share / held_out.len() as f64).collect();
            was_read.together = scored(0, &shares, &evidence.scores(&woven.weave, &secret)).collect();
        }
        write(&self.sheet, &encode_png(&contact_sheet(&sheet, TILE[0], TILE[1])))?;
        Ok(was_read)
    }
}

/// A weaving secret that is known to everybody: nothing that is woven with it is published.
fn secret(seed: u64) -> WeavingSecret {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    WeavingSecret::new(bytes)
}

impl ReadBack {
    fn table(&self, base: &Field, opened: &Opened) -> anyhow::Result<ShareTable> {
        let mut builder = Builder::new(VisibleField::rows(base));
        let training = opened.training();
        let mut progress = Progress::new(&format!("{}, share table", self.label), training.len() as u64);
        for (done, index) in training.into_iter().enumerate() {
            progress.at(done as u64, "");
            let NamedView { name, view } = opened.view(index)?.named();
            let photograph = Photograph { name: name.clone(), position: view.camera.pose.position };
            builder.add(photograph, &taught(base, &name, &view, self.huber))?;
        }
        builder.finish().context("the share table")
    }

    /// Some training views, evenly taken.
    fn looked(&self, base: &Field, opened: &Opened) -> Vec<Looked> {
        let training = opened.training();
        let count = training.len().min(LOOKED_AT);
        let of = |k: usize| {
            let view = training[k * training.len() / count];
            Looked { camera: opened.camera(view), light: base.appearance_of(opened.name(view)).clone() }
        };
        (0..count).map(of).collect()
    }
}

/// Whose the photographs are.
struct Owners {
    names: Vec<String>,
    /// By the training's photographs, in their order.
    of_photographs: Vec<u16>,
}

impl Owners {
    fn of(opened: &Opened, deal: Deal) -> Self {
        let all = contributors(opened, deal);
        let owner = |view: usize| all.iter().position(|views| views.contains(&view)).expect("a training view is dealt");
        let of_photographs = opened.training().into_iter().map(|view| owner(view) as u16).collect();
        Self { names: (0..all.len()).map(|k| format!("contributor {k}")).collect(), of_photographs }
    }

    /// Each contributor's share of what `camera` sees.
    fn shares(&self, from: &SeenFrom<'_>, base: &Field, camera: &Camera) -> Vec<f64> {
        let of_photographs = from.shares(&base.row_weights(camera, OfPixel::All)).of_photographs;
        let mut shares = vec![0.0; self.names.len()];
        for (owner, share) in self.of_photographs.iter().zip(of_photographs) {
            shares[usize::from(*owner)] += share;
        }
        shares
    }
}

fn scored(view: usize, shares: &[f64], scores: &[[f64; WAYS]]) -> impl Iterator<Item = Scored> {
    let best = |z: &[f64; WAYS]| z.iter().copied().fold(f64::MIN, f64::max);
    shares.iter().zip(scores).map(move |(share, z)| Scored { view, share: *share, z: best(z) })
}

/// Reads pictures whose cameras are known.
struct Reader<'a> {
    base: &'a Field,
    weave: &'a Weave,
    registrar: &'a Registrar,
    seed: u64,
}

impl Reader<'_> {
    /// What `shown`, taken by `camera`, tells once `chain` was done to it.
    fn evidence(&self, shown: &Picture, camera: &Camera, chain: &[Distortion], noise: u64) -> Option<Evidence> {
        let (mut picture, mut camera) = (shown.clone(), *camera);
        for distortion in chain {
            picture = distortion.apply(&picture, noise);
            camera = follow(distortion, &camera);
        }
        let registered = self.registrar.register_at(&picture, &camera)?;
        Some(Evidence::of(self.base, self.weave, &registered))
    }

    /// Adds the scores under secrets that have woven nothing.
    fn add_others(&self, evidence: &Evidence, null: &mut Null) {
        let from = threshold(self.weave.contributors.len() * WAYS, WRONG);
        for k in 1..=OTHERS {
            let scores = evidence.scores(self.weave, &secret(self.seed ^ (k << 32)));
            scores.as_flattened().iter().for_each(|z| null.add(*z, from));
        }
    }
}

/// A row of the sheet: both renders, three times as large, and how they differ.
fn row(plain: &Picture, marked: &Picture) -> Vec<Tile> {
    let cut = |picture: &Picture| {
        let (w, h) = (picture.width() / 3, picture.height() / 3);
        let rgb = (0..w * h).flat_map(|i| picture.pixel(w + i % w, h + i / w)).collect();
        Picture::new(w, h, rgb).expect("a colour a pixel")
    };
    let off = difference(marked, plain, TIMES);
    [
        ("Base, the middle".to_owned(), cut(plain)),
        ("Woven, the middle".to_owned(), cut(marked)),
        (format!("Difference x {TIMES}"), off),
    ]
    .map(|(label, picture)| Tile { picture, label })
    .to_vec()
}
