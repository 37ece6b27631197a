//! Where light arrives at all, however weak: random walks that ask for lamps at every place that they come to.

use glam::Vec3;

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
/// Lights, and places on lamps, that are asked for at a place: in a house of many, most shine in other rooms.
const ASKED: usize = 8;
/// What lamps send at a smaller cosine than this is nothing: places of one flat lamp see each other by rounding.
const GRAZING: f32 = 1e-3;

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
    /// Of all of them, m².
    pub area: f32,
    /// Of their areas.
    cdf: Vec<f32>,
}

impl Patch {
    /// Of triangles of the mesh, one at least.
    pub fn new(mesh: &Mesh, triangles: Vec<u32>) -> Self {
        let areas: Vec<f32> = triangles.iter().map(|&triangle| mesh.area(triangle)).collect();
        Self { triangles, area: areas.iter().sum(), cdf: cdf(&areas) }
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

/// Which of a triangle's sides, front and back, there are for light, and which of them shine.
#[derive(Clone, Copy, Default)]
pub(super) struct SidesOfTriangle {
    pub exist: [bool; 2],
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

/// What is told of a walk on its way.
pub(super) trait Walk {
    /// A triangle is met, or its back: whether the walk may go on from there.
    fn meets(&mut self, triangle: u32, back: bool) -> bool;

    /// Light is found, of a triangle that shines (from its back or not) or of something else: whether to go on.
    fn finds(&mut self, lamp: Option<(u32, bool)>) -> bool;
}

impl Reach<'_> {
    /// Walks from a place.
    pub fn walk(&self, mut place: SurfacePoint, random: &mut Random, walk: &mut impl Walk) {
        loop {
            if self.sees_light(&place, random) && !walk.finds(None) {
                return;
            }
            if self.sees_lamp(&place, random).is_some_and(|lamp| !walk.finds(Some(lamp))) {
                return;
            }
            let Some((hit, next)) = self.step(&place, random) else {
                if self.sky {
                    walk.finds(None);
                }
                return;
            };
            if !walk.meets(hit.triangle, hit.back) || random.unit() >= ALBEDO {
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
        let towards = -Vec3::from(direction.0);
        Some((hit, SurfacePoint::new(self.scene.mesh(), &Hit { triangle, u, v, t }, Some(towards))))
    }

    /// Whether a light without extent shines on a place, of some that are drawn.
    fn sees_light(&self, place: &SurfacePoint, random: &mut Random) -> bool {
        let count = self.lights.len();
        (0..count.min(ASKED)).any(|i| {
            let drawn = if count > ASKED { (random.unit() * count as f32) as usize } else { i };
            let shines = |light: &Coefficients| punctual(self.scene, light, place).0.iter().any(|e: &f32| *e > 0.0);
            self.lights.get(drawn).is_some_and(shines)
        })
    }

    /// A triangle, with whether it is its back, that shines on a place, of some that are drawn.
    fn sees_lamp(&self, place: &SurfacePoint, random: &mut Random) -> Option<(u32, bool)> {
        let lamps = self.lamps.as_ref()?;
        (0..lamps.triangles.len().min(ASKED)).find_map(|_| self.shines(lamps, place, random))
    }

    /// A triangle, with whether it is its back, where a place that is drawn from lamps shines on another.
    fn shines(&self, lamps: &Patch, place: &SurfacePoint, random: &mut Random) -> Option<(u32, bool)> {
        let mesh = self.scene.mesh();
        let lamp = lamps.place(mesh, false, random);
        let way = Vec3::from(lamp.position) - Vec3::from(place.position);
        let direction = way.try_normalize()?;
        let away = mesh.face_normal(lamp.triangle).dot(direction);
        let back = away > 0.0;
        let shines = away.abs() > GRAZING && self.sides[lamp.triangle as usize].shines[usize::from(back)];
        let faces = Vec3::from(place.normal).dot(direction) > GRAZING;
        let length = CLEAR_SHARE as f32 * way.length();
        let is_blocked = || self.scene.is_blocked(V3(place.position), V3(direction.to_array()), length);
        (shines && faces && !is_blocked()).then_some((lamp.triangle, back))
    }
}
