//! From evidence per pixel to roughness per texel: shrinkage along a hierarchy of ever smaller groups.
//!
//! Each group takes the roughness that explains its n pixels best, drawn to its parents': the minimum over r of ln(mean
//! cost(r)) + Σ (pull + n_parent/n) · (2 (r − r_parent))², for a segment with what its albedo says besides
//! ([`super::variation`]). The logarithm makes it the likelihood of residuals whose size is not known beforehand: what
//! is explained badly at any roughness says little about it. It does not grow with the number of pixels; what grows
//! with that is how little a parent counts beside it, unless its pull is for good: what goes wrong here (irradiance,
//! the BRDF model) is systematic and does not average out. Distances are those of r itself, in which steps look alike:
//! by ln r, a mirror would be further from what lies between it and chalk than chalk is.

use glam::Vec3A;
use rayon::prelude::*;

use super::kin::{self, Known};
use super::scan::{Tally, minimum};
use super::segments::Segments;
use crate::fit::settings::RoughnessSettings;
use crate::specular_table::node;

/// What a group is drawn to.
#[derive(Clone, Copy, Debug)]
pub struct Parent {
    /// Its roughness.
    pub roughness: f32,
    /// How much that weighs however many pixels the group has,
    pub pull: f32,
    /// and besides, as so many pixels.
    pub pixels: f32,
}

impl Parent {
    /// One that draws every group alike.
    pub fn pulling(roughness: f32, pull: f32) -> Self {
        Self { roughness, pull, pixels: 0.0 }
    }

    /// One whose roughness counts as that of so many pixels.
    pub fn of_pixels(roughness: f32, pixels: f32) -> Self {
        Self { roughness, pull: 0.0, pixels }
    }
}

/// Roughness of every group, by what its pixels say, each drawn to its parents. A group without evidence takes the mean
/// of its parents by the pixels that they count as, or else by their pulls.
pub fn settle<const N: usize>(groups: &[Tally], parents: &[[Parent; N]]) -> Vec<f32> {
    groups
        .par_iter()
        .zip(parents)
        .map(|(tally, parents)| {
            if tally.pixels == 0.0 {
                return mean(parents);
            }
            let against = tally.against();
            let drawn = |k: usize| -> f32 {
                let by =
                    |p: &Parent| (p.pull + p.pixels / tally.pixels as f32) * (2.0 * (node(k) - p.roughness)).powi(2);
                parents.iter().map(by).sum()
            };
            minimum(&std::array::from_fn(|k| against[k] + drawn(k)))
        })
        .collect()
}

/// What parents say by themselves.
fn mean(parents: &[Parent]) -> f32 {
    let by = |weight: fn(&Parent) -> f32| {
        parents.iter().fold((0.0, 0.0), |(sum, all), p| (sum + weight(p) * p.roughness, all + weight(p)))
    };
    let (sum, all) = match by(|p| p.pixels) {
        (_, 0.0) => by(|p| p.pull),
        said => said,
    };
    if all > 0.0 { sum / all } else { parents.iter().map(|p| p.roughness).sum::<f32>() / parents.len().max(1) as f32 }
}

/// Roughness of every segment: everything → class → class in a room → segment, which is drawn to what it is akin to
/// besides. `tallies` are what the pixels of the segments say, `colours` their [`kin::colours`].
pub fn of_segments(
    segments: &Segments,
    tallies: &[Tally],
    colours: &[Option<Vec3A>],
    settings: &RoughnessSettings,
) -> Vec<f32> {
    let s = settings;
    let class_of = |i: usize| usize::from(segments.class[i]);
    let room_of = |i: usize| segments.class_in_room[i] as usize;
    let all = settle(&[Tally::sum(tallies.iter())], &[[Parent::pulling(s.start, s.class_pull)]])[0];
    let classes = summed(tallies, class_of);
    let class = settle(&classes, &vec![[Parent::pulling(all, s.class_pull)]; classes.len()]);
    let rooms = summed(tallies, room_of);
    let mut parent = vec![[Parent::pulling(all, s.room_pull)]; rooms.len()];
    (0..tallies.len()).for_each(|i| parent[room_of(i)] = [Parent::pulling(class[class_of(i)], s.room_pull)]);
    let room = settle(&rooms, &parent);

    let of_room: Vec<Parent> = (0..tallies.len()).map(|i| Parent::pulling(room[room_of(i)], s.segment_pull)).collect();
    let alone = settle(tallies, &of_room.iter().map(|room| [*room]).collect::<Vec<_>>());
    let known = |i: usize| Known {
        class: segments.class[i],
        class_in_room: segments.class_in_room[i],
        colour: colours[i],
        roughness: alone[i].min(s.cap),
        believed: tallies[i].pixels as f32 / (tallies[i].pixels as f32 + s.segment_pixels),
    };
    let known: Vec<Known> = (0..tallies.len()).map(known).collect();
    let parents: Vec<[Parent; 2]> =
        of_room.into_iter().zip(kin::parents(&known, s)).map(|(room, kin)| [room, kin]).collect();
    settle(tallies, &parents).into_iter().map(|r| r.min(s.cap)).collect()
}

/// What larger groups say: `of` tells which of them each is in.
fn summed(tallies: &[Tally], of: impl Fn(usize) -> usize) -> Vec<Tally> {
    let groups = (0..tallies.len()).map(&of).max().map_or(0, |last| last + 1);
    let mut sums = vec![Tally::default(); groups];
    tallies.iter().enumerate().for_each(|(i, tally)| sums[of(i)].merge(tally));
    sums
}
