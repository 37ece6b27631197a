//! Atlas coordinates for surfaces that have none of their own: unwrapped by [uvunwrap](https://docs.rs/uvunwrap).

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use glam::{Vec2, Vec3};
use uvunwrap::{Density, MeshInput, Options, Stage};

use crate::atlas::DEFAULT_SIDE;
use crate::bake::PADDING;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::progress::{Progress, Task};

/// Sides of atlases that a mesh is unwrapped for, texels: the first on which its charts have room.
const SIDES: [usize; 3] = [DEFAULT_SIDE, 2 * DEFAULT_SIDE, 4 * DEFAULT_SIDE];

/// Texels that charts stay away from the borders of the atlas, half of what is between two of them.
const MARGIN: usize = PADDING / 2;
/// The time that it may take, and by how much more for every triangle: some ten times what it usually takes.
const MOST: Duration = Duration::from_secs(20 * 60);
const PER_TRIANGLE: Duration = Duration::from_millis(5);
/// Columns of the smallest atlas that has room for a chart.
pub(crate) const SMALLEST_SIDE: usize = 2 * MARGIN + 1;

/// Surfaces side by side in one atlas, [`PADDING`] texels apart.
pub(crate) struct Unwrapped {
    /// Columns and rows that are used.
    pub size: [usize; 2],
    /// Charts of all surfaces.
    pub charts: usize,
    /// In the order of the surfaces.
    pub surfaces: Vec<Charted>,
}

/// One surface's new vertices.
pub(crate) struct Charted {
    /// Of each new vertex, the old one that it copies.
    pub source: Vec<u32>,
    /// Of each new vertex.
    pub uvs: Vec<Vec2>,
    /// The surface's triangles, in the same order.
    pub triangles: Vec<[u32; 3]>,
}

/// Unwraps surfaces, of positions and triangles, into one atlas of `columns`, [`SMALLEST_SIDE`] or more, and at most as
/// many rows; `None` where their charts are too many for it.
pub(crate) fn unwrap(
    surfaces: &[(&[Vec3], &[[u32; 3]])],
    columns: usize,
    progress: &dyn Progress,
) -> Result<Option<Unwrapped>> {
    let inputs: Vec<MeshInput> = surfaces
        .iter()
        .map(|(positions, triangles)| MeshInput::new(bytemuck::cast_slice(positions), triangles.as_flattened()))
        .collect();
    let density = Density::Auto { page_size: columns as u32 };
    let options = Options { density, padding: MARGIN as u32, ..Options::default() };
    let count: usize = surfaces.iter().map(|(_, triangles)| triangles.len()).sum();
    let task = Task::start(progress, "unwrapping", count as u64, "triangles");
    let most = MOST + PER_TRIANGLE * count.try_into().unwrap_or(u32::MAX);
    let (flattened, started) = (AtomicUsize::new(0), Instant::now());
    let atlas = uvunwrap::generate_with_progress(&inputs, &options, |step| {
        if step.stage == Stage::Parameterizing {
            let before = flattened.swap(step.done, Ordering::Relaxed);
            progress.advance(step.done.saturating_sub(before) as u64);
        }
        !progress.cancelled() && started.elapsed() < most
    });
    drop(task);
    let atlas = atlas.map_err(|e| match e {
        uvunwrap::Error::Cancelled if !progress.cancelled() => Error::invalid(format!(
            "unwrapping was given up after {} minutes: the surface falls into too many charts; reduce it (a capture's by `texir import \
             --decimate`), smooth it, or unwrap it in another program",
            most.as_secs() / 60
        )),
        uvunwrap::Error::Cancelled => Error::Cancelled,
        e => Error::invalid(format!("the scene cannot be unwrapped into {columns}×{columns} texels: {e}")),
    })?;
    let charted = |mesh: &uvunwrap::OutputMesh| Charted {
        source: mesh.vertices.iter().map(|v| v.xref).collect(),
        uvs: mesh.vertices.iter().map(|v| Vec2::from(v.uv)).collect(),
        triangles: mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    };
    Ok((atlas.page_count == 1).then(|| Unwrapped {
        size: [atlas.width as usize, atlas.height as usize],
        charts: atlas.chart_count as usize,
        surfaces: atlas.meshes.iter().map(charted).collect(),
    }))
}

/// A mesh with a square atlas of its own.
#[derive(Debug)]
pub struct UnwrappedMesh {
    /// The same triangles in the same order; vertices on the borders of charts are there once per chart.
    pub mesh: Mesh,
    /// Charts of the atlas.
    pub charts: usize,
    /// Texels along a side that the atlas needs at least for charts to stay [`PADDING`] texels apart.
    pub side: usize,
}

/// Gives a mesh new atlas coordinates.
pub fn unwrap_mesh(mesh: &Mesh, progress: &dyn Progress) -> Result<UnwrappedMesh> {
    for side in SIDES {
        let Some(unwrapped) = unwrap(&[(&mesh.positions, &mesh.triangles)], side, progress)? else { continue };
        let [columns, rows] = unwrapped.size.map(|texels| texels as f32);
        let [charted] = &unwrapped.surfaces[..] else { continue };
        let of = |values: &[Vec3]| charted.source.iter().map(|&i| values[i as usize]).collect();
        let in_square = Vec2::new(columns, rows) / side as f32;
        let mesh = Mesh {
            positions: of(&mesh.positions),
            normals: of(&mesh.normals),
            uvs: charted.uvs.iter().map(|uv| *uv * in_square).collect(),
            triangles: charted.triangles.clone(),
        };
        return Ok(UnwrappedMesh { mesh, charts: unwrapped.charts, side });
    }
    let largest = SIDES[SIDES.len() - 1];
    Err(Error::invalid(format!(
        "the mesh falls into too many charts for an atlas of {largest}×{largest} texels: reduce it with --decimate, smooth \
         it, or unwrap it in another program"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_io::atlas_report;
    use crate::progress::{Impatient, Silent};

    /// A box of six faces of two triangles each, all of which have the same texture coordinates.
    fn box_without_atlas() -> Mesh {
        let mut mesh = Mesh::default();
        for (normal, x) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
            for side in [1.0, -1.0] {
                let (n, y) = (side * normal, side * normal.cross(x));
                let first = mesh.positions.len() as u32;
                for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                    mesh.positions.push((n + u * x + v * y) * Vec3::new(3.0, 2.0, 1.2));
                    mesh.normals.push(n);
                    mesh.uvs.push(Vec2::ZERO);
                }
                mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
        mesh
    }

    #[test]
    fn every_surface_gets_texels_of_its_own_and_a_gutter() {
        let old = box_without_atlas();
        let UnwrappedMesh { mesh, side, .. } = unwrap_mesh(&old, &Silent).unwrap();
        assert_eq!(side, SIDES[0]);
        for t in 0..old.triangles.len() as u32 {
            assert_eq!((mesh.corners(t), mesh.corner_normals(t)), (old.corners(t), old.corner_normals(t)));
        }
        let report = atlas_report(&mesh, [side; 2]);
        assert_eq!((report.overlapping_fraction, report.outside_unit_square_triangles), (0.0, 0));
        assert!(report.covered_fraction > 0.5, "{report:?}");
        // Faces by the texels of their charts, and who comes near them.
        let mut face = vec![0; side * side];
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corner_uvs(t as u32).map(|uv| uv * side as f32);
            for (i, j) in (0..=2000).flat_map(|i| (0..=2000 - i).map(move |j| (i, j))) {
                let p = a + (b - a) * (i as f32 / 2000.0) + (c - a) * (j as f32 / 2000.0);
                let at = p.as_uvec2().min(glam::UVec2::splat(side as u32 - 1));
                face[at.y as usize * side + at.x as usize] = 1 + t / 2;
            }
        }
        let reach = PADDING - 1;
        for (x, y) in (0..side - reach).flat_map(|y| (0..side - reach).map(move |x| (x, y))) {
            let own = face[y * side + x];
            for (dx, dy) in (0..=reach).flat_map(|dy| (0..=reach).map(move |dx| (dx, dy))) {
                let other = face[(y + dy) * side + x + dx];
                assert!(own == 0 || other == 0 || own == other, "faces {own} and {other} at ({x}, {y})");
            }
        }
    }

    #[test]
    fn unwrapping_can_be_stopped() {
        let stopped = unwrap_mesh(&box_without_atlas(), &Impatient::after(2));
        assert!(matches!(stopped, Err(Error::Cancelled)));
    }
}
