//! Mesh files in and out: OBJ, PLY, glTF/GLB. Whatever the format, what comes out is one checked [`Mesh`].

mod atlas;
pub(crate) mod gltf;
pub mod obj;
mod ply;
mod polygon;

use std::path::Path;

use glam::{Vec2, Vec3};

pub use self::atlas::{AtlasReport, atlas_report};
use crate::error::{Error, Result};
use crate::mesh::{Mesh, cross};

/// A mesh as read, and what had to be changed to make it usable.
#[derive(Clone, Debug)]
pub struct MeshFile {
    /// The mesh: indices in range, positions finite, normals unit, atlas coordinates everywhere, no triangle without
    /// area.
    pub mesh: Mesh,
    /// What was done to the file's content, in sentences for the user.
    pub warnings: Vec<String>,
}

/// What a format's reader found, before any check. Attributes are per vertex; v is down already.
#[derive(Default)]
struct RawMesh {
    positions: Vec<Vec3>,
    normals: Vec<Option<Vec3>>,
    uvs: Vec<Option<Vec2>>,
    triangles: Vec<[u32; 3]>,
    /// Polygons of which no good triangles could be made.
    crossing_polygons: usize,
    warnings: Vec<String>,
}

/// Whether a file of this name is glTF, whose +Y is up.
pub(crate) fn is_gltf(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb") || e.eq_ignore_ascii_case("gltf"))
}

/// Reads `.obj`, `.ply`, `.glb` or `.gltf` (by extension).
///
/// Triangles without area, unusable normals and single triangles without a place in the atlas are reported; anything
/// that leaves the surface or its atlas in doubt is an error: positions that are not finite, indices out of range, no
/// atlas at all.
pub fn read_mesh(path: impl AsRef<Path>) -> Result<MeshFile> {
    let path = path.as_ref();
    let (mut file, unplaced) = read_surface(path)?;
    let triangles = file.mesh.triangles.len();
    if unplaced == triangles {
        return Err(Error::file(
            path,
            format!(
                "has no texture coordinates, or none that are finite, on any of {triangles} triangles; expected an atlas: \
                 every surface at a place of its own in [0, 1]². `texir import` unwraps such meshes"
            ),
        ));
    }
    if unplaced > 0 {
        file.warnings.push(format!(
            "{}: {unplaced} of {triangles} triangles have no texture coordinates, or none that are finite: they have no texels, \
             and look like the atlas's corner. `texir import` unwraps such meshes",
            path.display()
        ));
    }
    Ok(file)
}

/// [`read_mesh`] for surfaces that may yet be unwrapped: how many triangles have no place in the atlas comes along;
/// their corners are at (0, 0).
pub fn read_surface(path: impl AsRef<Path>) -> Result<(MeshFile, usize)> {
    let path = path.as_ref();
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let raw = match extension.as_str() {
        "obj" => obj::read(path)?,
        "ply" => ply::read(path)?,
        "glb" | "gltf" => gltf::read(path)?,
        _ => return Err(Error::file(path, "is no mesh that texir knows; expected .obj, .ply, .glb or .gltf")),
    };
    let (mut file, unplaced) = check(path, raw)?;
    file.warnings.extend(file.mesh.misplaced().map(|what| format!("{}: {what}", path.display())));
    Ok((file, unplaced))
}

/// The mesh, and how many of its triangles have no place in the atlas.
fn check(path: &Path, raw: RawMesh) -> Result<(MeshFile, usize)> {
    let RawMesh { positions, mut normals, mut uvs, mut triangles, crossing_polygons, mut warnings } = raw;
    if triangles.is_empty() {
        return Err(Error::file(path, "has no triangles; expected a surface, not a point cloud or curves"));
    }
    if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
        return Err(Error::file(path, format!("vertex {i} is at {}; expected finite coordinates", positions[i])));
    }
    if let Some(t) = triangles.iter().position(|t| t.iter().any(|i| *i as usize >= positions.len())) {
        return Err(Error::file(
            path,
            format!("triangle {t} uses vertices {:?}; expected indices below {}", triangles[t], positions.len()),
        ));
    }

    let before = triangles.len();
    triangles.retain(|t| cross(t.map(|i| positions[i as usize])).length_squared() > 0.0);
    if triangles.is_empty() {
        return Err(Error::file(path, format!("all {before} triangles have no area; expected a surface")));
    }
    if triangles.len() < before {
        warnings.push(format!(
            "{}: {} of {before} triangles have no area and are left out",
            path.display(),
            before - triangles.len()
        ));
    }

    if crossing_polygons > 0 {
        warnings.push(format!(
            "{}: the outlines of {crossing_polygons} polygons cross themselves: parts of them are there twice, or face \
             the wrong way. Export triangles",
            path.display()
        ));
    }

    let has_normals = normals.iter().any(Option::is_some);
    for normal in &mut normals {
        *normal = normal.and_then(|n| n.try_normalize());
    }
    for uv in &mut uvs {
        *uv = uv.filter(|uv| uv.is_finite());
    }
    let placed = uvs.iter().map(|uv| uv.unwrap_or_default()).collect();
    let mut mesh = Mesh { normals: Vec::with_capacity(positions.len()), positions, uvs: placed, triangles };
    let unplaced = part_from_atlas_where_uvs_are_missing(&mut mesh, &mut normals, &uvs);
    mesh.normals.extend(normals.iter().map(|n| n.unwrap_or_default()));
    let flattened = flatten_where_normals_are_missing(&mut mesh, &normals);
    // A mesh without any is meant to be.
    if flattened > 0 && has_normals {
        warnings.push(format!(
            "{}: {flattened} of {} triangles have no usable vertex normals and are shaded flat",
            path.display(),
            mesh.triangles.len()
        ));
    }
    Ok((MeshFile { mesh, warnings }, unplaced))
}

/// Leaves every triangle with a place in the atlas missing without area there; returns their number. The corners that
/// do have one would span an area with (0, 0), over that of other triangles: such triangles get three vertices of their
/// own.
fn part_from_atlas_where_uvs_are_missing(
    mesh: &mut Mesh,
    normals: &mut Vec<Option<Vec3>>,
    uvs: &[Option<Vec2>],
) -> usize {
    let mut unplaced = 0;
    for t in 0..mesh.triangles.len() {
        let corners = mesh.triangles[t].map(|i| i as usize);
        let missing = corners.iter().filter(|i| uvs[**i].is_none()).count();
        unplaced += usize::from(missing > 0);
        if (1..3).contains(&missing) {
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(mesh.corners(t as u32));
            mesh.uvs.extend([Vec2::ZERO; 3]);
            normals.extend(corners.map(|i| normals[i]));
            mesh.triangles[t] = [base, base + 1, base + 2];
        }
    }
    unplaced
}

/// Gives every triangle with a normal missing three vertices of its own with the face's normal; returns their number.
fn flatten_where_normals_are_missing(mesh: &mut Mesh, normals: &[Option<Vec3>]) -> usize {
    let missing = |t: &[u32; 3]| t.iter().any(|i| normals[*i as usize].is_none());
    let flat: Vec<u32> = (0..mesh.triangles.len() as u32).filter(|t| missing(&mesh.triangles[*t as usize])).collect();
    if flat.len() == mesh.triangles.len() {
        mesh.flat_normals();
        return flat.len();
    }
    for &t in &flat {
        let base = mesh.positions.len() as u32;
        let (corners, uvs, normal) = (mesh.corners(t), mesh.corner_uvs(t), mesh.face_normal(t));
        mesh.positions.extend(corners);
        mesh.uvs.extend(uvs);
        mesh.normals.extend([normal; 3]);
        mesh.triangles[t as usize] = [base, base + 1, base + 2];
    }
    flat.len()
}

#[cfg(test)]
mod tests;
