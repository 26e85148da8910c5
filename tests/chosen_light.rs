//! A light that is chosen: a training view's, one on the way to another's, and that of a photograph which somebody
//! brings, through the real daemon.

use std::path::Path;

use cairn_api::v1::appearance::Choice;
use cairn_api::v1::render_path_request::Path as Way;
use cairn_api::v1::render_service_client::RenderServiceClient;
use cairn_api::v1::{self};
use cairn_field::AppearanceMode;
use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_scene::metrics::psnr_db;
use cairn_scene::{Limits, Picture, decode_picture, encode_png};
use cairn_testkit::daemon::{Daemon, Place, smoke_settings, train_to_end};
use tonic::{Code, Request};

const ADA: &str = "images/ada_002.png";
const BELA: &str = "images/bela_005.png";
/// One that was held out.
const HELD_OUT: &str = "images/ada_001.png";

/// A place whose scene `town` has a base field, with lights of its views' own or without.
fn trained(appearance: AppearanceMode, steps: u64) -> Place {
    let place = Place::new();
    train(&place, appearance, steps);
    place
}

fn train(place: &Place, appearance: AppearanceMode, steps: u64) {
    let data = place.text("data");
    place.import("town", ["--data", &data]);
    let mut settings = smoke_settings();
    (settings.field.steps, settings.field.appearance) = (steps, appearance);
    train_to_end(&place.path("data"), "town", settings, true);
}

fn picture(path: &Path) -> Picture {
    decode_picture(&std::fs::read(path).unwrap(), &Limits::default(), None).unwrap()
}

/// The base field from `view`, in a light that `light` says, as 8 bits a channel.
fn render(place: &Place, daemon: &Daemon, view: &str, light: &[&str]) -> Picture {
    let out = place.text("render.png");
    let render = ["render", "town", "--view", view, "--base", "--out", &out, "--connect", &daemon.url];
    place.cairn_ok(&[&render[..], light].concat());
    picture(Path::new(&out))
}

/// What `cairn render` is refused with.
fn refused(place: &Place, daemon: &Daemon, light: &[&str]) -> String {
    let render = ["render", "town", "--view", ADA, "--base", "--out", "no.png", "--connect", &daemon.url];
    let output = place.cairn(&[&render[..], light].concat());
    assert!(!output.status.success(), "{light:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_light_on_the_way_between_two_views_ends_in_theirs() {
    let place = trained(AppearanceMode::On, 300);
    let daemon = Daemon::start(&place.path("data"), "");
    let between =
        |share: &str| render(&place, &daemon, ADA, &["--light", ADA, "--light-to", BELA, "--light-share", share]);
    let own = [ADA, BELA].map(|of| render(&place, &daemon, ADA, &["--light", of]));
    assert!(psnr_db(&own[0], &own[1]).unwrap() < 35.0, "the two have one light");
    for (share, own) in [("0", &own[0]), ("1", &own[1])] {
        assert_eq!(between(share).rgb(), own.rgb(), "share {share}");
    }
    let half = between("0.5");
    assert_eq!(half.rgb(), render(&place, &daemon, ADA, &["--light", ADA, "--light-to", BELA]).rgb());
    // A pixel is linear in the light; both are rounded to 8 bits, and cut off at black and white.
    for (half, (a, b)) in half.rgb().iter().zip(own[0].rgb().iter().zip(own[1].rgb())) {
        let rounded = 1.01 / 255.0;
        assert!(a.min(*b) - rounded <= *half && *half <= a.max(*b) + rounded, "{half} between {a} and {b}");
        let cut = [a, b].iter().any(|v| **v <= 0.0 || **v >= 1.0);
        assert!(cut || (half - 0.5 * (a + b)).abs() <= rounded, "{half} half-way from {a} to {b}");
    }

    // A path changes from the one to the other, in the pictures that its ends are seen in.
    let between =
        ["--path", "between", "--from", ADA, "--to", ADA, "--frames", "3", "--light", ADA, "--light-to", BELA];
    let path = [&["render", "town", "--base"][..], &between].concat();
    let flight = place.text("flight");
    place.cairn_ok(&[&path[..], &["--out", &flight, "--connect", &daemon.url]].concat());
    for (frame, seen) in [(0, &own[0]), (1, &half), (2, &own[1])] {
        let frame = place.path(&format!("flight/frame-0000{frame}.png"));
        assert_eq!(picture(&frame).rgb(), seen.rgb(), "{}", frame.display());
    }
    let share = [&path[..], &["--light-share", "0.5", "--out", "x.gif", "--connect", &daemon.url]].concat();
    assert!(String::from_utf8_lossy(&place.cairn(&share).stderr).contains("--light-share is for one picture"));

    // That of a view that no training saw is fitted to its photograph.
    let photograph = place.text(&format!("capture/{HELD_OUT}"));
    let fitted = render(&place, &daemon, ADA, &["--light-of", &photograph, "--taken-view", HELD_OUT]);
    assert_eq!(render(&place, &daemon, ADA, &["--light", HELD_OUT]).rgb(), fitted.rgb());
    assert!(psnr_db(&own[1], &fitted).unwrap() < 35.0, "it is another view's light");

    for (light, says) in [
        (["--light", ADA, "--light-to", "images/none.png", "--light-share", "0"], "no view \"images/none.png\""),
        (
            ["--light", ADA, "--light-to", BELA, "--light-share", "1.5"],
            "the appearance's share is 1.5; allowed is 0 to 1",
        ),
        (["--light", ADA, "--light-to", BELA, "--light-share", "-0.1"], "the appearance's share is -0.1"),
        (["--light", ADA, "--light-to", BELA, "--light-share", "NaN"], "the appearance's share is NaN"),
    ] {
        let said = refused(&place, &daemon, &light);
        assert!(said.contains(says), "{light:?}: {said}");
    }
}

/// A place as [`trained`] makes it, of a landmark in one light, every second photograph of which is as at dusk, those that
/// are held out among them.
fn at_dusk() -> Place {
    let place = Place::new();
    let config = LandmarkConfig {
        contributors: 2,
        photographs: 8,
        width: 32,
        height: 32,
        passers_by: false,
        light_variation: 0.0,
        ..LandmarkConfig::default()
    };
    let mut capture = Landmark::generate(&config, 3).unwrap();
    for view in capture.views.iter_mut().filter(|view| is_at_dusk(&view.name)) {
        for pixel in view.picture.rgb_mut().chunks_exact_mut(3) {
            pixel.iter_mut().zip([0.4, 0.5, 0.75]).for_each(|(v, dimmed)| *v *= dimmed);
        }
    }
    std::fs::remove_dir_all(place.path("capture")).unwrap();
    capture.write(&place.path("capture")).unwrap();
    train(&place, AppearanceMode::On, 400);
    place
}

/// Whether the number of a photograph of [`at_dusk`] is odd.
fn is_at_dusk(name: &str) -> bool {
    ["1.png", "3.png", "5.png", "7.png"].iter().any(|end| name.ends_with(end))
}

/// Mean PSNR of the photographs at dusk that trained, and of the others, against renders from where they were taken, dB.
fn against_photographs(place: &Place, daemon: &Daemon, light: &[&str]) -> (f64, f64) {
    let of = |numbers: [u32; 3]| {
        let view = |number: u32| {
            let view = format!("images/ada_{number:03}.png");
            psnr_db(&picture(&place.path("capture").join(&view)), &render(place, daemon, &view, light)).unwrap()
        };
        numbers.into_iter().map(view).sum::<f64>() / 3.0
    };
    (of([3, 5, 7]), of([2, 4, 6]))
}

#[test]
fn the_light_of_a_photograph_is_the_one_that_it_was_taken_in() {
    let place = at_dusk();
    let daemon = Daemon::start(&place.path("data"), "");
    let neutral = against_photographs(&place, &daemon, &[]);
    println!("in the mean light: dusk {:.2} dB, day {:.2} dB", neutral.0, neutral.1);
    // Two that the scene never saw, and two of another contributor's that it did. The mean light is not far from the day's.
    let photographs = [
        ("images/ada_001.png", 3.0),
        ("images/bela_001.png", 3.0),
        ("images/bela_003.png", 3.0),
        ("images/bela_004.png", 0.2),
    ];
    for (view, least) in photographs {
        let photograph = place.text(&format!("capture/{view}"));
        let light = ["--light-of", &photograph, "--taken-view", view];
        let fitted = against_photographs(&place, &daemon, &light);
        println!("in the light of {view}: dusk {:.2} dB, day {:.2} dB", fitted.0, fitted.1);
        let (near, far) = ((fitted.0 - neutral.0), (fitted.1 - neutral.1));
        let (near, far) = if is_at_dusk(view) { (near, far) } else { (far, near) };
        assert!(near > least && far < -1.0, "{view}: {near} dB nearer to its own, {far} dB to the others");
    }
}

#[test]
fn a_photograph_may_be_larger_than_its_view_and_is_refused_where_that_cannot_have_taken_it() {
    let place = trained(AppearanceMode::On, 100);
    let daemon = Daemon::start(&place.path("data"), "");
    let photograph = place.text("capture/images/ada_002.png");
    let own = render(&place, &daemon, ADA, &["--light-of", &photograph, "--taken-view", ADA]);
    assert_ne!(own.rgb(), render(&place, &daemon, ADA, &[]).rgb(), "no light was found");
    // Larger than the view, with a camera of its own: nearly the same light.
    let large = place.text("large.png");
    std::fs::write(&large, encode_png(&picture(Path::new(&photograph)).resized(96, 96))).unwrap();
    let seen = render(&place, &daemon, ADA, &["--light-of", &large, "--taken-view", ADA]);
    assert!(psnr_db(&own, &seen).unwrap() > 40.0, "{}", psnr_db(&own, &seen).unwrap());
    let pose = place.pose(ADA, 3);
    let seen = render(&place, &daemon, ADA, &["--light-of", &large, "--taken-pose", &pose]);
    assert!(psnr_db(&own, &seen).unwrap() > 30.0, "{}", psnr_db(&own, &seen).unwrap());
    // A path has it, too, all the way.
    let between = ["--path", "between", "--from", ADA, "--to", BELA, "--frames", "2", "--out", &place.text("flight")];
    let path = [&["render", "town", "--base"][..], &between].concat();
    let light = ["--light-of", &photograph, "--taken-view", ADA, "--connect", &daemon.url];
    place.cairn_ok(&[&path[..], &light].concat());
    assert_eq!(picture(&place.path("flight/frame-00000.png")).rgb(), own.rgb());
    let there = render(&place, &daemon, BELA, &light[..4]);
    assert_eq!(picture(&place.path("flight/frame-00001.png")).rgb(), there.rgb());

    std::fs::write(place.path("wide.png"), encode_png(&Picture::constant(64, 32, [0.5; 3]))).unwrap();
    std::fs::write(place.path("damaged.png"), &std::fs::read(&photograph).unwrap()[..200]).unwrap();
    for (file, view, says) in [
        (
            "wide.png",
            ADA,
            "the photograph is 64 x 32 px; allowed is the proportions of the camera that took it, 32 x 32",
        ),
        ("damaged.png", ADA, "picture"),
        ("large.png", "images/none.png", "there is no view \"images/none.png\""),
    ] {
        let said = refused(&place, &daemon, &["--light-of", file, "--taken-view", view]);
        assert!(said.contains(says), "{file}: {said}");
    }
}

/// A render of the marked field, or a flight through it, with its light not said yet.
fn marked() -> (v1::RenderRequest, v1::RenderPathRequest) {
    let viewpoint = view(ADA);
    let render = v1::RenderRequest { scene: "town".into(), viewpoint, ..Default::default() };
    let path = Some(Way::Orbit(v1::OrbitPath::default()));
    let flight = v1::RenderPathRequest { scene: "town".into(), path, frames: 2, ..Default::default() };
    (render, flight)
}

fn view(name: &str) -> Option<v1::Viewpoint> {
    Some(v1::Viewpoint { from: Some(v1::viewpoint::From::ViewName(name.into())) })
}

fn photograph(bytes: Vec<u8>, taken: Option<v1::Viewpoint>) -> Option<v1::Appearance> {
    let of = v1::PhotographAppearance { photograph: bytes.into(), viewpoint: taken };
    Some(v1::Appearance { choice: Some(Choice::Photograph(of)) })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scene_of_one_light_and_photographs_beyond_the_limits_are_refused() {
    let place = trained(AppearanceMode::Off, 40);
    let daemon = Daemon::start(&place.path("data"), "");
    let light = ["--light-of", &place.text("capture/images/ada_002.png"), "--taken-view", ADA];
    let said = refused(&place, &daemon, &light);
    assert!(said.contains("--appearance on"), "{said}");
    // All views have its one light, and what is no view has none.
    let said = refused(&place, &daemon, &["--light", ADA, "--light-to", "carl_001.png"]);
    assert!(said.contains("carl_001.png"), "{said}");
    daemon.kill();

    let place = trained(AppearanceMode::On, 40);
    let daemon = Daemon::start(&place.path("data"), "[limits]\nmax_photograph_bytes = 9000\nmax_side_px = 100");
    let mut line = RenderServiceClient::connect(daemon.url.clone()).await.unwrap();
    let (render, flight) = marked();
    let (render, flight) = (
        v1::RenderRequest { field: v1::FieldKind::Base.into(), ..render },
        v1::RenderPathRequest { field: v1::FieldKind::Base.into(), ..flight },
    );
    let long = encode_png(&Picture::constant(101, 4, [0.5; 3]));
    for (bytes, taken, says) in [
        (vec![7; 9001], view(ADA), "limits.max_photograph_bytes"),
        (long, view(ADA), "101"),
        (vec![7; 99], view(ADA), "picture"),
        (vec![], view(ADA), "the appearance's photograph is not set"),
        (vec![7; 99], None, "the viewpoint of the appearance's photograph is not set"),
    ] {
        let appearance = photograph(bytes, taken);
        let refused = line.render(v1::RenderRequest { appearance: appearance.clone(), ..render.clone() }).await;
        let refused = refused.unwrap_err();
        assert!(refused.code() == Code::InvalidArgument && refused.message().contains(says), "{says}: {refused}");
        // At either end of a flight.
        for (appearance, appearance_to) in [(appearance.clone(), None), (None, appearance)] {
            let flight = v1::RenderPathRequest { appearance, appearance_to, ..flight.clone() };
            let refused = line.render_path(flight).await.unwrap_err();
            assert!(refused.code() == Code::InvalidArgument && refused.message().contains(says), "{says}: {refused}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_photographs_light_asks_for_the_token_that_base_renders_ask_for() {
    let place = Place::new();
    let settings = format!("[access]\ntoken_file = {:?}", place.token());
    let daemon = Daemon::start(&place.path("data"), &settings);
    let mut line = RenderServiceClient::connect(daemon.url.clone()).await.unwrap();
    let (render, flight) = marked();
    let fitted = photograph(vec![7; 99], view(ADA));
    let blend = v1::AppearanceBlend { from_view: ADA.into(), to_view: BELA.into(), share: 0.5 };
    let blend = Some(v1::Appearance { choice: Some(Choice::Blend(blend)) });
    for (appearance, without) in [(fitted, Code::Unauthenticated), (blend, Code::NotFound)] {
        let render = v1::RenderRequest { appearance: appearance.clone(), ..render.clone() };
        assert_eq!(line.render(render.clone()).await.unwrap_err().code(), without);
        let mut with = Request::new(render);
        with.metadata_mut().insert("authorization", "Bearer a-token-of-the-test".parse().unwrap());
        assert_eq!(line.render(with).await.unwrap_err().code(), Code::NotFound);
        for (appearance, appearance_to) in [(appearance.clone(), None), (None, appearance)] {
            let flight = v1::RenderPathRequest { appearance, appearance_to, ..flight.clone() };
            assert_eq!(line.render_path(flight.clone()).await.unwrap_err().code(), without);
            let mut with = Request::new(flight);
            with.metadata_mut().insert("authorization", "Bearer a-token-of-the-test".parse().unwrap());
            assert_eq!(line.render_path(with).await.unwrap_err().code(), Code::NotFound);
        }
    }
}
