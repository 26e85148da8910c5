//! `cairn keys`: owners' keys, which never leave this machine.

use std::path::PathBuf;

use cairn_registry::OwnerKey;

/// What to do with keys.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Make a new Ed25519 key, readable by you alone
    New {
        /// Where it goes; a file that is there is never replaced
        file: PathBuf,
    },
    /// Show the public half
    Show {
        /// The key's file
        file: PathBuf,
    },
}

/// Answers `cairn keys`.
pub fn run(command: &Command) -> anyhow::Result<()> {
    let key = match command {
        Command::New { file } => {
            let key = OwnerKey::generate()?;
            key.save(file)?;
            println!("new key in {}; keep it safe, nobody can make it again", file.display());
            key
        }
        Command::Show { file } => OwnerKey::load(file)?,
    };
    println!("public key {}", key.public());
    println!("key id     {}", key.public().id());
    Ok(())
}
