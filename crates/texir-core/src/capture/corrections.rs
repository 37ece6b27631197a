//! What was corrected in the views of a capture, as a file beside what was made of them: whoever compares with the
//! views later has to see them corrected as well.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Capture, Split, View, pose};
use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::tbl::blur;
use crate::text_file::read_text;

/// Corrected views by name, as JSON.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Corrections(BTreeMap<String, Correction>);

/// One view as it was used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Correction {
    /// [`View::scale`].
    scale: [f32; 3],
    /// [`View::blur`].
    #[serde(default)]
    blur: f32,
    /// Camera to world, as `transforms.json` has it.
    transform_matrix: Vec<Vec<f64>>,
}

impl Corrections {
    /// Exposure, blur and pose of the training views as they are now.
    pub fn of(capture: &Capture) -> Self {
        let correction = |view: &View| Correction {
            scale: view.scale,
            blur: view.blur,
            transform_matrix: pose::to_rows(view.camera.world_from_camera),
        };
        Self(capture.views(Split::Train).map(|view| (view.name.clone(), correction(view))).collect())
    }

    /// Corrects the views of these names. Those that the capture does not have are warned about: it may be another one.
    pub fn apply(&self, capture: &mut Capture, progress: &dyn Progress) -> Result<()> {
        let mut unknown: Vec<&str> = Vec::new();
        for (name, correction) in &self.0 {
            let Some(view) = capture.views.iter_mut().find(|view| view.name == *name) else {
                unknown.push(name);
                continue;
            };
            let Correction { scale, blur, transform_matrix } = correction;
            if !scale.iter().all(|s| s.is_finite() && *s > 0.0) {
                return Err(Error::invalid(format!(
                    "the correction of view {name:?} has the scale {scale:?}; expected three positive numbers"
                )));
            }
            if !(0.0..=blur::WIDEST).contains(blur) {
                return Err(Error::invalid(format!(
                    "the correction of view {name:?} has the blur {blur}; expected 0 to {} square pixels",
                    blur::WIDEST
                )));
            }
            let wrong = |e| Error::invalid(format!("the correction of view {name:?}: transform_matrix {e}"));
            view.scale = *scale;
            view.blur = *blur;
            view.camera.world_from_camera = pose::from_rows(transform_matrix).map_err(wrong)?.as_mat4();
        }
        if let Some(first) = unknown.first() {
            progress.warn(&format!(
                "{}: {} of {} views that the fit corrected are not there, the first is {first:?}: is it another capture?",
                capture.root.display(),
                unknown.len(),
                self.0.len()
            ));
        }
        Ok(())
    }

    /// Reads what [`Corrections::write`] wrote; without the file nothing is corrected.
    pub fn read(path: &Path) -> Result<Self> {
        if !path.exists() {
            return Ok(Self::default());
        }
        serde_json::from_str(&read_text(path)?).map_err(|e| {
            Error::file(
                path,
                format!("is not what `texir fit` writes ({e}); expected scale and transform_matrix by view"),
            )
        })
    }

    /// Writes the file.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_atomic(path, |sink| serde_json::to_writer_pretty(sink, self))
    }
}
