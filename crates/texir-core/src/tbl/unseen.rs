//! The sides of light sources that no view sees: a lampshade shines to the back as well.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::inpaint;
use crate::mesh::Mesh;

/// Vertices at most about this far apart, metres, are one: charts of the atlas do not share theirs.
const WELD: f32 = 1e-4;
/// A triangle is a light source when at least this share of its seen texels are: a ceiling of which mostly its lamp is seen
/// shall not shine where it is not seen.
const SOURCES: f32 = 0.9;
/// Edges are two sides of a crack when the middle of one is within this share of its length of the other.
const CRACK: f32 = 0.5;
/// Cells that an edge is found in, at most.
const STEPS: f32 = 4096.0;

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

/// Gives the texels that are not `seen` the light of the source that they are part of: a triangle without a seen texel belongs
/// to the nearest one along the surface that has some, and shines if that does, as bright as what is seen of the whole source.
/// Texels brighter than `limit` (mean over the channels) shine. Texels that are known to be no source count as seen, whatever
/// their radiance: a window's frame does not shine where its pixels show mostly panes.
pub(super) fn shine(mesh: &Mesh, atlas: &Atlas, limit: f32, seen: &[bool], radiance: &mut [[f32; 3]]) {
    let neighbours = Neighbours::new(mesh);
    let known = light_of_seen(mesh, atlas, limit, seen, radiance);
    let light = of_sources(&spread(mesh, &neighbours, &known), &neighbours, &known);
    for ((radiance, point), seen) in radiance.iter_mut().zip(&atlas.points).zip(seen) {
        if let (Some(light), false) = (light[point.triangle as usize], seen) {
            *radiance = light;
        }
    }
}

/// What is seen of a triangle.
#[derive(Clone, Copy, Default)]
struct Seen {
    /// Texels.
    texels: u32,
    /// Those of them that shine,
    sources: u32,
    /// and the sum of their radiance.
    light: Vec3,
}

impl Seen {
    fn shines(&self) -> bool {
        self.sources as f32 > SOURCES * self.texels as f32
    }
}

/// What is seen of each triangle.
fn light_of_seen(mesh: &Mesh, atlas: &Atlas, limit: f32, seen: &[bool], radiance: &[[f32; 3]]) -> Vec<Seen> {
    let mut known = vec![Seen::default(); mesh.triangles.len()];
    for ((point, radiance), _) in atlas.points.iter().zip(radiance).zip(seen).filter(|(_, seen)| **seen) {
        let triangle = &mut known[point.triangle as usize];
        triangle.texels += 1;
        if inpaint::mean(*radiance) > limit {
            triangle.sources += 1;
            triangle.light += Vec3::from(*radiance);
        }
    }
    known
}

/// Which triangles are part of a source: of those that are not seen, the ones whose nearest seen triangle is, along paths from
/// neighbour to neighbour (Dijkstra).
fn spread(mesh: &Mesh, neighbours: &Neighbours, known: &[Seen]) -> Vec<bool> {
    let centre = |t: u32| mesh.corners(t).iter().sum::<Vec3>() / 3.0;
    let is_known = |t: u32| known[t as usize].texels > 0;
    let mut shines: Vec<bool> = known.iter().map(|seen| seen.texels > 0 && seen.shines()).collect();
    let all = 0..known.len() as u32;
    let mut distance: Vec<f32> = all.clone().map(|t| if is_known(t) { 0.0 } else { f32::INFINITY }).collect();
    let mut fronts: BinaryHeap<Front> =
        all.filter(|&t| is_known(t)).map(|triangle| Front { distance: 0.0, triangle }).collect();
    while let Some(Front { distance: so_far, triangle }) = fronts.pop() {
        if so_far > distance[triangle as usize] {
            continue;
        }
        for next in neighbours.of(triangle) {
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

/// The light of each triangle that `shines`: the mean over what is seen of those that it is connected with. What is seen at the
/// rim of a lamp alone, where a pixel shows more of what is behind it, is little evidence of its back.
fn of_sources(shines: &[bool], neighbours: &Neighbours, known: &[Seen]) -> Vec<Option<[f32; 3]>> {
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
            source.extend(neighbours.of(triangle).filter(|t| visit(*t)));
        }
        let mean = (sum / texels.max(1) as f32).to_array();
        source.into_iter().for_each(|t| light[t as usize] = Some(mean));
    }
    light
}

/// Which triangles are neighbours, in both directions.
struct Neighbours {
    /// The triangles across each triangle's edges. An edge of more than two triangles joins them in pairs.
    across: Vec<[Option<u32>; 3]>,
    /// What lies beyond edges of a single triangle.
    cracks: HashMap<u32, Vec<u32>>,
}

impl Neighbours {
    fn new(mesh: &Mesh) -> Self {
        let mut welded: HashMap<IVec3, u32> = HashMap::new();
        let vertex: Vec<u32> = mesh
            .positions
            .iter()
            .enumerate()
            .map(|(i, p)| *welded.entry((p / WELD).round().as_ivec3()).or_insert(i as u32))
            .collect();
        let mut open: HashMap<(u32, u32), (u32, usize)> = HashMap::new();
        let mut across = vec![[None; 3]; mesh.triangles.len()];
        for (triangle, corners) in (0..).zip(&mesh.triangles) {
            for edge in 0..3 {
                let [a, b] = [corners[edge], corners[(edge + 1) % 3]].map(|corner| vertex[corner as usize]);
                let key = (a.min(b), a.max(b));
                match open.remove(&key) {
                    Some((other, its_edge)) => {
                        across[triangle as usize][edge] = Some(other);
                        across[other as usize][its_edge] = Some(triangle);
                    }
                    None => drop(open.insert(key, (triangle, edge))),
                }
            }
        }
        let mut open: Vec<Edge> = open.into_values().map(|(triangle, edge)| Edge::new(mesh, triangle, edge)).collect();
        open.sort_unstable_by_key(|edge| (edge.triangle, edge.edge));
        let mut cracks: HashMap<u32, Vec<u32>> = HashMap::new();
        for (edge, other) in open.iter().zip(across_cracks(&open)) {
            if let Some(other) = other {
                cracks.entry(edge.triangle).or_default().push(other);
                cracks.entry(other).or_default().push(edge.triangle);
            }
        }
        Self { across, cracks }
    }

    fn of(&self, triangle: u32) -> impl Iterator<Item = u32> {
        let cracks = self.cracks.get(&triangle).into_iter().flatten();
        self.across[triangle as usize].iter().flatten().chain(cracks).copied()
    }
}

/// An edge that no other triangle has.
struct Edge {
    triangle: u32,
    edge: usize,
    ends: [Vec3; 2],
}

impl Edge {
    fn new(mesh: &Mesh, triangle: u32, edge: usize) -> Self {
        let corners = mesh.corners(triangle);
        Self { triangle, edge, ends: [corners[edge], corners[(edge + 1) % 3]] }
    }

    fn length(&self) -> f32 {
        self.ends[0].distance(self.ends[1])
    }

    fn middle(&self) -> Vec3 {
        self.ends[0].midpoint(self.ends[1])
    }

    fn distance(&self, point: Vec3) -> f32 {
        let along = self.ends[1] - self.ends[0];
        let t = (point - self.ends[0]).dot(along) / along.length_squared().max(f32::MIN_POSITIVE);
        (self.ends[0] + along * t.clamp(0.0, 1.0)).distance(point)
    }
}

/// The triangle whose edge is nearest to the middle of each edge, where it is no further away than [`CRACK`] of its length: parts
/// of an object that meet with other vertices, as the cover of a lampshade and its side.
fn across_cracks(edges: &[Edge]) -> Vec<Option<u32>> {
    let mut lengths: Vec<f32> = edges.iter().map(Edge::length).collect();
    let middle = lengths.len() / 2;
    let Some(&mut median) = (!lengths.is_empty()).then(|| lengths.select_nth_unstable_by(middle, f32::total_cmp).1)
    else {
        return Vec::new();
    };
    let cell = median.max(WELD);
    let cell_of = |point: Vec3| (point / cell).floor().as_ivec3();
    let mut cells: HashMap<IVec3, Vec<u32>> = HashMap::new();
    for (i, edge) in (0..).zip(edges) {
        let steps = (2.0 * edge.length() / cell).ceil().clamp(1.0, STEPS) as u32;
        for step in 0..=steps {
            let members =
                cells.entry(cell_of(edge.ends[0].lerp(edge.ends[1], step as f32 / steps as f32))).or_default();
            if members.last() != Some(&i) {
                members.push(i);
            }
        }
    }
    let nearest = |edge: &Edge| {
        let (middle, most) = (edge.middle(), CRACK * edge.length());
        let reach = most.min(cell);
        let [low, high] = [cell_of(middle - reach), cell_of(middle + reach)];
        (low.x..=high.x)
            .flat_map(|x| (low.y..=high.y).flat_map(move |y| (low.z..=high.z).map(move |z| IVec3::new(x, y, z))))
            .flat_map(|at| cells.get(&at).into_iter().flatten())
            .map(|&i| &edges[i as usize])
            .filter(|other| other.triangle != edge.triangle)
            .map(|other| (other.distance(middle), other.triangle))
            .filter(|(distance, _)| *distance <= most)
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            .map(|(_, triangle)| triangle)
    };
    edges.par_iter().map(nearest).collect()
}
