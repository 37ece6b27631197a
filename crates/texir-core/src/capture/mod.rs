//! A capture: a mesh, posed HDR views, and what is known about them. [`load`](fn@load) reads texir's own folder;
//! [`import`] makes one of other programs' files.

mod black;
mod classes;
mod corrections;
mod files;
pub mod import;
mod lens;
mod load;
pub mod nerfstudio;
mod pose;
pub mod segment;
mod sharpen;
mod shot;
pub mod survey;
mod tbl_file;
mod upright;
mod view;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use self::classes::{Class, Classes};
pub use self::corrections::Corrections;
pub use self::lens::Distortion;
pub use self::load::load;
pub use self::shot::Shot;
use crate::camera::Camera;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::raster::{Raster, Rgb};

/// What a view is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// The fit sees it.
    Train,
    /// Held out: novel-view evaluation.
    Novel,
}

/// A posed image and the images that annotate it. Pixels are read when asked for: a capture may not fit in memory.
#[derive(Clone, Debug)]
pub struct View {
    /// File stem, unique within the capture.
    pub name: String,
    /// Pose and projection.
    pub camera: Camera,
    /// Training or held out.
    pub split: Split,
    /// Linear radiance.
    pub image: PathBuf,
    /// What the image's radiance is multiplied with, per channel: 1, unless exposures were solved for
    /// ([`crate::tbl::exposure`]).
    pub scale: [f32; 3],
    /// Variance of the images' point spread beyond that of a pixel, square pixels of the file along each axis, which
    /// [`View::load_image`] undoes: 0, unless it was measured ([`crate::tbl::blur`]).
    pub blur: f32,
    /// Pixels of the files along the edge of a pixel of the view: 1, unless it was [reduced](View::reduced).
    pub reduction: usize,
    /// Semantic class per pixel; 0 is "unknown".
    pub semantic: Option<PathBuf>,
    /// What the classes are called and how they are coloured, where the capture says so.
    pub classes: Option<Arc<Classes>>,
    /// Pixels to use (non-zero); excludes emitters, the rig, misses.
    pub mask: Option<PathBuf>,
    /// Room id per pixel; 0 is "unknown".
    pub room: Option<PathBuf>,
    /// Room id of the whole view, when given.
    pub room_id: Option<u16>,
    /// Ground-truth albedo, linear.
    pub albedo: Option<PathBuf>,
    /// Ground-truth perceptual roughness.
    pub roughness: Option<PathBuf>,
}

/// Texture-based lighting: the mesh's outgoing radiance in its atlas.
#[derive(Clone, Debug, PartialEq)]
pub struct Tbl {
    /// Linear radiance per texel; 0 outside the charts, apart from a gutter that repeats their borders.
    pub radiance: Rgb,
    /// How each texel came to be known.
    pub coverage: Raster<Coverage>,
}

/// How a TBL texel came to be known. Stored as a grey level: 255, 128, 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// Seen by at least one view.
    Seen,
    /// Filled from its neighbours.
    Inpainted,
    /// Outside the charts.
    Outside,
}

/// Ground-truth textures in the capture's atlas, where there are any. They are read when asked for: a fit does without.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Linear albedo.
    pub albedo: PathBuf,
    /// Perceptual roughness.
    pub roughness: PathBuf,
}

/// A capture folder, validated.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The folder.
    pub root: PathBuf,
    /// The mesh file that was read.
    pub mesh_path: PathBuf,
    /// The mesh with its atlas.
    pub mesh: Mesh,
    /// All views, training and novel.
    pub views: Vec<View>,
    /// `hdr_texture.exr`, when given ([`Tbl::read`]); otherwise the TBL is built from the views.
    pub tbl: Option<PathBuf>,
    /// Ground-truth textures, when given.
    pub truth: Option<Truth>,
}

/// Overrides of what is found in the folder.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// Use this mesh instead of the folder's.
    pub mesh: Option<PathBuf>,
    /// Use this HDR texture instead of the folder's.
    pub tbl: Option<PathBuf>,
}

impl Capture {
    /// The views of one split.
    pub fn views(&self, split: Split) -> impl Iterator<Item = &View> {
        self.views.iter().filter(move |v| v.split == split)
    }

    /// The files that it is made of: no output may replace one.
    pub fn files(&self) -> Vec<PathBuf> {
        let truth = self.truth.iter().flat_map(|truth| [&truth.albedo, &truth.roughness]);
        let of_folder = std::iter::once(&self.mesh_path).chain(&self.tbl).chain(truth);
        let of_views = self.views.iter().flat_map(View::files).map(|(_, path)| path.to_owned());
        std::iter::once(self.root.join("transforms.json")).chain(of_folder.cloned()).chain(of_views).collect()
    }
}

/// Posed views alone, from any camera file that texir reads: for rendering. Their images need not exist.
pub fn load_cameras(path: impl AsRef<Path>) -> Result<Vec<View>> {
    nerfstudio::read_transforms(path)
}

#[cfg(test)]
pub(crate) mod tests;
