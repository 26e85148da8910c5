//! What people expect of a command line: one folder for several commands, nothing made by looking, refusals that help, answers
//! for programs, and trainings that nobody starts unasked.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use cairn_testkit::daemon::{Daemon, Place, command};

/// A training in a process of its own, which goes with the test.
struct Training(Child);

impl Training {
    /// Waits for its end; its exit code, and what it said on standard error.
    fn end(mut self) -> (Option<i32>, String) {
        let mut said = String::new();
        self.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (self.0.wait().unwrap().code(), said)
    }
}

impl Drop for Training {
    fn drop(&mut self) {
        // Already gone where the test ended it itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A training of `town` that no test waits for, begun: its first checkpoint is there.
fn begun(place: &Place, data: &str) -> Training {
    let config = place.text("every-step.toml");
    std::fs::write(&config, "[training]\ncheckpoint_every_s = 0").unwrap();
    let child = command()
        .args(["train", "town", "--by-contributor", "--base-only", "--preset", "object", "--quality", "archival"])
        .args(["--max-voxels", "4096", "--data", data, "--config", &config])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut training = Training(child);
    let first = BufReader::new(training.0.stdout.as_mut().unwrap()).lines().next().unwrap().unwrap();
    assert!(first.contains(" accepted for town"), "{first}");
    let job = Path::new(data).join("jobs").join(first.split(' ').next().unwrap());
    while !job.join("screening.checkpoint").exists() {
        assert!(training.0.try_wait().unwrap().is_none(), "it ended before its first checkpoint");
        std::thread::sleep(Duration::from_millis(20));
    }
    training
}

#[test]
fn looking_makes_no_folder_and_empty_lists_say_so() {
    let place = Place::new();
    let absent = place.text("absent");
    for look in [&["scene", "list"][..], &["jobs"], &["owners", "list"], &["who", "town", "--view", "a"]] {
        let said = place.cairn_refused(&[look, &["--data", &absent]].concat());
        assert!(said.contains("there is no data folder") && said.contains("--data"), "{look:?}: {said}");
        assert!(!place.path("absent").exists(), "{look:?}");
    }
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["scene", "delete", "town", "--yes", "--data", &data]);
    for (look, says) in [
        (&["jobs"][..], "no trainings yet"),
        (&["owners", "list"], "no owner records yet"),
        (&["scene", "list"], "no scenes yet"),
    ] {
        // The variable stands for the option. What is no answer is none to a program that counts lines.
        let output = command().args(look).env("CAIRN_DATA_DIR", &data).output().unwrap();
        assert!(output.status.success() && output.stdout.is_empty(), "{output:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains(says), "{output:?}");
    }
}

#[test]
fn nothing_is_deleted_that_nobody_agreed_to() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let said = place.cairn_refused(&["scene", "delete", "town", "--data", &data]);
    assert!(said.contains("delete scene town with its 12 photographs") && said.contains("--yes"), "{said}");
    assert!(place.cairn_ok(&["scene", "list", "--data", &data]).contains("town"));
}

#[test]
fn commands_share_a_folder_that_a_daemon_holds() {
    let place = Place::new();
    let data = place.text("data");
    let daemon = Daemon::start(&place.path("data"), "");
    // No address is given: the folder leads to the daemon.
    place.import("town", ["--data", &data]);
    assert!(place.cairn_ok(&["scene", "list", "--connect", &daemon.url]).contains("town"));
    let train = ["train", "town", "--by-contributor", "--base-only", "--quality", "smoke"];
    let said = place.cairn_ok(&[&train[..], &["--detach", "--data", &data]].concat());
    assert!(said.contains("job-000001 accepted"), "{said}");
    let said = place.cairn_ok(&["jobs", "watch", "job-000001", "--data", &data]);
    assert!(said.contains("job-000001 done"), "{said}");
    let lines = place.cairn_ok(&["jobs", "watch", "1", "--json", "--data", &data]);
    let last: serde_json::Value = serde_json::from_str(lines.lines().next_back().unwrap()).unwrap();
    assert_eq!((&last["state"], &last["seed"]), (&"done".into(), &"1".into()), "{lines}");
    assert!(daemon.terminate().success());
    assert!(!place.path("data/socket").exists(), "the socket outlives its daemon");
    // Without a daemon a training cannot be left alone, nor with a command that ends when it has done its own work.
    let detached = [&train[..], &["--detach", "--data", &data]].concat();
    assert!(place.cairn_refused(&detached).contains("none is running"));
    let training = begun(&place, &data);
    assert!(place.cairn_refused(&detached).contains("none is running"));
    drop(training);
}

#[test]
fn short_commands_at_the_same_time_are_all_answered() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    // Each may find the folder free, held, or let go of just now.
    let look = || command().args(["scene", "list", "--data", &data]).stdout(Stdio::piped()).spawn().unwrap();
    for _ in 0..4 {
        let looks: Vec<Child> = std::iter::repeat_with(look).take(5).collect();
        for output in looks.into_iter().map(|look| look.wait_with_output().unwrap()) {
            assert!(output.status.success() && output.stdout.starts_with(b"town"), "{output:?}");
        }
    }
}

#[test]
fn what_was_typed_goes_before_a_variable_and_what_is_misspelt_makes_nothing() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let elsewhere =
        |arguments: &[&str]| command().args(arguments).env("CAIRN_CONNECT", "127.0.0.1:1").output().unwrap();
    let output = elsewhere(&["scene", "list", "--data", &data]);
    assert!(output.status.success(), "{output:?}");
    assert!(!elsewhere(&["scene", "list"]).status.success());
    let output = command().args(["scene", "list", "--data", &data]).env("CAIRN_CONNECT", "").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let absent = place.text("datta");
    for change in [&["scene", "delete", "town", "--yes"][..], &["train", "town"], &["jobs", "cancel", "job-000001"]] {
        let said = place.cairn_refused(&[change, &["--data", &absent]].concat());
        assert!(said.contains("there is no data folder") && !place.path("datta").exists(), "{change:?}: {said}");
    }
}

#[test]
fn a_daemon_that_asks_for_a_token_asks_its_folders_owner_for_none() {
    let place = Place::new();
    let settings = format!("[access]\nmode = \"token\"\ntoken_file = {:?}", place.token());
    let daemon = Daemon::start(&place.path("data"), &settings);
    place.import("town", ["--data", &place.text("data")]);
    let said = place.cairn_refused(&["scene", "delete", "town", "--yes", "--connect", &daemon.url]);
    assert!(said.contains("needs a token"), "{said}");
    let said = place.cairn_refused(&["jobs", "--connect", &daemon.url, "--token-file", "nofile"]);
    assert!(said.contains("the token is not read") && said.contains("nofile") && !said.contains("settings"), "{said}");
    place.cairn_ok(&["scene", "delete", "town", "--yes", "--data", &place.text("data")]);
}

#[test]
fn a_training_is_seen_and_cancelled_from_another_command() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let training = begun(&place, &data);
    let jobs = place.cairn_json(&["jobs", "list", "--json", "--data", &data]);
    assert_eq!((&jobs["jobs"][0]["state"], &jobs["jobs"][0]["scene"]), (&"running".into(), &"town".into()));
    // The first checkpoint comes before the first step.
    let shown = loop {
        let shown = place.cairn_ok(&["jobs", "show", "job-000001", "--data", &data]);
        assert!(shown.contains("job-000001  town  running"), "{shown}");
        if shown.contains("screening ") {
            break shown;
        }
    };
    assert!(shown.contains("about ") && shown.contains(" left"), "{shown}");
    let said = place.cairn_ok(&["jobs", "cancel", "job-000001", "--data", &data]);
    assert!(said.contains("cairn train town --resume job-000001"), "{said}");
    let (code, said) = training.end();
    // 130 is for the person at the command alone.
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("job-000001 was cancelled by another command; its checkpoint is kept"), "{said}");
    let said = place.cairn_refused(&["jobs", "watch", "1", "--data", &data]);
    assert!(said.contains("was cancelled by another command") && said.contains("--resume job-000001"), "{said}");
}

#[test]
fn a_training_that_died_is_found_and_goes_on_when_it_is_asked_to() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    drop(begun(&place, &data));
    let job = || std::fs::read(place.path("data/jobs/job-000001/job.json")).unwrap();
    let before = job();
    for _ in 0..2 {
        let output = place.cairn(&["scene", "list", "--data", &data]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains("job-000001 (town) was cut off with its process"), "{said}");
        assert!(said.contains("cairn train town --resume job-000001"), "{said}");
    }
    let shown = place.cairn_json(&["jobs", "show", "job-000001", "--json", "--data", &data]);
    assert_eq!(shown["state"], "interrupted");
    assert!(before == job(), "a command that looks changed the training");
    let said = place.cairn_refused(&["scene", "delete", "town", "--yes", "--data", &data]);
    assert!(said.contains("job-000001 is interrupted on it"), "{said}");
    place.cairn_ok(&["jobs", "cancel", "job-000001", "--data", &data]);
    let output = place.cairn(&["scene", "list", "--data", &data]);
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Time until a command is refused, and what it says.
fn refused_within(place: &Place, address: &str) -> (Duration, String) {
    let begun = Instant::now();
    let said = place.cairn_refused(&["scene", "list", "--connect", address]);
    (begun.elapsed(), said)
}

#[test]
fn what_is_no_daemon_is_said_to_be_none_and_soon() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "");
    let without_scheme = daemon.url.strip_prefix("http://").unwrap();
    place.cairn_ok(&["scene", "list", "--connect", without_scheme]);

    // Nothing there.
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let (_, said) = refused_within(&place, &free);
    assert!(said.contains("no daemon is reached at http://") && said.contains("cairn serve"), "{said}");
    assert_eq!(said.matches("os error").count(), 1, "{said}");

    // One that says nothing, and one that speaks another language.
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let (took, said) = refused_within(&place, &silent.local_addr().unwrap().to_string());
    assert!(said.contains("does not answer as a Cairn daemon does"), "{said}");
    // 2 seconds are given; a machine that does much else takes longer to start and to end.
    assert!(took < Duration::from_secs(6), "{took:?}");
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for stream in other.incoming() {
            let mut stream = stream.unwrap();
            let _ = stream.read(&mut [0; 64]);
            let _ = stream.write_all(b"HTTP/1.1 400 Bad Request\r\ncontent-length: 0\r\nconnection: close\r\n\r\n");
        }
    });
    let (_, said) = refused_within(&place, &address);
    assert!(said.contains("does not answer as a Cairn daemon does"), "{said}");
}

#[test]
fn a_refusal_says_once_what_the_system_said_and_has_no_names_of_codes() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let said = place.cairn_refused(&["identify", "town", "/no/such.png", "--data", &data]);
    assert_eq!((said.matches("os error").count(), said.matches("/no/such.png").count()), (1, 1), "{said}");
    let said = place.cairn_refused(&["scene", "show", "tow", "--data", &data]);
    assert!(said.contains("there is no scene \"tow\"; there is: town"), "{said}");
    assert!(!said.contains("NotFound") && !said.contains('('), "{said}");
    // The picture before the scene.
    std::fs::write(place.path("town.png"), b"").unwrap();
    let said = place.cairn_refused(&["identify", "town.png", "town", "--data", &data]);
    assert!(said.contains("the scene comes first: cairn identify town town.png"), "{said}");
    // A name that is nearly right.
    let said = place.cairn_refused(&["scene", "delte", "town", "--data", &data]);
    assert!(said.contains("'delete'"), "{said}");
    let said = place.cairn_refused(&["scene", "exclude", "town", "bela_04.png", "--data", &data]);
    assert!(said.contains("there is: images/bela_004.png, "), "{said}");
    // A word that is another command's.
    let said = place.cairn_refused(&["import", "town", "--from", "capture", "--data", &data]);
    assert!(said.contains("tip: `cairn scene import NAME --from DIR`"), "{said}");
}

#[test]
fn a_refusal_names_the_command_that_helps() {
    let place = Place::new();
    let data = place.text("data");
    let import = |arguments: &[&str]| {
        place.cairn_refused(&[&["scene", "import", "town"], arguments, &["--data", &data]].concat())
    };
    let said = import(&["--from", "capture", "--contributors", "missing.csv"]);
    assert!(said.contains("no table missing.csv") && said.contains("there is capture/contributors.csv"), "{said}");
    let said = import(&["--from", "capture/images"]);
    assert!(said.contains("capture/images holds no cameras, but capture does: import that folder"), "{said}");
    place.import("town", ["--data", &data]);
    let said = import(&["--from", "capture"]);
    assert!(said.contains("town already exists") && said.contains("`cairn scene delete town`"), "{said}");
    let said = place.cairn_refused(&["scene", "show", "town", "--by-contributor", "--data", &data]);
    assert!(said.contains("cairn scene show town --by-contributor --poses cameras.png"), "{said}");
}

#[test]
fn a_slip_in_a_path_or_a_name_is_answered_with_what_is_right() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let said = place.cairn_refused(&["owners", "list", "tow", "--data", &data]);
    assert!(said.contains("there is no scene \"tow\"; there is: town"), "{said}");
    let sign = ["owners", "sign", "town", "--identity", "1", "--data", &data, "--out", "bundle", "--key"];
    let said = place.cairn_refused(&[&sign[..], &["none.key"]].concat());
    assert!(said.contains("none.key: there is no such file") && said.contains("`cairn keys new`"), "{said}");
    place.cairn_ok(&["keys", "new-key-file", "unlock"]);
    place.cairn_ok(&["keys", "new", "ada.key", "--key-file", "unlock"]);
    let said = place.cairn_refused(&[&sign[..], &["ada.key"]].concat());
    assert!(
        said.contains("sealed by a key file; give its key file (--key-file") && !said.contains("--passphrase"),
        "{said}"
    );
    let said = place.cairn_refused(&["audit", "bundle", "bundl"]);
    assert!(said.contains("there is no folder bundl, and no bundl.dsse.json"), "{said}");
    let daemon = Daemon::start(&place.path("data"), "");
    place.cairn_ok(&["owners", "vkey", "--out", "log.vkey", "--data", &data]);
    let said = place.cairn_refused(&["audit", "follow", &daemon.url, "--vkey", "log.vkey", "--once"]);
    assert!(said.contains("no plain HTTP is spoken there") && said.contains("`registry.http_bind`"), "{said}");
}

#[test]
fn answers_are_there_for_programs() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let to = ["--json", "--data", &data];
    let scenes = place.cairn_json(&[&["scene", "list"][..], &to].concat());
    assert_eq!((&scenes["scenes"][0]["name"], &scenes["scenes"][0]["views"]), (&"town".into(), &12.into()));
    let scene = place.cairn_json(&[&["scene", "show", "town"][..], &to].concat());
    let view = &scene["views"][0];
    assert_eq!((&view["name"], &view["held_out"]), (&"images/ada_001.png".into(), &true.into()));
    assert_eq!(view["photograph_sha256"].as_str().unwrap().len(), 64);
    assert_eq!(scene["model"], serde_json::Value::Null);
    assert_eq!(place.cairn_json(&[&["jobs"][..], &to].concat())["jobs"], serde_json::json!([]));
    assert_eq!(place.cairn_json(&[&["owners", "list"][..], &to].concat())["records"], serde_json::json!([]));
    place.cairn_ok(&["keys", "new", &place.text("key"), "--plain"]);
    let key = place.cairn_json(&["keys", "show", &place.text("key"), "--json"]);
    assert_eq!(key["public_key"].as_str().unwrap().len(), 64);
    // Names may stand without their folder.
    let said = place.cairn_refused(&["scene", "exclude", "town", "none_001.png", "--data", &data]);
    assert!(said.contains("no view"), "{said}");
    place.cairn_ok(&["scene", "exclude", "town", "ada_002.png", "--why", "a test", "--data", &data]);
    let said = place.cairn_ok(&["scene", "show", "town", "--data", &data]);
    assert!(said.contains("images/ada_002.png  by ada  excluded (a test)"), "{said}");
}

#[test]
fn plain_photographs_are_answered_with_the_way_to_cameras() {
    let place = Place::new();
    std::fs::create_dir(place.path("plain")).unwrap();
    std::fs::rename(place.path("capture/images"), place.path("plain/images")).unwrap();
    let photographs = place.text("plain/images");
    let said = place.cairn_refused(&["scene", "import", "town", "--from", &photographs, "--data", &place.text("data")]);
    for step in ["colmap feature_extractor", "colmap exhaustive_matcher", "colmap mapper"] {
        assert!(said.contains(step), "{said}");
    }
}

/// Runs a command with `data` mounted so that nobody can write to it; `None` where the system does not let us.
#[cfg(target_os = "linux")]
fn read_only(data: &str, arguments: &[&str]) -> Option<std::process::Output> {
    let script = format!(
        "mount --bind '{data}' '{data}' && mount -o remount,bind,ro '{data}' && ! touch '{data}/x' 2>/dev/null && exec \"$@\""
    );
    let program = command();
    let mut unshared = Command::new("unshare");
    unshared.args(["-rm", "sh", "-c", &script, "sh"]).arg(program.get_program()).args(arguments);
    let probe = format!("mount --bind '{data}' '{data}'");
    let can = Command::new("unshare").args(["-rm", "sh", "-c", &probe]).output();
    can.is_ok_and(|probe| probe.status.success()).then(|| unshared.output().unwrap())
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_written_is_read() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let Some(output) = read_only(&data, &["scene", "list", "--data", &data]) else {
        println!("SKIPPED a_folder_that_cannot_be_written_is_read: no unshare -rm on this system");
        return;
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("town"));
    let listed = read_only(&data, &["owners", "list", "--data", &data]).unwrap();
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let refused = read_only(&data, &["scene", "delete", "town", "--yes", "--data", &data]).unwrap();
    assert_eq!(refused.status.code(), Some(2));
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("Read-only") && said.contains(&data), "{said}");
}
