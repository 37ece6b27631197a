//! The triangle mesh of the whole scene with its one texture atlas.

use std::collections::{HashMap, HashSet};
use std::hash::Hash;

use glam::{Vec2, Vec3};

use crate::error::{Error, Result};
use crate::ray_origin::offset_origin;

/// Rays may start off a surface by this share of the mesh's size.
const LARGEST_STEP: f32 = 1e-3;

/// Atlas coordinates beyond this are of a damaged file, and texels by them of no size.
const FARTHEST_UV: f32 = 1e6;

/// An indexed triangle mesh. World space, metres, right-handed. Texture origin top left (v down, as in glTF).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one per vertex.
    pub normals: Vec<Vec3>,
    /// Atlas coordinates in [0, 1]², one per vertex.
    pub uvs: Vec<Vec2>,
    /// Vertex indices, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Errors unless there are a normal and coordinates for every vertex, and triangles of these vertices.
    pub fn check(&self) -> Result<()> {
        let vertices = self.positions.len();
        for (what, count) in [("normals", self.normals.len()), ("atlas coordinates", self.uvs.len())] {
            if count != vertices {
                return Err(Error::invalid(format!(
                    "the mesh has {count} {what}; expected one for each of its {vertices} vertices"
                )));
            }
        }
        if self.triangles.is_empty() {
            return Err(Error::invalid("the mesh has no triangles"));
        }
        let is_near = |uv: &Vec2| uv.is_finite() && uv.abs().max_element() <= FARTHEST_UV;
        if let Some((i, uv)) = self.uvs.iter().enumerate().find(|(_, uv)| !is_near(uv)) {
            return Err(Error::invalid(format!(
                "vertex {i} of the mesh has the atlas coordinates {uv}; expected numbers, from 0 to 1 as a rule, and up to \
                 {FARTHEST_UV:e}"
            )));
        }
        match self.triangles.iter().enumerate().find(|(_, t)| t.iter().any(|i| *i as usize >= vertices)) {
            Some((t, corners)) => Err(Error::invalid(format!(
                "triangle {t} of the mesh has the vertices {corners:?}; expected indices below {vertices}, their number"
            ))),
            None => Ok(()),
        }
    }

    /// The three corners of a triangle.
    pub fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|i| self.positions[i as usize])
    }

    /// The three atlas coordinates of a triangle.
    pub fn corner_uvs(&self, triangle: u32) -> [Vec2; 3] {
        self.triangles[triangle as usize].map(|i| self.uvs[i as usize])
    }

    /// The three shading normals of a triangle.
    pub fn corner_normals(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|i| self.normals[i as usize])
    }

    /// Unit geometric normal; zero for a degenerate triangle.
    pub fn face_normal(&self, triangle: u32) -> Vec3 {
        cross(self.corners(triangle)).normalize_or_zero()
    }

    /// Area, m².
    pub fn area(&self, triangle: u32) -> f32 {
        0.5 * cross(self.corners(triangle)).length()
    }

    /// Mean of the corners.
    pub fn centre(&self, triangle: u32) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        (a + b + c) / 3.0
    }

    /// How this mesh's atlas differs from another's, if it does: textures of the one do not belong to the other then.
    pub fn atlas_difference(&self, other: &Mesh) -> Option<String> {
        /// Less than a texel of any atlas.
        const SAME: f32 = 1e-5;
        let [own, others] = [self, other].map(|mesh| mesh.triangles.len());
        if own != others {
            return Some(format!("it has {own} triangles, not {others}"));
        }
        let apart = |t: &u32| {
            let mut corners = self.corner_uvs(*t).into_iter().zip(other.corner_uvs(*t));
            corners.any(|(a, b)| !a.abs_diff_eq(b, SAME))
        };
        (0..own as u32).find(apart).map(|t| {
            format!(
                "its triangle {t} lies at {} in the atlas, not at {}",
                self.corner_uvs(t)[0],
                other.corner_uvs(t)[0]
            )
        })
    }

    /// Axis-aligned bounds `(min, max)`.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        bounds(self.positions.iter().copied())
    }

    /// What is wrong with where the mesh lies: rays start off its surfaces by some hundred steps of single precision
    /// ([`offset_origin`]), which must be little beside the mesh's size.
    pub fn misplaced(&self) -> Option<String> {
        let (low, high) = self.bounds();
        let (away, size) = (low.abs().max(high.abs()).max_element(), (high - low).length());
        let moved = (offset_origin(Vec3::splat(away), Vec3::X).x - away).max(offset_origin(Vec3::ZERO, Vec3::X).x);
        (moved > LARGEST_STEP * size).then(|| {
            format!(
                "the mesh is {size:.3} m large and reaches {away:.0} m from the origin, where rays start {moved:.0e} m off its surfaces: light \
                 will be wrong; expected metres, and the mesh (with its cameras) near the origin"
            )
        })
    }

    /// Drops triangles whose corners lie where those of an earlier one do, and run around alike; returns their number.
    pub(crate) fn drop_repeated(&mut self) -> usize {
        let before = self.triangles.len();
        let mut known = HashSet::with_capacity(before);
        let positions = &self.positions;
        self.triangles.retain(|t| {
            // Zero has two signs.
            let mut corners = t.map(|i| positions[i as usize].to_array().map(|v| (v + 0.0).to_bits()));
            let first = (0..3).min_by_key(|i| corners[*i]).unwrap_or(0);
            corners.rotate_left(first);
            known.insert(corners)
        });
        before - self.triangles.len()
    }

    /// Replaces `normals` by the face normals, splitting shared vertices: flat shading.
    pub fn flat_normals(&mut self) {
        let mut flat = Mesh::default();
        for t in 0..self.triangles.len() as u32 {
            let base = flat.positions.len() as u32;
            flat.positions.extend(self.corners(t));
            flat.uvs.extend(self.corner_uvs(t));
            flat.normals.extend([self.face_normal(t); 3]);
            flat.triangles.push([base, base + 1, base + 2]);
        }
        *self = flat;
    }
}

/// Twice the area of a triangle, along its normal: towards whoever sees the corners counter-clockwise.
pub(crate) fn cross([a, b, c]: [Vec3; 3]) -> Vec3 {
    (b - a).cross(c - a)
}

/// Axis-aligned bounds `(min, max)` of points; from ∞ to −∞ where there are none.
pub(crate) fn bounds(points: impl IntoIterator<Item = Vec3>) -> (Vec3, Vec3) {
    points.into_iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)))
}

/// Numbers vertices from 0 in the order in which their `keys` first appear, those with one key alike: the number of
/// every vertex, and of every number the first vertex that has it. Keys say which places are one.
pub(crate) fn weld<K: Eq + Hash>(keys: impl Iterator<Item = K>) -> (Vec<u32>, Vec<u32>) {
    let mut numbers: HashMap<K, u32> = HashMap::new();
    let mut firsts = Vec::new();
    let number = |(vertex, key)| {
        *numbers.entry(key).or_insert_with(|| {
            firsts.push(vertex);
            firsts.len() as u32 - 1
        })
    };
    ((0..).zip(keys).map(number).collect(), firsts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_of_one_key_are_one() {
        assert_eq!(weld(["b", "a", "b", "c", "a"].iter()), (vec![0, 1, 0, 2, 1], vec![0, 1, 3]));
        assert_eq!(weld([0; 0].iter()), (vec![], vec![]));
    }

    #[test]
    fn triangles_that_are_there_twice_are_dropped_but_not_those_that_face_the_other_way() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let again = [Vec3::new(-0.0, 0.0, -0.0), Vec3::X, Vec3::Y];
        let mut mesh = Mesh {
            positions: [corners, again].concat(),
            normals: vec![Vec3::Z; 6],
            uvs: vec![Vec2::ZERO; 6],
            // The first, turned on, of other vertices, and the other way around.
            triangles: vec![[0, 1, 2], [1, 2, 0], [3, 4, 5], [0, 2, 1]],
        };
        assert_eq!(mesh.drop_repeated(), 2);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 1]]);
    }

    #[test]
    fn meshes_are_misplaced_where_single_precision_is_coarse_beside_them() {
        let triangle = |size: f32, away: Vec3| Mesh {
            positions: [Vec3::ZERO, Vec3::X, Vec3::Y].map(|p| away + size * p).to_vec(),
            ..Mesh::default()
        };
        let misplaced = |size, away| triangle(size, away).misplaced();
        assert_eq!(misplaced(3.0, Vec3::ZERO), None);
        assert_eq!(misplaced(300.0, Vec3::splat(-300.0)), None);
        assert_eq!(misplaced(0.05, Vec3::ZERO), None);
        let said = misplaced(3.0, Vec3::new(0.0, 10_000.0, 0.0)).unwrap();
        assert!(said.contains("4.243 m large") && said.contains("10003 m from the origin"), "{said}");
        assert!(misplaced(3.0, Vec3::new(0.0, 0.0, -10_000.0)).is_some());
        // In kilometres, a room is a speck.
        assert!(misplaced(0.003, Vec3::ZERO).is_some());
    }

    #[test]
    fn atlas_coordinates_are_numbers_of_some_size() {
        let at = |u: f32| Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: vec![Vec2::ZERO, Vec2::new(u, 0.0), Vec2::Y],
            triangles: vec![[0, 1, 2]],
        };
        [1.0, -7.5, 1e6].into_iter().for_each(|u| at(u).check().unwrap());
        for u in [f32::NAN, f32::INFINITY, 1e20] {
            let error = at(u).check().unwrap_err().to_string();
            assert!(error.contains("vertex 1 of the mesh has the atlas coordinates"), "{error}");
        }
    }
}
