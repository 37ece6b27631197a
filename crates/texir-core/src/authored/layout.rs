//! Which coordinates a lightmap has: a set that the file brings, where it gives every surface a place of its own, or
//! new ones.

use std::ops::Range;

use glam::{Vec2, Vec3};

use super::gltf::{Model, Part};
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh_io::atlas_report;
use crate::progress::Progress;
use crate::unwrap::{SMALLEST_SIDE, unwrap};

/// Charts of a given set may share this fraction of the covered texels: rounding where they touch.
const OVERLAP: f64 = 1e-3;
/// Texels per side at which sets are tested.
const TEST_SIZE: usize = 2048;

impl Model {
    /// Chooses the lightmap's coordinates, and joins the parts. Says why, where the file brings coordinates for one
    /// that are not taken.
    pub(super) fn lay_out(&mut self, size: usize, progress: &dyn Progress) -> Result<Option<String>> {
        let mut why_not = None;
        for set in [1, 0] {
            let lacking: Vec<&Part> = self.parts.iter().filter(|part| part.has_uvs.get(set) != Some(&true)).collect();
            if lacking.is_empty() {
                self.mesh = joined(&self.parts, self.parts.iter().map(|part| part.uvs[set].as_slice()));
                let Some(reason) = no_lightmap(&self.mesh) else {
                    self.lightmap_set = Some(set);
                    let instead = |why: String| format!("{why}: TEXCOORD_0 is taken, which is one");
                    return Ok(why_not.map(instead));
                };
                why_not = why_not.or((set == 1).then(|| format!("TEXCOORD_1 is no lightmap's, as {reason}")));
            } else if set == 1 && lacking.len() < self.parts.len() {
                let (count, name) = (lacking.len(), &lacking[0].name);
                why_not =
                    Some(format!("TEXCOORD_1 is no lightmap's, as {count} primitives lack it (\"{name}\" the first)"));
            }
        }
        if size < SMALLEST_SIDE {
            return Err(Error::invalid(format!(
                "the scene has no coordinates for a lightmap, and cannot be unwrapped into one of {size}×{size} texels; expected \
                 at least {SMALLEST_SIDE}, and many times that for a picture of its light: make it larger with --size"
            )));
        }
        let surfaces: Vec<_> = self.parts.iter().map(|part| (&part.positions[..], &part.triangles[..])).collect();
        let unwrapped = unwrap(&surfaces, size, progress)?.ok_or_else(|| {
            Error::invalid(format!(
                "the scene's charts do not fit a lightmap of {size}×{size} texels: make it larger with --size, or bring a \
                 second UV set (TEXCOORD_1) without overlaps"
            ))
        })?;
        self.size = unwrapped.size;
        self.rows = unwrapped.size[1];
        for (part, new) in self.parts.iter_mut().zip(&unwrapped.surfaces) {
            let from = |values: &[Vec3]| new.source.iter().map(|&i| values[i as usize]).collect();
            (part.positions, part.normals) = (from(&part.positions), from(&part.normals));
            part.uvs.iter_mut().for_each(|uvs| *uvs = new.source.iter().map(|&i| uvs[i as usize]).collect());
            part.triangles.clone_from(&new.triangles);
        }
        self.mesh = joined(&self.parts, unwrapped.surfaces.iter().map(|new| new.uvs.as_slice()));
        Ok(why_not.map(|why| format!("{why}: the scene is unwrapped, and written with its new coordinates")))
    }
}

/// Why a mesh's coordinates do not give every surface a place of its own in [0, 1]²; `None` where they do.
fn no_lightmap(mesh: &Mesh) -> Option<String> {
    let has_area = |t: u32| {
        let [a, b, c] = mesh.corner_uvs(t);
        (b - a).perp_dot(c - a) != 0.0
    };
    let flat = (0..mesh.triangles.len() as u32).filter(|t| !has_area(*t)).count();
    if flat > 0 {
        return Some(format!("{flat} triangles have no area in it"));
    }
    let report = atlas_report(mesh, [TEST_SIZE; 2]);
    match report.outside_unit_square_triangles {
        0 if report.overlapping_fraction <= OVERLAP => None,
        0 => Some(format!("surfaces share {:.1} % of the texels", 100.0 * report.overlapping_fraction)),
        outside => Some(format!("{outside} triangles leave [0, 1]")),
    }
}

/// A part in the mesh of all.
pub(super) struct PlacedPart<'a> {
    /// Among the parts.
    pub index: usize,
    pub part: &'a Part,
    pub vertices: Range<usize>,
    pub triangles: Range<u32>,
}

/// Parts as they lie in the mesh of all: one behind the other.
pub(super) fn placed(parts: &[Part]) -> impl Iterator<Item = PlacedPart<'_>> {
    let (mut vertex, mut triangle) = (0, 0);
    parts.iter().enumerate().map(move |(index, part)| {
        let (vertices, triangles) =
            (vertex..vertex + part.positions.len(), triangle..triangle + part.triangles.len() as u32);
        (vertex, triangle) = (vertices.end, triangles.end);
        PlacedPart { index, part, vertices, triangles }
    })
}

/// All parts as one mesh, with the lightmap's coordinates of each.
fn joined<'a>(parts: &[Part], lightmap: impl Iterator<Item = &'a [Vec2]>) -> Mesh {
    let mut mesh = Mesh::default();
    for (part, uvs) in parts.iter().zip(lightmap) {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(&part.positions);
        mesh.normals.extend(&part.normals);
        mesh.uvs.extend(uvs);
        mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|i| first + i)));
    }
    mesh
}
