//! Irradiance from lights without extent, averaged over texels. Their shadows have sharp edges, which would be drawn in
//! whole texels if each asked one place.

use glam::{Mat2, Vec2, Vec3};
use rayon::prelude::*;

use crate::backend::Backend;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::progress::{Progress, Uncounted};
use crate::punctual::PunctualLight;
use crate::real::V3;
use crate::rng::to_unit;
use crate::scene::Scene;
use crate::scene::trace::Trace;
use crate::surface::{Hit, SurfacePoint};

/// Most places of a texel at which lights are asked for.
const MAX_SUBSAMPLES: u64 = 16;
/// Shadow rays are at most this share of the gather's, though one per light and texel at least.
const SHARE: f64 = 0.25;
/// Places of a texel are lit alike where the darkest has more than this share of the brightest's light.
const ALIKE: f32 = 0.98;

/// At how many places of a texel so many lights are asked for, where it gathers by so many `rays`: a power of two.
pub(super) fn subsamples(rays: u32, lights: usize) -> u32 {
    let most = (SHARE * f64::from(rays) / lights.max(1) as f64) as u64;
    1 << most.clamp(1, MAX_SUBSAMPLES).ilog2()
}

/// E, cosine included, not divided by π, per texel of a `[width, height]` map: the mean over those of its `subsamples`
/// places that lie on the texel's triangle, else at its surface point. Where that is uneven, only places with a free
/// line to the surface point count: a wall that stands on the texel does not mix its two sides.
pub(super) fn irradiance(
    backend: &mut dyn Backend,
    size: [usize; 2],
    points: &[SurfacePoint],
    lights: &[PunctualLight],
    subsamples: u32,
    progress: &dyn Progress,
) -> Result<Vec<[f32; 3]>> {
    let scene = backend.scene().clone();
    let subsampling = Subsampling { subsamples, lights };
    let lit = subsampling.sums(backend, points, progress, |point, within| moved(scene.mesh(), size, point, within))?;
    // What stands on a texel is of no matter where all of it is lit alike.
    let edges: Vec<usize> = (0..points.len()).filter(|&i| !lit[i].is_even()).collect();
    let on_edges: Vec<SurfacePoint> = edges.iter().map(|&i| points[i]).collect();
    let on_this_side = subsampling.sums(backend, &on_edges, &Uncounted(progress), |point, within| {
        moved(scene.mesh(), size, point, within).filter(|moved| sees(&scene, point, moved))
    })?;
    let mut found: Vec<[f32; 3]> = lit.iter().map(SubsampleSum::mean).collect();
    edges.into_iter().zip(on_this_side).for_each(|(i, lit)| found[i] = lit.mean());
    Ok(found)
}

/// Which places of texels are asked for which lights.
struct Subsampling<'a> {
    subsamples: u32,
    lights: &'a [PunctualLight],
}

impl Subsampling<'_> {
    /// What arrives over the texels of `points` at the places that `at` knows, or else at their points.
    fn sums(
        &self,
        backend: &mut dyn Backend,
        points: &[SurfacePoint],
        progress: &dyn Progress,
        at: impl Fn(&SurfacePoint, Vec2) -> Option<SurfacePoint> + Sync,
    ) -> Result<Vec<SubsampleSum>> {
        let mut lit = vec![SubsampleSum::default(); points.len()];
        for i in 0..self.subsamples {
            // A Hammersley set: one place in each of as many columns, and of as many rows.
            let within = Vec2::new(i as f32 + 0.5, 0.5) / self.subsamples as f32 + Vec2::Y * to_unit(i.reverse_bits());
            let moved: Vec<Option<SurfacePoint>> = points.par_iter().map(|point| at(point, within)).collect();
            let asked: Vec<SurfacePoint> = moved.iter().flatten().copied().collect();
            let found = backend.punctual(&asked, self.lights, progress)?;
            progress.advance(((points.len() - asked.len()) * self.lights.len()) as u64);
            let known = lit.iter_mut().zip(&moved).filter(|(_, moved)| moved.is_some());
            known.zip(found).for_each(|((lit, _), e)| lit.add(e));
        }
        let (mut alone, asked): (Vec<&mut SubsampleSum>, Vec<SurfacePoint>) =
            lit.iter_mut().zip(points).filter(|(lit, _)| lit.count == 0).unzip();
        let found = backend.punctual(&asked, self.lights, &Uncounted(progress))?;
        alone.iter_mut().zip(found).for_each(|(lit, e)| lit.add(e));
        Ok(lit)
    }
}

/// What arrives at the places of a texel.
#[derive(Clone, Copy, Default)]
struct SubsampleSum {
    sum: Vec3,
    count: u32,
    /// Of the sum of the channels.
    darkest: f32,
    brightest: f32,
}

impl SubsampleSum {
    fn add(&mut self, e: [f32; 3]) {
        let e = Vec3::from(e);
        let bright = e.element_sum();
        self.darkest = if self.count == 0 { bright } else { self.darkest.min(bright) };
        self.brightest = self.brightest.max(bright);
        self.sum += e;
        self.count += 1;
    }

    fn is_even(&self) -> bool {
        self.darkest >= ALIKE * self.brightest
    }

    fn mean(&self) -> [f32; 3] {
        (self.sum / self.count as f32).to_array()
    }
}

/// The surface at a place within a point's texel, the texel's corner at 0 and the next one's at 1; `None` beyond the
/// point's triangle.
fn moved(mesh: &Mesh, [width, height]: [usize; 2], point: &SurfacePoint, within: Vec2) -> Option<SurfacePoint> {
    let (column, row) = (point.index as usize % width, point.index as usize / width);
    let place = Vec2::new(column as f32, row as f32) + within;
    let [a, b, c] = mesh.corner_uvs(point.triangle).map(|uv| uv * Vec2::new(width as f32, height as f32));
    // Of a triangle without area these are no numbers, and none of them lies in it.
    let at = Mat2::from_cols(b - a, c - a).inverse() * (place - a);
    let hit = Hit { triangle: point.triangle, u: at.x, v: at.y, t: 0.0 };
    let inside = at.min_element() >= 0.0 && at.element_sum() <= 1.0;
    inside.then(|| SurfacePoint { index: point.index, ..SurfacePoint::new(mesh, &hit, None) })
}

/// Whether nothing stands between two points.
fn sees(scene: &Scene, from: &SurfacePoint, to: &SurfacePoint) -> bool {
    let way = Vec3::from(to.position) - Vec3::from(from.position);
    let is_blocked = |direction: Vec3| scene.is_blocked(V3(from.position), V3(direction.to_array()), way.length());
    !way.try_normalize().is_some_and(is_blocked)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::{Texels, Workspace};
    use crate::cpu::CpuBackend;
    use crate::progress::Silent;

    /// Columns and rows of the map, of which the floor has the left half.
    const SIZE: [usize; 2] = [16, 8];
    const DOWN: Vec3 = Vec3::NEG_Y;

    /// A level square metre.
    fn floor() -> Mesh {
        let mut mesh = Mesh::default();
        add(&mut mesh, [Vec3::ZERO, Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::X], Vec2::ZERO);
        mesh
    }

    /// Adds four corners, counter-clockwise from the front, as half of the map from `uv` on.
    fn add(mesh: &mut Mesh, corners: [Vec3; 4], uv: Vec2) {
        let base = mesh.positions.len() as u32;
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        let sides = [Vec2::ZERO, Vec2::Y, Vec2::ONE, Vec2::X];
        mesh.positions.extend(corners);
        mesh.normals.extend([normal; 4]);
        mesh.uvs.extend(sides.map(|at| uv + at * Vec2::new(0.5, 1.0)));
        mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| base + i)));
    }

    /// E of the floor under a light from straight above, by column and row.
    fn of_floor(mesh: Mesh, subsamples: u32) -> Vec<Vec<f32>> {
        let mut backend = CpuBackend::new(Scene::new(mesh).unwrap());
        let texels = Texels::map(&mut backend, SIZE, Workspace::Memory, &Silent).unwrap();
        let points: Vec<SurfacePoint> = texels.points().flat_map(|points| points.unwrap().into_owned()).collect();
        let light = PunctualLight::Distant { direction: DOWN.to_array(), irradiance: [1.0; 3] };
        let found = irradiance(&mut backend, SIZE, &points, &[light], subsamples, &Silent).unwrap();
        let mut columns = vec![vec![0.0; SIZE[1]]; SIZE[0]];
        for (point, e) in points.iter().zip(found) {
            columns[point.index as usize % SIZE[0]][point.index as usize / SIZE[0]] = e[0];
        }
        columns.truncate(SIZE[0] / 2);
        columns
    }

    /// What is lit of a column of the floor that is in shadow up to x = `edge`.
    fn lit(column: usize, edge: f32) -> f32 {
        (column as f32 + 1.0 - 8.0 * edge).clamp(0.0, 1.0)
    }

    #[test]
    fn an_edge_of_shadow_within_a_texel_darkens_it_by_its_share() {
        let edge = 0.46;
        let mut mesh = floor();
        let z = |x: f32, z: f32| Vec3::new(x, 0.5, z);
        add(&mut mesh, [z(-9.0, -9.0), z(-9.0, 9.0), z(edge, 9.0), z(edge, -9.0)], Vec2::new(0.5, 0.0));
        let off = |subsamples: u32| {
            let columns = of_floor(mesh.clone(), subsamples);
            let off = columns
                .iter()
                .enumerate()
                .map(|(x, column)| column.iter().map(|e| (e - lit(x, edge)).abs()).fold(0.0, f32::max));
            off.fold(0.0, f32::max)
        };
        // The floor's diagonal goes through texels, of which a triangle has fewer places.
        assert!(off(16) < 0.15, "{}", off(16));
        // One place is in shadow, or is not.
        assert!(off(1) > 0.3, "{}", off(1));
    }

    #[test]
    fn floor_under_a_box_does_not_darken_the_texels_beside_it() {
        let edge = 0.54;
        let p = |y: f32| move |x: f32, z: f32| Vec3::new(x, y, z);
        let (top, bottom) = (p(0.01), p(-0.01));
        let mut lid = floor();
        let right = Vec2::new(0.5, 0.0);
        add(&mut lid, [top(-0.1, -0.1), top(-0.1, 1.1), top(edge, 1.1), top(edge, -0.1)], right);
        let mut closed = lid.clone();
        add(&mut closed, [bottom(edge, 1.1), bottom(edge, -0.1), top(edge, -0.1), top(edge, 1.1)], right);
        // The column that the box ends in, the point of whose texels lies beside the box.
        let column = |mesh: Mesh| of_floor(mesh, 16)[4].clone();
        assert!(lit(4, edge) > 0.6 && lit(4, edge) < 0.7);
        assert!(column(closed).iter().all(|e| *e == 1.0));
        assert!(column(lid).iter().all(|e| *e < 0.8), "a lid in the air shades them");
    }

    #[test]
    fn shadow_rays_are_few_beside_those_of_the_gather() {
        let asked = |rays: u32| [0, 1, 4, 9, 64, 100_000].map(|lights| subsamples(rays, lights));
        assert_eq!(asked(256), [16, 16, 16, 4, 1, 1]);
        assert_eq!(asked(1), [1; 6]);
        assert_eq!(asked(u32::MAX), [16; 6]);
    }
}
