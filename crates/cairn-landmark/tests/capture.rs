//! The made-up capture as others see it: repeatable, importable, and with
//! cameras that are true.

use cairn_landmark::{Landmark, LandmarkConfig, LandmarkError};
use cairn_scene::{Capture, Picture, ReadOptions, SceneKind};
use glam::DVec3;

fn small() -> LandmarkConfig {
    LandmarkConfig { contributors: 3, photographs: 4, width: 36, height: 48, ..Default::default() }
}

fn distance(a: &Picture, b: &Picture) -> f64 {
    let sum: f64 = a.rgb().iter().zip(b.rgb()).map(|(x, y)| f64::from((x - y).abs())).sum();
    sum / a.rgb().len() as f64
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let on = |threads: usize, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Landmark::generate(&small(), seed).unwrap())
    };
    let one = on(1, 7);
    assert_eq!(one, on(3, 7));
    assert_ne!(one, on(3, 8));
    // All 64 bits of the seed count.
    assert_ne!(one, on(3, 7 | 1 << 40));
}

#[test]
fn the_ordinary_importer_reads_it_back() {
    comes_back(&small());
    for degrees in [40.0, 170.0, 220.0] {
        comes_back(&LandmarkConfig { fisheye_deg: Some(degrees), ..small() });
    }
}

fn comes_back(config: &LandmarkConfig) {
    let made = Landmark::generate(config, 1).unwrap();
    let folder = tempfile::tempdir().unwrap();
    made.write(folder.path()).unwrap();
    let options = ReadOptions { contributors: Some(folder.path().join("contributors.csv")), ..ReadOptions::default() };
    let read = Capture::read(folder.path(), &options).unwrap();
    assert_eq!(read.kind, SceneKind::Unbounded);
    assert_eq!(read.views.len(), made.views.len());
    for (index, (got, expected)) in read.views.iter().zip(&made.views).enumerate() {
        assert_eq!((&got.name, &got.contributor), (&expected.name, &expected.contributor));
        assert_eq!(got.camera.intrinsics, expected.camera.intrinsics);
        let (a, b) = (got.camera.pose, expected.camera.pose);
        assert!((a.position - b.position).length() < 1e-12);
        assert!((a.rotation - b.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-12));
        assert_eq!(read.photograph(index).unwrap().to_rgb8(), expected.picture.to_rgb8());
    }
}

#[test]
fn the_gilded_ball_is_seen_where_the_camera_says() {
    let config = LandmarkConfig { passers_by: false, light_variation: 0.0, width: 192, height: 256, ..small() };
    let made = Landmark::generate(&config, 3).unwrap();
    for view in &made.views {
        let ball = view.camera.project(DVec3::new(0.0, 0.0, 2.26)).unwrap();
        // Three of its radii to either side there is nothing but sky. Gold in
        // the shade mirrors that sky, so it is warm by comparison only.
        let aside = 0.18 / 3.0 * view.camera.intrinsics.fx;
        let [left, gold, right] = [-aside, 0.0, aside].map(|dx| {
            let [r, _, b] = view.picture.pixel((ball.x + dx) as usize, ball.y as usize);
            f64::from(r / b)
        });
        assert!(gold > left.max(right) + 0.05, "{}: red over blue is {left}, {gold}, {right} at {ball}", view.name);
    }
}

#[test]
fn a_fisheye_sees_as_far_as_it_was_asked_to() {
    for degrees in [40.0f32, 170.0, 220.0] {
        let config = LandmarkConfig { fisheye_deg: Some(degrees), ..small() };
        let camera = Landmark::generate(&config, 3).unwrap().views[0].camera;
        let (_, top) = camera.ray(config.width as f64 / 2.0, 0.0);
        let (_, bottom) = camera.ray(config.width as f64 / 2.0, config.height as f64);
        let halves = [top, bottom].map(|way| way.dot(camera.pose.forward()).acos().to_degrees());
        assert!(halves.iter().all(|half| (half * 2.0 - f64::from(degrees)).abs() < 1e-6), "{degrees}: {halves:?}");
    }
}

#[test]
fn passers_by_stand_on_some_photographs_and_change_nothing_else() {
    let config = LandmarkConfig { photographs: 8, ..small() };
    let crowded = Landmark::generate(&config, 2).unwrap();
    let empty = Landmark::generate(&LandmarkConfig { passers_by: false, ..config }, 2).unwrap();
    let mut touched = 0;
    for (with, without) in crowded.views.iter().zip(&empty.views) {
        assert_eq!(with.clean, without.picture, "{}", with.name);
        assert_eq!(without.clean, without.picture);
        touched += usize::from(with.picture != with.clean);
        assert!(distance(&with.picture, &with.clean) < 0.2, "{} is nothing but people", with.name);
    }
    assert!((6..=18).contains(&touched), "{touched} of 24 photographs have people");
}

#[test]
fn contributors_keep_their_arcs_and_their_light() {
    let made = Landmark::generate(&small(), 4).unwrap();
    assert_eq!(made.contributors(), ["ada", "bela", "chidi"]);
    for (index, view) in made.views.iter().enumerate() {
        let centre = (index / 4) as f64 * 120.0;
        let at = view.camera.pose.position;
        let off = (at.y.atan2(at.x).to_degrees() - centre + 540.0).rem_euclid(360.0) - 180.0;
        assert!(off.abs() <= 66.5, "{} stands {off} degrees from the middle of its arc", view.name);
        assert!((2.7..3.4).contains(&at.truncate().length()));
    }
    let mean = |i: usize| made.views[i].clean.rgb().iter().sum::<f32>() / made.views[i].clean.rgb().len() as f32;
    assert!((0..12).all(|i| (0.2..0.8).contains(&mean(i))), "every photograph is decently exposed");
    let same = Landmark::generate(&LandmarkConfig { light_variation: 0.0, ..small() }, 4).unwrap();
    assert!(distance(&same.views[0].clean, &made.views[0].clean) > 0.02);
}

#[test]
fn a_setting_out_of_range_is_named() {
    let error = Landmark::generate(&LandmarkConfig { width: 4, ..small() }, 0).unwrap_err();
    assert!(matches!(&error, LandmarkError::Config(c) if c.key == "width"));
    assert!(error.to_string().contains("16 to 2048"));
}

#[test]
fn a_folder_that_cannot_be_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("taken");
    std::fs::write(&file, b"").unwrap();
    let error = Landmark::generate(&small(), 0).unwrap().write(&file).unwrap_err();
    assert!(error.to_string().contains("taken"), "{error}");
}
