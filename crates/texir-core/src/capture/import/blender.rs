//! Transforms as the NeRF-synthetic scenes' Blender script writes them: `transforms_train.json` and, for held-out
//! views, `transforms_val.json` and `transforms_test.json`. One horizontal field of view for all, file names without
//! extension.

use std::path::Path;

use glam::Vec3;
use serde::Deserialize;

use super::{Importer, Source};
use crate::camera::{Camera, Projection};
use crate::capture::{Shot, files};
use crate::capture::{Split, View, pose};
use crate::error::{Error, Result};
use crate::image_io::read_size;
use crate::text_file::read_text;

/// See the module.
pub(super) struct Blender;

const TRAIN: &str = "transforms_train.json";
const SPLITS: [(&str, Split); 3] =
    [(TRAIN, Split::Train), ("transforms_val.json", Split::Novel), ("transforms_test.json", Split::Novel)];

#[derive(Deserialize)]
struct Transforms {
    /// Horizontal field of view, radians.
    camera_angle_x: f64,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
}

impl Importer for Blender {
    fn name(&self) -> &'static str {
        "blender"
    }

    fn signature(&self) -> &'static str {
        TRAIN
    }

    fn detects(&self, folder: &Path) -> bool {
        folder.join(TRAIN).is_file()
    }

    fn read(&self, folder: &Path) -> Result<Source> {
        let mut shots = Vec::new();
        for (name, split) in SPLITS {
            let path = folder.join(name);
            if name == TRAIN || path.is_file() {
                read(folder, &path, split, &mut shots)?;
            }
        }
        let names = files::view_names(shots.iter().map(|shot: &Shot| shot.view.name.as_str()));
        shots.iter_mut().zip(names).for_each(|(shot, name)| shot.view.name = name);
        Ok(Source {
            shots,
            mesh: files::mesh(folder),
            textures: Vec::new(),
            up: Some(Vec3::Z),
            metres_per_unit: Some(1.0),
            assumed: vec!["poses are camera-to-world with OpenGL axes, in Blender's world (+Z up, metres)".into()],
        })
    }
}

fn read(folder: &Path, path: &Path, split: Split, shots: &mut Vec<Shot>) -> Result<()> {
    let text = read_text(path)?;
    let file: Transforms = serde_json::from_str(&text)
        .map_err(|e| Error::file(path, format!("is no transforms file as the NeRF-synthetic scenes have it: {e}")))?;
    let angle = file.camera_angle_x;
    if !(angle > 0.0 && angle < std::f64::consts::PI) {
        return Err(Error::file(path, format!("camera_angle_x is {angle}; expected radians between 0 and π")));
    }
    for (index, frame) in file.frames.iter().enumerate() {
        let pose = pose::from_rows(&frame.transform_matrix).map_err(|what| {
            Error::file(path, format!("frames[{index}] ({}): transform_matrix {what}", frame.file_path))
        })?;
        let image = files::image(folder, &[""], &frame.file_path);
        let [width, height] = read_size(&image)?;
        let focal = (0.5 * width as f64 / (0.5 * angle).tan()) as f32;
        let projection = Projection::Pinhole { fx: focal, fy: focal, cx: width as f32 / 2.0, cy: height as f32 / 2.0 };
        let camera = Camera { projection, width, height, world_from_camera: pose.as_mat4() };
        // The path, for now: names are made when all are known.
        shots.push(View::new(frame.file_path.clone(), camera, split, image).into());
    }
    Ok(())
}
