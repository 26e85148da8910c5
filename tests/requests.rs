//! Scenes, renders, queries and refusals through the real daemon.

use cairn_api::v1::query_service_client::QueryServiceClient;
use cairn_api::v1::render_service_client::RenderServiceClient;
use cairn_api::v1::scene_service_client::SceneServiceClient;
use cairn_api::v1::training_service_client::TrainingServiceClient;
use cairn_api::v1::{self, import_scene_request::Part};
use cairn_testkit::daemon::{Daemon, Place, base_only, smoke, training as wanted};
use tonic::{Code, Request};

fn view(name: &str) -> Option<v1::Viewpoint> {
    Some(v1::Viewpoint { from: Some(v1::viewpoint::From::ViewName(name.into())) })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scene_is_imported_trained_rendered_and_asked() {
    let place = Place::new();
    let data = place.text("data");
    // In this process and over the network: the same commands on the same folder, in turn.
    assert!(place.import("town", ["--data", &data]).contains("12 views (2 held out) by 2 contributors"));
    let train = ["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data];
    assert!(place.cairn_ok(&train).contains("done"));

    let daemon = Daemon::start(&place.path("data"), "");
    let connect = ["--connect", daemon.url.as_str()];
    let listed = place.cairn_ok(&["scene", "list", connect[0], connect[1]]);
    assert!(listed.contains("town: 12 views") && listed.contains(", trained"), "{listed}");
    let mut scenes = SceneServiceClient::connect(daemon.url.clone()).await.unwrap();
    let request = v1::GetSceneRequest { scene: "town".into() };
    let scene = scenes.get(request).await.unwrap().into_inner();
    let model = scene.model.unwrap();
    assert_eq!(model.identities.len(), 2);

    // Every member of a cluster is told its identity; nobody's record is there yet.
    let mut query = QueryServiceClient::connect(daemon.url.clone()).await.unwrap();
    for identity in &model.identities {
        for name in &identity.view_names {
            let request = v1::ContributorsRequest { scene: "town".into(), viewpoint: view(name), ..Default::default() };
            let who = query.contributors(request).await.unwrap().into_inner();
            let Some(v1::contributors_response::Answer::Identity(found)) = who.answer else {
                panic!("{name}: {who:?}")
            };
            assert_eq!((found.number, found.record_indices.len()), (identity.number, 0), "{name}");
            assert!((0.0..=1.0).contains(&who.confidence), "{}", who.confidence);
            let shares = who.contributors.iter().map(|of| of.share).sum::<f64>() + who.unseen + who.behind;
            assert!((shares - 1.0).abs() < 1e-3 && who.excluded == 0.0, "{name}: all parts are {shares}");
            assert_eq!(who.photographed_by, found.label, "{name}");
            let photographs = who.contributors.iter().flat_map(|of| &of.photographs);
            assert!(photographs.map(|of| of.share).sum::<f64>() > 0.0 && who.map_png.is_empty());
        }
    }

    let name = scene.views[1].name.clone();
    let map = place.text("who.png");
    let said = place.cairn_ok(&["who", "town", "--view", &name, "--map", &map, connect[0], connect[1]]);
    assert!(said.contains(" %  ") && said.contains("behind the scene") && said.contains("photographed by"), "{said}");
    let drawn = std::fs::read(&map).unwrap();
    let drawn = cairn_scene::decode_picture(&drawn, &cairn_scene::Limits::default(), None).unwrap();
    assert!(drawn.width() >= 64 && drawn.height() > 32, "{} x {} px", drawn.width(), drawn.height());
    let table = place.cairn_ok(&["who", "town", "--view", &name, "--csv", connect[0], connect[1]]);
    assert!(table.starts_with("kind,contributor,photograph,records,more_records,share_percent\r\n"), "{table}");
    // A pixel in the middle has shares of its own; a region beside the picture is refused by name.
    let part = place.cairn_ok(&["who", "town", "--view", &name, "--region", "16,16,1,1", connect[0], connect[1]]);
    assert_ne!(part, said.replace(&format!("map in {map}\n"), ""));
    let beside = place.cairn_refused(&["who", "town", "--view", &name, "--region", "32,0,4,4", connect[0], connect[1]]);
    assert!(beside.contains("the region") && beside.contains("within 32 x 32 px"), "{beside}");

    // What necessity takes is said first, then how far it is, and the answer comes last.
    let asked =
        |contributors, name: &str| v1::NecessityRequest { scene: "town".into(), viewpoint: view(name), contributors };
    let mut stream = query.necessity(asked(2, &name)).await.unwrap().into_inner();
    let mut steps = Vec::new();
    while let Some(message) = stream.message().await.unwrap() {
        steps.push(message.what.unwrap());
    }
    use v1::necessity_response::What;
    let (Some(What::Cost(cost)), Some(What::Answer(answer))) = (steps.first(), steps.last()) else {
        panic!("{steps:?}")
    };
    assert!(cost.contributors == 2 && cost.photographs > 2 && cost.bytes > 0 && cost.seconds > 0.0, "{cost:?}");
    let between = |step: &What| matches!(step, What::Progress(at) if at.done > 0.0 && at.done < 1.0);
    assert!(steps.len() > 2 && steps[1..steps.len() - 1].iter().all(between), "{steps:?}");
    let changes: Vec<f64> = answer.contributors.iter().map(|of| of.change).collect();
    assert!(changes.len() == 2 && changes[0] >= changes[1] && changes[1] > 0.0, "{changes:?}");
    let refused = |asked| {
        let mut query = query.clone();
        async move { query.necessity(asked).await.unwrap().into_inner().message().await.unwrap_err() }
    };
    let many = refused(asked(21, &name)).await;
    assert!(many.code() == Code::InvalidArgument && many.message().contains("1 to 20"), "{many}");
    assert_eq!(refused(asked(1, "none.png")).await.code(), Code::NotFound);
    let said = place.cairn_ok(&["who", "town", "--view", &name, "--necessity", "1", connect[0], connect[1]]);
    assert!(said.starts_with("without ") && said.contains(" of 255 levels"), "{said}");

    let png = place.text("view.png");
    place.cairn_ok(&["render", "town", "--view", &name, "--out", &png, "--base", connect[0], connect[1]]);
    let bytes = std::fs::read(&png).unwrap();
    let picture = cairn_scene::decode_picture(&bytes, &cairn_scene::Limits::default(), None).unwrap();
    assert_eq!((picture.width(), picture.height()), (32, 32));
    let other = place.text("other.png");
    place.cairn_ok(&[
        "render",
        "town",
        "--view",
        &scene.views[7].name,
        "--out",
        &other,
        "--base",
        connect[0],
        connect[1],
    ]);
    assert_ne!(bytes, std::fs::read(&other).unwrap(), "two places look alike");

    let scored = place.cairn_ok(&["evaluate", "town", connect[0], connect[1]]);
    assert!(scored.contains("2 held-out views of town"), "{scored}");
    place.cairn_ok(&["scene", "delete", "town", "--yes", connect[0], connect[1]]);
    assert_eq!(place.cairn_ok(&["scene", "list", connect[0], connect[1]]), "");
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_get_the_right_codes() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "");
    place.import("town", ["--connect", &daemon.url]);
    let mut scenes = SceneServiceClient::connect(daemon.url.clone()).await.unwrap();
    let mut training = TrainingServiceClient::connect(daemon.url.clone()).await.unwrap();
    let mut render = RenderServiceClient::connect(daemon.url.clone()).await.unwrap();
    let mut query = QueryServiceClient::connect(daemon.url.clone()).await.unwrap();

    let get = |scene: &str| v1::GetSceneRequest { scene: scene.into() };
    assert_eq!(scenes.get(get("tow")).await.unwrap_err().code(), Code::NotFound);
    assert_eq!(scenes.get(get("../town")).await.unwrap_err().code(), Code::InvalidArgument);

    let odd = v1::TrainingOptions { payload_text_bytes: Some(5000), ..smoke() };
    let refused = training.start(base_only("town", 1, odd)).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    assert!(refused.message().contains("`training.payload_text_bytes` = 5000"), "{refused}");
    let unknown = v1::TrainingOptions { quality: 9, ..smoke() };
    let refused = training.start(base_only("town", 1, unknown)).await.unwrap_err();
    assert!(refused.message().contains("options.quality"), "{refused}");
    let by_anchors = v1::ByAnchors { anchors: 60, neighbours: 20 };
    let clusters = Some(v1::start_training_request::Clusters::ByAnchors(by_anchors));
    let too_many = v1::StartTrainingRequest { clusters, ..wanted("town", 1, smoke()) };
    assert_eq!(training.start(too_many).await.unwrap_err().code(), Code::FailedPrecondition);
    let no_clusters = v1::StartTrainingRequest { clusters: None, ..base_only("town", 1, smoke()) };
    assert_eq!(training.start(no_clusters).await.unwrap_err().code(), Code::InvalidArgument);
    let cancel = v1::CancelTrainingRequest { job_id: "job-000009".into() };
    assert_eq!(training.cancel(cancel).await.unwrap_err().code(), Code::NotFound);

    let request =
        v1::RenderRequest { scene: "town".into(), viewpoint: view("images/none.png"), ..v1::RenderRequest::default() };
    let untrained = render.render(request.clone()).await.unwrap_err();
    assert_eq!(untrained.code(), Code::FailedPrecondition, "{untrained}");
    let nowhere = v1::RenderRequest { viewpoint: None, ..request };
    assert_eq!(render.render(nowhere).await.unwrap_err().code(), Code::InvalidArgument);
    let noise = v1::IdentifyRequest { scene: "town".into(), picture: vec![7; 99].into(), ..Default::default() };
    assert_eq!(query.identify(noise).await.unwrap_err().code(), Code::InvalidArgument);
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_beyond_the_limits_are_refused_by_name() {
    let place = Place::new();
    let settings = "[limits]\nmax_message_bytes = 65536\nmax_pixels = 4096\nmax_side_px = 100";
    let daemon = Daemon::start(&place.path("data"), settings);
    let mut query = QueryServiceClient::connect(daemon.url.clone()).await.unwrap();
    let request = v1::IdentifyRequest { scene: "town".into(), picture: vec![0; 70_000].into(), ..Default::default() };
    let heavy = query.identify(request).await.unwrap_err();
    assert_eq!(heavy.code(), Code::OutOfRange, "{heavy}");

    place.import("town", ["--connect", &daemon.url]);
    let mut training = TrainingServiceClient::connect(daemon.url.clone()).await.unwrap();
    let job = training.start(base_only("town", 1, smoke())).await.unwrap().into_inner().job.unwrap();
    let watch = v1::WatchTrainingRequest { job_id: job.id };
    let mut line = training.watch(watch).await.unwrap().into_inner();
    while line.message().await.unwrap().is_some() {}

    let mut render = RenderServiceClient::connect(daemon.url.clone()).await.unwrap();
    for (width, height, limit) in [(90, 90, "limits.max_pixels"), (101, 4, "limits.max_side_px")] {
        let intrinsics = v1::Intrinsics { width, height, fx: 40.0, fy: 40.0, ..v1::Intrinsics::default() };
        let pose = v1::Pose { rotation: vec![1., 0., 0., 0., 1., 0., 0., 0., 1.], position: vec![0.0; 3] };
        let camera = v1::Camera { intrinsics: Some(intrinsics), pose: Some(pose) };
        let request = v1::RenderRequest {
            scene: "town".into(),
            viewpoint: Some(v1::Viewpoint { from: Some(v1::viewpoint::From::Camera(camera)) }),
            ..v1::RenderRequest::default()
        };
        let refused = render.render(request).await.unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
        assert!(refused.message().contains(limit), "{refused} does not name {limit}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_import_that_breaks_its_word_leaves_nothing() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "[limits]\nmax_photograph_bytes = 2048");
    let mut scenes = SceneServiceClient::connect(daemon.url.clone()).await.unwrap();
    let camera = v1::Camera {
        intrinsics: Some(v1::Intrinsics { width: 4, height: 4, fx: 4.0, fy: 4.0, ..v1::Intrinsics::default() }),
        pose: Some(v1::Pose { rotation: vec![1., 0., 0., 0., 1., 0., 0., 0., 1.], position: vec![0.0; 3] }),
    };
    let view = |name: &str, bytes| v1::ImportView {
        name: name.into(),
        camera: Some(camera.clone()),
        contributor: "ada".into(),
        photograph_bytes: bytes,
        photograph_sha256: vec![0; 32].into(),
        ..v1::ImportView::default()
    };
    let both = || vec![view("a", 8), view("b", 8)];
    let header = |views| {
        let kind = v1::SceneKind::Unbounded.into();
        let header = v1::ImportHeader { scene: "town".into(), views, kind, ..v1::ImportHeader::default() };
        v1::ImportSceneRequest { part: Some(Part::Header(header)) }
    };
    let listed = |why: v1::Unused, photographs| {
        let listed = vec![v1::UnusedPhotographs { contributor: "eve".into(), why: why.into(), photographs }];
        let mut header = header(both());
        if let Some(Part::Header(header)) = &mut header.part {
            header.listed = listed;
        }
        header
    };
    let chunk = |view_index, bytes: usize| {
        let part = Part::Chunk(v1::PhotographChunk { view_index, data: vec![1; bytes].into(), is_mask: false });
        v1::ImportSceneRequest { part: Some(part) }
    };
    let points = |xyz| v1::ImportSceneRequest { part: Some(Part::Points(v1::PointChunk { xyz })) };
    let wide = {
        let mut views = both();
        views[0].camera.as_mut().unwrap().intrinsics.as_mut().unwrap().width = 20_000;
        views
    };
    let nan = {
        let mut views = both();
        views[0].camera.as_mut().unwrap().pose.as_mut().unwrap().position[0] = f64::NAN;
        views
    };
    for (messages, code, says) in [
        (vec![chunk(0, 8)], Code::InvalidArgument, "no header"),
        (vec![header(vec![])], Code::InvalidArgument, "number of views"),
        (vec![header(vec![view("a", 8), view("a", 8)])], Code::InvalidArgument, "twice"),
        (vec![header(vec![view("a", 8), view("b", 4096)])], Code::InvalidArgument, "limits.max_photograph_bytes"),
        (vec![header(nan)], Code::InvalidArgument, "not finite"),
        (
            vec![listed(v1::Unused::HeldOut, 1)],
            Code::InvalidArgument,
            "the reason for the photographs of eve is held out",
        ),
        (vec![listed(v1::Unused::Unspecified, 1)], Code::InvalidArgument, "listed: why"),
        (vec![listed(v1::Unused::NoCamera, 0)], Code::InvalidArgument, "photographs of eve"),
        (vec![header(wide)], Code::InvalidArgument, "limits.max_side_px"),
        (vec![header(both())], Code::InvalidArgument, "0 whole views"),
        (vec![header(both()), header(both())], Code::InvalidArgument, "no chunk"),
        (vec![header(both()), points(vec![0.0; 4])], Code::InvalidArgument, "multiple of 3"),
        (vec![header(both()), points(vec![f64::NAN; 3])], Code::InvalidArgument, "finite"),
        (vec![header(both()), chunk(1, 8)], Code::InvalidArgument, "view_index"),
        (vec![header(both()), chunk(0, 9)], Code::InvalidArgument, "longer"),
        (vec![header(both()), chunk(0, 8)], Code::InvalidArgument, "SHA-256"),
    ] {
        let refused = scenes.import(tokio_stream::iter(messages)).await.unwrap_err();
        assert_eq!(refused.code(), code, "{refused}");
        assert!(refused.message().contains(says), "{refused} does not say {says:?}");
    }
    let list = scenes.list(v1::ListScenesRequest {}).await.unwrap();
    assert!(list.into_inner().scenes.is_empty());
    assert_eq!(std::fs::read_dir(place.path("data/staging")).unwrap().count(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_with_a_token_asks_for_it_where_something_changes() {
    let place = Place::new();
    let settings = format!("[access]\ntoken_file = {:?}", place.token());
    let daemon = Daemon::start(&place.path("data"), &settings);
    let mut scenes = SceneServiceClient::connect(daemon.url.clone()).await.unwrap();
    let delete = || v1::DeleteSceneRequest { scene: "town".into() };
    assert_eq!(scenes.delete(delete()).await.unwrap_err().code(), Code::Unauthenticated);
    for (token, code) in [
        ("Bearer wrong", Code::Unauthenticated),
        ("a-token-of-the-test", Code::Unauthenticated),
        ("Bearer a-token-of-the-test", Code::NotFound),
    ] {
        let mut request = Request::new(delete());
        request.metadata_mut().insert("authorization", token.parse().unwrap());
        assert_eq!(scenes.delete(request).await.unwrap_err().code(), code, "{token}");
    }
    // So does a picture that is to be registered with the field, as base renders do; the classifier's answer is everybody's.
    let mut query = QueryServiceClient::connect(daemon.url.clone()).await.unwrap();
    let identify = |register| {
        let picture = vec![7; 99].into();
        v1::IdentifyRequest { scene: "town".into(), picture, register, ..Default::default() }
    };
    assert_eq!(query.identify(identify(true)).await.unwrap_err().code(), Code::Unauthenticated);
    let at = v1::IdentifyRequest { camera: view("images/ada_002.png"), ..identify(false) };
    assert_eq!(query.identify(at).await.unwrap_err().code(), Code::Unauthenticated);
    let locate = v1::LocateRequest { scene: "town".into(), picture: vec![7; 99].into(), compared: false };
    assert_eq!(query.locate(locate.clone()).await.unwrap_err().code(), Code::Unauthenticated);
    let mut request = Request::new(locate);
    request.metadata_mut().insert("authorization", "Bearer a-token-of-the-test".parse().unwrap());
    assert_eq!(query.locate(request).await.unwrap_err().code(), Code::NotFound);
    assert_eq!(query.identify(identify(false)).await.unwrap_err().code(), Code::InvalidArgument);
    let mut request = Request::new(identify(true));
    request.metadata_mut().insert("authorization", "Bearer a-token-of-the-test".parse().unwrap());
    assert_eq!(query.identify(request).await.unwrap_err().code(), Code::InvalidArgument);
    let nowhere = v1::IdentifyRequest { camera: Some(v1::Viewpoint { from: None }), ..identify(false) };
    assert_eq!(query.identify(nowhere).await.unwrap_err().code(), Code::InvalidArgument);
    // Reading is free.
    assert!(scenes.list(v1::ListScenesRequest {}).await.is_ok());
    let token = place.text("token");
    let refused = place.cairn(&["scene", "delete", "town", "--yes", "--connect", &daemon.url, "--token-file", &token]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("no scene"), "{refused:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn health_and_reflection_tell_the_truth_and_the_folder_has_one_owner() {
    use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
    use tonic_reflection::pb::v1::ServerReflectionRequest;
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "");
    let channel = tonic::transport::Endpoint::from_shared(daemon.url.clone()).unwrap().connect().await.unwrap();
    let mut health = HealthClient::new(channel.clone());
    for service in ["", "cairn.v1.SceneService", "cairn.v1.OwnerService"] {
        let answer = health.check(HealthCheckRequest { service: service.into() }).await.unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service}");
    }
    let ask = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut answers = ServerReflectionClient::new(channel)
        .server_reflection_info(tokio_stream::iter([ask]))
        .await
        .unwrap()
        .into_inner();
    let Some(MessageResponse::ListServicesResponse(list)) = answers.message().await.unwrap().unwrap().message_response
    else {
        panic!("no list of services")
    };
    let names: Vec<String> = list.service.into_iter().map(|s| s.name).collect();
    for service in ["Scene", "Training", "Render", "Query", "Owner", "Access"] {
        assert!(names.contains(&format!("cairn.v1.{service}Service")), "{names:?}");
    }

    // A second daemon is told who has the folder; a command is answered by that one.
    place.cairn_ok(&["scene", "list", "--data", &place.text("data")]);

    let port = daemon.url.strip_prefix("http://").unwrap();
    std::fs::write(place.path("same.toml"), format!("[server]\nbind = {port:?}\n")).unwrap();
    let serve = |folder: &str| {
        let refused = place.cairn(&["serve", "--data", &place.text(folder), "--config", &place.text("same.toml")]);
        assert!(!refused.status.success());
        String::from_utf8_lossy(&refused.stderr).into_owned()
    };
    // Also where it finds its port taken as well, which is no news where the folder is free.
    let said = serve("data");
    assert!(said.contains(&format!("in use by process {}", daemon.pid())), "{said}");
    let said = serve("other");
    assert!(said.contains(&format!("cannot listen at {port}: ")), "{said}");
    assert!(said.contains("set server.bind in the file of --config") && said.contains("port 0"), "{said}");
    assert_eq!(said.matches("os error").count(), 1, "{said}");

    // A setting that is unknown stops the start, by name.
    std::fs::write(place.path("wrong.toml"), "[limits]\nque_length = 5\n").unwrap();
    let wrong = place.text("wrong.toml");
    let refused = place.cairn(&["serve", "--data", &place.text("other"), "--config", &wrong]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("unknown key `limits.que_length`;"), "{said}");
    assert!(daemon.terminate().success());
}
