//! What a capture's views show is looked at before anything is fitted: what ruins a result without stopping it is told.

use texir_core::image_io::{read_gray, read_rgb, write_rgb};

use crate::room::{Capture, WIDTH};
use crate::texir::{fit, succeed};

/// What `texir inspect` warns of.
fn told(capture: &Capture) -> Vec<String> {
    let said = succeed(&["inspect".as_ref(), capture.path().as_os_str(), "--quiet".as_ref()]);
    let warnings = said.out.lines().filter_map(|line| line.strip_prefix("warning: "));
    // The room is coarse, and has no list of classes.
    warnings.map(str::to_owned).collect()
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
    is_told(&capture, &["brighter or darker", "\"c\" (\"c\" 3.", "--solve-exposure"]);
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
        let out = capture.out("out");
        let of_fit = ["fit".into(), capture.path().into_os_string(), "-o".into(), out.clone().into_os_string()];
        let more = ["--backend", "cpu", "--no-eval", "--quiet", "--set", "fit.atlas_size=64"].map(Into::into);
        succeed(&of_fit.into_iter().chain(more).collect::<Vec<std::ffi::OsString>>());
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
