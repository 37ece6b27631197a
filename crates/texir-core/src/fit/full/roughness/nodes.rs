//! Which of the tabulated roughnesses a scan solves, and what it finds between them.

use crate::specular_table::NODES;

/// The nodes that are solved, from rough to smooth: every `every`th, and the smoothest.
pub fn solved(every: usize) -> Vec<usize> {
    let mut nodes: Vec<usize> = (0..NODES).rev().step_by(every.max(1)).collect();
    if nodes.last() != Some(&0) {
        nodes.push(0);
    }
    nodes
}

/// The nodes that are not `solved`.
pub fn between(solved: &[usize]) -> impl Iterator<Item = Between> {
    (0..NODES).filter(|node| !solved.contains(node)).map(|node| Between::new(solved, node))
}

/// A node between solved ones. What it has is that of a cubic through the nearest four (Lagrange): curves over nodes
/// are smooth.
pub struct Between {
    /// Which it is.
    pub node: usize,
    /// What each of the others counts.
    weights: Vec<(usize, f32)>,
}

impl Between {
    fn new(solved: &[usize], node: usize) -> Self {
        let mut nearest = solved.to_vec();
        nearest.sort_by_key(|k| k.abs_diff(node));
        nearest.truncate(4);
        let apart = |a: usize, b: usize| a as f32 - b as f32;
        let weight = |k: usize| -> f32 {
            nearest.iter().filter(|other| **other != k).map(|other| apart(node, *other) / apart(k, *other)).product()
        };
        Self { node, weights: nearest.iter().map(|k| (*k, weight(*k))).collect() }
    }

    /// The value of what has these at the solved nodes.
    pub fn at(&self, value: impl Fn(usize) -> f32) -> f32 {
        self.weights.iter().map(|(k, weight)| weight * value(*k)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubics_are_told_from_every_second_node_and_from_fewer() {
        let cubic = |k: usize| {
            let t = k as f32 / NODES as f32 - 0.4;
            0.3 + t - 2.0 * t * t + 3.0 * t * t * t
        };
        for every in [2, 3, 5] {
            let solved = solved(every);
            let found: Vec<Between> = between(&solved).collect();
            assert_eq!(found.len() + solved.len(), NODES);
            for node in found {
                let error = (node.at(cubic) - cubic(node.node)).abs();
                assert!(error < 1e-5, "{error} at node {} of every {every}", node.node);
            }
        }
        // Negative control: what has a corner is not.
        let corner = |k: usize| (k as f32 - 16.0).abs();
        let error = |node: Between| (node.at(corner) - corner(node.node)).abs();
        assert!(between(&solved(2)).map(error).fold(0.0, f32::max) > 0.1);
    }

    #[test]
    fn both_ends_are_solved() {
        assert!(between(&solved(1)).next().is_none());
        for every in [1, 2, 3, 31, 32, 1000] {
            let solved = solved(every);
            assert_eq!([solved[0], solved[solved.len() - 1]], [NODES - 1, 0]);
            assert!(solved.is_sorted_by(|a, b| a > b));
        }
    }
}
