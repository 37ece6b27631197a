//! nerfstudio's folder: `transforms.json` with the images that it names. texir's own capture is one without lens
//! distortion.

use std::path::Path;

use glam::Vec3;

use super::{Importer, Source};
use crate::capture::nerfstudio::read_shots;
use crate::capture::{Shot, files};
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
        let mut shots = read_shots(&folder.join("transforms.json"))?;
        for Shot { view, .. } in &mut shots {
            let path = view.image.strip_prefix(folder).unwrap_or(&view.image);
            view.image = files::rather_linear(folder, path);
        }
        Ok(Source {
            shots,
            mesh: files::mesh(folder),
            textures: textures.into_iter().filter(|(_, path)| path.is_file()).collect(),
            up: Some(Vec3::Z),
            // Metres where a device measured them; ns-process-data leaves COLMAP's unit as it is.
            metres_per_unit: None,
            assumed: vec![
                "poses are camera-to-world with OpenGL axes (−Z forward, +Y up), as nerfstudio writes them".into(),
            ],
        })
    }
}
