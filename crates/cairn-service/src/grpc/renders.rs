//! `RenderService`.

use std::sync::Arc;

use crate::auth::Need;
use cairn_api::v1::{self, render_service_server::RenderService};
use cairn_scene::encode_png;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Extensions, Request, Response, Status};

use super::gate::About;
use super::{Answer, Shared, from_proto, to_proto};
use crate::engine::Engine;
use crate::error::EngineError;
use crate::export::tour::Tour;
use crate::query::viewpoint::FieldKind;

#[tonic::async_trait]
impl RenderService for Shared {
    async fn render(&self, request: Request<v1::RenderRequest>) -> Answer<v1::RenderResponse> {
        let field = from_proto::field_kind(request.get_ref().field)?;
        may_see(self, request.extensions(), &request.get_ref().scene, field, &[request.get_ref().appearance.as_ref()])?;
        let v1::RenderRequest { scene, viewpoint, appearance, accumulation, depth, depth_colours, .. } =
            request.into_inner();
        let viewpoint = from_proto::viewpoint(viewpoint)?;
        let light = from_proto::light(appearance)?;
        self.compute(move |engine| {
            let wants_maps = accumulation || depth || depth_colours;
            let (picture, maps) = engine.render(&scene, &viewpoint, field, &light, wants_maps)?;
            let mut answer = v1::RenderResponse {
                width: picture.width() as u32,
                height: picture.height() as u32,
                png: encode_png(&picture).into(),
                ..v1::RenderResponse::default()
            };
            let Some(maps) = maps else { return Ok(answer) };
            if accumulation {
                answer.accumulation_png = maps.accumulation_png().into();
            }
            if depth {
                let written = maps.depth_png();
                (answer.depth_png, answer.depth_unit) = (written.png.into(), written.unit);
            }
            if depth_colours {
                answer.depth_colours_png = encode_png(&maps.depth_in_colours()).into();
            }
            Ok(answer)
        })
        .await
        .map(Response::new)
    }

    type RenderPathStream = ReceiverStream<Result<v1::RenderPathResponse, Status>>;

    async fn render_path(&self, request: Request<v1::RenderPathRequest>) -> Answer<Self::RenderPathStream> {
        let field = from_proto::field_kind(request.get_ref().field)?;
        let lights = [request.get_ref().appearance.as_ref(), request.get_ref().appearance_to.as_ref()];
        may_see(self, request.extensions(), &request.get_ref().scene, field, &lights)?;
        let fits = lights.into_iter().any(is_fitted);
        let plan = from_proto::path(request.into_inner())?;
        let plan = move |engine: &Engine| engine.tour(&plan);
        // Planning is geometry alone, but for a light that is fitted to a photograph.
        let tour = Arc::new(if fits { self.compute(plan).await? } else { self.run(plan).await? });
        // One place: at most one frame waits for its reader while the next is computed.
        let (sender, receiver) = mpsc::channel(1);
        let shared = self.clone();
        tokio::spawn(async move {
            for at in 0..tour.cameras.len() {
                let tour = tour.clone();
                // A place for each frame: renders of other callers come in between. Who hangs up waits for none.
                let frame = tokio::select! {
                    frame = shared.compute(move |engine| frame(engine, &tour, at)) => frame,
                    () = sender.closed() => return,
                };
                let failed = frame.is_err();
                if sender.send(frame).await.is_err() || failed {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Holds the caller to a token where a render would show the field without its marks: the base field's, and one in a
/// photograph's light. Who may choose any light chooses one so dark that the mark is nearly all that is left.
fn may_see(
    shared: &Shared,
    caller: &Extensions,
    scene: &str,
    field: FieldKind,
    lights: &[Option<&v1::Appearance>],
) -> Result<(), Status> {
    if field == FieldKind::Base || lights.iter().any(|light| is_fitted(*light)) {
        shared.authorise_as(caller, Need::Inspect, About::Scene(scene))?;
    }
    Ok(())
}

/// Whether it is fitted to a photograph.
fn is_fitted(light: Option<&v1::Appearance>) -> bool {
    matches!(light.and_then(|light| light.choice.as_ref()), Some(v1::appearance::Choice::Photograph(_)))
}

fn frame(engine: &Engine, tour: &Tour, at: usize) -> Result<v1::RenderPathResponse, EngineError> {
    let picture = engine.frame(tour, at)?;
    Ok(v1::RenderPathResponse {
        frame: at as u32,
        frames: tour.cameras.len() as u32,
        png: encode_png(&picture).into(),
        camera: Some(to_proto::camera(&tour.cameras[at])),
        job_id: tour.job.clone(),
    })
}
