//! The folder of a finished fit: what is in it, and how it gets there whole.

mod edited;

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::atomic_file::{Stage, write_atomic};
use crate::brdf::Masking;
use crate::capture::Tbl;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::glb::{Materials, Up, write_glb};
use crate::image_io::{read_gray, read_rgb, write_gray, write_rgb};
use crate::mesh::Mesh;
use crate::mesh_io;
use crate::progress::Progress;
use crate::raster::{Gray, Rgb};
use crate::render::Textures;
use crate::text_file::read_text;

/// Linear albedo, OpenEXR.
pub const ALBEDO: &str = "albedo.exr";
/// Perceptual roughness, OpenEXR.
pub const ROUGHNESS: &str = "roughness.exr";
/// 1 where the surface is metal, OpenEXR; `texir fit --metallic` writes it.
pub const METALLIC: &str = "metallic.exr";
/// Irradiance E (cosine included, not divided by π), OpenEXR.
pub const IRRADIANCE: &str = "irradiance.exr";
/// Emitted radiance, OpenEXR.
pub const EMISSION: &str = "emission.exr";
/// How well the views know the roughness, 0 (a guess) to 1, OpenEXR; full mode writes it.
pub const CONFIDENCE: &str = "confidence.exr";
/// How the textures scatter light ([`Scattering`]), JSON.
pub const MATERIALS: &str = "materials.json";
/// Texture-based lighting, OpenEXR.
pub const HDR_TEXTURE: &str = "hdr_texture.exr";
/// Where the texture-based lighting was seen (255), inpainted (128), or is outside the charts (0), PNG; the name that
/// [`Tbl::mask_path`] gives.
pub const HDR_TEXTURE_MASK: &str = "hdr_texture_mask.png";
/// Floor plan with room ids, PNG.
pub const ROOMS: &str = "rooms.png";
/// The textured scene for viewers and engines.
pub const SCENE: &str = "scene.glb";
/// The mesh in the capture's own frame, which the textures belong to.
pub const MESH: &str = "mesh.obj";
/// [`crate::eval::Evaluation`], JSON.
pub const METRICS: &str = "metrics.json";
/// Every setting of the fit, TOML.
pub const SETTINGS: &str = "settings.toml";
/// One line per epoch of paper mode, JSON; full mode has none, and leaves it empty.
pub const LOG: &str = "log.jsonl";
/// [`Run`], JSON.
pub const RUN: &str = "run.json";
/// [`crate::capture::Corrections`] of the views, JSON; written where some were asked for.
pub const CORRECTIONS: &str = "corrections.json";
/// The report, HTML.
pub const REPORT: &str = "report.html";

/// Every file of the folder.
const FILES: [&str; 18] = [
    ALBEDO,
    ROUGHNESS,
    METALLIC,
    IRRADIANCE,
    EMISSION,
    CONFIDENCE,
    MATERIALS,
    HDR_TEXTURE,
    HDR_TEXTURE_MASK,
    ROOMS,
    SCENE,
    MESH,
    METRICS,
    SETTINGS,
    LOG,
    RUN,
    CORRECTIONS,
    REPORT,
];

/// How a fit came about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Version of texir.
    pub version: String,
    /// The capture's folder.
    pub capture: PathBuf,
    /// What ran the passes.
    pub backend: String,
    /// Phases in order, with the seconds that each took.
    pub timings: Vec<(String, f64)>,
}

/// The BRDF that the textures belong to, as far as it is not always the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Scattering {
    /// The diffuse model.
    pub diffuse: DiffuseModel,
    /// The shadowing–masking term.
    pub masking: Masking,
}

impl Scattering {
    fn read(path: &Path) -> Result<Self> {
        serde_json::from_str(&read_text(path)?)
            .map_err(|e| Error::file(path, format!("is not what `texir fit` writes ({e}); run the fit again")))
    }
}

/// What rendering a fit's result takes.
#[derive(Clone, Debug, PartialEq)]
pub struct FitOutput {
    /// The mesh, in the capture's frame.
    pub mesh: Mesh,
    /// Texture-based lighting.
    pub tbl: Tbl,
    /// Materials and light.
    pub textures: Textures,
    /// How well the views know the roughness, 0 (a guess) to 1, where the fit tells.
    pub confidence: Option<Gray>,
}

impl FitOutput {
    /// Writes mesh and textures.
    pub fn save(&self, folder: &Path) -> Result<()> {
        let Textures { albedo, roughness, metallic, irradiance, emission, diffuse, masking } = &self.textures;
        write_rgb(folder.join(ALBEDO), albedo)?;
        write_gray(folder.join(ROUGHNESS), roughness)?;
        if let Some(metallic) = metallic {
            write_gray(folder.join(METALLIC), metallic)?;
        }
        write_rgb(folder.join(IRRADIANCE), irradiance)?;
        write_rgb(folder.join(EMISSION), emission)?;
        if let Some(confidence) = &self.confidence {
            write_gray(folder.join(CONFIDENCE), confidence)?;
        }
        let scattering = Scattering { diffuse: *diffuse, masking: *masking };
        write_atomic(folder.join(MATERIALS), |sink| serde_json::to_writer_pretty(sink, &scattering))?;
        self.tbl.write(folder.join(HDR_TEXTURE))?;
        mesh_io::obj::write(folder.join(MESH), &self.mesh)
    }

    /// Writes mesh and materials as one GLB, for engines.
    pub fn write_scene(&self, path: &Path) -> Result<()> {
        let Textures { albedo, roughness, metallic, emission, .. } = &self.textures;
        let materials = Materials { albedo, roughness, metallic: metallic.as_ref(), emission: Some(emission) };
        write_glb(path, &self.mesh, &materials, Up::Z)
    }

    /// Reads what [`FitOutput::save`] wrote, and may have been edited since: texels that are no numbers are an error,
    /// values out of range are limited and warned about.
    pub fn load(folder: &Path, progress: &dyn Progress) -> Result<Self> {
        if !folder.join(ALBEDO).is_file() {
            return Err(Error::file(
                folder,
                format!("is not the output of a fit: it has no {ALBEDO}; expected the folder given to `texir fit -o`"),
            ));
        }
        let Scattering { diffuse, masking } = Scattering::read(&folder.join(MATERIALS))?;
        let rgb = |name: &str, range| -> Result<Rgb> {
            let path = folder.join(name);
            edited::checked(&path, read_rgb(&path)?, range, progress)
        };
        let gray = |name: &str| -> Result<Gray> {
            let path = folder.join(name);
            edited::checked(&path, read_gray(&path)?, edited::SHARE, progress)
        };
        let optional = |name: &str| folder.join(name).is_file().then(|| gray(name)).transpose();
        let textures = Textures {
            diffuse,
            masking,
            albedo: rgb(ALBEDO, edited::SHARE)?,
            roughness: gray(ROUGHNESS)?,
            metallic: optional(METALLIC)?,
            irradiance: rgb(IRRADIANCE, edited::LIGHT)?,
            emission: rgb(EMISSION, edited::LIGHT)?,
        };
        let shape = textures.irradiance.size();
        edited::same_shape(&folder.join(ALBEDO), textures.albedo.size(), shape)?;
        edited::same_shape(&folder.join(ROUGHNESS), textures.roughness.size(), shape)?;
        if let Some(metallic) = &textures.metallic {
            edited::same_shape(&folder.join(METALLIC), metallic.size(), shape)?;
        }
        let confidence = optional(CONFIDENCE)?;
        let tbl = Tbl::read(folder.join(HDR_TEXTURE), progress)?;
        Ok(Self { mesh: mesh_io::read_mesh(folder.join(MESH))?.mesh, tbl, textures, confidence })
    }
}

/// Output that appears when all of it is there: files are written to a folder that nobody looks into, and moved to the
/// target, at once where that is new. In one that is there, they replace an earlier fit's one by one, while it lacks
/// the file without which no fit can be read.
#[derive(Debug)]
pub struct Staging(Stage);

impl Staging {
    /// Prepares to fill `target`, which may exist; missing folders above it are made.
    pub fn new(target: &Path) -> Result<Self> {
        let stage = Stage::new(target)?;
        match FILES.map(|name| stage.target().join(name)).into_iter().find(|path| path.is_dir()) {
            Some(folder) => {
                Err(Error::file(folder, "is a folder; expected a file, which will be replaced, or nothing"))
            }
            None => Ok(Self(stage)),
        }
    }

    /// The folder to write to.
    pub fn folder(&self) -> PathBuf {
        self.0.folder()
    }

    /// The folder where steps towards the target are kept: beside it, or in it where it is there already.
    pub fn partial(&self) -> PathBuf {
        let target = self.0.target();
        if target.is_dir() {
            return target.join("partial");
        }
        let mut name = target.file_name().unwrap_or("texir".as_ref()).to_owned();
        name.push(".partial");
        target.with_file_name(name)
    }

    /// Moves the files to the target: the folder as a whole where there is none yet. Files of the layout that an
    /// earlier run left there and this one did not make are removed: they describe another result.
    pub fn commit(self) -> Result<()> {
        if !self.0.target().exists() {
            return self.0.place_whole();
        }
        let is_new = |name: &str| self.folder().join(name).exists();
        let remove = |name: &str| {
            let old = self.0.target().join(name);
            if old.exists() { fs::remove_file(&old).map_err(|e| Error::cannot_write(&old, e)) } else { Ok(()) }
        };
        remove(MATERIALS)?;
        for name in FILES.into_iter().filter(|name| *name != MATERIALS) {
            if is_new(name) { self.0.place(name)? } else { remove(name)? }
        }
        if is_new(MATERIALS) { self.0.place(MATERIALS) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3};

    use super::*;
    use crate::capture::Coverage;
    use crate::progress::Silent;
    use crate::raster::Raster;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn outputs_appear_all_at_once() {
        let root = tempfile::tempdir().unwrap();
        let target = root.path().join("deep/out");
        let staging = Staging::new(&target).unwrap();
        fs::write(staging.folder().join(ALBEDO), "new").unwrap();
        assert!(!target.exists());
        staging.commit().unwrap();
        assert_eq!(names(&target), [ALBEDO]);
        assert_eq!(names(target.parent().unwrap()), ["out"]);
    }

    #[test]
    fn an_interrupted_run_leaves_nothing() {
        let root = tempfile::tempdir().unwrap();
        let staging = Staging::new(&root.path().join("out")).unwrap();
        fs::write(staging.folder().join(ALBEDO), "half").unwrap();
        drop(staging);
        assert!(names(root.path()).is_empty());
    }

    #[test]
    fn stale_outputs_go_and_other_files_stay() {
        let root = tempfile::tempdir().unwrap();
        for name in [METRICS, ALBEDO, "notes.txt"] {
            fs::write(root.path().join(name), "old").unwrap();
        }
        let staging = Staging::new(root.path()).unwrap();
        // The target may be another disk than the folder that it lies in.
        assert!(staging.folder().starts_with(root.path()));
        fs::write(staging.folder().join(ALBEDO), "new").unwrap();
        staging.commit().unwrap();
        assert_eq!(names(root.path()), [ALBEDO, "notes.txt"]);
        assert_eq!(fs::read_to_string(root.path().join(ALBEDO)).unwrap(), "new");
    }

    #[test]
    fn a_fit_that_is_half_replaced_is_none() {
        let root = tempfile::tempdir().unwrap();
        for name in [ALBEDO, MATERIALS] {
            fs::write(root.path().join(name), "old").unwrap();
        }
        // A file of the layout that cannot be replaced ends the move in its middle.
        let staging = Staging::new(root.path()).unwrap();
        for name in [ALBEDO, ROUGHNESS, MATERIALS] {
            fs::write(staging.folder().join(name), "new").unwrap();
        }
        fs::create_dir(root.path().join(ROUGHNESS)).unwrap();
        staging.commit().unwrap_err();
        assert_eq!(fs::read_to_string(root.path().join(ALBEDO)).unwrap(), "new");
        assert!(!root.path().join(MATERIALS).exists());
    }

    #[test]
    fn edited_textures_are_checked_when_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let [albedo, irradiance, emission] = [0.5, 1.0, 0.0].map(|v| Rgb::filled(4, 4, [v; 3]));
        let (diffuse, masking, roughness) = (DiffuseModel::Lambert, Masking::Smith, Gray::filled(4, 4, 0.5));
        let textures = Textures { albedo, roughness, metallic: None, irradiance, emission, diffuse, masking };
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
            triangles: vec![[0, 1, 2]],
        };
        let tbl = Tbl { radiance: textures.irradiance.clone(), coverage: Raster::filled(4, 4, Coverage::Seen) };
        let output = FitOutput { mesh, tbl, textures, confidence: None };
        output.save(folder.path()).unwrap();
        assert_eq!(FitOutput::load(folder.path(), &Silent).unwrap(), output);
        for (name, value, limited) in [(ALBEDO, 1.5, 1.0), (IRRADIANCE, -1.0, 0.0), (EMISSION, -1.0, 0.0)] {
            let path = folder.path().join(name);
            let whole = fs::read(&path).unwrap();
            write_rgb(&path, &Rgb::filled(4, 4, [value; 3])).unwrap();
            let Textures { albedo, irradiance, emission, .. } =
                FitOutput::load(folder.path(), &Silent).unwrap().textures;
            let read = [(ALBEDO, albedo), (IRRADIANCE, irradiance), (EMISSION, emission)];
            let read = read.iter().find(|(of, _)| *of == name).unwrap();
            assert_eq!(read.1.data, [[limited; 3]; 16], "{name}");
            fs::write(&path, whole).unwrap();
        }
        // Of another size, but not of another shape.
        write_rgb(folder.path().join(ALBEDO), &Rgb::filled(8, 8, [0.5; 3])).unwrap();
        assert_eq!(FitOutput::load(folder.path(), &Silent).unwrap().textures.albedo.width, 8);
        for name in [ALBEDO, ROUGHNESS] {
            let whole = fs::read(folder.path().join(name)).unwrap();
            write_gray(folder.path().join(name), &Gray::filled(4, 3, 0.5)).unwrap();
            let error = FitOutput::load(folder.path(), &Silent).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("4×3"), "{error}");
            fs::write(folder.path().join(name), whole).unwrap();
        }
        write_gray(folder.path().join(ROUGHNESS), &Gray::filled(4, 4, f32::NAN)).unwrap();
        let error = FitOutput::load(folder.path(), &Silent).unwrap_err().to_string();
        assert!(error.contains(ROUGHNESS) && error.contains("16 of 16 texels"), "{error}");
    }

    #[test]
    fn a_file_in_the_way_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = Staging::new(file.path()).unwrap_err().to_string();
        assert!(error.contains(&file.path().display().to_string()), "{error}");
        let folder = tempfile::tempdir().unwrap();
        assert!(FitOutput::load(folder.path(), &Silent).unwrap_err().to_string().contains("albedo.exr"));
    }
}
