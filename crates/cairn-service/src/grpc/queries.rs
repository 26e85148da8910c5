//! `QueryService`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::auth::Need;
use cairn_api::v1::{self, query_service_server::QueryService};
use cairn_scene::encode_png;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Extensions, Request, Response, Status};

use super::gate::About;
use super::waiting::Waiting;
use super::{Answer, Shared, from_proto, to_proto};
use crate::query::look::FieldRegistration;
use crate::query::necessity::{Question, Said};

#[tonic::async_trait]
impl QueryService for Shared {
    async fn identify(&self, request: Request<v1::IdentifyRequest>) -> Answer<v1::IdentifyResponse> {
        let register = registration(self, request.extensions(), request.get_ref())?;
        let _waiting = register.as_ref().map(|register| Waiting(register.given_up.clone()));
        let searching = searching(self, register.as_ref()).await;
        let v1::IdentifyRequest { scene, picture, payload, .. } = request.into_inner();
        let found = self.compute(move |engine| {
            let _searching = searching;
            engine.identify(&scene, &picture, register)
        });
        Ok(Response::new(to_proto::identified(found.await?, payload)))
    }

    async fn locate(&self, request: Request<v1::LocateRequest>) -> Answer<v1::LocateResponse> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let given_up = Arc::<AtomicBool>::default();
        let _waiting = Waiting(given_up.clone());
        let searching = self.searches.clone().acquire_owned().await.ok();
        let v1::LocateRequest { scene, picture, compared } = request.into_inner();
        // Pictures are encoded there, too: that is work.
        let found = self.compute(move |engine| {
            let _searching = searching;
            let wanted = || !given_up.load(Ordering::Relaxed);
            Ok(to_proto::located(engine.locate(&scene, &picture, compared, &wanted)?))
        });
        found.await.map(Response::new)
    }

    async fn contributors(&self, request: Request<v1::ContributorsRequest>) -> Answer<v1::ContributorsResponse> {
        let mut asked = from_proto::asked(request.get_ref())?;
        let scene = request.get_ref().scene.clone();
        // The map shows what is rendered: without marks that is the base field, which asks for a token.
        if asked.map {
            let of = scene.clone();
            let newest = self.run(move |engine| engine.newest_model(&of)).await?;
            if newest.is_some_and(|info| info.mark.is_none()) {
                self.authorise_as(request.extensions(), Need::Inspect, About::Scene(&scene))?;
                asked.may_see_base = true;
            }
        }
        let found = self.compute(move |engine| {
            let (mark, found) = engine.contributors(&scene, &asked)?;
            Ok(to_proto::contributors(mark, found))
        });
        found.await.map(Response::new)
    }

    type NecessityStream = ReceiverStream<Result<v1::NecessityResponse, Status>>;

    async fn necessity(&self, request: Request<v1::NecessityRequest>) -> Answer<Self::NecessityStream> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::NecessityRequest { scene, viewpoint, contributors } = request.into_inner();
        let (viewpoint, contributors) = (from_proto::viewpoint(viewpoint)?, contributors as usize);
        // Cost and answer always find a place, so that a caller who does not read holds nothing up.
        let (sender, receiver) = mpsc::channel(3);
        let shared = self.clone();
        tokio::spawn(async move {
            let says = sender.clone();
            // Who hangs up ends the work after the part under way.
            let work = shared.compute(move |engine| {
                engine.necessity(&scene, &Question { viewpoint, contributors }, &mut |said| {
                    let is_late = matches!(said, Said::Progress { .. }) && says.capacity() < 2;
                    if is_late { !says.is_closed() } else { says.try_send(Ok(to_proto::necessity(said))).is_ok() }
                })
            });
            let done = tokio::select! {
                done = work => done,
                () = sender.closed() => return,
            };
            if let Err(why) = done {
                // A caller that is gone hears nothing.
                let _ = sender.send(Err(why)).await;
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn evaluate(&self, request: Request<v1::EvaluateRequest>) -> Answer<v1::EvaluateResponse> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::EvaluateRequest { scene, contact_sheet, .. } = request.into_inner();
        self.compute(move |engine| {
            let (report, sheet) = engine.evaluate(&scene, contact_sheet)?;
            Ok(v1::EvaluateResponse {
                report_json: report.to_json()?,
                contact_sheet_png: sheet.map(|s| encode_png(&s)).unwrap_or_default().into(),
            })
        })
        .await
        .map(Response::new)
    }
}

/// How a picture is to be registered with the scene's field. It asks for a token as base renders do: it takes the daemon
/// seconds, and its scores are what someone would watch who wants a mark to go.
fn registration(
    shared: &Shared,
    caller: &Extensions,
    request: &v1::IdentifyRequest,
) -> Result<Option<FieldRegistration>, Status> {
    if !request.register && request.camera.is_none() {
        return Ok(None);
    }
    let from = request.camera.clone().map(|v| from_proto::viewpoint(Some(v))).transpose()?;
    shared.authorise_as(caller, Need::Inspect, About::Scene(&request.scene))?;
    Ok(Some(FieldRegistration { from, given_up: Arc::default() }))
}

/// Waits for the one place that searches for a camera have, of those that renders share: a search keeps its own for
/// many seconds. It goes with the work.
async fn searching(shared: &Shared, register: Option<&FieldRegistration>) -> Option<OwnedSemaphorePermit> {
    match register {
        Some(FieldRegistration { from: None, .. }) => shared.searches.clone().acquire_owned().await.ok(),
        _ => None,
    }
}
