//! Is the atlas one? Every texel should belong to one place of the surface.

use glam::{DVec2, Vec2};

use crate::mesh::Mesh;

/// Atlas coordinates may leave the unit square by this much: rounding, not a tiled texture.
const UNIT_SQUARE_SLACK: f32 = 1e-4;

/// Rounding and shared chart borders explain overlaps up to this fraction of the covered texels.
const TOLERATED_OVERLAP: f64 = 0.01;

/// Once triangles have had so many times the texels of an atlas, it is none.
const ENOUGH: usize = 8;

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

/// Rasterises the atlas at `[width, height]` texels. Surfaces of which all have the same texels many times over, as those of a
/// tiled texture, are not gone through to the last.
pub fn atlas_report(mesh: &Mesh, size: [usize; 2]) -> AtlasReport {
    const COVERED: u8 = 1;
    const OWNED: u8 = 2;
    const SHARED: u8 = 4;
    let corners = (0..mesh.triangles.len() as u32).map(|t| mesh.corner_uvs(t));
    let allowed = -UNIT_SQUARE_SLACK..=1.0 + UNIT_SQUARE_SLACK;
    let leaves = |uvs: &[Vec2; 3]| uvs.iter().any(|uv| !(allowed.contains(&uv.x) && allowed.contains(&uv.y)));
    let outside_unit_square_triangles = corners.clone().filter(leaves).count();
    let mut texels = vec![0_u8; size[0] * size[1]];
    let mut visits = 0;
    for uvs in corners {
        for_texel_centres(uvs, size, |texel, interior| {
            visits += 1;
            let state = &mut texels[texel];
            *state |= COVERED;
            if interior {
                *state |= if *state & OWNED != 0 { SHARED } else { OWNED };
            }
        });
        if visits > ENOUGH * texels.len() {
            break;
        }
    }
    let count = |flag: u8| texels.iter().filter(|t| **t & flag != 0).count() as f64;
    AtlasReport {
        covered_fraction: count(COVERED) / texels.len().max(1) as f64,
        overlapping_fraction: count(SHARED) / count(COVERED).max(1.0),
        outside_unit_square_triangles,
    }
}

/// Calls `visit(texel, strictly inside)` for every texel whose centre lies in the closed triangle.
fn for_texel_centres(uvs: [Vec2; 3], [width, height]: [usize; 2], mut visit: impl FnMut(usize, bool)) {
    let [a, b, c] = uvs.map(|uv| uv.as_dvec2() * DVec2::new(width as f64, height as f64));
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let edges = [(b, c), (c, a), (a, b)];
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    // The texels whose centre, at +½, lies in [low, high]; a float cast saturates.
    let first = |low: f64| (low - 0.5).ceil().max(0.0) as usize;
    let end = |high: f64, most: usize| ((high - 0.5).floor() + 1.0).clamp(0.0, most as f64) as usize;
    for y in first(low.y)..end(high.y, height) {
        let (mut left, mut right) = (low.x, high.x);
        // Where the row enters and leaves the triangle, with a texel to spare for rounding; by a level edge, at ±∞.
        for (from, to) in edges {
            let rise = to.y - from.y;
            let x = from.x + (y as f64 + 0.5 - from.y) * (to.x - from.x) / rise;
            if (rise < 0.0) == (area > 0.0) {
                left = left.max(x - 1.0);
            } else {
                right = right.min(x + 1.0);
            }
        }
        for x in first(left)..end(right, width) {
            let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let sides = edges.map(|(from, to)| (to - from).perp_dot(p - from) / area);
            if sides.iter().all(|e| *e >= 0.0) {
                visit(y * width + x, sides.iter().all(|e| *e > 1e-9));
            }
        }
    }
}
