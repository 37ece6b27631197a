//! A small scene, written as every format has it and read back; lenses; bad files.

mod formats;
mod fuzz;
mod lenses;

use std::path::Path;

use glam::{DMat4, DQuat, DVec3, Vec2};
use tempfile::TempDir;

use super::*;
use crate::camera::{Camera, Projection};
use crate::capture::{Distortion, Split, View};
use crate::image_io::write_rgb;
use crate::mesh_io::obj;
use crate::progress::Silent;
use crate::raster::Rgb;

const WIDTH: usize = 8;
const HEIGHT: usize = 4;

/// A floor and a ceiling without overlap in the atlas, of which they cover little: it is looked at often.
fn mesh() -> Mesh {
    let mut mesh = Mesh::default();
    for (level, u) in [(0.0, 0.0), (2.5, 0.5)] {
        let base = mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)] {
            mesh.positions.push(Vec3::new(x, y, level));
            mesh.normals.push(Vec3::Z);
            mesh.uvs.push(Vec2::new(u + 0.01 * x, 0.03 * y));
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    mesh
}

/// Poses of four cameras in texir's frame, held level within a few degrees.
fn poses() -> Vec<DMat4> {
    let pose = |i: u32| {
        let i = f64::from(i);
        let rotation = DQuat::from_rotation_z(0.7 + 1.9 * i)
            * DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2 + 0.02 * (i - 1.0))
            * DQuat::from_rotation_z(0.03 * (1.5 - i));
        DMat4::from_rotation_translation(rotation, DVec3::new(0.5 + 0.8 * i, 1.0 + 0.3 * i, 1.4 + 0.01 * i))
    };
    (0..4).map(pose).collect()
}

/// The pinhole of formats that have one field of view for both axes.
fn pinhole() -> Projection {
    Projection::Pinhole { fx: 5.0, fy: 5.0, cx: WIDTH as f32 / 2.0, cy: HEIGHT as f32 / 2.0 }
}

/// What every format is to bring back.
fn cameras(projection: Projection) -> Vec<Camera> {
    let camera = |pose: DMat4| Camera { projection, width: WIDTH, height: HEIGHT, world_from_camera: pose.as_mat4() };
    poses().into_iter().map(camera).collect()
}

/// `to` of the true frame: a frame in which things are where the other program has them.
fn source_from_texir(up: Vec3) -> DMat4 {
    DMat4::from_quat(DQuat::from_rotation_arc(up.as_dvec3(), DVec3::Z).inverse())
}

/// Writes the mesh as it is in a source whose up direction is `up`.
fn write_mesh(path: &Path, up: Vec3, units_per_metre: f32) {
    let mut mesh = mesh();
    let rotation = source_from_texir(up);
    for p in &mut mesh.positions {
        *p = rotation.transform_point3(p.as_dvec3()).as_vec3() * units_per_metre;
    }
    for n in &mut mesh.normals {
        *n = rotation.transform_vector3(n.as_dvec3()).as_vec3();
    }
    obj::write(path, &mesh).unwrap();
}

/// The image of view `i`.
fn image(i: usize) -> Rgb {
    Rgb::filled(WIDTH, HEIGHT, [1.0 + i as f32, 2.0, 3.0])
}

fn write_images(folder: &Path, name: impl Fn(usize) -> String) {
    for i in 0..poses().len() {
        write_rgb(folder.join(name(i)), &image(i)).unwrap();
    }
}

/// OpenCV's axes for OpenGL's: the conversion is its own inverse.
fn opencv(pose: DMat4) -> DMat4 {
    frame::opengl_from_opencv(pose)
}

/// Sixteen numbers row by row.
fn row_major(pose: DMat4) -> String {
    pose.transpose().to_cols_array().map(|v| format!("{v:.9}")).join(" ")
}

/// The folder reads as `format`, and gives the true cameras (to 1e-5), mesh and images, also after an import.
#[track_caller]
fn assert_reads(folder: &TempDir, format: &str, projection: Projection) -> Import {
    let root = folder.path();
    assert_eq!(detect(root, None).unwrap().name(), format);
    let read = read(root, &ImportOptions::default(), &Silent).unwrap();
    assert_eq!(read.format, format);
    let found: Vec<Camera> = read.shots.iter().map(|shot| shot.view.camera).collect();
    assert_cameras(&found, &cameras(projection));
    for (found, expected) in read.mesh.positions.iter().zip(mesh().positions) {
        assert!((*found - expected).length() < 1e-5, "{found} is not {expected}");
    }
    let out = tempfile::tempdir().unwrap();
    let written = write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap();
    assert_eq!(written.views, found.len());
    let capture = crate::capture::load(out.path(), &Default::default(), &Silent).unwrap();
    let imported: Vec<Camera> = capture.views.iter().map(|view| view.camera).collect();
    assert_cameras(&imported, &cameras(projection));
    for (i, view) in capture.views.iter().enumerate() {
        assert_eq!(view.load_image(&Silent).unwrap(), image(i), "{}", view.name);
    }
    read
}

#[track_caller]
fn assert_cameras(found: &[Camera], expected: &[Camera]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!((found.width, found.height), (expected.width, expected.height));
        let difference = found.world_from_camera - expected.world_from_camera;
        let largest = difference.to_cols_array().into_iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(largest < 1e-5, "{found:?} is not {expected:?}");
        for (x, y) in [(0.5, 0.5), (7.5, 0.5), (2.5, 3.5)] {
            let apart = (found.direction(x, y) - expected.direction(x, y)).length();
            assert!(apart < 1e-5, "pixel ({x}, {y}) of {found:?} looks elsewhere than that of {expected:?}");
        }
    }
}

#[track_caller]
fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

/// What a read of the folder complains about.
fn complaint(folder: &TempDir) -> String {
    read(folder.path(), &ImportOptions::default(), &Silent).unwrap_err().to_string()
}
