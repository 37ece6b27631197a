//! What stands for the segmenter in a build without inference.

use std::path::Path;

use crate::capture::View;
use crate::error::{Error, Result};
use crate::progress::Progress;

/// A segmentation model with the classes that it tells apart: there is none without the feature `onnx`.
#[derive(Clone, Debug)]
pub enum Segmenter {}

impl Segmenter {
    /// An error that says how to get a build with inference.
    pub fn open(model: impl AsRef<Path>, _classes: &str) -> Result<Self> {
        let what = "cannot be run: this texir was built without ONNX inference; build it with `--features onnx`";
        Err(Error::file(model, what))
    }

    /// Never called: there is no segmenter.
    pub fn label(&self, _views: &mut [View], _folder: &Path, _progress: &dyn Progress) -> Result<()> {
        match *self {}
    }
}
