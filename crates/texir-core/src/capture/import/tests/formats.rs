//! Round trips of every format.

use serde_json::json;

use super::*;
use crate::capture::Tbl;
use crate::capture::tests::Warnings;
use crate::glb::{Materials, Up, write_glb};
use crate::image_io::{read_labels, read_mask, write_gray, write_png_labels, write_png_rgb};
use crate::raster::{Gray, Labels, Raster};

/// The COLMAP model of the scene in a world of other orientation, text or binary.
pub(super) fn colmap(up: Vec3, binary: bool) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let model = root.join("sparse/0");
    std::fs::create_dir_all(&model).unwrap();
    let quaternion_and_translation = |pose: DMat4| {
        let (_, rotation, translation) = opencv(source_from_texir(up) * pose).inverse().to_scale_rotation_translation();
        ([rotation.w, rotation.x, rotation.y, rotation.z], translation.to_array())
    };
    if binary {
        let mut cameras = 1_u64.to_le_bytes().to_vec();
        cameras.extend([7_u32.to_le_bytes(), 1_u32.to_le_bytes()].concat());
        cameras.extend([WIDTH as u64, HEIGHT as u64].map(u64::to_le_bytes).concat());
        cameras.extend([5.0, 5.0, WIDTH as f64 / 2.0, HEIGHT as f64 / 2.0].map(f64::to_le_bytes).concat());
        let mut images = (poses().len() as u64).to_le_bytes().to_vec();
        for (i, pose) in poses().into_iter().enumerate() {
            let (rotation, translation) = quaternion_and_translation(pose);
            images.extend((i as u32 + 1).to_le_bytes());
            images.extend(rotation.iter().chain(&translation).flat_map(|v| v.to_le_bytes()));
            images.extend(7_u32.to_le_bytes());
            images.extend(format!("photo {i}.jpg\0").as_bytes());
            images.extend(2_u64.to_le_bytes());
            images.extend([0x42; 48]);
        }
        std::fs::write(model.join("cameras.bin"), cameras).unwrap();
        std::fs::write(model.join("images.bin"), images).unwrap();
    } else {
        let cameras = format!("# a comment\n7 SIMPLE_PINHOLE {WIDTH} {HEIGHT} 5 {} {}\n", WIDTH / 2, HEIGHT / 2);
        let mut images = "# IMAGE_ID ...\n".to_owned();
        for (i, pose) in poses().into_iter().enumerate() {
            let ([w, x, y, z], [a, b, c]) = quaternion_and_translation(pose);
            let points = ["", "1.5 2.5 -1 3.0 4.0 17"][i % 2];
            images += &format!("{} {w} {x} {y} {z} {a} {b} {c} 7 photo {i}.jpg\n{points}\n", i + 1);
        }
        std::fs::write(model.join("cameras.txt"), cameras).unwrap();
        std::fs::write(model.join("images.txt"), images).unwrap();
    }
    write_images(&root.join("images"), |i| format!("photo {i}.exr"));
    write_mesh(&root.join("mesh.obj"), up, 1.0);
    folder
}

#[test]
fn colmap_text_and_binary() {
    for binary in [false, true] {
        for up in [Vec3::Z, Vec3::NEG_Y, Vec3::Y] {
            assert_reads(&colmap(up, binary), "colmap", pinhole());
        }
    }
}

#[test]
fn colmap_without_an_axis_that_may_be_up_takes_the_cameras_word_for_it() {
    // One that is far from all axes, and one that is 6° from −Y, farther than the cameras' mean can be off.
    for up in [Vec3::new(1.0, 1.0, 1.0).normalize(), Vec3::new(0.105, -0.995, 0.0).normalize()] {
        let folder = colmap(up, true);
        let read = super::super::read(folder.path(), &ImportOptions::default(), &Silent).unwrap();
        assert_says(&read.assumed.join("\n"), &["the cameras' mean up direction; the format"]);
        let heights: Vec<f32> = read.mesh.positions.iter().map(|p| p.z).collect();
        let level = heights[..4].iter().all(|z| z.abs() < 0.1) && heights[4..].iter().all(|z| (z - 2.5).abs() < 0.1);
        assert!(level, "{up}: {heights:?}");
    }
    let up = Vec3::new(1.0, 1.0, 1.0).normalize();
    let folder = colmap(up, true);
    let options = ImportOptions { up: Some(up), ..ImportOptions::default() };
    let told = super::super::read(folder.path(), &options, &Silent).unwrap();
    assert!((told.mesh.positions[4].z - 2.5).abs() < 1e-5);
}

#[test]
fn units_become_metres() {
    let folder = colmap(Vec3::Z, false);
    let options = ImportOptions { metres_per_unit: Some(0.5), ..ImportOptions::default() };
    let read = super::super::read(folder.path(), &options, &Silent).unwrap();
    assert_eq!(read.mesh.positions[2], Vec3::new(2.0, 1.5, 0.0));
    let (half, whole) = (read.shots[1].view.camera.position(), poses()[1].w_axis.truncate().as_vec3());
    assert!((2.0 * half - whole).length() < 1e-5);
    for wrong in [0.0, -1.0, f64::NAN] {
        let options = ImportOptions { metres_per_unit: Some(wrong), ..ImportOptions::default() };
        assert!(super::super::read(folder.path(), &options, &Silent).is_err());
    }
}

#[test]
fn damaged_colmap_models_are_errors() {
    let folder = colmap(Vec3::Z, true);
    for name in ["cameras.bin", "images.bin"] {
        let path = folder.path().join("sparse/0").join(name);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        assert_says(&complaint(&folder), &[name, "cut off"]);
        std::fs::write(&path, [&[0xff; 8], &bytes[8..]].concat()).unwrap();
        assert_says(&complaint(&folder), &[name, "entries"]);
        std::fs::write(&path, &bytes).unwrap();
    }
    let folder = colmap(Vec3::Z, false);
    for (name, from, to, parts) in [
        ("cameras.txt", "SIMPLE_PINHOLE", "FOV", ["line 2", "FOV", "image_undistorter"]),
        ("cameras.txt", "PINHOLE 8 4 5", "PINHOLE 8 4 x", ["line 2", "3 numbers", "SIMPLE_PINHOLE"]),
        ("cameras.txt", "7 SIMPLE", "8 SIMPLE", ["images.txt", "camera 7", "cameras.txt"]),
        ("images.txt", " 7 photo 0", " seven photo 0", ["line 2", "CAMERA_ID", "seven"]),
        ("images.txt", " 7 photo 0.jpg", " 7", ["line 2", "NAME", "cut off"]),
        (
            "images.txt",
            "photo 0.jpg\n\n",
            "photo 0.jpg\n",
            ["line 3", "\"photo\" stands", "empty where there are none"],
        ),
    ] {
        let path = folder.path().join("sparse/0").join(name);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from));
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        assert_says(&complaint(&folder), &parts);
        std::fs::write(&path, text).unwrap();
    }
}

/// The scene as the NeRF-synthetic scenes are written.
pub(super) fn blender_scene() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_images(root, |i| format!("{}/r_{i}.exr", if i < 2 { "train" } else { "test" }));
    for (split, range) in [("train", 0..2), ("test", 2..4)] {
        let frame = |i: usize| {
            let rows = poses()[i].transpose().to_cols_array_2d();
            json!({"file_path": format!("./{split}/r_{i}"), "rotation": 0.1, "transform_matrix": rows})
        };
        let angle = 2.0 * (0.5 * WIDTH as f64 / 5.0).atan();
        let file = json!({"camera_angle_x": angle, "frames": range.map(frame).collect::<Vec<_>>()});
        std::fs::write(root.join(format!("transforms_{split}.json")), file.to_string()).unwrap();
    }
    write_mesh(&root.join("mesh.obj"), Vec3::Z, 1.0);
    folder
}

#[test]
fn blender() {
    let folder = blender_scene();
    let read = assert_reads(&folder, "blender", pinhole());
    assert_eq!(read.shots.iter().filter(|shot| shot.view.split == Split::Novel).count(), 2);
    let wrong = json!({"camera_angle_x": 4.0, "frames": []});
    std::fs::write(folder.path().join("transforms_train.json"), wrong.to_string()).unwrap();
    assert_says(&complaint(&folder), &["transforms_train.json", "camera_angle_x is 4"]);
}

/// The scene as a list in JSON, as one with quaternions, and as one with angles.
pub(super) fn panorama_lists() -> [TempDir; 3] {
    let rotation = |i: usize| DQuat::from_mat4(&poses()[i]);
    let position = |i: usize| poses()[i].w_axis.truncate();
    let row = |i: usize| {
        let (q, p) = (rotation(i), position(i));
        json!({"file": format!("p{i}.exr"), "x": p.x, "y": p.y, "z": p.z, "qw": q.w, "qx": q.x, "qy": q.y, "qz": q.z})
    };
    let csv_row = |i: usize| {
        let (q, p) = (rotation(i), position(i));
        format!("p{i}.exr;{};{};{};{};{};{};{}\n", p.x, p.y, p.z, q.w, q.x, q.y, q.z)
    };
    // Yaw is where the image's centre looks, pitch how far up, roll what is left.
    let angles = |i: usize| {
        let (pose, p) = (poses()[i], position(i));
        let forward = -pose.z_axis.truncate();
        let (yaw, pitch) = (forward.y.atan2(forward.x), forward.z.asin());
        let level_right = DVec3::new(yaw.sin(), -yaw.cos(), 0.0);
        let level_up = level_right.cross(forward);
        let right = pose.x_axis.truncate();
        let roll = (-right.dot(level_up)).atan2(right.dot(level_right));
        let [yaw, pitch, roll] = [yaw, pitch, roll].map(f64::to_degrees);
        format!("p{i}.exr , {}, {}, {}, {yaw}, {pitch}, {roll}\n", p.x, p.y, p.z)
    };
    let all = |line: &dyn Fn(usize) -> String| (0..4).map(line).collect::<String>();
    [
        ("panoramas.json", json!((0..4).map(row).collect::<Vec<_>>()).to_string()),
        ("panoramas.csv", format!("# made by hand\nfile;x;y;z;qw;qx;qy;qz\n{}", all(&csv_row))),
        ("panoramas.csv", format!("file,x,y,z,yaw,pitch,roll\n{}", all(&angles))),
    ]
    .map(|(name, text)| {
        let folder = tempfile::tempdir().unwrap();
        write_images(&folder.path().join("hdr"), |i| format!("p{i}.exr"));
        write_mesh(&folder.path().join("flat.obj"), Vec3::Z, 1.0);
        std::fs::write(folder.path().join(name), text).unwrap();
        folder
    })
}

#[test]
fn lists_of_panoramas() {
    for folder in panorama_lists() {
        assert_reads(&folder, "panoramas", Projection::Equirectangular);
    }
    let folder = tempfile::tempdir().unwrap();
    let bad = |text: &str| {
        std::fs::write(folder.path().join("panoramas.csv"), text).unwrap();
        complaint(&folder)
    };
    write_images(folder.path(), |i| format!("p{i}.exr"));
    assert_says(&bad("file,x,y,z\np0.exr,1,2,3\n"), &["panoramas.csv", "panorama 1 (p0.exr)", "qw", "yaw"]);
    assert_says(&bad("file,x,y\np0.exr,1,2\n"), &["panoramas.csv", "missing field", "file,x,y,z"]);
    let headless = ["panoramas.csv", "first line is \"p0.exr,1,2,3,90,0,0\"", "header", "file,x,y,z"];
    assert_says(&bad("# mine\np0.exr,1,2,3,90,0,0\n"), &headless);
    assert_says(&bad("p0.exr,1,2,3,90,0,0\r\np1.exr,1,2,3,90,0,0\r\n"), &headless);
    assert_says(&bad(""), &["panoramas.csv", "first line is \"\"", "header"]);
    assert_says(&bad("file,x,y,z,yaw\np0.exr,1,2,3,inf\n"), &["panorama 1", "finite", "degrees"]);
    assert_says(&bad("file,x,y,z,yaw\n"), &["no camera"]);
    write_rgb(folder.path().join("p0.exr"), &Rgb::filled(3, 2, [1.0; 3])).unwrap();
    assert_says(&bad("file,x,y,z,yaw\np0.exr,1,2,3,4\n"), &["3×2", "twice as wide as high"]);
}

/// The scene as Matterport's camera gives it.
pub(super) fn matterport() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let place = |name: &str| root.join(name);
    for name in ["matterport_camera_poses", "matterport_camera_intrinsics"] {
        std::fs::create_dir_all(place(name)).unwrap();
    }
    for (i, pose) in poses().into_iter().enumerate() {
        std::fs::write(place(&format!("matterport_camera_poses/ab_pose_0_{i}.txt")), row_major(opencv(pose))).unwrap();
    }
    let centre = [WIDTH / 2, HEIGHT / 2];
    let intrinsics = format!("{WIDTH} {HEIGHT} 5 5 {} {} 0 0 0 0 0", centre[0], centre[1]);
    std::fs::write(place("matterport_camera_intrinsics/ab_intrinsics_0.txt"), intrinsics).unwrap();
    write_images(&place("matterport_hdr_images"), |i| format!("ab_j0_{i}.exr"));
    write_mesh(&place("matterport_mesh/xyz/xyz.obj"), Vec3::Z, 1.0);
    folder
}

/// The scene as Matterport3D's undistorted photos, and its .conf.
pub(super) fn matterport_undistorted() -> (TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    // The principal point is off the middle: their rows count from the bottom.
    let mut conf = "dataset matterport\nn_images 4\n".to_owned();
    conf += "intrinsics_matrix 5 0 4  0 5 1  0 0 1\n";
    for (i, pose) in poses().into_iter().enumerate() {
        conf += &format!("scan d{i}.png c{i}.jpg {}\n", row_major(pose));
    }
    std::fs::create_dir_all(root.join("undistorted_camera_parameters")).unwrap();
    std::fs::write(root.join("undistorted_camera_parameters/xyz.conf"), &conf).unwrap();
    write_images(&root.join("hdr"), |i| format!("c{i}.exr"));
    write_mesh(&root.join("mesh.obj"), Vec3::Z, 1.0);
    (folder, conf)
}

#[test]
fn matterport_as_captured_and_undistorted() {
    assert_reads(&matterport(), "matterport3d", pinhole());
    let (folder, conf) = matterport_undistorted();
    assert_reads(&folder, "matterport3d", Projection::Pinhole { fx: 5.0, fy: 5.0, cx: 4.0, cy: HEIGHT as f32 - 1.0 });
    let conf = conf.replace("intrinsics_matrix", "intrinsics");
    std::fs::write(folder.path().join("undistorted_camera_parameters/xyz.conf"), conf).unwrap();
    assert_says(&complaint(&folder), &["xyz.conf", "line 4", "intrinsics_matrix"]);
}

/// The scene in the layout of the TexIR authors, and its matrices.
pub(super) fn texir_authors() -> (TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let (mut ids, mut matrices) = (String::new(), "4 \n".to_owned());
    for (i, pose) in poses().into_iter().enumerate() {
        ids += &format!("164610{i}\n");
        let rows = row_major(opencv(source_from_texir(Vec3::NEG_Y) * pose));
        matrices += &rows.split(' ').collect::<Vec<_>>().chunks(4).map(|row| row.join(" ") + " \n").collect::<String>();
        let derived = root.join(format!("derived/164610{i}"));
        // At half the size of the image.
        write_png_labels(derived.join("panoImage_gray.png"), &Labels::new(4, 2, (0..8).collect()).unwrap()).unwrap();
        let mut cutout = ::image::RgbaImage::from_pixel(WIDTH as u32, HEIGHT as u32, ::image::Rgba([0, 0, 0, 255]));
        cutout.put_pixel(3, 3, ::image::Rgba([9, 9, 9, 0]));
        cutout.save_with_format(derived.join("panoImage_orig.jpg"), ::image::ImageFormat::Png).unwrap();
    }
    std::fs::create_dir_all(root.join("info")).unwrap();
    std::fs::write(root.join("info/aligned.txt"), ids).unwrap();
    std::fs::write(root.join("info/final_extrinsics.txt"), &matrices).unwrap();
    // Read by its content.
    write_images(root, |i| format!("hdr/164610{i}/ccm.hdr"));
    write_mesh(&root.join("hdr_texture/out1.obj"), Vec3::NEG_Y, 1.0);
    write_rgb(root.join("hdr_texture/hdr_texture.hdr"), &Rgb::filled(2, 2, [7.0; 3])).unwrap();
    (folder, matrices)
}

#[test]
fn texir_authors_layout() {
    let (folder, matrices) = texir_authors();
    let read = assert_reads(&folder, "texir-authors", Projection::Equirectangular);

    let out = tempfile::tempdir().unwrap();
    write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap();
    let semantic = read_labels(out.path().join("semantic/1646101.png")).unwrap();
    assert_eq!((semantic.size(), *semantic.at(7, 3)), ([WIDTH, HEIGHT], 7));
    let mask = read_mask(out.path().join("mask/1646101.png")).unwrap();
    assert_eq!(mask.data.iter().filter(|used| !**used).count(), 1);
    assert!(!mask.at(3, 3));
    let capture = crate::capture::load(out.path(), &Default::default(), &Silent).unwrap();
    let texture = Tbl::read(capture.tbl.unwrap(), &Silent).unwrap();
    assert_eq!(texture.radiance.data[0], [7.0; 3]);

    std::fs::write(folder.path().join("info/final_extrinsics.txt"), &matrices[..matrices.len() - 14]).unwrap();
    assert_says(&complaint(&folder), &["final_extrinsics.txt", "63 numbers", "4 ids"]);
}

/// The scene as a glTF, whose nodes are cameras or the places of panoramas.
pub(super) fn gltf(camera: bool) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let from_texir = source_from_texir(Vec3::Y);
    let field = 2.0 * (0.5 * HEIGHT as f64 / 5.0).atan();
    let mut nodes = vec![json!({"mesh": 0, "name": "flat", "matrix": from_texir.to_cols_array()})];
    for (i, pose) in poses().into_iter().enumerate() {
        let mut node = json!({"name": format!("View.00{i}"), "matrix": (from_texir * pose).to_cols_array()});
        if camera {
            node["camera"] = json!(0);
        }
        nodes.push(node);
    }
    let mesh = mesh();
    let mut buffer: Vec<u8> = mesh.positions.iter().flat_map(|p| p.to_array().map(f32::to_le_bytes).concat()).collect();
    let uvs = buffer.len();
    buffer.extend(mesh.uvs.iter().flat_map(|uv| uv.to_array().map(f32::to_le_bytes).concat()));
    let normals = buffer.len();
    buffer.extend(mesh.normals.iter().flat_map(|n| n.to_array().map(f32::to_le_bytes).concat()));
    let indices = buffer.len();
    buffer.extend(mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()));
    let views = [(0, uvs), (uvs, normals - uvs), (normals, indices - normals), (indices, buffer.len() - indices)];
    let document = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2, 3, 4]}],
        "nodes": nodes,
        "cameras": [{"type": "perspective", "perspective": {"yfov": field, "aspectRatio": 2.0, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1, "NORMAL": 2}, "indices": 3}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", "min": [0, 0, 0], "max": [4, 3, 2.5]},
            {"bufferView": 1, "componentType": 5126, "count": 8, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 3, "componentType": 5125, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": views.map(|(at, length)| json!({"buffer": 0, "byteOffset": at, "byteLength": length})),
        "buffers": [{"uri": "scene.bin", "byteLength": buffer.len()}],
    });
    std::fs::write(root.join("scene.bin"), buffer).unwrap();
    std::fs::write(root.join("scene.gltf"), document.to_string()).unwrap();
    write_images(&root.join("images"), |i| format!("View.00{i}.exr"));
    folder
}

#[test]
fn gltf_cameras_and_panoramas() {
    for (projection, camera) in [(pinhole(), true), (Projection::Equirectangular, false)] {
        let folder = gltf(camera);
        assert_reads(&folder, "gltf", projection);
        if camera {
            std::fs::remove_file(folder.path().join("images/View.001.exr")).unwrap();
            assert_says(&complaint(&folder), &["scene.gltf", "View.001", "without an image"]);
            let path = folder.path().join("scene.gltf");
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(path, text.replace("\"accessors\"", "\"ccessors\"")).unwrap();
            assert_says(&complaint(&folder), &["scene.gltf", "POSITION is accessor 0"]);
        }
    }
}

/// [`gltf`] with cameras, its document changed.
fn changed_gltf(change: impl FnOnce(&mut serde_json::Value)) -> TempDir {
    let folder = gltf(true);
    let path = folder.path().join("scene.gltf");
    let mut document = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    change(&mut document);
    std::fs::write(path, document.to_string()).unwrap();
    folder
}

#[test]
fn gltf_rotations_of_any_length_turn_cameras_and_mesh_alike() {
    let turned = |turn: DQuat| {
        let folder = changed_gltf(|document| {
            let node = json!({"rotation": turn.to_array(), "children": [0, 1, 2, 3, 4]});
            document["nodes"].as_array_mut().unwrap().push(node);
            document["scenes"][0]["nodes"] = json!([5]);
        });
        let read = super::super::read(folder.path(), &ImportOptions::default(), &Silent).unwrap();
        (read.shots.iter().map(|shot| shot.view.camera).collect::<Vec<_>>(), read.mesh.positions)
    };
    let turn = DQuat::from_rotation_y(0.7);
    let [(unit_cameras, unit_mesh), (cameras, mesh)] = [turn, turn * 1.05].map(turned);
    assert_cameras(&cameras, &unit_cameras);
    assert!(mesh.iter().zip(&unit_mesh).all(|(p, unit)| p.distance(*unit) < 1e-5));
    // Negative control: it did turn.
    let (plain, _) = turned(DQuat::IDENTITY);
    assert!(plain[0].world_from_camera.w_axis.distance(cameras[0].world_from_camera.w_axis) > 0.1);
}

#[test]
fn gltf_cameras_may_have_their_parents_names() {
    let folder = changed_gltf(|document| {
        document["cameras"][0]["perspective"].as_object_mut().unwrap().remove("aspectRatio");
        let nodes = document["nodes"].as_array_mut().unwrap();
        for i in 1..=poses().len() {
            nodes[i].as_object_mut().unwrap().remove("camera");
            nodes[i]["children"] = json!([nodes.len()]);
            nodes.push(json!({"camera": 0}));
        }
    });
    // An image twice as wide as high would make a panorama of the parent.
    for i in 0..poses().len() {
        write_rgb(folder.path().join(format!("images/View.00{i}.exr")), &Rgb::filled(6, 4, [1.0; 3])).unwrap();
    }
    let views = |folder: &TempDir| -> Vec<_> {
        let read = super::super::read(folder.path(), &ImportOptions::default(), &Silent).unwrap();
        read.shots.into_iter().map(|shot| (shot.view.name, shot.view.camera.world_from_camera)).collect()
    };
    assert_eq!(views(&folder), views(&gltf(true)));
}

/// The scene as texir's own capture.
pub(super) fn nerfstudio() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let view = |(i, camera): (usize, Camera)| View {
        semantic: Some(root.join("ids.png")),
        roughness: Some(root.join("rough.exr")),
        ..View::new(format!("v{i}"), camera, Split::Train, root.join(format!("photos/v{i}.exr")))
    };
    let views: Vec<View> = cameras(pinhole()).into_iter().enumerate().map(view).collect();
    crate::capture::nerfstudio::write_transforms(root.join("transforms.json"), &views).unwrap();
    write_images(&root.join("photos"), |i| format!("v{i}.exr"));
    write_png_labels(root.join("ids.png"), &Labels::filled(WIDTH, HEIGHT, 300)).unwrap();
    write_gray(root.join("rough.exr"), &Gray::filled(WIDTH, HEIGHT, 0.25)).unwrap();
    write_mesh(&root.join("mesh.obj"), Vec3::Z, 1.0);
    folder
}

#[test]
fn semantics_in_colour_become_ids_and_keep_their_names() {
    let folder = nerfstudio();
    let path = folder.path().join("transforms.json");
    let mut document: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    document["classes"] = "lists/mine.json".into();
    std::fs::write(&path, document.to_string()).unwrap();
    std::fs::create_dir(folder.path().join("lists")).unwrap();
    let list = r#"[{"id": 300, "name": "rug", "color": [9, 8, 7]}, {"id": 2, "name": "lamp"}]"#;
    std::fs::write(folder.path().join("lists/mine.json"), list).unwrap();
    write_png_rgb(folder.path().join("ids.png"), &Raster::filled(WIDTH, HEIGHT, [9, 8, 7])).unwrap();
    let read = read(folder.path(), &ImportOptions::default(), &Silent).unwrap();

    let out = tempfile::tempdir().unwrap();
    write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap();
    let capture = crate::capture::load(out.path(), &Default::default(), &Silent).unwrap();
    assert_eq!(capture.views[2].load_semantic().unwrap().unwrap().data[0], 300);
    let classes = capture.views[2].classes.as_ref().unwrap();
    assert_eq!(classes.of_id(300).unwrap().name, "rug");
    assert!(out.path().join("classes.json").is_file());
}

#[test]
fn nerfstudio_is_read_with_all_that_belongs_to_it() {
    let folder = nerfstudio();
    let read = assert_reads(&folder, "nerfstudio", pinhole());
    assert!(is_capture(folder.path()).unwrap());

    let out = tempfile::tempdir().unwrap();
    let options = ImportOptions { link: cfg!(unix), ..ImportOptions::default() };
    write(&read, out.path(), &options, &Silent).unwrap();
    let capture = crate::capture::load(out.path(), &Default::default(), &Silent).unwrap();
    assert_eq!(capture.views[2].load_semantic().unwrap().unwrap().data[0], 300);
    assert_eq!(capture.views[2].load_roughness().unwrap().unwrap().data[0], 0.25);
    assert_eq!(out.path().join("hdr/v1.exr").is_symlink(), cfg!(unix));
    let again = write(&read, out.path(), &options, &Silent).unwrap_err().to_string();
    assert_says(&again, &["already", "new or empty folder"]);
}

#[test]
fn nerfstudio_of_photos_takes_what_they_were_merged_into() {
    let folder = nerfstudio();
    let path = folder.path().join("transforms.json");
    let mut document: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    // Of two cameras, whose files have the same names, and one whose photo has nothing beside it but another photo.
    let photos = ["images/left/0.jpg", "./images/right/0.JPG", "photos/v2.png"];
    for (frame, photo) in document["frames"].as_array_mut().unwrap().iter_mut().zip(photos) {
        frame["file_path"] = photo.into();
    }
    std::fs::write(&path, document.to_string()).unwrap();
    assert!(!is_capture(folder.path()).unwrap(), "photos are no linear images");
    let images = || {
        let read = nerfstudio::Nerfstudio.read(folder.path()).unwrap();
        read.shots.into_iter().map(|shot| shot.view.image).take(photos.len()).collect::<Vec<_>>()
    };
    let at = |path: &str| folder.path().join(path);
    // Without any, the photos themselves; beside them; in `hdr/`, with and without their first folder.
    std::fs::remove_file(at("photos/v2.exr")).unwrap();
    assert_eq!(images(), photos.map(at));
    for linear in ["photos/v2.hdr", "hdr/left/0.exr", "hdr/images/right/0.exr"] {
        std::fs::create_dir_all(at(linear).parent().unwrap()).unwrap();
        std::fs::write(at(linear), []).unwrap();
    }
    assert_eq!(images(), ["hdr/left/0.exr", "hdr/images/right/0.exr", "photos/v2.hdr"].map(at));
}

#[test]
fn an_import_replaces_nothing_and_leaves_nothing_half_done() {
    let source = nerfstudio();
    let read = super::super::read(source.path(), &ImportOptions::default(), &Silent).unwrap();
    let image = source.path().join("photos/v1.exr");
    let before = std::fs::read(&image).unwrap();
    let into = |out: &Path| write(&read, out, &ImportOptions::default(), &Silent);
    assert_says(&into(source.path()).unwrap_err().to_string(), &["new or empty folder"]);
    assert!(std::fs::read(&image).unwrap() == before);
    let root = tempfile::tempdir().unwrap();
    std::fs::remove_file(&image).unwrap();
    assert_says(&into(&root.path().join("new")).unwrap_err().to_string(), &["v1.exr"]);
    assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 0);
    // Negative control: with the image, it is all there.
    std::fs::write(&image, before).unwrap();
    into(&root.path().join("new")).unwrap();
    assert!(root.path().join("new/hdr/v1.exr").is_file() && root.path().join("new/transforms.json").is_file());
}

#[test]
fn what_a_killed_import_left_is_in_no_imports_way() {
    let source = nerfstudio();
    let read = super::super::read(source.path(), &ImportOptions::default(), &Silent).unwrap();
    let (out, warnings) = (tempfile::tempdir().unwrap(), Warnings::default());
    let left = out.path().join(".texir-78yUj9/new/hdr/v1.exr");
    std::fs::create_dir_all(left.parent().unwrap()).unwrap();
    std::fs::write(&left, "half an image").unwrap();
    check_vacant(out.path()).unwrap();
    write(&read, out.path(), &ImportOptions::default(), &warnings).unwrap();
    assert!(crate::capture::load(out.path(), &Default::default(), &Silent).is_ok());
    // It may as well be one that goes on.
    assert!(left.is_file());
    let warnings = warnings.all();
    assert!(warnings.len() == 1, "{warnings:?}");
    assert_says(&warnings[0], &[".texir-78yUj9", "killed", "remove it"]);
    // Negative control: what is somebody's is in the way.
    let out = tempfile::tempdir().unwrap();
    std::fs::create_dir(out.path().join(".git")).unwrap();
    assert_says(&check_vacant(out.path()).unwrap_err().to_string(), &["holds .git already", "new or empty folder"]);
}

/// Puts a mesh into a folder as soon as there is progress.
struct Meanwhile<'a>(&'a Path);

impl Progress for Meanwhile<'_> {
    fn start(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {
        std::fs::create_dir_all(self.0).unwrap();
        std::fs::write(self.0.join("mesh.obj"), "another's").unwrap();
    }
    fn finish(&self) {}
    fn warn(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        false
    }
}

#[test]
fn an_import_does_not_mix_with_what_came_meanwhile() {
    let source = nerfstudio();
    let read = super::super::read(source.path(), &ImportOptions::default(), &Silent).unwrap();
    let root = tempfile::tempdir().unwrap();
    for (name, exists) in [("new", false), ("empty", true)] {
        let out = root.path().join(name);
        if exists {
            std::fs::create_dir(&out).unwrap();
        }
        let refused = write(&read, &out, &ImportOptions::default(), &Meanwhile(&out)).unwrap_err().to_string();
        assert_says(&refused, &[name, "holds mesh.obj already"]);
        assert_eq!(std::fs::read_to_string(out.join("mesh.obj")).unwrap(), "another's");
        assert_eq!(std::fs::read_dir(&out).unwrap().count(), 1, "{name}");
    }
}

/// Exports the folder's `mesh.obj` as `mesh.glb`, as modellers do: what was +Z up there is +Y up.
fn export_mesh(folder: &TempDir) {
    let path = folder.path().join("mesh.obj");
    let mesh = read_surface(&path).unwrap().0.mesh;
    std::fs::remove_file(&path).unwrap();
    let (albedo, roughness) = (Rgb::filled(2, 2, [0.5; 3]), Gray::filled(2, 2, 0.5));
    let materials = Materials { albedo: &albedo, roughness: &roughness, metallic: None, emission: None };
    write_glb(path.with_extension("glb"), &mesh, &materials, Up::Z).unwrap();
}

#[test]
fn a_mesh_that_an_exporter_laid_on_its_side_is_turned_by_an_import_as_by_a_load() {
    let is_turned = |mesh: &Mesh, warnings: Warnings| {
        let told = warnings.all().iter().filter(|w| w.contains("mesh.glb: is taken as +Y up")).count();
        let true_mesh = mesh.positions.iter().zip(super::mesh().positions).all(|(a, b)| a.abs_diff_eq(b, 1e-5));
        assert!(told == 1 && true_mesh, "{told} {:?}", mesh.positions);
    };
    let capture = nerfstudio();
    export_mesh(&capture);
    let warnings = Warnings::default();
    let loaded = crate::capture::load(capture.path(), &Default::default(), &warnings).unwrap();
    is_turned(&loaded.mesh, warnings);
    // In the frame of the cameras, whichever that is.
    for folder in [capture, colmap(Vec3::Z, true), colmap(Vec3::NEG_Y, true)] {
        if folder.path().join("mesh.obj").is_file() {
            export_mesh(&folder);
        }
        let warnings = Warnings::default();
        let read = super::super::read(folder.path(), &ImportOptions::default(), &warnings).unwrap();
        is_turned(&read.mesh, warnings);
    }
}

#[test]
fn unknown_folders_and_formats_are_named_with_what_is_known() {
    let folder = tempfile::tempdir().unwrap();
    assert_says(&complaint(&folder), &["no capture that texir knows", "colmap", "panoramas.csv", "info/aligned.txt"]);
    let options = ImportOptions { format: Some("polaroid".to_owned()), ..ImportOptions::default() };
    let message = super::super::read(folder.path(), &options, &Silent).unwrap_err().to_string();
    assert_says(&message, &["polaroid", "nerfstudio", "gltf"]);
    let folder = colmap(Vec3::Z, false);
    std::fs::remove_file(folder.path().join("mesh.obj")).unwrap();
    assert_says(&complaint(&folder), &["has no mesh", "--mesh"]);
}

/// What the reader of the folder assumed, and the problems of the atlas that came out.
fn unwrapped(folder: &TempDir, options: &ImportOptions) -> (String, Vec<String>) {
    let read = super::super::read(folder.path(), options, &Silent).unwrap();
    let corners = |mesh: &Mesh| (0..mesh.triangles.len() as u32).map(|t| mesh.corners(t)).collect::<Vec<_>>();
    assert_eq!(corners(&read.mesh), corners(&mesh()));
    (read.assumed.join("\n"), crate::mesh_io::atlas_report(&read.mesh, [1024; 2]).problems())
}

#[test]
fn meshes_get_an_atlas_where_theirs_is_none() {
    let folder = colmap(Vec3::Z, false);
    let path = folder.path().join("mesh.obj");
    let (given, asked) = (ImportOptions::default(), ImportOptions { unwrap: true, ..ImportOptions::default() });
    assert!(!unwrapped(&folder, &given).0.contains("new atlas"));
    assert_says(&unwrapped(&folder, &asked).0, &["new atlas", "2 charts", "as told"]);
    let text = std::fs::read_to_string(&path).unwrap();
    for (from, to, why) in
        [("vt 0.5", "vt 0.0", "overlap on"), ("vt 0.5", "vt 1.5", "2 triangles have texture coordinates outside")]
    {
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let (assumed, problems) = unwrapped(&folder, &given);
        assert_says(&assumed, &["new atlas", why]);
        assert!(problems.is_empty(), "{problems:?}");
    }
    let without: String =
        text.lines().filter(|line| !line.starts_with("vt")).map(|line| line.to_owned() + "\n").collect();
    let without = (1..=8).fold(without, |text, i| text.replace(&format!("{i}/{i}/{i}"), &format!("{i}//{i}")));
    std::fs::write(&path, without).unwrap();
    let (assumed, problems) = unwrapped(&folder, &given);
    assert_says(&assumed, &["4 of its triangles have no texture coordinates"]);
    assert!(problems.is_empty(), "{problems:?}");
}

#[test]
fn textures_do_not_outlive_their_atlas() {
    let (folder, _) = texir_authors();
    let with_texture = |options: &ImportOptions| {
        let read = super::super::read(folder.path(), options, &Silent).unwrap();
        !read.textures.is_empty()
    };
    assert!(with_texture(&ImportOptions::default()));
    assert!(!with_texture(&ImportOptions { unwrap: true, ..ImportOptions::default() }));
}

/// The COLMAP scene with 800 triangles of hills that are 20 cm high, and what the reader says about them.
fn decimated(target: usize) -> Result<(Import, Vec<String>)> {
    let folder = colmap(Vec3::Z, false);
    let mut hills = Mesh::default();
    for (i, j) in (0..=20).flat_map(|j| (0..=20).map(move |i| (i, j))) {
        let uv = Vec2::new(i as f32, j as f32) / 20.0;
        hills.positions.push(Vec3::new(4.0 * uv.x, 3.0 * uv.y, 0.1 * (6.0 * uv.x).sin() * (5.0 * uv.y).cos()));
        hills.normals.push(Vec3::Z);
        hills.uvs.push(uv);
        if i < 20 && j < 20 {
            let a = 21 * j + i;
            hills.triangles.extend([[a, a + 1, a + 22], [a, a + 22, a + 21]]);
        }
    }
    obj::write(folder.path().join("mesh.obj"), &hills)?;
    let (warnings, options) = (Warnings::default(), ImportOptions { decimate: Some(target), ..Default::default() });
    Ok((super::super::read(folder.path(), &options, &warnings)?, warnings.all()))
}

#[test]
fn dense_meshes_are_reduced_and_unwrapped() {
    let (read, warnings) = decimated(300).unwrap();
    assert!((299..=300).contains(&read.mesh.triangles.len()) && warnings.is_empty(), "{warnings:?}");
    assert_says(&read.assumed.join("\n"), &["new atlas", "reduced from 800 to", "mm"]);
    assert!(crate::mesh_io::atlas_report(&read.mesh, [1024; 2]).problems().is_empty());
    assert!((0..read.mesh.triangles.len() as u32).all(|t| read.mesh.face_normal(t).z > 0.9));

    let (read, warnings) = decimated(12).unwrap();
    assert!(read.mesh.triangles.len() > 30, "{}", read.mesh.triangles.len());
    assert_says(&warnings.join("\n"), &["mesh.obj", "triangles are left, not 12", "more than 10 mm"]);

    let (read, warnings) = decimated(800).unwrap();
    assert!(read.mesh.triangles.len() == 800 && warnings.is_empty(), "{warnings:?}");
    assert_says(&read.assumed.join("\n"), &["not reduced", "800 triangles"]);
    assert!(!read.assumed.join("\n").contains("new atlas"));

    let refused = decimated(0).map(|_| ()).unwrap_err().to_string();
    assert_says(&refused, &["mesh.obj", "to 0 triangles", "12 or more"]);
}

#[test]
fn images_that_end_early_are_no_capture() {
    let folder = colmap(Vec3::Z, false);
    let path = folder.path().join("images/photo 2.exr");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
    let read = super::super::read(folder.path(), &ImportOptions::default(), &Silent).unwrap();
    let out = tempfile::tempdir().unwrap();
    let refused = write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap_err().to_string();
    assert_says(&refused, &["photo 2.exr", "cut short", "copy or export it again"]);
    assert!(!out.path().join("transforms.json").exists());
}

#[test]
fn encoded_images_need_a_curve() {
    let folder = colmap(Vec3::Z, false);
    let root = folder.path();
    std::fs::remove_dir_all(root.join("images")).unwrap();
    std::fs::create_dir(root.join("images")).unwrap();
    for i in 0..4 {
        let mut photo =
            ::image::RgbaImage::from_pixel(WIDTH as u32, HEIGHT as u32, ::image::Rgba([188, 188, 255, 255]));
        photo.put_pixel(0, 0, ::image::Rgba([0, 0, 0, 0]));
        photo.save_with_format(root.join(format!("images/photo {i}.jpg")), ::image::ImageFormat::Png).unwrap();
    }
    let read = super::super::read(root, &ImportOptions::default(), &Silent).unwrap();
    let out = tempfile::tempdir().unwrap();
    let refused = write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap_err().to_string();
    assert_says(&refused, &["photo", "texir hdr", "--curve"]);
    let options = ImportOptions { curve: Some(TransferCurve::Srgb), ..ImportOptions::default() };
    let written = write(&read, out.path(), &options, &Silent).unwrap();
    assert_eq!((written.decoded, written.clipped_pixels), (4, 4 * (WIDTH * HEIGHT - 1)));
    let capture = crate::capture::load(out.path(), &Default::default(), &Silent).unwrap();
    let image = capture.views[0].load_image(&Silent).unwrap();
    assert!((image.data[1][0] - 0.5029).abs() < 1e-3 && image.data[1][2] == 1.0, "{:?}", image.data[1]);
    assert!(!capture.views[0].load_mask().unwrap().unwrap().at(0, 0));
}
