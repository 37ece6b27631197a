//! Charts: the rectangular pieces of surface that the flat is built of, and the shapes made of them.
//!
//! A chart is a grid of quadrilaterals. Its own coordinates `(s, t)` are metres along the surface, `s` to the right and
//! `t` up as seen from the front; the front is where ∂s × ∂t points.

use glam::{Vec2, Vec3};

use super::paint::Paint;

/// What covers a surface, and what it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// Material and emission.
    pub paint: Paint,
    /// Semantic class, see [`super::class`].
    pub class: u16,
    /// Room id, from 1.
    pub room: u16,
}

/// A rectangle in chart coordinates, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rect {
    pub lo: Vec2,
    pub hi: Vec2,
}

impl Rect {
    pub fn new(lo: Vec2, hi: Vec2) -> Self {
        Self { lo, hi }
    }

    pub fn contains(&self, p: Vec2) -> bool {
        p.cmpge(self.lo).all() && p.cmple(self.hi).all()
    }

    pub fn overlaps(&self, other: &Rect) -> bool {
        self.lo.cmplt(other.hi).all() && other.lo.cmplt(self.hi).all()
    }

    pub fn grown(&self, by: f32) -> Self {
        Self { lo: self.lo - by, hi: self.hi + by }
    }

    pub fn centre(&self) -> Vec2 {
        (self.lo + self.hi) * 0.5
    }

    pub fn size(&self) -> Vec2 {
        self.hi - self.lo
    }
}

/// A right-handed frame with z up: `x` × `y` = +Z.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub origin: Vec3,
    pub x: Vec3,
    pub y: Vec3,
}

impl Frame {
    /// The frame at `origin` whose y axis points along `y` (horizontal, unit).
    pub fn facing(origin: Vec3, y: Vec3) -> Self {
        Self { origin, x: Vec3::new(y.y, -y.x, 0.0), y }
    }

    /// The frame at `origin`, turned by `angle` radians about +Z.
    pub fn turned(origin: Vec3, angle: f32) -> Self {
        Self::facing(origin, Vec3::new(-angle.sin(), angle.cos(), 0.0))
    }

    /// World position of local `p`.
    pub fn point(&self, p: Vec3) -> Vec3 {
        self.origin + self.vector(p)
    }

    /// World direction of local `d`.
    pub fn vector(&self, d: Vec3) -> Vec3 {
        self.x * d.x + self.y * d.y + Vec3::Z * d.z
    }

    /// The same orientation with its origin at local `p`.
    pub fn moved(&self, p: Vec3) -> Self {
        Self { origin: self.point(p), ..*self }
    }
}

/// A point of a surface: position and unit shading normal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub position: Vec3,
    pub normal: Vec3,
}

/// A grid of quadrilaterals with its look.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    /// Grid lines along `s`, ascending from 0, metres.
    pub columns: Vec<f32>,
    /// Grid lines along `t`, ascending from 0, metres.
    pub rows: Vec<f32>,
    /// Grid points, row by row: `rows.len() · columns.len()`.
    pub points: Vec<Point>,
    /// Cells that are left out, in chart coordinates.
    pub holes: Vec<Rect>,
    pub look: Look,
}

impl Chart {
    /// The chart whose point at `(s, t)` is `surface(s, t)`.
    pub fn new(look: Look, columns: Vec<f32>, rows: Vec<f32>, surface: impl Fn(f32, f32) -> Point) -> Self {
        let points =
            rows.iter().flat_map(|&t| columns.iter().map(move |&s| (s, t))).map(|(s, t)| surface(s, t)).collect();
        Self { columns, rows, points, holes: Vec::new(), look }
    }

    /// A flat rectangle: `origin` + s·`right` + t·`up`, facing `right` × `up`.
    pub fn plane(look: Look, origin: Vec3, right: Vec3, up: Vec3, columns: Vec<f32>, rows: Vec<f32>) -> Self {
        let normal = right.cross(up);
        Self::new(look, columns, rows, |s, t| Point { position: origin + right * s + up * t, normal })
    }

    /// A surface of revolution about the frame's z axis. `profile` lists `(radius, z)`; the front is to the right of
    /// its direction (outside, for a profile that climbs). `segments` must be a multiple of 4 to meet a
    /// [`Chart::disc`].
    pub fn revolve(look: Look, frame: Frame, profile: &[(f32, f32)], segments: usize) -> Self {
        let at = |i: usize| Vec2::new(profile[i].0, profile[i].1);
        let last = profile.len() - 1;
        let mut rows = vec![0.0];
        for i in 0..last {
            rows.push(rows[i] + at(i).distance(at(i + 1)));
        }
        let widest = profile.iter().map(|p| p.0).fold(0.0, f32::max);
        let turn = std::f32::consts::TAU * widest;
        let columns: Vec<f32> = (0..=segments).map(|i| turn * i as f32 / segments as f32).collect();
        let mut points = Vec::with_capacity(rows.len() * columns.len());
        for i in 0..=last {
            let along = (at((i + 1).min(last)) - at(i.saturating_sub(1))).normalize_or(Vec2::Y);
            for c in 0..=segments {
                let (sin, cos) = rim_angle(c % segments, segments).sin_cos();
                points.push(Point {
                    position: frame.point(Vec3::new(cos * at(i).x, sin * at(i).x, at(i).y)),
                    normal: frame.vector(Vec3::new(cos * along.y, sin * along.y, -along.x)),
                });
            }
        }
        Self { columns, rows, points, holes: Vec::new(), look }
    }

    /// A disc of `segments` rim vertices (a multiple of 4) in the frame's plane z = 0, facing +z, or −z with `down`;
    /// the square of the chart becomes the disc by the concentric map (Shirley and Chiu 1997), which spaces the rim
    /// evenly.
    pub fn disc(look: Look, frame: Frame, radius: f32, segments: usize, down: bool) -> Self {
        let lines = even_lines(2.0 * radius, segments / 4);
        let flip = if down { -1.0 } else { 1.0 };
        Self::new(look, lines.clone(), lines, |s, t| {
            let p = Vec2::new(s / radius - 1.0, flip * (t / radius - 1.0));
            let (r, angle) = if p.x.abs() > p.y.abs() {
                (p.x, std::f32::consts::FRAC_PI_4 * p.y / p.x)
            } else if p.y != 0.0 {
                (p.y, std::f32::consts::FRAC_PI_2 - std::f32::consts::FRAC_PI_4 * p.x / p.y)
            } else {
                (0.0, 0.0)
            };
            let (sin, cos) = angle.sin_cos();
            Point { position: frame.point(Vec3::new(cos, sin, 0.0) * r * radius), normal: Vec3::Z * flip }
        })
    }

    /// Width and height in metres.
    pub fn size(&self) -> Vec2 {
        let end = |lines: &[f32]| lines.last().copied().unwrap_or(0.0);
        Vec2::new(end(&self.columns), end(&self.rows))
    }

    /// Whether the cell at `column`, `row` is part of the surface.
    pub fn is_solid(&self, column: usize, row: usize) -> bool {
        let mid = |lines: &[f32], i: usize| 0.5 * (lines[i] + lines[i + 1]);
        let centre = Vec2::new(mid(&self.columns, column), mid(&self.rows, row));
        !self.holes.iter().any(|hole| hole.contains(centre))
    }

    /// The grid point at `column`, `row`.
    pub fn corner(&self, column: usize, row: usize) -> Point {
        self.points[row * self.columns.len() + column]
    }

    /// The surface point at `st`, on the triangles as [`super::atlas`] cuts them; `None` in a hole.
    pub fn at(&self, st: Vec2) -> Option<Point> {
        let cell = |lines: &[f32], x: f32| {
            let i = lines.partition_point(|&line| line <= x).clamp(1, lines.len() - 1) - 1;
            (i, ((x - lines[i]) / (lines[i + 1] - lines[i])).clamp(0.0, 1.0))
        };
        let ((c, a), (r, b)) = (cell(&self.columns, st.x), cell(&self.rows, st.y));
        if !self.is_solid(c, r) {
            return None;
        }
        let (p00, p11) = (self.corner(c, r), self.corner(c + 1, r + 1));
        let (side, near, far) = if a >= b { (self.corner(c + 1, r), a, b) } else { (self.corner(c, r + 1), b, a) };
        let mix = |f: fn(&Point) -> Vec3| f(&p00) * (1.0 - near) + f(&side) * (near - far) + f(&p11) * far;
        Some(Point { position: mix(|p| p.position), normal: mix(|p| p.normal).normalize_or(p00.normal) })
    }
}

/// The angle of rim vertex `i` of `segments`: evenly spaced, starting at the corner of the disc's chart.
fn rim_angle(i: usize, segments: usize) -> f32 {
    std::f32::consts::TAU * i as f32 / segments as f32 - std::f32::consts::FRAC_PI_4
}

/// `cells` equal cells over `length`.
fn even_lines(length: f32, cells: usize) -> Vec<f32> {
    let cells = cells.max(1);
    (0..=cells).map(|i| length * i as f32 / cells as f32).collect()
}

/// Longest edge of a cell, metres: long faces are split, so that triangles are not slivers.
const MAX_CELL: f32 = 0.75;

/// Lines over `length` that are at most [`MAX_CELL`] apart.
pub(super) fn split_lines(length: f32) -> Vec<f32> {
    even_lines(length, (length / MAX_CELL).ceil() as usize)
}

/// Which faces of a block exist.
#[derive(Clone, Copy, Debug)]
pub(super) struct Faces(u8);

impl Faces {
    pub const LEFT: Self = Self(1);
    pub const RIGHT: Self = Self(2);
    pub const BACK: Self = Self(4);
    pub const FRONT: Self = Self(8);
    pub const BOTTOM: Self = Self(16);
    pub const TOP: Self = Self(32);
    pub const ALL: Self = Self(63);
    /// Standing on something.
    pub const STANDING: Self = Self::ALL.without(Self::BOTTOM);

    /// These faces but not `other`: the ones that touch something and can never be seen.
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    fn has(self, face: Self) -> bool {
        self.0 & face.0 != 0
    }
}

/// An axis-parallel block in `frame`, from `lo` to `hi`; back is −y, front is +y.
pub(super) fn block(out: &mut Vec<Chart>, look: Look, frame: Frame, lo: Vec3, hi: Vec3, faces: Faces) {
    let (x, y, z) = (frame.x, frame.y, Vec3::Z);
    let d = hi - lo;
    let corner = |right: bool, front: bool, top: bool| {
        let pick = |high: bool, lo: f32, hi: f32| if high { hi } else { lo };
        frame.point(Vec3::new(pick(right, lo.x, hi.x), pick(front, lo.y, hi.y), pick(top, lo.z, hi.z)))
    };
    let sides = [
        (Faces::LEFT, corner(false, true, false), -y, z, d.y, d.z),
        (Faces::RIGHT, corner(true, false, false), y, z, d.y, d.z),
        (Faces::BACK, corner(false, false, false), x, z, d.x, d.z),
        (Faces::FRONT, corner(true, true, false), -x, z, d.x, d.z),
        (Faces::BOTTOM, corner(false, true, false), x, -y, d.x, d.y),
        (Faces::TOP, corner(false, false, true), x, y, d.x, d.y),
    ];
    for (_, origin, right, up, width, height) in sides.into_iter().filter(|side| faces.has(side.0)) {
        out.push(Chart::plane(look, origin, right, up, split_lines(width), split_lines(height)));
    }
}

/// Segments around a round object: few for a thin one.
pub(super) fn segments(radius: f32) -> usize {
    if radius < 0.04 { 8 } else { 20 }
}

/// An upright cylinder from z = `from` to `to`, with its discs where asked for.
pub(super) fn cylinder(
    out: &mut Vec<Chart>,
    look: Look,
    frame: Frame,
    radius: f32,
    (from, to): (f32, f32),
    faces: Faces,
) {
    let n = segments(radius);
    out.push(Chart::revolve(look, frame, &[(radius, from), (radius, to)], n));
    if faces.has(Faces::TOP) {
        out.push(Chart::disc(look, frame.moved(Vec3::Z * to), radius, n, false));
    }
    if faces.has(Faces::BOTTOM) {
        out.push(Chart::disc(look, frame.moved(Vec3::Z * from), radius, n, true));
    }
}

/// A sphere centred on the frame's origin.
pub(super) fn ball(out: &mut Vec<Chart>, look: Look, frame: Frame, radius: f32) {
    const RINGS: usize = 10;
    let profile: Vec<(f32, f32)> = (0..=RINGS)
        .map(|i| {
            let (sin, cos) = (std::f32::consts::PI * i as f32 / RINGS as f32).sin_cos();
            (if i == 0 || i == RINGS { 0.0 } else { radius * sin }, -radius * cos)
        })
        .collect();
    out.push(Chart::revolve(look, frame, &profile, 20));
}
