//! Captures of other programs, read as what they are and written as texir's: one file per format, one line in
//! [`IMPORTERS`].
//!
//! A format's module says what is in its files, in its own frame and units. Everything after that is common: what is up
//! and how long a metre is (`frame`), and the capture folder, without lens distortion (`write`).

mod atlas;
mod blender;
mod colmap;
mod frame;
mod gltf;
mod matterport;
mod nerfstudio;
mod numbers;
mod panoramas;
mod texir_authors;
mod truth;
mod up;
mod write;

use std::path::{Path, PathBuf};

use glam::Vec3;

pub use self::write::{Written, check_vacant, write};
use super::Capture;
use super::segment::Segmenter;
use crate::capture::{Shot, files, upright};
use crate::error::{Error, Result};
use crate::image_io::TransferCurve;
use crate::mesh::Mesh;
use crate::mesh_io::{MeshFile, read_surface};
use crate::progress::Progress;

/// One capture format of another program.
pub trait Importer: Sync {
    /// What users call it: on the command line, in what `texir inspect` prints.
    fn name(&self) -> &'static str;
    /// The files that give the format away, for people.
    fn signature(&self) -> &'static str;
    /// True when the folder holds those files. Looks at names, reads as little as possible.
    fn detects(&self, folder: &Path) -> bool;
    /// Reads cameras, and finds the files that belong to them. Images are opened for their sizes at most.
    fn read(&self, folder: &Path) -> Result<Source>;
}

/// All formats, the most specific first: the first that recognises a folder reads it.
pub const IMPORTERS: &[&dyn Importer] = &[
    &nerfstudio::Nerfstudio,
    &texir_authors::TexirAuthors,
    &matterport::Matterport,
    &blender::Blender,
    &panoramas::Panoramas,
    &colmap::Colmap,
    &gltf::Gltf,
];

/// What an importer found, in the source's own world frame and units; cameras with OpenGL axes.
#[derive(Clone, Debug)]
pub struct Source {
    /// The cameras with their files.
    pub shots: Vec<Shot>,
    /// The mesh, when the format has a place for it and it is there.
    pub mesh: Option<PathBuf>,
    /// Textures in the mesh's atlas, with the names that a capture folder gives them (`hdr_texture.exr`).
    pub textures: Vec<(&'static str, PathBuf)>,
    /// The direction against gravity, when the format says so; otherwise the cameras tell.
    pub up: Option<Vec3>,
    /// Length of a unit, when the format says so; otherwise taken for a metre.
    pub metres_per_unit: Option<f64>,
    /// What was taken for granted, in sentences for the user.
    pub assumed: Vec<String>,
}

/// What the user says about a source; each wins over what was found.
#[derive(Clone, Debug, Default)]
pub struct ImportOptions {
    /// The format's [`Importer::name`], instead of detecting it.
    pub format: Option<String>,
    /// The mesh, in the frame of the cameras.
    pub mesh: Option<PathBuf>,
    /// The direction against gravity, in the source's frame.
    pub up: Option<Vec3>,
    /// Length of the source's unit in metres.
    pub metres_per_unit: Option<f64>,
    /// How 8 and 16-bit images encode linear light; without it they are refused.
    pub curve: Option<TransferCurve>,
    /// Reduce the mesh to so many triangles, and give it a new atlas.
    pub decimate: Option<usize>,
    /// Give the mesh a new atlas even if its own is one.
    pub unwrap: bool,
    /// Link to images that need no change, instead of copying them.
    pub link: bool,
    /// Makes the semantic images, instead of those of the source.
    pub segmenter: Option<Segmenter>,
}

/// A source in texir's frame: metres, +Z up. Lenses are as they were.
#[derive(Clone, Debug)]
pub struct Import {
    /// The folder.
    pub root: PathBuf,
    /// Name of the format.
    pub format: &'static str,
    /// The cameras with their files.
    pub shots: Vec<Shot>,
    /// The mesh, placed like the cameras.
    pub mesh: Mesh,
    /// The file that it was read from.
    pub mesh_path: PathBuf,
    /// Textures in the mesh's atlas, with the names that a capture folder gives them.
    pub textures: Vec<(&'static str, PathBuf)>,
    /// What was taken for granted, in sentences for the user.
    pub assumed: Vec<String>,
}

/// The format of a folder: the first that recognises it, or the one that is asked for.
pub fn detect(folder: &Path, format: Option<&str>) -> Result<&'static dyn Importer> {
    if !folder.is_dir() {
        return Err(Error::file(folder, "is no folder; expected the folder of a capture"));
    }
    let found = match format {
        Some(name) => IMPORTERS.iter().find(|i| i.name() == name),
        None => IMPORTERS.iter().find(|i| i.detects(folder)),
    };
    let formats =
        || IMPORTERS.iter().map(|i| format!("{} ({})", i.name(), i.signature())).collect::<Vec<_>>().join("; ");
    found.copied().ok_or_else(|| match format {
        Some(name) => Error::invalid(format!("format is {name:?}; expected one of: {}", formats())),
        None => Error::file(folder, format!("holds no capture that texir knows; expected one of: {}", formats())),
    })
}

/// True when the folder is a capture already: images are linear and without lens distortion, so that nothing needs to
/// be imported.
pub fn is_capture(folder: impl AsRef<Path>) -> Result<bool> {
    let folder = folder.as_ref();
    if detect(folder, None)?.name() != nerfstudio::Nerfstudio.name() {
        return Ok(false);
    }
    let is_ready = |shot: &Shot| shot.distortion.is_none() && !files::is_encoded(&shot.view.image);
    Ok(super::nerfstudio::read_shots(&folder.join("transforms.json"))?.iter().all(is_ready))
}

/// Reads a folder of any known format and places it in texir's frame.
pub fn read(folder: impl AsRef<Path>, options: &ImportOptions, progress: &dyn Progress) -> Result<Import> {
    let folder = folder.as_ref();
    let importer = detect(folder, options.format.as_deref())?;
    let source = importer.read(folder)?;
    if source.shots.is_empty() {
        return Err(Error::file(
            folder,
            format!("has no camera in its {} files; expected posed images", importer.name()),
        ));
    }
    let mesh_path = options.mesh.clone().or_else(|| source.mesh.clone()).ok_or_else(|| {
        Error::file(folder, "has no mesh, or several; expected mesh.obj, .glb or .ply, or one named with --mesh")
    })?;
    let (MeshFile { mut mesh, warnings }, unplaced) = read_surface(&mesh_path)?;
    warnings.iter().for_each(|w| progress.warn(w));
    // Their charts would be as many again, and share the views with those of the first.
    let repeated = mesh.drop_repeated();
    if repeated > 0 {
        progress.warn(&format!("{}: {repeated} triangles are there twice, and dropped", mesh_path.display()));
    }
    // Before anything is placed: what an exporter turned was the mesh alone, in the cameras' own frame.
    let places = source.shots.iter().map(|shot| shot.view.camera.position());
    let mesh = upright::among_cameras(&mesh_path, mesh, places, progress);
    let Source { mut shots, textures, mut assumed, .. } = source.clone();
    let texir_from_source = frame::Similarity::of(&source, options, &mut assumed)?;
    shots.iter_mut().for_each(|shot| shot.view.camera = texir_from_source.place_camera(&shot.view.camera));
    let mesh = texir_from_source.place_mesh(mesh);
    let mut import =
        Import { root: folder.to_owned(), format: importer.name(), shots, mesh, mesh_path, textures, assumed };
    let reduced = match options.decimate {
        Some(target) => atlas::reduce(&mut import, target, progress)?,
        None => None,
    };
    if let Some(why) = reduced.or_else(|| atlas::lacking(&import, unplaced, options)) {
        atlas::renew(&mut import, &why, progress)?;
    }
    Ok(import)
}

impl Import {
    /// The capture as it would be after an import, for a look at it: lenses count as pinholes, textures are left out.
    pub fn preview(&self) -> Capture {
        Capture {
            root: self.root.clone(),
            mesh_path: self.mesh_path.clone(),
            mesh: self.mesh.clone(),
            views: self.shots.iter().map(|shot| shot.view.clone()).collect(),
            tbl: None,
            truth: None,
        }
    }
}

#[cfg(test)]
mod tests;
