//! Dropping what shows in no picture: pictures stay, cells go, files keep it so.

use crate::common::{ahead, ball_box, ball_in_the_open, field_of, random_appearance, random_grid, ring, rms};
use cairn_field::grid::lattice::Grid;
use cairn_field::{Field, only_what_shows};
use glam::DVec3;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

/// A ball of walls: nobody sees its inside.
fn solid(dims: [usize; 3]) -> Grid<f32> {
    let mut grid: Grid<f32> = random_grid(dims, 1.0, -1.0..1.0, 3);
    let raw: Vec<f32> = grid.vertex[1..]
        .iter()
        .map(|v| {
            let v = *v as usize;
            let at = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
            let far = (0..3).map(|k| (at[k] as f64 / (dims[k] - 1) as f64 - 0.5).powi(2)).sum::<f64>().sqrt();
            if far < 0.35 { 3.0 } else { -20.0 }
        })
        .collect();
    grid.set_raw_rows(&raw);
    grid.refresh_occupancy(0.0);
    grid
}

#[test]
fn the_inside_of_things_goes_and_pictures_stay() {
    let look = random_appearance(2);
    for frame in [ball_box(), ball_in_the_open()] {
        let cameras = ring(8, 48, 1.0, DVec3::ZERO);
        let whole = field_of(&frame, &solid([24, 24, 24]), &look);
        let less = only_what_shows(whole.clone(), &cameras, 0.01);
        let cells = |f: &Field| f.grid().occupancy.cells();
        assert!(4 * cells(&less) < 3 * cells(&whole), "{} of {} cells left", cells(&less), cells(&whole));
        assert!(less.grid().rows() < whole.grid().rows());
        for camera in &cameras {
            let (a, b) = (less.render(camera, &look), whole.render(camera, &look));
            // Neighbouring vertices' colours are unrelated here, so that every cell counts.
            assert!(rms(a.rgb(), b.rgb()) < 0.02, "{frame:?}: {}", rms(a.rgb(), b.rgb()));
        }
        let read = Field::from_bytes(&less.to_bytes().expect("a file")).expect("a sound file");
        assert_eq!(cells(&read), cells(&less));
        assert_eq!(read.render(&cameras[0], &look), less.render(&cameras[0], &look), "{frame:?}");
        assert_eq!(read.to_bytes().ok(), less.to_bytes().ok());
        // Looking again finds nothing more to drop.
        assert_eq!(cells(&only_what_shows(less.clone(), &cameras, 0.0)), cells(&less));
    }
}

#[test]
fn nothing_in_sight_leaves_nothing_and_no_threshold_changes_no_picture() {
    let look = random_appearance(2);
    let frame = ahead();
    let camera = ring(1, 20, 1.0, DVec3::ZERO)[0];
    let field = field_of(&frame, &random_grid([8, 8, 8], 0.8, -4.0..0.0, 5), &look);
    let before = field.render(&camera, &look);
    assert_eq!(only_what_shows(field.clone(), &[camera], 0.0).render(&camera, &look), before);
    let none = only_what_shows(field, &[], 0.01);
    assert_eq!((none.grid().rows(), none.grid().occupancy.cells()), (1, 0));
    assert!(none.render(&camera, &look).rgb().iter().all(|v| v.is_finite()));
}

#[test]
fn cells_of_another_lattice_are_refused() {
    let field = field_of(&ball_box(), &random_grid([8, 9, 10], 0.8, -4.0..0.0, 5), &random_appearance(2));
    let bytes = field.to_bytes().expect("a file");
    let (_, metadata) = SafeTensors::read_metadata(&bytes).expect("a field");
    let file = SafeTensors::deserialize(&bytes).expect("a field");
    for (dtype, words) in [(Dtype::U64, 7), (Dtype::U64, 0), (Dtype::I64, 12)] {
        let data = vec![0xff; 8 * words];
        let cells = TensorView::new(dtype, vec![words], &data).expect("whole numbers");
        let others = file.tensors().into_iter().filter(|(name, _)| name != "cells");
        let all: Vec<(String, TensorView<'_>)> = others.chain([("cells".to_owned(), cells)]).collect();
        let forged = safetensors::serialize(all, metadata.metadata().clone()).expect("plain tensors");
        let error = Field::from_bytes(&forged).expect_err("an error").to_string();
        assert!(error.contains("cells"), "{error}");
    }
    let without: Vec<_> = file.tensors().into_iter().filter(|(name, _)| name != "cells").collect();
    let forged = safetensors::serialize(without, metadata.metadata().clone()).expect("plain tensors");
    let error = Field::from_bytes(&forged).expect_err("an error").to_string();
    assert!(error.contains("no tensor `cells`"), "{error}");
}
