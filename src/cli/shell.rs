//! `cairn completions` and `cairn man`: what shells and `man` know of the program, made from the declarations of its commands.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Command;
use clap_complete::Shell;

/// `cairn completions`.
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell that they are for
    #[arg(value_enum)]
    shell: Shell,
}

/// `cairn man`.
#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// The folder that takes the pages, as ~/.local/share/man/man1; made where absent
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Prints the completions of the program `of`.
pub fn completions(args: &CompletionsArgs, mut of: Command) {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut of, "cairn", &mut script);
    print!("{}", String::from_utf8_lossy(&script));
}

/// Writes a page for the program `of` and one for each of its commands.
pub fn man(args: &ManArgs, of: Command) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    pages(&args.out, of)?;
    println!("manual pages in {}; `man cairn` finds them where the folder around it is in MANPATH", args.out.display());
    Ok(())
}

fn pages(folder: &Path, of: Command) -> anyhow::Result<usize> {
    clap_mangen::generate_to(of, folder).with_context(|| format!("cannot write pages into {}", folder.display()))?;
    Ok(std::fs::read_dir(folder)?.count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_made_for_every_command() {
        let folder = tempfile::tempdir().unwrap();
        let below = Command::new("scene").subcommand(Command::new("import"));
        assert_eq!(pages(folder.path(), Command::new("cairn").subcommand(below)).unwrap(), 3);
        for name in ["cairn.1", "cairn-scene.1", "cairn-scene-import.1"] {
            let page = std::fs::read_to_string(folder.path().join(name)).unwrap();
            assert!(page.contains(".TH"), "{name}: {page}");
        }
    }
}
