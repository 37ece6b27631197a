//! Which points lie near each other on a surface. Neighbours are found in space, so that charts of the atlas do not
//! matter.

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::surface::SurfacePoint;

/// Points of one surface face the same way: the cosine between their normals is at least this.
pub const MIN_NORMAL_COSINE: f32 = 0.9;
/// How far a point may lie beside the tangent plane, as a share of the search radius.
pub const MAX_PLANE_DISTANCE: f32 = 0.15;
/// Columns of cells along z within one cell of another.
pub const NEAR: usize = 9;
/// Columns of cells along z within three cells of another, the [`NEAR`] ones first.
pub const FAR: usize = 49;

/// Points by cells of a sparse grid, for searches in [`NEAR`] or [`FAR`] columns around each.
#[derive(Debug)]
pub struct Neighbours<const COLUMNS: usize> {
    /// Edge of a cell, metres.
    edge: f32,
    /// The points, cell by cell in order of x, y, z and then of the points' own, so that a column of cells lies
    /// together.
    pub entries: Vec<Entry>,
    /// Of every cell, where in `entries` each column around it begins and ends.
    pub spans: Vec<[[u32; 2]; COLUMNS]>,
    /// Where in `entries` each point is.
    places: Vec<u32>,
}

/// A point as a search needs it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Entry {
    /// Its place, metres.
    pub position: [f32; 3],
    /// Which point it is.
    pub index: u32,
    /// Its unit normal.
    pub normal: [f32; 3],
    /// Which cell it lies in.
    pub cell: u32,
}

impl<const COLUMNS: usize> Neighbours<COLUMNS> {
    /// How many cells the columns reach.
    const REACH: i32 = (COLUMNS.isqrt() / 2) as i32;

    /// Sorts the points into cells of `edge` metres, for searches of up to that radius, or three times that with
    /// [`FAR`].
    pub fn new(points: &[SurfacePoint], edge: f32) -> Self {
        let cell_at = |i: u32| cell_of(points[i as usize].position.into(), edge).to_array();
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.par_sort_by_cached_key(|&i| cell_at(i));
        let mut places = vec![0; points.len()];
        order.iter().zip(0..).for_each(|(&i, place)| places[i as usize] = place);

        let (mut cells, mut starts) = (Vec::new(), Vec::new());
        let mut entries = Vec::with_capacity(points.len());
        for (&index, place) in order.iter().zip(0..) {
            let cell = cell_at(index);
            if cells.last() != Some(&cell) {
                cells.push(cell);
                starts.push(place);
            }
            let SurfacePoint { position, normal, .. } = points[index as usize];
            entries.push(Entry { position, index, normal, cell: cells.len() as u32 - 1 });
        }
        starts.push(points.len() as u32);
        // The first point in that cell or in one after it.
        let first = |cell: [i32; 3]| starts[cells.partition_point(|other| *other < cell)];
        let columns = Self::columns();
        let around = |&[x, y, z]: &[i32; 3]| {
            let column = |dx, dy, z| first([x + dx, y + dy, z]);
            columns.map(|[dx, dy]| [column(dx, dy, z - Self::REACH), column(dx, dy, z + Self::REACH + 1)])
        };
        let spans = cells.par_iter().map(around).collect();
        Self { edge, entries, spans, places }
    }

    /// Gives `found` the points within `radius` metres of point `i` on its surface, itself included: index and offset,
    /// metres.
    #[inline(always)]
    pub fn each(&self, i: usize, radius: f32, mut found: impl FnMut(usize, Vec3)) {
        let own = &self.entries[self.places[i] as usize];
        let (position, normal) = (Vec3::from(own.position), Vec3::from(own.normal));
        let columns = if radius <= self.edge { NEAR } else { COLUMNS };
        for &[start, end] in &self.spans[own.cell as usize][..columns] {
            for entry in &self.entries[start as usize..end as usize] {
                let offset = Vec3::from(entry.position) - position;
                let near = offset.length_squared() < radius * radius;
                if near
                    && offset.dot(normal).abs() < MAX_PLANE_DISTANCE * radius
                    && normal.dot(entry.normal.into()) > MIN_NORMAL_COSINE
                {
                    found(entry.index as usize, offset);
                }
            }
        }
    }

    /// What is known of every point, in their own order, by what is known of every entry.
    pub fn by_point<T: Copy + Send + Sync>(&self, by_entry: &[T]) -> Vec<T> {
        self.places.par_iter().map(|&place| by_entry[place as usize]).collect()
    }

    /// The points of a cell.
    pub fn cell(&self, cell: u32) -> &[Entry] {
        let first = self.entries.partition_point(|entry| entry.cell < cell);
        let end = self.entries.partition_point(|entry| entry.cell <= cell);
        &self.entries[first..end]
    }

    /// All points of the columns around a cell.
    pub fn around(&self, cell: u32) -> impl Iterator<Item = &Entry> {
        self.spans[cell as usize].iter().flat_map(|&[start, end]| &self.entries[start as usize..end as usize])
    }

    /// Where the columns are beside the one in the middle: those within one cell, then the others.
    fn columns() -> [[i32; 2]; COLUMNS] {
        let side = 2 * Self::REACH + 1;
        let mut columns = std::array::from_fn(|k| [k as i32 % side - Self::REACH, k as i32 / side - Self::REACH]);
        columns.sort_by_key(|[dx, dy]: &[i32; 2]| dx.abs().max(dy.abs()).max(1));
        columns
    }

    /// How many points the columns around any one cell hold at most.
    pub fn most(&self) -> u64 {
        let held = |spans: &[[u32; 2]; COLUMNS]| spans.iter().map(|[start, end]| u64::from(end - start)).sum();
        self.spans.iter().map(held).max().unwrap_or(0)
    }
}

/// The cell of a grid of some `edge` (metres) that a place lies in. What is too far from the origin to be counted is
/// taken to be as far as can be counted with room for sums and differences.
pub(crate) fn cell_of(position: Vec3, edge: f32) -> IVec3 {
    const FARTHEST: Vec3 = Vec3::splat(1e9);
    (position / edge).floor().clamp(-FARTHEST, FARTHEST).as_ivec3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{hash2, sobol2};

    fn found<const COLUMNS: usize>(neighbours: &Neighbours<COLUMNS>, i: usize, radius: f32) -> Vec<usize> {
        let mut found = Vec::new();
        neighbours.each(i, radius, |j, _| found.push(j));
        found
    }

    #[test]
    fn a_search_finds_what_looking_at_every_point_finds() {
        // Two walls and a floor, around the origin and thus in cells of either sign.
        let point = |i: u32| {
            let [a, b] = sobol2(i, 3).map(|v| 2.0 * v - 1.0);
            let (position, normal) = match hash2(i, 1) % 3 {
                0 => ([a, b, 0.0], [0.0, 0.0, 1.0]),
                1 => ([a, 0.0, b], [0.0, 1.0, 0.0]),
                _ => ([0.0, a, b], [1.0, 0.0, 0.0]),
            };
            SurfacePoint { position, triangle: 0, normal, index: i }
        };
        let points: Vec<SurfacePoint> = (0..3000).map(point).collect();
        let neighbours = Neighbours::<FAR>::new(&points, 0.1);
        let near = Neighbours::<NEAR>::new(&points, 0.1);
        for radius in [0.04, 0.1, 0.13, 0.2, 0.3] {
            for i in (0..points.len()).step_by(17) {
                let [p, n] = [points[i].position, points[i].normal].map(Vec3::from);
                let close = |j: &usize| {
                    let offset = Vec3::from(points[*j].position) - p;
                    let beside = offset.dot(n).abs() < MAX_PLANE_DISTANCE * radius;
                    offset.length_squared() < radius * radius
                        && beside
                        && n.dot(points[*j].normal.into()) > MIN_NORMAL_COSINE
                };
                let mut all = found(&neighbours, i, radius);
                let alike = found(&near, i, radius) == all;
                assert!(alike || radius > 0.1, "{i}, {radius} m");
                all.sort_unstable();
                assert_eq!(all, (0..points.len()).filter(close).collect::<Vec<_>>(), "{i}, {radius} m");
                assert!(all.contains(&i));
            }
        }
        assert!((100..3000).contains(&neighbours.most()));
        assert_eq!(Neighbours::<FAR>::new(&[], 0.1).most(), 0);
    }

    #[test]
    fn points_too_far_away_to_be_counted_are_points_even_so() {
        let point =
            |x: f32, z: f32| SurfacePoint { position: [x, 0.0, z], triangle: 0, normal: [0.0, 1.0, 0.0], index: 0 };
        let points = [point(0.0, 0.0), point(1e9, 1e9), point(-1e9, 1e9), point(1e9, -1e9), point(0.005, 0.0)];
        let neighbours = Neighbours::<FAR>::new(&points, 0.01);
        assert_eq!([0, 1, 2, 3].map(|i| found(&neighbours, i, 0.02)), [vec![0, 4], vec![1], vec![2], vec![3]]);
    }
}
