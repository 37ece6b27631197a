//! nerfstudio's folder: `transforms.json` with the images that it names. texir's own capture is one without lens
//! distortion.

use std::path::Path;

use glam::Vec3;

use super::{Importer, Source};
use crate::capture::files;
use crate::capture::nerfstudio::read_shots;
use crate::error::Result;

/// See the module.
pub(super) struct Nerfstudio;

/// Textures that a capture folder may hold beside its views.
const TEXTURES: [&str; 5] =
    ["hdr_texture.exr", "hdr_texture_mask.png", "albedo_tex.exr", "roughness_tex.exr", "emission_tex.exr"];

impl Importer for Nerfstudio {
    fn name(&self) -> &'static str {
        "nerfstudio"
    }

    fn signature(&self) -> &'static str {
        "transforms.json"
    }

    fn detects(&self, folder: &Path) -> bool {
        folder.join("transforms.json").is_file()
    }

    fn read(&self, folder: &Path) -> Result<Source> {
        let textures = TEXTURES.map(|name| (name, folder.join(name)));
        Ok(Source {
            shots: read_shots(&folder.join("transforms.json"))?,
            mesh: files::mesh(folder),
            textures: textures.into_iter().filter(|(_, path)| path.is_file()).collect(),
            up: Some(Vec3::Z),
            metres_per_unit: Some(1.0),
            assumed: vec![
                "poses are camera-to-world with OpenGL axes (−Z forward, +Y up), as nerfstudio writes them".into(),
            ],
        })
    }
}
