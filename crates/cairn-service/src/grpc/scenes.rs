//! `SceneService`.

use std::sync::atomic::Ordering;

use cairn_api::v1::{self, import_scene_request::Part, scene_service_server::SceneService};
use cairn_scene::encode_png;
use tonic::{Request, Response, Streaming};

use super::gate::About;
use super::waiting::Waiting;
use super::{Answer, Shared, from_proto, to_proto};
use crate::engine::Engine;
use crate::error::EngineError;
use crate::export::poses::PoseSheet;
use crate::query::check::Looks;
use crate::store::exclusions::{Decision, State};
use crate::store::import::Imported;

#[tonic::async_trait]
impl SceneService for Shared {
    async fn import(&self, request: Request<Streaming<v1::ImportSceneRequest>>) -> Answer<v1::ImportSceneResponse> {
        let (_, extensions, mut stream) = request.into_parts();
        let first = stream.message().await?.unwrap_or_default();
        let Some(Part::Header(header)) = first.part else {
            return Err(EngineError::invalid("the stream's first message", "no header", "the header").into());
        };
        let name = header.scene.clone();
        let owner = self.authorise(&extensions, About::Scene(&name))?;
        let plan = from_proto::import_plan(header)?;
        let mut import = self.run(move |engine| engine.begin_import(plan, owner)).await?;
        // A stream that breaks off drops the import, and with it what it had written.
        while let Some(message) = stream.message().await? {
            let chunk = match message.part {
                Some(Part::Chunk(chunk)) => chunk,
                Some(Part::Points(chunk)) => {
                    import.add_points(from_proto::points(&chunk)?)?;
                    continue;
                }
                Some(Part::Header(_)) | None => {
                    return Err(EngineError::invalid("the stream's next message", "no chunk", "a chunk").into());
                }
            };
            import = self
                .run(move |_| {
                    import.write(chunk.view_index as usize, chunk.is_mask, &chunk.data)?;
                    Ok(import)
                })
                .await?;
        }
        let Imported { scene, without_share } = self.run(move |engine| engine.finish_import(import)).await?;
        let summary = to_proto::scene_summary(&name, &scene, false);
        tracing::info!(scene = name, views = summary.views, "scene imported");
        let without_share = to_proto::unused_photographs(&without_share);
        Ok(Response::new(v1::ImportSceneResponse { scene: Some(summary), without_share }))
    }

    async fn list(&self, _: Request<v1::ListScenesRequest>) -> Answer<v1::ListScenesResponse> {
        let scenes = self
            .run(|engine| engine.scene_names()?.iter().map(|name| summary(engine, name)).collect::<Result<_, _>>())
            .await?;
        Ok(Response::new(v1::ListScenesResponse { scenes }))
    }

    async fn get(&self, request: Request<v1::GetSceneRequest>) -> Answer<v1::GetSceneResponse> {
        let v1::GetSceneRequest { scene } = request.into_inner();
        self.run(move |engine| {
            let snapshot = engine.snapshot(&scene)?;
            let (folder, model) = (&snapshot.scene, snapshot.newest.as_ref());
            Ok(v1::GetSceneResponse {
                summary: Some(to_proto::scene_summary(&scene, folder, model.is_some())),
                views: to_proto::scene_views(folder, &snapshot.entries),
                model: model.map(to_proto::model),
            })
        })
        .await
        .map(Response::new)
    }

    async fn draw_poses(&self, request: Request<v1::DrawPosesRequest>) -> Answer<v1::DrawPosesResponse> {
        let request = request.into_inner();
        let svg = from_proto::is_svg(request.format)?;
        let clusters = from_proto::drawn_clusters(&request)?;
        self.compute(move |engine| {
            let PoseSheet { drawing, views, clusters } = engine.draw_poses(&request.scene, clusters)?;
            let picture = if svg { drawing.svg().into_bytes() } else { encode_png(&drawing.picture()) };
            Ok(v1::DrawPosesResponse {
                picture: picture.into(),
                width: drawing.width as u32,
                height: drawing.height as u32,
                views: views as u32,
                clusters: clusters as u32,
            })
        })
        .await
        .map(Response::new)
    }

    async fn check(&self, request: Request<v1::CheckSceneRequest>) -> Answer<v1::CheckSceneResponse> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::CheckSceneRequest { scene, anew, picture, places } = request.into_inner();
        let looks = Looks { picture, places };
        let waiting = Waiting::default();
        let given_up = waiting.0.clone();
        let searching = if places { self.searches.clone().acquire_owned().await.ok() } else { None };
        let answer = self
            .compute(move |engine| {
                let _searching = searching;
                let checked = engine.check(&scene, anew, looks, &|| !given_up.load(Ordering::Relaxed))?;
                Ok(to_proto::checked(&engine.scene(&scene)?, checked))
            })
            .await?;
        drop(waiting);
        Ok(Response::new(answer))
    }

    async fn exclude(&self, request: Request<v1::ExcludeViewsRequest>) -> Answer<v1::ExcludeViewsResponse> {
        let by = self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::ExcludeViewsRequest { scene, view_names, why } = request.into_inner();
        let names = from_proto::view_names(view_names)?;
        let decision = Decision { state: State::Excluded, why, by };
        let excluded = self.run(move |engine| engine.decide(&scene, &names, &decision)).await?;
        Ok(Response::new(v1::ExcludeViewsResponse { excluded: excluded as u32 }))
    }

    async fn include(&self, request: Request<v1::IncludeViewsRequest>) -> Answer<v1::IncludeViewsResponse> {
        let by = self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::IncludeViewsRequest { scene, view_names } = request.into_inner();
        let names = from_proto::view_names(view_names)?;
        let decision = Decision { state: State::Included, why: String::new(), by };
        let excluded = self.run(move |engine| engine.decide(&scene, &names, &decision)).await?;
        Ok(Response::new(v1::IncludeViewsResponse { excluded: excluded as u32 }))
    }

    async fn delete(&self, request: Request<v1::DeleteSceneRequest>) -> Answer<v1::DeleteSceneResponse> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let scene = request.into_inner().scene;
        self.run(move |engine| engine.delete_scene(&scene)).await?;
        Ok(Response::new(v1::DeleteSceneResponse {}))
    }
}

fn summary(engine: &Engine, name: &str) -> Result<v1::SceneSummary, EngineError> {
    let trained = engine.newest_model(name)?.is_some();
    Ok(to_proto::scene_summary(name, &engine.scene(name)?, trained))
}
