//! Closest hits: what finds them, of which there is [`Scene`](crate::scene::Scene) in `f32`, and an exhaustive search
//! in any scalar as the oracle.

use crate::environment::Environment;
use crate::mesh::Mesh;
use crate::raster::Rgb;
use crate::real::{Real, V3};

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
    /// Whether it is the triangle's back that is hit.
    pub back: bool,
}

/// Something that finds the closest hit of a ray.
pub trait Trace<R: Real>: Sync {
    /// The mesh that is traced.
    fn mesh(&self) -> &Mesh;
    /// The closest hit with t > 0 along the unit direction, either side of a triangle.
    fn closest(&self, origin: V3<R>, direction: V3<R>) -> Option<TraceHit<R>>;
}

/// Ray–triangle intersection (Möller and Trumbore 1997) by a corner and the edges from it, two-sided.
#[inline]
pub fn intersect<R: Real>(
    triangle: u32,
    corner: V3<R>,
    [e1, e2]: [V3<R>; 2],
    origin: V3<R>,
    direction: V3<R>,
) -> Option<TraceHit<R>> {
    let zero = R::of(0.0);
    let p = direction.cross(e2);
    let determinant = e1.dot(p);
    let inverse = R::of(1.0) / determinant;
    let s = origin - corner;
    let u = s.dot(p) * inverse;
    let q = s.cross(e1);
    let v = direction.dot(q) * inverse;
    let t = e2.dot(q) * inverse;
    let hit = TraceHit { triangle, u, v, t, back: determinant < zero };
    (u >= zero && v >= zero && u + v <= R::of(1.0) && t > zero).then_some(hit)
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
            let [a, b, c] = self.0.corners(triangle).map(|corner| V3::of(corner.to_array()));
            if let Some(hit) = intersect(triangle, a, [b - a, c - a], origin, direction)
                && best.is_none_or(|best| hit.t < best.t)
            {
                best = Some(hit);
            }
        }
        best
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
