//! From other programs' files to a capture, and from brackets to a linear image.

use serde_json::Value;
use texir_core::capture::nerfstudio::read_transforms;
use texir_core::image_io::{encode_srgb, read_rgb, write_png_rgb};
use texir_core::raster::Rgb;

use crate::room::{Capture, names};
use crate::texir::{fit, run, succeed};

/// The room as a list of panoramas, its `transforms.json` gone.
fn panoramas() -> (Capture, Value) {
    let capture = Capture::new();
    let path = capture.path();
    let before = succeed(&["inspect".as_ref(), path.as_os_str(), "--json".as_ref()]);
    let views = read_transforms(capture.file("transforms.json")).unwrap();
    let mut list = "file,x,y,z,qx,qy,qz,qw,split\n".to_owned();
    for view in &views {
        let (_, rotation, p) = view.camera.world_from_camera.to_scale_rotation_translation();
        let [x, y, z, w] = rotation.to_array();
        let split = if view.name == "novel" { "novel" } else { "train" };
        list += &format!("{}.exr,{},{},{},{x},{y},{z},{w},{split}\n", view.name, p.x, p.y, p.z);
    }
    std::fs::write(capture.file("panoramas.csv"), list).unwrap();
    std::fs::remove_file(capture.file("transforms.json")).unwrap();
    (capture, serde_json::from_str(&before.out).unwrap())
}

#[test]
fn a_list_of_panoramas_becomes_the_capture_that_it_came_from() {
    let (capture, before) = panoramas();
    let (source, out) = (capture.path(), capture.out("imported"));
    let refused = run(&fit(&source, &capture.out("fit"), &["--backend", "cpu"]));
    refused.complains(&["is no capture yet", "panoramas", "texir import"]);

    let said = succeed(&["inspect".as_ref(), source.as_os_str()]);
    for part in
        ["panoramas; `texir import` makes a capture of it", "assumed", "yaw is counter-clockwise", "it becomes +Z"]
    {
        assert!(said.out.contains(part), "{part:?} is not in {}", said.out);
    }
    let said = succeed(&["import".as_ref(), source.as_os_str(), "-o".as_ref(), out.as_os_str(), "--json".as_ref()]);
    let summary: Value = serde_json::from_str(&said.out).unwrap();
    assert_eq!((&summary["views"], &summary["format"]), (&4.into(), &"panoramas".into()));

    let said = succeed(&["inspect".as_ref(), out.as_os_str(), "--json".as_ref()]);
    let after: Value = serde_json::from_str(&said.out).unwrap();
    assert_eq!(after["origin"]["is_capture"], true);
    assert_eq!((&after["mesh"]["triangles"], &after["atlas"]), (&before["mesh"]["triangles"], &before["atlas"]));
    for (after, before) in after["views"].as_array().unwrap().iter().zip(before["views"].as_array().unwrap()) {
        assert_eq!(
            (&after["name"], &after["split"], &after["no_hit"]),
            (&before["name"], &before["split"], &before["no_hit"])
        );
        let metres = |view: &Value| view["nearest"].as_f64().unwrap();
        assert!((metres(after) - metres(before)).abs() < 1e-4);
    }
    let overlay = capture.out("overlay");
    let refused = run(&["inspect".as_ref(), source.as_os_str(), "--overlay".as_ref(), overlay.as_os_str()]);
    refused.complains(&["--overlay needs a capture", "texir import"]);
    succeed(&["inspect".as_ref(), out.as_os_str(), "--overlay".as_ref(), overlay.as_os_str()]);
    assert_eq!(names(&overlay), ["a.png", "b.png", "c.png", "novel.png"]);
    let again = run(&["import".as_ref(), source.as_os_str(), "-o".as_ref(), out.as_os_str()]);
    again.complains(&["already", "new or empty folder"]);
}

/// Every build knows the options; one without inference says how to get it.
#[test]
fn a_model_that_cannot_be_run_is_refused_before_the_import() {
    let (capture, _) = panoramas();
    let (source, out, model) = (capture.path(), capture.out("imported"), capture.file("model.onnx"));
    std::fs::write(&model, "no model").unwrap();
    let import = ["import".as_ref(), source.as_os_str(), "-o".as_ref(), out.as_os_str()];
    let with = |more: &[&std::ffi::OsStr]| run(&[&import[..], more].concat());
    with(&["--segment".as_ref(), model.as_os_str()]).complains(&["--classes"]);
    let refused = with(&["--segment".as_ref(), model.as_os_str(), "--classes".as_ref(), "ade20k".as_ref()]);
    let why =
        if cfg!(feature = "onnx") { "is no ONNX model that can be read" } else { "build it with `--features onnx`" };
    refused.complains(&["model.onnx", why]);
    assert!(!out.exists());
}

#[test]
fn brackets_become_one_linear_image() {
    let capture = Capture::new();
    let truth: Vec<f32> = (0..64).map(|i| 0.1 * 1.12_f32.powi(i)).collect();
    let mut arguments: Vec<std::ffi::OsString> = vec!["hdr".into()];
    for (i, time) in [1.0, 0.1, 0.01, 0.001].into_iter().enumerate() {
        let shot = Rgb::new(64, 1, truth.iter().map(|v| [v * time; 3]).collect()).unwrap();
        let path = capture.out(&format!("shot_{i}.png"));
        write_png_rgb(&path, &encode_srgb(&shot)).unwrap();
        arguments.push(path.into());
    }
    let out = capture.out("pano.exr");
    let refused = run(&[&arguments[..], &["-o".into(), out.clone().into()]].concat());
    refused.complains(&["shot_0.png", "EXIF", "--times"]);
    assert!(!out.exists());
    let more = ["-o".into(), out.clone().into(), "--times=1,1/10,0.01,1/1000".into(), "--response=srgb".into()];
    succeed(&[&arguments[..], &more].concat());
    for (found, truth) in read_rgb(&out).unwrap().data.iter().zip(truth) {
        assert!((found[0] / truth - 1.0).abs() < 0.02, "{} is not {truth}", found[0]);
    }
    run(&[&arguments[..], &["-o".into(), out.into(), "--times=1".into()]].concat())
        .complains(&["--times has 1", "4 shots"]);
}
