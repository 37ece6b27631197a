use std::f64::consts::PI;
use std::sync::Arc;

use glam::Vec2;

use super::*;
use crate::atlas::Atlas;
use crate::backend::{Backend, Gather};
use crate::cpu::CpuBackend;
use crate::distribution::cdf;
use crate::progress::Silent;
use crate::raster::Rgb;
use crate::scene::Scene;
use crate::surface::SurfacePoint;

/// Quads in an atlas of `n × n` charts.
struct Quads {
    mesh: Mesh,
    charts: usize,
}

impl Quads {
    fn new(charts: usize) -> Self {
        Self { mesh: Mesh::default(), charts }
    }

    /// A parallelogram that faces `s × t`, in the given chart.
    fn add(&mut self, chart: usize, corner: Vec3, s: Vec3, t: Vec3) {
        let base = self.mesh.positions.len() as u32;
        let at = Vec2::new((chart % self.charts) as f32, (chart / self.charts) as f32);
        for (a, b) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            self.mesh.positions.push(corner + s * a + t * b);
            self.mesh.normals.push(s.cross(t).normalize());
            self.mesh.uvs.push((at + 0.1 + 0.8 * Vec2::new(a, b)) / self.charts as f32);
        }
        self.mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
}

const SIDE: usize = 64;

/// Two rooms of 2 × 2 × 2 m side by side, a wall between them, and a lamp of 40 × 40 cm below each ceiling, the one on
/// the right four times as bright.
fn two_rooms() -> (Arc<Scene>, Rgb) {
    let mut q = Quads::new(4);
    let (x, y, z) = (2.0 * Vec3::X, 2.0 * Vec3::Y, 2.0 * Vec3::Z);
    q.add(0, Vec3::ZERO, 2.0 * x, y);
    q.add(1, z, y, 2.0 * x);
    q.add(2, Vec3::ZERO, y, z);
    q.add(3, 2.0 * x, z, y);
    q.add(4, Vec3::ZERO, z, 2.0 * x);
    q.add(5, y, 2.0 * x, z);
    q.add(6, x - 0.01 * Vec3::X, z, y);
    q.add(7, x + 0.01 * Vec3::X, y, z);
    q.add(12, Vec3::new(0.8, 0.8, 1.9), 0.4 * Vec3::Y, 0.4 * Vec3::X);
    q.add(13, Vec3::new(2.8, 0.8, 1.9), 0.4 * Vec3::Y, 0.4 * Vec3::X);
    let texel = |i: usize| match (i % SIDE * 4 / SIDE, i / SIDE * 4 / SIDE) {
        (0, 3) => [1.0, 2.0, 3.0],
        (1, 3) => [4.0, 8.0, 12.0],
        _ => [0.0; 3],
    };
    let radiance = Rgb { width: SIDE, height: SIDE, data: (0..SIDE * SIDE).map(texel).collect() };
    (Arc::new(Scene::new(q.mesh).unwrap()), radiance)
}

fn atlas(scene: &Arc<Scene>) -> Atlas {
    Atlas::new(&mut CpuBackend::new(scene.clone()), [SIDE, SIDE]).unwrap()
}

/// A point of the floor.
fn on_floor(x: f32, y: f32) -> SurfacePoint {
    SurfacePoint { position: [x, y, 1e-4], triangle: 0, normal: [0.0, 0.0, 1.0], index: 0 }
}

/// Share of the directions above (x, y), by the cosine, that see a horizontal rectangle `h` higher (Siegel and Howell,
/// "Thermal Radiation Heat Transfer", factor of a plane element to a parallel rectangle, for each of its corners).
fn form_factor([x, y]: [f64; 2], low: [f64; 2], high: [f64; 2], h: f64) -> f64 {
    let corner = |a: f64, b: f64| {
        let (a, b) = (a / h, b / h);
        let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
        (a / p * (b / p).atan() + b / q * (a / q).atan()) / (2.0 * PI)
    };
    let [x0, x1, y0, y1] = [low[0] - x, high[0] - x, low[1] - y, high[1] - y];
    corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)
}

/// Mean and relative standard deviation of E over seeds at a point.
fn gathered(backend: &mut dyn Backend, point: &SurfacePoint, cosine: u32, light: u32) -> (f64, f64) {
    let points: Vec<SurfacePoint> = (0..20_000).map(|index| SurfacePoint { index, ..*point }).collect();
    let all = backend.irradiance(&points, Gather::new(cosine, light, 1), &Silent).unwrap();
    let n = all.len() as f64;
    let e = || all.iter().map(|g| f64::from(g.irradiance[0]));
    let mean = e().sum::<f64>() / n;
    (mean, (e().map(|e| (e / mean - 1.0).powi(2)).sum::<f64>() / n).sqrt())
}

#[test]
fn a_rectangle_shines_as_its_form_factor_says() {
    let (scene, radiance) = two_rooms();
    let mut lights = Lights::find(&scene, &atlas(&scene), &radiance).unwrap();
    let mut backend = CpuBackend::new(scene.clone());
    for point in [on_floor(1.0, 1.0), on_floor(0.3, 1.6)] {
        let [x, y, _] = point.position.map(f64::from);
        let expected = PI * form_factor([x, y], [0.8, 0.8], [1.2, 1.2], 1.9 - 1e-4);
        backend.set_tbl(&radiance, &lights).unwrap();
        let (mean, deviation) = gathered(&mut backend, &point, 4, 12);
        assert!((mean / expected - 1.0).abs() < 5e-3, "{mean} for {expected}");
        backend.set_tbl(&radiance, &Lights { grid: Lights::none(scene.mesh()).grid, ..lights.clone() }).unwrap();
        let (mean, by_power) = gathered(&mut backend, &point, 4, 12);
        assert!((mean / expected - 1.0).abs() < 1e-2, "{mean} for {expected} by power");
        assert!(deviation < 0.6 * by_power, "{deviation} with tables, {by_power} by power");
    }
    // Tables that all but rule out the lamp of this room change the noise, not the mean.
    let clusters = lights.clusters.len() - 1;
    let lamp = |c: usize| scene.mesh().centre(lights.part(c, 0.0).0.triangle).x < 2.0;
    let unwise: Vec<f32> = (0..clusters).map(|c| if lamp(c) { 1e-3 } else { 1.0 }).collect();
    let unwise = cdf(&unwise).repeat(lights.tables.len() / clusters);
    lights.tables = unwise;
    backend.set_tbl(&radiance, &lights).unwrap();
    let expected = PI * form_factor([1.0, 1.0], [0.8, 0.8], [1.2, 1.2], 1.9 - 1e-4);
    let (mean, _) = gathered(&mut backend, &on_floor(1.0, 1.0), 64, 8);
    assert!((mean / expected - 1.0).abs() < 1e-2, "{mean} for {expected} by an unwise table");
    // Negative control: a density that is not the draws' own is a bias that this test sees.
    lights.parts.iter_mut().for_each(|light| light.pdf_area *= 3.0);
    backend.set_tbl(&radiance, &lights).unwrap();
    let (mean, _) = gathered(&mut backend, &on_floor(1.0, 1.0), 1, 8);
    let wrong = (mean / expected - 1.0).abs();
    assert!(wrong > 1e-2, "{mean} for {expected}");
}

#[test]
fn a_small_lamp_on_a_large_triangle_is_aimed_at() {
    // A ceiling of 4 × 4 m, of which 48 × 48 texels of the map, with two lamps: 3 × 2 texels, and one of half as much
    // light.
    const TEXEL: f32 = 4.0 / 48.0;
    let mut q = Quads::new(1);
    q.add(0, Vec3::new(-2.0, -2.0, 2.0), 4.0 * Vec3::Y, 4.0 * Vec3::X);
    let mesh = q.mesh.clone();
    // The chart begins a tenth of the map from its corner.
    let (first, side) = (8, 64);
    let uvs = mesh.uvs.iter().map(|uv| (Vec2::splat(first as f32) + (uv - 0.1) / 0.8 * 48.0) / side as f32).collect();
    let scene = Arc::new(Scene::new(Mesh { uvs, ..mesh }).unwrap());
    let mut radiance = Rgb::filled(side, side, [0.01; 3]);
    let mut lamp = |x: std::ops::Range<usize>, y: std::ops::Range<usize>, l: f32| {
        for at in y.flat_map(|y| x.clone().map(move |x| (first + y) * side + first + x)) {
            radiance.data[at] = [l; 3];
        }
    };
    lamp(30..33, 10..12, 100.0);
    lamp(5..6, 40..41, 50.0);
    let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), [side, side]).unwrap();
    let lights = Lights::find(&scene, &atlas, &radiance).unwrap();
    let shining: f32 = (lights.members.iter())
        .map(|&m| lights.parts[m as usize])
        .map(|light| scene.mesh().area(light.triangle) / 4.0f32.powi(light.part.level() as i32))
        .sum();
    assert!(shining < 8.0 * 7.0 * TEXEL * TEXEL, "{shining} m² of lights");

    let mut backend = CpuBackend::new(scene.clone());
    let point = on_floor(0.4, -0.7);
    // Columns of the map run along y, rows along x.
    let corner = |row: usize, column: usize| [row, column].map(|at| -2.0 + f64::from(TEXEL) * at as f64);
    let seen = |rows: [usize; 2], columns: [usize; 2]| {
        let [low, high] = [0, 1].map(|end| corner(rows[end], columns[end]));
        form_factor([0.4, -0.7], low, high, 2.0 - 1e-4)
    };
    let all = 0.01 * form_factor([0.4, -0.7], [-2.0; 2], [2.0; 2], 2.0 - 1e-4);
    let lamps = 99.99 * seen([10, 12], [30, 33]) + 49.99 * seen([40, 41], [5, 6]);
    let expected = PI * (all + lamps);
    backend.set_tbl(&radiance, &lights).unwrap();
    let (mean, deviation) = gathered(&mut backend, &point, 16, 16);
    assert!((mean / expected - 1.0).abs() < 5e-3, "{mean} for {expected}");
    assert!(deviation < 0.6, "{deviation}");
    // Its triangles as wholes say the same in the mean, with far more noise.
    backend.set_tbl(&radiance, &Lights::by_power(scene.mesh(), &[1.0; 2])).unwrap();
    let (mean, of_wholes) = gathered(&mut backend, &point, 16, 16);
    assert!((mean / expected - 1.0).abs() < 5e-2, "{mean} for {expected} by whole triangles");
    assert!(deviation < of_wholes / 5.0, "{deviation} for {of_wholes} by whole triangles");
    // Negative control: a density that is not the draws' own.
    let mut wrong = lights;
    wrong.parts.iter_mut().for_each(|light| light.pdf_area *= 1.1);
    backend.set_tbl(&radiance, &wrong).unwrap();
    let (mean, _) = gathered(&mut backend, &point, 16, 16);
    assert!((mean / expected - 1.0).abs() > 2e-2, "{mean} for {expected}");
}

#[test]
fn a_room_is_lit_by_its_own_lamp() {
    let (scene, radiance) = two_rooms();
    let lights = Lights::find(&scene, &atlas(&scene), &radiance).unwrap();
    assert_eq!(lights.members.len(), 4);
    let share = |point: SurfacePoint, left: bool| -> f32 {
        let table = lights.table(point.position.into(), point.normal.into());
        let of = |c: usize| table[c] - if c > 0 { table[c - 1] } else { 0.0 };
        let here = |c: &usize| (scene.mesh().centre(lights.part(*c, 0.0).0.triangle).x < 2.0) == left;
        (0..table.len()).filter(here).map(of).sum()
    };
    assert!(share(on_floor(1.0, 1.0), true) > 0.85);
    assert!(share(on_floor(3.0, 1.0), false) > 0.95);
    // A cell that nothing was learned for, here outside the grid, has the table by power.
    assert!((share(on_floor(-50.0, 1.0), true) - 0.2).abs() < 1e-3);
}

#[test]
fn every_table_is_a_density() {
    let (scene, radiance) = two_rooms();
    let lights = Lights::find(&scene, &atlas(&scene), &radiance).unwrap();
    let clusters = lights.clusters.len() - 1;
    assert!(lights.tables.len() > 10 * clusters);
    for table in lights.tables.chunks(clusters) {
        let of = |c: usize| table[c] - if c > 0 { table[c - 1] } else { 0.0 };
        let area = |light: &LightPart| scene.mesh().area(light.triangle) / 4.0f32.powi(light.part.level() as i32);
        let total: f32 =
            lights.parts.iter().map(|light| of(light.cluster as usize) * light.pdf_area * area(light)).sum();
        assert!((total - 1.0).abs() < 1e-5, "{total}");
    }
}

#[test]
fn clusters_hold_every_light_once_and_face_one_way() {
    // A bumpy sheet of a thousand triangles.
    let mut mesh = Mesh::default();
    for i in 0..1000u32 {
        let at = Vec3::new((i % 32) as f32, (i / 32) as f32, (crate::rng::hash(i) % 64) as f32 / 64.0);
        let spin = |k: u32| (crate::rng::hash2(i, k) % 256) as f32 / 256.0;
        mesh.positions.extend([at, at + Vec3::new(1.0, spin(1), spin(2)), at + Vec3::new(spin(3), 1.0, spin(4))]);
        mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
    mesh.normals = vec![Vec3::Z; mesh.positions.len()];
    let lights = Lights::by_power(&mesh, &vec![1.0; 1000]);
    let member = |&index: &u32| lights.parts[index as usize];
    let mut all: Vec<u32> = lights.members.iter().map(|m| member(m).triangle).collect();
    all.sort_unstable();
    assert!(all.into_iter().eq(0..1000));
    assert_eq!(lights.clusters.len() - 1, 256);
    for range in lights.clusters.windows(2) {
        let range = range[0] as usize..range[1] as usize;
        let members = &lights.members[range.clone()];
        let way = |m: &u32| facing(mesh.face_normal(member(m).triangle));
        assert!(!members.is_empty() && members.iter().all(|m| way(m) == way(&members[0])));
        assert_eq!(lights.cdf[range].last(), Some(&1.0));
    }
}

#[test]
fn nothing_that_shines_is_no_light() {
    let (scene, _) = two_rooms();
    let dark = Lights::find(&scene, &atlas(&scene), &Rgb::filled(SIDE, SIDE, [1.0; 3])).unwrap();
    assert_eq!(dark, Lights::none(scene.mesh()));
    let unusable = Lights::by_power(scene.mesh(), &vec![f32::NAN; scene.mesh().triangles.len()]);
    assert!(unusable.is_empty());
}
