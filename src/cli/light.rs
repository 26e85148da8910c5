//! In whose light `cairn render` renders.

use std::path::PathBuf;

use cairn_api::v1::{self, appearance::Choice};

use super::connect::Connection;
use super::files::read;
use super::locate::{camera_of, in_words};
use super::viewpoint::viewpoint;

/// How far from --light to --light-to where that is not said.
const HALF_WAY: f64 = 0.5;

/// One light of a training view, or of a photograph.
#[derive(Clone, Debug, clap::Args)]
pub struct InLight {
    /// In the light of this view, held-out ones too (where not given neutral; with --path between from the one's to the other's)
    #[arg(long, value_name = "VIEW")]
    light: Option<String>,
    /// In the light of this photograph, PNG, JPEG or WebP, as it is fitted to the whole of it. Its camera is looked for, as
    /// `cairn locate` does, where none is given
    #[arg(long, value_name = "FILE", conflicts_with = "light")]
    light_of: Option<PathBuf>,
    /// The photograph was taken with the camera of this view of the scene, and neither cut nor turned since
    #[arg(long, value_name = "VIEW", requires = "light_of", group = "taken")]
    taken_view: Option<String>,
    /// The photograph was taken with this camera, written as for `cairn render --pose`
    #[arg(long, value_name = "FILE", requires = "light_of", group = "taken")]
    taken_pose: Option<PathBuf>,
}

/// A second view's light.
#[derive(Clone, Debug, clap::Args)]
pub struct LightTo {
    /// On the way from the light of --light to the one of this view, which a path reaches with its last frame
    #[arg(long, value_name = "VIEW", requires = "light")]
    light_to: Option<String>,
    /// How far on that way, from 0 to 1: 0 is --light, 1 is --light-to (half-way where not given)
    #[arg(long, value_name = "SHARE", requires = "light_to", allow_negative_numbers = true)]
    light_share: Option<f64>,
}

impl LightTo {
    /// The light of a path's last frame; `None` where nothing is said.
    ///
    /// # Errors
    /// For a share, which a path goes through from 0 to 1.
    pub fn of_path(self) -> anyhow::Result<Option<v1::Appearance>> {
        anyhow::ensure!(
            self.light_share.is_none(),
            "--light-share is for one picture; a path changes its light evenly"
        );
        Ok(self.light_to.map(|view| v1::Appearance { choice: Some(Choice::ViewName(view)) }))
    }
}

impl InLight {
    /// The camera that took the photograph, which is looked for in `scene`; `None` without one, and where it is given.
    ///
    /// # Errors
    /// As [`camera_of`].
    pub async fn found(&self, line: &Connection, scene: &str) -> anyhow::Result<Option<v1::Viewpoint>> {
        let is_given = self.taken_view.is_some() || self.taken_pose.is_some();
        let Some(path) = self.light_of.as_ref().filter(|_| !is_given) else { return Ok(None) };
        let found = camera_of(line, scene, path).await?;
        for said in in_words(&found)? {
            eprintln!("{}: {said}", path.display());
        }
        Ok(Some(v1::Viewpoint { from: found.camera.map(v1::viewpoint::From::Camera) }))
    }

    /// The light; `None` where nothing is said. `found` is what [`InLight::found`] gave.
    ///
    /// # Errors
    /// For a photograph or a camera's file that cannot be read.
    pub fn asked(&self, found: Option<v1::Viewpoint>) -> anyhow::Result<Option<v1::Appearance>> {
        let choice = match (&self.light_of, &self.light) {
            (Some(path), _) => {
                let given = || viewpoint(self.taken_view.clone(), self.taken_pose.as_deref());
                let viewpoint = Some(found.map_or_else(given, Ok)?);
                Some(Choice::Photograph(v1::PhotographAppearance { photograph: read(path)?.into(), viewpoint }))
            }
            (None, Some(view)) => Some(Choice::ViewName(view.clone())),
            (None, None) => None,
        };
        Ok(choice.map(|choice| v1::Appearance { choice: Some(choice) }))
    }

    /// The light, or one on the way from it; `None` where nothing is said.
    ///
    /// # Errors
    /// As [`InLight::asked`].
    pub fn asked_with(&self, way: LightTo, found: Option<v1::Viewpoint>) -> anyhow::Result<Option<v1::Appearance>> {
        let (Some(from_view), Some(to_view)) = (self.light.clone(), way.light_to) else { return self.asked(found) };
        let share = way.light_share.unwrap_or(HALF_WAY);
        Ok(Some(v1::Appearance { choice: Some(Choice::Blend(v1::AppearanceBlend { from_view, to_view, share })) }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        light: InLight,
        #[command(flatten)]
        way: LightTo,
    }

    fn asked(arguments: &[&str]) -> Result<Option<Choice>, String> {
        let line = Line::try_parse_from([&["cairn"], arguments].concat()).map_err(|e| e.to_string())?;
        let light = line.light.asked_with(line.way, None).map_err(|e| format!("{e:#}"))?;
        Ok(light.and_then(|light| light.choice))
    }

    #[test]
    fn a_light_is_a_views_between_two_or_a_photographs() {
        assert_eq!(asked(&[]), Ok(None));
        assert_eq!(asked(&["--light", "a"]), Ok(Some(Choice::ViewName("a".into()))));
        let blend = |share| {
            let (from_view, to_view) = ("a".into(), "b".into());
            Ok(Some(Choice::Blend(v1::AppearanceBlend { from_view, to_view, share })))
        };
        assert_eq!(asked(&["--light", "a", "--light-to", "b"]), blend(0.5));
        // What is out of range is for the services to refuse, by name.
        assert_eq!(asked(&["--light", "a", "--light-to", "b", "--light-share", "-1"]), blend(-1.0));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "picture").unwrap();
        let of = asked(&["--light-of", file.path().to_str().unwrap(), "--taken-view", "a"]);
        let from = Some(v1::viewpoint::From::ViewName("a".into()));
        let photograph =
            v1::PhotographAppearance { photograph: "picture".into(), viewpoint: Some(v1::Viewpoint { from }) };
        assert_eq!(of, Ok(Some(Choice::Photograph(photograph))));
    }

    #[test]
    fn halves_of_a_light_are_refused() {
        for (arguments, says) in [
            (&["--light-to", "b"][..], "--light <VIEW>"),
            (&["--light", "a", "--light-share", "0.5"], "--light-to <VIEW>"),
            (&["--taken-view", "a"], "--light-of <FILE>"),
            (&["--light-of", "x.png", "--taken-view", "a", "--taken-pose", "p"], "cannot be used with"),
            (&["--light-of", "x.png", "--taken-view", "a", "--light", "b"], "cannot be used with"),
            (&["--light-of", "/no/such.png", "--taken-view", "a"], "cannot read /no/such.png"),
        ] {
            let refused = asked(arguments).unwrap_err();
            assert!(refused.contains(says), "{arguments:?}: {refused}");
        }
    }
}
