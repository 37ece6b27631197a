//! Where light arrives at all, however weak: random walks that ask for lamps at every place that they come to.

use crate::cpu::project::CLEAR_SHARE;
use crate::cpu::punctual::punctual;
use crate::cpu::sampling::{Frame, cosine_direction};
use crate::distribution::{cdf, sample_cdf};
use crate::mesh::Mesh;
use crate::punctual::Coefficients;
use crate::real::V3;
use crate::rng::{hash2, to_unit};
use crate::scene::Scene;
use crate::scene::trace::{Trace, TraceHit};
use crate::surface::{Hit, SurfacePoint};

/// What a walk survives at every surface: the albedo of all.
const ALBEDO: f32 = 0.5;

/// Numbers in [0, 1), one after the other.
pub(super) struct Random {
    seed: u32,
    drawn: u32,
}

impl Random {
    pub fn new(seed: u32) -> Self {
        Self { seed, drawn: 0 }
    }

    fn unit(&mut self) -> f32 {
        self.drawn += 1;
        to_unit(hash2(self.drawn, self.seed))
    }

    fn pair(&mut self) -> [f32; 2] {
        [self.unit(), self.unit()]
    }
}

/// Triangles that places are drawn from.
pub(super) struct Patch {
    pub triangles: Vec<u32>,
    /// Of their areas.
    cdf: Vec<f32>,
}

impl Patch {
    /// Of triangles of the mesh, one at least.
    pub fn new(mesh: &Mesh, triangles: Vec<u32>) -> Self {
        let areas: Vec<f32> = triangles.iter().map(|&triangle| mesh.area(triangle)).collect();
        Self { triangles, cdf: cdf(&areas) }
    }

    /// A place on its front, or else its back.
    pub fn place(&self, mesh: &Mesh, back: bool, random: &mut Random) -> SurfacePoint {
        let (index, _) = sample_cdf(self.cdf.len(), |i| self.cdf[i], random.unit());
        let triangle = self.triangles[index];
        let [mut u, mut v] = random.pair();
        if u + v > 1.0 {
            [u, v] = [1.0 - u, 1.0 - v];
        }
        let front = mesh.face_normal(triangle);
        SurfacePoint::new(mesh, &Hit { triangle, u, v, t: 0.0 }, Some(if back { -front } else { front }))
    }
}

/// What a triangle does to light, at its front and at its back.
#[derive(Clone, Copy, Default)]
pub(super) struct SidesOfTriangle {
    pub reflects: [bool; 2],
    pub shines: [bool; 2],
}

/// What light comes from, and what it meets on its way.
pub(super) struct Reach<'a> {
    pub scene: &'a Scene,
    /// Of every triangle.
    pub sides: Vec<SidesOfTriangle>,
    /// All that shine, if any.
    pub lamps: Option<Patch>,
    pub lights: Vec<Coefficients>,
    /// Whether what leaves the scene meets light.
    pub sky: bool,
}

impl Reach<'_> {
    /// Whether a walk from a place finds light.
    pub fn finds_light(&self, mut place: SurfacePoint, random: &mut Random) -> bool {
        loop {
            if self.sees_light(&place, random) {
                return true;
            }
            let Some((hit, next)) = self.step(&place, random) else {
                return self.sky;
            };
            let (sides, side) = (self.sides[hit.triangle as usize], usize::from(hit.back));
            if sides.shines[side] {
                return true;
            }
            if !sides.reflects[side] || random.unit() >= ALBEDO {
                return false;
            }
            place = next;
        }
    }

    /// Walks on from a place for as long as `reflects` says so of the triangles that it meets, of their backs or not.
    pub fn walk(&self, mut place: SurfacePoint, random: &mut Random, mut reflects: impl FnMut(u32, bool) -> bool) {
        while let Some((hit, next)) = self.step(&place, random) {
            if !reflects(hit.triangle, hit.back) || random.unit() >= ALBEDO {
                return;
            }
            place = next;
        }
    }

    /// What a cosine-distributed ray meets, and the place there, on the side that it comes from.
    fn step(&self, place: &SurfacePoint, random: &mut Random) -> Option<(TraceHit<f32>, SurfacePoint)> {
        let direction = Frame::of(V3::<f32>::of(place.normal)).to_world(cosine_direction(random.pair()));
        let hit = self.scene.closest(V3(place.position), direction)?;
        let TraceHit { triangle, u, v, t, .. } = hit;
        let towards = -glam::Vec3::from(direction.0);
        Some((hit, SurfacePoint::new(self.scene.mesh(), &Hit { triangle, u, v, t }, Some(towards))))
    }

    /// Whether one of the lights, or a place on one of the lamps, shines on a place.
    fn sees_light(&self, place: &SurfacePoint, random: &mut Random) -> bool {
        let drawn = (random.unit() * self.lights.len() as f32) as usize;
        let shines = |light: &Coefficients| punctual(self.scene, light, place).0.iter().any(|e: &f32| *e > 0.0);
        self.lights.get(drawn).is_some_and(shines) || self.sees_lamp(place, random)
    }

    fn sees_lamp(&self, place: &SurfacePoint, random: &mut Random) -> bool {
        let Some(lamps) = &self.lamps else {
            return false;
        };
        let lamp = lamps.place(self.scene.mesh(), false, random);
        let way = glam::Vec3::from(lamp.position) - glam::Vec3::from(place.position);
        let direction = way.normalize_or_zero();
        let side = usize::from(self.scene.mesh().face_normal(lamp.triangle).dot(direction) > 0.0);
        let faces = glam::Vec3::from(place.normal).dot(direction) > 0.0;
        let shines = faces && self.sides[lamp.triangle as usize].shines[side];
        let length = CLEAR_SHARE as f32 * way.length();
        shines && !self.scene.is_blocked(V3(place.position), V3(direction.to_array()), length)
    }
}
