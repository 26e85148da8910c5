//! Where a render's time goes: one thread's microseconds a ray for rays alone, for stepping
//! through what is occupied, and for whole pictures, and how much each ray meets.
//!
//! `cargo run --release -p cairn-field --example rays -- FIELD FOLDER [VIEWS [pictures]]`; the last word
//! leaves all but the pictures out, for a profile.

use cairn_field::composite::{runs, see};
use cairn_field::march::{STEP_VOXELS, march};
use cairn_field::operator::MarkableField;
use cairn_field::rays::Lens;
use cairn_field::sh::SH;
use cairn_field::{Field, RayPath, Thresholds};
use cairn_scene::{Camera, Capture, ReadOptions};
use std::hint::black_box;
use std::time::Instant;

/// Times that each is run; the least counts.
const LAPS: usize = 5;
/// Width of the views whose ray weights are worked out, px, and rays across their pixels.
const SMALL: (usize, usize) = (192, 3);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, file, folder, rest @ ..] = arguments.as_slice() else {
        return Err("usage: rays FIELD FOLDER [VIEWS [pictures]]".into());
    };
    let views = rest.first().map_or(Ok(4), |n| n.parse::<std::num::NonZero<usize>>().map(usize::from))?;
    let field = Field::from_bytes(&std::fs::read(file)?)?;
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let every = capture.held_out().count().div_ceil(views).max(1);
    let cameras: Vec<Camera> = capture.held_out().step_by(every).map(|i| capture.views[i].camera).collect();
    println!("{} rays, {} rows, {:?}", pixels(&cameras), field.grid().rows(), field.grid().dims);
    if rest.get(1).is_none() {
        ray_by_ray(&field, &cameras);
        ray_weights(&field, &cameras);
    }
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let render = |camera: &Camera| drop(black_box(field.render(camera, field.canonical_appearance())));
        let us = least_us(pixels(&cameras), || pool.install(|| cameras.iter().for_each(render)));
        println!("pictures, {threads} thread(s)    {us:.3} us a ray, {:.3} million rays/s", 1.0 / us);
    }
    Ok(())
}

fn pixels(cameras: &[Camera]) -> usize {
    cameras.iter().map(|c| c.intrinsics.width * c.intrinsics.height).sum()
}

/// The least microseconds a ray that `work` on so many `rays` takes.
fn least_us(rays: usize, mut work: impl FnMut()) -> f64 {
    let seconds = (0..LAPS).map(|_| {
        let started = Instant::now();
        work();
        started.elapsed().as_secs_f64()
    });
    seconds.fold(f64::INFINITY, f64::min) / rays as f64 * 1e6
}

/// Rays, stepping and single rays' pictures, on one thread.
fn ray_by_ray(field: &Field, cameras: &[Camera]) {
    let views: Vec<(&Camera, Lens)> = cameras.iter().map(|camera| (camera, Lens::new(camera))).collect();
    let each = |what: &str, visit: &mut dyn FnMut(RayPath, [f32; SH])| {
        let us = least_us(pixels(cameras), || {
            for (camera, lens) in &views {
                for at in 0..lens.pixels() {
                    let (path, basis) = lens.ray(camera, field.frame(), at);
                    visit(path, basis);
                }
            }
        });
        println!("{what:24} {us:.3} us a ray");
    };
    let a_ray = |n: usize| n as f64 / (pixels(cameras) * LAPS) as f64;
    each("rays", &mut |path, basis| {
        black_box((path, basis));
    });
    let (mut groups, mut samples) = (0, 0);
    each("stepping to the end", &mut |path, _| {
        march(field.grid(), &path, 0.5, STEP_VOXELS, |s| {
            groups += 1;
            samples += s.held.count_ones() as usize;
            true
        });
    });
    println!("{:24} {:.2} groups, {:.2} samples a ray", "", a_ray(groups), a_ray(samples));
    let (mut tape, mut kept, mut cells) = (Vec::new(), 0, 0);
    each("ray by ray", &mut |path, basis| {
        black_box(see(field.grid(), &path, &basis, Thresholds::SHOWN, &mut tape));
        kept += tape.len();
        cells += runs(&tape).count();
    });
    println!("{:24} {:.2} samples kept, {:.2} cells a ray", "", a_ray(kept), a_ray(cells));
}

/// What stage 2 works out of each view, on all threads.
fn ray_weights(field: &Field, cameras: &[Camera]) {
    let (across, rays) = SMALL;
    let down = |c: &Camera| (across * c.intrinsics.height / c.intrinsics.width).max(1);
    let small: Vec<Camera> = cameras.iter().map(|c| c.resized(across, down(c))).collect();
    let us = least_us(rays * rays * pixels(&small), || {
        small.iter().for_each(|camera| drop(black_box(field.view(camera, 1e-3, rays))));
    });
    println!("{:24} {us:.3} us a ray, all threads", "ray weights");
}
