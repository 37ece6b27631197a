//! Which points lie near each other on a surface. Neighbours are found in space, so that charts of the atlas do not matter.

use std::collections::HashMap;
use std::ops::Range;

use glam::{IVec3, Vec3};

use crate::surface::SurfacePoint;

/// Points of one surface face the same way: the cosine between their normals is at least this.
const SAME_WAY: f32 = 0.9;
/// How far a point may lie beside the tangent plane, as a share of the search radius.
const BESIDE: f32 = 0.15;

/// Points by cells of a sparse grid.
pub(crate) struct Neighbours<'a> {
    points: &'a [SurfacePoint],
    /// Edge of a cell and search radius, metres.
    radius: f32,
    /// Point indices, cell by cell.
    order: Vec<u32>,
    cells: HashMap<IVec3, Range<usize>>,
}

impl<'a> Neighbours<'a> {
    /// Sorts the points into cells of `radius` metres.
    pub fn new(points: &'a [SurfacePoint], radius: f32) -> Self {
        let cell = |i: u32| cell_of(Vec3::from(points[i as usize].position), radius);
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.sort_by_cached_key(|&i| cell(i).to_array());
        let mut cells = HashMap::new();
        let mut start = 0;
        for run in order.chunk_by(|&a, &b| cell(a) == cell(b)) {
            cells.insert(cell(run[0]), start..start + run.len());
            start += run.len();
        }
        Self { points, radius, order, cells }
    }

    /// The points within the radius of point `i` on its surface, itself included: index and offset, metres.
    pub fn of(&self, i: usize) -> impl Iterator<Item = (usize, Vec3)> + '_ {
        let position = Vec3::from(self.points[i].position);
        let normal = Vec3::from(self.points[i].normal);
        let centre = cell_of(position, self.radius);
        let around = move |k: i32| centre + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
        (0..27)
            .filter_map(move |k| self.cells.get(&around(k)))
            .flat_map(|range| &self.order[range.clone()])
            .map(move |&j| (j as usize, Vec3::from(self.points[j as usize].position) - position))
            .filter(move |&(j, offset)| {
                offset.length_squared() < self.radius * self.radius
                    && offset.dot(normal).abs() < BESIDE * self.radius
                    && normal.dot(Vec3::from(self.points[j].normal)) > SAME_WAY
            })
    }
}

fn cell_of(position: Vec3, edge: f32) -> IVec3 {
    (position / edge).floor().as_ivec3()
}
