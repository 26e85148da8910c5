//! tmp
use cairn_nn::{Window, conv2d};
use candle_core::{Device, Tensor, Var};
use std::time::Instant;
fn best(mut f: impl FnMut()) -> f64 {
    let mut b = f64::MAX;
    for _ in 0..30 {
        let s = Instant::now();
        f();
        b = b.min(s.elapsed().as_secs_f64() * 1e3);
    }
    b
}
fn main() {
    for (ci, co, n, size, stride) in [(32, 32, 2, 128, 1), (16, 16, 4, 128, 1), (16, 32, 4, 128, 2), (64, 64, 4, 32, 1)]
    {
        let x = Var::randn(0f32, 1., (n, ci, size, size), &Device::Cpu).unwrap();
        let w = Var::randn(0f32, 0.1, (co, ci, 3, 3), &Device::Cpu).unwrap();
        let (dx, dw) = (x.detach(), w.detach());
        let ww = Window::square(stride, 1);
        let f = best(|| {
            conv2d(&dx, &dw, None, ww).unwrap();
        });
        let go = |a: &Tensor, b: &Tensor| {
            let y = conv2d(a, b, None, ww).unwrap();
            let s = Instant::now();
            y.backward().unwrap();
            s.elapsed().as_secs_f64() * 1e3
        };
        let mut bx = f64::MAX;
        let mut bw = f64::MAX;
        for _ in 0..20 {
            bx = bx.min(go(&x, &dw));
            bw = bw.min(go(&dx, &w));
        }
        println!("{ci}->{co} f {f:.2} dx {bx:.2} dw {bw:.2}");
    }
}
