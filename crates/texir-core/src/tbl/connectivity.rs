//! Triangles that are connected along the surface, whether or not they share vertices.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::mesh::{Mesh, weld};
use crate::stats::median;

/// Cells that an edge is found in, at most.
const STEPS: f32 = 4096.0;
/// Edges are two sides of a crack when the middle of one is within this share of its length of the other.
const CRACK: f32 = 0.5;
/// Vertices at most about this far apart, metres, are one: charts of the atlas do not share theirs.
const WELD: f32 = 1e-4;
/// Cosine of the angle by which neighbours differ at a crease: sides of what is meant to be round differ by less.
const CREASE: f32 = 0.75;

/// Which triangles are neighbours, in both directions, and which smooth parts of the surface they make up.
pub(super) struct Connectivity {
    /// The triangles across each triangle's edges. An edge of more than two triangles joins them in pairs.
    across: Vec<[Option<u32>; 3]>,
    /// What lies beyond edges of a single triangle.
    cracks: HashMap<u32, Vec<u32>>,
    /// The part of the surface without a crease that each triangle is in, by its first triangle.
    part: Vec<u32>,
}

impl Connectivity {
    /// Of all triangles.
    pub fn new(mesh: &Mesh) -> Self {
        let (vertex, _) = weld(mesh.positions.iter().map(|p| (p / WELD).round().as_ivec3()));
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
        let mut open: Vec<OpenEdge> =
            open.into_values().map(|(triangle, edge)| OpenEdge::new(mesh, triangle, edge)).collect();
        open.sort_unstable_by_key(|edge| (edge.triangle, edge.edge));
        let mut cracks: HashMap<u32, Vec<u32>> = HashMap::new();
        for (edge, other) in open.iter().zip(across_cracks(&open)) {
            if let Some(other) = other {
                cracks.entry(edge.triangle).or_default().push(other);
                cracks.entry(other).or_default().push(edge.triangle);
            }
        }
        let mut connectivity = Self { across, cracks, part: Vec::new() };
        connectivity.part = connectivity.smooth_parts(mesh);
        connectivity
    }

    /// The triangles beside one.
    pub fn of(&self, triangle: u32) -> impl Iterator<Item = u32> {
        let cracks = self.cracks.get(&triangle).into_iter().flatten();
        self.across[triangle as usize].iter().flatten().chain(cracks).copied()
    }

    /// The part of the surface that a triangle is in: what is connected to it without a crease between. Named by one of
    /// its triangles.
    pub fn part(&self, triangle: u32) -> u32 {
        self.part[triangle as usize]
    }

    fn smooth_parts(&self, mesh: &Mesh) -> Vec<u32> {
        let normals: Vec<Vec3> =
            (0..mesh.triangles.len() as u32).map(|t| mesh.face_normal(t).normalize_or_zero()).collect();
        let mut part: Vec<Option<u32>> = vec![None; normals.len()];
        for first in 0..part.len() as u32 {
            let mut front = if part[first as usize].is_none() { vec![first] } else { continue };
            part[first as usize] = Some(first);
            while let Some(t) = front.pop() {
                for next in self.of(t) {
                    let smooth = normals[t as usize].dot(normals[next as usize]) > CREASE;
                    if smooth && part[next as usize].is_none() {
                        part[next as usize] = Some(first);
                        front.push(next);
                    }
                }
            }
        }
        part.into_iter().flatten().collect()
    }
}

/// An edge that no other triangle has.
struct OpenEdge {
    triangle: u32,
    edge: usize,
    ends: [Vec3; 2],
}

impl OpenEdge {
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

/// The triangle whose edge is nearest to the middle of each edge, where it is no further away than [`CRACK`] of its
/// length: parts of an object that meet with other vertices, as the cover of a lampshade and its side.
fn across_cracks(edges: &[OpenEdge]) -> Vec<Option<u32>> {
    let mut lengths: Vec<f32> = edges.iter().map(OpenEdge::length).collect();
    let Some(median) = median(&mut lengths) else { return Vec::new() };
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
    let nearest = |edge: &OpenEdge| {
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
