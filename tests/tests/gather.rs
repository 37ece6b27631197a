//! What must not change a gathered sum: the shape of the kernel, how work is cut, and whether a closed room of one
//! radiance is looked at from here or there. And what must stop one.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Vec2, Vec3};
use texir_core::backend::{
    Backend, Gather, Gathered, GroupTarget, Groups, Material, RoughnessGradient, Sampling, Sequences, ShadePoint,
};
use texir_core::brdf::{Masking, fresnel_weight, g_schlick};
use texir_core::cpu::CpuBackend;
use texir_core::error::Error;
use texir_core::lights::{Cut, LightPart, Lights};
use texir_core::progress::{Progress, Silent};
use texir_core::raster::Rgb;
use texir_core::rng::{hash, sobol2};
use texir_core::scene::{Scene, TriangleOpacity};
use texir_core::specular_table::{STRATA, TableSampling};
use texir_core::surface::{Hit, SurfacePoint};
use texir_core::texture::{Pyramid, SparseRows, Tap};
use texir_gpu::{BvhStorage, GatherShape, Gpu, GpuBackend};
use texir_tests::compare::{Tolerance, lanes3};
use texir_tests::{gpu, scenes};

/// Sums of some thousand numbers in another order.
const ROUNDING: Tolerance = Tolerance { absolute: 0.0, relative: 2e-5 };
/// The same by another traversal, which differs in a few of thousands of hits at the edges of texels.
const TRACED: Tolerance = Tolerance { absolute: 0.0, relative: 2e-4 };
/// The same, in half floats.
const HALF: Tolerance = Tolerance { absolute: 1e-3, relative: 3e-3 };

fn room() -> Arc<Scene> {
    let mut mesh = scenes::furnished_room();
    mesh.flat_normals();
    Arc::new(Scene::new(mesh).unwrap())
}

fn points(scene: &Scene, count: u32) -> Vec<SurfacePoint> {
    (0..count)
        .map(|i| {
            let triangle = hash(i) % scene.mesh().triangles.len() as u32;
            let [u, v] = sobol2(i, 9).map(|x| 0.05 + 0.45 * x);
            let point = SurfacePoint::new(scene.mesh(), &Hit { triangle, u, v, t: 0.0 }, None);
            SurfacePoint { index: i, ..point }
        })
        .collect()
}

/// What rays meet where some triangles are not there for them.
fn transparent(is_transparent: impl Fn(u32) -> bool) -> impl Fn(u32) -> TriangleOpacity {
    move |triangle| if is_transparent(triangle) { TriangleOpacity::Transparent } else { TriangleOpacity::Opaque }
}

/// Lights a backend by [`scenes::smooth_light`].
fn light(backend: &mut dyn Backend) {
    let radiance = scenes::smooth_light(192);
    let lights = scenes::lights(backend, &radiance);
    assert!(!lights.is_empty());
    backend.set_tbl(&radiance, &lights).unwrap();
}

fn lit(gpu: &Gpu, scene: &Arc<Scene>) -> GpuBackend {
    let mut backend = GpuBackend::new(gpu, scene.clone()).unwrap();
    light(&mut backend);
    backend
}

/// Irradiance and share of back faces as lanes.
fn flat(gathered: &[Gathered]) -> Vec<f64> {
    gathered
        .iter()
        .flat_map(|g| [g.irradiance[0], g.irradiance[1], g.irradiance[2], g.back_faces])
        .map(f64::from)
        .collect()
}

fn shading(points: &[SurfacePoint]) -> (Vec<ShadePoint>, Vec<Material>) {
    let pixel = |(i, p): (usize, &SurfacePoint)| {
        let n = Vec3::from(p.normal);
        let view = (n + 0.7 * n.any_orthonormal_vector()).normalize();
        let point = ShadePoint {
            position: p.position,
            index: i as u32,
            normal: p.normal,
            view: view.to_array(),
            irradiance: [1.0, 2.0, 3.0],
        };
        (point, Material::dielectric([0.5, 0.4, 0.3], 0.05 + 0.1 * (i % 9) as f32))
    };
    points.iter().enumerate().map(pixel).unzip()
}

#[test]
fn many_samples_give_the_same_sum_in_every_shape() {
    // Software drivers end a thread after 65,535 loop iterations without a word: shapes that put many rays into one
    // thread would come out darker, and the host must not let that happen.
    let scene = room();
    let mut backend = lit(&gpu(), &scene);
    let mut cpu = CpuBackend::new(scene.clone());
    light(&mut cpu);
    let points = points(&scene, 4);
    for (samples, shapes) in [(2048, vec![(1, 64)]), (4096, vec![(64, 64), (8, 64)]), (8192, vec![(64, 32), (32, 27)])]
    {
        let gather = Gather::new(samples, samples / 2, 2);
        let expected = flat(&cpu.irradiance(&points, gather, &Silent).unwrap());
        for (threads_per_item, rays_per_thread) in shapes {
            backend.set_gather_shape(Some(GatherShape { threads_per_item, rays_per_thread })).unwrap();
            let got = flat(&backend.irradiance(&points, gather, &Silent).unwrap());
            TRACED.check(
                &format!("{samples} samples, {threads_per_item} threads of {rays_per_thread}"),
                &got,
                &expected,
            );
        }
        // Negative control: a hundredth of the samples lost would be noticed.
        let darker: Vec<f64> = expected.iter().map(|e| 0.99 * e).collect();
        assert!(TRACED.failures(&darker, &expected).len() >= 3 * points.len());
    }
}

#[test]
fn light_passes_through_panes_as_if_they_were_not_there() {
    /// Where the pane's triangles are among the others: numbers after it differ between mesh and hierarchy.
    const PLACE: usize = 5;
    let bare = room();
    let with = |is_pane: bool| {
        let mut mesh = bare.mesh().clone();
        let first = mesh.positions.len() as u32;
        // Below the ceiling, from wall to wall but for a gap, in the last chart, which is free.
        mesh.positions.extend([(0.1, 0.1), (0.1, 2.9), (3.9, 2.9), (3.9, 0.1)].map(|(x, y)| Vec3::new(x, y, 2.1)));
        mesh.normals.extend([-Vec3::Z; 4]);
        mesh.uvs.extend([(0.93, 0.93), (0.99, 0.93), (0.99, 0.99), (0.93, 0.99)].map(Vec2::from));
        let pane = [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|corner| first + corner));
        mesh.triangles.splice(PLACE..PLACE, pane);
        Scene::with_opacity(mesh, transparent(|t| is_pane && (PLACE as u32..PLACE as u32 + 2).contains(&t))).unwrap()
    };
    let points_of_bare = points(&bare, 60);
    let moved = |p: &SurfacePoint| {
        let triangle = if (p.triangle as usize) < PLACE { p.triangle } else { p.triangle + 2 };
        SurfacePoint { triangle, ..*p }
    };
    let points: Vec<SurfacePoint> = points_of_bare.iter().map(moved).collect();
    // The pane is bright as well, which must not make it a light.
    let mut radiance = scenes::smooth_light(192);
    let is_pane_texel = |i: usize| i % 192 >= 176 && i / 192 >= 176;
    let lit = |(i, l): (usize, &mut [f32; 3])| *l = if is_pane_texel(i) { [9.0; 3] } else { *l };
    radiance.data.iter_mut().enumerate().for_each(lit);
    let gpu = gpu();
    let gathered = |backend: &mut dyn Backend, points: &[SurfacePoint], light_samples: u32| {
        let lights = scenes::lights(backend, &radiance);
        let shine = |l: &LightPart| l.pdf_area > 0.0;
        let solid = backend.scene().is_solid();
        assert!(!lights.is_empty() && lights.parts.iter().all(|l| !shine(l) || solid[l.triangle as usize]));
        backend.set_tbl(&radiance, &lights).unwrap();
        flat(&backend.irradiance(points, Gather::new(64, light_samples, 5), &Silent).unwrap())
    };
    let (pane, sheet) = (Arc::new(with(true)), Arc::new(with(false)));
    let on_gpu = |scene: &Arc<Scene>, points: &[SurfacePoint], light_samples: u32| {
        gathered(&mut GpuBackend::new(&gpu, scene.clone()).unwrap(), points, light_samples)
    };
    // Tables of lights are learned on panes too, so that light samples are others than without any.
    TRACED.check("beside no pane at all", &on_gpu(&pane, &points, 0), &on_gpu(&bare, &points_of_bare, 0));
    let through = on_gpu(&pane, &points, 64);
    TRACED.check("beside the CPU", &through, &gathered(&mut CpuBackend::new(pane), &points, 64));
    // Negative control: what is solid takes the light.
    assert!(TRACED.failures(&on_gpu(&sheet, &points, 64), &through).len() > 2 * points.len());
}

#[test]
fn triangles_that_rays_meet_in_parts_are_the_same_to_all() {
    let mesh = room().mesh().clone();
    // Holes of many sizes, and translucent triangles, in all that there is: lights, walls, and things before them.
    let in_parts = |triangle: u32| {
        let some = |[[u, v], ..]: [[f32; 2]; 3]| if u + v < 0.4 { 1.0 } else { 0.7 * u };
        let opacity = match [1, 2, 5, 16, 33, 100][triangle as usize % 6] {
            1 => TriangleOpacity::from_coverage(1, hash(triangle), |_| 0.4),
            side => TriangleOpacity::from_coverage(side, hash(triangle), some),
        };
        if hash(triangle).is_multiple_of(2) { opacity.turned_over() } else { opacity }
    };
    let scene = Arc::new(Scene::with_opacity(mesh.clone(), in_parts).unwrap());
    assert!(scene.micromaps().len() > mesh.triangles.len() / 2);
    let (points, camera) = (points(&scene, 100), &scenes::cameras()[0]);
    let traced = |backend: &mut dyn Backend| {
        light(backend);
        let e = backend.irradiance(&points, Gather::new(64, 64, 5), &Silent).unwrap();
        (flat(&e), backend.primary(camera, camera.rows()).unwrap())
    };
    let expected = traced(&mut CpuBackend::new(scene.clone()));
    for place in [BvhStorage::Buffers, BvhStorage::Textures] {
        let got = traced(&mut GpuBackend::with_bvh_storage(&gpu(), scene.clone(), place).unwrap());
        // Of some thousand rays one or two go by the edge of a part.
        let different = expected.1.iter().zip(&got.1).filter(|(a, b)| a.triangle != b.triangle).count();
        assert!(different * 1000 < expected.1.len(), "{different} of {} pixels", expected.1.len());
        let far = TRACED.failures(&got.0, &expected.0).len();
        assert!(far * 10 < expected.0.len(), "{far} of {} sums", expected.0.len());
        let mean = |e: &[f64]| e.iter().sum::<f64>() / e.len() as f64;
        assert!((mean(&got.0) / mean(&expected.0) - 1.0).abs() < 1e-3, "{place:?}");
    }
    // Negative control: the same without holes.
    let whole = traced(&mut CpuBackend::new(Arc::new(Scene::new(mesh).unwrap())));
    let different = expected.1.iter().zip(&whole.1).filter(|(a, b)| a.triangle != b.triangle).count();
    assert!(different * 5 > expected.1.len(), "{different} of {} pixels", expected.1.len());
    assert!(TRACED.failures(&whole.0, &expected.0).len() * 2 > expected.0.len());
}

#[test]
fn lights_are_solid() {
    let scene = Arc::new(Scene::with_opacity(room().mesh().clone(), transparent(|t| t == 7)).unwrap());
    let mut luminance = vec![0.0; scene.mesh().triangles.len()];
    let radiance = scenes::smooth_light(192);
    let mut gpu = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    for backend in [&mut CpuBackend::new(scene.clone()) as &mut dyn Backend, &mut gpu] {
        luminance.fill(0.0);
        luminance[8] = 1.0;
        backend.set_tbl(&radiance, &Lights::by_power(scene.mesh(), &luminance)).unwrap();
        luminance[7] = 1.0;
        let refused = backend.set_tbl(&radiance, &Lights::by_power(scene.mesh(), &luminance)).unwrap_err().to_string();
        assert!(refused.contains("triangle 7"), "{refused}");
    }
}

#[test]
fn parts_of_triangles_are_sampled_alike() {
    // Spots of a few texels on walls of two triangles.
    let scene = room();
    let mut radiance = Rgb::filled(192, 192, [0.1, 0.2, 0.3]);
    (0..60).for_each(|i| radiance.data[hash(i) as usize % (192 * 192)] = [30.0, 20.0, 10.0]);
    let points = points(&scene, 64);
    let pixels: Vec<_> = shading(&points).0.into_iter().map(|point| [point; STRATA]).collect();
    let gather = Gather::new(16, 48, 3);
    let table = TableSampling { lobe: 2, cosine: 2, light: 8, seed: 4, masking: Masking::Schlick };
    let gathered = |backend: &mut dyn Backend, change: &dyn Fn(&mut Lights)| {
        let mut lights = scenes::lights(backend, &radiance);
        assert!(lights.parts.iter().any(|light| light.part.level() > 2 && light.pdf_area > 0.0));
        change(&mut lights);
        backend.set_tbl(&radiance, &lights).unwrap();
        let e = flat(&backend.irradiance(&points, gather, &Silent).unwrap());
        let tables = backend.specular_tables(&pixels, 0.04, table, &Silent).unwrap();
        (e, tables.iter().flat_map(|curve| curve.nodes).flatten().map(|s| f64::from(s.to_f32())).collect::<Vec<_>>())
    };
    let mut gpu = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let expected = gathered(&mut CpuBackend::new(scene.clone()), &|_| ());
    let got = gathered(&mut gpu, &|_| ());
    TRACED.check("irradiance", &got.0, &expected.0);
    HALF.check("specular tables", &got.1, &expected.1);
    // Negative control: other densities of the parts are other sums.
    let other = gathered(&mut gpu, &|lights| lights.parts.iter_mut().for_each(|light| light.pdf_area *= 2.0));
    assert!(TRACED.failures(&other.0, &expected.0).len() * 2 > expected.0.len());
}

#[test]
fn lights_in_several_leaves_of_the_hierarchy_shine_in_full() {
    let (mesh, radiance) = scenes::room_with_strip(192);
    let scene = Arc::new(Scene::new(mesh).unwrap());
    let strip = scene.mesh().triangles.len() as u32 - 2;
    let leaves = scene.primitives().iter().filter(|&&t| t >= strip).count();
    assert!(leaves > 2, "the strip's triangles are in one leaf each: nothing is tested");
    let points = points(&scene, 60);
    let mut cpu = CpuBackend::new(scene.clone());
    let mut gpu = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let lights = scenes::lights(&mut cpu, &radiance);
    assert!((strip..strip + 2).all(|t| lights.at(t, [0.3; 2]).is_some()), "the strip is no light");
    let gathered = [&mut cpu as &mut dyn Backend, &mut gpu].map(|backend| {
        backend.set_tbl(&radiance, &lights).unwrap();
        flat(&backend.irradiance(&points, Gather::new(64, 64, 5), &Silent).unwrap())
    });
    TRACED.check("E beneath the strip", &gathered[1], &gathered[0]);
}

#[test]
fn buffers_and_textures_hold_the_same_hierarchy() {
    let gpu = gpu();
    let scene = Arc::new(Scene::new(scenes::subdivided(room().mesh(), 4)).unwrap());
    assert!(scene.nodes().len() > 8192 * 16, "its nodes are in one row of a texture");
    let points = points(&scene, 200);
    let [buffers, textures] = [BvhStorage::Buffers, BvhStorage::Textures].map(|place| {
        let mut backend = GpuBackend::with_bvh_storage(&gpu, scene.clone(), place).unwrap();
        light(&mut backend);
        let e = backend.irradiance(&points, Gather::new(64, 64, 6), &Silent).unwrap();
        (e, backend.primary(&scenes::cameras()[0], scenes::cameras()[0].rows()).unwrap())
    });
    ROUNDING.check("E", &flat(&buffers.0), &flat(&textures.0));
    assert!(buffers.1.iter().zip(&textures.1).all(|(a, b)| a.triangle == b.triangle));
}

#[test]
fn few_samples_give_the_same_sum_in_every_shape() {
    let scene = room();
    let mut backend = lit(&gpu(), &scene);
    let points = points(&scene, 70);
    let (pixels, materials) = shading(&points);
    let sampling = Sampling { samples: 50, seed: 2 };
    let mut expected: Option<(Vec<f64>, Vec<f64>)> = None;
    for (threads_per_item, rays_per_thread) in [(64, 32), (16, 4), (4, 3), (1, 1), (2, 64)] {
        backend.set_gather_shape(Some(GatherShape { threads_per_item, rays_per_thread })).unwrap();
        let e = flat(&backend.irradiance(&points, Gather::new(50, 21, 2), &Silent).unwrap());
        let shaded = backend.shade(&pixels, &materials, sampling, RoughnessGradient::Exact, &Silent).unwrap();
        let l = shaded.iter().flat_map(|s| [s.radiance, s.specular_scale]).flatten().map(f64::from).collect();
        let (expected_e, expected_l) = expected.get_or_insert((e.clone(), l));
        ROUNDING.check("E", &e, expected_e);
        let l: Vec<f64> = shaded.iter().flat_map(|s| [s.radiance, s.specular_scale]).flatten().map(f64::from).collect();
        ROUNDING.check("L_o and A", &l, expected_l);
    }
    for shape in [
        GatherShape { threads_per_item: 48, rays_per_thread: 4 },
        GatherShape { threads_per_item: 128, rays_per_thread: 1 },
        GatherShape { threads_per_item: 8, rays_per_thread: 0 },
    ] {
        assert!(backend.set_gather_shape(Some(shape)).is_err(), "{shape:?}");
    }
}

#[test]
fn parts_of_a_gather_are_the_whole() {
    let scene = room();
    let mut backend = lit(&gpu(), &scene);
    let points = points(&scene, 70);
    let whole = Gather::new(60, 24, 2);
    let mut part = |part| {
        let half =
            Gather { cosine: whole.cosine / 2, light: whole.light / 2, sequences: Sequences::Own { part }, ..whole };
        flat(&backend.irradiance(&points, half, &Silent).unwrap())
    };
    let halves = [part(0), part(1)];
    let mean: Vec<f64> = halves[0].iter().zip(&halves[1]).map(|(a, b)| (a + b) / 2.0).collect();
    let expected = flat(&backend.irradiance(&points, whole, &Silent).unwrap());
    ROUNDING.check("both parts", &mean, &expected);
    // Negative control: parts draw different samples.
    assert!(ROUNDING.failures(&halves[0], &expected).len() > points.len());
}

#[test]
fn a_closed_room_of_one_radiance_is_a_furnace() {
    let scene = room();
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    backend.set_tbl(&Rgb::filled(3, 2, [2.0, 1.0, 0.25]), &Lights::none(scene.mesh())).unwrap();
    let points = points(&scene, 300);
    let expected: Vec<f64> = points.iter().flat_map(|_| [2.0, 1.0, 0.25].map(|l| std::f64::consts::PI * l)).collect();
    for samples in [1, 16, 64, 256, 4096] {
        let points = &points[..if samples > 256 { 10 } else { points.len() }];
        // The light samples have nothing to aim at, and must not count.
        let gather = Gather::new(samples, samples, samples);
        let got = backend.irradiance(points, gather, &Silent).unwrap();
        let e = lanes3(got.iter().map(|g| &g.irradiance));
        ROUNDING.check(&format!("E = πL, {samples} samples"), &e, &expected[..3 * points.len()]);
        assert!(got.iter().all(|g| g.back_faces == 0.0));
    }
    // A nearly perfect mirror reflects L·F, times the masking g(nl) g(nv) nl nv that the model keeps even there.
    let (pixels, _) = shading(&points);
    let roughness = 0.01;
    let mirrors = vec![Material { metallic: 1.0, ..Material::dielectric([1.0, 0.7, 0.2], roughness) }; pixels.len()];
    let sampling = Sampling { samples: 16, seed: 3 };
    let shaded = backend.shade(&pixels, &mirrors, sampling, RoughnessGradient::Exact, &Silent).unwrap();
    let nv = 1.0 / 1.49f64.sqrt();
    let weight = (g_schlick(nv, f64::from(roughness)) * nv).powi(2);
    let x = fresnel_weight(nv);
    let reflected = |f0: f64, l: f64| weight * l * (f0 * (1.0 - x) + x);
    let expected: Vec<f64> =
        pixels.iter().flat_map(|_| [reflected(1.0, 2.0), reflected(0.7, 1.0), reflected(0.2, 0.25)]).collect();
    let narrow = Tolerance { absolute: 0.0, relative: 2e-3 };
    narrow.check("mirror", &lanes3(shaded.iter().map(|s| &s.radiance)), &expected);
}

#[test]
fn the_same_call_gives_the_same_bits_however_it_is_cut() {
    let gpu = gpu();
    let scene = room();
    let mut backend = lit(&gpu, &scene);
    let points = points(&scene, 3000);
    let gather = Gather::new(128, 64, 4);
    let whole = backend.irradiance(&points, gather, &Silent).unwrap();
    // The second call has measured the device, and cuts elsewhere; a new backend starts over.
    assert!(whole == backend.irradiance(&points, gather, &Silent).unwrap());
    let mut fresh = lit(&gpu, &scene);
    // A point's samples follow the sequence that it carries, so that a subset gathers alike.
    assert!(whole[17..40] == fresh.irradiance(&points[17..40], gather, &Silent).unwrap()[..]);
    let moved: Vec<SurfacePoint> = points[17..40].iter().map(|p| SurfacePoint { index: 0, ..*p }).collect();
    assert!(whole[17..40] != fresh.irradiance(&moved, gather, &Silent).unwrap()[..]);

    let (pixels, materials) = shading(&points);
    let sampling = Sampling { samples: 128, seed: 4 };
    let shade = |backend: &mut GpuBackend, from: usize| {
        let gradient = RoughnessGradient::Authors;
        backend.shade(&pixels[from..], &materials[from..], sampling, gradient, &Silent).unwrap()
    };
    let whole = shade(&mut backend, 0);
    // A pixel's samples follow the sequence that it carries, so that a subset shades alike.
    assert!(whole[777..] == shade(&mut fresh, 777)[..]);
}

#[test]
fn threads_share_a_device_with_each_other_and_with_their_host() {
    let gpu = gpu();
    let scene = room();
    let points = points(&scene, 64);
    let gather = Gather::new(64, 0, 4);
    let alone = lit(&gpu, &scene).irradiance(&points, gather, &Silent).unwrap();
    std::thread::scope(|threads| {
        let gathering = || {
            let mut backend = lit(&gpu, &scene);
            (0..50).all(|_| backend.irradiance(&points, gather, &Silent).unwrap() == alone)
        };
        let gathering = [(); 3].map(|()| threads.spawn(gathering));
        // As a renderer does between its frames.
        while gathering.iter().any(|thread| !thread.is_finished()) {
            gpu.device().poll(texir_gpu::wgpu::PollType::Poll).unwrap();
            std::thread::yield_now();
        }
        assert_eq!(gathering.map(|thread| thread.join().unwrap()), [true; 3]);
    });
}

/// Counts what it is told, and cancels after a number of rays.
struct Counter {
    rays: AtomicU64,
    limit: u64,
}

impl Progress for Counter {
    fn start(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, done: u64) {
        self.rays.fetch_add(done, Ordering::Relaxed);
    }
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        panic!("warned: {message}");
    }
    fn cancelled(&self) -> bool {
        self.rays.load(Ordering::Relaxed) >= self.limit
    }
}

#[test]
fn progress_counts_every_ray_and_cancelling_stops() {
    let scene = room();
    let mut backend = lit(&gpu(), &scene);
    let points = points(&scene, 3000);
    let gather = Gather::new(80, 20, 4);
    let counter = Counter { rays: AtomicU64::new(0), limit: u64::MAX };
    backend.irradiance(&points, gather, &counter).unwrap();
    assert_eq!(counter.rays.into_inner(), 300_000);
    let counter = Counter { rays: AtomicU64::new(0), limit: 1 };
    let mut fresh = lit(&gpu(), &scene);
    assert!(matches!(fresh.irradiance(&points, gather, &counter), Err(Error::Cancelled)));
    let done = counter.rays.into_inner();
    assert!(done > 0 && done < 300_000, "{done} rays were traced");
}

#[test]
fn empty_work_gives_empty_results() {
    let scene = room();
    let mut cpu = CpuBackend::new(scene.clone());
    cpu.set_tbl(&scenes::smooth_light(8), &Lights::none(scene.mesh())).unwrap();
    let sampling = Sampling { samples: 16, seed: 1 };
    for backend in [&mut cpu as &mut dyn Backend, &mut lit(&gpu(), &scene)] {
        assert!(backend.irradiance(&[], Gather::new(16, 4, 1), &Silent).unwrap().is_empty());
        assert!(backend.shade(&[], &[], sampling, RoughnessGradient::Exact, &Silent).unwrap().is_empty());
        assert!(backend.shade_vjp(&[], &[], &[], &[]).unwrap().is_empty());
        assert!(backend.project(&[], &scenes::cameras()[0]).unwrap().is_empty());
        assert!(backend.radiance_loss(&[], &[]).unwrap().gradient.is_empty());
        assert!(backend.texels([0, 5], 0..5).unwrap().is_empty());
    }
}

/// What no backend may do: nothing, or fail without a word.
fn misused(backend: &mut dyn Backend) {
    let scene = backend.scene().clone();
    let points = points(&scene, 2);
    let one = Gather::new(1, 0, 0);
    let unlit = backend.irradiance(&points, one, &Silent).unwrap_err().to_string();
    assert!(unlit.contains("lighting"), "{unlit}");
    let dark = Lights::none(scene.mesh());
    let empty = backend.set_tbl(&Rgb::filled(0, 0, [0.0; 3]), &dark).unwrap_err().to_string();
    assert!(empty.contains("no texels"), "{empty}");
    backend.set_tbl(&scenes::smooth_light(8), &dark).unwrap();
    let none = backend.irradiance(&points, Gather { cosine: 0, ..one }, &Silent).unwrap_err().to_string();
    assert!(none.contains("samples"), "{none}");
    let foreign = Lights { cuts: vec![Cut::NONE; 3], ..dark };
    let foreign = backend.set_tbl(&scenes::smooth_light(8), &foreign).unwrap_err().to_string();
    assert!(foreign.contains("another mesh"), "{foreign}");
    let clusterless = Lights { clusters: Vec::new(), ..Lights::none(scene.mesh()) };
    let clusterless = backend.set_tbl(&scenes::smooth_light(8), &clusterless).unwrap_err().to_string();
    assert!(clusterless.contains("clusters"), "{clusterless}");
    // Parts that are of no triangle, or of one that the mesh does not have.
    let dark = Lights::none(scene.mesh());
    for triangle in [0, u32::MAX] {
        let stray = LightPart { triangle, ..dark.parts[0] };
        let parts = vec![dark.parts[0], stray];
        let of_one =
            Lights { parts, members: vec![1], cdf: vec![1.0], clusters: vec![0, 1], tables: vec![1.0], ..dark.clone() };
        let refused = backend.set_tbl(&scenes::smooth_light(8), &of_one).unwrap_err().to_string();
        assert!(refused.contains("parts"), "{refused}");
    }
    let short = Rgb { data: vec![[1.0; 3]; 63], ..scenes::smooth_light(8) };
    let short = backend.set_tbl(&short, &Lights::none(scene.mesh())).unwrap_err().to_string();
    assert!(short.contains("holds 63 values") && short.contains("8×8 pixels"), "{short}");
    for impossible in [f32::NAN, -1.0, f32::INFINITY, 1e20] {
        let mut light = scenes::smooth_light(8);
        light.data[19][1] = impossible;
        let refused = backend.set_tbl(&light, &Lights::none(scene.mesh())).unwrap_err().to_string();
        assert!(refused.contains("column 3, row 2"), "{refused}");
    }
    let (pixels, materials) = shading(&points);
    let (sampling, exact) = (Sampling { samples: 1, seed: 0 }, RoughnessGradient::Exact);
    let few = backend.shade(&pixels, &materials[1..], sampling, exact, &Silent).unwrap_err().to_string();
    assert!(few.contains("materials"), "{few}");
    let shaded = backend.shade(&pixels, &materials, sampling, exact, &Silent).unwrap();
    let few = backend.shade_vjp(&pixels, &materials, &shaded, &[[0.0; 3]]).unwrap_err().to_string();
    assert!(few.contains("cotangents"), "{few}");
    let few = backend.radiance_loss(&[[1.0; 3]], &[]).unwrap_err().to_string();
    assert!(few.contains("target"), "{few}");
    let strange = Groups { offsets: vec![0, 1], members: vec![7], references: vec![1] };
    let strange = backend.group_loss(&[0.0; 4], 1, &strange, GroupTarget::Mean).unwrap_err().to_string();
    assert!(strange.contains("pixel 7"), "{strange}");
    let pyramid = Pyramid::new(2, 2, &[true; 4]);
    let beyond = SparseRows { offsets: vec![0, 1], taps: vec![Tap { texel: 9, weight: 1.0 }] };
    let small = backend.lookup(&pyramid, &[0.0; 3], 1, &beyond).unwrap_err().to_string();
    assert!(small.contains("texture of lookup"), "{small}");
    let beyond = backend.lookup(&pyramid, &[0.0; 4], 1, &beyond).unwrap_err().to_string();
    assert!(beyond.contains("texel 9"), "{beyond}");
    let torn = SparseRows { offsets: vec![0, 2], taps: vec![Tap { texel: 0, weight: 1.0 }] };
    let torn = backend.lookup(&pyramid, &[0.0; 4], 1, &torn).unwrap_err().to_string();
    assert!(torn.contains("offsets"), "{torn}");
    let flat = SparseRows { offsets: vec![0], taps: Vec::new() };
    let flat = backend.lookup(&pyramid, &[], 0, &flat).unwrap_err().to_string();
    assert!(flat.contains("0 channels"), "{flat}");
    let pair = Groups { offsets: vec![0, 2], members: vec![0, 1], references: vec![1] };
    let high = backend.group_loss(&[0.0; 2], 1, &pair, GroupTarget::Quantile(1.5)).unwrap_err().to_string();
    assert!(high.contains("quantile 1.5"), "{high}");
    let nowhere = [points[0], SurfacePoint { position: [f32::NAN; 3], ..points[1] }];
    let mut lost = scenes::cameras()[0];
    let refused = [
        backend.irradiance(&nowhere, one, &Silent).map(drop),
        backend.punctual(&nowhere, &[], &Silent).map(drop),
        backend.project(&nowhere, &lost).map(drop),
        backend.shade(&shading(&nowhere).0, &materials, sampling, exact, &Silent).map(drop),
    ];
    for refused in refused.map(|pass| pass.unwrap_err().to_string()) {
        assert!(refused.contains("the position of point 1 is [NaN"), "{refused}");
    }
    lost.world_from_camera.w_axis.x = f32::NAN;
    for refused in [backend.primary(&lost, 0..1).map(drop), backend.project(&points, &lost).map(drop)] {
        assert!(refused.unwrap_err().to_string().contains("the camera's world_from_camera"));
    }
    assert!(backend.irradiance(&points, one, &Silent).is_ok());
}

#[test]
fn misuse_is_an_error() {
    let scene = room();
    let gpu = gpu();
    misused(&mut CpuBackend::new(scene.clone()));
    let mut backend = GpuBackend::new(&gpu, scene.clone()).unwrap();
    misused(&mut backend);
    // Larger than the device binds or makes: an error with the figures, not a lost device.
    let (points, dark) = (points(&scene, 2), Lights::none(scene.mesh()));
    let limit = gpu.device().limits().max_texture_dimension_2d as usize;
    let wide = backend.set_tbl(&Rgb::filled(limit + 1, 1, [1.0; 3]), &dark).unwrap_err().to_string();
    assert!(wide.contains(&format!("{limit} × {limit}")), "{wide}");
    // What was set before had to make room.
    let none = backend.irradiance(&points, Gather::new(1, 0, 0), &Silent).unwrap_err().to_string();
    assert!(none.contains("no lighting is set"), "{none}");
    backend.set_tbl(&scenes::smooth_light(8), &dark).unwrap();
    assert!(backend.irradiance(&points, Gather::new(1, 0, 0), &Silent).is_ok());
    let unknown = Gpu::headless(Some("no such adapter")).err().unwrap().to_string();
    assert!(unknown.contains("no such adapter"), "{unknown}");
}

#[test]
fn engines_can_keep_backends() {
    fn is_kept<T: Send + Sync + 'static>() {}
    is_kept::<CpuBackend>();
    is_kept::<GpuBackend>();
}

#[test]
fn walls_that_are_there_from_both_sides_take_no_light() {
    // As exporters write what is to be seen from both sides; turned, so that distances round apart.
    let turn = glam::Quat::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -0.7);
    let mut mesh = room().mesh().clone();
    mesh.positions.iter_mut().for_each(|p| *p = turn * *p);
    mesh.flat_normals();
    let single = Arc::new(Scene::new(mesh.clone()).unwrap());
    mesh.triangles.extend_from_within(..);
    let half = mesh.triangles.len() / 2;
    mesh.triangles[half..].iter_mut().for_each(|corners| corners.reverse());
    let doubled = Arc::new(Scene::new(mesh).unwrap());
    let points = points(&single, 400);
    let gathered = |backend: &mut dyn Backend| {
        // Backs are black, as in scenes that somebody made.
        let lights = Lights { one_sided: true, ..Lights::none(backend.scene().mesh()) };
        backend.set_tbl(&scenes::smooth_light(192), &lights).unwrap();
        flat(&backend.irradiance(&points, Gather::new(128, 0, 5), &Silent).unwrap())
    };
    let one = gathered(&mut CpuBackend::new(single));
    TRACED.check("two sheets on the CPU", &gathered(&mut CpuBackend::new(doubled.clone())), &one);
    TRACED.check("two sheets on the GPU", &gathered(&mut GpuBackend::new(&gpu(), doubled).unwrap()), &one);
}
