//! Irradiance gather, twin of `irradiance.wgsl`.

use std::f64::consts::FRAC_1_PI;

use arrayvec::ArrayVec;

use super::light_sampling::{light_at, light_pdf, light_point};
use super::lighting::{Lighting, TOGETHER};
use super::sampling::{Frame, cosine_direction};
#[cfg(doc)]
use crate::backend::Sequences;
use crate::backend::{Gather, Gathered};
use crate::lights::Lights;
use crate::real::{Real, V3};
use crate::rng::{hash2, lattice2};
use crate::scene::trace::Trace;
use crate::surface::SurfacePoint;

/// E = Σ L cosθ / (n_c cosθ/π + n_l p_l + n_s p_s), the balance heuristic over n_c cosine samples, n_l samples of
/// lights and n_s of the bright sky (Veach and Guibas 1995). Full irradiance: cosine and π included. Cosine sample i is
/// point stretch · n_c + i of the lattice sequence shifted by two hashes of the seed of the point's [`Sequences`],
/// those of lights and sky likewise points of others.
///
/// A light shines from its front: behind a lamp's shade, its back is what an inexact mesh shows through cracks. Other
/// surfaces show the same radiance on either side, so that a curtain of one sheet is seen from its window.
pub fn irradiance<R: Real, T: Trace<R>>(
    lighting: &Lighting<'_, T>,
    lights: &Lights,
    point: &SurfacePoint,
    gather: Gather,
) -> Gathered {
    let mesh = lighting.tracer.mesh();
    let (origin, normal) = (V3::of(point.position), V3::<R>::of(point.normal));
    let frame = Frame::of(normal);
    let (seed, stretch) = gather.sequences.of(gather.seed, point.index);
    let sky = lighting.environment.filter(|sky| !sky.bright().is_empty());
    let [light_samples, environment_samples] = gather.light_and_sky(!lights.is_empty(), sky.is_some());
    let table = lights.table(point.position.into(), point.normal.into());
    let [n_cosine, n_light, n_sky] = [gather.cosine, light_samples, environment_samples].map(|n| R::of(f64::from(n)));
    let (mut sum, mut behind) = (WeightedSum::default(), 0u32);

    let offset = [hash2(seed, 3), hash2(seed, 4)];
    for i in 0..gather.cosine {
        let drawn @ V3([.., z]) =
            cosine_direction(lattice2(stretch.wrapping_mul(gather.cosine).wrapping_add(i), offset));
        let direction = frame.to_world(drawn);
        let Some(hit) = lighting.tracer.closest(origin, direction) else {
            if let Some(sky) = lighting.environment {
                let pixel = sky.pixel(direction);
                let density = n_cosine * z * R::of(FRAC_1_PI) + n_sky * R::of(f64::from(sky.bright().density[pixel]));
                sum.add(&sky.radiance().data[pixel], z / density);
            }
            continue;
        };
        behind += u32::from(hit.back);
        if hit.back && (lights.one_sided || light_at(lights, &hit).is_some()) {
            continue;
        }
        let density = n_cosine * z * R::of(FRAC_1_PI) + n_light * light_pdf(mesh, lights, table, &hit, direction);
        sum.add(lighting.radiance_at(&hit), z / density);
    }
    let offset = [hash2(seed, 1), hash2(seed, 2)];
    for i in 0..light_samples {
        let (triangle, target) =
            light_point(mesh, lights, table, lattice2(stretch.wrapping_mul(light_samples).wrapping_add(i), offset));
        let direction = (target - origin).normalize();
        let cosine = normal.dot(direction);
        if !(cosine > R::of(0.0)) {
            continue;
        }
        let Some(hit) = lighting.tracer.closest(origin, direction) else { continue };
        if hit.triangle != triangle || hit.back {
            continue;
        }
        let density = n_cosine * cosine * R::of(FRAC_1_PI) + n_light * light_pdf(mesh, lights, table, &hit, direction);
        sum.add(lighting.radiance_at(&hit), cosine / density);
    }
    if let Some(sky) = sky {
        let offset = [hash2(seed, 5), hash2(seed, 6)];
        for i in 0..environment_samples {
            let index = stretch.wrapping_mul(environment_samples).wrapping_add(i);
            let (direction, pixel) = sky.sample_environment(lattice2(index, offset));
            let cosine = normal.dot(direction);
            if !(cosine > R::of(0.0)) || lighting.tracer.is_blocked(origin, direction, R::of(f64::INFINITY)) {
                continue;
            }
            let density = n_cosine * cosine * R::of(FRAC_1_PI) + n_sky * R::of(f64::from(sky.bright().density[pixel]));
            sum.add(&sky.radiance().data[pixel], cosine / density);
        }
    }
    Gathered { irradiance: sum.total().to_f32(), back_faces: behind as f32 / gather.cosine.max(1) as f32 }
}

/// Σ L w, [`TOGETHER`] radiances at a time.
struct WeightedSum<'a, R> {
    sum: V3<R>,
    waiting: ArrayVec<(&'a [f32; 3], R), TOGETHER>,
}

impl<R: Real> Default for WeightedSum<'_, R> {
    fn default() -> Self {
        Self { sum: V3::zero(), waiting: ArrayVec::new() }
    }
}

impl<'a, R: Real> WeightedSum<'a, R> {
    fn add(&mut self, radiance: &'a [f32; 3], weight: R) {
        if self.waiting.is_full() {
            self.fetch();
        }
        self.waiting.push((radiance, weight));
    }

    fn fetch(&mut self) {
        self.sum = self.waiting.drain(..).fold(self.sum, |sum, (radiance, weight)| sum + V3::of(*radiance) * weight);
    }

    fn total(mut self) -> V3<R> {
        self.fetch();
        self.sum
    }
}
