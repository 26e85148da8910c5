//! What pictures see of a field's rows is what the linear views say, without them.

use crate::common::{Numbers, ahead, ball_box, ball_in_the_open, camera, field_of, random_appearance, random_grid};
use cairn_field::grid::lattice::Grid;
use cairn_field::{Appearance, CHANNELS, CarrierBasis, Field, MarkableField, OfPixel, SceneFrame, VisibleField};
use glam::{DVec3, Vec4};

fn cases() -> [(SceneFrame, DVec3, DVec3); 3] {
    let (aside, middle) = (DVec3::new(-3.0, 0.7, 2.0), DVec3::ZERO);
    [
        (ball_box(), aside, middle),
        (ball_in_the_open(), aside, middle),
        (ahead(), DVec3::new(0.05, 0.1, 0.02), DVec3::new(0.0, 0.0, 4.0)),
    ]
}

fn field(frame: &SceneFrame) -> Field {
    let grid: Grid<f32> = random_grid([16, 14, 18], 0.7, -5.0..0.0, 31);
    field_of(frame, &grid, &random_appearance(6))
}

const SIDE: usize = 24;

#[test]
fn rows_weigh_what_the_transposed_view_says() {
    for (frame, from, at) in cases() {
        let (field, camera) = (field(&frame), camera(from, at, SIDE));
        let weight = |pixel: usize| if pixel.is_multiple_of(3) { 0.0 } else { 1.0 + (pixel % 7) as f32 };
        let seen = field.row_weights(&camera, OfPixel::ByPlace(&weight));

        let plain = Appearance::neutral([0.0; 3]);
        let view = field.view(&camera, 0.0, 1);
        let slope: Vec<f32> = (0..SIDE * SIDE).flat_map(|pixel| [weight(pixel), 0.0, 0.0]).collect();
        let rows = MarkableField::rows(&field);
        let (mut sums, mut touched) = (vec![0.0; 3 * rows], vec![false; rows]);
        view.push_back(&slope, CarrierBasis::Constant, &plain, &mut sums, &mut touched);

        let mut found = vec![0.0; rows];
        seen.rows.iter().for_each(|(row, weight)| found[*row as usize] = *weight);
        assert!(seen.rows.windows(2).all(|two| two[0].0 < two[1].0) && seen.rows[0].0 > 0, "ascending, not row 0");
        assert!(seen.rows.len() > 200, "{} rows are seen", seen.rows.len());
        let by_colour = field.row_weights(&camera, OfPixel::ByColour(&|pixel| weight(pixel.at)));
        assert!(by_colour == seen, "colours change nothing but what they are asked for");
        for (row, (found, sum)) in found.iter().zip(sums.chunks_exact(3)).enumerate() {
            assert!((found - sum[0]).abs() < 1e-4 * (1.0 + sum[0]), "{frame:?}, row {row}: {found}, not {}", sum[0]);
        }
        let ends = field.gather_view(&camera, cairn_field::Thresholds::SHOWN);
        let behind: f64 = ends.iter().enumerate().map(|(p, (g, _))| f64::from(weight(p) * g.end)).sum();
        let pixels: f64 = (0..SIDE * SIDE).map(|p| f64::from(weight(p))).sum();
        assert!((seen.behind - behind).abs() < 1e-6 * pixels && seen.pixels == pixels);
    }
}

#[test]
fn any_number_of_threads_weighs_alike() {
    let (frame, from, at) = cases()[1].clone();
    let (field, camera) = (field(&frame), camera(from, at, 40));
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| field.row_weights(&camera, OfPixel::ByPlace(&|at| 1.0 / (1 + at) as f32)))
    };
    let one = with(1);
    assert!([2, 3, 8].into_iter().all(|threads| with(threads) == one));
}

#[test]
fn a_pixel_is_given_with_its_colour() {
    for (frame, from, at) in cases() {
        let (field, camera, look) = (field(&frame), camera(from, at, SIDE), random_appearance(12));
        let render = field.render(&camera, &look);
        let off = |pixel: &cairn_field::Pixel| {
            let shown = render.pixel(pixel.at % SIDE, pixel.at / SIDE);
            let apart = pixel.colour(&look).iter().zip(shown).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-6, "{frame:?}, pixel {}", pixel.at);
            1.0
        };
        field.row_weights(&camera, OfPixel::ByColour(&off));
    }
}

#[test]
fn mixed_numbers_are_what_the_view_makes_of_them() {
    for (frame, from, at) in cases() {
        let (field, camera) = (field(&frame), camera(from, at, SIDE));
        let rows = MarkableField::rows(&field);
        let mut numbers = Numbers(3);
        // Every second row has numbers of its own, all others none.
        let mut table = vec![[0.0f32; CHANNELS]];
        let mut slot_of = vec![0u32; rows];
        for slot in slot_of.iter_mut().skip(1).step_by(2) {
            *slot = table.len() as u32;
            table.push([0.0; CHANNELS].map(|_: f32| numbers.within(0.0, 1.0) as f32));
        }
        let mixed = field.mixed(&camera, &slot_of, &table);

        let carrier: Vec<f32> = slot_of.iter().flat_map(|slot| table[*slot as usize][..3].to_vec()).collect();
        let mut picture = vec![0.0; 3 * SIDE * SIDE];
        let view = field.view(&camera, 0.0, 1);
        view.apply(&carrier, CarrierBasis::Constant, &Appearance::neutral([0.0; 3]), &mut picture);
        for (pixel, (mixed, shown)) in mixed.iter().zip(picture.chunks_exact(3)).enumerate() {
            for (got, want) in mixed.channels.iter().zip(shown) {
                assert!((got - want).abs() < 1e-5, "{frame:?}, pixel {pixel}: {got}, not {want}");
            }
        }
    }
}

#[test]
fn a_row_s_place_is_where_pictures_see_it() {
    for (frame, from, at) in cases() {
        let (field, camera) = (field(&frame), camera(from, at, SIDE));
        let eye = Vec4::from(field.place_of(camera.pose.position));
        let (mut shown, mut offs) = (0, 0.0);
        for row in 1..MarkableField::rows(&field) {
            let place = Vec4::from(field.place(row));
            assert!(place.w >= 0.0 && eye.w == 1.0);
            // The row alone in a picture: where it is brightest is where its place is.
            if row % 97 != 0 {
                continue;
            }
            let mut slot_of = vec![0; MarkableField::rows(&field)];
            slot_of[row] = 1;
            let mixed = field.mixed(&camera, &slot_of, &[[0.0; CHANNELS], [1.0; CHANNELS]]);
            let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
            for (pixel, mixed) in mixed.iter().enumerate().filter(|(_, m)| m.channels[0] > 1e-3) {
                let (_, way) = camera.ray((pixel % SIDE) as f64 + 0.5, (pixel / SIDE) as f64 + 0.5);
                sum += f64::from(mixed.channels[0]) * way;
                weight += f64::from(mixed.channels[0]);
            }
            if weight < 0.05 {
                continue;
            }
            shown += 1;
            // Both ways in the frame's own axes: a point far along the pixel's ray, seen from the eye.
            let seen = Vec4::from(field.place_of(camera.pose.position + 1e3 * sum.normalize()));
            let seen = (seen - eye).truncate().normalize();
            let way = (place.truncate() - eye.truncate() * place.w).normalize();
            let off = seen.dot(way).clamp(-1.0, 1.0).acos().to_degrees();
            // A cell is some 7 degrees wide from there, and what hides a part of it moves its middle.
            assert!(off < 12.0, "{frame:?}, row {row} is seen {off} degrees from its place");
            offs += off;
        }
        assert!(shown >= 3 && offs < 4.0 * shown as f32, "{frame:?}: {shown} rows show, {offs} degrees in all");
    }
}

/// A camera keeps its place in every frame's coordinates, whatever the capture's own are.
#[test]
fn places_keep_angles() {
    for (frame, from, at) in cases() {
        let field = field(&frame);
        let angle = |a: DVec3, b: DVec3, c: DVec3| (a - b).angle_between(c - b);
        let points: [DVec3; 3] = [from, at + DVec3::new(0.3, 0.1, 0.2), from + DVec3::new(0.5, -0.2, 0.1)];
        let [a, b, c] = points.map(|point| {
            let place = field.place_of(point);
            DVec3::new(f64::from(place[0]), f64::from(place[1]), f64::from(place[2]))
        });
        let off = angle(a, b, c) - angle(points[0], points[1], points[2]);
        assert!(off.abs() < 1e-5, "{frame:?}: {off}");
    }
}
