//! The declarations against the written documents, presets, and what is refused.

use std::path::Path;

use cairn_field::AppearanceMode;
use cairn_mark::OtherColours;
use cairn_scene::SceneKind;

use super::*;

/// With `CAIRN_WRITE_DOCS=1` the documents are written instead; read the change before it goes in.
#[test]
fn documents_are_as_the_declarations_say() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut others = Vec::new();
    for (path, text) in document::all() {
        if std::env::var_os("CAIRN_WRITE_DOCS").is_some() {
            std::fs::create_dir_all(root.join(&path).parent().unwrap()).unwrap();
            std::fs::write(root.join(&path), &text).unwrap();
        } else if std::fs::read_to_string(root.join(&path)).ok().as_ref() != Some(&text) {
            others.push(format!("{path} is not this (CAIRN_WRITE_DOCS=1 writes it):\n{text}"));
        }
    }
    assert!(others.is_empty(), "{}", others.join("\n"));
}

#[test]
fn the_written_file_says_what_is_so_without_it() {
    let written = document::all().into_iter().find(|(path, _)| path == "configs/daemon.toml").unwrap().1;
    let (written, without) = (Config::from_toml(&written, "test").unwrap(), Config::from_toml("", "test").unwrap());
    assert_eq!(format!("{written:?}"), format!("{without:?}"));
}

#[test]
fn settings_are_few_and_each_has_a_reason() {
    let all: Vec<_> = settings::TABLES.iter().flat_map(|table| table.settings).collect();
    assert!(all.len() <= 50, "{} settings", all.len());
    for setting in all {
        assert!(setting.about.trim().ends_with('.') && setting.reason.ends_with('.'), "{}", setting.key);
    }
}

fn of(preset: Preset, quality: Quality, robust: bool) -> TrainingSettings {
    preset::settings(Chosen { preset, quality, robust })
}

#[test]
fn every_choice_is_accepted_and_says_what_it_is() {
    for preset in [Preset::Forward, Preset::Object, Preset::Outdoor] {
        for quality in [Quality::Smoke, Quality::Draft, Quality::Balanced, Quality::Archival] {
            for robust in [false, true] {
                let settings = of(preset, quality, robust);
                settings.check().unwrap();
                assert_eq!(settings.chosen, Some(Chosen { preset, quality, robust }));
                assert_eq!(settings.mark.robust.enabled, robust);
                assert_eq!(settings.screened, quality != Quality::Smoke);
                let again: TrainingSettings = toml::from_str(&settings.to_toml().unwrap()).unwrap();
                assert_eq!(again, settings);
            }
        }
    }
}

#[test]
fn a_quality_stands_over_its_preset_and_robust_over_both() {
    let plain = of(Preset::Object, Quality::Balanced, false);
    assert_eq!((plain.field.steps, plain.mark.budget_db, plain.mark.finer), (10_000, 52.2, 2));
    let draft = of(Preset::Object, Quality::Draft, false);
    assert_eq!((draft.field.steps, draft.mark.budget_db, draft.mark.finer), (600, 42.0, 1));
    assert_eq!(draft.field.initial_opacity, plain.field.initial_opacity, "the preset's");
    let robust = of(Preset::Object, Quality::Draft, true);
    assert_eq!((robust.mark.steps, robust.mark.budget_db, robust.field), (2000, 38.0, draft.field));
    let archival = of(Preset::Object, Quality::Archival, false);
    assert_eq!((archival.field.steps, archival.mark.steps), (20_000, 2 * plain.mark.steps));
    // It promises seconds, whatever else is asked for.
    assert_eq!(of(Preset::Outdoor, Quality::Smoke, true).mark.steps, 30);
}

#[test]
fn unmarked_pictures_have_any_colours_and_confidence_is_asked_for_where_a_preset_says_so() {
    let of = |preset, quality, robust| {
        let mark = of(preset, quality, robust).mark;
        (mark.others, mark.others_colours, mark.others_cutout_share, mark.min_confidence)
    };
    assert_eq!(of(Preset::Forward, Quality::Balanced, false), (2, OtherColours::Any, 0.25, 0.8));
    assert_eq!(of(Preset::Object, Quality::Balanced, false), (1, OtherColours::Near, 0.0, 0.8));
    assert_eq!(of(Preset::Outdoor, Quality::Balanced, false), (1, OtherColours::Near, 0.0, 0.0));
    for (quality, robust) in [(Quality::Draft, false), (Quality::Balanced, true)] {
        assert_eq!(of(Preset::Forward, quality, robust), (1, OtherColours::Near, 0.0, 0.0));
    }
}

#[test]
fn the_request_counts_first_then_the_file_then_the_preset() {
    let file = Config::from_toml("[training]\npreset = \"object\"\nappearance = \"on\"\n", "test").unwrap().training;
    let kind = SceneKind::Unbounded;
    let of_file = TrainingOptions::default().settings(&file, kind).unwrap();
    assert_eq!(of_file.chosen.unwrap().preset, Preset::Object);
    assert_eq!((of_file.field.appearance, of_file.mark.audio.longest_s), (AppearanceMode::On, 4.0));
    let asked = TrainingOptions {
        preset: Some(PresetChoice::Auto),
        appearance: Some(AppearanceMode::Off),
        payload_sound_s: Some(2.0),
        ..TrainingOptions::default()
    };
    let asked = asked.settings(&file, kind).unwrap();
    assert_eq!(asked.chosen.unwrap().preset, Preset::Outdoor);
    assert_eq!((asked.field.appearance, asked.mark.audio.longest_s), (AppearanceMode::Off, 2.0));
}

#[test]
fn refusals_name_key_value_and_what_is_allowed() {
    for (text, wanted) in [
        ("[limits]\nqueue_lenght = 3", ["`limits.queue_lenght`", "queue_length"]),
        ("[limits]\nqueue_length = 0", ["`limits.queue_length` = 0", "1 to 10000"]),
        ("[limits]\nqueue_length = \"many\"", ["`limits.queue_length` = \"many\"", "integer"]),
        ("[training]\nmax_voxels = 100", ["`training.max_voxels` = 100", "4096 to 500000000"]),
        ("[training]\nquality = \"best\"", ["`training.quality` = best", "draft, balanced, archival"]),
        ("[training]\npayload_picture_px = 100", ["`training.payload_picture_px` = 100", "a multiple of 16"]),
        ("[training]\npayload_sound_s = 31", ["`training.payload_sound_s` = 31", "0.1 to 30"]),
        ("[training]\nsteps = 3", ["`training.steps`", "checkpoint_every_s"]),
        ("[mark]\nbatch = 2", ["`mark`", "training"]),
        ("[server.tls]\ncert = \"c\"", ["`server.tls.cert`", "certificate"]),
        ("server = 3", ["`server`", "limits"]),
        ("[server]\nbind = \"0.0.0.0:1\"", ["`server.bind` = 0.0.0.0:1", "loopback"]),
        (
            "[access]\nmode = \"accounts\"\n[server]\nbind = \"0.0.0.0:1\"",
            ["`server.bind` = 0.0.0.0:1", "server.plaintext"],
        ),
        ("[access]\nmode = \"token\"", ["`access.token_file`", "a token's file"]),
        ("[access]\nmode = \"all\"", ["`access.mode` = all", "accounts"]),
        ("[access]\nread = \"closed\"", ["`access.read` = closed", "no caller has a token"]),
        ("[access]\nmode = \"accounts\"\ntoken_file = \"t\"", ["`access.token_file` = t", "no other mode"]),
        ("[access]\ntoken_lifetime_s = 301", ["`access.token_lifetime_s` = 301", "10 to 300"]),
        ("[access.quota]\nviews = -1", ["`access.quota.views` = -1", "0 to"]),
        ("[server.tls]\ncertificate = \"c\"", ["`server.tls.key`", "PEM"]),
        ("[server.tls]\nclient_ca = \"c\"", ["`server.tls.certificate`", "PEM"]),
        ("[server]\nbind = \"home\"", ["`server.bind` = home", "an IP address"]),
        ("[registry]\norigin = \"a b\"", ["`registry.origin` = a b", "without spaces"]),
        ("[registry]\nanchor_file = \"log.anchor\"", ["`registry.anchor_file` = log.anchor", "absolute path"]),
        ("[registry]\nanchor_file = \"/\"", ["`registry.anchor_file` = /", "of a file"]),
        ("[registry]\nhttp_bind = \"home\"", ["`registry.http_bind` = home", "an IP address"]),
        ("[registry]\nhttp_prefix = \"log\"", ["`registry.http_prefix` = log", "as /log"]),
        ("[registry]\nhttp_prefix = \"/a/../b\"", ["`registry.http_prefix` = /a/../b", "segments"]),
        ("[registry]\nwitnesses = [\"x\"]", ["entry 1 of `registry.witnesses` is not", "VKEY URL"]),
        ("[registry]\nwitnesses = [\"x http://w\"]", ["entry 1 of `registry.witnesses` begins", "no verifier key: "]),
        ("[registry]\nwitnesses = \"x\"", ["`registry.witnesses`", "array"]),
        ("[log]\nformat = \"xml\"", ["`log.format` = xml", "text"]),
        ("colour = true", ["`colour`", "limits"]),
    ] {
        let error = Config::from_toml(text, "test.toml").unwrap_err().to_string();
        for part in wanted {
            assert!(error.contains(part), "{text:?} gave: {error}");
        }
    }
}

#[test]
fn a_whole_number_is_a_fraction_but_not_the_other_way_round() {
    let config = Config::from_toml("[training]\npayload_sound_s = 2", "test").unwrap();
    assert_eq!(config.training.payload_sound_s, 2.0);
    assert!(Config::from_toml("[training]\nmax_voxels = 5000.5", "test").is_err());
}

#[test]
fn witnesses_and_public_files_are_read() {
    let vkey = "remora.n621.de+da77ade7+BOvN63jn/bLvkieywe8R6UYAtVtNbZpXh34x7onlmtw2";
    let settings = |witnesses: &[String]| format!("[registry]\nhttp_bind = \"0.0.0.0:80\"\nwitnesses = {witnesses:?}");
    let entry = format!("{vkey} https://witness.example/prefix/");
    let config = Config::from_toml(&settings(std::slice::from_ref(&entry)), "test").unwrap();
    assert_eq!(config.public_http.unwrap().bind.to_string(), "0.0.0.0:80", "public: any address");
    assert_eq!(config.witnesses[0].verifier.to_string(), vkey);
    assert_eq!(config.witnesses[0].url, "https://witness.example/prefix/");
    let twice = Config::from_toml(&settings(&[entry.clone(), entry]), "test").unwrap_err();
    assert!(twice.to_string().starts_with("entry 2 of `registry.witnesses` has the key of another entry"), "{twice}");
    let odd = Config::from_toml(&settings(&[format!("{vkey} ftp://witness.example")]), "test").unwrap_err();
    assert!(odd.to_string().contains("expected http://"), "{odd}");
    let none = Config::from_toml("", "test").unwrap();
    assert!(none.public_http.is_none() && none.witnesses.is_empty());
}

#[test]
fn a_token_is_read_from_its_file_and_never_printed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("token");
    std::fs::write(&path, "short\n").unwrap();
    assert!(Token::load(&path).unwrap_err().to_string().contains("5 bytes"));
    std::fs::write(&path, "0123456789abcdef\n").unwrap();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = |mode| std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        mode(0o640);
        let refused = Token::load(&path).unwrap_err().to_string();
        assert!(
            refused.contains("mode 640") && refused.contains("chmod 600") && !refused.contains("0123"),
            "{refused}"
        );
        mode(0o600);
    }
    let absent = Token::load(&dir.path().join("absent")).unwrap_err().to_string();
    assert!(absent.contains("the token is not read") && absent.contains("--token-file"), "{absent}");
    let text = format!(
        "[server]\nbind = \"0.0.0.0:7341\"\nplaintext = true\n[access]\ntoken_file = {:?}",
        path.display().to_string()
    );
    let config = Config::from_toml(&text, "test").unwrap();
    assert_eq!(config.token.as_ref().unwrap().secret(), "0123456789abcdef");
    assert!(!format!("{config:?}").contains("0123456789abcdef"));
}
