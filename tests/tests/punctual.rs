//! Punctual lights against their definitions, and WGSL against its twin.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use glam::{DVec3, Vec3};
use texir_core::backend::Backend;
use texir_core::cpu::CpuBackend;
use texir_core::cpu::punctual::punctual;
use texir_core::progress::Silent;
use texir_core::punctual::PunctualLight;
use texir_core::scene::trace::BruteForce;
use texir_core::scene::{Scene, TriangleOpacity};
use texir_core::surface::{Hit, SurfacePoint};
use texir_gpu::{BvhStorage, GpuBackend};
use texir_tests::compare::{Tolerance, lanes3};
use texir_tests::{gpu, scenes};

const ROUNDING: Tolerance = Tolerance { absolute: 1e-6, relative: 1e-5 };

/// A ground plane at y = 0, with a box hovering over a part of it.
fn scene() -> Arc<Scene> {
    let mut builder = scenes::Builder::default();
    let corner = |x: f32, z: f32| Vec3::new(4.0 * x, 0.0, 4.0 * z);
    builder.quad([corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)], [Vec3::Y; 4]);
    builder.cuboid(Vec3::new(1.0, 0.5, -3.0), Vec3::new(3.0, 0.7, 3.0), false);
    Arc::new(Scene::new(builder.finish()).unwrap())
}

/// Points all over the ground; the second triangle lies towards +X.
fn points(scene: &Scene) -> Vec<SurfacePoint> {
    let at = |i: u32| {
        let [u, v] = texir_core::rng::sobol2(i, 7);
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        SurfacePoint::new(scene.mesh(), &Hit { triangle: i % 2, u, v, t: 0.0 }, None)
    };
    (0..400).map(at).collect()
}

/// Irradiance at a place on the open ground.
type Law = fn(DVec3) -> f64;

/// What each light alone gives on the open ground (x < 0, which no box shades), by its definition.
fn lights() -> Vec<(PunctualLight, Law)> {
    const ABOVE: DVec3 = DVec3::new(-2.0, 3.0, 0.5);
    // I cosθ/d² with cosθ = h/d.
    fn open(p: DVec3) -> f64 {
        let way = ABOVE - p;
        100.0 * way.y / way.length().powi(3)
    }
    fn ranged(p: DVec3) -> f64 {
        let d = (ABOVE - p).length();
        open(p) * (1.0 - (d / 4.0).powi(4)).clamp(0.0, 1.0)
    }
    fn cone(p: DVec3) -> f64 {
        let cosine = (ABOVE - p).y / (ABOVE - p).length();
        open(p) * ((cosine - 0.6f64.cos()) / (0.3f64.cos() - 0.6f64.cos())).clamp(0.0, 1.0).powi(2)
    }
    fn sun(_: DVec3) -> f64 {
        100.0 * 0.8
    }
    let (position, intensity) = (ABOVE.as_vec3().to_array(), [100.0; 3]);
    let spot = PunctualLight::Spot {
        position,
        direction: [0.0, -1.0, 0.0],
        intensity,
        range: None,
        inner_cone_angle: 0.3,
        outer_cone_angle: 0.6,
    };
    vec![
        (PunctualLight::Point { position, intensity, range: None }, open),
        (PunctualLight::Point { position, intensity, range: Some(4.0) }, ranged),
        (spot, cone),
        (PunctualLight::Distant { direction: [0.6, -0.8, 0.0], irradiance: intensity }, sun),
    ]
}

#[test]
fn lights_follow_their_definitions() {
    let scene = scene();
    let points: Vec<SurfacePoint> = points(&scene).into_iter().filter(|p| p.position[0] < 0.0).collect();
    let gpu = gpu();
    let backends: [Box<dyn Backend>; 2] =
        [Box::new(GpuBackend::new(&gpu, scene.clone()).unwrap()), Box::new(CpuBackend::new(scene.clone()))];
    for mut backend in backends {
        for (light, law) in lights() {
            let got = lanes3(&backend.punctual(&points, &[light], &Silent).unwrap());
            let place = |p: &SurfacePoint| Vec3::from(p.position).as_dvec3();
            let expected: Vec<f64> = points.iter().flat_map(|p| [law(place(p)); 3]).collect();
            assert!(expected.iter().any(|e| *e > 0.0));
            // A cone's rim divides by a small difference of cosines.
            let tolerance = Tolerance { absolute: 1e-4, relative: 1e-4 };
            tolerance.check(&format!("{light:?}"), &got, &expected);
        }
    }
}

#[test]
fn shadows_and_sums_are_those_of_the_twin() {
    let scene = scene();
    let points = points(&scene);
    let lights: Vec<PunctualLight> = lights().into_iter().map(|(light, _)| light).collect();
    let exact = BruteForce(scene.mesh());
    let twin = |lights: &[PunctualLight]| -> Vec<f64> {
        let at = |p| {
            lights
                .iter()
                .map(|l| punctual::<f64>(&exact, &l.coefficients(), p).0)
                .fold([0.0; 3], |sum: [f64; 3], e| [sum[0] + e[0], sum[1] + e[1], sum[2] + e[2]])
        };
        points.iter().flat_map(at).collect()
    };
    let expected = twin(&lights);
    let sun = twin(&lights[3..]);
    let shaded = sun.iter().filter(|e| **e == 0.0).count();
    assert!(shaded > 100 && shaded < sun.len() - 100, "{shaded} lanes lie in the sun's shadow");
    let got = GpuBackend::new(&gpu(), scene.clone()).unwrap().punctual(&points, &lights, &Silent).unwrap();
    ROUNDING.check("WGSL", &lanes3(&got), &expected);
    let got = CpuBackend::new(scene.clone()).punctual(&points, &lights, &Silent).unwrap();
    ROUNDING.check("CPU", &lanes3(&got), &expected);
    // Negative control: a light that is missing is noticed.
    assert!(ROUNDING.failures(&lanes3(&got), &twin(&lights[1..])).len() > points.len());
}

#[test]
fn translucent_sheets_take_their_share() {
    const OPACITY: f64 = 0.25;
    let mesh = scene().mesh().clone();
    let points = points(&scene());
    // All but the ground is equally translucent, and rays that meet the box go in and out of it.
    let box_of = |opacity: f32| {
        let of_triangle = |triangle: u32| match triangle {
            0 | 1 => TriangleOpacity::Opaque,
            _ => TriangleOpacity::from_coverage(40, triangle, |_| opacity),
        };
        Arc::new(Scene::with_opacity(mesh.clone(), of_triangle).unwrap())
    };
    let light = lights().remove(3).0;
    let e = |backend: &mut dyn Backend| lanes3(&backend.punctual(&points, &[light], &Silent).unwrap());
    let [open, blocked, through] = [0.0, 1.0, OPACITY as f32].map(box_of);
    let (open, blocked) = (e(&mut CpuBackend::new(open)), e(&mut CpuBackend::new(blocked)));
    let share = |lane: usize| if blocked[lane] == 0.0 { (1.0 - OPACITY).powi(2) } else { 1.0 };
    let expected: Vec<f64> = (0..open.len()).map(|lane| open[lane] * share(lane)).collect();
    assert!(expected.iter().zip(&open).filter(|(e, open)| e < open).count() > 100);
    ROUNDING.check("CPU", &e(&mut CpuBackend::new(through.clone())), &expected);
    for place in [BvhStorage::Buffers, BvhStorage::Textures] {
        let mut backend = GpuBackend::with_bvh_storage(&gpu(), through.clone(), place).unwrap();
        ROUNDING.check(&format!("WGSL, {place:?}"), &e(&mut backend), &expected);
    }
    // Negative control: sheets that take nothing, or all.
    assert!(ROUNDING.failures(&open, &expected).len() > 100 && ROUNDING.failures(&blocked, &expected).len() > 100);
}

#[test]
fn no_lights_are_dark() {
    let scene = scene();
    let points = points(&scene);
    let dark = GpuBackend::new(&gpu(), scene.clone()).unwrap().punctual(&points, &[], &Silent).unwrap();
    assert!(dark.len() == points.len() && dark.iter().all(|e| *e == [0.0; 3]));
}
