//! `cairn witness` as a process: it cosigns a log that grows, refuses its fork and keeps the evidence, and
//! remembers over a restart; and `cairn serve` hands out the log's public files.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use cairn_log::format::{merkle::leaf_hash, testing::Tree};
use cairn_log::keys::{Unlock, load_key};
use cairn_log::witness::{WitnessClient, WitnessError, collect};
use cairn_log::{Checkpoint, Digest, Note, NoteVerifier, OwnerKey, Policy, Quorum, TlogProof};
use cairn_testkit::daemon::{Daemon, Place};

const ORIGIN: &str = "log.example/owners";
const NAME: &str = "witness.example/w1";

/// A log whose leaves from the third on depend on `branch`.
fn tree(branch: u8) -> Tree {
    let mut tree = Tree::new();
    for i in 0..20_u8 {
        tree.push(leaf_hash(&[i, if i < 3 { 0 } else { branch }]));
    }
    tree
}

fn log_key() -> OwnerKey {
    OwnerKey::from_seed(&[1; 32])
}

fn note(tree: &Tree, size: u64) -> String {
    Checkpoint::new(ORIGIN, size, tree.root_at(size).unwrap()).sign(&log_key()).unwrap().to_string()
}

fn cairn() -> Command {
    cairn_testkit::daemon::command()
}

/// A running `cairn` that was told to listen on port 0, and the lines that it began with.
struct Running {
    child: Child,
    lines: Vec<String>,
}

impl Running {
    fn start(command: &mut Command, lines: usize) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let said = BufReader::new(child.stdout.take().unwrap()).lines().take(lines);
        Self { lines: said.map(|line| line.unwrap()).collect(), child }
    }

    fn witness(dir: &Path) -> Self {
        let folder = dir.join("witness");
        let text = |name: &str| dir.join(name).display().to_string();
        let arguments = ["witness", "serve", "--listen", "127.0.0.1:0", "--name", NAME];
        let mut command = cairn();
        command.args(arguments).args(["--key", &text("witness.key"), "--log", &text("log.vkey")]);
        Self::start(command.arg("--folder").arg(folder), 2)
    }

    /// The address at the end of a line.
    fn url(&self, line: usize) -> &str {
        self.lines[line].rsplit(' ').next().unwrap()
    }

    fn client(&self) -> WitnessClient {
        assert!(self.lines[0].starts_with("cairn witness listens at http://127.0.0.1:"), "{:?}", self.lines);
        WitnessClient::new(self.lines[1].parse().unwrap(), self.url(0)).unwrap()
    }

    /// SIGTERM; it must end well.
    fn terminate(mut self) {
        assert!(Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap().success());
        assert!(self.child.wait().unwrap().success());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Already gone where the test ended it itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A folder with a witness's key and the log's vkey.
fn place() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let made = cairn().args(["keys", "new", "--plain"]).arg(dir.path().join("witness.key")).output().unwrap();
    assert!(made.status.success(), "{made:?}");
    let log = NoteVerifier::new(ORIGIN, log_key().public()).unwrap();
    std::fs::write(dir.path().join("log.vkey"), format!("# the log\n{log}\n")).unwrap();
    dir
}

#[test]
fn a_witness_cosigns_refuses_a_fork_and_remembers() {
    let dir = place();
    let running = Running::witness(dir.path());
    let (log, fork) = (tree(0), tree(1));
    let prove = |from, to| log.prove_consistency(from, to).map_err(|e| e.to_string());
    let client = running.client();
    let vkey = cairn().args(["witness", "vkey", "--name", NAME, "--key"]).arg(dir.path().join("witness.key")).output();
    assert_eq!(String::from_utf8(vkey.unwrap().stdout).unwrap().trim_end(), running.lines[1]);

    // Growth, each time with one request, and a client that knows nothing yet with two.
    for size in [5, 9, 9] {
        client.cosign(&note(&log, size), &prove).unwrap();
    }
    let cosigned = collect(&[running.client()], &note(&log, 12), &prove).remove(0).unwrap();
    let policy = format!(
        "log {}\nwitness w {}\nquorum w\n",
        NoteVerifier::new(ORIGIN, log_key().public()).unwrap(),
        client.verifier()
    );
    let whole = format!("{}{}\n", note(&log, 12), cosigned.line);
    let verdict = Policy::parse(policy).unwrap().check(&whole).unwrap();
    assert_eq!(verdict.quorum, Quorum::Complete { not_later_than: cosigned.time });

    // A fork, of the same size and of a larger one.
    let prove_fork = |from, to| fork.prove_consistency(from, to).map_err(|e| e.to_string());
    for size in [12, 15] {
        let refused = client.cosign(&note(&fork, size), &prove_fork);
        assert!(matches!(refused, Err(WitnessError::Inconsistent { size: 12, .. })), "{refused:?}");
    }
    let evidence = || std::fs::read_dir(dir.path().join("witness/evidence")).unwrap().count();
    assert_eq!(evidence(), 2);

    // One witness a folder.
    let second = cairn()
        .args(["witness", "serve", "--listen", "127.0.0.1:0", "--name", NAME, "--folder"])
        .arg(dir.path().join("witness"))
        .arg("--key")
        .arg(dir.path().join("witness.key"))
        .arg("--log")
        .arg(dir.path().join("log.vkey"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&second.stderr).into_owned();
    assert!(!second.status.success() && said.contains(&running.child.id().to_string()), "{said}");

    running.terminate();
    let running = Running::witness(dir.path());
    let client = running.client();
    // A log that was restored from a backup hears of it.
    let ahead = client.cosign(&note(&log, 9), &prove);
    assert!(matches!(ahead, Err(WitnessError::Ahead { size: 12, ours: 9, .. })), "{ahead:?}");
    let log_verifier = NoteVerifier::new(ORIGIN, log_key().public()).unwrap();
    let latest = client.latest(&log_verifier).unwrap().unwrap();
    assert_eq!((latest.checkpoint.size, latest.checkpoint.root), (12, log.root_at(12).unwrap()));
    client.cosign(&note(&log, 20), &prove).unwrap();
    assert_eq!(evidence(), 2);
}

#[test]
fn a_bundle_from_before_its_witness_gets_a_cosigned_proof() {
    let place = Place::new();
    let (data, key) = (place.text("data"), place.text("ada.key"));
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
    for name in ["ada.key", "witness.key"] {
        place.cairn_ok(&["keys", "new", &place.text(name), "--plain"]);
    }
    place.cairn_ok(&["owners", "vkey", "--data", &data, "--out", "log.vkey"]);
    let witness = place.cairn_ok(&["witness", "vkey", "--key", "witness.key", "--name", NAME]);
    let log = std::fs::read_to_string(place.path("log.vkey")).unwrap();
    std::fs::write(place.path("policy"), format!("log {log}witness w1 {witness}quorum w1\n")).unwrap();
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let settings = format!("[registry]\nwitnesses = [\"{} http://{free}\"]", witness.trim());

    let daemon = Daemon::start(&place.path("data"), &settings);
    let sign = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", &key];
    let said = place.cairn_ok(&[&sign[..], &["--out", "bundle", "--connect", &daemon.url]].concat());
    assert!(said.contains("published, cosigned by 0 of 1 witnesses"), "{said}");
    assert!(said.contains("`cairn owners submit bundle` fetches a newer proof"), "{said}");
    let audit = || place.cairn(&["audit", "bundle", "bundle", "--policy", "policy"]);
    assert_eq!(audit().status.code(), Some(1));
    assert!(daemon.terminate().success());

    let serve = ["witness", "serve", "--listen", &free, "--name", NAME, "--key", "witness.key", "--folder", "witness"];
    let running = Running::start(cairn().args(serve).args(["--log", "log.vkey"]).current_dir(place.dir.path()), 2);
    let daemon = Daemon::start(&place.path("data"), &settings);
    let said = place.cairn_ok(&["owners", "submit", "bundle", "--connect", &daemon.url]);
    assert!(said.contains("cosigned by 1 of 1 witnesses; its bundle is in bundle"), "{said}");
    let audited = audit();
    assert!(audited.status.success(), "{}", String::from_utf8_lossy(&audited.stdout));
    // A proof that says more, or that contradicts the daemon's, is not lost.
    let kept = place.path("bundle/record.tlog-proof");
    let good = TlogProof::parse(&std::fs::read_to_string(&kept).unwrap()).unwrap();
    let (mut note, checkpoint) = Checkpoint::read(&good.checkpoint).unwrap();
    let refused = |note: &Note, part: &str| {
        let proof = TlogProof { checkpoint: note.to_string(), ..good.clone() }.to_text();
        std::fs::write(&kept, &proof).unwrap();
        let said = place.cairn_refused(&["owners", "submit", "bundle", "--connect", &daemon.url]);
        assert!(said.contains(part), "{said}");
        assert_eq!(std::fs::read_to_string(&kept).unwrap(), proof);
    };
    note.sign("witness.example/w2", &log_key()).unwrap();
    refused(&note, "lacks the cosignature of witness.example/w2");
    let other = place.path("bundle/record.other.tlog-proof");
    assert!(!other.exists());
    let signer = load_key(&place.path("data/registry.key"), &Unlock::Nothing).unwrap();
    for (size, root) in [(checkpoint.size + 9, checkpoint.root), (checkpoint.size, Digest::of("another history"))] {
        let fork = Checkpoint::new(&checkpoint.origin, size, root).sign(&signer).unwrap();
        refused(&fork, "A log does not shrink or change");
        assert_eq!(std::fs::read_to_string(&other).unwrap(), good.to_text());
        std::fs::remove_file(&other).unwrap();
    }
    std::fs::write(&kept, good.to_text()).unwrap();
    // Another log's proof is not taken for it.
    place.cairn_ok(&["owners", "vkey", "--data", &place.text("other"), "--out", "bundle/log.vkey"]);
    let proof = std::fs::read(place.path("bundle/record.tlog-proof")).unwrap();
    let said = place.cairn_refused(&["owners", "submit", "bundle", "--connect", &daemon.url]);
    assert!(said.contains("under the bundle's log.vkey"), "{said}");
    assert_eq!(std::fs::read(place.path("bundle/record.tlog-proof")).unwrap(), proof);
    assert!(daemon.terminate().success());
    running.terminate();
}

/// A request as anybody could send it; the whole answer.
fn get(url: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(url.strip_prefix("http://").unwrap().split('/').next().unwrap()).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: log\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn a_daemon_serves_the_public_files_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let (data, config) = (dir.path().join("data"), dir.path().join("cairn.toml"));
    let settings = "[server]\nbind = \"127.0.0.1:0\"\nshutdown_grace_s = 1\n\
                    [registry]\nhttp_bind = \"127.0.0.1:0\"\nhttp_prefix = \"/log\"\n";
    std::fs::write(&config, settings).unwrap();
    let running = Running::start(cairn().arg("serve").arg("--data").arg(&data).arg("--config").arg(&config), 2);
    assert!(running.lines[1].starts_with("public log at http://127.0.0.1:"), "{:?}", running.lines);
    let url = running.url(1);
    assert!(url.ends_with("/log"), "{url}");
    // Whatever the daemon publishes, this tile is none of it.
    let tile = data.join("registry/public/tile/63/999");
    std::fs::create_dir_all(tile.parent().unwrap()).unwrap();
    std::fs::write(&tile, Digest::of("x").as_bytes().repeat(256)).unwrap();
    let answer = get(url, "/log/tile/63/999");
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n") && answer.contains("immutable"), "{answer}");
    assert!(get(url, "/log/tile/63/999.p/1").contains("content-length: 32\r\n"));
    for path in ["/tile/63/999", "/log/../../registry.key", "/log/tile/63/998", "/log/%2e%2e/working"] {
        assert!(get(url, path).starts_with("HTTP/1.1 404"), "{path}");
    }
    running.terminate();
}
