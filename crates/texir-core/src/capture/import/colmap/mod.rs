//! COLMAP's sparse models, text and binary: `cameras` and `images`. Points are not needed: the mesh is the geometry.
//!
//! Format: <https://colmap.github.io/format.html>. Poses are world-to-camera, quaternion w first, OpenCV axes (x right,
//! y down, z forward); pixel centres are at +½. A model has no gravity and no scale of its own.

mod binary;
mod text;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat4, DQuat, DVec3, DVec4};

use super::{Importer, Source};
use crate::camera::{Camera, Projection};
use crate::capture::{Distortion, Shot, files};
use crate::capture::{Split, View};
use crate::error::{Error, Result};

/// Where models are looked for, first what COLMAP's own steps and nerfstudio's script leave.
const MODELS: [&str; 6] = ["sparse/0", "sparse", "", "dense/sparse", "dense/0/sparse", "colmap/sparse/0"];
/// Where images are looked for; linear ones win over what was registered (see [`files::image`]).
const IMAGES: [&str; 6] = ["hdr", "images", "", "input", "dense/images", "dense/0/images"];

/// See the module.
pub(super) struct Colmap;

/// One line of `cameras`.
struct Sensor {
    id: u32,
    model: &'static CameraModel,
    width: u64,
    height: u64,
    parameters: Vec<f64>,
}

/// One line of `images`.
struct Image {
    camera_id: u32,
    /// w, x, y, z.
    camera_from_world: [f64; 4],
    translation: [f64; 3],
    /// Path under the folder of images.
    name: String,
}

/// A camera model by its name and its number in binary files.
struct CameraModel {
    number: i32,
    name: &'static str,
    parameters: usize,
    intrinsics: fn(&[f64]) -> Intrinsics,
}

/// fx, fy, cx, cy and the lens.
type Intrinsics = ([f64; 4], Option<Distortion>);

fn radial(k: [f64; 4], tangential: [f64; 2]) -> Option<Distortion> {
    Distortion::radial(k, [0.0; 3], tangential)
}

/// The models with up to OpenCV's twelve parameters (`src/colmap/sensor/models.h`).
const CAMERA_MODELS: [CameraModel; 9] = [
    CameraModel { number: 0, name: "SIMPLE_PINHOLE", parameters: 3, intrinsics: |p| ([p[0], p[0], p[1], p[2]], None) },
    CameraModel { number: 1, name: "PINHOLE", parameters: 4, intrinsics: |p| ([p[0], p[1], p[2], p[3]], None) },
    CameraModel {
        number: 2,
        name: "SIMPLE_RADIAL",
        parameters: 4,
        intrinsics: |p| ([p[0], p[0], p[1], p[2]], radial([p[3], 0.0, 0.0, 0.0], [0.0; 2])),
    },
    CameraModel {
        number: 3,
        name: "RADIAL",
        parameters: 5,
        intrinsics: |p| ([p[0], p[0], p[1], p[2]], radial([p[3], p[4], 0.0, 0.0], [0.0; 2])),
    },
    CameraModel {
        number: 4,
        name: "OPENCV",
        parameters: 8,
        intrinsics: |p| ([p[0], p[1], p[2], p[3]], radial([p[4], p[5], 0.0, 0.0], [p[6], p[7]])),
    },
    CameraModel {
        number: 5,
        name: "OPENCV_FISHEYE",
        parameters: 8,
        intrinsics: |p| ([p[0], p[1], p[2], p[3]], Some(Distortion::Fisheye { k: [p[4], p[5], p[6], p[7]] })),
    },
    CameraModel {
        number: 6,
        name: "FULL_OPENCV",
        parameters: 12,
        intrinsics: |p| {
            let lens = Distortion::radial([p[4], p[5], p[8], 0.0], [p[9], p[10], p[11]], [p[6], p[7]]);
            ([p[0], p[1], p[2], p[3]], lens)
        },
    },
    CameraModel {
        number: 8,
        name: "SIMPLE_RADIAL_FISHEYE",
        parameters: 4,
        intrinsics: |p| ([p[0], p[0], p[1], p[2]], Some(Distortion::Fisheye { k: [p[3], 0.0, 0.0, 0.0] })),
    },
    CameraModel {
        number: 9,
        name: "RADIAL_FISHEYE",
        parameters: 5,
        intrinsics: |p| ([p[0], p[0], p[1], p[2]], Some(Distortion::Fisheye { k: [p[3], p[4], 0.0, 0.0] })),
    },
];

/// The model that `is` picks out, or what to do without it.
fn camera_model(
    is: impl Fn(&CameraModel) -> bool,
    found: impl std::fmt::Display,
) -> Result<&'static CameraModel, String> {
    CAMERA_MODELS.iter().find(|m| is(m)).ok_or_else(|| {
        let names = CAMERA_MODELS.each_ref().map(|m| m.name).join(", ");
        format!("the camera model is {found}; expected one of {names}: undistort with `colmap image_undistorter`")
    })
}

impl Importer for Colmap {
    fn name(&self) -> &'static str {
        "colmap"
    }

    fn signature(&self) -> &'static str {
        "sparse/0/cameras.bin or .txt with images.bin or .txt"
    }

    fn detects(&self, folder: &Path) -> bool {
        model(folder).is_some()
    }

    fn read(&self, folder: &Path) -> Result<Source> {
        let (model, extension) = model(folder)
            .ok_or_else(|| Error::file(folder, format!("has no COLMAP model; expected {}", self.signature())))?;
        let [cameras_path, images_path] = ["cameras", "images"].map(|name| model.join(name).with_extension(extension));
        let (sensors, images) = if extension == "bin" {
            (binary::cameras(&cameras_path)?, binary::images(&images_path)?)
        } else {
            (text::cameras(&cameras_path)?, text::images(&images_path)?)
        };
        let mut cameras = HashMap::new();
        for sensor in &sensors {
            cameras.insert(sensor.id, sensor.intrinsics(&cameras_path)?);
        }
        let names = files::view_names(images.iter().map(|image| image.name.as_str()));
        let shot = |(image, name): (&Image, String)| {
            let (camera, distortion) = cameras.get(&image.camera_id).ok_or_else(|| {
                let what =
                    format!("image {:?}: camera {} is not in {}", image.name, image.camera_id, cameras_path.display());
                Error::file(&images_path, what)
            })?;
            let camera = Camera { world_from_camera: image.pose(&images_path)?.as_mat4(), ..*camera };
            let file = files::image(folder, &IMAGES, &image.name);
            Ok(Shot { distortion: *distortion, ..View::new(name, camera, Split::Train, file).into() })
        };
        let shots = images.iter().zip(names).map(shot).collect::<Result<Vec<_>>>()?;
        let mesh = files::mesh(folder)
            .or_else(|| files::mesh(&folder.join("dense")))
            .or_else(|| files::mesh(&folder.join("dense/0")));
        Ok(Source {
            shots,
            mesh,
            textures: Vec::new(),
            up: None,
            metres_per_unit: None,
            assumed: vec![format!(
                "the model is {}; its poses are world-to-camera with OpenCV axes (z forward, y down)",
                model.display()
            )],
        })
    }
}

/// The folder of the first whole model, and the extension of its files.
fn model(folder: &Path) -> Option<(PathBuf, &'static str)> {
    let whole = |place: &Path, extension: &str| {
        ["cameras", "images"].iter().all(|name| place.join(name).with_extension(extension).is_file())
    };
    MODELS.iter().map(|place| folder.join(place)).find_map(|place| {
        let extension = ["bin", "txt"].into_iter().find(|extension| whole(&place, extension))?;
        Some((place, extension))
    })
}

impl Sensor {
    /// The camera without its pose.
    fn intrinsics(&self, path: &Path) -> Result<(Camera, Option<Distortion>)> {
        let wrong = |what: String| Error::file(path, format!("camera {}: {what}", self.id));
        let ([fx, fy, cx, cy], distortion) = (self.model.intrinsics)(&self.parameters);
        if !(fx > 0.0 && fy > 0.0 && self.parameters.iter().all(|p| p.is_finite())) {
            let what =
                format!("the parameters are {:?}; expected finite numbers, focal lengths above 0", self.parameters);
            return Err(wrong(what));
        }
        let size = |value: u64| match usize::try_from(value) {
            Ok(value @ 1..=0xffff) => Ok(value),
            _ => Err(wrong(format!("the image is {}×{} pixels; expected 1 to 65535 each", self.width, self.height))),
        };
        let projection = Projection::Pinhole { fx: fx as f32, fy: fy as f32, cx: cx as f32, cy: cy as f32 };
        let (width, height) = (size(self.width)?, size(self.height)?);
        Ok((Camera { projection, width, height, world_from_camera: glam::Mat4::IDENTITY }, distortion))
    }
}

impl Image {
    /// `world_from_camera` with OpenGL axes.
    fn pose(&self, path: &Path) -> Result<DMat4> {
        let ([w, x, y, z], translation) = (self.camera_from_world, DVec3::from_array(self.translation));
        let rotation = DVec4::new(x, y, z, w).try_normalize().filter(|_| translation.is_finite()).ok_or_else(|| {
            let what = format!(
                "image {:?}: the pose is {:?} {:?}; expected a quaternion and finite numbers",
                self.name, self.camera_from_world, self.translation
            );
            Error::file(path, what)
        })?;
        let world_from_camera = DQuat::from_vec4(rotation).inverse();
        Ok(super::frame::opengl_from_opencv(DMat4::from_rotation_translation(
            world_from_camera,
            -(world_from_camera * translation),
        )))
    }
}
