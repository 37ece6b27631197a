//! Is the atlas one? Every texel should belong to one place of the surface.

use glam::{DVec2, Vec2};

use crate::mesh::Mesh;

/// Atlas coordinates may leave the unit square by this much: rounding, not a tiled texture.
const UNIT_SQUARE_SLACK: f32 = 1e-4;

/// Rounding and shared chart borders explain overlaps up to this fraction of the covered texels.
const TOLERATED_OVERLAP: f64 = 0.01;

/// How a mesh uses its atlas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtlasReport {
    /// Texels whose centre lies in at least one triangle, as a fraction of all.
    pub covered_fraction: f64,
    /// Texels whose centre lies inside (not on the edge) of two or more triangles, as a fraction of the covered ones.
    pub overlapping_fraction: f64,
    /// Triangles with a corner outside of [0, 1]².
    pub outside_unit_square_triangles: usize,
}

impl AtlasReport {
    /// What is wrong with the atlas, in sentences for the user; empty where every surface has a place of its own.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.overlapping_fraction > TOLERATED_OVERLAP {
            problems.push(format!(
                "texture coordinates overlap on {:.1} % of the covered atlas: surfaces that share texels would share one \
                 material and one light",
                100.0 * self.overlapping_fraction
            ));
        }
        if self.outside_unit_square_triangles > 0 {
            problems.push(format!(
                "{} triangles have texture coordinates outside of [0, 1]: what lies there would get no texels",
                self.outside_unit_square_triangles
            ));
        }
        problems
    }
}

/// Rasterises the atlas at `size`² texels.
pub fn atlas_report(mesh: &Mesh, size: usize) -> AtlasReport {
    const COVERED: u8 = 1;
    const OWNED: u8 = 2;
    const SHARED: u8 = 4;
    let mut texels = vec![0_u8; size * size];
    let mut outside = 0;
    for t in 0..mesh.triangles.len() as u32 {
        let uvs = mesh.corner_uvs(t);
        let allowed = -UNIT_SQUARE_SLACK..=1.0 + UNIT_SQUARE_SLACK;
        outside += usize::from(uvs.iter().any(|uv| !(allowed.contains(&uv.x) && allowed.contains(&uv.y))));
        for_texel_centres(uvs, size, |texel, interior| {
            let state = &mut texels[texel];
            *state |= COVERED;
            if interior {
                *state |= if *state & OWNED != 0 { SHARED } else { OWNED };
            }
        });
    }
    let count = |flag: u8| texels.iter().filter(|t| **t & flag != 0).count() as f64;
    AtlasReport {
        covered_fraction: count(COVERED) / (size * size).max(1) as f64,
        overlapping_fraction: count(SHARED) / count(COVERED).max(1.0),
        outside_unit_square_triangles: outside,
    }
}

/// Calls `visit(texel, strictly inside)` for every texel whose centre lies in the closed triangle.
fn for_texel_centres(uvs: [Vec2; 3], size: usize, mut visit: impl FnMut(usize, bool)) {
    let [a, b, c] = uvs.map(|uv| uv.as_dvec2() * size as f64);
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 {
        return;
    }
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    // The texels whose centre, at +½, lies in [low, high]; a float cast saturates.
    let first = |low: f64| (low - 0.5).ceil().max(0.0) as usize;
    let end = |high: f64| ((high - 0.5).floor() + 1.0).clamp(0.0, size as f64) as usize;
    for y in first(low.y)..end(high.y) {
        for x in first(low.x)..end(high.x) {
            let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let edges = [(b, c), (c, a), (a, b)].map(|(from, to)| (to - from).perp_dot(p - from) / area);
            if edges.iter().all(|e| *e >= 0.0) {
                visit(y * size + x, edges.iter().all(|e| *e > 1e-9));
            }
        }
    }
}
