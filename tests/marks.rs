//! Marks through the real binary: trained, rendered, read, claimed. The training
//! is far too short for good answers; that they are well-formed and consistent
//! is what counts here.

use cairn_api::v1;
use cairn_api::v1::query_service_client::QueryServiceClient;
use cairn_testkit::daemon::{Daemon, Place};

#[tokio::test(flavor = "multi_thread")]
async fn a_mark_is_trained_rendered_read_and_claimed() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let keys = place.text("owners");
    let train = ["train", "town", "--by-contributor", "--quality", "smoke", "--data", &data, "--keys", &keys];
    let said = place.cairn_ok(&train);
    assert!(said.contains("marked field") && said.contains("2 owner records signed"), "{said}");

    let daemon = Daemon::start(&place.path("data"), "");
    let to = ["--connect", daemon.url.as_str()];
    let (marked, base) = (place.text("marked.png"), place.text("base.png"));
    let render = ["render", "town", "--view", "images/ada_002.png", "--out"];
    place.cairn_ok(&[&render[..], &[&marked], &to].concat());
    place.cairn_ok(&[&render[..], &[&base, "--base"], &to].concat());
    let (marked, base) = (std::fs::read(marked).unwrap(), std::fs::read(base).unwrap());
    // A path shows the marked field, too, and its maps are there.
    let (there, flight) = (place.text("there.png"), place.text("flight"));
    let light = ["--light", "images/ada_002.png", "--depth", &place.text("depth.png")];
    place.cairn_ok(&[&render[..], &[&there], &light, &to].concat());
    let between = ["--path", "between", "--from", "images/ada_002.png", "--to", "images/ada_004.png", "--frames", "2"];
    place.cairn_ok(&[&["render", "town"][..], &between, &["--out", &flight], &to].concat());
    assert_eq!(std::fs::read(place.path("flight/frame-00000.png")).unwrap(), std::fs::read(there).unwrap());
    assert_ne!(marked, base, "the mark left no trace");

    // One answer says whose mark it is, how sure that is, and what it hides.
    let mut query = QueryServiceClient::connect(daemon.url.clone()).await.unwrap();
    let picture = marked.into();
    let mut request = v1::IdentifyRequest { scene: "town".into(), picture, payload: true, ..Default::default() };
    let found = query.identify(request.clone()).await.unwrap().into_inner();
    assert_eq!(found.probabilities.len(), 3);
    assert!((found.probabilities.iter().sum::<f32>() - 1.0).abs() < 1e-4, "{:?}", found.probabilities);
    let payload = found.payload.unwrap();
    let signal = cairn_scene::decode_picture(&payload.picture_png, &cairn_scene::Limits::default(), None).unwrap();
    assert_eq!((signal.width(), signal.height()), (32, 32));
    assert!(payload.sound_wav.is_empty() && payload.text.is_none(), "nobody hides a sound or a text");
    let number = match found.answer.unwrap() {
        v1::identify_response::Answer::Identity(who) => who.number,
        v1::identify_response::Answer::Unmarked(_) | v1::identify_response::Answer::Foreign(_) => 0,
    };
    assert!((found.confidence - f64::from(found.probabilities[number as usize])).abs() < 1e-6);
    request.payload = false;
    assert_eq!(query.identify(request).await.unwrap().into_inner().payload, None);

    // Registered with the field, the mark stands out of a render that has it, and not of one that has none. It takes pictures
    // with more to see than the photographs.
    let pose = place.pose("images/ada_002.png", 6);
    let larger = ["render", "town", "--pose", &pose, "--out"];
    place.cairn_ok(&[&larger[..], &[&place.text("marked.png")], &to].concat());
    place.cairn_ok(&[&larger[..], &[&place.text("base.png"), "--base"], &to].concat());
    place.cairn_ok(&[&larger[..], &[&place.text("marked.webp")], &to].concat());
    let lossy = place.cairn(&[&larger[..], &[&place.text("marked.jpg")], &to].concat());
    assert!(String::from_utf8_lossy(&lossy.stderr).contains("a JPEG may take a faint mark"), "{lossy:?}");
    let who = place.cairn_json(&["who", "town", "--view", "images/ada_002.png", "--json", to[0], to[1]]);
    let owner = format!("identity {}: {}", who["identity"]["number"], who["identity"]["label"].as_str().unwrap());
    let identify =
        |picture: &str, how: &[&str]| place.cairn_ok(&[&["identify", "town", &place.text(picture)], how, &to].concat());
    for how in [["--view", "images/ada_002.png"], ["--pose", &pose]] {
        let said = identify("marked.png", &how);
        assert!(said.starts_with(&owner) && stands_out(&said), "{how:?}: {said}");
        assert_eq!(identify("marked.webp", &how), said, "the pixels are the same");
        let said = identify("base.png", &how);
        assert!(said.contains("registered: the field explains ") && !stands_out(&said), "{how:?}: {said}");
    }
    // A field of forty steps shows no place that is known again: the answer says so, and the classifier's comes.
    let said = identify("marked.png", &["--register"]);
    let why = "not registered: no camera was found: of ";
    assert!(
        said.contains(why) && said.contains("; the classifier answers\n") && said.contains("  class 2 ("),
        "{said}"
    );
    let nowhere = ["identify", "town", &place.text("marked.png"), "--view", "images/none.png"];
    let refused = place.cairn(&[&nowhere[..], &to].concat());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("there is no view"), "{refused:?}");
    // Too little to see, and what that camera cannot have taken whole.
    let wide = cairn_scene::Picture::constant(192, 96, [0.5; 3]);
    std::fs::write(place.path("wide.png"), cairn_scene::encode_png(&wide)).unwrap();
    for (picture, how, why) in [
        ("capture/images/ada_002.png", "--register", "64 x 64 px or more"),
        ("wide.png", "--view=images/ada_002.png", "the proportions of what it was rendered at, 32 x 32 px"),
    ] {
        let refused = place.cairn(&["identify", "town", &place.text(picture), how, to[0], to[1]]);
        assert!(String::from_utf8_lossy(&refused.stderr).contains(why), "{refused:?}");
    }

    let sheet = place.text("sheet.png");
    let report = place.cairn_json(&["evaluate", "town", "--json", "--sheet", &sheet, to[0], to[1]]);
    assert_eq!(report["mark"]["classes"]["asked"], 4, "{report}");
    assert_eq!(report["mark"]["identities"].as_array().unwrap().len(), 2);
    assert!(std::fs::read(sheet).unwrap().starts_with(b"\x89PNG"));

    assert!(daemon.terminate().success());
    let (bundle, vkey) = (place.text("owners/1"), place.text("owners/1/log.vkey"));
    let verify = ["audit", "bundle", &bundle, "--vkey", &vkey, "--against", &data];
    assert!(place.cairn_ok(&verify).starts_with("trusted"));

    // Another picture in the place of the hidden one.
    std::fs::copy(place.path("sheet.png"), place.path("owners/1/signal.png")).unwrap();
    assert_eq!(place.cairn(&verify).status.code(), Some(1));
}

/// Whether `cairn identify` says that a mark of the registered picture stood out.
fn stands_out(said: &str) -> bool {
    said.contains("registered: the field explains ") && !said.contains("the classifier answers")
}

#[test]
fn a_record_outlives_the_next_training_and_speaks_for_its_own_alone() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let train = |seed: &str, keys: &str| {
        let keys = place.text(keys);
        let train = ["train", "town", "--by-contributor", "--quality", "smoke", "--data", &data, "--seed", seed];
        place.cairn_ok(&[&train[..], &["--keys", &keys]].concat());
    };
    let who = || place.cairn_ok(&["who", "town", "--view", "images/ada_002.png", "--data", &data]);
    train("1", "first");
    let before = who();
    let number = if before.contains("identity 1's: ada") { 1 } else { 2 };
    assert!(before.contains(" %  ada: images/ada_002.png "), "{before}");
    // A map leaf follows each record.
    let last = format!("\nthe place is identity {number}'s: ada; owner records at index: {}\n", 2 * (number - 1));
    assert!(before.ends_with(&last), "{before}");

    // The second training has marks and records of its own; the first one's say nothing about them.
    train("2", "second");
    assert!(who().ends_with(&format!("; owner records at index: {}\n", 2 * (number + 1))), "{}", who());
    for keys in ["first", "second"] {
        let (bundle, vkey) = (place.text(&format!("{keys}/1")), place.text(&format!("{keys}/1/log.vkey")));
        let report = place.cairn_ok(&["audit", "bundle", &bundle, "--vkey", &vkey, "--against", &data]);
        assert!(report.starts_with("trusted") && report.contains("marked_field.match"), "{keys}: {report}");
    }

    // A file that is not there any more cannot have been compared; a marked field that was altered is told from the record's.
    let (bundle, vkey) = (place.text("first/1"), place.text("first/1/log.vkey"));
    let verify = ["audit", "bundle", &bundle, "--vkey", &vkey, "--against", &data];
    let field = place.path("data/models/town/job-000001/marked.field");
    std::fs::write(&field, b"another").unwrap();
    assert_eq!(place.cairn(&verify).status.code(), Some(1));
    std::fs::remove_dir_all(field.parent().unwrap()).unwrap();
    let refused = place.cairn(&verify);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{said}");
    assert!(said.contains("of 1 models of scene \"town\" none has the marked field"), "{said}");
}

/// A PNG of a colour above white.
fn emblem(colour: [f32; 3]) -> Vec<u8> {
    let mut picture = cairn_scene::Picture::constant(40, 40, colour);
    picture.rgb_mut()[40 * 20 * 3..].fill(1.0);
    cairn_scene::encode_png(&picture)
}

#[test]
fn anchors_and_signals_of_ones_own_go_all_the_way() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let signals = place.path("signals");
    std::fs::create_dir(&signals).unwrap();
    for (name, colour) in [("10.png", [0.0, 1.0, 0.2]), ("2.png", [1.0, 0.0, 0.4])] {
        std::fs::write(signals.join(name), emblem(colour)).unwrap();
    }
    std::fs::write(signals.join("._2.png"), "what macOS leaves").unwrap();
    let signals = signals.display().to_string();
    let train = ["train", "town", "--anchors", "2", "--neighbours", "4", "--signals", &signals];
    let keys = place.text("owners");
    let told = place.cairn_ok(&[&train[..], &["--quality", "smoke", "--data", &data, "--keys", &keys]].concat());
    // In the order in which people count: 2.png is identity 1's, which is said first. It is hidden at the detector's size.
    let lines: Vec<&str> = told.lines().map(str::trim).collect();
    for (line, end) in [(1, ") hides 2 (picture)"), (2, ") hides 10 (picture)")] {
        let begin = format!("identity {line} (anchor-");
        assert!(lines[line].starts_with(&begin) && lines[line].ends_with(end), "{told}");
        assert_eq!(lines.iter().filter(|l| **l == lines[line]).count(), 1, "{told}");
    }
    for (number, colour) in [(1, [255, 0, 102]), (2, [0, 255, 51])] {
        let kept = std::fs::read(place.path(&format!("owners/{number}/signal.png"))).unwrap();
        let kept = cairn_scene::decode_picture(&kept, &cairn_scene::Limits::default(), None).unwrap();
        assert_eq!(kept.to_rgb8()[..3], colour, "identity {number}");
    }
    // The label names the anchor's view; whose photographs stand behind it is said beside it.
    let shown = place.cairn_ok(&["scene", "show", "town", "--data", &data]);
    let label = shown.lines().find_map(|l| l.trim().strip_prefix("identity 1: ")?.split(',').next()).unwrap();
    let anchor = label.strip_prefix("anchor-").unwrap();
    let who = place.cairn_json(&["who", "town", "--view", anchor, "--json", "--data", &data]);
    let by = who["identity"]["contributors"].as_array().unwrap();
    let counts: Vec<u64> = by.iter().map(|of| of["photographs"].as_u64().unwrap()).collect();
    assert!(counts.is_sorted_by(|a, b| a >= b), "{who}");
    assert_eq!((counts.iter().sum::<u64>(), who["identity"]["label"].as_str()), (4, Some(label)), "{who}");
    // One signal too few is refused before anything is trained.
    let short = ["train", "town", "--anchors", "3", "--neighbours", "3", "--signals", &signals, "--quality", "smoke"];
    let refused = place.cairn(&[&short[..], &["--data", &data]].concat());
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("the number of signals") && said.contains('3'), "{said}");
}

#[test]
fn the_demo_goes_the_whole_way() {
    let place = Place::new();
    let out = place.text("demo");
    let demo = ["demo", "--photographs", "6", "--quality", "smoke", "--out", &out];
    let said = place.cairn_ok(&demo);
    for line in ["pictures, base field", "pictures, marked field", "classes, marked and base", "hidden SSIM"] {
        assert!(said.contains(line), "no line {line:?} in {said}");
    }
    for line in ["who contributed, by pose", "photographs unmarked", "owner records trusted      3 of 3 right"] {
        assert!(said.contains(line), "no line {line:?} in {said}");
    }
    // What it says to try next works, after another demo in the same place.
    std::fs::write(place.path("demo/notes.txt"), "of the person who looked").unwrap();
    let results = place.cairn_json(&[&demo[..], &["--json"]].concat());
    assert!(place.path("demo/notes.txt").exists());
    let next: Vec<&str> = said.lines().filter_map(|line| line.strip_prefix("  cairn ")).collect();
    assert!(next.len() > 4, "{said}");
    for command in next.iter().filter(|command| !command.contains("--path")) {
        place.cairn_ok(&command.split_whitespace().collect::<Vec<_>>());
    }
    assert_eq!((results["format_version"].as_u64(), results["seed"].as_u64()), (Some(1), Some(1)));
    assert_eq!(results["records_trusted"], serde_json::json!({ "right": 3, "asked": 3 }));
    assert_eq!(results["evaluation"]["mark"]["identities"].as_array().unwrap().len(), 3);
    // All who photographed what it shows, those who show most first.
    let shares: Vec<(String, f64)> = serde_json::from_value(results["shares"].clone()).unwrap();
    assert!(shares.is_sorted_by(|a, b| a.1 >= b.1), "{shares:?}");
    let ada = shares.iter().find(|(name, _)| name == "ada").map_or(0.0, |(_, share)| *share);
    assert!(ada > 0.05 && shares.iter().map(|(_, share)| share).sum::<f64>() < 1.0, "{shares:?}");
    assert!(said.contains("whose photographs show ada_001.png: ") && place.path("demo/who.png").exists(), "{said}");
    assert_eq!(results["seconds"].as_array().unwrap().last().unwrap()[0], "whole demo");
    // Six tiles a row, each at least 96 px wide.
    let sheet = std::fs::read(place.path("demo/contact-sheet.png")).unwrap();
    let sheet = cairn_scene::decode_picture(&sheet, &cairn_scene::Limits::default(), None).unwrap();
    assert!(sheet.width() >= 6 * 96, "{} px wide", sheet.width());
}

#[test]
fn a_picture_with_a_text_and_a_spoken_credit_go_all_the_way() {
    let place = Place::new();
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let signals = place.path("signals");
    std::fs::create_dir(&signals).unwrap();
    std::fs::write(signals.join("a.png"), emblem([1.0, 0.0, 0.4])).unwrap();
    std::fs::write(signals.join("a.txt"), "© Éva\n").unwrap();
    let spoken = cairn_landmark::sounds::credit(0, 0.4, 22_050, 3);
    std::fs::write(signals.join("b.wav"), cairn_scene::encode_wav(&spoken)).unwrap();
    let dir = signals.display().to_string();
    let train = ["train", "town", "--by-contributor", "--signals", &dir, "--quality", "smoke", "--data", &data];
    place.cairn_ok(&[&train[..], &["--keys", &place.text("owners")]].concat());

    // Files of one name are one identity's, and its record binds all of them.
    let kept = |file: &str| std::fs::read(place.path(&format!("owners/{file}")));
    assert_eq!(kept("1/signal.txt").unwrap(), "© Éva".as_bytes());
    assert!(kept("1/signal.png").is_ok() && kept("1/signal.wav").is_err() && kept("2/signal.png").is_err());
    let limits = cairn_scene::SoundLimits { max_file_bytes: 1 << 20, longest_s: 1.0 };
    let hidden = cairn_scene::decode_wav("kept", &kept("2/signal.wav").unwrap(), &limits).unwrap();
    assert_eq!((hidden.sample_rate_hz(), hidden.samples().len()), (16_000, 6_400));
    let verify = |number: u32| {
        let (bundle, vkey) =
            (place.text(&format!("owners/{number}")), place.text(&format!("owners/{number}/log.vkey")));
        place.cairn(&["audit", "bundle", &bundle, "--vkey", &vkey, "--against", &data])
    };
    for number in [1, 2] {
        let said = String::from_utf8_lossy(&verify(number).stdout).into_owned();
        assert!(said.starts_with("trusted") && said.contains("digest.hidden_signal.match"), "{said}");
    }

    // Registered, and large enough for that, so that so short a training's mark is believed.
    let (view, said_to, pose) = (place.text("view.png"), place.text("said"), place.pose("images/ada_002.png", 6));
    let render = ["render", "town", "--pose", &pose, "--out", &view, "--data", &data];
    let identify = ["identify", "town", &view, "--payload-out", &said_to, "--pose", &pose, "--data", &data];
    place.cairn_ok(&[&render[..], &["--base"]].concat());
    let refused = place.cairn_refused(&identify);
    assert!(refused.contains("the picture is unmarked, so nobody hid anything in it"), "{refused}");
    assert!(!place.path("said").exists());
    place.cairn_ok(&render);
    let said = place.cairn_ok(&identify);
    assert!(said.contains("  class 1 (ada): "), "{said}");
    assert!(
        ["recovered text: \"", "recovered sound in", "recovered picture in"].iter().all(|s| said.contains(s)),
        "{said}"
    );
    let sound =
        cairn_scene::decode_wav("said", &std::fs::read(place.path("said/sound.wav")).unwrap(), &limits).unwrap();
    assert_eq!((sound.sample_rate_hz(), sound.samples().len()), (16_000, 6_400));
    assert!(place.path("said/text.txt").exists() && place.path("said/picture.png").exists());

    let sheet = place.text("sheet.png");
    let said = place.cairn_ok(&["evaluate", "town", "--data", &data]);
    assert!(said.contains("hidden sound, SNR in dB") && said.contains("hidden text, characters"), "{said}");
    let report = place.cairn_json(&["evaluate", "town", "--json", "--sheet", &sheet, "--data", &data]);
    let [one, two] = [0, 1].map(|at| &report["mark"]["identities"][at]);
    assert!(one["text_bits"]["forced_grey"].is_f64() && one["audio_snr_db"].is_null(), "{report}");
    assert!(two["audio_lsd_db"]["forced_noise"].is_f64() && two["picture_ssim"].is_null(), "{report}");

    // Another text in the place of the hidden one; a sound that is not given with the rest.
    std::fs::write(place.path("owners/1/signal.txt"), "© Eva").unwrap();
    std::fs::remove_file(place.path("owners/2/signal.wav")).unwrap();
    std::fs::write(place.path("owners/2/signal.txt"), "nothing").unwrap();
    for number in [1, 2] {
        assert_eq!(verify(number).status.code(), Some(1), "identity {number}");
    }
    // Too long is refused before anything is trained, by name.
    std::fs::write(signals.join("a.txt"), "x".repeat(300)).unwrap();
    let refused = place.cairn(&train);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success(), "{said}");
    assert!(["identity 1", "300 bytes", "training.payload_text_bytes"].iter().all(|s| said.contains(s)), "{said}");
}
