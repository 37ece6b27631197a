//! Finds the parts of a capture folder, reads what fits in memory, and checks that the rest is whole.

use std::path::{Path, PathBuf};

use glam::Vec3;
use rayon::prelude::*;

use super::{Capture, LoadOptions, Split, Truth, View, files, import, nerfstudio, upright};
use crate::atlas::DEFAULT_SIDE;
use crate::error::{Error, Result};
use crate::image_io::{check_whole, read_rgb, read_size};
use crate::mesh::Mesh;
use crate::mesh_io::{atlas_report, read_mesh};
use crate::progress::{Progress, Task};
use crate::raster::times;
use crate::scene::Scene;

/// Looked for in this order.
const MESH_NAMES: [&str; 4] = ["mesh.obj", "mesh.glb", "mesh.gltf", "mesh.ply"];
/// A camera whose up axis points down by more than this is upside down.
const DOWN: f32 = 0.5;
/// Cameras that agree on what is up by more than this hold it; within 45° of +Z it is well.
const UPRIGHT: f32 = 0.7;

/// Reads and checks a capture folder: `transforms.json`, a mesh, and `hdr_texture.exr`, `albedo_tex.exr` with
/// `roughness_tex.exr` where they exist. All but the mesh stays on disk; files are checked to be there,
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
    let task = Task::start(progress, "checking files", views.len() as u64, "views");
    views.par_iter().try_for_each(|view| {
        progress.check()?;
        view.check_files()?;
        progress.advance(1);
        Ok(())
    })?;
    drop(task);
    check_light(&root, &views, progress)?;

    let mesh_path = match &options.mesh {
        Some(path) => path.clone(),
        None => find_mesh(&root)?,
    };
    progress.check()?;
    let file = read_mesh(&mesh_path)?;
    file.warnings.iter().for_each(|w| progress.warn(w));
    let places = views.iter().map(|view| view.camera.position());
    let mesh = upright::among_cameras(&mesh_path, file.mesh, places, progress);
    Scene::check(&mesh).map_err(|e| Error::file(&mesh_path, e))?;
    warn_about_atlas(&mesh_path, &mesh, progress);
    warn_about_positions(&root, &views, &mesh, progress);
    warn_about_axes(&root, &views, progress);
    warn_about_centres(&root, &views, progress);

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
    tbl.as_ref().map_or(Ok(()), check_whole)?;
    Ok(Capture { root, mesh_path, mesh, views, tbl, truth })
}

fn find_mesh(root: &Path) -> Result<PathBuf> {
    MESH_NAMES.iter().map(|name| root.join(name)).find(|path| path.is_file()).ok_or_else(|| {
        let names = MESH_NAMES.join(", ");
        let what = match files::mesh(root) {
            Some(only) => format!(
                "has no mesh of a name that is looked for ({names}), but {}: rename it, give it as --mesh {}, or make a \
                 capture of the folder with `texir import`, which takes it",
                only.file_name().unwrap_or_default().display(),
                only.display()
            ),
            None => format!("has no mesh; expected one of {names}, or name one with --mesh"),
        };
        Error::file(root, what)
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
    for problem in atlas_report(mesh, [DEFAULT_SIDE; 2]).problems() {
        progress.warn(&format!("{}: {problem}; `texir import --unwrap` makes a new atlas", path.display()));
    }
}

fn warn_about_positions(root: &Path, views: &[View], mesh: &Mesh, progress: &dyn Progress) {
    let (low, high) = mesh.bounds();
    let holds = upright::holds(mesh);
    let outside: Vec<&View> = views.iter().filter(|view| !holds(view.camera.position())).collect();
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

/// What turns OpenGL's axes into OpenCV's turns images upside down, but keeps what they show: the fit would go on, and
/// find anything but the room's materials.
fn warn_about_axes(root: &Path, views: &[View], progress: &dyn Progress) {
    let down: Vec<&View> = views.iter().filter(|v| v.camera.world_from_camera.y_axis.z < -DOWN).collect();
    if let Some(first) = down.first().filter(|_| 2 * down.len() > views.len()) {
        progress.warn(&format!(
            "{}: transform_matrix: {} of {} cameras are upside down (+Z is up in the world), the first is {:?}: are their axes \
             OpenCV's (+Y down, +Z forward)? Expected OpenGL's (+Y up, -Z forward): negate the second and the third \
             column of every transform_matrix",
            root.join("transforms.json").display(),
            down.len(),
            views.len(),
            first.name
        ));
        return;
    }
    // Photos in portrait are often stored lying down, and those of a floor or a ceiling alone have no up.
    let steep = |axis: fn(&View) -> f32| views.iter().map(axis).sum::<f32>().abs() > UPRIGHT * views.len() as f32;
    if steep(|view| view.camera.world_from_camera.x_axis.z) || steep(|view| view.camera.world_from_camera.z_axis.z) {
        return;
    }
    let up =
        views.iter().map(|view| view.camera.world_from_camera.y_axis.truncate()).sum::<Vec3>() / views.len() as f32;
    // Whoever turns the camera every way shows no up.
    if up.length() > UPRIGHT && up.normalize().z < UPRIGHT {
        progress.warn(&format!(
            "{}: transform_matrix: up is {up:.1} in the cameras, on average, and +Z in the world: floors and rooms are looked for \
             along +Z; `texir import --up` turns mesh and cameras",
            root.join("transforms.json").display()
        ));
    }
}

fn warn_about_centres(root: &Path, views: &[View], progress: &dyn Progress) {
    let all: Vec<(&View, [f32; 2])> =
        views.iter().filter_map(|view| Some((view, view.camera.centre_outside()?))).collect();
    let Some((first, [cx, cy])) = all.first() else { return };
    progress.warn(&format!(
        "{}: cx, cy: the principal point of {} of {} views lies outside of the image, the first is {:?} with ({cx}, {cy}) of \
         {}×{} pixels: are they in pixels, and of images of this size?",
        root.join("transforms.json").display(),
        all.len(),
        views.len(),
        first.name,
        first.camera.width,
        first.camera.height
    ));
}

fn truth(albedo: PathBuf, roughness: PathBuf) -> Result<Truth> {
    let (of_albedo, of_roughness) = (read_size(&albedo)?, read_size(&roughness)?);
    if of_albedo != of_roughness {
        return Err(Error::file(
            &roughness,
            format!("is {} texels; expected {}, as {} has", times(of_roughness), times(of_albedo), albedo.display()),
        ));
    }
    [&albedo, &roughness].into_iter().try_for_each(check_whole)?;
    Ok(Truth { albedo, roughness })
}
