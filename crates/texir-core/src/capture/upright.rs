//! Meshes of glTF among cameras of another frame: glTF has +Y up, and exporters turn what they write to it.

use std::path::Path;

use glam::Vec3;

use crate::mesh::Mesh;
use crate::mesh_io::is_gltf;
use crate::progress::Progress;

/// The mesh of the file `path` in the frame of the cameras at `places`: turned, with a warning, where it is glTF's and
/// the cameras say so.
pub(super) fn among_cameras(
    path: &Path,
    mesh: Mesh,
    places: impl Iterator<Item = Vec3> + Clone,
    progress: &dyn Progress,
) -> Mesh {
    if !is_gltf(path) || !stands_on_its_side(&mesh, places) {
        return mesh;
    }
    progress
        .warn(&format!("{}: is taken as +Y up, as glTF has it: that way the cameras are inside of it", path.display()));
    upright(mesh)
}

/// Whether a place is within the mesh's bounds.
pub(super) fn holds(mesh: &Mesh) -> impl Fn(Vec3) -> bool {
    let (low, high) = mesh.bounds();
    move |place| place.cmpge(low).all() && place.cmple(high).all()
}

/// Whether most cameras are outside of a mesh that, with its +Y turned to +Z, has all of them inside.
fn stands_on_its_side(mesh: &Mesh, places: impl Iterator<Item = Vec3> + Clone) -> bool {
    let holds = holds(mesh);
    let outside = places.clone().filter(|place| !holds(*place)).count();
    // The turned mesh holds what the mesh holds of places that are turned back.
    let turned_back = |place: Vec3| Vec3::new(place.x, place.z, -place.y);
    2 * outside > places.clone().count() && places.clone().all(|place| holds(turned_back(place)))
}

/// The mesh with its +Y turned to +Z.
fn upright(mut mesh: Mesh) -> Mesh {
    mesh.positions.iter_mut().chain(&mut mesh.normals).for_each(|v| *v = Vec3::new(v.x, -v.z, v.y));
    mesh
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;

    #[test]
    fn a_mesh_stands_on_its_side_where_it_holds_the_cameras_once_it_is_turned_and_not_before() {
        // A room of 6 × 2.5 × 4 m, 2.5 of which are its height, along +Y; behind the origin, as −Z is ahead in glTF.
        let corners = [(0.0, 0.0, 0.0), (6.0, 2.5, -4.0), (6.0, 0.0, -4.0)];
        let lying = Mesh {
            positions: corners.map(|(x, y, z)| Vec3::new(x, y, z)).to_vec(),
            normals: vec![Vec3::Y; 3],
            uvs: vec![Vec2::ZERO; 3],
            triangles: vec![[0, 1, 2]],
        };
        let stands_on_its_side = |mesh: &Mesh, places: &[(f32, f32)]| {
            stands_on_its_side(mesh, places.iter().map(|p| Vec3::new(p.0, p.1, 1.5)))
        };
        let places = [(1.0, 1.0), (5.0, 3.5), (3.0, 2.0)];
        assert!(stands_on_its_side(&lying, &places));
        let standing = upright(lying.clone());
        assert_eq!((standing.bounds(), standing.normals[0]), ((Vec3::ZERO, Vec3::new(6.0, 4.0, 2.5)), Vec3::Z));
        assert!(!stands_on_its_side(&standing, &places));
        // Nor one that is elsewhere either way.
        assert!(!stands_on_its_side(&lying, &[(50.0, 1.0)]));
    }
}
