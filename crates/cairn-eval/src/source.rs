//! A capture as the suites read it: at full size, or smaller and fewer views
//! for trying out.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_field::{NamedView, SceneFrame};
use cairn_scene::{Camera, Capture, Limits, Picture, ReadOptions, SceneKind, decode_picture};
use serde::{Deserialize, Serialize};

/// Where a capture lies and how much of it is taken.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Source {
    /// Its folder.
    pub folder: PathBuf,
    /// Pictures are made smaller where a side is longer, px; `None` leaves them.
    pub longest_side_px: Option<usize>,
    /// At most so many views of each split, evenly; `None` takes all.
    pub max_views: Option<usize>,
}

/// A capture whose cameras were read; photographs are decoded when asked for.
pub struct Opened {
    capture: Capture,
    source: Source,
}

impl Source {
    /// Reads the cameras. Every 8th view in order of name is held out where the
    /// capture brings no split of its own.
    ///
    /// # Errors
    /// Those of [`Capture::read`].
    pub fn open(&self) -> anyhow::Result<Opened> {
        let contributors = Some(self.folder.join("contributors.csv")).filter(|table| table.is_file());
        let capture =
            Capture::read(&self.folder, &ReadOptions { contributors, hold_out: Some(8), ..ReadOptions::default() })?;
        Ok(Opened { capture, source: self.clone() })
    }
}

/// A view with its photograph, at the size it is used at.
pub struct SizedView {
    /// Its name.
    pub name: String,
    /// Its camera.
    pub camera: Camera,
    /// Its photograph.
    pub picture: Picture,
}

impl SizedView {
    /// As stage 1 learns from it.
    pub fn named(&self) -> NamedView {
        NamedView::new(self.name.clone(), self.camera, &self.picture)
    }
}

impl Opened {
    /// How the scene lies around its cameras.
    pub fn kind(&self) -> SceneKind {
        self.capture.kind
    }

    /// What transparent photographs were composited on.
    pub fn background(&self) -> Option<[f32; 3]> {
        self.capture.background
    }

    /// The frame that the field's grid fills.
    ///
    /// # Errors
    /// For a capture that has none.
    pub fn frame(&self) -> anyhow::Result<SceneFrame> {
        Ok(SceneFrame::from_capture(&self.capture)?)
    }

    /// Indices of the views to train on.
    pub fn training(&self) -> Vec<usize> {
        self.some(self.capture.training())
    }

    /// Indices of the views to score on.
    pub fn held_out(&self) -> Vec<usize> {
        self.some(self.capture.held_out())
    }

    /// Cameras of the views to score on.
    pub fn held_out_cameras(&self) -> Vec<Camera> {
        self.held_out().into_iter().map(|index| self.camera(index)).collect()
    }

    /// A view's name.
    pub fn name(&self, index: usize) -> &str {
        &self.capture.views[index].name
    }

    /// Who took a view, as the capture's `contributors.csv` says; `unknown` without one.
    pub fn contributor(&self, index: usize) -> &str {
        &self.capture.views[index].contributor
    }

    /// A view's camera, at the size it is used at.
    pub fn camera(&self, index: usize) -> Camera {
        let camera = self.capture.views[index].camera;
        let (w, h) = self.size(index);
        if (w, h) == (camera.intrinsics.width, camera.intrinsics.height) { camera } else { camera.resized(w, h) }
    }

    /// A view with its photograph, at the size it is used at.
    ///
    /// # Errors
    /// For a photograph that does not decode.
    pub fn view(&self, index: usize) -> anyhow::Result<SizedView> {
        let picture = self.sized(index, self.capture.photograph(index)?);
        Ok(SizedView { name: self.capture.views[index].name.clone(), camera: self.camera(index), picture })
    }

    /// The pixels of a view that belong to the subject, row-major; `None` where the
    /// capture has no folder `masks`.
    ///
    /// # Errors
    /// For a view whose mask is missing or does not decode.
    pub fn mask(&self, index: usize) -> anyhow::Result<Option<Vec<bool>>> {
        let folder = self.source.folder.join("masks");
        if !folder.is_dir() {
            return Ok(None);
        }
        let name = Path::new(&self.capture.views[index].name).with_extension("png");
        let path = folder.join(name.file_name().unwrap_or_default());
        let bytes = crate::file::read(&path).with_context(|| {
            format!("view {} has no mask, and others have; add it or move masks away", self.capture.views[index].name)
        })?;
        let mask = decode_picture(&bytes, &Limits::default(), None)
            .with_context(|| format!("the mask {} does not decode", path.display()))?;
        let (w, h) = self.size(index);
        let mask = mask.resized(w, h);
        Ok(Some(mask.rgb().chunks_exact(3).map(|pixel| pixel[0] > 0.5).collect()))
    }

    fn some(&self, indices: impl Iterator<Item = usize>) -> Vec<usize> {
        let all: Vec<usize> = indices.collect();
        let most = self.source.max_views.unwrap_or(all.len()).min(all.len());
        (0..most).map(|k| all[k * all.len() / most]).collect()
    }

    fn size(&self, index: usize) -> (usize, usize) {
        let i = &self.capture.views[index].camera.intrinsics;
        let longest = i.width.max(i.height);
        match self.source.longest_side_px.filter(|most| *most < longest) {
            None => (i.width, i.height),
            Some(most) => {
                let side = |v: usize| ((v * most) as f64 / longest as f64).round().max(1.0) as usize;
                (side(i.width), side(i.height))
            }
        }
    }

    fn sized(&self, index: usize, picture: Picture) -> Picture {
        let (w, h) = self.size(index);
        if (w, h) == (picture.width(), picture.height()) { picture } else { picture.resized(w, h) }
    }
}
