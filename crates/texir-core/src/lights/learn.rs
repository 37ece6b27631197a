//! Tables of a scene's lights by place: what each cluster contributes to a cell's surface, found with shadow rays.
//!
//! Variance is least when clusters are drawn in proportion to the RMS of their contributions, visibility included
//! (Vévoda, Kondapaneni and Křivánek, "Bayesian online regression for adaptive direct illumination sampling", SIGGRAPH
//! 2018, with a plain estimate in place of their regression).

use glam::Vec3;
use rayon::prelude::*;

use super::{LightGrid, Lights};
use crate::distribution::cdf;
use crate::mesh::bounds;
use crate::real::V3;
use crate::rng::{hash2, sobol2};
use crate::scene::Scene;
use crate::scene::trace::Trace;
use crate::surface::SurfacePoint;

/// The surface of the scene over the area of a cell's side: about half the number of its cells, at most.
const CELLS: f32 = 2048.0;
/// Texels over the area of a cell's side, at least: a cell without a texel would have no table.
const TEXELS: f32 = 8.0;
/// Most cells of the grid, empty ones included: bounds memory where small objects stand far apart.
const GRID_CELLS: f32 = (1 << 20) as f32;
/// Shadow rays per cell and cluster.
const RAYS: u32 = 16;
/// Share of what clusters would contribute if nothing hid them: for what so few rays miss.
const UNSEEN: f32 = 0.1;
/// Lights nearer than this share of a cell's edge count as that far.
const NEAREST: f32 = 0.1;

/// The same lights with a table for every cell that holds some of `points`.
pub fn learn(mut lights: Lights, scene: &Scene, points: &[SurfacePoint]) -> Lights {
    if lights.is_empty() || points.is_empty() {
        return lights;
    }
    lights.grid = grid(scene, points);
    let cell = |p: &SurfacePoint| lights.grid.cell(p.position.into(), p.normal.into());
    let mut members: Vec<(usize, u32)> = (0..).zip(points).filter_map(|(i, p)| Some((cell(p)?, i))).collect();
    members.par_sort_unstable();
    let cells: Vec<&[(usize, u32)]> = members.chunk_by(|a, b| a.0 == b.0).collect();
    let tables: Vec<Option<Vec<f32>>> = (cells.par_iter())
        .map(|cell| {
            let weights: Vec<f32> = (0..lights.clusters.len() - 1)
                .map(|cluster| {
                    let point = |k: u32| &points[cell[k as usize % cell.len()].1 as usize];
                    contribution(&lights, scene, cluster, hash2(cell[0].0 as u32, cluster as u32), point)
                })
                .collect();
            (weights.iter().sum::<f32>() > 0.0).then(|| cdf(&weights))
        })
        .collect();
    let mut number = 0;
    for (cell, table) in cells.iter().zip(tables) {
        let Some(table) = table else { continue };
        number += 1;
        lights.grid.tables[cell[0].0] = number;
        lights.tables.extend(table);
    }
    lights
}

/// A grid around the points.
fn grid(scene: &Scene, points: &[SurfacePoint]) -> LightGrid {
    let area: f64 = (0..scene.mesh().triangles.len() as u32).map(|t| f64::from(scene.mesh().area(t))).sum();
    let (low, high) = bounds(points.iter().map(|p| Vec3::from(p.position)));
    let size = |edge: f32| ((high - low) / edge).floor() + 1.0;
    let cells = CELLS.min(points.len() as f32 / TEXELS);
    let mut edge = (area as f32 / cells).sqrt().max(f32::MIN_POSITIVE);
    while !(size(edge).element_product() <= GRID_CELLS) {
        edge *= 1.25;
    }
    let size = size(edge).to_array().map(|n| n as u32);
    let cells = size.iter().product::<u32>() as usize;
    LightGrid { origin: low, per_metre: 1.0 / edge, size, tables: vec![0; 6 * cells] }
}

/// Root of the mean square of a cluster's irradiance at a cell, by [`RAYS`] pairs of a point there and one on the
/// cluster.
fn contribution<'a>(
    lights: &Lights,
    scene: &Scene,
    cluster: usize,
    seed: u32,
    point: impl Fn(u32) -> &'a SurfacePoint,
) -> f32 {
    let mesh = scene.mesh();
    let nearest = (NEAREST / lights.grid.per_metre).powi(2);
    let (mut seen, mut open) = (0.0f32, 0.0f32);
    for i in 0..RAYS {
        let point = point(hash2(seed, i));
        let [u, v] = sobol2(i, seed);
        let (light, u) = lights.part(cluster, u);
        let origin = V3(point.position);
        let to = light.point(mesh, [u, v]) - origin;
        let squared = to.dot(to);
        let direction = to * (1.0 / squared.sqrt());
        let cosine = V3(point.normal).dot(direction);
        let towards = -mesh.face_normal(light.triangle).dot(Vec3::from(direction.0));
        if !(cosine > 0.0 && towards > 0.0) {
            continue;
        }
        // L / density is the cluster's power, the same for all its points.
        let square = (cosine * towards / squared.max(nearest)).powi(2);
        open += square;
        if scene.closest(origin, direction).is_some_and(|hit| hit.triangle == light.triangle) {
            seen += square;
        }
    }
    let root = |sum: f32| (sum / RAYS as f32).sqrt();
    lights.power(cluster) * (UNSEEN * root(open) + (1.0 - UNSEEN) * root(seen))
}
