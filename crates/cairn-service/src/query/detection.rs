//! What a picture says: read by the detector, or by registration with the scene's field.

use std::sync::Arc;

use cairn_mark::RegisteredReader;
use cairn_register::Index;
use cairn_scene::{Camera, Picture};

use crate::error::EngineError;
use crate::store::classes::{Found, Registered};
use crate::store::model::Mark;

impl Mark {
    /// Classifies `picture` (any size) and recovers what it hides.
    ///
    /// # Errors
    /// As [`cairn_mark::Detector::detect`].
    pub fn detect(&self, picture: &Picture) -> Result<Found, EngineError> {
        Ok(self.classes.found(self.detector.detect(picture)?))
    }

    /// As [`Mark::detect`], with the picture registered with the field as well, at `from` where
    /// that is known, else where the index of `places` finds it: a mark that stands out there is believed, and where
    /// none does, or no place is found, the classifier answers. What is hidden comes from the detector, told that
    /// answer. The search is given up, and the classifier answers, once it is no longer `wanted`.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for pictures that show too little; [`EngineError::WrongState`]
    /// where nothing can be registered with this field; as [`cairn_mark::Detector::detect`].
    pub fn detect_registered(
        &self,
        picture: &Picture,
        places: Option<Arc<Index>>,
        from: Option<&Camera>,
        wanted: &dyn Fn() -> bool,
    ) -> Result<Found, EngineError> {
        let (width, height) = (picture.width(), picture.height());
        if !RegisteredReader::can_tell(width, height) {
            let allowed = "64 x 64 px or more, to be registered with a field";
            return Err(EngineError::invalid("the picture", format!("{width} x {height} px"), allowed));
        }
        let reader = RegisteredReader::new(&self.field, places).ok_or_else(|| {
            let why = "the field's densities moved with the marks (mark.density); ask without registration, and the \
                       classifier answers";
            EngineError::wrong_state("the picture", "registered with the scene's field", why)
        })?;
        let reading = match reader.read(&self.field, picture, from, wanted) {
            Ok(reading) => reading,
            Err(why) => return Ok(Found { registered: Some(Err(why)), ..self.detect(picture)? }),
        };
        let (explained, believed) = (reading.registered.explained, reading.identity());
        let registered = Some(Ok(Registered { explained, scores: reading.scores.clone(), believed }));
        let Some(number) = believed else {
            return Ok(Found { registered, ..self.detect(picture)? });
        };
        let mut detection = self.detector.detect_forced(picture, self.classes.of(number))?;
        detection.identity = Some(number);
        detection.probabilities = reading.probabilities();
        let confidence = detection.probabilities[number as usize];
        Ok(Found { identity: Some(number), elsewhere: None, confidence, registered, detection })
    }

    /// As [`Mark::detect`], with the scene's identity `number` told to the detector in place of the
    /// classifier's answer.
    ///
    /// # Errors
    /// As [`cairn_mark::Detector::detect_forced`].
    pub fn detect_forced(&self, picture: &Picture, number: u32) -> Result<Found, EngineError> {
        Ok(self.classes.found(self.detector.detect_forced(picture, self.classes.of(number))?))
    }
}
