//! The penalty on albedo that varies: at the wrong roughness it would have to imitate highlights.
//!
//! Where no texel is seen from two directions, some albedo explains the pixels at any roughness. At a wrong one,
//! though, it must imitate highlights that are missing or cancel those that are too many. So the likeliest roughness is
//! that at which albedo varies least between texels; what a surface is painted with varies alike at all.

use crate::fit::full::albedo::AlbedoProblem;
use crate::fit::index::NONE;
use crate::specular_table::NODES;

/// Largest weight of the log mean variation relative to the log mean cost of pixels: a texel has two pairs of
/// neighbours.
const PAIRS: f64 = 2.0;
/// Pixels at which that weight halves: many views of a surface constrain its albedo by themselves, and noise of the
/// curves adds variation where highlights are sharp.
const HALF_NEEDED: f64 = 3000.0;
/// Mean variation below which nothing counts as more even.
const FLAT: f64 = 1e-4;

/// Penalty of each node's roughness for a segment that so many `pixels` see, by the mean variation of the albedo that
/// goes with each ([`AlbedoProblem::variation`]): its logarithm, as the strength of the pattern is unknown.
pub fn penalty(variation: &[f64; NODES], pixels: f64) -> [f32; NODES] {
    let counts = PAIRS / (1.0 + pixels / HALF_NEEDED);
    variation.map(|mean| (counts * (mean + FLAT).ln()) as f32)
}

/// Which texels are seen by pixels that count for their `segment`. Elsewhere, albedo rests on pixels at grazing angles,
/// rims or edges alone, where models are inexact.
pub fn constrained(problem: &AlbedoProblem<'_>, segment: &[u32]) -> Vec<bool> {
    let mut constrained = vec![false; problem.segment.of.len()];
    let rows = &problem.seen.rows;
    let counting = (0..segment.len()).filter(|p| segment[*p] != NONE);
    counting.flat_map(|p| rows.row(p)).for_each(|share| constrained[share.texel as usize] = true);
    constrained
}
