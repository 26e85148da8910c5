//! Hostile uploads: every reader of contributors' files is fed mutations of good files and noise, and bombs made by hand.
//! None may panic, nor allocate more than a stated multiple of what it was given.

mod common;
mod targets;

use std::fs;
use std::io::Write as _;

use cairn_scene::{Capture, CaptureError, ReadOptions, SoundLimits, decode_picture, decode_wav};
use cairn_testkit::{Counting, Limit, attack_with, cases, peak_of};
use common::{Chunk, Colmap, photograph, read, refuses, riff_webp, webp};
use targets::{TARGETS, Target, jpeg, limits, target, webps};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A case reads a whole capture from the disk, which costs a millisecond: fewer of them in a run of the tests.
fn try_one(name: &str) {
    let Target { name, good, limit: (times, plus), read } = *target(name);
    let good = good();
    let good: Vec<&[u8]> = good.iter().map(Vec::as_slice).collect();
    attack_with(name, &good, cases() / 6, |length| Limit { times, plus }.of(length), read);
}

/// One test a target, so that they run side by side and are named when they fail.
macro_rules! attacked {
    ($($test:ident: $name:literal),* $(,)?) => {
        $(#[test]
        fn $test() {
            try_one($name);
        })*

        #[test]
        fn no_target_is_left_out() {
            let tried = [$($name),*];
            assert_eq!(TARGETS.map(|target| target.name), tried);
        }
    };
}

attacked! {
    colmap_binary_cameras: "cameras.bin",
    colmap_binary_images: "images.bin",
    colmap_binary_points: "points3D.bin",
    colmap_text_cameras: "cameras.txt",
    colmap_text_images: "images.txt",
    colmap_text_points: "points3D.txt",
    transforms: "transforms.json",
    llff_poses: "poses_bounds.npy",
    contributor_tables: "contributors.csv",
    png_pictures: "png",
    jpeg_pictures: "jpeg",
    webp_pictures: "webp",
    wav_sounds: "wav",
}

/// What the good files are, their readers take: else the attacks would try one half of them only.
#[test]
fn good_files_are_taken() {
    let folder = Colmap::small().folder();
    assert!(read(folder.path()).is_ok());
    for (name, file) in [("transforms.json", "transforms.json"), ("poses_bounds.npy", "poses_bounds.npy")] {
        for good in (target(name).good)() {
            let folder = tempfile::tempdir().unwrap();
            let photographs =
                if name == "transforms.json" { folder.path().into() } else { folder.path().join("images") };
            fs::create_dir_all(&photographs).unwrap();
            for number in 1..4 {
                fs::write(photographs.join(format!("{number}.png")), photograph()).unwrap();
            }
            fs::write(folder.path().join(file), good).unwrap();
            read(folder.path()).unwrap();
        }
    }
    for sound in (target("wav").good)() {
        decode_wav("a", &sound, &SoundLimits { max_file_bytes: 1 << 20, longest_s: 1.0 }).unwrap();
    }
    for picture in webps().into_iter().chain([photograph(), jpeg()]) {
        decode_picture(&picture, &limits(), None).unwrap();
    }
}

/// The CRC-32 of PNG chunks (PNG specification, annex D), bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xedb8_8320 } else { c >> 1 })
    })
}

fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let named = [kind, data].concat();
    [&(data.len() as u32).to_be_bytes(), named.as_slice(), &crc(&named).to_be_bytes()].concat()
}

/// `photograph()` with its header's size changed, and `more` chunks behind the header.
fn png_with(size: Option<(u32, u32)>, more: &[u8]) -> Vec<u8> {
    let mut png = photograph();
    if let Some((width, height)) = size {
        png[16..20].copy_from_slice(&width.to_be_bytes());
        png[20..24].copy_from_slice(&height.to_be_bytes());
    }
    let header = chunk(b"IHDR", &png[16..29]);
    [&png[..8], &header, more, &png[33..]].concat()
}

#[test]
fn monstrous_dimensions_cost_nothing() {
    let sides = [u32::MAX >> 1, 1 << 30, 65_536, 201];
    for (width, height) in sides.into_iter().flat_map(|side| [(side, side), (side, 1), (1, side)]) {
        let png = png_with(Some((width, height)), &[]);
        let (decoded, peak) = peak_of(|| decode_picture(&png, &limits(), None));
        assert!(decoded.is_err(), "{width} x {height}");
        assert!(peak < 1 << 20, "{peak} bytes for a PNG that claims {width} x {height}");
    }
    let good = jpeg();
    // Start of frame: marker, length, precision, then height and width.
    let frame = good.windows(2).position(|two| two == [0xff, 0xc0]).unwrap() + 5;
    for (height, width) in [(u16::MAX, u16::MAX), (u16::MAX, 1), (1, u16::MAX), (0, 0), (101, 100)] {
        let mut jpeg = good.clone();
        jpeg[frame..frame + 2].copy_from_slice(&height.to_be_bytes());
        jpeg[frame + 2..frame + 4].copy_from_slice(&width.to_be_bytes());
        let (decoded, peak) = peak_of(|| decode_picture(&jpeg, &limits(), None));
        assert!(decoded.is_err(), "{width} x {height}");
        assert!(peak < 1 << 20, "{peak} bytes for a JPEG that claims {width} x {height}");
    }
}

/// The header of a lossless frame of this size: a signature, then 14 bits each of what is one less.
fn lossless_head(width: u32, height: u32) -> Vec<u8> {
    [&[0x2f][..], &((width - 1) | (height - 1) << 14).to_le_bytes()].concat()
}

/// The header of a lossy key frame of this size.
fn lossy_head(width: u16, height: u16) -> Vec<u8> {
    [&[0x10, 0, 0, 0x9d, 1, 0x2a][..], &width.to_le_bytes(), &height.to_le_bytes()].concat()
}

/// An extended header of this canvas, px, with these flags.
fn extended(flags: u8, width: u32, height: u32) -> Vec<u8> {
    [&[flags, 0, 0, 0][..], &(width - 1).to_le_bytes()[..3], &(height - 1).to_le_bytes()[..3]].concat()
}

/// Each is refused by name, from memory and from the disk, and costs nothing.
fn webp_is_refused(file: &[u8], says: &str) {
    let (decoded, peak) = peak_of(|| decode_picture(file, &limits(), None));
    refuses(decoded, &["picture cannot be decoded as PNG, JPEG or WebP", says, "save it again"]);
    assert!(peak < 64 << 10, "{says}: {peak} bytes for a file of {}", file.len());
    let folder = Colmap::small().folder();
    fs::write(folder.path().join("images/2.png"), file).unwrap();
    refuses(read(folder.path()), &["2.png", says]);
}

#[test]
fn what_a_webp_says_of_itself_is_held_to_the_file() {
    webp_is_refused(&webp("animation"), "it is an animation, and one frame of it has to be chosen");
    let (head, lossless) = (lossless_head(40, 30), [lossless_head(40, 30), vec![0; 40]].concat());
    let file = |chunks: &[(&[u8; 4], &[u8])]| {
        riff_webp(&chunks.iter().map(|&(name, data)| Chunk { name, data }).collect::<Vec<_>>())
    };
    // Frames without the flag that says so are an animation, too.
    let still = extended(0, 40, 30);
    webp_is_refused(&file(&[(b"VP8X", &still), (b"VP8L", &lossless), (b"ANMF", &[0; 32])]), "it is an animation");
    // A small canvas around a frame of as many pixels as the format has.
    let wide = lossy_head(16_383, 16_383);
    let says = "it says that it has 40 x 30 pixels, and its frame has 16383 x 16383";
    webp_is_refused(&file(&[(b"VP8X", &still), (b"VP8 ", &wide)]), says);
    let says = "its frame has 16384 x 16384";
    webp_is_refused(&file(&[(b"VP8X", &still), (b"VP8L", &lossless_head(16_384, 16_384))]), says);
    // Chunks that say more bytes than are there: the decoder would take memory for all of them.
    for (name, flags) in [(b"EXIF", 8), (b"ICCP", 32), (b"XMP ", 4), (b"ALPH", 16), (b"none", 0)] {
        let mut cut = file(&[(b"VP8X", &extended(flags, 40, 30)), (b"VP8L", &lossless), (name, &[0; 8])]);
        let at = cut.len() - 12;
        cut[at..at + 4].copy_from_slice(&(u32::MAX - 1).to_le_bytes());
        let name = std::str::from_utf8(name).unwrap();
        webp_is_refused(&cut, &format!("its chunk {name} says 4294967294 bytes, and 8 are left"));
    }
    let whole = webp("lossless");
    for length in [whole.len() - 2, 100, 30, 12] {
        webp_is_refused(&whole[..length], &format!("says {} bytes, and it has {length}", whole.len()));
    }
    webp_is_refused(&[&whole[..], b"<script>"].concat(), &format!("and it has {}", whole.len() + 8));
    webp_is_refused(&file(&[(b"VP8X", &[0; 30]), (b"VP8L", &head)]), "its extended header is not 10 bytes");
    webp_is_refused(&file(&[(b"VP8X", &still), (b"VP8X", &still)]), "its extended header is not 10 bytes");
    webp_is_refused(&file(&[]), "");
}

#[test]
fn monstrous_dimensions_of_a_webp_cost_nothing() {
    let frames = |side: u32| {
        let (lossless, lossy) = (lossless_head(side, side), lossy_head(side.min(16_383) as u16, 1));
        let canvas = extended(0, side, side);
        let image = Chunk { name: b"VP8L", data: &lossless };
        let simple = riff_webp(&[Chunk { name: b"VP8 ", data: &lossy }]);
        [riff_webp(&[Chunk { name: b"VP8X", data: &canvas }, image]), simple]
    };
    for file in [16_384, 4000, 201].map(frames).concat() {
        let (decoded, peak) = peak_of(|| decode_picture(&file, &limits(), None));
        refuses(decoded, &["longest side in pixels", "limit is 200"]);
        assert!(peak < 64 << 10, "{peak} bytes for a file of {}", file.len());
    }
    // A canvas that no frame has.
    let canvas = extended(0, 1 << 24, 1);
    let file = riff_webp(&[Chunk { name: b"VP8X", data: &canvas }, Chunk { name: b"none", data: b"" }]);
    let (decoded, peak) = peak_of(|| decode_picture(&file, &limits(), None));
    assert!(decoded.is_err() && peak < 64 << 10, "{peak} bytes");
}

/// Bits of a lossless WebP, the first the lowest of the first byte.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    used: usize,
}

impl Bits {
    /// Adds `count` bits of `value`, from the lowest.
    fn put(&mut self, value: u32, count: usize) {
        for bit in (0..count).map(|i| (value >> i & 1) as u8) {
            if self.used.is_multiple_of(8) {
                self.bytes.push(0);
            }
            *self.bytes.last_mut().unwrap() |= bit << (self.used % 8);
            self.used += 1;
        }
    }

    /// A code with one symbol, which takes no bits where it is used.
    fn one_symbol(&mut self, symbol: u32) {
        self.put(0b101, 3);
        self.put(symbol, 8);
    }

    /// A code whose symbols 0, 1, ... have these lengths, 1 to 15 bits (RFC 9649, section 3.7.2.1.2).
    fn code(&mut self, lengths: &[u32]) {
        // 19 lengths of lengths, of which the order begins with 17, 18, 0: sixteen codes of four bits, for 0 to 15.
        self.put(0, 1);
        self.put(15, 4);
        self.put(0, 3);
        self.put(0, 3);
        self.put(4, 3);
        (1..=5).for_each(|_| self.put(4, 3));
        self.put(0, 3);
        (6..=15).for_each(|_| self.put(4, 3));
        // As many symbols as there are, and no more: in six bits, two less.
        self.put(1, 1);
        self.put(2, 3);
        self.put(lengths.len() as u32 - 2, 6);
        // A canonical code is written from its highest bit.
        lengths.iter().for_each(|length| self.put(length.reverse_bits() >> 28, 4));
    }
}

/// A lossless WebP of one pixel whose pixels choose between `groups` groups of codes, each of five codes of `lengths`.
fn with_groups(groups: u32, lengths: &[u32]) -> Vec<u8> {
    let mut bits = Bits::default();
    // No transform, no cache of colours; an image of groups with blocks of 4 px.
    bits.put(0, 2);
    bits.put(1, 1);
    bits.put(0, 3);
    // It has no cache, and one pixel: red and green say the last group.
    bits.put(0, 1);
    [(groups - 1) & 0xff, (groups - 1) >> 8, 0, 0, 0].into_iter().for_each(|symbol| bits.one_symbol(symbol));
    (0..groups * 5).for_each(|_| bits.code(lengths));
    bits.put(0, 32);
    riff_webp(&[Chunk { name: b"VP8L", data: &[lossless_head(1, 1), bits.bytes].concat() }])
}

/// Codes take several hundred times their length in memory: a picture of one pixel may not have a megabyte of them.
#[test]
fn codes_of_a_lossless_webp_take_what_its_size_allows() {
    let lengths: Vec<u32> = (1..=10).chain([10]).collect();
    let few = with_groups(700, &lengths);
    let (decoded, peak) = peak_of(|| decode_picture(&few, &limits(), None));
    assert!(decoded.is_ok(), "{decoded:?}");
    assert!(peak < 320 * few.len() && peak < 24 << 20, "{peak} bytes for a file of {}", few.len());
    let (refused, peak) = peak_of(|| decode_picture(&with_groups(2000, &lengths), &limits(), None));
    refuses(refused, &["its chunk VP8L has", "65540 at most are read"]);
    assert!(peak < 1 << 20, "{peak} bytes");
}

/// Twice as many codes as there are bits for: the decoder's own check of that overflows, and it stops.
#[test]
fn codes_that_are_none_are_refused() {
    let twice: Vec<u32> = [1, 1].into_iter().chain(1..=15).chain([15]).collect();
    refuses(decode_picture(&with_groups(1, &twice), &limits(), None), &["picture cannot be decoded"]);
}

/// `length` zeros compressed by zlib, some thousandth of that: made by the encoder of PNG's own pixels.
fn compressed_zeros(length: u32) -> Vec<u8> {
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, length / 1024, 1024);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_compression(png::Compression::High);
    encoder.set_filter(png::Filter::NoFilter);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&vec![0; length as usize]).unwrap();
    writer.finish().unwrap();
    let (mut at, mut stream) = (8, Vec::new());
    while at < png.len() {
        let length = u32::from_be_bytes(png[at..at + 4].try_into().unwrap()) as usize;
        if &png[at + 4..at + 8] == b"IDAT" {
            stream.extend_from_slice(&png[at + 8..at + 8 + length]);
        }
        at += 12 + length;
    }
    stream
}

/// Text and colour profiles lie compressed before the pixels, and are met when only the size is asked for.
#[test]
fn compressed_chunks_do_not_unpack_without_bound() {
    let bomb = compressed_zeros(200 << 20);
    assert!(bomb.len() < 1 << 20, "{} bytes", bomb.len());
    let profile = chunk(b"iCCP", &[b"profile\0\0", bomb.as_slice()].concat());
    let text = chunk(b"zTXt", &[b"Comment\0\0", bomb.as_slice()].concat());
    let xmp = chunk(b"iTXt", &[b"XML:com.adobe.xmp\0\x01\0\0\0", bomb.as_slice()].concat());
    for (name, chunk) in [("iCCP", profile), ("zTXt", text), ("iTXt", xmp)] {
        let png = png_with(None, &chunk);
        let (_, peak) = peak_of(|| drop(decode_picture(&png, &limits(), None)));
        assert!(peak < 64 << 20, "{name}: {peak} bytes for a picture of {}", png.len());
        let folder = Colmap::small().folder();
        fs::write(folder.path().join("images/2.png"), &png).unwrap();
        let (_, peak) = peak_of(|| drop(read(folder.path())));
        assert!(peak < 64 << 20, "{name}: {peak} bytes for the header of a picture of {}", png.len());
    }
}

fn peak_of_reading(folder: &std::path::Path) -> (Result<Capture, CaptureError>, usize) {
    peak_of(|| Capture::read(folder, &ReadOptions::default()))
}

/// Everything in `transforms.json` that nobody asked for, or asked for once, is dropped as it is read.
#[test]
fn lists_in_transforms_are_not_built_before_they_are_counted() {
    let zeros = format!("[{}0]", "0,".repeat(2_000_000));
    let empties = format!("[{}[]]", "[],".repeat(1_000_000));
    let frame = |matrix: &str| format!(r#"{{"file_path":"1.png","transform_matrix":{matrix}}}"#);
    for (json, says) in [
        (format!(r#"{{"fl_x":1,"frames":[],"unknown":{zeros}}}"#), "at least one view"),
        (format!(r#"{{"fl_x":1,"frames":{zeros}}}"#), "number of views is 2000001"),
        (format!(r#"{{"fl_x":1,"frames":[{}]}}"#, frame(&empties)), "4 x 4 transform_matrix"),
        (
            format!(r#"{{"fl_x":1,"frames":[{}]}}"#, frame(&format!("[{zeros},{zeros},{zeros}]"))),
            "4 x 4 transform_matrix",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("1.png"), photograph()).unwrap();
        fs::write(folder.path().join("transforms.json"), &json).unwrap();
        let (result, peak) = peak_of_reading(folder.path());
        refuses(result, &[says]);
        assert!(peak < json.len() + (4 << 20), "{says}: {peak} bytes for a file of {}", json.len());
    }
}

/// A COLMAP file without line ends is not taken into memory whole, nor are a camera's parameters without number.
#[test]
fn endless_lines_are_refused_on_the_way() {
    for (file, start) in
        [("cameras.txt", "1 PINHOLE 64 48 "), ("images.txt", "1 1 0 0 0 0 0 0 1 "), ("points3D.txt", "")]
    {
        let folder = tempfile::tempdir().unwrap();
        Colmap::small().write_text(folder.path());
        Colmap::small().write_photographs(folder.path());
        let mut out = fs::File::create(folder.path().join("sparse").join(file)).unwrap();
        out.write_all(start.as_bytes()).unwrap();
        for _ in 0..100 {
            out.write_all("1 ".repeat(1 << 19).as_bytes()).unwrap();
        }
        let (result, peak) = peak_of_reading(folder.path());
        refuses(result, &[file, "line 1", "at most 16 MiB"]);
        assert!(peak < 64 << 20, "{file}: {peak} bytes");
    }
    let folder = tempfile::tempdir().unwrap();
    Colmap::small().write_text(folder.path());
    let cameras = format!("1 PINHOLE 64 48 {}", "1 ".repeat(1 << 20));
    fs::write(folder.path().join("sparse/cameras.txt"), &cameras).unwrap();
    let (result, peak) = peak_of_reading(folder.path());
    refuses(result, &["camera 1", "4 parameters of PINHOLE"]);
    assert!(peak < 4 * cameras.len(), "{peak} bytes for a line of {}", cameras.len());
}
