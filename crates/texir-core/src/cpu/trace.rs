//! Closest hits: obvhs's own traversal in `f32`, and an exhaustive search in any scalar as the oracle.

use obvhs::ray::{Ray, RayHit};

use crate::environment::Environment;
use crate::mesh::Mesh;
use crate::raster::Rgb;
use crate::real::{Real, V3};
use crate::scene::Scene;

/// A closest hit; see [`crate::surface::Hit`].
#[derive(Clone, Copy, Debug)]
pub struct TraceHit<R> {
    /// Triangle index of the mesh.
    pub triangle: u32,
    /// Barycentric coordinate of the second corner.
    pub u: R,
    /// Barycentric coordinate of the third corner.
    pub v: R,
    /// Distance.
    pub t: R,
}

/// Something that finds the closest hit of a ray.
pub trait Trace<R: Real>: Sync {
    /// The mesh that is traced.
    fn mesh(&self) -> &Mesh;
    /// The closest hit with t > 0 along the unit direction, either side of a triangle.
    fn closest(&self, origin: V3<R>, direction: V3<R>) -> Option<TraceHit<R>>;
}

/// Ray–triangle intersection (Möller and Trumbore 1997), two-sided: `(t, u, v)`.
pub fn intersect<R: Real>(corners: [V3<R>; 3], origin: V3<R>, direction: V3<R>) -> Option<(R, R, R)> {
    let zero = R::of(0.0);
    let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
    let p = direction.cross(e2);
    let inverse = R::of(1.0) / e1.dot(p);
    let s = origin - corners[0];
    let u = s.dot(p) * inverse;
    let q = s.cross(e1);
    let v = direction.dot(q) * inverse;
    let t = e2.dot(q) * inverse;
    (u >= zero && v >= zero && u + v <= R::of(1.0) && t > zero).then_some((t, u, v))
}

fn corners_in<R: Real>(mesh: &Mesh, triangle: u32) -> [V3<R>; 3] {
    mesh.corners(triangle).map(|c| V3::of(c.to_array()))
}

/// Tests every triangle: slow, free of any hierarchy, exact in its scalar.
pub struct Exhaustive<'a>(pub &'a Mesh);

impl<R: Real> Trace<R> for Exhaustive<'_> {
    fn mesh(&self) -> &Mesh {
        self.0
    }

    fn closest(&self, origin: V3<R>, direction: V3<R>) -> Option<TraceHit<R>> {
        let mut best: Option<TraceHit<R>> = None;
        for triangle in 0..self.0.triangles.len() as u32 {
            if let Some((t, u, v)) = intersect(corners_in(self.0, triangle), origin, direction)
                && best.is_none_or(|b| t < b.t)
            {
                best = Some(TraceHit { triangle, u, v, t });
            }
        }
        best
    }
}

impl Trace<f32> for Scene {
    fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    fn closest(&self, origin: V3<f32>, direction: V3<f32>) -> Option<TraceHit<f32>> {
        // obvhs takes −0 for negative in one place and for positive in another, and misses boxes.
        let ray = Ray::new_inf(origin.0.into(), direction.0.map(|d| d + 0.0).into());
        let mut hit = RayHit::none();
        let found = self.bvh.ray_traverse(ray, &mut hit, |_, id| {
            let triangle = self.bvh.primitive_indices[id];
            intersect(corners_in(&self.mesh, triangle), origin, direction).map_or(f32::INFINITY, |(t, _, _)| t)
        });
        if !found {
            return None;
        }
        let triangle = self.bvh.primitive_indices[hit.primitive_id as usize];
        intersect(corners_in(&self.mesh, triangle), origin, direction).map(|(t, u, v)| TraceHit { triangle, u, v, t })
    }
}

/// Texture-based lighting: the radiance arriving along a ray is the texture's value where the ray first meets the mesh.
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
            Some(hit) => self.radiance_at(&hit),
            None => self.beyond(direction),
        }
    }

    /// Radiance of the environment in `direction`.
    pub fn beyond<R: Real>(&self, direction: V3<R>) -> V3<R> {
        self.environment.map_or(V3::zero(), |environment| environment.towards(direction))
    }

    /// Outgoing radiance at a hit: the nearest texel.
    pub fn radiance_at<R: Real>(&self, hit: &TraceHit<R>) -> V3<R>
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
        V3::of(*self.radiance.at(texel(uv[0], self.radiance.width), texel(uv[1], self.radiance.height)))
    }
}
