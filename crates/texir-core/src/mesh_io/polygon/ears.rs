//! Ear clipping: a corner goes whose triangle holds no other corner, until a triangle is left.
//!
//! Every corner of the outline stays one of a triangle, also where it is in line with those beside it (the crate earcut
//! leaves such out, and what another face has there would be a crack), and hostile outlines end in bounded time.

use std::collections::VecDeque;
use std::ops::Range;

use glam::DVec2;

use super::Outline;

/// So often, per corner, other corners may be looked at. Stars, combs and spirals of 50,000 corners take less than half
/// of it; what takes more has long rows of corners that are in line but for rounding, or crosses itself.
const LOOKS_PER_CORNER: usize = 2_000;

/// Triangles of a polygon, two fewer than corners. Where it crosses itself there may come a time without ears: what is
/// left then is cut as a fan, and has triangles that are turned over.
pub(super) fn clip(outline: &Outline) -> Vec<[usize; 3]> {
    let mut ring = Ring::new(outline);
    ring.clip_spikes();
    ring.find_reflex();
    ring.clip_ears();
    ring.with_rest_as_fan()
}

/// What is left of a polygon.
struct Ring<'a> {
    outline: &'a Outline,
    previous: Vec<usize>,
    next: Vec<usize>,
    is_clipped: Vec<bool>,
    /// Where the outline turns away from what it encloses, or goes straight on: only such corners can be in an ear's
    /// way. One that turns in goes on doing so, since ears make angles smaller.
    is_reflex: Vec<bool>,
    /// All that were reflex. The middle one parts those before it from those after it, in x; the middle of either half
    /// parts that in y, and so on.
    tree: Vec<usize>,
    bounds: [DVec2; 2],
    looks: usize,
    triangles: Vec<[usize; 3]>,
}

impl<'a> Ring<'a> {
    fn new(outline: &'a Outline) -> Self {
        let points = outline.points.iter().copied();
        let count = points.len();
        Self {
            outline,
            previous: (0..count).map(|i| (i + count - 1) % count).collect(),
            next: (0..count).map(|i| (i + 1) % count).collect(),
            is_clipped: vec![false; count],
            is_reflex: vec![false; count],
            tree: Vec::new(),
            bounds: [points.clone().fold(DVec2::INFINITY, DVec2::min), points.fold(DVec2::NEG_INFINITY, DVec2::max)],
            looks: 0,
            triangles: Vec::with_capacity(count - 2),
        }
    }

    fn left(&self) -> usize {
        self.next.len() - self.triangles.len()
    }

    fn corners(&self) -> impl Iterator<Item = usize> {
        (0..self.next.len()).filter(|i| !self.is_clipped[*i])
    }

    /// The triangle at a corner.
    fn triangle(&self, corner: usize) -> [usize; 3] {
        [self.previous[corner], corner, self.next[corner]]
    }

    /// Cuts a corner off; returns those beside it.
    fn clip(&mut self, corner: usize) -> [usize; 2] {
        let [before, _, after] = self.triangle(corner);
        self.triangles.push([before, corner, after]);
        self.is_clipped[corner] = true;
        self.is_reflex[corner] = false;
        (self.next[before], self.previous[after]) = (after, before);
        for beside in [before, after] {
            self.is_reflex[beside] &= self.outline.turn(self.triangle(beside)) <= 0.0;
        }
        [before, after]
    }

    /// Corners that repeat the one beside them, and those from which the outline goes back where it came from, enclose
    /// nothing, and hide how the outline turns.
    fn clip_spikes(&mut self) {
        let mut stack: Vec<usize> = self.corners().collect();
        while let Some(corner) = stack.pop()
            && self.left() > 3
        {
            if !self.is_clipped[corner] && self.is_spike(corner) {
                stack.extend(self.clip(corner));
            }
        }
    }

    fn is_spike(&self, corner: usize) -> bool {
        let triangle = self.triangle(corner);
        let [before, tip, after] = triangle.map(|i| self.outline.points[i]);
        self.outline.turn(triangle) == 0.0 && (before - tip).dot(after - tip) >= 0.0
    }

    fn find_reflex(&mut self) {
        let points = &self.outline.points;
        self.tree = self.corners().filter(|i| self.outline.turn(self.triangle(*i)) <= 0.0).collect();
        self.tree.iter().for_each(|i| self.is_reflex[*i] = true);
        part(&mut self.tree, points, 0);
    }

    /// Looks at every corner, and again at those beside an ear: no others become ears.
    fn clip_ears(&mut self) {
        let mut queue: VecDeque<usize> = self.corners().collect();
        let mut queued: Vec<u32> = self.is_clipped.iter().map(|is_clipped| u32::from(!is_clipped)).collect();
        while let Some(corner) = queue.pop_front()
            && self.left() > 3
            && self.looks < LOOKS_PER_CORNER * self.next.len()
        {
            queued[corner] -= 1;
            // A corner beside an ear waits for its last turn: of ears one beside the other, each is longer than the one
            // before.
            if queued[corner] == 0 && !self.is_clipped[corner] && self.is_ear(corner) {
                for beside in self.clip(corner) {
                    queue.push_back(beside);
                    queued[beside] += 1;
                }
            }
        }
    }

    fn is_ear(&mut self, corner: usize) -> bool {
        let triangle = self.triangle(corner);
        self.outline.turn(triangle) > 0.0 && !self.is_hindered(triangle, 0..self.tree.len(), 0, self.bounds)
    }

    /// Whether some of those corners of the tree that are within bounds are in a triangle.
    fn is_hindered(&mut self, triangle: [usize; 3], tree: Range<usize>, axis: usize, [low, high]: [DVec2; 2]) -> bool {
        if tree.is_empty() {
            return false;
        }
        self.looks += 1;
        let [a, b, c] = triangle.map(|i| self.outline.points[i]);
        let is_beside = |(from, to): (DVec2, DVec2)| {
            let inwards = (to - from).perp();
            let innermost = DVec2::select(inwards.cmpgt(DVec2::ZERO), high, low);
            inwards.dot(innermost - from) < 0.0
        };
        if [(a, b), (b, c), (c, a)].into_iter().any(is_beside) {
            return false;
        }
        let middle = tree.start + tree.len() / 2;
        let corner = self.tree[middle];
        if self.hinders(corner, triangle) {
            return true;
        }
        let (mut before, mut after) = (high, low);
        before[axis] = self.outline.points[corner][axis];
        after[axis] = before[axis];
        self.is_hindered(triangle, tree.start..middle, 1 - axis, [low, before])
            || self.is_hindered(triangle, middle + 1..tree.end, 1 - axis, [after, high])
    }

    /// Whether a corner is in the triangle at `b`.
    fn hinders(&self, corner: usize, [a, b, c]: [usize; 3]) -> bool {
        let is_in = |edge: [usize; 2]| self.outline.turn([edge[0], edge[1], corner]) >= 0.0;
        if !self.is_reflex[corner] || ![[a, b], [b, c], [c, a]].into_iter().all(is_in) {
            return false;
        }
        // An outline may come by a place again, as it does on its way to a hole and back. What goes into the triangle
        // from the ends of the cut has a reflex corner further in.
        let points = &self.outline.points;
        if points[corner] == points[a] || points[corner] == points[c] {
            return false;
        }
        let goes_in = |to: usize| self.outline.turn([b, c, to]) > 0.0 && self.outline.turn([b, to, a]) > 0.0;
        points[corner] != points[b] || goes_in(self.previous[corner]) || goes_in(self.next[corner])
    }

    fn with_rest_as_fan(mut self) -> Vec<[usize; 3]> {
        let rest: Vec<usize> = self.corners().collect();
        self.triangles.extend(rest.windows(2).skip(1).map(|edge| [rest[0], edge[0], edge[1]]));
        self.triangles
    }
}

/// Orders corners as [`Ring::tree`] has them.
fn part(corners: &mut [usize], points: &[DVec2], axis: usize) {
    if corners.len() < 2 {
        return;
    }
    let middle = corners.len() / 2;
    corners.select_nth_unstable_by(middle, |a, b| points[*a][axis].total_cmp(&points[*b][axis]));
    let (before, rest) = corners.split_at_mut(middle);
    part(before, points, 1 - axis);
    part(&mut rest[1..], points, 1 - axis);
}
