//! `QueryService` and `DetectionService`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::auth::Need;
use cairn_api::v1::{self, detection_service_server::DetectionService, query_service_server::QueryService};
use cairn_scene::encode_png;
use tokio::sync::OwnedSemaphorePermit;
use tonic::{Extensions, Request, Response, Status};

use super::gate::About;
use super::status::status;
use super::{Shared, from_proto, to_proto};
use crate::query::look::Over;
use crate::store::hidden::encoded;

type Answer<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl QueryService for Shared {
    async fn who_by_pose(&self, request: Request<v1::WhoByPoseRequest>) -> Answer<v1::WhoResponse> {
        let v1::WhoByPoseRequest { scene, viewpoint } = request.into_inner();
        let viewpoint = from_proto::viewpoint(viewpoint).map_err(status)?;
        let who = self.run(move |engine| engine.who_by_pose(&scene, &viewpoint)).await?;
        Ok(Response::new(to_proto::who(who)))
    }

    async fn who_by_picture(&self, request: Request<v1::WhoByPictureRequest>) -> Answer<v1::WhoResponse> {
        let over = self.over(request.extensions(), &request.get_ref().scene, request.get_ref().lay_over.as_ref())?;
        let _waiting = over.as_ref().map(Waiting::of);
        let searching = self.searching(over.as_ref()).await;
        let v1::WhoByPictureRequest { scene, picture, .. } = request.into_inner();
        let who = self.compute(move |engine| {
            let _searching = searching;
            engine.who_by_picture(&scene, &picture, over)
        });
        let who = who.await?;
        Ok(Response::new(to_proto::who(who)))
    }

    async fn evaluate(&self, request: Request<v1::EvaluateRequest>) -> Answer<v1::EvaluateResponse> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::EvaluateRequest { scene, contact_sheet, .. } = request.into_inner();
        let answer = self
            .compute(move |engine| {
                let (report, sheet) = engine.evaluate(&scene, contact_sheet)?;
                Ok(v1::EvaluateResponse {
                    report_json: report.to_json()?,
                    contact_sheet_png: sheet.map(|s| encode_png(&s)).unwrap_or_default().into(),
                })
            })
            .await?;
        Ok(Response::new(answer))
    }
}

#[tonic::async_trait]
impl DetectionService for Shared {
    async fn detect(&self, request: Request<v1::DetectRequest>) -> Answer<v1::DetectResponse> {
        let over = self.over(request.extensions(), &request.get_ref().scene, request.get_ref().lay_over.as_ref())?;
        let _waiting = over.as_ref().map(Waiting::of);
        let searching = self.searching(over.as_ref()).await;
        let v1::DetectRequest { scene, picture, .. } = request.into_inner();
        let found = self.compute(move |engine| {
            let _searching = searching;
            engine.detect(&scene, &picture, over)
        });
        let (found, label) = found.await?;
        let detection = found.detection;
        let recovered = encoded(&detection.recovered);
        Ok(Response::new(v1::DetectResponse {
            recovered_png: recovered.picture.unwrap_or_default().into(),
            recovered_wav: recovered.audio.unwrap_or_default().into(),
            recovered_text: detection.recovered.text,
            probabilities: detection.probabilities,
            identity: detection.identity.unwrap_or(0),
            label: label.unwrap_or_default(),
            elsewhere: found.elsewhere.map(to_proto::elsewhere),
            laid_over: found.laid_over.map(to_proto::laid_over),
            closer_look: detection.is_center_crop,
        }))
    }
}

/// A caller who waits: where it goes without its answer, this is dropped, and a search for its picture's camera ends.
struct Waiting(Arc<AtomicBool>);

impl Waiting {
    fn of(over: &Over) -> Self {
        Self(over.given_up.clone())
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Shared {
    /// How a picture is to be laid over the scene's field. It asks for a token as base renders do: it takes the daemon
    /// seconds, and its scores are what someone would watch who wants a mark to go.
    fn over(&self, caller: &Extensions, scene: &str, asked: Option<&v1::LayOver>) -> Result<Option<Over>, Status> {
        let Some(v1::LayOver { viewpoint }) = asked else { return Ok(None) };
        let from = viewpoint.clone().map(|v| from_proto::viewpoint(Some(v))).transpose().map_err(status)?;
        self.authorise_as(caller, Need::Inspect, About::Scene(scene))?;
        Ok(Some(Over { from, given_up: Arc::default() }))
    }

    /// Waits for the one place that searches for a camera have, of those that renders share: a search keeps its own for
    /// many seconds. It goes with the work.
    async fn searching(&self, over: Option<&Over>) -> Option<OwnedSemaphorePermit> {
        match over {
            Some(Over { from: None, .. }) => self.searches.clone().acquire_owned().await.ok(),
            _ => None,
        }
    }
}
