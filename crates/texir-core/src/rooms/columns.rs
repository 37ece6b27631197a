//! What stands over each cell of a storey's plan: the mesh rasterised into vertical columns of 64 slices.

use glam::Vec3;

use super::storeys::{LEVEL_BIN, Storey};
use super::{Grid, HORIZONTAL};
use crate::error::{Error, Result};
use crate::mesh::{bounds, cross};

/// Empty cells around the mesh, so that everything has an outside.
const MARGIN: usize = 3;
/// Cells of the largest plan that is made: more than 400 m × 400 m at 5 cm is a wrong unit or a stray vertex.
const MAX_CELLS: f64 = 6.4e7;

/// The grid over triangles given in plan coordinates, with a margin. Errors without a finite triangle, and on more
/// cells than [`MAX_CELLS`].
pub(super) fn grid_over(triangles: impl Iterator<Item = [Vec3; 3]>, cell: f32) -> Result<Grid> {
    let (lo, hi) = bounds(triangles.flatten().filter(|p| p.is_finite()));
    if lo.x > hi.x {
        return Err(Error::invalid("the mesh has no triangle with finite corners: no floor plan can be made"));
    }
    let extent = ((hi - lo) / cell).ceil();
    if f64::from(extent.x + 2.0) * f64::from(extent.y + 2.0) > MAX_CELLS {
        return Err(Error::invalid(format!(
            "the floor plan of a mesh of {:.1} m × {:.1} m needs too many cells of {cell} m: check the mesh's unit \
             (metres are expected; `texir import --metres-per-unit` converts) and stray vertices",
            hi.x - lo.x,
            hi.y - lo.y
        )));
    }
    let (width, height) = (extent.x as usize + 1 + 2 * MARGIN, extent.y as usize + 1 + 2 * MARGIN);
    Ok(Grid { width, height, origin: lo.truncate() - MARGIN as f32 * cell, cell })
}

/// The columns over a storey. Plan coordinates: x and y in the floor's plane, z up, metres.
pub(super) struct Columns {
    /// The cells.
    pub grid: Grid,
    /// Heights of the floor and of the highest ceiling.
    pub storey: Storey,
    /// Per cell, bit i set: some surface passes through slice i of the 64 between floor and top.
    filled: Vec<u64>,
    /// Per cell, the highest floor, table or ceiling; −∞ where there is nothing.
    highest: Vec<f32>,
}

impl Columns {
    /// Rasterises what lies in a storey of triangles given in plan coordinates.
    pub fn new(triangles: impl Iterator<Item = [Vec3; 3]>, grid: Grid, storey: Storey) -> Self {
        let cells = grid.width * grid.height;
        let mut columns = Self { grid, storey, filled: vec![0; cells], highest: vec![f32::NEG_INFINITY; cells] };
        triangles.for_each(|triangle| columns.add(triangle));
        columns
    }

    /// Whether a floor, a ceiling or anything else horizontal lies in the cell's column.
    pub fn covered(&self, cell: usize) -> bool {
        self.highest[cell] > f32::NEG_INFINITY
    }

    /// Height of the cell's ceiling: its highest horizontal surface, if that is above head height.
    pub fn ceiling(&self, cell: usize, head: f32) -> Option<f32> {
        (self.highest[cell] > self.storey.floor + head).then_some(self.highest[cell])
    }

    /// Share of the slices between two heights that some surface passes through.
    pub fn share(&self, cell: usize, from: f32, to: f32) -> f32 {
        let mask = self.slices(from, to);
        (self.filled[cell] & mask).count_ones() as f32 / mask.count_ones().max(1) as f32
    }

    /// The slices that a height interval touches.
    fn slices(&self, from: f32, to: f32) -> u64 {
        let Storey { floor, top } = self.storey;
        if to < floor || from > top {
            return 0;
        }
        let slice = |z: f32| (((z - floor) / (top - floor) * 64.0).max(0.0) as u32).min(63);
        let (first, last) = (slice(from), slice(to));
        (u64::MAX >> (63 - last)) & (u64::MAX << first)
    }

    /// Adds one triangle to every column it passes through.
    fn add(&mut self, triangle: [Vec3; 3]) {
        let normal = cross(triangle);
        let horizontal = normal.z.abs() > HORIZONTAL * normal.length();
        if !triangle.iter().all(|p| p.is_finite()) {
            return;
        }
        let whole = Polygon::from(triangle);
        let (y0, y1) = whole.range(1);
        for y in self.index(y0, 1)..=self.index(y1, 1) {
            let row = whole.slab(1, self.grid.origin.y + y as f32 * self.grid.cell, self.grid.cell);
            let (x0, x1) = row.range(0);
            if x0 > x1 {
                continue;
            }
            for x in self.index(x0, 0)..=self.index(x1, 0) {
                let (z0, z1) = row.slab(0, self.grid.origin.x + x as f32 * self.grid.cell, self.grid.cell).range(2);
                if z0 > z1 {
                    continue;
                }
                let cell = y * self.grid.width + x;
                self.filled[cell] |= self.slices(z0, z1);
                // What lies above the ceiling (a roof) or below the floor is not this storey's.
                if horizontal && z1 <= self.storey.top + LEVEL_BIN && z0 >= self.storey.floor - LEVEL_BIN {
                    self.highest[cell] = self.highest[cell].max(z1);
                }
            }
        }
    }

    /// Column (axis 0) or row (axis 1) of a plan coordinate.
    fn index(&self, value: f32, axis: usize) -> usize {
        let limit = [self.grid.width, self.grid.height][axis] - 1;
        (((value - self.grid.origin[axis]) / self.grid.cell).max(0.0) as usize).min(limit)
    }
}

/// A convex polygon: a triangle cut by at most four planes.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [Vec3; 8],
    count: usize,
}

impl From<[Vec3; 3]> for Polygon {
    fn from([a, b, c]: [Vec3; 3]) -> Self {
        let mut corners = [a; 8];
        (corners[1], corners[2]) = (b, c);
        Self { corners, count: 3 }
    }
}

impl Polygon {
    /// The part with `from ≤ coordinate ≤ from + size` along an axis, a little fattened: a wall exactly on the border
    /// of two cells must not fall between them by rounding.
    fn slab(&self, axis: usize, from: f32, size: f32) -> Self {
        const FAT: f32 = 1e-3;
        self.clip(|p| p[axis] - from + FAT * size).clip(|p| from + (1.0 + FAT) * size - p[axis])
    }

    /// The part where a linear function is not negative.
    fn clip(&self, inside: impl Fn(Vec3) -> f32) -> Self {
        let mut cut = Self { corners: self.corners, count: 0 };
        for i in 0..self.count {
            let (p, q) = (self.corners[i], self.corners[(i + 1) % self.count]);
            let (dp, dq) = (inside(p), inside(q));
            if dp >= 0.0 {
                cut.push(p);
            }
            if (dp >= 0.0) != (dq >= 0.0) {
                cut.push(p.lerp(q, dp / (dp - dq)));
            }
        }
        cut
    }

    fn push(&mut self, p: Vec3) {
        // A triangle cut by four planes has at most seven corners; rounding may repeat one, never lose one that
        // matters.
        if self.count < self.corners.len() {
            self.corners[self.count] = p;
            self.count += 1;
        }
    }

    /// Smallest and largest coordinate along an axis; an empty range for an empty polygon.
    fn range(&self, axis: usize) -> (f32, f32) {
        self.corners[..self.count]
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), p| (lo.min(p[axis]), hi.max(p[axis])))
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;

    #[test]
    fn a_tilted_triangle_touches_exactly_the_cells_that_it_overlaps() {
        let triangle = [Vec3::new(0.03, 0.02, 0.0), Vec3::new(0.93, 0.11, 2.0), Vec3::new(0.31, 0.77, 4.0)];
        let triangles = [triangle].into_iter();
        let grid = grid_over(triangles.clone(), 0.1).unwrap();
        let columns = Columns::new(triangles, grid, Storey { floor: 0.0, top: 4.0 });
        // Brute force: dense points of the triangle. A touched cell without one is grazed at a corner.
        let mut reached = vec![false; columns.filled.len()];
        for i in 0..=600 {
            for j in 0..=600 - i {
                let (u, v) = (i as f32 / 600.0, j as f32 / 600.0);
                let p = triangle[0] * (1.0 - u - v) + triangle[1] * u + triangle[2] * v;
                reached[grid.cell_of(p.truncate())] = true;
            }
        }
        for (cell, _) in reached.iter().enumerate().filter(|(_, reached)| **reached) {
            assert_ne!(columns.filled[cell], 0, "cell {cell} holds part of the triangle and is empty");
        }
        let touched = columns.filled.iter().filter(|&&f| f != 0).count();
        let inside = reached.iter().filter(|&&r| r).count();
        assert!(touched - inside <= 2, "{touched} cells touched, {inside} hold part of the triangle");
    }

    #[test]
    fn slices_follow_the_height() {
        let wall = |z0: f32, z1: f32| {
            [
                [Vec3::new(0.0, 0.0, z0), Vec3::new(1.0, 0.0, z0), Vec3::new(1.0, 0.0, z1)],
                [Vec3::new(0.0, 0.0, z0), Vec3::new(1.0, 0.0, z1), Vec3::new(0.0, 0.0, z1)],
            ]
        };
        let walls = [wall(0.0, 1.0), wall(2.0, 3.2)].into_iter().flatten();
        let grid = grid_over(walls.clone(), 0.05).unwrap();
        let columns = Columns::new(walls, grid, Storey { floor: 0.0, top: 3.2 });
        let cell = grid.cell_of(Vec2::new(0.5, 0.0));
        assert!(columns.share(cell, 0.1, 0.9) == 1.0 && columns.share(cell, 2.1, 3.1) == 1.0);
        assert!(columns.share(cell, 1.1, 1.9) == 0.0);
    }
}
