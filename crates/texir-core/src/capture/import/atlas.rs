//! A new atlas for meshes whose own does not give every surface a place of its own.

use super::{Import, ImportOptions};
use crate::capture::load::ATLAS_CHECK_SIZE;
use crate::error::{Error, Result};
use crate::mesh_io::atlas_report;
use crate::progress::Progress;
use crate::tbl::DEFAULT_SIZE;
use crate::unwrap::{UnwrappedMesh, unwrap_mesh};

/// Why the mesh needs a new atlas. One with faults stays where textures belong to it: they would be lost.
pub(super) fn lacking(import: &Import, unplaced: usize, options: &ImportOptions) -> Option<String> {
    if options.unwrap {
        return Some("as told".to_owned());
    }
    if unplaced > 0 {
        return Some(format!("{unplaced} of its vertices have no texture coordinates"));
    }
    let problems = atlas_report(&import.mesh, ATLAS_CHECK_SIZE).problems();
    (import.textures.is_empty() && !problems.is_empty()).then(|| problems.join(", and "))
}

/// Unwraps the mesh. Textures of the atlas that it had are left out.
pub(super) fn renew(import: &mut Import, why: &str, progress: &dyn Progress) -> Result<()> {
    let unwrapped = unwrap_mesh(&import.mesh, progress);
    let UnwrappedMesh { mesh, charts, side } = unwrapped.map_err(|e| match e {
        Error::Invalid(what) => Error::file(&import.mesh_path, what),
        e => e,
    })?;
    import.mesh = mesh;
    let larger = if side > DEFAULT_SIZE { format!("; fit it with --set fit.atlas_size={side}") } else { String::new() };
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
