//! `texir bake` of scenes that bring their own light.

use std::path::Path;

use glam::{Vec2, Vec3};
use serde_json::Value;
use texir_core::glb::{Materials, Up, write_glb};
use texir_core::image_io::{read_gray, read_rgb};
use texir_core::lightmap::write_lightmap;
use texir_core::mesh::Mesh;
use texir_core::raster::{Gray, Rgb};

use crate::texir::{run, succeed};

/// A floor under a lamp that faces it, in the two halves of one atlas; the lamp shines with `emission`.
fn write_scene(path: &Path, emission: f32) {
    let mut mesh = Mesh::default();
    for (height, normal, u) in [(0.0, Vec3::Y, 0.0), (1.0, Vec3::NEG_Y, 0.5)] {
        let base = mesh.positions.len() as u32;
        for (x, z) in [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)] {
            mesh.positions.push(Vec3::new(x, height, z));
            mesh.normals.push(normal);
            mesh.uvs.push(Vec2::new(u + 0.05 + 0.4 * x, 0.05 + 0.9 * z));
        }
        let order = if u == 0.0 { [[0, 1, 2], [0, 2, 3]] } else { [[0, 2, 1], [0, 3, 2]] };
        mesh.triangles.extend(order.map(|t: [u32; 3]| t.map(|i| base + i)));
    }
    let shines = |i: usize| if i % 32 < 16 { [0.0; 3] } else { [emission; 3] };
    let emission = Rgb::new(32, 32, (0..32 * 32).map(shines).collect()).unwrap();
    let (albedo, roughness) = (Rgb::filled(32, 32, [0.5; 3]), Gray::filled(32, 32, 0.5));
    let of = Materials { albedo: &albedo, roughness: &roughness, metallic: None, emission: Some(&emission) };
    write_glb(path, &mesh, &of, Up::Y).unwrap();
}

/// Mean irradiance of the floor.
fn floor(map: &Rgb) -> f32 {
    let texels = (8..24).flat_map(|y| (4..12).map(move |x| map.at(x, y)[1]));
    texels.sum::<f32>() / 128.0
}

#[test]
fn an_authored_scene_is_baked_for_an_engine() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.glb");
    write_scene(&scene, 1000.0);
    let bake = |name: &str, more: &[&str]| -> Value {
        let output = folder.path().join("out").join(name);
        let how = ["--size", "32", "--spp", "64", "--backend", "cpu", "--json", "-o"].map(AsRef::as_ref);
        let more: Vec<_> = more.iter().map(AsRef::as_ref).collect();
        let said = succeed(&[&["bake".as_ref(), scene.as_os_str()], &how[..], &[output.as_os_str()], &more].concat());
        serde_json::from_str(&said.out).unwrap()
    };
    let summary = bake("full.exr", &[]);
    let full = read_rgb(folder.path().join("out/full.exr")).unwrap();
    assert_eq!(full.size(), [32, 32]);
    // Two unit squares a metre apart: the view factor is 0.2, so that direct light alone is πL · 0.2 on average.
    let direct = std::f32::consts::PI * 1000.0 * 0.2;
    assert!((direct..1.6 * direct).contains(&floor(&full)), "{} lux, {direct} of them directly", floor(&full));
    assert!(
        summary["remainder"].as_f64().unwrap() <= 0.005
            && summary["irradiance_by_bounce"].as_array().unwrap().len() > 1
    );
    assert!(folder.path().join("out/full.glb").is_file());

    for (profile, expected) in [
        ("bevy", std::f32::consts::PI),
        ("godot", std::f32::consts::PI),
        ("unity", std::f32::consts::PI),
        ("three", 1.0),
    ] {
        bake("engine.hdr", &["--profile", profile]);
        let engine = read_rgb(folder.path().join("out/engine.hdr")).unwrap();
        let ratio = floor(&full) / floor(&engine);
        assert!((ratio / expected - 1.0).abs() < 0.01, "{profile}: E / texel is {ratio}");
    }
    // Standard errors are in the unit of the map.
    let errors = |name: &str, profile: &[&str]| {
        bake(name, &[&["--error-map", "--bounces", "0"], profile].concat());
        let map = read_gray(folder.path().join("out").join(name.replace(".exr", "_error.exr"))).unwrap();
        map.data.iter().sum::<f32>()
    };
    let ratio = errors("a.exr", &[]) / errors("b.exr", &["--profile", "bevy"]);
    assert!((ratio / std::f32::consts::PI - 1.0).abs() < 1e-3, "standard errors' ratio is {ratio}");

    bake("hubs.hdr", &["--profile", "moz", "--bounces", "0"]);
    let glb = std::fs::read(folder.path().join("out/hubs.glb")).unwrap();
    assert!(String::from_utf8_lossy(&glb).contains("\"MOZ_lightmap\""));
    bake("map.ktx2", &[]);
}

#[test]
fn a_scene_of_others_beside_the_map_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, other, map] = ["scene.glb", "map.glb", "map.exr"].map(|name| folder.path().join(name));
    write_scene(&scene, 1000.0);
    let how = ["--size", "16", "--spp", "4", "--bounces", "0", "--backend", "cpu", "-o"].map(AsRef::as_ref);
    let bake = [&["bake".as_ref(), scene.as_os_str()], &how[..], &[map.as_os_str()]].concat();
    let mut bytes = std::fs::read(&scene).unwrap();
    let generator = bytes.windows(6).position(|w| w == b"texir ").unwrap();
    bytes[generator..generator + 6].copy_from_slice(b"other ");
    std::fs::write(&other, &bytes).unwrap();
    let said = run(&bake);
    assert_eq!(said.code, Some(1), "{said:#?}");
    said.complains(&["map.glb", "texir did not write it", "--output"]);
    assert!(std::fs::read(&other).unwrap() == bytes && !map.exists());
    // Negative control: what texir wrote is written anew.
    std::fs::remove_file(&other).unwrap();
    succeed(&bake);
    succeed(&bake);
}

#[test]
fn an_environment_shines_in_the_unit_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, sky, output] = ["scene.glb", "sky.hdr", "out.exr"].map(|name| folder.path().join(name));
    write_scene(&scene, 0.0);
    write_lightmap(&sky, &Rgb::filled(8, 4, [1.0; 3])).unwrap();
    let mean = |more: &[&str]| {
        let with = ["--environment".as_ref(), sky.as_os_str(), "-o".as_ref(), output.as_os_str()];
        let how = ["--size", "32", "--spp", "64", "--backend", "cpu", "--bounces", "0"].map(AsRef::as_ref);
        let more: Vec<_> = more.iter().map(AsRef::as_ref).collect();
        succeed(&[&["bake".as_ref(), scene.as_os_str()], &with[..], &how[..], &more].concat());
        floor(&read_rgb(&output).unwrap())
    };
    // Of a sky of radiance 1, all of π but the fifth that the square above hides, on average.
    let expected = 0.8 * std::f32::consts::PI;
    for (more, nits) in [(&[][..], 1.0), (&["--environment-nits", "250"], 250.0)] {
        let found = mean(more);
        assert!((found / (nits * expected) - 1.0).abs() < 0.1, "{found} for {expected} times {nits}");
    }
}

#[test]
fn scenes_that_cannot_be_baked_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (folder.path().join("scene.glb"), folder.path().join("out.exr"));
    write_scene(&scene, 0.0);
    let bake = |output: &Path, more: &[&str]| {
        let how = ["--size", "32", "--spp", "8", "--backend", "cpu", "-o"].map(AsRef::as_ref);
        let more: Vec<_> = more.iter().map(AsRef::as_ref).collect();
        run(&[&["bake".as_ref(), scene.as_os_str()], &how[..], &[output.as_os_str()], &more].concat())
    };
    bake(&out, &[]).complains(&["scene.glb", "no light sources", "emissive"]);
    bake(&out.with_extension("png"), &[]).complains(&["out.png", ".ktx2"]);
    bake(&scene.with_extension("exr"), &[]).complains(&["scene.glb", "--output"]);
    bake(&out, &["--environment", "missing.hdr"]).complains(&["missing.hdr"]);
    bake(&out, &["--tolerance", "nan"]).complains(&["nan", "--tolerance", "at least 0"]);
    for share in ["2", "1", "0", "-1", "nan"] {
        bake(&out, &["--error", share]).complains(&["--error", "above 0 and below 1"]);
    }
    bake(&out, &["--max-memory", "1MiB"]).complains(&["limit of memory is 1.0 MiB", "32×32", "raise it"]);
    assert!(!out.exists() && !out.with_extension("exr.partial").exists());
    // What is read is not written over, and what cannot be written is told before the bake.
    let sky = folder.path().join("sky.hdr");
    write_lightmap(&sky, &Rgb::filled(8, 4, [1.0; 3])).unwrap();
    let before = std::fs::read(&sky).unwrap();
    bake(&sky, &["--environment", sky.to_str().unwrap()]).complains(&["sky.hdr", "replace", "--output"]);
    assert!(before == std::fs::read(&sky).unwrap());
    std::fs::create_dir(folder.path().join("taken.glb")).unwrap();
    bake(&folder.path().join("taken.exr"), &[]).complains(&["taken.glb", "folder"]);
    let large = ["--size".as_ref(), "20000".as_ref(), "-o".as_ref(), out.as_os_str()];
    run(&[&["bake".as_ref(), scene.as_os_str()], &large[..]].concat()).complains(&["20000", "--size", "16384"]);
    let nowhere = folder.path().join("nowhere.glb");
    run(&["bake".as_ref(), nowhere.as_os_str()]).complains(&["nowhere.glb", "no such file"]);
}
