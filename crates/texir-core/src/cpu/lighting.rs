//! The light that arrives along a ray; twin of `shared/lighting.wgsl` and `shared/environment.wgsl`.

use crate::environment::Environment;
use crate::raster::Rgb;
use crate::real::{Real, V3};
use crate::scene::trace::{Trace, TraceHit};

/// Radiances that are looked up in a row, no ray between them: they lie all over memory, and each alone is waited for.
pub const TOGETHER: usize = 16;

/// Texture-based lighting: the radiance arriving along a ray is the texture's value where the ray first meets the mesh.
#[derive(Debug)]
pub struct Lighting<'a, T> {
    /// Finds the hits.
    pub tracer: &'a T,
    /// Outgoing radiance in the atlas.
    pub radiance: &'a Rgb,
    /// What rays see that miss the mesh; black where there is none.
    pub environment: Option<&'a Environment>,
}

impl<T> Lighting<'_, T> {
    /// Radiance arriving at `origin` from `direction`: nearest texel at the hit, the environment on a miss.
    pub fn incoming<R: Real>(&self, origin: V3<R>, direction: V3<R>) -> V3<R>
    where
        T: Trace<R>,
    {
        match self.tracer.closest(origin, direction) {
            Some(hit) => V3::of(*self.radiance_at(&hit)),
            None => self.environment_radiance(direction),
        }
    }

    /// Radiance of the environment in `direction`.
    pub fn environment_radiance<R: Real>(&self, direction: V3<R>) -> V3<R> {
        self.environment.map_or(V3::zero(), |environment| environment.towards(direction))
    }

    /// Outgoing radiance at a hit: the nearest texel.
    pub fn radiance_at<R: Real>(&self, hit: &TraceHit<R>) -> &[f32; 3]
    where
        T: Trace<R>,
    {
        let [a, b, c] = self.tracer.mesh().corner_uvs(hit.triangle).map(|uv| uv.to_array());
        let w = R::of(1.0) - hit.u - hit.v;
        let uv: [f64; 2] = std::array::from_fn(|i| {
            let [a, b, c] = [a[i], b[i], c[i]].map(|x| R::of(f64::from(x)));
            (a * w + b * hit.u + c * hit.v).value()
        });
        let texel = |x: f64, size: usize| ((x * size as f64) as usize).min(size - 1);
        self.radiance.at(texel(uv[0], self.radiance.width), texel(uv[1], self.radiance.height))
    }
}
