//! A glTF or GLB whose nodes are the cameras: what Blender and other modellers export. A node's image has its name (the
//! node's, its camera's or its parent's). A node with a camera is a pinhole; one without, whose image is twice as wide
//! as high, is a panorama. glTF's world has +Y up, metres; its cameras have OpenGL axes.

use std::path::{Path, PathBuf};

use ::gltf::Node;
use ::gltf::camera::Projection as Lens;
use glam::{DMat4, Mat4, Vec3};

use super::{Importer, Source};
use crate::camera::{Camera, Projection, check_rigid};
use crate::capture::{Shot, files};
use crate::capture::{Split, View};
use crate::error::{Error, Result};
use crate::image_io::read_size;
use crate::mesh_io::gltf::{for_each_node, open};

/// See the module.
pub(super) struct Gltf;

/// Where images are looked for.
const IMAGES: [&str; 2] = ["hdr", "images"];
/// A camera's aspect may differ from its image's by this much: rounding to whole pixels.
const ASPECT_TOLERANCE: f64 = 0.01;

impl Importer for Gltf {
    fn name(&self) -> &'static str {
        "gltf"
    }

    fn signature(&self) -> &'static str {
        "one .glb or .gltf with cameras, and their images under hdr/ or images/"
    }

    fn detects(&self, folder: &Path) -> bool {
        scene(folder).is_some() && IMAGES.iter().any(|place| folder.join(place).is_dir())
    }

    fn read(&self, folder: &Path) -> Result<Source> {
        let path = scene(folder).ok_or_else(|| Error::file(folder, format!("does not hold {}", self.signature())))?;
        let document = open(&path)?.document;
        let mut parent_names = vec![None; document.nodes().len()];
        document.nodes().for_each(|node| node.children().for_each(|child| parent_names[child.index()] = node.name()));
        let mut shots = Vec::new();
        for_each_node(&path, &document, |node, world_from_node| {
            shots.extend(shot(&path, folder, node, parent_names[node.index()], world_from_node)?);
            Ok(())
        })?;
        shots.sort_by(|a, b| a.view.name.cmp(&b.view.name));
        let names = files::view_names(shots.iter().map(|shot| shot.view.name.as_str()));
        shots.iter_mut().zip(names).for_each(|(shot, name)| shot.view.name = name);
        Ok(Source {
            shots,
            mesh: Some(path),
            textures: Vec::new(),
            up: Some(Vec3::Y),
            metres_per_unit: Some(1.0),
            assumed: vec!["nodes are cameras of glTF's world (+Y up, metres); images have the nodes' names".into()],
        })
    }
}

fn scene(folder: &Path) -> Option<PathBuf> {
    files::only(folder, &["glb", "gltf"])
}

/// The node's view, when it has an image.
fn shot(path: &Path, folder: &Path, node: &Node, parent: Option<&str>, pose: Mat4) -> Result<Option<Shot>> {
    let camera = node.camera();
    let names = [node.name(), camera.as_ref().and_then(|c| c.name()), parent.filter(|_| camera.is_some())];
    let named = names.into_iter().flatten().map(|name| (name, files::image(folder, &IMAGES, name)));
    let found = named.into_iter().find(|(_, image)| image.is_file());
    let Some((name, image)) = found else {
        return match camera {
            None => Ok(None),
            Some(_) => {
                let name = node.name().map_or_else(|| format!("number {}", node.index()), |name| format!("{name:?}"));
                let what =
                    format!("node {name} is a camera without an image; expected one of its name in hdr/ or images/");
                Err(Error::file(path, what))
            }
        };
    };
    let wrong = |what: String| Error::file(path, format!("node {name:?}: {what}"));
    let [width, height] = read_size(&image)?;
    let projection = match camera.map(|c| lens(&c, width, height)) {
        Some(projection) => projection.map_err(wrong)?,
        None if width == 2 * height => Projection::Equirectangular,
        None => return Ok(None),
    };
    let world_from_camera = without_scale(pose.as_dmat4());
    check_rigid(&world_from_camera).map_err(|what| wrong(format!("its transform {what}")))?;
    let camera = Camera { projection, width, height, world_from_camera: world_from_camera.as_mat4() };
    Ok(Some(View::new(name.to_owned(), camera, Split::Train, image).into()))
}

/// Parents may be scaled; a camera is not.
fn without_scale(pose: DMat4) -> DMat4 {
    let axis = |v: glam::DVec4| v.truncate().normalize_or_zero().extend(0.0);
    DMat4::from_cols(axis(pose.x_axis), axis(pose.y_axis), axis(pose.z_axis), pose.w_axis)
}

fn lens(camera: &::gltf::Camera, width: usize, height: usize) -> Result<Projection, String> {
    let Lens::Perspective(lens) = camera.projection() else {
        return Err("the camera is orthographic; expected a perspective one".to_owned());
    };
    let (field, shape) = (f64::from(lens.yfov()), width as f64 / height as f64);
    if !(field > 0.0 && field < std::f64::consts::PI) {
        return Err(format!("yfov is {field}; expected radians between 0 and π"));
    }
    if let Some(aspect) = lens.aspect_ratio().map(f64::from)
        && !((aspect / shape - 1.0).abs() <= ASPECT_TOLERANCE)
    {
        return Err(format!("aspectRatio is {aspect}, but the image is {width}×{height}; expected {shape:.4}"));
    }
    let focal = (0.5 * height as f64 / (0.5 * field).tan()) as f32;
    Ok(Projection::Pinhole { fx: focal, fy: focal, cx: width as f32 / 2.0, cy: height as f32 / 2.0 })
}
