//! The flat as rays see it: hits with their materials, light samples, the specular lobe.

use glam::{Vec2, Vec3};

use super::Flat;
use super::emitters::{Choice, Emitters};
use super::random::Sample;
use crate::brdf::{
    Cosines, DIELECTRIC_F0, Masking, fresnel_weight, pdf, sample_half_vector, sample_weight, specular_over_fresnel,
};
use crate::cpu::sampling::Frame;
use crate::error::Result;
use crate::raster::{Raster, Rgb};
use crate::real::V3;
use crate::scene::Scene;
use crate::scene::trace::Trace;
use crate::surface::{Hit, SurfacePoint};

/// The flat, its hierarchy and its emitters.
pub(super) struct World<'a> {
    pub flat: &'a Flat,
    pub scene: Scene,
    pub emitters: Emitters,
}

/// A surface point that a ray met.
pub(super) struct Vertex {
    /// Moved off the surface: rays leave from here.
    pub position: Vec3,
    /// Unit shading normal, on the side the ray came from.
    pub normal: Vec3,
    pub triangle: u32,
    pub uv: Vec2,
    pub distance: f32,
    /// Whether the front of the triangle was met.
    pub front: bool,
    /// Cosine between the geometric normal and the ray, positive.
    pub cosine: f32,
}

/// A direction drawn from the specular lobe.
pub(super) struct LobeSample {
    pub direction: Vec3,
    /// f_s·n·l / pdf.
    pub weight: f32,
    /// Per solid angle.
    pub pdf: f32,
}

impl<'a> World<'a> {
    pub fn new(flat: &'a Flat) -> Result<Self> {
        Ok(Self { flat, scene: Scene::new(flat.mesh.clone())?, emitters: Emitters::new(flat) })
    }

    /// The closest surface along a ray.
    pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<Vertex> {
        let found = self.scene.closest(V3(origin.to_array()), V3(direction.to_array()))?;
        let mesh = &self.flat.mesh;
        let hit = Hit { triangle: found.triangle, u: found.u, v: found.v, t: found.t };
        let point = SurfacePoint::new(mesh, &hit, Some(-direction));
        let cosine = -mesh.face_normal(found.triangle).dot(direction);
        Some(Vertex {
            position: point.position.into(),
            normal: point.normal.into(),
            triangle: found.triangle,
            uv: hit.uv(mesh),
            distance: found.t,
            front: cosine > 0.0,
            cosine: cosine.abs(),
        })
    }

    /// Whether nothing is in between two points.
    fn visible(&self, from: Vec3, to: Vec3) -> bool {
        let way = to - from;
        let length = way.length();
        let direction = V3((way / length).to_array());
        !self.scene.is_blocked(V3(from.to_array()), direction, length * (1.0 - 1e-4))
    }

    /// Emitted radiance towards the ray that met `vertex`.
    pub fn emission(&self, vertex: &Vertex) -> Vec3 {
        if vertex.front && self.emitters.contains(vertex.triangle) {
            bilinear(&self.flat.emission, vertex.uv)
        } else {
            Vec3::ZERO
        }
    }

    /// How lamps are drawn for light that arrives at `vertex`.
    pub fn choice(&self, vertex: &Vertex) -> Choice {
        self.emitters.choice(vertex.position, vertex.normal, self.flat.labels(vertex.triangle).1)
    }

    /// Solid-angle density with which [`Self::light`] would have drawn the direction towards `vertex`.
    pub fn light_pdf(&self, vertex: &Vertex, choice: &Choice) -> f32 {
        self.emitters.pdf(vertex.triangle, choice) * vertex.distance * vertex.distance / vertex.cosine.max(1e-6)
    }

    /// Light drawn from an emitter: `(direction, emitted radiance, density per solid angle)`; `None` where the emitter
    /// is hidden or turned away.
    pub fn light(
        &self,
        position: Vec3,
        normal: Vec3,
        choice: &Choice,
        sample: &mut Sample,
    ) -> Option<(Vec3, Vec3, f32)> {
        let (pick, place) = (sample.pair(), sample.pair());
        let drawn = self.emitters.sample(self.flat, choice, pick, place)?;
        let way = drawn.position - position;
        let distance2 = way.length_squared();
        let direction = way / distance2.sqrt();
        let cosine = -drawn.normal.dot(direction);
        // Phrased so that coincident points, whose direction is NaN, fail.
        if !(cosine > 0.0 && normal.dot(direction) > 0.0 && self.visible(position, drawn.position)) {
            return None;
        }
        Some((direction, bilinear(&self.flat.emission, drawn.uv), drawn.pdf * distance2 / cosine))
    }

    /// Perceptual roughness at a surface point.
    pub fn roughness(&self, uv: Vec2) -> f32 {
        bilinear_with(&self.flat.roughness, uv, |&r| r, |a, b, t| a + (b - a) * t)
    }

    /// Linear albedo at a surface point.
    pub fn albedo(&self, uv: Vec2) -> Vec3 {
        bilinear(&self.flat.albedo, uv)
    }
}

/// f_s·n·l and the density of drawing `light` from the lobe; the specular term of [`crate::brdf`] for a dielectric.
pub(super) fn lobe(normal: Vec3, view: Vec3, light: Vec3, roughness: f32) -> (f32, f32) {
    let half = (view + light).normalize_or_zero();
    let c = Cosines {
        nl: normal.dot(light).clamp(0.0, 1.0),
        nv: normal.dot(view).clamp(0.0, 1.0),
        nh: normal.dot(half).clamp(0.0, 1.0),
        vh: view.dot(half).clamp(1e-4, 1.0),
    };
    (specular_over_fresnel(Masking::Smith, &c, roughness) * fresnel(c.vh) * c.nl, pdf(&c, roughness))
}

/// Draws a direction from the lobe; `None` below the surface.
pub(super) fn sample_lobe(normal: Vec3, view: Vec3, roughness: f32, [u, v]: [f32; 2]) -> Option<LobeSample> {
    let nh = sample_half_vector(u, roughness)[1];
    let half = around(normal, nh, v);
    let vh = view.dot(half);
    let direction = half * (2.0 * vh) - view;
    let nl = normal.dot(direction);
    if !(nl > 0.0 && vh > 1e-4 && nh > 0.0) {
        return None;
    }
    let c = Cosines { nl: nl.min(1.0), nv: normal.dot(view).clamp(0.0, 1.0), nh, vh: vh.min(1.0) };
    Some(LobeSample {
        direction,
        weight: sample_weight(Masking::Smith, &c, roughness) * fresnel(c.vh),
        pdf: pdf(&c, roughness),
    })
}

/// The unit direction at polar cosine `cosine` and azimuth 2π·`turn` about `normal`.
pub(super) fn around(normal: Vec3, cosine: f32, turn: f32) -> Vec3 {
    let Frame { tangent, bitangent, .. } = Frame::of(V3(normal.to_array()));
    let (sin_phi, cos_phi) = (std::f32::consts::TAU * turn).sin_cos();
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    (Vec3::from(tangent.0) * cos_phi + Vec3::from(bitangent.0) * sin_phi) * sine + normal * cosine
}

fn fresnel(vh: f32) -> f32 {
    let (f0, x) = (DIELECTRIC_F0 as f32, fresnel_weight(vh));
    f0 * (1.0 - x) + x
}

/// Bilinear lookup, texel centres at half-integers, clamped at the borders.
pub(super) fn bilinear(map: &Rgb, uv: Vec2) -> Vec3 {
    bilinear_with(map, uv, |&v| Vec3::from(v), Vec3::lerp)
}

fn bilinear_with<T, V: Copy>(map: &Raster<T>, uv: Vec2, value: impl Fn(&T) -> V, mix: impl Fn(V, V, f32) -> V) -> V {
    let [width, height] = map.size();
    let last = Vec2::new(width as f32 - 1.0, height as f32 - 1.0);
    let p = (uv * Vec2::new(width as f32, height as f32) - 0.5).clamp(Vec2::ZERO, last);
    let (x, y) = (p.x as usize, p.y as usize);
    let (x1, y1) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
    let f = p.fract();
    let row = |y: usize| mix(value(map.at(x, y)), value(map.at(x1, y)), f.x);
    mix(row(y), row(y1), f.y)
}
