//! Digests of what tiny trainings end in: a refactoring gives the same bytes from the same seed.

use crate::common::{bytes, config, run, start};
use cairn_mark::{CarrierKind, DensityKind, OtherColours, Recipe, RobustConfig};
use safetensors::SafeTensors;
use sha2::{Digest, Sha256};

/// Of all tensors of a file, its header left out.
fn digest(file: &[u8]) -> String {
    let file = SafeTensors::deserialize(file).unwrap();
    let mut parts: Vec<Vec<u8>> = file.tensors().iter().map(|(_, t)| Sha256::digest(t.data()).to_vec()).collect();
    parts.sort();
    Sha256::digest(parts.concat()).iter().take(8).map(|b| format!("{b:02x}")).collect()
}

#[test]
#[ignore = "holds the bits of one kind of processor (candle's matrix product); run it before and after a refactoring"]
fn digests() {
    let usual = config(40);
    let mut different = Vec::new();
    for (name, before, config) in [
        ("usual", ["5bd0fbc3fc9c8b64", "603efae4a996c39d"], usual.clone()),
        (
            "outdoor",
            ["753664ddf5b649bc", "4f54c48f24fd7114"],
            Recipe {
                others: 2,
                others_colours: OtherColours::Any,
                others_cutout_share: 0.25,
                noisy_share: 0.25,
                view_refresh_steps: 4,
                ..usual.clone()
            },
        ),
        (
            "robust",
            ["8543bed9ae35f520", "ab5e00781a7f0a83"],
            Recipe { robust: RobustConfig { enabled: true, ..RobustConfig::default() }, ..config(20) },
        ),
        (
            "harmonics",
            ["84a052d80fae4b8c", "5ed52a97e8e34a73"],
            Recipe { carrier: CarrierKind::Harmonics, ..config(20) },
        ),
        (
            "free",
            ["4780710c17b96309", "e083e424c75a6ff4"],
            Recipe { carrier: CarrierKind::Harmonics, density: DensityKind::Free, ..config(4) },
        ),
    ] {
        let mut trainer = start(config);
        run(&mut trainer);
        let checkpoint = digest(&trainer.checkpoint().unwrap());
        let now = [checkpoint, digest(&bytes(trainer)[1])];
        if now != before {
            different.push(format!("{name}: {now:?} for {before:?}"));
        }
    }
    assert!(different.is_empty(), "checkpoint and detector of tiny trainings: {different:#?}");
}
