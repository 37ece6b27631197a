//! The sides of light sources that no view sees: a lampshade shines to the back as well.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::Vec3;

use super::connectivity::Connectivity;
use crate::atlas::Atlas;
use crate::mesh::Mesh;
use crate::raster::mean_of_channels;

/// A triangle is a light source when at least this share of its seen texels are: a ceiling of which mostly its lamp is
/// seen shall not shine where it is not seen.
const SOURCES: f32 = 0.9;

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

/// Gives texels that are not `seen` the mean radiance of what is seen of their source. A triangle without a seen texel
/// is part of one if the nearest triangle along the surface that has some shines. Texels brighter than `limit` (mean
/// over the channels) shine. Texels that are known to be no source count as seen, whatever their radiance: a window's
/// frame does not shine where its pixels show mostly panes.
pub(super) fn shine(
    mesh: &Mesh,
    connectivity: &Connectivity,
    atlas: &Atlas,
    limit: f32,
    seen: &[bool],
    radiance: &mut [[f32; 3]],
) {
    let known = light_of_seen(mesh, atlas, limit, seen, radiance);
    let light = of_sources(&sources(mesh, connectivity, &known), connectivity, &known);
    for ((radiance, point), seen) in radiance.iter_mut().zip(&atlas.points).zip(seen) {
        if let (Some(light), false) = (light[point.triangle as usize], seen) {
            *radiance = light;
        }
    }
}

/// What is seen of a triangle.
#[derive(Clone, Copy, Default)]
struct SeenOfTriangle {
    /// Texels.
    texels: u32,
    /// Those of them that emit.
    sources: u32,
    /// Sum of the radiance of those.
    light: Vec3,
}

impl SeenOfTriangle {
    fn shines(&self) -> bool {
        self.sources as f32 > SOURCES * self.texels as f32
    }
}

/// What is seen of each triangle.
fn light_of_seen(mesh: &Mesh, atlas: &Atlas, limit: f32, seen: &[bool], radiance: &[[f32; 3]]) -> Vec<SeenOfTriangle> {
    let mut known = vec![SeenOfTriangle::default(); mesh.triangles.len()];
    for ((point, radiance), _) in atlas.points.iter().zip(radiance).zip(seen).filter(|(_, seen)| **seen) {
        let triangle = &mut known[point.triangle as usize];
        triangle.texels += 1;
        if mean_of_channels(*radiance) > limit {
            triangle.sources += 1;
            triangle.light += Vec3::from(*radiance);
        }
    }
    known
}

/// Which triangles are part of a source: of those that are not seen, the ones whose nearest seen triangle is, both
/// along the surface and along their smooth part of it, where that has one. The dark rim of a spot is nearer to its
/// shining face than to what is seen of the rim.
fn sources(mesh: &Mesh, connectivity: &Connectivity, known: &[SeenOfTriangle]) -> Vec<bool> {
    let nearest = spread(mesh, known, |t| connectivity.of(t));
    let smooth = spread(mesh, known, |t| {
        connectivity.of(t).filter(move |&next| connectivity.part(next) == connectivity.part(t))
    });
    nearest.into_iter().zip(smooth).map(|(nearest, smooth)| nearest == Some(true) && smooth != Some(false)).collect()
}

/// Whether the nearest seen triangle shines, along paths from neighbour to neighbour (Dijkstra); `None` where none
/// leads to one.
fn spread<N: Iterator<Item = u32>>(
    mesh: &Mesh,
    known: &[SeenOfTriangle],
    neighbours: impl Fn(u32) -> N,
) -> Vec<Option<bool>> {
    let centre = |t: u32| mesh.corners(t).iter().sum::<Vec3>() / 3.0;
    let is_known = |t: u32| known[t as usize].texels > 0;
    let mut shines: Vec<Option<bool>> = known.iter().map(|seen| (seen.texels > 0).then(|| seen.shines())).collect();
    let all = 0..known.len() as u32;
    let mut distance: Vec<f32> = all.clone().map(|t| if is_known(t) { 0.0 } else { f32::INFINITY }).collect();
    let mut fronts: BinaryHeap<Front> =
        all.filter(|&t| is_known(t)).map(|triangle| Front { distance: 0.0, triangle }).collect();
    while let Some(Front { distance: so_far, triangle }) = fronts.pop() {
        if so_far > distance[triangle as usize] {
            continue;
        }
        for next in neighbours(triangle) {
            let new = so_far + centre(triangle).distance(centre(next));
            if new < distance[next as usize] {
                distance[next as usize] = new;
                shines[next as usize] = shines[triangle as usize];
                fronts.push(Front { distance: new, triangle: next });
            }
        }
    }
    shines
}

/// The light of each triangle that `shines`: the mean over what is seen of those that it is connected with. What is
/// seen at the rim of a lamp alone, where a pixel shows more of what is behind it, is little evidence of its back.
fn of_sources(shines: &[bool], connectivity: &Connectivity, known: &[SeenOfTriangle]) -> Vec<Option<[f32; 3]>> {
    let mut light = vec![None; shines.len()];
    let mut visited = vec![false; shines.len()];
    let mut visit = |t: u32| shines[t as usize] && !std::mem::replace(&mut visited[t as usize], true);
    for first in 0..shines.len() as u32 {
        let mut source: Vec<u32> = Some(first).filter(|t| visit(*t)).into_iter().collect();
        let (mut texels, mut sum) = (0, Vec3::ZERO);
        let mut at = 0;
        while let Some(&triangle) = source.get(at) {
            at += 1;
            texels += known[triangle as usize].sources;
            sum += known[triangle as usize].light;
            source.extend(connectivity.of(triangle).filter(|t| visit(*t)));
        }
        let mean = (sum / texels.max(1) as f32).to_array();
        source.into_iter().for_each(|t| light[t as usize] = Some(mean));
    }
    light
}
