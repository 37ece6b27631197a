//! Closest hits: what finds them, of which there is [`Scene`](super::Scene) in `f32`, and an exhaustive search in any
//! scalar as the oracle.

use crate::mesh::Mesh;
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

/// Relative bias of back-face hits, which count as BACK_FACE_BIAS · (t + max |origin|) further: of two coincident
/// triangles that face opposite ways (exporters' double-sided geometry), a ray meets the one that faces it, instead of
/// whichever rounding favours. 0.08 mm at ten metres.
pub const BACK_FACE_BIAS: f64 = 1.0 / (1 << 17) as f64;

/// Something that finds the closest hit of a ray.
pub trait Trace<R: Real>: Sync {
    /// The mesh that is traced.
    fn mesh(&self) -> &Mesh;
    /// The closest hit with t > 0 along the unit direction, either side of a triangle; backs count as
    /// [`BACK_FACE_BIAS`] further.
    fn closest(&self, origin: V3<R>, direction: V3<R>) -> Option<TraceHit<R>>;

    /// Whether anything is hit with 0 < t < `length` along the unit direction, either side of a triangle.
    fn is_blocked(&self, origin: V3<R>, direction: V3<R>, length: R) -> bool;

    /// The share of light that passes along the unit direction, from 0 < t < `length`. What takes the same share of
    /// light all over takes that ([`super::Micromap::even_opacity`]); of such sheets in one place, one does. All else
    /// takes all or nothing, as in [`Trace::is_blocked`].
    fn transmittance(&self, origin: V3<R>, direction: V3<R>, length: R) -> R {
        R::of(if self.is_blocked(origin, direction, length) { 0.0 } else { 1.0 })
    }
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
#[derive(Debug)]
pub struct BruteForce<'a>(pub &'a Mesh);

impl BruteForce<'_> {
    /// All hits with t > 0, by triangle.
    fn hits<R: Real>(&self, origin: V3<R>, direction: V3<R>) -> impl Iterator<Item = TraceHit<R>> {
        (0..self.0.triangles.len() as u32).filter_map(move |triangle| {
            let [a, b, c] = self.0.corners(triangle).map(|corner| V3::of(corner.to_array()));
            intersect(triangle, a, [b - a, c - a], origin, direction)
        })
    }
}

impl<R: Real> Trace<R> for BruteForce<'_> {
    fn mesh(&self) -> &Mesh {
        self.0
    }

    fn closest(&self, origin: V3<R>, direction: V3<R>) -> Option<TraceHit<R>> {
        let size = origin.0.iter().map(|x| x.value().abs()).fold(0.0, f64::max);
        let rank =
            |hit: &TraceHit<R>| hit.t.value() + if hit.back { BACK_FACE_BIAS * (hit.t.value() + size) } else { 0.0 };
        let mut best: Option<TraceHit<R>> = None;
        for hit in self.hits(origin, direction) {
            if best.is_none_or(|best| rank(&hit) < rank(&best)) {
                best = Some(hit);
            }
        }
        best
    }

    fn is_blocked(&self, origin: V3<R>, direction: V3<R>, length: R) -> bool {
        self.hits(origin, direction).any(|hit| hit.t < length)
    }
}
