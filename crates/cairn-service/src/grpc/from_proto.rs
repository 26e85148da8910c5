//! From messages to the engine's own types: the only place where a message's
//! fields are believed, and only after they were checked.

use std::path::PathBuf;

use crate::auth::Role;
use cairn_api::v1;
use cairn_field::AppearanceMode;
use cairn_log::{Digest, PublicKey, RegistryError};
use cairn_scene::cluster::{ClusterConfig, Grouping};
use cairn_scene::{
    BrownConrady, Camera, Fisheye, Intrinsics, Pose, SceneKind, Support, Unused, UnusedPhotographs, View,
};
use glam::{DMat3, DVec3};

use crate::config::{PresetChoice, Quality, TrainingOptions};
use crate::error::EngineError;
use crate::export::tour::{PathKind, PathRequest};
use crate::query::coverage::{Asked, Region};
use crate::query::light::Light;
use crate::query::viewpoint::{FieldKind, Viewpoint};
use crate::records::owners::{About as SignedAbout, AskedView};
use crate::store::given::Given;
use crate::store::hidden::Parts;
use crate::store::import::{ImportPlan, PlannedFile, PlannedView};
use crate::train::request::{Plan, TrainingRequest};

/// Longest text field, bytes.
const MAX_TEXT_BYTES: usize = 256;
/// Most views named in one request.
const MAX_VIEW_NAMES: usize = 10_000;
/// Most scenes of one training.
const MAX_SCENES: usize = 16;
/// Cameras wider than this are a broken message, px.
const MAX_CAMERA_SIDE_PX: u32 = 1 << 20;

/// The variant of `$own` that a number of the wire's enum `$wire` names; `None` where it is
/// unspecified.
macro_rules! named {
    ($what:literal, $number:expr, $wire:ident => $own:ident { $($variant:ident),+ }) => {
        match v1::$wire::try_from($number) {
            Ok(v1::$wire::Unspecified) => Ok(None),
            $(Ok(v1::$wire::$variant) => Ok(Some($own::$variant)),)+
            Err(_) => Err(EngineError::invalid($what, $number, ["unset", $(stringify!($variant)),+].join(", "))),
        }
    };
}

fn missing(what: &str) -> EngineError {
    EngineError::invalid(what, "not set", "a value")
}

fn finite(what: &str, value: f64) -> Result<f64, EngineError> {
    if value.is_finite() { Ok(value) } else { Err(EngineError::invalid(what, value, "a finite number")) }
}

fn text(what: &str, value: String) -> Result<String, EngineError> {
    if value.is_empty() || value.len() > MAX_TEXT_BYTES || value.chars().any(char::is_control) {
        let shown: String = value.chars().take(80).collect();
        return Err(EngineError::invalid(what, format!("{shown:?}"), "1 to 256 bytes without control characters"));
    }
    Ok(value)
}

/// Names of views, each once.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn view_names(mut names: Vec<String>) -> Result<Vec<String>, EngineError> {
    names.sort();
    names.dedup();
    if names.is_empty() || names.len() > MAX_VIEW_NAMES {
        return Err(EngineError::invalid("the number of view_names", names.len(), format!("1 to {MAX_VIEW_NAMES}")));
    }
    names.into_iter().map(|name| text("a view's name", name)).collect()
}

/// 32 bytes.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn bytes32(what: &str, bytes: &[u8]) -> Result<[u8; 32], EngineError> {
    bytes.try_into().map_err(|_| EngineError::invalid(what, format!("{} bytes", bytes.len()), "32 bytes"))
}

/// An Ed25519 public key, none of small order.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn public_key(what: &str, bytes: &[u8]) -> Result<PublicKey, EngineError> {
    Ok(PublicKey::from_bytes(&bytes32(what, bytes)?).map_err(RegistryError::from)?)
}

/// What a record is to be signed about.
///
/// # Errors
/// [`EngineError::Invalid`] where it names neither.
pub fn signed_about(of: Option<v1::material_request::Of>) -> Result<SignedAbout, EngineError> {
    use v1::material_request::Of;
    match of {
        Some(Of::Identity(number)) => Ok(SignedAbout::Identity(number)),
        Some(Of::Contributor(name)) => Ok(SignedAbout::Contributor(name)),
        None => Err(EngineError::invalid("of", "nothing", "an identity's number or a contributor's name")),
    }
}

/// Which view a complete answer is about; `None` for the whole scene.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn asked_view(of: Option<v1::answer_request::Of>) -> Result<Option<AskedView>, EngineError> {
    use v1::answer_request::Of;
    Ok(match of {
        None => None,
        Some(Of::ViewName(name)) => Some(AskedView::Named(name)),
        Some(Of::PhotographSha256(digest)) => {
            Some(AskedView::Photograph(Digest::from_bytes(bytes32("photograph_sha256", &digest)?)))
        }
    })
}

/// A role; `None` where none is named.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn role(number: i32) -> Result<Option<Role>, EngineError> {
    named!("role", number, Role => Role { Contributor, Curator, Auditor, Operator })
}

fn intrinsics(what: &str, i: &v1::Intrinsics) -> Result<Intrinsics, EngineError> {
    for (name, side) in [("width", i.width), ("height", i.height)] {
        if side == 0 || side > MAX_CAMERA_SIDE_PX {
            return Err(EngineError::invalid(format!("{what}: {name}"), side, format!("1 to {MAX_CAMERA_SIDE_PX} px")));
        }
    }
    for (name, focal) in [("fx", i.fx), ("fy", i.fy)] {
        if !(focal.is_finite() && focal > 0.0) {
            return Err(EngineError::invalid(format!("{what}: {name}"), focal, "a finite number of px above 0"));
        }
    }
    for (name, value) in [("cx", i.cx), ("cy", i.cy)] {
        finite(&format!("{what}: {name}"), value)?;
    }
    let bent = [("k1", i.k1), ("k2", i.k2), ("k3", i.k3), ("p1", i.p1), ("p2", i.p2)];
    for (name, value) in bent {
        finite(&format!("{what}: {name}"), value)?;
    }
    let distortion = match &i.fisheye {
        None => BrownConrady { k1: i.k1, k2: i.k2, k3: i.k3, p1: i.p1, p2: i.p2 }.into(),
        Some(v1::Fisheye { k1, k2, k3, k4 }) => {
            if let Some((name, value)) = bent.iter().find(|(_, value)| *value != 0.0) {
                let allowed = "0 beside a fisheye, which has coefficients of its own";
                return Err(EngineError::invalid(format!("{what}: {name}"), value, allowed));
            }
            let k = [*k1, *k2, *k3, *k4];
            for (n, value) in (1..).zip(k) {
                finite(&format!("{what}: the fisheye's k{n}"), value)?;
            }
            Fisheye::new(k).into()
        }
    };
    let intrinsics = Intrinsics {
        width: i.width as usize,
        height: i.height as usize,
        fx: i.fx,
        fy: i.fy,
        cx: i.cx,
        cy: i.cy,
        distortion,
    };
    (intrinsics.check_lens())
        .map_err(|e| EngineError::invalid(format!("{what}: the lens"), e, "a fisheye that fills the picture"))?;
    Ok(intrinsics)
}

fn pose(what: &str, p: &v1::Pose) -> Result<Pose, EngineError> {
    let rotation: [f64; 9] = (p.rotation.as_slice().try_into())
        .map_err(|_| EngineError::invalid(format!("{what}: rotation"), format!("{} numbers", p.rotation.len()), "9"))?;
    let position: [f64; 3] = (p.position.as_slice().try_into())
        .map_err(|_| EngineError::invalid(format!("{what}: position"), format!("{} numbers", p.position.len()), "3"))?;
    let rotation = DMat3::from_cols_array(&rotation).transpose();
    Pose::new(rotation, DVec3::from_array(position))
        .map_err(|e| EngineError::invalid(format!("{what}: pose"), e, "a finite position and a rotation"))
}

/// A camera; `what` names it in errors.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn camera(what: &str, camera: Option<&v1::Camera>) -> Result<Camera, EngineError> {
    let camera = camera.ok_or_else(|| missing(what))?;
    let i = camera.intrinsics.as_ref().ok_or_else(|| missing(&format!("{what}: intrinsics")))?;
    let p = camera.pose.as_ref().ok_or_else(|| missing(&format!("{what}: pose")))?;
    Ok(Camera { intrinsics: intrinsics(what, i)?, pose: pose(what, p)? })
}

/// A viewpoint.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn viewpoint(viewpoint: Option<v1::Viewpoint>) -> Result<Viewpoint, EngineError> {
    viewpoint_of("the viewpoint", viewpoint)
}

/// Which place is asked about.
///
/// # Errors
/// As [`viewpoint`].
pub fn asked(request: &v1::ContributorsRequest) -> Result<Asked, EngineError> {
    let region = request.region.map(|v1::Region { left, top, width, height }| {
        let [left, top, width, height] = [left, top, width, height].map(|px| px as usize);
        Region { left, top, width, height }
    });
    let viewpoint = viewpoint(request.viewpoint.clone())?;
    Ok(Asked { region, map: request.map, ..Asked::about(viewpoint) })
}

/// A viewpoint; `what` names it in errors.
fn viewpoint_of(what: &str, viewpoint: Option<v1::Viewpoint>) -> Result<Viewpoint, EngineError> {
    match viewpoint.and_then(|v| v.from).ok_or_else(|| missing(what))? {
        v1::viewpoint::From::ViewName(name) => Ok(Viewpoint::View(name)),
        v1::viewpoint::From::Camera(c) => Ok(Viewpoint::Camera(camera(&format!("{what}'s camera"), Some(&c))?)),
    }
}

/// A scene kind.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn scene_kind(kind: i32) -> Result<SceneKind, EngineError> {
    let named = named!("the scene's kind", kind, SceneKind => SceneKind { ForwardFacing, Bounded, Unbounded })?;
    let allowed = "forward facing (1), bounded (2) or unbounded (3)";
    named.ok_or_else(|| EngineError::invalid("the scene's kind", kind, allowed))
}

/// An import's header.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn import_plan(header: v1::ImportHeader) -> Result<ImportPlan, EngineError> {
    let background = match header.background.as_slice() {
        [] => None,
        [r, g, b] if [r, g, b].iter().all(|v| (0.0..=1.0).contains(*v)) => Some([*r, *g, *b]),
        other => {
            return Err(EngineError::invalid("the background", format!("{other:?}"), "none, or 3 numbers, 0 to 1"));
        }
    };
    let views = header.views.into_iter().map(planned_view).collect::<Result<_, _>>()?;
    let listed = unused_photographs("listed", header.listed)?;
    if let Some(row) = listed.iter().find(|row| !matches!(row.why, Unused::NoCamera | Unused::Missing)) {
        let what = format!("listed: the reason for the photographs of {}", row.contributor);
        return Err(EngineError::invalid(what, row.why.words(), "NO_CAMERA (4) or MISSING (5)"));
    }
    Ok(ImportPlan { scene: header.scene, kind: scene_kind(header.kind)?, background, views, listed })
}

/// Photographs that teach nothing; `what` names them in errors.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn unused_photographs(what: &str, rows: Vec<v1::UnusedPhotographs>) -> Result<Vec<UnusedPhotographs>, EngineError> {
    let of = |row: v1::UnusedPhotographs| {
        let why = named!("why", row.why, Unused => Unused { HeldOut, Excluded, Masked, NoCamera, Missing })?;
        let why = why.ok_or_else(|| missing(&format!("{what}: why")))?;
        let contributor = text(&format!("{what}: contributor"), row.contributor)?;
        match row.photographs as usize {
            0 => Err(EngineError::invalid(format!("{what}: photographs of {contributor}"), 0, "1 or more")),
            photographs => Ok(UnusedPhotographs { contributor, why, photographs }),
        }
    };
    rows.into_iter().map(of).collect()
}

/// Points of the surface.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn points(chunk: &v1::PointChunk) -> Result<Vec<DVec3>, EngineError> {
    let (points, rest) = chunk.xyz.as_chunks::<3>();
    if !rest.is_empty() {
        return Err(EngineError::invalid("the points' numbers", chunk.xyz.len(), "a multiple of 3"));
    }
    let points: Vec<DVec3> = points.iter().map(|p| DVec3::from_array(*p)).collect();
    match points.iter().find(|p| !p.is_finite()) {
        Some(point) => Err(EngineError::invalid("a point", point, "finite coordinates")),
        None => Ok(points),
    }
}

fn planned_view(view: v1::ImportView) -> Result<PlannedView, EngineError> {
    let name = text("a view's name", view.name)?;
    let (near, far) = (view.near, view.far);
    let bounds = match (near, far) {
        (0.0, 0.0) => None,
        _ if near.is_finite() && far.is_finite() && near > 0.0 && far > near => Some((near, far)),
        _ => {
            let got = format!("{near} to {far}");
            return Err(EngineError::invalid(format!("view {name}: near and far"), got, "0 and 0, or 0 < near < far"));
        }
    };
    let mask = match view.mask_bytes {
        0 if view.mask_sha256.is_empty() => None,
        0 => return Err(EngineError::invalid(format!("view {name}: mask_bytes"), 0, "1 or more for a mask")),
        bytes => {
            let sha256 = bytes32(&format!("view {name}: mask_sha256"), &view.mask_sha256)?;
            Some(PlannedFile { bytes, sha256 })
        }
    };
    let support = view.support.map(|s| Support { points: s.points, reprojection_error_px: s.reprojection_error_px });
    if let Some(Support { reprojection_error_px: error, .. }) = support
        && !(error.is_finite() && error >= 0.0)
    {
        let what = format!("view {name}: reprojection_error_px");
        return Err(EngineError::invalid(what, error, "a finite number, at least 0"));
    }
    let photograph = PlannedFile {
        bytes: view.photograph_bytes,
        sha256: bytes32(&format!("view {name}: photograph_sha256"), &view.photograph_sha256)?,
    };
    let view = View {
        camera: camera(&format!("view {name}: camera"), view.camera.as_ref())?,
        contributor: text(&format!("view {name}: contributor"), view.contributor)?,
        contributor_key: match view.contributor_key.is_empty() {
            true => None,
            false => Some(bytes32(&format!("view {name}: contributor_key"), &view.contributor_key)?),
        },
        photograph: PathBuf::new(),
        as_stored: view.as_stored,
        mask: None,
        held_out: view.held_out,
        bounds,
        support,
        name,
    };
    Ok(PlannedView { view, photograph, mask })
}

/// What to train.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn training(request: v1::StartTrainingRequest) -> Result<TrainingRequest, EngineError> {
    use v1::start_training_request::Clusters;
    let grouping = match request.clusters.ok_or_else(|| missing("clusters"))? {
        Clusters::ByAnchors(a) => by_anchors(&a)?,
        Clusters::ByContributor(c) => by_contributor(&c),
    };
    if request.also.len() >= MAX_SCENES {
        let got = format!("{} scenes beside the first", request.also.len());
        return Err(EngineError::invalid("also", got, format!("fewer than {MAX_SCENES}")));
    }
    Ok(TrainingRequest {
        scene: request.scene,
        also: request.also,
        grow: request.grow,
        grouping,
        seed: request.seed,
        plan: Plan::Options(options(request.options.unwrap_or_default())?),
        signals: request.signals.into_iter().map(signal).collect::<Result<_, _>>()?,
        base_only: request.base_only,
        owner: None,
    })
}

/// What a request says of its training; what is not there is the daemon's to say.
fn options(options: v1::TrainingOptions) -> Result<TrainingOptions, EngineError> {
    let o = &options;
    Ok(TrainingOptions {
        preset: named!("options.preset", o.preset, Preset => PresetChoice { Auto, Forward, Object, Outdoor })?,
        quality: named!("options.quality", o.quality, Quality => Quality { Smoke, Draft, Balanced, Archival })?,
        robust: options.robust,
        max_voxels: options.max_voxels.map(|voxels| usize::try_from(voxels).unwrap_or(usize::MAX)),
        appearance: named!("options.appearance", o.appearance, AppearanceMode => AppearanceMode { Auto, On, Off })?,
        payload_picture_px: options.payload_picture_px.map(|px| px as usize),
        payload_sound_s: options.payload_sound_s,
        payload_sound_hz: options.payload_sound_hz,
        payload_text_bytes: options.payload_text_bytes.map(|bytes| bytes as usize),
    })
}

/// What an identity is to hide; a field that is not there is empty on the wire.
fn signal(signal: v1::Signal) -> Result<Given, EngineError> {
    let some = |bytes: Vec<u8>| (!bytes.is_empty()).then_some(bytes);
    let name = match signal.name {
        none if none.is_empty() => none,
        name => text("a signal's name", name)?,
    };
    let parts = Parts {
        picture: some(signal.picture.to_vec()),
        audio: some(signal.audio.to_vec()),
        text: some(signal.text.into_bytes()),
    };
    Ok(Given { name, parts })
}

/// Clusters around anchors.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn by_anchors(a: &v1::ByAnchors) -> Result<Grouping, EngineError> {
    if !(1..=64).contains(&a.anchors) {
        return Err(EngineError::invalid("anchors", a.anchors, "1 to 64"));
    }
    if a.neighbours > 1000 {
        return Err(EngineError::invalid("neighbours", a.neighbours, "1 to 1000, or 0 for as many as there are"));
    }
    let (anchors, neighbours) = (a.anchors as usize, a.neighbours as usize);
    let direction_weight = ClusterConfig::default().direction_weight;
    Ok(Grouping::Anchors(ClusterConfig { anchors, neighbours, direction_weight }))
}

/// One cluster a contributor.
pub fn by_contributor(c: &v1::ByContributor) -> Grouping {
    let direction_weight = ClusterConfig::default().direction_weight;
    Grouping::ByContributor { min_views: c.min_views as usize, direction_weight }
}

/// Clusters to draw, and the seed they are made with; `None` for the model's.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn drawn_clusters(request: &v1::DrawPosesRequest) -> Result<Option<(Grouping, u64)>, EngineError> {
    use v1::draw_poses_request::Clusters;
    let grouping = match &request.clusters {
        None => return Ok(None),
        Some(Clusters::ByAnchors(a)) => by_anchors(a)?,
        Some(Clusters::ByContributor(c)) => by_contributor(c),
    };
    Ok(Some((grouping, request.seed)))
}

/// Whether a drawing is wanted as SVG, and not as PNG.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn is_svg(format: i32) -> Result<bool, EngineError> {
    match v1::DrawingFormat::try_from(format) {
        Ok(v1::DrawingFormat::Svg) => Ok(true),
        Ok(v1::DrawingFormat::Png | v1::DrawingFormat::Unspecified) => Ok(false),
        Err(_) => Err(EngineError::invalid("the drawing's format", format, "PNG (1) or SVG (2)")),
    }
}

/// A camera path.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn path(request: v1::RenderPathRequest) -> Result<PathRequest, EngineError> {
    use v1::render_path_request::Path;
    let kind = match request.path.ok_or_else(|| missing("the path"))? {
        Path::Orbit(o) => {
            let arc_deg = if o.arc_deg == 0.0 { 360.0 } else { o.arc_deg };
            if !(arc_deg > 0.0 && arc_deg <= 360.0) {
                return Err(EngineError::invalid("the orbit's arc_deg", arc_deg, "above 0, to 360"));
            }
            PathKind::Orbit { arc_deg }
        }
        Path::Spiral(_) => PathKind::Spiral,
        Path::Between(b) => PathKind::Between(b.from_view, b.to_view),
    };
    let set = |appearance: Option<v1::Appearance>| match appearance.filter(|a| a.choice.is_some()) {
        None => Ok(None),
        some => light(some).map(Some),
    };
    Ok(PathRequest {
        scene: request.scene,
        kind,
        frames: request.frames as usize,
        size: (request.width as usize, request.height as usize),
        field: field_kind(request.field)?,
        light: set(request.appearance)?,
        light_to: set(request.appearance_to)?,
    })
}

/// Which field.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn field_kind(kind: i32) -> Result<FieldKind, EngineError> {
    Ok(named!("field", kind, FieldKind => FieldKind { Marked, Base })?.unwrap_or(FieldKind::Marked))
}

/// In whose light.
///
/// # Errors
/// [`EngineError::Invalid`] with the field, what it is and what is allowed.
pub fn light(appearance: Option<v1::Appearance>) -> Result<Light, EngineError> {
    use v1::appearance::Choice;
    Ok(match appearance.and_then(|a| a.choice) {
        None | Some(Choice::Neutral(_)) => Light::Neutral,
        Some(Choice::ViewName(name)) => Light::View(name),
        Some(Choice::Blend(b)) => {
            if !(0.0..=1.0).contains(&b.share) {
                return Err(EngineError::invalid("the appearance's share", b.share, "0 to 1"));
            }
            Light::Blend(b.from_view, b.to_view, b.share)
        }
        Some(Choice::Photograph(p)) => {
            if p.photograph.is_empty() {
                return Err(missing("the appearance's photograph"));
            }
            let taken = viewpoint_of("the viewpoint of the appearance's photograph", p.viewpoint)?;
            Light::Photograph(p.photograph.into(), taken)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grpc::to_proto;

    fn good() -> v1::Camera {
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y).unwrap();
        let distortion = BrownConrady { k1: 0.1, k2: 0.2, k3: 0.3, p1: 0.4, p2: 0.5 }.into();
        let intrinsics = Intrinsics { width: 8, height: 6, fx: 7.0, fy: 5.0, cx: 4.0, cy: 3.0, distortion };
        to_proto::camera(&Camera { intrinsics, pose })
    }

    fn fisheye(k: [f64; 4]) -> v1::Camera {
        let mut camera = good();
        let i = camera.intrinsics.as_mut().unwrap();
        (i.k1, i.k2, i.k3, i.p1, i.p2) = (0.0, 0.0, 0.0, 0.0, 0.0);
        i.fisheye = Some(v1::Fisheye { k1: k[0], k2: k[1], k3: k[2], k4: k[3] });
        camera
    }

    #[test]
    fn a_fisheye_comes_back_as_it_went() {
        let k = [-0.03, 0.004, -0.003, 0.0004];
        let read = camera("c", Some(&fisheye(k))).unwrap();
        assert_eq!(read.intrinsics.distortion, Fisheye::new(k).into());
        assert_eq!(to_proto::camera(&read).intrinsics, fisheye(k).intrinsics);
        // One whose coefficients are all 0 is no pinhole.
        let ideal = camera("c", Some(&fisheye([0.0; 4]))).unwrap();
        assert_eq!(ideal.intrinsics.distortion, Fisheye::new([0.0; 4]).into());
        assert_eq!(to_proto::camera(&ideal).intrinsics, fisheye([0.0; 4]).intrinsics);
    }

    #[test]
    fn bad_fisheyes_are_refused_by_name() {
        let refused = |c: &v1::Camera| camera("view a: camera", Some(c)).unwrap_err().to_string();
        let mut both = fisheye([0.1, 0.0, 0.0, 0.0]);
        both.intrinsics.as_mut().unwrap().p1 = 0.01;
        assert!(
            refused(&both).contains("view a: camera: p1 is 0.01; allowed is 0 beside a fisheye"),
            "{}",
            refused(&both)
        );
        let unknown = refused(&fisheye([0.0, 0.0, 0.0, f64::INFINITY]));
        assert!(unknown.contains("the fisheye's k4 is inf"), "{unknown}");
        let turns = refused(&fisheye([-1.0, 0.0, 0.0, 0.0]));
        assert!(turns.contains("view a: camera: the lens") && turns.contains("turns back"), "{turns}");
        let mut wide = fisheye([0.0; 4]);
        (wide.intrinsics.as_mut().unwrap().fx, wide.intrinsics.as_mut().unwrap().fy) = (1.0, 1.0);
        assert!(refused(&wide).contains("ends 180.0 degrees"), "{}", refused(&wide));
    }

    #[test]
    fn a_camera_comes_back_as_it_went() {
        let read = camera("c", Some(&good())).unwrap();
        let again = camera("c", Some(&to_proto::camera(&read))).unwrap();
        assert!((read.pose.position - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        assert_eq!(read.intrinsics, again.intrinsics);
        let difference = read.pose.rotation - again.pose.rotation;
        assert!(difference.to_cols_array().iter().all(|v| v.abs() < 1e-12));
        assert_eq!(read.intrinsics.distortion, BrownConrady { k1: 0.1, k2: 0.2, k3: 0.3, p1: 0.4, p2: 0.5 }.into());
    }

    #[test]
    fn bad_cameras_are_refused_by_name() {
        let change = |f: fn(&mut v1::Camera)| {
            let mut c = good();
            f(&mut c);
            camera("view a: camera", Some(&c)).unwrap_err().to_string()
        };
        assert!(change(|c| c.intrinsics.as_mut().unwrap().width = 0).contains("width is 0"));
        assert!(change(|c| c.intrinsics.as_mut().unwrap().fx = f64::NAN).contains("fx is NaN"));
        assert!(change(|c| c.pose.as_mut().unwrap().rotation[0] = 5.0).contains("pose"));
        assert!(change(|c| c.pose.as_mut().unwrap().rotation.truncate(8)).contains("8 numbers"));
        assert!(change(|c| c.pose = None).contains("not set"));
    }

    #[test]
    fn lights_are_refused_by_what_is_wrong_with_them() {
        use v1::appearance::Choice;
        let of = |choice| light(Some(v1::Appearance { choice: Some(choice) })).map_err(|e| e.to_string());
        let blend = |share| {
            let (from_view, to_view) = ("a".into(), "b".into());
            of(Choice::Blend(v1::AppearanceBlend { from_view, to_view, share }))
        };
        for share in [0.0, 0.25, 1.0] {
            assert!(matches!(blend(share), Ok(Light::Blend(_, _, s)) if s == share), "{share}");
        }
        for share in [-1e-9, 1.0 + 1e-12, f64::NAN, f64::INFINITY] {
            assert_eq!(blend(share).unwrap_err(), format!("the appearance's share is {share}; allowed is 0 to 1"));
        }
        let camera = |camera| Some(v1::Viewpoint { from: Some(v1::viewpoint::From::Camera(camera)) });
        let photograph = |bytes: Vec<u8>, viewpoint| {
            of(Choice::Photograph(v1::PhotographAppearance { photograph: bytes.into(), viewpoint }))
        };
        assert!(
            matches!(photograph(vec![7], camera(good())), Ok(Light::Photograph(b, Viewpoint::Camera(_))) if b == [7])
        );
        let poseless = v1::Camera { pose: None, ..good() };
        for (bytes, viewpoint, says) in [
            (vec![], camera(good()), "the appearance's photograph is not set"),
            (vec![7], None, "the viewpoint of the appearance's photograph is not set"),
            (vec![7], camera(poseless), "the viewpoint of the appearance's photograph's camera: pose is not set"),
        ] {
            let refused = photograph(bytes, viewpoint).unwrap_err();
            assert!(refused.starts_with(says), "{refused}");
        }
    }

    #[test]
    fn signals_keep_their_names_and_order() {
        let by = v1::start_training_request::Clusters::ByContributor(v1::ByContributor { min_views: 2 });
        let of = |name: &str| v1::Signal { name: name.into(), text: "t".into(), ..v1::Signal::default() };
        let asked = |names: &[&str]| {
            let signals = names.iter().map(|name| of(name)).collect();
            training(v1::StartTrainingRequest { clusters: Some(by), signals, ..Default::default() })
        };
        let wanted = asked(&["drone-2", ""]).unwrap();
        assert_eq!(wanted.signals.iter().map(|g| g.name.as_str()).collect::<Vec<_>>(), ["drone-2", ""]);
        assert_eq!(wanted.signals[0].parts.text.as_deref(), Some(&b"t"[..]));
        let refused = asked(&["a\nb"]).unwrap_err().to_string();
        assert!(refused.contains("a signal's name"), "{refused}");
    }
}
