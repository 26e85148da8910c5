//! `cairn completions` and `cairn man`: what shells and `man` know of the program, made from the declarations of its commands.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::CommandFactory as _;
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

/// Prints the completions.
pub fn completions(args: &CompletionsArgs) {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::Cli::command(), "cairn", &mut script);
    print!("{}", String::from_utf8_lossy(&script));
}

/// Writes a page for the program and one for each of its commands.
pub fn man(args: &ManArgs) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let pages = pages(&args.out)?;
    println!("{pages} pages in {}; `man cairn` finds them where that folder is one of MANPATH's", args.out.display());
    Ok(())
}

fn pages(folder: &Path) -> anyhow::Result<usize> {
    clap_mangen::generate_to(super::Cli::command(), folder)
        .with_context(|| format!("cannot write pages into {}", folder.display()))?;
    Ok(std::fs::read_dir(folder)?.count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_made_for_every_command() {
        let folder = tempfile::tempdir().unwrap();
        pages(folder.path()).unwrap();
        for name in ["cairn.1", "cairn-train.1", "cairn-scene-import.1"] {
            let page = std::fs::read_to_string(folder.path().join(name)).unwrap();
            assert!(page.contains(".TH"), "{name}: {page}");
        }
    }
}
