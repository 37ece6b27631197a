//! What cannot be used is refused with its file, its field and a way out, before anything is written. What can be
//! repaired is, loudly.

use std::ffi::OsStr;

use serde_json::{Value, json};
use texir_core::image_io::{read_rgb, write_png_labels, write_rgb};
use texir_core::raster::{Labels, Rgb};

use crate::room::{Capture, HEIGHT, VIEWS, WIDTH};
use crate::texir::{fit, run, succeed};

/// A fit of the capture fails with all `parts` on standard error, and writes nothing.
#[track_caller]
fn refused(capture: &Capture, more: &[&str], parts: &[&str]) {
    let (input, out) = (capture.path(), capture.out("out"));
    let before = capture.outputs();
    let said = run(&fit(&input, &out, &[&["--backend", "cpu", "--no-eval"], more].concat()));
    assert_eq!(said.code, Some(1), "{said:#?}");
    said.complains(parts);
    assert!(!said.err.contains("panicked"), "{}", said.err);
    assert_eq!(capture.outputs(), before, "a fit that fails writes nothing");
}

/// A fit of the capture succeeds, and says all `parts` on standard error, even when asked to be quiet.
#[track_caller]
fn repaired(capture: &Capture, parts: &[&str]) {
    let (input, out) = (capture.path(), capture.out("out"));
    let said = succeed(&fit(&input, &out, &["--backend", "cpu", "--no-eval", "--quiet"]));
    said.complains(&["warning"]);
    said.complains(parts);
    let mut warnings: Vec<&str> = said.err.split("warning: ").collect();
    let all = warnings.len();
    warnings.sort_unstable();
    warnings.dedup();
    assert_eq!(warnings.len(), all, "the same is said twice: {}", said.err);
    assert!(out.join("scene.glb").is_file());
}

#[test]
fn nothing_is_wrong_with_the_room() {
    let capture = Capture::new();
    let (input, out) = (capture.path(), capture.out("out"));
    let said = succeed(&fit(&input, &out, &["--backend", "cpu", "--no-eval", "--quiet"]));
    assert_eq!(said.err, "");
}

#[test]
fn missing_and_truncated_images() {
    let capture = Capture::new();
    let path = capture.file("hdr/novel.exr");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 200]).unwrap();
    refused(&capture, &[], &["hdr/novel.exr", "cut short", "copy or export it again"]);
    std::fs::write(&path, &bytes[..40]).unwrap();
    refused(&capture, &[], &["hdr/novel.exr", "cannot be read"]);
    std::fs::remove_file(&path).unwrap();
    refused(&capture, &[], &["hdr/novel.exr", "does not exist", "file_path", "expected an image"]);
}

#[test]
fn unusable_camera_matrices() {
    for (row, parts) in [
        (json!([0.0, 0.0, 0.0, 1.0]), ["transforms.json", "transform_matrix", "singular"]),
        (json!([-1.0, 0.0, 0.0, 1.0]), ["transforms.json", "transform_matrix", "mirror"]),
    ] {
        let capture = Capture::new();
        capture.edit(|document| {
            let matrix = &mut document["frames"][1]["transform_matrix"];
            *matrix = json!([row, [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]]);
        });
        refused(&capture, &[], &parts);
        refused(&capture, &[], &["expected"]);
    }
}

#[test]
fn a_mesh_without_an_atlas() {
    let capture = Capture::new();
    capture.edit_mesh(|line| match line.split_once(' ') {
        Some(("vt", _)) => String::new(),
        // v/vt/vn
        Some(("f", _)) => line
            .split(' ')
            .map(|corner| match corner.split('/').collect::<Vec<_>>()[..] {
                [v, _, n] => format!("{v}//{n}"),
                _ => corner.to_owned(),
            })
            .collect::<Vec<_>>()
            .join(" "),
        _ => line.to_owned(),
    });
    refused(&capture, &[], &["mesh.obj", "no texture coordinates", "texir import"]);
    let (source, out) = (capture.path(), capture.out("unwrapped"));
    let said = succeed(&["import".as_ref(), source.as_os_str(), "-o".as_ref(), out.as_os_str()]);
    assert!(said.out.contains("the mesh gets a new atlas"), "{}", said.out);
    let said = succeed(&["inspect".as_ref(), out.as_os_str(), "--json".as_ref()]);
    let atlas = serde_json::from_str::<Value>(&said.out).unwrap()["atlas"].take();
    assert_eq!((&atlas["overlapping_fraction"], &atlas["outside_triangles"]), (&0.0.into(), &0.into()));
    assert!(atlas["covered_fraction"].as_f64().unwrap() > 0.5, "{atlas}");
}

#[test]
fn semantics_of_another_size() {
    let capture = Capture::new();
    write_png_labels(capture.file("semantic/b.png"), &Labels::filled(WIDTH, HEIGHT + 1, 1)).unwrap();
    refused(&capture, &[], &["semantic/b.png", "semantic_path", "32×17", "expected 32×16", "scale w, h"]);
}

#[test]
fn no_light_at_all() {
    let capture = Capture::new();
    for name in VIEWS {
        write_rgb(capture.file(&format!("hdr/{name}.exr")), &Rgb::filled(WIDTH, HEIGHT, [0.0; 3])).unwrap();
    }
    refused(&capture, &[], &["transforms.json", "file_path", "black", "expected linear radiance above 0"]);
}

#[test]
fn unknown_and_impossible_settings() {
    let capture = Capture::new();
    let config = capture.out("settings.toml");
    for (text, parts) in [
        ("[fit.paper]\nspecular_sample = 4\n", ["unknown field", "specular_sample", "specular_samples"]),
        ("[fit.paper]\nspecular_samples = 0\n", ["specular_samples", "0", "1 to 1048576"]),
        ("[fit.paper.parameters]\nalbedo_range = [0.9, 0.1]\n", ["albedo_range[1]", "0.1", "above the lower bound"]),
        ("[fit.paper.stage_two]\nquantile = 1.5\n", ["stage_two.quantile", "1.5", "[0, 1]"]),
        ("[fit.paper.stage_one]\nsemantic_weight = nan\n", ["semantic_weight", "NaN", "at least 0"]),
    ] {
        std::fs::write(&config, text).unwrap();
        // The quick settings would hide the file's.
        let (input, out) = (capture.path(), capture.out("out"));
        let said = run(&[
            "fit".as_ref(),
            input.as_os_str(),
            "-o".as_ref(),
            out.as_os_str(),
            "--config".as_ref(),
            config.as_os_str(),
        ]);
        assert_eq!(said.code, Some(1), "{said:#?}");
        said.complains(&["settings.toml"]);
        said.complains(&parts);
        assert_eq!(capture.outputs(), ["settings.toml"]);
    }
    refused(&capture, &["--set", "fit.emitter_ratio=0.0"], &["--set", "emitter_ratio", "above 0"]);
    refused(&capture, &["--mode", "paper", "--metallic"], &["full.metallic.enabled", "paper", "mode full"]);
    refused(&capture, &["--set", "fit.emitter=3.0"], &["--set", "unknown field", "emitter"]);
}

#[test]
fn no_texels_and_no_samples() {
    let capture = Capture::new();
    let (input, out) = (capture.path(), capture.out("out.exr"));
    for (command, option) in [("tbl", "--size"), ("bake", "--size")] {
        let how = [option.as_ref(), "0".as_ref(), "-o".as_ref(), out.as_os_str(), "--backend".as_ref(), "cpu".as_ref()];
        let said = run(&[&[command.as_ref(), input.as_os_str()], &how[..]].concat());
        assert_eq!(said.code, Some(2), "{command} {option} 0: {said:#?}");
        said.complains(&[option, "0 is not in 1.."]);
        assert_eq!(capture.outputs(), [""; 0]);
    }
    for command in ["render", "eval", "report", "bake"] {
        let more = if command == "render" { &["--cameras", "cameras.json", "-o", "renders"][..] } else { &[] };
        let said = run(&[&[command, "out", "--spp", "0"], more].concat());
        assert_eq!(said.code, Some(2), "{command}: {said:#?}");
        said.complains(&["--spp", "0 is not in 1.."]);
    }
}

#[test]
fn options_that_would_do_nothing() {
    let capture = Capture::new();
    let (input, out) = (capture.path(), capture.out("out.exr"));
    let texture = capture.file("mesh.obj");
    let cases: [(&str, &str, &OsStr); 6] = [
        ("bake", "--bounces", "2".as_ref()),
        ("bake", "--tolerance", "0.1".as_ref()),
        ("bake", "--environment", texture.as_os_str()),
        ("bake", "--profile", "moz".as_ref()),
        ("bake", "--set", "fit.atlas_size=64".as_ref()),
        ("ablate", "--set", "fit.mode=\"full\"".as_ref()),
    ];
    for (command, option, value) in cases {
        let how = [command.as_ref(), input.as_os_str(), "-o".as_ref(), out.as_os_str(), option.as_ref(), value];
        let said = run(&how);
        assert_eq!(said.code, Some(1), "{command} {option}: {said:#?}");
        said.complains(&[option, "leave it out"]);
        assert_eq!(capture.outputs(), [""; 0]);
    }
}

#[test]
fn pixels_that_no_radiance_has() {
    let capture = Capture::new();
    let path = capture.file("hdr/a.exr");
    let mut image = read_rgb(&path).unwrap();
    image.data[3][0] = f32::NAN;
    image.data[4][1] = f32::INFINITY;
    image.data[70][2] = -1.0;
    write_rgb(&path, &image).unwrap();
    repaired(&capture, &["hdr/a.exr", "2 pixels are NaN, infinite or above 1e35, and 1 negative", "taken as 0"]);
}

#[test]
fn an_atlas_that_overlaps() {
    let capture = Capture::new();
    // The second quad's chart moves onto the first's.
    let mut coordinate = 0;
    capture.edit_mesh(|line| {
        let Some(("vt", uv)) = line.split_once(' ') else { return line.to_owned() };
        let (u, v) = uv.split_once(' ').unwrap();
        coordinate += 1;
        let shift = if (5..=8).contains(&coordinate) { 0.25 } else { 0.0 };
        format!("vt {} {v}", u.parse::<f32>().unwrap() - shift)
    });
    repaired(&capture, &["mesh.obj", "overlap on 9.1 %", "texir import --unwrap"]);
}

#[test]
fn triangles_without_area() {
    let capture = Capture::new();
    let mut first = true;
    capture.edit_mesh(|line| match line.split_once(' ') {
        Some(("f", corners)) if std::mem::take(&mut first) => {
            let corner = corners.split(' ').next().unwrap();
            format!("{line}\nf {corner} {corner} {corner}\nf {corner} {corner} {corner}")
        }
        _ => line.to_owned(),
    });
    repaired(&capture, &["mesh.obj", "2 of 26 triangles have no area", "left out"]);
}

/// The command fails, says so, and leaves the file as it is.
#[track_caller]
fn keeps(file: &std::path::Path, arguments: &[&OsStr], parts: &[&str]) {
    let before = std::fs::read(file).unwrap();
    let said = run(arguments);
    assert_eq!(said.code, Some(1), "{said:#?}");
    said.complains(parts);
    assert!(std::fs::read(file).unwrap() == before, "{} was replaced", file.display());
}

#[test]
fn outputs_that_would_replace_what_they_are_made_of() {
    let capture = Capture::new();
    let (input, image, images) = (capture.path(), capture.file("hdr/novel.exr"), capture.file("hdr"));
    let (cameras, mesh) = (capture.file("transforms.json"), capture.file("mesh.obj"));
    let [input, hdr, folder, of] = [&input, &image, &images, &cameras].map(|path| path.as_os_str());
    let o = OsStr::new;
    let replaced = ["novel.exr", "would replace an input", "another name"];
    keeps(&image, &[o("tbl"), input, o("-o"), hdr, o("--size"), o("16")], &replaced);
    keeps(&image, &[o("bake"), input, o("-o"), hdr, o("--size"), o("16"), o("--spp"), o("4")], &replaced);
    keeps(&image, &[o("hdr"), hdr, hdr, o("--times"), o("1,2"), o("-o"), hdr], &replaced);
    let picture = capture.out("picture.png");
    for command in [&[o("tbl"), input][..], &[o("hdr"), hdr, hdr, o("--times"), o("1,2")]] {
        keeps(&image, &[command, &[o("-o"), picture.as_os_str()]].concat(), &["picture.png", "ends in .exr"]);
    }
    let mask = capture.file("light_mask.png");
    write_png_labels(&mask, &Labels::new(WIDTH, HEIGHT, vec![255; WIDTH * HEIGHT]).unwrap()).unwrap();
    capture.edit(|document| document["frames"][0]["mask_path"] = "light_mask.png".into());
    let light = capture.file("light.exr");
    let beside = ["light_mask.png", "would replace an input"];
    keeps(&mask, &[o("tbl"), input, o("-o"), light.as_os_str(), o("--size"), o("16")], &beside);
    let inside = ["which this command reads", "another folder"];
    keeps(&image, &[o("inspect"), input, o("--overlay"), folder], &inside);
    let fitting = fit(&capture.path(), &capture.path(), &["--backend", "cpu", "--no-eval"]);
    keeps(&mesh, &fitting.iter().map(|argument| argument.as_os_str()).collect::<Vec<_>>(), &inside);

    // Negative controls: beside them is fine, and an HDR texture may be made anew.
    let texture = capture.file("hdr_texture.exr");
    let tbl = [o("tbl"), input, o("-o"), texture.as_os_str(), o("--size"), o("16"), o("--backend"), o("cpu")];
    succeed(&tbl);
    succeed(&tbl);
    std::fs::remove_file(&texture).unwrap();
    let out = capture.out("out");
    succeed(&fit(&capture.path(), &out, &["--backend", "cpu", "--no-eval"]));
    let render = [o("render"), out.as_os_str(), o("--cameras"), of, o("--spp"), o("1"), o("-o")];
    keeps(&image, &[&render[..], &[folder]].concat(), &inside);
    keeps(&out.join("scene.glb"), &[&render[..], &[out.as_os_str()]].concat(), &inside);
    let said = succeed(&[&render[..], &[capture.out("views").as_os_str()]].concat());
    said.complains(&["--spp is 1", "96 rays per pixel"]);
    assert_eq!(said.err.matches("--spp is").count(), 1, "{}", said.err);
}

#[test]
fn masks_that_leave_nothing() {
    let capture = Capture::new();
    let (width, height) = (WIDTH, HEIGHT);
    let mask = capture.file("black.png");
    write_png_labels(&mask, &Labels::new(width, height, vec![0; width * height]).unwrap()).unwrap();
    let masked = |path: serde_json::Value| {
        capture.edit(|document| {
            for frame in document["frames"].as_array_mut().unwrap() {
                frame["mask_path"] = path.clone();
            }
        });
        succeed(&["inspect".as_ref(), capture.path().as_os_str()]).out
    };
    let said = masked("black.png".into());
    assert!(said.contains("masks leave out 100 %") && said.contains("inverted"), "{said}");
    assert!(!masked(Value::Null).contains("masks leave out"));
}
