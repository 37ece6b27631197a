//! Which texels are neighbours on the surface: beside each other in a chart, or on the two sides of a seam.

use std::collections::HashMap;

use glam::{IVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::atlas::{Atlas, TexelIndex};
use crate::disjoint_sets::DisjointSets;
use crate::fit::index::NONE;
use crate::mesh::Mesh;

/// Texels this many texel edges apart on the surface do not belong together, even side by side in the atlas.
const REACH: f32 = 3.0;
/// Vertices closer than this share of the scene's extent are one.
const WELD: f32 = 1e-5;

/// Neighbours of the valid texels, by index into [`Atlas::texels`].
pub struct Adjacency {
    /// Left, right, up and down in the chart, or [`NONE`].
    pub beside: Vec<[u32; 4]>,
    /// Pairs across the seams between charts, from both sides, ascending.
    pub seams: Vec<[u32; 2]>,
    /// Which texels are the first of a pair in `seams`.
    is_at_seam: Vec<bool>,
}

impl Adjacency {
    /// The neighbours in an atlas.
    pub fn new(mesh: &Mesh, atlas: &Atlas) -> Self {
        let index = TexelIndex::new(atlas);
        let position = |i: u32| Vec3::from(atlas.points[i as usize].position);
        let beside = atlas
            .texels
            .par_iter()
            .enumerate()
            .map(|(i, &texel)| {
                let (x, y) = ((texel as usize % atlas.width) as i64, (texel as usize / atlas.width) as i64);
                let reach = REACH * atlas.texel_area(mesh, atlas.points[i].triangle).sqrt();
                [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(dx, dy)| {
                    let near = |&n: &u32| {
                        let other = REACH * atlas.texel_area(mesh, atlas.points[n as usize].triangle).sqrt();
                        position(i as u32).distance(position(n)) < reach.max(other)
                    };
                    index.at(x + dx, y + dy).filter(near).unwrap_or(NONE)
                })
            })
            .collect();
        Self::of(beside, seams(mesh, atlas, &index))
    }

    /// The neighbours `beside` each texel, and `seams` from both sides, ascending.
    pub(super) fn of(beside: Vec<[u32; 4]>, seams: Vec<[u32; 2]>) -> Self {
        let mut is_at_seam = vec![false; beside.len()];
        seams.iter().for_each(|[texel, _]| is_at_seam[*texel as usize] = true);
        Self { beside, seams, is_at_seam }
    }

    /// All neighbours of a texel: beside it, and across seams.
    pub fn around(&self, texel: u32) -> impl Iterator<Item = u32> + '_ {
        let seams = if self.is_at_seam[texel as usize] { &self.seams[..] } else { &[] };
        let first = seams.partition_point(|pair| pair[0] < texel);
        let across = seams[first..].iter().take_while(move |pair| pair[0] == texel).map(|pair| pair[1]);
        self.beside[texel as usize].into_iter().filter(|&n| n != NONE).chain(across)
    }

    /// Numbers the regions of texels in which neighbours, and the `pairs` besides, belong together; and their count.
    pub fn regions(&self, pairs: &[[u32; 2]], together: impl Fn(u32, u32) -> bool) -> (Vec<u32>, usize) {
        let count = self.beside.len();
        let mut sets = DisjointSets::new(count);
        let mut join = |a: u32, b: u32| {
            if together(a, b) {
                sets.join(a, b);
            }
        };
        // Each pair once: with the right and the lower neighbour, and from one side of seams.
        for (i, [_, right, _, down]) in (0..).zip(&self.beside) {
            [right, down].into_iter().filter(|n| **n != NONE).for_each(|n| join(i, *n));
        }
        self.seams.iter().filter(|[a, b]| a < b).chain(pairs).for_each(|[a, b]| join(*a, *b));
        let mut numbers = vec![NONE; count];
        let mut regions = 0;
        let numbered = (0..count as u32)
            .map(|i| {
                let root = sets.root(i) as usize;
                if numbers[root] == NONE {
                    numbers[root] = regions;
                    regions += 1;
                }
                numbers[root]
            })
            .collect();
        (numbered, regions as usize)
    }

    /// All texels that one touches: those [around](Self::around) it, and those at its corners in the chart.
    pub fn touching(&self, texel: u32) -> impl Iterator<Item = u32> + '_ {
        let step = |from: u32, side: usize| match from {
            NONE => NONE,
            from => self.beside[from as usize][side],
        };
        let corner = move |[across, along]: [usize; 2]| match step(step(texel, across), along) {
            NONE => step(step(texel, along), across),
            corner => corner,
        };
        let corners = [[0, 2], [0, 3], [1, 2], [1, 3]].into_iter().map(corner);
        self.around(texel).chain(corners.filter(|&n| n != NONE))
    }
}

/// Texels on the two sides of every mesh edge whose faces lie in different charts.
fn seams(mesh: &Mesh, atlas: &Atlas, index: &TexelIndex) -> Vec<[u32; 2]> {
    let (low, high) = mesh.bounds();
    let grid = (high - low).max_element().max(f32::MIN_POSITIVE) * WELD;
    let weld = |p: Vec3| ((p - low) / grid).round().as_ivec3();
    /// The corners of an edge in the atlas, in the order of their welded positions.
    type Edge = [Vec2; 2];
    let mut first: HashMap<(IVec3, IVec3), Edge> = HashMap::new();
    let mut pairs = Vec::new();
    let size = Vec2::new(atlas.width as f32, atlas.height as f32);
    for triangle in 0..mesh.triangles.len() as u32 {
        let (corners, uvs) = (mesh.corners(triangle), mesh.corner_uvs(triangle));
        for i in 0..3 {
            let (a, b) = (weld(corners[i]), weld(corners[(i + 1) % 3]));
            let (key, edge) = if a.to_array() < b.to_array() {
                ((a, b), [uvs[i], uvs[(i + 1) % 3]])
            } else {
                ((b, a), [uvs[(i + 1) % 3], uvs[i]])
            };
            match first.remove(&key) {
                None => {
                    first.insert(key, edge);
                }
                Some(other) if other == edge => {}
                Some(other) => {
                    let steps = ((edge[1] - edge[0]) * size).length().ceil().clamp(1.0, 4096.0) as usize;
                    for s in 0..=steps {
                        let t = s as f32 / steps as f32;
                        let pair = [&other, &edge].map(|side| index.nearest(side[0].lerp(side[1], t)));
                        if let [Some(a), Some(b)] = pair
                            && a != b
                        {
                            pairs.extend([[a, b], [b, a]]);
                        }
                    }
                }
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}
