use cairn_field::{Field, NamedView, OfPixel, VisibleField};
use cairn_scene::{Capture, ReadOptions};
use cairn_share::*;
use std::time::Instant;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let field = Field::from_bytes(&std::fs::read(&args[1]).unwrap()).unwrap();
    let side: usize = args[3].parse().unwrap();
    let capture = Capture::read(std::path::Path::new(&args[2]), &ReadOptions::default()).unwrap();
    let held: Vec<usize> = capture.held_out().collect();
    let train: Vec<usize> = capture.training().collect();
    let huber: f64 = args[4].parse().unwrap();
    let sized = |i: usize| {
        let c = capture.views[i].camera;
        let s = side as f64 / c.intrinsics.width.max(c.intrinsics.height) as f64;
        if s >= 1.0 {
            c
        } else {
            c.resized(
                (c.intrinsics.width as f64 * s).round() as usize,
                (c.intrinsics.height as f64 * s).round() as usize,
            )
        }
    };
    let views: Vec<NamedView> = train
        .iter()
        .map(|&i| {
            let c = sized(i);
            let p = capture.photograph(i).unwrap();
            let p = if (p.width(), p.height()) != (c.intrinsics.width, c.intrinsics.height) {
                p.resized(c.intrinsics.width, c.intrinsics.height)
            } else {
                p
            };
            NamedView::new(capture.views[i].name.clone(), c, &p)
        })
        .collect();
    let samples: Vec<usize> = args[5].split(',').map(|v| v.parse().unwrap()).collect();
    let mut all: Vec<Vec<Shares>> = vec![];
    for s in &samples {
        cairn_share::SAMPLES.store(*s, std::sync::atomic::Ordering::Relaxed);
        let t = Instant::now();
        let mut b = Builder::new(VisibleField::rows(&field));
        for v in &views {
            let w = taught(&field, &v.name, &v.view, huber);
            b.add(Photograph { name: v.name.clone(), position: v.view.camera.pose.position }, &w).unwrap();
        }
        let t1 = t.elapsed().as_secs_f64();
        let table = b.finish().unwrap();
        println!(
            "samples {s}: {:.2} s, finish {:.2} s, {} bytes",
            t1,
            t.elapsed().as_secs_f64() - t1,
            table.to_bytes().unwrap().len()
        );
        let shares = held
            .iter()
            .map(|&i| {
                let c = sized(i);
                let from = SeenFrom::new(&table, &field, c.pose.position, Sharpness::default());
                from.shares(&field.row_weights(&c, OfPixel::All))
            })
            .collect::<Vec<_>>();
        if let Some(first) = all.first() {
            let mut worst: (f64, f64) = (0.0, 0.0);
            let mut sq = 0.0;
            let mut n = 0;
            for (a, b) in first.iter().zip(&shares) {
                for (x, y) in a.of_photographs.iter().zip(&b.of_photographs) {
                    worst.0 = worst.0.max((x - y).abs());
                    sq += (x - y) * (x - y);
                    n += 1;
                }
                worst.1 = worst.1.max((a.unseen - b.unseen).abs());
            }
            println!(
                "   worst photo share off {:.5}, unseen off {:.5}, rms {:.6}",
                worst.0,
                worst.1,
                (sq / n as f64).sqrt()
            );
        }
        all.push(shares);
        if *s == samples[0] {
            for every in [2usize, 3, 4, 6] {
                let t = Instant::now();
                let mut worst = 0f64;
                let mut tt = 0.0;
                for (k, &i) in held.iter().enumerate() {
                    let c = sized(i);
                    let c2 = c.resized(c.intrinsics.width / every, c.intrinsics.height / every);
                    let t2 = Instant::now();
                    let from = SeenFrom::new(&table, &field, c.pose.position, Sharpness::default());
                    let sh = from.shares(&field.row_weights(&c2, OfPixel::All));
                    tt += t2.elapsed().as_secs_f64();
                    for (x, y) in all[0][k].of_photographs.iter().zip(&sh.of_photographs) {
                        worst = worst.max((x - y).abs());
                    }
                    worst = worst.max((all[0][k].unseen - sh.unseen).abs()).max((all[0][k].behind - sh.behind).abs());
                }
                let _ = t;
                println!("   query every {every}: worst off {:.5}, {:.4} s a view", worst, tt / held.len() as f64);
            }
        }
    }
}
