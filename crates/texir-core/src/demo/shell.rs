//! The shell of the flat: floors, ceilings, walls with their openings, door frames and windows.

use glam::{Vec2, Vec3};

use super::chart::{Chart, Faces, Frame, Look, Point, Rect, block};
use super::class;
use super::layout::{CEILING, Layout, Opening, WALL, heights};
use super::paint::Paint;
use super::palette::RoomPalette;

/// One wall of a room, seen from inside.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wall {
    /// Its left end on the floor, seen from inside.
    pub origin: Vec3,
    /// From left to right.
    pub right: Vec3,
    /// Into the room.
    pub inward: Vec3,
    pub length: f32,
}

impl Wall {
    /// The four walls of a room: west, east, south, north.
    pub fn of(rect: Rect) -> [Self; 4] {
        let (lo, hi, size) = (rect.lo, rect.hi, rect.size());
        let wall = |x: f32, y: f32, right: Vec3, length: f32| Self {
            origin: Vec3::new(x, y, 0.0),
            right,
            inward: right.cross(Vec3::Z),
            length,
        };
        [
            wall(lo.x, lo.y, Vec3::Y, size.y),
            wall(hi.x, hi.y, -Vec3::Y, size.y),
            wall(hi.x, lo.y, -Vec3::X, size.x),
            wall(lo.x, hi.y, Vec3::X, size.x),
        ]
    }

    /// Where along the wall the point is, metres from its left end.
    pub fn along(&self, p: Vec2) -> f32 {
        (p.extend(0.0) - self.origin).dot(self.right)
    }

    /// The rectangle that an opening cuts out of this wall; `None` if it is in another wall.
    pub fn cut(&self, opening: &Opening) -> Option<Rect> {
        let inside = opening.plan.centre().extend(0.0) - self.origin;
        let distance = -inside.dot(self.inward);
        let runs_along_y = self.right.x == 0.0;
        if runs_along_y != opening.across_x || !(0.0..=WALL).contains(&distance) {
            return None;
        }
        let (a, b) = (self.along(opening.plan.lo), self.along(opening.plan.hi));
        let cut = Rect::new(Vec2::new(a.min(b), opening.z.0), Vec2::new(a.max(b), opening.z.1));
        (cut.lo.x >= 0.0 && cut.hi.x <= self.length).then_some(cut)
    }
}

/// Builds the shell of the whole flat.
pub(super) fn build(out: &mut Vec<Chart>, layout: &Layout, palettes: &[RoomPalette]) {
    let lines = [layout.lines(0), layout.lines(1)];
    for (index, room) in layout.rooms.iter().enumerate() {
        let palette = &palettes[index];
        let look = |paint: Paint, class: u16| Look { paint, class, room: room.id };
        let size = room.rect().size();
        let xs = span(&lines[0], room.lo.x, room.hi.x);
        let ys = span(&lines[1], room.lo.y, room.hi.y);
        let floor = look(palette.floor, class::FLOOR);
        out.push(Chart::plane(floor, room.lo.extend(0.0), Vec3::X, Vec3::Y, xs.clone(), ys.clone()));
        let ceiling = look(palette.ceiling, class::CEILING);
        let corner = Vec3::new(room.lo.x, room.hi.y, CEILING);
        out.push(Chart::plane(ceiling, corner, Vec3::X, -Vec3::Y, xs.clone(), mirrored(&ys, size.y)));
        for (side, wall) in Wall::of(room.rect()).into_iter().enumerate() {
            let lines = if wall.right.x == 0.0 { &ys } else { &xs };
            let columns = if wall.right.min_element() < 0.0 { mirrored(lines, wall.length) } else { lines.clone() };
            let paint = look(if side == palette.accent_side { palette.accent_wall } else { palette.wall }, class::WALL);
            let mut chart = Chart::plane(paint, wall.origin, wall.right, Vec3::Z, columns, heights());
            let cuts = layout.openings.iter().filter(|o| o.touches(index)).filter_map(|o| wall.cut(o));
            chart.holes = cuts.collect();
            out.push(chart);
        }
    }
    for opening in &layout.openings {
        reveal(out, opening, layout, &lines, palettes);
        if opening.is_window() {
            window(out, opening, layout, palettes);
        }
    }
}

/// The lines between `from` and `to`, counted from `from`.
fn span(lines: &[f32], from: f32, to: f32) -> Vec<f32> {
    lines.iter().filter(|&&x| (from..=to).contains(&x)).map(|x| x - from).collect()
}

/// The same lines counted from the other end.
fn mirrored(lines: &[f32], length: f32) -> Vec<f32> {
    lines.iter().rev().map(|x| length - x).collect()
}

/// The sides of an opening within the thickness of its wall.
fn reveal(out: &mut Vec<Chart>, opening: &Opening, layout: &Layout, lines: &[Vec<f32>; 2], palettes: &[RoomPalette]) {
    let palette = &palettes[opening.rooms.0];
    let room = layout.rooms[opening.rooms.0].id;
    let class = if opening.is_window() { class::WINDOW } else { class::DOOR };
    let look = Look { paint: palette.trim, class, room };
    let (lo, hi, size) = (opening.plan.lo, opening.plan.hi, opening.plan.size());
    let (z0, z1) = opening.z;
    let (xs, ys) = (span(&lines[0], lo.x, hi.x), span(&lines[1], lo.y, hi.y));
    let zs = span(&heights(), z0, z1);
    let mut plane = |look: Look, origin: Vec3, right: Vec3, up: Vec3, columns: &[f32], rows: &[f32]| {
        out.push(Chart::plane(look, origin, right, up, columns.to_vec(), rows.to_vec()));
    };
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let sill = if opening.is_window() { look } else { Look { paint: palette.threshold, ..look } };
    plane(sill, lo.extend(z0), x, y, &xs, &ys);
    plane(look, Vec3::new(lo.x, hi.y, z1), x, -y, &xs, &mirrored(&ys, size.y));
    if opening.across_x {
        plane(look, Vec3::new(hi.x, lo.y, z0), -x, z, &mirrored(&xs, size.x), &zs);
        plane(look, Vec3::new(lo.x, hi.y, z0), x, z, &xs, &zs);
    } else {
        plane(look, lo.extend(z0), y, z, &ys, &zs);
        plane(look, hi.extend(z0), -y, z, &mirrored(&ys, size.y), &zs);
    }
    if opening.is_window() {
        let wall = outer_wall(opening, layout);
        let columns = if wall.right.x == 0.0 { &ys } else { &xs };
        let width = columns.last().copied().unwrap_or(0.0);
        let columns = if wall.right.min_element() < 0.0 { mirrored(columns, width) } else { columns.clone() };
        let pane = Look { paint: palette.sky, ..look };
        let cut = wall.cut(opening).unwrap_or(Rect::new(Vec2::ZERO, Vec2::ZERO));
        let origin = wall.origin + wall.right * cut.lo.x + Vec3::Z * z0 - wall.inward * WALL;
        plane(pane, origin, wall.right, z, &columns, &zs);
    }
}

/// The wall of its room that a window is in.
fn outer_wall(opening: &Opening, layout: &Layout) -> Wall {
    let walls = Wall::of(layout.rooms[opening.rooms.0].rect());
    walls.into_iter().find(|wall| wall.cut(opening).is_some()).unwrap_or(walls[0])
}

/// Frame bars in front of the pane, and short curtains beside the window.
fn window(out: &mut Vec<Chart>, opening: &Opening, layout: &Layout, palettes: &[RoomPalette]) {
    let wall = outer_wall(opening, layout);
    let Some(cut) = wall.cut(opening) else { return };
    let palette = &palettes[opening.rooms.0];
    let look = Look { paint: palette.trim, class: class::WINDOW, room: layout.rooms[opening.rooms.0].id };
    // Seen from inside, x runs to the left.
    let frame = Frame::facing(wall.origin + wall.right * cut.hi.x, wall.inward);
    let (width, (z0, z1)) = (cut.size().x, opening.z);
    let (back, front, bar) = (-WALL, 0.05 - WALL, 0.03);
    let mid = 0.5 * width;
    let upright = Faces::ALL.without(Faces::TOP).without(Faces::BOTTOM).without(Faces::BACK);
    let lying = Faces::ALL.without(Faces::LEFT).without(Faces::RIGHT).without(Faces::BACK);
    block(out, look, frame, Vec3::new(mid - bar, back, z0), Vec3::new(mid + bar, front, z1), upright);
    let z = z0 + 0.68 * (z1 - z0);
    block(out, look, frame, Vec3::new(0.0, back, z - bar), Vec3::new(mid - bar, front, z + bar), lying);
    block(out, look, frame, Vec3::new(mid + bar, back, z - bar), Vec3::new(width, front, z + bar), lying);

    let rod = Look { paint: Paint::flat(Vec3::splat(0.08), 0.3), class: class::CURTAIN, ..look };
    let top = z1 + 0.14;
    let ends = (Vec3::new(-0.42, 0.075, top), Vec3::new(width + 0.42, 0.095, top + 0.02));
    block(out, rod, frame, ends.0, ends.1, Faces::ALL);
    let cloth = Look { paint: palette.curtain, ..rod };
    for left in [-0.38, width + 0.03] {
        curtain(out, cloth, frame.moved(Vec3::new(left, 0.085, z0 - 0.12)), 0.35, top - z0 + 0.115);
    }
}

/// A hanging cloth with folds, `width` along the frame's x: front, back and the strips between them.
fn curtain(out: &mut Vec<Chart>, look: Look, frame: Frame, width: f32, height: f32) {
    const STEPS: usize = 28;
    const HALF: f32 = 0.008;
    let fold = |s: f32| 0.035 * (s / width * std::f32::consts::TAU * 3.5).sin();
    let slope = |s: f32| 0.035 * (s / width * std::f32::consts::TAU * 3.5).cos() * std::f32::consts::TAU * 3.5 / width;
    let columns: Vec<f32> = (0..=STEPS).map(|i| width * i as f32 / STEPS as f32).collect();
    let rows: Vec<f32> = (0..=3).map(|i| height * i as f32 / 3.0).collect();
    let at = |x: f32, y: f32, z: f32| frame.point(Vec3::new(x, y, z));
    // The back is seen with x to the right, the front with x to the left.
    for side in [-1.0, 1.0] {
        let x = move |s: f32| if side < 0.0 { s } else { width - s };
        out.push(Chart::new(look, columns.clone(), rows.clone(), |s, t| Point {
            position: at(x(s), fold(x(s)) + side * HALF, t),
            normal: frame.vector(Vec3::new(-slope(x(s)), 1.0, 0.0).normalize() * side),
        }));
    }
    for (z, side) in [(height, 1.0), (0.0, -1.0)] {
        out.push(Chart::new(look, columns.clone(), vec![0.0, 2.0 * HALF], |s, t| Point {
            position: at(s, fold(s) + side * (t - HALF), z),
            normal: Vec3::Z * side,
        }));
    }
    for (x, side) in [(0.0, -1.0), (width, 1.0)] {
        out.push(Chart::new(look, vec![0.0, 2.0 * HALF], rows.clone(), |s, t| Point {
            position: at(x, fold(x) + side * (s - HALF), t),
            normal: frame.x * side,
        }));
    }
}
