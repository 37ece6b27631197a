//! Segments of several materials, told by the colours of their faces: one tiled wall in a painted room.
//!
//! Semantics call all of it wall. As one segment, all of it would have one roughness, or two if halves of the views
//! agree on them; as segments of their own, each is scanned.

use std::cmp::Reverse;

use glam::Vec3A;

use crate::fit::full::partition::Partition;
use crate::stats::median;

/// Faces of which less is seen, square metres, are of their segment's main paint: walls and floors are judged well by
/// themselves, a door is not.
const SMALLEST: f32 = 2.5;
/// Colours are of one material up to this difference of their logarithms, in any channel: light is not known better
/// everywhere.
const SAME: f32 = 0.35;
/// And up to this difference of channels' differences: light that is not well known keeps its hue, and where few views
/// see tiles, their reflections make them pale.
const SAME_HUE: f32 = 0.12;
/// Added to albedo before: about what reflections add to it, where it is told by radiance, which is much of a dark one.
const REFLECTED: f32 = 0.05;

/// Divides segments whose large faces differ in colour, and tells how many segments there are then. The part with the
/// largest face keeps the segment's number, and what is not on a large face; others have numbers from `segment.count` on.
/// Colours are those of texels that are `seen`; `texel` is the edge of a typical texel, metres.
pub fn divide(
    segment: Partition<'_>,
    face: &[u32],
    albedo: &[Vec3A],
    seen: impl Fn(usize) -> bool,
    texel: f32,
) -> (Vec<u32>, usize) {
    let mut texels_of: Vec<Vec<u32>> = vec![Vec::new(); face.iter().max().map_or(0, |last| *last as usize + 1)];
    (0..).zip(face).filter(|(t, _)| seen(*t as usize)).for_each(|(t, face)| texels_of[*face as usize].push(t));
    // Those that have a segment's number are small pieces of it.
    let mut large: Vec<(usize, &Vec<u32>)> = texels_of.iter().enumerate().skip(segment.count).collect();
    large.retain(|(_, texels)| texels.len() as f32 * texel * texel >= SMALLEST);
    large.sort_by_key(|(_, texels)| Reverse(texels.len()));

    // Of every segment, the colours of its parts with their numbers.
    let mut parts: Vec<Vec<(Vec3A, u32)>> = vec![Vec::new(); segment.count];
    let mut count = segment.count;
    let mut part_of_face = vec![None; texels_of.len()];
    for (face, texels) in large {
        let number = segment.of[texels[0] as usize];
        let parts = &mut parts[number as usize];
        let colour = main_colour(texels, albedo);
        let known = parts.iter().find(|(of_part, _)| are_alike(*of_part, colour)).map(|(_, part)| *part);
        part_of_face[face] = known.or_else(|| {
            let new = if parts.is_empty() { number } else { count as u32 };
            count += usize::from(!parts.is_empty());
            parts.push((colour, new));
            Some(new)
        });
    }
    let part = |(s, face): (&u32, &u32)| part_of_face[*face as usize].unwrap_or(*s);
    (segment.of.iter().zip(face).map(part).collect(), count)
}

/// Whether colours may be of one material.
fn are_alike(a: Vec3A, b: Vec3A) -> bool {
    let difference = a - b;
    difference.abs().max_element() <= SAME && difference.max_element() - difference.min_element() <= SAME_HUE
}

/// The median over texels, by channel.
fn main_colour(texels: &[u32], albedo: &[Vec3A]) -> Vec3A {
    let channel = |c: usize| {
        let mut values: Vec<f32> = texels.iter().map(|t| (albedo[*t as usize][c] + REFLECTED).ln()).collect();
        median(&mut values).unwrap_or_default()
    };
    Vec3A::new(channel(0), channel(1), channel(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXEL: f32 = 0.05;
    const PAINT: Vec3A = Vec3A::new(0.66, 0.64, 0.57);
    const TILES: Vec3A = Vec3A::new(0.36, 0.57, 0.47);

    /// The parts of one segment: walls of 3 m² each but for the first, which is of 4, and then 0.5 m² of small pieces.
    /// By wall, whether it is in another part than the first; nothing else is but them.
    fn divided<const N: usize>(colours: [&dyn Fn(usize) -> Vec3A; N], seen: impl Fn(usize) -> bool) -> [bool; N] {
        let wall = |t: usize| (t.saturating_sub(400) / 1200).min(N);
        let texels = 400 + 1200 * N + 200;
        let face: Vec<u32> = (0..texels).map(|t| if wall(t) == N { 0 } else { 1 + wall(t) as u32 }).collect();
        let albedo: Vec<Vec3A> = (0..texels).map(|t| if wall(t) == N { TILES } else { colours[wall(t)](t) }).collect();
        let one = vec![0; texels];
        let (part, count) = divide(Partition { of: &one, count: 1 }, &face, &albedo, seen, TEXEL);
        assert!(part[400 + 1200 * N..].iter().all(|part| *part == 0) && part.iter().all(|p| (*p as usize) < count));
        let first = |wall: usize| part[if wall == 0 { 0 } else { 400 + 1200 * wall }];
        assert!((0..400 + 1200 * N).all(|t| part[t] == first(wall(t))), "a wall is in one part");
        assert_eq!(count, 1 + (0..N).filter(|w| first(*w) != 0 && (0..*w).all(|v| first(v) != first(*w))).count());
        std::array::from_fn(|wall| first(wall) != first(0))
    }

    #[test]
    fn walls_of_another_colour_are_segments_of_their_own() {
        let (paint, tiles) = (|_: usize| PAINT, |_: usize| TILES);
        assert_eq!(divided([&paint, &tiles, &paint, &tiles], |_| true), [false, true, false, true]);
        // What their light is hardly known by, and where little of them is seen.
        assert_eq!(divided([&paint, &|_| 0.6 * PAINT], |_| true), [false, true]);
        assert_eq!(divided([&paint, &tiles], |t| t < 1600 || t % 3 == 0), [false, false]);
        // Other tiles, pale by their reflections.
        assert_eq!(divided([&paint, &|_| Vec3A::new(0.6, 0.65, 0.5)], |_| true), [false, true]);
    }

    #[test]
    fn light_that_is_not_known_well_and_patterns_divide_nothing() {
        let paint = |_: usize| PAINT;
        let shaded = |_: usize| PAINT * Vec3A::new(0.8, 0.76, 0.74);
        let striped = |t: usize| if t % 5 < 2 { TILES } else { PAINT };
        let soot = |_: usize| Vec3A::new(0.01, 0.02, 0.01);
        let shining_soot = |_: usize| Vec3A::new(0.025, 0.035, 0.025);
        assert_eq!(divided([&paint, &shaded, &striped], |_| true), [false; 3]);
        assert_eq!(divided([&soot, &shining_soot], |_| true), [false; 2]);
    }
}
