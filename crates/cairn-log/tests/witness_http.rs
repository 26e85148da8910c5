//! The witness over HTTP and the client against it, and the client against servers that are up to no good.
#![cfg(all(feature = "witness-client", feature = "witness-server"))]

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::Arc,
    thread::{self, JoinHandle},
};

use crate::witness_common::{Hands, Log, NAME, NOW, ORIGIN, key, log_verifier, names, open};
use cairn_log::witness::{
    Witness, WitnessClient, WitnessError, collect, plain_http::Limits, request::MAX_BODY_BYTES, server,
};
use cairn_log::{Cosignature, Digest, Note, WitnessVerifier, cosign};
use tokio::sync::oneshot;

/// A witness on a free port, in a thread of its own.
struct Served {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    fn start(witness: Witness, limits: Limits) -> Self {
        let (stop, stopped) = oneshot::channel();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        let thread = thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
            runtime.block_on(async {
                let listener = tokio::net::TcpListener::from_std(listener).unwrap();
                let stop = async { drop(stopped.await) };
                server::serve(listener, Arc::new(witness), limits, stop).await.unwrap();
            });
        });
        Self { address, stop: Some(stop), thread: Some(thread) }
    }

    fn client(&self) -> WitnessClient {
        client(self.address, "")
    }

    /// Sends bytes, gives the whole answer; the request must ask for the connection's end.
    fn raw(&self, bytes: &[u8]) -> String {
        let mut stream = TcpStream::connect(self.address).unwrap();
        // A server that refuses early may hang up on the rest.
        let _ = stream.write_all(bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.stop.take().map(|stop| stop.send(()));
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(matches!(ended, Some(Ok(()))) || thread::panicking(), "the server did not end well");
    }
}

fn verifier() -> WitnessVerifier {
    WitnessVerifier::new(NAME, key(2).public()).unwrap()
}

fn client(address: SocketAddr, path: &str) -> WitnessClient {
    WitnessClient::new(verifier(), &format!("http://{address}{path}")).unwrap()
}

fn prove(log: &Log) -> impl Fn(u64, u64) -> Result<Vec<Digest>, String> + Sync {
    |from, to| log.tree.prove_consistency(from, to).map_err(|e| e.to_string())
}

#[test]
fn client_and_server_agree() {
    let dir = tempfile::tempdir().unwrap();
    let (log, fork, hands) = (Log::new(40, 0), Log::new(3, 1), Hands::new());
    let served = Served::start(open(dir.path(), &hands).unwrap(), Limits::default());
    let client = served.client();
    assert_eq!(client.latest(&log_verifier()).unwrap(), None);
    let times = |answers: Vec<Result<Cosignature, WitnessError>>| -> Vec<u64> {
        answers.into_iter().map(|answer| answer.unwrap().time).collect()
    };
    let clients = [client];
    for size in [0, 4, 4, 10] {
        assert_eq!(times(collect(&clients, &log.note(size).to_string(), &prove(&log))), [NOW]);
    }
    // A client that starts anew is told where the witness stands, and asks once more.
    let client = served.client();
    let refused = client.add_checkpoint(0, &[], &log.note(12).to_string());
    assert!(matches!(refused, Err(WitnessError::Conflict { size: 10, .. })), "{refused:?}");
    assert_eq!(served.client().cosign(&log.note(12).to_string(), &prove(&log)).unwrap().time, NOW);
    let latest = client.latest(&log_verifier()).unwrap().unwrap();
    assert_eq!((latest.checkpoint.root, latest.cosignature.time), (log.root(12), NOW));

    for client in [&clients[0], &served.client()] {
        let behind = client.cosign(&log.note(7).to_string(), &prove(&log));
        assert!(matches!(behind, Err(WitnessError::Ahead { size: 12, ours: 7, .. })), "{behind:?}");
        for size in [12, 14] {
            let forked = client.cosign(&fork.note(size).to_string(), &prove(&fork));
            assert!(matches!(forked, Err(WitnessError::Inconsistent { size: 12, .. })), "{forked:?}");
        }
        let unproven = client.cosign(&log.note(13).to_string(), &|_, _| Err("no tiles".into()));
        assert!(matches!(unproven, Err(WitnessError::Proof { from: 12, to: 13, .. })), "{unproven:?}");
    }
    assert_eq!(names(&dir.path().join("evidence")).len(), 2);

    let stranger = cairn_log::Checkpoint::new("other", 1, log.root(1)).sign(&key(1)).unwrap().to_string();
    let unknown = client.cosign(&stranger, &prove(&log));
    assert!(matches!(unknown, Err(WitnessError::Refused { status: 404, .. })), "{unknown:?}");
    let foreign = cairn_log::Checkpoint::new(ORIGIN, 20, log.root(20)).sign(&key(9)).unwrap().to_string();
    let untrusted = client.cosign(&foreign, &prove(&log));
    assert!(matches!(untrusted, Err(WitnessError::Refused { status: 403, .. })), "{untrusted:?}");
    assert!(matches!(client.cosign("no note", &prove(&log)), Err(WitnessError::Checkpoint { .. })));
}

#[test]
fn the_server_is_bounded_and_exact() {
    let dir = tempfile::tempdir().unwrap();
    let log = Log::new(40, 0);
    let served = Served::start(open(dir.path(), &Hands::new()).unwrap(), Limits::default());
    let request = |line: &str, body: &str| {
        let length = body.len();
        format!("{line} HTTP/1.1\r\nHost: w\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n{body}")
            .into_bytes()
    };
    let good = log.request(0, 10).to_body();
    let answer = served.raw(&request("POST /add-checkpoint", &good));
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains("\r\n\r\n\u{2014} witness.example/w1 "), "{answer}");
    let answer = served.raw(&request("POST /add-checkpoint", &good));
    assert!(answer.starts_with("HTTP/1.1 409 ") && answer.ends_with("\r\n\r\n10\n"), "{answer}");
    assert!(answer.to_lowercase().contains("content-type: text/x.tlog.size\r\n"), "{answer}");
    for (line, body, status) in [
        ("GET /add-checkpoint", String::new(), 405),
        ("POST /", String::new(), 404),
        ("POST /add-checkpoint/", good.clone(), 404),
        ("POST /add-checkpoint", "x".repeat(MAX_BODY_BYTES + 1), 413),
        ("POST /add-checkpoint", String::new(), 400),
        ("GET /log.example/checkpoint", String::new(), 404),
        ("POST /sign-subtree", String::new(), 404),
    ] {
        let answer = served.raw(&request(line, &body));
        assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{line}: {answer}");
    }
    // A head without end is cut off; announced bytes that are too many are not waited for.
    let endless = [b"GET / HTTP/1.1\r\nX: ".to_vec(), vec![b'x'; 64 << 10]].concat();
    assert!(!served.raw(&endless).starts_with("HTTP/1.1 200"));
    let announced = b"POST /add-checkpoint HTTP/1.1\r\nHost: w\r\nContent-Length: 99999999999\r\n\r\nold";
    assert!(served.raw(announced).starts_with("HTTP/1.1 413 "));
    // Monitors find the checkpoint under the origin's hash.
    let monitor = format!("GET /{}/checkpoint", Digest::of(ORIGIN));
    let answer = served.raw(&request(&monitor, ""));
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains("\r\n\r\nlog.example/owners\n10\n"), "{answer}");
}

#[test]
fn a_stop_does_not_wait_for_idle_clients_and_a_full_house_lets_later_ones_wait() {
    let dir = tempfile::tempdir().unwrap();
    let log = Log::new(40, 0);
    let limits = Limits { connections: 1, ..Limits::default() };
    let served = Served::start(open(dir.path(), &Hands::new()).unwrap(), limits);
    let idle = TcpStream::connect(served.address).unwrap();
    let (client, note) = (served.client(), log.note(4).to_string());
    let waiting = thread::spawn(move || client.cosign(&note, &|_, _| Ok(Vec::new())));
    drop(idle);
    assert_eq!(waiting.join().unwrap().unwrap().time, NOW);
    let _idle = TcpStream::connect(served.address).unwrap();
    drop(served);
}

/// Answers each request with `answer`, as often as asked.
fn canned(answer: Vec<u8>, times: usize) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        for stream in listener.incoming().take(times) {
            let mut stream = BufReader::new(stream.unwrap());
            let mut length = 0;
            loop {
                let mut line = String::new();
                stream.read_line(&mut line).unwrap();
                if let Some(value) = line.to_lowercase().strip_prefix("content-length:") {
                    length = value.trim().parse().unwrap();
                }
                if line.trim().is_empty() {
                    break;
                }
            }
            stream.read_exact(&mut vec![0; length]).unwrap();
            // The client may have had enough.
            let _ = stream.get_mut().write_all(&answer);
        }
    });
    address
}

fn http(status: &str, body: &str) -> Vec<u8> {
    format!("HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}", body.len()).into_bytes()
}

#[test]
fn a_witness_is_believed_only_as_far_as_it_signs() {
    let log = Log::new(40, 0);
    let note = log.note(10);
    let ask = |answer: Vec<u8>| client(canned(answer, 2), "/prefix/").cosign(&note.to_string(), &prove(&log));
    let line = |text: &str, number| format!("{}\n", cosign(text, 7, NAME, &key(number)).unwrap());
    let strangers = line(&note.text, 9);
    let whole = ask(http("200 OK", &format!("{strangers}{}", line(&note.text, 2))));
    assert_eq!(whole.unwrap().time, 7, "strangers' lines are ignored");
    let malformed = |answer: Vec<u8>| match ask(answer) {
        Err(WitnessError::Malformed { witness, what }) => {
            assert_eq!(witness, NAME);
            what
        }
        other => panic!("{other:?}"),
    };
    assert!(malformed(http("200 OK", &strangers)).contains("without a cosignature"));
    assert!(malformed(http("200 OK", "")).contains("without a cosignature"));
    assert!(malformed(http("200 OK", "<html>")).contains("signature line"));
    assert!(malformed(http("200 OK", &strangers.repeat(101))).contains("101 lines"));
    for size in ["", "10", "010\n", "-1\n", "99999999999999999999\n", "<html>\n"] {
        assert!(malformed(http("409 Conflict", size)).contains("expected a size"), "{size:?}");
    }
    let other = line(&log.note(11).text, 2);
    assert!(matches!(ask(http("200 OK", &other)), Err(WitnessError::Cosignature { .. })));
    // The same conflict for ever ends after the second request.
    assert!(matches!(ask(http("409 Conflict", "5\n")), Err(WitnessError::Inconsistent { size: 5, .. })));
    assert!(matches!(ask(http("409 Conflict", "11\n")), Err(WitnessError::Ahead { size: 11, ours: 10, .. })));
    assert!(matches!(ask(http("422 Unprocessable Entity", "no")), Err(WitnessError::Inconsistent { .. })));
    let moved = b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n".to_vec();
    assert!(matches!(ask(moved), Err(WitnessError::Refused { status: 302, .. })), "redirects are not followed");
}

#[test]
fn monstrous_and_missing_answers_end() {
    let log = Log::new(40, 0);
    let note = log.note(10).to_string();
    let ask = |address| client(address, "").cosign(&note, &prove(&log));
    let unreachable = |address| match ask(address) {
        Err(WitnessError::Unreachable { url, .. }) => assert!(url.ends_with("/add-checkpoint"), "{url}"),
        other => panic!("{other:?}"),
    };
    unreachable(canned(http("200 OK", &"x".repeat(1 << 20)), 1));
    let head = format!("HTTP/1.1 200 OK\r\nX: {}\r\n\r\n", "x".repeat(64 << 10));
    unreachable(canned(head.into_bytes(), 1));
    unreachable(canned(b"nonsense\r\n\r\n".to_vec(), 1));
    unreachable(canned(Vec::new(), 1));
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    unreachable(closed);
    // What it keeps for monitors must be the log's and its own.
    let latest = |body: &str| client(canned(http("200 OK", body), 1), "").latest(&log_verifier());
    assert!(matches!(latest(&note), Err(WitnessError::Malformed { .. })), "not cosigned");
    let mut both = Note::parse(&note).unwrap();
    both.signatures.push(cosign(&both.text, 7, NAME, &key(2)).unwrap());
    assert_eq!(latest(&both.to_string()).unwrap().unwrap().cosignature.time, 7);
    both.signatures.remove(0);
    assert!(matches!(latest(&both.to_string()), Err(WitnessError::Checkpoint { .. })), "not the log's");
}

#[test]
fn only_addresses_that_can_be_asked_are_taken() {
    for url in [
        "",
        "witness.example",
        "ftp://witness.example",
        "http://",
        "http:///x",
        "http://a/?b",
        "http://u:p@a/",
        "http://a/#b",
    ] {
        assert!(matches!(WitnessClient::new(verifier(), url), Err(WitnessError::Url { .. })), "{url}");
    }
    let client = WitnessClient::new(verifier(), "https://witness.example:8443/one/").unwrap();
    assert_eq!(client.url(), "https://witness.example:8443/one");
}
