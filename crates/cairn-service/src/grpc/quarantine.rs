//! `QuarantineService`.

use cairn_api::v1::{self, quarantine_service_server::QuarantineService};
use tonic::{Request, Response, Status};

use super::gate::About;
use super::status::status;
use super::{Shared, from_proto, to_proto};

type Answer<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl QuarantineService for Shared {
    async fn list(&self, request: Request<v1::ListQuarantineRequest>) -> Answer<v1::ListQuarantineResponse> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let scene = request.into_inner().scene;
        let groups = self
            .run(move |engine| Ok(to_proto::quarantine_groups(&engine.scene(&scene)?, &engine.quarantined(&scene)?)))
            .await?;
        Ok(Response::new(v1::ListQuarantineResponse { groups }))
    }

    async fn release(&self, request: Request<v1::ReleaseViewsRequest>) -> Answer<v1::ReleaseViewsResponse> {
        let by = self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::ReleaseViewsRequest { scene, view_names, .. } = request.into_inner();
        let names = from_proto::view_names(view_names).map_err(status)?;
        let released = self.run(move |engine| engine.release_views(&scene, &names, by)).await?;
        let views = released.iter().map(to_proto::quarantined_view).collect();
        Ok(Response::new(v1::ReleaseViewsResponse { views }))
    }

    async fn remove(&self, request: Request<v1::RemoveViewsRequest>) -> Answer<v1::RemoveViewsResponse> {
        let by = self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::RemoveViewsRequest { scene, view_names, .. } = request.into_inner();
        let names = from_proto::view_names(view_names).map_err(status)?;
        let removed = self.run(move |engine| engine.remove_views(&scene, &names, by)).await?;
        let views = removed.iter().map(to_proto::quarantined_view).collect();
        Ok(Response::new(v1::RemoveViewsResponse { views }))
    }
}
