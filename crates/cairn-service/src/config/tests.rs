//! The default file against the defaults in code, and what is refused.

use cairn_field::AppearanceMode;
use cairn_mark::OtherColours;

use super::raw::Raw;
use super::*;

#[test]
fn the_default_file_is_the_defaults_and_has_every_key() {
    let file: toml::Table = DEFAULT_TOML.parse().unwrap();
    let parsed: Raw = file.clone().try_into().unwrap();
    assert_eq!(parsed, Raw::default());
    let code = toml::Table::try_from(Raw::default()).unwrap();
    assert_eq!(keys(&file), keys(&code));
}

/// All keys, those of inner tables by their whole path, sorted.
fn keys(table: &toml::Table) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => found.extend(keys(inner).iter().map(|k| format!("{key}.{k}"))),
            _ => found.push(key.clone()),
        }
    }
    found.sort();
    found
}

#[test]
fn every_key_of_the_default_file_has_a_comment() {
    let mut before = "";
    for (number, line) in DEFAULT_TOML.lines().enumerate() {
        if line.contains(" = ") && !line.starts_with('#') {
            assert!(before.starts_with('#'), "line {}: {line} has no comment above it", number + 1);
        }
        before = line;
    }
}

#[test]
fn shipped_overlays_are_accepted() {
    let base = Config::from_toml("", "test").unwrap().training;
    for (name, text) in [
        ("llff", include_str!("../../../../configs/llff.toml")),
        ("synthetic", include_str!("../../../../configs/synthetic.toml")),
        ("wild", include_str!("../../../../configs/wild.toml")),
        ("paper", include_str!("../../../../configs/paper.toml")),
        ("robust", include_str!("../../../../configs/robust.toml")),
        ("quick", QUICK_TOML),
    ] {
        let settings = training_settings(&base, &[(name, text)]).unwrap();
        assert_ne!(settings, base, "{name}.toml changes nothing");
    }
}

#[test]
fn pictures_of_something_else_take_any_colours_where_nothing_says_otherwise() {
    let base = Config::from_toml("", "test").unwrap().training;
    let others = |over: &[(&str, &str)]| {
        let overlays: Vec<(&str, &str)> =
            [overlay_for(SceneKind::ForwardFacing)].into_iter().chain(over.iter().copied()).collect();
        let mark = training_settings(&base, &overlays).unwrap().mark;
        (mark.others, mark.others_colours, mark.others_cutout_share)
    };
    assert_eq!(others(&[]), (2, OtherColours::Any, 0.25));
    for (name, text, each) in [
        ("quick", QUICK_TOML, 1),
        ("robust", include_str!("../../../../configs/robust.toml"), 1),
        // The paper knows no other pictures.
        ("paper", include_str!("../../../../configs/paper.toml"), 0),
    ] {
        assert_eq!(others(&[(name, text)]), (each, OtherColours::Near, 0.0), "{name}");
    }
}

#[test]
fn owners_have_to_be_told_surely_but_in_the_open_where_nothing_says_otherwise() {
    let base = Config::from_toml("", "test").unwrap().training;
    let least = |overlays: &[(&str, &str)]| training_settings(&base, overlays).unwrap().mark.min_confidence;
    assert_eq!(least(&[overlay_for(SceneKind::Unbounded)]), 0.0);
    for over in [
        ("quick", QUICK_TOML),
        ("robust", include_str!("../../../../configs/robust.toml")),
        ("paper", include_str!("../../../../configs/paper.toml")),
    ] {
        for kind in [SceneKind::ForwardFacing, SceneKind::Bounded] {
            assert_eq!(least(&[overlay_for(kind)]), 0.8, "{kind:?}");
            assert_eq!(least(&[overlay_for(kind), over]), 0.0, "{kind:?}, {}", over.0);
        }
    }
}

#[test]
fn the_papers_recipe_is_the_same_whatever_the_kind_of_scene() {
    let base = Config::from_toml("", "test").unwrap().training;
    let paper = ("paper", include_str!("../../../../configs/paper.toml"));
    let alone = training_settings(&base, &[paper]).unwrap();
    assert_eq!(alone.field, base.field, "stage 1 is the kind's");
    for kind in [SceneKind::ForwardFacing, SceneKind::Bounded, SceneKind::Unbounded] {
        let plain = training_settings(&base, &[overlay_for(kind)]).unwrap();
        let over = training_settings(&base, &[overlay_for(kind), paper]).unwrap();
        assert_eq!(over.mark, alone.mark, "{kind:?}: something of the kind's is left");
        assert_eq!(over.field, plain.field, "{kind:?}");
    }
    let quick = training_settings(&base, &[("quick", QUICK_TOML), paper]).unwrap();
    assert_eq!(quick.mark, alone.mark, "something of --quick is left");
}

#[test]
fn every_kind_of_scene_has_settings_that_are_accepted() {
    let base = Config::from_toml("", "test").unwrap().training;
    let field = |kind| training_settings(&base, &[overlay_for(kind)]).unwrap().field;
    let fields = [SceneKind::ForwardFacing, SceneKind::Bounded, SceneKind::Unbounded].map(field);
    for field in fields {
        assert_ne!(field.steps, base.field.steps, "each kind has its own");
        assert_eq!(field.appearance, AppearanceMode::Auto, "found out from the photographs, whatever the kind");
    }
}

#[test]
fn what_a_settings_file_says_stands_over_the_kinds_choice_key_by_key() {
    let settings = |text: &str, kind, own: &str| {
        let config = Config::from_toml(text, "test").unwrap();
        let overlays = [overlay_for(kind), ("the daemon's settings", &config.training_configured), ("own", own)];
        training_settings(&TrainingSettings::default(), &overlays).unwrap()
    };
    let plain = settings("", SceneKind::Unbounded, "");
    // One key of stage 2: the kind chooses all else, in both stages.
    let marked = settings("[mark]\nbudget_db = 38\n[mark.robust]\nenabled = true", SceneKind::Unbounded, "");
    assert!(marked.mark.budget_db == 38.0 && marked.mark.robust.enabled);
    assert_eq!((marked.field, marked.mark.view_refresh_steps), (plain.field.clone(), plain.mark.view_refresh_steps));
    // One of stage 1 leaves stage 2's alone.
    let field = settings("[field]\nsteps = 77", SceneKind::Bounded, "");
    assert_eq!((field.field.steps, field.field.voxel_px, field.mark.budget_db, field.mark.finer), (77, 2.2, 52.2, 2));
    assert_eq!(field.mark.classifier.channels, [12, 16, 32, 64, 64]);
    // So does a default that somebody asks for by name; a request's own word is the last.
    assert_eq!(settings("[mark]\nbudget_db = 52.0", SceneKind::Unbounded, "").mark.budget_db, 52.0);
    assert_eq!(settings("[mark]\nbudget_db = 38", SceneKind::Unbounded, "[mark]\nbudget_db = 40").mark.budget_db, 40.0);
}

#[test]
fn a_copy_of_the_default_file_says_only_what_was_changed_in_it() {
    let said = |text: &str| Config::from_toml(text, "test").unwrap().training_configured;
    let copy = said(DEFAULT_TOML);
    let kinds = [SceneKind::ForwardFacing, SceneKind::Bounded, SceneKind::Unbounded];
    for kind in kinds {
        let of = |configured: &str| {
            training_settings(&TrainingSettings::default(), &[overlay_for(kind), ("configured", configured)]).unwrap()
        };
        assert_eq!(of(&copy), of(""), "{kind:?}");
        // An older release's copy lacks some keys.
        let older = DEFAULT_TOML.replace("\nleast_voxel_px = 0.8\n", "\n").replace("\ngrow_share = 0.4\n", "\n");
        assert_eq!(of(&said(&older)), of(""), "{kind:?}");
        let changed = of(&said(&DEFAULT_TOML.replace("budget_db = 52.0", "budget_db = 38")));
        assert_eq!((changed.mark.budget_db, changed.field), (38.0, of("").field), "{kind:?}");
    }
    assert_eq!(said(""), "");
}

#[test]
fn what_stands_over_the_kinds_choice_is_told() {
    let keys = |text: &str| overridden(overlay_for(SceneKind::Unbounded), ("test", text), &[]).unwrap();
    assert_eq!(keys("[mark]\nbudget_db = 38.0\nbatch = 5"), ["mark.budget_db = 38.0 (39.5 there)"]);
    assert_eq!(keys("[mark]\nbudget_db = 39.5\n[field]\nhuber = 0.1"), ["field.huber = 0.1 (0.2 there)"]);
    assert_eq!(keys(""), [""; 0]);
    let (whole, same) = (("kind", "[mark]\nbudget_db = 41.0"), ("test", "[mark]\nbudget_db = 41"));
    assert_eq!(overridden(whole, same, &[]).unwrap(), [""; 0], "it says the same");
    // What is said again by somebody else does not stand.
    let (daemons, own) = (("test", "[mark]\nbudget_db = 38.0"), ("own", "[mark]\nbudget_db = 40.0"));
    assert_eq!(overridden(overlay_for(SceneKind::Unbounded), daemons, &[own]).unwrap(), [""; 0]);
}

#[test]
fn refusals_name_key_value_and_what_is_allowed() {
    for (text, wanted) in [
        ("[limits]\nqueue_lenght = 3", ["`limits.queue_lenght` = 3", "queue_length"]),
        ("[limits]\nqueue_length = 0", ["`limits.queue_length` = 0", "1 to 10000"]),
        ("[limits]\nqueue_length = \"many\"", ["`limits.queue_length` = \"many\"", "integer"]),
        ("[field]\nsteps = 0", ["`field.steps` = 0", "1 to 1000000"]),
        ("[mark]\nbatch = 0", ["`mark.batch` = 0", "1 to 64"]),
        ("[mark.detector]\nsise = 1", ["`mark.detector.sise` = 1", "size"]),
        ("[field]\nstepz = 1", ["`field.stepz` = 1", "steps"]),
        ("format_version = 2", ["`format_version` = 2", "1 to 1"]),
        ("[server]\nbind = \"0.0.0.0:1\"", ["`server.bind` = 0.0.0.0:1", "loopback"]),
        (
            "[access]\nmode = \"accounts\"\n[server]\nbind = \"0.0.0.0:1\"",
            ["`server.bind` = 0.0.0.0:1", "server.plaintext"],
        ),
        ("[access]\nmode = \"token\"", ["`access.token_file`", "a token's file"]),
        ("[access]\nmode = \"all\"", ["all", "accounts"]),
        ("[access]\nread = \"closed\"", ["`access.read` = closed", "nobody has a token"]),
        ("[access]\nmode = \"accounts\"\ntoken_file = \"t\"", ["`access.token_file` = t", "no other mode"]),
        ("[access]\ntoken_lifetime_s = 301", ["`access.token_lifetime_s` = 301", "10 to 300"]),
        ("[access.quota]\nviews = -1", ["views", "-1"]),
        ("[server.tls]\ncertificate = \"c\"", ["`server.tls.key`", "PEM"]),
        ("[server.tls]\nclient_ca = \"c\"", ["`server.tls.certificate`", "PEM"]),
        ("[server]\nbind = \"home\"", ["`server.bind` = home", "an IP address"]),
        ("[registry]\norigin = \"a b\"", ["`registry.origin` = a b", "without spaces"]),
        ("[registry]\nanchor_file = \"log.anchor\"", ["`registry.anchor_file` = log.anchor", "absolute path"]),
        ("[registry]\nanchor_file = \"/\"", ["`registry.anchor_file` = /", "of a file"]),
        ("[registry]\nhttp_bind = \"home\"", ["`registry.http_bind` = home", "an IP address"]),
        ("[registry]\nhttp_prefix = \"log\"", ["`registry.http_prefix` = log", "as /log"]),
        ("[registry]\nhttp_prefix = \"/a/../b\"", ["`registry.http_prefix` = /a/../b", "segments"]),
        ("[registry]\nwitnesses = [\"x\"]", ["`registry.witnesses` = x", "VKEY URL"]),
        ("[registry]\nwitnesses = [\"x http://w\"]", ["`registry.witnesses` = x", "verifier key"]),
        ("[registry]\nwitnesses = \"x\"", ["`registry.witnesses`", "array"]),
        ("[log]\nformat = \"xml\"", ["xml", "text"]),
        ("colour = true", ["`colour` = true", "limits"]),
    ] {
        let error = Config::from_toml(text, "test.toml").unwrap_err().to_string();
        for part in wanted {
            assert!(error.contains(part), "{text:?} gave: {error}");
        }
    }
}

#[test]
fn a_whole_number_is_a_fraction_but_not_the_other_way_round() {
    let config = Config::from_toml("[field]\nhuber = 1", "test").unwrap();
    assert_eq!(config.training.field.huber, 1.0);
    assert!(Config::from_toml("[field]\nsteps = 1.5", "test").is_err());
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
    assert!(twice.to_string().contains("another entry has this key"), "{twice}");
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
    let text = format!(
        "[server]\nbind = \"0.0.0.0:7341\"\nplaintext = true\n[access]\ntoken_file = {:?}",
        path.display().to_string()
    );
    let config = Config::from_toml(&text, "test").unwrap();
    assert_eq!(config.token.as_ref().unwrap().secret(), "0123456789abcdef");
    assert!(!format!("{config:?}").contains("0123456789abcdef"));
}
