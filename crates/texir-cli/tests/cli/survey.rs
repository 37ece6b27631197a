//! What a capture's views show is looked at before anything is fitted: what ruins a result without stopping it is told.

use std::ffi::OsString;
use std::path::PathBuf;

use texir_core::image_io::{read_gray, read_labels, read_rgb, write_png_labels, write_rgb};

use crate::room::{Capture, WIDTH};
use crate::texir::{Said, fit, succeed};

/// What `texir inspect` warns of.
fn told(capture: &Capture) -> Vec<String> {
    let said = succeed(&["inspect".as_ref(), capture.path().as_os_str(), "--quiet".as_ref()]);
    let warnings = said.out.lines().filter_map(|line| line.strip_prefix("warning: "));
    // The room is coarse, and has no list of classes.
    warnings.map(str::to_owned).collect()
}

/// A fit in full mode, with where its output is.
fn fit_fully(capture: &Capture) -> (PathBuf, Said) {
    let out = capture.out("out");
    let mut arguments: Vec<OsString> = vec!["fit".into(), capture.path().into(), "-o".into(), out.clone().into()];
    let more = ["--backend", "cpu", "--no-eval", "--quiet", "--set", "fit.atlas_size=64"];
    arguments.extend(more.map(OsString::from));
    let said = succeed(&arguments);
    (out, said)
}

/// Changes the pixels of an image, by their index.
fn paint(capture: &Capture, view: &str, change: impl Fn(usize, [f32; 3]) -> [f32; 3]) {
    let path = capture.file(&format!("hdr/{view}.exr"));
    let mut image = read_rgb(&path).unwrap();
    image.data = (image.data.iter().enumerate()).map(|(i, pixel)| change(i, *pixel)).collect();
    write_rgb(&path, &image).unwrap();
}

/// One warning more than a sound capture has, with all of `parts`.
#[track_caller]
fn is_told(capture: &Capture, parts: &[&str]) {
    let (told, sound) = (told(capture), told(&Capture::new()));
    let more: Vec<&String> = told.iter().filter(|told| !sound.contains(told)).collect();
    let [warning] = more[..] else { panic!("one more, not {more:#?}") };
    parts.iter().for_each(|part| assert!(warning.contains(part), "{part:?} is not in: {warning}"));
}

/// Changes the faces of the mesh, by their number.
fn edit_faces(capture: &Capture, mut change: impl FnMut(usize, &str) -> String) {
    let mut face = 0;
    capture.edit_mesh(|line| match line.strip_prefix("f ") {
        Some(corners) => {
            face += 1;
            change(face - 1, corners)
        }
        None => line.to_owned(),
    });
}

#[test]
fn lamps_that_face_the_wrong_way() {
    let capture = Capture::new();
    // Two triangles a quad; the lamp is the last of twelve.
    edit_faces(&capture, |face, corners| {
        let turned: Vec<&str> = corners.split(' ').rev().collect();
        format!("f {}", if face >= 22 { turned.join(" ") } else { corners.to_owned() })
    });
    is_told(&capture, &["from the backs of faces", "of the light", "turn these faces around"]);
}

#[test]
fn surfaces_that_are_missing() {
    let capture = Capture::new();
    // A wall.
    edit_faces(&capture, |face, corners| if face / 2 == 2 { String::new() } else { format!("f {corners}") });
    is_told(&capture, &["where the mesh has no surface", "close them"]);
}

#[test]
fn views_that_contradict_the_others() {
    let capture = Capture::new();
    // The image of another place.
    paint(&capture, "b", |i, _| [if (i % WIDTH / 4).is_multiple_of(2) { 0.05 } else { 2.0 }; 3]);
    is_told(&capture, &["do not show what the others show", "\"b\"", "pose"]);
}

#[test]
fn views_that_are_exposed_otherwise() {
    let capture = Capture::new();
    paint(&capture, "c", |_, pixel| pixel.map(|v| 4.0 * v));
    is_told(&capture, &["exposed differently", "\"c\" most (4.0", "--solve-exposure"]);
}

#[test]
fn images_that_are_clipped() {
    let capture = Capture::new();
    for view in ["a", "b", "c"] {
        paint(&capture, view, |_, pixel| pixel.map(|v| v.min(2.0)));
    }
    is_told(&capture, &["3 training images end at 2", "clipped", "texir hdr"]);
}

#[test]
fn views_that_are_too_few_to_tell_highlights_from_paint() {
    let capture = Capture::new();
    capture.edit(|transforms| {
        let frames = transforms["frames"].as_array_mut().unwrap();
        frames.retain(|frame| !frame["file_path"].as_str().unwrap().ends_with("c.exr"));
    });
    is_told(&capture, &["2 training views", "expected several views of every room"]);
}

#[test]
fn cameras_that_are_not_at_the_height_of_hands_or_heads() {
    let capture = Capture::new();
    // The same room in feet.
    const FOOT: f64 = 0.3048;
    capture.edit_mesh(|line| match line.strip_prefix("v ") {
        Some(place) => {
            let feet = place.split(' ').map(|metres| (metres.parse::<f64>().unwrap() / FOOT).to_string());
            format!("v {}", feet.collect::<Vec<_>>().join(" "))
        }
        None => line.to_owned(),
    });
    capture.edit(|transforms| {
        for frame in transforms["frames"].as_array_mut().unwrap() {
            for row in frame["transform_matrix"].as_array_mut().unwrap().iter_mut().take(3) {
                row[3] = (row[3].as_f64().unwrap() / FOOT).into();
            }
        }
    });
    is_told(&capture, &["above what is below them", "--metres-per-unit"]);
}

#[test]
fn semantic_images_that_contradict_each_other() {
    let capture = Capture::new();
    // Every view has classes of its own, as segmentations of instances have.
    for (view, image) in ["a", "b", "c"].into_iter().enumerate() {
        let path = capture.file(&format!("semantic/{image}.png"));
        let mut labels = read_labels(&path).unwrap();
        labels.data.iter_mut().filter(|id| **id > 0).for_each(|id| *id += 10 * view as u16);
        write_png_labels(&path, &labels).unwrap();
    }
    fit_fully(&capture).1.complains(&["semantic_path", "% agrees", "the same in every view?"]);
    // Negative control.
    let (_, sound) = fit_fully(&Capture::new());
    assert!(!sound.err.contains("% agrees"), "{}", sound.err);
}

#[test]
fn images_that_are_black_are_left_out() {
    let capture = Capture::new();
    paint(&capture, "a", |_, _| [0.0; 3]);
    let out = capture.out("out");
    let said = succeed(&fit(&capture.path(), &out, &["--backend", "cpu", "--no-eval", "--quiet"]));
    said.complains(&["hdr/a.exr", "black throughout, and left out"]);
    // Two views are left: what they show is painted as with all three, and nothing is black.
    let albedo = read_rgb(out.join("albedo.exr")).unwrap();
    assert!(albedo.data.iter().filter(|a| a[0] > 0.1).count() > albedo.data.len() / 4);
}

#[test]
fn light_may_be_in_any_unit() {
    let fitted = |factor: f32| {
        let capture = Capture::new();
        ["a", "b", "c"].iter().for_each(|view| paint(&capture, view, |_, pixel| pixel.map(|v| factor * v)));
        let (out, _) = fit_fully(&capture);
        let albedo = read_rgb(out.join("albedo.exr")).unwrap();
        let roughness = read_gray(out.join("roughness.exr")).unwrap();
        let light = ["emission.exr", "irradiance.exr", "hdr_texture.exr"]
            .map(|name| read_rgb(out.join(name)).unwrap().map(|pixel| pixel.map(|v| v / factor)));
        (albedo, roughness, light)
    };
    let usual = fitted(1.0);
    for factor in [1e-9, 1e9] {
        let other = fitted(factor);
        let off = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32;
        assert!(off(other.0.data.as_flattened(), usual.0.data.as_flattened()) < 1e-3, "albedo at {factor}");
        assert!(off(&other.1.data, &usual.1.data) < 1e-2, "roughness at {factor}");
        for (other, usual) in other.2.iter().zip(&usual.2) {
            assert!(off(other.data.as_flattened(), usual.data.as_flattened()) < 1e-2, "light at {factor}");
        }
    }
}
