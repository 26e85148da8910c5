//! `cairn identify`: whose mark a picture carries and what it hides.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_api::v1::{self, identify_response};

use super::connect::Connection;
use super::files::{read_picture, write};
use super::json::{self, Json};
use super::viewpoint::viewpoint;

/// Contributors named in one line.
const MAX_NAMES: usize = 5;

/// `cairn identify`.
#[derive(Debug, clap::Args)]
pub struct IdentifyArgs {
    /// The scene whose marks are looked for
    #[arg(value_name = "SCENE")]
    name: String,
    /// The picture, PNG, JPEG or WebP
    picture: PathBuf,
    /// Also find the picture's camera, and look for each mark in what the field does not explain from there: surer, and takes
    /// seconds
    #[arg(long)]
    register: bool,
    /// Register it at this view of the scene, which it was rendered from and neither cut nor turned since
    #[arg(long, value_name = "VIEW", conflicts_with = "pose")]
    view: Option<String>,
    /// Register it at this camera, written as for `cairn render --pose`
    #[arg(long, value_name = "FILE")]
    pose: Option<PathBuf>,
    /// Write what the mark hides into this folder: picture.png, sound.wav and text.txt, those that the scene hides;
    /// refused where the picture is unmarked
    #[arg(long, value_name = "DIR")]
    payload_out: Option<PathBuf>,
    #[command(flatten)]
    json: Json,
}

/// Answers `cairn identify`.
pub async fn identify(line: &Connection, args: IdentifyArgs) -> anyhow::Result<()> {
    let picture = read_picture("identify", &args.name, &args.picture)?.into();
    let camera = match args.view.is_some() || args.pose.is_some() {
        true => Some(viewpoint(args.view, args.pose.as_deref())?),
        false => None,
    };
    let registers = args.register || camera.is_some();
    let request =
        v1::IdentifyRequest { scene: args.name.clone(), picture, register: args.register, camera, payload: true };
    let mut answer = line.about(&args.name).query().identify(request).await?.into_inner();
    let is_unmarked = matches!(answer.answer, Some(identify_response::Answer::Unmarked(_)) | None);
    if is_unmarked {
        // What the detector draws from an unmarked picture is nobody's.
        answer.payload = None;
    }
    let kept_in = args.payload_out.as_deref();
    if args.json.json {
        if let Some(payload) = &mut answer.payload {
            kept_in.iter().try_for_each(|folder| keep(payload, folder).map(drop))?;
            // Files are for these.
            (payload.picture_png, payload.sound_wav) = Default::default();
        }
        json::print(&answer)?;
        return may_be_kept(is_unmarked, args.payload_out.as_deref(), registers);
    }
    let names = Names(std::mem::take(&mut answer.labels));
    match &answer.answer {
        Some(identify_response::Answer::Identity(found)) => show(found, answer.confidence),
        Some(identify_response::Answer::Foreign(there)) => {
            let v1::ForeignIdentity { scene, number, label } = there;
            println!("of scene {scene}, identity {number}: {label} (confidence {:.2})", answer.confidence);
        }
        Some(identify_response::Answer::Unmarked(_)) | None => {
            println!("unmarked (confidence {:.2}){}", answer.confidence, unsure(&answer.probabilities, &names));
        }
    }
    if answer.center_crop {
        println!("read in the middle of the picture: the whole says nothing surely");
    }
    if registers {
        show_registered(answer.registered.as_ref().ok_or(&answer.not_registered), &names);
    }
    for (class, probability) in answer.probabilities.iter().enumerate() {
        println!("  class {}: {probability:.4}", names.class(class));
    }
    if is_unmarked {
        println!("the picture is unmarked: what the detector draws from it is nobody's, and is not shown");
        return may_be_kept(is_unmarked, args.payload_out.as_deref(), registers);
    }
    show_payload(&answer.payload.unwrap_or_default(), kept_in)
}

/// Refuses files of what nobody hid.
///
/// # Errors
/// For an unmarked picture whose payload was to go into `folder`.
fn may_be_kept(is_unmarked: bool, folder: Option<&Path>, registered: bool) -> anyhow::Result<()> {
    let Some(folder) = folder.filter(|_| is_unmarked) else { return Ok(()) };
    let surer = if registered { "" } else { "; --register looks again, and is surer" };
    anyhow::bail!(
        "nothing is written into {}: the picture is unmarked, so nobody hid anything in it{surer}",
        folder.display()
    )
}

/// What the scene's identities are called, identity 1 first.
struct Names(Vec<String>);

impl Names {
    /// The number of a class, and in brackets what it is called where that is known.
    fn class(&self, class: usize) -> String {
        match class.checked_sub(1) {
            None => "0 (unmarked)".to_owned(),
            Some(at) => self.0.get(at).map_or_else(|| class.to_string(), |name| format!("{class} ({name})")),
        }
    }
}

fn show(found: &v1::FoundIdentity, confidence: f64) {
    println!("identity {}: {} (confidence {confidence:.2})", found.number, found.label);
    if !found.contributors.is_empty() {
        println!("{}: photographs by {}", found.label, named(&found.contributors));
    }
    let indices: Vec<String> = found.record_indices.iter().map(u64::to_string).collect();
    match indices[..] {
        [] => println!("no owner record yet; `cairn owners sign` makes one"),
        _ => println!("owner records at index: {}", indices.join(", ")),
    }
}

/// Of an unmarked picture: that an owner is likelier all the same, if one is.
fn unsure(probabilities: &[f32], names: &Names) -> String {
    let all = || probabilities.iter().enumerate();
    match all().max_by(|(_, a), (_, b)| a.total_cmp(b)) {
        Some((class, _)) if class > 0 => {
            format!(": class {} is likelier, and not sure enough to be credited", names.class(class))
        }
        _ => String::new(),
    }
}

/// What the registered picture says, or why it was not registered.
fn show_registered(reading: Result<&v1::RegisteredReading, &String>, names: &Names) {
    let reading = match reading {
        Ok(reading) => reading,
        Err(why) => return println!("not registered: {why}; the classifier answers"),
    };
    println!("registered: the field explains {:.0} % of it", 100.0 * reading.explained);
    for (at, score) in reading.scores.iter().enumerate() {
        println!(
            "  mark {}: {score:.1} deviations (believed from {:.0} on)",
            names.class(at + 1),
            reading.believed_from
        );
    }
    match reading.believed {
        0 => println!("no mark stands out: the classifier answers"),
        number => println!("mark {} stands out and is believed", names.class(number as usize)),
    }
}

/// Prints the recovered text, and writes the parts of the payload where `folder` says so.
fn show_payload(payload: &v1::Payload, folder: Option<&Path>) -> anyhow::Result<()> {
    if let Some(text) = &payload.text {
        // Quoted and escaped: it comes out of a picture, and may say anything to a terminal.
        println!("recovered text: {text:?}");
    }
    let kept = folder.map(|folder| keep(payload, folder)).transpose()?.unwrap_or_default();
    for Part { name, file, bytes } in parts(payload) {
        match (folder, bytes) {
            (Some(_), Some(_)) => {
                kept.iter()
                    .filter(|path| path.ends_with(file))
                    .for_each(|p| println!("recovered {name} in {}", p.display()));
            }
            (Some(_), None) => println!("no {name}: no identity of the scene hides one"),
            (None, Some(_)) if name != "text" => println!("recovered {name} not kept; --payload-out DIR keeps it"),
            (None, _) => {}
        }
    }
    Ok(())
}

/// A part of a payload, and the file that it goes to.
struct Part<'a> {
    name: &'static str,
    file: &'static str,
    bytes: Option<&'a [u8]>,
}

fn parts(payload: &v1::Payload) -> [Part<'_>; 3] {
    let there = |bytes: &'_ [u8]| !bytes.is_empty();
    let (picture, sound) = (&payload.picture_png[..], &payload.sound_wav[..]);
    [
        Part { name: "picture", file: "picture.png", bytes: Some(picture).filter(|bytes| there(bytes)) },
        Part { name: "sound", file: "sound.wav", bytes: Some(sound).filter(|bytes| there(bytes)) },
        Part { name: "text", file: "text.txt", bytes: payload.text.as_deref().map(str::as_bytes) },
    ]
}

/// Writes what is there of a payload into `folder`; the files.
fn keep(payload: &v1::Payload, folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let mut kept = Vec::new();
    for Part { file, bytes, .. } in parts(payload) {
        if let Some(bytes) = bytes {
            write(&folder.join(file), bytes)?;
            kept.push(folder.join(file));
        }
    }
    Ok(kept)
}

/// The first contributors by name, each with a count; how many more there are.
fn named(contributors: &[v1::ClusterContributor]) -> String {
    let first = contributors.iter().take(MAX_NAMES).map(|c| format!("{} ({})", c.name, c.photographs));
    let mut names = first.collect::<Vec<_>>().join(", ");
    if contributors.len() > MAX_NAMES {
        names.push_str(&format!(" and {} more", contributors.len() - MAX_NAMES));
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_names_five_contributors_and_counts_the_rest() {
        let of = |count: u32| {
            let of = |n| v1::ClusterContributor { name: format!("drone-{n}"), photographs: 9 - n };
            named(&(0..count).map(of).collect::<Vec<_>>())
        };
        assert_eq!(of(2), "drone-0 (9), drone-1 (8)");
        assert_eq!(of(5), "drone-0 (9), drone-1 (8), drone-2 (7), drone-3 (6), drone-4 (5)");
        assert_eq!(of(7), "drone-0 (9), drone-1 (8), drone-2 (7), drone-3 (6), drone-4 (5) and 2 more");
    }

    #[test]
    fn an_unmarked_picture_that_tells_an_owner_says_so() {
        let nobody = Names(Vec::new());
        assert_eq!(unsure(&[0.6, 0.1, 0.3], &nobody), "");
        assert!(unsure(&[0.3, 0.0, 0.7], &nobody).contains("class 2 is likelier"));
        let names = Names(vec!["ada".into(), "bob".into()]);
        assert!(unsure(&[0.3, 0.0, 0.7], &names).contains("class 2 (bob) is likelier"));
        assert_eq!(
            (names.class(0), names.class(1), names.class(3)),
            ("0 (unmarked)".into(), "1 (ada)".into(), "3".into())
        );
        assert_eq!(unsure(&[], &nobody), "");
    }

    #[test]
    fn what_nobody_hid_is_not_written() {
        let folder = Some(Path::new("out"));
        let refused = may_be_kept(true, folder, false).unwrap_err().to_string();
        assert!(refused.contains("into out: the picture is unmarked") && refused.contains("--register"), "{refused}");
        assert!(!may_be_kept(true, folder, true).unwrap_err().to_string().contains("--register"));
        assert!(may_be_kept(false, folder, false).is_ok() && may_be_kept(true, None, false).is_ok());
    }
}
