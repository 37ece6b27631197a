//! Views as cameras take them, through lenses.

use std::path::PathBuf;

use super::View;
use super::lens::Distortion;

/// A view, and the lens that it was taken through.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Pose, intrinsics and files. A pinhole's intrinsics are those of the image as it is, distorted.
    pub view: View,
    /// How the lens deviates from the pinhole.
    pub distortion: Option<Distortion>,
    /// An image whose fully transparent pixels are not used.
    pub opacity: Option<PathBuf>,
}

impl From<View> for Shot {
    fn from(view: View) -> Self {
        Self { view, distortion: None, opacity: None }
    }
}
