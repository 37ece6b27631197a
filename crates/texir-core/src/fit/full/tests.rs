//! The full mode's parts on small problems with known answers.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec3A};

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather, Material, RoughnessGradient, Sampling, ShadePoint};
use crate::brdf::Masking;
use crate::cpu::CpuBackend;
use crate::diffuse::DiffuseModel;
use crate::fit::adjacency::Adjacency;
use crate::fit::full::albedo::{AlbedoProblem, EdgeGuide, Roughness};
use crate::fit::full::joints::{self, JointPixels, Lines};
use crate::fit::full::observations::Observations;
use crate::fit::full::observations::packed_tap::PackedTap;
use crate::fit::full::partition::Partition;
use crate::fit::full::roughness::prior::shrink;
use crate::fit::full::roughness::scan::scan;
use crate::fit::index::NONE;
use crate::fit::settings::{AcceptanceSettings, AlbedoSettings, JointSettings, RoughnessSettings};
use crate::lights::Lights;
use crate::mesh::Mesh;
use crate::progress::Silent;
use crate::raster::Rgb;
use crate::scene::Scene;
use crate::specular_table::{PackedCurve, STRATA, TableSampling};
use crate::surface::SurfacePoint;
use crate::texture::{SparseRows, Tap};

/// Edge of the floor's part of the atlas, texels.
const FLOOR: usize = 8;

/// A floor of 2 × 2 m, a lamp of 20 × 20 cm above it, and a dim ceiling above both; one chart each.
fn room() -> (Arc<Scene>, Rgb) {
    let quad = |size: f32, z: f32, facing: f32| {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| Vec3::new(size * x, size * y * facing, z))
    };
    let mut mesh = Mesh { positions: vec![], normals: vec![], uvs: vec![], triangles: vec![] };
    let quads = [
        (quad(1.0, 0.0, 1.0), 0.0, Vec3::Z),
        (quad(0.1, 1.5, -1.0), 0.5, -Vec3::Z),
        (quad(2.0, 2.0, -1.0), 0.75, -Vec3::Z),
    ];
    for (corners, left, normal) in quads {
        let first = mesh.positions.len() as u32;
        let width = if left == 0.0 { 0.5 } else { 0.25 };
        mesh.positions.extend(corners);
        mesh.normals.extend([normal; 4]);
        mesh.uvs.extend([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| Vec2::new(left + width * u, v)));
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    let mut radiance = Rgb::filled(2 * FLOOR, FLOOR, [0.3, 0.25, 0.2]);
    for y in 0..FLOOR {
        radiance.data[y * 2 * FLOOR + FLOOR..][..FLOOR / 2].fill([60.0, 50.0, 40.0]);
        radiance.data[y * 2 * FLOOR..][..FLOOR].fill([0.2, 0.2, 0.2]);
    }
    (Arc::new(Scene::new(mesh).unwrap()), radiance)
}

/// The floor seen by cameras on two circles, its materials known.
struct Toy {
    seen: Observations,
    irradiance: Vec<Vec3A>,
    adjacency: Adjacency,
    segment: Vec<u32>,
}

fn toy(albedo: impl Fn(usize) -> Vec3A, roughness: f32, height: f32) -> Toy {
    toy_of(|t| Material::dielectric(albedo(t).to_array(), roughness), height)
}

fn toy_of(material: impl Fn(usize) -> Material, height: f32) -> Toy {
    let (scene, radiance) = room();
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, [2 * FLOOR, FLOOR]).unwrap();
    let lights = Lights::find(&scene, &atlas, &radiance).unwrap();
    backend.set_tbl(&radiance, &lights).unwrap();
    let on_floor: Vec<bool> = atlas.points.iter().map(|p: &SurfacePoint| p.triangle < 2).collect();
    let gather = Gather::new(1024, 1024, 3);
    let irradiance: Vec<Vec3A> =
        backend.irradiance(&atlas.points, gather, &Silent).unwrap().iter().map(|g| Vec3A::from(g.irradiance)).collect();
    let mut seen = Observations::default();
    let mut strata: Vec<[ShadePoint; STRATA]> = Vec::new();
    for view in 0..8 {
        let angle = view as f32 / 8.0 * std::f32::consts::TAU;
        let radius = if view % 2 == 0 { 1.2 } else { 0.4 };
        let camera = Vec3::new(radius * angle.cos(), radius * angle.sin(), height + 0.05 * view as f32);
        for (t, point) in atlas.points.iter().enumerate().filter(|(t, _)| on_floor[*t]) {
            let to_camera = (camera - Vec3::from(point.position)).normalize();
            strata.push(
                [ShadePoint {
                    position: point.position,
                    index: strata.len() as u32,
                    normal: [0.0, 0.0, 1.0],
                    view: to_camera.to_array(),
                    irradiance: irradiance[t].to_array(),
                }; STRATA],
            );
            seen.cosine.push(to_camera.z);
            seen.min_cosine.push(to_camera.z);
            seen.near_excluded.push(false);
            seen.area.push(1.0);
            seen.rows.push(PackedTap::of(std::array::from_fn(|_| vec![Tap { texel: t as u32, weight: 1.0 }])));
        }
    }
    let points: Vec<ShadePoint> = strata.iter().map(|s| s[0]).collect();
    let texel = |p: usize| seen.rows.taps[p].texel as usize;
    let materials: Vec<Material> = (0..points.len()).map(|p| material(texel(p))).collect();
    // The images come from shading, which draws its samples otherwise than the tables do.
    let sampling = Sampling { samples: 1 << 14, seed: 7 };
    let shaded = backend.shade(&points, &materials, sampling, RoughnessGradient::Exact, &Silent).unwrap();
    seen.radiance = shaded.iter().map(|s| Vec3A::from(s.radiance)).collect();
    let sampling = TableSampling { lobe: 64, cosine: 64, light: 256, masking: Masking::Schlick, seed: 5 };
    let mut tables = |f0: f32| {
        let curves = backend.specular_tables(&strata, f0, sampling, &Silent).unwrap();
        curves.iter().map(PackedCurve::from).collect()
    };
    (seen.curves, seen.white_curves) = (tables(0.04), tables(1.0));
    seen.block = (0..strata.len() as u32).collect();
    seen.index(atlas.texels.len());
    let adjacency = Adjacency::new(scene.mesh(), &atlas);
    Toy { seen, irradiance, adjacency, segment: on_floor.iter().map(|&f| u32::from(!f)).collect() }
}

impl Toy {
    /// Leaves the first view only: no texel is seen twice.
    fn seen_by_one(&mut self) {
        let (seen, pixels) = (&mut self.seen, self.segment.iter().filter(|s| **s == 0).count());
        seen.radiance.truncate(pixels);
        seen.cosine.truncate(pixels);
        seen.min_cosine.truncate(pixels);
        seen.near_excluded.truncate(pixels);
        seen.area.truncate(pixels);
        seen.block.truncate(pixels);
        seen.rows.taps.truncate(pixels);
        seen.rows.offsets.truncate(pixels + 1);
        seen.index(self.segment.len());
    }

    fn problem<'a>(&'a self, settings: &'a AlbedoSettings) -> AlbedoProblem<'a> {
        let segment = Partition { of: &self.segment, count: 2 };
        AlbedoProblem::new(&self.seen, &self.irradiance, &self.adjacency, segment, DiffuseModel::Lambert, settings)
    }
}

#[test]
fn the_scan_recovers_roughness_under_a_small_lamp() {
    let settings = AlbedoSettings { smoothness: 0.0, segment_prior: 1e-6, ..AlbedoSettings::default() };
    for truth in [0.08f32, 0.15, 0.3, 0.5, 0.7, 0.9] {
        let toy = toy(|t| Vec3A::new(0.3, 0.5, 0.4) + 0.02 * (t % 5) as f32, truth, 1.0);
        let problem = toy.problem(&settings);
        let mut albedo = problem.start();
        let evidence = scan(&problem, "Lambert", &RoughnessSettings::default(), &mut albedo, &Silent).unwrap();
        let group: Vec<u32> = evidence.segment.iter().map(|&s| if s == NONE { NONE } else { 0 }).collect();
        let found = shrink(&evidence.by_group(Partition { of: &group, count: 1 }), &[[]])[0];
        assert!((found - truth).abs() < 0.02, "r {truth}: found {found}");
    }
}

#[test]
fn a_single_view_tells_roughness_by_what_albedo_would_have_to_imitate() {
    let settings = AlbedoSettings { smoothness: 0.0, segment_prior: 1e-6, ..AlbedoSettings::default() };
    for truth in [0.15f32, 0.3, 0.5] {
        // Boards of their own paint each.
        let mut toy = toy(|t| Vec3A::new(0.3, 0.5, 0.4) + 0.05 * (t % FLOOR / 2 % 2) as f32, truth, 1.0);
        toy.seen_by_one();
        let problem = toy.problem(&settings);
        let mut albedo = problem.start();
        let evidence = scan(&problem, "Lambert", &RoughnessSettings::default(), &mut albedo, &Silent).unwrap();
        let group: Vec<u32> = evidence.segment.iter().map(|&s| if s == NONE { NONE } else { 0 }).collect();
        let found = shrink(&evidence.by_segment(), &[[]; 2])[0];
        assert!((found - truth).abs() < 0.03, "r {truth}: found {found}");
        // Negative control: its pixels alone are explained by some albedo at any roughness.
        let alone = evidence.by_group(Partition { of: &group, count: 1 })[0].misfit();
        let [least, most] = [f32::min, f32::max].map(|pick| alone.iter().copied().reduce(pick).unwrap());
        assert!(most - least < 1e-3, "r {truth}: {least} to {most}");
    }
}

#[test]
fn pixels_say_nothing_at_rims_and_where_a_part_is_seen_at_a_grazing_angle() {
    let settings = AlbedoSettings::default();
    let mut toy = toy(|_| Vec3A::splat(0.5), 0.3, 1.0);
    let usual = 3;
    let [edge, rim] = [usual + 1, usual + 2];
    toy.seen.min_cosine[edge] = 0.1;
    toy.seen.near_excluded[rim] = true;
    let problem = toy.problem(&settings);
    let evidence = scan(&problem, "Lambert", &RoughnessSettings::default(), &mut problem.start(), &Silent).unwrap();
    assert!([usual, edge, rim].iter().all(|p| toy.seen.cosine[*p] > 0.4));
    assert_eq!([usual, edge, rim].map(|p| evidence.segment[p]), [0, NONE, NONE]);
}

#[test]
fn the_diffuse_model_is_the_one_that_the_images_were_made_with() {
    use super::scan_models;
    use crate::fit::full::segments::Segments;
    use crate::fit::settings::FullSettings;
    let settings = FullSettings::default();
    for truth in [DiffuseModel::Lambert, DiffuseModel::Burley] {
        let roughness = 0.9;
        let mut toy = toy(|_| Vec3A::splat(0.5), roughness, 0.45);
        for p in 0..toy.seen.len() {
            let texel = toy.seen.rows.taps[p].texel as usize;
            let diffuse = 0.5 * toy.irradiance[texel] * std::f32::consts::FRAC_1_PI;
            toy.seen.radiance[p] += (truth.factor(toy.seen.cosine[p], roughness) - 1.0) * diffuse;
        }
        let segments = Segments {
            segment: toy.segment.clone(),
            face: toy.segment.clone(),
            class: vec![1; 2],
            class_in_room: vec![0; 2],
        };
        let mut problem = toy.problem(&settings.albedo);
        let scanned = scan_models(&mut problem, &segments, &settings, &Silent).unwrap();
        assert_eq!(scanned.diffuse, truth);
    }
}

#[test]
fn smooth_metal_is_told_from_dielectrics_and_keeps_its_colour() {
    use super::scan_models;
    use crate::fit::full::segments::Segments;
    use crate::fit::settings::{DiffuseChoice, FullSettings, MetallicSettings};
    let mut settings = FullSettings { diffuse: DiffuseChoice::Lambert, ..FullSettings::default() };
    let copper = Vec3A::new(0.95, 0.64, 0.54);
    for (metallic, roughness) in [(1.0, 0.1), (1.0, 0.25), (0.0, 0.1), (0.0, 0.25), (0.0, 0.9)] {
        let material = Material { metallic, ..Material::dielectric(copper.to_array(), roughness) };
        let toy = toy_of(|_| material, 1.0);
        let segments = Segments {
            segment: toy.segment.clone(),
            face: toy.segment.clone(),
            class: vec![1; 2],
            class_in_room: vec![0; 2],
        };
        let floor = toy.segment.iter().position(|s| *s == 0).unwrap();
        let mut metal = |enabled| {
            settings.metallic = MetallicSettings { enabled, ..MetallicSettings::default() };
            let mut problem = toy.problem(&settings.albedo);
            let mut scanned = scan_models(&mut problem, &segments, &settings, &Silent).unwrap();
            let r = vec![scanned.by_segment[0]; toy.segment.len()];
            let sigma = problem.noise(settings.albedo.image_noise);
            let mut predicted = problem.predicted(&scanned.albedo);
            let target = problem.target(&Roughness::Texels(&r));
            problem.solve((&mut scanned.albedo, &mut predicted), (&target, &sigma), 3, 25, EdgeGuide::Albedo);
            (problem.metal.get(floor).copied().unwrap_or(false), r[0], scanned.albedo[floor])
        };
        let (is_metal, r, albedo) = metal(true);
        assert_eq!(is_metal, metallic == 1.0, "metallic {metallic}, r {roughness}");
        assert!((r - roughness).abs() < 0.03, "metallic {metallic}, r {roughness}: found {r}");
        assert!((albedo - copper).abs().max_element() < 0.03, "metallic {metallic}, r {roughness}: {albedo}");
        // Negative control: taken for a dielectric, metal has another colour.
        let (is_metal, _, albedo) = metal(false);
        assert!(!is_metal && (metallic == 0.0 || (albedo - copper).abs().max_element() > 0.1), "{albedo}");
    }
}

#[test]
fn least_squares_recovers_albedo_beside_highlights() {
    let settings = AlbedoSettings { smoothness: 0.0, segment_prior: 1e-6, ..AlbedoSettings::default() };
    let truth = |t: usize| Vec3A::new(0.2 + 0.07 * (t % 7) as f32, 0.5, 0.8 - 0.1 * (t % 3) as f32);
    let toy = toy(truth, 0.3, 1.0);
    let problem = toy.problem(&settings);
    let sigma = problem.noise(settings.image_noise);
    let error = |r: f32| {
        let mut albedo = problem.start();
        let mut predicted = problem.predicted(&albedo);
        let target = problem.target(&Roughness::Texels(&vec![r; toy.segment.len()]));
        problem.solve((&mut albedo, &mut predicted), (&target, &sigma), 3, 25, EdgeGuide::Albedo);
        let seen = (0..albedo.len()).filter(|&t| toy.segment[t] == 0);
        seen.map(|t| (albedo[t] - truth(t)).abs().max_element()).fold(0.0, f32::max)
    };
    let (right, wrong) = (error(0.3), error(0.9));
    // Negative control: at the wrong roughness highlights stay in the albedo, as far as robust weights let them.
    assert!(right < 0.005 && wrong > 2.0 * right, "{right} {wrong}");
}

#[test]
fn between_a_smooth_texel_and_a_rough_one_reflections_are_those_of_the_mean_roughness() {
    let mut toy = toy(|_| Vec3A::splat(0.5), 0.3, 1.0);
    let [smooth, rough] = [toy.seen.rows.row(0)[0].texel, toy.seen.rows.row(1)[0].texel];
    let roughness: Vec<f32> = (0..toy.segment.len()).map(|t| if t == rough as usize { 0.8 } else { 0.1 }).collect();
    let sees = |texel, weight| Tap { texel, weight };
    // A pixel between both, nearer to the rough one by a share that is kept exactly; and one across a sharp edge.
    let between = PackedTap::of(std::array::from_fn(|_| vec![sees(smooth, 1.0), sees(rough, 2.0)]));
    let across = PackedTap::of([smooth, rough, rough, rough].map(|t| vec![sees(t, 1.0)]));
    let highlight = |p: &usize| toy.seen.curve(*p).at(0.1).0[0];
    let pixel = (0..toy.seen.len()).max_by(|a, b| highlight(a).total_cmp(&highlight(b))).unwrap();
    let mut apparent = |shares: Vec<PackedTap>| {
        let mut row = Some(shares);
        let rows =
            (0..toy.seen.len()).map(|p| if p == pixel { row.take().unwrap() } else { toy.seen.rows.row(p).to_vec() });
        toy.seen.rows = SparseRows::from_lists(rows.collect::<Vec<_>>());
        let settings = AlbedoSettings::default();
        let problem = toy.problem(&settings);
        let said = problem.target(&Roughness::Texels(&roughness)).albedo[pixel];
        (problem.seen.radiance[pixel] - said / problem.pi_over_e[pixel])[0]
    };
    let reflected = [apparent(between), apparent(across)];
    let at = |roughness| toy.seen.curve(pixel).at(roughness).0[0];
    let mixed = |smooth: f32| smooth * at(0.1) + (1.0 - smooth) * at(0.8);
    let expected = [at((0.1 + 2.0 * 0.8) / 3.0), mixed(0.25)];
    for (reflected, expected) in reflected.into_iter().zip(expected) {
        assert!((reflected - expected).abs() < 0.01 * expected, "{reflected} {expected}");
    }
    // Negative control: what the texels reflect, by their shares, is another thing.
    assert!(mixed(1.0 / 3.0) > 2.0 * expected[0]);
}

#[test]
fn a_target_that_changes_in_part_is_that_of_the_roughness_changed_there() {
    let toy = toy(|_| Vec3A::splat(0.5), 0.4, 1.0);
    let settings = AlbedoSettings::default();
    let mut problem = toy.problem(&settings);
    let before = vec![0.4; toy.segment.len()];
    let changed = |t: usize| t.is_multiple_of(3);
    let after: Vec<f32> = (0..before.len()).map(|t| if changed(t) { 0.2 } else { before[t] }).collect();
    let sees_changed = |p: usize| toy.seen.rows.row(p).iter().any(|share| changed(share.texel as usize));
    for metal in [vec![], (0..before.len()).map(|t| t.is_multiple_of(2)).collect()] {
        problem.metal = metal;
        let whole = problem.target(&Roughness::Texels(&after));
        let mut target = problem.target(&Roughness::Texels(&before));
        // Negative control: it differs before it is changed.
        assert_ne!(target.albedo, whole.albedo);
        problem.retarget(&mut target, &Roughness::Texels(&after), sees_changed);
        assert_eq!(target.albedo, whole.albedo);
        let zero = vec![Vec3A::ZERO; toy.seen.len()];
        let residuals = |target| (0..toy.seen.len()).map(|p| problem.residual(&zero, target, p)).collect::<Vec<_>>();
        assert_eq!(residuals(&target), residuals(&whole));
    }
}

#[test]
fn a_joint_has_a_roughness_of_its_own_where_the_views_say_so() {
    let settings = AlbedoSettings { smoothness: 0.0, segment_prior: 1e-6, ..AlbedoSettings::default() };
    let found = |is_joint: fn(usize) -> bool, length: f32, paint: f32, finish: f32| {
        let defaults = JointSettings::default();
        let own = defaults.acceptance.clone();
        let roughness = RoughnessSettings {
            joints: JointSettings {
                width: 0.25,
                length,
                acceptance: AcceptanceSettings { half_pixels: 50.0, ..own },
                ..defaults
            },
            ..RoughnessSettings::default()
        };
        let material = |t: usize| match is_joint(t) {
            true => Material::dielectric([paint; 3], finish),
            false => Material::dielectric([0.5; 3], 0.15),
        };
        let toy = toy_of(material, 1.0);
        let problem = toy.problem(&settings);
        let surface = vec![0.15; toy.segment.len()];
        let target = problem.target(&Roughness::Texels(&surface));
        let mut albedo = problem.start();
        let mut predicted = problem.predicted(&albedo);
        problem.solve(
            (&mut albedo, &mut predicted),
            (&target, &problem.noise(settings.image_noise)),
            2,
            25,
            EdgeGuide::Albedo,
        );
        let pixels = toy.seen.len();
        // Every view sees each of the floor's texels once.
        let half: Vec<u8> = (0..pixels).map(|p| (p / (2 * FLOOR * FLOOR) % 2) as u8).collect();
        let texel = 2.0 / FLOOR as f32;
        let pixels_of_joints = JointPixels { segment: &vec![0; pixels], weight: &vec![1.0; pixels], half: &half };
        let lines = Lines::find(&problem, &albedo, texel, &roughness.joints, &Silent).unwrap();
        let joints =
            joints::find(&problem, pixels_of_joints, (&albedo, &surface), &lines, &roughness, &Silent).unwrap();
        (0..surface.len()).map(|t| joints.at(t).map(|(joint, share)| joint.on(surface[t], share))).collect::<Vec<_>>()
    };
    let on = |joints: &[Option<f32>]| -> Vec<f32> { joints.iter().flatten().copied().collect() };
    // Texels are 0.25 m wide. The diagonal's touch at their corners.
    let column = |t: usize| t % (2 * FLOOR) == 3;
    let diagonal = |t: usize| t % (2 * FLOOR) == t / (2 * FLOOR);
    let specks = |t: usize| t % (2 * FLOOR) < FLOOR && t % (2 * FLOOR) % 3 == 1 && t / (2 * FLOOR) % 3 == 1;
    for (is_joint, paint, finish) in
        [(column as fn(usize) -> bool, 0.25, 0.4), (column, 0.25, 0.6), (column, 0.8, 0.4), (diagonal, 0.25, 0.5)]
    {
        let joints = found(is_joint, 1.0, paint, finish);
        assert!(joints.iter().enumerate().all(|(t, joint)| joint.is_none() || is_joint(t)));
        let values = on(&joints);
        assert_eq!(values.len(), FLOOR, "paint {paint}, finish {finish}");
        assert!(values.iter().all(|r| (r - finish).abs() < 0.12), "{values:?} for {finish}");
    }
    // Negative controls: paint that is as glossy as the floor, a finish that no paint gives away, and what is no line,
    // unless single texels are taken for one.
    assert!(on(&found(column, 1.0, 0.25, 0.15)).is_empty());
    assert!(on(&found(column, 1.0, 0.5, 0.6)).is_empty());
    assert!(on(&found(specks, 1.0, 0.25, 0.5)).is_empty());
    assert_eq!(on(&found(specks, 0.25, 0.25, 0.5)).len(), 9);
}

#[test]
fn irradiance_takes_what_albedo_gives_up_but_not_of_metal() {
    let irradiance = [Vec3A::splat(2.0); 3];
    let albedo = [Vec3A::new(0.3, 0.6, 0.5); 3];
    let painted = [Vec3A::new(0.6, 0.6, 0.25), Vec3A::new(0.6, 0.6, 0.25), Vec3A::ZERO];
    let metal = [false, true, false];
    let found = super::compensated_irradiance(&irradiance, (&albedo, &painted), |t| !metal[t]);
    for c in 0..3 {
        assert!((found[0][c] * painted[0][c] - irradiance[0][c] * albedo[0][c]).abs() < 1e-6, "{found:?}");
    }
    assert_eq!(found[1], Vec3A::splat(2.0));
    assert_eq!(found[2], Vec3A::splat(20.0), "at most ten times");
}

#[test]
fn every_view_has_curves_of_its_own() {
    use std::ops::Range;

    use glam::Mat4;

    use crate::camera::{Camera, Projection};
    use crate::capture::{Split, View};
    use crate::checkpoint::Checkpoints;
    use crate::fit::full::observations::Observer;
    use crate::fit::settings::FullSettings;
    use crate::raster::Mask;
    let (scene, radiance) = room();
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, [2 * FLOOR, FLOOR]).unwrap();
    backend.set_tbl(&radiance, &Lights::find(&scene, &atlas, &radiance).unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("image.exr");
    crate::image_io::write_rgb(&image, &Rgb::filled(32, 16, [0.3; 3])).unwrap();
    let [a, b, c] = [-0.5, 0.1, 0.6].map(|x| {
        let world_from_camera = Mat4::from_translation(Vec3::new(x, 0.2, 1.0));
        let camera = Camera { projection: Projection::Equirectangular, width: 32, height: 16, world_from_camera };
        View::new(x.to_string(), camera, Split::Train, image.clone())
    });
    let (emitters, settings) = (Mask::filled(2 * FLOOR, FLOOR, false), FullSettings::default());
    let checkpoints = Checkpoints::none();
    let observer =
        Observer { atlas: &atlas, emitters: &emitters, settings: &settings, seed: 1, checkpoints: &checkpoints };
    let [ab, cb, alone] = [vec![a.clone(), b.clone()], vec![c, b], vec![a]]
        .map(|views| observer.observe(&mut backend, &views, &Silent).unwrap());
    let curves = |of: &Observations, range: Range<usize>| range.map(|p| *of.curve(p)).collect::<Vec<_>>();
    let [first, other] = [&ab, &cb].map(|of| of.views[0]);
    assert_eq!(curves(&ab, 0..first), curves(&alone, 0..alone.len()));
    assert_eq!(curves(&ab, first..ab.len()), curves(&cb, other..cb.len()));
    // Negative control: views differ.
    let each = first.min(other).min(ab.len() - first);
    assert_ne!(curves(&ab, 0..each), curves(&cb, 0..each));
    assert_ne!(curves(&ab, 0..each), curves(&ab, first..first + each));
}

/// The albedo that a toy of roughness 0.3 is found to have where that is known.
fn solved(toy: &Toy, settings: &AlbedoSettings) -> Vec<Vec3A> {
    let problem = toy.problem(settings);
    let mut albedo = problem.start();
    problem.solve_at(&mut albedo, vec![0.3; toy.segment.len()], 4, EdgeGuide::Median);
    albedo
}

#[test]
fn neighbours_are_drawn_together_but_not_across_an_edge() {
    // Two paints, each with noise that looks like a chequerboard; no texel is seen twice.
    let paint = |t: usize| if t % (2 * FLOOR) < FLOOR / 2 { 0.2 } else { 0.8 };
    let noise = |t: usize| if (t % (2 * FLOOR) + t / (2 * FLOOR)).is_multiple_of(2) { 0.01 } else { -0.01 };
    let mut toy = toy(|t| Vec3A::splat(paint(t) + noise(t)), 0.3, 1.0);
    toy.seen_by_one();
    // The largest and the smallest difference between a texel of some columns and the one right of it.
    let steps = |smoothness: f32, columns: &[usize]| {
        let albedo = solved(&toy, &AlbedoSettings { smoothness, segment_prior: 1e-6, ..AlbedoSettings::default() });
        let looked_at = (0..albedo.len()).filter(|&t| toy.segment[t] == 0 && columns.contains(&(t % (2 * FLOOR))));
        let steps: Vec<f32> = looked_at.map(|t| (albedo[t].x - albedo[t + 1].x).abs()).collect();
        [f32::min, f32::max].map(|pick| steps.iter().copied().reduce(pick).unwrap())
    };
    let (within, across) = ([0, 1, 5, 6], [FLOOR / 2 - 1]);
    let [free, smooth] = [0.0, 2.0].map(|smoothness| steps(smoothness, &within));
    assert!(free[0] > 0.015 && smooth[1] < 0.01, "{free:?} {smooth:?}");
    assert!(steps(2.0, &across)[0] > 0.5, "{:?} of 0.6", steps(2.0, &across));
}

#[test]
fn a_view_that_contradicts_all_others_hardly_counts() {
    let truth = |t: usize| Vec3A::splat(0.3 + 0.02 * (t % 3) as f32);
    let mut toy = toy(truth, 0.3, 1.0);
    let pixels = toy.seen.len() / 8;
    toy.seen.radiance[3 * pixels..4 * pixels].iter_mut().for_each(|radiance| *radiance *= 3.0);
    let albedo = solved(&toy, &AlbedoSettings { smoothness: 0.0, segment_prior: 1e-6, ..AlbedoSettings::default() });
    let floor = (0..albedo.len()).filter(|&t| toy.segment[t] == 0);
    let off = floor.map(|t| (albedo[t] - truth(t)).abs().max_element()).fold(0.0, f32::max);
    // Were all believed alike, it would be an eighth of 0.6 and more.
    assert!(off < 0.02, "{off}");
}

#[test]
fn what_is_taken_off_for_a_highlight_is_believed_to_a_share_of_itself() {
    let toy = toy(|_| Vec3A::splat(0.5), 0.3, 1.0);
    let settings = AlbedoSettings { specular_noise: 0.5, ..AlbedoSettings::default() };
    let problem = toy.problem(&settings);
    let roughness = vec![0.3; toy.segment.len()];
    let [plain, known] = [problem.noise(settings.image_noise), problem.noise_at(&Roughness::Texels(&roughness))];
    let mut most = 0.0f32;
    for p in 0..toy.seen.len() {
        // As albedo, like the noise.
        let highlight = Vec3A::from(toy.seen.curve(p).at(0.3).0) * problem.pi_over_e[p];
        let wrong = 0.5 * (highlight.x + highlight.y + highlight.z) / 3.0;
        let expected = (plain[p].powi(2) + wrong.powi(2)).sqrt();
        assert!((known[p] - expected).abs() < 1e-5 * expected, "pixel {p}: {} for {expected}", known[p]);
        most = most.max(wrong / plain[p]);
    }
    assert!(most > 1.0, "highlights are to matter: {most}");
}
