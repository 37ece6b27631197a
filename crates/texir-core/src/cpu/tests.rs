//! Derivatives against dual numbers, estimators against analytic answers, transposes against their forward maps.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::group_loss::group_loss;
use super::lighting::Lighting;
use super::lookup::{lookup, lookup_vjp};
use super::radiance_loss::radiance_loss;
use super::sampling::Frame;
use super::shade::{MaterialIn, ShadedIn, shade};
use super::shade_vjp::shade_vjp;
use super::*;
use crate::atlas::Atlas;
use crate::brdf::{self, Masking};
use crate::mesh::Mesh;
use crate::progress::Silent;
use crate::real::{Dual, Real};
use crate::rng::{hash, hash2, sobol2};
use crate::scene::trace::{BruteForce, Trace};
use crate::texture::{SparseRows, Tap};

/// A closed box [0, 1]³ seen from inside; each wall has its own sixth of the atlas.
fn box_room() -> Mesh {
    let mut mesh = Mesh::default();
    for wall in 0..6usize {
        let axis = wall / 2;
        let far = (wall % 2) as f32;
        let corner = |s: f32, t: f32| {
            let mut p = [0.0; 3];
            p[axis] = far;
            p[(axis + 1) % 3] = s;
            p[(axis + 2) % 3] = t;
            Vec3::from(p)
        };
        let mut normal = [0.0; 3];
        normal[axis] = 1.0 - 2.0 * far;
        let base = mesh.positions.len() as u32;
        for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(corner(s, t));
            mesh.normals.push(Vec3::from(normal));
            mesh.uvs.push(Vec2::new((wall as f32 + 0.05 + 0.9 * s) / 6.0, 0.05 + 0.9 * t));
        }
        let (b, d) = if wall % 2 == 0 { (1, 3) } else { (3, 1) };
        mesh.triangles.push([base, base + b, base + 2]);
        mesh.triangles.push([base, base + 2, base + d]);
    }
    mesh
}

/// Random light, brighter by a factor of a hundred in a few texels.
fn patchy_light() -> Rgb {
    let mut light = Rgb::filled(24, 8, [0.0; 3]);
    for (i, texel) in light.data.iter_mut().enumerate() {
        let bright = if hash(i as u32).is_multiple_of(11) { 20.0 } else { 0.2 };
        *texel = std::array::from_fn(|c| bright * (0.5 + hash2(i as u32, c as u32) as f32 / u32::MAX as f32));
    }
    light
}

fn point(view: Vec3) -> ShadePoint {
    ShadePoint {
        position: [0.4, 0.55, 1e-4],
        index: 9,
        normal: [0.0, 0.0, 1.0],
        view: view.normalize().to_array(),
        irradiance: [1.0, 0.8, 0.5],
    }
}

fn views() -> [Vec3; 3] {
    [Vec3::new(0.1, 0.2, 1.0), Vec3::new(0.8, -0.2, 0.5), Vec3::new(-0.9, 0.3, 0.2)]
}

const SAMPLING: Sampling = Sampling { samples: 64, seed: 3 };

fn material<R: Real>(r: R) -> MaterialIn<R> {
    MaterialIn { albedo: V3([0.6, 0.3, 0.1].map(R::of)), roughness: r, metallic: R::of(0.3) }
}

fn close(a: f64, b: f64, tolerance: f64, what: &str) {
    assert!((a - b).abs() <= tolerance * (1.0 + a.abs().max(b.abs())), "{what}: {a} against {b}");
}

#[test]
fn the_authors_gradient_is_the_derivative_of_their_estimator() {
    let (mesh, tbl) = (box_room(), patchy_light());
    let light = Lighting { tracer: &BruteForce(&mesh), radiance: &tbl, environment: None };
    for view in views() {
        for r in [0.1, 0.3, 0.7] {
            let d = shade(&light, &point(view), &material(Dual::variable(r)), SAMPLING, RoughnessGradient::Authors);
            for c in 0..3 {
                close(d.roughness_jacobian.0[c].re, d.radiance.0[c].du, 1e-9, "dL/dr");
            }
        }
    }
}

/// L_o(r') by the samples and densities of r: the detached estimator, written out from the BRDF's value and density.
fn detached<R: Real>(light: &Lighting<'_, BruteForce<'_>>, point: &ShadePoint, r: f64, moved: R) -> V3<R> {
    let (n, v) = (V3::<f64>::of(point.normal), V3::<f64>::of(point.view));
    let Frame { tangent: t, bitangent: b, .. } = Frame::of(n);
    let f0 = brdf::f0(material(moved).albedo, R::of(0.3));
    let mut sum = V3::zero();
    for i in 0..SAMPLING.samples {
        let [u1, u2] = sobol2(i, hash2(SAMPLING.seed, point.index)).map(f64::from);
        let cos = brdf::sample_half_vector(u1, r)[1];
        let (sin, phi) = ((1.0 - cos * cos).sqrt(), std::f64::consts::TAU * u2);
        let h = t * (sin * phi.cos()) + b * (sin * phi.sin()) + n * cos;
        let vh = v.dot(h);
        let l = h * (2.0 * vh) - v;
        if n.dot(l) <= 0.0 || vh <= 0.0 {
            continue;
        }
        let at = brdf::Cosines { nl: n.dot(l), nv: n.dot(v), nh: cos, vh };
        let moving = brdf::Cosines { nl: R::of(at.nl), nv: R::of(at.nv), nh: R::of(at.nh), vh: R::of(at.vh) };
        let x = R::of(brdf::fresnel_weight(vh));
        let value =
            brdf::specular_over_fresnel(Masking::Schlick, &moving, moved) * R::of(at.nl / brdf::pdf(&at, r) / 64.0);
        let incoming = light.incoming(V3::<f64>::of(point.position), l).map(R::of);
        sum = sum + f0.map(|f| f * (R::of(1.0) - x) + x).hadamard(incoming) * value;
    }
    sum
}

#[test]
fn the_exact_gradient_is_that_of_the_detached_estimator() {
    let (mesh, tbl) = (box_room(), patchy_light());
    let light = Lighting { tracer: &BruteForce(&mesh), radiance: &tbl, environment: None };
    let mut differs = false;
    for view in views() {
        for r in [0.1, 0.3, 0.7] {
            let expected = detached(&light, &point(view), r, Dual::variable(r));
            let got = shade(&light, &point(view), &material(r), SAMPLING, RoughnessGradient::Exact);
            let biased = shade(&light, &point(view), &material(r), SAMPLING, RoughnessGradient::Authors);
            for c in 0..3 {
                close(got.roughness_jacobian.0[c], expected.0[c].du, 1e-6, "dL/dr");
                // Negative control: the authors' estimator is another one.
                differs |= (biased.roughness_jacobian.0[c] - expected.0[c].du).abs() > 0.1;
            }
        }
    }
    assert!(differs);
}

#[test]
fn shade_vjp_is_the_transposed_derivative() {
    let (mesh, tbl) = (box_room(), patchy_light());
    let light = Lighting { tracer: &BruteForce(&mesh), radiance: &tbl, environment: None };
    let delta = V3([0.7, -1.3, 0.4]);
    for view in views() {
        let p = point(view);
        let gradient = RoughnessGradient::Authors;
        let shaded: ShadedIn<f64> = shade(&light, &p, &material(0.4), SAMPLING, gradient);
        let d = shade_vjp(&p, &material(0.4), &shaded, delta);
        let along = |m: MaterialIn<Dual>| {
            let s = shade(&light, &p, &m, SAMPLING, gradient);
            (0..3).map(|c| s.radiance.0[c].du * delta.0[c]).sum::<f64>()
        };
        for c in 0..3 {
            let mut m = material(Dual::of(0.4));
            m.albedo.0[c] = Dual::variable(m.albedo.0[c].re);
            close(d.albedo.0[c], along(m), 1e-9, "d_albedo");
        }
        close(d.roughness, along(material(Dual::variable(0.4))), 1e-9, "d_roughness");
        let m = material(Dual::of(0.4));
        close(d.metallic, along(MaterialIn { metallic: Dual::variable(0.3), ..m }), 1e-9, "d_metallic");
    }
}

#[test]
fn radiance_loss_gradient_against_dual_numbers() {
    let (rendered, target) = ([0.3, 2.0, 0.9], [0.5, 1.0, 0.9001]);
    let (_, d) = radiance_loss(V3(rendered), V3(target), 0.25);
    for c in 0..3 {
        let mut dual = V3(rendered.map(Dual::of));
        dual.0[c] = Dual::variable(rendered[c]);
        let (loss, _) = radiance_loss(dual, V3(target.map(Dual::of)), Dual::of(0.25));
        close(d.0[c], loss.du, 1e-12, "d_rendered");
    }
}

#[test]
fn group_loss_gradient_against_dual_numbers() {
    let values: Vec<f64> = (0..24).map(|i| f64::from(hash(i)) / f64::from(u32::MAX)).collect();
    let groups = Groups {
        offsets: vec![0, 5, 5, 11],
        members: vec![0, 2, 4, 6, 7, 1, 3, 5, 8, 9, 10],
        references: vec![2, 0, 3],
    };
    for target in [GroupTarget::Mean, GroupTarget::Quantile(0.4)] {
        let mut gradient = vec![0.0; values.len()];
        group_loss(&values, 2, &groups, target, &mut gradient);
        for i in 0..values.len() {
            let pixel = (i / 2) as u32;
            let position = groups.members.iter().position(|&m| m == pixel);
            // The quantile is held fixed: references move it, so the total derivative differs for them by design.
            let reference = matches!(position, Some(0 | 1 | 5 | 6 | 7));
            if matches!(target, GroupTarget::Quantile(_)) && reference {
                assert_eq!(gradient[i], 0.0);
                continue;
            }
            let mut dual: Vec<Dual> = values.iter().map(|&v| Dual::of(v)).collect();
            dual[i] = Dual::variable(values[i]);
            let mut unused = vec![Dual::of(0.0); dual.len()];
            let loss = group_loss(&dual, 2, &groups, target, &mut unused);
            close(gradient[i], loss.du, 1e-12, "d_value");
        }
    }
}

#[test]
fn lookup_vjp_is_the_transpose_of_lookup() {
    let valid: Vec<bool> = (0..15).map(|i| i % 4 != 3).collect();
    let pyramid = Pyramid::new(5, 3, &valid);
    let taps = |pixel: u32| {
        let texels: Vec<usize> = (0..pyramid.len())
            .filter(|&t| pyramid.coverage[t] > 0.0 && hash2(pixel, t as u32).is_multiple_of(3))
            .collect();
        texels.iter().map(|&t| Tap { texel: t as u32, weight: 1.0 / (1.0 + t as f32) }).collect()
    };
    let footprints = Footprints::new(SparseRows::from_lists((0..7).map(taps)));
    let random = |n: usize, s: u32| -> Vec<f64> {
        (0..n as u32).map(|i| f64::from(hash2(i, s)) / f64::from(u32::MAX) - 0.5).collect()
    };
    let (x, y) = (random(30, 1), random(14, 2));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let forward = dot(&y, &lookup(&pyramid, &x, 2, &footprints.rows));
    let backward = dot(&lookup_vjp(&pyramid, &y, 2, &footprints), &x);
    assert!(forward.abs() > 1e-3);
    close(forward, backward, 1e-12, "⟨y, Ax⟩ = ⟨Aᵀy, x⟩");
    // A constant texture stays constant at every level, holes or not.
    let ones = super::lookup::reduce(&pyramid, &[1.0f64; 15], 1, usize::MAX);
    assert_eq!(ones.len(), pyramid.len() - 15);
    for (value, &coverage) in ones.iter().zip(&pyramid.coverage[15..]) {
        close(*value, if coverage > 0.0 { 1.0 } else { 0.0 }, 1e-6, "mean of ones");
    }
}

#[test]
fn a_closed_box_of_constant_radiance_is_a_furnace() {
    let scene = Arc::new(Scene::new(box_room()).unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    backend.set_tbl(&Rgb::filled(4, 4, [2.0, 1.0, 0.5]), &Lights::none(scene.mesh())).unwrap();
    let hits = backend.texels([24, 8], 0..8).unwrap();
    let points: Vec<SurfacePoint> =
        hits.iter().flatten().map(|h| SurfacePoint::new(scene.mesh(), &h.hit(), None)).collect();
    assert!(points.len() > 100);
    for g in backend.irradiance(&points, Gather::new(64, 64, 3), &Silent).unwrap() {
        let e = g.irradiance;
        assert_eq!(g.back_faces, 0.0);
        close(f64::from(e[0]), std::f64::consts::TAU, 1e-5, "E = πL");
        close(f64::from(e[2]), std::f64::consts::FRAC_PI_2, 1e-5, "E = πL");
    }
}

#[test]
fn a_smooth_conductor_in_a_furnace_reflects_its_f0() {
    let (mesh, tbl) = (box_room(), Rgb::filled(4, 4, [1.0; 3]));
    let light = Lighting { tracer: &BruteForce(&mesh), radiance: &tbl, environment: None };
    let mirror = MaterialIn { albedo: V3([1.0, 0.7, 0.2]), roughness: 0.02, metallic: 1.0 };
    let p = point(Vec3::new(0.0, 0.05, 1.0));
    let got: ShadedIn<f64> = shade(&light, &p, &mirror, SAMPLING, RoughnessGradient::Exact);
    for (c, expected) in [1.0, 0.7, 0.2].into_iter().enumerate() {
        close(got.radiance.0[c], expected, 2e-3, "furnace");
    }
}

#[test]
fn obvhs_and_the_exhaustive_search_agree() {
    let scene = Arc::new(Scene::new(box_room()).unwrap());
    let exhaustive = BruteForce(scene.mesh());
    for i in 0..500 {
        let [u, v] = sobol2(i, 1);
        let d = V3([u - 0.5, v - 0.5, sobol2(i, 2)[0] - 0.5]).normalize();
        let origin = V3([0.3f32, 0.6, 0.4]);
        let fast: TraceHit<f32> = scene.closest(origin, d).unwrap();
        let slow: TraceHit<f32> = exhaustive.closest(origin, d).unwrap();
        close(f64::from(fast.t), f64::from(slow.t), 1e-5, "distance");
    }
}

/// The mean over points of E by light sampling against that by the cosine alone, for a room with one bright patch.
#[test]
fn light_samples_change_the_noise_and_not_the_mean() {
    let scene = Arc::new(Scene::new(box_room()).unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, [24, 8]).unwrap();
    // The ceiling (+Z wall, last sixth) shines.
    let mut tbl = Rgb::filled(24, 8, [0.1; 3]);
    for (i, texel) in tbl.data.iter_mut().enumerate() {
        if i % 24 >= 20 {
            *texel = [5.0 + (i % 3) as f32; 3];
        }
    }
    let lights = Lights::find(&scene, &atlas, &tbl).unwrap();
    assert_eq!(lights.members.len(), 2);
    backend.set_tbl(&tbl, &lights).unwrap();
    let mut gather = |cosine, light, seed| -> Vec<f64> {
        let all = backend.irradiance(&atlas.points, Gather::new(cosine, light, seed), &Silent).unwrap();
        all.iter().map(|g| f64::from(g.irradiance[0])).collect()
    };
    let truth = gather(16_384, 0, 1);
    let error = |e: &[f64]| {
        let ratios: Vec<f64> = e.iter().zip(&truth).map(|(e, t)| e / t - 1.0).collect();
        let n = ratios.len() as f64;
        (ratios.iter().sum::<f64>() / n, (ratios.iter().map(|r| r * r).sum::<f64>() / n).sqrt())
    };
    let (bias, rms) = error(&gather(32, 32, 2));
    let (_, plain) = error(&gather(64, 0, 2));
    assert!(bias.abs() < 0.004, "bias {bias}");
    assert!(rms < 0.7 * plain, "{rms} against {plain} by the cosine alone");
    // Negative control: a density that is not that of the samples is a bias that this test sees.
    let mut wrong = lights;
    wrong.parts.iter_mut().for_each(|light| light.pdf_area *= 0.8);
    backend.set_tbl(&tbl, &wrong).unwrap();
    let all = backend.irradiance(&atlas.points, Gather::new(32, 32, 2), &Silent).unwrap();
    let biased: Vec<f64> = all.iter().map(|g| f64::from(g.irradiance[0])).collect();
    assert!(error(&biased).0.abs() > 0.004, "{}", error(&biased).0);
}

#[test]
fn an_atlas_that_all_triangles_fill_is_an_error_before_it_fills_the_memory() {
    let uvs = vec![Vec2::ZERO, Vec2::X, Vec2::ONE];
    let mesh = Mesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::ONE],
        normals: vec![Vec3::Z; 3],
        uvs,
        triangles: vec![[0, 1, 2]; 100_000],
    };
    // 128² tiles, each with all triangles.
    let error = super::texels::TileBins::new(&mesh, [2048, 2048], 0..2048).unwrap_err().to_string();
    assert!(error.contains("lie over each other"), "{error}");
}
