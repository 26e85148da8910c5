//! What is brought, made ready or refused, and whose it is.

use cairn_scene::{Picture, Sound, encode_png, encode_wav};

use super::*;
use crate::store::hidden::{keep, kept};

fn limits() -> Limits {
    Limits::default()
}

fn given(name: &str) -> Given {
    Given { name: name.into(), parts: Parts { text: Some(b"a".to_vec()), ..Parts::default() } }
}

fn of(parts: Parts<Vec<u8>>) -> Given {
    Given { name: "credit".into(), parts }
}

fn tone(level: f32, rate: u32) -> Sound {
    Sound::new((0..rate).map(|i| (i as f32 * 0.05).sin() * level).collect(), rate).unwrap()
}

/// Identities with these labels, from number 1.
fn added(labels: &[&str]) -> Vec<Added> {
    let identity = |(number, label): (usize, &&str)| Added {
        called: format!("identity {number} ({label})"),
        number,
        label: (*label).to_owned(),
    };
    (1..).zip(labels).map(identity).collect()
}

#[test]
fn what_is_given_is_made_ready_or_refused_by_name() {
    let mark = Recipe::default();
    let recorded = tone(0.5, 44_100);
    let parts = Parts { audio: Some(encode_wav(&recorded)), text: Some("a".into()), picture: None };
    let (signal, notes) = of(parts).signal(1, &mark, &limits()).unwrap();
    let sound = signal.audio.unwrap();
    assert_eq!((sound.sample_rate_hz(), sound.samples().len()), (16_000, 16_000));
    assert_eq!(notes, Vec::<String>::new());
    let says = |parts: Parts<Vec<u8>>, expected: &[&str]| {
        let error = of(parts).signal(2, &mark, &limits()).unwrap_err().to_string();
        assert!(error.contains("identity 2") && expected.iter().all(|part| error.contains(part)), "{error}");
    };
    says(Parts { text: Some(vec![b'a', 0xff]), ..Parts::default() }, &["credit", "byte 1", "UTF-8"]);
    says(Parts::default(), &["nothing to hide"]);
    let long = Sound::new(vec![0.1; 5 * 8000], 8000).unwrap();
    says(Parts { audio: Some(encode_wav(&long)), ..Parts::default() }, &["credit", "5.00 s", "4 s"]);
    says(Parts { audio: Some(b"RIFF".to_vec()), ..Parts::default() }, &["credit", "WAV"]);
    says(Parts { picture: Some(b"GIF89a".to_vec()), ..Parts::default() }, &["picture", "credit", "PNG, JPEG or WebP"]);
    let black = encode_png(&Picture::constant(40, 40, [0.0; 3]));
    says(Parts { picture: Some(black), ..Parts::default() }, &["one colour", "0, 0, 0"]);
    // What 16 bits round to nothing is silence before anything is trained, not after.
    let faint = Parts { audio: Some(float_wav(&[1e-6; 800])), ..Parts::default() };
    says(faint, &["silence"]);
}

/// A mono WAV of 32-bit floats at 16 kHz, written out by hand: [`encode_wav`] clips.
fn float_wav(samples: &[f32]) -> Vec<u8> {
    let data = samples.len() as u32 * 4;
    let mut bytes = b"RIFF".to_vec();
    bytes.extend((36 + data).to_le_bytes());
    bytes.extend(b"WAVEfmt ");
    bytes.extend(16u32.to_le_bytes());
    bytes.extend([3u16, 1].map(u16::to_le_bytes).concat());
    bytes.extend([16_000u32, 64_000].map(u32::to_le_bytes).concat());
    bytes.extend([4u16, 32].map(u16::to_le_bytes).concat());
    bytes.extend(b"data");
    bytes.extend(data.to_le_bytes());
    bytes.extend(samples.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

#[test]
fn a_sounds_level_is_told_before_it_is_trained() {
    let notes = |level: f32| {
        let samples: Vec<f32> = (0..1600).map(|i| (i as f32 * 0.05).sin() * level).collect();
        let parts = Parts { audio: Some(float_wav(&samples)), ..Parts::default() };
        of(parts).signal(2, &Recipe::default(), &limits()).unwrap().1
    };
    let [loud] = &notes(1.5)[..] else { panic!("it is cut off and nobody is told") };
    assert!(["identity 2", "credit", "3.5 dB over full scale"].iter().all(|part| loud.contains(part)), "{loud}");
    let [quiet] = &notes(0.005)[..] else { panic!("it cannot come back and nobody is told") };
    assert!(["identity 2", "-49 dB", "louder"].iter().all(|part| quiet.contains(part)), "{quiet}");
    assert_eq!(notes(0.5), Vec::<String>::new());
}

#[test]
fn a_large_picture_is_kept_as_it_is_hidden() {
    let mark = Recipe::default();
    // Noise, which no PNG makes smaller.
    let mut state = 7u32;
    let noise = (0..600 * 400 * 3).map(|_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as f32 / 255.0
    });
    let file = encode_png(&Picture::new(600, 400, noise.collect()).unwrap());
    let parts = Parts { picture: Some(file.clone()), ..Parts::default() };
    let (signal, _) = of(parts).signal(1, &mark, &limits()).unwrap();
    let dir = tempfile::tempdir().unwrap();
    keep(dir.path(), 1, &signal).unwrap();
    let length = dir.path().join("signal-1.png").metadata().unwrap().len();
    assert!(length < 60_000 && file.len() > 600_000, "{length} bytes of {}", file.len());
    assert_eq!(kept(dir.path(), 1, kinds_of(&signal), &mark).unwrap(), signal, "what is kept is not what was checked");
}

#[test]
fn files_named_as_identities_go_to_them_in_any_order() {
    let none = BTreeSet::new();
    let identities = added(&["ada", "carol", "drone-2"]);
    let given = ["drone-2", "ada", "carol"].map(given);
    assert_eq!(assigned(&given, &identities, &none).unwrap(), [1, 2, 0]);
    // Names that are nobody's go by their order, as do those without.
    let ordered = ["1", "2", "10"].map(self::given);
    assert_eq!(assigned(&ordered, &identities, &none).unwrap(), [0, 1, 2]);
    assert_eq!(assigned(&["", "", ""].map(self::given), &identities, &none).unwrap(), [0, 1, 2]);
    assert_eq!(assigned(&[], &identities, &none).unwrap(), [0; 0]);
    // One contributor of two scenes hides the same in both.
    let both = added(&["ada", "bob", "ada"]);
    assert_eq!(assigned(&["bob", "ada"].map(self::given), &both, &none).unwrap(), [1, 0, 1]);
}

#[test]
fn signals_that_are_nobodys_are_refused_by_name() {
    let marked = BTreeSet::from(["eve".to_owned()]);
    let says = |given: &[&str], labels: &[&str], expected: &[&str]| {
        let given: Vec<Given> = given.iter().map(|name| self::given(name)).collect();
        let error = assigned(&given, &added(labels), &marked).unwrap_err().to_string();
        assert!(expected.iter().all(|part| error.contains(part)), "{error}");
    };
    // Bob has too few views: his logo is not to become Carol's.
    says(
        &["ada", "bob", "carol"],
        &["ada", "carol"],
        &["\"bob\" (no identity has this name)", "after each of ada, carol, or no file"],
    );
    says(
        &["ada", "bob", "carol"],
        &["ada", "carol", "dora"],
        &["\"bob\" (no identity has this name)", "after each of ada, carol, dora, or no file"],
    );
    says(&["ada"], &["ada", "carol"], &["none for identity 2 (carol)"]);
    says(&["ada", "ada"], &["ada", "carol"], &["\"ada\" twice"]);
    says(&["eve", "dora"], &["dora"], &["\"eve\" (marked already", "allowed is one file named after each of dora, or"]);
    says(&["logo"], &["ada", "carol"], &["number of signals is 1", "2 identities", "identity 2 (carol)"]);
}

#[test]
fn what_nobody_hides_is_said_by_name() {
    let given = ["logo", "seal", "crest", ""].map(given);
    let taken = assigned(&given, &added(&["ada", "carol"]), &BTreeSet::new()).unwrap();
    assert_eq!(taken, [0, 1]);
    let note = left_over_note(&given, &taken).unwrap();
    assert!(note.contains("\"crest\", one without a name") && !note.contains("seal"), "{note}");
    assert_eq!(left_over_note(&given[..2], &taken), None);
}

#[test]
fn who_hides_what_is_said() {
    let identity = &added(&["ada"])[0];
    let (signal, _) = given("ada").signal(1, &Recipe::default(), &limits()).unwrap();
    assert_eq!(hides_note(identity, &given("ada"), &signal), "identity 1 (ada) hides ada (text)");
    let both = Signal { audio: Some(tone(0.5, 16_000)), ..signal };
    assert_eq!(hides_note(identity, &given(""), &both), "identity 1 (ada) hides a sound and a text");
}
