//! Which coordinates a lightmap has: a set that the file brings, where it gives every surface a place of its own, or new
//! ones.

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
    /// Chooses the lightmap's coordinates, and joins the parts.
    pub(super) fn lay_out(&mut self, size: usize, progress: &dyn Progress) -> Result<()> {
        for set in [1, 0] {
            if self.parts.iter().all(|part| part.has_uvs.get(set) == Some(&true)) {
                self.mesh = joined(&self.parts, self.parts.iter().map(|part| part.uvs[set].as_slice()));
                if is_lightmap(&self.mesh) {
                    self.lightmap_set = Some(set);
                    return Ok(());
                }
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
        for (part, new) in self.parts.iter_mut().zip(&unwrapped.surfaces) {
            let from = |values: &[Vec3]| new.source.iter().map(|&i| values[i as usize]).collect();
            (part.positions, part.normals) = (from(&part.positions), from(&part.normals));
            part.uvs.iter_mut().for_each(|uvs| *uvs = new.source.iter().map(|&i| uvs[i as usize]).collect());
            part.triangles.clone_from(&new.triangles);
        }
        self.mesh = joined(&self.parts, unwrapped.surfaces.iter().map(|new| new.uvs.as_slice()));
        Ok(())
    }
}

/// Whether a mesh's coordinates give every surface a place of its own in [0, 1]².
fn is_lightmap(mesh: &Mesh) -> bool {
    let has_area = |t: u32| {
        let [a, b, c] = mesh.corner_uvs(t);
        (b - a).perp_dot(c - a) != 0.0
    };
    if !(0..mesh.triangles.len() as u32).all(has_area) {
        return false;
    }
    let report = atlas_report(mesh, TEST_SIZE);
    report.outside_unit_square_triangles == 0 && report.overlapping_fraction <= OVERLAP
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
