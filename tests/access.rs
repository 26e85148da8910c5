//! Who may do what, through the real daemon: accounts, tokens, roles, quotas.

use std::collections::BTreeSet;
use std::time::{SystemTime, UNIX_EPOCH};

use cairn_api::v1;
use cairn_api::v1::scene_service_client::SceneServiceClient;
use cairn_api::v1::training_service_client::TrainingServiceClient;
use cairn_log::OwnerKey;
use cairn_service::auth::roles::{Need, need};
use cairn_service::auth::{Daemon as Identity, sign};
use cairn_testkit::daemon::accounts::{ACCOUNTS, CLOSED, World, key};
use cairn_testkit::daemon::{Daemon, Place, base_only, endless};
use tonic::client::Grpc;
use tonic::transport::Channel;
use tonic::{Code, Request, Status};

const DELETE: &str = "/cairn.v1.SceneService/Delete";
const START: &str = "/cairn.v1.TrainingService/Start";
fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs()
}

fn bearing<T>(message: T, token: &str) -> Request<T> {
    let mut request = Request::new(message);
    request.metadata_mut().insert("authorization", format!("Cairn {token}").parse().unwrap());
    request
}

#[tokio::test(flavor = "multi_thread")]
async fn an_account_is_registered_approved_and_held_to_its_role() {
    let world = World::new(&format!("{ACCOUNTS}[training]\nquality = \"smoke\"\n"));
    key(&world.place, "ada");
    let asked = world.ok("ada", &["access", "register", "--name", "ada", "--role", "curator"]);
    assert!(asked.contains("ada  contributor, asked for curator  waiting"), "{asked}");
    let said = world.import("ada", "town").unwrap_err();
    assert!(said.contains("waits for an operator's approval"), "{said}");
    key(&world.place, "eve");
    world.refused("eve", &["scene", "delete", "town", "--yes"], "register its key first");
    let ada = world.key("ada").public().to_string();
    world.refused("ada", &["access", "approve", &ada], "waits for");
    let approved = world.ok("root", &["access", "approve", &ada, "--role", "contributor"]);
    assert!(approved.contains("active"), "{approved}");
    let (bob, _) = (world.with("bob", "contributor"), world.with("cara", "curator"));
    world.with("dan", "auditor");

    assert!(world.import("ada", "town").unwrap().contains("12 views"));
    for who in ["bob", "dan"] {
        let train = ["train", "town", "--by-contributor", "--base-only", "--detach"];
        let why = if who == "bob" { "the scene \"town\" belongs to another account" } else { "is auditor" };
        world.refused(who, &["scene", "delete", "town", "--yes"], why);
        world.refused(who, &train, why);
    }
    assert!(world.import("dan", "fern").unwrap_err().contains("needs the role contributor or curator or operator"));
    // What a view's fate is, its contributor may know and not decide.
    for who in ["ada", "cara", "dan", "root"] {
        let table = world.ok(who, &["scene", "check", "town"]);
        assert!(table.lines().count() >= 13 && table.contains("sigmas"), "{who}: {table}");
    }
    world.refused("bob", &["scene", "check", "town"], "belongs to another account");
    for change in ["exclude", "include"] {
        for who in ["ada", "bob", "dan"] {
            let arguments = ["scene", change, "town", "images/ada_002.png"];
            world.refused(who, &arguments, "needs the role curator or operator");
        }
    }
    let exclude = ["scene", "exclude", "town", "images/ada_002.png", "--why", "a dog"];
    assert!(world.ok("cara", &exclude).starts_with("1 view of town is excluded"));
    for list in ["check", "show"] {
        let listed = world.ok("ada", &["scene", list, "town"]);
        let line = listed.lines().find(|line| line.contains("images/ada_002.png")).unwrap();
        assert!(line.contains(" ada ") && line.contains("excluded (a dog)"), "{line}");
    }
    assert!(
        world
            .ok("root", &["scene", "include", "town", "images/ada_002.png"])
            .starts_with("no view of town is excluded")
    );
    world.refused("bob", &["scene", "delete", "none", "--yes"], "there is no scene \"none\"");
    world.ok("cara", &["scene", "delete", "town", "--yes"]);
    assert!(world.import("ada", "town").is_ok());
    world.ok("ada", &["scene", "delete", "town", "--yes"]);

    world.refused("cara", &["access", "list"], "needs the role auditor or operator");
    let listed = world.ok("dan", &["access", "list"]);
    assert!(listed.contains(&world.key("root").public().to_string()) && listed.lines().count() == 5, "{listed}");
    world.refused("bob", &["access", "set", &bob.to_string(), "--role", "operator"], "needs the role operator");
    world.refused("bob", &["access", "quota", &ada], "needs the role auditor or operator");
    let root = world.key("root").public().to_string();
    world.refused("root", &["access", "set", &root, "--disable"], "the last active operator");
    world.ok("root", &["access", "set", &bob.to_string(), "--disable"]);
    assert!(world.import("bob", "fern").unwrap_err().contains("\"bob\" is disabled"));
    world.ok("root", &["access", "set", &bob.to_string(), "--enable"]);

    // While the daemon runs, nobody adds accounts behind its back.
    let data = world.place.text("data");
    let add = ["access", "add", "--role", "operator", "--key", &ada, "--data", &data];
    let said = String::from_utf8_lossy(&world.place.cairn(&add).stderr).into_owned();
    assert!(said.contains(&format!("process {}", world.daemon.pid())), "{said}");
    assert!(said.contains("stop the daemon first") && !said.contains("--connect"), "{said}");
    // Who is no account is told how to name one.
    let said = world.place.cairn_refused(&["access", "quota", "--data", &data]);
    assert!(said.contains("--account FILE") && said.contains("cairn access quota KEY"), "{said}");
}

#[test]
fn the_first_operator_is_added_by_its_key_file_and_a_new_folder_is_told() {
    let place = Place::new();
    let public = key(&place, "grace");
    let data = place.text("data");
    let add = |key: &str| place.cairn(&["access", "add", "--role", "operator", "--key", key, "--data", &data]);
    let said = |output: std::process::Output| String::from_utf8_lossy(&output.stdout).into_owned();
    let first = said(add(&place.text("grace.key")));
    assert!(first.contains(&format!("began a new data folder {data}")) && first.contains("added operator"), "{first}");
    let listed = place.cairn_ok(&["access", "list", "--data", &data]);
    assert!(listed.starts_with(&public.to_string()), "{listed}");
    let ada = key(&place, "ada").to_string();
    assert_eq!(said(add(&ada)), "added operator, operator\n");
    let refused = add("grce.key");
    let refused = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.contains("nor a key's file") && refused.contains("cairn keys show"), "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_good_for_one_call_of_one_run() {
    let mut world = World::new(ACCOUNTS);
    world.with("cara", "curator");
    let (cara, here) = (world.key("cara"), world.identity().await);
    let signed =
        |here: &Identity, method: &str, scene: &str, at: u64| sign(&cara, here, method, scene, at, 60).unwrap();
    let delete = || v1::DeleteSceneRequest { scene: "town".into() };
    let mut scenes = SceneServiceClient::new(world.channel().await);

    let good = signed(&here, DELETE, "town", now());
    assert_eq!(scenes.delete(bearing(delete(), &good)).await.unwrap_err().code(), Code::NotFound);
    for (token, says) in [
        (good.clone(), "used already"),
        (signed(&here, DELETE, "town", now() - 1000), "expired"),
        (signed(&here, DELETE, "town", now() + 1000), "issued at"),
        (signed(&here, DELETE, "fern", now()), "about scene \"fern\""),
        (signed(&here, START, "town", now()), "sign one for this call"),
        ("x".repeat(40), "cannot be read"),
    ] {
        let refused = scenes.delete(bearing(delete(), &token)).await.unwrap_err();
        assert_eq!(refused.code(), Code::Unauthenticated, "{refused}");
        assert!(refused.message().contains(says), "{refused} does not say {says:?}");
    }

    let early = signed(&here, DELETE, "town", now());
    world.daemon.kill();
    world.daemon = Daemon::start(&world.place.path("data"), ACCOUNTS);
    let mut scenes = SceneServiceClient::new(world.channel().await);
    for token in [early, good] {
        let refused = scenes.delete(bearing(delete(), &token)).await.unwrap_err();
        assert!(refused.message().contains("an earlier run of this daemon"), "{refused}");
    }
    // Pinned, the command signs for no other daemon.
    let (vkey, other) = (world.place.text("vkey"), world.place.text("other.vkey"));
    world.ok("cara", &["owners", "vkey", "--out", &vkey]);
    world.place.cairn_ok(&["owners", "vkey", "--data", &world.place.text("other"), "--out", &other]);
    world.refused("cara", &["scene", "delete", "town", "--yes", "--daemon-vkey", &vkey], "no scene \"town\"");
    world.refused("cara", &["scene", "delete", "town", "--yes", "--daemon-vkey", &other], "and the pinned one");
}

/// Calls a method by its path with a message that holds its version and nothing else: all have that field.
async fn call(channel: &Channel, path: &'static str, token: Option<&str>) -> Result<(), Status> {
    let mut client = Grpc::new(channel.clone());
    client.ready().await.unwrap();
    let codec = tonic_prost::ProstCodec::<v1::ListScenesRequest, ()>::default();
    let message = v1::ListScenesRequest {};
    let request = token.map_or_else(|| Request::new(message), |token| bearing(message, token));
    let path = tonic::codegen::http::uri::PathAndQuery::from_static(path);
    client.server_streaming(request, path, codec).await?.into_inner().message().await.map(drop)
}

#[tokio::test(flavor = "multi_thread")]
async fn no_method_of_the_contract_is_forgotten() {
    // What needs no token where reading is open. Whoever adds a method decides, here and in the table of roles.
    let open: BTreeSet<&str> = [
        "AccessService/About",
        "AccessService/Nonce",
        "AccessService/Register",
        "SceneService/List",
        "SceneService/Get",
        "SceneService/DrawPoses",
        "TrainingService/Watch",
        "TrainingService/List",
        "RenderService/Render",
        "RenderService/RenderPath",
        "QueryService/Identify",
        "QueryService/Contributors",
        "OwnerService/Answer",
        "OwnerService/List",
        "OwnerService/Get",
        "OwnerService/Checkpoint",
        "OwnerService/Proof",
    ]
    .into();
    for (settings, closed) in [(ACCOUNTS, false), (CLOSED, true)] {
        let world = World::new(settings);
        let (channel, root, here) = (world.channel().await, world.key("root"), world.identity().await);
        for path in v1::METHODS.iter().copied() {
            let anyone = need(path) == Some(Need::Anyone);
            let free = open.contains(path.trim_start_matches("/cairn.v1.")) && (anyone || !closed);
            let code = call(&channel, path, None).await.err().map(|status| status.code());
            assert_eq!(code == Some(Code::Unauthenticated), !free, "{path} without a token: {code:?}");
            if !free {
                // Nor does a token of the operator's help that is for another call, or for another scene.
                let elsewhere = if path == DELETE { START } else { DELETE };
                let token = sign(&root, &here, elsewhere, "", now(), 60).unwrap();
                let refused = call(&channel, path, Some(&token)).await.unwrap_err();
                assert_eq!(refused.code(), Code::Unauthenticated, "{path}: {refused}");
                let token = sign(&root, &here, path, "elsewhere", now(), 60).unwrap();
                let with_scene = call(&channel, path, Some(&token)).await;
                let guarded = need(path).is_some_and(Need::is_guarded);
                assert!(with_scene.is_err() || !guarded, "{path} took a token about another scene");
            }
        }
        let mut health = tonic_health::pb::health_client::HealthClient::new(channel.clone());
        health.check(tonic_health::pb::HealthCheckRequest::default()).await.unwrap();
        let unknown = call(&channel, "/cairn.v1.SceneService/Rename", None).await.unwrap_err();
        assert_eq!(unknown.code(), Code::Unimplemented, "{unknown}");

        // Any account reads.
        world.with("dan", "auditor");
        world.ok("dan", &["scene", "list"]);
        let anybody = world.place.cairn(&["scene", "list", "--connect", &world.daemon.url]);
        assert_eq!(anybody.status.success(), !closed, "{anybody:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_quota_of_views_refuses_an_import_and_leaves_nothing() {
    let world = World::new(&format!("{ACCOUNTS}[access.quota]\nviews = 20\n"));
    let ada = world.with("ada", "contributor").to_string();
    world.ok("root", &["access", "quota", &ada, "--views", "3"]);
    let said = world.import("ada", "town").unwrap_err();
    assert!(said.contains("quota `views` is 3: 0 used, 12 more asked for"), "{said}");
    for folder in ["scenes", "staging", "owners"] {
        let left = std::fs::read_dir(world.place.path("data").join(folder)).unwrap().count();
        assert_eq!(left, 0, "{folder}");
    }
    assert!(world.ok("ada", &["access", "quota"]).contains("views             0 of 3"));
    world.ok("root", &["access", "quota", &ada, "--default"]);
    world.import("ada", "town").unwrap();
    assert!(world.ok("ada", &["access", "quota"]).contains("views             12 of 20"));
    assert!(world.import("ada", "fern").unwrap_err().contains("12 used, 12 more asked for; deleting a scene"));
    assert!(world.import("root", "fern").is_ok(), "others have their own");
    world.ok("ada", &["scene", "delete", "town", "--yes"]);
    assert!(world.ok("ada", &["access", "quota"]).contains("views             0 of 20"));
}

#[tokio::test(flavor = "multi_thread")]
async fn trainings_are_held_to_the_owners_quotas_and_records_to_their_key() {
    let world = World::new(&format!("{ACCOUNTS}[access.quota]\nqueued_jobs = 1\n"));
    let (ada, _) = (world.with("ada", "contributor").to_string(), world.with("bob", "contributor"));
    world.import("ada", "town").unwrap();
    let train = ["train", "town", "--by-contributor", "--base-only", "--quality", "smoke"];
    assert!(world.ok("ada", &train).contains("done"));

    // Records: under one's own key, whoever imported the scene.
    let (own, other) = (world.place.text("bob.key"), world.place.text("ada.key"));
    for (key, out) in [(&other, "refused"), (&own, "taken")] {
        let out_folder = world.place.text(out);
        let sign =
            ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", key, "--out", &out_folder];
        if out == "taken" { drop(world.ok("bob", &sign)) } else { world.refused("bob", &sign, "did not sign") }
    }
    let view = "images/none.png";
    let base = ["render", "town", "--view", view, "--base", "--out", "x.png"];
    world.refused("bob", &base, "belongs to another account");
    world.refused("ada", &base, "there is no view");
    // In the light of a photograph that the caller brings a mark may be nearly all there is to see.
    let photograph = world.place.text("capture/images/ada_001.png");
    let light = ["--light-of", &photograph, "--taken-view", view];
    let (one, path) = (["--view", view, "--out", "x.png"], ["--path", "orbit", "--out", "x.gif"]);
    for seen in [one, path] {
        let marked = [&["render", "town"][..], &seen].concat();
        let marked = &marked[..];
        world.refused("bob", &[marked, &light].concat(), "belongs to another account");
        let said = world.run("ada", &[marked, &light].concat()).unwrap_err();
        assert!(!said.contains("another account") && !said.contains("needs a signed token"), "{said}");
        let anybody = world.place.cairn(&[marked, &light, &["--connect", &world.daemon.url]].concat());
        let said = String::from_utf8_lossy(&anybody.stderr).into_owned();
        assert!(!anybody.status.success() && said.contains("needs a signed token"), "{said}");
    }
    world.refused("bob", &["evaluate", "town"], "belongs to another account");
    // Nor is a picture registered with the field for them.
    let picture = world.place.text("capture/images/ada_002.png");
    world.refused("bob", &["identify", "town", &picture, "--register"], "belongs to another account");
    world.refused("bob", &["locate", "town", &picture], "belongs to another account");
    // Its owner, curators and auditors get as far as that there is no mark yet.
    let _ = (world.with("cara", "curator"), world.with("dan", "auditor"));
    for who in ["ada", "cara", "dan"] {
        world.refused(who, &["identify", "town", &picture, "--register"], "base field alone");
        assert!(world.ok(who, &["locate", "town", &picture]).starts_with("not found: "), "{who}");
    }

    // Nobody takes another's scene along in a training of their own.
    world.import("bob", "mill").unwrap();
    world.refused("bob", &["train", "mill", "--with", "town", "--by-contributor"], "belongs to another account");

    // One at a time; cancelling frees it. Nobody but its owner or a curator cancels it.
    let (key, here) = (world.key("ada"), world.identity().await);
    let mut training = TrainingServiceClient::new(world.channel().await);
    let token = |who: &OwnerKey, method: &str| sign(who, &here, method, "town", now(), 60).unwrap();
    let start = || bearing(base_only("town", 1, endless()), &token(&key, START));
    let job = training.start(start()).await.unwrap().into_inner().job.unwrap();
    let full = training.start(start()).await.unwrap_err();
    assert_eq!(full.code(), Code::ResourceExhausted, "{full}");
    assert!(full.message().contains("`queued_jobs` is 1: 1 used"), "{full}");
    let path = "/cairn.v1.TrainingService/Cancel";
    let cancel = |who: &OwnerKey| {
        let request = v1::CancelTrainingRequest { job_id: job.id.clone() };
        bearing(request, &token(who, path))
    };
    let refused = training.cancel(cancel(&world.key("bob"))).await.unwrap_err();
    assert_eq!(refused.code(), Code::PermissionDenied, "{refused}");
    training.cancel(cancel(&key)).await.unwrap();
    assert!(world.ok("ada", &["access", "quota"]).contains("queued jobs       0 of 1"));

    // A training that uses up its owner's seconds is put down at a checkpoint, and says so.
    let used = world.ok("ada", &["access", "quota"]);
    let used: u64 = used.lines().nth(2).unwrap().split_whitespace().nth(2).unwrap().parse().unwrap();
    assert!(used >= 1);
    world.ok("root", &["access", "quota", &ada, "--training-seconds", &(used + 1).to_string()]);
    let job = training.start(start()).await.unwrap().into_inner().job.unwrap();
    let watch = v1::WatchTrainingRequest { job_id: job.id.clone() };
    let mut line = training.watch(watch).await.unwrap().into_inner();
    let mut last = None;
    while let Some(message) = line.message().await.unwrap() {
        last = message.job;
    }
    let last = last.unwrap();
    assert_eq!(last.state(), v1::JobState::Failed);
    assert!(
        last.error.contains("put down at a checkpoint") && last.error.contains("`training_seconds`"),
        "{}",
        last.error
    );
    // The seconds end while the scene is still screened, or in stage 1 where the machine is quick:
    // both are resumed from theirs.
    let folder = world.place.path("data/jobs").join(&job.id);
    let kept = ["screening.checkpoint", "base.checkpoint"].map(|name| folder.join(name).exists());
    assert!(kept[0] != kept[1], "one checkpoint, of the stage that was put down: {kept:?}");
    let spent = training.start(start()).await.unwrap_err();
    assert_eq!(spent.code(), Code::ResourceExhausted, "{spent}");
    world.refused("ada", &["train", "town", "--resume", &job.id], "`training_seconds`");
    world.ok("root", &["access", "quota", &ada, "--training-seconds", "0"]);
    world.ok("ada", &["train", "town", "--resume", &job.id, "--detach"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_binding_is_a_curators_under_their_own_key() {
    let world = World::new(ACCOUNTS);
    let ada = world.with("ada", "contributor").to_string();
    for (who, role) in [("eve", "contributor"), ("cara", "curator"), ("dora", "curator"), ("dan", "auditor")] {
        world.with(who, role);
    }
    world.import("ada", "town").unwrap();
    let bind = |who: &str, key: &str, to: &str| {
        let (key, out) =
            (world.place.text(&format!("{key}.key")), world.place.text(&format!("{who} binds {to} by {key}")));
        let name = ["owners", "bind", "town", "--contributor", "ada", "--owner-key", to, "--key", &key, "--out", &out];
        world.run(who, &name)
    };
    let claim = |who: &str| {
        let (key, out) = (world.place.text(&format!("{who}.key")), world.place.text(&format!("claim of {who}")));
        world.ok(who, &["owners", "sign", "town", "--contributor", "ada", "--key", &key, "--out", &out]);
    };
    // A stranger claims first, without any training, and binds the name to herself: in vain.
    claim("eve");
    claim("ada");
    let eve = world.key("eve").public().to_string();
    let refused = bind("eve", "eve", &eve).unwrap_err();
    assert!(refused.contains("needs the role curator or operator"), "{refused}");
    // Nor does who imported the scene, or an auditor, or a curator under a key that is not their account's.
    for (who, key, why) in [
        ("ada", "ada", "needs the role curator or operator"),
        ("dan", "dan", "is auditor"),
        ("cara", "eve", "did not sign"),
        ("cara", "dora", "did not sign"),
    ] {
        let refused = bind(who, key, &ada).unwrap_err();
        assert!(refused.contains(why), "{who} under {key}'s key: {refused}");
    }
    let listed = world.ok("ada", &["owners", "list", "town"]);
    assert_eq!(listed.matches("claim  town  contributor \"ada\"  stands, name unconfirmed").count(), 2, "{listed}");
    let said = bind("cara", "cara", &ada).unwrap();
    assert!(said.contains("\"ada\" stands for key") && said.contains(&ada), "{said}");
    let listed = world.ok("ada", &["owners", "list", "town"]);
    let states: Vec<&str> = listed.lines().map(|line| line.split("  by key id").next().unwrap()).collect();
    let wanted = [
        "0  claim  town  contributor \"ada\"  stands, name unconfirmed",
        "2  claim  town  contributor \"ada\"  stands, name confirmed by record 4",
        "4  binding  town  contributor \"ada\"  stands",
    ];
    assert_eq!(states, wanted);
    // Another curator, and an operator, may bind the name anew: the newest counts.
    bind("dora", "dora", &eve).unwrap();
    let shown = world.ok("dan", &["owners", "show", "0"]);
    assert!(shown.contains("stands, name confirmed by record 6") && shown.contains("contributor    ada"), "{shown}");
    bind("root", "root", &ada).unwrap();
    assert!(world.ok("dan", &["owners", "show", "0"]).contains("stands, name unconfirmed"));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_account_continues_under_the_key_that_took_its_keys_place_and_ends_with_it() {
    let mut world = World::new(ACCOUNTS);
    let ada = world.with("ada", "contributor").to_string();
    key(&world.place, "next");
    world.import("ada", "town").unwrap();
    world.ok("ada", &["train", "town", "--by-contributor", "--base-only", "--quality", "smoke"]);
    world.ok("root", &["access", "quota", &ada, "--views", "13"]);
    let (own, next) = (world.place.text("ada.key"), world.place.text("next.key"));
    let out = |name: &str| world.place.text(name);
    let sign = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution"];
    world.ok("ada", &[&sign[..], &["--key", &own, "--out", &out("first")]].concat());
    let token_of_old = {
        let (here, old) = (world.identity().await, world.key("ada"));
        sign_for(&old, &here, "town")
    };
    let rotate = ["keys", "rotate", "town", "--record", "0", "--key", &own, "--new-key", &next];
    world.ok("ada", &[&rotate[..], &["--out", &out("rotation")]].concat());

    // The old key's tokens stop, those signed before included; role, quota and scenes are the new one's.
    let mut scenes = SceneServiceClient::new(world.channel().await);
    let delete = v1::DeleteSceneRequest { scene: "town".into() };
    let refused = scenes.delete(bearing(delete, &token_of_old)).await.unwrap_err();
    assert!(refused.code() == Code::PermissionDenied && refused.message().contains("continues under key"), "{refused}");
    world.refused("ada", &["access", "quota"], "continues under key");
    assert!(world.ok("next", &["access", "quota"]).contains("views             12 of 13"));
    assert!(world.import("next", "fern").unwrap_err().contains("`views` is 13: 12 used"));
    let next_key = world.key("next").public().to_string();
    assert!(world.ok("root", &["access", "list"]).contains(&format!("signed for by {next_key}")));
    world.ok("root", &["access", "quota", &next_key, "--views", "40"]);
    world.ok("next", &[&sign[..], &["--key", &next, "--out", &out("second")]].concat());

    // A key that was rotated away gets no other account, whoever has it.
    world.refused("ada", &["access", "register", "--name", "again"], "was ended by record");
    // Also after a restart; and registering the new key changes nothing.
    assert!(world.daemon.terminate().success());
    world.daemon = Daemon::start(&world.place.path("data"), CLOSED);
    let again = world.ok("next", &["access", "register", "--name", "another"]);
    assert!(again.contains(&ada) && again.contains("contributor"), "{again}");
    world.refused("ada", &["scene", "delete", "town", "--yes"], "continues under key");

    // Revoked: nobody acts for the account, and the key gets no other. It reads no more either, but the proof of this very
    // record came with its acknowledgement.
    let revoke = ["keys", "revoke", "town", "--key", &next, "--purpose", "lost", "--out"];
    world.ok("next", &[&revoke[..], &[&world.place.text("revocation")]].concat());
    world.refused("next", &["scene", "list"], "was ended by record");
    let (bundle, vkey) = (world.place.text("revocation"), world.place.text("revocation/log.vkey"));
    assert!(world.place.cairn_ok(&["audit", "bundle", &bundle, "--vkey", &vkey]).starts_with("trusted"));
    for who in ["ada", "next"] {
        world.refused(who, &["scene", "delete", "town", "--yes"], "was ended by record");
        world.refused(who, &["access", "register", "--name", "again"], "was ended by record");
    }
    assert!(world.ok("root", &["access", "list"]).contains("its key ended by record"));
    world.ok("root", &["scene", "delete", "town", "--yes"]);
}

fn sign_for(key: &OwnerKey, here: &Identity, scene: &str) -> String {
    sign(key, here, DELETE, scene, now(), 60).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_quota_of_records_stops_a_flood_and_no_revocation() {
    let world = World::new(&format!("{ACCOUNTS}[access.quota]\nrecords_per_day = 2\n"));
    let (ada, _) = (world.with("ada", "contributor").to_string(), world.with("bob", "contributor"));
    world.import("ada", "town").unwrap();
    world.ok("ada", &["train", "town", "--by-contributor", "--base-only", "--quality", "smoke"]);
    let own = world.place.text("ada.key");
    let out = |name: &str| world.place.text(name);
    let sign_as = |key: &str, to: &str| {
        ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", key, "--out", to]
            .map(str::to_owned)
    };
    let submit = |who: &str, key: &str, to: &str| {
        let line = sign_as(key, &out(to));
        world.run(who, &line.iter().map(String::as_str).collect::<Vec<_>>())
    };
    // What the registry refuses costs nothing.
    let foreign = ["owners", "sign", "town", "--identity", "9", "--key", &own, "--out", &out("none")];
    assert!(world.run("ada", &foreign).is_err());
    submit("ada", &own, "first").unwrap();
    submit("ada", &own, "second").unwrap();
    let said = submit("ada", &own, "third").unwrap_err();
    assert!(said.contains("quota `records_per_day` is 2: 2 used, 1 more asked for"), "{said}");
    assert!(world.ok("ada", &["access", "quota"]).contains("records per day   2 of 2"));
    submit("bob", &out("bob.key"), "bobs").unwrap();
    world.ok("root", &["access", "quota", &ada, "--records", "3", "--records-per-day", "0"]);
    submit("ada", &own, "third").unwrap();
    let said = submit("ada", &own, "fourth").unwrap_err();
    assert!(said.contains("quota `records` is 3: 3 used") && said.contains("an operator can raise it"), "{said}");
    // Whose key is stolen must not wait.
    let revoke = ["keys", "revoke", "town", "--key", &own, "--purpose", "stolen", "--out", &out("end")];
    world.ok("ada", &revoke);
}
