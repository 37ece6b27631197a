//! Every WGSL pass against its twin in `f64`, which finds hits by testing every triangle.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use glam::Vec3;
use texir_core::backend::{
    Backend, Gather, Gathered, GroupTarget, Groups, Material, MaterialGrad, RoughnessGradient, Sampling, Sequences,
    ShadePoint, Shaded,
};
use texir_core::camera::Camera;
use texir_core::cpu::lighting::Lighting;
use texir_core::cpu::shade::{MaterialIn, ShadedIn};
use texir_core::cpu::{group_loss, irradiance, lookup, primary, project, radiance_loss, shade, shade_vjp, texels};
use texir_core::lights::Lights;
use texir_core::progress::Silent;
use texir_core::real::V3;
use texir_core::rng::{hash, hash2, sobol2};
use texir_core::scene::Scene;
use texir_core::scene::trace::{BruteForce, TraceHit};
use texir_core::surface::{Hit, SurfacePoint, TexelHit};
use texir_core::texture::{Footprints, Pyramid, SparseRows, Tap};
use texir_gpu::GpuBackend;
use texir_tests::compare::{Tolerance, lanes, lanes3};
use texir_tests::{gpu, scenes};

const TIGHT: Tolerance = Tolerance { absolute: 1e-5, relative: 1e-5 };
/// Sums over traced rays: a ray within rounding of an edge or a texel's border sees another texel.
const TRACED: Tolerance = Tolerance { absolute: 1e-3, relative: 2e-3 };

fn room() -> Arc<Scene> {
    Arc::new(Scene::new(scenes::furnished_room()).unwrap())
}

fn unit(i: u32, stream: u32) -> f32 {
    hash2(i, stream) as f32 / u32::MAX as f32
}

/// Surface points all over the room.
fn points(scene: &Scene, count: u32) -> Vec<SurfacePoint> {
    (0..count)
        .map(|i| {
            let triangle = hash2(i, 3) % scene.mesh().triangles.len() as u32;
            let [a, b] = sobol2(i, 4);
            let (u, v) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let hit = Hit { triangle, u: 0.9 * u, v: 0.9 * v, t: 0.0 };
            SurfacePoint { index: i, ..SurfacePoint::new(scene.mesh(), &hit, None) }
        })
        .collect()
}

#[test]
fn primary_visibility() {
    let scene = room();
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let exact = BruteForce(scene.mesh());
    for camera in scenes::cameras() {
        let hits = backend.primary(&camera, camera.rows()).unwrap();
        let twin: Vec<TraceHit<f64>> = (0..camera.pixels())
            .map(|i| primary::primary(&exact, &camera, i % camera.width, i / camera.width).unwrap())
            .collect();
        let t = |h: &Hit| if h.is_hit() { f64::from(h.t) } else { f64::NAN };
        let (got, expected): (Vec<f64>, Vec<f64>) = (hits.iter().map(t).collect(), twin.iter().map(|h| h.t).collect());
        TIGHT.check("distance", &got, &expected);
        // Rows by themselves are those of the whole.
        let rows = camera.height / 3..camera.height / 2;
        let (first, end) = (rows.start * camera.width, rows.end * camera.width);
        assert!(end > first && backend.primary(&camera, rows).unwrap() == hits[first..end]);
        // Barycentric coordinates where no other triangle is as near.
        let same: Vec<_> = hits.iter().zip(&twin).filter(|(h, e)| h.triangle == e.triangle).collect();
        assert!(same.len() + 4 > hits.len(), "{} of {} triangles differ", hits.len() - same.len(), hits.len());
        let coordinates = Tolerance { absolute: 1e-4, relative: 0.0 };
        let of = |f: fn(&Hit) -> f32| same.iter().map(|(h, _)| f64::from(f(h))).collect::<Vec<_>>();
        coordinates.check("u", &of(|h| h.u), &same.iter().map(|(_, e)| e.u).collect::<Vec<_>>());
        coordinates.check("v", &of(|h| h.v), &same.iter().map(|(_, e)| e.v).collect::<Vec<_>>());
        // Negative control: the image of a camera a few centimetres aside is told apart.
        let mut moved = camera;
        moved.world_from_camera.w_axis += glam::Vec4::new(0.02, 0.02, 0.02, 0.0);
        let other: Vec<f64> = backend.primary(&moved, moved.rows()).unwrap().iter().map(t).collect();
        assert!(TIGHT.failures(&other, &expected).len() > hits.len() / 4);
    }
}

#[test]
fn rays_that_leave_the_scene_miss() {
    let mut builder = scenes::Builder::default();
    builder.quad([Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y], [Vec3::Z; 4]);
    let scene = Arc::new(Scene::new(builder.finish()).unwrap());
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    backend.set_tbl(&scenes::smooth_light(32), &Lights::none(scene.mesh())).unwrap();
    for camera in scenes::cameras() {
        let hits = backend.primary(&camera, camera.rows()).unwrap();
        let exact = BruteForce(scene.mesh());
        let twin = |i: usize| primary::primary::<f64>(&exact, &camera, i % camera.width, i / camera.width).is_some();
        let wrong: Vec<_> = (0..hits.len()).filter(|&i| hits[i].is_hit() != twin(i)).collect();
        assert!(wrong.is_empty(), "pixels {wrong:?}");
        assert!(hits.contains(&Hit::MISS));
    }
    let up = SurfacePoint { position: [0.5, 0.5, 0.1], triangle: 0, normal: [0.0, 0.0, 1.0], index: 0 };
    let gather = Gather::new(32, 0, 1);
    let nothing = Gathered { irradiance: [0.0; 3], back_faces: 0.0 };
    assert_eq!(backend.irradiance(&[up], gather, &Silent).unwrap(), [nothing]);
}

#[test]
fn texel_map() {
    let scene = room();
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    // Not multiples of the tile, and coarse enough that charts meet within texels.
    for (width, height) in [(149, 131), (37, 20)] {
        let hits = backend.texels([width, height], 0..height).unwrap();
        let bins = texels::TileBins::new(scene.mesh(), [width, height], 0..height).unwrap();
        let corners = |t: u32| {
            scene.mesh().corner_uvs(t).map(|uv| [f64::from(uv.x) * width as f64, f64::from(uv.y) * height as f64])
        };
        let place = |triangle: u32, u: f64, v: f64, x: usize, y: usize| {
            let [a, b, c] = corners(triangle);
            let at = |k: usize| a[k] * (1.0 - u - v) + b[k] * u + c[k] * v;
            (at(0) - x as f64 - 0.5).hypot(at(1) - y as f64 - 0.5)
        };
        let (mut got, mut expected, mut inside, mut triangles) = (vec![], vec![], 0, 0);
        for (i, hit) in hits.iter().enumerate() {
            let (x, y) = (i % width, i / width);
            let twin = texels::texel(bins.at(x, y), corners, x, y);
            expected.push(twin.map_or(texels::REACH, |t| place(t.triangle, t.u, t.v, x, y)));
            got.push(hit.map_or(texels::REACH, |t| place(t.triangle, f64::from(t.u), f64::from(t.v), x, y)));
            inside += usize::from(twin.is_some_and(|t| t.inside) != hit.is_some_and(|t| t.inside));
            triangles += usize::from(twin.map(|t| t.triangle) != hit.map(|t| t.triangle));
        }
        Tolerance { absolute: 1e-4, relative: 0.0 }.check("distance from the texel's centre", &got, &expected);
        // Only where a centre lies on an edge may rounding decide otherwise.
        assert!(inside <= hits.len() / 200 && triangles <= hits.len() / 100, "{inside} and {triangles} differ");
        assert!([true, false].iter().all(|inside| hits.iter().flatten().any(|t| t.inside == *inside)));
        let cuts = [0, 5, 16, 19];
        let pieces = cuts.iter().zip(cuts[1..].iter().chain([&height]));
        let pieces: Vec<Option<TexelHit>> =
            pieces.flat_map(|(&from, &to)| backend.texels([width, height], from..to).unwrap()).collect();
        assert!(pieces == hits, "rows do not depend on which others are asked for");
    }
}

#[test]
fn irradiance_gather() {
    // Flat shading: about an interpolated normal, some rays enter the surface that they start on, and whether that
    // surface is hit again is a matter of rounding.
    let mut mesh = scenes::furnished_room();
    mesh.flat_normals();
    let scene = Arc::new(Scene::new(mesh).unwrap());
    let light = scenes::smooth_light(192);
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let lights = scenes::lights(&mut backend, &light);
    assert!(lights.members.len() > 10);
    backend.set_tbl(&light, &lights).unwrap();
    let points = points(&scene, 150);
    let exact = BruteForce(scene.mesh());
    let lighting = Lighting { tracer: &exact, radiance: &light, environment: None };
    let flat = |g: &Gathered| [g.irradiance[0], g.irradiance[1], g.irradiance[2], g.back_faces].map(f64::from);
    let own = |part| Sequences::Own { part };
    // In a narrow map the points lie in blocks below each other, in a wide one beside each other.
    let shared = |width, part, parts| Sequences::Shared { width, part, parts };
    for (cosine, light, sequences) in [
        (5, 0, own(0)),
        (64, 0, own(0)),
        (64, 64, own(1)),
        (33, 100, own(2)),
        (64, 64, shared(40, 0, 1)),
        (33, 9, shared(3, 0, 1)),
        (64, 64, shared(40, 1, 2)),
    ] {
        let gather = Gather { sequences, ..Gather::new(cosine, light, 11) };
        let got: Vec<f64> = backend.irradiance(&points, gather, &Silent).unwrap().iter().flat_map(flat).collect();
        let expected: Vec<f64> = (points.iter())
            .map(|p| irradiance::irradiance::<f64, _>(&lighting, &lights, p, gather))
            .flat_map(|g| flat(&g))
            .collect();
        TRACED.check("E and back faces", &got, &expected);
        // Negative control: another seed draws other samples.
        let other = backend.irradiance(&points, Gather { seed: 12, ..gather }, &Silent).unwrap();
        let other: Vec<f64> = other.iter().flat_map(flat).collect();
        assert!(TRACED.failures(&other, &expected).len() > points.len());
    }
}

#[test]
fn projection() {
    let scene = room();
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    let points = points(&scene, 6000);
    let exact = BruteForce(scene.mesh());
    for camera in scenes::cameras() {
        let got = backend.project(&points, &camera).unwrap();
        let (mut found, mut expected, mut seen) = (vec![], vec![], 0);
        for (g, p) in got.iter().zip(&points) {
            let e = project::project::<f64>(&exact, &camera, p);
            seen += usize::from(e.distance > 0.0);
            found.extend([g.pixel[0], g.pixel[1], g.cosine, g.distance].map(f64::from));
            expected.extend([e.pixel[0], e.pixel[1], e.cosine, e.distance].map(f64::from));
        }
        assert!(seen > 50 && seen < points.len(), "{seen} points are seen");
        Tolerance { absolute: 1e-4, relative: 1e-5 }.check("pixel, cosine, distance", &found, &expected);
    }
}

/// Pixels of a panorama of the room with random materials.
fn shading(backend: &mut GpuBackend, camera: &Camera, step: usize) -> (Vec<ShadePoint>, Vec<Material>) {
    let hits = backend.primary(camera, camera.rows()).unwrap();
    (0..hits.len())
        .step_by(step)
        .map(|i| {
            let view = -camera.direction((i % camera.width) as f32 + 0.5, (i / camera.width) as f32 + 0.5);
            let point = SurfacePoint::new(backend.scene().mesh(), &hits[i], Some(view));
            let n = i as u32;
            let shade_point = ShadePoint {
                position: point.position,
                index: n,
                normal: point.normal,
                view: view.to_array(),
                irradiance: [unit(n, 1), 2.0 * unit(n, 2), 3.0 * unit(n, 3)],
            };
            let albedo = [unit(n, 4), unit(n, 5), unit(n, 6)];
            let roughness = 0.02 + 0.9 * unit(n, 7);
            let metallic = if hash(n).is_multiple_of(3) { unit(n, 8) } else { 0.0 };
            (shade_point, Material { metallic, ..Material::dielectric(albedo, roughness) })
        })
        .unzip()
}

fn wide(m: &Material) -> MaterialIn<f64> {
    MaterialIn { albedo: V3::of(m.albedo), roughness: f64::from(m.roughness), metallic: f64::from(m.metallic) }
}

#[test]
fn shading_and_its_jacobian() {
    let scene = room();
    let light = scenes::smooth_light(192);
    let mut backend = GpuBackend::new(&gpu(), scene.clone()).unwrap();
    backend.set_tbl(&light, &Lights::none(scene.mesh())).unwrap();
    let (points, materials) = shading(&mut backend, &scenes::cameras()[0], 17);
    let exact = BruteForce(scene.mesh());
    let lighting = Lighting { tracer: &exact, radiance: &light, environment: None };
    let sampling = Sampling { samples: 16, seed: 5 };
    let mut first: Option<Vec<f64>> = None;
    for gradient in [RoughnessGradient::Exact, RoughnessGradient::Authors] {
        let got = backend.shade(&points, &materials, sampling, gradient, &Silent).unwrap();
        let twin: Vec<ShadedIn<f64>> = (points.iter().zip(&materials))
            .map(|(p, m)| shade::shade(&lighting, p, &wide(m), sampling, gradient))
            .collect();
        let part = |f: fn(&ShadedIn<f64>) -> [f64; 3]| twin.iter().flat_map(f).collect::<Vec<f64>>();
        let of = |f: fn(&Shaded) -> &[f32; 3]| lanes3(got.iter().map(f));
        TRACED.check("L_o", &of(|s| &s.radiance), &part(|s| s.radiance.0));
        TRACED.check("A", &of(|s| &s.specular_scale), &part(|s| s.specular_scale.0));
        // ψ and the tilt's divisions by cosines amplify rounding.
        let slopes = Tolerance { absolute: 5e-3, relative: 5e-3 };
        let slope = of(|s| &s.roughness_jacobian);
        slopes.check("dL_o/dr", &slope, &part(|s| s.roughness_jacobian.0));
        // Negative control: the two derivatives are told apart.
        if let Some(first) = &first {
            assert!(slopes.failures(&slope, first).len() > points.len());
        }
        first = Some(slope);
    }
}

#[test]
fn shading_adjoint() {
    let mut backend = GpuBackend::new(&gpu(), room()).unwrap();
    let (points, materials) = shading(&mut backend, &scenes::cameras()[0], 3);
    let n = points.len() as u32;
    let random3 = |i: u32, s: u32| [0, 1, 2].map(|c| 4.0 * unit(i, s + c) - 1.0);
    let shaded: Vec<Shaded> = (0..n)
        .map(|i| Shaded { radiance: [0.0; 3], specular_scale: random3(i, 20), roughness_jacobian: random3(i, 30) })
        .collect();
    let delta: Vec<[f32; 3]> = (0..n).map(|i| random3(i, 40)).collect();
    let got = backend.shade_vjp(&points, &materials, &shaded, &delta).unwrap();
    let flat = |m: &MaterialGrad| [m.albedo[0], m.albedo[1], m.albedo[2], m.roughness, m.metallic].map(f64::from);
    let got: Vec<f64> = got.iter().flat_map(flat).collect();
    let expected: Vec<f64> = (0..n as usize)
        .flat_map(|i| {
            let s = ShadedIn {
                radiance: V3::zero(),
                specular_scale: V3::of(shaded[i].specular_scale),
                roughness_jacobian: V3::of(shaded[i].roughness_jacobian),
            };
            let d = shade_vjp::shade_vjp(&points[i], &wide(&materials[i]), &s, V3::of(delta[i]));
            [d.albedo.0[0], d.albedo.0[1], d.albedo.0[2], d.roughness, d.metallic]
        })
        .collect();
    TIGHT.check("d_material", &got, &expected);
}

#[test]
fn image_loss() {
    let mut backend = GpuBackend::new(&gpu(), room()).unwrap();
    let n = 1000u32;
    let colours = |s: u32| (0..n).map(|i| [0, 1, 2].map(|c| 5.0 * unit(i, s + c))).collect::<Vec<[f32; 3]>>();
    let (mut rendered, target) = (colours(1), colours(9));
    rendered[7] = target[7];
    let loss = backend.radiance_loss(&rendered, &target).unwrap();
    let share = 1.0 / (3.0 * f64::from(n));
    let twin: Vec<(f64, V3<f64>)> =
        (0..n as usize).map(|i| radiance_loss::radiance_loss(V3::of(rendered[i]), V3::of(target[i]), share)).collect();
    let gradient: Vec<f64> = twin.iter().flat_map(|(_, d)| d.0).collect();
    Tolerance { absolute: 1e-9, relative: 1e-5 }.check("d_rendered", &lanes3(&loss.gradient), &gradient);
    TIGHT.check("loss", &[f64::from(loss.value)], &[twin.iter().map(|(l, _)| l).sum()]);
    assert_eq!(loss.gradient[7], [0.0; 3]);
}

/// Groups of very different sizes; some pixels are in none, one group is empty, one has only references.
fn groups(pixels: u32) -> Groups {
    let sizes = [1, 2, 0, 700, 37, 256, 5];
    let mut order: Vec<u32> = (0..pixels).collect();
    order.sort_by_key(|&p| hash(p));
    let mut offsets = vec![0];
    for size in sizes {
        offsets.push(offsets[offsets.len() - 1] + size);
    }
    let members = order[..offsets[sizes.len()] as usize].to_vec();
    Groups { offsets, members, references: vec![1, 1, 0, 650, 0, 130, 5] }
}

#[test]
fn group_losses() {
    let mut backend = GpuBackend::new(&gpu(), room()).unwrap();
    let groups = groups(1200);
    for channels in [1usize, 3] {
        // Some values are equal, some negative, and all share their leading bits with others.
        let values: Vec<f32> =
            (0..1200 * channels as u32).map(|i| ((unit(i, 1) - 0.2) * 300.0).round() / 128.0).collect();
        let exact: Vec<f64> = values.iter().map(|&v| f64::from(v)).collect();
        let mut losses = Vec::new();
        for target in [0.4, 0.0, 1.0, 0.77].map(GroupTarget::Quantile).into_iter().chain([GroupTarget::Mean]) {
            let mut gradient = vec![0.0; exact.len()];
            let expected = group_loss::group_loss(&exact, channels, &groups, target, &mut gradient);
            let got = backend.group_loss(&values, channels, &groups, target).unwrap();
            TIGHT.check(&format!("{target:?}"), &[f64::from(got.value)], &[expected]);
            Tolerance { absolute: 1e-7, relative: 1e-4 }.check("d_values", &lanes(&got.gradient), &gradient);
            losses.push(got.value);
        }
        // Negative control: the targets are told apart.
        losses.sort_by(f32::total_cmp);
        assert!(losses.windows(2).all(|w| w[1] > w[0] + 1e-3), "{losses:?}");
    }
}

#[test]
fn groups_that_do_not_fit_are_refused() {
    let mut backend = GpuBackend::new(&gpu(), room()).unwrap();
    let good = groups(1200);
    let values = vec![0.5; 1200];
    let beyond = Groups { members: good.members.iter().map(|m| m + 1).collect(), ..good.clone() };
    let many = Groups { references: vec![2; 7], ..good.clone() };
    let short = Groups { offsets: good.offsets[1..].to_vec(), ..good };
    for bad in [beyond, many, short] {
        let result = backend.group_loss(&values, 1, &bad, GroupTarget::Mean);
        assert!(result.is_err_and(|e| e.to_string().contains("groups")), "{bad:?}");
    }
}

#[test]
fn cameras_that_scale_are_refused() {
    let mut backend = GpuBackend::new(&gpu(), room()).unwrap();
    let mut camera = scenes::cameras()[0];
    camera.world_from_camera.x_axis *= 2.0;
    let found = [backend.primary(&camera, camera.rows()).err(), backend.project(&[], &camera).err()];
    assert!(found.iter().flatten().filter(|e| e.to_string().contains("is not rigid")).count() == 2, "{found:?}");
}

/// A pyramid with holes and odd sizes, and footprints from all of its levels; the first sees very many texels.
fn pyramid() -> (Pyramid, Footprints) {
    let (width, height) = (183, 101);
    let valid: Vec<bool> = (0..width * height).map(|i| !hash(i as u32 / 7).is_multiple_of(4)).collect();
    let pyramid = Pyramid::new(width, height, &valid);
    let taps = |row: u32| {
        let texel = |t: usize| Tap { texel: t as u32, weight: unit(t as u32, row) };
        let sees = |t: &usize| row == 0 || hash2(row, *t as u32).is_multiple_of(3000);
        (0..pyramid.len()).filter(|&t| pyramid.coverage[t] > 0.0).filter(sees).map(texel).collect()
    };
    let footprints = Footprints::new(SparseRows::from_lists((0..500).map(taps)));
    (pyramid, footprints)
}

#[test]
fn texture_lookup_and_its_transpose() {
    let mut backend = GpuBackend::new(&gpu(), room()).unwrap();
    let (pyramid, footprints) = pyramid();
    assert!(footprints.rows.row(0).len() > 16_384, "one row takes two dispatches");
    let texels = pyramid.levels[0].width * pyramid.levels[0].height;
    for channels in [1usize, 4] {
        let texture: Vec<f32> = (0..(texels * channels) as u32).map(|i| unit(i, 2) - 0.3).collect();
        let wide: Vec<f64> = texture.iter().map(|&v| f64::from(v)).collect();
        let d_values: Vec<f32> = (0..(footprints.len() * channels) as u32).map(|i| unit(i, 3) - 0.5).collect();
        let d_wide: Vec<f64> = d_values.iter().map(|&v| f64::from(v)).collect();
        // Twice: the second time from what the device kept.
        for _ in 0..2 {
            let got = backend.lookup(&pyramid, &texture, channels, &footprints.rows).unwrap();
            TIGHT.check("lookup", &lanes(&got), &lookup::lookup(&pyramid, &wide, channels, &footprints.rows));
            let got = backend.lookup_vjp(&pyramid, &d_values, channels, &footprints).unwrap();
            let expected = lookup::lookup_vjp(&pyramid, &d_wide, channels, &footprints);
            TIGHT.check("lookup_vjp", &lanes(&got), &expected);
        }
    }
}

#[test]
fn footprints_that_changed_are_not_taken_for_those_kept() {
    let mut backend = GpuBackend::new(&gpu(), room()).unwrap();
    let (pyramid, mut footprints) = pyramid();
    let texture: Vec<f32> = (0..(183 * 101)).map(|i| unit(i, 2)).collect();
    let before = backend.lookup(&pyramid, &texture, 1, &footprints.rows).unwrap();
    let middle = footprints.rows.taps.len() / 2;
    footprints.rows.taps[middle].weight += 1.0;
    let after = backend.lookup(&pyramid, &texture, 1, &footprints.rows).unwrap();
    assert_eq!(before.iter().zip(&after).filter(|(a, b)| a != b).count(), 1);
}
