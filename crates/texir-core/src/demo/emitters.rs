//! The emitting surfaces as lamps to draw light samples from.

use glam::{Vec2, Vec3};

use super::Flat;
use crate::mesh::bounds;

/// How much likelier a lamp in the room of the lit point is than an equal one elsewhere: light from another room has to
/// come through a doorway.
const SAME_ROOM: f32 = 10.0;

/// A point drawn on an emitter.
pub(super) struct EmitterSample {
    pub position: Vec3,
    pub normal: Vec3,
    pub uv: Vec2,
    /// Density per area, 1/m².
    pub pdf: f32,
}

/// One lamp or window pane: emitting charts that follow each other.
struct Lamp {
    room: u16,
    /// Emitted radiance times area, summed over the colours.
    power: f32,
    /// Bounding sphere.
    centre: Vec3,
    radius: f32,
    triangles: Vec<u32>,
    /// Cumulative probabilities of `triangles`, by power.
    cdf: Vec<f32>,
}

/// All lamps of a flat.
pub(super) struct Emitters {
    lamps: Vec<Lamp>,
    /// Per mesh triangle: its lamp and its density within it (1/m²); `None` for those that do not emit.
    owner: Vec<Option<(u32, f32)>>,
}

/// The probabilities with which lamps are drawn for one lit point: by power over squared distance, 0 for lamps that are
/// below its horizon.
pub(super) struct Choice {
    /// Cumulative, ending at 1; empty if nothing can light the point.
    cdf: Vec<f32>,
}

impl Emitters {
    pub fn new(flat: &Flat) -> Self {
        let mut emitters = Self { lamps: Vec::new(), owner: vec![None; flat.mesh.triangles.len()] };
        let mut groups: Vec<Vec<u32>> = Vec::new();
        let mut last = None;
        for (triangle, &chart) in (0..).zip(&flat.chart_of) {
            let look = &flat.charts[chart as usize].look;
            if look.paint.emission == Vec3::ZERO {
                continue;
            }
            let joins = last.is_some_and(|(previous, room)| chart - previous <= 1 && room == look.room);
            match groups.last_mut().filter(|_| joins) {
                Some(group) => group.push(triangle),
                None => groups.push(vec![triangle]),
            }
            last = Some((chart, look.room));
        }
        groups.into_iter().for_each(|group| emitters.add(flat, group));
        emitters
    }

    fn add(&mut self, flat: &Flat, triangles: Vec<u32>) {
        let look = |t: u32| &flat.charts[flat.chart_of[t as usize] as usize].look;
        let powers: Vec<f32> =
            triangles.iter().map(|&t| look(t).paint.emission.element_sum() * flat.mesh.area(t)).collect();
        let power: f32 = powers.iter().sum();
        let corners = || triangles.iter().flat_map(|&t| flat.mesh.corners(t));
        let (lo, hi) = bounds(corners());
        let centre = 0.5 * (lo + hi);
        let radius = corners().map(|p| p.distance(centre)).fold(0.0, f32::max);
        let mut sum = 0.0;
        let cdf = powers.iter().map(|p| (sum += p / power, sum).1).collect();
        for (&t, p) in triangles.iter().zip(&powers) {
            self.owner[t as usize] = Some((self.lamps.len() as u32, p / (power * flat.mesh.area(t))));
        }
        self.lamps.push(Lamp { room: look(triangles[0]).room, power, centre, radius, triangles, cdf });
    }

    /// Whether the triangle emits.
    pub fn contains(&self, triangle: u32) -> bool {
        self.owner[triangle as usize].is_some()
    }

    /// How lamps are drawn for a point in `room`.
    pub fn choice(&self, position: Vec3, normal: Vec3, room: u16) -> Choice {
        let mut sum = 0.0;
        let mut cdf: Vec<f32> = self
            .lamps
            .iter()
            .map(|lamp| {
                let way = lamp.centre - position;
                if normal.dot(way) + lamp.radius > 0.0 {
                    let near = if lamp.room == room { SAME_ROOM } else { 1.0 };
                    sum += near * lamp.power / way.length_squared().max(lamp.radius * lamp.radius);
                }
                sum
            })
            .collect();
        if sum > 0.0 {
            cdf.iter_mut().for_each(|value| *value /= sum);
        } else {
            cdf.clear();
        }
        Choice { cdf }
    }

    /// Density per area (1/m²) with which [`Self::sample`] draws a point of this triangle.
    pub fn pdf(&self, triangle: u32, choice: &Choice) -> f32 {
        self.owner[triangle as usize].map_or(0.0, |(lamp, within)| choice.probability(lamp as usize) * within)
    }

    /// Draws a point; `None` if no lamp is above the lit point's horizon.
    pub fn sample(
        &self,
        flat: &Flat,
        choice: &Choice,
        [pick, part]: [f32; 2],
        [u, v]: [f32; 2],
    ) -> Option<EmitterSample> {
        let lamp = choice.cdf.partition_point(|&sum| sum <= pick).min(choice.cdf.len().checked_sub(1)?);
        let lamp = &self.lamps[lamp];
        let triangle = lamp.triangles[lamp.cdf.partition_point(|&sum| sum <= part).min(lamp.triangles.len() - 1)];
        let root = u.sqrt();
        let weights = [1.0 - root, root * (1.0 - v), root * v];
        let [a, b, c] = flat.mesh.corners(triangle);
        let [ta, tb, tc] = flat.mesh.corner_uvs(triangle);
        Some(EmitterSample {
            position: a * weights[0] + b * weights[1] + c * weights[2],
            normal: flat.mesh.face_normal(triangle),
            uv: ta * weights[0] + tb * weights[1] + tc * weights[2],
            pdf: self.pdf(triangle, choice),
        })
    }
}

impl Choice {
    fn probability(&self, lamp: usize) -> f32 {
        let Some(&to) = self.cdf.get(lamp) else { return 0.0 };
        to - if lamp == 0 { 0.0 } else { self.cdf[lamp - 1] }
    }
}
