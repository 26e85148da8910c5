//! The walk back against finite differences, in f64: every density and colour
//! coefficient a ray touches, for straight and contracted paths, with both
//! losses on the weights; and the appearance code.

use crate::common::{Numbers, ahead, ball_box, ball_in_the_open, random_appearance, random_grid};
use cairn_field::appearance::code::{CODE, FEATURES, features};
use cairn_field::grid::lattice::{Grid, ROW};
use cairn_field::grid::sh::{SH, basis};
use cairn_field::render::composite::{Gathered, Thresholds, gather, push_back};
use cairn_field::render::patch::{Debts, Patch, Roulette};
use cairn_field::{Appearance, RayPath, SceneFrame};
use glam::DVec3;

const DISTORTION: f64 = 0.7;
const TARGET: [f64; 3] = [0.2, 0.9, 0.4];
const OFFSET: f64 = 0.37;

/// A ray and its basis.
type Ray = (RayPath, [f64; SH]);

/// Rays that start outside, inside and beyond, along and across the axes.
fn rays(frame: &SceneFrame, origin: DVec3, aims: &[DVec3]) -> Vec<Ray> {
    let rays: Vec<Ray> = aims
        .iter()
        .map(|aim| {
            let d = (*aim - origin).normalize();
            (frame.path(origin, d), basis(d.to_array()))
        })
        .collect();
    assert!(rays.iter().all(|r| r.0 != RayPath::Miss), "every ray is to cross the grid");
    rays
}

/// Squared error of all rays plus the losses on their weights, from the definitions.
fn loss(grid: &Grid<f64>, rays: &[Ray], look: &Appearance) -> f64 {
    let (mut tape, mut patch) = (Vec::new(), Patch::default());
    let mut sum = 0.0;
    for (path, basis) in rays {
        patch.begin(*basis);
        let gathered = gather(grid, &mut patch, path, OFFSET, Thresholds::EXACT, &mut tape);
        let shade = look.shade(&features(&gathered, basis));
        sum += (0..3).map(|c| (shade[c] - TARGET[c]).powi(2)).sum::<f64>();
        for a in &tape {
            sum += DISTORTION / 3.0 * a.weight * a.weight * a.length;
            for b in &tape {
                sum += DISTORTION * a.weight * b.weight * (a.along - b.along).abs();
            }
        }
    }
    sum
}

/// The same loss's gradient by the renderer's own walk, `rows x ROW`.
fn gradient(grid: &Grid<f64>, rays: &[Ray], look: &Appearance, mut roulette: Roulette) -> Vec<f64> {
    let (mut tape, mut patch) = (Vec::new(), Patch::default());
    let mut debts = Debts::default();
    for (path, basis) in rays {
        patch.begin(*basis);
        let gathered = gather(grid, &mut patch, path, OFFSET, Thresholds::EXACT, &mut tape);
        let shade = look.shade(&features(&gathered, basis));
        let slope: Gathered<f64> = look.pull(std::array::from_fn(|c| 2.0 * (shade[c] - TARGET[c])), basis);
        push_back(&mut patch, &tape, gathered.end, &slope, DISTORTION);
        assert!(patch.settle(&mut roulette, &mut debts), "finite gradients");
    }
    by_row(grid, &debts)
}

/// All debts added up, `rows x ROW`.
fn by_row(grid: &Grid<f64>, debts: &Debts<f64>) -> Vec<f64> {
    let mut out = vec![0.0; grid.rows() * ROW];
    for debt in &debts.owed {
        let out = &mut out[debt.row as usize * ROW..][..ROW];
        for (k, b) in debts.bases[debt.tile as usize].iter().enumerate() {
            for c in 0..3 {
                out[3 * k + c] += debt.light[c] * b;
            }
        }
        out[ROW - 1] += debt.raw;
    }
    out
}

/// A row's raw density (the last column) or one of its coefficients.
fn number(grid: &mut Grid<f64>, row: usize, k: usize) -> &mut f64 {
    let vertex = grid.vertex[row] as usize;
    if k == ROW - 1 { &mut grid.raw[vertex] } else { &mut grid.colour[row * ROW + k] }
}

fn agree(frame: &SceneFrame, origin: DVec3, aims: &[DVec3], dims: [usize; 3]) {
    let mut grid: Grid<f64> = random_grid(dims, 0.8, -4.5..-1.5, 11);
    let rays = rays(frame, origin, aims);
    let look = random_appearance(3);
    let found = gradient(&grid, &rays, &look, Roulette::NONE);
    let largest = found.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    assert!(largest > 1e-3, "the rays are to touch something");
    let mut touched = 0;
    let h = 1e-5;
    for row in 1..grid.rows() {
        if found[row * ROW..(row + 1) * ROW].iter().all(|v| *v == 0.0) {
            continue;
        }
        touched += 1;
        // The density, the constant colours and three others.
        for k in [ROW - 1, 0, 1, 2, 3 * 4, 3 * 6 + 1, 3 * 8 + 2] {
            let mut at = |step: f64| {
                let before = *number(&mut grid, row, k);
                *number(&mut grid, row, k) += step;
                let sum = loss(&grid, &rays, &look);
                *number(&mut grid, row, k) = before;
                sum
            };
            let expected = (at(h) - at(-h)) / (2.0 * h);
            let got = found[row * ROW + k];
            assert!(
                (got - expected).abs() <= 1e-6 * expected.abs() + 1e-8 * largest.max(1.0),
                "row {row}, number {k}: {got} for {expected}"
            );
        }
    }
    assert!(touched > 20, "only {touched} rows touched");
}

#[test]
fn a_bounded_box() {
    let aims = [DVec3::new(0.3, -0.2, 0.1), DVec3::new(-0.7, 0.9, 0.4)];
    agree(&ball_box(), DVec3::new(-3.0, 0.7, 2.0), &aims, [6, 5, 7]);
}

#[test]
fn a_camera_inside_the_box() {
    agree(&ball_box(), DVec3::new(0.2, 0.1, -0.3), &[DVec3::new(5.0, 1.0, 1.0), DVec3::new(0.2, 0.1, 9.0)], [6, 5, 7]);
}

#[test]
fn device_coordinates() {
    let aims = [DVec3::new(0.3, -0.2, 4.0), DVec3::new(-1.2, 0.9, 3.0)];
    agree(&ahead(), DVec3::new(0.05, 0.1, 0.02), &aims, [6, 7, 5]);
}

#[test]
fn contracted_space() {
    let aims = [DVec3::new(0.3, -0.2, 0.1), DVec3::new(-0.7, 2.9, 0.4), DVec3::new(-9.0, 0.9, 4.0)];
    agree(&ball_in_the_open(), DVec3::new(-3.0, 0.7, 2.0), &aims, [6, 5, 7]);
}

/// The axes of the largest coordinate beyond the inner box, in their order along a ray.
fn dominant_axes(path: &RayPath) -> Vec<usize> {
    let RayPath::Contracted { origin, direction } = path else { panic!("a contracted ray") };
    let mut axes = Vec::new();
    for i in 0..20_000 {
        let t = f64::from(i) * 1e-3;
        let x: [f64; 3] = std::array::from_fn(|k| (origin[k] + t * direction[k]).abs());
        let axis = (0..3).max_by(|a, b| x[*a].total_cmp(&x[*b])).expect("three");
        if x[axis] > 1.0 && axes.last() != Some(&axis) {
            axes.push(axis);
        }
    }
    axes
}

#[test]
fn contracted_rays_that_turn_a_corner() {
    let frame = ball_in_the_open();
    for (origin, aim) in [
        // x, y and z are largest in turn, without ever meeting the inner box.
        (DVec3::new(-6.0, 2.0, 1.0), DVec3::new(-1.0, 5.0, 4.0)),
        // Through the box, in by x, out by z.
        (DVec3::new(-4.0, 0.2, 0.9), DVec3::new(0.2, 0.1, 2.0)),
        // Along a side of the contracted cube: the largest coordinate hardly changes.
        (DVec3::new(-3.0, -2.9, 2.2), DVec3::new(-3.01, 1.0, 2.5)),
    ] {
        let path = frame.path(origin, (aim - origin).normalize());
        let axes = dominant_axes(&path);
        assert!(axes.len() > 1, "{origin}: the largest coordinate is {axes:?} all along");
        agree(&frame, origin, &[aim, aim + DVec3::new(0.0, 0.3, 0.1)], [6, 5, 7]);
    }
}

#[test]
fn an_appearance_code() {
    let grid: Grid<f64> = random_grid([6, 5, 7], 0.8, -4.5..-1.5, 11);
    let rays = rays(&ball_in_the_open(), DVec3::new(-3.0, 0.7, 2.0), &[DVec3::new(0.3, -0.2, 0.1)]);
    let look = random_appearance(9);
    let mut patch = Patch::default();
    patch.begin(rays[0].1);
    let gathered = gather(&grid, &mut patch, &rays[0].0, OFFSET, Thresholds::EXACT, &mut Vec::new());
    let f = features(&gathered, &rays[0].1);
    let shade = look.shade(&f);
    let mut found = [0.0f64; CODE];
    Appearance::add_code_gradient(std::array::from_fn(|c| 2.0 * (shade[c] - TARGET[c])), &f, &mut found);
    // A power of two, so that the code's f32 takes the step exactly.
    let h = 2.0f32.powi(-12);
    for k in 0..CODE {
        let at = |step: f32| {
            let mut code = look.code().to_vec();
            code[k] += step;
            let taken = code[k] - look.code()[k];
            (loss(&grid, &rays, &Appearance::from_code(code).expect("finite")), f64::from(taken))
        };
        let ((up, a), (down, b)) = (at(h), at(-h));
        let expected = (up - down) / (a - b);
        assert!((found[k] - expected).abs() < 1e-3 * expected.abs() + 1e-6, "{k}: {} for {expected}", found[k]);
    }
    assert!(found.iter().filter(|v| v.abs() > 1e-4).count() > FEATURES, "most numbers matter to this pixel");
}

#[test]
fn faint_vertices_left_to_chance_keep_the_mean() {
    let grid: Grid<f64> = random_grid([6, 5, 7], 0.8, -4.5..-1.5, 11);
    let rays = rays(&ball_box(), DVec3::new(-3.0, 0.7, 2.0), &[DVec3::new(0.3, -0.2, 0.1), DVec3::new(-0.7, 0.9, 0.4)]);
    let look = random_appearance(3);
    let exact = gradient(&grid, &rays, &look, Roulette::NONE);
    let mut numbers = Numbers(1);
    let draws = 4000;
    let (mut sum, mut differed) = (vec![0.0; exact.len()], false);
    for _ in 0..draws {
        let state = (numbers.share() * 2f64.powi(53)) as u64;
        let drawn = gradient(&grid, &rays, &look, Roulette { below: 0.05, state });
        differed |= drawn != exact;
        sum.iter_mut().zip(drawn).for_each(|(s, v)| *s += v);
    }
    assert!(differed, "some vertices are faint");
    let size = exact.iter().map(|v| v * v).sum::<f64>().sqrt();
    let off = exact.iter().zip(sum).map(|(a, b)| (a - b / f64::from(draws)).powi(2)).sum::<f64>().sqrt();
    // The spread of one draw is below the gradient's size: 4000 leave a sixtieth of it.
    assert!(off < 0.03 * size, "{off} of {size}");
}

#[test]
fn extreme_rays_have_finite_gradients() {
    let mut numbers = Numbers(1);
    for raw in [-1e8, -50.0, 0.0, 50.0, 1e4, 1e8] {
        let mut grid: Grid<f32> = random_grid([6, 5, 7], 1.0, 0.0..1.0, 2);
        grid.set_raw_rows(&vec![raw as f32; grid.rows() - 1]);
        grid.refresh_occupancy(0.0);
        let d = DVec3::new(1.0, numbers.within(-0.2, 0.2), -0.5).normalize();
        for frame in [ball_box(), ball_in_the_open()] {
            let path = frame.path(DVec3::new(-3.0, 0.1, 1.0), d);
            let basis = basis([d.x as f32, d.y as f32, d.z as f32]);
            let (mut tape, mut patch) = (Vec::new(), Patch::default());
            patch.begin(basis);
            let gathered = gather(&grid, &mut patch, &path, 0.5, Thresholds::SHOWN, &mut tape);
            if raw >= 50.0 {
                assert_eq!(gathered.end, 0.0, "raw density {raw} lets nothing through");
            }
            if raw <= -50.0 {
                assert_eq!(gathered.end, 1.0, "raw density {raw} stops nothing");
            }
            let slope = random_appearance(4).pull([1.0f32, -2.0, 0.5], &basis);
            push_back(&mut patch, &tape, gathered.end, &slope, 0.1);
            let mut debts = Debts::default();
            assert!(patch.settle(&mut Roulette::default(), &mut debts), "raw density {raw}");
            for debt in &debts.owed {
                let numbers = debt.light.iter().chain([&debt.raw, &debt.max_weight]);
                assert!(numbers.copied().all(f32::is_finite), "raw density {raw}: {debt:?}");
            }
        }
    }
}

#[test]
fn rays_of_one_tile_add_up() {
    let grid: Grid<f64> = random_grid([6, 5, 7], 0.8, -4.5..-1.5, 11);
    let aims = [DVec3::new(0.3, -0.2, 0.1), DVec3::new(0.35, -0.2, 0.1), DVec3::new(0.3, -0.1, 0.12)];
    let rays = rays(&ball_in_the_open(), DVec3::new(-3.0, 0.7, 2.0), &aims);
    let basis = rays[0].1;
    let look = random_appearance(3);
    // Each ray by itself, all seen along one direction, against the three in one patch.
    let alone: Vec<Ray> = rays.iter().map(|(path, _)| (*path, basis)).collect();
    let expected = gradient(&grid, &alone, &look, Roulette::NONE);
    let (mut tape, mut patch, mut debts) = (Vec::new(), Patch::default(), Debts::default());
    patch.begin(basis);
    for (path, _) in &rays {
        let gathered = gather(&grid, &mut patch, path, OFFSET, Thresholds::EXACT, &mut tape);
        let shade = look.shade(&features(&gathered, &basis));
        let slope: Gathered<f64> = look.pull(std::array::from_fn(|c| 2.0 * (shade[c] - TARGET[c])), &basis);
        push_back(&mut patch, &tape, gathered.end, &slope, DISTORTION);
    }
    assert!(patch.settle(&mut Roulette::default(), &mut debts), "finite gradients");
    assert_eq!(debts.bases.len(), 1);
    let mut rows: Vec<u32> = debts.owed.iter().map(|d| d.row).collect();
    let met = rows.len();
    rows.sort_unstable();
    rows.dedup();
    assert_eq!(rows.len(), met, "every row once");
    for (a, b) in by_row(&grid, &debts).iter().zip(&expected) {
        assert!((a - b).abs() < 1e-12 * (1.0 + b.abs()), "{a} for {b}");
    }
    // A gradient beyond all measure is refused.
    let huge = Gathered { near: [f64::INFINITY; 3], far: [f64::NAN; 3], ..Gathered::default() };
    push_back(&mut patch, &tape, 0.0, &huge, DISTORTION);
    assert!(!patch.settle(&mut Roulette::default(), &mut debts));
}
