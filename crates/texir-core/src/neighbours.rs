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
pub(crate) struct Neighbours {
    /// Edge of a cell and search radius, metres.
    radius: f32,
    /// The points, cell by cell, so that a search reads memory in order.
    entries: Vec<Entry>,
    cells: HashMap<IVec3, Range<usize>>,
}

struct Entry {
    position: Vec3,
    normal: Vec3,
    index: u32,
}

impl Neighbours {
    /// Sorts the points into cells of `radius` metres.
    pub fn new(points: &[SurfacePoint], radius: f32) -> Self {
        let entry = |(i, point): (usize, &SurfacePoint)| Entry {
            position: point.position.into(),
            normal: point.normal.into(),
            index: i as u32,
        };
        let mut entries: Vec<Entry> = points.iter().enumerate().map(entry).collect();
        let cell = |entry: &Entry| cell_of(entry.position, radius);
        entries.sort_by_cached_key(|entry| cell(entry).to_array());
        let mut cells = HashMap::new();
        let mut start = 0;
        for run in entries.chunk_by(|a, b| cell(a) == cell(b)) {
            cells.insert(cell(&run[0]), start..start + run.len());
            start += run.len();
        }
        Self { radius, entries, cells }
    }

    /// The points within the radius of `point` on its surface, itself included: index and offset, metres.
    pub fn of(&self, point: &SurfacePoint) -> impl Iterator<Item = (usize, Vec3)> + '_ {
        let (position, normal) = (Vec3::from(point.position), Vec3::from(point.normal));
        let centre = cell_of(position, self.radius);
        (0..27)
            .filter_map(move |k| self.cells.get(&(centre + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1))))
            .flat_map(|range| &self.entries[range.clone()])
            .map(move |entry| (entry, entry.position - position))
            .filter(move |(entry, offset)| {
                offset.length_squared() < self.radius * self.radius
                    && offset.dot(normal).abs() < BESIDE * self.radius
                    && normal.dot(entry.normal) > SAME_WAY
            })
            .map(|(entry, offset)| (entry.index as usize, offset))
    }
}

/// The cell of a grid of some `edge` (metres) that a place lies in.
pub(crate) fn cell_of(position: Vec3, edge: f32) -> IVec3 {
    (position / edge).floor().as_ivec3()
}
