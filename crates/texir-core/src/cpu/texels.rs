//! Texel map, twin of `texels.wgsl`: which surface point each atlas texel is.

use std::ops::Range;

use glam::Vec2;

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::real::Real;
use crate::surface::TexelHit;

/// Side of the tiles that triangles are binned into, texels.
pub const TILE: usize = 16;

/// A triangle touches a texel when it comes this close to its centre, in texels: the texel's circumscribed circle, so
/// that every triangle that overlaps the texel's square is found.
pub const REACH: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Triangles in the lists of all tiles together, at most: a gigabyte, hundreds for every tile of the largest atlas.
const MOST: usize = 1 << 28;

/// Triangles by tile of the atlas, each list ascending: what a texel's thread has to look through.
#[derive(Clone, Debug, PartialEq)]
pub struct TileBins {
    /// Tiles per row.
    pub columns: usize,
    /// First row of tiles.
    pub first_row: usize,
    /// `tiles + 1` offsets into `triangles`.
    pub offsets: Vec<u32>,
    /// Triangle indices, tile by tile.
    pub triangles: Vec<u32>,
}

impl TileBins {
    /// Bins every triangle into the tiles that its bounds, grown by [`REACH`], touch: those that hold `rows` of an
    /// atlas of `[width, height]` texels. Errors where more than 2²⁸ are in them together: triangles then lie over
    /// each other by the thousands.
    pub fn new(mesh: &Mesh, [width, height]: [usize; 2], rows: Range<usize>) -> Result<Self> {
        let columns = width.div_ceil(TILE);
        let (first_row, end_row) = (rows.start / TILE, rows.end.div_ceil(TILE));
        let tiles_of = |triangle: u32| {
            let corners = mesh.corner_uvs(triangle).map(|uv| uv * Vec2::new(width as f32, height as f32));
            let low = corners.into_iter().reduce(Vec2::min).unwrap_or_default() - 1.0;
            let high = corners.into_iter().reduce(Vec2::max).unwrap_or_default() + 1.0;
            let tile = |x: f32| x.max(0.0) as usize / TILE;
            let across = tile(low.x).min(columns.saturating_sub(1))..(tile(high.x) + 1).min(columns);
            let all_rows = height.div_ceil(TILE);
            (tile(low.y).min(all_rows.saturating_sub(1)).max(first_row)..(tile(high.y) + 1).min(end_row))
                .flat_map(move |ty| across.clone().map(move |tx| (ty - first_row) * columns + tx))
        };
        // Where the lists of the tiles end; then, while they are filled, where their next entries go.
        let mut ends = vec![0u32; columns * end_row.saturating_sub(first_row) + 1];
        let mut entries = 0;
        for triangle in 0..mesh.triangles.len() as u32 {
            tiles_of(triangle).for_each(|tile| {
                ends[tile + 1] += 1;
                entries += 1;
            });
            if entries > MOST {
                return Err(Error::invalid(format!(
                    "the mesh's triangles lie over each other in the atlas, so many that more than {MOST} are near its texels; expected \
                     a place of its own for each: give the mesh a new atlas (`texir import --unwrap`)"
                )));
            }
        }
        (1..ends.len()).for_each(|tile| ends[tile] += ends[tile - 1]);
        let offsets = ends.clone();
        let mut triangles = vec![0; entries];
        for triangle in 0..mesh.triangles.len() as u32 {
            tiles_of(triangle).for_each(|tile| {
                triangles[ends[tile] as usize] = triangle;
                ends[tile] += 1;
            });
        }
        Ok(Self { columns, first_row, offsets, triangles })
    }

    /// The candidates of texel (x, y).
    pub fn at(&self, x: usize, y: usize) -> &[u32] {
        let tile = (y / TILE - self.first_row) * self.columns + x / TILE;
        &self.triangles[self.offsets[tile] as usize..self.offsets[tile + 1] as usize]
    }
}

/// Texel (x, y): the lowest-numbered triangle that contains its centre; else the nearest point of the nearest triangle
/// within [`REACH`] (the lower number where equally near). `corners(t)` are atlas coordinates in texels.
pub fn texel<R: Real>(
    candidates: &[u32],
    corners: impl Fn(u32) -> [[R; 2]; 3],
    x: usize,
    y: usize,
) -> Option<TexelHit<R>> {
    let centre = [R::of(x as f64 + 0.5), R::of(y as f64 + 0.5)];
    let mut best = None;
    let mut best_distance = R::of(REACH * REACH);
    for &triangle in candidates {
        let Some((u, v, distance)) = nearest(corners(triangle), centre) else { continue };
        let inside = distance == R::of(0.0);
        if inside || distance < best_distance {
            best = Some(TexelHit { triangle, u, v, inside });
            best_distance = distance;
        }
        if inside {
            break;
        }
    }
    best
}

/// Barycentric coordinates of the point of a triangle nearest to `p`, and the squared distance (0 inside); `None` for a
/// triangle without area in the atlas.
fn nearest<R: Real>([a, b, c]: [[R; 2]; 3], p: [R; 2]) -> Option<(R, R, R)> {
    let (zero, one) = (R::of(0.0), R::of(1.0));
    let sub = |p: [R; 2], q: [R; 2]| [p[0] - q[0], p[1] - q[1]];
    let cross = |p: [R; 2], q: [R; 2]| p[0] * q[1] - p[1] * q[0];
    let dot = |p: [R; 2], q: [R; 2]| p[0] * q[0] + p[1] * q[1];
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let area = cross(ab, ac);
    if area == zero {
        return None;
    }
    let (u, v) = (cross(ap, ac) / area, cross(ab, ap) / area);
    if u >= zero && v >= zero && u + v <= one {
        return Some((u, v, zero));
    }
    let along = |from: [R; 2], edge: [R; 2]| (dot(sub(p, from), edge) / dot(edge, edge)).max(zero).min(one);
    let (s, t, w) = (along(a, ab), along(a, ac), along(b, sub(c, b)));
    let mut best = (zero, zero, R::of(f64::MAX));
    for (u, v) in [(s, zero), (zero, t), (one - w, w)] {
        let offset = [ap[0] - ab[0] * u - ac[0] * v, ap[1] - ab[1] * u - ac[1] * v];
        let distance = dot(offset, offset);
        if distance < best.2 {
            best = (u, v, distance);
        }
    }
    Some(best)
}
