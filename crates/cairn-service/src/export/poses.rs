//! Where a scene's cameras stand, drawn: a plan and a side view to one scale, once
//! coloured by contributor and, where there are clusters, once by cluster.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use cairn_scene::cluster::{Clusters, Grouping};
use cairn_scene::{Capture, SceneFolder};
use glam::DVec2;

use crate::error::EngineError;
use crate::export::drawing::{Drawing, LINE_PX, Shape, words_width};
use crate::export::layout::{Layout, PANEL};
use crate::export::words::Colour;
use crate::store::model::{IdentityInfo, ModelInfo};
use crate::train::clusters;

/// Groups with a colour of their own; the others share one.
const MAX_COLOURS: usize = 12;
/// Far apart from each other, the first ones for colour-blind readers too (Okabe and Ito's).
const COLOURS: [Colour; MAX_COLOURS] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [106, 61, 154],
    [25, 25, 25],
    [150, 85, 35],
    [150, 190, 0],
    [200, 20, 60],
    [0, 90, 70],
];
const OTHERS: Colour = [128, 128, 126];
const NO_CLUSTER: Colour = [178, 178, 172];
const PAPER: Colour = [252, 252, 250];
const INK: Colour = [30, 30, 36];
const FRAME: Colour = [190, 190, 186];
const POINT: Colour = [192, 190, 182];
/// Space around panels, px.
const GAP: f64 = 24.0;
/// Space for a panel's title, px.
const TITLE: f64 = 26.0;
/// Width of the legend, px.
const LEGEND: f64 = 430.0;
/// Height of a line of the legend, px.
const ROW: f64 = 26.0;
/// Letters of a name in the legend.
const NAME_LETTERS: usize = 22;
/// Sparse points drawn a panel.
const MAX_POINTS: usize = 5000;

/// The drawing, and what is on it.
#[derive(Clone, Debug)]
pub struct PoseSheet {
    /// To be written as a picture or as SVG.
    pub drawing: Drawing,
    /// Cameras.
    pub views: usize,
    /// Clusters shown, 0 where colours are by contributor alone.
    pub clusters: usize,
}

/// Draws the scene's cameras. Clusters are made as a training with this grouping
/// and seed would make them; without a grouping they are those of the `newest` model.
///
/// # Errors
/// [`Clusters::build`]'s.
pub fn draw_poses(
    scene: &str,
    folder: &SceneFolder,
    grouping: Option<(Grouping, u64)>,
    newest: Option<ModelInfo>,
) -> Result<PoseSheet, EngineError> {
    let capture = folder.capture();
    let clusters = match grouping {
        Some((grouping, seed)) => {
            let clusters = clusters::clusters(folder, &grouping, seed)?;
            let identities = clusters::identities(folder, &clusters);
            Some(("clusters as asked for".to_owned(), clusters, identities))
        }
        None => newest.map(|m| (format!("clusters of {}", m.job), m.clusters, m.identities)),
    };
    let mut rows = vec![Groups::by_contributor(capture)];
    if let Some((title, clusters, identities)) = &clusters {
        rows.push(Groups::by_cluster(capture, title, clusters, identities));
    }
    let shown = clusters.map_or(0, |(_, clusters, _)| clusters.clusters.len());
    let drawing = sheet(scene, capture, &rows);
    Ok(PoseSheet { drawing, views: capture.views.len(), clusters: shown })
}

/// Which group each view is in, and what the groups are called.
struct Groups {
    title: String,
    /// A group's name and its numbers of training and held-out views: clusters in order, contributors by views.
    names: Vec<(String, [usize; 2])>,
    /// By view; `None` for no group.
    of: Vec<Option<usize>>,
    /// Views to ring: anchors.
    ringed: Vec<usize>,
}

impl Groups {
    fn by_contributor(capture: &Capture) -> Self {
        let names = capture.views.iter().map(|v| Some((0, v.contributor.clone()))).collect();
        Self::new("contributors".to_owned(), capture, names, Vec::new())
    }

    fn by_cluster(capture: &Capture, title: &str, clusters: &Clusters, identities: &[IdentityInfo]) -> Self {
        let name = |number: u32| match identities.iter().find(|i| i.number == number) {
            Some(identity) => (number, format!("{number} {}", identity.label)),
            None => (number, number.to_string()),
        };
        let of = |v: &cairn_scene::View| clusters.identity_of(&v.camera.pose).identity.map(name);
        // By their poses: the views that the clusters' indices count may have changed since.
        let is_at = |pose: &cairn_scene::Pose| capture.training().find(|v| capture.views[*v].camera.pose == *pose);
        let anchors = match clusters.grouping() {
            Grouping::Anchors(_) => {
                let of = |c: &cairn_scene::cluster::Cluster| clusters.anchor_pose(c.identity).and_then(is_at);
                clusters.clusters.iter().filter_map(of).collect()
            }
            Grouping::ByContributor { .. } => Vec::new(),
        };
        Self::new(title.to_owned(), capture, capture.views.iter().map(of).collect(), anchors)
    }

    /// Groups by number and name; numbers that differ are an order, until there are
    /// more groups than colours.
    fn new(title: String, capture: &Capture, of: Vec<Option<(u32, String)>>, ringed: Vec<usize>) -> Self {
        let mut counts: BTreeMap<&(u32, String), [usize; 2]> = BTreeMap::new();
        for (group, view) in of.iter().zip(&capture.views) {
            if let Some(group) = group {
                counts.entry(group).or_default()[usize::from(view.held_out)] += 1;
            }
        }
        let mut groups: Vec<_> = counts.into_iter().collect();
        let numbered = groups.iter().any(|((number, _), _)| *number > 0);
        if !numbered || groups.len() > MAX_COLOURS {
            // Stable: equal counts stay in their order.
            groups.sort_by_key(|(_, [training, held_out])| Reverse(training + held_out));
        }
        let places: BTreeMap<_, usize> = groups.iter().enumerate().map(|(i, (group, _))| (*group, i)).collect();
        let place = |group: &Option<(u32, String)>| group.as_ref().and_then(|g| places.get(g).copied());
        let places = of.iter().map(place).collect();
        let names = groups.into_iter().map(|((_, name), counts)| (name.clone(), counts)).collect();
        Self { title, names, of: places, ringed }
    }

    fn colour(&self, view: usize) -> Colour {
        self.of[view].map_or(NO_CLUSTER, |group| COLOURS.get(group).copied().unwrap_or(OTHERS))
    }

    /// Views in the order in which they are drawn: nobody's and the others' below.
    fn order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.of.len()).collect();
        order.sort_by_key(|v| Reverse(self.of[*v].unwrap_or(usize::MAX)));
        order
    }
}

fn sheet(scene: &str, capture: &Capture, rows: &[Groups]) -> Drawing {
    let layout = Layout::new(capture);
    let row_height = TITLE + PANEL.y + GAP;
    let width = GAP * 4.0 + PANEL.x * 2.0 + LEGEND;
    let height = GAP * 2.0 + LINE_PX + row_height * rows.len() as f64;
    let mut shapes = Vec::new();
    let held_out = capture.held_out().count();
    let views = capture.views.len();
    let by = match rows.first().map_or(&[][..], |contributors| &contributors.names) {
        [(one, _)] => short(one),
        people => format!("{} contributors", people.len()),
    };
    let title = format!("{scene}: {views} views by {by}, {held_out} of them held out");
    words(&mut shapes, DVec2::new(GAP, GAP), &title, INK);
    for (i, groups) in rows.iter().enumerate() {
        let top = GAP * 2.0 + LINE_PX + row_height * i as f64;
        for (k, (side, what)) in [(1, "plan, from above"), (2, "from the side")].iter().enumerate() {
            let left = GAP + k as f64 * (PANEL.x + GAP);
            words(&mut shapes, DVec2::new(left, top), &format!("{}: {what}", groups.title), INK);
            panel(&mut shapes, capture, &layout, groups, *side, DVec2::new(left, top + TITLE));
        }
        legend(&mut shapes, groups, &layout, !capture.points.is_empty(), DVec2::new(GAP * 3.0 + PANEL.x * 2.0, top));
    }
    Drawing { width: width as usize, height: height as usize, paper: PAPER, shapes }
}

fn panel(shapes: &mut Vec<Shape>, capture: &Capture, layout: &Layout, groups: &Groups, side: usize, corner: DVec2) {
    let end = corner + PANEL;
    let corners = vec![corner, DVec2::new(end.x, corner.y), end, DVec2::new(corner.x, end.y)];
    shapes.push(Shape::Polygon { corners: corners.clone(), fill: Some(([255; 3], 1.0)), line: None });
    let every = capture.points.len().div_ceil(MAX_POINTS).max(1);
    for point in capture.points.iter().step_by(every) {
        let at = layout.place(*point, side, corner);
        if at.cmpgt(corner + 1.0).all() && at.cmplt(end - 1.0).all() {
            shapes.push(Shape::Dot { at, radius: 1.0, colour: POINT });
        }
    }
    for view in groups.order() {
        let pose = &capture.views[view].camera.pose;
        let at = layout.place(pose.position, side, corner);
        let outline = layout.camera(pose, side, at);
        if groups.ringed.contains(&view) {
            let middle = outline.iter().sum::<DVec2>() / outline.len() as f64;
            ring(shapes, middle, layout.camera_px);
        }
        shapes.push(mark(outline, groups.colour(view), capture.views[view].held_out));
    }
    shapes.push(Shape::Polygon { corners, fill: None, line: Some((FRAME, 1.0)) });
    scale_bar(shapes, layout, DVec2::new(corner.x + 16.0, end.y - 16.0));
}

fn mark(corners: Vec<DVec2>, colour: Colour, held_out: bool) -> Shape {
    let fill = if held_out { ([255; 3], 0.7) } else { (colour, 0.8) };
    let width = if held_out { 1.8 } else { 1.0 };
    Shape::Polygon { corners, fill: Some(fill), line: Some((colour, width)) }
}

fn ring(shapes: &mut Vec<Shape>, at: DVec2, camera_px: f64) {
    let around = |i: u32| (f64::from(i) * std::f64::consts::TAU / 32.0).sin_cos();
    let corners = (0..32).map(around).map(|(s, c)| at + DVec2::new(c, s) * camera_px * 1.2).collect();
    shapes.push(Shape::Polygon { corners, fill: None, line: Some((INK, 2.0)) });
}

fn scale_bar(shapes: &mut Vec<Shape>, layout: &Layout, left: DVec2) {
    let most = PANEL.x / 4.0 / layout.px_per_unit;
    let power = 10f64.powf(most.log10().floor());
    let length = [5.0, 2.0, 1.0].iter().map(|m| m * power).find(|l| *l <= most).unwrap_or(power);
    let right = left + DVec2::X * (length * layout.px_per_unit);
    for ends in [
        [left, right],
        [left - DVec2::Y * 5.0, left + DVec2::Y * 5.0],
        [right - DVec2::Y * 5.0, right + DVec2::Y * 5.0],
    ] {
        shapes.push(Shape::Line { ends, colour: INK, width: 2.0 });
    }
    let digits = (-power.log10().floor()).clamp(0.0, 9.0) as usize;
    let unit = if length == 1.0 { "unit" } else { "units" };
    words(shapes, left - DVec2::Y * (LINE_PX + 10.0), &format!("{length:.digits$} {unit}"), INK);
}

fn legend(shapes: &mut Vec<Shape>, groups: &Groups, layout: &Layout, points: bool, corner: DVec2) {
    let mut at = corner;
    words(shapes, at, "views (+ held out)", INK);
    at.y += TITLE;
    let shown = groups.names.len().min(MAX_COLOURS);
    let named = groups.names[..shown].iter().zip(COLOURS);
    let mut lines: Vec<(Colour, String, String)> =
        named.map(|((name, counts), colour)| (colour, short(name), count(*counts))).collect();
    let rest = &groups.names[shown..];
    if !rest.is_empty() {
        let sum = rest.iter().fold([0, 0], |s, (_, c)| [s[0] + c[0], s[1] + c[1]]);
        lines.push((OTHERS, format!("{} others", rest.len()), count(sum)));
    }
    let without_cluster = groups.of.iter().filter(|g| g.is_none()).count();
    if without_cluster > 0 {
        lines.push((NO_CLUSTER, "in no cluster".to_owned(), without_cluster.to_string()));
    }
    for (colour, name, count) in lines {
        entry(shapes, at, layout, colour, false, &name, &count);
        at.y += ROW;
    }
    at.y += ROW * 0.4;
    entry(shapes, at, layout, INK, false, "tip: it stands there", "");
    words(shapes, at + DVec2::new(40.0, ROW * 0.8), "broad side: it looks there", INK);
    at.y += ROW * 1.8;
    entry(shapes, at, layout, INK, true, "hollow: held out", "");
    at.y += ROW;
    if !groups.ringed.is_empty() {
        ring(shapes, at + DVec2::new(16.0, LINE_PX / 2.0), 9.0);
        words(shapes, at + DVec2::X * 40.0, "ringed: anchor", INK);
        at.y += ROW;
    }
    if points {
        for i in 0..3 {
            let dot = at + DVec2::new(8.0 + 8.0 * f64::from(i), LINE_PX / 2.0 + f64::from(i % 2) * 3.0);
            shapes.push(Shape::Dot { at: dot, radius: 1.4, colour: POINT });
        }
        words(shapes, at + DVec2::X * 40.0, "dots: sparse points", INK);
    }
}

/// A line of the legend: a camera, what it is, and a number at the right.
fn entry(shapes: &mut Vec<Shape>, at: DVec2, layout: &Layout, colour: Colour, hollow: bool, name: &str, count: &str) {
    let (size, tip) = (layout.camera_px.min(20.0), at + DVec2::new(6.0, LINE_PX / 2.0));
    let open = [DVec2::new(size, -size * 0.45), DVec2::new(size, size * 0.45)];
    shapes.push(mark(vec![tip, tip + open[0], tip + open[1]], colour, hollow));
    words(shapes, at + DVec2::X * 40.0, name, INK);
    words(shapes, at + DVec2::X * (LEGEND - words_width(count)), count, INK);
}

fn count([training, held_out]: [usize; 2]) -> String {
    if held_out > 0 { format!("{training} + {held_out}") } else { training.to_string() }
}

fn short(name: &str) -> String {
    if name.chars().count() <= NAME_LETTERS {
        return name.to_owned();
    }
    let first: String = name.chars().take(NAME_LETTERS - 2).collect();
    format!("{first}..")
}

fn words(shapes: &mut Vec<Shape>, at: DVec2, text: &str, colour: Colour) {
    shapes.push(Shape::Words { at, text: text.to_owned(), colour });
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Camera, Distortion, Intrinsics, LeftOut, Pose, SceneKind, View};
    use glam::DVec3;

    fn capture(poses: Vec<Pose>, points: Vec<DVec3>) -> Capture {
        let intrinsics =
            Intrinsics { width: 4, height: 4, fx: 4.0, fy: 4.0, cx: 2.0, cy: 2.0, distortion: Distortion::default() };
        let view = |(i, pose): (usize, Pose)| View {
            name: format!("{i:03}"),
            camera: Camera { intrinsics, pose },
            contributor: format!("person-{:02}", (i * i) % 15),
            contributor_key: None,
            photograph: "none".into(),
            as_stored: false,
            held_out: i % 8 == 0,
            mask: None,
            support: None,
            bounds: None,
        };
        let views = poses.into_iter().enumerate().map(view).collect();
        Capture {
            root: ".".into(),
            kind: SceneKind::Unbounded,
            background: None,
            views,
            points,
            left_out: LeftOut::default(),
        }
    }

    fn ring(count: i32) -> Vec<Pose> {
        let at = |i: i32| {
            let (s, c) = (f64::from(i) * 0.3).sin_cos();
            Pose::look_at(DVec3::new(9.0 * c, 6.0 * s, 1.0), DVec3::ZERO, DVec3::Z).unwrap()
        };
        (0..count).map(at).collect()
    }

    fn finite(drawing: &Drawing) -> bool {
        !drawing.svg().contains("NaN") && !drawing.svg().contains("inf")
    }

    #[test]
    fn every_camera_is_drawn_within_its_panel_and_looks_inwards() {
        let points = (0..400).map(f64::from).map(|i| DVec3::new(i.sin(), i.cos(), (i * 0.3).sin())).collect();
        let capture = capture(ring(40), points);
        let groups = Groups::by_contributor(&capture);
        let layout = Layout::new(&capture);
        assert!((layout.axes[2] - DVec3::Z).length() < 1e-9 && layout.axes[0].x.abs() > 0.99, "{:?}", layout.axes);
        assert!((layout.axes[0].cross(layout.axes[1]) - layout.axes[2]).length() < 1e-9, "seen from above, not below");
        for side in [1, 2] {
            for view in &capture.views {
                let at = layout.place(view.camera.pose.position, side, DVec2::ZERO);
                assert!(at.cmpgt(DVec2::ZERO).all() && at.cmplt(PANEL).all(), "{at}");
                let outline = layout.camera(&view.camera.pose, side, at);
                let middle = outline.iter().sum::<DVec2>() / outline.len() as f64;
                // Seen head-on, the tip lies within.
                assert!((3..=5).contains(&outline.len()) && (side == 2 || outline.contains(&at)), "{outline:?}");
                let area: f64 =
                    (0..outline.len()).map(|i| (outline[i] - at).perp_dot(outline[(i + 1) % outline.len()] - at)).sum();
                assert!(area.abs() > 1.0, "a camera of no width: {outline:?}");
                assert!(layout.along(-view.camera.pose.position, side).dot(middle - at) > 0.0);
            }
        }
        let drawing = sheet("town", &capture, &[groups]);
        let cameras = |s: &&Shape| matches!(s, Shape::Polygon { fill: Some(_), line: Some(_), .. });
        // A view in each of two panels, and the legend: its groups, a whole one and a hollow one.
        let groups = Groups::by_contributor(&capture).names.len().min(MAX_COLOURS + 1);
        assert_eq!(drawing.shapes.iter().filter(cameras).count(), 2 * 40 + groups + 2);
        assert!(finite(&drawing));
    }

    #[test]
    fn the_most_frequent_have_colours_and_the_rest_are_others() {
        let names = |i: usize| Some((0, format!("p{:02}", i.min(19))));
        let capture = capture(ring(30), Vec::new());
        let groups = Groups::new("t".into(), &capture, (0..30).map(names).collect(), Vec::new());
        assert_eq!((groups.names.len(), groups.names[0].0.as_str()), (20, "p19"));
        assert_eq!(groups.names[0].1.iter().sum::<usize>(), 11);
        assert_eq!((groups.colour(25), groups.colour(0), groups.colour(15)), (COLOURS[0], COLOURS[1], OTHERS));
        let svg = sheet("town", &capture, &[groups]).svg();
        assert!(svg.contains("8 others") && svg.contains("p19"));
    }

    #[test]
    fn cameras_that_stand_together_or_look_everywhere_are_drawn_all_the_same() {
        let together = vec![Pose::look_at(DVec3::ONE, DVec3::ZERO, DVec3::Z).unwrap(); 3];
        let down = (0..4).map(|i| f64::from(i).sin_cos());
        let down = down.map(|(s, c)| Pose::look_at(DVec3::Z * 4.0, DVec3::ZERO, DVec3::new(s, c, 0.0)).unwrap());
        let far_off = (0..200).map(|i| DVec3::splat(1e6 * f64::from(i))).collect();
        for capture in [capture(together, Vec::new()), capture(down.collect(), Vec::new()), capture(ring(5), far_off)] {
            assert!(finite(&sheet("t", &capture, &[Groups::by_contributor(&capture)])));
        }
    }
}
