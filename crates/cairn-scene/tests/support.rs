//! What COLMAP's tracks say for a photograph: how many points support it, and how well.

use std::fs;
use std::path::Path;

use crate::common::{Colmap, read, refuses};
use cairn_scene::{Capture, SceneFolder, Support};

/// Observations of each image, as numbers of points (-1 is none), and the points' errors, px.
const SEEN: [&[i64]; 3] = [&[10, -1, 30, 77], &[30, 20, 20], &[]];
const POINTS: [(u64, f64); 3] = [(30, 2.5), (10, 0.5), (20, -1.0)];
/// Point 77 does not exist; COLMAP did not work out the error of point 20.
const EXPECTED: [(u32, f64); 3] = [(2, 1.5), (3, 2.5), (0, 0.0)];

fn text(folder: &Path) {
    Colmap::small().write_text(folder);
    let images = (1..4).zip(SEEN).fold(String::new(), |text, (id, seen)| {
        let seen: Vec<String> = seen.iter().map(|point| format!("1.5 2.5 {point}")).collect();
        format!("{text}{id} 1 0 0 0 {id} 0.5 2 1 {id}.png\n{}\n", seen.join(" "))
    });
    let points = POINTS.map(|(id, error)| format!("{id} 0 0.1 1 1 2 3 {error} 1 0 2 1\n")).concat();
    fs::write(folder.join("sparse/images.txt"), images).unwrap();
    fs::write(folder.join("sparse/points3D.txt"), points).unwrap();
}

fn binary(folder: &Path) {
    Colmap::small().write_bin(folder);
    let mut images = 3u64.to_le_bytes().to_vec();
    for (id, seen) in (1u32..4).zip(SEEN) {
        images.extend(id.to_le_bytes());
        let numbers = [1.0, 0.0, 0.0, 0.0, f64::from(id), 0.5, 2.0];
        images.extend(numbers.iter().flat_map(|v: &f64| v.to_le_bytes()));
        images.extend(1u32.to_le_bytes());
        images.extend(format!("{id}.png\0").as_bytes());
        images.extend((seen.len() as u64).to_le_bytes());
        for point in seen {
            images.extend([1.5f64, 2.5].iter().flat_map(|v| v.to_le_bytes()));
            images.extend(point.to_le_bytes());
        }
    }
    let mut points = 3u64.to_le_bytes().to_vec();
    for (id, error) in POINTS {
        points.extend(id.to_le_bytes());
        points.extend([0.0f64, 0.1, 1.0].iter().flat_map(|v| v.to_le_bytes()));
        points.extend([1, 2, 3]);
        points.extend(error.to_le_bytes());
        points.extend(0u64.to_le_bytes());
    }
    fs::write(folder.join("sparse/0/images.bin"), images).unwrap();
    fs::write(folder.join("sparse/0/points3D.bin"), points).unwrap();
}

fn supports(capture: &Capture) -> Vec<Option<Support>> {
    capture.views.iter().map(|view| view.support).collect()
}

#[test]
fn tracks_of_either_kind_of_file_are_counted() {
    let expected = EXPECTED.map(|(points, reprojection_error_px)| Some(Support { points, reprojection_error_px }));
    for (write, points) in [(text as fn(&Path), "sparse/points3D.txt"), (binary, "sparse/0/points3D.bin")] {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path());
        Colmap::small().write_photographs(folder.path());
        let capture = read(folder.path()).unwrap();
        assert_eq!(supports(&capture), expected, "{points}");
        // A scene keeps it.
        let scenes = tempfile::tempdir().unwrap();
        SceneFolder::create(scenes.path(), "a", &capture).unwrap();
        assert_eq!(supports(SceneFolder::open(scenes.path(), "a").unwrap().capture()), expected);
        // Without a file of points nothing can be said.
        fs::remove_file(folder.path().join(points)).unwrap();
        assert_eq!(supports(&read(folder.path()).unwrap()), [None; 3], "{points}");
    }
}

#[test]
fn errors_and_counts_that_cannot_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    text(folder.path());
    Colmap::small().write_photographs(folder.path());
    let points = folder.path().join("sparse/points3D.txt");
    for (bad, parts) in [("30 0 0 1 1 2 3 inf 1 0\n", "finite"), ("30 0 0 1 1 2 3\n", "reprojection error")] {
        fs::write(&points, bad).unwrap();
        refuses(read(folder.path()), &["points3D.txt", parts]);
    }
    let folder = tempfile::tempdir().unwrap();
    binary(folder.path());
    Colmap::small().write_photographs(folder.path());
    let file = folder.path().join("sparse/0/images.bin");
    let mut images = fs::read(&file).unwrap();
    // The first image's count of observations, behind the number of images, 64 bytes of its own and its name.
    let at = 8 + 4 + 56 + 4 + "1.png\0".len();
    images[at..at + 8].copy_from_slice(&u64::MAX.to_le_bytes());
    fs::write(&file, images).unwrap();
    refuses(read(folder.path()), &["images.bin", "image at index 0", "before the file ends"]);
}
