//! The declarations against the written documents, and what is refused.
use super::*;

#[test]
fn golden() {
    for kind in [Preset::Forward, Preset::Object, Preset::Outdoor] {
        for (name, quality) in [("draft", Quality::Draft), ("balanced", Quality::Balanced), ("smoke", Quality::Smoke)] {
            for robust in [false, true] {
                let settings = preset::settings(Chosen { preset: kind, quality, robust });
                settings.check().unwrap();
                let path = format!("/tmp/w/config-golden/{}-{name}-{}.toml", kind.name(), u8::from(robust));
                std::fs::write(path, settings.to_toml().unwrap()).unwrap();
            }
        }
    }
    for (path, text) in document::all() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
}
