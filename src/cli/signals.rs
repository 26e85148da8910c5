//! The folder of `cairn train --signals`: which files are one identity's, in which order, and what is sent of them.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1;
use cairn_scene::{Ground, ImageFormat, Limits, decode_emblem, encode_png};

use super::files::read;

/// Pictures in larger files are made smaller before they are sent, bytes.
const SENT_AS_IT_IS: usize = 256 << 10;
/// To as many rows and columns, px: the most that a detector has (`mark.detector.size`).
const SENT_PX: usize = 512;
/// Largest file of a picture that is made smaller, bytes.
const MAX_PICTURE_BYTES: u64 = 1 << 30;

/// The folder's files as signals, each by the name that its files share but for the endings: those that differ in
/// their endings alone are one identity's. In natural order of the names, 2 before 10.
///
/// # Errors
/// For a file that cannot be read or made smaller, one that is empty, two of a kind under one name, and a folder
/// with nothing to hide; each names the file.
pub fn signals(folder: &Path) -> anyhow::Result<Vec<v1::Signal>> {
    let list = std::fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))?;
    let mut paths = list.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<PathBuf>>>()?;
    paths.sort();
    let mut signals: Vec<v1::Signal> = Vec::new();
    for path in paths.iter().filter(|path| !is_hidden(path)) {
        let Some(ending) = ending(path) else { continue };
        let name = path.file_stem().unwrap_or_default();
        let name = name.to_str().with_context(|| format!("{}: a name that is no UTF-8; rename it", path.display()))?;
        let at = signals.iter().position(|signal| signal.name == name).unwrap_or_else(|| {
            signals.push(v1::Signal { name: name.to_owned(), ..v1::Signal::default() });
            signals.len() - 1
        });
        let signal = &mut signals[at];
        let taken = match ending {
            Ending::Sound => {
                let bytes = read(path)?;
                anyhow::ensure!(!bytes.is_empty(), "{} is empty; bring a sound, or take it out", path.display());
                std::mem::replace(&mut signal.audio, bytes.into()).len()
            }
            Ending::Text => std::mem::replace(&mut signal.text, text(path)?).len(),
            Ending::Picture => std::mem::replace(&mut signal.picture, picture(path)?.into()).len(),
        };
        anyhow::ensure!(taken == 0, "{}: a second of its kind under that name; rename one of them", path.display());
    }
    anyhow::ensure!(
        !signals.is_empty(),
        "{} holds no picture ({}), WAV or TXT to hide",
        folder.display(),
        ImageFormat::names()
    );
    signals.sort_by(|a, b| natural(&a.name, &b.name));
    Ok(signals)
}

/// Refuses signals that do not go into one message of `most` bytes, naming the largest.
///
/// # Errors
/// As said.
pub fn fit_one_message(signals: &[v1::Signal], most: usize) -> anyhow::Result<()> {
    let size = |s: &v1::Signal| s.picture.len() + s.audio.len() + s.text.len() + s.name.len();
    let all: usize = signals.iter().map(size).sum();
    // Settings and the rest of the request take less than the difference.
    let room = most - (most / 4).min(256 << 10);
    let Some(largest) = signals.iter().max_by_key(|s| size(s)).filter(|_| all > room) else { return Ok(()) };
    let mb = |bytes: usize| bytes as f64 / 1e6;
    anyhow::bail!(
        "the signals take {:.1} MB, {:?} {:.1} MB of them, and all go in one message of {:.1} MB at most \
         (limits.max_message_bytes): bring sounds as mono, 16 kHz, 16 bits, or have the limit raised on both sides",
        mb(all),
        largest.name,
        mb(size(largest)),
        mb(room)
    )
}

#[derive(Clone, Copy)]
enum Ending {
    Picture,
    Sound,
    Text,
}

/// What kind of file it is; `None` for what nobody can hide.
fn ending(path: &Path) -> Option<Ending> {
    if ImageFormat::of_path(path).is_some() {
        return Some(Ending::Picture);
    }
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "wav" => Some(Ending::Sound),
        "txt" => Some(Ending::Text),
        _ => None,
    }
}

/// Whether it is a file that systems leave beside people's own, as macOS's `._logo.png`.
fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
}

/// A text without what editors put around it: a byte order mark before it and ends of lines behind.
fn text(path: &Path) -> anyhow::Result<String> {
    let text =
        String::from_utf8(read(path)?).with_context(|| format!("{} is no UTF-8; save it as such", path.display()))?;
    let text = text.trim_start_matches('\u{feff}').trim_end_matches(['\r', '\n']);
    anyhow::ensure!(!text.is_empty(), "{} holds no text to hide; write some into it, or take it out", path.display());
    Ok(text.to_owned())
}

/// A picture's bytes, of a large file's those of a smaller picture: a detector draws no finer one, and all signals travel in
/// one message.
fn picture(path: &Path) -> anyhow::Result<Vec<u8>> {
    let bytes = read(path)?;
    anyhow::ensure!(!bytes.is_empty(), "{} is empty; bring a picture, or take it out", path.display());
    if bytes.len() <= SENT_AS_IT_IS {
        return Ok(bytes);
    }
    let limits = Limits { max_file_bytes: MAX_PICTURE_BYTES, ..Limits::default() };
    let (small, ground) =
        decode_emblem(&bytes, &limits, SENT_PX).with_context(|| format!("{} cannot be hidden", path.display()))?;
    match ground {
        Ground::None => {}
        Ground::White => eprintln!("{} is transparent in places and is hidden on white", path.display()),
        Ground::Black => eprintln!(
            "{} is transparent in places and is hidden on black, since too little of it would show on white",
            path.display()
        ),
    }
    Ok(encode_png(&small))
}

/// The order in which people count: runs of digits by their number, all else by its characters.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    loop {
        let (x, y) = match (run(&mut left), run(&mut right)) {
            (None, None) => return a.cmp(b),
            (None, Some(_)) => return Ordering::Less,
            (Some(_), None) => return Ordering::Greater,
            (Some(x), Some(y)) => (x, y),
        };
        let is_number = |run: &str| run.starts_with(|c: char| c.is_ascii_digit());
        let order = if is_number(x) && is_number(y) {
            // Without zeros in front, the longer number is the larger one, however long.
            let [x, y] = [x, y].map(|run| run.trim_start_matches('0'));
            x.len().cmp(&y.len()).then(x.cmp(y))
        } else {
            x.cmp(y)
        };
        if order != Ordering::Equal {
            return order;
        }
    }
}

/// Takes the digits that `rest` begins with, or what stands before the next ones.
fn run<'a>(rest: &mut &'a str) -> Option<&'a str> {
    let is_digit = rest.chars().next()?.is_ascii_digit();
    let end = rest.find(|c: char| c.is_ascii_digit() != is_digit).unwrap_or(rest.len());
    let (run, after) = rest.split_at(end);
    *rest = after;
    Some(run)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_scene::{Picture, decode_picture};

    /// A folder with these files.
    fn folder(files: &[(&str, &[u8])]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, bytes)| std::fs::write(dir.path().join(name), bytes).unwrap());
        dir
    }

    fn read_of(files: &[(&str, &[u8])]) -> anyhow::Result<Vec<v1::Signal>> {
        signals(folder(files).path())
    }

    #[test]
    fn signals_come_in_the_order_in_which_people_count() {
        let files =
            ["10.txt", "2.txt", "1.txt", "b10a.txt", "b9z.txt", "B.txt", "02.txt"].map(|name| (name, &b"t"[..]));
        let names: Vec<String> = read_of(&files).unwrap().into_iter().map(|s| s.name).collect();
        assert_eq!(names, ["1", "02", "2", "10", "B", "b9z", "b10a"]);
        assert_eq!(natural("view_99999999999999999999998", "view_99999999999999999999999"), Ordering::Less);
    }

    #[test]
    fn files_of_one_name_are_one_identitys_and_what_systems_leave_is_nobodys() {
        let files: &[(&str, &[u8])] = &[
            ("ada.png", b"p"),
            ("ada.txt", "\u{feff}© Éva\r\n\n".as_bytes()),
            ("._ada.png", b"rubbish"),
            (".hidden.txt", b"rubbish"),
            ("Thumbs.db", b"rubbish"),
            ("anchor-view_1.jpg.WAV", b"w"),
        ];
        let [ada, anchor] = &read_of(files).unwrap()[..] else { panic!("two have something to hide") };
        assert_eq!((ada.name.as_str(), ada.text.as_str(), &ada.picture[..]), ("ada", "© Éva", &b"p"[..]));
        assert_eq!((anchor.name.as_str(), &anchor.audio[..]), ("anchor-view_1.jpg", &b"w"[..]));
    }

    #[test]
    fn what_holds_nothing_is_refused_by_its_file() {
        let says = |files: &[(&str, &[u8])], expected: &[&str]| {
            let error = format!("{:#}", read_of(files).unwrap_err());
            assert!(expected.iter().all(|part| error.contains(part)), "{error}");
        };
        for empty in [&b""[..], b"\n", "\u{feff}\r\n".as_bytes()] {
            says(&[("a.png", b"p"), ("a.txt", empty)], &["a.txt", "holds no text"]);
        }
        says(&[("a.wav", b"")], &["a.wav", "empty"]);
        says(&[("b.jpeg", b"")], &["b.jpeg", "empty"]);
        says(&[("a.png", b"p"), ("a.jpg", b"p")], &["a.png", "second of its kind"]);
        says(&[("a.png", b"p"), ("a.WebP", b"p")], &["a.png", "second of its kind"]);
        says(&[("a.txt", b"\xff")], &["a.txt", "UTF-8"]);
        says(&[("notes.md", b"x")], &["holds no picture (PNG, JPEG or WebP)"]);
    }

    #[test]
    fn a_large_picture_is_sent_as_small_as_it_is_hidden() {
        let mut state = 7u32;
        let noise = (0..1200 * 700 * 3).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as f32 / 255.0
        });
        let noise = Picture::new(1200, 700, noise.collect()).unwrap();
        let file = encode_png(&noise);
        let sent = read_of(&[("a.png", &file)]).unwrap().remove(0).picture;
        assert!(sent.len() < 1 << 20 && file.len() > 2 << 20, "{} of {} bytes", sent.len(), file.len());
        let (hidden, _) = decode_emblem(&sent, &Limits::default(), 128).unwrap();
        let (whole, _) = decode_emblem(&file, &Limits::default(), 128).unwrap();
        let apart = hidden.rgb().iter().zip(whole.rgb()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart <= 1.01 / 255.0, "{apart} from what the file itself would have given");
        // A small file goes as it is, whatever it holds.
        let small = encode_png(&Picture::constant(40, 40, [0.5; 3]));
        assert_eq!(read_of(&[("a.png", &small)]).unwrap()[0].picture, small);
        assert!(decode_picture(&small, &Limits::default(), None).is_ok());
    }

    #[test]
    fn more_than_a_message_holds_is_refused_by_name_before_it_is_sent() {
        let sound =
            |name: &str, bytes| v1::Signal { name: name.into(), audio: vec![1; bytes].into(), ..Default::default() };
        let signals = [sound("ada", 3 << 20), sound("carol", 5 << 20)];
        fit_one_message(&signals, 32 << 20).unwrap();
        let error = fit_one_message(&signals, 8 << 20).unwrap_err().to_string();
        assert!(["8.4 MB", "\"carol\" 5.2 MB", "max_message_bytes"].iter().all(|part| error.contains(part)), "{error}");
    }
}
