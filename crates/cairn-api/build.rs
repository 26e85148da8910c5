//! Turns `proto/` into Rust with protox, a compiler in Rust, so that building
//! Cairn needs no `protoc` on the machine.

use std::error::Error;
use std::path::{Path, PathBuf};

use prost::Message;

/// One file a service, and what they share.
const FILES: [&str; 7] = ["common", "scene", "training", "render", "query", "owner", "access"];

fn main() -> Result<(), Box<dyn Error>> {
    // Asked for when it runs: two checkouts may share a target folder, and with it this program.
    let root = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("../../proto");
    let files: Vec<PathBuf> = FILES.iter().map(|name| root.join(format!("cairn/v1/{name}.proto"))).collect();
    for file in &files {
        println!("cargo:rerun-if-changed={}", file.display());
    }
    let descriptors = protox::compile(&files, [&root])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("cairn_descriptors.bin"), descriptors.encode_to_vec())?;
    let mut methods = Vec::new();
    for file in &descriptors.file {
        for service in &file.service {
            let path = |method: &str| format!("/{}.{}/{method}", file.package(), service.name());
            methods.extend(service.method.iter().map(|m| path(m.name())));
        }
    }
    std::fs::write(out.join("cairn_methods.rs"), format!("&{methods:?}"))?;
    let mut config = prost_build::Config::new();
    // A message knows its name: answers in JSON look its fields up by it.
    config.enable_type_names();
    // Else its other answer, a sentence, would take as much room.
    config.boxed(".cairn.v1.LocateResponse.answer.found");
    tonic_prost_build::configure().bytes(".").compile_fds_with_config(descriptors, config)?;
    Ok(())
}
