//! From the engine's own types to messages. Nothing here can fail.

use cairn_api::v1;
use cairn_log::{Envelope, LogEntry, OwnerRecord, RecordKind};
use cairn_register::NotLocated;
use cairn_scene::{BrownConrady, Camera, Distortion, SceneFolder, SceneKind, Unused, UnusedPhotographs, encode_png};
use tonic::codegen::Bytes;

use crate::auth::{Account, Limits, Role, Standing as AccountStanding};
use crate::query::check::{Checked, CheckedView, Whereabouts};
use crate::query::coverage::{ContributorShare, Contributors};
use crate::query::locate::{Compared, FoundCamera};
use crate::query::look::{Identified, Who};
use crate::query::necessity::{Cost, Needed, Said};
use crate::records::corrections::Standing;
use crate::records::credits::Crediting;
use crate::store::classes::{Elsewhere, Registered};
use crate::store::exclusions::{Entries, Entry, State};
use crate::store::hidden::encoded;
use crate::store::model::{IdentityInfo, MarkInfo, ModelInfo};
use crate::train::job::{Job, JobState};

/// The variant of the wire's enum `$wire` that is called as one of ours is.
macro_rules! of_wire {
    ($value:expr, $own:ident => $wire:ident { $($variant:ident),+ }) => {
        match $value {
            $($own::$variant => v1::$wire::$variant,)+
        }
    };
}

/// A camera.
pub fn camera(camera: &Camera) -> v1::Camera {
    let i = &camera.intrinsics;
    let (BrownConrady { k1, k2, k3, p1, p2 }, fisheye) = match &i.distortion {
        Distortion::Pinhole(bent) => (*bent, None),
        Distortion::Fisheye(lens) => {
            let [k1, k2, k3, k4] = lens.k();
            (BrownConrady::default(), Some(v1::Fisheye { k1, k2, k3, k4 }))
        }
    };
    v1::Camera {
        intrinsics: Some(v1::Intrinsics {
            width: i.width as u32,
            height: i.height as u32,
            fx: i.fx,
            fy: i.fy,
            cx: i.cx,
            cy: i.cy,
            k1,
            k2,
            k3,
            p1,
            p2,
            fisheye,
        }),
        pose: Some(v1::Pose {
            rotation: camera.pose.rotation.transpose().to_cols_array().to_vec(),
            position: camera.pose.position.to_array().to_vec(),
        }),
    }
}

/// What later records say of one.
pub fn standing(standing: Standing, confirmed_by: Option<u64>) -> v1::Standing {
    let Standing { replaced_by, taken_back_by, disputed_by, key_ended_by, key_rotated } = standing;
    v1::Standing { replaced_by, taken_back_by, disputed_by, key_ended_by, key_rotated, confirmed_by }
}

/// A scene kind.
pub fn scene_kind(kind: SceneKind) -> v1::SceneKind {
    of_wire!(kind, SceneKind => SceneKind { ForwardFacing, Bounded, Unbounded })
}

/// A scene in one line.
pub fn scene_summary(name: &str, scene: &SceneFolder, trained: bool) -> v1::SceneSummary {
    let capture = scene.capture();
    let mut contributors: Vec<&str> = capture.views.iter().map(|v| v.contributor.as_str()).collect();
    contributors.sort_unstable();
    contributors.dedup();
    let size = |v: &cairn_scene::View| capture.root.join(&v.photograph).metadata().map_or(0, |m| m.len());
    v1::SceneSummary {
        name: name.to_owned(),
        views: capture.views.len() as u32,
        held_out_views: capture.held_out().count() as u32,
        contributors: contributors.len() as u32,
        photograph_bytes: capture.views.iter().map(size).sum(),
        trained,
        kind: scene_kind(capture.kind).into(),
        background: capture.background.map(Vec::from).unwrap_or_default(),
    }
}

/// Why a photograph teaches nothing.
pub fn unused(why: Unused) -> v1::Unused {
    of_wire!(why, Unused => Unused { HeldOut, Excluded, Masked, NoCamera, Missing })
}

/// Photographs that teach nothing.
pub fn unused_photographs(all: &[UnusedPhotographs]) -> Vec<v1::UnusedPhotographs> {
    let of = |row: &UnusedPhotographs| v1::UnusedPhotographs {
        contributor: row.contributor.clone(),
        why: unused(row.why).into(),
        photographs: row.photographs as u32,
    };
    all.iter().map(of).collect()
}

/// A scene's views, with what was decided about them.
pub fn scene_views(scene: &SceneFolder, entries: &Entries) -> Vec<v1::SceneView> {
    let of = |(index, view): (usize, &cairn_scene::View)| v1::SceneView {
        name: view.name.clone(),
        camera: Some(camera(&view.camera)),
        contributor: view.contributor.clone(),
        contributor_key: view.contributor_key.map(|key| key.to_vec()).unwrap_or_default().into(),
        photograph_sha256: scene.photograph_digest(index).to_vec().into(),
        held_out: view.held_out,
        decision: entries.views.iter().find(|e| e.view == view.name).map(decision),
    };
    scene.capture().views.iter().enumerate().map(of).collect()
}

/// What was decided about a view.
fn decision(entry: &Entry) -> v1::ViewDecision {
    v1::ViewDecision {
        excluded: entry.state == State::Excluded,
        automatic: entry.automatic,
        why: entry.why.clone(),
        by: entry.by.map(|id| id.as_bytes().to_vec()).unwrap_or_default().into(),
        unix_s: entry.unix_s,
    }
}

/// Where a photograph is found among the others' places.
fn whereabouts(found: Whereabouts) -> v1::Whereabouts {
    use v1::whereabouts::Answer;
    let answer = match found {
        Whereabouts::Found { off_px, uncertainty_px } => Answer::Off(v1::OffCamera { off_px, uncertainty_px }),
        Whereabouts::NotFound(why) => Answer::NotFound(why.to_string()),
    };
    v1::Whereabouts { answer: Some(answer) }
}

/// What is known of a scene's views.
pub fn checked(scene: &SceneFolder, checked: Checked) -> v1::CheckSceneResponse {
    let view = |view: CheckedView| {
        let known = &scene.capture().views[view.index];
        v1::CheckedView {
            view_name: known.name.clone(),
            contributor: known.contributor.clone(),
            held_out: known.held_out,
            fit: view.score.map(|s| v1::ViewFit { score: s.score, fit_db: s.fit_db, outlier: s.is_outlier }),
            support: view
                .support
                .map(|s| v1::Support { points: s.points, reprojection_error_px: s.reprojection_error_px }),
            against: view.against.unwrap_or_default(),
            decision: view.decision.as_ref().map(decision),
            found: view.found.map(whereabouts),
        }
    };
    let (median_fit_db, limit_fit_db, doubt) =
        checked.measured.map(|m| (m.median_db, m.limit_db, m.doubt)).unwrap_or_default();
    v1::CheckSceneResponse {
        views: checked.views.into_iter().map(view).collect(),
        median_fit_db,
        limit_fit_db,
        doubt,
        picture_png: checked.picture.map(|p| encode_png(&p)).unwrap_or_default().into(),
    }
}

/// A model.
pub fn model(info: &ModelInfo) -> v1::Model {
    let digest = |d: &cairn_log::Digest| -> Bytes { d.as_bytes().to_vec().into() };
    let of_mark = |f: fn(&MarkInfo) -> &cairn_log::Digest| info.mark.as_ref().map(|m| digest(f(m))).unwrap_or_default();
    let identity = |i: &IdentityInfo| {
        let signals = info.mark.as_ref().map(|m| m.signals.as_slice()).unwrap_or_default();
        let hidden = (i.number as usize).checked_sub(1).and_then(|at| signals.get(at)).map(|parts| parts.map(digest));
        let hidden = hidden.unwrap_or_default();
        v1::Identity {
            number: i.number,
            label: i.label.clone(),
            view_names: i.views.clone(),
            signal_sha256: hidden.picture.unwrap_or_default(),
            audio_sha256: hidden.audio.unwrap_or_default(),
            text_sha256: hidden.text.unwrap_or_default(),
            photograph_sha256: i.photographs.iter().map(digest).collect(),
        }
    };
    v1::Model {
        job_id: info.job.clone(),
        // Written by this program from a u64; 0 could only be read from a file altered by hand.
        seed: info.seed.parse().unwrap_or(0),
        identities: info.identities.iter().map(identity).collect(),
        base_field_sha256: digest(&info.base_field),
        marked_field_sha256: of_mark(|m| &m.marked_field),
        detector_sha256: of_mark(|m| &m.detector),
        settings_sha256: digest(&info.settings),
        share_table_sha256: digest(&info.share_table),
        without_share: unused_photographs(&info.without_share),
    }
}

/// A job.
pub fn job(job: &Job) -> v1::Job {
    let p = &job.progress;
    v1::Job {
        id: job.id.clone(),
        scene: job.spec.scene.clone(),
        state: of_wire!(job.state, JobState => JobState { Accepted, Running, Done, Failed, Cancelled, Interrupted })
            .into(),
        progress: Some(v1::Progress {
            stage: p.stage.clone(),
            step: p.step,
            total: p.total,
            loss: p.loss,
            psnr_db: p.psnr_db,
            seconds_left: p.seconds_left,
        }),
        error: job.error.clone(),
        accepted_unix_s: job.accepted_unix_s,
        ended_unix_s: job.ended_unix_s,
        seed: job.spec.seed,
        stages: (job.stages.iter()).map(|s| v1::StageSeconds { stage: s.stage.clone(), seconds: s.seconds }).collect(),
        also: job.spec.also.iter().map(|beside| beside.scene.clone()).collect(),
        notes: job.notes.clone(),
    }
}

/// The identity that was found, if one was.
fn found_identity(who: Who) -> Option<v1::FoundIdentity> {
    let (number, label) = who.identity?;
    let of = |(name, photographs)| v1::ClusterContributor { name, photographs: photographs as u32 };
    let contributors = who.contributors.into_iter().map(of).collect();
    Some(v1::FoundIdentity { number, label, record_indices: who.records, contributors })
}

/// Who contributed to a place.
pub fn contributors(mark: Who, found: Contributors) -> v1::ContributorsResponse {
    use v1::contributors_response::Answer;
    let Contributors { shares, excluded, unseen, behind, photographed_by, view_unused, map } = found;
    let confidence = mark.confidence;
    let answer = found_identity(mark).map_or(Answer::Unmarked(v1::Unmarked {}), Answer::Identity);
    let photograph = |(view_name, share)| v1::PhotographShare { view_name, share };
    let record = |Crediting { index, confirmed }| v1::CreditingRecord { index, confirmed };
    let share = |ContributorShare { name, share, photographs, credits }| {
        let photographs = photographs.into_iter().map(photograph).collect();
        let (records, may_be_more) = (credits.records.into_iter().map(record).collect(), credits.may_be_more);
        v1::ContributorShare { name, share, photographs, records, more_records: may_be_more }
    };
    v1::ContributorsResponse {
        answer: Some(answer),
        confidence,
        contributors: shares.into_iter().map(share).collect(),
        excluded,
        unseen,
        behind,
        photographed_by: photographed_by.unwrap_or_default(),
        view_unused: view_unused.map_or(v1::Unused::Unspecified, unused).into(),
        map_png: map.map(|map| encode_png(&map)).unwrap_or_default().into(),
    }
}

/// What is said while necessity is worked out.
pub fn necessity(said: Said) -> v1::NecessityResponse {
    use v1::necessity_response::What;
    let contributor = |Needed { name, share, change }| v1::NeededContributor { name, share, change };
    let what = match said {
        Said::Cost(Cost { contributors, photographs, bytes, seconds }) => What::Cost(v1::NecessityCost {
            contributors: contributors as u32,
            photographs: photographs as u32,
            bytes,
            seconds,
        }),
        Said::Progress { done, seconds_left } => What::Progress(v1::NecessityProgress { done, seconds_left }),
        Said::Answer(needed) => {
            What::Answer(v1::NecessityAnswer { contributors: needed.into_iter().map(contributor).collect() })
        }
    };
    v1::NecessityResponse { what: Some(what) }
}

/// Whose mark a picture carries; with what it hides where `payload` says so.
pub fn identified(Identified { who, found, labels }: Identified, payload: bool) -> v1::IdentifyResponse {
    use v1::identify_response::Answer;
    let confidence = who.confidence;
    let answer = match (found_identity(who), found.elsewhere) {
        (Some(identity), _) => Answer::Identity(identity),
        (None, Some(Elsewhere { scene, number, label })) => {
            Answer::Foreign(v1::ForeignIdentity { scene, number, label })
        }
        (None, None) => Answer::Unmarked(v1::Unmarked {}),
    };
    let detection = found.detection;
    let (read, not_registered) = match found.registered {
        Some(Ok(read)) => (Some(read), String::new()),
        Some(Err(why)) => (None, why.to_string()),
        None => (None, String::new()),
    };
    let payload = payload.then(|| {
        let recovered = encoded(&detection.recovered);
        v1::Payload {
            picture_png: recovered.picture.unwrap_or_default().into(),
            sound_wav: recovered.audio.unwrap_or_default().into(),
            text: detection.recovered.text,
        }
    });
    v1::IdentifyResponse {
        answer: Some(answer),
        confidence,
        probabilities: detection.probabilities,
        registered: read.map(registered),
        center_crop: detection.is_center_crop,
        payload,
        labels,
        not_registered,
    }
}

/// Where a picture was taken.
pub fn located(found: Result<FoundCamera, NotLocated>) -> v1::LocateResponse {
    use v1::locate_response::Answer;
    let answer = match found {
        Ok(found) => Answer::Found(Box::new(found_camera(found))),
        Err(why) => Answer::NotFound(why.to_string()),
    };
    v1::LocateResponse { answer: Some(answer) }
}

fn found_camera(found: FoundCamera) -> v1::FoundCamera {
    let FoundCamera { camera: of, turned_deg, uncertainty_px, explained, agreeing, compared } = found;
    let encoded = compared.map(|Compared { picture, render }| [&picture, &render].map(encode_png));
    let [compared_png, render_png] = encoded.unwrap_or_default().map(Bytes::from);
    let (camera, agreeing) = (Some(camera(&of)), agreeing as u32);
    v1::FoundCamera { camera, uncertainty_px, explained, agreeing, turned_deg, compared_png, render_png }
}

/// What a registered picture says.
fn registered(Registered { explained, scores, believed }: Registered) -> v1::RegisteredReading {
    v1::RegisteredReading { explained, scores, believed: believed.unwrap_or(0), believed_from: cairn_mark::BELIEVED }
}

/// A record of the log.
pub fn record(index: u64, leaf_hash: &cairn_log::Digest, envelope: &Envelope, record: &OwnerRecord) -> v1::Record {
    v1::Record {
        index,
        envelope: envelope.to_json().into_bytes().into(),
        leaf_hash: leaf_hash.as_bytes().to_vec().into(),
        scene: record.scene.clone(),
        identity: record.identity.number.unwrap_or(0),
        contributor: record.identity.contributor.clone(),
        owner_key_sha256: record.owner_key.id().as_bytes().to_vec().into(),
        kind: kind(record.kind),
        standing: None,
    }
}

/// A log entry as a record, `scene` being what it was asked for under; none for a map leaf.
pub fn entry(entry: &LogEntry, scene: &str) -> Option<v1::Record> {
    match entry {
        LogEntry::Record(stored) => Some(record(stored.index, &stored.leaf.hash(), &stored.envelope, &stored.record)),
        LogEntry::Erased { index, leaf, .. } => Some(v1::Record {
            index: *index,
            envelope: Default::default(),
            leaf_hash: leaf.hash().as_bytes().to_vec().into(),
            scene: scene.to_owned(),
            identity: 0,
            contributor: String::new(),
            owner_key_sha256: leaf.owner.as_bytes().to_vec().into(),
            kind: kind(leaf.kind),
            standing: None,
        }),
        LogEntry::Map { .. } => None,
    }
}

fn kind(kind: RecordKind) -> String {
    let name = serde_json::to_value(kind).ok().and_then(|v| v.as_str().map(str::to_owned));
    name.unwrap_or_default()
}

/// A role.
pub fn role(role: Role) -> v1::Role {
    of_wire!(role, Role => Role { Contributor, Curator, Auditor, Operator })
}

/// Quotas.
pub fn quota(limits: &Limits) -> v1::QuotaLimits {
    let Limits { bytes, views, training_seconds, queued_jobs, records, records_per_day } = *limits;
    v1::QuotaLimits { bytes, views, training_seconds, queued_jobs, records, records_per_day }
}

/// An account.
pub fn account(account: &Account) -> v1::Account {
    let standing = of_wire!(account.standing, AccountStanding => AccountStanding { Waiting, Active, Disabled });
    v1::Account {
        public_key: account.key.to_bytes().to_vec().into(),
        name: account.name.clone(),
        role: role(account.role).into(),
        asked: role(account.asked).into(),
        standing: standing.into(),
        since_unix_s: account.since,
        quota: account.quota.as_ref().map(quota),
        heir: account.heir.map(|key| key.to_bytes().to_vec()).unwrap_or_default().into(),
        ended_by: account.ended_by,
    }
}
