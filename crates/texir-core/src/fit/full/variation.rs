//! What an albedo says of roughness: how much it would have to imitate.
//!
//! Where no texel is seen from two sides, pixels alone say nothing: at any roughness, some albedo explains them. But at
//! the wrong one it takes up the highlights that are missing, and undoes those that are too many. So the roughness is
//! likely at which albedo varies least from texel to texel. What a surface is painted with varies alike at all of them.

use super::albedo::AlbedoProblem;
use crate::fit::adjacency::NONE;
use crate::specular_table::NODES;

/// What the logarithm of the mean variation counts at most beside that of the cost of pixels: there are two pairs of
/// neighbours for each texel.
const PAIRS: f64 = 2.0;
/// The pixels at which it counts half of that: where many views see a surface, they contradict what albedo imitates,
/// and noise of the curves makes it vary more where highlights are sharp.
const HALF_NEEDED: f64 = 3000.0;
/// Mean variation below which nothing counts as more even.
const FLAT: f64 = 1e-4;

/// What speaks against each node's roughness of a segment that so many `pixels` see, by the mean variation of the
/// albedo that goes with each ([`AlbedoProblem::variation`]): its logarithm, as it is not known beforehand how strong
/// the pattern is.
pub fn against(variation: &[f64; NODES], pixels: f64) -> [f32; NODES] {
    let counts = PAIRS / (1.0 + pixels / HALF_NEEDED);
    variation.map(|mean| (counts * (mean + FLAT).ln()) as f32)
}

/// Which texels are seen by pixels that say something of their `segment`. Elsewhere, albedo has only been told at
/// grazing angles or along an edge, where models are not exact.
pub fn told(problem: &AlbedoProblem<'_>, segment: &[u32]) -> Vec<bool> {
    let mut told = vec![false; problem.segment.of.len()];
    let rows = &problem.seen.rows;
    let saying = (0..segment.len()).filter(|p| segment[*p] != NONE);
    saying.flat_map(|p| rows.row(p)).for_each(|share| told[share.texel as usize] = true);
    told
}
