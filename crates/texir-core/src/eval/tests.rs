//! The protocol on a closed box whose views are rendered here, so that the right figures are known.

use std::path::Path;
use std::sync::Arc;

use glam::{Mat4, Vec2, Vec3};

use super::*;
use crate::brdf::Masking;
use crate::camera::{Camera, Projection};
use crate::capture::Truth;
use crate::cpu::CpuBackend;
use crate::diffuse::DiffuseModel;
use crate::image_io::{write_gray, write_png_mask, write_rgb};
use crate::mesh::Mesh;
use crate::progress::Silent;
use crate::scene::Scene;

const ATLAS: (usize, usize) = (48, 32);

/// A box of 4 × 4 × 4 m around the origin, seen from within; its faces are the cells of a 3 × 2 atlas, a little apart.
fn room() -> Mesh {
    let mut mesh = Mesh::default();
    for (face, normal) in [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z].into_iter().enumerate() {
        let (right, up) = normal.any_orthonormal_pair();
        let base = mesh.positions.len() as u32;
        let cell = Vec2::new((face % 3) as f32, (face / 3) as f32);
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(normal * -2.0 + (right * (2.0 * x - 1.0) + up * (2.0 * y - 1.0)) * 2.0);
            mesh.normals.push(normal);
            mesh.uvs.push((cell + 0.1 + 0.8 * Vec2::new(x, y)) / Vec2::new(3.0, 2.0));
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    mesh
}

fn textures() -> Textures {
    let (width, height) = ATLAS;
    let rgb = |f: &dyn Fn(usize) -> [f32; 3]| Rgb::new(width, height, (0..width * height).map(f).collect()).unwrap();
    Textures {
        albedo: rgb(&|i| [0.2 + 0.01 * (i % 31) as f32, 0.5, 0.3 + 0.02 * (i % 17) as f32]),
        roughness: Gray::filled(width, height, 0.4),
        metallic: None,
        irradiance: rgb(&|i| [1.0 + 0.02 * (i % 23) as f32; 3]),
        emission: rgb(&|_| [0.0; 3]),
        diffuse: DiffuseModel::Lambert,
        masking: Masking::Smith,
    }
}

fn camera(shift: f32) -> Camera {
    Camera {
        projection: Projection::Equirectangular,
        width: 32,
        height: 16,
        world_from_camera: Mat4::from_translation(Vec3::new(shift, 0.3, -0.2)),
    }
}

/// A training and a novel view whose images and truth are what the renderer shows of `textures`; the top row is masked,
/// a pixel unknown.
fn capture(folder: &Path, scene: &Scene, renderer: &mut Renderer<'_>, textures: &Textures) -> Capture {
    let seen = renderer.mipmapped(textures).unwrap();
    let views = [("a", 0.5, Split::Train), ("b", -0.5, Split::Novel)].map(|(name, shift, split)| {
        let camera = camera(shift);
        let file = |kind: &str| folder.join(format!("{name}_{kind}"));
        let surfaces = renderer.surfaces(&camera, &seen).unwrap();
        let mut image = renderer.render(&camera, &seen, &Silent).unwrap();
        // Nothing is known of a pixel amid the others.
        image.data[32 * 8 + 5] = [f32::NAN; 3];
        write_rgb(file("image.exr"), &image).unwrap();
        write_rgb(file("albedo.exr"), &surfaces.albedo).unwrap();
        write_gray(file("roughness.exr"), &surfaces.roughness).unwrap();
        let mut mask = surfaces.reflective();
        mask.data[..32].fill(false);
        write_png_mask(file("mask.png"), &mask).unwrap();
        View {
            mask: Some(file("mask.png")),
            albedo: Some(file("albedo.exr")),
            roughness: Some(file("roughness.exr")),
            ..View::new(name.to_owned(), camera, split, file("image.exr"))
        }
    });
    let truth = Truth { albedo: folder.join("albedo_tex.exr"), roughness: folder.join("roughness_tex.exr") };
    write_rgb(&truth.albedo, &textures.albedo).unwrap();
    write_gray(&truth.roughness, &textures.roughness).unwrap();
    Capture {
        root: folder.to_owned(),
        mesh_path: folder.join("mesh.obj"),
        mesh: scene.mesh().clone(),
        views: views.to_vec(),
        tbl: None,
        truth: Some(truth),
    }
}

/// Evaluates the true textures after `change`.
fn evaluated(change: impl Fn(&mut Textures)) -> Evaluation {
    evaluated_in(1.0, change)
}

/// [`evaluated`] in a scene that is so many times as bright.
fn evaluated_in(brightness: f32, change: impl Fn(&mut Textures)) -> Evaluation {
    let lit = || {
        let textures = textures();
        Textures { irradiance: textures.irradiance.map(|e| e.map(|e| brightness * e)), ..textures }
    };
    let scene = Arc::new(Scene::new(room()).unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let radiance = lit().irradiance;
    let mut renderer = Renderer::new(&mut backend, &radiance, 96, 3).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let capture = capture(folder.path(), &scene, &mut renderer, &lit());
    let mut result = lit();
    change(&mut result);
    let mut shown = Vec::new();
    let evaluation =
        evaluate(&mut renderer, &capture, &result, &Silent, &mut |view| shown.push(view.view.name.clone())).unwrap();
    assert_eq!(shown, ["a", "b"]);
    evaluation
}

#[test]
fn the_truth_is_perfect_and_so_is_its_ceiling() {
    let evaluation = evaluated(|_| ());
    for table in [evaluation.result, evaluation.true_materials.unwrap()] {
        for scores in [table.train, table.novel] {
            assert!(scores.albedo.unwrap().global.psnr > 100.0, "{scores:?}");
            assert!(scores.roughness.unwrap().psnr > 100.0, "{scores:?}");
            assert!(scores.image.unwrap().psnr > 100.0, "{scores:?}");
            assert!(scores.image.unwrap().ssim > 0.999_999, "{scores:?}");
        }
    }
    let json = serde_json::to_string(&evaluation).unwrap();
    assert_eq!(serde_json::from_str::<Evaluation>(&json).unwrap(), evaluation);
}

#[test]
fn a_wrong_roughness_costs_what_it_is_off_by() {
    let evaluation = evaluated(|t| t.roughness = t.roughness.map(|r| r + 0.1));
    for scores in [evaluation.result.train, evaluation.result.novel] {
        assert!((scores.roughness.unwrap().psnr - 20.0).abs() < 1e-4, "{scores:?}");
        assert!(scores.albedo.unwrap().per_image.psnr > 100.0, "{scores:?}");
        assert!(scores.image.unwrap().psnr < 80.0, "{scores:?}");
    }
    assert!(evaluation.true_materials.unwrap().train.roughness.unwrap().psnr > 100.0);
}

#[test]
fn the_scale_of_albedo_is_free_and_its_shape_is_not() {
    let scaled = evaluated(|t| t.albedo = t.albedo.map(|a| a.map(|c| 0.5 * c)));
    let albedo = scaled.result.train.albedo.unwrap();
    assert!(albedo.per_image.psnr > 100.0 && albedo.global.psnr > 100.0, "{albedo:?}");
    assert!((scaled.result.global_albedo_scale.unwrap() - 2.0).abs() < 1e-5);
    assert!(scaled.result.train.image.unwrap().psnr < 30.0);
    let tinted = evaluated(|t| t.albedo = t.albedo.map(|a| [a[0], 0.5 * a[1], a[2]]));
    assert!(tinted.result.train.albedo.unwrap().per_image.psnr < 30.0);
}

#[test]
fn images_that_would_be_white_or_black_throughout_are_compared_at_another_brightness() {
    let darker = |brightness: f32| {
        let evaluation = evaluated_in(brightness, |t| t.albedo = t.albedo.map(|a| a.map(|c| 0.5 * c)));
        [evaluation.result.train, evaluation.result.novel].map(|scores| scores.image.unwrap().psnr)
    };
    let usual = darker(1.0);
    for brightness in [1e-4, 1e4] {
        for (psnr, usual) in darker(brightness).into_iter().zip(usual) {
            // Where they are brought to is within a factor of two of where they are usually.
            assert!((psnr - usual).abs() < 6.0, "{psnr} dB at a brightness of {brightness}, {usual} usually");
        }
    }
}

#[test]
fn light_sources_and_masked_pixels_do_not_count() {
    let mut backend = CpuBackend::new(Scene::new(room()).unwrap());
    let mut renderer = Renderer::new(&mut backend, &textures().irradiance, 96, 3).unwrap();
    let mut glowing = textures();
    glowing.emission.data[..48 * 8].fill([9.0; 3]);
    let (glowing, dark) = (renderer.mipmapped(&glowing).unwrap(), textures());
    let dark = renderer.mipmapped(&dark).unwrap();
    let surfaces = renderer.surfaces(&camera(0.5), &glowing).unwrap();
    let reflective = surfaces.reflective();
    let counted = reflective.data.iter().filter(|r| **r).count();
    assert!(counted > 0 && counted < 32 * 16, "{counted}");
    let glow = renderer.render(&camera(0.5), &glowing, &Silent).unwrap();
    let plain = renderer.render(&camera(0.5), &dark, &Silent).unwrap();
    let masked = compare(&encoded(&glow), &encoded(&plain), &reflective).unwrap().unwrap();
    let all = compare(&encoded(&glow), &encoded(&plain), &reflective.map(|_| true)).unwrap().unwrap();
    assert!(masked.psnr > all.psnr + 6.0, "{masked:?} {all:?}");
}

#[test]
fn views_that_are_too_small_are_named_before_any_work() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let radiance = textures().irradiance;
    let mut renderer = Renderer::new(&mut backend, &radiance, 96, 3).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut capture = capture(folder.path(), &scene, &mut renderer, &textures());
    assert!(check_sizes(&capture).is_ok());
    (capture.views[1].camera.width, capture.views[1].camera.height) = (7, 7);
    assert!(check_sizes(&capture).is_ok(), "a window is enough");
    capture.views[1].camera.height = 6;
    let shown = &mut |_: &Evaluated<'_>| panic!("work was done");
    let error = evaluate(&mut renderer, &capture, &textures(), &Silent, shown).unwrap_err().to_string();
    for part in ["transforms.json", "1 of 2 views", "\"b\" with 7×6", "7×7", "--no-eval"] {
        assert!(error.contains(part), "{part:?} is not in: {error}");
    }
}
