//! Priors on a group's roughness, and shrinkage towards them.

use rayon::prelude::*;

use super::evidence::{Tally, minimum};
use crate::specular_table::node;

/// A prior on a group's roughness: the penalty (weight + pseudo_count/n) (2 (r − roughness))² beside ln(mean cost).
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// Its mean.
    pub roughness: f32,
    /// Constant weight, whatever the group's pixels.
    pub weight: f32,
    /// Weight as of so many pixels: it counts less the more pixels the group has.
    pub pseudo_count: f32,
}

impl Prior {
    /// One of constant weight.
    pub fn weighted(roughness: f32, weight: f32) -> Self {
        Self { roughness, weight, pseudo_count: 0.0 }
    }

    /// One that counts as so many pixels.
    pub fn pseudo_pixels(roughness: f32, pseudo_count: f32) -> Self {
        Self { roughness, weight: 0.0, pseudo_count }
    }
}

/// Roughness of every group by its pixels, shrunk to its `priors`. A group without pixels takes the mean of its priors
/// by their pseudo-counts, or else by their weights.
pub fn shrink<const N: usize>(groups: &[Tally], priors: &[[Prior; N]]) -> Vec<f32> {
    groups
        .par_iter()
        .zip(priors)
        .map(|(tally, priors)| {
            if tally.pixels == 0.0 {
                return mean(priors);
            }
            let objective = tally.objective();
            let drawn = |k: usize| -> f32 {
                let by = |p: &Prior| {
                    (p.weight + p.pseudo_count / tally.pixels as f32) * (2.0 * (node(k) - p.roughness)).powi(2)
                };
                priors.iter().map(by).sum()
            };
            minimum(&std::array::from_fn(|k| objective[k] + drawn(k)))
        })
        .collect()
}

/// The priors' own mean.
fn mean(priors: &[Prior]) -> f32 {
    let by = |weight: fn(&Prior) -> f32| {
        priors.iter().fold((0.0, 0.0), |(sum, all), p| (sum + weight(p) * p.roughness, all + weight(p)))
    };
    let (sum, all) = match by(|p| p.pseudo_count) {
        (_, 0.0) => by(|p| p.weight),
        by_count => by_count,
    };
    if all > 0.0 { sum / all } else { priors.iter().map(|p| p.roughness).sum::<f32>() / priors.len().max(1) as f32 }
}

#[cfg(test)]
mod tests {
    use half::f16;

    use super::super::evidence::Evidence;
    use super::*;
    use crate::specular_table::NODES;

    #[test]
    fn a_group_without_evidence_follows_its_parent_and_one_with_little_is_drawn_to_it() {
        let mut cost = [f16::ONE; NODES];
        cost[8] = f16::ZERO;
        let evidence = Evidence {
            segment: vec![0],
            cost: vec![cost],
            weight: vec![1.0],
            slope: vec![[0.0; NODES]; 2],
            variation: vec![],
        };
        let groups = evidence.by_segment();
        let settled = |pull, pixels| {
            let parents = [0.8, 0.6].map(|roughness| [Prior { roughness, weight: pull, pseudo_count: pixels }]);
            shrink(&groups, &parents)
        };
        let own = node(8);
        assert!((settled(0.0, 0.0)[0] - own).abs() < 1e-3 && settled(0.0, 0.0)[1] == 0.6);
        assert!(settled(100.0, 0.0)[0] > 0.75, "a strong prior wins");
        assert!(settled(0.0, 500.0)[0] > 0.75, "one pixel beside 500 is not believed");
        // Of several parents, those that count as pixels speak where there are none.
        let mean = |parents: [Prior; 3]| shrink(&groups, &[parents; 2])[1];
        let [near, far, room] =
            [Prior::pseudo_pixels(0.2, 30.0), Prior::pseudo_pixels(0.6, 10.0), Prior::weighted(0.9, 0.3)];
        assert!((mean([near, far, room]) - 0.3).abs() < 1e-6 && (mean([room; 3]) - 0.9).abs() < 1e-6);
    }
}
