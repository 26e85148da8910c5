//! What is worth saying about a capture that was read, and is no reason to refuse it.

use std::path::Path;

use crate::capture::Capture;

/// Folders that hold one capture's photographs in several sizes.
const SIZES: [&str; 4] = ["images", "images_2", "images_4", "images_8"];
/// How many views a note names.
const NAMED: usize = 5;

impl Capture {
    /// Notes for who brought this capture, a sentence or two each: which folder of
    /// photographs was taken where there are several, and which views' lenses fold
    /// within the frame.
    pub fn notes(&self) -> Vec<String> {
        self.folder_note().into_iter().chain(self.lens_note()).collect()
    }

    fn folder_note(&self) -> Option<String> {
        let taken = self.views.first()?.photograph.components().next()?;
        let taken = SIZES.into_iter().find(|&name| Path::new(name).components().next() == Some(taken))?;
        let others: Vec<&str> =
            SIZES.into_iter().filter(|&name| name != taken && self.root.join(name).is_dir()).collect();
        let list = others.join(", ");
        (!others.is_empty()).then(|| format!("photographs are those in {taken}; there is {list}, too (--images DIR)"))
    }

    fn lens_note(&self) -> Option<String> {
        let folding: Vec<&str> =
            self.views.iter().filter(|v| v.camera.intrinsics.folds()).map(|v| v.name.as_str()).collect();
        let rest = match folding.len().saturating_sub(NAMED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let views = folding.get(..NAMED).unwrap_or(&folding).join(", ");
        (!folding.is_empty()).then(|| {
            format!(
                "the lens distortion of {views}{rest} folds within the frame: towards the corners its rays turn back, and what is seen \
                 there is placed wrongly; calibrate with fewer coefficients, or undistort the photographs (`colmap image_undistorter`)"
            )
        })
    }
}
