//! The emitting triangles as a set to draw light samples from.

use glam::{Vec2, Vec3};

use super::Flat;

/// How much likelier a lamp in the room of the lit point is than one of the same power elsewhere: light from another room
/// has to come through a doorway.
const SAME_ROOM: f32 = 8.0;

/// A point drawn on an emitter.
pub(super) struct EmitterSample {
    pub position: Vec3,
    pub normal: Vec3,
    pub uv: Vec2,
    /// Density per area, 1/m².
    pub pdf: f32,
}

/// Emitting triangles, drawn by power.
pub(super) struct Emitters {
    triangles: Vec<u32>,
    /// Per mesh triangle: 1 + its index in `triangles`, 0 for those that do not emit.
    slot: Vec<u32>,
    /// Per room id: the cumulative probabilities of `triangles`.
    cumulative: Vec<Vec<f32>>,
    areas: Vec<f32>,
}

impl Emitters {
    pub fn new(flat: &Flat) -> Self {
        let count = flat.mesh.triangles.len() as u32;
        let emission = |t: u32| flat.charts[flat.chart_of[t as usize] as usize].look.paint.emission;
        let triangles: Vec<u32> = (0..count).filter(|&t| emission(t) != Vec3::ZERO).collect();
        let mut slot = vec![0; count as usize];
        triangles.iter().zip(1..).for_each(|(&t, i)| slot[t as usize] = i);
        let areas: Vec<f32> = triangles
            .iter()
            .map(|&t| {
                let [a, b, c] = flat.mesh.corners(t);
                0.5 * (b - a).cross(c - a).length()
            })
            .collect();
        let rooms = flat.rooms.iter().map(|room| room.id).max().unwrap_or(0);
        let cumulative = (0..=rooms)
            .map(|room| {
                let mut sum = 0.0f64;
                let sums: Vec<f64> = triangles
                    .iter()
                    .zip(&areas)
                    .map(|(&t, &area)| {
                        let near = if flat.labels(t).1 == room { SAME_ROOM } else { 1.0 };
                        sum += f64::from(emission(t).element_sum() * area * near);
                        sum
                    })
                    .collect();
                sums.iter().map(|s| (s / sum) as f32).collect()
            })
            .collect();
        Self { triangles, slot, cumulative, areas }
    }

    /// Whether the triangle emits.
    pub fn contains(&self, triangle: u32) -> bool {
        self.slot[triangle as usize] != 0
    }

    /// Density per area (1/m²) with which [`Self::sample`] draws a point of this triangle for a lit point in `room`.
    pub fn pdf(&self, triangle: u32, room: u16) -> f32 {
        match self.slot[triangle as usize] {
            0 => 0.0,
            slot => {
                let i = slot as usize - 1;
                let sums = &self.cumulative[room as usize];
                let below = if i == 0 { 0.0 } else { sums[i - 1] };
                (sums[i] - below) / self.areas[i]
            }
        }
    }

    /// Draws a point for a lit point in `room`; `None` if nothing emits.
    pub fn sample(&self, flat: &Flat, room: u16, pick: f32, [u, v]: [f32; 2]) -> Option<EmitterSample> {
        let sums = &self.cumulative[room as usize];
        let i = sums.partition_point(|&sum| sum <= pick).min(self.triangles.len().checked_sub(1)?);
        let triangle = self.triangles[i];
        let root = u.sqrt();
        let weights = [1.0 - root, root * (1.0 - v), root * v];
        let [a, b, c] = flat.mesh.corners(triangle);
        let [ta, tb, tc] = flat.mesh.corner_uvs(triangle);
        Some(EmitterSample {
            position: a * weights[0] + b * weights[1] + c * weights[2],
            normal: flat.mesh.face_normal(triangle),
            uv: ta * weights[0] + tb * weights[1] + tc * weights[2],
            pdf: self.pdf(triangle, room),
        })
    }
}
