//! Training through the real daemon: watched, cancelled, resumed, killed in the
//! middle, and the same bytes at the end whatever happened on the way.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};

use cairn_api::v1::scene_service_client::SceneServiceClient;
use cairn_api::v1::training_service_client::TrainingServiceClient;
use cairn_api::v1::{self, JobState};
use cairn_testkit::daemon::{Daemon, Place, accept, base_only, endless, smoke, smoke_settings, train_to_end};
use tonic::transport::Channel;

/// Writes a checkpoint after every step, so that any moment has one.
const EVERY_STEP: &str = "[training]\ncheckpoint_every_s = 0";

async fn training(daemon: &Daemon) -> TrainingServiceClient<Channel> {
    TrainingServiceClient::connect(daemon.url.clone()).await.unwrap()
}

/// Watches until `wanted` holds; the job as it was then.
async fn watch_until(
    client: &mut TrainingServiceClient<Channel>,
    id: &str,
    wanted: impl Fn(&v1::Job) -> bool,
) -> v1::Job {
    let request = v1::WatchTrainingRequest { job_id: id.into() };
    let mut stream = client.watch(request).await.unwrap().into_inner();
    while let Some(message) = stream.message().await.unwrap() {
        let job = message.job.unwrap();
        if wanted(&job) {
            return job;
        }
    }
    panic!("the stream ended before that");
}

fn ended(job: &v1::Job) -> bool {
    matches!(job.state(), JobState::Done | JobState::Failed | JobState::Cancelled)
}

async fn model(daemon: &Daemon, scene: &str) -> v1::Model {
    let mut client = SceneServiceClient::connect(daemon.url.clone()).await.unwrap();
    let request = v1::GetSceneRequest { scene: scene.into() };
    client.get(request).await.unwrap().into_inner().model.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_killed_in_the_middle_ends_in_the_same_bytes() {
    let place = Place::new();
    for scene in ["one", "two"] {
        place.import(scene, ["--data", &place.text("data")]);
    }
    let mut screened = smoke_settings();
    screened.screened = true;

    // Undisturbed.
    train_to_end(&place.path("data"), "one", screened.clone(), false);

    // Killed within each stage, started again: found and taken up by itself.
    let second = accept(&place.path("data"), "two", screened);
    let daemon = Daemon::start(&place.path("data"), EVERY_STEP);
    let mut client = training(&daemon).await;
    let within = |stage: &'static str| {
        move |job: &v1::Job| job.progress.as_ref().is_some_and(|p| p.stage == stage && p.step > 0)
    };
    watch_until(&mut client, &second, within("screening")).await;
    daemon.kill();
    let daemon = Daemon::start(&place.path("data"), EVERY_STEP);
    let mut client = training(&daemon).await;
    watch_until(&mut client, &second, within("base field")).await;
    daemon.kill();
    let daemon = Daemon::start(&place.path("data"), EVERY_STEP);
    let mut client = training(&daemon).await;
    watch_until(&mut client, &second, within("marked field")).await;
    daemon.kill();
    let daemon = Daemon::start(&place.path("data"), EVERY_STEP);
    let mut client = training(&daemon).await;
    let job = watch_until(&mut client, &second, ended).await;
    assert_eq!(job.state(), JobState::Done, "{}", job.error);
    let [undisturbed, killed] = [model(&daemon, "one").await, model(&daemon, "two").await];
    assert_eq!(undisturbed.base_field_sha256, killed.base_field_sha256);
    assert_eq!(undisturbed.settings_sha256, killed.settings_sha256);
    assert_eq!(undisturbed.marked_field_sha256, killed.marked_field_sha256);
    assert_eq!(undisturbed.detector_sha256, killed.detector_sha256);

    assert_eq!(undisturbed.detector_sha256.len(), 32);

    // Another seed gives another field, or the comparison above would say nothing.
    let third = client.start(base_only("two", 8, smoke())).await.unwrap().into_inner().job.unwrap();
    watch_until(&mut client, &third.id, ended).await;
    assert_ne!(undisturbed.base_field_sha256, model(&daemon, "two").await.base_field_sha256);
}

#[tokio::test(flavor = "multi_thread")]
async fn cancelled_resumed_and_put_down_by_sigterm() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "[limits]\nqueue_length = 1");
    place.import("one", ["--connect", &daemon.url]);
    let mut client = training(&daemon).await;
    let job = client.start(base_only("one", 7, endless())).await.unwrap().into_inner().job.unwrap();
    let in_screening = |job: &v1::Job| job.progress.as_ref().is_some_and(|p| p.stage == "screening" && p.step > 0);
    watch_until(&mut client, &job.id, in_screening).await;

    // One may wait, the next is refused; a scene in use is not deleted.
    let waiting = client.start(base_only("one", 8, endless())).await.unwrap().into_inner().job.unwrap();
    let refused = client.start(base_only("one", 9, endless())).await.unwrap_err();
    assert_eq!(refused.code(), tonic::Code::ResourceExhausted, "{refused}");
    let mut scenes = SceneServiceClient::connect(daemon.url.clone()).await.unwrap();
    let request = v1::DeleteSceneRequest { scene: "one".into() };
    assert_eq!(scenes.delete(request).await.unwrap_err().code(), tonic::Code::FailedPrecondition);

    for id in [&waiting.id, &job.id] {
        let request = v1::CancelTrainingRequest { job_id: id.clone() };
        let cancelled = client.cancel(request).await.unwrap().into_inner().job.unwrap();
        assert_eq!(cancelled.state(), JobState::Cancelled);
    }
    let watch = v1::WatchTrainingRequest { job_id: job.id.clone() };
    let now = client.watch(watch).await.unwrap().into_inner().message().await.unwrap().unwrap();
    let step = now.job.unwrap().progress.unwrap().step;
    let request = v1::ResumeTrainingRequest { job_id: job.id.clone() };
    client.resume(request).await.unwrap();
    let resumed = watch_until(&mut client, &job.id, |j| {
        j.state() == JobState::Running && {
            let p = j.progress.as_ref().unwrap();
            p.stage == "screening" && p.step > step
        }
    });
    resumed.await;

    // SIGTERM in the middle: the checkpoint is written and the job is found again.
    assert!(daemon.terminate().success());
    assert!(place.path("data/jobs").join(&job.id).join("screening.checkpoint").exists());
    let daemon = Daemon::start(&place.path("data"), "");
    let mut client = training(&daemon).await;
    watch_until(&mut client, &job.id, |j| in_screening(j) && j.progress.as_ref().unwrap().step > step).await;
    let request = v1::CancelTrainingRequest { job_id: job.id.clone() };
    client.cancel(request).await.unwrap();
    let list = client.list(v1::ListTrainingRequest { scene: String::new() }).await.unwrap();
    let states: Vec<JobState> = list.into_inner().jobs.iter().map(v1::Job::state).collect();
    assert_eq!(states, [JobState::Cancelled, JobState::Cancelled]);
}

/// A capture as a phone's: a photograph is gone, and nobody says how large clusters are.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_missing_is_left_out_and_clusters_are_as_large_as_may_be() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "");
    let images = place.path("capture/images");
    let mut names: Vec<_> = std::fs::read_dir(&images).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort_unstable();
    std::fs::remove_file(images.join(&names[1])).unwrap();
    let (capture, table) = (place.text("capture"), place.text("capture/contributors.csv"));
    let import = ["scene", "import", "town", "--from", &capture, "--contributors", &table, "--connect", &daemon.url];
    let refused = place.cairn(&import);
    let (error, gone) = (String::from_utf8_lossy(&refused.stderr), names[1].to_str().unwrap());
    assert!(!refused.status.success() && error.contains(gone) && error.contains("--skip-missing"), "{error}");
    let done = place.cairn(&[&import[..], &["--skip-missing"]].concat());
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && said.contains("left out 1 view without") && said.contains(gone), "{said}");

    let mut scenes = SceneServiceClient::connect(daemon.url.clone()).await.unwrap();
    let get = || v1::GetSceneRequest { scene: "town".into() };
    let scene = scenes.get(get()).await.unwrap().into_inner();
    assert_eq!(scene.views.len(), names.len() - 1);
    let most = scene.views.iter().filter(|v| !v.held_out).count() as u32 / 2;
    let mut client = training(&daemon).await;
    let mut clusters = Vec::new();
    for neighbours in [0, most] {
        let by_anchors =
            Some(v1::start_training_request::Clusters::ByAnchors(v1::ByAnchors { anchors: 2, neighbours }));
        let request = v1::StartTrainingRequest { clusters: by_anchors, ..base_only("town", 1, smoke()) };
        let job = client.start(request).await.unwrap().into_inner().job.unwrap();
        assert_eq!(watch_until(&mut client, &job.id, ended).await.state(), JobState::Done);
        let identities = model(&daemon, "town").await.identities;
        clusters.push(identities.into_iter().map(|identity| identity.view_names).collect::<Vec<_>>());
    }
    assert!(clusters[0] == clusters[1] && clusters[0].iter().all(|views| views.len() > 2), "{clusters:?}");
}

#[test]
fn ctrl_c_cancels_and_keeps_the_checkpoint() {
    let place = Place::new();
    let data = place.text("data");
    place.import("one", ["--data", &data]);
    let config = place.text("every-step.toml");
    std::fs::write(&config, EVERY_STEP).unwrap();
    let mut child = cairn_testkit::daemon::command()
        .args(["train", "one", "--by-contributor", "--base-only", "--preset", "object", "--quality", "archival"])
        .args(["--max-voxels", "4096", "--data", &data, "--config", &config])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.next().unwrap().unwrap().contains("job-000001 accepted"));
    // The signal is caught from the moment that the job is watched; one sent before ends
    // the process, and the wait below would see it.
    let checkpoint = place.path("data/jobs/job-000001/screening.checkpoint");
    while !checkpoint.exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before its first checkpoint");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(130), "{said}");
    assert!(said.contains("cancelled; its checkpoint is kept"), "{said}");
    assert!(checkpoint.exists());
    assert!(place.cairn_ok(&["jobs", "--data", &data]).contains("cancelled"));
}
