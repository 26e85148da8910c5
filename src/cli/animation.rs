//! Pictures that move: a GIF, frame by frame.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_scene::Picture;
use tempfile::NamedTempFile;

use super::files::make_folder_of;

/// How thoroughly a GIF frame's colours are chosen, 1 (best) to 30.
const GIF_SPEED: i32 = 10;

/// A GIF being written beside its name, which it gets when it is whole. Dropped before, it leaves nothing.
pub struct Gif {
    path: PathBuf,
    file: NamedTempFile,
    encoder: gif::Encoder<BufWriter<File>>,
    /// Pixels across and down.
    width: usize,
    height: usize,
    /// Hundredths of a second a frame.
    delay_cs: u16,
}

impl Gif {
    /// Begins the GIF at `path`, of frames of `width` x `height` px, so many a second.
    ///
    /// # Errors
    /// For a side that a GIF cannot have, and the file system's.
    pub fn begin(path: &Path, width: usize, height: usize, fps: u16) -> anyhow::Result<Self> {
        let max = usize::from(u16::MAX);
        anyhow::ensure!(
            width.max(height) <= max,
            "{}: {width} x {height} px; a GIF holds {max} px a side at most",
            path.display()
        );
        let cannot = || format!("cannot write {}", path.display());
        make_folder_of(path)?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let file =
            tempfile::Builder::new().prefix(".cairn-").suffix(".part").tempfile_in(folder).with_context(cannot)?;
        let out = BufWriter::new(file.reopen().with_context(cannot)?);
        let mut encoder = gif::Encoder::new(out, width as u16, height as u16, &[]).with_context(cannot)?;
        encoder.set_repeat(gif::Repeat::Infinite).with_context(cannot)?;
        let delay_cs = (100.0 / f64::from(fps)).round() as u16;
        Ok(Self { path: path.to_path_buf(), file, encoder, width, height, delay_cs })
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// For one of another size, and the file system's.
    pub fn add(&mut self, picture: &Picture) -> anyhow::Result<()> {
        let (width, height) = (picture.width(), picture.height());
        anyhow::ensure!(
            (width, height) == (self.width, self.height),
            "a frame of {width} x {height} px among those of {} x {}",
            self.width,
            self.height
        );
        let mut frame = gif::Frame::from_rgb_speed(width as u16, height as u16, &picture.to_rgb8(), GIF_SPEED);
        frame.delay = self.delay_cs;
        self.encoder.write_frame(&frame).with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Ends the file and gives it its name; the frames' width and height, px.
    ///
    /// # Errors
    /// The file system's.
    pub fn finish(self) -> anyhow::Result<(usize, usize)> {
        let cannot = || format!("cannot write {}", self.path.display());
        let out = self.encoder.into_inner().with_context(cannot)?;
        out.into_inner().map_err(std::io::IntoInnerError::into_error).with_context(cannot)?;
        // Temporary files are their owner's alone; what is asked for is as other new files are.
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let as_usual = std::fs::Permissions::from_mode(0o644);
            self.file.as_file().set_permissions(as_usual).with_context(cannot)?;
        }
        self.file.persist(&self.path).map(drop).with_context(cannot)?;
        Ok((self.width, self.height))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(i: usize) -> Picture {
        Picture::constant(5, 4, [i as f32 / 3.0, 0.5, 1.0])
    }

    #[test]
    fn a_gif_comes_back_with_its_frames() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let mut gif = Gif::begin(&path, 5, 4, 20).unwrap();
        assert!(!path.exists(), "nothing under its name before it is whole");
        (0..3).for_each(|i| gif.add(&frame(i)).unwrap());
        assert!(gif.add(&Picture::constant(4, 4, [0.0; 3])).unwrap_err().to_string().contains("4 x 4 px"));
        assert_eq!(gif.finish().unwrap(), (5, 4));
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut read = options.read_info(File::open(&path).unwrap()).unwrap();
        for i in 0..3 {
            let got = read.read_next_frame().unwrap().unwrap();
            assert_eq!((got.delay, got.width, got.height), (5, 5, 4));
            assert!(got.buffer[0].abs_diff(frame(i).to_rgb8()[0]) < 4, "frame {i}");
        }
        assert!(read.read_next_frame().unwrap().is_none());
    }

    #[test]
    fn what_is_cut_off_leaves_nothing_and_what_was_there_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        std::fs::write(&path, "before").unwrap();
        let mut gif = Gif::begin(&path, 5, 4, 20).unwrap();
        gif.add(&frame(0)).unwrap();
        drop(gif);
        assert_eq!(std::fs::read(&path).unwrap(), b"before");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
