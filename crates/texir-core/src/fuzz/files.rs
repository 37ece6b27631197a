//! Every file that is read but those of capture formats, which are in `capture::import::tests`.

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use glam::{Vec2, Vec3};
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb32FImage};
use serde_json::json;

use super::{IMAGE, TEXT, TIFF, survives};
use crate::authored;
use crate::brdf::Masking;
use crate::capture::{Classes, Corrections, Coverage, Tbl};
use crate::checkpoint::{Array, Checkpoints};
use crate::diffuse::DiffuseModel;
use crate::fit::FitSettings;
use crate::glb::{Materials, Up, write_glb};
use crate::hdr;
use crate::image_io::{
    check_whole, is_encoded, read_colors, read_encoded, read_gray, read_labels, read_mask, read_rgb, read_size,
    write_gray, write_hdr, write_png_labels, write_png_rgb, write_rgb,
};
use crate::mesh::Mesh;
use crate::mesh_io::{atlas_report, obj, read_mesh};
use crate::outputs::FitOutput;
use crate::progress::Silent;
use crate::raster::{Gray, Labels, Raster, Rgb};
use crate::render::Textures;
use crate::scene::Scene;

/// Two squares that meet at an edge, each with half of the atlas.
fn mesh() -> Mesh {
    let mut mesh = Mesh::default();
    for (u, across) in [(0.0, Vec3::Y), (0.5, Vec3::Z)] {
        let base = mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(x * Vec3::X + y * across);
            mesh.normals.push(Vec3::X.cross(across));
            mesh.uvs.push(Vec2::new(u + 0.4 * x, 0.9 * y));
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    mesh
}

/// As a capture's mesh is read, checked and made ready for rays.
fn use_mesh(path: &Path) {
    let Ok(file) = read_mesh(path) else { return };
    let (low, high) = file.mesh.bounds();
    assert!(low.is_finite() && high.is_finite());
    atlas_report(&file.mesh, [32; 2]);
    drop(Scene::new(file.mesh));
}

#[test]
fn obj_meshes() {
    let folder = tempfile::tempdir().unwrap();
    obj::write(folder.path().join("written.obj"), &mesh()).unwrap();
    let by_hand = "mtllib a.mtl\no a\nv 0 0 0 1 0.5 0.5\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0 0\nvt 1 1\nvn 0 0 1\n\
                   usemtl a\ns 1\nf 1/1/1 2/2/1 3/3/1 4/1/1\ng b\nf -4/-3 -3/-2 -2/-1\nf 1//1 2//1 3//1\nl 1 2\np 1\n";
    std::fs::write(folder.path().join("by_hand.obj"), by_hand).unwrap();
    for file in ["written.obj", "by_hand.obj"] {
        survives(&folder, &[file], TEXT, |folder| use_mesh(&folder.join(file)));
    }
}

#[test]
fn ply_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let header = |format: &str, corners: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment made here\nelement vertex 4\nproperty float x\nproperty float y\n\
             property float z\nproperty float s\nproperty float t\nelement edge 1\nproperty int a\nelement face 1\n\
             property list uchar int vertex_indices\n{corners}end_header\n"
        )
    };
    let corners = "property list uchar float texcoord\n";
    let vertices = [[0.0_f32, 0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0, 0.0], [1.0, 1.0, 0.0, 1.0, 1.0], [0.0; 5]];
    let text = vertices.map(|v| v.map(|v| v.to_string()).join(" ")).join("\n");
    let ascii = format!("{}{text}\n7\n4 0 1 2 3 8 0 0 1 0 1 1 0 1\n", header("ascii", corners));
    std::fs::write(folder.path().join("ascii.ply"), ascii).unwrap();
    for (file, format, little) in
        [("little.ply", "binary_little_endian", true), ("big.ply", "binary_big_endian", false)]
    {
        let number = |bits: u32| if little { bits.to_le_bytes() } else { bits.to_be_bytes() };
        let mut bytes = header(format, "").into_bytes();
        bytes.extend(vertices.iter().flatten().flat_map(|v| number(v.to_bits())));
        bytes.extend(number(7));
        bytes.push(4);
        bytes.extend([0, 1, 2, 3].into_iter().flat_map(number));
        std::fs::write(folder.path().join(file), bytes).unwrap();
    }
    for file in ["ascii.ply", "little.ply", "big.ply"] {
        survives(&folder, &[file], TEXT, |folder| use_mesh(&folder.join(file)));
    }
}

/// As `texir bake scene.glb` starts.
fn use_scene(path: &Path) {
    use_mesh(path);
    if let Ok(model) = authored::read_gltf(path, 64, authored::BounceAlbedo::Diffuse, &Silent) {
        drop(model.scene());
    }
}

#[test]
fn authored_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let (albedo, roughness) = (Rgb::filled(4, 4, [0.5; 3]), Gray::filled(4, 4, 0.5));
    let emission = Rgb::filled(2, 2, [3.0; 3]);
    let of = Materials { albedo: &albedo, roughness: &roughness, metallic: None, emission: Some(&emission) };
    write_glb(folder.path().join("scene.glb"), &mesh(), &of, Up::Z).unwrap();
    // A square without texture coordinates, and a lamp.
    let mut buffer: Vec<u8> =
        mesh().positions[..4].iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes).collect();
    buffer.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()));
    let scene = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [2, 2, 2], "children": [1]},
                  {"translation": [0, 0, 1], "extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"emissiveFactor": [1, 0.5, 0], "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]},
                       "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 7}}}],
        "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength"],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "spot", "intensity": 5, "range": 9, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.5}}]}},
        "buffers": [{"byteLength": buffer.len(),
                     "uri": format!("data:application/octet-stream;base64,{}", BASE64.encode(&buffer))}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
    });
    std::fs::write(folder.path().join("scene.gltf"), scene.to_string()).unwrap();
    for file in ["scene.glb", "scene.gltf"] {
        survives(&folder, &[file], IMAGE, |folder| use_scene(&folder.join(file)));
    }
}

/// Every way in which images are read.
fn use_image(path: &Path) {
    drop((read_size(path), check_whole(path), is_encoded(path)));
    drop((read_rgb(path), read_gray(path), read_encoded(path)));
    drop((read_labels(path), read_mask(path), read_colors(path)));
    drop(hdr::read_exposure(path));
}

#[test]
fn images() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let gradient = Rgb::new(8, 4, (0..32).map(|i| [i as f32, 0.5, 1e4 / (i + 1) as f32]).collect()).unwrap();
    write_rgb(path("rgb.exr"), &gradient).unwrap();
    write_gray(path("gray.exr"), &gradient.map(|p| p[0])).unwrap();
    write_hdr(path("panorama.hdr"), &gradient).unwrap();
    write_png_labels(path("ids.png"), &Labels::new(8, 4, (0..32).map(|i| 20 * i).collect()).unwrap()).unwrap();
    write_png_rgb(path("photo.png"), &gradient.map(|p| p.map(|v| v as u8))).unwrap();
    let floats = Rgb32FImage::from_raw(8, 4, gradient.data.as_flattened().to_vec()).unwrap();
    floats.save_with_format(path("float.tif"), ImageFormat::Tiff).unwrap();
    let gray = ImageBuffer::<Luma<u16>, _>::from_raw(8, 4, (0..32).map(|i| 2000 * i).collect::<Vec<u16>>()).unwrap();
    gray.save_with_format(path("gray.tif"), ImageFormat::Tiff).unwrap();
    DynamicImage::from(floats).to_rgb8().save_with_format(path("photo.jpg"), ImageFormat::Jpeg).unwrap();
    // EXIF is a TIFF without an image.
    std::fs::write(path("exif.tif"), hdr::tests::exif((1, 400))).unwrap();
    for file in [
        "rgb.exr",
        "gray.exr",
        "panorama.hdr",
        "ids.png",
        "photo.png",
        "float.tif",
        "gray.tif",
        "photo.jpg",
        "exif.tif",
    ] {
        let bound = if file.ends_with(".tif") { TIFF } else { IMAGE };
        survives(&folder, &[file], bound, |folder| use_image(&folder.join(file)));
    }
}

fn texture_with_coverage() -> Tbl {
    let coverage = [Coverage::Seen, Coverage::Inpainted, Coverage::Outside, Coverage::Seen].repeat(2);
    Tbl { radiance: Rgb::filled(4, 2, [0.5, 1.0, 7.0]), coverage: Raster::new(4, 2, coverage).unwrap() }
}

#[test]
fn textures_with_coverage() {
    let folder = tempfile::tempdir().unwrap();
    texture_with_coverage().write(folder.path().join("t.exr")).unwrap();
    survives(&folder, &["t.exr", "t_mask.png"], IMAGE, |folder| {
        drop(Tbl::read(folder.join("t.exr"), &Silent));
    });
}

#[test]
fn lists_of_classes() {
    let folder = tempfile::tempdir().unwrap();
    let list = r#"[{"id": 1, "name": "wall", "color": [9, 8, 7]}, {"id": 2, "name": "floor", "isthing": 0}]"#;
    std::fs::write(folder.path().join("mine.json"), list).unwrap();
    write_png_rgb(folder.path().join("view.png"), &Raster::filled(8, 4, [9, 8, 7])).unwrap();
    survives(&folder, &["mine.json", "view.png"], IMAGE, |folder| {
        drop(Classes::open("mine.json", folder).and_then(|classes| classes.read(&folder.join("view.png"))));
    });
}

#[test]
fn corrections() {
    let capture = crate::capture::tests::loaded();
    let folder = tempfile::tempdir().unwrap();
    Corrections::of(&capture).write(&folder.path().join("corrections.json")).unwrap();
    survives(&folder, &["corrections.json"], TEXT, |folder| {
        if let Ok(corrections) = Corrections::read(&folder.join("corrections.json")) {
            drop(corrections.apply(&mut capture.clone(), &Silent));
        }
    });
}

#[test]
fn settings() {
    let folder = tempfile::tempdir().unwrap();
    let text = toml::to_string_pretty(&FitSettings::default()).unwrap();
    std::fs::write(folder.path().join("settings.toml"), text).unwrap();
    survives(&folder, &["settings.toml"], TEXT, |folder| {
        let Ok(text) = std::fs::read_to_string(folder.join("settings.toml")) else { return };
        drop(toml::from_str::<FitSettings>(&text).map(|settings| settings.validate()));
    });
}

#[test]
fn kept_steps() {
    let folder = tempfile::tempdir().unwrap();
    let open = |folder: &Path| Checkpoints::open(folder, "a", &Silent).unwrap();
    open(folder.path()).keep("step", &[("values", Array::from(&[[1.0_f32, 2.0, 3.0]; 5][..]))]).unwrap();
    survives(&folder, &["step.safetensors", "identity.txt"], TEXT, |folder| {
        drop(open(folder).array::<[f32; 3]>("step", 5, || Ok(vec![])));
    });
}

#[test]
fn results_of_a_fit() {
    let folder = tempfile::tempdir().unwrap();
    let gray = Gray::filled(4, 2, 0.5);
    let [albedo, irradiance, emission] = [0.5, 1.0, 0.0].map(|v| Rgb::filled(4, 2, [v; 3]));
    let (diffuse, masking) = (DiffuseModel::Lambert, Masking::Smith);
    let (roughness, metallic) = (gray.clone(), Some(gray.clone()));
    let textures = Textures { albedo, roughness, metallic, irradiance, emission, diffuse, masking };
    let fit = FitOutput { mesh: mesh(), tbl: texture_with_coverage(), textures, confidence: Some(gray) };
    fit.save(folder.path()).unwrap();
    survives(&folder, &["materials.json", "albedo.exr"], IMAGE, |folder| {
        drop(FitOutput::load(folder, &Silent));
    });
}
