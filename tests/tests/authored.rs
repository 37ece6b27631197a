//! Authored scenes: the solver against the analytic series and a path tracer, the loader against what it was given.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{Mat4, Vec2, Vec3};
use serde_json::json;
use texir_core::atlas::Atlas;
use texir_core::authored::{BounceAlbedo, Bounces, Model, Surfaces, irradiance, read_gltf, write_lightmapped_glb};
use texir_core::backend::{Backend, Gather};
use texir_core::bake::{Baked, Buried, Denoiser, PADDING, Quality, Texels};
use texir_core::brdf::Masking;
use texir_core::checkpoint::Checkpoints;
use texir_core::cpu::CpuBackend;
use texir_core::cpu::sampling::{Frame, cosine_direction};
use texir_core::environment::Environment;
use texir_core::mesh_io::atlas_report;
use texir_core::progress::Silent;
use texir_core::punctual::PunctualLight;
use texir_core::raster::Rgb;
use texir_core::real::V3;
use texir_core::rng::hash2;
use texir_core::scene::Scene;
use texir_core::scene::trace::{BruteForce, Trace};
use texir_core::specular_albedo::specular_albedo;
use texir_core::surface::SurfacePoint;
use texir_gpu::GpuBackend;
use texir_tests::compare::Tolerance;
use texir_tests::gltf::Document;
use texir_tests::{gpu, scenes};

const QUALITY: Quality = Quality { gather: Gather::new(32, 32, 3), error: None, denoise: Some(Denoiser::Regression) };
const BOUNCES: Bounces = Bounces { quality: QUALITY, tolerance: 1e-3, max_bounces: 64 };

/// What was solved, in memory.
struct Lit {
    baked: Baked,
    series: Vec<f64>,
    remainder: f64,
}

fn solve(backend: &mut dyn Backend, atlas: &Atlas, surfaces: &Surfaces, bounces: &Bounces) -> Lit {
    let (texels, none) = (Texels::of(atlas), Checkpoints::none());
    let solved = irradiance(backend, &texels, surfaces, bounces, &none, &Silent).unwrap();
    Lit { baked: solved.solution.into_baked().unwrap(), series: solved.series, remainder: solved.remainder.total }
}

#[test]
fn a_closed_box_is_a_furnace_bounce_by_bounce() {
    let mut builder = scenes::Builder::default();
    builder.cuboid(Vec3::ZERO, Vec3::new(3.0, 2.0, 4.0), true);
    let scene = Arc::new(Scene::new(builder.finish()).unwrap());
    let (albedo, emission) = ([0.6, 0.3, 0.1], [2.0f32, 1.0, 0.5]);
    let gpu = gpu();
    let backends: [Box<dyn Backend>; 2] =
        [Box::new(GpuBackend::new(&gpu, scene.clone()).unwrap()), Box::new(CpuBackend::new(scene.clone()))];
    for mut backend in backends {
        let atlas = Atlas::new(backend.as_mut(), [96, 96]).unwrap();
        let surfaces = Surfaces {
            albedo: Rgb::filled(96, 96, albedo),
            emission: Rgb::filled(96, 96, emission),
            lights: vec![],
            environment: None,
        };
        // E = π Le Σ_{j ≤ k} ρ^j after k bounces, at every texel.
        let series = |bounces: usize| {
            [0, 1, 2].map(|c| {
                let powers = (0..=bounces).map(|j| f64::from(albedo[c]).powi(j as i32));
                PI * f64::from(emission[c]) * powers.sum::<f64>()
            })
        };
        let lanes = |solved: &Lit| -> Vec<f64> {
            (solved.baked.irradiance.iter().zip(&atlas.inside))
                .filter(|(_, inside)| **inside)
                .flat_map(|(e, _)| e.map(f64::from))
                .collect()
        };
        let tight = Tolerance { absolute: 0.0, relative: 2e-4 };
        for most in [0, 1, 2, 4] {
            let solved =
                solve(backend.as_mut(), &atlas, &surfaces, &Bounces { max_bounces: most, tolerance: 0.0, ..BOUNCES });
            let got = lanes(&solved);
            let expected: Vec<f64> = series(most as usize).into_iter().cycle().take(got.len()).collect();
            tight.check(&format!("{}, {most} bounces", backend.name()), &got, &expected);
            // Negative control: a bounce more would be noticed.
            let more: Vec<f64> = series(most as usize + 1).into_iter().cycle().take(got.len()).collect();
            assert!(tight.failures(&got, &more).len() > got.len() / 2);
            assert_eq!(solved.series.len(), most as usize + 1);
        }
        let solved = solve(backend.as_mut(), &atlas, &surfaces, &BOUNCES);
        let closed: f64 = (0..3).map(|c| PI * f64::from(emission[c] / (1.0 - albedo[c]))).sum::<f64>() / 3.0;
        let sum: f64 = solved.series.iter().sum();
        assert!(solved.remainder <= 1e-3 && (sum / closed - 1.0).abs() < 1.5e-3, "{sum} of {closed}");
    }
}

#[test]
fn a_dim_room_beside_a_sunlit_yard_has_all_of_its_light() {
    let mut builder = scenes::Builder::default();
    builder.cuboid(Vec3::ZERO, Vec3::new(3.0, 2.0, 4.0), true);
    builder.quad([Vec3::ZERO, Vec3::Z, Vec3::Z + Vec3::X, Vec3::X].map(|p| 20.0 * p + 50.0 * Vec3::X), [Vec3::Y; 4]);
    let mut backend = CpuBackend::new(Scene::new(builder.finish()).unwrap());
    let atlas = Atlas::new(&mut backend, [96, 96]).unwrap();
    let (albedo, emission) = (0.8, 1.0);
    let in_yard = |point: &SurfacePoint| point.position[0] > 40.0;
    let glows: Vec<[f32; 3]> =
        atlas.points.iter().map(|point| [if in_yard(point) { 0.0 } else { emission }; 3]).collect();
    let surfaces = Surfaces {
        albedo: Rgb::filled(96, 96, [albedo; 3]),
        emission: atlas.scatter_padded(&glows, &vec![true; glows.len()], [0.0; 3], PADDING).unwrap(),
        lights: vec![PunctualLight::Distant { direction: [0.0, -1.0, 0.0], irradiance: [1e5; 3] }],
        environment: None,
    };
    let tolerance = 5e-3;
    let solved = solve(&mut backend, &atlas, &surfaces, &Bounces { tolerance, ..BOUNCES });
    let room = solved.baked.irradiance.iter().zip(&atlas.points).filter(|(_, point)| !in_yard(point));
    let (sum, count) = room.fold((0.0, 0.0), |(sum, count), (e, _)| (sum + f64::from(e[0]), count + 1.0));
    let expected = PI * f64::from(emission / (1.0 - albedo));
    assert!((sum / count / expected - 1.0).abs() < 0.025, "{} for {expected}", sum / count);
    // Negative control: by the mean over the map, the first bounce would have been the last.
    let [direct, first, ..] = solved.series[..] else { panic!("{:?}", solved.series) };
    assert!(first / direct < f64::from(tolerance) && solved.series.len() > 5, "{:?}", solved.series);
}

#[test]
fn a_sky_lights_once_and_bounces_on() {
    // Two open planes that face each other would be noisy; one plane reflects nothing back to itself: E = πL exactly.
    let mut builder = scenes::Builder::default();
    builder.quad([Vec3::ZERO, Vec3::Z, Vec3::Z + Vec3::X, Vec3::X], [Vec3::Y; 4]);
    let mut backend = CpuBackend::new(Scene::new(builder.finish()).unwrap());
    let atlas = Atlas::new(&mut backend, [32, 32]).unwrap();
    let surfaces = Surfaces {
        albedo: Rgb::filled(32, 32, [0.9; 3]),
        emission: Rgb::filled(32, 32, [0.0; 3]),
        lights: vec![],
        environment: Some(Environment::constant([1.0, 2.0, 3.0]).unwrap()),
    };
    let solved = solve(&mut backend, &atlas, &surfaces, &BOUNCES);
    let expected: Vec<f64> = solved.baked.irradiance.iter().flat_map(|_| [PI, 2.0 * PI, 3.0 * PI]).collect();
    let got: Vec<f64> = solved.baked.irradiance.iter().flatten().map(|v| f64::from(*v)).collect();
    Tolerance { absolute: 0.0, relative: 1e-5 }.check("E", &got, &expected);
    assert_eq!((solved.series.len(), solved.remainder), (2, 0.0), "the second bounce is black, and the last");
}

/// A Cornell box as glTF: open in front, two turned boxes, a lamp under the ceiling; every other of its quads
/// `upside_down`, of double-sided materials but for the lamp's, or all as they should be. `(document, albedo by
/// material)`.
fn cornell(upside_down: bool) -> (Document, [[f32; 3]; 4]) {
    const ALBEDO: [[f32; 3]; 4] = [[0.73; 3], [0.65, 0.05, 0.05], [0.12, 0.45, 0.15], [0.0; 3]];
    let mut document = Document::default();
    let [white, red, green, lamp] =
        [0, 1, 2, 3].map(|m| document.material(ALBEDO[m], if m == 3 { [17.0, 12.0, 4.0] } else { [0.0; 3] }));
    if upside_down {
        [white, red, green].into_iter().for_each(|material| document.show_both_sides(material));
    }
    let mut turns = 0;
    let mut quad = |[a, b, c, d]: [Vec3; 4], material: usize, place: Mat4| {
        let may_turn = upside_down && material != lamp;
        turns += u32::from(may_turn);
        let corners = if may_turn && turns % 2 == 1 { [a, d, c, b] } else { [a, b, c, d] };
        document.quad(corners, material, place, &[]);
    };
    let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let (l, r, b, t, n, f) = (-1.0, 1.0, 0.0, 2.0, 1.0, -1.0);
    let here = Mat4::IDENTITY;
    quad([at(l, b, f), at(l, b, n), at(r, b, n), at(r, b, f)], white, here);
    quad([at(l, t, f), at(r, t, f), at(r, t, n), at(l, t, n)], white, here);
    quad([at(l, b, f), at(r, b, f), at(r, t, f), at(l, t, f)], white, here);
    quad([at(l, b, f), at(l, t, f), at(l, t, n), at(l, b, n)], red, here);
    quad([at(r, b, f), at(r, b, n), at(r, t, n), at(r, t, f)], green, here);
    let (s, y) = (0.3, 1.95);
    quad([at(-s, y, -s), at(s, y, -s), at(s, y, s), at(-s, y, s)], lamp, here);
    for (x, z, turn, height) in [(-0.35, -0.3, 0.3, 1.2), (0.35, 0.35, -0.3, 0.6)] {
        let place = Mat4::from_translation(at(x, 0.0, z)) * Mat4::from_rotation_y(turn);
        let place = place * Mat4::from_scale(at(0.6, height, 0.6));
        let h = 0.5;
        quad([at(-h, 1.0, -h), at(-h, 1.0, h), at(h, 1.0, h), at(h, 1.0, -h)], white, place);
        for side in 0..4 {
            let side = place * Mat4::from_rotation_y(side as f32 * std::f32::consts::FRAC_PI_2);
            quad([at(-h, 0.0, h), at(h, 0.0, h), at(h, 1.0, h), at(-h, 1.0, h)], white, side);
        }
    }
    (document, ALBEDO)
}

/// Reads a document through its file.
fn load(document: &Document, size: usize) -> Model {
    load_reflecting(document, size, BounceAlbedo::Diffuse)
}

fn load_reflecting(document: &Document, size: usize, reflected: BounceAlbedo) -> Model {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    document.write(&path);
    read_gltf(&path, size, reflected, &Silent).unwrap()
}

/// A path tracer in f64 without hierarchy, lightmap or bias: E(x) = D(x) + ρ(x₁) E(x₁), x₁ met by a cosine-distributed
/// ray, D from a random point of the lamp.
struct Twin<'a> {
    exact: BruteForce<'a>,
    /// By triangle.
    albedo: Vec<[f32; 3]>,
    /// The lamp's two triangles, of one area.
    lamp: [u32; 2],
    emission: [f64; 3],
}

impl Twin<'_> {
    fn irradiance(&self, point: &SurfacePoint, seed: u32, paths: u32) -> [f64; 3] {
        let mut counter = 0;
        let mut random = || {
            counter += 1;
            (f64::from(hash2(seed, counter)) + 0.5) / 4_294_967_296.0
        };
        let mut sum = [0.0; 3];
        for _ in 0..paths {
            let (mut weight, mut at) = ([1.0; 3], *point);
            for _ in 0..40 {
                let direct = self.direct(&at, &mut random);
                (0..3).for_each(|c| sum[c] += weight[c] * direct[c]);
                let n = V3::<f64>::of(at.normal);
                let direction = Frame::of(n).to_world(cosine_direction([random() as f32, random() as f32]));
                let Some(hit) = self.exact.closest(V3::of(at.position), direction) else { break };
                let towards = -Vec3::from(direction.to_f32());
                let found = texir_core::surface::Hit {
                    triangle: hit.triangle,
                    u: hit.u as f32,
                    v: hit.v as f32,
                    t: hit.t as f32,
                };
                at = SurfacePoint::new(self.exact.0, &found, Some(towards));
                (0..3).for_each(|c| weight[c] *= f64::from(self.albedo[hit.triangle as usize][c]));
                if weight.iter().all(|w| *w < 1e-4) {
                    break;
                }
            }
        }
        sum.map(|v| v / f64::from(paths))
    }

    fn direct(&self, at: &SurfacePoint, random: &mut impl FnMut() -> f64) -> [f64; 3] {
        let triangle = self.lamp[usize::from(random() < 0.5)];
        let (root, v) = (random().sqrt(), random());
        let [a, b, c] = self.exact.0.corners(triangle).map(|p| V3::<f64>::of(p.to_array()));
        let target = a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v);
        let area = 2.0 * 0.5 * (b - a).cross(c - a).dot((b - a).cross(c - a)).sqrt();
        let way = target - V3::of(at.position);
        let d2 = way.dot(way);
        let direction = way * (1.0 / d2.sqrt());
        let cosine = V3::of(at.normal).dot(direction);
        let facing = -(b - a).cross(c - a).normalize().dot(direction);
        let seen = || {
            let hit = Trace::<f64>::closest(&self.exact, V3::of(at.position), direction);
            hit.is_some_and(|hit| self.lamp.contains(&hit.triangle))
        };
        if cosine > 0.0 && facing > 0.0 && seen() {
            self.emission.map(|l| l * cosine * facing * area / d2)
        } else {
            [0.0; 3]
        }
    }
}

#[test]
fn a_cornell_box_is_lit_as_a_path_tracer_lights_it() {
    let (document, albedo) = cornell(false);
    lit_as_by_a_path_tracer(&load(&document, 128), albedo);
}

#[test]
fn a_cornell_box_of_double_sided_quads_is_lit_whichever_way_these_are_turned() {
    let (document, albedo) = cornell(true);
    let mut model = load(&document, 128);
    let fronts = model.mesh.triangles.clone();
    let told = model.find_sides(None, &Silent).unwrap().unwrap();
    assert!(told.contains("in 8 primitives"), "{told}");
    assert_eq!(model.size, model.lightmap_size());
    assert_eq!(model.mesh.triangles.iter().zip(&fronts).filter(|(turned, front)| turned != front).count(), 16);
    lit_as_by_a_path_tracer(&model, albedo);
}

/// Bakes a Cornell box beside the path tracer.
fn lit_as_by_a_path_tracer(model: &Model, albedo: [[f32; 3]; 4]) {
    let scene = Arc::new(model.scene().unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, model.size).unwrap();
    let surfaces = model.surfaces(&mut backend, &Texels::of(&atlas), None).unwrap();
    let gather = Gather::new(48, 48, 1);
    let bounces = Bounces { quality: Quality { gather, denoise: None, ..QUALITY }, ..BOUNCES };
    let solved = solve(&mut backend, &atlas, &surfaces, &bounces);
    let denoised =
        solve(&mut backend, &atlas, &surfaces, &Bounces { quality: Quality { gather, ..QUALITY }, ..BOUNCES });

    // Two triangles per quad, in the order of the document: floor, ceiling, back, red, green, lamp, boxes.
    let material = |t: u32| [0, 0, 0, 1, 2, 3].get(t as usize / 2).copied().unwrap_or(0);
    let triangles = scene.mesh().triangles.len() as u32;
    let twin = Twin {
        exact: BruteForce(scene.mesh()),
        albedo: (0..triangles).map(|t| albedo[material(t)]).collect(),
        lamp: [10, 11],
        emission: [17.0, 12.0, 4.0],
    };
    let fair = |i: &usize| atlas.inside[*i] && !solved.baked.buried[*i] && atlas.points[*i].triangle / 2 != 5;
    let chosen: Vec<usize> = (0..atlas.texels.len()).filter(fair).collect();
    let chosen: Vec<usize> = chosen.iter().copied().step_by(chosen.len() / 110).collect();
    let reference: Vec<[f64; 3]> = chosen.iter().map(|&i| twin.irradiance(&atlas.points[i], i as u32, 1000)).collect();
    for c in 0..3 {
        let pairs = || chosen.iter().zip(&reference).map(|(&i, r)| (f64::from(solved.baked.irradiance[i][c]), r[c]));
        let (got, expected) = pairs().fold((0.0, 0.0), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1));
        assert!((got / expected - 1.0).abs() < 0.01, "channel {c}: {got} where the path tracer finds {expected}");
        let mut errors: Vec<f64> = pairs().map(|(got, expected)| (got / expected - 1.0).abs()).collect();
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        assert!(median < 0.04, "channel {c}: the median error is {median}");
    }
    // Texels are 5 cm wide: a denoiser that flattens what is curved over ten of them takes light at every bounce.
    let light = |solved: &Lit| (0..atlas.texels.len()).filter(fair).map(|i| solved.baked.irradiance[i][1]).sum::<f32>();
    let kept = light(&denoised) / light(&solved);
    assert!((kept - 1.0).abs() < 0.01, "denoising keeps {kept} of the light");
    // Negative control: without the bounces it is darker by far more than the tolerance.
    let direct = solve(&mut backend, &atlas, &surfaces, &Bounces { max_bounces: 0, ..bounces });
    assert!(direct.series[0] < 0.9 * solved.series.iter().sum::<f64>());
}

/// A leaf in the light of two lamps, one on either side, above a floor: of one double-sided quad, or of two that face
/// opposite ways.
fn leaf(is_double_sided: bool, emission: [f32; 3]) -> Document {
    let mut document = Document::default();
    let [floor, green] =
        [([0.7, 0.7, 0.7], [0.0; 3]), ([0.3, 0.8, 0.1], emission)].map(|(a, e)| document.material(a, e));
    document.quad(SQUARE.map(|p| 4.0 * p - Vec3::new(2.0, 0.0, 2.0)), floor, Mat4::IDENTITY, &[]);
    let place = Mat4::from_translation(0.6 * Vec3::Y) * Mat4::from_rotation_x(0.4);
    let [a, b, c, d] = SQUARE.map(|p| 1.4 * p - Vec3::new(0.7, 0.0, 0.7));
    document.quad([a, b, c, d], green, place, &[]);
    if is_double_sided {
        document.show_both_sides(green);
    } else {
        document.quad([a, d, c, b], green, place, &[]);
    }
    for (x, y) in [(0.2, 1.8), (1.5, 0.3)] {
        let light = json!({ "type": "point", "intensity": 20.0 });
        document.light(light, Mat4::from_translation(Vec3::new(x, y, 0.1)));
    }
    document
}

/// The mean light on the floor and on the upper side of the leaf.
fn on_floor_and_leaf(model: &Model) -> [Vec3; 2] {
    let mut backend = CpuBackend::new(model.scene().unwrap());
    let atlas = Atlas::new(&mut backend, model.size).unwrap();
    let texels = Texels::of(&atlas);
    let surfaces = model.surfaces(&mut backend, &texels, None).unwrap();
    let quality = Quality { gather: Gather::new(64, 64, 1), error: None, denoise: None };
    let bounces = Bounces { quality, tolerance: 1e-3, max_bounces: 16 };
    let solved = irradiance(&mut backend, &texels, &surfaces, &bounces, &Checkpoints::none(), &Silent).unwrap();
    // The lightmap is cut from the map that was baked.
    let lightmap = model.lightmap(&solved.solution, &texels, Buried::Keep).unwrap();
    assert_eq!(lightmap.size(), model.lightmap_size());
    let mut sums = [(Vec3::ZERO, 0.0); 2];
    for (point, texel) in atlas.points.iter().zip(&atlas.texels) {
        let of = point.triangle as usize / 2;
        if let Some(sum) = sums.get_mut(of).filter(|_| point.normal[1] > 0.0) {
            *sum = (sum.0 + Vec3::from(lightmap.data[*texel as usize]), sum.1 + 1.0);
        }
    }
    sums.map(|(sum, count)| sum / count)
}

#[test]
fn a_double_sided_sheet_is_as_two_that_face_opposite_ways() {
    for emission in [[0.0; 3], [1.0, 3.0, 8.0]] {
        let mut one = load(&leaf(true, emission), 96);
        let alone = on_floor_and_leaf(&one);
        assert_eq!(one.find_sides(None, &Silent).unwrap(), None);
        assert_eq!(one.size[1], 2 * one.lightmap_size()[1]);
        let (both, two) = (on_floor_and_leaf(&one), on_floor_and_leaf(&load(&leaf(false, emission), 96)));
        for (both, two) in both.iter().zip(&two) {
            assert!((both / two - 1.0).abs().max_element() < 0.01, "{both} where two sheets have {two}");
        }
        // Negative control: from below it would reflect nothing.
        assert!((alone[0] / two[0] - 1.0).abs().max_element() > 0.03, "{} and {}", alone[0], two[0]);
    }
}

#[test]
fn the_baked_scene_has_the_same_coordinates_whatever_sides_are_baked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    leaf(true, [0.0; 3]).write(&path);
    let mut model = read_gltf(&path, 96, BounceAlbedo::Diffuse, &Silent).unwrap();
    let written = |model: &Model| {
        let baked = folder.path().join("baked.glb");
        write_lightmapped_glb(&baked, &path, model, None).unwrap();
        std::fs::read(baked).unwrap()
    };
    let before = written(&model);
    model.find_sides(None, &Silent).unwrap();
    assert_eq!(model.mesh.triangles.len(), 6);
    assert!(written(&model) == before);
}

/// Corners of a unit square in the ground, facing +Y, and coordinates of a part of the unit square.
const SQUARE: [Vec3; 4] = [Vec3::ZERO, Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::X];

fn coordinates(low: f32, high: f32) -> [Vec2; 4] {
    [Vec2::splat(low), Vec2::new(low, high), Vec2::splat(high), Vec2::new(high, low)]
}

/// What a document of one square emits and reflects, as means over its texels.
fn square(material: serde_json::Value, image: Option<(usize, usize, Vec<[u8; 3]>)>) -> Surfaces {
    square_reflecting(material, image, BounceAlbedo::Diffuse)
}

fn square_reflecting(
    material: serde_json::Value,
    image: Option<(usize, usize, Vec<[u8; 3]>)>,
    reflected: BounceAlbedo,
) -> Surfaces {
    let mut document = Document::default();
    if let Some((width, height, pixels)) = image {
        document.image(width, height, pixels);
    }
    let material = document.raw_material(material);
    document.quad(SQUARE, material, Mat4::IDENTITY, &[coordinates(0.0, 1.0)]);
    let model = load_reflecting(&document, 16, reflected);
    let mut backend = CpuBackend::new(model.scene().unwrap());
    let atlas = Atlas::new(&mut backend, [16, 16]).unwrap();
    model.surfaces(&mut backend, &Texels::of(&atlas), None).unwrap()
}

#[test]
fn materials_mean_what_the_specification_says() {
    let plain = square(json!({ "emissiveFactor": [0.5, 1.0, 0.25] }), None);
    assert_eq!((plain.emission.data[40], plain.albedo.data[40]), ([0.5, 1.0, 0.25], [1.0; 3]));
    let strength = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 40.0 } });
    let strong = square(json!({ "emissiveFactor": [0.5, 1.0, 0.25], "extensions": strength }), None);
    assert_eq!(strong.emission.data[40], [20.0, 40.0, 10.0]);
    // sRGB 188 is 0.5029 linear; the factor is linear already. Left half dark, right half bright.
    let image = (2, 1, vec![[0, 0, 0], [188, 255, 188]]);
    let base = json!({
        "baseColorFactor": [0.5, 0.5, 1.0, 1.0], "baseColorTexture": { "index": 0 },
        "metallicFactor": 0.0
    });
    let textured = square(json!({ "pbrMetallicRoughness": base }), Some(image));
    let at = |x: usize| textured.albedo.data[8 * 16 + x];
    // Bilinear, and repeating: the middle of either half is the pixel itself.
    let right = [at(11), at(12)].map(Vec3::from);
    assert!(right.iter().all(|v| v.abs_diff_eq(Vec3::new(0.2514, 0.5, 0.5029), 0.05)), "{right:?}");
    let left = [at(3), at(4)].map(Vec3::from);
    assert!(left.iter().all(|v| v.max_element() < 0.1), "{left:?}");
}

#[test]
fn dielectrics_reflect_more_than_their_base_colour_where_that_is_asked_for() {
    let reflects = |[roughness, metal]: [f32; 2], image: Option<[u8; 3]>, reflected| {
        let mut base = json!({
            "baseColorFactor": [0.5, 0.25, 0.97, 1.0], "roughnessFactor": roughness, "metallicFactor": metal
        });
        if image.is_some() {
            base["metallicRoughnessTexture"] = json!({ "index": 0 });
        }
        let image = image.map(|pixel| (1, 1, vec![pixel]));
        square_reflecting(json!({ "pbrMetallicRoughness": base }), image, reflected).albedo.data[40]
    };
    let near = |found: [f32; 3], expected: [f32; 3]| {
        assert!(Vec3::from(found).abs_diff_eq(expected.into(), 1e-4), "{found:?} where {expected:?} is expected");
    };
    let specular = |roughness: f32| specular_albedo(Masking::Smith, roughness);
    near(reflects([0.2, 0.0], None, BounceAlbedo::Diffuse), [0.5, 0.25, 0.97]);
    near(
        reflects([0.2, 0.0], None, BounceAlbedo::DiffuseAndSpecular),
        [0.5 + specular(0.2), 0.25 + specular(0.2), 1.0],
    );
    near(
        reflects([1.0, 0.0], None, BounceAlbedo::DiffuseAndSpecular),
        [0.5, 0.25, 0.97].map(|colour| colour + specular(1.0)),
    );
    near(reflects([0.2, 1.0], None, BounceAlbedo::DiffuseAndSpecular), [0.5, 0.25, 0.97]);
    // The texture's green is how rough it is and its blue how much of a metal, as they stand: two fifths are 102, three
    // quarters 191, and not what sRGB makes of them. (Red says nothing.)
    let mixed = specular(0.2) * (1.0 - 191.0 / 255.0);
    let found = reflects([0.5, 1.0], Some([255, 102, 191]), BounceAlbedo::DiffuseAndSpecular);
    near(found, [0.5 + mixed, 0.25 + mixed, 0.97 + mixed]);
}

#[test]
fn a_point_light_above_a_plane_follows_the_square_law() {
    let mut document = Document::default();
    let white = document.material([0.5; 3], [0.0; 3]);
    document.quad(SQUARE, white, Mat4::from_scale(Vec3::splat(4.0)), &[coordinates(0.0, 1.0)]);
    let above = Mat4::from_translation(Vec3::new(2.0, 2.0, 2.0));
    document.light(json!({ "type": "point", "intensity": 100.0, "color": [1.0, 0.5, 0.0] }), above);
    let model = load(&document, 65);
    let mut backend = CpuBackend::new(model.scene().unwrap());
    let atlas = Atlas::new(&mut backend, [65, 65]).unwrap();
    let surfaces = model.surfaces(&mut backend, &Texels::of(&atlas), None).unwrap();
    let solved = solve(&mut backend, &atlas, &surfaces, &BOUNCES);
    let law = |x: f64, z: f64| {
        let d2 = (2.0 - x).powi(2) + 4.0 + (2.0 - z).powi(2);
        100.0 * 2.0 / d2.powf(1.5)
    };
    // A texel holds the mean over it; on the floor's diagonal that over a half, which is the same under this light.
    let mean = |p: &SurfacePoint| {
        let [x, _, z] = p.position.map(f64::from);
        let off = |i: i32| (f64::from(i % 8) - 3.5) / 8.0 * 4.0 / 65.0;
        let mean = (0..64).map(|i| law(x + off(i), z + off(i / 8))).sum::<f64>() / 64.0;
        [mean, 0.5 * mean, 0.0]
    };
    let expected: Vec<f64> = atlas.points.iter().flat_map(mean).collect();
    let got: Vec<f64> = solved.baked.irradiance.iter().flatten().map(|v| f64::from(*v)).collect();
    Tolerance { absolute: 1e-5, relative: 1e-4 }.check("I cosθ/d²", &got, &expected);
    let brightest = got.iter().copied().fold(0.0, f64::max);
    assert!((brightest - 25.0).abs() < 0.05, "100 cd at 2 m are 25 lx, not {brightest}");
    // A lamp that shines along its node's −Z, turned down, and one turned away.
    for (turn, lit) in [(-std::f32::consts::FRAC_PI_2, true), (std::f32::consts::FRAC_PI_2, false)] {
        let mut document = Document::default();
        document.quad(SQUARE, 0, Mat4::from_scale(Vec3::splat(4.0)), &[coordinates(0.0, 1.0)]);
        document.material([0.5; 3], [0.0; 3]);
        document.light(json!({ "type": "directional", "intensity": 3.0 }), Mat4::from_rotation_x(turn));
        let light = load(&document, 8).lights[0];
        let PunctualLight::Distant { direction, irradiance } = light else { panic!("{light:?}") };
        assert_eq!((direction[1] < -0.99, irradiance), (lit, [3.0; 3]), "{light:?}");
    }
}

#[test]
fn the_lightmap_takes_coordinates_that_do_not_overlap() {
    let two = |sets: [&[[Vec2; 4]]; 2]| {
        let mut document = Document::default();
        let white = document.material([0.5; 3], [1.0; 3]);
        document.quad(SQUARE, white, Mat4::IDENTITY, sets[0]);
        document.quad(SQUARE, white, Mat4::from_translation(Vec3::Y), sets[1]);
        document
    };
    let (whole, low, high) = (coordinates(0.0, 1.0), coordinates(0.05, 0.45), coordinates(0.55, 0.95));
    // The second set is its own, the first is shared.
    let second = load(&two([&[whole, low], &[whole, high]]), 64);
    assert_eq!(second.mesh.uvs[0], Vec2::splat(0.05));
    // Only the first is its own.
    let first = load(&two([&[low, whole], &[high, whole]]), 64);
    assert_eq!(first.mesh.uvs[0], Vec2::splat(0.05));
    assert_eq!(first.size, [64, 64]);
    // Neither, or none at all: unwrapped.
    for sets in [[&[whole, whole][..], &[whole, whole]], [&[], &[]]] {
        let model = load(&two(sets), 64);
        let report = atlas_report(&model.mesh, [512; 2]);
        assert!(report.covered_fraction > 0.3 && report.overlapping_fraction == 0.0, "{report:?}");
        assert_eq!(model.mesh.triangles.len(), 4);
        assert!(model.size[0] == 64 && model.size[1] <= 64, "{:?}", model.size);
    }
}

#[test]
fn the_baked_scene_keeps_its_materials_and_carries_the_lightmap() {
    let folder = tempfile::tempdir().unwrap();
    let (source, baked) = (folder.path().join("scene.gltf"), folder.path().join("baked.glb"));
    let mut document = Document::default();
    document.image(2, 1, vec![[0, 0, 0], [255, 255, 255]]);
    let material = json!({
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "roughnessFactor": 0.3 },
        "extensions": { "KHR_materials_clearcoat": { "clearcoatFactor": 0.7 } },
    });
    let material = document.raw_material(material);
    let whole = coordinates(0.0, 1.0);
    for height in [0.0, 1.0] {
        document.quad(SQUARE, material, Mat4::from_translation(Vec3::Y * height), &[whole]);
    }
    document.write(&source);
    let model = read_gltf(&source, 64, BounceAlbedo::Diffuse, &Silent).unwrap();
    let irradiance = Rgb::filled(64, 64, [3.0, 2.0, 1.0]);
    write_lightmapped_glb(&baked, &source, &model, Some(&irradiance)).unwrap();

    let again = read_gltf(&baked, 64, BounceAlbedo::Diffuse, &Silent).unwrap();
    assert_eq!((&again.mesh.uvs, &again.mesh.positions), (&model.mesh.uvs, &model.mesh.positions));
    let bytes = std::fs::read(&baked).unwrap();
    let json: serde_json::Value =
        serde_json::from_slice(&bytes[20..20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize])
            .unwrap();
    let material = &json["materials"][0];
    assert_eq!(material["pbrMetallicRoughness"]["roughnessFactor"].as_f64().map(|v| v as f32), Some(0.3));
    assert_eq!(material["extensions"]["KHR_materials_clearcoat"]["clearcoatFactor"], 0.7);
    let lightmap = &material["extensions"]["MOZ_lightmap"];
    assert_eq!((&lightmap["texCoord"], &lightmap["intensity"]), (&json!(1), &json!(1.0)));
    let texture = &json["textures"][lightmap["index"].as_u64().unwrap() as usize];
    let image = texture["extensions"]["MOZ_texture_rgbe"]["source"].as_u64().unwrap() as usize;
    assert_eq!(json["images"][image]["mimeType"], "image/vnd.radiance");
    assert_eq!(json["nodes"].as_array().unwrap().len(), 2);
}

#[test]
fn what_cannot_be_baked_is_an_error_that_says_why() {
    let mut document = Document::default();
    let white = document.material([0.5; 3], [0.0; 3]);
    document.quad(SQUARE, white, Mat4::IDENTITY, &[coordinates(0.0, 1.0)]);
    let model = load(&document, 16);
    let scene = Arc::new(model.scene().unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, [16, 16]).unwrap();
    let good = model.surfaces(&mut backend, &Texels::of(&atlas), None).unwrap();
    assert!(good.is_dark());
    let refuse = |surfaces: Surfaces, word: &str| {
        let mut backend = CpuBackend::new(scene.clone());
        let error = irradiance(&mut backend, &Texels::of(&atlas), &surfaces, &BOUNCES, &Checkpoints::none(), &Silent)
            .unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
    };
    refuse(Surfaces { albedo: Rgb::filled(8, 8, [0.5; 3]), ..good.clone() }, "16×16");
    refuse(Surfaces { albedo: Rgb::filled(16, 16, [1.5; 3]), ..good.clone() }, "albedo");
    refuse(Surfaces { emission: Rgb::filled(16, 16, [f32::NAN; 3]), ..good.clone() }, "emission");
    // A light in the file with a number that no light has.
    document.light(json!({ "type": "point", "intensity": -5.0 }), Mat4::IDENTITY);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    document.write(&path);
    let error = read_gltf(&path, 16, BounceAlbedo::Diffuse, &Silent).err().unwrap().to_string();
    assert!(error.contains("node 1") && error.contains("scene.gltf"), "{error}");
}
