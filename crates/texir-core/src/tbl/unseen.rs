//! The sides of light sources that no view sees: a lampshade shines to the back as well.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

use glam::{IVec3, Vec3};

use crate::atlas::Atlas;
use crate::inpaint;
use crate::mesh::Mesh;

/// Vertices at most about this far apart, metres, are one: charts of the atlas do not share theirs.
const WELD: f32 = 1e-4;
/// A triangle is a light source when at least this share of its seen texels are: a ceiling of which mostly its lamp is seen
/// shall not shine where it is not seen.
const SOURCES: f32 = 0.9;
/// Keeps the logarithm of black finite; far below any radiance that matters.
const BLACK: f32 = 1e-6;

/// A triangle on the way along the surface, nearest first.
#[derive(PartialEq)]
struct Front {
    distance: f32,
    triangle: u32,
}

impl Eq for Front {}

impl Ord for Front {
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance).then(other.triangle.cmp(&self.triangle))
    }
}

impl PartialOrd for Front {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Gives the texels that no view sees the light of the nearest seen triangle along the surface, if that is a light source;
/// texels brighter than `limit` (mean over the channels) are.
pub(super) fn shine(mesh: &Mesh, atlas: &Atlas, limit: f32, radiance: &mut [Option<[f32; 3]>]) {
    let light = spread(mesh, &light_of_seen(mesh, atlas, limit, radiance));
    for (radiance, point) in radiance.iter_mut().zip(&atlas.points) {
        *radiance = radiance.or(light[point.triangle as usize]);
    }
}

/// Per triangle: nothing if no texel of it is seen, otherwise its light, if it is a source (geometric mean).
fn light_of_seen(
    mesh: &Mesh,
    atlas: &Atlas,
    limit: f32,
    radiance: &[Option<[f32; 3]>],
) -> Vec<Option<Option<[f32; 3]>>> {
    let mut seen = vec![(0u32, 0u32, Vec3::ZERO); mesh.triangles.len()];
    for (point, radiance) in atlas.points.iter().zip(radiance).filter_map(|(p, r)| Some((p, (*r)?))) {
        let (all, sources, logs) = &mut seen[point.triangle as usize];
        *all += 1;
        if inpaint::mean(radiance) > limit {
            *sources += 1;
            *logs += (Vec3::from(radiance) + BLACK).map(f32::ln);
        }
    }
    let light = |(all, sources, logs): (u32, u32, Vec3)| {
        (sources as f32 > SOURCES * all as f32).then(|| (logs / sources as f32).map(f32::exp).to_array())
    };
    seen.into_iter().map(|triangle| (triangle.0 > 0).then(|| light(triangle))).collect()
}

/// Every triangle takes what the nearest triangle that is known has, along paths over shared edges (Dijkstra).
fn spread(mesh: &Mesh, known: &[Option<Option<[f32; 3]>>]) -> Vec<Option<[f32; 3]>> {
    let neighbours = neighbours(mesh);
    let centre = |t: u32| mesh.corners(t).iter().sum::<Vec3>() / 3.0;
    let mut light: Vec<Option<[f32; 3]>> = known.iter().map(|k| k.flatten()).collect();
    let mut distance: Vec<f32> = known.iter().map(|k| if k.is_some() { 0.0 } else { f32::INFINITY }).collect();
    let mut fronts: BinaryHeap<Front> = (0..known.len() as u32)
        .filter(|&t| known[t as usize].is_some())
        .map(|triangle| Front { distance: 0.0, triangle })
        .collect();
    while let Some(Front { distance: so_far, triangle }) = fronts.pop() {
        if so_far > distance[triangle as usize] {
            continue;
        }
        for &next in neighbours[triangle as usize].iter().flatten() {
            let new = so_far + centre(triangle).distance(centre(next));
            if new < distance[next as usize] {
                distance[next as usize] = new;
                light[next as usize] = light[triangle as usize];
                fronts.push(Front { distance: new, triangle: next });
            }
        }
    }
    light
}

/// The triangles across each triangle's edges. An edge of more than two triangles joins them in pairs.
fn neighbours(mesh: &Mesh) -> Vec<[Option<u32>; 3]> {
    let mut welded: HashMap<IVec3, u32> = HashMap::new();
    let vertex: Vec<u32> = mesh
        .positions
        .iter()
        .enumerate()
        .map(|(i, p)| *welded.entry((p / WELD).round().as_ivec3()).or_insert(i as u32))
        .collect();
    let mut open: HashMap<(u32, u32), (u32, usize)> = HashMap::new();
    let mut neighbours = vec![[None; 3]; mesh.triangles.len()];
    for (triangle, corners) in (0..).zip(&mesh.triangles) {
        for edge in 0..3 {
            let [a, b] = [corners[edge], corners[(edge + 1) % 3]].map(|corner| vertex[corner as usize]);
            let key = (a.min(b), a.max(b));
            match open.remove(&key) {
                Some((other, its_edge)) => {
                    neighbours[triangle as usize][edge] = Some(other);
                    neighbours[other as usize][its_edge] = Some(triangle);
                }
                None => drop(open.insert(key, (triangle, edge))),
            }
        }
    }
    neighbours
}
