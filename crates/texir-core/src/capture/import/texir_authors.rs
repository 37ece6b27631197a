//! The layout of the TexIR authors' captures, as their public code reads it (`datasets/dataset.py` of
//! <https://github.com/LZleejean/TexIR_code>):
//!
//! - `info/aligned.txt`, one view id a line, and `info/final_extrinsics.txt`, a count and as many 4×4 camera-to-world
//!   matrices; synthetic scenes have `info/novel.txt` and `info/novel_extrinsics.txt` as well;
//! - `hdr/<id>/ccm.hdr`, equirectangular radiance; `derived/<id>/panoImage_gray.png`, segment ids; the alpha channel of
//!   `derived/<id>/panoImage_orig.jpg` (a PNG by its content), the pixels to use; synthetic scenes: `albedo.png`,
//!   `roughness.png`;
//! - `hdr_texture/out1.obj` and `hdr_texture/hdr_texture.hdr`.
//!
//! Cameras look along +Z with x to the right and y down, and the world's y points down as well: both follow from how
//! that code renders (`Pano2Cube` puts +z in the image's centre, the projection takes +z as forward, rows grow with y).
//! Its `hdr_exposure` scales views and texture alike and is left out: radiance has an arbitrary unit.

use std::path::Path;

use glam::Vec3;

use super::{Importer, Source, numbers};
use crate::camera::{Camera, Projection};
use crate::capture::{Shot, files};
use crate::capture::{Split, View};
use crate::error::{Error, Result};
use crate::image_io::read_size;
use crate::text_file::read_text;

/// See the module.
pub(super) struct TexirAuthors;

const POSES: &str = "info/final_extrinsics.txt";

impl Importer for TexirAuthors {
    fn name(&self) -> &'static str {
        "texir-authors"
    }

    fn signature(&self) -> &'static str {
        "info/aligned.txt with info/final_extrinsics.txt"
    }

    fn detects(&self, folder: &Path) -> bool {
        folder.join(POSES).is_file()
    }

    fn read(&self, folder: &Path) -> Result<Source> {
        let mut shots = read(folder, "info/aligned.txt", POSES, Split::Train)?;
        let (ids, poses) = ("info/novel.txt", "info/novel_extrinsics.txt");
        if folder.join(ids).is_file() {
            shots.extend(read(folder, ids, poses, Split::Novel)?);
        }
        let existing = |name: &str| Some(folder.join(name)).filter(|path| path.is_file());
        Ok(Source {
            shots,
            mesh: existing("hdr_texture/out1.obj"),
            textures: existing("hdr_texture/hdr_texture.hdr")
                .map(|path| ("hdr_texture.exr", path))
                .into_iter()
                .collect(),
            up: Some(Vec3::NEG_Y),
            metres_per_unit: Some(1.0),
            assumed: vec![
                "panoramas look along +Z of their pose with y down; radiance is taken without the exposure factor"
                    .into(),
            ],
        })
    }
}

fn read(folder: &Path, ids: &str, poses: &str, split: Split) -> Result<Vec<Shot>> {
    let (ids_path, poses_path) = (folder.join(ids), folder.join(poses));
    let ids = read_text(&ids_path)?;
    let ids: Vec<&str> = ids.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let found = numbers::parse(&poses_path, &read_text(&poses_path)?)?;
    // The first number counts the matrices.
    let matrices = found.get(1..).unwrap_or_default();
    if matrices.len() != 16 * ids.len() {
        let what = format!(
            "has {} numbers after the first; expected 16 for each of the {} ids in {}",
            matrices.len(),
            ids.len(),
            ids_path.display()
        );
        return Err(Error::file(&poses_path, what));
    }
    let names = files::view_names(ids.iter().copied());
    let shot = |((id, name), matrix): ((&&str, String), &[f64])| {
        let pose = numbers::pose(&poses_path, &format!("the matrix of view {id}"), matrix)?;
        let image = folder.join("hdr").join(id).join("ccm.hdr");
        let [width, height] = read_size(&image)?;
        if width != 2 * height {
            let what = format!("is {width}×{height} pixels; expected a full panorama, twice as wide as high");
            return Err(Error::file(&image, what));
        }
        let world_from_camera = super::frame::opengl_from_opencv(pose).as_mat4();
        let camera = Camera { projection: Projection::Equirectangular, width, height, world_from_camera };
        let derived = |name: &str| Some(folder.join("derived").join(id).join(name)).filter(|path| path.is_file());
        let view = View {
            semantic: derived("panoImage_gray.png"),
            albedo: derived("albedo.png"),
            roughness: derived("roughness.png"),
            ..View::new(name, camera, split, image)
        };
        Ok(Shot { opacity: derived("panoImage_orig.jpg"), ..view.into() })
    };
    ids.iter().zip(names).zip(matrices.chunks_exact(16)).map(shot).collect()
}
