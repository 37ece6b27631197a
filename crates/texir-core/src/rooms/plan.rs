//! The floor plan: which room a point of the world lies in.

use std::path::Path;

use glam::{Mat3, Vec2, Vec3};

use super::{distance, picture};
use crate::error::{Error, Result};
use crate::raster::{Labels, Mask, times};

/// The cells of a floor plan, alike for all storeys. Plan coordinates: x and y in the floor's plane, z up, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Cells along x.
    pub width: usize,
    /// Cells along y; row j holds plan coordinates from `origin.y + j·cell`.
    pub height: usize,
    /// Plan coordinates of the outer corner of cell (0, 0), metres.
    pub origin: Vec2,
    /// Edge of a cell, metres.
    pub cell: f32,
}

impl Grid {
    /// The cell under a point in plan coordinates, clamped to the plan: row · width + column.
    pub fn cell_of(&self, p: Vec2) -> usize {
        let g = ((p - self.origin) / self.cell).floor();
        let (x, y) = (g.x.max(0.0) as usize, g.y.max(0.0) as usize);
        y.min(self.height - 1) * self.width + x.min(self.width - 1)
    }
}

/// One storey of a floor plan.
#[derive(Clone, Debug, PartialEq)]
pub struct StoreyPlan {
    /// Room id per cell, from 1; 0 for walls and the outside.
    pub rooms: Labels,
    /// Cells that hold a wall.
    pub walls: Mask,
    /// Height from which on points belong to this storey or one above, metres above the world's origin. Points under
    /// the lowest storey belong to it as well.
    pub from: f32,
    /// Per cell, the id of the nearest room.
    nearest: Labels,
}

impl StoreyPlan {
    /// A storey of given ids, such as a room map that came with the capture. Errors where there is no room, or on
    /// `walls` of another size.
    pub fn new(rooms: Labels, walls: Mask, from: f32) -> Result<Self> {
        if rooms.size() != walls.size() {
            return Err(Error::invalid(format!("{:?} room ids, but {:?} wall flags", rooms.size(), walls.size())));
        }
        let sources = distance::nearest(&rooms.map(|&id| id != 0))
            .ok_or_else(|| Error::invalid("no room was found: the floor plan has no cell with a room id"))?;
        let data = sources.iter().map(|&cell| rooms.data[cell as usize]).collect();
        let nearest = Labels::new(rooms.width, rooms.height, data)?;
        Ok(Self { rooms, walls, from, nearest })
    }
}

/// A floor plan: room ids on a grid in the plane perpendicular to the up direction, storey by storey.
#[derive(Clone, Debug, PartialEq)]
pub struct FloorPlan {
    /// The cells of every storey.
    pub grid: Grid,
    /// The storeys, the lowest first; at least one. No two share a room id.
    pub storeys: Vec<StoreyPlan>,
    /// Rows: plan x, plan y and up, in world space. With +Z up, plan x and y are the world's.
    plan_from_world: Mat3,
}

impl FloorPlan {
    /// A plan of given storeys, sorted by height. Errors without a storey, or on one of another size than the grid.
    pub fn new(grid: Grid, mut storeys: Vec<StoreyPlan>, up: Vec3) -> Result<Self> {
        if storeys.is_empty() {
            return Err(Error::invalid("a floor plan has no storey; expected at least one"));
        }
        if let Some(storey) = storeys.iter().find(|s| s.rooms.size() != [grid.width, grid.height]) {
            let size = storey.rooms.size();
            return Err(Error::invalid(format!("a storey of {} cells, but a grid of {grid:?}", times(size))));
        }
        storeys.sort_by(|a, b| a.from.total_cmp(&b.from));
        Ok(Self { grid, storeys, plan_from_world: plan_from_world(up) })
    }

    /// Number of rooms of all storeys; ids go from 1 to this.
    pub fn count(&self) -> usize {
        self.storeys.iter().flat_map(|s| &s.rooms.data).copied().max().unwrap_or(0).into()
    }

    /// Plan coordinates of a world point.
    pub fn plan(&self, point: Vec3) -> Vec3 {
        self.plan_from_world * point
    }

    /// Index of the storey at a world point.
    pub fn storey_at(&self, point: Vec3) -> usize {
        let height = self.plan(point).z;
        self.storeys.iter().rposition(|s| s.from <= height).unwrap_or(0)
    }

    /// The room at a world point in free space, or the nearest one of its storey; never 0.
    pub fn room_at(&self, point: Vec3) -> u16 {
        self.storeys[self.storey_at(point)].nearest.data[self.grid.cell_of(self.plan(point).truncate())]
    }

    /// The room that a surface faces: the one in front of `point` along its `normal`, so that the two sides of a wall
    /// belong to two rooms. Never 0.
    pub fn room_of(&self, point: Vec3, normal: Vec3) -> u16 {
        self.room_at(point + normal.normalize_or_zero() * (1.5 * self.grid.cell))
    }

    /// Writes the plan as a picture: rooms in distinct colours with their ids, walls dark, cameras as dots; plan y up,
    /// the lowest storey on the left.
    pub fn write_png(&self, path: &Path, cameras: &[Vec3]) -> Result<()> {
        picture::write(self, path, cameras)
    }
}

/// The rotation whose rows are plan x, plan y and up.
pub(super) fn plan_from_world(up: Vec3) -> Mat3 {
    let up = up.normalize_or(Vec3::Z);
    let forward = if up.x.abs() < 0.9 { Vec3::X } else { Vec3::Y };
    let x = forward.reject_from_normalized(up).normalize_or(Vec3::X);
    Mat3::from_cols(x, up.cross(x), up).transpose()
}
