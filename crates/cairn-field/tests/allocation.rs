//! Rays ask for no memory of their own: what a picture and a step need they take for tiles and threads. And
//! a field is read without its file beside it.

mod common;

use cairn_field::{BaseTrainer, Field, FieldConfig};
use cairn_testkit::{Counting, allocations_of, peak_of};
use common::{ball_box, camera, named, random_appearance, random_grid, stored_field, tiny, views};
use glam::DVec3;
use half::f16;
use std::io::Cursor;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How often `work` asks for memory, on a thread that does all of it.
fn asked(work: impl FnOnce() + Send) -> usize {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| allocations_of(work).1)
}

#[test]
fn a_picture_of_many_rays_asks_for_memory_hardly_more_often_than_one_of_few() {
    assert!(asked(|| drop(std::hint::black_box(vec![1_u8; 64]))) > 0, "the counter does not count");
    let grid = random_grid([24; 3], 0.3, -2.0..6.0, 3);
    let field = Field::from_bytes(&stored_field(&ball_box(), &grid, &random_appearance(4))).unwrap();
    let of = |size: usize| {
        let camera = camera(DVec3::new(0.4, 0.3, 3.0), DVec3::ZERO, size);
        asked(|| drop(std::hint::black_box(field.render(&camera, field.canonical_appearance()))))
    };
    let [few, many] = [64, 256].map(of);
    // 61,440 rays more, in tiles of up to 128.
    assert!(many < few + 256, "{few} times for 4,096 rays, {many} for 65,536");
}

#[test]
fn a_step_of_many_rays_asks_for_memory_hardly_more_often_than_one_of_few() {
    let of = |rays_per_step: usize| {
        let config = FieldConfig { rays_per_step, levels: 1, ..tiny(40) };
        let mut trainer = BaseTrainer::new(named(views(6, 64, 1.0, DVec3::ZERO)), ball_box(), None, config, 3).unwrap();
        let mut most = 0;
        for step in 0..20 {
            let count = asked(|| assert!(trainer.step().is_ok()));
            // The first steps make room.
            most = if step < 10 { 0 } else { most.max(count) };
        }
        most
    };
    let [few, many] = [256, 4096].map(of);
    assert!(many < few + 256, "{few} times for 256 rays, {many} for 4,096");
}

#[test]
fn a_field_is_read_in_little_more_memory_than_it_takes() {
    // Several pieces of every tensor.
    let grid = random_grid([56; 3], 0.6, -2.0..6.0, 5);
    let stored = stored_field(&ball_box(), &grid, &random_appearance(4));
    let (field, peak) = peak_of(|| Field::read_from(&mut Cursor::new(&stored)).unwrap());
    let rounded: Vec<f32> = grid.colour.iter().map(|v| f16::from_f32(*v).to_f32()).collect();
    assert!(field.grid().colour == rounded && field.grid().raw == grid.raw && field.grid().vertex == grid.vertex);
    let takes = 4 * (rounded.len() + 2 * grid.raw.len() + grid.rows());
    assert!(peak < takes + stored.len() / 4, "{peak} bytes for {takes} of a file of {}", stored.len());
    let whole = peak_of(|| Field::from_bytes(&stored.clone()).unwrap()).1;
    assert!(whole > takes + stored.len(), "the counter does not count: {whole} bytes");
}
