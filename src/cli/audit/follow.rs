//! `cairn audit follow`: looks at a log again and again, and keeps what it signed.
//!
//! ```text
//! STATE/checkpoint               the newest checkpoint that went on from all before it
//! STATE/evidence/<n>/first       of a contradiction: the checkpoint seen first, a signed note
//! STATE/evidence/<n>/second      and the one that contradicts it
//! STATE/evidence/<n>/tile/...    tiles of the larger of the two
//! ```
//!
//! Everything is there whole or not at all, and nothing of it is ever overwritten but
//! `checkpoint`, which after a contradiction stays the one seen first.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context as _;
use cairn_verify::{Contradiction, FollowOptions};

use super::http::HttpLog;
use super::trust::Trust;
use cairn_durable::{read_limited, remove, rename, write_atomic};

/// `cairn audit follow`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Where the log's public files lie, as http://HOST:PORT/PREFIX or with https
    #[arg(value_name = "URL")]
    pub url: String,
    #[command(flatten)]
    pub trust: Trust,
    /// What was seen of this log, kept from look to look: a folder of its own for each log
    #[arg(long, value_name = "DIR", default_value = "cairn-follow")]
    pub state: PathBuf,
    /// Look once and exit
    #[arg(long)]
    pub once: bool,
    /// Seconds from look to look
    #[arg(long, value_name = "S", default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub interval: u64,
    /// Print the reports as JSON
    #[arg(long)]
    pub json: bool,
}

/// Answers `cairn audit follow`: until something is wrong, or once.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let policy = args.trust.policy()?;
    let pinned = args.trust.pinned(policy.as_ref(), None)?;
    let pinned = pinned.context(
        "whose log is it? give its public key (--vkey, from `cairn owners vkey`), or a policy with one log line",
    )?;
    let options = FollowOptions { pinned: &pinned, policy: policy.as_ref() };
    let log = HttpLog::new(&args.url)?;
    std::fs::create_dir_all(&args.state).with_context(|| format!("cannot make the folder {}", args.state.display()))?;
    loop {
        let code = match look(args, &log, &options) {
            Ok(code) => code,
            Err(error) if args.once => return Err(error),
            // A log out of reach says nothing; the next look may find it.
            Err(error) => {
                eprintln!("no answer: {error:#}");
                0
            }
        };
        // Whom should it go on for, once nobody reads what it says?
        if args.once || code != 0 || crate::out::is_closed() {
            return Ok(ExitCode::from(code));
        }
        std::thread::sleep(Duration::from_secs(args.interval));
    }
}

/// One look: its exit code.
fn look(args: &Args, log: &HttpLog, options: &FollowOptions<'_>) -> anyhow::Result<u8> {
    let kept = args.state.join("checkpoint");
    let last = match kept.exists() {
        true => Some(String::from_utf8(read_limited(&kept, 1 << 20)?).context("the state's checkpoint is no text")?),
        false => None,
    };
    let followed = cairn_verify::follow(log, last.as_deref(), options)?;
    if let Some(note) = followed.keep.filter(|note| Some(note) != last.as_ref()) {
        write_atomic(&kept, note.as_bytes())?;
    }
    let evidence = followed.contradiction.map(|found| keep(&args.state.join("evidence"), &found)).transpose()?;
    super::trust::show(&followed.report, args.json.then(|| followed.report.to_json()));
    if let Some(folder) = evidence {
        eprintln!("both sides are kept in {}; check them with `cairn audit evidence`", folder.display());
    }
    Ok(followed.report.exit_code())
}

/// Keeps a contradiction in a folder of its own, durably; the same one twice is kept once.
fn keep(evidence: &Path, found: &Contradiction) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(evidence).with_context(|| format!("cannot make the folder {}", evidence.display()))?;
    let mut number = 1;
    while evidence.join(number.to_string()).exists() {
        let folder = evidence.join(number.to_string());
        let same = |name: &str, note: &str| std::fs::read(folder.join(name)).is_ok_and(|kept| kept == note.as_bytes());
        if same("first", &found.first) && same("second", &found.second) {
            return Ok(folder);
        }
        number += 1;
    }
    let (filling, folder) = (evidence.join(format!(".{number}")), evidence.join(number.to_string()));
    remove(&filling)?;
    let notes = [("first".to_owned(), found.first.as_bytes()), ("second".to_owned(), found.second.as_bytes())];
    let tiles = found.tiles.iter().map(|(path, bytes)| (path.clone(), bytes.as_slice()));
    for (path, bytes) in notes.into_iter().chain(tiles) {
        let path = filling.join(path);
        let parent = path.parent().unwrap_or(&filling);
        std::fs::create_dir_all(parent).with_context(|| format!("cannot make the folder {}", parent.display()))?;
        write_atomic(&path, bytes)?;
    }
    rename(&filling, &folder)?;
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contradiction_is_kept_once_and_another_beside_it() {
        let dir = tempfile::tempdir().unwrap();
        let evidence = dir.path().join("evidence");
        let found = |second: &str| Contradiction {
            first: "first".into(),
            second: second.into(),
            tiles: vec![("tile/0/000.p/1".into(), vec![7; 32])],
        };
        for (second, number) in [("a", "1"), ("a", "1"), ("b", "2"), ("a", "1")] {
            assert_eq!(keep(&evidence, &found(second)).unwrap(), evidence.join(number));
        }
        assert_eq!(std::fs::read(evidence.join("1/tile/0/000.p/1")).unwrap(), [7; 32]);
        assert_eq!(std::fs::read(evidence.join("2/second")).unwrap(), b"b");
        assert_eq!(std::fs::read_dir(&evidence).unwrap().count(), 2, "nothing half done stays");
    }
}
