//! Keyed marks from the weaving to a name.

use crate::common::{cameras, field, photograph};
use cairn_field::{NamedView, VisibleField};
use cairn_mark::weave::keys::WeavingSecret;
use cairn_mark::weave::woven::{Looked, Woven, weave};
use cairn_mark::{Distortion, Evidence, threshold};
use cairn_register::Registrar;
use cairn_scene::metrics::psnr_db;
use cairn_scene::{Camera, Picture};
use cairn_share::{Builder, Photograph, taught};

/// Probability of any wrong name, of the six scores of a picture.
const WRONG: f64 = 1e-6;

/// The ball, woven for Ann, whose photographs show its one side, and Ben, whose show the other.
fn woven() -> Woven {
    let base = field();
    let mut builder = Builder::new(VisibleField::rows(&*base));
    for (number, camera) in cameras().into_iter().enumerate() {
        let NamedView { name, view } = NamedView::new(format!("view{number}"), camera, &photograph(&camera));
        let taught = taught(&base, &name, &view, 0.1);
        builder.add(Photograph { name, position: camera.pose.position }, &taught).unwrap();
    }
    let looked: Vec<Looked> = cameras()
        .iter()
        .step_by(3)
        .map(|camera| Looked { camera: large(camera), light: base.canonical_appearance().clone() })
        .collect();
    let owner_of: Vec<u16> = (0..12).map(|view| u16::from(view >= 6)).collect();
    let names = vec!["ann".to_owned(), "ben".to_owned()];
    weave(&base, &builder.finish().unwrap(), names, &owner_of, &secret(), &looked, 48.0)
        .expect("the views see what they taught")
}

fn secret() -> WeavingSecret {
    WeavingSecret::new([9; 32])
}

fn large(camera: &Camera) -> Camera {
    camera.resized(200, 180)
}

/// The best score of Ann and of Ben in `picture`.
fn read(woven: &Woven, picture: &Picture, camera: &Camera, secret: &WeavingSecret) -> [f64; 2] {
    let registrar = Registrar::new(field(), None);
    let registered = registrar.register_at(picture, camera).unwrap();
    let scores = Evidence::of(&field(), &woven.weave, &registered).scores(&woven.weave, secret);
    [0, 1].map(|who| scores[who].iter().copied().fold(f64::MIN, f64::max))
}

#[test]
fn a_picture_names_whose_photographs_taught_what_it_shows_and_nobody_else() {
    let (base, woven) = (field(), woven());
    let from = threshold(6, WRONG);
    // In the middle of Ann's cameras, and of Ben's.
    for (view, who) in [(2, 0), (8, 1)] {
        let camera = large(&cameras()[view]);
        let render = |field: &cairn_field::Field| field.render(&camera, field.canonical_appearance()).clamped();
        let (plain, marked) = (render(&base), render(&woven.field));
        let psnr = psnr_db(&plain, &marked).unwrap();
        let largest = plain.rgb().iter().zip(marked.rgb()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(psnr > 45.0 && largest < 8.0 / 255.0, "{psnr} dB, a colour changes by {largest}");
        for distortion in [Distortion::EightBits, Distortion::Jpeg { quality: 75 }] {
            let z = read(&woven, &distortion.apply(&marked, 1), &camera, &secret());
            assert!(z[who] > from && z[who] > z[1 - who], "{distortion:?} of view {view}: {z:?}");
            let unmarked = read(&woven, &distortion.apply(&plain, 1), &camera, &secret());
            assert!(unmarked.iter().all(|z| *z < from), "{distortion:?} of an unmarked render: {unmarked:?}");
        }
        let others = read(&woven, &Distortion::EightBits.apply(&marked, 1), &camera, &WeavingSecret::new([1; 32]));
        assert!(others.iter().all(|z| *z < from), "under another secret: {others:?}");
    }
}

#[test]
fn weaving_moves_colours_alone_and_is_the_same_twice() {
    let (base, one, other) = (field(), woven(), woven());
    assert_eq!(one.field.to_bytes().unwrap(), other.field.to_bytes().unwrap());
    assert_eq!(one.weave, other.weave);
    // What is expected over all signs is 48; of so few cells one draw lies a little beside it.
    assert!((one.psnr_db - 48.0).abs() < 1.0, "{} dB", one.psnr_db);
    let camera = large(&cameras()[1]);
    let depth = |field: &cairn_field::Field| field.render_maps(&camera, field.canonical_appearance()).depth;
    assert_eq!(depth(&base), depth(&one.field));
}
