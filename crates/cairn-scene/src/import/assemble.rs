//! From what a camera file states to a checked [`Capture`]: the part that every
//! format shares, so that no format can forget a check.

use std::collections::HashSet;
use std::path::Path;

use crate::cameras::camera::Camera;
use crate::cameras::facing;
use crate::cameras::intrinsics::{Intrinsics, check_intrinsics};
use crate::capture::{Capture, LeftOut, SceneKind, UNKNOWN_CONTRIBUTOR, View};
use crate::error::CaptureError;
use crate::images::format::ImageFormat;
use crate::images::photograph::{self, Header, WHITE};
use crate::import::contributors::{self, Contributor};
use crate::import::model::{Entry, Guess, ImageFolder, Model, check_count};
use crate::import::options::ReadOptions;
use crate::import::{masks, named};
use crate::unused::{Standing, Unused, UnusedPhotographs, without_share};

/// How many photographs are decoded to see whether they are transparent.
const LOOKED_AT: usize = 5;

/// How many folders deep photographs are looked for. Rigs and dates make two or three; what is deeper than this is some
/// other tree, and a walk through all of it would take long.
const DEEPEST: usize = 8;

/// How many of the photographs something is true of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Share {
    None,
    Some,
    All,
}

/// Checks `model` against its photographs and makes the capture of it.
///
/// # Errors
/// For no or too many views, a name used twice, an impossible camera, a
/// photograph that is missing or of another shape, and a wrong contributor table.
pub(crate) fn assemble(root: &Path, mut model: Model, options: &ReadOptions) -> Result<Capture, CaptureError> {
    check_entries(&mut model, options)?;
    leave_out_missing(root, &mut model, options)?;
    model.left_out.without_camera = without_camera(root, &model, options);
    let headers = headers(root, &model, options)?;
    let contributors = match &options.contributors {
        None => vec![Contributor { name: UNKNOWN_CONTRIBUTOR.to_owned(), key: None }; model.entries.len()],
        Some(table) => {
            let names: Vec<&str> = model.entries.iter().map(|e| e.name.as_str()).collect();
            let LeftOut { missing, without_camera, .. } = &model.left_out;
            let left_out: Vec<&str> = missing.iter().chain(without_camera).map(String::as_str).collect();
            let takers = contributors::read(table, &names, &left_out, &options.limits)?;
            model.left_out.listed = listed(&takers.of_left_out, missing.len());
            takers.of_views
        }
    };
    let held_out = held_out(&model, options)?;
    let mut views = Vec::with_capacity(model.entries.len());
    for (((entry, header), contributor), held_out) in model.entries.iter().zip(&headers).zip(contributors).zip(held_out)
    {
        let (width, height, as_stored) =
            fit(&entry.intrinsics, header, model.as_stored).ok_or_else(|| CaptureError::SizeMismatch {
                photograph: root.join(&entry.photograph),
                expected: (entry.intrinsics.width, entry.intrinsics.height),
                got: header.oriented,
            })?;
        views.push(View {
            name: entry.name.clone(),
            camera: Camera { intrinsics: entry.intrinsics.resized(width, height), pose: entry.pose },
            contributor: contributor.name,
            contributor_key: contributor.key,
            photograph: entry.photograph.clone(),
            as_stored,
            mask: None,
            support: entry.support,
            held_out,
            bounds: entry.bounds,
        });
    }
    add_masks(root, &model, options, &mut views)?;
    let transparent = transparent(root, &model, &headers, options)?;
    let kind = options.kind.unwrap_or(match model.kind {
        Guess::ForwardFacing => SceneKind::ForwardFacing,
        Guess::Bounded => SceneKind::Bounded,
        Guess::BoundedIfTransparent if transparent == Share::All => SceneKind::Bounded,
        Guess::ForwardFacingIfDeep if facing::looks_ahead(&stated_cameras(&model), &model.points) => {
            SceneKind::ForwardFacing
        }
        Guess::BoundedIfTransparent | Guess::ForwardFacingIfDeep | Guess::Unbounded => SceneKind::Unbounded,
    });
    if kind == SceneKind::ForwardFacing {
        let views = model.entries.iter().map(|e| (&e.pose, e.bounds.is_some()));
        facing::check_near(&model.file, views, &model.points)?;
    }
    let background = match (transparent, kind) {
        (Share::All, _) | (Share::Some, SceneKind::Bounded) => Some(WHITE),
        // A cut-out or two among photographs of an open scene: white is not what lies behind the others.
        (Share::Some | Share::None, _) => None,
    };
    Ok(Capture { root: root.to_path_buf(), kind, background, views, points: model.points, left_out: model.left_out })
}

/// The cameras as the file states them.
fn stated_cameras(model: &Model) -> Vec<Camera> {
    model.entries.iter().map(|e| Camera { intrinsics: e.intrinsics, pose: e.pose }).collect()
}

/// Gives the views their masks, each held to its photograph's size by its header.
fn add_masks(root: &Path, model: &Model, options: &ReadOptions, views: &mut [View]) -> Result<(), CaptureError> {
    for (view, mask) in views.iter_mut().zip(masks::find(root, model, options)?) {
        let Some(mask) = mask else { continue };
        let path = root.join(&mask);
        let photograph = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let got = photograph::header(&path, &options.limits)?.stored;
        if got != photograph {
            return Err(CaptureError::MaskSize { mask: path, photograph, got });
        }
        view.mask = Some(mask);
    }
    Ok(())
}

/// Sorts by name and refuses what no format may say.
fn check_entries(model: &mut Model, options: &ReadOptions) -> Result<(), CaptureError> {
    check_count(&model.file, model.entries.len() as u64, options.limits.max_views)?;
    model.entries.sort_by(|a, b| a.name.cmp(&b.name));
    for pair in model.entries.windows(2) {
        if pair[0].name == pair[1].name {
            let got = format!("{} of the same name", pair[0].label);
            let remedy = "remove one of the two entries";
            return Err(CaptureError::malformed(
                &model.file,
                pair[1].label.clone(),
                "a name used only once",
                got,
                remedy,
            ));
        }
    }
    model.entries.iter().try_for_each(|e| check_intrinsics(&model.file, &e.label, &e.intrinsics))
}

/// Takes the views out whose photographs are not there and notes their names. Without
/// [`ReadOptions::skip_missing`], or where none is there, the first of them is an error.
fn leave_out_missing(root: &Path, model: &mut Model, options: &ReadOptions) -> Result<(), CaptureError> {
    let is_there = |entry: &Entry| root.join(&entry.photograph).is_file();
    for entry in model.entries.iter_mut().filter(|entry| !is_there(entry)) {
        if let Some(found) = named::find(root, &entry.photograph, &[]) {
            entry.photograph = found;
        }
    }
    let (there, missing): (Vec<Entry>, Vec<Entry>) = model.entries.drain(..).partition(is_there);
    if let Some(first) = missing.first().filter(|_| there.is_empty() || !options.skip_missing) {
        let (file, entry) = (model.file.clone(), first.label.clone());
        return Err(CaptureError::PhotographMissing { file, entry, photograph: root.join(&first.photograph) });
    }
    model.entries = there;
    model.left_out.missing.extend(missing.into_iter().map(|entry| entry.name));
    Ok(())
}

/// Names of the photographs in the model's folder of them that no view shows, sorted; structure from motion leaves out
/// what it cannot place. What cannot be looked at counts for nothing.
fn without_camera(root: &Path, model: &Model, options: &ReadOptions) -> Vec<String> {
    let Some(ImageFolder { path: folder, is_in_names }) = &model.images else { return Vec::new() };
    let shown: HashSet<&Path> = model.entries.iter().map(|entry| entry.photograph.as_path()).collect();
    let mut found = Vec::new();
    // The capture's own folder has folders of other things: masks, smaller copies.
    let mut folders = vec![(folder.clone(), if folder.as_os_str().is_empty() { 1 } else { DEEPEST })];
    let most = options.limits.max_views;
    while let Some((within, depth)) = folders.pop().filter(|_| found.len() < most) {
        for entry in std::fs::read_dir(root.join(&within)).into_iter().flatten().flatten() {
            let (path, name) = (within.join(entry.file_name()), entry.file_name());
            // What macOS leaves beside files on other systems' disks (`._a.png`) is none.
            let is_hidden = name.to_string_lossy().starts_with('.');
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) && depth > 1 && !is_hidden {
                folders.push((path, depth - 1));
            } else if ImageFormat::of_path(&path).is_some() && !is_hidden && !shown.contains(path.as_path()) {
                let name = if *is_in_names { &path } else { path.strip_prefix(folder).unwrap_or(&path) };
                found.push(name.to_string_lossy().replace('\\', "/"));
            }
            if found.len() == most {
                break;
            }
        }
    }
    found.sort();
    found
}

/// Which of the photographs are transparent, as far as a few of them tell: all, some, or none.
fn transparent(root: &Path, model: &Model, headers: &[Header], options: &ReadOptions) -> Result<Share, CaptureError> {
    let with_alpha: Vec<&Entry> = model.entries.iter().zip(headers).filter(|(_, h)| h.alpha).map(|(e, _)| e).collect();
    let looked_at = with_alpha.len().min(LOOKED_AT);
    let mut through = 0;
    for i in 0..looked_at {
        // Evenly over the views, the first and the last included.
        let entry = with_alpha[i * (with_alpha.len() - 1) / (looked_at - 1).max(1)];
        through += usize::from(photograph::shows_through(&root.join(&entry.photograph), &options.limits)?);
    }
    Ok(match through {
        0 => Share::None,
        n if n == looked_at && with_alpha.len() == headers.len() => Share::All,
        _ => Share::Some,
    })
}

fn headers(root: &Path, model: &Model, options: &ReadOptions) -> Result<Vec<Header>, CaptureError> {
    model.entries.iter().map(|entry| photograph::header(&root.join(&entry.photograph), &options.limits)).collect()
}

/// Photographs that the contributor table names and no view shows, by contributor and reason; the first `missing` of
/// `takers` are of those whose files are missing.
fn listed(takers: &[Option<String>], missing: usize) -> Vec<UnusedPhotographs> {
    let why = |at| Some(if at < missing { Unused::Missing } else { Unused::NoCamera });
    let rows = takers.iter().enumerate().filter_map(|(at, taker)| Some((at, taker.as_deref()?)));
    without_share(rows.map(|(at, contributor)| Standing { contributor, why: why(at), photographs: 1 }))
}

/// Which views are held out: none unless that is asked for, then the capture's own test views, or every n-th where it
/// names none.
fn held_out(model: &Model, options: &ReadOptions) -> Result<Vec<bool>, CaptureError> {
    let Some(every) = options.hold_out else { return Ok(vec![false; model.entries.len()]) };
    let own = model.entries.iter().any(|entry| entry.held_out == Some(true));
    let is_held =
        |(i, entry): (usize, &Entry)| if own { entry.held_out == Some(true) } else { i.is_multiple_of(every) };
    let held: Vec<bool> = model.entries.iter().enumerate().map(is_held).collect();
    if held.iter().all(|&h| h) {
        let got = format!("all {} held out", held.len());
        let remedy = "leave hold_out (--hold-out) away, or bring more views";
        return Err(CaptureError::malformed(&model.file, "the split", "at least one view to train on", got, remedy));
    }
    Ok(held)
}

/// The size that the photograph and the camera agree on: the same shape to
/// within a pixel of the smaller of the two; and whether it is meant without its
/// EXIF orientation. Where the shape fits both ways, `as_stored` decides.
fn fit(camera: &Intrinsics, header: &Header, as_stored: bool) -> Option<(usize, usize, bool)> {
    let same_shape = |(w, h): (usize, usize)| {
        let (w, h, cw, ch) = (w as f64, h as f64, camera.width as f64, camera.height as f64);
        let scale = w / cw;
        (ch * scale - h).abs() <= scale.max(1.0) || (cw * h / ch - w).abs() <= (h / ch).max(1.0)
    };
    let stored = match (same_shape(header.oriented), same_shape(header.stored)) {
        (false, false) => return None,
        (true, true) => as_stored,
        (_, stored) => stored,
    };
    let (width, height) = if stored { header.stored } else { header.oriented };
    // A photograph that nothing turns is the same both ways, and need not be told apart.
    Some((width, height, stored && header.turned))
}
