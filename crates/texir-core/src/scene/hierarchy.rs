//! Builds the hierarchy that rays are traced through: a binary one from the top down, by the binned surface area
//! heuristic (Wald, "On Fast Construction of SAH-based Bounding Volume Hierarchies", IEEE Symposium on Interactive Ray
//! Tracing 2007), which obvhs packs eight wide.
//!
//! obvhs's own builder goes from the bottom up. Where triangles are even and flat surfaces large, its boxes overlap
//! more and more: a ray visits 70 nodes among a million triangles where it visits 11 here (docs/performance.md).

use glam::Vec3A;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, node::Bvh2Node};
use obvhs::cwbvh::{CwBvh, bvh2_to_cwbvh::bvh2_to_cwbvh};
use obvhs::splits::split_aabbs_preset;
use obvhs::triangle::Triangle;
use rayon::prelude::*;

/// Bins that the centres of boxes are sorted into, per axis.
const BINS: usize = 32;
/// Levels of the binary hierarchy in which the heuristic decides; below, boxes are halved by number. Far more than it
/// needs: it could go on peeling off one box at a time.
const HEURISTIC_LEVELS: usize = 48;
/// Most levels of a hierarchy: the shaders' traversal keeps an entry per level and has room for 32; the size of the
/// host's stack follows from this.
pub const MAX_LEVELS: usize = 31;
/// Triangles of a leaf: as many as a compressed node can hold.
const LEAF: u32 = 3;
/// Boxes from which on work is shared between threads.
const SHARED: usize = 1 << 14;

/// The hierarchy of some triangles, of which there is at least one. A triangle that is much larger than others may be
/// in several leaves.
pub fn build(triangles: Vec<Triangle>) -> CwBvh {
    let mut boxes: Vec<Aabb> = triangles.iter().map(|t| t.aabb()).collect();
    let mut triangle_of: Vec<u32> = (0..triangles.len() as u32).collect();
    let largest = boxes.iter().map(Aabb::half_area).fold(0.0, f32::max);
    let mean = boxes.iter().map(Aabb::half_area).sum::<f32>() / boxes.len() as f32;
    split_aabbs_preset(&mut boxes, &mut triangle_of, &triangles, mean, largest);
    drop(triangles);

    let packed = |heuristic_levels| {
        let mut nodes = vec![Bvh2Node::default(); 2 * boxes.len() - 1];
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let (root, below) = nodes.split_at_mut(1);
        let all = Subtree { root: &mut root[0], below, below_at: 1, items: &mut order, items_at: 0, heuristic_levels };
        subdivide(&boxes, all);
        let primitive_indices = order.into_iter().map(|item| triangle_of[item as usize]).collect();
        let binary = Bvh2 { nodes, primitive_indices, uses_spatial_splits: true, ..Bvh2::default() };
        bvh2_to_cwbvh(&binary, LEAF, true, false)
    };
    let best = packed(HEURISTIC_LEVELS);
    if levels(&best) <= MAX_LEVELS {
        return best;
    }
    // Boxes without area, which obvhs does not pack: nearly all triangles in one place. Halving n boxes takes log2 n
    // levels.
    packed(MAX_LEVELS - boxes.len().next_power_of_two().ilog2() as usize)
}

/// Levels of a packed hierarchy.
fn levels(bvh: &CwBvh) -> usize {
    let mut deepest = 0;
    let mut open = vec![(0, 1)];
    while let Some((index, level)) = open.pop() {
        deepest = deepest.max(level);
        let node = &bvh.nodes[index as usize];
        // Inner children lie next to each other.
        open.extend((0..node.imask.count_ones()).map(|k| (node.child_base_idx + k, level + 1)));
    }
    deepest
}

/// A part of the binary hierarchy that is to be built, with the room for it: n boxes take a root and 2n − 2 nodes
/// below.
struct Subtree<'a> {
    root: &'a mut Bvh2Node,
    below: &'a mut [Bvh2Node],
    /// Index of `below` in the hierarchy.
    below_at: usize,
    /// Indices of its boxes.
    items: &'a mut [u32],
    /// Where they are among all.
    items_at: usize,
    /// Levels in which the heuristic still decides.
    heuristic_levels: usize,
}

fn subdivide(boxes: &[Aabb], tree: Subtree<'_>) {
    let Subtree { root, below, below_at, items, items_at, heuristic_levels } = tree;
    let bounds = bounds(boxes, items);
    if items.len() == 1 {
        *root = Bvh2Node::new(bounds.boxes, 1, items_at as u32);
        return;
    }
    *root = Bvh2Node::new(bounds.boxes, 0, below_at as u32);
    let split = (heuristic_levels > 0).then(|| best_split(boxes, items, &bounds.centres)).flatten();
    let middle = match split {
        Some(split) => partition(items, |item| split.is_left(&boxes[item as usize])),
        None => halve(boxes, items, bounds.centres.largest_axis()),
    };
    let (children, below) = below.split_at_mut(2);
    let (left_root, right_root) = children.split_at_mut(1);
    let (left_items, right_items) = items.split_at_mut(middle);
    let (left_below, right_below) = below.split_at_mut(2 * middle - 2);
    let shared = left_items.len() + right_items.len() > SHARED;
    let left = Subtree {
        root: &mut left_root[0],
        below_at: below_at + 2,
        below: left_below,
        items: left_items,
        items_at,
        heuristic_levels: heuristic_levels.saturating_sub(1),
    };
    let right = Subtree {
        root: &mut right_root[0],
        below_at: below_at + 2 * middle,
        below: right_below,
        items: right_items,
        items_at: items_at + middle,
        heuristic_levels: heuristic_levels.saturating_sub(1),
    };
    if shared {
        rayon::join(|| subdivide(boxes, left), || subdivide(boxes, right));
    } else {
        subdivide(boxes, left);
        subdivide(boxes, right);
    }
}

/// What holds some boxes, and what holds their centres.
struct Bounds {
    boxes: Aabb,
    centres: Aabb,
}

fn bounds(boxes: &[Aabb], items: &[u32]) -> Bounds {
    let empty = || Bounds { boxes: Aabb::empty(), centres: Aabb::empty() };
    let add = |mut bounds: Bounds, &item: &u32| {
        let found = &boxes[item as usize];
        bounds.centres.extend(found.center());
        Bounds { boxes: bounds.boxes.union(found), centres: bounds.centres }
    };
    let merge = |a: Bounds, b: Bounds| Bounds { boxes: a.boxes.union(&b.boxes), centres: a.centres.union(&b.centres) };
    shared(items, empty, |items| items.iter().fold(empty(), add), merge)
}

/// Boxes whose centres lie within a slice of an axis.
#[derive(Clone, Copy)]
struct Bin {
    bounds: Aabb,
    count: usize,
}

impl Bin {
    const EMPTY: Self = Self { bounds: Aabb { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY }, count: 0 };

    fn union(&self, other: &Self) -> Self {
        Self { bounds: self.bounds.union(&other.bounds), count: self.count + other.count }
    }

    /// What it costs to test its boxes, by the area in which a ray has to.
    fn cost(&self) -> f32 {
        self.bounds.half_area() * self.count as f32
    }
}

type Bins = [[Bin; BINS]; 3];

/// Which bin a centre is in, along each axis.
#[derive(Clone, Copy)]
struct Binning {
    origin: Vec3A,
    per_metre: Vec3A,
}

impl Binning {
    fn new(centres: &Aabb) -> Self {
        // Not quite BINS, so that the last centre falls into the last bin.
        Self { origin: centres.min, per_metre: 0.999 * BINS as f32 / centres.diagonal() }
    }

    fn bin(&self, of: &Aabb, axis: usize) -> usize {
        (((of.center() - self.origin) * self.per_metre)[axis] as usize).min(BINS - 1)
    }
}

/// A plane that tells boxes by their centres: those in bins before `bin` are on its left.
struct Split {
    binning: Binning,
    axis: usize,
    bin: usize,
}

impl Split {
    fn is_left(&self, of: &Aabb) -> bool {
        self.binning.bin(of, self.axis) < self.bin
    }
}

/// The split of least expected cost; `None` where all centres are the same.
fn best_split(boxes: &[Aabb], items: &[u32], centres: &Aabb) -> Option<Split> {
    let binning = Binning::new(centres);
    let empty = || Box::new([[Bin::EMPTY; BINS]; 3]);
    let bins = shared(
        items,
        empty,
        |items| {
            let mut bins: Box<Bins> = empty();
            for &item in items {
                let found = Bin { bounds: boxes[item as usize], count: 1 };
                for (axis, bins) in bins.iter_mut().enumerate() {
                    let bin = &mut bins[binning.bin(&found.bounds, axis)];
                    *bin = bin.union(&found);
                }
            }
            bins
        },
        |mut a, b| {
            a.iter_mut().flatten().zip(b.iter().flatten()).for_each(|(a, b)| *a = a.union(b));
            a
        },
    );
    let mut best: Option<(f32, usize, usize)> = None;
    for (axis, bins) in bins.iter().enumerate() {
        let mut right = [Bin::EMPTY; BINS];
        let mut beyond = Bin::EMPTY;
        for bin in (1..BINS).rev() {
            beyond = beyond.union(&bins[bin]);
            right[bin] = beyond;
        }
        let mut left = Bin::EMPTY;
        for bin in 1..BINS {
            left = left.union(&bins[bin - 1]);
            if left.count == 0 || right[bin].count == 0 {
                continue;
            }
            let cost = left.cost() + right[bin].cost();
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, bin));
            }
        }
    }
    best.map(|(_, axis, bin)| Split { binning, axis, bin })
}

/// Moves what is on the left before what is not, and says how much is.
fn partition(items: &mut [u32], is_left: impl Fn(u32) -> bool) -> usize {
    let mut middle = 0;
    for i in 0..items.len() {
        if is_left(items[i]) {
            items.swap(i, middle);
            middle += 1;
        }
    }
    middle
}

/// Moves the half whose centres are further left before the others, and says how many they are.
fn halve(boxes: &[Aabb], items: &mut [u32], axis: usize) -> usize {
    let middle = items.len() / 2;
    let centre = |item: u32| boxes[item as usize].center_axis(axis);
    items.select_nth_unstable_by(middle, |&a, &b| centre(a).total_cmp(&centre(b)));
    middle
}

/// Sums up items, between threads where there are many. Whatever the threads, the result is the same: minima and
/// maxima.
fn shared<T: Send>(
    items: &[u32],
    empty: impl Fn() -> T + Sync + Send,
    sum: impl Fn(&[u32]) -> T + Sync + Send,
    merge: impl Fn(T, T) -> T + Sync + Send,
) -> T {
    if items.len() <= SHARED {
        return sum(items);
    }
    items.par_chunks(SHARED).map(sum).reduce(empty, merge)
}

#[cfg(test)]
mod tests {
    use obvhs::cwbvh::node::CwBvhNode;

    use super::*;
    use crate::rng::hash2;

    fn unit(i: u32, k: u32) -> f32 {
        hash2(i, k) as f32 / u32::MAX as f32
    }

    /// Triangles of a size at places.
    fn triangles(count: u32, place: impl Fn(u32) -> Vec3A, size: f32) -> Vec<Triangle> {
        let edge = |i, k: u32| size * Vec3A::new(unit(i, k), unit(i, k + 1), unit(i, k + 2));
        (0..count).map(|i| Triangle { v0: place(i), v1: place(i) + edge(i, 10), v2: place(i) + edge(i, 20) }).collect()
    }

    /// How many nodes a ray that crosses everything is expected to visit: the areas of their boxes by that of the
    /// whole.
    fn expected_visits(bvh: &CwBvh) -> f32 {
        let inner =
            |node: &CwBvhNode| (0..8).filter(|&child| !node.is_leaf(child)).map(|c| node.child_aabb(c)).collect();
        let boxes: Vec<Aabb> = bvh.nodes.iter().flat_map(|node| -> Vec<Aabb> { inner(node) }).collect();
        1.0 + boxes.iter().map(Aabb::half_area).sum::<f32>() / bvh.total_aabb.half_area()
    }

    /// The six sides of a cube, each a grid of squares cut in two.
    fn room(squares: u32) -> Vec<Triangle> {
        let at = |side: u32, x: u32, y: u32| {
            let [x, y] = [x, y].map(|v| v as f32 / squares as f32);
            let mut p = [x, y, (side % 2) as f32];
            p.rotate_right((side / 2) as usize);
            Vec3A::from(p)
        };
        let square = |side, x, y| {
            let [a, b, c, d] = [at(side, x, y), at(side, x + 1, y), at(side, x + 1, y + 1), at(side, x, y + 1)];
            [Triangle { v0: a, v1: b, v2: c }, Triangle { v0: a, v1: c, v2: d }]
        };
        let cells = (0..6).flat_map(|side| (0..squares).flat_map(move |y| (0..squares).map(move |x| (side, x, y))));
        cells.flat_map(|(side, x, y)| square(side, x, y)).collect()
    }

    #[test]
    fn every_triangle_is_in_a_leaf() {
        let scattered = |i: u32| Vec3A::new(unit(i, 0), unit(i, 1), unit(i, 2));
        let one_place = |_: u32| Vec3A::ONE;
        // Eight in a place, the next half as far from the origin: bins part only few of them at a time.
        let crowding = |i: u32| Vec3A::splat(0.5f32.powi(i as i32 / 8));
        let cases = [
            triangles(1, scattered, 0.1),
            triangles(2, one_place, 0.0),
            triangles(3000, one_place, 0.0),
            triangles(1000, crowding, 1e-30),
            triangles(40_000, scattered, 0.01),
        ];
        for (case, triangles) in cases.iter().enumerate() {
            let bvh = build(triangles.clone());
            let mut found = vec![false; triangles.len()];
            bvh.primitive_indices.iter().for_each(|&t| found[t as usize] = true);
            assert!(found.iter().all(|found| *found), "case {case}");
            assert!(levels(&bvh) <= MAX_LEVELS, "case {case}: {}", levels(&bvh));
            bvh.validate(triangles, false);
        }
    }

    #[test]
    fn finer_triangles_hardly_make_more_nodes_to_visit() {
        let [coarse, fine] = [room(20), room(120)];
        let growth =
            |build: &dyn Fn(&[Triangle]) -> CwBvh| expected_visits(&build(&fine)) / expected_visits(&build(&coarse));
        let bottom_up = |triangles: &[Triangle]| {
            let params = obvhs::BvhBuildParams::medium_build();
            obvhs::cwbvh::builder::build_cwbvh_from_tris(triangles, params, &mut Default::default())
        };
        let (ours, theirs) = (growth(&|triangles| build(triangles.to_vec())), growth(&bottom_up));
        assert!(ours < 2.0, "{ours}");
        assert!(theirs > 2.0 * ours, "the control: {theirs} and {ours}");
    }

    #[test]
    fn threads_do_not_change_it() {
        let scattered = |i: u32| Vec3A::new(unit(i, 0), unit(i, 1), unit(i, 2));
        let triangles = triangles(50_000, scattered, 0.01);
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let alone = alone.install(|| build(triangles.clone()));
        let together = build(triangles);
        assert_eq!(alone.primitive_indices, together.primitive_indices);
        assert_eq!(bytemuck::cast_slice::<_, u8>(&alone.nodes), bytemuck::cast_slice::<_, u8>(&together.nodes));
    }
}
