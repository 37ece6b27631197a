//! Writes the flat as a capture folder.

use std::path::{Path, PathBuf};

use super::{Flat, Rendered};
use crate::capture::{View, nerfstudio};
use crate::error::{Error, Result};
use crate::image_io::{write_gray, write_png_labels, write_rgb};
use crate::mesh_io::obj;
use crate::progress::{Progress, Task};

/// All that [`write()`] leaves in a folder.
pub const FILES: [&str; 13] = [
    "transforms.json",
    "mesh.obj",
    "albedo_tex.exr",
    "roughness_tex.exr",
    "emission_tex.exr",
    "semantic_tex.png",
    "room_tex.png",
    "hdr",
    "albedo",
    "roughness",
    "semantic",
    "room",
    "mask",
];

/// Writes `mesh.obj`, the views with their ground truth, the ground-truth textures and, last, `transforms.json`: a
/// folder that was not finished is no capture. Images are OpenEXR (linear radiance, albedo, roughness) and PNG (ids,
/// masks).
pub fn write(flat: &Flat, views: &[Rendered], folder: impl AsRef<Path>, progress: &dyn Progress) -> Result<()> {
    let folder = folder.as_ref();
    for name in ["hdr", "albedo", "roughness", "semantic", "room", "mask"] {
        let path = folder.join(name);
        std::fs::create_dir_all(&path).map_err(|e| Error::file(&path, format!("cannot be created: {e}")))?;
    }
    let _task = Task::start(progress, "demo: writing", views.len() as u64 + 1, "files");
    obj::write(folder.join("mesh.obj"), &flat.mesh)?;
    write_rgb(folder.join("albedo_tex.exr"), &flat.albedo)?;
    write_gray(folder.join("roughness_tex.exr"), &flat.roughness)?;
    write_rgb(folder.join("emission_tex.exr"), &flat.emission)?;
    write_png_labels(folder.join("semantic_tex.png"), &flat.semantic)?;
    write_png_labels(folder.join("room_tex.png"), &flat.room)?;
    progress.advance(1);
    let mut frames = Vec::with_capacity(views.len());
    for rendered in views {
        progress.check()?;
        frames.push(write_view(rendered, folder)?);
        progress.advance(1);
    }
    nerfstudio::write_transforms(folder.join("transforms.json"), &frames)?;
    Ok(())
}

fn write_view(rendered: &Rendered, folder: &Path) -> Result<View> {
    let shot = &rendered.shot;
    let file =
        |kind: &str, extension: &str| -> PathBuf { folder.join(kind).join(format!("{}.{extension}", shot.name)) };
    let view = View {
        semantic: Some(file("semantic", "png")),
        mask: Some(file("mask", "png")),
        room: Some(file("room", "png")),
        room_id: Some(shot.room_id),
        albedo: Some(file("albedo", "exr")),
        roughness: Some(file("roughness", "exr")),
        ..View::new(shot.name.clone(), shot.camera, shot.split, file("hdr", "exr"))
    };
    write_rgb(&view.image, &rendered.image)?;
    write_rgb(file("albedo", "exr"), &rendered.albedo)?;
    write_gray(file("roughness", "exr"), &rendered.roughness)?;
    write_png_labels(file("semantic", "png"), &rendered.semantic)?;
    write_png_labels(file("room", "png"), &rendered.room)?;
    write_png_labels(file("mask", "png"), &rendered.mask.map(|&used| if used { 255 } else { 0 }))?;
    Ok(view)
}
