//! What users are told of a fit that the capture does not suffice for.

use crate::atlas::Atlas;
use crate::capture::{Coverage, Tbl};
use crate::mesh::Mesh;
use crate::raster::{Mask, Rgb};

/// What to tell the user where views see little of the surface, area by area.
pub(super) fn little_seen(atlas: &Atlas, mesh: &Mesh, is_seen: &[bool]) -> Option<String> {
    /// Views that show every corner of a furnished flat see two thirds: the rest is under things and inside of them.
    const LITTLE: f64 = 0.5;
    let (mut seen, mut all) = (0.0, 0.0);
    for (point, is_seen) in atlas.points.iter().zip(is_seen) {
        let area = f64::from(atlas.texel_area(mesh, point.triangle));
        all += area;
        seen += if *is_seen { area } else { 0.0 };
    }
    (seen < LITTLE * all).then(|| {
        format!(
            "training views see {:.0} % of the surface; the rest is filled in from similar surfaces (confidence.exr tells how \
             well its roughness is known): views from other places would show more",
            100.0 * seen / all
        )
    })
}

/// What to tell the user where much of the surface that views see would have to reflect all light: there must be more
/// of it.
pub(super) fn too_bright(albedo: &Rgb, emitters: &Mask, tbl: &Tbl) -> Option<String> {
    /// Albedo from here on is more than paint has.
    const WHITE: f32 = 0.97;
    const SHARE: f64 = 0.1;
    let seen =
        tbl.coverage.data.iter().zip(&emitters.data).map(|(coverage, emits)| *coverage == Coverage::Seen && !emits);
    let [mut all, mut white] = [0u64; 2];
    for (albedo, _) in albedo.data.iter().zip(seen).filter(|(_, seen)| *seen) {
        all += 1;
        white += u64::from(albedo.iter().any(|a| *a >= WHITE));
    }
    let share = white as f64 / all.max(1) as f64;
    (share > SHARE).then(|| {
        format!(
            "{:.0} % of the surface that views see would have to reflect nearly all light: light is missing. Are lamps clipped in the images, \
             turned around or missing in the mesh, or are there holes that light comes through? (`texir inspect`)",
            100.0 * share
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Raster;

    #[test]
    fn surfaces_that_would_reflect_all_light_are_told_where_they_are_many() {
        let told = |white: usize, coverage: Coverage| {
            let albedo = Rgb::new(10, 10, (0..100).map(|i| [0.5, if i < white { 0.98 } else { 0.5 }, 0.5]).collect());
            let tbl = Tbl { radiance: Rgb::filled(10, 10, [1.0; 3]), coverage: Raster::filled(10, 10, coverage) };
            too_bright(&albedo.unwrap(), &Mask::filled(10, 10, false), &tbl)
        };
        assert!(told(20, Coverage::Seen).unwrap().starts_with("20 % of the surface"));
        // Negative controls: a few, and what no view sees.
        assert_eq!(told(5, Coverage::Seen), None);
        assert_eq!(told(20, Coverage::Inpainted), None);
    }
}
