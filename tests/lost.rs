//! An answer that is lost on its way, through the real daemon: what was signed is kept and asked about
//! again, also by a key that the lost answer's own record ended.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cairn_log::{Envelope, OwnerRecord};
use cairn_testkit::daemon::accounts::{CLOSED, World, key};

/// A way to the daemon at `url` that breaks once a record went through it: the daemon has it, and its answer never comes.
fn way_that_breaks(url: &str) -> String {
    let daemon = url.strip_prefix("http://").unwrap().to_owned();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for client in listener.incoming() {
            let (client, daemon) = (client.unwrap(), TcpStream::connect(&daemon).unwrap());
            let (back, ends) = (daemon.try_clone().unwrap(), client.try_clone().unwrap());
            let broken = Arc::new(AtomicBool::new(false));
            let is_broken = broken.clone();
            std::thread::spawn(move || there(client, daemon, &broken));
            std::thread::spawn(move || back_again(back, ends, &is_broken));
        }
    });
    url
}

fn there(mut client: TcpStream, mut daemon: TcpStream, broken: &AtomicBool) {
    let (mut buffer, mut said) = ([0; 4096], Vec::new());
    while let Ok(read @ 1..) = client.read(&mut buffer) {
        said.extend_from_slice(&buffer[..read]);
        // An envelope goes as it is, and this is how each ends: in a moment the rest of it is here as well.
        if said.windows(12).any(|bytes| bytes == b"\"signatures\"") && !broken.swap(true, Ordering::SeqCst) {
            client.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
        }
        daemon.write_all(&buffer[..read]).unwrap();
    }
    let _ = client.shutdown(Shutdown::Both);
    if !broken.load(Ordering::SeqCst) {
        let _ = daemon.shutdown(Shutdown::Write);
    }
    // To the daemon the way stays open: it goes on with what it was asked for, however long that takes.
    std::thread::sleep(Duration::from_secs(60));
}

fn back_again(mut daemon: TcpStream, mut client: TcpStream, broken: &AtomicBool) {
    let mut buffer = [0; 4096];
    while let Ok(read @ 1..) = daemon.read(&mut buffer) {
        if broken.load(Ordering::SeqCst) || client.write_all(&buffer[..read]).is_err() {
            return;
        }
    }
    let _ = client.shutdown(Shutdown::Write);
}

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort_unstable();
    names
}

/// A daemon that is closed to strangers and takes `records` records of each owner, where ada trained her town, with marks
/// or without; and the file of her key.
fn town_of_ada(records: u32, marked: bool) -> (World, String) {
    let world = World::new(&format!("{CLOSED}[access.quota]\nrecords = {records}\n"));
    world.with("ada", "contributor");
    world.import("ada", "town").unwrap();
    let own = world.place.text("ada.key");
    let train = ["train", "town", "--by-contributor", "--quality", "smoke", "--base-only"];
    world.ok("ada", &train[..if marked { 5 } else { 6 }]);
    (world, own)
}

/// Runs a command over a way that breaks, until the log has what it sent; what was signed stays in the folder `out`, and
/// what it says names it.
fn lose(world: &World, who: &str, command: &[&str], out: &str) {
    let records = || world.ok("root", &["owners", "list"]).lines().count();
    let before = records();
    let lost =
        world.run_at(&way_that_breaks(&world.daemon.url), who, &[command, &["--out", out]].concat()).unwrap_err();
    assert!(
        lost.contains("no answer that settles it") && lost.contains(&format!("cairn owners submit {out}")),
        "{lost}"
    );
    assert!(Path::new(out).join("record.signed.json").is_file(), "{lost}");
    let begun = Instant::now();
    while records() == before {
        assert!(begun.elapsed() < Duration::from_secs(60), "the daemon never entered it: {lost}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn an_answer_that_is_lost_is_asked_for_again_also_by_a_key_that_ended() {
    let (world, own) = town_of_ada(1, true);
    let sign = ["owners", "sign", "town", "--identity", "1", "--key", &own];
    let revoke = ["keys", "revoke", "town", "--key", &own, "--purpose", "lost"];
    let secret = ["signal.png", "signal.salt"];
    let vkey = world.place.text("pinned.vkey");
    world.ok("root", &["owners", "vkey", "--out", &vkey]);
    for (what, line, name, secret, ended) in [
        ("record 0 is durable and published;", &sign[..], "claim", &secret[..], false),
        ("record 2 is durable;", &revoke[..], "end", &[], true),
    ] {
        let (folder, out) = (world.place.path(name), world.place.text(name));
        lose(&world, "ada", line, &out);
        assert_eq!(files(&folder), [&["record.signed.json"], secret].concat());
        for name in files(&folder) {
            let mode = std::fs::metadata(folder.join(&name)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600, "{name} is the owner's secret");
        }
        // The claim used the quota up, and the revocation the key: neither keeps the answer back.
        for _ in 0..2 {
            std::fs::copy(folder.join("record.signed.json"), world.place.path("kept")).unwrap();
            let said = world.ok("ada", &["owners", "submit", &out]);
            assert!(said.contains(what), "{said}");
            assert_eq!(files(&folder), [&["log.vkey", "record.json", "record.tlog-proof"], secret].concat());
            assert!(world.place.cairn_ok(&["audit", "bundle", &out, "--vkey", &vkey]).starts_with("trusted"));
            std::fs::copy(world.place.path("kept"), folder.join("record.signed.json")).unwrap();
        }
        std::fs::remove_file(folder.join("record.signed.json")).unwrap();
        // A bundle that waits for no answer asks for a newer proof, as any call that a key must be good for.
        let again = ["owners", "submit", &out];
        if ended {
            world.refused("ada", &again, "was ended by record 2");
        } else {
            assert!(world.ok("ada", &again).contains(what));
        }
    }
    world.refused("ada", &["scene", "list"], "was ended by record 2");

    // A record that never was in the log is not entered by a key that ended, and nobody takes another's answer.
    let kept = std::fs::read(world.place.path("kept")).unwrap();
    let (mut record, _) = OwnerRecord::open(&Envelope::parse(&kept).unwrap()).unwrap();
    record.purpose = "another".into();
    std::fs::create_dir(world.place.path("never")).unwrap();
    let never = record.seal(&world.key("ada")).unwrap().to_json();
    std::fs::write(world.place.path("never/record.signed.json"), never).unwrap();
    // By the gate, before the log is asked.
    let refused = world.run("ada", &["owners", "submit", &world.place.text("never")]).unwrap_err();
    assert!(refused.contains("was ended by record 2"), "{refused}");
    world.with("eve", "contributor");
    std::fs::create_dir(world.place.path("eves")).unwrap();
    std::fs::copy(world.place.path("kept"), world.place.path("eves/record.signed.json")).unwrap();
    let refused = world.run("eve", &["owners", "submit", &world.place.text("eves")]).unwrap_err();
    assert!(refused.contains("your account's key did not sign"), "{refused}");
    let listed = world.ok("root", &["owners", "list"]);
    assert_eq!(listed.lines().count(), 2, "each once: {listed}");
}

#[test]
fn what_a_key_signed_before_its_rotation_is_answered_to_the_key_that_followed() {
    let (world, own) = town_of_ada(9, false);
    let (next, out) = (world.place.text("next.key"), |name: &str| world.place.text(name));
    key(&world.place, "next");
    let sign = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", &own];
    lose(&world, "ada", &sign, &out("first"));
    let rotate = ["keys", "rotate", "town", "--record", "0", "--key", &own, "--new-key", &next];
    world.ok("ada", &[&rotate[..], &["--out", &out("rotation")]].concat());

    // The old key is told which one to ask with, and loses nothing; a stranger gets no answer.
    let refused = world.run("ada", &["owners", "submit", &out("first")]).unwrap_err();
    assert!(refused.contains("continues under key") && refused.contains("what was signed stays in"), "{refused}");
    world.with("eve", "contributor");
    world.refused("eve", &["owners", "submit", &out("first")], "your account's key did not sign");
    std::fs::create_dir(out("again")).unwrap();
    std::fs::copy(world.place.path("first/record.signed.json"), world.place.path("again/record.signed.json")).unwrap();
    let said = world.ok("next", &["owners", "submit", &out("first")]);
    assert!(said.contains("record 0 is durable and published"), "{said}");
    assert_eq!(files(&world.place.path("first")), ["log.vkey", "record.json", "record.tlog-proof"]);

    // Also at the end of a chain, where the key between is refused, and once the last key ended as well.
    let last = world.place.text("last.key");
    key(&world.place, "last");
    let rotate = ["keys", "rotate", "town", "--record", "2", "--key", &next, "--new-key", &last];
    world.ok("next", &[&rotate[..], &["--out", &out("second")]].concat());
    world.refused("next", &["owners", "submit", &out("again")], "there is no account with the key id");
    let revoke = ["keys", "revoke", "town", "--key", &last, "--purpose", "lost"];
    world.ok("last", &[&revoke[..], &["--out", &out("end")]].concat());
    let said = world.ok("last", &["owners", "submit", &out("again")]);
    assert!(said.contains("record 0 is durable;"), "{said}");
    assert_eq!(world.ok("root", &["owners", "list"]).lines().count(), 4, "each once");
}

#[test]
fn what_is_refused_leaves_nothing_behind() {
    let (world, own) = town_of_ada(1, false);
    let sign = ["owners", "sign", "town", "--identity", "1", "--kind", "contribution", "--key", &own, "--out"];
    world.ok("ada", &[&sign[..], &[&world.place.text("first")]].concat());
    let second = world.place.text("second");
    world.refused("ada", &[&sign[..], &[&second]].concat(), "quota `records` is 1");
    assert!(!Path::new(&second).exists());
}
