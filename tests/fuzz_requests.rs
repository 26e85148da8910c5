//! Hostile requests: every method that the descriptors list is sent arbitrary bytes, messages made of its own fields
//! with values good and bad, and mutations of those. One daemon takes them all: each must be answered with a status, no
//! thread of it may panic, its memory stays bounded, and afterwards it serves as before.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Write as _;

use cairn_api::v1;
use cairn_log::OwnerKey;
use cairn_testkit::daemon::wire::{Contract, Method, Pool, call, call_compressed};
use cairn_testkit::daemon::{Daemon, Place};
use cairn_testkit::samples;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

/// Small, so that what gets through costs little and the bounds are met often.
const SETTINGS: &str = r#"
[limits]
max_message_bytes = 262144
max_photograph_bytes = 65536
max_side_px = 256
max_pixels = 16384
max_path_frames = 16
max_scene_bytes = 4194304
queue_length = 4
[training]
quality = "smoke"
"#;

/// The daemon's memory at its highest, KiB: twice what it takes for a few good requests in a debug build.
#[cfg(target_os = "linux")]
const MAX_RESIDENT_KIB: u64 = 768 << 10;

/// Requests a method: a part of `CAIRN_FUZZ_CASES`, as each goes through a daemon.
fn requests() -> usize {
    (cairn_testkit::cases() / 75) as usize
}

fn pool(place: &Place) -> Pool {
    let names = |texts: &[&str]| texts.iter().map(|t| (*t).to_owned()).collect::<Vec<_>>();
    let view = std::fs::read_dir(place.path("capture/images")).map_or_else(
        |_| "none".to_owned(),
        |mut folder| folder.next().unwrap().unwrap().file_name().to_string_lossy().into_owned(),
    );
    let views = vec![format!("images/{view}"), view];
    let mut texts: HashMap<&'static str, Vec<String>> = HashMap::new();
    texts.insert("scene", names(&["town", "town", "city"]));
    texts.insert("name", names(&["a", "b", "c"]));
    texts.insert("contributor", names(&["ada", "ben"]));
    texts.insert("job_id", names(&["job-000001", "job-000002", "job-000009"]));
    for name in ["view_name", "view_names", "from_view", "to_view"] {
        texts.insert(name, views.clone());
    }
    let picture = cairn_scene::encode_png(&cairn_scene::Picture::constant(32, 32, [0.5; 3]));
    let key = OwnerKey::from_seed(&[1; 32]).public().to_bytes().to_vec();
    let envelope =
        br#"{"payload":"e30=","payloadType":"application/vnd.cairn.owner-record.v1+json","signatures":[{"sig":""}]}"#;
    Pool { texts, bytes: vec![vec![], vec![0; 32], key, picture, envelope.to_vec(), vec![7; 300]] }
}

/// What each method answered, by code.
type Answers = BTreeMap<String, BTreeMap<String, usize>>;

fn note(answers: &mut Answers, method: &Method, answer: Result<usize, Status>) {
    let code = match answer {
        Ok(_) => Code::Ok,
        Err(status) => {
            let code = status.code();
            // A handler that panics breaks the line, a thread of it that does is reported as such.
            let broken = matches!(code, Code::Unknown | Code::Cancelled | Code::Unimplemented);
            assert!(!broken && !status.message().contains("ended early"), "{}: {status:?}", method.path);
            assert!(!status.message().is_empty(), "{}: {code:?} without a word", method.path);
            // What is no message of this type is refused below the handlers, under this code; a handler has no excuse for it.
            let unread = ["failed to decode Protobuf message", "Missing request message"];
            let excused = unread.iter().any(|why| status.message().contains(why));
            assert!(code != Code::Internal || excused, "{}: {status:?}", method.path);
            code
        }
    };
    *answers.entry(method.path.clone()).or_default().entry(format!("{code:?}")).or_default() += 1;
}

async fn attack(channel: &Channel, contract: &Contract, method: &Method, pool: &Pool, answers: &mut Answers) {
    let mut random = ChaCha8Rng::seed_from_u64(method.path.len() as u64);
    let good: Vec<Vec<u8>> = (0..12).map(|_| contract.message(&method.input, pool, &mut random)).collect();
    let good: Vec<&[u8]> = good.iter().map(Vec::as_slice).collect();
    let mut spoilt = samples(&method.path, &good);
    for round in 0..requests() {
        let mut next = || match round % 2 {
            0 => contract.message(&method.input, pool, &mut random),
            _ => spoilt.next().unwrap(),
        };
        let count = if method.client_streams { 1 + round % 5 } else { 1 };
        let messages = (0..count).map(|_| next()).collect();
        note(answers, method, call(channel, &method.path, messages).await);
    }
    // No message at all, more than one, and more than is taken.
    note(answers, method, call(channel, &method.path, vec![]).await);
    note(answers, method, call(channel, &method.path, vec![vec![], vec![0xff; 9]]).await);
    note(answers, method, call(channel, &method.path, vec![vec![8; 300_000]]).await);
    let refused = call_compressed(channel, &method.path).await;
    assert_eq!(refused.code(), Code::Unimplemented, "{}: {refused}", method.path);
}

/// Bytes that are no HTTP/2, and HTTP/2 that is no gRPC.
fn noise_at_the_door(url: &str) {
    let address = url.strip_prefix("http://").unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for round in 0..40 {
        let mut line = std::net::TcpStream::connect(address).unwrap();
        let mut bytes = if round % 2 == 0 { vec![] } else { b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec() };
        bytes.extend((0..random.random_range(1..2000)).map(|_| random.random::<u8>()));
        // The daemon may hang up at any byte.
        let _ = line.write_all(&bytes);
    }
}

#[cfg(target_os = "linux")]
fn assert_memory_is_bounded(pid: u32) {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    let peak: u64 = peak.trim().trim_end_matches(" kB").parse().unwrap();
    println!("the daemon's memory at its highest: {} MiB", peak >> 10);
    assert!(peak < MAX_RESIDENT_KIB, "the daemon took {peak} KiB");
}

#[cfg(not(target_os = "linux"))]
fn assert_memory_is_bounded(_pid: u32) {
    println!("SKIPPED the bound on the daemon's memory: it is read from Linux's /proc");
}

async fn serves(channel: &Channel) {
    use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
    let mut health = HealthClient::new(channel.clone());
    for service in ["", "cairn.v1.SceneService", "cairn.v1.OwnerService"] {
        let answer = health.check(HealthCheckRequest { service: service.into() }).await.unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_method_answers_hostile_requests_and_the_daemon_goes_on() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
    let log = File::create(place.path("daemon.log")).unwrap();
    let daemon = Daemon::start_logging(&place.path("data"), SETTINGS, log);
    let channel = Endpoint::from_shared(daemon.url.clone()).unwrap().connect().await.unwrap();

    let contract = Contract::read(v1::FILE_DESCRIPTOR_SET);
    let mut methods = contract.methods.clone();
    assert!(methods.len() >= 24, "{} methods found", methods.len());
    // What destroys comes last, or the rest would find nothing to work on.
    methods.sort_by_key(|method| (method.path.contains("Delete"), method.path.contains("Remove")));
    let (pool, mut answers) = (pool(&place), Answers::new());
    for method in &methods {
        attack(&channel, &contract, method, &pool, &mut answers).await;
    }
    noise_at_the_door(&daemon.url);

    for (path, codes) in &answers {
        println!("{path}: {codes:?}");
    }
    let reached = answers.values().filter(|codes| codes.contains_key("Ok")).count();
    // A daemon that asks nobody who they are keeps no accounts: all that changes or lists them is refused.
    let working = methods.iter().filter(|method| !method.path.contains("AccessService")).count();
    assert!(2 * reached > working, "only {reached} methods ever did their work: the messages are too bad");
    let looked_at =
        |codes: &BTreeMap<String, usize>| codes.keys().any(|code| !["Internal", "OutOfRange"].contains(&code.as_str()));
    assert!(answers.values().all(looked_at), "a method has not seen one message of its own type");
    serves(&channel).await;
    assert_memory_is_bounded(daemon.pid());
    assert!(daemon.terminate().success());
    let said = std::fs::read_to_string(place.path("daemon.log")).unwrap();
    assert!(!said.contains("panicked at"), "{said}");
    // The folder is whole: a command opens it, and the log with it.
    place.cairn_ok(&["owners", "list", "--data", &data]);
}
