//! The named presets: every hyper-parameter of a training that differs from its type's default.
//!
//! A preset says how a kind of scene is trained, a quality how long, and `robust` lays marks on top
//! that outlast what happens to pictures. Each value stands here once, with its reason above it;
//! `configs/` holds the same values as files, which a test writes.

use cairn_field::FieldConfig;
use cairn_mark::{OtherColours, Recipe};

use super::training::{Chosen, Preset, Quality, TrainingSettings};

/// A named group of values.
#[derive(Clone, Copy, Debug)]
pub struct Group {
    /// Its name, which is also its file's under `configs/`.
    pub name: &'static str,
    /// What it is for, lines of prose.
    pub about: &'static str,
    /// Puts its values into settings.
    pub apply: fn(&mut TrainingSettings),
    /// What it sets, in its order.
    pub sets: &'static [Set],
}

/// A value that a group sets.
#[derive(Clone, Copy, Debug)]
pub struct Set {
    /// The key's parts, as `["mark", "budget_db"]`.
    pub path: &'static [&'static str],
    /// Why it is set; empty where the key says it.
    pub why: &'static str,
}

/// Declares a [`Group`]: each line is an assignment to a field of [`TrainingSettings`], its reason above it.
/// A value may use what the settings (the name given first) held before.
macro_rules! group {
    ($(#[doc = $about:literal])+ $constant:ident, $name:literal, $settings:ident;
     $($(#[doc = $why:literal])* $($part:ident).+ = $value:expr;)+) => {
        $(#[doc = $about])+
        pub const $constant: Group = Group {
            name: $name,
            about: concat!($($about, "\n"),+),
            apply: |$settings| { $($settings.$($part).+ = $value;)+ },
            sets: &[$(Set { path: &[$(stringify!($part)),+], why: concat!($($why),*) }),+],
        };
    };
}

group! {
    /// Forward-facing captures: all cameras look the same way from about the same place.
    FORWARD, "forward", settings;

    field.voxels = 12_000_000;
    field.voxel_px = 2.2;
    field.levels = 4;
    field.steps = 5000;
    field.learning_rate_density = 0.8;
    /// Few views see each place: neighbours have to agree.
    field.smooth_density = 3e-5;
    field.smooth_colour = 1e-3;
    /// Something lies behind every pixel; haze is met by dropping what hardly shows.
    field.initial_opacity = 0.5;
    field.prune_weight = 0.03;
    /// Two dozen photographs of one place from one side show few colours: what a mark looks like is
    /// learnt from more of what is none.
    mark.others = 2;
    mark.others_colours = OtherColours::Any;
    /// Nor do they show an object on an empty background, and the photographs of others do.
    mark.others_cutout_share = 0.25;
    /// Noise is no mark.
    mark.noisy_share = 0.25;
    /// Photographs of other places get an owner with less confidence; below this, the center crop is read.
    mark.min_confidence = 0.8;
    /// A mark may cover too little of a picture to be read from the whole of it.
    mark.center_crop_confidence = 0.9;
}

group! {
    /// Objects within a box, photographed from all around, with nothing behind them.
    OBJECT, "object", settings;

    field.voxels = 12_000_000;
    field.voxel_px = 2.2;
    field.levels = 4;
    field.steps = 10_000;
    field.learning_rate_density = 0.5;
    /// Thin air to begin with: what stands where is seen through it.
    field.initial_opacity = 0.05;
    /// The known background clears haze away: rays need little drawing together beyond that.
    field.distortion = 0.005;
    /// Renders come within 33 dB of the photographs; a mark of 52.2 dB takes 0.05 dB of that.
    mark.budget_db = 52.2;
    /// A mark as faint as that needs four times the pixels to be read.
    mark.finer = 2;
    mark.longest_side_px = 400;
    /// Photographs leave gaps all around an object, and marks have to be read from there, too.
    mark.view_refresh_steps = 3;
    /// Noise is no mark.
    mark.noisy_share = 0.25;
    /// Pictures of other places get an owner with less confidence; below this, the center crop is read.
    mark.min_confidence = 0.8;
    /// A mark may cover too little of a picture to be read from the whole of it.
    mark.center_crop_confidence = 0.9;
    mark.classifier.channels = vec![12, 16, 32, 64, 64];
    /// From the side an object covers half of the picture that it covers from above.
    mark.classifier.textured_only = true;
}

group! {
    /// Landmarks in the open, photographed by many visitors.
    OUTDOOR, "outdoor", settings;

    /// Passers-by are in one photograph only: let them pull less.
    field.huber = 0.2;
    field.steps = 2500;
    field.voxels = 8_000_000;
    field.voxel_px = 2.2;
    field.levels = 4;
    /// Neighbours have to agree, or each photograph's own light becomes haze before it.
    field.smooth_density = 1e-4;
    field.smooth_colour = 1e-3;
    field.smooth_in_one_light = 0.3;
    /// In the open nothing ends a ray: what there is has to stand in one place, or every
    /// photograph's own sky becomes haze before it.
    field.distortion = 0.03;
    /// The field explains visitors' photographs to some 22 dB, of which a mark of 39.5 dB takes some 0.08 dB.
    /// A fainter mark takes longer to learn and is missed more often.
    mark.budget_db = 39.5;
    /// Views and lights differ much, so marks can be read from everywhere only late. Training ends as soon as they can.
    mark.steps = 2300;
    /// Visitors crowd where a landmark looks best, and marks have to be read from elsewhere, too.
    mark.view_refresh_steps = 4;
    /// Noise is no mark.
    mark.noisy_share = 0.25;
    /// A mark may cover too little of a picture to be read from the whole of it.
    mark.center_crop_confidence = 0.9;
}

group! {
    /// Minutes on a laptop, for trying things out.
    DRAFT, "draft", settings;

    field.steps = 600;
    field.rays_per_step = 4096;
    field.voxels = 6_000_000;
    field.voxel_px = 0.0;
    field.levels = 4;
    mark.steps = 700;
    mark.virtual_views = 10;
    /// View refresh gained the demo's hidden pictures nothing in so few steps (one run).
    mark.view_refresh_steps = 0;
    mark.longest_side_px = 128;
    mark.finer = 1;
    /// Marks that training finds in few steps.
    mark.budget_db = 42.0;
    mark.enough_ssim = 0.96;
    /// The steps are too few to learn what unmarked pictures look like in general, or to read marks
    /// among noise or in parts of pictures.
    mark.others = 1;
    mark.others_colours = OtherColours::Near;
    mark.others_cutout_share = 0.0;
    mark.noisy_share = 0.0;
    mark.min_confidence = 0.0;
    mark.center_crop_confidence = 1.0;
    mark.classifier.channels = vec![16, 32, 64, 64];
}

group! {
    /// Twice the steps and twice the vertices of `balanced`, for a model that is kept for years. Chosen by
    /// mechanism; not measured yet.
    ARCHIVAL, "archival", settings;

    field.steps = settings.field.steps * 2;
    field.voxels = settings.field.voxels * 2;
    field.max_voxels = settings.field.max_voxels * 2;
    /// Twice the vertices make a voxel narrower by the cube root of two.
    field.voxel_px = 1.75;
    mark.steps = settings.mark.steps * 2;
}

group! {
    /// Seconds: for a program's own integration tests and for trying an installation. Good for nothing
    /// else: the picture is a blur, and marks are not read.
    SMOKE, "smoke", settings;

    /// So few steps explain no photograph well enough to find outliers.
    screened = false;
    field.steps = 40;
    field.rays_per_step = 256;
    field.voxels = 4096;
    field.levels = 1;
    mark.steps = 30;
    mark.virtual_views = 1;
    mark.longest_side_px = 64;
    /// A training that never reads its marks fails otherwise.
    mark.classify_until = 10.0;
    mark.classifier.channels = vec![4, 8];
    mark.detector.size = [32, 32];
    mark.detector.channels = vec![4, 8];
}

group! {
    /// Marks that outlast what happens to pictures (JPEG, blur, noise, light, rotation, smaller copies,
    /// 8 bits, half precision of the mark), at a price in the picture. They lie on top of any quality.
    ROBUST, "robust", settings;

    /// What happens to pictures takes longer to learn; training ends earlier where everything is read.
    mark.steps = 2000;
    mark.budget_db = 38.0;
    /// Photographs that the field explains to 26 dB lose a quarter of a dB.
    mark.max_cost_db = 0.5;
    /// Photographs of other places do not look like a strong mark, and a distortion is enough to learn.
    mark.others = 1;
    mark.others_colours = OtherColours::Near;
    mark.others_cutout_share = 0.0;
    /// Noise is among the distortions.
    mark.noisy_share = 0.0;
    /// A distorted mark is read with less confidence.
    mark.min_confidence = 0.0;
    mark.robust.enabled = true;
}

/// All groups but `balanced`, which sets nothing of its own.
pub const GROUPS: [Group; 7] = [FORWARD, OBJECT, OUTDOOR, DRAFT, ARCHIVAL, SMOKE, ROBUST];

/// The settings that a choice stands for. Its preset comes first, its quality over it, `robust` on top;
/// `smoke` has the last word, since it promises seconds.
pub fn settings(chosen: Chosen) -> TrainingSettings {
    let mut settings = TrainingSettings::given(FieldConfig::default(), Recipe::default());
    settings.chosen = Some(chosen);
    let kind = match chosen.preset {
        Preset::Forward => FORWARD,
        Preset::Object => OBJECT,
        Preset::Outdoor => OUTDOOR,
    };
    let robust = chosen.robust.then_some(ROBUST);
    let [second, third] = match chosen.quality {
        Quality::Smoke => [robust, Some(SMOKE)],
        Quality::Draft => [Some(DRAFT), robust],
        Quality::Balanced => [None, robust],
        Quality::Archival => [Some(ARCHIVAL), robust],
    };
    for group in [Some(kind), second, third].into_iter().flatten() {
        (group.apply)(&mut settings);
    }
    settings
}
