//! Owner records from key to verdict, through the real binary: signed at the
//! owner's side, entered, listed, and verified from files alone.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use cairn_api::v1;
use cairn_api::v1::owner_service_client::OwnerServiceClient;
use cairn_log::format::record::{self, Digests, Identity, Seen, random_salt};
use cairn_log::format::shares::Shares;
use cairn_log::{Answer, Checkpoint, Digest, Note, NoteVerifier, OwnerKey, OwnerRecord, RecordKind};
use cairn_testkit::daemon::{Daemon, Place};
use cairn_verify::{Evidence, LogView, Outcome, audit};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use tonic::transport::Channel;

#[test]
fn a_record_is_signed_entered_verified_and_seen_through_when_forged() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
    let (key, bundle) = (place.text("ada.key"), place.text("bundle"));
    place.cairn_ok(&["keys", "new", &key, "--plain"]);
    // A key is never replaced, and its file is its owner's alone.
    assert!(!place.cairn(&["keys", "new", &key, "--plain"]).status.success());

    let daemon = Daemon::start(&place.path("data"), "");
    let connect = ["--connect", daemon.url.as_str()];
    let sign = ["owners", "sign", "town", "--identity", "1", "--key", &key, "--kind", "contribution", "--out", &bundle];
    let said = place.cairn_ok(&[&sign[..], &connect].concat());
    assert!(said.contains("record 0 is durable and published"), "{said}");
    let list = place.text("log.json");
    let listed = place.cairn_ok(&["owners", "list", "town", "--out", &list, connect[0], connect[1]]);
    assert!(listed.starts_with("0  contribution  town  identity 1"), "{listed}");
    let who = place.cairn_ok(&["who", "town", "--view", &first_view(&place, &connect), connect[0], connect[1]]);
    assert!(who.contains("owner records at index: 0"), "{who}");
    assert!(daemon.terminate().success());

    // The daemon is gone; the files speak.
    let vkey = place.text("bundle/log.vkey");
    let verify = ["audit", "bundle", &bundle, "--vkey", &vkey, "--against", &data, "--log", &list];
    let report = place.cairn_ok(&verify);
    assert!(report.starts_with("trusted"), "{report}");
    assert!(place.cairn_ok(&["audit", "bundle", &bundle]).starts_with("valid"));

    // The whole folder, byte by byte: the log that the registry wrote, scenes, models and jobs.
    let store = place.cairn_ok(&["audit", "store", &data, "--vkey", &vkey]);
    assert!(store.starts_with("trusted"), "{store}");
    for part in
        ["store.map.verified", "working.verified", "folder.verified  scenes/town", "folder.verified  models/town"]
    {
        assert!(store.contains(part), "{part}: {store}");
    }

    // A folder that has nothing to compare with: neither trusted nor invalid, but a mistake.
    let empty = place.cairn(&["audit", "bundle", &bundle, "--vkey", &vkey, "--against", &place.text("tada")]);
    let said = String::from_utf8_lossy(&empty.stderr).into_owned();
    assert_eq!((empty.status.code(), empty.stdout.len()), (Some(2), 0), "{said}");
    for part in ["tada", "\"town\"", "nothing was compared", "give --against the data folder"] {
        assert!(said.contains(part), "{part}: {said}");
    }

    // Another photograph than the one that was signed for.
    let photographs = place.path("data/scenes/town/photographs");
    for entry in std::fs::read_dir(&photographs).unwrap() {
        let path = entry.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.push(0);
        std::fs::write(&path, bytes).unwrap();
    }
    let forged = place.cairn(&verify);
    assert_eq!(forged.status.code(), Some(1), "{}", String::from_utf8_lossy(&forged.stdout));
    assert!(String::from_utf8_lossy(&forged.stdout).starts_with("invalid"));
    let store = place.cairn(&["audit", "store", &data, "--vkey", &vkey]);
    let said = String::from_utf8_lossy(&store.stdout).into_owned();
    assert!(store.status.code() == Some(15) && said.contains("file.mismatch  scenes/town/photographs/"), "{said}");

    // A changed word in the record itself.
    let record = place.path("bundle/record.json");
    let mut json: serde_json::Value = serde_json::from_slice(&std::fs::read(&record).unwrap()).unwrap();
    let payload = json["payload"].as_str().unwrap().to_owned();
    let swapped =
        if payload.starts_with('e') { payload.replacen('e', "f", 1) } else { payload.replacen(&payload[..1], "e", 1) };
    json["payload"] = swapped.into();
    std::fs::write(&record, json.to_string()).unwrap();
    assert_eq!(place.cairn(&["audit", "bundle", &bundle]).status.code(), Some(1));
}

#[test]
fn a_contributors_photographs_are_claimed_before_any_training_and_confirmed_by_a_curator() {
    let place = Place::new();
    let data = place.text("data");
    let data = ["--data", data.as_str()];
    place.import("town", data);
    let cairn = |arguments: &[&str]| place.cairn_ok(&[arguments, &data].concat());
    let key = |name: &str| {
        let path = place.text(&format!("{name}.key"));
        place.cairn_ok(&["keys", "new", &path, "--plain"]);
        let public = cairn_log::keys::load_key(Path::new(&path), &cairn_log::keys::Unlock::Nothing).unwrap().public();
        (path, public.to_string())
    };
    let ((ada, ada_public), (curator, _)) = (key("ada"), key("curator"));
    let claim = place.text("claim");
    let sign = ["owners", "sign", "town", "--contributor", "ada", "--key", &ada, "--out", &claim];
    assert!(cairn(&sign).contains("record 0 is durable"));
    // A claim of photographs alone has no secret.
    assert!(!place.path("claim/signal.salt").exists());
    // Exactly one of the two; and none of a contributor that is not there.
    let refused = |arguments: &[&str]| place.cairn_refused(&[arguments, &data].concat());
    let out = place.text("refused");
    let by = ["--key", ada.as_str(), "--out", out.as_str()];
    refused(&[&["owners", "sign", "town"][..], &by].concat());
    refused(&[&["owners", "sign", "town", "--contributor", "ada", "--identity", "1"][..], &by].concat());
    let said = refused(&[&["owners", "sign", "town", "--contributor", "zoe"][..], &by].concat());
    assert!(said.contains("there is no contributor \"zoe\"") && said.contains("ada"), "{said}");
    let said = refused(&[&["owners", "sign", "town", "--contributor", "ada", "--kind", "training"][..], &by].concat());
    assert!(said.contains("has no model yet"), "{said}");
    let bind = ["owners", "bind", "town", "--owner-key", &ada_public, "--key", &curator];
    let said = refused(&[&bind[..], &["--contributor", "zoe", "--out", &out]].concat());
    assert!(said.contains("no photograph by \"zoe\""), "{said}");

    // The answer about any photograph of hers names the claim, and says whether it is confirmed.
    let (answer, vkey) = (place.text("answer.json"), place.text("log.vkey"));
    cairn(&["owners", "vkey", "--out", &vkey]);
    let view = "images/ada_002.png";
    let photograph = place.text(&format!("capture/{view}"));
    let audited = || {
        cairn(&["owners", "answer", "town", "--view", view, "--out", &answer]);
        place.cairn_ok(&["audit", "answer", &answer, "--vkey", &vkey, "--scene", "town", "--view", &photograph])
    };
    let said = audited();
    assert!(said.starts_with("trusted") && said.contains("1 of 1 records count"), "{said}");
    assert!(
        said.contains("claim by \"ada\", name unconfirmed") && said.contains("answer.record.unconfirmed"),
        "{said}"
    );
    cairn(&[&bind[..], &["--contributor", "ada", "--out", &place.text("binding")]].concat());
    let said = audited();
    assert!(said.contains("claim by \"ada\", name confirmed at index 2"), "{said}");
    // The photographs are the scene's own, and every one of them.
    let bundle = place.cairn_ok(&["audit", "bundle", &claim, "--vkey", &vkey, "--against", data[1]]);
    assert!(bundle.starts_with("trusted") && bundle.contains("digest.photographs.match"), "{bundle}");
    // What the table of contributors says binds nothing, until a curator does.
    let table = place.path("capture/contributors.csv");
    let rows = std::fs::read_to_string(&table).unwrap();
    let key_of = |row: &str| if row.ends_with(",ada") { ada_public.clone() } else { String::new() };
    let with_keys = |first: &str| {
        let rows: Vec<String> = rows.lines().skip(1).map(|row| format!("{row},{}", key_of(row))).collect();
        std::fs::write(&table, format!("image,contributor,key\n{}\n", rows.join("\n").replacen(&ada_public, first, 1)))
            .unwrap();
    };
    let import = ["scene", "import", "mill", "--from", &place.text("capture"), "--contributors", "contributors.csv"];
    with_keys(&"0b".repeat(32));
    assert!(refused(&import).contains("\"ada\" has another key in line"));
    // All zeros is a key of small order: anybody could sign for it.
    std::fs::write(
        &table,
        rows.replacen('\n', ",key\n", 1)
            .replace(",ada\n", &format!(",ada,{}\n", "0".repeat(64)))
            .replace(",bela\n", ",bela,\n"),
    )
    .unwrap();
    let said = refused(&import);
    assert!(said.contains("the key of contributor \"ada\"") && said.contains("small order"), "{said}");
    with_keys(&ada_public);
    cairn(&import);
    let shown = cairn(&["scene", "show", "mill"]);
    assert_eq!(shown.matches(&format!("key of ada: {ada_public}")).count(), 1, "{shown}");
    assert!(!shown.contains("key of bela"), "{shown}");
    let from_table = place.text("from table");
    let said = cairn(&["owners", "bind", "mill", "--from-table", "--key", &curator, "--out", &from_table]);
    assert!(said.starts_with(&format!("\"ada\" is to stand for key {ada_public}\n")), "{said}");
    assert!(said.contains(&format!("\"ada\" stands for key {ada_public}")) && said.lines().count() == 2, "{said}");
    // A second run enters nothing anew.
    let said = cairn(&["owners", "bind", "mill", "--from-table", "--key", &curator, "--out", &from_table]);
    assert_eq!(said, format!("\"ada\" stands for key {ada_public} already\n"));
    let listed = cairn(&["owners", "list", "mill"]);
    assert_eq!(listed.matches("binding  mill").count(), 1, "{listed}");
    let index = listed.split("  ").next().unwrap();
    let shown = cairn(&["owners", "show", index]);
    assert!(shown.contains("as the scene's table of contributors says"), "{shown}");
    let said = refused(&["owners", "bind", "town", "--from-table", "--key", &curator, "--out", &out]);
    assert!(said.contains("has no keys"), "{said}");
    // A photograph that is excluded is claimed no more.
    cairn(&["scene", "exclude", "town", view]);
    let later = place.text("later");
    cairn(&[&sign[..8], &[later.as_str()]].concat());
    let count = |index: &str| {
        let shown = cairn(&["owners", "show", index]);
        let line = shown.lines().find(|line| line.contains(" photographs:")).unwrap().to_owned();
        line.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap()
    };
    let newest = cairn(&["owners", "list", "town"]).lines().last().unwrap().split("  ").next().unwrap().to_owned();
    assert_eq!(count("0"), count(&newest) + 1);
}

#[test]
fn shares_are_signed_and_worked_out_again_and_forged_ones_are_found() {
    let place = Place::new();
    let data = place.text("data");
    let data = ["--data", data.as_str()];
    place.import("town", data);
    let cairn = |arguments: &[&str]| place.cairn_ok(&[arguments, &data].concat());
    let key = |name: &str| {
        let path = place.text(&format!("{name}.key"));
        place.cairn_ok(&["keys", "new", &path, "--plain"]);
        let public = cairn_log::keys::load_key(Path::new(&path), &cairn_log::keys::Unlock::Nothing).unwrap().public();
        (path, public.to_string())
    };
    let ((ada, ada_public), (curator, _)) = (key("ada"), key("curator"));
    cairn(&["owners", "sign", "town", "--contributor", "ada", "--key", &ada, "--out", &place.text("claim")]);
    let (answer, vkey, view) = (place.text("answer.json"), place.text("log.vkey"), "images/ada_002.png");
    cairn(&["owners", "vkey", "--out", &vkey]);
    let asked = ["owners", "answer", "town", "--view", view, "--out", &answer];
    let audit = |answer: &str| {
        let audited = place.cairn(&["audit", "answer", answer, "--vkey", &vkey]);
        (String::from_utf8(audited.stdout).unwrap(), audited.status.code())
    };
    // Before any training there are none.
    assert!(cairn(&asked).contains("it holds no shares: scene \"town\""));
    let (said, code) = audit(&answer);
    assert!(code == Some(0) && said.contains("info     shares.missing"), "{said}");

    cairn(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke"]);
    assert!(cairn(&asked).contains("and the shares of what the view shows"));
    let (said, code) = audit(&answer);
    assert!(code == Some(0) && said.starts_with("trusted") && said.contains("passed   shares.verified"), "{said}");
    assert!(
        said.contains("shares of what view \"images/ada_002.png\" shows")
            && said.contains(" %  \"ada\", photographs: ")
    );
    cairn(&[
        "owners",
        "bind",
        "town",
        "--contributor",
        "ada",
        "--owner-key",
        &ada_public,
        "--key",
        &curator,
        "--out",
        &place.text("binding"),
    ]);
    // The records that credit ada stand beside her share, and who confirmed them.
    let who = cairn(&["who", "town", "--view", view]);
    let line = who.lines().find(|line| line.contains(" ada: ")).unwrap();
    assert!(line.ends_with("; name confirmed: record 0"), "{who}");
    let json: serde_json::Value = serde_json::from_str(&cairn(&["who", "town", "--view", view, "--json"])).unwrap();
    let of_ada = json["contributors"].as_array().unwrap().iter().find(|of| of["name"] == "ada").unwrap();
    assert_eq!(of_ada["records"].as_array().unwrap().len(), 1);
    // A training record names what the shares follow from.
    let training = place.text("training");
    cairn(&["owners", "sign", "town", "--contributor", "ada", "--kind", "training", "--key", &ada, "--out", &training]);
    let report = place.cairn_ok(&["audit", "bundle", &training, "--vkey", &vkey, "--against", data[1]]);
    assert!(report.contains("digest.share_table.match") && report.contains("digest.base_field.match"), "{report}");

    // From the files alone.
    let model = place.path("data/models/town");
    let job = std::fs::read_dir(&model).unwrap().map(|entry| entry.unwrap().path()).find(|path| path.is_dir()).unwrap();
    let file = |name: &str| job.join(name).display().to_string();
    let (field, table, scene) = (file("base.field"), file("base.shares"), place.text("data/scenes/town"));
    let again = |answer: &str, field: &str, table: &str, more: &[&str]| {
        let line = ["audit", "shares", answer, "--base-field", field, "--share-table", table, "--vkey", &vkey];
        let output = place.cairn(&[&line[..], more].concat());
        let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        (said, output.status.code())
    };
    let (said, code) = again(&answer, &field, &table, &[]);
    assert!(code == Some(0) && said.starts_with("trusted") && said.contains("passed   shares.recomputed"), "{said}");
    let with_scene = ["--scene-folder", scene.as_str(), "--photographs", "4"];
    assert!(
        said.contains("info     shares.scene.unchecked") && said.contains("info     shares.rows.unchecked"),
        "{said}"
    );
    // Of this view, and of no other.
    let of = |view: &str| {
        let photograph = Digest::of(std::fs::read(place.path("capture").join(view)).unwrap()).to_string();
        again(&answer, &field, &table, &["--scene", "town", "--view", &photograph])
    };
    let ((said, right), (other, wrong)) = (of(view), of("images/ada_003.png"));
    assert!(right == Some(0) && said.contains("passed   answer.question.match"), "{said}");
    assert!(wrong == Some(1) && other.contains("error    answer.question.mismatch"), "{other}");
    let (said, code) = again(&answer, &field, &table, &["--scene-folder", &scene, "--photographs", "0"]);
    assert!(code == Some(2) && said.contains("--photographs"), "{said}");
    let (said, code) = again(&answer, &field, &table, &with_scene);
    assert!(
        code == Some(0) && !said.contains("shares.scene.unchecked") && said.contains("shares.camera.match"),
        "{said}"
    );
    assert_eq!(said.matches("passed   shares.rows.match").count(), 8, "{said}");
    assert!(said.contains("info     shares.rows.unchecked") && said.contains("got      8 were looked at"), "{said}");
    let json = again(&answer, &field, &table, &["--json"]).0;
    assert_eq!(serde_json::from_str::<serde_json::Value>(&json).unwrap()["outcome"], "trusted");

    // Another table, another field: their digests say so. A file that is none is named.
    let bent = |name: &str| {
        let mut bytes = std::fs::read(job.join(name)).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        let path = place.text(&format!("bent {name}"));
        std::fs::write(&path, bytes).unwrap();
        path
    };
    for (field, table) in [(&field, &bent("base.shares")), (&bent("base.field"), &table)] {
        let (said, code) = again(&answer, field, table, &[]);
        assert!(
            code == Some(1) && said.contains("error    shares.file.mismatch") && !said.contains("recomputed"),
            "{said}"
        );
    }
    let (said, code) = again(&answer, &field, &place.text("nothing"), &[]);
    assert!(code == Some(2) && said.contains("nothing"), "{said}");

    // A changed statement, and ones that the registry itself made up: shares moved from ada to bela, another power, and her
    // photographs in bela's name.
    let (registry, honest) = (place.path("data/registry.key"), std::fs::read(&answer).unwrap());
    let registry = cairn_log::keys::load_key(&registry, &cairn_log::keys::Unlock::Nothing).unwrap();
    let forged = |bend: &dyn Fn(&mut Shares)| {
        let mut answer = Answer::parse(&honest).unwrap();
        let mut shares = Shares::open(answer.shares.as_ref().unwrap()).unwrap();
        bend(&mut shares);
        answer.shares = Some(shares.seal(&registry).unwrap());
        let path = place.text("forged.json");
        std::fs::write(&path, answer.to_json()).unwrap();
        path
    };
    let moved = forged(&|shares| {
        let largest = &mut shares.contributors[0];
        let part = largest.photographs[0].share.min(0.1);
        largest.photographs[0].share -= part;
        largest.share -= part;
        shares.unseen += part;
    });
    let (said, code) = audit(&moved);
    assert!(code == Some(0), "it adds up, and the registry signed it: {said}");
    let (said, code) = again(&moved, &field, &table, &[]);
    assert!(code == Some(1) && said.contains("error    shares.recomputed.mismatch"), "{said}");
    let (said, code) = again(&forged(&|shares| shares.power = 0), &field, &table, &[]);
    assert!(code == Some(1) && said.contains("error    shares.method.unknown"), "{said}");
    let renamed = forged(&|shares| shares.contributors[0].name = "zoe".into());
    assert_eq!(again(&renamed, &field, &table, &[]).1, Some(0), "field and table know no names");
    let (said, code) = again(&renamed, &field, &table, &with_scene);
    assert!(code == Some(1) && said.contains("error    shares.photograph.mismatch"), "{said}");
    // Her photographs left out of it, or called excluded without being named, though all adds up.
    let dropped = |shares: &mut Shares| {
        let at = shares.contributors.iter().position(|of| of.name == "ada").unwrap();
        shares.excluded += shares.contributors.remove(at).share;
    };
    let (said, code) = again(&forged(&dropped), &field, &table, &[]);
    assert!(code == Some(1) && said.contains("neither credited nor excluded"), "{said}");
    let turned = forged(&|shares| shares.camera["pose"]["position"] = serde_json::json!([1.0, 2.0, 3.0]));
    let (said, code) = again(&turned, &field, &table, &with_scene);
    assert!(code == Some(1) && said.contains("error    shares.camera.mismatch"), "{said}");
    let mut changed = Answer::parse(&honest).unwrap();
    let envelope = changed.shares.as_mut().unwrap();
    let body = String::from_utf8(envelope.payload.clone()).unwrap();
    envelope.payload = body.replacen("\"ada\"", "\"zoe\"", 1).into_bytes();
    std::fs::write(place.path("changed.json"), changed.to_json()).unwrap();
    let (said, code) = again(&place.text("changed.json"), &field, &table, &[]);
    assert!(code == Some(1) && said.contains("error    shares.signature.invalid"), "{said}");
    assert_eq!(audit(&place.text("changed.json")).1, Some(1));
    // A table whose entries the photographs do not bear out, though the registry signed its digest.
    let mut bytes = std::fs::read(&table).unwrap();
    let weights = bytes.len() - entries(&bytes);
    bytes[weights..].iter_mut().enumerate().for_each(|(i, code)| *code = code.wrapping_add(i as u8 % 97));
    let wrong = place.text("wrong.shares");
    std::fs::write(&wrong, &bytes).unwrap();
    let signed = forged(&|shares| shares.files.share_table = Digest::of(&bytes));
    let (said, code) = again(&signed, &field, &wrong, &with_scene);
    assert!(code == Some(1) && said.contains("error    shares.rows.mismatch"), "{said}");
    // A table that moves a camera.
    let mut bytes = std::fs::read(&table).unwrap();
    let header = 8..8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let moved = move_a_camera(str::from_utf8(&bytes[header.clone()]).unwrap());
    bytes[header].copy_from_slice(moved.as_bytes());
    let wrong = place.text("moved.shares");
    std::fs::write(&wrong, &bytes).unwrap();
    let signed = forged(&|shares| shares.files.share_table = Digest::of(&bytes));
    let (said, code) = again(&signed, &field, &wrong, &with_scene);
    assert!(code == Some(1) && said.contains("error    shares.position.mismatch"), "{said}");
    // A table that is not to be had takes nothing from the proof.
    std::fs::rename(&table, place.text("kept.shares")).unwrap();
    assert!(cairn(&asked).contains("it holds no shares: ") && audit(&answer).0.starts_with("trusted"));
    std::fs::rename(place.text("kept.shares"), &table).unwrap();
    // Trained again with the same settings from fewer photographs: each record is held to its own training.
    cairn(&["scene", "exclude", "town", "images/bela_002.png"]);
    cairn(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke"]);
    let second = place.text("second training");
    cairn(&["owners", "sign", "town", "--contributor", "ada", "--kind", "training", "--key", &ada, "--out", &second]);
    for training in [&training, &second] {
        let report = place.cairn_ok(&["audit", "bundle", training, "--vkey", &vkey, "--against", data[1]]);
        assert!(report.contains("digest.share_table.match") && report.contains("digest.base_field.match"), "{report}");
    }
}

/// The header of a share table in which the first digit behind a position's first point is another.
fn move_a_camera(header: &str) -> String {
    let at = header.find("position").unwrap();
    let digit = at + header[at..].find('.').unwrap() + 1;
    let other = if header.as_bytes()[digit] == b'5' { "6" } else { "5" };
    format!("{}{other}{}", &header[..digit], &header[digit + 1..])
}

/// Bytes of a share table's weights, which end its file, by its header (safetensors).
fn entries(table: &[u8]) -> usize {
    let length = u64::from_le_bytes(table[..8].try_into().unwrap()) as usize;
    let header: serde_json::Value = serde_json::from_slice(&table[8..8 + length]).unwrap();
    let at = |n: usize| header["weight"]["data_offsets"][n].as_u64().unwrap() as usize;
    assert_eq!(8 + length + at(1), table.len(), "weights come last");
    at(1) - at(0)
}

/// A view of identity 1's cluster.
fn first_view(place: &Place, connect: &[&str; 2]) -> String {
    let shown = place.cairn_ok(&["scene", "show", "town", connect[0], connect[1]]);
    let label = shown.lines().find_map(|l| l.trim().strip_prefix("identity 1: ")?.split(',').next()).unwrap();
    let of_label = |l: &&str| l.contains(&format!("by {label}")) && !l.contains("held out");
    shown.lines().find(of_label).unwrap().trim().split("  ").next().unwrap().to_owned()
}

#[test]
fn the_key_to_pin_comes_from_the_registry_and_not_from_the_bundle() {
    let place = Place::new();
    let (data, key) = (place.text("data"), place.text("ada.key"));
    place.import("town", ["--data", &data]);
    place.cairn_ok(&["train", "town", "--by-contributor", "--base-only", "--quality", "smoke", "--data", &data]);
    place.cairn_ok(&["keys", "new", &key, "--plain"]);
    // Whoever has the photographs and the model can draw up a log of their own, with a bundle that agrees with itself.
    for part in ["scenes", "models"] {
        copy(&place.path("data").join(part), &place.path("forged-data").join(part));
    }
    place.cairn_ok(&["owners", "vkey", "--data", &place.text("forged-data")]);
    let (bundle, forged) = (place.text("bundle"), place.text("forged"));
    for (out, data) in [(&bundle, &data), (&forged, &place.text("forged-data"))] {
        let sign = ["owners", "sign", "town", "--identity", "1", "--key", &key, "--kind", "contribution"];
        place.cairn_ok(&[&sign[..], &["--out", out, "--data", data]].concat());
    }
    let own = place.text("forged/log.vkey");
    assert!(place.cairn_ok(&["audit", "bundle", &forged, "--vkey", &own]).starts_with("trusted"));

    let pinned = place.text("pinned.vkey");
    place.cairn_ok(&["owners", "vkey", "--data", &data, "--out", &pinned]);
    let written = std::fs::read_to_string(&pinned).unwrap();
    assert_eq!(place.cairn_ok(&["owners", "vkey", "--data", &data]), written);
    let daemon = Daemon::start(&place.path("data"), "");
    assert_eq!(place.cairn_ok(&["owners", "vkey", "--connect", &daemon.url]), written);
    assert!(daemon.terminate().success());
    assert_eq!(std::fs::read_to_string(place.path("bundle/log.vkey")).unwrap(), written);
    assert_eq!(place.cairn(&["audit", "bundle", &forged, "--vkey", &pinned]).status.code(), Some(1));
    // Nor does it matter what a bundle brings along.
    std::fs::copy(&own, place.path("bundle/log.vkey")).unwrap();
    assert!(place.cairn_ok(&["audit", "bundle", &bundle, "--vkey", &pinned]).starts_with("trusted"));
    assert_eq!(place.cairn(&["audit", "bundle", &bundle, "--vkey", &own]).status.code(), Some(1));
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &to);
        } else {
            std::fs::copy(&path, &to).unwrap();
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_about_a_photograph_looks_into_no_folder_but_a_scenes() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "");
    let mut client = OwnerServiceClient::connect(daemon.url.clone()).await.unwrap();
    let photograph = Digest::of("photograph").as_bytes().to_vec();
    for scene in ["..", "../models", "/tmp", "nowhere"] {
        let of = Some(v1::answer_request::Of::PhotographSha256(photograph.clone().into()));
        let request = v1::AnswerRequest { scene: scene.into(), of, as_of: String::new() };
        let json = client.answer(request).await.unwrap().into_inner().answer;
        let answer = Answer::parse(&json).unwrap();
        assert!(answer.records.is_empty() && answer.shares.is_none(), "{scene}");
    }
    assert!(daemon.terminate().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_log_whose_key_is_lost_is_not_opened_with_a_new_one() {
    let place = Place::new();
    let daemon = Daemon::start(&place.path("data"), "");
    let mut client = OwnerServiceClient::connect(daemon.url.clone()).await.unwrap();
    submit(&mut client, &OwnerKey::from_seed(&[1; 32]), "one").await.unwrap();
    assert!(daemon.terminate().success());

    let (key, kept) = (place.path("data/registry.key"), place.path("kept.key"));
    std::fs::rename(&key, &kept).unwrap();
    let list = ["owners", "list", "--data", &place.text("data")];
    let refused = place.cairn(&list);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{said}");
    assert!(said.contains("registry.key") && said.contains("restore") && said.contains("backup"), "{said}");
    assert!(!key.exists(), "a new key was made");
    std::fs::rename(&kept, &key).unwrap();
    assert!(place.cairn_ok(&list).starts_with("0  contribution  town"));
}

/// Records as they were acknowledged, each with the signed checkpoint that came with it.
type Answers = Arc<Mutex<Vec<(v1::Record, String)>>>;

/// Rounds of killing the daemon where `CAIRN_KILL_ROUNDS` says nothing.
const ROUNDS: usize = 20;
/// Clients that submit at the same time.
const CLIENTS: u8 = 3;

fn rounds() -> usize {
    std::env::var("CAIRN_KILL_ROUNDS").map_or(ROUNDS, |text| text.parse().expect("CAIRN_KILL_ROUNDS is a number"))
}

/// Every signed checkpoint that anybody was ever shown: one root for each size.
#[derive(Default)]
struct Roots(HashMap<u64, Digest>);

impl Roots {
    fn see(&mut self, note: &str, pinned: &NoteVerifier, round: usize) {
        let signed = Checkpoint::verify(note, pinned).unwrap();
        let root = *self.0.entry(signed.size).or_insert(signed.root);
        assert_eq!(root, signed.root, "round {round}: two roots were signed for size {}", signed.size);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_acknowledged_record_outlives_a_killed_daemon() {
    let place = Place::new();
    let mut random = ChaCha8Rng::seed_from_u64(20_261_122);
    let (mut acknowledged, mut roots) = (HashMap::new(), Roots::default());
    let mut daemon = Daemon::start(&place.path("data"), "");
    let pinned: NoteVerifier = checkpoint(&daemon.url).await.vkey.parse().unwrap();
    for round in 0..rounds() {
        let wanted = random.random_range(1..12);
        let pause = Duration::from_micros(random.random_range(0..20_000));
        let answers = load_and_kill(daemon, round, wanted, pause).await;
        let fresh: Vec<u64> = answers.iter().map(|(record, _)| record.index).collect();
        for (record, note) in answers {
            let index = record.index;
            assert!(acknowledged.insert(index, record).is_none(), "round {round}: index {index} was given twice");
            roots.see(&note, &pinned, round);
        }
        if round % 3 == 1 {
            // In the middle of starting as well, when the last batch is being set right.
            Daemon::start_and_kill(&place.path("data"), Duration::from_millis(random.random_range(0..150)));
        }
        daemon = Daemon::start(&place.path("data"), "");
        roots.see(&checkpoint(&daemon.url).await.checkpoint, &pinned, round);
        let last = round + 1 == rounds();
        verify_log(&daemon.url, &pinned, &acknowledged, |index| last || fresh.contains(&index)).await;
    }
    assert!(acknowledged.len() >= rounds());
    assert!(daemon.terminate().success());
}

/// Submits from several clients at once, kills the daemon `pause` after the `wanted`-th answer, and gives every answer.
async fn load_and_kill(daemon: Daemon, round: usize, wanted: usize, pause: Duration) -> Vec<(v1::Record, String)> {
    let (answers, killed) = (Answers::default(), Arc::new(AtomicBool::new(false)));
    let client = |number| submit_until_gone(daemon.url.clone(), number, round, answers.clone(), killed.clone());
    let clients: Vec<_> = (1..=CLIENTS).map(|number| tokio::spawn(client(number))).collect();
    let begun = Instant::now();
    while answers.lock().unwrap().len() < wanted {
        assert!(begun.elapsed() < Duration::from_secs(60), "round {round}: the daemon takes no records");
        tokio::time::sleep(Duration::from_micros(300)).await;
    }
    tokio::time::sleep(pause).await;
    killed.store(true, Ordering::SeqCst);
    daemon.kill();
    for client in clients {
        client.await.unwrap();
    }
    answers.lock().unwrap().drain(..).collect()
}

/// Submits under a key of its own until the daemon is gone.
async fn submit_until_gone(url: String, number: u8, round: usize, answers: Answers, killed: Arc<AtomicBool>) {
    let mut client = match OwnerServiceClient::connect(url).await {
        Ok(client) => client,
        Err(e) => return assert!(killed.load(Ordering::SeqCst), "round {round}: {e}"),
    };
    let key = OwnerKey::from_seed(&[number; 32]);
    for count in 0.. {
        match submit(&mut client, &key, &format!("{round}/{number}/{count}")).await {
            Ok(record) => answers.lock().unwrap().push(record),
            // What a broken line is called depends on the moment; before the kill there is none.
            Err(_) if killed.load(Ordering::SeqCst) => return,
            Err(e) => panic!("round {round}: {e}"),
        }
    }
}

/// Signs and submits a contribution; the record as the daemon acknowledged it.
async fn submit(
    client: &mut OwnerServiceClient<Channel>,
    key: &OwnerKey,
    what: &str,
) -> Result<(v1::Record, String), tonic::Status> {
    submit_listing(client, key, Digest::of(what), None).await
}

/// As [`submit`], with the photographs' root and the photographs that the record lists.
async fn submit_listing(
    client: &mut OwnerServiceClient<Channel>,
    key: &OwnerKey,
    photographs: Digest,
    views: Option<Vec<Digest>>,
) -> Result<(v1::Record, String), tonic::Status> {
    let owner_key = key.public().to_bytes().to_vec().into();
    let nonce = client.nonce(v1::NonceRequest { scene: "town".into(), owner_key }).await?.into_inner();
    let seen = Checkpoint::parse_text(&Note::parse(&nonce.checkpoint).unwrap().text).unwrap();
    let record = OwnerRecord {
        version: record::VERSION,
        kind: RecordKind::Contribution,
        origin: nonce.origin,
        scene: "town".into(),
        scene_salt: random_salt().unwrap(),
        identity: Identity::numbered(1, "ada"),
        owner_key: key.public(),
        digests: Digests { photographs: Some(photographs), ..Digests::default() },
        seed: None,
        purpose: "credit".into(),
        nonce: nonce.nonce.parse().unwrap(),
        seen: Seen { size: seen.size, root: seen.root },
        replaces: None,
        views,
    };
    let envelope = record.seal(key).unwrap().to_json().into_bytes().into();
    let answer = client.submit(v1::SubmitRecordRequest { envelope }).await?.into_inner();
    Ok((answer.record.unwrap(), answer.checkpoint))
}

async fn checkpoint(url: &str) -> v1::CheckpointResponse {
    let mut client = OwnerServiceClient::connect(url.to_owned()).await.unwrap();
    client.checkpoint(v1::CheckpointRequest {}).await.unwrap().into_inner()
}

/// Holds the log to what was acknowledged, and every record that is `asked` for to the key pinned before the first kill.
async fn verify_log(
    url: &str,
    pinned: &NoteVerifier,
    acknowledged: &HashMap<u64, v1::Record>,
    asked: impl Fn(u64) -> bool,
) {
    let size = Checkpoint::verify(&checkpoint(url).await.checkpoint, pinned).unwrap().size;
    let log = LogView { size, records: vec![] };
    let mut client = OwnerServiceClient::connect(url.to_owned()).await.unwrap();
    let request = v1::ListRecordsRequest { scene: "town".into(), ..Default::default() };
    let records = client.list(request).await.unwrap().into_inner().records;
    // What was acknowledged says nothing of later records.
    let entered = |record: &v1::Record| v1::Record { standing: None, ..record.clone() };
    let kept: HashMap<u64, v1::Record> = records.iter().map(|record| (record.index, entered(record))).collect();
    assert_eq!(kept.len(), records.len(), "an index twice");
    for (index, wanted) in acknowledged {
        assert_eq!(kept.get(index), Some(wanted), "record {index} is lost, or another");
    }
    // Those that were on their way when the daemon was killed may be there too, and must hold as well.
    for record in records.iter().filter(|r| asked(r.index) || !acknowledged.contains_key(&r.index)) {
        let request = v1::ProofRequest { index: record.index };
        let proof = client.proof(request).await.unwrap().into_inner().tlog_proof;
        let (envelope, proof, pinned) = (&record.envelope, Some(proof.as_str()), Some(pinned));
        let report = audit(&Evidence { envelope, proof, pinned, log: Some(&log), ..Evidence::default() });
        assert_eq!(report.outcome, Outcome::Trusted, "{report}");
    }
}

#[tokio::test]
async fn a_page_of_records_has_a_limit_in_bytes_and_pages_leave_nothing_out() {
    let place = Place::new();
    const MOST: usize = 65_536;
    let daemon = Daemon::start(&place.path("data"), &format!("[limits]\nmax_message_bytes = {MOST}\n"));
    let mut client = OwnerServiceClient::connect(daemon.url.clone()).await.unwrap();
    let key = OwnerKey::from_seed(&[1; 32]);
    let mut entered = Vec::new();
    // Some 14 kB each, and one alone that is more than half of a message.
    for (number, count) in [150, 150, 150, 480, 150, 150].into_iter().enumerate() {
        let mut views: Vec<Digest> = (0..count).map(|view| Digest::of(format!("{number}/{view}"))).collect();
        views.sort_unstable();
        let root = record::photographs_root(&views);
        entered.push(submit_listing(&mut client, &key, root, Some(views)).await.unwrap().0);
    }
    let (mut from, mut pages) = (0, Vec::new());
    loop {
        let request = v1::ListRecordsRequest { scene: "town".into(), from, limit: 0 };
        let page = client.list(request).await.unwrap().into_inner();
        let bytes: usize = page.records.iter().map(|record| record.envelope.len()).sum();
        assert!(bytes < MOST, "{bytes} bytes in page {}", pages.len());
        let next = page.next;
        pages.push(page.records);
        let Some(next) = next else { break };
        assert!(next > from, "page {} leads nowhere", pages.len());
        from = next;
    }
    assert!(
        pages.len() > 2,
        "{} records of {} bytes on {} pages",
        entered.len(),
        entered[0].envelope.len(),
        pages.len()
    );
    let listed: Vec<(u64, usize)> =
        pages.iter().flatten().map(|record| (record.index, record.envelope.len())).collect();
    assert_eq!(listed, entered.iter().map(|record| (record.index, record.envelope.len())).collect::<Vec<_>>());
}
