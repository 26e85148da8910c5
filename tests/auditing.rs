//! The auditor's guide, `docs/security/auditing.md`, held to what the program prints: every command of its `text`
//! blocks is run, in order, on a small log, and must print what stands there, digests and sled's number of files apart.
//!
//! With `CAIRN_WRITE_DOCS=1` what it prints is written into the guide instead; read the change before it goes in.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use cairn_log::format::record::{
    self, Digests, Identity, Seen, SignalFiles, hidden_signal_commitment, photographs_root,
};
use cairn_log::keys::{Seal, save_key};
use cairn_log::{
    Checkpoint, Digest, Note, OwnerKey, OwnerRecord, RecordKind, Registry, SignedRecord, TlogProof, WitnessVerifier,
    cosign,
};
use cairn_testkit::daemon::{Daemon, Place, files};

const ORIGIN: &str = "registry.example/owners";
const WITNESS: &str = "witness.example/w1";
/// 2026-11-18T11:06:40Z.
const NOON: u64 = 1_795_000_000;

fn key(number: u8) -> OwnerKey {
    OwnerKey::from_seed(&[number; 32])
}

fn photograph(number: u8) -> Vec<u8> {
    format!("what the camera wrote of photograph {number}").into_bytes()
}

/// What a record says beside who signs it.
struct Says {
    kind: RecordKind,
    scene: &'static str,
    identity: (u32, &'static str),
    photographs: std::ops::Range<u8>,
    replaces: Option<Digest>,
}

/// The log of the guide in a folder, and what lies beside it.
struct World {
    folder: PathBuf,
}

impl World {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn open(&self, data: &str) -> Registry {
        Registry::open(&self.path(data).join("registry"), key(200), ORIGIN).unwrap()
    }

    /// Enters a record by the first of `keys`, signed by all; its envelope's digest and its index.
    fn enter(registry: &Registry, keys: &[u8], says: &Says) -> (Digest, u64) {
        let owner = key(keys[0]);
        let mut views: Vec<Digest> = says.photographs.clone().map(|n| Digest::of(photograph(n))).collect();
        views.sort_unstable();
        let of_photographs = matches!(says.kind, RecordKind::Claim | RecordKind::Contribution);
        let of_mark = says.kind == RecordKind::Claim;
        let salt = Digest::of(registry.size().to_be_bytes());
        let signal = hidden_signal_commitment(&Digest::of("salt"), &SignalFiles::picture(b"a small picture"));
        let head = Checkpoint::parse_text(&Note::parse(&registry.checkpoint()).unwrap().text).unwrap();
        let record = OwnerRecord {
            version: record::VERSION,
            kind: says.kind,
            origin: ORIGIN.into(),
            scene: says.scene.into(),
            scene_salt: salt,
            identity: Identity::numbered(says.identity.0, says.identity.1),
            owner_key: owner.public(),
            digests: Digests {
                marked_field: of_mark.then(|| Digest::of("field")),
                detector: of_mark.then(|| Digest::of("detector")),
                hidden_signal: of_mark.then_some(signal),
                photographs: of_photographs.then(|| photographs_root(&views)),
                base_field: None,
                share_table: None,
                training_configuration: None,
            },
            seed: None,
            purpose: "credit for the photographs".into(),
            nonce: registry.nonce(says.scene, &owner.public()).unwrap(),
            seen: Seen { size: head.size, root: head.root },
            replaces: says.replaces,
            views: of_photographs.then_some(views),
        };
        let mut envelope = record.seal(&owner).unwrap();
        keys[1..].iter().for_each(|other| envelope.sign(&key(*other)));
        (envelope.digest(), registry.submit(SignedRecord::open(envelope).unwrap()).unwrap().index)
    }

    /// Publishes, and has it cosigned at this time.
    fn publish(registry: &Registry, at: u64) {
        let mut note = Note::parse(&registry.publish().unwrap().checkpoint).unwrap();
        note.signatures.truncate(1);
        note.signatures.push(cosign(&note.text, at, WITNESS, &key(90)).unwrap());
        registry.cosign(&note.to_string()).unwrap();
    }

    fn put(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    /// Five records: ben's contribution, which cleo contests later, ada's claim, a rotation of her key, and one that is erased.
    fn new(folder: &Path) -> Self {
        let world = Self { folder: folder.into() };
        let registry = world.open("data");
        let says =
            |kind, identity, photographs, replaces| Says { kind, scene: "liberty", identity, photographs, replaces };
        let (bens, _) = Self::enter(&registry, &[2], &says(RecordKind::Contribution, (2, "ben"), 3..6, None));
        let (claim, adas) = Self::enter(&registry, &[1], &says(RecordKind::Claim, (1, "ada"), 1..4, None));
        Self::enter(&registry, &[3], &says(RecordKind::Dispute, (2, "ben"), 0..0, Some(bens)));
        Self::enter(&registry, &[4, 1], &says(RecordKind::Rotation, (1, "ada"), 0..0, Some(claim)));
        let town = Says { scene: "town", ..says(RecordKind::Contribution, (1, "dan"), 6..8, None) };
        let (_, last) = Self::enter(&registry, &[5], &town);
        Self::publish(&registry, NOON);
        registry.erase_index(last).unwrap();

        let (vkey, witness) = (registry.verifier().unwrap(), WitnessVerifier::new(WITNESS, key(90).public()).unwrap());
        world.put("log.vkey", format!("{vkey}\n"));
        world.put("policy", format!("log {vkey}\nwitness w1 {witness}\nquorum w1\n"));
        let mut envelope = registry.record(adas).unwrap().envelope;
        let proof: TlogProof = registry.tlog_proof(adas).unwrap();
        for bundle in ["bundle", "with-signal", "forged"] {
            world.put(&format!("{bundle}/record.json"), envelope.to_json());
            world.put(&format!("{bundle}/record.tlog-proof"), proof.to_text());
        }
        world.put("with-signal/signal.png", b"a small picture");
        world.put("with-signal/signal.salt", format!("{}\n", Digest::of("salt")));
        (1..4).for_each(|number| world.put(&format!("photographs/IMG_{number}.jpg"), photograph(number)));
        // Somebody else's name in her record.
        let said = String::from_utf8(envelope.payload).unwrap();
        envelope.payload = said.replace("\"ada\"", "\"eve\"").into_bytes();
        world.put("forged/record.json", envelope.to_json());
        drop(registry);
        save_key(&world.path("data/registry.key"), &key(200), &Seal::Plain).unwrap();
        // Opened by the program once and closed again, the folder is as a daemon leaves it.
        world.put("cairn.toml", format!("[registry]\norigin = {ORIGIN:?}\n"));
        let (said, code) = cairn("cairn registry anchor --accept --data data --config cairn.toml", folder);
        assert_eq!(code, 0, "{said}");
        let (said, code) = cairn("cairn owners vkey --data data --config cairn.toml", folder);
        assert!(said.starts_with(&format!("{vkey}\n")) && code == 0, "{said}");
        for copy in ["damaged", "fork", "running"] {
            cairn_testkit::copy(&world.path("data"), &world.path(copy));
        }
        // The anchor stays beside the folder that was copied.
        let (said, code) = cairn("cairn registry anchor --accept --data running --config cairn.toml", folder);
        assert_eq!(code, 0, "{said}");
        let entries = world.path("damaged/registry/public/tile/entries/000.p/10");
        let mut bytes = std::fs::read(&entries).unwrap();
        bytes[4 * 164 + 20] ^= 1;
        std::fs::write(entries, bytes).unwrap();
        world
    }

    /// The log goes on, in `data` by one record and in `fork` by two others.
    fn go_on(&self, data: &str, records: u8, at: u64) {
        let registry = self.open(data);
        for number in 0..records {
            let photographs = if data == "fork" { 20 + number..21 + number } else { 10..12 };
            let identity = (3, "eve");
            let says = Says { kind: RecordKind::Contribution, scene: "liberty", identity, photographs, replaces: None };
            Self::enter(&registry, &[6], &says);
        }
        Self::publish(&registry, at);
    }
}

/// What a command prints, on either output, and its exit code.
fn cairn(command: &str, folder: &Path) -> (String, i32) {
    let arguments = command.split_whitespace().skip(1);
    let output = cairn_testkit::daemon::command().args(arguments).current_dir(folder).output().unwrap();
    let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    (said, output.status.code().unwrap())
}

/// The guide with each command's real output below it; `run` gives it, with the exit code.
fn with_outputs(text: &str, mut run: impl FnMut(&str) -> (String, i32)) -> String {
    let (mut made, mut code) = (String::new(), 0);
    for (at, part) in text.split("```").enumerate() {
        let fence = if at == 0 { "" } else { "```" };
        let commands = part.strip_prefix("text\n").filter(|part| at % 2 == 1 && part.starts_with("$ "));
        let Some(block) = commands else {
            made += &format!("{fence}{part}");
            continue;
        };
        made += &format!("{fence}text\n");
        for command in block.lines().filter_map(|line| line.strip_prefix("$ ")) {
            let said = if command == "echo $?" {
                format!("{code}\n")
            } else {
                let (said, exit) = run(command);
                code = exit;
                said
            };
            made += &format!("$ {command}\n{said}");
        }
    }
    made
}

#[test]
fn the_guide_shows_what_the_program_prints() {
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/security/auditing.md");
    let text = std::fs::read_to_string(&guide).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let world = World::new(dir.path());
    let policy = std::fs::read_to_string(world.path("policy")).unwrap();
    let served = Arc::new(Mutex::new(world.path("data/registry/public")));
    let public = files::serve(served.clone());
    let daemon = Daemon::start(&world.path("running"), &std::fs::read_to_string(world.path("cairn.toml")).unwrap());
    let demo = Place::new();
    let (mut followed, mut commands) = (0, 0);
    let made = with_outputs(&text, |command| {
        commands += 1;
        if command.starts_with("cairn audit follow") {
            match followed {
                1 => world.go_on("data", 1, NOON + 3600),
                2 => {
                    world.go_on("fork", 2, NOON + 7200);
                    *served.lock().unwrap() = world.path("fork/registry/public");
                }
                _ => {}
            }
            followed += 1;
        }
        if command.contains("demo-out/") {
            return of_a_trained_scene(&demo, command, &text);
        }
        let real = command.replace("http://HOST:7342", &public).replace("http://HOST:7341", &daemon.url);
        cairn(&real, dir.path())
    });
    assert!(commands >= 12 && followed == 3, "{commands} commands, {followed} of them follow");
    // The policy is shown as a file.
    let shown = format!("```text\n{policy}```");
    let at = made.find("```text\nlog ").expect("the guide shows a policy");
    let end = at + 7 + made[at + 7..].find("```").unwrap() + 3;
    let made = format!("{}{shown}{}", &made[..at], &made[end..]);
    if std::env::var_os("CAIRN_WRITE_DOCS").is_some() {
        std::fs::write(&guide, made).unwrap();
        return;
    }
    for (at, (shown, printed)) in steady(&text).lines().zip(steady(&made).lines()).enumerate() {
        assert_eq!(shown, printed, "docs/security/auditing.md, line {}: what is shown is not what is printed", at + 1);
    }
    assert_eq!(text.lines().count(), made.lines().count());
}

/// A text whose digests are numbered as they come, since a registry's nonces are random: equal ones stay equal. How many
/// files sled has is its own affair.
fn steady(text: &str) -> String {
    let mut known: Vec<&str> = Vec::new();
    let mut made = String::new();
    for word in text.split_inclusive(|c: char| !c.is_ascii_alphanumeric()) {
        let bare = word.trim_end_matches(|c: char| !c.is_ascii_alphanumeric());
        if bare.len() == 64 && bare.bytes().all(|b| b.is_ascii_hexdigit()) {
            let number = known.iter().position(|digest| *digest == bare).unwrap_or_else(|| {
                known.push(bare);
                known.len() - 1
            });
            made += &format!("digest {number}{}", &word[64..]);
        } else {
            made += word;
        }
    }
    let line = |line: &str| match line.trim_start().starts_with("got ") && line.ends_with(" files") {
        true => "got files\n".to_owned(),
        false => format!("{line}\n"),
    };
    made.lines().map(line).collect()
}

/// What the guide shows of the demo's folder, whose training takes a minute: held to a training that takes a moment, finding
/// by finding. Whether marks are found is the demo's own: such a training marks nothing.
fn of_a_trained_scene(place: &Place, command: &str, text: &str) -> (String, i32) {
    let data = place.text("demo-out/data");
    if !Path::new(&data).exists() {
        place.import("town", ["--data", &data]);
        place.cairn_ok(&[
            "train",
            "town",
            "--by-contributor",
            "--quality",
            "smoke",
            "--data",
            &data,
            "--keys",
            "owners",
        ]);
    }
    let arguments: Vec<&str> = command.split_whitespace().skip(1).collect();
    let printed = place.cairn_ok(&arguments);
    let shown = text.split(&format!("$ {command}\n")).nth(1).unwrap();
    let shown = shown.split("```").next().unwrap().split("$ ").next().unwrap();
    let (mut of_guide, mut of_place) = (findings(shown), findings(&printed));
    let marks = |found: &mut Vec<String>| found.extract_if(.., |f| f.contains("render.mark.")).collect::<Vec<_>>();
    if arguments[0] == "audit" {
        assert_eq!(marks(&mut of_guide), ["passed render.mark.found"], "docs/security/auditing.md, below `{command}`");
        assert_eq!(marks(&mut of_place), ["warning render.mark.lost"], "{printed}");
    }
    assert_eq!(of_guide, of_place, "docs/security/auditing.md, below `{command}`, beside\n{printed}");
    (shown.to_owned(), 0)
}

/// Severity and code of each finding, the verdict in front.
fn findings(report: &str) -> Vec<String> {
    let code = |line: &str| {
        let mut words = line.split_whitespace();
        let (severity, code) = (words.next()?, words.next()?);
        let is_finding = ["passed", "info", "warning", "error"].contains(&severity);
        is_finding.then(|| format!("{severity} {code}"))
    };
    report.lines().take(1).map(str::to_owned).chain(report.lines().filter_map(code)).collect()
}

#[test]
fn digests_may_differ_and_which_are_the_same_may_not() {
    let [a, b] = ["a", "b"].map(|digit| digit.repeat(64));
    let first = steady(&format!("root {a}, {b}.\n{a}\n   got      3 files\n"));
    assert_eq!(first, steady(&format!("root {b}, {a}.\n{b}\n   got      2 files\n")));
    assert_ne!(first, steady(&format!("root {b}, {a}.\n{a}\n   got      2 files\n")));
    assert_ne!(first, steady(&format!("root {b}, {a}.\n{b}\n   got      2 records\n")));
}

#[test]
fn a_guides_outputs_are_replaced_and_nothing_else() {
    let text =
        "a `b`\n```text\nlog x\n```\nc\n```text\n$ cairn one\nold\n$ echo $?\n9\n```\nd\n```text\n$ cairn two\n```\n";
    let wanted = "a `b`\n```text\nlog x\n```\nc\n```text\n$ cairn one\nnew\n$ echo $?\n3\n```\nd\n```text\n$ cairn two\nnew\n```\n";
    assert_eq!(with_outputs(text, |_| ("new\n".into(), 3)), wanted);
}

#[test]
fn photographs_that_came_by_mail_are_all_that_the_record_lists() {
    let dir = tempfile::tempdir().unwrap();
    let world = World::new(dir.path());
    let audit = || cairn("cairn audit bundle bundle --policy policy --photographs photographs", dir.path());
    let (said, code) = audit();
    assert!(code == 0 && said.contains("passed   digest.photographs.match  photographs (3 photographs)"), "{said}");
    // In folders of their own, and under other names.
    std::fs::create_dir(world.path("photographs/more")).unwrap();
    std::fs::rename(world.path("photographs/IMG_1.jpg"), world.path("photographs/more/a.jpg")).unwrap();
    assert_eq!(audit().1, 0);
    // Others beside them are left out; one that is changed, or scaled, is missing.
    world.put("photographs/IMG_9.jpg", photograph(9));
    let (said, code) = audit();
    let matched = "digest.photographs.match  photographs, 3 of the 3 that the record lists, among 4 files";
    assert!(code == 0 && said.contains(matched), "{said}");
    world.put("photographs/IMG_2.jpg", "scaled");
    let (said, code) = audit();
    let mismatch = "digest.photographs.mismatch  photographs, 2 of the 3 that the record lists, among 4 files";
    assert!(code == 1 && said.contains(mismatch) && said.contains("--against"), "{said}");
    std::fs::remove_dir_all(world.path("photographs")).unwrap();
    let (said, code) = audit();
    assert!(code == 2 && said.contains("cannot list photographs"), "{said}");
    std::fs::create_dir(world.path("photographs")).unwrap();
    let (said, code) = audit();
    assert!(code == 2 && said.contains("there is no file in photographs"), "{said}");
    world.put("settings", "another");
    let (said, code) =
        cairn("cairn audit bundle bundle --policy policy --field settings --detector settings", dir.path());
    let mismatches = ["digest.marked_field.mismatch", "digest.detector.mismatch"];
    assert!(code == 1 && mismatches.iter().all(|code| said.contains(code)), "{said}");
}
