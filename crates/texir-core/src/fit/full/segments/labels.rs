//! Labels of texels, semantic classes or rooms, by the votes of the views' pixels.
//!
//! Every texel asks each view that sees it for the label of the pixel that shows it. Segmentations are wrong in other
//! places in every view, but in regions rather than pixels: votes are therefore weighed nearly alike over the views, so
//! that the nearest does not decide alone, and blurred over the surface.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::capture::View;
use crate::error::Result;
use crate::fit::adjacency::Adjacency;
use crate::fit::full::segments::surfaces;
use crate::progress::{Progress, Task};
use crate::raster::Mask;
use crate::stats::median;
use crate::surface::SurfacePoint;
use crate::tbl::shown::{VisibleSurfaces, pixels_per_steradian};
use crate::texture::SparseRows;

/// Surfaces seen at a smaller cosine have no vote: the pixel's neighbour may be metres away on them.
const MIN_COSINE: f32 = 0.1;
/// Exponent of a view's resolution (pixels per square metre of surface) in its vote: who is near sees edges best, but
/// is mistaken as often as others.
const SHARPNESS: f32 = 0.25;
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
/// Semantic images of which a smaller share of the votes agrees are of something else: of other photos, or not of
/// classes.
const AGREED: f32 = 0.7;
/// Texels whose normals' cosine is less do not share votes: classes end at creases.
const SAME_NORMAL: f32 = 0.9;

/// Labels of every texel, as far as they are known.
pub struct Labels {
    /// The flat surface that each texel is part of.
    pub surface: Vec<u32>,
    /// The texels of thin things, each with the one on the other side.
    pub backs: Vec<[u32; 2]>,
    /// Semantic class, as the views voted; `None` where there is no vote around.
    pub class: Vec<Option<u16>>,
    /// Room as the capture names them, likewise.
    pub room: Vec<Option<u16>>,
}

impl Labels {
    /// Lets the views vote.
    pub fn vote(
        backend: &mut dyn Backend,
        (atlas, adjacency): (&Atlas, &Adjacency),
        views: &[View],
        progress: &dyn Progress,
    ) -> Result<Self> {
        let has_labels = |v: &&View| v.semantic.is_some() || v.room.is_some() || v.room_id.is_some();
        let _task = Task::start(progress, "labels", views.iter().filter(has_labels).count() as u64, "views");
        let [mut class, mut room] = [Votes::default(), Votes::default()];
        for view in views.iter().filter(has_labels) {
            progress.check()?;
            let (classes, rooms) = (view.load_semantic()?, view.load_room()?);
            let votes = texel_votes(backend, atlas, view, view.load_mask()?.as_ref())?;
            class.add(&votes, |pixel| classes.as_ref().map_or(0, |ids| ids.data[pixel]));
            let of_view = view.room_id.unwrap_or(0);
            room.add(&votes, |pixel| rooms.as_ref().map_or(of_view, |ids| ids.data[pixel]));
            progress.advance(1);
        }
        let agreed = class.agreement();
        if agreed < AGREED {
            progress.warn(&format!(
                "semantic_path: of the views' votes on each texel's class, {:.0} % agrees with the majority; expected nearly all. Do \
                 the images belong to these photos, and are their ids classes, the same in every view?",
                100.0 * agreed
            ));
        }
        let scene = backend.scene();
        let surface = surfaces::flat_surfaces(atlas, adjacency);
        let backs = surfaces::backs(scene, atlas);
        let (sharing, texel) = (sharing(atlas, adjacency), atlas.typical_texel(scene.mesh()));
        class.blur(&sharing, texel);
        room.blur(&sharing, texel);
        drop(sharing);
        class.share(&backs);
        let [class, room] = [class, room].map(|votes| votes.count(&surface));
        Ok(Self { surface, backs, class, room })
    }

    /// Whether views have semantic classes.
    pub fn has_classes(&self) -> bool {
        self.class.iter().any(Option::is_some)
    }
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

/// The pixel of a view that shows a texel.
pub struct Vote {
    /// Index of the pixel.
    pub pixel: usize,
    /// What its vote counts.
    pub weight: f32,
}

/// The votes for every texel in a view, where the view sees it and `mask` does not exclude the pixel. Rays are only
/// traced from texels whose pixel shows their surface: the others are not seen there anyway.
pub fn texel_votes(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    view: &View,
    mask: Option<&Mask>,
) -> Result<Vec<Option<Vote>>> {
    let camera = &view.camera;
    let shown = VisibleSurfaces::new(backend, camera)?;
    let candidate = |(texel, point): (usize, &SurfacePoint)| {
        let position = Vec3::from(point.position);
        let faces_camera = Vec3::from(point.normal).dot(camera.position() - position) > 0.0;
        let at = faces_camera.then(|| camera.project(position))??;
        let pixel = camera.pixel(at.x as i64, at.y as i64)?;
        let usable = mask.is_none_or(|mask| mask.data[pixel]);
        let shows = usable && shown.shows(pixel, point, position.distance(camera.position()));
        shows.then_some((texel, pixel))
    };
    let candidates: Vec<(usize, usize)> = atlas.points.par_iter().enumerate().filter_map(candidate).collect();
    let points: Vec<SurfacePoint> = candidates.iter().map(|(texel, _)| atlas.points[*texel]).collect();
    let mut votes: Vec<Option<Vote>> = atlas.points.iter().map(|_| None).collect();
    for ((texel, pixel), at) in candidates.into_iter().zip(backend.project(&points, camera)?) {
        if at.distance > 0.0 && at.cosine >= MIN_COSINE {
            let resolution = pixels_per_steradian(camera) * at.cosine / (at.distance * at.distance);
            votes[texel] = Some(Vote { pixel, weight: resolution.powf(SHARPNESS) });
        }
    }
    Ok(votes)
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
    fn agreement(&self) -> f32 {
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
pub(super) fn rounds(deviation: f32, size: f32) -> usize {
    ((deviation / size).powi(2) / VARIANCE_PER_ROUND).min(MAX_ROUNDS).round() as usize
}

#[cfg(test)]
mod tests {
    use std::hash::{DefaultHasher, Hash, Hasher};
    use std::path::PathBuf;
    use std::sync::Arc;

    use super::*;
    use crate::camera::Camera;
    use crate::capture::Split;
    use crate::cpu::CpuBackend;
    use crate::fit::full::segments::spread;
    use crate::raster::Labels;
    use crate::scene::Scene;
    use crate::surface::Hit;
    use crate::tbl::tests::{panorama, room};

    /// Walls with a door, a floor with a rug, a ceiling. By triangle: a texel on a crease lies in two surfaces.
    fn class(triangle: u32, p: Vec3) -> u16 {
        let rug = (p.x - 2.2).abs() < 0.8 && (p.y - 1.4).abs() < 0.6;
        let door = (p.x - 1.2).abs() < 0.45 && p.z < 2.0;
        match triangle / 2 {
            0 if rug => 5,
            0 => 2,
            1 => 3,
            2 if door => 4,
            _ => 1,
        }
    }

    /// A number in [0, 1) that belongs to `of`.
    fn chance(of: impl Hash) -> f32 {
        let mut hasher = DefaultHasher::new();
        of.hash(&mut hasher);
        (hasher.finish() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// One pixel in ten of some other class.
    fn speckled(labels: &Labels, view: usize) -> Labels {
        let wrong = |(i, id): (usize, &u16)| match chance((view, i)) < 0.1 {
            true => 1 + (id + (4.0 * chance((view, i, "class"))) as u16) % 5,
            false => *id,
        };
        Labels { data: labels.data.iter().enumerate().map(wrong).collect(), ..*labels }
    }

    /// Discs of wrong classes, on a tenth of the pixels.
    fn blotched(labels: &Labels, view: usize) -> Labels {
        let mut blotched = labels.clone();
        let (width, height) = (labels.width as f32, labels.height as f32);
        for disc in 0.. {
            let [x, y, radius, id] = std::array::from_fn(|k| chance((view, disc, k)));
            for (i, pixel) in blotched.data.iter_mut().enumerate() {
                let dx = (i % labels.width) as f32 - x * width;
                let dy = (i / labels.width) as f32 - y * height;
                if dx.hypot(dy) < 4.0 + 10.0 * radius {
                    *pixel = 1 + (5.0 * id) as u16;
                }
            }
            let wrong = blotched.data.iter().zip(&labels.data).filter(|(a, b)| a != b).count();
            if 10 * wrong >= labels.data.len() {
                break;
            }
        }
        blotched
    }

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

    #[test]
    fn views_that_are_wrong_on_a_tenth_of_their_pixels_outvote_each_other() {
        let scene = Arc::new(Scene::new(room()).unwrap());
        let mut backend = CpuBackend::new(scene.clone());
        let atlas = Atlas::new(&mut backend, [192, 128]).unwrap();
        let adjacency = Adjacency::new(scene.mesh(), &atlas);
        let truth: Vec<u16> = atlas.points.iter().map(|p| class(p.triangle, p.position.into())).collect();
        let places = [[0.7, 0.6], [3.3, 0.7], [0.8, 2.4], [3.2, 2.3], [2.0, 1.5], [1.3, 1.6]];
        let views = places.map(|[x, y]| {
            let camera = Camera { width: 256, height: 128, ..panorama(Vec3::new(x, y, 1.3), x) };
            View::new(x.to_string(), camera, Split::Train, PathBuf::new())
        });
        let mut right = |wrong: fn(&Labels, usize) -> Labels, views: &[View]| {
            let mut votes = Votes::default();
            let mut seen = vec![false; truth.len()];
            for (i, view) in views.iter().enumerate() {
                let Camera { width, height, .. } = view.camera;
                let hits = backend.primary(&view.camera, view.camera.rows()).unwrap();
                let shows = |(pixel, hit): (usize, &Hit)| {
                    let direction = view.camera.direction_of(pixel);
                    class(hit.triangle, view.camera.position() + direction * hit.t)
                };
                let labels = Labels::new(width, height, hits.iter().enumerate().map(shows).collect()).unwrap();
                let labels = wrong(&labels, i);
                let of_view = texel_votes(&mut backend, &atlas, view, None).unwrap();
                seen.iter_mut().zip(&of_view).for_each(|(seen, vote)| *seen |= vote.is_some());
                votes.add(&of_view, |pixel| labels.data[pixel]);
            }
            votes.blur(&sharing(&atlas, &adjacency), atlas.typical_texel(scene.mesh()));
            let fused = spread(votes.count(&surfaces::flat_surfaces(&atlas, &adjacency)), &adjacency, |_| 0);
            let all = seen.iter().filter(|seen| **seen).count();
            let right = (0..truth.len()).filter(|&t| seen[t] && fused[t] == truth[t]).count();
            right as f64 / all as f64
        };
        let clean = right(|labels, _| labels.clone(), &views);
        let (speckles, blotches, alone) =
            (right(speckled, &views), right(blotched, &views), right(blotched, &views[..1]));
        assert!(clean > 0.985, "{clean} of the texels are right when all pixels are");
        assert!(speckles > 0.97, "{speckles} of the texels are right");
        assert!(blotches > 0.97, "{blotches} of the texels are right");
        // Negative control: nobody to outvote the one view.
        assert!(alone < 0.95, "{alone} of the texels are right in one view alone");
    }
}
