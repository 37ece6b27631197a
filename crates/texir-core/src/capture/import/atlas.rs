//! A new atlas for meshes whose own does not give every surface a place of its own, and for those that are reduced.

use super::{Import, ImportOptions};
use crate::atlas::DEFAULT_SIDE;
use crate::decimate::{Decimated, FARTHEST, decimate};
use crate::error::{Error, Result};
use crate::mesh_io::atlas_report;
use crate::progress::Progress;
use crate::unwrap::{UnwrappedMesh, unwrap_mesh};

/// Why the mesh needs a new atlas. One with faults stays where textures belong to it: they would be lost.
pub(super) fn lacking(import: &Import, unplaced: usize, options: &ImportOptions) -> Option<String> {
    if options.unwrap {
        return Some("as told".to_owned());
    }
    if unplaced > 0 {
        return Some(format!("{unplaced} of its triangles have no texture coordinates"));
    }
    let problems = atlas_report(&import.mesh, [DEFAULT_SIDE; 2]).problems();
    (import.textures.is_empty() && !problems.is_empty()).then(|| problems.join(", and "))
}

/// Reduces the mesh to `target` triangles if it has more; says why it then needs a new atlas.
pub(super) fn reduce(import: &mut Import, target: usize, progress: &dyn Progress) -> Result<Option<String>> {
    let before = import.mesh.triangles.len();
    if target >= before {
        import.assumed.push(format!("the mesh is not reduced: it has {before} triangles, and {target} are allowed"));
        return Ok(None);
    }
    let Decimated { mesh, moved } = decimate(&import.mesh, target, progress).map_err(|e| of_mesh(import, e))?;
    let after = mesh.triangles.len();
    if after > target {
        progress.warn(&format!(
            "{}: {after} triangles are left, not {target}: with fewer, surfaces would move by more than {} mm, or tear",
            import.mesh_path.display(),
            1000.0 * FARTHEST
        ));
    }
    import.mesh = mesh;
    let moved = 1000.0 * moved;
    Ok(Some(format!("it was reduced from {before} to {after} triangles; surfaces moved by up to {moved:.1} mm")))
}

/// Errors about the mesh name its file.
fn of_mesh(import: &Import, error: Error) -> Error {
    match error {
        Error::Invalid(what) => Error::file(&import.mesh_path, what),
        error => error,
    }
}

/// Unwraps the mesh. Textures of the atlas that it had are left out.
pub(super) fn renew(import: &mut Import, why: &str, progress: &dyn Progress) -> Result<()> {
    let unwrapped = unwrap_mesh(&import.mesh, progress);
    let UnwrappedMesh { mesh, charts, side } = unwrapped.map_err(|e| of_mesh(import, e))?;
    import.mesh = mesh;
    let larger = if side > DEFAULT_SIDE { format!("; fit it with --set fit.atlas_size={side}") } else { String::new() };
    import
        .assumed
        .push(format!("the mesh gets a new atlas of {charts} charts for {side} × {side} texels{larger} ({why})"));
    if !import.textures.is_empty() {
        let names: Vec<&str> = import.textures.drain(..).map(|(name, _)| name).collect();
        progress.warn(&format!(
            "{}: {} belong to the atlas that the mesh had, and are left out",
            import.mesh_path.display(),
            names.join(", ")
        ));
    }
    Ok(())
}
