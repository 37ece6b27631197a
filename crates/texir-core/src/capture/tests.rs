//! A tiny capture made in code, and everything that can be wrong with one.

use std::sync::Mutex;

use glam::{Mat4, Vec2, Vec3};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::*;
use crate::camera::Projection;
use crate::image_io::{write_gray, write_png_labels, write_png_mask, write_rgb};
use crate::mesh_io::obj;
use crate::progress::{Progress, Silent};
use crate::raster::{Gray, Labels, Mask};

/// Collects warnings.
#[derive(Default)]
pub(crate) struct Warnings(Mutex<Vec<String>>);

impl Progress for Warnings {
    fn start(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
    fn cancelled(&self) -> bool {
        false
    }
}

impl Warnings {
    pub(crate) fn all(self) -> Vec<String> {
        self.0.into_inner().unwrap()
    }
}

const WIDTH: usize = 4;
const HEIGHT: usize = 2;

/// A square and, a metre above it, a second one; the cameras are between them.
fn mesh() -> Mesh {
    let mut mesh = Mesh::default();
    for (level, u) in [(0.0, 0.0), (1.0, 0.5)] {
        let base = mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(Vec3::new(x, y, level));
            mesh.normals.push(Vec3::Z);
            mesh.uvs.push(Vec2::new(u + 0.4 * x, 0.9 * y));
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    mesh
}

/// The three views of the capture in `root`, pose and all: two for training, one held out.
fn views(root: &Path) -> Vec<View> {
    let view = |i: usize| View {
        semantic: Some(root.join(format!("semantic/view_{i}.png"))),
        mask: Some(root.join(format!("mask/view_{i}.png"))),
        room: Some(root.join(format!("room/view_{i}.png"))),
        room_id: Some(1),
        albedo: Some(root.join(format!("albedo/view_{i}.exr"))),
        roughness: Some(root.join(format!("roughness/view_{i}.exr"))),
        ..View::new(
            format!("view_{i}"),
            Camera {
                projection: Projection::Equirectangular,
                width: WIDTH,
                height: HEIGHT,
                world_from_camera: Mat4::from_translation(Vec3::new(0.5, 0.25 * (i + 1) as f32, 0.5))
                    * Mat4::from_rotation_x(1.5)
                    * Mat4::from_rotation_y(i as f32),
            },
            if i < 2 { Split::Train } else { Split::Novel },
            root.join(format!("hdr/view_{i}.exr")),
        )
    };
    (0..3).map(view).collect()
}

fn capture() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let views = views(root);
    for (i, view) in views.iter().enumerate() {
        write_rgb(&view.image, &Rgb::filled(WIDTH, HEIGHT, [i as f32, 1.0, 2.0])).unwrap();
        write_png_labels(view.semantic.as_ref().unwrap(), &Labels::filled(WIDTH, HEIGHT, 7)).unwrap();
        write_png_mask(view.mask.as_ref().unwrap(), &Mask::filled(WIDTH, HEIGHT, true)).unwrap();
        write_png_labels(view.room.as_ref().unwrap(), &Labels::filled(WIDTH, HEIGHT, 300)).unwrap();
        write_rgb(view.albedo.as_ref().unwrap(), &Rgb::filled(WIDTH, HEIGHT, [0.5; 3])).unwrap();
        write_gray(view.roughness.as_ref().unwrap(), &Gray::filled(WIDTH, HEIGHT, 0.25)).unwrap();
    }
    nerfstudio::write_transforms(root.join("transforms.json"), &views).unwrap();
    obj::write(root.join("mesh.obj"), &mesh()).unwrap();
    folder
}

fn load_warned(folder: &TempDir) -> (Result<Capture>, Vec<String>) {
    let warnings = Warnings::default();
    let result = load(folder, &LoadOptions::default(), &warnings);
    (result, warnings.all())
}

/// The capture as loaded; its files are gone.
pub(crate) fn loaded() -> Capture {
    load_warned(&capture()).0.unwrap()
}

fn message(folder: &TempDir) -> String {
    load_warned(folder).0.unwrap_err().to_string()
}

/// Changes the capture's `transforms.json`.
fn edit(folder: &TempDir, change: impl FnOnce(&mut Value)) {
    let path = folder.path().join("transforms.json");
    let mut document = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    change(&mut document);
    std::fs::write(path, document.to_string()).unwrap();
}

#[track_caller]
fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

#[test]
fn a_good_capture_loads_without_a_warning() {
    let folder = capture();
    let (capture, warnings) = load_warned(&folder);
    let capture = capture.unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(capture.mesh.triangles, mesh().triangles);
    assert!(capture.tbl.is_none() && capture.truth.is_none());
    assert_eq!(capture.views(Split::Train).count(), 2);
    for (read, written) in capture.views.iter().zip(views(folder.path())) {
        assert_eq!(format!("{read:?}"), format!("{written:?}"), "write_transforms and read_transforms agree");
    }
    let view = &capture.views[1];
    assert_eq!(view.load_image(&Silent).unwrap().data[0], [1.0, 1.0, 2.0]);
    assert_eq!(view.load_semantic().unwrap().unwrap().data[0], 7);
    assert_eq!(view.load_room().unwrap().unwrap().data[0], 300);
    assert!(view.load_mask().unwrap().unwrap().data[0]);
    assert_eq!(view.load_albedo().unwrap().unwrap().data[0], [0.5; 3]);
    assert_eq!(view.load_roughness().unwrap().unwrap().data[0], 0.25);
}

#[test]
fn textures_of_the_folder_are_found_and_overridden() {
    let folder = capture();
    let root = folder.path();
    let texels = Rgb::new(2, 2, vec![[1.0, 2.0, 3.0], [0.0; 3], [4.0; 3], [0.0; 3]]).unwrap();
    write_rgb(root.join("albedo_tex.exr"), &texels).unwrap();
    write_gray(root.join("roughness_tex.exr"), &Gray::filled(2, 2, 0.5)).unwrap();
    write_rgb(root.join("hdr_texture.exr"), &texels).unwrap();
    let capture = load_warned(&folder).0.unwrap();
    assert_eq!(capture.truth.unwrap().albedo, root.join("albedo_tex.exr"));
    let tbl = Tbl::read(capture.tbl.unwrap(), &Silent).unwrap();
    let light = [Coverage::Seen, Coverage::Outside].repeat(2);
    assert_eq!(tbl.coverage.data, light, "without a mask, light tells");

    let coverage = Raster::new(2, 2, [Coverage::Inpainted, Coverage::Seen].repeat(2)).unwrap();
    let other = Tbl { coverage, ..tbl };
    other.write(root.join("tbl/other.exr")).unwrap();
    let options = LoadOptions { tbl: Some(root.join("tbl/other.exr")), mesh: Some(root.join("none.ply")) };
    let error = load(root, &options, &Silent).unwrap_err().to_string();
    assert_says(&error, &["none.ply", "cannot be read"]);
    let capture = load(root, &LoadOptions { mesh: None, ..options }, &Silent).unwrap();
    assert_eq!(Tbl::read(capture.tbl.unwrap(), &Silent).unwrap(), other);

    write_png_labels(root.join("tbl/other_mask.png"), &Labels::filled(2, 2, 7)).unwrap();
    let error = Tbl::read(root.join("tbl/other.exr"), &Silent).unwrap_err().to_string();
    assert_says(&error, &["other_mask.png", "level 7", "128"]);
    write_rgb(root.join("tbl/view.exr"), &Rgb::filled(4, 2, [1.0; 3])).unwrap();
    let told = Warnings::default();
    Tbl::read(root.join("tbl/view.exr"), &told).unwrap();
    assert_says(&told.all().join("\n"), &["view.exr", "is 4×2 texels", "square as a rule"]);
}

#[test]
fn perspective_cameras_survive_a_round_trip_and_need_no_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    let mut written = views(folder.path());
    written[1].camera.projection = Projection::Pinhole { fx: 3.0, fy: 3.5, cx: 2.0, cy: 0.75 };
    (written[2].camera.width, written[2].camera.height) = (18, 9);
    nerfstudio::write_transforms(&path, &written).unwrap();
    let read = load_cameras(&path).unwrap();
    assert_eq!(format!("{read:?}"), format!("{written:?}"));
}

#[test]
fn the_example_of_the_documentation_is_read() {
    let page = include_str!("../../../../docs/files.md");
    let example = page.split("```").find_map(|block| block.strip_prefix("json")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, example).unwrap();
    let views = nerfstudio::read_transforms(&path).unwrap();
    assert_eq!(views.len(), 2);
    for (view, [x, y, z]) in views.iter().zip([[2.1, 0.4, 1.5], [4.7, 0.9, 1.5]]) {
        let Camera { width, height, .. } = view.camera;
        assert!(view.camera.position().abs_diff_eq(Vec3::new(x, y, z), 1e-6) && view.split == Split::Train);
        // Upright, looking along +Y.
        let ahead = view.camera.direction(width as f32 / 2.0, height as f32 / 2.0);
        let above = view.camera.direction(width as f32 / 2.0, height as f32 / 4.0);
        assert!(ahead.abs_diff_eq(Vec3::Y, 1e-5) && above.z > 0.1, "{ahead} {above}");
    }
}

#[test]
fn intrinsics_may_stand_in_the_file_or_in_the_frame_and_lists_split() {
    let identity = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]);
    let document = json!({
        "camera_model": "OPENCV", "w": 4, "h": 2, "fl_x": 3.0, "fl_y": 3.0, "cx": 2, "cy": 1, "k1": 0.0,
        "aabb_scale": 16,
        "test_filenames": ["b/0.exr"],
        "frames": [
            {"file_path": "a/0.exr", "fl_x": 5.0, "transform_matrix": identity},
            {"file_path": "b/0.exr", "transform_matrix": identity}
        ]
    });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    std::fs::write(&path, document.to_string()).unwrap();
    let views = load_cameras(&path).unwrap();
    assert_eq!(views[0].camera.projection, Projection::Pinhole { fx: 5.0, fy: 3.0, cx: 2.0, cy: 1.0 });
    assert_eq!(views[1].camera.projection, Projection::Pinhole { fx: 3.0, fy: 3.0, cx: 2.0, cy: 1.0 });
    assert_eq!(views.iter().map(|v| v.split).collect::<Vec<_>>(), [Split::Train, Split::Novel]);
    assert_eq!(views.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["a_0", "b_0"], "stems collide");
    assert_eq!(views[0].image, folder.path().join("a/0.exr"));

    // A file that names no model has perspective cameras, unless its images may be panoramas.
    let unnamed = |height: usize| {
        let mut document = document.clone();
        (document["camera_model"], document["h"]) = (Value::Null, json!(height));
        std::fs::write(&path, document.to_string()).unwrap();
        load_cameras(&path)
    };
    assert_eq!(unnamed(3).unwrap()[0].camera.projection, views[0].camera.projection);
    assert!(unnamed(2).unwrap_err().to_string().contains("camera_model is missing"));
}

#[test]
fn paths_that_windows_wrote_are_read() {
    let folder = capture();
    let path = folder.path().join("transforms.json");
    let expected = load_warned(&folder).0.unwrap().views;
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(
        &path,
        ["hdr", "semantic", "mask", "room"]
            .iter()
            .fold(text, |text, place| text.replace(&format!("\"{place}/"), &format!("\"{place}\\\\"))),
    )
    .unwrap();
    assert!(std::fs::read_to_string(&path).unwrap().contains("hdr\\\\view_0.exr"));
    assert_eq!(format!("{:?}", load_warned(&folder).0.unwrap().views), format!("{expected:?}"));
}

#[test]
fn a_byte_order_mark_before_transforms_json_is_ignored() {
    let folder = capture();
    let path = folder.path().join("transforms.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, format!("\u{feff}{text}")).unwrap();
    assert_eq!(load_warned(&folder).0.unwrap().views.len(), 3);
    // Anywhere else it is no JSON.
    std::fs::write(&path, format!("{{\u{feff}{}", &text[1..])).unwrap();
    assert_says(&message(&folder), &["transforms.json", "line 1 column"]);
}

#[test]
fn every_unusable_field_of_transforms_json_is_named_with_its_value() {
    let scaled = |s: f64| json!([[s, 0, 0, 0], [0, s, 0, 0], [0, 0, s, 0], [0, 0, 0, 1]]);
    let rows = |row: Value| json!([[1, 0, 0, 0], row, [0, 0, 1, 0], [0, 0, 0, 1]]);
    for (pointer, value, parts) in [
        ("/frames/1/transform_matrix", rows(json!([1, 0, 0, 0])), vec!["transform_matrix", "singular", "determinant"]),
        ("/frames/1/transform_matrix", rows(json!([0, -1, 0, 0])), vec!["transform_matrix", "mirrors", "-1.000"]),
        (
            "/frames/1/transform_matrix",
            rows(json!([0.5, 1, 0, 0])),
            vec!["transform_matrix", "not rigid", "orthonormal"],
        ),
        ("/frames/1/transform_matrix", scaled(2.0), vec!["transform_matrix", "not rigid", "2.0000"]),
        ("/frames/1/transform_matrix", scaled(1e-4), vec!["transform_matrix", "not rigid", "0.0001"]),
        ("/frames/1/transform_matrix", scaled(0.0), vec!["transform_matrix", "singular"]),
        ("/frames/1/transform_matrix", json!([[1, 0], [0, 1]]), vec!["transform_matrix", "[2, 2]", "4 rows"]),
        ("/frames/1/transform_matrix/3", json!([1, 0, 0, 1]), vec!["transform_matrix", "last row", "[0, 0, 0, 1]"]),
        ("/frames/1/transform_matrix/0/0", json!("x"), vec!["expected f64"]),
        ("/frames/1/transform_matrix/0/3", json!(1e300), vec!["frames[1]", "transform_matrix", "metres"]),
        ("/frames/1/split", json!("both"), vec!["split is \"both\"", "train"]),
        ("/frames/1/file_path", json!(""), vec!["file_path names no file"]),
        ("/frames/1/file_path", json!("hdr/view_0.exr"), vec!["file_path", "hdr/view_0.exr", "a second time"]),
        ("/camera_model", json!("OPENCV_FISHEYE"), vec!["camera_model is OPENCV_FISHEYE", "texir import"]),
        ("/camera_model", Value::Null, vec!["camera_model is missing"]),
        ("/w", json!(0), vec!["w is 0"]),
        ("/w", json!(5), vec!["w, h are 5×2", "twice as wide"]),
        ("/h", json!(2.5), vec!["h is 2.5"]),
        ("/w", json!(100_000), vec!["w is 100000", "1 to 65535"]),
        ("/h", Value::Null, vec!["h is missing"]),
        ("/frames", json!([]), vec!["frames is empty"]),
    ] {
        let folder = capture();
        edit(&folder, |document| *document.pointer_mut(pointer).unwrap() = value.clone());
        let error = message(&folder);
        assert_says(&error, &["transforms.json"]);
        assert_says(&error, &parts);
    }
}

#[test]
fn lists_name_frames() {
    let lists = |names: Value| {
        let folder = capture();
        edit(&folder, |document| {
            document["frames"].as_array_mut().unwrap().iter_mut().for_each(|frame| {
                frame.as_object_mut().unwrap().remove("split");
            });
            document["test_filenames"] = names;
        });
        load_warned(&folder).0
    };
    for name in ["hdr/view_1.exr", "./hdr/view_1.exr"] {
        assert_eq!(lists(json!([name])).unwrap().views(Split::Train).count(), 2);
    }
    assert_says(&lists(json!(["view_1.exr"])).unwrap_err().to_string(), &["test_filenames", "view_1.exr", "file_path"]);
}

#[test]
fn pinholes_need_their_intrinsics_and_no_distortion() {
    for (field, value, expected) in [
        ("k2", json!(0.1), "k2 is 0.1; expected no distortion: undistort"),
        ("fl_x", json!(-3.0), "fl_x is -3"),
        ("fl_y", Value::Null, "fl_y is missing"),
        ("cx", Value::Null, "cx is missing"),
    ] {
        let folder = capture();
        edit(&folder, |document| {
            document["camera_model"] = json!("OPENCV");
            document[field] = value.clone();
        });
        assert_says(&message(&folder), &["transforms.json", "frames[0] (hdr/view_0.exr)", expected]);
    }
}

#[test]
fn missing_truncated_and_wrongly_sized_images_are_errors() {
    for (field, file) in [
        ("file_path", "hdr/view_2.exr"),
        ("semantic_path", "semantic/view_2.png"),
        ("mask_path", "mask/view_2.png"),
        ("room_path", "room/view_2.png"),
        ("albedo_path", "albedo/view_2.exr"),
        ("roughness_path", "roughness/view_2.exr"),
    ] {
        let folder = capture();
        let path = folder.path().join(file);
        if file.ends_with("png") {
            write_png_labels(&path, &Labels::filled(3, 2, 1)).unwrap();
        } else {
            write_gray(&path, &Gray::filled(3, 2, 1.0)).unwrap();
        }
        assert_says(&message(&folder), &[file, field, "view_2", "3×2", "expected 4×2"]);
        std::fs::write(&path, &std::fs::read(&path).unwrap()[..10]).unwrap();
        assert_says(&message(&folder), &[file, "cannot be read"]);
        std::fs::remove_file(&path).unwrap();
        assert_says(&message(&folder), &[file, field, "view_2", "does not exist"]);
    }
}

#[test]
fn pixels_cut_off_behind_a_good_header_are_found_before_any_work_and_when_read() {
    for file in ["hdr/view_1.exr", "roughness/view_2.exr", "semantic/view_0.png", "mask/view_2.png"] {
        let folder = capture();
        let path = folder.path().join(file);
        let bytes = std::fs::read(&path).unwrap();
        // A PNG ends in a 12-byte chunk without pixels.
        std::fs::write(&path, &bytes[..bytes.len() - if file.ends_with("png") { 16 } else { 4 }]).unwrap();
        assert_says(&message(&folder), &[file, "cut short", "copy or export it again"]);
    }
    let folder = capture();
    let capture = load_warned(&folder).0.unwrap();
    let path = &capture.views[1].image;
    let bytes = std::fs::read(path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() - 4]).unwrap();
    assert_says(&capture.views[1].load_image(&Silent).unwrap_err().to_string(), &["view_1.exr", "cannot be read"]);
}

#[test]
fn pixels_that_are_not_finite_are_unknown_and_negative_ones_black_with_a_warning() {
    let folder = capture();
    let capture = load_warned(&folder).0.unwrap();
    let mut image = Rgb::filled(WIDTH, HEIGHT, [1.0; 3]);
    image.data[2] = [f32::NAN, 1.0, 1.0];
    image.data[5] = [1.0, -2.0, 1.0];
    write_rgb(&capture.views[0].image, &image).unwrap();
    let warnings = Warnings::default();
    let read = capture.views[0].load_image(&warnings).unwrap();
    assert!(read.data[2].iter().all(|v| v.is_nan()), "{:?}", read.data[2]);
    assert_eq!(read.data[5], [1.0, 0.0, 1.0]);
    assert_eq!(capture.views[0].load_picture(&Silent).unwrap().data[2], [0.0; 3]);
    let usable = capture.views[0].usable(&read).unwrap();
    assert_eq!((0..WIDTH * HEIGHT).filter(|&i| !usable.data[i]).collect::<Vec<_>>(), [2]);
    assert_says(&warnings.all()[0], &["view_0.exr", "1 pixels are NaN", "1 negative", "nothing is known"]);
}

#[test]
fn no_light_is_an_error_and_light_in_one_training_view_is_enough() {
    let folder = capture();
    let views = views(folder.path());
    let black = Rgb::filled(WIDTH, HEIGHT, [0.0, -1.0, f32::NAN]);
    write_rgb(&views[0].image, &black).unwrap();
    assert!(load_warned(&folder).0.is_ok());
    write_rgb(&views[1].image, &black).unwrap();
    assert_says(&message(&folder), &["transforms.json", "file_path", "all 2 training images are black", "no light"]);
}

#[test]
fn a_capture_needs_a_folder_a_mesh_and_a_training_view() {
    let folder = capture();
    edit(&folder, |document| {
        for frame in document["frames"].as_array_mut().unwrap() {
            frame["split"] = json!("novel");
        }
    });
    assert_says(&message(&folder), &["transforms.json", "split", "none of the 3 views"]);

    let folder = capture();
    std::fs::remove_file(folder.path().join("mesh.obj")).unwrap();
    assert_says(&message(&folder), &["has no mesh; expected", "mesh.glb", "--mesh"]);
    for (name, parts) in [
        ("room.obj", &["has no mesh of a name that is looked for", "but room.obj", "--mesh", "texir import"][..]),
        // Of two, none is the mesh.
        ("scan.obj", &["has no mesh; expected one of"]),
    ] {
        obj::write(folder.path().join(name), &mesh()).unwrap();
        assert_says(&message(&folder), parts);
    }
    std::fs::remove_file(folder.path().join("transforms.json")).unwrap();
    assert_says(&message(&folder), &["holds no capture", "transforms.json"]);
    let error = load(folder.path().join("none"), &LoadOptions::default(), &Silent).unwrap_err().to_string();
    assert_says(&error, &["none", "is no folder"]);
}

#[test]
fn doubtful_atlases_and_poses_are_warned_about() {
    let folder = capture();
    let mut overlapping = mesh();
    for uv in &mut overlapping.uvs[4..] {
        uv.x -= 0.3;
    }
    obj::write(folder.path().join("mesh.obj"), &overlapping).unwrap();
    let (capture, warnings) = load_warned(&folder);
    assert!(capture.is_ok());
    assert_says(&warnings[0], &["mesh.obj", "overlap on", "unwrap"]);

    let mut outside = mesh();
    outside.uvs[4].x += 0.7;
    obj::write(folder.path().join("mesh.obj"), &outside).unwrap();
    let (capture, warnings) = load_warned(&folder);
    assert!(capture.is_ok());
    assert!(warnings.iter().any(|w| w.contains("mesh.obj") && w.contains("outside of [0, 1]")), "{warnings:?}");

    obj::write(folder.path().join("mesh.obj"), &mesh()).unwrap();
    edit(&folder, |document| document["frames"][1]["transform_matrix"][2][3] = json!(7.0));
    let (capture, warnings) = load_warned(&folder);
    assert!(capture.is_ok());
    assert_says(&warnings[0], &["transforms.json", "transform_matrix", "1 of 3 cameras", "view_1", "same frame"]);

    write_rgb(folder.path().join("albedo_tex.exr"), &Rgb::filled(1, 1, [0.5; 3])).unwrap();
    let (_, warnings) = load_warned(&folder);
    assert_says(&warnings[1], &["albedo_tex.exr", "needs both"]);
    write_gray(folder.path().join("roughness_tex.exr"), &Gray::filled(2, 1, 0.5)).unwrap();
    assert_says(&message(&folder), &["roughness_tex.exr", "2×1", "expected 1×1", "albedo_tex.exr"]);
}

/// What one is warned of where the cameras with indices in `turned` have OpenCV's axes.
fn warned_of_axes(turned: std::ops::Range<usize>) -> Vec<String> {
    let folder = capture();
    edit(&folder, |document| {
        for i in turned {
            let matrix = &mut document["frames"][i]["transform_matrix"];
            for (row, column) in [(0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (2, 2)] {
                matrix[row][column] = json!(-matrix[row][column].as_f64().unwrap());
            }
        }
    });
    let (capture, warnings) = load_warned(&folder);
    assert!(capture.is_ok());
    warnings
}

#[test]
fn cameras_upside_down_are_warned_about() {
    for (turned, parts) in [(0..3, ["3 of 3 cameras", "\"view_0\""]), (1..3, ["2 of 3 cameras", "\"view_1\""])] {
        let warnings = warned_of_axes(turned);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert_says(
            &warnings[0],
            &["transforms.json: transform_matrix", "upside down", "OpenCV", "second and the third column"],
        );
        assert_says(&warnings[0], &parts);
    }
    // Negative control: one of three may hang from the ceiling.
    assert!(warned_of_axes(2..3).is_empty());
}

#[test]
fn worlds_that_are_not_z_up_are_warned_about() {
    let warned = |roll: f64, up: [usize; 3]| {
        let folder = capture();
        edit(&folder, |document| {
            for (i, yaw) in [0.0f64, 60.0, 90.0].into_iter().enumerate() {
                let ((sin, cos), (s, c)) = (yaw.to_radians().sin_cos(), roll.to_radians().sin_cos());
                // Right, up and backwards of a camera that looks about the second axis, rolled.
                let (right, upwards) = ([cos, 0.0, -sin], [0.0, 1.0, 0.0]);
                let rolled = [0, 1, 2]
                    .map(|k| (c * right[k] + s * upwards[k], c * upwards[k] - s * right[k], [sin, 0.0, cos][k]));
                let matrix = &mut document["frames"][i]["transform_matrix"];
                for (k, (x, y, z)) in up.iter().zip(rolled) {
                    (matrix[*k][0], matrix[*k][1], matrix[*k][2]) = (json!(x), json!(y), json!(z));
                }
            }
        });
        load_warned(&folder).1.into_iter().filter(|told| told.contains("transform_matrix: up is")).collect::<Vec<_>>()
    };
    let y_up = warned(0.0, [0, 1, 2]);
    assert_eq!(y_up.len(), 1, "{y_up:?}");
    assert_says(&y_up[0], &["transforms.json", "up is [0.0, 1.0, 0.0]", "+Z in the world", "texir import --up"]);
    // Negative controls: +Z is up, also in photos that lie on their side.
    assert!(warned(0.0, [1, 2, 0]).is_empty());
    assert!(warned(90.0, [1, 2, 0]).is_empty());
}

#[test]
fn principal_points_outside_of_the_image_are_warned_about() {
    let warned = |cx: f64, cy: f64| {
        let folder = capture();
        edit(&folder, |document| {
            let fields = [("camera_model", json!("PINHOLE")), ("fl_x", json!(3.0)), ("fl_y", json!(3.0))];
            fields.into_iter().for_each(|(field, value)| document[field] = value);
            (document["cx"], document["cy"]) = (json!(cx), json!(cy));
        });
        load_warned(&folder).1
    };
    for (cx, cy) in [(4.5, 1.0), (-0.5, 1.0), (2.0, 2.25), (2.0, -1.0)] {
        let warnings = warned(cx, cy);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert_says(&warnings[0], &["transforms.json: cx, cy", "3 of 3 views", "view_0", "4×2 pixels"]);
        assert_says(&warnings[0], &[&format!("({cx}, {cy})")]);
    }
    // Negative control: its border is still in it.
    for (cx, cy) in [(2.0, 1.0), (0.0, 0.0), (4.0, 2.0)] {
        assert!(warned(cx, cy).is_empty());
    }
}

#[test]
fn a_view_is_read_without_its_blur_and_corrections_bring_that_along() {
    let folder = capture();
    let mut capture = load(folder.path(), &LoadOptions::default(), &Silent).unwrap();
    let paint = |i: usize| if i.is_multiple_of(2) { [0.8; 3] } else { [0.6; 3] };
    let image = Rgb { width: WIDTH, height: HEIGHT, data: (0..WIDTH * HEIGHT).map(paint).collect() };
    write_rgb(&capture.views[0].image, &image).unwrap();
    let contrast = |view: &View| {
        let image = view.load_image(&Silent).unwrap();
        image.at(2, 1)[0] - image.at(1, 1)[0]
    };
    let before = contrast(&capture.views[0]);
    capture.views[0].blur = 1.0 / 6.0;
    let after = contrast(&capture.views[0]);
    assert!(after > 1.2 * before, "{before}, without blur {after}");
    // What covers several pixels is their mean once they are sharp.
    let reduced = capture.views[0].reduced(2).unwrap().load_image(&Silent).unwrap();
    assert!((reduced.at(0, 0)[0] - 0.7).abs() < 1e-3, "{:?}", reduced.at(0, 0));
    let corrections = Corrections::of(&capture);
    let mut again = load(folder.path(), &LoadOptions::default(), &Silent).unwrap();
    corrections.apply(&mut again, &Silent).unwrap();
    assert_eq!(contrast(&again.views[0]), after);
}
