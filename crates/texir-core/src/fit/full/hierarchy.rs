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

use super::kin::{self, Known};
use super::parent::{Parent, settle};
use super::scan::Tally;
use super::segments::Segments;
use crate::fit::settings::RoughnessSettings;

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
