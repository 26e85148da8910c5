//! One error type for everything that can be wrong with what people bring: each
//! variant names the file, the entry in it, what was expected, what was found,
//! and what to do about it.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use cairn_durable::DurableError;

use crate::cameras::fisheye::LensError;
use crate::cameras::lens::LensModel;
use crate::cameras::pose::PoseError;
use crate::shell::quoted;

/// Why a capture, a photograph or a stored scene was refused.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// The file system said no.
    #[error("cannot {operation} {}: {problem}; check that the path exists and may be accessed", path.display())]
    Io {
        /// What was tried, as a verb.
        operation: &'static str,
        /// On what.
        path: PathBuf,
        /// What the system answered. Not a `source`: the message has it already.
        problem: io::Error,
    },
    /// No camera file of a known format is there.
    #[error(
        "{} holds no capture; expected a COLMAP model (cameras, images .bin or .txt in sparse/0, sparse or the folder itself), poses_bounds.npy (LLFF), transforms.json or transforms_train.json",
        folder.display()
    )]
    NotACapture {
        /// Where it was looked for.
        folder: PathBuf,
    },
    /// Photographs without cameras: what a person has before structure from motion.
    #[error("{}", without_cameras(folder, images, *photographs))]
    NoCameras {
        /// Where a capture was looked for.
        folder: PathBuf,
        /// The folder that the photographs lie in.
        images: PathBuf,
        /// How many there are.
        photographs: usize,
    },
    /// A folder in a capture in the place of the capture: its photographs, say.
    #[error("{} holds no cameras, but {} does: import that folder", folder.display(), capture.display())]
    InCapture {
        /// Where a capture was looked for.
        folder: PathBuf,
        /// The folder above, which is one.
        capture: PathBuf,
    },
    /// A camera file, table or scene file says something that cannot be.
    #[error("{}, {entry}: expected {expected}, got {got}; {remedy}", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// The entry in it.
        entry: String,
        /// What a good file has there.
        expected: String,
        /// What this one has.
        got: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A split that would hold out all views, or none.
    #[error("hold_out (--hold-out) is {every}, expected 2 or more; leave it away to train on every photograph")]
    HoldOut {
        /// What was asked for: 0 or 1.
        every: usize,
    },
    /// A mask of another size than its photograph.
    #[error(
        "the mask {} has {} x {} pixels, its photograph {} x {}; bring masks of the photographs' size, or name their folder (--masks DIR)",
        mask.display(), got.0, got.1, photograph.0, photograph.1
    )]
    MaskSize {
        /// The mask's file.
        mask: PathBuf,
        /// The photograph's width and height, px.
        photograph: (usize, usize),
        /// The mask's width and height, px.
        got: (usize, usize),
    },
    /// A camera model that is not read.
    #[error(
        "{}, {entry}: the camera model {model} is not supported; expected {}; undistort the photographs with `colmap image_undistorter`, or convert the cameras with `colmap model_converter` and a supported model",
        file.display(), LensModel::list()
    )]
    UnsupportedCamera {
        /// The camera file.
        file: PathBuf,
        /// Which camera.
        entry: String,
        /// Its model.
        model: String,
    },
    /// A lens that does not fill its picture.
    #[error("{}, {entry}: {problem}", file.display())]
    Lens {
        /// The camera file.
        file: PathBuf,
        /// Which camera.
        entry: String,
        /// What is wrong with it. Not a `source`, as in [`CaptureError::Io`].
        problem: LensError,
    },
    /// A pose that is not one.
    #[error("{}, {entry}: {problem}", file.display())]
    Pose {
        /// The camera file.
        file: PathBuf,
        /// Which view.
        entry: String,
        /// What is wrong with it. Not a `source`, as in [`CaptureError::Io`].
        problem: PoseError,
    },
    /// A camera file names a photograph that is not there.
    #[error(
        "{}, {entry}: the photograph {} is missing; put it there, remove the entry, leave such views out (--skip-missing), or name the folder of photographs (--images DIR)",
        file.display(), photograph.display()
    )]
    PhotographMissing {
        /// The file that names it.
        file: PathBuf,
        /// The entry that names it.
        entry: String,
        /// Where it was looked for.
        photograph: PathBuf,
    },
    /// A file of none of the formats that are read, or a broken one.
    #[error(
        "{photograph} cannot be decoded as PNG, JPEG or WebP: {reason}; save it again as one of them, or leave it out"
    )]
    NotAPicture {
        /// The file, or `picture` for bytes without one.
        photograph: String,
        /// What the decoder said.
        reason: String,
    },
    /// A file that is no sound that is read here, or a broken one.
    #[error("{file} cannot be read as a WAV sound: {reason}; save it again as WAV, 16-bit PCM, or leave it out")]
    NotASound {
        /// The file, or what errors call it.
        file: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A sound that lasts longer than is allowed.
    #[error("{file} lasts {seconds:.2} s, the limit is {longest_s} s; cut it or raise the limit")]
    SoundTooLong {
        /// The file, or what errors call it.
        file: String,
        /// How long it lasts, seconds.
        seconds: f64,
        /// The most that is allowed, seconds.
        longest_s: f64,
    },
    /// Larger than the limits allow.
    #[error("{file}: {what} is {got}, the limit is {limit}; bring a smaller one or raise the limit")]
    TooLarge {
        /// The file, or `picture` for bytes without one.
        file: String,
        /// What is too large, with its unit.
        what: &'static str,
        /// The most that is allowed.
        limit: u64,
        /// What was found.
        got: u64,
    },
    /// A photograph and its camera disagree about the size in pixels.
    #[error(
        "{}: the camera is {} x {} pixels, the photograph {} x {} (another shape, not only another size); bring the photograph that the camera was computed for",
        photograph.display(), expected.0, expected.1, got.0, got.1
    )]
    SizeMismatch {
        /// The photograph.
        photograph: PathBuf,
        /// The camera's width and height, px.
        expected: (usize, usize),
        /// The photograph's, EXIF orientation applied, px.
        got: (usize, usize),
    },
    /// The table of contributors does not fit the photographs.
    #[error("{}, {entry}: {problem}; {remedy}", table.display())]
    Contributors {
        /// The table.
        table: PathBuf,
        /// The row or the photograph.
        entry: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A name that cannot be a folder's name everywhere.
    #[error(
        "the scene name {name:?} is not allowed; use 1 to 64 letters, digits, '-', '_' or '.', not starting with '.' or '-'"
    )]
    SceneName {
        /// The name.
        name: String,
    },
    /// A scene of that name is already there; it was left as it was.
    #[error("the scene {name} already exists in {} and was left as it was; choose another name, or delete it first \
             with `cairn scene delete {name}`", path.parent().unwrap_or(path).display(), name = scene_name(path))]
    SceneExists {
        /// Its folder.
        path: PathBuf,
    },
    /// A stored scene of a format that this version does not read.
    #[error("{}: the scene format version is {got}, this program reads version {expected}; use the version of Cairn that wrote it, or import the capture again", file.display())]
    UnknownVersion {
        /// The scene file.
        file: PathBuf,
        /// What this program reads.
        expected: u32,
        /// What the file says.
        got: u64,
    },
    /// A stored file is no longer what was imported.
    #[error(
        "{} was altered since the import: expected SHA-256 {expected}, got {got}; restore the file or import the capture again",
        file.display()
    )]
    Altered {
        /// The file.
        file: PathBuf,
        /// The digest at import, hexadecimal.
        expected: String,
        /// The digest now.
        got: String,
    },
    /// A view that the capture does not have.
    #[error("there is no view {view}; the capture has views 0 to {} ({views} of them)", views.saturating_sub(1))]
    NoSuchView {
        /// Index asked for.
        view: usize,
        /// Views there are.
        views: usize,
    },
    /// A picture that cannot be saved because a number in it is not finite.
    #[error("{}: the picture holds {got} at column {x}, row {y}, which is not a colour; find the step that made it", path.display())]
    NotFinite {
        /// Where it was to be saved.
        path: PathBuf,
        /// Column, from 0.
        x: usize,
        /// Row, from 0.
        y: usize,
        /// The value.
        got: f32,
    },
}

impl From<DurableError> for CaptureError {
    fn from(error: DurableError) -> Self {
        match error {
            DurableError::Io { operation, path, cause } => Self::Io { operation, path, problem: cause },
            DurableError::TooLarge { path, limit, got } => Self::TooLarge {
                file: path.display().to_string(),
                what: "file size in bytes",
                limit,
                got: got.unwrap_or(limit.saturating_add(1)),
            },
            DurableError::Locked { ref path, .. } => {
                Self::Io { operation: "lock", path: path.clone(), problem: error.into() }
            }
        }
    }
}

/// The name of the scene in the folder `path`.
fn scene_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// What helps where there are photographs and no cameras.
fn without_cameras(folder: &Path, images: &Path, photographs: usize) -> String {
    let shown = |path: &Path| quoted(&path.display().to_string());
    let (database, sparse) = (shown(&folder.join("database.db")), shown(&folder.join("sparse")));
    format!(
        "{} holds {photographs} photographs and no cameras; COLMAP works out where each was taken (https://colmap.github.io):\n  \
         colmap feature_extractor --image_path {images} --database_path {database} --SiftExtraction.use_gpu 0\n  \
         colmap exhaustive_matcher --database_path {database} --SiftMatching.use_gpu 0\n  \
         mkdir -p {sparse} && colmap mapper --image_path {images} --database_path {database} --output_path {sparse}\n\
         (from COLMAP 3.13 on write --FeatureExtraction.use_gpu and --FeatureMatching.use_gpu; leave both out where there \
         is a graphics card and a display); then import the same folder again",
        folder.display(),
        images = shown(images),
    )
}

impl CaptureError {
    /// Wraps what the file system said.
    pub(crate) fn io(operation: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |problem| Self::Io { operation, path, problem }
    }

    /// A file that says something impossible; `remedy` is for the person who brought it.
    pub(crate) fn malformed(
        file: &Path,
        entry: impl Into<String>,
        expected: impl Into<String>,
        got: impl Into<String>,
        remedy: &'static str,
    ) -> Self {
        Self::Malformed {
            file: file.to_path_buf(),
            entry: entry.into(),
            expected: expected.into(),
            got: got.into(),
            remedy,
        }
    }
}
