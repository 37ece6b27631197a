//! Light from far away: rays that leave the scene see the environment, in WGSL as in the twin.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::PI;
use std::sync::Arc;

use glam::Vec3;
use texir_core::backend::{Backend, Gather, Gathered, Material, RoughnessGradient, Sampling, ShadePoint};
use texir_core::cpu::CpuBackend;
use texir_core::cpu::irradiance::irradiance;
use texir_core::cpu::lighting::Lighting;
use texir_core::environment::Environment;
use texir_core::lights::Lights;
use texir_core::progress::Silent;
use texir_core::raster::Rgb;
use texir_core::scene::Scene;
use texir_core::scene::trace::BruteForce;
use texir_core::surface::{Hit, SurfacePoint};
use texir_gpu::GpuBackend;
use texir_tests::compare::{Tolerance, lanes3};
use texir_tests::{gpu, scenes};

/// A ground plane, facing +Y, with or without a lit box on it.
fn ground(with_box: bool) -> Arc<Scene> {
    let mut builder = scenes::Builder::default();
    let corner = |x: f32, z: f32| Vec3::new(4.0 * x, 0.0, 4.0 * z);
    builder.quad([corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)], [Vec3::Y; 4]);
    if with_box {
        builder.cuboid(Vec3::new(0.3, 0.01, -0.5), Vec3::new(1.0, 1.5, 0.7), false);
    }
    let mut mesh = builder.finish();
    mesh.flat_normals();
    Arc::new(Scene::new(mesh).unwrap())
}

/// Points on the ground.
fn points(scene: &Scene) -> Vec<SurfacePoint> {
    let at = |i: u32| Hit { triangle: i % 2, u: 0.1 + 0.01 * i as f32, v: 0.55 - 0.012 * i as f32, t: 0.0 };
    (0..40).map(|i| SurfacePoint { index: i, ..SurfacePoint::new(scene.mesh(), &at(i), None) }).collect()
}

/// A sky that brightens towards the zenith and towards one side, with a window of other light in it.
fn sky() -> Environment {
    let (width, height) = (64, 32);
    let pixel = |i: usize| {
        let (u, v) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        let scale = if (10..13).contains(&(i % width)) && (5..8).contains(&(i / width)) { 30.0 } else { 1.0 };
        [3.0 - 2.0 * v, 1.0 + 0.8 * (6.3 * u).sin(), 0.2 + u].map(|l| scale * l)
    };
    Environment::new(Rgb::new(width, height, (0..width * height).map(pixel).collect()).unwrap()).unwrap()
}

#[test]
fn an_open_plane_under_a_constant_sky_receives_pi_l() {
    let scene = ground(false);
    let points = points(&scene);
    let sky = [2.0, 1.0, 0.25];
    let expected: Vec<f64> = points.iter().flat_map(|_| sky.map(|l| PI * f64::from(l))).collect();
    let rounding = Tolerance { absolute: 0.0, relative: 2e-6 };
    let gpu = gpu();
    let backends: [Box<dyn Backend>; 2] =
        [Box::new(GpuBackend::new(&gpu, scene.clone()).unwrap()), Box::new(CpuBackend::new(scene.clone()))];
    for mut backend in backends {
        backend.set_tbl(&Rgb::filled(2, 2, [9.0; 3]), &Lights::none(scene.mesh())).unwrap();
        backend.set_environment(Some(&Environment::constant(sky).unwrap())).unwrap();
        let gather = Gather::new(37, 8, 1);
        let lit = backend.irradiance(&points, gather, &Silent).unwrap();
        rounding.check(&backend.name(), &lanes3(lit.iter().map(|g| &g.irradiance)), &expected);
        assert!(lit.iter().all(|g| g.back_faces == 0.0));
        // Negative control: without it the sky is black.
        backend.set_environment(None).unwrap();
        let dark = backend.irradiance(&points, gather, &Silent).unwrap();
        assert!(dark.iter().all(|g| g.irradiance == [0.0; 3]));
    }
}

#[test]
fn sky_and_lit_surfaces_add_up_as_in_the_twin() {
    let scene = ground(true);
    let points = points(&scene);
    let (mut radiance, sky) = (scenes::smooth_light(192), sky());
    // The box's side towards −X is a lamp: the second of the charts, which are 16 texels wide.
    for y in 0..16 {
        radiance.data[y * 192 + 16..y * 192 + 32].iter_mut().flatten().for_each(|v| *v *= 20.0);
    }
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let lights = scenes::lights(&mut backend, &radiance);
    assert!(!lights.is_empty() && !sky.bright().is_empty());
    backend.set_tbl(&radiance, &lights).unwrap();
    backend.set_environment(Some(&sky)).unwrap();
    let gather = Gather::new(64, 32, 5);
    let got = backend.irradiance(&points, gather, &Silent).unwrap();
    let exact = BruteForce(scene.mesh());
    let twin = |environment| -> Vec<f64> {
        let lighting = Lighting { tracer: &exact, radiance: &radiance, environment };
        let at = |p| irradiance::<f64, _>(&lighting, &lights, p, gather).irradiance;
        points.iter().flat_map(at).map(f64::from).collect()
    };
    // A ray in a thousand falls into the neighbouring texel or pixel.
    let traced = Tolerance { absolute: 0.0, relative: 2e-3 };
    let got = lanes3(got.iter().map(|g| &g.irradiance));
    traced.check("E", &got, &twin(Some(&sky)));
    // Negative control: a sky turned by half a turn is told apart.
    let mut turned = sky.radiance().clone();
    turned.data.chunks_exact_mut(64).for_each(|row| row.rotate_left(32));
    assert!(traced.failures(&got, &twin(Some(&Environment::new(turned).unwrap()))).len() > got.len() / 2);
}

#[test]
fn a_small_sun_is_found_by_few_rays() {
    // Four pixels of half a degree in a dim sky: one cosine ray in five thousand meets them.
    let (width, height) = (720, 360);
    let (dim, sun) = (0.1f32, 2e5f32);
    let mut radiance = Rgb::filled(width, height, [dim; 3]);
    for (x, y) in [(500, 100), (501, 100), (500, 101), (501, 101)] {
        radiance.data[y * width + x] = [sun; 3];
    }
    let sky = Environment::new(radiance).unwrap();
    let azimuth = 2.0 * PI / width as f64;
    let towards = |row: f64| (row * PI / height as f64).cos();
    // ∫ cosθ dω over the sun, θ from the plane's normal +Y.
    let form = azimuth * (towards(100.0).powi(2) - towards(102.0).powi(2));
    let expected = PI * f64::from(dim) + f64::from(sun - dim) * form;
    let gpu = gpu();
    let off = |lit: &[Gathered]| -> Vec<f64> {
        lit.iter().map(|g| (f64::from(g.irradiance[0]) / expected - 1.0).abs()).collect()
    };
    let scene = ground(false);
    let points = points(&scene);
    let backends: [Box<dyn Backend>; 2] =
        [Box::new(GpuBackend::new(&gpu, scene.clone()).unwrap()), Box::new(CpuBackend::new(scene.clone()))];
    for mut backend in backends {
        backend.set_tbl(&Rgb::filled(2, 2, [9.0; 3]), &Lights::none(scene.mesh())).unwrap();
        backend.set_environment(Some(&sky)).unwrap();
        let gather = Gather::new(16, 16, 4);
        let lit = backend.irradiance(&points, gather, &Silent).unwrap();
        assert!(off(&lit).iter().all(|off| *off < 5e-3), "{}: {:?}", backend.name(), off(&lit));
        // Negative control: cosine samples alone miss the sun, or meet it far too often.
        let alone = Gather { cosine: 32, light: 0, ..gather };
        let lit = backend.irradiance(&points, alone, &Silent).unwrap();
        assert!(off(&lit).iter().filter(|off| **off > 0.5).count() > points.len() / 2);
    }
}

#[test]
fn a_mirror_shows_the_sky() {
    let scene = ground(false);
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    backend.set_tbl(&Rgb::filled(2, 2, [0.0; 3]), &Lights::none(scene.mesh())).unwrap();
    backend.set_environment(Some(&Environment::constant([3.0, 2.0, 1.0]).unwrap())).unwrap();
    let pixels: Vec<ShadePoint> = (points(&scene).iter())
        .map(|p| ShadePoint { position: p.position, index: 0, normal: p.normal, view: p.normal, irradiance: [0.0; 3] })
        .collect();
    let mirrors = vec![Material { metallic: 1.0, ..Material::dielectric([1.0; 3], 0.01) }; pixels.len()];
    let sampling = Sampling { samples: 8, seed: 3 };
    let shaded = backend.shade(&pixels, &mirrors, sampling, RoughnessGradient::Exact, &Silent).unwrap();
    let expected: Vec<f64> = pixels.iter().flat_map(|_| [3.0, 2.0, 1.0]).collect();
    let narrow = Tolerance { absolute: 0.0, relative: 2e-3 };
    narrow.check("mirror", &lanes3(shaded.iter().map(|s| &s.radiance)), &expected);
}
