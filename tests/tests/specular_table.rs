//! Specular tables: the twin against quadrature and against shading, the WGSL against the twin.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::Vec3;
use texir_core::backend::{Backend, RoughnessGradient, Sampling, ShadePoint};
use texir_core::brdf::Masking;
use texir_core::cpu::CpuBackend;
use texir_core::cpu::lighting::Lighting;
use texir_core::cpu::shade::{MaterialIn, shade};
use texir_core::cpu::specular_table::specular_table;
use texir_core::lights::Lights;
use texir_core::mesh::Mesh;
use texir_core::progress::Silent;
use texir_core::raster::Rgb;
use texir_core::real::V3;
use texir_core::scene::Scene;
use texir_core::scene::trace::BruteForce;
use texir_core::specular_table::{Curve, NODES, STRATA, TableSampling, node};
use texir_gpu::GpuBackend;
use texir_tests::compare::Tolerance;
use texir_tests::{gpu, scenes};

/// F0 of a dielectric, and of a white metal.
const DIELECTRIC: f32 = 0.04;
const WHITE: f32 = 1.0;

/// A closed box of 2 × 2 × 1 m and a lamp of 10 × 10 cm below its ceiling, the last two triangles.
fn box_with_lamp() -> Mesh {
    let mut b = scenes::Builder::default();
    b.cuboid(Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 1.0), true);
    let corner = |x: f32, y: f32| Vec3::new(0.35 + x, 0.1 + y, 0.9);
    b.quad([corner(0.0, 0.0), corner(0.0, 0.1), corner(0.1, 0.1), corner(0.1, 0.0)], [-Vec3::Z; 4]);
    b.finish()
}

/// The lamp's two triangles, drawn with equal probability.
fn lamp(mesh: &Mesh) -> Lights {
    let first = mesh.triangles.len() - 2;
    let luminance: Vec<f32> = (0..mesh.triangles.len()).map(|t| f32::from(u8::from(t >= first))).collect();
    Lights::by_power(mesh, &luminance)
}

/// Radiance 0.1 everywhere but on the lamp, whose chart is the seventh of the atlas's first row of twelve.
fn lamp_light() -> Rgb {
    let mut light = Rgb::filled(48, 48, [0.1; 3]);
    for y in 0..4 {
        light.data[y * 48 + 24..y * 48 + 28].fill([50.0, 30.0, 10.0]);
    }
    light
}

/// A pixel of the floor: its strata lie within a few millimetres.
fn floor_pixel(view: Vec3, index: u32) -> [ShadePoint; STRATA] {
    std::array::from_fn(|stratum| ShadePoint {
        position: [0.003 * (stratum % 2) as f32, 0.003 * (stratum / 2) as f32, 1e-4],
        index: index + stratum as u32,
        normal: [0.0, 0.0, 1.0],
        view: view.normalize().to_array(),
        irradiance: [0.0; 3],
    })
}

fn from_above(nv: f32) -> Vec3 {
    Vec3::new(-(1.0 - nv * nv).sqrt(), 0.0, nv)
}

/// ∫ f_s nl dω at normal-incidence reflectance `f0` by the midpoint rule around the mirrored view, whose polar angle is
/// πs⁴: rings crowd where the lobe is sharp. Written out from the BRDF's definition, apart from the library.
fn albedo(masking: Masking, nv: f64, r: f64, f0: f64) -> f64 {
    const RINGS: usize = 1500;
    const SECTORS: usize = 256;
    let sv = (1.0 - nv * nv).sqrt();
    let (a2, k) = (r.powi(4), (r + 1.0).powi(2) / 8.0);
    let g1 = |c: f64| match masking {
        Masking::Schlick => c / (c * (1.0 - k) + k),
        // 2 / (1 + √(1 + α² tan²θ)).
        Masking::Smith => 2.0 / (1.0 + (1.0 + a2 * (1.0 - c * c) / (c * c)).sqrt()),
    };
    let mut sum = 0.0;
    for ring in 0..RINGS {
        let s = (ring as f64 + 0.5) / RINGS as f64;
        let theta = PI * s.powi(4);
        let cell = 4.0 * PI * s.powi(3) / RINGS as f64 * theta.sin() * TAU / SECTORS as f64;
        for sector in 0..SECTORS {
            let phi = TAU * (sector as f64 + 0.5) / SECTORS as f64;
            // The view is (−sv, 0, nv), the mirrored one (sv, 0, nv), and (nv, 0, −sv) across it.
            let (x, y, z) = (theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
            let l = [sv * z + nv * x, y, nv * z - sv * x];
            if l[2] <= 0.0 {
                continue;
            }
            let h = [l[0] - sv, l[1], l[2] + nv];
            let length = (h[0] * h[0] + h[1] * h[1] + h[2] * h[2]).sqrt();
            let vh = (h[2] * nv - h[0] * sv) / length;
            let sin2 = (h[0] * h[0] + h[1] * h[1]) / (length * length);
            let d = a2 / (PI * (a2 + sin2 * (1.0 - a2)).powi(2));
            let f = f0 + (1.0 - f0) * 2f64.powf((-5.55472 * vh - 6.98316) * vh);
            sum += cell * d * f * g1(l[2]) * g1(nv) / (4.0 * nv);
        }
    }
    sum
}

fn red(table: [V3<f64>; NODES]) -> Vec<f64> {
    table.iter().map(|n| n.0[0]).collect()
}

#[test]
fn in_a_furnace_every_node_is_the_albedo_of_its_lobe() {
    let mesh = box_with_lamp();
    let (one, exact) = (Rgb::filled(4, 4, [1.0; 3]), BruteForce(&mesh));
    let lighting = Lighting { tracer: &exact, radiance: &one, environment: None };
    let noise = Tolerance { absolute: 0.0, relative: 0.01 };
    for nv in [0.3, 0.5, 0.8, 1.0] {
        let pixel = floor_pixel(from_above(nv), 5);
        for (masking, f0, cosine, light, lights) in [
            (Masking::Schlick, DIELECTRIC, 256, 0, Lights::none(&mesh)),
            (Masking::Schlick, DIELECTRIC, 64, 64, lamp(&mesh)),
            (Masking::Smith, DIELECTRIC, 64, 64, lamp(&mesh)),
            (Masking::Smith, WHITE, 64, 64, lamp(&mesh)),
        ] {
            let of_node = |k| albedo(masking, f64::from(nv), f64::from(node(k)), f64::from(f0));
            let expected: Vec<f64> = (0..NODES).map(of_node).collect();
            let sampling = TableSampling { lobe: 256, cosine, light, masking, seed: 1 };
            let got = red(specular_table(&lighting, &lights, &pixel, f0, sampling));
            noise.check(&format!("albedo at nv {nv}"), &got, &expected);
            // Negative control: the lobe of a node further on is another one.
            assert!(noise.failures(&got[6..], &expected[..NODES - 6]).len() > NODES / 4);
        }
    }
}

#[test]
fn a_small_lamp_shines_as_in_shading_at_every_node() {
    let mesh = box_with_lamp();
    let (light, exact) = (lamp_light(), BruteForce(&mesh));
    let lighting = Lighting { tracer: &exact, radiance: &light, environment: None };
    // Mirrors the lamp, so that sharp lobes see it.
    let pixel = floor_pixel(Vec3::new(-0.4, -0.15, 0.9), 5);
    let ks = [4, 10, 16, NODES - 1];
    let expected: Vec<f64> = (ks.iter())
        .map(|&k| {
            let black = MaterialIn { albedo: V3::zero(), roughness: f64::from(node(k)), metallic: 0.0 };
            let of = |p: &ShadePoint| {
                let sampling = Sampling { samples: 1 << 17, seed: 2 };
                shade(&lighting, p, &black, sampling, RoughnessGradient::Exact).radiance.0[0]
            };
            pixel.iter().map(of).sum::<f64>() / STRATA as f64
        })
        .collect();
    let noise = Tolerance { absolute: 0.0, relative: 0.03 };
    let table = |lights: &Lights, light| {
        let sampling = TableSampling { lobe: 8192, cosine: 8192, light, masking: Masking::Schlick, seed: 1 };
        let all = red(specular_table(&lighting, lights, &pixel, DIELECTRIC, sampling));
        ks.map(|k| all[k])
    };
    let lights = lamp(&mesh);
    noise.check("without light samples", &table(&Lights::none(&mesh), 0), &expected);
    noise.check("with light samples", &table(&lights, 256), &expected);
    // Negative control: light samples whose density is left out of the sum are too bright.
    let mut uncounted = lights;
    uncounted.parts.iter_mut().for_each(|light| light.pdf_area = 0.0);
    assert!(noise.failures(&table(&uncounted, 256), &expected).len() >= 2);
}

/// The furnished room, flat: about an interpolated normal, some rays enter the surface that they start on.
fn room() -> Arc<Scene> {
    let mut mesh = scenes::furnished_room();
    mesh.flat_normals();
    Arc::new(Scene::new(mesh).unwrap())
}

/// Pixels of a panorama of the room, each of 2 × 2 strata.
fn pixels(backend: &mut dyn Backend, step: usize) -> Vec<[ShadePoint; STRATA]> {
    let camera = scenes::cameras()[0].supersampled(2);
    let hits = backend.primary(&camera, camera.rows()).unwrap();
    let scene = backend.scene();
    let point = |pixel: usize| ShadePoint::new(scene.mesh(), &camera, pixel as u32, &hits[pixel], [0.0; 3]);
    (0..hits.len() / STRATA)
        .step_by(step)
        .map(|i| {
            let (x, y) = (2 * i % camera.width, 2 * (2 * i / camera.width));
            std::array::from_fn(|k| point((y + k / 2) * camera.width + x + k % 2))
        })
        .collect()
}

fn flat(curves: &[Curve]) -> Vec<f64> {
    curves.iter().flat_map(|c| c.nodes).flatten().map(|c| f64::from(c.to_f32())).collect()
}

/// Half floats, and a ray within rounding of an edge or a texel's border sees another texel.
const HALF: Tolerance = Tolerance { absolute: 1e-3, relative: 3e-3 };

#[test]
fn wgsl_and_twin_agree() {
    let scene = room();
    let radiance = scenes::smooth_light(192);
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let lights = scenes::lights(&mut backend, &radiance);
    assert!(!lights.is_empty());
    let pixels = pixels(&mut backend, 41);
    let exact = BruteForce(scene.mesh());
    let lighting = Lighting { tracer: &exact, radiance: &radiance, environment: None };
    for lights in [lights, Lights::none(scene.mesh())] {
        backend.set_tbl(&radiance, &lights).unwrap();
        for (masking, f0, lobe, cosine, light) in [
            (Masking::Smith, DIELECTRIC, 2, 2, 6),
            (Masking::Schlick, WHITE, 1, 0, 3),
            (Masking::Schlick, DIELECTRIC, 0, 3, 0),
            (Masking::Smith, WHITE, 3, 5, 7),
        ] {
            let sampling = TableSampling { lobe, cosine, light, masking, seed: 11 };
            let got = flat(&backend.specular_tables(&pixels, f0, sampling, &Silent).unwrap());
            let twin = |p| specular_table::<f64, _>(&lighting, &lights, p, f0, sampling);
            let expected: Vec<f64> = pixels.iter().flat_map(twin).flat_map(|n| n.0).collect();
            HALF.check(&format!("tables at {f0} by {sampling:?}"), &got, &expected);
            // Negative control: another seed draws other samples.
            let other = backend.specular_tables(&pixels, f0, TableSampling { seed: 12, ..sampling }, &Silent).unwrap();
            assert!(HALF.failures(&flat(&other), &expected).len() > pixels.len());
        }
        let none = TableSampling { lobe: 0, cosine: 0, light: 0, masking: Masking::Smith, seed: 11 };
        assert!(flat(&backend.specular_tables(&pixels, DIELECTRIC, none, &Silent).unwrap()).iter().all(|&c| c == 0.0));
    }
}

#[test]
fn lights_in_several_leaves_of_the_hierarchy_are_reflected_in_full() {
    let (mesh, radiance) = scenes::room_with_strip(192);
    let scene = Arc::new(Scene::new(mesh).unwrap());
    assert!(scene.primitives().len() > scene.mesh().triangles.len(), "no triangle is in two leaves");
    let mut cpu = CpuBackend::new(scene.clone());
    let mut gpu = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let lights = scenes::lights(&mut cpu, &radiance);
    let pixels = pixels(&mut cpu, 61);
    let sampling = TableSampling { lobe: 1, cosine: 1, light: 14, masking: Masking::Smith, seed: 4 };
    let found = [&mut cpu as &mut dyn Backend, &mut gpu].map(|backend| {
        backend.set_tbl(&radiance, &lights).unwrap();
        flat(&backend.specular_tables(&pixels, DIELECTRIC, sampling, &Silent).unwrap())
    });
    HALF.check("tables beneath the strip", &found[1], &found[0]);
}

#[test]
fn how_work_is_cut_changes_nothing() {
    let scene = room();
    let radiance = scenes::smooth_light(192);
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let lights = scenes::lights(&mut backend, &radiance);
    backend.set_tbl(&radiance, &lights).unwrap();
    let pixels = pixels(&mut backend, 7);
    let sampling = TableSampling { lobe: 2, cosine: 2, light: 6, masking: Masking::Smith, seed: 3 };
    let whole = backend.specular_tables(&pixels, DIELECTRIC, sampling, &Silent).unwrap();
    let pieces = pixels.chunks(53).flat_map(|p| backend.specular_tables(p, DIELECTRIC, sampling, &Silent).unwrap());
    assert!(whole == pieces.collect::<Vec<_>>());
    // More samples than one dispatch takes: all of them count.
    let sampling = TableSampling { lobe: 50, cosine: 130, light: 75, masking: Masking::Smith, seed: 3 };
    let mut cpu = CpuBackend::new(scene.clone());
    cpu.set_tbl(&radiance, &lights).unwrap();
    let expected = flat(&cpu.specular_tables(&pixels[..40], DIELECTRIC, sampling, &Silent).unwrap());
    HALF.check(
        "many samples",
        &flat(&backend.specular_tables(&pixels[..40], DIELECTRIC, sampling, &Silent).unwrap()),
        &expected,
    );
}
