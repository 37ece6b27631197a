//! Tiny models made in code, panoramas whose classes are known, and everything that can be wrong with a model.

mod models;

use std::path::PathBuf;

use glam::{Mat4, Quat, Vec3};
use tempfile::TempDir;

use self::models::{Axis, Head, Model};
use super::*;
use crate::camera::{Camera, Projection};
use crate::capture::import::{self, ImportOptions};
use crate::capture::{LoadOptions, Split, View, load};
use crate::error::{Error, Result};
use crate::image_io::{srgb_from_linear, write_rgb};
use crate::mesh::Mesh;
use crate::mesh_io::obj;
use crate::progress::{Impatient, Silent};
use crate::raster::{Labels, Raster, Rgb, luminance};

/// What the classes look like, before all are made equally bright.
const PAINTS: [[f32; 3]; 6] =
    [[1.0, 0.3, 0.3], [0.3, 1.0, 0.3], [0.4, 0.3, 1.0], [1.0, 0.9, 0.2], [0.2, 0.9, 1.0], [1.0, 0.4, 1.0]];
/// Their ids: not the places in the list.
const IDS: [u16; 6] = [7, 3, 300, 12, 1, 9];
/// Radiance is nowhere near what a photo holds.
const BRIGHTNESS: f32 = 70.0;

/// Linear colour of a class at luminance 1.
fn paint(class: usize) -> [f32; 3] {
    PAINTS[class].map(|v| v / luminance(&PAINTS[class]))
}

/// As a photo shows a class when all of it is equally bright.
fn shown(class: usize) -> [f32; 3] {
    paint(class).map(|v| srgb_from_linear(0.18 * v))
}

/// The class of a world direction: caps at the poles, between them four quarters, none of which ends where crops do.
fn class(direction: Vec3) -> usize {
    let height = direction.z.asin().to_degrees();
    if height.abs() > 62.0 {
        return usize::from(height < 0.0);
    }
    let heading = direction.y.atan2(direction.x).to_degrees() + 360.0 + 17.0;
    2 + (heading / 90.0) as usize % 4
}

/// No other class is within `degrees`.
fn clear(direction: Vec3, degrees: f32) -> bool {
    let side = direction.any_orthonormal_vector();
    (0..8).all(|i| {
        let axis = Quat::from_axis_angle(direction, i as f32 * std::f32::consts::FRAC_PI_4) * side;
        class(Quat::from_axis_angle(axis, degrees.to_radians()) * direction) == class(direction)
    })
}

fn panorama(rotation: Quat) -> Camera {
    let level = Mat4::from_rotation_x(std::f32::consts::FRAC_PI_2);
    let world_from_camera = Mat4::from_translation(Vec3::new(5.0, 2.0, 1.0)) * Mat4::from_quat(rotation) * level;
    Camera { projection: Projection::Equirectangular, width: 256, height: 128, world_from_camera }
}

fn pinhole() -> Camera {
    let projection = Projection::Pinhole { fx: 90.0, fy: 80.0, cx: 70.0, cy: 40.0 };
    Camera { projection, width: 160, height: 90, ..panorama(Quat::from_rotation_z(0.4)) }
}

fn direction(camera: &Camera, pixel: usize) -> Vec3 {
    camera.direction((pixel % camera.width) as f32 + 0.5, (pixel / camera.width) as f32 + 0.5)
}

/// Files of a test.
struct Room(TempDir);

impl Room {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let class = |id| format!("{{\"id\": {id}, \"name\": \"class {id}\"}}");
        let list = format!("[{}]", IDS.map(class).join(", "));
        std::fs::write(folder.path().join("list.json"), list).unwrap();
        Self(folder)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn open_bytes(&self, bytes: &[u8]) -> Result<Segmenter> {
        std::fs::write(self.file("model.onnx"), bytes).unwrap();
        Segmenter::open(self.file("model.onnx"), self.file("list.json").to_str().unwrap())
    }

    fn open(&self, model: &Model) -> Result<Segmenter> {
        self.open_bytes(&model.bytes())
    }

    /// A view that shows the classes' paints.
    fn view(&self, camera: Camera, paint: impl Fn(usize) -> [f32; 3]) -> View {
        let radiance = |i: usize| paint(class(direction(&camera, i))).map(|v| BRIGHTNESS * v);
        let image = Rgb::new(camera.width, camera.height, (0..camera.pixels()).map(radiance).collect()).unwrap();
        let path = self.file("view.exr");
        write_rgb(&path, &image).unwrap();
        View::new("view".into(), camera, Split::Train, path)
    }

    fn label(&self, segmenter: &Segmenter, view: View) -> Labels {
        let mut views = [view];
        segmenter.label(&mut views, self.0.path(), &Silent).unwrap();
        views[0].load_semantic().unwrap().unwrap()
    }
}

/// The share of pixels with the right id, of those whose class is alone within `degrees`.
fn right(camera: &Camera, labels: &Labels, degrees: f32) -> f64 {
    assert_eq!(labels.size(), [camera.width, camera.height]);
    let clear: Vec<usize> = (0..camera.pixels()).filter(|i| clear(direction(camera, *i), degrees)).collect();
    assert!(clear.len() > camera.pixels() / 2, "{} of {} pixels are clear", clear.len(), camera.pixels());
    let right = clear.iter().filter(|i| labels.data[**i] == IDS[class(direction(camera, **i))]).count();
    right as f64 / clear.len() as f64
}

const FIXED: [Axis; 4] = [Axis::Fixed(1), Axis::Fixed(3), Axis::Fixed(128), Axis::Fixed(128)];
const FREE: [Axis; 4] = [Axis::Free("batch"), Axis::Fixed(3), Axis::Free("height"), Axis::Free("width")];

fn model(input: &[Axis], head: Head) -> Model {
    Model::new(input, head, (0..PAINTS.len()).map(shown))
}

#[test]
fn panoramas_are_labelled_everywhere_whatever_form_the_output_has() {
    let tilted = Quat::from_axis_angle(Vec3::new(0.8, 0.5, 0.3).normalize(), 1.1);
    for (input, head, degrees) in [
        (&FIXED, Head::Scores, 2.0),
        (&FIXED, Head::Quarter, 5.0),
        (&FIXED, Head::Classes { keep_axis: false }, 2.0),
        (&FIXED, Head::Classes { keep_axis: true }, 2.0),
        (&FREE, Head::Scores, 2.0),
        (&[FREE[0], FREE[2], Axis::Fixed(96), Axis::Fixed(160)], Head::Scores, 2.0),
    ] {
        let room = Room::new();
        let segmenter = room.open(&model(input, head)).unwrap();
        for camera in [panorama(Quat::from_rotation_z(0.3)), panorama(tilted)] {
            let labels = room.label(&segmenter, room.view(camera, paint));
            let share = right(&camera, &labels, degrees);
            assert!(share >= 0.999, "{head:?} of {input:?}: {share}");
            assert!(labels.data.iter().all(|id| IDS.contains(id)), "a pixel that no crop covers");
            // The poles are whole rows, and left and right meet.
            for (y, x) in [(0, 3), (127, 200), (64, 0), (64, 255)] {
                let direction = direction(&camera, y * 256 + x);
                assert!(!clear(direction, degrees) || *labels.at(x, y) == IDS[class(direction)], "({x}, {y})");
            }
        }
    }
}

#[test]
fn pinholes_are_labelled_whole() {
    for (input, head, degrees) in [(&FIXED, Head::Scores, 1.5), (&FREE, Head::Quarter, 1.5)] {
        let room = Room::new();
        let segmenter = room.open(&model(input, head)).unwrap();
        let labels = room.label(&segmenter, room.view(pinhole(), paint));
        let share = right(&pinhole(), &labels, degrees);
        assert!(share >= 0.999, "{head:?} of {input:?}: {share}");
    }
}

/// The checks above can fail: other colours, other channels, other classes.
#[test]
fn what_is_wrong_shows() {
    let room = Room::new();
    let segmenter = room.open(&model(&FIXED, Head::Scores)).unwrap();
    let camera = panorama(Quat::IDENTITY);
    let share = |segmenter: &Segmenter, paint: &dyn Fn(usize) -> [f32; 3]| {
        right(&camera, &room.label(segmenter, room.view(camera, paint)), 2.0)
    };
    assert!(share(&segmenter, &paint) >= 0.999);
    let swapped = |class| {
        let [r, g, b] = paint(class);
        [b, r, g]
    };
    assert!(share(&segmenter, &swapped) < 0.5, "{}", share(&segmenter, &swapped));
    let reversed = Model::new(&FIXED, Head::Scores, (0..PAINTS.len()).rev().map(shown));
    let reversed = room.open(&reversed).unwrap();
    assert!(share(&reversed, &paint) < 0.1);
}

/// What a network says at the border of its image is poor: there another crop, which sees more of the place, decides.
#[test]
fn seams_vanish() {
    let room = Room::new();
    let segmenter = room.open(&model(&FIXED, Head::Framed(10))).unwrap();
    let camera = panorama(Quat::from_rotation_z(0.3));
    let labels = room.label(&segmenter, room.view(camera, paint));
    assert!(right(&camera, &labels, 2.0) >= 0.999);
    let labels = room.label(&segmenter, room.view(pinhole(), paint));
    assert!(right(&pinhole(), &labels, 2.0) < 0.9, "a pinhole has no other crop");
}

#[test]
fn an_import_brings_ids_and_the_list_of_classes() {
    let room = Room::new();
    let source = room.file("source");
    let camera = panorama(Quat::IDENTITY);
    std::fs::create_dir(&source).unwrap();
    std::fs::rename(room.view(camera, paint).image, source.join("view.exr")).unwrap();
    std::fs::write(source.join("panoramas.csv"), "file,x,y,z,yaw\nview.exr,5,2,1,90\n").unwrap();
    let floor = Mesh {
        positions: vec![Vec3::ZERO, Vec3::new(9.0, 0.0, 0.0), Vec3::new(0.0, 9.0, 3.0)],
        normals: vec![Vec3::Z; 3],
        uvs: [[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]].map(Into::into).to_vec(),
        triangles: vec![[0, 1, 2]],
    };
    obj::write(source.join("mesh.obj"), &floor).unwrap();
    let segmenter = Some(room.open(&model(&FIXED, Head::Quarter)).unwrap());
    let options = ImportOptions { segmenter, ..ImportOptions::default() };
    let read = import::read(&source, &options, &Silent).unwrap();
    let out = room.file("capture");
    let written = import::write(&read, &out, &options, &Silent).unwrap();
    assert_eq!((written.views, written.segmented), (1, 1));
    let capture = load(&out, &LoadOptions::default(), &Silent).unwrap();
    let view = &capture.views[0];
    assert_eq!(view.semantic.as_ref().unwrap(), &out.join("semantic/view.png"));
    let classes = view.classes.as_ref().unwrap();
    assert_eq!((classes.name.as_str(), classes.of_id(300).unwrap().name.as_str()), ("classes.json", "class 300"));
    assert!(right(&view.camera, &view.load_semantic().unwrap().unwrap(), 5.0) >= 0.999);
}

#[test]
fn whoever_asks_to_stop_is_obeyed() {
    let room = Room::new();
    let segmenter = room.open(&model(&FIXED, Head::Scores)).unwrap();
    let mut views = [room.view(pinhole(), paint)];
    let result = segmenter.label(&mut views, room.0.path(), &Impatient::after(0));
    assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
}

#[test]
fn unusable_models_are_told_apart() {
    use Axis::{Fixed, Free};
    let of = |input: &[Axis]| model(input, Head::Scores);
    let [one, three, edge] = [Fixed(1), Fixed(3), Fixed(64)];
    for (model, parts) in [
        (of(&[three, edge, edge]), vec!["input \"image\"", "3 axes (is 3×64×64)", "1×3×height×width"]),
        (of(&[one, edge, edge, three]), vec!["is 1×64×64×3, channels last"]),
        (of(&[one, Fixed(4), edge, edge]), vec!["is 1×4×64×64", "1×3×height×width"]),
        (of(&[Fixed(2), three, edge, Free("w")]), vec!["is 2×3×64×?", "several images"]),
        (of(&[one, three, Fixed(1 << 20), edge]), vec!["height is not in 1 to 2048"]),
        (Model { element: models::FLOAT16, ..of(&FIXED) }, vec!["input \"image\"", "holds F16"]),
        (Model { inputs: 2, ..of(&FIXED) }, vec!["inputs: there are 2; expected one"]),
        (model(&FIXED, Head::Vector), vec!["output: is 1×6 of F32", "1×classes×height×width"]),
        (model(&FIXED, Head::Unknown), vec!["cannot be made ready", "Segment"]),
        (Model::new(&FIXED, Head::Scores, (0..5).map(shown)), vec!["output: has 5 classes", "expected 6"]),
        (model(&FIXED, Head::Shifted), vec!["output: has the class", "expected 0 to 5"]),
    ] {
        let room = Room::new();
        let error = room.open(&model).unwrap_err().to_string();
        for part in parts.into_iter().chain(["model.onnx"]) {
            assert!(error.contains(part), "{part:?} is not in: {error}");
        }
    }
}

#[test]
fn what_is_no_model_is_an_error() {
    let room = Room::new();
    let good = model(&FIXED, Head::Scores).bytes();
    let text = b"RIFF? no, this is a letter.".to_vec();
    for bytes in [text, Vec::new(), good[..good.len() / 2].to_vec(), good[..good.len() - 1].to_vec()] {
        let error = room.open_bytes(&bytes).unwrap_err().to_string();
        assert!(error.contains("model.onnx: is no ONNX model that can be read"), "{error}");
    }
    let error = Segmenter::open(room.file("none.onnx"), "ade20k").unwrap_err().to_string();
    assert!(error.contains("none.onnx: cannot be read"), "{error}");
    let error = Segmenter::open(room.file("none.onnx"), "ade").unwrap_err().to_string();
    assert!(error.contains("ade20k, coco, nyu40"), "{error}");
}

/// Scores that are no numbers, an image without light.
#[test]
fn nothing_known_is_unknown() {
    let room = Room::new();
    let segmenter = room.open(&model(&FIXED, Head::Nan)).unwrap();
    let labels = room.label(&segmenter, room.view(pinhole(), paint));
    assert_eq!(labels, Raster::filled(160, 90, 0));
    let segmenter = room.open(&model(&FIXED, Head::Scores)).unwrap();
    let labels = room.label(&segmenter, room.view(pinhole(), |_| [0.0; 3]));
    assert!(labels.data.iter().all(|id| *id == labels.data[0]));
}

#[test]
fn mutated_models_never_panic() {
    let room = Room::new();
    let small = [Axis::Fixed(1), Axis::Fixed(3), Axis::Fixed(8), Axis::Fixed(8)];
    for head in [Head::Scores, Head::Quarter, Head::Classes { keep_axis: true }] {
        std::fs::write(room.file("model.onnx"), model(&small, head).bytes()).unwrap();
        crate::fuzz::survives(&room.0, &["model.onnx"], crate::fuzz::IMAGE, |folder| {
            let list = folder.join("list.json");
            drop(Segmenter::open(folder.join("model.onnx"), list.to_str().unwrap()));
        });
    }
}
