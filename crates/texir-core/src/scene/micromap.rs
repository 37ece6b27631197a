//! Which parts of a triangle rays meet: opacity micromaps of two states, as `VK_EXT_opacity_micromap` and DirectX
//! Raytracing have them.

use std::ops::Range;

use crate::rng::{hash2, to_unit};

/// Columns and rows of parts whose dither is one.
pub const DITHER_BLOCK: u32 = 4;

/// What rays meet of a triangle.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum TriangleOpacity {
    /// All of it.
    Opaque,
    /// Nothing.
    Transparent,
    /// The parts that are set.
    Micromap(Micromap),
}

/// A triangle cut along `side` − 1 lines parallel to each of its edges into `side`² parts alike: whether rays meet each.
///
/// Parts come in rows from the edge between the first two corners to the third; those of a row by barycentric `u`, of
/// which every second one is upside down.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Micromap {
    side: u32,
    parts: Parts,
    /// Whether the triangle's second and third corner are the other way round than when its parts were told.
    is_mirrored: bool,
}

/// Which parts are there.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Parts {
    /// A bit for each.
    Listed(Box<[u32]>),
    /// Those whose threshold is below the opacity, here by its bits, of all alike.
    Even { opacity: u32, seed: u32 },
}

/// The place of a part of a triangle: its column along the first edge, its row, and whether it is upside down.
pub(super) type Part = (u32, u32, bool);

impl TriangleOpacity {
    /// Of a triangle of which `coverage` tells how much of a part is opaque, from 0 to 1, by the barycentric
    /// coordinates (u, v) of the part's corners; `side` parts along each edge, 1 to [`Micromap::MAX_SIDE`].
    ///
    /// A part is there or it is not. Parts that are covered in part are there by an ordered dither (thresholds from the
    /// R2 sequence: Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018), so that as much is there
    /// as is covered, and no two neighbours alike. Of triangles behind each other each should have a `seed` of its own.
    /// What is covered alike all over is cut as finely as can be, so that each of a point's rays is stopped or passes by
    /// itself.
    pub fn from_coverage(side: u32, seed: u32, coverage: impl Fn([[f32; 2]; 3]) -> f32) -> Self {
        let side = side.clamp(1, Micromap::MAX_SIDE);
        let count = side * side;
        let mut words = vec![0u32; count.div_ceil(u32::BITS) as usize];
        let (mut set, mut least, mut most) = (0, f32::INFINITY, f32::NEG_INFINITY);
        for (index, part) in parts(side).enumerate() {
            let covered = coverage(corners(side, part));
            (least, most) = (least.min(covered), most.max(covered));
            if covered > threshold(part, seed) {
                words[index / 32] |= 1 << (index % 32);
                set += 1;
            }
        }
        if least == most && most > 0.0 && most < 1.0 {
            let parts = Parts::Even { opacity: most.to_bits(), seed };
            return Self::Micromap(Micromap { side: Micromap::MAX_SIDE, parts, is_mirrored: false });
        }
        match set {
            0 => Self::Transparent,
            set if set == count => Self::Opaque,
            _ => Self::Micromap(Micromap { side, parts: Parts::Listed(words.into()), is_mirrored: false }),
        }
    }

    /// That of the same triangle with its second and third corner swapped, so that it faces the other way.
    #[must_use]
    pub fn turned_over(self) -> Self {
        match self {
            Self::Micromap(micromap) => Self::Micromap(Micromap { is_mirrored: !micromap.is_mirrored, ..micromap }),
            plain => plain,
        }
    }
}

impl Micromap {
    /// Most parts along an edge.
    pub const MAX_SIDE: u32 = 4096;

    /// Parts along each edge.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// A bit for every part, from the least significant bit of the first word; none where there is an
    /// [`Micromap::even_opacity`].
    pub fn words(&self) -> &[u32] {
        match &self.parts {
            Parts::Listed(words) => words,
            Parts::Even { .. } => &[],
        }
    }

    /// The share of light that the triangle takes, above 0 and below 1, where that is the same all over.
    pub fn even_opacity(&self) -> Option<f32> {
        match self.parts {
            Parts::Listed(_) => None,
            Parts::Even { opacity, .. } => Some(f32::from_bits(opacity)),
        }
    }

    /// What shifts the thresholds of what is equally opaque all over; of nothing else, 0.
    pub fn seed(&self) -> u32 {
        match self.parts {
            Parts::Listed(_) => 0,
            Parts::Even { seed, .. } => seed,
        }
    }

    /// Whether its parts are looked up with barycentric coordinates swapped: see [`TriangleOpacity::turned_over`].
    pub fn is_mirrored(&self) -> bool {
        self.is_mirrored
    }

    /// Whether rays meet the part at barycentric coordinates.
    pub(super) fn is_opaque(&self, u: f32, v: f32) -> bool {
        let (u, v) = if self.is_mirrored { (v, u) } else { (u, v) };
        let cells = self.side as f32;
        let (x, y) = (u * cells, v * cells);
        let row = (y as u32).min(self.side - 1);
        let last = self.side - 1 - row;
        let column = (x as u32).min(last);
        // Beyond a row's last cell there is no triangle to turn.
        let turned = column < last && (x - column as f32) + (y - row as f32) > 1.0;
        match &self.parts {
            Parts::Listed(words) => {
                let index = row * (2 * self.side - row) + 2 * column + u32::from(turned);
                words[(index / 32) as usize] >> (index % 32) & 1 == 1
            }
            Parts::Even { opacity, seed } => f32::from_bits(*opacity) > threshold((column, row, turned), *seed),
        }
    }
}

/// All parts, in order.
pub(super) fn parts(side: u32) -> impl Iterator<Item = Part> {
    let in_row = move |row: u32| {
        let columns: Range<u32> = 0..2 * (side - row) - 1;
        columns.map(move |k| (k / 2, row, k % 2 == 1))
    };
    (0..side).flat_map(in_row)
}

/// The corners of a part.
pub(super) fn corners(side: u32, (column, row, turned): Part) -> [[f32; 2]; 3] {
    let steps = if turned { [(1, 1), (0, 1), (1, 0)] } else { [(0, 0), (1, 0), (0, 1)] };
    steps.map(|(x, y)| [column + x, row + y].map(|at| at as f32 / side as f32))
}

/// How much of a part must be covered for it to be there, in [0, 1).
///
/// The sequence is shifted in every block of [`DITHER_BLOCK`]² columns and rows anew: samples that lie in a grid of their own,
/// as those of a lightmap do, must not keep step with it.
fn threshold((column, row, turned): Part, seed: u32) -> f32 {
    // 1/ρ and 1/ρ² of the plastic number ρ, in fractions of 2³².
    let sequence = column.wrapping_mul(3_242_174_889).wrapping_add(row.wrapping_mul(2_447_445_414));
    let shift = hash2(hash2(column / DITHER_BLOCK, row / DITHER_BLOCK), seed);
    to_unit(sequence.wrapping_add(shift).wrapping_add(u32::from(turned) << 31))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Barycentric coordinates within a part.
    fn within(corners: [[f32; 2]; 3], [s, t]: [f32; 2]) -> [f32; 2] {
        let [a, b, c] = corners;
        [0, 1].map(|axis| a[axis] + s * (b[axis] - a[axis]) + t * (c[axis] - a[axis]))
    }

    #[test]
    fn every_place_is_looked_up_in_the_part_that_it_is_in() {
        for side in [1, 2, 3, 7, 32] {
            let set = |part: Part| (part.0 + 2 * part.1 + u32::from(part.2)).is_multiple_of(3);
            let middle = |corners| within(corners, [1.0 / 3.0; 2]);
            let middles: Vec<[f32; 2]> =
                parts(side).filter(|&part| set(part)).map(|p| middle(corners(side, p))).collect();
            let opacity =
                TriangleOpacity::from_coverage(side, 0, |corners| f32::from(middles.contains(&middle(corners))));
            let TriangleOpacity::Micromap(map) = opacity else {
                assert!(side == 1 && opacity == TriangleOpacity::Opaque, "{side}: {opacity:?}");
                continue;
            };
            assert_eq!(parts(side).count() as u32, side * side);
            for part in parts(side) {
                for [s, t] in [[0.01, 0.01], [0.97, 0.01], [0.01, 0.97], [0.3, 0.3]] {
                    let [u, v] = within(corners(side, part), [s, t]);
                    assert_eq!(map.is_opaque(u, v), set(part), "{part:?} of {side} at {u}, {v}");
                }
            }
            // Rounding leads beyond an edge at most.
            for [u, v] in [[1.0, 0.0], [0.0, 1.0], [0.5, 0.500_000_1], [1.0, 1.0]] {
                map.is_opaque(u, v);
            }
        }
    }

    #[test]
    fn a_mirrored_triangle_is_there_where_it_was() {
        let ramp = |[[u, v], ..]: [[f32; 2]; 3]| 0.9 * u + 0.2 * v;
        for opacity in [TriangleOpacity::from_coverage(13, 5, ramp), TriangleOpacity::from_coverage(13, 5, |_| 0.4)] {
            let [TriangleOpacity::Micromap(map), TriangleOpacity::Micromap(mirrored)] =
                [opacity.clone(), opacity.clone().turned_over()]
            else {
                panic!("{opacity:?} is all or nothing");
            };
            let places = || parts(50).map(|part| within(corners(50, part), [0.3, 0.3]));
            assert!(places().all(|[u, v]| mirrored.is_opaque(v, u) == map.is_opaque(u, v)));
            // Negative control: its parts do lie otherwise.
            assert!(places().any(|[u, v]| mirrored.is_opaque(u, v) != map.is_opaque(u, v)));
            assert_eq!(opacity.clone().turned_over().turned_over(), opacity);
        }
    }

    #[test]
    fn as_much_is_there_as_is_covered() {
        for coverage in [0.05, 0.3, 0.5, 0.9] {
            for seed in [0, 1 << 30, 123_456_789] {
                let TriangleOpacity::Micromap(even) = TriangleOpacity::from_coverage(40, seed, |_| coverage) else {
                    panic!("{coverage} is neither all nor nothing");
                };
                assert_eq!((even.even_opacity(), even.words()), (Some(coverage), &[][..]));
                let places = parts(100).map(|part| within(corners(100, part), [0.3, 0.3]));
                let met = places.filter(|[u, v]| even.is_opaque(*u, *v)).count();
                assert!((met as f32 / 1e4 - coverage).abs() < 0.02, "{met} of 10,000 for {coverage}");
                // All but equal.
                let varying = |[[u, _], ..]: [[f32; 2]; 3]| coverage + 1e-3 * u;
                let TriangleOpacity::Micromap(map) = TriangleOpacity::from_coverage(40, seed, varying) else {
                    panic!("{coverage} is neither all nor nothing");
                };
                let set: u32 = map.words().iter().map(|word| word.count_ones()).sum();
                assert!((set as f32 / 1600.0 - coverage).abs() < 0.02, "{set} of 1600 for {coverage}");
                assert_eq!(map.even_opacity(), None);
            }
        }
        assert_eq!(TriangleOpacity::from_coverage(40, 7, |_| 1.0), TriangleOpacity::Opaque);
        assert_eq!(TriangleOpacity::from_coverage(40, 7, |_| 0.0), TriangleOpacity::Transparent);
    }
}
