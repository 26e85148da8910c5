//! Animated files that people can open: GIF, and APNG where 256 colours are too
//! few. Frames are written as they come, beside the file's final name, which it
//! gets when it is whole: what is cut off leaves nothing broken.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_scene::Picture;
use tempfile::NamedTempFile;

/// How thoroughly a GIF frame's colours are chosen, 1 (best) to 30.
const GIF_SPEED: i32 = 10;

/// The kinds of animated files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 256 colours a frame; opens everywhere.
    Gif,
    /// Animated PNG: every pixel as it was rendered; opens in browsers.
    Apng,
}

impl Kind {
    /// By the file's ending.
    ///
    /// # Errors
    /// For any ending but `.gif`, `.png` and `.apng`.
    pub fn of(path: &Path) -> anyhow::Result<Self> {
        match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("gif") => Ok(Self::Gif),
            Some("png" | "apng") => Ok(Self::Apng),
            _ => anyhow::bail!("{}: an animation ends in .gif or .png (an animated PNG)", path.display()),
        }
    }
}

enum Encoder {
    Gif(gif::Encoder<BufWriter<File>>),
    Apng(png::Writer<BufWriter<File>>),
}

/// An animated file being written. Dropped before [`Animation::finish`], it leaves nothing.
pub struct Animation {
    path: PathBuf,
    file: NamedTempFile,
    encoder: Encoder,
    /// Pixels across and down.
    size: (usize, usize),
    /// Frames that are still to come.
    missing: usize,
    /// Hundredths of a second a frame.
    delay_cs: u16,
}

impl Animation {
    /// Begins the file at `path`: `frames` frames of `width` x `height` px, `fps`
    /// a second (1 to 50; a GIF counts in hundredths of a second), over and over.
    ///
    /// # Errors
    /// [`Kind::of`]'s, a size that the format does not hold, the file system's.
    pub fn begin(path: &Path, (width, height): (usize, usize), frames: usize, fps: u16) -> anyhow::Result<Self> {
        let kind = Kind::of(path)?;
        let most = if kind == Kind::Gif { usize::from(u16::MAX) } else { i32::MAX as usize };
        anyhow::ensure!(
            width.max(height) <= most,
            "{}: {width} x {height} px; its format holds {most} px a side at most",
            path.display()
        );
        let cannot = || format!("cannot write {}", path.display());
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let file =
            tempfile::Builder::new().prefix(".cairn-").suffix(".part").tempfile_in(folder).with_context(cannot)?;
        let out = BufWriter::new(file.reopen().with_context(cannot)?);
        let encoder = match kind {
            Kind::Gif => {
                let mut encoder = gif::Encoder::new(out, width as u16, height as u16, &[]).with_context(cannot)?;
                encoder.set_repeat(gif::Repeat::Infinite).with_context(cannot)?;
                Encoder::Gif(encoder)
            }
            Kind::Apng => {
                let mut encoder = png::Encoder::new(out, width as u32, height as u32);
                encoder.set_color(png::ColorType::Rgb);
                encoder.set_depth(png::BitDepth::Eight);
                encoder.set_animated(frames as u32, 0).with_context(cannot)?;
                encoder.set_frame_delay(1, fps).with_context(cannot)?;
                Encoder::Apng(encoder.write_header().with_context(cannot)?)
            }
        };
        let delay_cs = (100.0 / f64::from(fps)).round() as u16;
        Ok(Self { path: path.to_path_buf(), file, encoder, size: (width, height), missing: frames, delay_cs })
    }

    /// Adds the next frame.
    ///
    /// # Errors
    /// For a frame of another size or one too many, and the file system's.
    pub fn add(&mut self, frame: &Picture) -> anyhow::Result<()> {
        let (width, height) = self.size;
        let got = (frame.width(), frame.height());
        anyhow::ensure!(got == self.size, "a frame of {} x {} px among those of {width} x {height}", got.0, got.1);
        let left = self.missing.checked_sub(1);
        self.missing = left.with_context(|| format!("{}: a frame too many", self.path.display()))?;
        let cannot = || format!("cannot write {}", self.path.display());
        match &mut self.encoder {
            Encoder::Gif(encoder) => {
                let mut frame = gif::Frame::from_rgb_speed(width as u16, height as u16, &frame.to_rgb8(), GIF_SPEED);
                frame.delay = self.delay_cs;
                encoder.write_frame(&frame).with_context(cannot)
            }
            Encoder::Apng(writer) => writer.write_image_data(&frame.to_rgb8()).with_context(cannot),
        }
    }

    /// Ends the file and gives it its name, over what was there before.
    ///
    /// # Errors
    /// For frames that are missing, and the file system's.
    pub fn finish(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.missing == 0, "{}: {} frames are missing", self.path.display(), self.missing);
        let cannot = || format!("cannot write {}", self.path.display());
        match self.encoder {
            Encoder::Gif(encoder) => {
                let out = encoder.into_inner().with_context(cannot)?;
                out.into_inner().map_err(std::io::IntoInnerError::into_error).with_context(cannot)?;
            }
            Encoder::Apng(writer) => writer.finish().with_context(cannot)?,
        }
        place(self.file, &self.path)
    }
}

/// Writes `bytes` to `path` whole or not at all.
///
/// # Errors
/// The file system's.
pub fn write_whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    use std::io::Write as _;
    let cannot = || format!("cannot write {}", path.display());
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file =
        tempfile::Builder::new().prefix(".cairn-").suffix(".part").tempfile_in(folder).with_context(cannot)?;
    file.write_all(bytes).with_context(cannot)?;
    place(file, path)
}

/// Gives a temporary file its name.
fn place(file: NamedTempFile, path: &Path) -> anyhow::Result<()> {
    // Temporary files are their owner's alone; what is asked for is as other new files are.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let as_usual = std::fs::Permissions::from_mode(0o644);
        file.as_file().set_permissions(as_usual).with_context(|| format!("cannot write {}", path.display()))?;
    }
    file.persist(path).map(drop).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(i: usize) -> Picture {
        Picture::constant(5, 4, [i as f32 / 3.0, 0.5, 1.0])
    }

    #[test]
    fn both_kinds_come_back_with_their_frames() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.gif", "a.PNG"] {
            let path = folder.path().join(name);
            let mut animation = Animation::begin(&path, (5, 4), 3, 20).unwrap();
            assert!(!path.exists(), "nothing under its name before it is whole");
            (0..3).for_each(|i| animation.add(&frame(i)).unwrap());
            assert!(animation.add(&Picture::constant(4, 4, [0.0; 3])).unwrap_err().to_string().contains("4 x 4 px"));
            animation.finish().unwrap();
        }
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut read = options.read_info(File::open(folder.path().join("a.gif")).unwrap()).unwrap();
        for i in 0..3 {
            let got = read.read_next_frame().unwrap().unwrap();
            assert_eq!((got.delay, got.width, got.height), (5, 5, 4));
            assert!(got.buffer[0].abs_diff(frame(i).to_rgb8()[0]) < 4, "frame {i}");
        }
        assert!(read.read_next_frame().unwrap().is_none());
        let file = std::io::BufReader::new(File::open(folder.path().join("a.PNG")).unwrap());
        let mut read = png::Decoder::new(file).read_info().unwrap();
        assert_eq!(read.info().animation_control().unwrap().num_frames, 3);
        for i in 0..3 {
            let mut bytes = vec![0; read.output_buffer_size().unwrap()];
            read.next_frame(&mut bytes).unwrap();
            assert_eq!(bytes, frame(i).to_rgb8(), "frame {i}");
        }
    }

    #[test]
    fn what_is_cut_off_leaves_nothing_and_what_was_there_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        std::fs::write(&path, "before").unwrap();
        let mut animation = Animation::begin(&path, (5, 4), 3, 20).unwrap();
        animation.add(&frame(0)).unwrap();
        drop(animation);
        assert_eq!(std::fs::read(&path).unwrap(), b"before");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        // What lacks frames is not whole.
        let mut short = Animation::begin(&folder.path().join("b.png"), (5, 4), 3, 20).unwrap();
        short.add(&frame(0)).unwrap();
        assert!(short.finish().is_err());
        assert!(!folder.path().join("b.png").exists());
        assert!(Kind::of(Path::new("c.mp4")).unwrap_err().to_string().contains(".gif or .png"));
    }
}
