//! Mutated files of every format.

use super::formats;
use super::*;
use crate::capture::nerfstudio;
use crate::fuzz::{IMAGE, TEXT, survives};

/// As `texir import` starts, and with the lens that comes out of it.
fn import(folder: &Path) {
    let Ok(read) = read(folder, &ImportOptions::default(), &Silent) else { return };
    for shot in &read.shots {
        let lens = shot.distortion.and_then(|lens| crate::capture::lens::Undistortion::new(&shot.view.camera, lens));
        if let Some(lens) = lens {
            assert!(lens.pinhole.pixels() <= 16 * shot.view.camera.pixels());
        }
    }
}

#[test]
fn colmap() {
    let model = |extension| ["cameras", "images"].map(|name| format!("sparse/0/{name}.{extension}"));
    for (binary, files) in [(true, model("bin")), (false, model("txt"))] {
        survives(&formats::colmap(Vec3::Z, binary), &files.each_ref().map(String::as_str), TEXT, import);
    }
}

#[test]
fn colmap_with_a_lens() {
    let folder = formats::colmap(Vec3::Z, false);
    let path = folder.path().join("sparse/0/cameras.txt");
    for line in
        ["7 FULL_OPENCV 8 4 5 5 4 2 0.1 0.01 0.001 0.002 0.03 0.1 0.02 0.003", "7 OPENCV_FISHEYE 8 4 5 5 4 2 .1 0 0 0"]
    {
        std::fs::write(&path, line).unwrap();
        survives(&folder, &["sparse/0/cameras.txt"], TEXT, import);
    }
}

#[test]
fn nerfstudio_transforms() {
    survives(&formats::nerfstudio(), &["transforms.json"], TEXT, |folder| {
        import(folder);
        drop(nerfstudio::read_transforms(folder.join("transforms.json")));
    });
}

#[test]
fn blender() {
    survives(&formats::blender_scene(), &["transforms_train.json"], TEXT, import);
}

#[test]
fn panoramas() {
    let [json, quaternions, angles] = formats::panorama_lists();
    survives(&json, &["panoramas.json"], TEXT, import);
    survives(&quaternions, &["panoramas.csv"], TEXT, import);
    survives(&angles, &["panoramas.csv"], TEXT, import);
}

#[test]
fn matterport() {
    let files = ["matterport_camera_poses/ab_pose_0_1.txt", "matterport_camera_intrinsics/ab_intrinsics_0.txt"];
    survives(&formats::matterport(), &files, TEXT, import);
    survives(&formats::matterport_undistorted().0, &["undistorted_camera_parameters/xyz.conf"], TEXT, import);
}

#[test]
fn texir_authors() {
    let files = ["info/aligned.txt", "info/final_extrinsics.txt"];
    survives(&formats::texir_authors().0, &files, TEXT, import);
}

#[test]
fn gltf() {
    survives(&formats::gltf(true), &["scene.gltf"], TEXT, import);
    survives(&formats::gltf(false), &["scene.gltf", "scene.bin"], TEXT, import);
}

/// From the source to a capture that loads, whatever image, mesh or list is damaged.
#[test]
fn whole_imports() {
    let through = |folder: &Path| {
        let out = tempfile::tempdir().unwrap();
        let options = ImportOptions { curve: Some(TransferCurve::Srgb), ..ImportOptions::default() };
        let written = read(folder, &options, &Silent).and_then(|read| write(&read, out.path(), &options, &Silent));
        if written.is_ok() {
            drop(crate::capture::load(out.path(), &Default::default(), &Silent));
        }
    };
    let own = ["transforms.json", "mesh.obj", "photos/v0.exr", "ids.png", "rough.exr"];
    survives(&formats::nerfstudio(), &own, IMAGE, through);
    let authors = [
        "info/final_extrinsics.txt",
        "hdr/1646101/ccm.hdr",
        "derived/1646101/panoImage_gray.png",
        "derived/1646101/panoImage_orig.jpg",
        "hdr_texture/hdr_texture.hdr",
    ];
    survives(&formats::texir_authors().0, &authors, IMAGE, through);
    survives(&formats::gltf(false), &["scene.gltf", "scene.bin"], IMAGE, through);
}
