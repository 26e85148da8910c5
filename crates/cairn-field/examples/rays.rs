//! Where a render's time goes: one thread's microseconds a ray for rays alone, for stepping
//! through what is occupied, and for whole pictures, and how much each ray meets.
//!
//! `cargo run --release -p cairn-field --example rays -- FIELD FOLDER [VIEWS [pictures]]`; the last word
//! leaves all but the pictures out, for a profile.

use cairn_capture::{Camera, Capture, ReadOptions};
use cairn_field::composite::{runs, see};
use cairn_field::march::{STEP_VOXELS, march};
use cairn_field::operator::MarkableField;
use cairn_field::rays::Lens;
use cairn_field::{Field, Thresholds};
use std::hint::black_box;
use std::time::Instant;

/// Times that each is run; the least counts.
const LAPS: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, file, folder, rest @ ..] = arguments.as_slice() else {
        return Err("usage: rays FIELD FOLDER [VIEWS]".into());
    };
    let views: usize = rest.first().map_or(Ok(4), |n| n.parse())?;
    let field = Field::from_bytes(&std::fs::read(file)?)?;
    let capture = Capture::read(folder.as_ref(), &ReadOptions::default())?;
    let every = capture.held_out().count().div_ceil(views).max(1);
    let cameras: Vec<Camera> = capture.held_out().step_by(every).map(|i| capture.views[i].camera).collect();
    let lenses: Vec<Lens> = cameras.iter().map(Lens::new).collect();
    let all: f64 = lenses.iter().map(|l| l.pixels() as f64).sum();
    println!("{all} rays, {} rows, {:?}", field.grid().rows(), field.grid().dims);
    let each = |what: &str, visit: &mut dyn FnMut(&Camera, &Lens, usize)| {
        let least = (0..LAPS).map(|_| {
            let started = Instant::now();
            for (camera, lens) in cameras.iter().zip(&lenses) {
                (0..lens.pixels()).for_each(|at| visit(camera, lens, at));
            }
            started.elapsed().as_secs_f64()
        });
        println!("{what:24} {:.3} us a ray", least.fold(f64::INFINITY, f64::min) / all * 1e6);
    };
    let parts = rest.get(1).is_none();
    let each = |what: &str, visit: &mut dyn FnMut(&Camera, &Lens, usize)| {
        if parts {
            each(what, visit)
        }
    };
    each("rays", &mut |camera, lens, at| {
        black_box(lens.ray(black_box(camera), field.frame(), at));
    });
    let (mut groups, mut samples) = (0usize, 0usize);
    each("stepping to the end", &mut |camera, lens, at| {
        march(field.grid(), &lens.ray(camera, field.frame(), at).0, 0.5, STEP_VOXELS, |s| {
            groups += 1;
            samples += s.held.count_ones() as usize;
            true
        });
    });
    let a_ray = |n: usize| n as f64 / all / LAPS as f64;
    println!("{:24} {:.2} groups, {:.2} samples a ray", "", a_ray(groups), a_ray(samples));
    let (mut tape, mut kept, mut cells) = (Vec::new(), 0usize, 0usize);
    each("ray by ray", &mut |camera, lens, at| {
        let (path, basis) = lens.ray(camera, field.frame(), at);
        black_box(see(field.grid(), &path, &basis, Thresholds::SHOWN, &mut tape));
        kept += tape.len();
        cells += runs(&tape).count();
    });
    println!("{:24} {:.2} samples kept, {:.2} cells a ray", "", a_ray(kept), a_ray(cells));
    let small: Vec<Camera> =
        cameras.iter().map(|c| c.resized(192, 192 * c.intrinsics.height / c.intrinsics.width)).collect();
    let least = (0..if parts { LAPS } else { 0 }).map(|_| {
        let started = Instant::now();
        small.iter().for_each(|camera| drop(black_box(field.view(camera, 1e-3, 3))));
        started.elapsed().as_secs_f64()
    });
    let rays: usize = small.iter().map(|c| 9 * c.intrinsics.width * c.intrinsics.height).sum();
    println!(
        "{:24} {:.3} us a ray, all threads",
        "ray weights, 3 x 3",
        least.fold(f64::INFINITY, f64::min) / rays as f64 * 1e6
    );
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let least = (0..LAPS).map(|_| {
            let started = Instant::now();
            for camera in &cameras {
                pool.install(|| black_box(field.render(camera, field.canonical_appearance())));
            }
            started.elapsed().as_secs_f64()
        });
        let least = least.fold(f64::INFINITY, f64::min) / all * 1e6;
        println!("pictures, {threads} thread(s)    {least:.3} us a ray, {:.3} million rays/s", 1.0 / least);
    }
    Ok(())
}
