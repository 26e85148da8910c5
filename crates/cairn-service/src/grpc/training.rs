//! `TrainingService`.

use cairn_api::v1::{self, training_service_server::TrainingService};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::gate::About;
use super::{Answer, Shared, from_proto, to_proto};

#[tonic::async_trait]
impl TrainingService for Shared {
    async fn start(&self, request: Request<v1::StartTrainingRequest>) -> Answer<v1::StartTrainingResponse> {
        let owner = self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        for scene in &request.get_ref().also {
            self.authorise(request.extensions(), About::Beside(scene))?;
        }
        let mut wanted = from_proto::training(request.into_inner())?;
        wanted.owner = owner;
        let job = self.run(move |engine| engine.train(wanted)).await?;
        tracing::info!(job = job.id, scene = job.spec.scene, "training accepted");
        Ok(Response::new(v1::StartTrainingResponse { job: Some(to_proto::job(&job)) }))
    }

    type WatchStream = ReceiverStream<Result<v1::WatchTrainingResponse, Status>>;

    async fn watch(&self, request: Request<v1::WatchTrainingRequest>) -> Answer<Self::WatchStream> {
        let v1::WatchTrainingRequest { job_id } = request.into_inner();
        let mut jobs = self.engine()?.jobs().watch(&job_id)?;
        // One place: who reads slowly misses messages, but never the last one.
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(async move {
            loop {
                let job = jobs.borrow_and_update().clone();
                let message = v1::WatchTrainingResponse { job: Some(to_proto::job(&job)) };
                // Nobody listens any more, the job has ended, or the daemon goes down.
                if sender.send(Ok(message)).await.is_err() || job.state.has_ended() || jobs.changed().await.is_err() {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn cancel(&self, request: Request<v1::CancelTrainingRequest>) -> Answer<v1::CancelTrainingResponse> {
        self.authorise(request.extensions(), About::Job(&request.get_ref().job_id))?;
        let id = request.into_inner().job_id;
        let mut watch = self.engine()?.jobs().watch(&id)?;
        self.run(move |engine| engine.jobs().cancel(&id)).await?;
        // The worker lets go at its next step, after its checkpoint.
        let job = watch.wait_for(|job| job.state.has_ended()).await.map(|job| to_proto::job(&job));
        let job = job.map_err(|_| Status::unavailable("the daemon went down before the job let go"))?;
        Ok(Response::new(v1::CancelTrainingResponse { job: Some(job) }))
    }

    async fn resume(&self, request: Request<v1::ResumeTrainingRequest>) -> Answer<v1::ResumeTrainingResponse> {
        self.authorise(request.extensions(), About::Job(&request.get_ref().job_id))?;
        let id = request.into_inner().job_id;
        let job = self
            .run(move |engine| {
                let job = engine.jobs().get(&id)?;
                // Its scene may be gone since.
                engine.scene(&job.spec.scene)?;
                engine.jobs().resume(&id)
            })
            .await?;
        Ok(Response::new(v1::ResumeTrainingResponse { job: Some(to_proto::job(&job)) }))
    }

    async fn list(&self, request: Request<v1::ListTrainingRequest>) -> Answer<v1::ListTrainingResponse> {
        let v1::ListTrainingRequest { scene } = request.into_inner();
        let jobs = self.engine()?.jobs().list();
        let jobs = jobs.iter().filter(|j| scene.is_empty() || j.spec.is_of(&scene)).map(to_proto::job).collect();
        Ok(Response::new(v1::ListTrainingResponse { jobs }))
    }
}
