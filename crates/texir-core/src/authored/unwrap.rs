//! Which coordinates a lightmap has: a set that the file brings, where it gives every surface a place of its own, or one
//! made by [uvunwrap](https://docs.rs/uvunwrap).

use glam::Vec2;
use uvunwrap::{Density, MeshInput, Options, Stage};

use super::gltf::Part;
use crate::bake::PADDING;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh_io::atlas_report;
use crate::progress::Progress;

/// Charts of a given set may share this fraction of the covered texels: rounding where they touch.
const OVERLAP: f64 = 1e-3;
/// Texels per side at which sets are tested.
const TEST_SIZE: usize = 2048;

/// Whether a mesh's coordinates give every surface a place of its own in [0, 1]².
pub(super) fn is_lightmap(mesh: &Mesh) -> bool {
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

/// One part's new coordinates.
pub(super) struct Unwrapped {
    /// Of each new vertex, the old one that it copies.
    pub source: Vec<u32>,
    /// Of each new vertex.
    pub uvs: Vec<Vec2>,
    /// The part's triangles, in the same order.
    pub triangles: Vec<[u32; 3]>,
}

/// Unwraps all parts into one atlas of `size` columns; `(columns, rows)` come back.
pub(super) fn unwrap(parts: &[Part], size: usize, progress: &dyn Progress) -> Result<(Vec<Unwrapped>, [usize; 2])> {
    let inputs: Vec<MeshInput> = parts
        .iter()
        .map(|part| MeshInput::new(bytemuck::cast_slice(&part.positions), bytemuck::cast_slice(&part.triangles)))
        .collect();
    let options = Options {
        density: Density::Auto { page_size: size as u32 },
        padding: PADDING as u32 / 2,
        ..Options::default()
    };
    progress.start("unwrapping", parts.iter().map(|p| p.triangles.len() as u64).sum(), "triangles");
    let flattened = std::sync::atomic::AtomicUsize::new(0);
    let atlas = uvunwrap::generate_with_progress(&inputs, &options, |step| {
        if step.stage == Stage::Parameterizing {
            let before = flattened.swap(step.done, std::sync::atomic::Ordering::Relaxed);
            progress.advance(step.done.saturating_sub(before) as u64);
        }
        !progress.cancelled()
    });
    progress.finish();
    let atlas = atlas.map_err(|e| match e {
        uvunwrap::Error::Cancelled => Error::Cancelled,
        e => Error::invalid(format!("the scene cannot be unwrapped into {size}×{size} texels: {e}")),
    })?;
    if atlas.page_count != 1 {
        return Err(Error::invalid(format!(
            "{} charts do not fit a lightmap of {size}×{size} texels: make it larger with --size, or bring a \
             second UV set (TEXCOORD_1) without overlaps",
            atlas.chart_count
        )));
    }
    let unwrapped = atlas.meshes.iter().map(|mesh| Unwrapped {
        source: mesh.vertices.iter().map(|v| v.xref).collect(),
        uvs: mesh.vertices.iter().map(|v| Vec2::from(v.uv)).collect(),
        triangles: mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    });
    Ok((unwrapped.collect(), [atlas.width as usize, atlas.height as usize]))
}
