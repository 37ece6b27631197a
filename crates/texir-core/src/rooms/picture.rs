//! The floor plan as a picture.

use std::collections::BTreeSet;
use std::path::Path;

use glam::{Vec2, Vec3};

use super::{FloorPlan, Grid};
use crate::error::Result;
use crate::image_io::write_png_rgb;
use crate::raster::{Labels, Raster};

/// The longer side of the picture, pixels, at least where the plan has fewer cells.
const SIZE: usize = 1200;
const OUTSIDE: [u8; 3] = [250, 250, 250];
const WALL: [u8; 3] = [52, 54, 60];
const INK: [u8; 3] = [30, 32, 38];
const CAMERA: [u8; 3] = [214, 40, 40];
/// 3×5 digits, one row of pixels per octal digit, top row first.
const DIGITS: [u16; 10] = [0o75557, 0o26227, 0o71747, 0o71717, 0o55711, 0o74717, 0o74757, 0o71111, 0o75757, 0o75717];

/// Writes the plan; plan y points up, the lowest storey is on the left.
pub(super) fn write(plan: &FloorPlan, path: &Path, cameras: &[Vec3]) -> Result<()> {
    write_png_rgb(path, &draw(plan, cameras))
}

fn draw(plan: &FloorPlan, cameras: &[Vec3]) -> Raster<[u8; 3]> {
    let Grid { width: w, height: h, origin, cell } = plan.grid;
    let scale = (SIZE / (w * plan.storeys.len()).max(h)).max(1);
    let (width, height) = (w * plan.storeys.len() * scale, h * scale);
    let colour_at = |i: usize| {
        let (cx, cy) = (i % width / scale, h - 1 - i / width / scale);
        let storey = &plan.storeys[cx / w];
        match *storey.rooms.at(cx % w, cy) {
            _ if *storey.walls.at(cx % w, cy) => WALL,
            0 => OUTSIDE,
            id => colour(id),
        }
    };
    let mut canvas = Raster { width, height, data: (0..width * height).map(colour_at).collect() };
    // Cells of a storey to picture, y up.
    let place = |storey: usize, p: Vec2| Vec2::new((storey * w) as f32 + p.x, h as f32 - p.y) * scale as f32;
    let radius = (0.08 / cell * scale as f32).max(2.0);
    for &camera in cameras.iter().filter(|c| c.is_finite()) {
        let at = (plan.plan(camera).truncate() - origin) / cell;
        disc(&mut canvas, place(plan.storey_at(camera), at), radius);
    }
    let dot = (0.06 / cell * scale as f32).max(2.0);
    for (k, storey) in plan.storeys.iter().enumerate() {
        let ids: BTreeSet<u16> = storey.rooms.data.iter().copied().filter(|&id| id != 0).collect();
        for id in ids {
            if let Some(anchor) = anchor(&storey.rooms, id) {
                number(&mut canvas, id, place(k, anchor), dot.round());
            }
        }
    }
    canvas
}

/// A light colour, distinct for neighbouring ids: hues in steps of the golden angle.
fn colour(id: u16) -> [u8; 3] {
    let hue = (f32::from(id) * 0.618_034).fract() * 6.0;
    [5.0, 3.0, 1.0].map(|offset: f32| {
        let k = (offset + hue).rem_euclid(6.0);
        (238.0 - 88.0 * k.min(4.0 - k).clamp(0.0, 1.0)) as u8
    })
}

/// Where a room's number fits best, in cells: its cell that is furthest from any other room or wall.
fn anchor(rooms: &Labels, id: u16) -> Option<Vec2> {
    let w = rooms.width;
    let other = super::distance::nearest(&rooms.map(|&other| other != id))?;
    (0..rooms.data.len())
        .filter(|&c| rooms.data[c] == id)
        .map(|c| (c, super::distance::between(w, c, other[c] as usize)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(c, _)| Vec2::new((c % w) as f32 + 0.5, (c / w) as f32 + 0.5))
}

fn disc(canvas: &mut Raster<[u8; 3]>, centre: Vec2, radius: f32) {
    fill(canvas, centre - radius, centre + radius, CAMERA, |p| p.distance(centre) <= radius);
}

/// Draws a number in `dot`-sized squares, centred.
fn number(canvas: &mut Raster<[u8; 3]>, value: u16, centre: Vec2, dot: f32) {
    let text = value.to_string();
    let corner = centre - Vec2::new(4.0 * text.len() as f32 - 1.0, 5.0) * dot / 2.0;
    for (i, digit) in text.bytes().enumerate() {
        let rows = DIGITS[usize::from(digit - b'0')];
        for (row, column) in (0..5).flat_map(|row| (0..3).map(move |column| (row, column))) {
            if rows >> (3 * (4 - row) + 2 - column) & 1 == 1 {
                let from = corner + Vec2::new((4 * i + column) as f32, row as f32) * dot;
                fill(canvas, from, from + dot, INK, |_| true);
            }
        }
    }
}

/// Colours the pixels of a rectangle whose centres satisfy `inside`.
fn fill(canvas: &mut Raster<[u8; 3]>, from: Vec2, to: Vec2, colour: [u8; 3], inside: impl Fn(Vec2) -> bool) {
    let [width, height] = canvas.size();
    for y in (from.y.max(0.0) as usize)..(to.y.ceil().max(0.0) as usize).min(height) {
        for x in (from.x.max(0.0) as usize)..(to.x.ceil().max(0.0) as usize).min(width) {
            if inside(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)) {
                canvas.data[y * width + x] = colour;
            }
        }
    }
}
