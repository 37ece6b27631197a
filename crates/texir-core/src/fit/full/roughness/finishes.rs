//! Roughness that varies within a segment: worn tracks, wet spots, a polished patch, a tiled wall among painted ones.
//!
//! A segment has one finish or a mixture of two. It is cut into square blocks of the atlas, each with a posterior share
//! of the two by its pixels, its neighbours and its face: blocks of one tiled wall support each other, and uncertain
//! ones stay in between. A second finish is trusted by its held-out gain: blocks are free enough to fit errors, which
//! differ from view to view, so the shares that one half of the views estimates are scored on the other half.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;

use super::blocks::{Block, BlockGrid, BlockKey, BlockTallies};
use super::cross_validation::ramp;
use super::evidence::{Tally, minimum};
use crate::fit::settings::FinishSettings;
use crate::specular_table::NODES;

/// Roughness of every texel where segments have two finishes, from the `roughness` by segment and colour. `whole` is
/// that of each segment.
pub fn refine(
    grid: &BlockGrid<'_>,
    BlockTallies { all, without_joints }: &BlockTallies,
    whole: &[f32],
    roughness: &[f32],
    settings: &FinishSettings,
) -> Vec<f32> {
    let segments: Vec<&[Block]> = all.chunk_by(|a, b| a.key.segment == b.key.segment).collect();
    let changes: BTreeMap<BlockKey, f32> = segments
        .into_par_iter()
        .flat_map_iter(|blocks| two_finishes(blocks, without_joints, whole, settings))
        .collect();
    let blended = |t: usize| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (key, near) in grid.between(t) {
            if let Some(times) = changes.get(&key) {
                sum += near * times;
                weight += near;
            }
        }
        roughness[t] * if weight > 0.0 { sum / weight } else { 1.0 }
    };
    (0..roughness.len()).into_par_iter().map(blended).collect()
}

/// How many times as rough as their segment its blocks are; nothing where one finish is as good. `without_joints` has
/// those of all segments.
fn two_finishes(
    blocks: &[Block],
    without_joints: &[Block],
    whole: &[f32],
    settings: &FinishSettings,
) -> Vec<(BlockKey, f32)> {
    let own: Vec<Tally> = blocks.iter().map(Block::all).collect();
    let neighbours = Neighbours::of(blocks);
    let pair = best_pair(&own, &neighbours);
    let trust = ramp(settings.gain, gain(blocks, &neighbours, pair, settings));
    let rough = neighbours.shares(&own, pair);
    let of_all = finishes(&own, &rough);
    let few = |finish: &Tally| finish.pixels < f64::from(settings.min_pixels);
    if trust == 0.0 || of_all.iter().any(few) {
        return Vec::new();
    }
    let of_plain = |block: &Block| {
        let block = without_joints.binary_search_by_key(&block.key, |block| block.key).ok();
        block.map_or(Tally::default(), |block| without_joints[block].all())
    };
    let plain = finishes(&blocks.iter().map(of_plain).collect::<Vec<_>>(), &rough);
    let whole = whole[blocks[0].key.segment as usize];
    let times = [0, 1].map(|finish| {
        let says = if few(&plain[finish]) { &of_all[finish] } else { &plain[finish] };
        (minimum(&says.misfit()) / whole).powf(trust)
    });
    let of_block = |share: &f64| times[0] + *share as f32 * (times[1] - times[0]);
    blocks.iter().map(|block| block.key).zip(rough.iter().map(of_block)).collect()
}

/// The two nodes, smoother first, that explain the blocks best: of all pairs, each block taking the better of the two,
/// and from there by what their shares ask for.
fn best_pair(own: &[Tally], neighbours: &Neighbours) -> [usize; 2] {
    /// Almost all pairs stay after the first.
    const ROUNDS: usize = 3;
    let of_pair = |[smooth, rough]: [usize; 2]| -> f64 {
        own.iter().map(|block| block.cost[smooth].min(block.cost[rough])).sum()
    };
    let pairs = (0..NODES).flat_map(|smooth| (smooth + 1..NODES).map(move |rough| [smooth, rough]));
    let first = pairs.map(|pair| (of_pair(pair), pair)).min_by(|a, b| a.0.total_cmp(&b.0));
    let mut pair = first.map_or([0, 1], |(_, pair)| pair);
    for _ in 0..ROUNDS {
        let asked = finishes(own, &neighbours.shares(own, pair)).map(|finish| finish.best_node());
        if asked[0] >= asked[1] || asked == pair {
            break;
        }
        pair = asked;
    }
    pair
}

/// The tallies of the smoother finish and of the rougher one, of which every block has the share `rough`.
fn finishes(tallies: &[Tally], rough: &[f64]) -> [Tally; 2] {
    tallies.iter().zip(rough).fold([Tally::default(); 2], |[mut smoother, mut rougher], (tally, rough)| {
        smoother.merge(&tally.times(1.0 - rough));
        rougher.merge(&tally.times(*rough));
        [smoother, rougher]
    })
}

/// Held-out gain: fall of the log mean cost from the other half's best single finish to the one of `pair` further from
/// it, weighted by that half's shares; times n/(n + `half_pixels`), 0 if n is.
fn gain(blocks: &[Block], neighbours: &Neighbours, pair: [usize; 2], settings: &FinishSettings) -> f32 {
    let (mut judged, mut one, mut two) = (Tally::default(), 0.0, 0.0);
    for [mine, other] in [[0, 1], [1, 0]] {
        let asks: Vec<Tally> = blocks.iter().map(|block| block.halves[other]).collect();
        let single = Tally::sum(asks.iter()).best_node();
        let second = usize::from(single.abs_diff(pair[0]) < single.abs_diff(pair[1]));
        let rough = neighbours.shares(&asks, pair);
        for ((block, asks), rough) in blocks.iter().zip(&asks).zip(rough) {
            // Of blocks that it does not see, the other half says nothing.
            if asks.pixels > 0.0 {
                let block = block.halves[mine].times([1.0 - rough, rough][second]);
                judged.merge(&block);
                one += block.cost[single];
                two += block.cost[pair[second]];
            }
        }
    }
    if judged.pixels == 0.0 {
        return 0.0;
    }
    let pixels = judged.pixels as f32;
    (judged.ln_mean(one) - judged.ln_mean(two)) * pixels / (pixels + settings.half_pixels)
}

/// Which blocks of a segment are neighbours.
struct Neighbours {
    /// The blocks of each face.
    faces: Vec<Range<usize>>,
    /// Those around each block, on its face.
    beside: Vec<Vec<usize>>,
}

impl Neighbours {
    fn of(blocks: &[Block]) -> Self {
        let face_after = |end: &mut usize, face: &[Block]| {
            let first = std::mem::replace(end, *end + face.len());
            Some(first..*end)
        };
        let at = |key: BlockKey| blocks.binary_search_by_key(&key, |block| block.key).ok();
        let beside = |block: &Block| {
            let BlockKey { column: x, row: y, .. } = block.key;
            let around = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
            around.into_iter().filter_map(|(column, row)| at(BlockKey { column, row, ..block.key })).collect()
        };
        Self {
            faces: blocks.chunk_by(|a, b| a.key.face == b.key.face).scan(0, face_after).collect(),
            beside: blocks.iter().map(beside).collect(),
        }
    }

    /// The posterior of the rougher finish of `pair` in each block, by its `tallies`, by its face's share as a prior,
    /// and by the blocks beside it. A face's share is the mean of its blocks', shrunk to the segment's where pixels are
    /// few. (Expectation maximisation over a mixture of two, the field of the neighbours by its mean; Celeux, Forbes
    /// and Peyrard, "EM procedures using mean field-like approximations", 2003.)
    fn shares(&self, tallies: &[Tally], [smooth, rough]: [usize; 2]) -> Vec<f64> {
        /// Log odds that a neighbour, all of one finish, adds to that finish.
        const NEIGHBOUR_LOG_ODDS: f64 = 1.0;
        /// Pixels at which a face's own share counts as much as its segment's.
        const PRIOR_PIXELS: f64 = 30.0;
        /// Least share of either finish in a face.
        const LEAST: f64 = 0.05;
        /// EM iterations: with many, tiny changes decide whether a face collapses to one finish.
        const ROUNDS: usize = 5;
        let odds = |tally: &Tally| {
            let likelihood = tally.ln_likelihood();
            f64::from(likelihood[rough] - likelihood[smooth])
        };
        let odds: Vec<f64> = tallies.iter().map(odds).collect();
        let mut share = vec![0.5; tallies.len()];
        let mut of_face = vec![0.5; self.faces.len()];
        for _ in 0..ROUNDS {
            let likely = |block: usize, of_face: f64| {
                let lent: f64 =
                    self.beside[block].iter().map(|beside| NEIGHBOUR_LOG_ODDS * (2.0 * share[*beside] - 1.0)).sum();
                1.0 / (1.0 + (1.0 - of_face) / of_face * (-odds[block] - lent).exp())
            };
            let faces = self.faces.iter().zip(&of_face);
            share = faces.flat_map(|(face, of_face)| face.clone().map(|block| likely(block, *of_face))).collect();
            let sums = |part: Range<usize>| {
                let part = share[part.clone()].iter().zip(&tallies[part]);
                part.fold([0.0; 2], |[rough, all], (share, tally)| [rough + share * tally.pixels, all + tally.pixels])
            };
            let [rough, all] = sums(0..share.len());
            let of_segment = rough / all.max(f64::MIN_POSITIVE);
            let of = |face: &Range<usize>| {
                let [rough, all] = sums(face.clone());
                ((rough + PRIOR_PIXELS * of_segment) / (all + PRIOR_PIXELS)).clamp(LEAST, 1.0 - LEAST)
            };
            of_face = self.faces.iter().map(of).collect();
        }
        share
    }
}

#[cfg(test)]
mod tests {
    use half::f16;

    use super::super::evidence::Evidence;
    use super::super::evidence::tests::of_one_segment;
    use super::*;
    use crate::fit::index::NONE;
    use crate::specular_table::node;

    #[test]
    fn a_surface_has_two_finishes_where_the_views_tell_them_apart_clearly() {
        let (width, texels) = (64u32, (0..64 * 16).collect::<Vec<u32>>());
        let halves = |t: u32| t % width < 32;
        // Smooth here, 0.1, and `rough` there; `depth` says how clearly the views tell, beside what nothing explains.
        let evidence = |is_smooth: &dyn Fn(u32) -> bool, depth: f32, rough: f32| Evidence {
            segment: vec![0; texels.len()],
            cost: texels
                .iter()
                .map(|&t| {
                    let truth: f32 = if is_smooth(t) { 0.1 } else { rough };
                    std::array::from_fn(|k| f16::from_f32(0.1 + depth * (node(k) / truth).ln().powi(2).min(1.0)))
                })
                .collect::<Vec<[f16; NODES]>>(),
            weight: vec![1.0; texels.len()],
            slope: vec![],
            variation: vec![],
        };
        let segment = vec![0; texels.len()];
        // Views take turns, texel by texel.
        let half: Vec<u8> = texels.iter().map(|t| ((t % width + t / width) % 2) as u8).collect();
        let grid = BlockGrid { width: width as usize, texels: &texels, segment: &segment, face: &segment, block: 6.0 };
        let by = |half: &[u8], evidence: &Evidence, settings: &FinishSettings| {
            let blocks = grid.blocks(evidence, &texels, half);
            refine(&grid, &BlockTallies { all: blocks.clone(), without_joints: blocks }, &[0.2], &[0.2; 1024], settings)
        };
        // By default a finish must have 500 pixels, about as many as each has here.
        let settings = FinishSettings { min_pixels: 200, ..FinishSettings::default() };
        let refined =
            |is_smooth: &dyn Fn(u32) -> bool, depth, rough| by(&half, &evidence(is_smooth, depth, rough), &settings);
        let clear = refined(&halves, 1.0, 0.4);
        assert!((clear[8] - 0.1).abs() < 0.01 && (clear[56] - 0.4).abs() < 0.02, "{} {}", clear[8], clear[56]);
        // A little more evidence changes little.
        let by_depth: Vec<f32> =
            (0..=40).map(|step| refined(&halves, 1e-3 * 1.2f32.powi(step), 0.4)[8]).map(f32::ln).collect();
        assert!((by_depth[0] - 0.2f32.ln()).abs() < 1e-6 && (by_depth[40] - 0.1f32.ln()).abs() < 0.1, "{by_depth:?}");
        assert!(by_depth.windows(2).all(|d| d[1] < d[0] + 0.01 && d[1] > d[0] - 0.4), "{by_depth:?}");
        // Single blocks, where both halves of the views see them.
        let scattered = |t: u32| crate::rng::hash2(t % width / 6, t / width / 6).is_multiple_of(2);
        let by_block = refined(&scattered, 1.0, 0.4);
        for (x, y) in [(2u32, 1u32), (4, 1), (5, 0), (7, 1)] {
            let (t, found) = (6 * x + 3 + width * (6 * y + 3), 0.2f32);
            let truth = if scattered(t) { 0.1 } else { 0.4 };
            assert!(
                (by_block[t as usize] / truth).ln().abs() < (found / truth).ln().abs() - 0.2,
                "{x} {y}: {}",
                by_block[t as usize]
            );
        }
        // Negative controls: too little difference, none, too few pixels,
        assert_eq!(refined(&halves, 1e-3, 0.4), [0.2; 1024]);
        assert_eq!(refined(&halves, 1.0, 0.1), [0.2; 1024]);
        assert_eq!(
            by(&half, &evidence(&halves, 1.0, 0.4), &FinishSettings { min_pixels: 600, ..settings.clone() }),
            [0.2; 1024]
        );
        // views that contradict each other, and one that nobody can.
        let odd = |t: u32| (t % width + t / width).is_multiple_of(2);
        assert_eq!(refined(&|t| halves(t) == odd(t), 1.0, 0.4), [0.2; 1024]);
        assert_eq!(by(&[0; 1024], &evidence(&halves, 1.0, 0.4), &settings), [0.2; 1024]);
    }

    #[test]
    fn the_blocks_of_a_face_speak_for_each_other() {
        // Two walls of 10 blocks: one of 0.1, of which two blocks look like the other's 0.4 to both halves of the views.
        let texels: Vec<u32> = (0..60 * 12).collect();
        let column = |t: u32| t % 60;
        let is_smooth = |t: u32| column(t) < 30 && !(6..12).contains(&column(t));
        let cost = |&t: &u32| -> [f16; NODES] {
            let truth: f32 = if is_smooth(t) { 0.1 } else { 0.4 };
            // The two that are off, hardly.
            let depth = if (6..12).contains(&column(t)) { 0.06 } else { 0.5 };
            std::array::from_fn(|k| f16::from_f32(0.1 + depth * (node(k) / truth).ln().powi(2).min(1.0)))
        };
        let evidence = of_one_segment(texels.iter().map(cost).collect());
        let by_face = |face: &[u32]| {
            let half: Vec<u8> = texels.iter().map(|t| (t % 2) as u8).collect();
            let segment = vec![0; texels.len()];
            let grid = BlockGrid { width: 60, texels: &texels, segment: &segment, face, block: 6.0 };
            let settings = FinishSettings { min_pixels: 200, ..FinishSettings::default() };
            let blocks = grid.blocks(&evidence, &texels, &half);
            refine(
                &grid,
                &BlockTallies { all: blocks.clone(), without_joints: blocks },
                &[0.2],
                &vec![0.2; texels.len()],
                &settings,
            )
        };
        let walls: Vec<u32> = texels.iter().map(|t| u32::from(column(*t) >= 30)).collect();
        let roughness = by_face(&walls);
        let [one, other, off] = [3, 45, 9].map(|column| roughness[3 * 60 + column]);
        assert!((one - 0.1).abs() < 0.01 && (other - 0.4).abs() < 0.02 && off < 0.12, "{one} {other} {off}");
        // Negative control: where both walls are one face, that says nothing, and only the blocks beside them do.
        let alone = by_face(&vec![0; texels.len()])[3 * 60 + 9];
        assert!(alone > 1.2 * off, "{off} {alone}");
    }

    #[test]
    fn pixels_that_see_joints_say_where_finishes_are_but_not_what() {
        // 0.1 on the left, 0.3 on the right; what pixels see of every third column is twice as rough, for the joint in it.
        const WIDTH: u32 = 64;
        let texels: Vec<u32> = (0..WIDTH * 24).collect();
        let is_joint = |t: u32| (t % WIDTH).is_multiple_of(3);
        let cost = |&t: &u32| -> [f16; NODES] {
            let truth = if t % WIDTH < 32 { 0.1f32 } else { 0.3 } * if is_joint(t) { 2.0 } else { 1.0 };
            std::array::from_fn(|k| f16::from_f32(0.1 + (node(k) / truth).ln().powi(2).min(1.0)))
        };
        let evidence = of_one_segment(texels.iter().map(cost).collect());
        let refined = |counts: &dyn Fn(u32) -> bool| {
            let half: Vec<u8> = texels.iter().map(|t| ((t % WIDTH + t / WIDTH) % 2) as u8).collect();
            let segment = vec![0; texels.len()];
            let dominant: Vec<u32> = texels.iter().map(|t| if counts(*t) { *t } else { NONE }).collect();
            let grid =
                BlockGrid { width: WIDTH as usize, texels: &texels, segment: &segment, face: &segment, block: 6.0 };
            let without_joints = grid.blocks(&evidence, &dominant, &half);
            let settings = FinishSettings { min_pixels: 200, ..FinishSettings::default() };
            let roughness = refine(
                &grid,
                &BlockTallies { all: grid.blocks(&evidence, &texels, &half), without_joints },
                &[0.17],
                &vec![0.17; texels.len()],
                &settings,
            );
            [8, 56].map(|column| roughness[(12 * WIDTH + column) as usize])
        };
        let [left, right] = refined(&|t| !is_joint(t));
        assert!((left - 0.1).abs() < 0.01 && (right - 0.3).abs() < 0.02, "{left} {right}");
        // Negative control: all pixels. Where those without joints are too few, all count as well.
        let [left, right] = refined(&|_| true);
        assert!(left > 0.11 && right > 0.33, "{left} {right}");
        assert_eq!(refined(&|t| t % WIDTH < 2), [left, right]);
    }
}
