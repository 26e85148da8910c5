//! What a record binds, hashed anew from its bytes: the files of a data folder (`cairn audit bundle --against DIR`), or
//! single ones. Nothing to compare is an error: a report
//! that compared nothing must not read as one that did.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use cairn_log::{Digest, OwnerRecord};
use cairn_scene::SceneFolder;
use cairn_verify::{Code, Evidence, FileInHand, Report};

use cairn_service::store::model::{self, ModelInfo};

/// What is left out for want of the file, one code a digest that a data folder can be asked for.
const UNCHECKED: [Code; 6] = [
    Code::MarkedFieldUnchecked,
    Code::BaseFieldUnchecked,
    Code::ShareTableUnchecked,
    Code::DetectorUnchecked,
    Code::PhotographsUnchecked,
    Code::ConfigurationUnchecked,
];

/// Files in hand one by one, as they come by mail.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Files {
    /// The folder of the photographs, to be held to the record: all that it lists must be there, unchanged, and others may
    #[arg(long, value_name = "DIR", conflicts_with = "against")]
    pub photographs: Option<PathBuf>,
    /// The marked field, to be held to the record
    #[arg(long, value_name = "FILE", conflicts_with = "against")]
    pub field: Option<PathBuf>,
    /// The base field, to be held to the record
    #[arg(long, value_name = "FILE", conflicts_with = "against")]
    pub base_field: Option<PathBuf>,
    /// The base field's share table, to be held to the record
    #[arg(long, value_name = "FILE", conflicts_with = "against")]
    pub share_table: Option<PathBuf>,
    /// The detector, to be held to the record
    #[arg(long, value_name = "FILE", conflicts_with = "against")]
    pub detector: Option<PathBuf>,
    /// The training's settings (settings.toml), to be held to the record
    #[arg(long, value_name = "FILE", conflicts_with = "against")]
    pub settings: Option<PathBuf>,
}

impl Files {
    /// Adds what is given to `evidence`; of the photographs those that `record` lists, where it lists them.
    ///
    /// # Errors
    /// For what cannot be read, and a folder without files.
    pub fn gather(&self, evidence: &mut Evidence<'_>, record: Option<&OwnerRecord>) -> anyhow::Result<()> {
        let file = |path: &Option<PathBuf>| path.as_deref().map(FileInHand::read).transpose();
        evidence.marked_field = file(&self.field)?;
        evidence.base_field = file(&self.base_field)?;
        evidence.share_table = file(&self.share_table)?;
        evidence.detector = file(&self.detector)?;
        evidence.training_configuration = file(&self.settings)?;
        let listed = record.and_then(|record| record.views.as_deref());
        evidence.photographs = self.photographs.as_deref().map(|folder| in_folder(folder, listed)).transpose()?;
        Ok(())
    }
}

/// The photographs in a folder: those `listed`, or where nothing is listed every file.
fn in_folder(folder: &Path, listed: Option<&[Digest]>) -> anyhow::Result<FileInHand> {
    let (there, name) = (all_files(folder)?, folder.display().to_string());
    let Some(listed) = listed else { return Ok(FileInHand::photographs(&name, &there)) };
    let kept: Vec<Digest> = listed.iter().filter(|digest| there.contains(digest)).copied().collect();
    if kept.len() == listed.len() && there.len() == listed.len() {
        return Ok(FileInHand::photographs(&name, &kept));
    }
    let files = if there.len() == 1 { "file" } else { "files" };
    let place =
        format!("{name}, {} of the {} that the record lists, among {} {files}", kept.len(), listed.len(), there.len());
    Ok(FileInHand::photographs(&place, &kept))
}

/// The digests of every file of a folder; folders in it are gone through as well.
fn all_files(folder: &Path) -> anyhow::Result<Vec<Digest>> {
    let (mut digests, mut left) = (Vec::new(), vec![folder.to_path_buf()]);
    while let Some(folder) = left.pop() {
        let listed = std::fs::read_dir(&folder).with_context(|| format!("cannot list {}", folder.display()))?;
        for entry in listed {
            let entry = entry.with_context(|| format!("cannot list {}", folder.display()))?;
            // A link to a folder may lead back here: it is read as a file, which fails by name.
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                left.push(entry.path());
            } else {
                digests.push(FileInHand::read(&entry.path())?.digest);
            }
        }
    }
    anyhow::ensure!(!digests.is_empty(), "there is no file in {}", folder.display());
    Ok(digests)
}

/// Adds to `evidence` each file below `data` whose digest the record names.
///
/// # Errors
/// Where no model in `data` is of the training that the record names, or a file of it cannot be read.
pub fn gather(evidence: &mut Evidence<'_>, data: &Path, record: &OwnerRecord) -> anyhow::Result<()> {
    cairn_service::store::scenes::check_scene_name(&record.scene)?;
    let bound = &record.digests;
    let of_training =
        [bound.marked_field, bound.detector, bound.base_field, bound.share_table, bound.training_configuration];
    if record.identity.number.is_none() && bound.photographs.is_some() {
        evidence.photographs = Some(of_contributor(data, record)?);
        if of_training.iter().all(Option::is_none) {
            return Ok(());
        }
    }
    let models = data.join("models");
    let info = training_of(&models, record)?;
    let folder = models.join(&info.scene).join(&info.job);
    let file = |name: &str| FileInHand::read(&folder.join(name));
    if bound.training_configuration.is_some() {
        evidence.training_configuration = Some(file("settings.toml")?);
    }
    if bound.marked_field.is_some() {
        evidence.marked_field = Some(file("marked.field")?);
    }
    if bound.base_field.is_some() {
        evidence.base_field = Some(file("base.field")?);
    }
    if bound.share_table.is_some() {
        evidence.share_table = Some(file("base.shares")?);
    }
    if bound.detector.is_some() {
        evidence.detector = Some(file("detector")?);
    }
    if let (Some(number), true) = (record.identity.number, bound.photographs.is_some()) {
        evidence.photographs = Some(photographs(data, &info, number)?);
    }
    Ok(())
}

/// The photographs that a record about a contributor lists, as they lie in the scene; where it lists none, all of the
/// contributor's.
fn of_contributor(data: &Path, record: &OwnerRecord) -> anyhow::Result<FileInHand> {
    let scene = SceneFolder::open(&data.join("scenes"), &record.scene)?;
    let capture = scene.capture();
    let mut digests = Vec::new();
    for (i, view) in capture.views.iter().enumerate() {
        let is_of = match &record.views {
            Some(listed) => listed.binary_search(&Digest::from_bytes(scene.photograph_digest(i))).is_ok(),
            None => view.contributor == record.identity.contributor,
        };
        if is_of {
            digests.push(FileInHand::read(&capture.root.join(&view.photograph))?.digest);
        }
    }
    let place = format!("{} photographs of {}", digests.len(), scene.folder().display());
    Ok(FileInHand::photographs(&place, &digests))
}

/// The model of the record's own training: the scene may have been trained again since.
fn training_of(models: &Path, record: &OwnerRecord) -> anyhow::Result<ModelInfo> {
    let bound = &record.digests;
    let same_photographs = |m: &ModelInfo| {
        let identity = record.identity.number.and_then(|number| m.identity(number).ok());
        identity.is_some_and(|i| Some(i.photographs_root()) == bound.photographs)
    };
    let mut found = model::all(models, &record.scene)?;
    let there = found.len();
    // By what is told apart best: trainings with the same settings may have learnt from other photographs.
    let named = if let Some(field) = bound.marked_field {
        found.retain(|m| m.mark.as_ref().is_some_and(|mark| mark.marked_field == field));
        format!("marked field {field}")
    } else if let Some(table) = bound.share_table {
        found.retain(|m| m.share_table == table);
        format!("share table {table}")
    } else if let Some(field) = bound.base_field {
        found.retain(|m| m.base_field == field);
        format!("base field {field}")
    } else if let Some(settings) = bound.training_configuration {
        found.retain(|m| m.settings == settings);
        format!("training configuration {settings}")
    } else if let Some(root) = bound.photographs {
        found.retain(same_photographs);
        format!("photographs {root} as identity {}", record.identity.number.unwrap_or(0))
    } else {
        anyhow::bail!(
            "the record about scene {:?} names neither marked field, share table, base field, training configuration nor \
             photographs, so {} holds nothing to compare it with; leave --against out",
            record.scene,
            models.display()
        );
    };
    // Settings and photographs stay the same from one training to the next: any of those will do.
    let at = found.iter().position(same_photographs).unwrap_or(0);
    anyhow::ensure!(
        at < found.len(),
        "{}: of {there} models of scene {:?} none has the {named} that the record names, so nothing was compared; \
         give --against the data folder in which it was trained, or leave it out",
        models.display(),
        record.scene
    );
    Ok(found.swap_remove(at))
}

fn photographs(data: &Path, info: &ModelInfo, number: u32) -> anyhow::Result<FileInHand> {
    let identity = info.identity(number).with_context(|| {
        let (place, scene) = (data.display(), &info.scene);
        format!(
            "{place}: the photographs of the record about scene {scene:?} were not compared; give --against the data \
             folder in which it was trained, or leave it out"
        )
    })?;
    let scene = SceneFolder::open(&data.join("scenes"), &info.scene)?;
    let capture = scene.capture();
    if let Some(gone) = identity.views.iter().find(|name| capture.views.iter().all(|v| v.name != **name)) {
        anyhow::bail!(
            "{}: view {gone:?} of identity {} was removed from the scene since, so its photographs were not compared; \
             give --against a copy from before, or leave it out",
            scene.folder().display(),
            identity.number
        );
    }
    let mut digests = Vec::with_capacity(identity.views.len());
    for view in capture.views.iter().filter(|v| identity.views.contains(&v.name)) {
        digests.push(FileInHand::read(&capture.root.join(&view.photograph))?.digest);
    }
    let place = format!("{} photographs of {}", digests.len(), scene.folder().display());
    Ok(FileInHand::photographs(&place, &digests))
}

/// Makes sure that everything of the record that a data folder can be asked for was compared.
///
/// # Errors
/// Naming the first field that was not.
pub fn all_compared(report: &Report, data: &Path) -> anyhow::Result<()> {
    match report.findings.iter().find(|f| UNCHECKED.contains(&f.code)) {
        None => Ok(()),
        Some(finding) => anyhow::bail!(
            "{}: {} ({}) was not compared; give --against the data folder in which it was trained, or leave it out",
            data.display(),
            finding.place,
            finding.expected
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_log::format::record::{self, Digests, Identity, Seen};
    use cairn_log::{OwnerKey, RecordKind, format::merkle};
    use cairn_verify::Outcome;

    fn contribution(digests: Digests) -> (OwnerRecord, Vec<u8>) {
        let key = OwnerKey::from_seed(&[1; 32]);
        let record = OwnerRecord {
            version: record::VERSION,
            kind: RecordKind::Contribution,
            origin: "cairn.example/log".into(),
            scene: "town".into(),
            scene_salt: Digest::of("salt"),
            identity: Identity::numbered(1, "ada"),
            owner_key: key.public(),
            digests: Digests { photographs: Some(Digest::of("photographs")), ..digests },
            seed: None,
            purpose: "credit".into(),
            nonce: Digest::of("nonce"),
            seen: Seen { size: 0, root: merkle::empty_root() },
            replaces: None,
            views: None,
        };
        let envelope = record.seal(&key).unwrap().to_json().into_bytes();
        (record, envelope)
    }

    #[test]
    fn whatever_the_record_binds_and_nobody_compared_is_named() {
        let any = Some(Digest::of("any"));
        let photographs = FileInHand { place: "p".into(), digest: Digest::of("photographs") };
        for (digests, field) in [
            (Digests { marked_field: any, ..Digests::default() }, "marked_field"),
            (Digests { detector: any, ..Digests::default() }, "detector"),
            (Digests { training_configuration: any, ..Digests::default() }, "training_configuration"),
        ] {
            let (_, envelope) = contribution(digests);
            let photographs = Some(photographs.clone());
            let report = cairn_verify::audit(&Evidence { envelope: &envelope, photographs, ..Evidence::default() });
            assert_eq!(report.outcome, Outcome::Valid, "{report}");
            let error = all_compared(&report, Path::new("folder")).unwrap_err().to_string();
            assert!(error.contains(field) && error.starts_with("folder: "), "{field}: {error}");
        }
        let (_, envelope) = contribution(Digests::default());
        let evidence = |photographs| Evidence { envelope: &envelope, photographs, ..Evidence::default() };
        assert!(all_compared(&cairn_verify::audit(&evidence(None)), Path::new("folder")).is_err());
        all_compared(&cairn_verify::audit(&evidence(Some(photographs))), Path::new("folder")).unwrap();
    }

    #[test]
    fn of_a_folder_those_photographs_are_taken_that_the_record_lists() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("more")).unwrap();
        for name in ["a", "b", "more/c", "stranger"] {
            std::fs::write(dir.path().join(name), name).unwrap();
        }
        let root = |names: &[&str]| record::photographs_root(&names.iter().map(Digest::of).collect::<Vec<_>>());
        let mut listed = ["a", "b", "more/c"].map(Digest::of);
        listed.sort_unstable();
        let some = in_folder(dir.path(), Some(&listed)).unwrap();
        assert_eq!(some.digest, root(&["a", "b", "more/c"]));
        assert!(some.place.contains("3 of the 3 that the record lists, among 4 files"), "{}", some.place);
        assert_eq!(in_folder(dir.path(), None).unwrap().digest, root(&["a", "b", "more/c", "stranger"]));
        // One that was changed is not taken, and without it the root is another.
        std::fs::write(dir.path().join("a"), "a, scaled").unwrap();
        let some = in_folder(dir.path(), Some(&listed)).unwrap();
        assert!(some.digest != root(&["a", "b", "more/c"]) && some.place.contains("2 of the 3"), "{}", some.place);
    }

    #[test]
    fn a_record_that_binds_nothing_cannot_be_held_to_a_folder() {
        let (mut record, envelope) = contribution(Digests::default());
        record.digests = Digests::default();
        let mut evidence = Evidence { envelope: &envelope, ..Evidence::default() };
        let error = gather(&mut evidence, Path::new("folder"), &record).unwrap_err().to_string();
        assert!(error.contains("\"town\"") && error.contains("leave --against out"), "{error}");
    }
}
