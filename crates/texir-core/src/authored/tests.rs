//! The baked scene's file against the one that it was made of, and what the reader says of what it leaves out.

use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use glam::{Mat4, Vec3};
use gltf::binary::Glb;
use serde_json::{Value, json};

use super::BounceLimit::{Bound, Wanted};
use super::{BounceAlbedo, BounceLimit, Bounces, Model, Surfaces, irradiance, read_gltf, write_lightmapped_glb};
use crate::backend::{Backend, Gather};
use crate::bake::{Quality, Texels, Workspace};
use crate::capture::tests::Warnings;
use crate::checkpoint::Checkpoints;
use crate::cpu::CpuBackend;
use crate::environment::Environment;
use crate::image_io::encode_png;
use crate::progress::Silent;
use crate::punctual::PunctualLight;
use crate::raster::{Raster, Rgb};
use crate::scene::{Scene, TriangleOpacity};
use crate::surface::SurfacePoint;

/// Corners of a unit square, counter-clockwise from above.
const CORNERS: [[f32; 2]; 4] = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]];

/// Coordinates of the corners.
type Uvs = [[f32; 2]; 4];

/// The corners, scaled and moved.
fn set(scale: f32, at: f32) -> Uvs {
    CORNERS.map(|corner| corner.map(|v| at + scale * v))
}

/// Writes a scene of level squares above each other, a node each, with their sets of coordinates and their material;
/// `more` are the other fields of the document.
fn write_squares(folder: &Path, squares: &[(&[Uvs], Option<usize>)], more: Value) -> PathBuf {
    let (mut bytes, mut views, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    let mut accessor = |values: &[f32], shape: &str, width: usize| {
        views.push(json!({ "buffer": 0, "byteOffset": bytes.len(), "byteLength": 4 * values.len() }));
        bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        let count = values.len() / width;
        let mut accessor =
            json!({ "bufferView": views.len() - 1, "componentType": 5126, "count": count, "type": shape });
        if width == 3 {
            (accessor["min"], accessor["max"]) = (json!([0.0, 0.0, 0.0]), json!([1.0, 9.0, 1.0]));
        }
        accessors.push(accessor);
        accessors.len() - 1
    };
    let (mut meshes, mut nodes) = (Vec::new(), Vec::new());
    for (height, (sets, material)) in squares.iter().enumerate() {
        let place = |[x, z]: [f32; 2]| [x, height as f32, z];
        // Six corners without indices: two triangles.
        let order = [0, 1, 2, 0, 2, 3];
        let positions: Vec<f32> = order.iter().flat_map(|&i| place(CORNERS[i])).collect();
        let mut primitive = json!({ "attributes": { "POSITION": accessor(&positions, "VEC3", 3) } });
        for (k, uvs) in sets.iter().enumerate() {
            let uvs: Vec<f32> = order.iter().flat_map(|&i| uvs[i]).collect();
            primitive["attributes"][format!("TEXCOORD_{k}")] = accessor(&uvs, "VEC2", 2).into();
        }
        if let Some(material) = material {
            primitive["material"] = json!(material);
        }
        meshes.push(json!({ "primitives": [primitive] }));
        nodes.push(json!({ "mesh": height }));
    }
    let uri = format!("data:application/octet-stream;base64,{}", BASE64.encode(&bytes));
    let mut document = json!({
        "asset": { "version": "2.0" }, "buffers": [{ "byteLength": bytes.len(), "uri": uri }],
        "bufferViews": views, "accessors": accessors, "meshes": meshes, "nodes": nodes,
        "scenes": [{ "nodes": (0..squares.len()).collect::<Vec<_>>() }], "scene": 0,
    });
    let (fields, more) = (document.as_object_mut().unwrap(), more.as_object().unwrap());
    fields.extend(more.iter().map(|(name, value)| (name.clone(), value.clone())));
    let path = folder.join("scene.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    path
}

/// A GLB as it was written: its JSON and its binary chunk.
struct Written(Value, Vec<u8>);

impl Written {
    /// What a scene becomes, with a lightmap inside or not.
    fn of(source: &Path, attached: bool) -> Self {
        let model = read_gltf(source, 64, BounceAlbedo::Diffuse, &Silent).unwrap();
        let irradiance = Rgb::filled(4, 4, [1.0; 3]);
        let path = source.with_file_name("baked.glb");
        write_lightmapped_glb(&path, source, &model, attached.then_some(&irradiance)).unwrap();
        let bytes = std::fs::read(path).unwrap();
        let Glb { json, bin, .. } = Glb::from_slice(&bytes).unwrap();
        Self(serde_json::from_slice(&json).unwrap(), bin.unwrap().into_owned())
    }

    /// An attribute of a square, per vertex.
    fn attribute(&self, square: usize, name: &str) -> Vec<Vec<f32>> {
        let index = &self.0["meshes"][square]["primitives"][0]["attributes"][name];
        let accessor = &self.0["accessors"][index.as_u64().unwrap_or_else(|| panic!("no {name}")) as usize];
        let view = &self.0["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let [offset, length] = ["byteOffset", "byteLength"].map(|field| view[field].as_u64().unwrap() as usize);
        let floats: Vec<f32> =
            self.1[offset..][..length].chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        let width = if accessor["type"] == "VEC3" { 3 } else { 2 };
        floats.chunks(width).map(<[f32]>::to_vec).collect()
    }

    /// Whether a set of coordinates of a square is that which `source` gives its corners.
    fn is_set(&self, square: usize, set: u64, source: Uvs) -> bool {
        let (positions, uvs) = (self.attribute(square, "POSITION"), self.attribute(square, &format!("TEXCOORD_{set}")));
        positions.iter().zip(&uvs).all(|(position, uv)| {
            let corner = CORNERS.iter().position(|corner| corner[..] == [position[0], position[2]]).unwrap();
            uv[..] == source[corner]
        })
    }
}

#[test]
fn whose_work_a_scene_is_stays_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let more = json!({ "asset": { "version": "2.0", "copyright": "somebody", "extras": { "license": "CC BY 4.0" } } });
    let Written(written, _) = Written::of(&write_squares(folder.path(), &[(&[], None)], more), false);
    assert_eq!(written["asset"]["copyright"], "somebody");
    assert_eq!(written["asset"]["extras"]["license"], "CC BY 4.0");
}

/// An image as PNG, as a data URI.
fn png_of(image: &Raster<[u8; 3]>) -> String {
    let mut file = Vec::new();
    encode_png(image, &mut file).unwrap();
    format!("data:image/png;base64,{}", BASE64.encode(file))
}

/// A pixel of PNG, as a data URI.
fn png() -> String {
    png_of(&Raster { width: 1, height: 1, data: vec![[200u8; 3]] })
}

/// What a scene's surfaces are per texel of a map of `size` columns.
fn surfaces_of(source: &Path, size: usize) -> Surfaces {
    let model = read_gltf(source, size, BounceAlbedo::Diffuse, &Silent).unwrap();
    let mut backend = CpuBackend::new(model.scene().unwrap());
    let texels = Texels::map(&mut backend, model.size, Workspace::Memory, &Silent).unwrap();
    model.surfaces(&mut backend, &texels, None).unwrap()
}

#[test]
fn what_emits_and_reflects_does_not_hang_on_the_size_of_the_map_nor_on_where_points_fall() {
    // A lamp of small dots, much finer than the map, and a photo repeated on a floor.
    let folder = tempfile::tempdir().unwrap();
    type Map = fn(&Surfaces) -> &Rgb;
    let mean = |of: Map, (pixels, period, start): (usize, usize, usize), repeats: f32, size: usize| {
        let is_lit = |i: usize| (i + pixels - start) % period < 2;
        let dot = |i: usize| [if is_lit(i % pixels) && is_lit(i / pixels) { 255 } else { 0 }; 3];
        let image = Raster { width: pixels, height: pixels, data: (0..pixels * pixels).map(dot).collect() };
        let texture = json!({ "index": 0, "extensions": { "KHR_texture_transform": { "scale": [repeats, repeats] } } });
        let more = json!({
            "extensionsUsed": ["KHR_texture_transform"],
            "images": [{ "uri": png_of(&image) }], "textures": [{ "source": 0 }],
            "materials": [{
                "pbrMetallicRoughness": { "baseColorTexture": texture },
                "emissiveTexture": texture, "emissiveFactor": [1.0, 1.0, 1.0],
            }],
        });
        let surfaces = surfaces_of(&write_squares(folder.path(), &[(&[set(1.0, 0.0)], Some(0))], more), size);
        of(&surfaces).data.iter().map(|v| v[0]).sum::<f32>() / (size * size) as f32
    };
    let (emission, albedo): (Map, Map) = (|s| &s.emission, |s| &s.albedo);
    for start in [0, 4, 7, 8, 12] {
        for size in [8, 11, 64] {
            let shone = mean(emission, (128, 16, start), 1.0, size);
            assert!((shone * 64.0 - 1.0).abs() < 0.01, "from {start}, at {size}: {shone} for 1/64");
        }
    }
    for (pixels, repeats) in [(16, 64.0), (24, 32.0)] {
        let reflected = mean(albedo, (pixels, 4, 1), repeats, 32);
        assert!((reflected * 4.0 - 1.0).abs() < 0.01, "{pixels} pixels, {repeats} times: {reflected} for 1/4");
    }
    // Where the map is finer than the image, it shows the image.
    let dots = mean(emission, (8, 8, 3), 1.0, 64);
    assert!((dots * 16.0 - 1.0).abs() < 0.01, "{dots}");
}

#[test]
fn textures_of_the_baked_scene_are_looked_up_where_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let materials = json!({
        "extensionsUsed": ["KHR_texture_transform", "KHR_materials_clearcoat"],
        "images": [{ "uri": png() }], "textures": [{ "source": 0 }],
        "materials": [{
            "pbrMetallicRoughness": {
                "baseColorTexture": {
                    "index": 0, "texCoord": 1, "extensions": { "KHR_texture_transform": { "scale": [3, 3] } }
                },
                "roughnessFactor": 0.3,
            },
            "normalTexture": { "index": 0, "texCoord": 2 },
            "occlusionTexture": { "index": 0 },
            "emissiveTexture": {
                "index": 0, "texCoord": 0, "extensions": { "KHR_texture_transform": { "texCoord": 2, "scale": [2, 2] } }
            },
            "extensions": { "KHR_materials_clearcoat": { "clearcoatTexture": { "index": 0, "texCoord": 1 } } },
            "extras": { "texCoord": 1 },
        }],
    });
    // Which set serves as the lightmap's: none, the first, the second. A set that is shared does not.
    let (shared, tiled) = (set(1.0, 0.0), set(3.0, 0.5));
    let own = [set(0.4, 0.05), set(0.4, 0.55)];
    let cases = [
        [[shared, tiled, shared], [shared, tiled, shared]],
        [[own[0], tiled, shared], [own[1], tiled, shared]],
        [[shared, own[0], tiled], [shared, own[1], tiled]],
    ];
    for (case, squares) in cases.iter().enumerate() {
        let source =
            write_squares(folder.path(), &squares.each_ref().map(|sets| (&sets[..], Some(0))), materials.clone());
        let written = Written::of(&source, false);
        let material = &written.0["materials"][0];
        let base = &material["pbrMetallicRoughness"]["baseColorTexture"];
        let clearcoat = &material["extensions"]["KHR_materials_clearcoat"]["clearcoatTexture"];
        let transform = &material["emissiveTexture"]["extensions"]["KHR_texture_transform"];
        let looked_up = [
            (base, 1),
            (&material["normalTexture"], 2),
            (&material["occlusionTexture"], 0),
            (&material["emissiveTexture"], 0),
            (transform, 2),
            (&base["extensions"]["KHR_texture_transform"], 1),
            (clearcoat, 1),
        ];
        for (reference, set) in looked_up {
            let now = reference["texCoord"].as_u64().unwrap_or(0);
            for (square, sets) in squares.iter().enumerate() {
                assert!(written.is_set(square, now, sets[set]), "case {case}: {reference} was set {set}");
            }
        }
        assert_eq!(material["extras"]["texCoord"], 1);
        assert_eq!(material["pbrMetallicRoughness"]["roughnessFactor"].as_f64().map(|v| v as f32), Some(0.3));
        assert_eq!(transform["scale"], json!([2.0, 2.0]));
        // Negative control: what the lightmap is looked up by is another set, unless it is the file's own.
        let served = [None, Some(0), Some(1)][case];
        (0..3).for_each(|set| assert_eq!(written.is_set(0, 1, squares[0][set]), served == Some(set), "{case} {set}"));
        let last = written.0["meshes"][0]["primitives"][0]["attributes"].get("TEXCOORD_3").is_some();
        assert_eq!(last, served != Some(1), "the file's own set comes once");
    }
}

#[test]
fn primitives_without_a_material_carry_the_lightmap_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let materials = json!({ "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.5, 0.5, 1.0] } }] });
    let sets = [set(1.0, 0.0)];
    let squares = [(&sets[..], Some(0)), (&sets[..], None), (&sets[..], None)];
    let source = write_squares(folder.path(), &squares, materials);
    let Written(json, _) = Written::of(&source, true);
    let used: Vec<usize> =
        (0..3).map(|i| json["meshes"][i]["primitives"][0]["material"].as_u64().unwrap() as usize).collect();
    assert_eq!(used, [0, 1, 1]);
    let materials = json["materials"].as_array().unwrap();
    assert!(materials.iter().all(|material| material["extensions"]["MOZ_lightmap"]["texCoord"] == 1), "{materials:?}");
    // White, as the default that the surfaces were baked with.
    let white = read_gltf(source.with_file_name("baked.glb"), 64, BounceAlbedo::Diffuse, &Silent).unwrap();
    assert_eq!(white.parts[1].material, Some(1));
    let factor = &materials[1]["pbrMetallicRoughness"]["baseColorFactor"];
    assert!(factor.as_array().is_none_or(|factor| factor.iter().all(|v| v == 1.0)), "{factor}");
    // Negative control: without a lightmap inside, none is made up.
    let Written(json, _) = Written::of(&source, false);
    assert_eq!(json["materials"].as_array().unwrap().len(), 1);
    assert!(json["meshes"][1]["primitives"][0].get("material").is_none());
}

#[test]
fn images_of_the_baked_scene_have_their_own_type() {
    let folder = tempfile::tempdir().unwrap();
    let data =
        |declared: &str, file: &[u8]| json!({ "uri": format!("data:{declared};base64,{}", BASE64.encode(file)) });
    let webp = b"RIFF\x04\0\0\0WEBPVP8 ";
    let ktx2 = b"\xabKTX 20\xbb\r\n\x1a\n";
    let images = json!({ "images": [
        { "uri": png() },
        data("image/png", b"\xff\xd8\xff\xe0\0\x10JFIF"),
        data("image/jpeg", webp),
        data("image/jpeg", ktx2),
        data("image/avif", b"\0\0\0\x1cftypavif"),
        { "uri": "data:;base64,AAAA", "mimeType": "image/x-own" },
        // Negative control: the same container, other contents.
        data("audio/wav", b"RIFF\x04\0\0\0WAVEfmt "),
    ] });
    let source = write_squares(folder.path(), &[(&[set(1.0, 0.0)], None)], images);
    let Written(json, _) = Written::of(&source, false);
    let types: Vec<_> =
        json["images"].as_array().unwrap().iter().map(|image| image["mimeType"].as_str().unwrap()).collect();
    let expected = ["image/png", "image/jpeg", "image/webp", "image/ktx2", "image/avif", "image/x-own", "audio/wav"];
    assert_eq!(types, expected);
}

/// Places squares, the given one under each transform, and a lamp; `materials` by square.
fn write_lit(folder: &Path, placed: &[(usize, Mat4)], lamp: Vec3, materials: Vec<Option<Value>>) -> PathBuf {
    let mut nodes: Vec<Value> =
        placed.iter().map(|(square, place)| json!({ "mesh": square, "matrix": place.to_cols_array() })).collect();
    nodes.push(json!({ "translation": lamp.to_array(), "extensions": { "KHR_lights_punctual": { "light": 0 } } }));
    let squares: Vec<(&[Uvs], _)> =
        materials.iter().enumerate().map(|(i, m)| (&[][..], m.as_ref().map(|_| i))).collect();
    let more = json!({
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": { "KHR_lights_punctual": { "lights": [{ "type": "point", "intensity": 10.0 }] } },
        "materials": materials.iter().map(|m| m.clone().unwrap_or(json!({}))).collect::<Vec<_>>(),
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }], "nodes": nodes,
    });
    write_squares(folder, &squares, more)
}

/// Turns about the centre of a unit box that put its floor at each of its sides.
fn sides() -> impl Iterator<Item = Mat4> {
    let half = std::f32::consts::FRAC_PI_2;
    let turns = (0..4).map(move |k| Mat4::from_rotation_x(k as f32 * half));
    turns.chain([-half, half].map(Mat4::from_rotation_z)).map(|turn| about(Vec3::splat(0.5), turn))
}

/// A turn about a place.
fn about(place: Vec3, turn: Mat4) -> Mat4 {
    Mat4::from_translation(place) * turn * Mat4::from_translation(-place)
}

/// Turns the lowest square over.
fn over() -> Mat4 {
    about(Vec3::new(0.5, 0.0, 0.5), Mat4::from_rotation_x(std::f32::consts::PI))
}

/// What users are told of a scene after at most so many bounces, which were asked for or not: of bounces, and of sides
/// and light that does not arrive.
fn told(source: PathBuf, most: u32, limit: BounceLimit) -> [Option<String>; 2] {
    let mut model = read_gltf(source, 32, BounceAlbedo::Diffuse, &Silent).unwrap();
    let sides = model.find_sides(None, &Silent).unwrap();
    let mut backend = CpuBackend::new(model.scene().unwrap());
    let texels = Texels::map(&mut backend, model.size, Workspace::Memory, &Silent).unwrap();
    let surfaces = model.surfaces(&mut backend, &texels, None).unwrap();
    let quality = Quality { gather: Gather::new(16, 0, 1), error: None, denoise: None };
    let bounces = Bounces { quality, tolerance: 0.005, max_bounces: most };
    let solved = irradiance(&mut backend, &texels, &surfaces, &bounces, &Checkpoints::none(), &Silent).unwrap();
    let unlit = sides.into_iter().chain(solved.unlit()).reduce(|a, b| format!("{a}\n{b}"));
    [solved.unfinished(&model, bounces.tolerance, limit), unlit]
}

#[test]
fn bounces_that_do_not_end_are_told_with_the_materials_to_blame() {
    // A closed room around a lamp.
    let told = |material: Option<Value>, most: u32, limit: BounceLimit| {
        let folder = tempfile::tempdir().unwrap();
        let room: Vec<_> = sides().map(|side| (0, side)).collect();
        let [unfinished, unlit] = told(write_lit(folder.path(), &room, Vec3::splat(0.5), vec![material]), most, limit);
        assert_eq!(unlit, None);
        unfinished
    };
    let grey = |v: f32| Some(json!({ "name": "wall", "pbrMetallicRoughness": { "baseColorFactor": [v, v, v, 1.0] } }));
    for limit in [Bound, Wanted] {
        let white = told(None, 8, limit).unwrap();
        assert!(white.contains("do not converge: after 8") && white.contains("glTF's default"), "{white}");
        assert!(!white.contains("more bounces"), "more of them would not help: {white}");
        assert!(told(grey(1.0), 4, limit).unwrap().contains("\"wall\""));
    }
    let slow = told(grey(0.96), 8, Bound).unwrap();
    assert!(
        slow.contains("8 bounces leave out about") && slow.contains("is 0.005") && slow.contains("\"wall\""),
        "{slow}"
    );
    assert!(slow.contains("more bounces"), "{slow}");
    let few = told(grey(0.5), 2, Bound).unwrap();
    assert!(few.contains("2 bounces") && few.contains("more bounces") && !few.contains("nearly all light"), "{few}");
    // Negative controls: what was asked for, and what converged.
    assert_eq!(told(grey(0.96), 8, Wanted), None);
    assert_eq!(told(grey(0.5), 64, Bound), None);
}

#[test]
fn extensions_that_matter_are_told_and_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let read = |used: &[&str], required: &[&str]| {
        let more = json!({ "extensionsUsed": used, "extensionsRequired": required });
        let (source, told) = (write_squares(folder.path(), &[(&[set(1.0, 0.0)], None)], more), Warnings::default());
        let error = read_gltf(source, 16, BounceAlbedo::Diffuse, &told).err().map(|e| e.to_string());
        (told.all(), error)
    };
    let harmless = ["KHR_lights_punctual", "KHR_texture_transform", "KHR_materials_ior", "KHR_materials_clearcoat"];
    assert_eq!(read(&harmless, &["KHR_texture_transform"]), (vec![], None));
    let matter = ["EXT_mesh_gpu_instancing", "KHR_materials_ior", "KHR_materials_pbrSpecularGlossiness"];
    let (told, error) = read(&matter, &[]);
    let [warning] = &told[..] else { panic!("one warning, not {told:?}") };
    assert!(
        warning.contains("scene.gltf: ") && warning.contains(matter[0]) && warning.contains(matter[2]),
        "{warning}"
    );
    assert!(!warning.contains("ior") && error.is_none(), "{warning}");
    // What materials have besides takes nothing from their colours, required or not.
    assert_eq!(read(&["KHR_materials_sheen"], &["KHR_materials_sheen"]), (vec![], None));
    let advice = [
        ("KHR_materials_pbrSpecularGlossiness", "metallic-roughness"),
        ("KHR_draco_mesh_compression", "without compression"),
        ("EXT_texture_webp", "PNG or JPEG"),
        ("EXT_mesh_gpu_instancing", "every instance"),
        ("EXT_unheard_of", "export without it"),
    ];
    for (extension, word) in advice {
        let (_, error) = read(&[extension], &[extension]);
        let error = error.unwrap();
        assert!(["scene.gltf: ", extension, word].iter().all(|part| error.contains(part)), "{error}");
    }
}

#[test]
fn primitives_that_lack_their_textures_coordinates_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let read = |sets: &[Uvs]| {
        let texture = json!({ "index": 0, "texCoord": 2 });
        let more = json!({
            "images": [{ "uri": png() }], "textures": [{ "source": 0 }],
            "materials": [{ "pbrMetallicRoughness": { "baseColorTexture": texture } }],
        });
        let (source, told) =
            (write_squares(folder.path(), &[(sets, Some(0)), (sets, None)], more), Warnings::default());
        read_gltf(source, 16, BounceAlbedo::Diffuse, &told).unwrap();
        let of_textures = |told: &String| told.contains("textures");
        told.all().into_iter().filter(of_textures).collect::<Vec<_>>()
    };
    let told = read(&[set(1.0, 0.0); 2]);
    assert!(told.len() == 1 && told[0].contains("scene.gltf: 1 primitives have no TEXCOORD_2"), "{told:?}");
    assert_eq!(read(&[set(1.0, 0.0); 3]), Vec::<String>::new());
}

#[test]
fn the_lightmap_holds_backs_where_light_reaches_these_alone() {
    let material = |double_sided: bool| {
        let base = json!({ "baseColorFactor": [0.5, 0.5, 0.5, 1.0] });
        Some(json!({ "pbrMetallicRoughness": base, "doubleSided": double_sided }))
    };
    let told = |placed: &[(usize, Mat4)], lamp: Vec3, double_sided: bool| {
        let folder = tempfile::tempdir().unwrap();
        let source = write_lit(folder.path(), placed, lamp, vec![material(double_sided); 2]);
        let [_, unlit] = told(source, 64, Bound);
        unlit
    };
    let (floor, within, above) = ((0, Mat4::IDENTITY), Vec3::splat(0.5), Vec3::new(0.4, 2.0, 0.6));
    // The second square lies a metre above the first, and faces up.
    let ceiling = |turn: Mat4| (1, Mat4::from_translation(Vec3::Y) * turn * Mat4::from_translation(-Vec3::Y));
    let upside_down = told(&[floor, ceiling(Mat4::IDENTITY)], within, true).unwrap();
    assert!(upside_down.contains("in 1 primitives"), "{upside_down}");
    assert!(upside_down.contains("\"node 1\"") && !upside_down.contains("node 0"), "{upside_down}");
    // Negative controls: it is seen from its front alone, it faces down, it is lit where it faces.
    assert_eq!(told(&[floor, ceiling(Mat4::IDENTITY)], within, false), None);
    assert_eq!(told(&[floor, ceiling(over())], within, true), None);
    assert_eq!(told(&[floor, ceiling(Mat4::IDENTITY)], above, true), None);
    // Rooms and solid things are dark on some of their sides, but nobody looks from inside of the latter.
    let room: Vec<_> = sides().map(|side| (0, side)).collect();
    assert_eq!(told(&room, within, true), None);
    let cube: Vec<_> = sides().map(|side| (0, side * over())).collect();
    assert_eq!(told(&cube, above, true), None);
    // A room that is inside out.
    let black = told(&cube, within, false).unwrap();
    assert!(black.contains("no light arrives at any surface"), "{black}");
    let turned = told(&cube, within, true).unwrap();
    assert!(turned.contains("in 6 primitives") && !turned.contains("no light"), "{turned}");
}

/// How often the rows of the lightmap are baked of squares under a sky, where sides were looked for: twice if others are
/// needed.
fn sides_baked(placed: &[(usize, Mat4)], materials: Vec<Option<Value>>, sky: f32) -> usize {
    let folder = tempfile::tempdir().unwrap();
    let source = write_lit(folder.path(), placed, Vec3::new(0.4, 90.0, 0.6), materials);
    let mut model = read_gltf(source, 32, BounceAlbedo::Diffuse, &Silent).unwrap();
    model.lights.clear();
    model.find_sides(Some(&Environment::constant([sky; 3]).unwrap()), &Silent).unwrap();
    assert_eq!(model.lightmap_size()[0], model.size[0]);
    model.size[1] / model.lightmap_size()[1]
}

#[test]
fn other_sides_are_baked_where_they_are_lit_and_seen() {
    let sheet = || Some(json!({ "doubleSided": true }));
    let glowing = || Some(json!({ "doubleSided": true, "emissiveFactor": [1.0, 1.0, 1.0] }));
    // The second square lies a metre above the first.
    let (floor, above) = ((0, Mat4::IDENTITY), (1, Mat4::IDENTITY));
    assert_eq!(sides_baked(&[floor, above], vec![None, sheet()], 1.0), 2);
    // To most of a large floor it is nothing, but to what lies right below it is.
    let large = (0, about(Vec3::new(0.5, 0.0, 0.5), Mat4::from_scale(Vec3::splat(20.0))));
    assert_eq!(sides_baked(&[large, above], vec![None, sheet()], 1.0), 2);
    // Negative controls: it has one side; nobody sees the other; there is no light.
    assert_eq!(sides_baked(&[floor, above], vec![None, None], 1.0), 1);
    assert_eq!(sides_baked(&[above], vec![None, sheet()], 1.0), 1);
    assert_eq!(sides_baked(&[floor, above], vec![None, sheet()], 0.0), 1);
    // Something solid, and the same without a lid, in which a square lies.
    let solid = |open: usize| -> Vec<(usize, Mat4)> {
        let within = Mat4::from_scale_rotation_translation(Vec3::splat(0.5), Default::default(), Vec3::splat(0.2));
        let lower = over() * Mat4::from_translation(Vec3::NEG_Y);
        sides().skip(open).map(|side| (1, side * lower)).chain([(0, within)]).collect()
    };
    assert_eq!(sides_baked(&solid(0), vec![None, sheet()], 1.0), 1);
    assert_eq!(sides_baked(&solid(1), vec![None, sheet()], 1.0), 2);
    // A panel that shines up at a ceiling, and on what is below it, if there is anything.
    let ceiling = (0, Mat4::from_translation(2.0 * Vec3::Y) * over());
    assert_eq!(sides_baked(&[floor, above, ceiling], vec![None, glowing()], 0.0), 2);
    assert_eq!(sides_baked(&[above, ceiling], vec![None, glowing()], 0.0), 1);
}

#[test]
fn backs_send_light_where_nothing_says_that_they_do_not() {
    let told = |extras: Value| {
        let folder = tempfile::tempdir().unwrap();
        let glow = json!({ "doubleSided": true, "emissiveFactor": [1.0, 1.0, 1.0], "extras": extras });
        // A panel above a floor, which faces up.
        let more = json!({ "materials": [glow] });
        let [_, unlit] = told(write_squares(folder.path(), &[(&[], None), (&[], Some(0))], more), 0, Wanted);
        unlit.unwrap()
    };
    let both = told(json!({ "artist": "somebody" }));
    assert!(both.contains("in 1 primitives") && !both.contains("no light arrives"), "{both}");
    let front = told(json!({ "texir_light": "front" }));
    assert!(front.contains("no light arrives") && !front.contains("primitives"), "{front}");
}

#[test]
fn lamps_are_the_triangles_that_their_images_show_to_shine() {
    let folder = tempfile::tempdir().unwrap();
    // Bright in its right half.
    let image = image::RgbImage::from_fn(64, 4, |x, _| image::Rgb([if x < 32 { 1 } else { 255 }; 3]));
    image.save(folder.path().join("half.png")).unwrap();
    let glow = json!({ "emissiveFactor": [1.0, 1.0, 1.0], "emissiveTexture": { "index": 0 } });
    let more = json!({ "images": [{ "uri": "half.png" }], "textures": [{ "source": 0 }], "materials": [glow] });
    let squares: [(&[Uvs], _); 3] =
        [(&[set(0.2, 0.1)], Some(0)), (&[set(0.2, 0.7)], Some(0)), (&[set(0.2, 0.7)], None)];
    let model = read_gltf(write_squares(folder.path(), &squares, more), 32, BounceAlbedo::Diffuse, &Silent).unwrap();
    assert_eq!(model.shining(), [false, false, true, true, false, false]);
}

#[test]
fn what_is_lit_under_a_roof_of_one_sheet_is_not_inside_of_something() {
    let folder = tempfile::tempdir().unwrap();
    // Nine metres wide, it faces up: of the floor's rays nearly all meet its back.
    let wide = Mat4::from_scale_rotation_translation(Vec3::new(9.0, 1.0, 9.0), Default::default(), Vec3::splat(-4.0));
    let roof = Mat4::from_translation(4.0 * Vec3::Y) * wide;
    let scene = write_lit(folder.path(), &[(0, Mat4::IDENTITY), (1, roof)], Vec3::new(0.4, 0.5, 0.6), vec![None; 2]);
    assert_eq!(told(scene, 2, Wanted), [None, None]);
}

/// Visits the irradiance of a model's texels, baked with few rays and so many bounces.
fn each_baked(model: &Model, most: u32, mut visit: impl FnMut(&SurfacePoint, [f32; 3])) {
    let mut backend = CpuBackend::new(model.scene().unwrap());
    let texels = Texels::map(&mut backend, model.size, Workspace::Memory, &Silent).unwrap();
    let surfaces = model.surfaces(&mut backend, &texels, None).unwrap();
    let quality = Quality { gather: Gather::new(16, 16, 1), error: None, denoise: None };
    let bounces = Bounces { quality, tolerance: 0.0, max_bounces: most };
    let solved = irradiance(&mut backend, &texels, &surfaces, &bounces, &Checkpoints::none(), &Silent).unwrap();
    let baked = solved.solution.into_baked().unwrap();
    let points = texels.points().flat_map(|points| points.unwrap().into_owned());
    points.zip(baked.irradiance).for_each(|(point, e)| visit(&point, e));
}

/// The mean irradiance of a floor under a lamp, where `roof` is between both: a sheet of a material, wider than it is
/// high.
fn under_a_roof(roof: Mat4, material: Option<Value>) -> f32 {
    let folder = tempfile::tempdir().unwrap();
    let wide = Mat4::from_scale_rotation_translation(Vec3::new(9.0, 1.0, 9.0), Default::default(), Vec3::splat(-4.0));
    let roof = Mat4::from_translation(4.0 * Vec3::Y) * roof * wide;
    let placed = [(0, Mat4::IDENTITY), (1, roof)];
    let scene = write_lit(folder.path(), &placed, Vec3::new(0.5, 2.0, 0.5), vec![None, material]);
    let model = read_gltf(scene, 64, BounceAlbedo::Diffuse, &Silent).unwrap();
    // The floor has the mesh's first two triangles.
    let (mut sum, mut count) = (0.0, 0);
    let of_floor = |point: &SurfacePoint| point.triangle < 2;
    each_baked(&model, 2, |point, e| {
        if of_floor(point) {
            (sum, count) = (sum + e[0], count + 1)
        }
    });
    assert!(count > 0);
    sum / count as f32
}

#[test]
fn no_light_comes_through_a_sheet() {
    // As white as can be.
    assert_eq!(under_a_roof(Mat4::IDENTITY, None), 0.0);
    // Negative control: beside the floor it is no roof.
    assert!(under_a_roof(Mat4::from_translation(20.0 * Vec3::X), None) > 1.0);
}

#[test]
fn as_much_light_passes_as_a_surface_lets_through() {
    let transmitting =
        |share: f32| json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": share } } });
    let blended = |alpha: f32| json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorFactor": [0.0, 0.0, 0.0, alpha] } });
    let open = under_a_roof(Mat4::from_translation(20.0 * Vec3::X), Some(transmitting(1.0)));
    assert_eq!(under_a_roof(Mat4::IDENTITY, Some(transmitting(1.0))), open);
    assert_eq!(under_a_roof(Mat4::IDENTITY, Some(transmitting(0.0))), 0.0);
    for (material, expected) in [(transmitting(0.3), 0.3), (blended(0.25), 0.75), (blended(0.9), 0.1)] {
        let through = under_a_roof(Mat4::IDENTITY, Some(material.clone())) / open;
        assert!((through - expected).abs() < 1e-4, "{through} of the light passes: {material}");
    }
}

#[test]
fn surfaces_are_there_where_their_materials_are_opaque() {
    let folder = tempfile::tempdir().unwrap();
    // Opaque in its left quarter; in the file, so that it is read as PNGs with alpha are.
    let mut image = image::RgbaImage::from_pixel(64, 4, image::Rgba([255, 255, 255, 0]));
    (0..16).for_each(|x| (0..4).for_each(|y| image.get_pixel_mut(x, y).0[3] = 255));
    image.save(folder.path().join("quarter.png")).unwrap();
    // The share of a primitive that rays meet: its triangles are of one size.
    let share = |part: &super::gltf::Part| {
        let of_triangle = |opacity: &TriangleOpacity| match opacity {
            TriangleOpacity::Opaque => 1.0,
            TriangleOpacity::Transparent => 0.0,
            TriangleOpacity::Micromap(map) if map.even_opacity().is_some() => map.even_opacity().unwrap(),
            TriangleOpacity::Micromap(map) => {
                let set: u32 = map.words().iter().map(|word| word.count_ones()).sum();
                set as f32 / map.side().pow(2) as f32
            }
        };
        let sum: f32 = part.opacity.iter().map(of_triangle).sum();
        if part.opacity.is_empty() { 1.0 } else { sum / part.opacity.len() as f32 }
    };
    // The square shows the image from `at` on, `scale` of it.
    let read = |material: &Value, (scale, at): (f32, f32)| {
        let told = Warnings::default();
        let more = json!({
            "images": [{ "uri": "quarter.png" }, { "uri": png() }],
            "textures": [{ "source": 0 }, { "source": 1 }], "materials": [material],
        });
        let source = write_squares(folder.path(), &[(&[set(scale, at)], Some(0)), (&[set(1.0, 0.0)], None)], more);
        let model = read_gltf(source, 32, BounceAlbedo::Diffuse, &told).unwrap();
        assert!(model.parts[1].opacity.is_empty());
        let told: Vec<String> = told.all().into_iter().filter(|what| what.contains("primitives are")).collect();
        (share(&model.parts[0]), told.join(" "))
    };
    let whole = (1.0, 0.0);
    let plain = |mode: &str, alpha: f32| json!({ "alphaMode": mode, "pbrMetallicRoughness": { "baseColorFactor": [1.0, 1.0, 1.0, alpha] } });
    let textured = |mode: &str, texture: usize, alpha: f32| {
        let base = json!({ "baseColorTexture": { "index": texture }, "baseColorFactor": [1.0, 1.0, 1.0, alpha] });
        json!({ "alphaMode": mode, "pbrMetallicRoughness": base })
    };
    // Transmission replaces what is reflected, not what is emitted.
    let lamp = |mut material: Value| {
        material["emissiveFactor"] = json!([1.0, 1.0, 1.0]);
        material
    };
    let glass = json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.8 } } });
    for (material, shown, expected) in [
        (plain("BLEND", 0.3), whole, 0.3),
        (plain("BLEND", 0.7), whole, 0.7),
        (plain("MASK", 0.3), whole, 0.0),
        (plain("MASK", 0.7), whole, 1.0),
        (plain("OPAQUE", 0.0), whole, 1.0),
        (textured("MASK", 0, 1.0), whole, 0.25),
        (textured("BLEND", 0, 1.0), whole, 0.25),
        (textured("BLEND", 0, 0.4), whole, 0.1),
        (textured("OPAQUE", 0, 1.0), whole, 1.0),
        // What it shows decides, not what the image holds: the quarter alone, what is beside it.
        (textured("MASK", 0, 1.0), (0.2, 0.01), 1.0),
        (textured("BLEND", 0, 1.0), (0.2, 0.01), 1.0),
        (textured("BLEND", 0, 0.4), (0.2, 0.01), 0.4),
        (textured("BLEND", 0, 1.0), (0.3, 0.0), 0.25 / 0.3),
        (textured("MASK", 0, 1.0), (0.5, 0.4), 0.0),
        // Images without alpha.
        (textured("MASK", 1, 1.0), whole, 1.0),
        (textured("BLEND", 1, 0.4), whole, 0.4),
        (lamp(plain("BLEND", 0.3)), whole, 0.3),
        (glass.clone(), whole, 0.2),
        (lamp(glass), whole, 1.0),
    ] {
        let (share, told) = read(&material, shown);
        assert!((share - expected).abs() < 0.02, "{share} is there: {material} {shown:?}");
        let is_told = told.contains("1 primitives are transparent, or in parts") && told.contains("\"node 0\"");
        assert_eq!(is_told, expected < 1.0, "{material}: {told}");
    }
}

#[test]
fn albedo_is_that_of_what_is_opaque() {
    let folder = tempfile::tempdir().unwrap();
    // Columns of opaque red and of transparent blue, many of each to a texel.
    let column = |x: u32, _: u32| image::Rgba(if x.is_multiple_of(2) { [255, 0, 0, 255] } else { [0, 0, 255, 102] });
    image::RgbaImage::from_fn(512, 8, column).save(folder.path().join("columns.png")).unwrap();
    for (mode, expected) in [
        ("MASK", [1.0, 0.0, 0.0]),
        // As much as is seen of each: 1 and 0.4.
        ("BLEND", [1.0 / 1.4, 0.0, 0.4 / 1.4]),
        ("OPAQUE", [0.5, 0.0, 0.5]),
    ] {
        let more = json!({
            "images": [{ "uri": "columns.png" }], "textures": [{ "source": 0 }],
            "materials": [{ "alphaMode": mode, "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }],
        });
        let source = write_squares(folder.path(), &[(&[set(1.0, 0.0)], Some(0))], more);
        let model = read_gltf(source, 32, BounceAlbedo::Diffuse, &Silent).unwrap();
        let mut backend = CpuBackend::new(model.scene().unwrap());
        let texels = Texels::map(&mut backend, model.size, Workspace::Memory, &Silent).unwrap();
        let albedo = model.surfaces(&mut backend, &texels, None).unwrap().albedo;
        let found = albedo.at(16, 16);
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 0.02, "{found:?} for {expected:?}: {mode}");
    }
}

#[test]
fn cut_outs_cast_the_shadow_of_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    // The left half of the roof.
    let mut image = image::RgbaImage::from_pixel(8, 8, image::Rgba([255, 255, 255, 0]));
    (0..4).for_each(|x| (0..8).for_each(|y| image.get_pixel_mut(x, y).0[3] = 255));
    image.save(folder.path().join("half.png")).unwrap();
    let squares = [(&[set(0.48, 0.01)][..], None), (&[set(1.0, 0.0)][..], Some(0))];
    let sun =
        json!({ "extensions": { "KHR_lights_punctual": { "lights": [{ "type": "directional", "intensity": 4.0 }] } } });
    let mut more = json!({
        "images": [{ "uri": "half.png" }], "textures": [{ "source": 0 }],
        "materials": [{ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }],
        "extensionsUsed": ["KHR_lights_punctual"], "scenes": [{ "nodes": [0, 1, 2] }],
    });
    more.as_object_mut().unwrap().extend(sun.as_object().unwrap().clone());
    let source = write_squares(folder.path(), &squares, more);
    // Straight down: its −Z is the world's −Y.
    let mut document: Value = serde_json::from_slice(&std::fs::read(&source).unwrap()).unwrap();
    let lamp = json!({ "rotation": [-0.5f32.sqrt(), 0.0, 0.0, 0.5f32.sqrt()], "extensions": { "KHR_lights_punctual": { "light": 0 } } });
    document["nodes"].as_array_mut().unwrap().push(lamp);
    std::fs::write(&source, document.to_string()).unwrap();
    let model = read_gltf(source, 64, BounceAlbedo::Diffuse, &Silent).unwrap();
    let mut seen = [0; 2];
    let look = |point: &SurfacePoint, e: [f32; 3]| {
        let ([x, ..], floor) = (point.position, point.triangle < 2);
        if floor && (x - 0.5).abs() > 0.05 {
            let expected = if x < 0.5 { 0.0 } else { 4.0 };
            assert!((e[0] - expected).abs() < 1e-3, "{e:?} at {x}");
            seen[usize::from(x > 0.5)] += 1;
        }
    };
    each_baked(&model, 0, look);
    assert!(seen.iter().all(|count| *count > 50), "{seen:?}");
}

#[test]
fn coordinates_for_a_lightmap_that_are_not_taken_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let read = |squares: &[(&[Uvs], Option<usize>)]| {
        let told = Warnings::default();
        let source = write_squares(folder.path(), squares, json!({}));
        let model = read_gltf(source, 32, BounceAlbedo::Diffuse, &told).unwrap();
        (told.all(), model.lightmap_set)
    };
    let (left, right, flat) = (set(0.4, 0.0), set(0.4, 0.5), [[0.5; 2]; 4]);
    let expect = |(told, taken): (Vec<String>, Option<usize>), set: Option<usize>, words: &[&str]| {
        assert_eq!(taken, set, "{told:?}");
        let [told] = &told[..] else { panic!("one warning, not {told:?}") };
        words.iter().for_each(|word| assert!(told.contains(word), "{word:?} is not in: {told}"));
    };
    let overlapping = read(&[(&[left, left], None), (&[right, left], None)]);
    expect(overlapping, Some(0), &["scene.gltf: TEXCOORD_1 is no lightmap's", "share", "TEXCOORD_0 is taken"]);
    expect(read(&[(&[left, set(2.0, 0.0)], None), (&[left, right], None)]), None, &["leave [0, 1]", "unwrapped"]);
    expect(read(&[(&[left, flat], None), (&[left, right], None)]), None, &["2 triangles have no area"]);
    expect(read(&[(&[left, left], None), (&[left], None)]), None, &["1 primitives lack it (\"node 1\""]);
    // Negative controls: one that is taken, and none.
    assert_eq!(read(&[(&[left, left], None), (&[left, right], None)]), (vec![], Some(1)));
    assert_eq!(read(&[(&[left], None), (&[left], None)]), (vec![], None));
}

#[test]
fn normals_against_the_front_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let source = write_squares(folder.path(), &[(&[set(1.0, 0.0)], None)], json!({}));
    let mut model = read_gltf(source, 16, BounceAlbedo::Diffuse, &Silent).unwrap();
    assert_eq!(model.turned_away(), None);
    model.mesh.normals.iter_mut().for_each(|normal| *normal = -*normal);
    let told = model.turned_away().unwrap();
    assert!(told.starts_with("2 triangles have normals that point away"), "{told}");
}

#[test]
fn the_baked_scene_says_which_extensions_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let more = json!({
        "extensionsUsed": ["EXT_made_up", "KHR_materials_ior", "KHR_materials_variants"],
        "extensions": { "KHR_materials_variants": { "variants": [{ "name": "red" }] } },
        "materials": [{ "extensions": { "EXT_made_up": { "x": 1 }, "KHR_materials_ior": { "ior": 1.4 } } }],
    });
    let source = write_squares(folder.path(), &[(&[set(1.0, 0.0)], Some(0))], more);
    let Written(json, _) = Written::of(&source, true);
    let used = json!(["EXT_made_up", "KHR_materials_ior", "MOZ_lightmap", "MOZ_texture_rgbe"]);
    assert_eq!(json["extensionsUsed"], used);
    assert!(json.get("extensions").is_none(), "{json}");
}

#[test]
fn dim_panels_too_shine_from_their_front_alone() {
    // Half of all surface shines, so that it does not stand out.
    let told = |panel: Mat4| {
        let folder = tempfile::tempdir().unwrap();
        let glow = json!({
            "materials": [{ "emissiveFactor": [1.0, 1.0, 1.0] }],
            "scenes": [{ "nodes": [0, 1] }],
            "nodes": [{ "mesh": 0 }, { "mesh": 1, "matrix": panel.to_cols_array() }],
        });
        let [_, unlit] = told(write_squares(folder.path(), &[(&[], None), (&[], Some(0))], glow), 0, Wanted);
        unlit
    };
    let facing_down = about(Vec3::new(0.5, 1.0, 0.5), Mat4::from_rotation_x(std::f32::consts::PI));
    assert_eq!(told(facing_down), None);
    assert!(told(Mat4::IDENTITY).unwrap().contains("no light arrives"));
}

#[test]
fn spots_without_a_cone_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_lit(folder.path(), &[(0, Mat4::IDENTITY)], Vec3::new(0.5, 1.0, 0.5), vec![None]);
    let text = std::fs::read_to_string(&scene).unwrap();
    let read = |inner: f64, outer: f64| {
        let mut document: Value = serde_json::from_str(&text).unwrap();
        document["extensions"]["KHR_lights_punctual"]["lights"][0] =
            json!({ "type": "spot", "spot": { "innerConeAngle": inner, "outerConeAngle": outer } });
        std::fs::write(&scene, document.to_string()).unwrap();
        read_gltf(&scene, 16, BounceAlbedo::Diffuse, &Silent).map(drop).map_err(|e| e.to_string())
    };
    for (inner, outer) in [(0.75, 0.5), (0.5, 2.0), (-0.5, 0.5)] {
        let error = read(inner, outer).unwrap_err();
        for part in
            ["scene.gltf: the light of node 1", &format!("inner_cone_angle is {inner}"), &format!("{outer}; expected")]
        {
            assert!(error.contains(part), "{part:?} is not in: {error}");
        }
    }
    // Negative controls, of a half-space too, as files with few digits have it.
    for (inner, outer) in [(0.0, 0.5), (0.5, 0.5), (0.0, 1.571)] {
        read(inner, outer).unwrap();
    }
}

#[test]
fn surfaces_that_reflect_more_than_all_light_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let read = |v: f32| {
        let colour = json!({ "name": "wall", "pbrMetallicRoughness": { "baseColorFactor": [0.5, v, 0.5, 1.0] } });
        let scene = write_squares(folder.path(), &[(&[], Some(0))], json!({ "materials": [colour] }));
        read_gltf(&scene, 16, BounceAlbedo::Diffuse, &Silent).map(drop).map_err(|e| e.to_string())
    };
    for v in [1.5, -0.1] {
        let error = read(v).unwrap_err();
        let said = format!("\"wall\" emits [0, 0, 0] and reflects (0.5, {v}, 0.5)");
        assert!(error.contains(&said) && error.contains("baseColorFactor from 0 to 1"), "{error}");
    }
    // Negative control, with what conversions leave.
    read(1.0001).unwrap();
}

#[test]
fn surfaces_that_no_scene_has_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let surfaces = surfaces_of(&write_squares(folder.path(), &[(&[], None)], json!({})), 16);
    let scene = read_gltf(folder.path().join("scene.gltf"), 16, BounceAlbedo::Diffuse, &Silent).unwrap();
    let mut backend = CpuBackend::new(Scene::new(scene.mesh).unwrap());
    let texels = Texels::map(&mut backend, [16; 2], Workspace::Memory, &Silent).unwrap();
    let said = |change: &dyn Fn(&mut Surfaces)| {
        let mut changed = surfaces.clone();
        change(&mut changed);
        changed.check(&texels).map_err(|e| e.to_string())
    };
    said(&|_| {}).unwrap();
    for (change, part) in [
        (
            &(|s: &mut Surfaces| s.emission.data.truncate(5)) as &dyn Fn(&mut Surfaces),
            "emission map is 16×16 texels and holds 5",
        ),
        (&|s| s.albedo.data.clear(), "albedo map is 16×16 texels and holds 0"),
        (&|s| s.emission.data[7] = [0.0, f32::NAN, 0.0], "emission map leaves"),
        (&|s| s.emission.data[7] = [2e15; 3], "emission map leaves [0, 1e15]"),
        (&|s| s.albedo.data[7] = [1.5; 3], "albedo map leaves"),
    ] {
        let error = said(change).unwrap_err();
        assert!(error.contains(part), "{part:?} is not in: {error}");
    }
    let quality = Quality::denoised(Gather::new(4, 4, 0));
    let error = |backend: &mut CpuBackend, tolerance: f32| {
        let bounces = Bounces { quality, tolerance, max_bounces: 1 };
        irradiance(backend, &texels, &surfaces, &bounces, &Checkpoints::none(), &Silent).unwrap_err().to_string()
    };
    assert!(error(&mut backend, f32::NAN).contains("tolerance of bounces is NaN"));
    let mut smaller = backend.scene().mesh().clone();
    smaller.triangles.truncate(1);
    let said = error(&mut CpuBackend::new(Scene::new(smaller).unwrap()), 0.1);
    assert!(said.contains("of a mesh of 1; expected texels of the backend's mesh"), "{said}");
}

#[test]
fn lightmaps_without_room_for_a_chart_are_refused_before_unwrapping() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_squares(folder.path(), &[(&[], None)], json!({}));
    let progress = crate::progress::Silent;
    for size in [1, 4] {
        let error = read_gltf(&scene, size, BounceAlbedo::Diffuse, &progress).map(drop).unwrap_err().to_string();
        assert!(error.contains(&format!("{size}×{size} texels; expected at least 5")), "{error}");
    }
    // Negative control.
    assert_eq!(read_gltf(&scene, 5, BounceAlbedo::Diffuse, &progress).unwrap().size[0], 5);
}

#[test]
fn a_texture_is_turned_scaled_moved_and_wrapped_as_its_extension_and_its_sampler_say() {
    // Four colours, read at places that the extension gives: offset · rotation · scale. (Its sample code turns the
    // other way than its words, its sample asset and engines do: KhronosGroup/glTF issue 1563.)
    let [a, b, c, d] = [[255u8, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]];
    let image = png_of(&Raster { width: 2, height: 2, data: vec![a, b, c, d] });
    const REPEAT: u32 = 10497;
    const CLAMP: u32 = 33071;
    const MIRROR: u32 = 33648;
    let quarter = std::f32::consts::FRAC_PI_2;
    for (transform, wrap, uv, expected) in [
        (json!({}), REPEAT, [0.25, 0.25], a),
        (json!({}), REPEAT, [0.75, 0.25], b),
        (json!({}), REPEAT, [0.25, 0.75], c),
        (json!({}), REPEAT, [1.25, 0.25], a),
        (json!({}), CLAMP, [1.25, 0.25], b),
        (json!({}), CLAMP, [-0.25, 0.75], c),
        (json!({}), MIRROR, [1.25, 0.25], b),
        (json!({}), MIRROR, [1.75, 0.25], a),
        (json!({ "offset": [0.5, 0.0] }), CLAMP, [0.25, 0.25], b),
        (json!({ "offset": [0.0, 0.5] }), CLAMP, [0.25, 0.25], c),
        (json!({ "scale": [3.0, 1.0] }), CLAMP, [0.25, 0.75], d),
        // (u, v) → (cos r · u + sin r · v, −sin r · u + cos r · v) = (v, −u), and one further down.
        (json!({ "rotation": quarter, "offset": [0.0, 1.0] }), CLAMP, [0.25, 0.25], c),
        (json!({ "rotation": quarter, "offset": [0.0, 1.0] }), CLAMP, [0.75, 0.25], a),
        (json!({ "rotation": quarter, "offset": [0.0, 1.0] }), CLAMP, [0.25, 0.75], d),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let texture = json!({ "index": 0, "extensions": { "KHR_texture_transform": transform } });
        let scene = write_squares(
            folder.path(),
            &[(&[[uv; 4], set(0.8, 0.1)], Some(0))],
            json!({
                "extensionsUsed": ["KHR_texture_transform"],
                "images": [{ "uri": image }], "textures": [{ "source": 0, "sampler": 0 }],
                "samplers": [{ "wrapS": wrap, "wrapT": wrap }],
                "materials": [{ "emissiveFactor": [1.0, 1.0, 1.0], "emissiveTexture": texture,
                    "pbrMetallicRoughness": { "metallicFactor": 0.0 } }],
            }),
        );
        let emission = surfaces_of(&scene, 16).emission;
        let found = emission.at(8, 8).map(|v| (255.0 * v).round() as u8);
        assert_eq!(found, expected, "{transform} {wrap} at {uv:?}");
    }
}

#[test]
fn a_spot_of_a_file_has_its_cone_and_its_range() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_lit(folder.path(), &[(0, Mat4::IDENTITY)], Vec3::new(0.5, 1.0, 0.5), vec![None]);
    let mut document: Value = serde_json::from_str(&std::fs::read_to_string(&scene).unwrap()).unwrap();
    document["extensions"]["KHR_lights_punctual"]["lights"][0] = json!({
        "type": "spot", "color": [1.0, 0.5, 0.25], "intensity": 8.0, "range": 9.0,
        "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 }
    });
    std::fs::write(&scene, document.to_string()).unwrap();
    let lights = read_gltf(&scene, 16, BounceAlbedo::Diffuse, &Silent).unwrap().lights;
    let [light] = &lights[..] else { panic!("{lights:?}") };
    let PunctualLight::Spot { position, direction, .. } = *light else { panic!("{light:?}") };
    let expected = PunctualLight::Spot {
        position,
        direction,
        intensity: [8.0, 4.0, 2.0],
        range: Some(9.0),
        inner_cone_angle: 0.25,
        outer_cone_angle: 0.5,
    };
    assert_eq!(*light, expected);
}

#[test]
fn numbers_of_materials_beyond_single_precision_are_refused_before_the_bake() {
    let folder = tempfile::tempdir().unwrap();
    let read = |roughness: Value| {
        let material = json!({ "pbrMetallicRoughness": { "roughnessFactor": roughness } });
        let squares: &[(&[Uvs], _)] = &[(&[], Some(0))];
        let scene = write_squares(folder.path(), squares, json!({ "materials": [material] }));
        read_gltf(scene, 16, BounceAlbedo::Diffuse, &Silent).map(drop).map_err(|e| e.to_string())
    };
    read(json!(0.5)).unwrap();
    let error = read(json!(1e308)).unwrap_err();
    assert!(
        error.contains("scene.gltf: materials[0]: roughnessFactor") && error.contains("single precision"),
        "{error}"
    );
}

#[test]
fn buffers_that_are_no_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_squares(folder.path(), &[(&[], None)], json!({}));
    let mut document: Value = serde_json::from_str(&std::fs::read_to_string(&scene).unwrap()).unwrap();
    std::fs::create_dir(folder.path().join("scene.bin")).unwrap();
    document["buffers"][0]["uri"] = "scene.bin".into();
    std::fs::write(&scene, document.to_string()).unwrap();
    let error = read_gltf(&scene, 16, BounceAlbedo::Diffuse, &Silent).map(drop).unwrap_err().to_string();
    assert!(error.contains("buffers[0]: its file scene.bin is a folder or a device; expected a file"), "{error}");
}
