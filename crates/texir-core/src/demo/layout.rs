//! The floor plan: rooms, doorways and windows, from a seed. Everything lies on a grid of 1/16 m, so that coordinates
//! are exact in `f32` and neighbouring surfaces share their edges bit for bit.

use glam::Vec2;

use super::chart::Rect;
use super::random::Random;

/// The grid of the plan, metres.
const GRID: f32 = 1.0 / 16.0;
/// Thickness of walls, metres.
pub(super) const WALL: f32 = 0.125;
/// Height of rooms, metres.
pub(super) const CEILING: f32 = 2.625;
/// Height of doorways, metres.
pub(super) const DOOR_HEAD: f32 = 2.0625;
/// Lower and upper edge of windows, metres.
pub(super) const WINDOW: (f32, f32) = (0.9375, 2.25);

/// What a room is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoomKind {
    /// Sofa, shelf, screen, rug.
    Living,
    /// Bed, wardrobe.
    Bedroom,
    /// Counter, dining table.
    Kitchen,
    /// Desk, shelf.
    Study,
}

/// A rectangular room.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Room id, from 1.
    pub id: u16,
    /// What it is for.
    pub kind: RoomKind,
    /// Corner of least x and y, metres.
    pub lo: Vec2,
    /// Corner of greatest x and y, metres.
    pub hi: Vec2,
}

impl Room {
    /// The floor's area in plan.
    pub(super) fn rect(&self) -> Rect {
        Rect::new(self.lo, self.hi)
    }
}

/// A hole through a wall: its rectangle in plan spans the thickness of the wall.
#[derive(Clone, Copy, Debug)]
pub(super) struct Opening {
    pub plan: Rect,
    /// Lower and upper edge, metres.
    pub z: (f32, f32),
    /// The room it belongs to, and the one on its other side (none for a window).
    pub rooms: (usize, Option<usize>),
    /// Whether the wall runs along y (the opening is passed along x).
    pub across_x: bool,
}

impl Opening {
    /// Whether it is a window.
    pub fn is_window(&self) -> bool {
        self.rooms.1.is_none()
    }

    /// Whether one of its sides is the given room.
    pub fn touches(&self, room: usize) -> bool {
        self.rooms.0 == room || self.rooms.1 == Some(room)
    }
}

/// Rooms and openings.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub rooms: Vec<Room>,
    pub openings: Vec<Opening>,
}

/// Fewest and most rooms that a layout can have.
pub(super) const ROOMS: std::ops::RangeInclusive<usize> = 3..=5;

impl Layout {
    /// Two columns of rooms of random sizes, joined by doorways; a window or two in every room.
    pub fn random(rooms: usize, random: &mut Random) -> Self {
        use RoomKind::{Bedroom, Kitchen, Living, Study};
        let (left, right): (&[_], &[_]) = match rooms {
            ..=3 => (&[Living], &[Bedroom, Kitchen]),
            4 => (&[Living, Study], &[Bedroom, Kitchen]),
            _ => (&[Living, Study], &[Bedroom, Kitchen, Bedroom]),
        };
        let (left_width, right_width) = (snap(random.range(4.4, 5.2)), snap(random.range(3.3, 3.9)));
        let depth = snap(random.range(2.9, 3.2) * left.len().max(right.len()) as f32);
        let mut plan = Self { rooms: Vec::new(), openings: Vec::new() };
        plan.column((0.0, left_width), depth, left, random);
        plan.column((left_width + WALL, left_width + WALL + right_width), depth, right, random);
        plan.doors(left.len(), random);
        plan.windows(left.len(), random);
        plan
    }

    fn column(&mut self, (x0, x1): (f32, f32), depth: f32, kinds: &[RoomKind], random: &mut Random) {
        let weights: Vec<f32> = kinds
            .iter()
            .map(|kind| random.range(0.95, 1.1) * if *kind == RoomKind::Living { 1.35 } else { 1.0 })
            .collect();
        let total: f32 = weights.iter().sum();
        let mut from = 0.0;
        let mut passed = 0.0;
        for (i, (&kind, weight)) in kinds.iter().zip(&weights).enumerate() {
            passed += weight;
            let to = if i + 1 == kinds.len() { depth } else { snap(depth * passed / total) };
            let id = self.rooms.len() as u16 + 1;
            self.rooms.push(Room { id, kind, lo: Vec2::new(x0, from), hi: Vec2::new(x1, to) });
            from = to + WALL;
        }
    }

    /// Doorways between the columns wherever rooms share enough wall, and within a column of several rooms.
    fn doors(&mut self, left: usize, random: &mut Random) {
        for b in left..self.rooms.len() {
            let shared = |a: usize| {
                let (p, q) = (&self.rooms[a], &self.rooms[b]);
                (p.lo.y.max(q.lo.y), p.hi.y.min(q.hi.y))
            };
            let widest = (0..left).map(shared).enumerate().max_by(|x, y| (x.1.1 - x.1.0).total_cmp(&(y.1.1 - y.1.0)));
            if let Some((a, (from, to))) = widest {
                let wide = self.rooms[b].kind == RoomKind::Kitchen;
                let width = if wide { 1.4375 } else { 0.9375 };
                let x = self.rooms[a].hi.x;
                let y = snap(random.range(from + 0.5, to - 0.5 - width));
                let plan = Rect::new(Vec2::new(x, y), Vec2::new(x + WALL, y + width));
                self.openings.push(Opening { plan, z: (0.0, DOOR_HEAD), rooms: (a, Some(b)), across_x: true });
            }
        }
        let within: Vec<usize> = (1..self.rooms.len()).filter(|&b| b != left).take(1.max(left - 1)).collect();
        for b in within {
            let (p, width) = (self.rooms[b - 1], 0.875);
            let x = snap(random.range(p.lo.x + 0.4, p.lo.x + 0.9));
            let plan = Rect::new(Vec2::new(x, p.hi.y), Vec2::new(x + width, p.hi.y + WALL));
            self.openings.push(Opening { plan, z: (0.0, DOOR_HEAD), rooms: (b - 1, Some(b)), across_x: false });
        }
    }

    /// A window in the outer long wall of every room, and in the short one where it is outer.
    fn windows(&mut self, left: usize, random: &mut Random) {
        let depth = self.rooms.iter().map(|room| room.hi.y).fold(0.0, f32::max);
        for (index, room) in self.rooms.clone().into_iter().enumerate() {
            let is_left = index < left;
            let x = if is_left { room.lo.x - WALL } else { room.hi.x };
            let mut window = |plan: Rect, across_x: bool| {
                self.openings.push(Opening { plan, z: WINDOW, rooms: (index, None), across_x });
            };
            let span = (room.hi.y - room.lo.y).min(6.0);
            let width = snap(random.range(0.34, 0.42) * span);
            let y = snap(room.lo.y + (span - width) * random.range(0.35, 0.65));
            window(Rect::new(Vec2::new(x, y), Vec2::new(x + WALL, y + width)), true);
            if is_left && (room.lo.y == 0.0 || room.hi.y == depth) {
                let y = if room.lo.y == 0.0 { -WALL } else { depth };
                let width = snap(random.range(1.2, 1.6));
                let x = snap(room.lo.x + (room.hi.x - room.lo.x - width) * random.range(0.35, 0.6));
                window(Rect::new(Vec2::new(x, y), Vec2::new(x + width, y + WALL)), false);
            }
        }
    }

    /// The lines along an axis (0: x, 1: y) at which surfaces of the shell are cut: room and opening edges of the whole
    /// flat, and more wherever two are far apart. All surfaces share them, so that no edge meets another's middle.
    pub fn lines(&self, axis: usize) -> Vec<f32> {
        let rects = self.rooms.iter().map(Room::rect).chain(self.openings.iter().map(|opening| opening.plan));
        let edges = rects.flat_map(|rect| [rect.lo[axis], rect.hi[axis]]);
        subdivide(edges.collect())
    }
}

/// The heights at which walls are cut.
pub(super) fn heights() -> Vec<f32> {
    subdivide(vec![0.0, WINDOW.0, DOOR_HEAD, WINDOW.1, CEILING])
}

/// Sorted, without repetitions, and with lines on the grid put in where two are over 0.75 m apart.
fn subdivide(mut lines: Vec<f32>) -> Vec<f32> {
    lines.sort_by(f32::total_cmp);
    lines.dedup();
    let mut all = Vec::new();
    for pair in lines.windows(2) {
        let parts = ((pair[1] - pair[0]) / 0.75).ceil().max(1.0);
        all.extend((0..parts as usize).map(|i| pair[0] + snap((pair[1] - pair[0]) * i as f32 / parts)));
    }
    all.extend(lines.last());
    all
}

/// The nearest point of the grid.
fn snap(x: f32) -> f32 {
    (x / GRID).round() * GRID
}
