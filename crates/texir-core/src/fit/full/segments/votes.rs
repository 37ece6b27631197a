//! Votes on the label of every texel: shared with those around, and counted.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::fit::adjacency::Adjacency;
use crate::stats::median;
use crate::texture::SparseRows;

/// Votes are blurred by this standard deviation, metres: about two pixels' width of a panorama of 256 columns.
const BLUR: f32 = 0.07;
/// A round of the blur averages a texel with its four neighbours, which adds 2/5 of a texel squared to the variance.
const VARIANCE_PER_ROUND: f32 = 0.4;
/// Rounds at most, for their time; fine texels are blurred less far.
const MAX_ROUNDS: f32 = 24.0;
/// What has a smaller share of the votes than is usual on its flat surface is left to those around it: what one view
/// catches through a gap under a sofa is as often the sofa's leg.
const SCARCE: f32 = 0.3;
/// What votes on the other side of something thin count: seen at a grazing angle, a door's leaf is taken for the wall
/// behind it.
const OTHER_SIDE: f32 = 0.5;
/// Texels whose normals' cosine is less do not share votes: classes end at creases.
const SAME_NORMAL: f32 = 0.9;

/// The pixel of a view that shows a texel.
pub struct Vote {
    /// Index of the pixel.
    pub pixel: usize,
    /// What its vote counts.
    pub weight: f32,
}

/// The votes of all views; empty while nobody voted.
#[derive(Default)]
pub struct Votes(Vec<Ballot>);

/// Labels of a texel, 0 for none, and the weight of their votes; more labels than fit are dropped, the weakest first.
#[derive(Clone, Copy, Default)]
struct Ballot {
    labels: [u16; 6],
    weights: [f32; 6],
}

impl Ballot {
    fn votes(&self) -> impl Iterator<Item = (u16, f32)> {
        self.labels.into_iter().zip(self.weights)
    }

    fn add(&mut self, label: u16, weight: f32) {
        let weakest = || (0..self.weights.len()).min_by(|a, b| self.weights[*a].total_cmp(&self.weights[*b]));
        if let Some(known) = self.labels.iter().position(|l| *l == label) {
            self.weights[known] += weight;
        } else if let Some(weakest) = weakest()
            && self.weights[weakest] < weight
        {
            (self.labels[weakest], self.weights[weakest]) = (label, weight);
        }
    }

    /// Adds a share of another's votes.
    fn merge(&mut self, other: &Self, share: f32) {
        // As nearly everywhere.
        if self.labels == other.labels {
            self.weights.iter_mut().zip(other.weights).for_each(|(sum, weight)| *sum += share * weight);
        } else {
            other.votes().filter(|(label, _)| *label != 0).for_each(|(label, weight)| self.add(label, share * weight));
        }
    }

    /// All votes.
    fn weight(&self) -> f32 {
        self.weights.iter().sum()
    }

    /// The label with the most votes; the lower of two that are equal.
    fn winner(&self) -> Option<u16> {
        let most = self.votes().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        most.map(|(label, _)| label).filter(|label| *label != 0)
    }
}

impl Votes {
    /// A view's votes: `label` by pixel, of which 0 is none.
    pub fn add(&mut self, votes: &[Option<Vote>], label: impl Fn(usize) -> u16 + Sync) {
        self.0.resize(votes.len(), Ballot::default());
        self.0.par_iter_mut().zip(votes).for_each(|(ballot, vote)| {
            if let Some(Vote { pixel, weight }) = vote
                && label(*pixel) != 0
            {
                ballot.add(label(*pixel), *weight);
            }
        });
    }

    /// The share of all votes that go to the winner of their texel; 1 where there are none.
    pub fn agreement(&self) -> f32 {
        let most = |ballot: &Ballot| ballot.weights.into_iter().fold(0.0, f32::max);
        let [agreed, all] = (self.0.iter()).fold([0.0; 2], |[agreed, all], ballot| {
            [agreed + f64::from(most(ballot)), all + f64::from(ballot.weight())]
        });
        if all > 0.0 { (agreed / all) as f32 } else { 1.0 }
    }

    /// Lets texels share their votes with those around them ([`sharing`]), which are `texel` wide, metres.
    pub fn blur(&mut self, sharing: &SparseRows<u32>, texel: f32) {
        let Self(votes) = self;
        let mut before = votes.clone();
        for _ in 0..rounds(BLUR, texel) {
            std::mem::swap(votes, &mut before);
            let mean = |(t, mean): (usize, &mut Ballot)| {
                let around = sharing.row(t);
                *mean = before[t];
                around.iter().for_each(|n| mean.merge(&before[*n as usize], 1.0));
                mean.weights.iter_mut().for_each(|weight| *weight /= 1.0 + around.len() as f32);
            };
            votes.par_iter_mut().enumerate().for_each(mean);
        }
    }

    /// Gives each first texel of the pairs the second one's votes besides, at half their weight.
    pub fn share(&mut self, pairs: &[[u32; 2]]) {
        let Self(votes) = self;
        if votes.is_empty() {
            return;
        }
        let shared = |[to, from]: &[u32; 2]| {
            let mut ballot = votes[*to as usize];
            ballot.merge(&votes[*from as usize], OTHER_SIDE);
            (*to, ballot)
        };
        let shared: Vec<(u32, Ballot)> = pairs.par_iter().map(shared).collect();
        shared.into_iter().for_each(|(to, ballot)| votes[to as usize] = ballot);
    }

    /// The label of every texel, each being part of a flat `surface`; `None` where there are no votes around, or hardly
    /// any.
    pub fn count(self, surface: &[u32]) -> Vec<Option<u16>> {
        let Self(votes) = self;
        if votes.is_empty() {
            return vec![None; surface.len()];
        }
        let mut on_surface: HashMap<u32, Vec<f32>> = HashMap::new();
        for (ballot, &surface) in votes.iter().zip(surface).filter(|(ballot, _)| ballot.weight() > 0.0) {
            on_surface.entry(surface).or_default().push(ballot.weight());
        }
        let usual: HashMap<u32, f32> = on_surface
            .into_iter()
            .filter_map(|(surface, mut weights)| Some((surface, median(&mut weights)?)))
            .collect();
        let label =
            |(ballot, surface): (&Ballot, &u32)| ballot.winner().filter(|_| ballot.weight() >= SCARCE * usual[surface]);
        votes.iter().zip(surface).map(label).collect()
    }
}

/// Averages with the neighbours that blur by a standard deviation, metres, on texels `size` wide.
pub fn rounds(deviation: f32, size: f32) -> usize {
    ((deviation / size).powi(2) / VARIANCE_PER_ROUND).min(MAX_ROUNDS).round() as usize
}

/// Those around each texel that face as it does.
pub fn sharing(atlas: &Atlas, adjacency: &Adjacency) -> SparseRows<u32> {
    let normal = |t: u32| Vec3::from(atlas.points[t as usize].normal);
    let mut rows = SparseRows::default();
    for t in 0..atlas.points.len() as u32 {
        rows.push(adjacency.around(t).filter(|n| normal(t).dot(normal(*n)) >= SAME_NORMAL));
    }
    rows
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::cpu::CpuBackend;
    use crate::fit::full::segments::surfaces;
    use crate::scene::Scene;
    use crate::tbl::tests::room;

    #[test]
    fn views_agree_as_far_as_their_votes_go_to_one_label() {
        let votes = |of_views: &[[u16; 4]]| {
            let mut votes = Votes::default();
            for labels in of_views {
                let seen: Vec<_> = (0..4).map(|pixel| Some(Vote { pixel, weight: 2.0 })).collect();
                votes.add(&seen, |pixel| labels[pixel]);
            }
            votes.agreement()
        };
        assert_eq!(votes(&[]), 1.0);
        // 0 is no vote.
        assert_eq!(votes(&[[1, 2, 3, 0], [1, 2, 3, 4], [1, 0, 3, 4]]), 1.0);
        assert_eq!(votes(&[[1, 1, 1, 1], [2, 1, 2, 1]]), 0.75);
        assert_eq!(votes(&[[1, 1, 1, 1], [2, 2, 2, 2], [3, 3, 3, 3], [4, 4, 4, 4]]), 0.25);
    }

    #[test]
    fn what_hardly_any_view_votes_for_is_left_open() {
        let scene = Arc::new(Scene::new(room()).unwrap());
        let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), [192, 128]).unwrap();
        let adjacency = Adjacency::new(scene.mesh(), &atlas);
        let islet = |t: usize| (Vec3::from(atlas.points[t].position) - Vec3::new(2.0, 1.5, 0.0)).length() < 0.4;
        let labels = |votes_on_islet: usize| {
            let mut votes = Votes::default();
            for view in 0..6 {
                let all = 0..atlas.points.len();
                let sees = |t: usize| (!islet(t) || view < votes_on_islet).then_some(Vote { pixel: t, weight: 1.0 });
                votes.add(&all.map(sees).collect::<Vec<_>>(), |t| if islet(t) { 2 } else { 1 });
            }
            votes.blur(&sharing(&atlas, &adjacency), atlas.typical_texel(scene.mesh()));
            votes.count(&surfaces::flat_surfaces(&atlas, &adjacency))
        };
        let middle = (0..atlas.points.len())
            .filter(|&t| islet(t))
            .min_by(|&a, &b| {
                let from_middle = |t: usize| Vec3::from(atlas.points[t].position).distance(Vec3::new(2.0, 1.5, 0.0));
                from_middle(a).total_cmp(&from_middle(b))
            })
            .unwrap();
        assert_eq!(labels(1)[middle], None);
        // Negative control: as many votes as elsewhere.
        assert_eq!(labels(6)[middle], Some(2));
    }

    #[test]
    fn the_front_of_something_thin_outvotes_its_back_where_many_more_views_see_it() {
        const DOOR: u16 = 4;
        const WALL: u16 = 1;
        // Texel 0 is the front, texel 1 the back.
        let labels = |of_front: usize, of_back: usize, pairs: &[[u32; 2]]| {
            let mut votes = Votes::default();
            for view in 0..of_front.max(of_back) {
                let sees = [(0, of_front), (1, of_back)]
                    .map(|(pixel, views)| (view < views).then_some(Vote { pixel, weight: 1.0 }));
                votes.add(&sees, |pixel| [DOOR, WALL][pixel]);
            }
            votes.share(pairs);
            votes.count(&[0, 1])
        };
        let pairs = [[0, 1], [1, 0]];
        assert_eq!(labels(5, 2, &pairs), [Some(DOOR); 2]);
        assert_eq!(labels(5, 0, &pairs), [Some(DOOR); 2]);
        // Negative controls: seen as often, and not thin.
        assert_eq!(labels(3, 3, &pairs), [Some(DOOR), Some(WALL)]);
        assert_eq!(labels(5, 2, &[]), [Some(DOOR), Some(WALL)]);
    }
}
