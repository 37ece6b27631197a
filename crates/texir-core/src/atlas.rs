//! The atlas as surface points: which texels hold a piece of the mesh, and where in the world they are.

mod crowded;

use std::fmt;
use std::ops::Range;

use glam::Vec2;

pub use self::crowded::crowded;
use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::mesh::{Mesh, cross};
use crate::raster::Raster;
use crate::surface::{Hit, SurfacePoint, TexelHit};
use crate::texture::{Pyramid, Tap};

/// How far a texel that its triangle only touches moves from the triangle's edge towards its middle: on the edge
/// itself, where rounding decides on which side of the neighbouring surface a ray starts, half of its rays would leave
/// the room.
const OFF_EDGE: f32 = 1e-3;

/// Side of an atlas, texels, where nothing says; overlaps of charts are looked for at this size.
pub const DEFAULT_SIDE: usize = 1024;

/// Largest side of an atlas, texels: beyond it, no graphics card holds the texture, and readers of images refuse it.
pub const MAX_SIDE: usize = 16_384;

/// Texels of a map that are written at a time, and mapped at least.
pub(crate) const BAND: usize = 1 << 19;

/// The texel map of a mesh: the valid texels of a `width × height` atlas and their surface points, in atlas order.
#[derive(Clone, Debug)]
pub struct Atlas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Atlas index (row · width + column) of each valid texel, ascending.
    pub texels: Vec<u32>,
    /// The surface point of each valid texel, on the front side of its triangle; its index is the texel's.
    pub points: Vec<SurfacePoint>,
    /// Texels whose centre lies in a triangle (the others are only touched by one), per valid texel.
    pub inside: Vec<bool>,
}

impl Atlas {
    /// Maps every texel of `[width, height]` to the backend's mesh. Errors when no texel is covered, or a side is
    /// longer than [`MAX_SIDE`]. Where charts overlap or leave [0, 1], texels are another surface's or missing;
    /// `mesh_io::atlas_report` tells.
    pub fn new(backend: &mut dyn Backend, [width, height]: [usize; 2]) -> Result<Self> {
        let mut atlas = Self { width, height, texels: Vec::new(), points: Vec::new(), inside: Vec::new() };
        map(backend, [width, height], |_, points, inside| {
            atlas.texels.extend(points.iter().map(|point| point.index));
            atlas.points.extend(points);
            atlas.inside.extend(inside);
            Ok(())
        })?;
        Ok(atlas)
    }

    /// One flag per atlas texel: does it hold a piece of the mesh?
    pub fn valid(&self) -> Vec<bool> {
        let mut valid = vec![false; self.width * self.height];
        self.texels.iter().for_each(|&t| valid[t as usize] = true);
        valid
    }

    /// The mip pyramid over the valid texels.
    pub fn pyramid(&self) -> Pyramid {
        Pyramid::new(self.width, self.height, &self.valid())
    }

    /// Area on the surface, m², of a texel on `triangle`; 0 for a triangle without area in the atlas.
    pub fn texel_area(&self, mesh: &Mesh, triangle: u32) -> f32 {
        texel_area(mesh, [self.width, self.height], triangle)
    }

    /// Edge of the median texel on the surface, metres.
    pub fn typical_texel(&self, mesh: &Mesh) -> f32 {
        let mut typical = TypicalTexel::new(mesh, [self.width, self.height]);
        typical.count(&self.points);
        typical.edge()
    }

    /// Puts one value per valid texel into the atlas, `empty` elsewhere. Errors on another number of values.
    pub fn scatter<T: Copy>(&self, values: &[T], empty: T) -> Result<Raster<T>> {
        self.check_count("values", values.len())?;
        let mut raster = Raster::filled(self.width, self.height, empty);
        self.texels.iter().zip(values).for_each(|(&t, &v)| raster.data[t as usize] = v);
        Ok(raster)
    }

    /// [`Atlas::scatter`], then `rings` times the texels that are not `known`, those outside the charts among them,
    /// take the value of their first neighbour that is or has taken one, so that lookups just outside find what is just
    /// inside.
    pub fn scatter_padded<T: Copy>(&self, values: &[T], known: &[bool], empty: T, rings: usize) -> Result<Raster<T>> {
        let mut raster = self.scatter(values, empty)?;
        self.check_count("flags of what is known", known.len())?;
        let mut filled = vec![false; self.width * self.height];
        self.texels.iter().zip(known).for_each(|(&texel, &known)| filled[texel as usize] = known);
        pad(&mut raster, &mut filled, rings);
        Ok(raster)
    }

    /// [`Atlas::scatter_padded`] of values that are all known; 0 beyond.
    pub fn padded<T: Copy + Default>(&self, values: &[T], rings: usize) -> Result<Raster<T>> {
        self.scatter_padded(values, &vec![true; values.len()], T::default(), rings)
    }

    fn check_count(&self, what: &str, found: usize) -> Result<()> {
        if found == self.texels.len() {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "{found} {what} are given for an atlas of {} texels; expected one per valid texel",
            self.texels.len()
        )))
    }
}

/// Maps a band of an atlas's rows after another: hands on the rows, the points of their valid texels, in atlas order,
/// and which of these have their centre in a triangle. Errors when no texel is covered.
pub(crate) fn map(
    backend: &mut dyn Backend,
    [width, height]: [usize; 2],
    mut take: impl FnMut(Range<usize>, Vec<SurfacePoint>, Vec<bool>) -> Result<()>,
) -> Result<()> {
    if ![width, height].iter().all(|side| (1..=MAX_SIDE).contains(side)) {
        return Err(Error::invalid(format!(
            "the atlas is {width}×{height} texels; expected at least 1×1, and at most {MAX_SIDE} a side"
        )));
    }
    let scene = backend.scene().clone();
    let mut any = false;
    for rows in mapped_bands(scene.mesh(), [width, height]) {
        let hits = backend.texels([width, height], rows.clone())?;
        let first = rows.start * width;
        let covered = || hits.iter().zip(first..).filter_map(|(hit, i)| Some((hit.as_ref()?, i)));
        let point = |(hit, i): (&TexelHit, usize)| SurfacePoint {
            index: i as u32,
            ..SurfacePoint::new(scene.mesh(), &off_edge(hit), None)
        };
        any |= covered().next().is_some();
        take(rows, covered().map(point).collect(), covered().map(|(hit, _)| hit.inside).collect())?;
    }
    if any {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "no texel of the {width}×{height} atlas is covered by the mesh: its texture coordinates are missing, degenerate, or \
         outside [0, 1]"
    )))
}

/// Rows of a map or a view, in bands of about `items` items, of which each row has `width`.
pub(crate) fn bands(width: usize, height: usize, items: usize) -> impl Iterator<Item = Range<usize>> {
    let rows = (items / width.max(1)).max(1);
    (0..height).step_by(rows).map(move |row| row..(row + rows).min(height))
}

/// Rows of a map of a mesh, in bands to be mapped at a time: each takes all triangles in hand, so that there are at
/// least as many texels in one.
pub(crate) fn mapped_bands(mesh: &Mesh, [width, height]: [usize; 2]) -> impl Iterator<Item = Range<usize>> {
    bands(width, height, BAND.max(mesh.triangles.len()))
}

/// Area on the surface, m², of a texel on `triangle` in an atlas of some size; 0 for a triangle without area in it.
pub(crate) fn texel_area(mesh: &Mesh, [width, height]: [usize; 2], triangle: u32) -> f32 {
    let [ua, ub, uc] = mesh.corner_uvs(triangle);
    let world = cross(mesh.corners(triangle)).length();
    let texels = (ub - ua).perp_dot(uc - ua).abs() * (width * height) as f32;
    if texels > 0.0 { world / texels } else { 0.0 }
}

/// Finds the median texel: all texels of a triangle have the same size.
pub(crate) struct TypicalTexel<'a> {
    mesh: &'a Mesh,
    size: [usize; 2],
    /// Texels by triangle.
    counts: Vec<u32>,
}

impl<'a> TypicalTexel<'a> {
    /// For an atlas of `size`.
    pub fn new(mesh: &'a Mesh, size: [usize; 2]) -> Self {
        Self { mesh, size, counts: vec![0; mesh.triangles.len()] }
    }

    /// Takes note of some texels.
    pub fn count(&mut self, points: &[SurfacePoint]) {
        points.iter().for_each(|point| self.counts[point.triangle as usize] += 1);
    }

    /// Edge of the median texel on the surface, metres; 0 without texels.
    pub fn edge(&self) -> f32 {
        let used = (0..self.counts.len()).filter(|&t| self.counts[t] > 0);
        let mut areas: Vec<(f32, u32)> =
            used.map(|t| (texel_area(self.mesh, self.size, t as u32), self.counts[t])).collect();
        areas.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut left = areas.iter().map(|(_, count)| *count as usize).sum::<usize>() / 2;
        let median = areas.iter().find(|(_, count)| {
            let here = left < *count as usize;
            left = left.saturating_sub(*count as usize);
            here
        });
        median.map_or(0.0, |(area, _)| area.sqrt())
    }
}

/// `rings` times, the empty texels next to filled ones take their first filled neighbour's value.
pub(crate) fn pad<T: Copy>(raster: &mut Raster<T>, filled: &mut [bool], rings: usize) {
    let (width, height) = (raster.width, raster.height);
    for _ in 0..rings {
        let before = filled.to_vec();
        for y in 0..height {
            for x in 0..width {
                if before[y * width + x] {
                    continue;
                }
                let neighbours = [(1, 1), (0, 1), (2, 1), (1, 0), (1, 2), (0, 0), (2, 0), (0, 2), (2, 2)]
                    .into_iter()
                    .filter_map(|(dx, dy)| {
                        let (nx, ny) = ((x + dx).checked_sub(1)?, (y + dy).checked_sub(1)?);
                        (nx < width && ny < height).then_some(ny * width + nx)
                    });
                if let Some(from) = neighbours.into_iter().find(|&n| before[n]) {
                    raster.data[y * width + x] = raster.data[from];
                    filled[y * width + x] = true;
                }
            }
        }
    }
}

/// See [`OFF_EDGE`].
fn off_edge(texel: &TexelHit) -> Hit {
    let hit = texel.hit();
    if texel.inside {
        return hit;
    }
    let inwards = |v: f32| v + (1.0 / 3.0 - v) * OFF_EDGE;
    Hit { u: inwards(hit.u), v: inwards(hit.v), ..hit }
}

/// Finds the valid texels at atlas positions, by their index in [`Atlas::texels`].
pub struct TexelIndex {
    width: usize,
    height: usize,
    index: Vec<u32>,
}

impl fmt::Debug for TexelIndex {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TexelIndex").field("size", &[self.width, self.height]).finish_non_exhaustive()
    }
}

impl TexelIndex {
    const EMPTY: u32 = u32::MAX;

    /// The index of an atlas.
    pub fn new(atlas: &Atlas) -> Self {
        let mut index = vec![Self::EMPTY; atlas.width * atlas.height];
        for (i, &texel) in atlas.texels.iter().enumerate() {
            index[texel as usize] = i as u32;
        }
        Self { width: atlas.width, height: atlas.height, index }
    }

    /// The valid texel in column `x` and row `y`.
    pub fn at(&self, x: i64, y: i64) -> Option<u32> {
        let inside = x >= 0 && y >= 0 && x < self.width as i64 && y < self.height as i64;
        let texel = if inside { self.index[y as usize * self.width + x as usize] } else { Self::EMPTY };
        (texel != Self::EMPTY).then_some(texel)
    }

    /// The valid texel that `uv` lies in, which the last one does at 1.
    pub fn nearest(&self, uv: Vec2) -> Option<u32> {
        let size = Vec2::new(self.width as f32, self.height as f32);
        let p = (uv * size).floor().min(size - 1.0);
        let inside = uv.cmpge(Vec2::ZERO).all() && uv.cmple(Vec2::ONE).all();
        if inside { self.at(p.x as i64, p.y as i64) } else { None }
    }

    /// Bilinear shares of the valid texels around `uv`; they are not normalised.
    pub fn bilinear(&self, uv: Vec2) -> impl Iterator<Item = Tap> + use<'_> {
        let p = uv * Vec2::new(self.width as f32, self.height as f32) - 0.5;
        let base = p.floor();
        let f = p - base;
        [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().filter_map(move |(dx, dy)| {
            let weight = (if dx == 0 { 1.0 - f.x } else { f.x }) * (if dy == 0 { 1.0 - f.y } else { f.y });
            let x = (base.x as i64 + dx).clamp(0, self.width as i64 - 1);
            let y = (base.y as i64 + dy).clamp(0, self.height as i64 - 1);
            self.at(x, y).filter(|_| weight > 0.0).map(|texel| Tap { texel, weight })
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::cpu::CpuBackend;
    use crate::scene::Scene;

    #[test]
    fn texels_hold_what_is_at_their_centres() {
        let square = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        let mesh = Mesh {
            positions: square.map(|at| at.extend(0.0)).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: square.to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let atlas = Atlas::new(&mut CpuBackend::new(Scene::new(mesh).unwrap()), [4, 4]).unwrap();
        for few in [atlas.scatter(&[1.0; 15], 0.0), atlas.scatter_padded(&[1.0; 16], &[true; 17], 0.0, 1)] {
            assert!(few.is_err_and(|e| e.to_string().contains("an atlas of 16 texels")));
        }
        let index = TexelIndex::new(&atlas);
        let column = |u: f32| index.nearest(Vec2::new(u, 0.5)).map(|texel| atlas.texels[texel as usize] % 4);
        assert_eq!([0.0, 0.24, 0.26, 0.99, 1.0].map(column), [0, 0, 1, 3, 3].map(Some));
        assert_eq!([-0.01, 1.01, f32::NAN].map(column), [None; 3]);
        // Every texel holds its column, or its row.
        let place = |tap: &Tap| [atlas.texels[tap.texel as usize] % 4, atlas.texels[tap.texel as usize] / 4];
        for (uv, expected) in [
            ([0.375, 0.875], [1.0, 3.0]),
            ([0.5, 0.25], [1.5, 0.5]),
            ([0.8125, 0.0], [2.75, 0.0]),
            ([1.0, 1.0], [3.0, 3.0]),
        ] {
            let sum = |k: usize| index.bilinear(uv.into()).map(|tap| place(&tap)[k] as f32 * tap.weight).sum::<f32>();
            let found = [0, 1].map(sum);
            assert!(
                (0..2).all(|k| (found[k] - expected[k]).abs() < 1e-6),
                "{found:?} at {uv:?}; expected {expected:?}"
            );
        }
    }
}
