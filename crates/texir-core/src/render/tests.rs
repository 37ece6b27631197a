//! Rendered views against shading, which draws its samples otherwise.

use glam::{Mat4, Vec2, Vec3};

use super::*;
use crate::backend::{Material, RoughnessGradient, Sampling};
use crate::camera::Projection;
use crate::cpu::CpuBackend;
use crate::mesh::Mesh;
use crate::progress::Silent;
use crate::rng::hash2;
use crate::texture::SparseRows;

const ALBEDO: f32 = 0.5;
const IRRADIANCE: f32 = 0.8;

/// A floor and a ceiling with a bright quarter.
fn scene() -> (Scene, Rgb) {
    let mut mesh = Mesh { positions: vec![], normals: vec![], uvs: vec![], triangles: vec![] };
    for (z, normal, left) in [(0.0, Vec3::Z, 0.0), (2.0, -Vec3::Z, 0.5)] {
        let first = mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(Vec3::new(6.0 * x - 3.0, 6.0 * y - 3.0, z));
            mesh.normals.push(normal);
            mesh.uvs.push(Vec2::new(left + 0.5 * x, y));
        }
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    let bright = |i: usize| if i % 16 >= 12 && i / 16 < 4 { [3.0, 2.0, 1.0] } else { [0.1, 0.2, 0.3] };
    (Scene::new(mesh).unwrap(), Rgb::new(16, 8, (0..16 * 8).map(bright).collect()).unwrap())
}

fn camera() -> Camera {
    Camera {
        projection: Projection::Equirectangular,
        width: 16,
        height: 8,
        world_from_camera: Mat4::from_translation(Vec3::new(0.2, 0.1, 1.0)),
    }
}

/// Mean difference of the two images over the mean of the second.
fn difference(image: &Rgb, other: &Rgb) -> f32 {
    let (a, b) = (image.data.as_flattened(), other.data.as_flattened());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / b.iter().sum::<f32>()
}

fn textures(diffuse: DiffuseModel, roughness: f32) -> Textures {
    let rgb = |value: f32| Rgb::filled(16, 8, [value; 3]);
    Textures {
        albedo: rgb(ALBEDO),
        roughness: Gray::filled(16, 8, roughness),
        metallic: None,
        irradiance: rgb(IRRADIANCE),
        emission: rgb(0.0),
        diffuse,
        // As in shading.
        masking: Masking::Schlick,
    }
}

fn render_each<const N: usize>(renderer: &mut Renderer<'_>, textures: [&Textures; N]) -> [Rgb; N] {
    let textures = textures.map(|textures| renderer.mipmapped(textures).unwrap());
    renderer.render_each(&camera(), textures.each_ref(), &Silent).unwrap()
}

/// The camera's view of the scene that `radiance` lights, made of one `material`, by shading every sub-pixel.
fn shaded(backend: &mut CpuBackend, radiance: &Rgb, material: Material) -> Rgb {
    let scene = backend.scene().clone();
    let atlas = Atlas::new(backend, radiance.size()).unwrap();
    backend.set_tbl(radiance, &Lights::find(&scene, &atlas, radiance).unwrap()).unwrap();
    let fine = camera().supersampled(SUB_PIXELS);
    let hits = backend.primary(&fine, fine.rows()).unwrap();
    let seen: Vec<u32> = (0..fine.pixels() as u32).filter(|&i| hits[i as usize].is_hit()).collect();
    let point = |&i: &u32| ShadePoint::new(scene.mesh(), &fine, i, &hits[i as usize], [IRRADIANCE; 3]);
    let points: Vec<ShadePoint> = seen.iter().map(point).collect();
    let materials = vec![material; points.len()];
    let sampling = Sampling { samples: 1024, seed: 5 };
    let shaded = backend.shade(&points, &materials, sampling, RoughnessGradient::Exact, &Silent).unwrap();
    let mut image = Rgb::filled(16, 8, [0.0; 3]);
    for (&i, shaded) in seen.iter().zip(&shaded) {
        let (x, y) = (i as usize % fine.width / SUB_PIXELS, i as usize / fine.width / SUB_PIXELS);
        let sum = &mut image.data[y * 16 + x];
        *sum = std::array::from_fn(|c| sum[c] + shaded.radiance[c] / (SUB_PIXELS * SUB_PIXELS) as f32);
    }
    image
}

#[test]
fn views_agree_with_shading_of_every_sub_pixel() {
    let (scene, radiance) = scene();
    let roughness = 0.3;
    let mut backend = CpuBackend::new(scene);
    let mut renderer = Renderer::new(&mut backend, &radiance, 1024, 1).unwrap();
    let lambert = textures(DiffuseModel::Lambert, roughness);
    let burley = textures(DiffuseModel::Burley, roughness);
    let smoother = textures(DiffuseModel::Lambert, 0.15);
    let smith = Textures { masking: Masking::Smith, ..lambert.clone() };
    let [rendered, burley, smoother, smith] = render_each(&mut renderer, [&lambert, &burley, &smoother, &smith]);

    let expected = shaded(&mut backend, &radiance, Material::dielectric([ALBEDO; 3], roughness));
    let off = difference(&rendered, &expected);
    assert!(off < 0.01, "{off}");
    // Negative controls: another roughness, another diffuse model and another masking show.
    assert!(difference(&smith, &expected) > 1.5 * off, "{off} {}", difference(&smith, &expected));
    assert!(difference(&smoother, &expected) > 2.0 * off, "{off} {}", difference(&smoother, &expected));
    assert!(difference(&burley, &expected) > 2.0 * off, "{off} {}", difference(&burley, &expected));
}

#[test]
fn metal_mirrors_in_its_own_colour() {
    let (scene, radiance) = scene();
    let mut backend = CpuBackend::new(scene);
    let dielectric = textures(DiffuseModel::Lambert, 0.3);
    for metallic in [1.0, 0.4] {
        let metal = Textures { metallic: Some(Gray::filled(16, 8, metallic)), ..dielectric.clone() };
        let mut renderer = Renderer::new(&mut backend, &radiance, 8192, 1).unwrap();
        let [rendered, plain] = render_each(&mut renderer, [&metal, &dielectric]);
        let material = Material { metallic, ..Material::dielectric([ALBEDO; 3], 0.3) };
        let expected = shaded(&mut backend, &radiance, material);
        let off = difference(&rendered, &expected);
        assert!(off < 0.02, "metallic {metallic}: {off}");
        assert!(difference(&plain, &expected) > 10.0 * off, "metallic {metallic}: {off}");
    }
}

#[test]
fn mipmapped_textures_are_looked_up_as_by_a_backend() {
    let (scene, radiance) = scene();
    let mut backend = CpuBackend::new(scene);
    let scene = backend.scene().clone();
    let random = |i: usize, c: u32| hash2(i as u32, c) as f32 / u32::MAX as f32;
    let rgb = |c: u32| Rgb::new(16, 8, (0..128).map(|i| [0, 1, 2].map(|k| random(i, c + k))).collect()).unwrap();
    let textures = Textures {
        albedo: rgb(0),
        irradiance: rgb(3),
        emission: rgb(6),
        // Of another size than the rest.
        roughness: Gray::new(32, 16, (0..512).map(|i| random(i, 9)).collect()).unwrap(),
        ..textures(DiffuseModel::Lambert, 0.3)
    };
    let mut renderer = Renderer::new(&mut backend, &radiance, 96, 1).unwrap();
    let mipmapped = renderer.mipmapped(&textures).unwrap();
    let [pyramid, finer] = [[16, 8], [32, 16]].map(|size| renderer.pyramid(size).unwrap());
    let hits = backend.primary(&camera(), camera().rows()).unwrap();
    let seen: Vec<u32> = (0..camera().pixels() as u32).filter(|&i| hits[i as usize].is_hit()).collect();
    let rows = |of| SparseRows::of_pixels(of, scene.mesh(), &camera(), 1, |i| hits[i], &seen);
    // Coarse levels are seen.
    assert!(rows(&pyramid).taps.iter().any(|tap| tap.texel >= 128 + 32));
    let mut look_up = |of, texture: &[f32], channels| backend.lookup(of, texture, channels, &rows(of)).unwrap();
    let albedo = look_up(&pyramid, textures.albedo.data.as_flattened(), 3);
    let irradiance = look_up(&pyramid, textures.irradiance.data.as_flattened(), 3);
    let roughness = look_up(&finer, &textures.roughness.data, 1);
    for (k, &i) in seen.iter().enumerate() {
        let (x, y) = (i as usize % 16, i as usize / 16);
        let seen = mipmapped.at(&Footprint::area(scene.mesh(), &camera(), &hits[i as usize], x, y));
        let expected = [&albedo[3 * k..][..3], &irradiance[3 * k..][..3], &roughness[k..][..1]].concat();
        let found = [&seen.albedo[..], &seen.irradiance, &[seen.roughness]].concat();
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?} {expected:?}");
        // Lamps do not shine from coarse levels into what is beside them.
        let texels = pyramid.bilinear(0, hits[i as usize].uv(scene.mesh()));
        let emission =
            |c: usize| texels.iter().map(|t| t.weight * textures.emission.data[t.texel as usize][c]).sum::<f32>();
        assert!((0..3).all(|c| (seen.emission[c] - emission(c)).abs() < 1e-5));
    }
}

#[test]
fn textures_of_wrong_sizes_or_scenes_are_errors() {
    let (mut backends, radiance) = ([scene().0, scene().0].map(CpuBackend::new), scene().1);
    let [mut renderer, mut other] =
        backends.each_mut().map(|backend| Renderer::new(backend, &radiance, 96, 1).unwrap());
    let good = textures(DiffuseModel::Lambert, 0.3);
    for texels in [127, 129] {
        let torn = |image: &Rgb| Rgb { data: vec![[0.5; 3]; texels], ..image.clone() };
        for wrong in [
            Textures { albedo: torn(&good.albedo), ..good.clone() },
            Textures { emission: torn(&good.emission), ..good.clone() },
        ] {
            let error = renderer.mipmapped(&wrong).err().unwrap().to_string();
            assert!(error.contains(&format!("{texels} texels; expected those of 16 × 8")), "{error}");
        }
    }
    let foreign = other.mipmapped(&good).unwrap();
    let error = renderer.render(&camera(), &foreign, &Silent).unwrap_err().to_string();
    assert!(error.contains("another scene"), "{error}");
    assert!(renderer.surfaces(&camera(), &foreign).is_err());
    assert!(other.surfaces(&camera(), &foreign).is_ok());
}

#[test]
fn bands_have_every_row_once_and_little_in_them() {
    for (rows, items) in [(7, CHUNK / 3), (5, 2 * CHUNK), (1, 1), (1000, 4096), (3, 0)] {
        let bands: Vec<Range<usize>> = bands(items, rows, CHUNK).collect();
        assert!(bands.iter().cloned().flatten().eq(0..rows), "{bands:?}");
        assert!(bands.iter().all(|band| band.len() == 1 || band.len() * items <= CHUNK), "{bands:?}");
    }
}

#[test]
fn what_emits_adds_its_radiance_once() {
    let (scene, radiance) = scene();
    let dark = Rgb::filled(radiance.width, radiance.height, [0.0; 3]);
    let mut backend = CpuBackend::new(scene);
    let hits = backend.primary(&camera(), camera().rows()).unwrap();
    let mut renderer = Renderer::new(&mut backend, &dark, 96, 1).unwrap();
    let plain = textures(DiffuseModel::Lambert, 0.3);
    let shines = Textures { emission: Rgb::filled(16, 8, [2.0, 1.0, 0.5]), ..plain.clone() };
    let [image, plain] = render_each(&mut renderer, [&shines, &plain]);
    let middle = hits.iter().position(|hit| hit.is_hit()).unwrap();
    for (c, emitted) in [2.0, 1.0, 0.5].into_iter().enumerate() {
        let added = image.data[middle][c] - plain.data[middle][c];
        assert!((added - emitted).abs() < 1e-5, "{added} of {emitted}");
        // a E/π alone, and nothing that shines to be mirrored.
        let reflected = ALBEDO * IRRADIANCE * std::f32::consts::FRAC_1_PI;
        assert!((plain.data[middle][c] - reflected).abs() < 1e-5, "{}", plain.data[middle][c]);
    }
}

#[test]
fn light_may_be_in_any_unit() {
    let (scene, radiance) = scene();
    let mut backend = CpuBackend::new(scene);
    let mut rendered = |factor: f32| {
        let scaled = |map: &Rgb| map.map(|v| v.map(|v| v * factor));
        let plain = textures(DiffuseModel::Lambert, 0.15);
        let textures = Textures { irradiance: scaled(&plain.irradiance), ..plain };
        let mut renderer = Renderer::new(&mut backend, &scaled(&radiance), 96, 1).unwrap();
        let [image] = render_each(&mut renderer, [&textures]);
        image.map(|v| v.map(|v| v / factor))
    };
    let usual = rendered(1.0);
    for exponent in [-40, -20, 20, 40] {
        let off = difference(&rendered(f32::powi(2.0, exponent)), &usual);
        assert!(off < 1e-4, "{off} in a unit of 2^-{exponent}");
    }
}

#[test]
fn lighting_without_its_pixels_is_refused() {
    let (scene, radiance) = scene();
    let short = Rgb { data: radiance.data[1..].to_vec(), ..radiance };
    let error = Renderer::new(&mut CpuBackend::new(scene), &short, 96, 1).err().unwrap().to_string();
    assert!(error.contains("expected one for each of its"), "{error}");
}

#[test]
fn cameras_that_scale_are_refused() {
    let (scene, radiance) = scene();
    let mut backend = CpuBackend::new(scene);
    let pose = camera().world_from_camera * Mat4::from_scale(Vec3::splat(2.0));
    let scaled = Camera { world_from_camera: pose, ..camera() };
    let refused = |error: Option<Error>| error.is_some_and(|e| e.to_string().contains("is not rigid"));
    assert!(refused(backend.primary(&scaled, scaled.rows()).err()));
    assert!(refused(backend.project(&[], &scaled).err()));
    let mut renderer = Renderer::new(&mut backend, &radiance, 96, 1).unwrap();
    let textures = textures(DiffuseModel::Lambert, 0.2);
    let textures = renderer.mipmapped(&textures).unwrap();
    assert!(refused(renderer.surfaces(&scaled, &textures).err()));
    assert!(refused(renderer.render(&scaled, &textures, &Silent).err()));
    let empty = Camera { height: 0, ..camera() };
    assert!(renderer.surfaces(&empty, &textures).is_err_and(|e| e.to_string().contains("16×0 pixels")));
}
