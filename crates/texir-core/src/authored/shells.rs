//! The connected pieces of double-sided surfaces.

use std::collections::HashMap;

use super::gltf::{Model, Part};
use super::layout::{PlacedPart, placed};
use super::reach::Patch;
use crate::disjoint_sets::DisjointSets;
use crate::mesh::weld;

/// A connected piece of a double-sided primitive.
pub(super) struct Shell {
    /// Index of the primitive.
    pub part: usize,
    pub patch: Patch,
    /// Whether both of its sides shine. Nobody sees the inside of a lamp that is closed.
    pub is_lamp: bool,
}

impl Model {
    /// Whether a part is double-sided, and there for light.
    pub(super) fn has_two_sides(&self, part: &Part) -> bool {
        self.is_double_sided(part) && !part.is_transparent()
    }

    /// The pieces of all double-sided primitives, of which some triangles shine.
    pub(super) fn shells(&self, shines: &[bool]) -> Vec<Shell> {
        let shells_of = |placed: PlacedPart<'_>| {
            let shell = move |piece: Vec<(u32, [u32; 3])>| {
                let triangles: Vec<u32> = piece.iter().map(|(index, _)| placed.triangles.start + index).collect();
                let shines = triangles.iter().any(|&triangle| shines[triangle as usize]);
                let is_lamp = shines && !is_closed(&piece);
                Shell { part: placed.index, is_lamp, patch: Patch::new(&self.mesh, triangles) }
            };
            pieces(placed.part).into_iter().map(shell)
        };
        placed(&self.parts).filter(|placed| self.has_two_sides(placed.part)).flat_map(shells_of).collect()
    }
}

/// The connected pieces of a part, by the places of its vertices: the index of every triangle, and the places of its
/// corners.
fn pieces(part: &Part) -> Vec<Vec<(u32, [u32; 3])>> {
    // Zero has one sign.
    let (places, firsts) = weld(part.positions.iter().map(|p| p.to_array().map(|v| (v + 0.0).to_bits())));
    let mut sets = DisjointSets::new(firsts.len());
    let corners = |triangle: &[u32; 3]| triangle.map(|vertex| places[vertex as usize]);
    for [a, b, c] in part.triangles.iter().map(corners) {
        sets.join(a, b);
        sets.join(b, c);
    }
    let (mut pieces, mut numbers) = (Vec::<Vec<_>>::new(), HashMap::new());
    for (index, triangle) in (0..).zip(&part.triangles) {
        let corners = corners(triangle);
        let number = *numbers.entry(sets.root(corners[0])).or_insert_with(|| {
            pieces.push(Vec::new());
            pieces.len() - 1
        });
        pieces[number].push((index, corners));
    }
    pieces
}

/// Whether every edge of triangles is one of two that run opposite ways.
fn is_closed(triangles: &[(u32, [u32; 3])]) -> bool {
    let mut balance = HashMap::new();
    for (_, [a, b, c]) in triangles {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            *balance.entry([from.min(to), from.max(to)]).or_insert(0i32) += if from < to { 1 } else { -1 };
        }
    }
    balance.values().all(|balance| *balance == 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A part of triangles whose corners are integers in the plane.
    fn part(triangles: &[[[i8; 3]; 3]]) -> Part {
        let corners = triangles.as_flattened().iter();
        Part {
            positions: corners.map(|corner| corner.map(f32::from).into()).collect(),
            normals: vec![],
            uvs: vec![],
            has_uvs: vec![],
            triangles: (0..triangles.len() as u32).map(|t| [0, 1, 2].map(|k| 3 * t + k)).collect(),
            material: None,
            name: String::new(),
            opacity: vec![],
        }
    }

    #[test]
    fn pieces_are_told_by_their_places_and_closed_ones_by_their_edges() {
        let [o, x, y, z] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];
        let tetrahedron = [[o, y, x], [o, x, z], [o, z, y], [x, y, z]];
        let far = [[9, 0, 0], [8, 0, 0], [9, 1, 0]];
        let [solid, alone] = &pieces(&part(&[&tetrahedron[..2], &[far], &tetrahedron[2..]].concat()))[..] else {
            panic!("two pieces");
        };
        assert_eq!(solid.iter().map(|(index, _)| *index).collect::<Vec<_>>(), [0, 1, 3, 4]);
        assert!(is_closed(solid) && !is_closed(alone));
        // Open on one side, and closed by a face that is turned around.
        let closed = |triangles: &[_]| is_closed(&pieces(&part(triangles))[0]);
        assert!(!closed(&tetrahedron[1..]));
        assert!(!closed(&[&tetrahedron[1..], &[[o, x, y]]].concat()));
    }
}
