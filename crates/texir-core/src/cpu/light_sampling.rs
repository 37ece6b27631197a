//! Directions to the lights of the TBL, and the density with which they are drawn; twin of
//! `shared/light_sampling.wgsl`.

use crate::distribution::sample_cdf;
use crate::lights::{LightPart, Lights};
use crate::mesh::Mesh;
use crate::real::{Real, V3};
use crate::scene::trace::TraceHit;

/// A point on a light, and the triangle it lies on: the first number chooses a cluster by `table`, what is left of it a
/// part of the cluster, and what is left of that is the point's first coordinate.
pub fn light_point<R: Real>(mesh: &Mesh, lights: &Lights, table: &[f32], [u, v]: [f32; 2]) -> (u32, V3<R>) {
    let (cluster, rest) = sample_cdf(table.len(), |c| table[c], u);
    let (light, rest) = lights.part(cluster, rest);
    (light.triangle, light.point(mesh, [rest, v]))
}

/// What a hit place is sampled as; `None` for what is no light.
pub fn light_at<'a, R: Real>(lights: &'a Lights, hit: &TraceHit<R>) -> Option<&'a LightPart> {
    lights.at(hit.triangle, [hit.u, hit.v].map(|x| x.value() as f32))
}

/// Density, per solid angle, with which the light samples of `table` draw the direction of a hit: density per area ·
/// t² / |cosθ'|.
pub fn light_pdf<R: Real>(mesh: &Mesh, lights: &Lights, table: &[f32], hit: &TraceHit<R>, direction: V3<R>) -> R {
    let Some(light) = light_at(lights, hit) else { return R::of(0.0) };
    let cluster = light.cluster as usize;
    let before = if cluster > 0 { table[cluster - 1] } else { 0.0 };
    let pdf_area = R::of(f64::from((table[cluster] - before) * light.pdf_area));
    let [a, b, c] = mesh.corners(hit.triangle).map(|p| V3::of(p.to_array()));
    let cosine = (b - a).cross(c - a).normalize().dot(direction).abs();
    pdf_area * hit.t * hit.t / cosine.max(R::of(1e-6))
}
