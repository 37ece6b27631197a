//! Finds the parts of a capture folder, reads what fits in memory, and checks that the rest is whole.

use std::path::{Path, PathBuf};

use glam::Vec3;
use rayon::prelude::*;

use super::{Capture, LoadOptions, Split, Truth, View, import, nerfstudio};
use crate::error::{Error, Result};
use crate::image_io::{check_whole, read_rgb, read_size};
use crate::mesh::Mesh;
use crate::mesh_io::{atlas_report, read_mesh};
use crate::progress::Progress;

/// Looked for in this order.
const MESH_NAMES: [&str; 4] = ["mesh.obj", "mesh.glb", "mesh.gltf", "mesh.ply"];
/// The atlas is checked for overlaps at this many texels squared.
pub(super) const ATLAS_CHECK_SIZE: usize = 1024;

/// Reads and checks a capture folder: `transforms.json`, a mesh, and `hdr_texture.exr`, `albedo_tex.exr` with
/// `roughness_tex.exr`, `emission_tex.exr` where they exist. All but the mesh stays on disk; files are checked to be there,
/// whole and of the right size.
///
/// What can be worked with is warned about; what cannot is an error that names the file and the field.
pub fn load(folder: impl AsRef<Path>, options: &LoadOptions, progress: &dyn Progress) -> Result<Capture> {
    let root = folder.as_ref().to_owned();
    if !root.is_dir() {
        return Err(Error::file(&root, "is no folder; expected a capture: transforms.json, a mesh and its images"));
    }
    if !root.join("transforms.json").exists() {
        let importer = import::detect(&root, None)?;
        let what = format!("is no capture yet, but files of {}; make a capture of it: `texir import`", importer.name());
        return Err(Error::file(&root, what));
    }
    let views = nerfstudio::read_transforms(root.join("transforms.json"))?;
    if !views.iter().any(|v| v.split == Split::Train) {
        return Err(Error::file(
            root.join("transforms.json"),
            format!("split: none of the {} views is for training; expected at least one \"train\"", views.len()),
        ));
    }
    progress.start("checking files", views.len() as u64, "views");
    views.par_iter().try_for_each(|view| {
        progress.check()?;
        view.check_files()?;
        progress.advance(1);
        Ok(())
    })?;
    progress.finish();
    check_light(&root, &views, progress)?;

    let mesh_path = match &options.mesh {
        Some(path) => path.clone(),
        None => find_mesh(&root)?,
    };
    progress.check()?;
    let file = read_mesh(&mesh_path)?;
    file.warnings.iter().for_each(|w| progress.warn(w));
    let mesh = file.mesh;
    warn_about_atlas(&mesh_path, &mesh, progress);
    warn_about_positions(&root, &views, &mesh, progress);

    let existing = |name: &str| Some(root.join(name)).filter(|path| path.is_file());
    let tbl = options.tbl.clone().or_else(|| existing("hdr_texture.exr"));
    let truth = match (existing("albedo_tex.exr"), existing("roughness_tex.exr")) {
        (Some(albedo), Some(roughness)) => Some(truth(albedo, roughness)?),
        (None, None) => None,
        (Some(one), None) | (None, Some(one)) => {
            progress.warn(&format!(
                "{}: ground truth needs both albedo_tex.exr and roughness_tex.exr; the one alone is not used",
                one.display()
            ));
            None
        }
    };
    let emission = existing("emission_tex.exr");
    tbl.iter().chain(&emission).try_for_each(check_whole)?;
    Ok(Capture { root, mesh_path, mesh, views, tbl, truth, emission })
}

fn find_mesh(root: &Path) -> Result<PathBuf> {
    MESH_NAMES.iter().map(|name| root.join(name)).find(|path| path.is_file()).ok_or_else(|| {
        Error::file(root, format!("has no mesh; expected one of {}, or name one with --mesh", MESH_NAMES.join(", ")))
    })
}

/// At least one training view must hold light. Views are decoded only until one does.
fn check_light(root: &Path, views: &[View], progress: &dyn Progress) -> Result<()> {
    let training: Vec<&View> = views.iter().filter(|v| v.split == Split::Train).collect();
    for view in &training {
        progress.check()?;
        // What is wrong with single pixels is said when the view is used.
        let image = read_rgb(&view.image)?;
        if image.data.iter().any(|pixel| pixel.iter().all(|v| v.is_finite()) && pixel.iter().any(|v| *v > 0.0)) {
            return Ok(());
        }
    }
    Err(Error::file(
        root.join("transforms.json"),
        format!(
            "file_path: all {} training images are black: there is no light to explain; expected linear radiance above 0",
            training.len()
        ),
    ))
}

fn warn_about_atlas(path: &Path, mesh: &Mesh, progress: &dyn Progress) {
    for problem in atlas_report(mesh, ATLAS_CHECK_SIZE).problems() {
        progress.warn(&format!("{}: {problem}; `texir import --unwrap` makes a new atlas", path.display()));
    }
}

fn warn_about_positions(root: &Path, views: &[View], mesh: &Mesh, progress: &dyn Progress) {
    let (low, high) = mesh.bounds();
    let inside = |p: Vec3| p.cmpge(low).all() && p.cmple(high).all();
    let outside: Vec<&View> = views.iter().filter(|v| !inside(v.camera.position())).collect();
    if let Some(first) = outside.first() {
        progress.warn(&format!(
            "{}: transform_matrix: {} of {} cameras are outside of the mesh's bounds {low} to {high}, the first is {:?} at \
             {}: are mesh and cameras in the same frame and in metres?",
            root.join("transforms.json").display(),
            outside.len(),
            views.len(),
            first.name,
            first.camera.position()
        ));
    }
}

fn truth(albedo: PathBuf, roughness: PathBuf) -> Result<Truth> {
    let (of_albedo, of_roughness) = (read_size(&albedo)?, read_size(&roughness)?);
    if of_albedo != of_roughness {
        return Err(Error::file(
            &roughness,
            format!("is {of_roughness:?} texels; expected {of_albedo:?}, as {} has", albedo.display()),
        ));
    }
    [&albedo, &roughness].into_iter().try_for_each(check_whole)?;
    Ok(Truth { albedo, roughness })
}
