//! Rooms from the mesh: a floor plan in which every point belongs to a room, and a doorway separates.
//!
//! The mesh is rasterised into vertical columns (`columns.rs`). A wall fills its column from sitting to head height and
//! up to the ceiling; furniture fills neither, so it does not split a room; a lintel fills only the part under the
//! ceiling. What is covered by a floor or a ceiling and not walled is free space, and free space is cut into rooms at
//! lintels no wider than a door and where it narrows to a doorway (`segment.rs`). Every storey that cameras stand in
//! (`storeys.rs`) has a plan of its own; what lies under its floor or above its highest ceiling is left out.

mod columns;
mod distance;
mod picture;
mod plan;
mod segment;
mod storeys;
#[cfg(test)]
mod tests;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::raster::{Labels, Mask};
use columns::{Columns, grid_over};
pub use plan::{FloorPlan, Grid, StoreyPlan};

/// How rooms are found. Lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RoomOptions {
    /// Edge of a floor-plan cell.
    pub cell: f32,
    /// Direction away from the floor, in world space.
    pub up: [f32; 3],
    /// The widest opening that separates two rooms.
    pub door_width: f32,
    /// Without a lintel, an opening separates only if it is this much narrower than the smaller of its two rooms.
    pub constriction: f32,
    /// Anything smaller (m²) is part of the room it opens to.
    pub min_area: f32,
}

impl Default for RoomOptions {
    fn default() -> Self {
        Self { cell: 0.05, up: [0.0, 0.0, 1.0], door_width: 1.9, constriction: 0.8, min_area: 1.0 }
    }
}

impl RoomOptions {
    /// Errors on settings with which no plan can be made.
    fn check(&self) -> Result<()> {
        let positive = [("cell", self.cell), ("door_width", self.door_width), ("constriction", self.constriction)];
        for (name, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::invalid(format!("RoomOptions::{name} is {value}; expected a number above 0")));
            }
        }
        if self.min_area < 0.0 || self.min_area.is_nan() {
            return Err(Error::invalid(format!("RoomOptions::min_area is {}; expected 0 or more (m²)", self.min_area)));
        }
        if !(Vec3::from(self.up).length() > 1e-6 && Vec3::from(self.up).is_finite()) {
            return Err(Error::invalid(format!(
                "RoomOptions::up is {:?}; expected a direction, such as [0, 0, 1]",
                self.up
            )));
        }
        Ok(())
    }
}

/// Triangles steeper than this (|cos| of the tilt) are walls, flatter ones floors, ceilings and table tops.
const HORIZONTAL: f32 = 0.7;
/// Lower and upper end, above the floor, of the part of a column that a wall fills and a table does not.
const BODY: (f32, f32) = (0.3, 1.9);
/// Lower and upper end, below the ceiling, of the part that walls and lintels fill and doors and wardrobes do not.
const HEAD: (f32, f32) = (0.3, 0.05);
/// Ceilings are higher than this above the floor.
const HEAD_ROOM: f32 = 1.9;
/// The share of either part that must be filled: scans are frayed, and a wall may lie astride two cells.
const FILLED: f32 = 0.4;
/// A free-standing piece of wall up to this long, metres, is a pillar or a wardrobe.
const PILLAR: f32 = 0.8;
/// Where a lintel meets walls, it does so over at least this share of its length.
const SPAN: f32 = 0.7;
/// Holes in both floor and ceiling up to this area (m²) are holes of the scan.
const HOLE_AREA: f32 = 1.0;
/// Cells under a lintel, and free scraps, join a room no further away than this, metres.
const REACH: f32 = 0.3;

/// Finds the rooms of a mesh. `cameras` are positions known to lie inside rooms: they tell storeys apart and floor from
/// ceiling (without them, half the mesh's height does) and are free space even where the scan has holes. Errors where
/// there is no room, and on options or a mesh that no plan can be made with.
pub fn detect(mesh: &Mesh, cameras: &[Vec3], options: &RoomOptions) -> Result<FloorPlan> {
    options.check()?;
    let up = Vec3::from(options.up);
    let rotation = plan::plan_from_world(up);
    let cameras: Vec<Vec3> = cameras.iter().filter(|c| c.is_finite()).map(|&c| rotation * c).collect();
    let triangles = (0..mesh.triangles.len() as u32).map(|t| mesh.corners(t).map(|p| rotation * p));
    let grid = grid_over(triangles.clone(), options.cell)?;
    let mut plans: Vec<StoreyPlan> = Vec::new();
    let (mut count, mut top_below) = (0, None);
    for storey in storeys::find(triangles.clone(), &cameras) {
        let columns = Columns::new(triangles.clone(), grid, storey);
        let (mut rooms, walls) = rooms_of(&columns, &cameras, options);
        let found = rooms.data.iter().copied().max().unwrap_or(0);
        if found > u16::MAX - count {
            return Err(Error::invalid(format!(
                "more than {} rooms of at least {} m² were found; expected a building of fewer: is the mesh in metres?",
                u16::MAX,
                options.min_area
            )));
        }
        rooms.data.iter_mut().filter(|id| **id != 0).for_each(|id| *id += count);
        count += found;
        // The slab between two storeys is cut in its middle.
        let from = top_below.map_or(f32::NEG_INFINITY, |top: f32| 0.5 * (top + storey.floor));
        top_below = Some(storey.top);
        if found > 0 {
            plans.push(StoreyPlan::new(rooms, walls, from)?);
        }
    }
    if plans.is_empty() {
        return Err(Error::invalid(format!(
            "no room was found: no free floor of {} m² between walls; expected a mesh in metres in which {:?} points \
             up. `texir import` scales and turns a capture",
            options.min_area, options.up
        )));
    }
    FloorPlan::new(grid, plans, up)
}

/// The rooms of a storey, from 1, and the cells with walls.
fn rooms_of(columns: &Columns, cameras: &[Vec3], options: &RoomOptions) -> (Labels, Mask) {
    let (walls, lintels) = obstacles(columns, options);
    let free = free_space(columns, &walls, &lintels, cameras);
    let mut rooms = segment::rooms(&free, options.cell, options);
    fill_passages(&mut rooms, &free, &lintels, options.cell);
    (rooms, walls)
}

/// Cells with walls, and cells with lintels short enough to be a door's.
fn obstacles(columns: &Columns, options: &RoomOptions) -> (Mask, Mask) {
    let (w, h) = (columns.grid.width, columns.grid.height);
    let known =
        Mask { width: w, height: h, data: (0..w * h).map(|c| columns.ceiling(c, HEAD_ROOM).is_some()).collect() };
    // Where the scan's ceiling has a hole, the nearest known height serves; where it has none at all, the mesh's top.
    let nearest_ceiling = distance::nearest(&known);
    let mut walls = Mask::filled(w, h, false);
    let mut lintels = walls.clone();
    for c in 0..w * h {
        let source = nearest_ceiling.as_ref().map_or(c, |n| n[c] as usize);
        let ceiling = columns.ceiling(source, HEAD_ROOM).unwrap_or(columns.storey.top);
        if columns.share(c, ceiling - HEAD.0, ceiling - HEAD.1) >= FILLED {
            let wall = columns.share(c, columns.storey.floor + BODY.0, columns.storey.floor + BODY.1) >= FILLED;
            walls.data[c] = wall;
            lintels.data[c] = !wall;
        }
    }
    // A pillar stands in a room.
    for part in segment::components(&walls) {
        if extent(part.iter().copied(), w) * options.cell <= PILLAR {
            part.iter().for_each(|&c| walls.data[c] = false);
        }
    }
    // A lintel spans from wall to wall; a lamp that hangs from the ceiling does not. A beam across a room, or a row of
    // hanging cupboards, is longer than a door is wide.
    for part in segment::components(&lintels) {
        let length = extent(part.iter().copied(), w);
        let at_walls = |&c: &usize| segment::neighbours8(c, w, h).any(|n| walls.data[n]);
        let spans = extent(part.iter().copied().filter(at_walls), w) >= SPAN * length;
        if !spans || length * options.cell > options.door_width + 2.0 * options.cell {
            part.iter().for_each(|&c| lintels.data[c] = false);
        }
    }
    (walls, lintels)
}

/// Diagonal of the bounds of some cells of a plan `width` cells wide, in cells.
fn extent(cells: impl Iterator<Item = usize>, width: usize) -> f32 {
    let bounds = cells.map(|c| (c % width, c / width)).fold(None, |bounds, (x, y)| {
        let (x0, y0, x1, y1) = bounds.unwrap_or((x, y, x, y));
        Some((x0.min(x), y0.min(y), x1.max(x), y1.max(y)))
    });
    bounds.map_or(0.0, |(x0, y0, x1, y1)| ((x1 - x0 + 1) as f32).hypot((y1 - y0 + 1) as f32))
}

/// Cells in which one can stand: under a ceiling or on a floor, and neither wall nor lintel.
fn free_space(columns: &Columns, walls: &Mask, lintels: &Mask, cameras: &[Vec3]) -> Mask {
    let [w, h] = walls.size();
    let obstacle = |c: usize| walls.data[c] || lintels.data[c];
    let open = Mask { width: w, height: h, data: (0..w * h).map(|c| !obstacle(c)).collect() };
    let mut free = Mask { width: w, height: h, data: (0..w * h).map(|c| open.data[c] && columns.covered(c)).collect() };
    let here = |c: &&Vec3| (columns.storey.floor..columns.storey.top).contains(&c.z);
    for camera in cameras.iter().filter(here) {
        let c = columns.grid.cell_of(camera.truncate());
        free.data[c] = open.data[c];
    }
    let uncovered = Mask { width: w, height: h, data: (0..w * h).map(|c| open.data[c] && !free.data[c]).collect() };
    for hole in segment::components(&uncovered) {
        if hole.len() as f32 * columns.grid.cell.powi(2) > HOLE_AREA {
            continue;
        }
        // The hollow of a wall is small as well, but walls surround it.
        let border = hole.iter().flat_map(|&c| segment::neighbours4(c, w, h)).filter(|&n| !uncovered.data[n]);
        let (inside, all) = border.fold((0, 0), |(inside, all), n| (inside + usize::from(free.data[n]), all + 1));
        if 2 * inside > all {
            hole.iter().for_each(|&c| free.data[c] = true);
        }
    }
    free
}

/// Gives the cells under lintels, and scraps of free space between them, to the nearest room within reach.
fn fill_passages(rooms: &mut Labels, free: &Mask, lintels: &Mask, cell: f32) {
    let Some(sources) = distance::nearest(&rooms.map(|&id| id != 0)) else { return };
    for (c, &source) in sources.iter().enumerate() {
        let near = distance::between(rooms.width, c, source as usize) * cell <= REACH;
        if rooms.data[c] == 0 && (free.data[c] || lintels.data[c]) && near {
            rooms.data[c] = rooms.data[source as usize];
        }
    }
}
