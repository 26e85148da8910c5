//! Digests of what tiny trainings end in: the same seed gives the same bytes.

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
fn digests() {
    let usual = config(40);
    for (name, config) in [
        ("usual", usual.clone()),
        (
            "outdoor",
            Recipe {
                others: 2,
                others_colours: OtherColours::Any,
                others_cutout_share: 0.25,
                noisy_share: 0.25,
                view_refresh_steps: 4,
                ..usual.clone()
            },
        ),
        ("robust", Recipe { robust: RobustConfig { enabled: true, ..RobustConfig::default() }, ..config(20) }),
        ("harmonics", Recipe { carrier: CarrierKind::Harmonics, ..config(20) }),
        ("free", Recipe { carrier: CarrierKind::Harmonics, density: DensityKind::Free, ..config(4) }),
    ] {
        let mut trainer = start(config);
        run(&mut trainer);
        let checkpoint = digest(&trainer.checkpoint().unwrap());
        let (field, detector) = bytes(trainer.finish().unwrap());
        println!("{name}: {checkpoint} {} {}", digest(&field), digest(&detector));
    }
}
