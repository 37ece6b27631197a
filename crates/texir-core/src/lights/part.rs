//! Triangles in congruent parts: lamps may be small places of large triangles.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

/// Most halvings of the edges of a triangle that is sampled in parts: 65,536 parts.
pub(super) const MAX_LEVEL: u32 = 8;

/// One of the 4^level congruent parts of a triangle whose edges are halved `level` times.
///
/// Lines through the ends of the n = 2^level pieces of an edge, parallel to the other edges, cut it: part (i, j) begins
/// at the barycentric coordinates (i, j)/n of the second and the third corner and is the triangle itself, n times
/// smaller, or what is left of that parallelogram, turned by half a turn.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct Part(u32);

impl Part {
    /// All of the triangle.
    pub const WHOLE: Self = Self(0);

    /// As `shared/light_sampling.wgsl` has it: i, j, whether it is turned, and the level, of 12, 12, 4 and 4 bits.
    fn new(level: u32, i: u32, j: u32, turned: bool) -> Self {
        Self(i | j << 12 | u32::from(turned) << 24 | level << 28)
    }

    fn i(self) -> u32 {
        self.0 & 0xfff
    }

    fn j(self) -> u32 {
        self.0 >> 12 & 0xfff
    }

    fn is_turned(self) -> bool {
        self.0 >> 24 & 1 != 0
    }

    /// How often the triangle's edges are halved.
    pub fn level(self) -> u32 {
        self.0 >> 28
    }

    /// The part that holds a point, by barycentric coordinates of the second and the third corner.
    pub fn at(level: u32, [u, v]: [f32; 2]) -> Self {
        let side = 1 << level;
        let (u, v) = (u * side as f32, v * side as f32);
        let j = (v as u32).min(side - 1);
        let i = (u as u32).min(side - 1 - j);
        let turned = (u - i as f32) + (v - j as f32) > 1.0 && i + j < side - 1;
        Self::new(level, i, j, turned)
    }

    /// All parts, by number.
    pub fn all(level: u32) -> impl Iterator<Item = Self> {
        let side = 1 << level;
        (0..side).flat_map(move |j| {
            let of_row = 2 * (side - j) - 1;
            (0..of_row).map(move |k| Self::new(level, k / 2, j, k % 2 == 1))
        })
    }

    /// Its place among the parts of its level: row by row of equal j, by i, the turned one of a pair last.
    pub fn number(self) -> u32 {
        let (side, j) = (1 << self.level(), self.j());
        j * (2 * side - j) + 2 * self.i() + u32::from(self.is_turned())
    }

    /// Barycentric coordinates, in the triangle, of what has these in the part: (start + slope · it) · scale.
    pub(super) fn placement(self) -> ([f32; 2], f32, f32) {
        let (slope, turn) = if self.is_turned() { (-1.0, 1) } else { (1.0, 0) };
        ([self.i() + turn, self.j() + turn].map(|k| k as f32), slope, 1.0 / (1 << self.level()) as f32)
    }

    /// The part of an earlier level that it is within.
    pub(super) fn within(self, level: u32) -> Self {
        Self::at(level, self.centre().to_array())
    }

    /// Its corners, of the triangle's.
    pub(super) fn corners(self, [a, b, c]: [Vec3; 3]) -> [Vec3; 3] {
        let (start, slope, scale) = self.placement();
        let at = |u: f32, v: f32| {
            a + (b - a) * ((start[0] + slope * u) * scale) + (c - a) * ((start[1] + slope * v) * scale)
        };
        [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)]
    }

    /// Barycentric coordinates of its centre.
    pub fn centre(self) -> Vec2 {
        let (start, slope, scale) = self.placement();
        (Vec2::from(start) + slope / 3.0) * scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_numbered_and_hold_what_is_in_them() {
        for level in 0..=MAX_LEVEL {
            let mut numbers = 0;
            for part in Part::all(level) {
                assert_eq!(part.number(), numbers, "{part:?}");
                assert_eq!(part.level(), level);
                numbers += 1;
                let (start, slope, scale) = part.placement();
                for [u, v] in [[0.02, 0.02], [0.95, 0.02], [0.02, 0.95], [0.3, 0.4]] {
                    let at = [start[0] + slope * u, start[1] + slope * v].map(|x| x * scale);
                    assert_eq!(Part::at(level, at), part, "{at:?}");
                }
                assert_eq!(Part::at(level, part.centre().to_array()), part);
            }
            assert_eq!(numbers, 4u32.pow(level));
            // What rounding leaves on the edges, or beyond them, is in some part.
            for at in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5], [0.7, 0.300_001], [1.000_001, -1e-9]] {
                assert!(Part::at(level, at).number() < numbers);
            }
        }
    }
}
