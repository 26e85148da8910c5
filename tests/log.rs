//! A log at work, through real processes: cosigned by a witness, served over HTTP, followed, asked completely; and an
//! older backup of it that is refused at the start, whoever notices: a witness, what was published, or the anchor.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use cairn_api::v1;
use cairn_api::v1::owner_service_client::OwnerServiceClient;
use cairn_log::format::record::{self, Digests, Identity, Seen, photographs_root, random_salt};
use cairn_log::{Checkpoint, Digest, Note, OwnerKey, OwnerRecord, Policy, RecordKind};
use cairn_testkit::copy;
use cairn_testkit::daemon::{Daemon, Place};
use tonic::transport::Channel;

/// A running `cairn witness serve`; ends with the test.
struct Witness {
    child: Child,
    url: String,
    vkey: String,
}

impl Witness {
    fn start(place: &Place, log: &Path) -> Self {
        let mut child = cairn_testkit::daemon::command()
            .args(["witness", "serve", "--listen", "127.0.0.1:0", "--name", "witness.example/w"])
            .args(["--key", &place.text("witness.key"), "--folder", &place.text("witness")])
            .args(["--log", &log.display().to_string()])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        let url = lines.next().unwrap().rsplit(' ').next().unwrap().to_owned();
        Self { child, url, vkey: lines.next().unwrap() }
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn photographs(numbers: std::ops::Range<u32>) -> Vec<Digest> {
    let mut digests: Vec<_> = numbers.map(|number| Digest::of(number.to_be_bytes())).collect();
    digests.sort_unstable();
    digests
}

/// Enters a contribution of photographs of the town; its index.
async fn contribute(client: &mut OwnerServiceClient<Channel>, by: u8, of: std::ops::Range<u32>) -> u64 {
    let key = OwnerKey::from_seed(&[by; 32]);
    let owner_key = key.public().to_bytes().to_vec().into();
    let request = v1::NonceRequest { scene: "town".into(), owner_key };
    let nonce = client.nonce(request).await.unwrap().into_inner();
    let seen = Checkpoint::parse_text(&Note::parse(&nonce.checkpoint).unwrap().text).unwrap();
    let views = photographs(of);
    let record = OwnerRecord {
        version: record::VERSION,
        kind: RecordKind::Contribution,
        origin: nonce.origin,
        scene: "town".into(),
        scene_salt: random_salt().unwrap(),
        identity: Identity::numbered(1, &format!("contributor {by}")),
        owner_key: key.public(),
        digests: Digests { photographs: Some(photographs_root(&views)), ..Digests::default() },
        seed: None,
        purpose: "credit".into(),
        nonce: nonce.nonce.parse().unwrap(),
        seen: Seen { size: seen.size, root: seen.root },
        replaces: None,
        views: Some(views),
    };
    let envelope = record.seal(&key).unwrap().to_json().into_bytes().into();
    let answer = client.submit(v1::SubmitRecordRequest { envelope }).await.unwrap();
    answer.into_inner().record.unwrap().index
}

/// A start that has to fail; what it says.
fn refused(place: &Place, data: &str, config: &str) -> String {
    // On a port of its own: another test may have the usual one at this very moment.
    std::fs::write(place.path("refused.toml"), format!("{config}\n[server]\nbind = \"127.0.0.1:0\"\n")).unwrap();
    let said = place.cairn(&["serve", "--data", &place.text(data), "--config", &place.text("refused.toml")]);
    assert!(!said.status.success());
    String::from_utf8_lossy(&said.stderr).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_log_is_cosigned_served_followed_and_asked_and_its_older_self_is_refused() {
    let place = Place::new();
    place.cairn_ok(&["keys", "new", "--plain", &place.text("witness.key")]);
    place.cairn_ok(&["owners", "vkey", "--data", &place.text("data"), "--out", &place.text("log.vkey")]);
    let witness = Witness::start(&place, &place.path("log.vkey"));
    let settings =
        format!("[registry]\nhttp_bind = \"127.0.0.1:0\"\nwitnesses = [\"{} {}\"]\n", witness.vkey, witness.url);
    let daemon = Daemon::start(&place.path("data"), &settings);
    let mut client = OwnerServiceClient::connect(daemon.url.clone()).await.unwrap();
    let one = contribute(&mut client, 1, 0..4).await;
    let two = contribute(&mut client, 2, 2..6).await;

    // A proof comes with the witness's cosignature, which a policy asks for.
    let proof = client.proof(v1::ProofRequest { index: two }).await.unwrap().into_inner().tlog_proof;
    let log = std::fs::read_to_string(place.path("log.vkey")).unwrap();
    let policy = format!("log {}\nwitness w {}\nquorum w\n", log.trim(), witness.vkey);
    let (_, note) = proof.split_once("\n\n").unwrap();
    let verdict = Policy::parse(&policy).unwrap().check(note).unwrap();
    assert!(verdict.quorum.holds(), "{verdict:?}");
    std::fs::write(place.path("policy"), policy).unwrap();

    // Who contributed to a photograph: nobody is left out, and an older checkpoint is gone on from.
    let asked = |number: u32| v1::AnswerRequest {
        scene: "town".into(),
        of: Some(v1::answer_request::Of::PhotographSha256(Digest::of(number.to_be_bytes()).as_bytes().to_vec().into())),
        as_of: note.to_owned(),
    };
    for (number, wanted) in [(0, vec![one]), (3, vec![one, two]), (5, vec![two]), (9, vec![])] {
        let answer = client.answer(asked(number)).await.unwrap().into_inner().answer;
        let report = cairn_verify::audit_answer(&answer, Some(&log.trim().parse().unwrap()));
        assert_eq!(report.outcome, cairn_verify::Outcome::Trusted, "{report}");
        assert_eq!(report.credited().map(|r| r.index).collect::<Vec<_>>(), wanted, "{report}");
    }

    // A backup, and then the log goes on.
    copy(&place.path("data"), &place.path("backup"));
    let three = contribute(&mut client, 3, 0..4).await;
    client.proof(v1::ProofRequest { index: three }).await.unwrap();
    assert!(daemon.terminate().success());
    let (vkey, data) = (place.text("log.vkey"), place.text("data"));
    place.cairn_ok(&["audit", "store", &data, "--vkey", &vkey, "--policy", &place.text("policy")]);
    // An operator who takes it for the newest is told better by the witness.
    let beside = |name: &str| {
        let ends = |path: &PathBuf| path.extension().is_some_and(|end| end == "anchor");
        let of = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with(&format!("{name}."));
        let mut found = std::fs::read_dir(place.dir.path()).unwrap().map(|entry| entry.unwrap().path());
        found.find(|path| ends(path) && of(path))
    };
    place.cairn_ok(&["registry", "anchor", "--accept", "--data", &place.text("backup")]);
    let said = refused(&place, "backup", &settings);
    std::fs::remove_file(beside("backup").unwrap()).unwrap();
    assert!(said.contains("witness.example/w") && said.contains("backup"), "{said}");
    // In another place the older log has no anchor, and does not start by itself.
    let said = refused(&place, "backup", "");
    assert!(said.contains(".anchor is missing") && said.contains("cairn registry anchor --accept"), "{said}");
    // The log itself starts again.
    assert!(Daemon::start(&place.path("data"), &settings).terminate().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_whole_folder_restored_from_an_older_backup_is_refused_by_the_anchor_alone() {
    let place = Place::new();
    let anchored = |file: &str| format!("[registry]\nanchor_file = {:?}\n", place.text(file));
    let settings = anchored("log.anchor");
    let daemon = Daemon::start(&place.path("data"), &settings);
    let mut client = OwnerServiceClient::connect(daemon.url.clone()).await.unwrap();
    contribute(&mut client, 1, 0..4).await;
    assert!(daemon.terminate().success());
    // Whole, the checkpoint that was published last included.
    copy(&place.path("data"), &place.path("backup"));
    let daemon = Daemon::start(&place.path("data"), &settings);
    let mut client = OwnerServiceClient::connect(daemon.url.clone()).await.unwrap();
    contribute(&mut client, 2, 0..4).await;
    daemon.kill();
    let said = refused(&place, "backup", &settings);
    for part in ["log.anchor", "over 4 log entries", "holds 2", "restore the newest"] {
        assert!(said.contains(part), "{said}");
    }

    // Taken away it is not made again unasked; accepted it is, and then the older folder is what it was.
    let kept = std::fs::read(place.path("log.anchor")).unwrap();
    std::fs::remove_file(place.path("log.anchor")).unwrap();
    let said = refused(&place, "data", &settings);
    assert!(said.contains("log.anchor is missing") && said.contains("cairn registry anchor --accept"), "{said}");
    let (data, config) = (place.text("data"), place.text("refused.toml"));
    let anchor = ["registry", "anchor", "--data", &data, "--config", &config];
    assert!(!place.cairn(&anchor).status.success() && !place.path("log.anchor").exists());
    let accept = [&anchor[..], &["--accept"]].concat();
    assert!(place.cairn_ok(&accept).contains("goes on from its anchor: size 4, root "));
    assert_eq!(std::fs::read(place.path("log.anchor")).unwrap(), kept);
    place.cairn_ok(&anchor);
    assert!(refused(&place, "backup", &settings).contains("restore the newest"));

    // One that would be restored with the folder is none, by whichever name.
    std::os::unix::fs::symlink(place.path("data"), place.path("link")).unwrap();
    for inside in ["data/log.anchor", "data/registry/log.anchor", "link/log.anchor"] {
        let said = refused(&place, "data", &anchored(inside));
        assert!(said.contains("registry.anchor_file") && said.contains("outside the data folder"), "{inside}: {said}");
    }
    let said = refused(&place, "data", &anchored("nowhere/log.anchor"));
    assert!(said.contains("nowhere/log.anchor") && said.contains("make the folder"), "{said}");
    assert!(Daemon::start(&place.path("data"), &settings).terminate().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_whole_folder_restored_from_an_older_backup_is_refused_without_any_setting() {
    let place = Place::new();
    let data = place.path("data");
    let kept = || {
        let beside = std::fs::read_dir(place.dir.path()).unwrap().map(|entry| entry.unwrap().path());
        let is_kept = |path: &PathBuf| path.extension().is_some_and(|end| end == "anchor");
        beside.filter(is_kept).collect::<Vec<_>>()
    };
    // Another start, and a record more.
    let go_on = async |by| {
        let daemon = Daemon::start(&data, "");
        let mut client = OwnerServiceClient::connect(daemon.url.clone()).await.unwrap();
        contribute(&mut client, by, 0..4).await;
        assert!(daemon.terminate().success());
    };
    go_on(1).await;
    copy(&data, &place.path("backup"));
    go_on(2).await;
    std::fs::rename(&data, place.path("newest")).unwrap();
    copy(&place.path("backup"), &data);
    for _ in 0..2 {
        let said = refused(&place, "data", "");
        for part in [".anchor", "over 4 log entries", "holds 2", "restore the newest"] {
            assert!(said.contains(part), "{part}: {said}");
        }
    }
    std::fs::remove_dir_all(&data).unwrap();
    std::fs::rename(place.path("newest"), &data).unwrap();
    go_on(3).await;

    // To accept the log as it is makes no new anchor where there is one.
    let accept = ["registry", "anchor", "--accept", "--data", &place.text("old/data")];
    copy(&place.path("backup"), &place.path("old/data"));
    std::fs::copy(&kept()[0], place.path("old").join(kept()[0].file_name().unwrap())).unwrap();
    let said = place.cairn(&accept);
    assert!(!said.status.success() && String::from_utf8_lossy(&said.stderr).contains("restore the newest"));

    // Without it a folder does not start, as one that was moved does not, until an operator accepts the log as it is. A log
    // that is begun anew in its place has its own, so that the first one's backup is refused all the same.
    std::fs::remove_file(&kept()[0]).unwrap();
    assert!(refused(&place, "data", "").contains("cairn registry anchor --accept"));
    place.cairn_ok(&["registry", "anchor", "--accept", "--data", &place.text("data")]);
    assert_eq!(kept().len(), 1, "made again");
    go_on(4).await;
    std::fs::rename(&data, place.path("newest")).unwrap();
    go_on(5).await;
    go_on(6).await;
    assert_eq!(kept().len(), 2);
    std::fs::remove_dir_all(&data).unwrap();
    copy(&place.path("backup"), &data);
    assert!(refused(&place, "data", "").contains("restore the newest"));
}
