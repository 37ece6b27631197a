//! Whether charts are far enough apart: lookups blend a texel with those beside it, which must be its neighbours on the
//! surface, too.

use glam::Vec2;
use rayon::prelude::*;

use super::mapped_bands;
use crate::backend::Backend;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::surface::TexelHit;

/// Texels beside each other in the map are strangers where so many steps lie between them on the surface. Within a
/// chart it is one, and somewhat more where the surface is stretched from there on.
const STEPS: f32 = 4.0;
/// Strangers meet at more of the texels than this before it is told: charts that touch in a point do no harm.
const SHARE: f64 = 0.02;

/// What to tell the user where charts lie so close together in a map of `[width, height]` texels that one leaks into
/// the other; `None` where they do not.
pub fn crowded(backend: &mut dyn Backend, size: [usize; 2]) -> Result<Option<String>> {
    let share = beside_strangers(backend, size)?;
    let [width, height] = size;
    Ok((share > SHARE).then(|| {
        format!(
            "charts of the atlas touch at {:.0} % of the texels of a map of {width}×{height}: light and materials leak from one \
             surface to another there; a larger map keeps them apart, or charts that lie farther from each other",
            100.0 * share
        )
    }))
}

/// The share of the texels of a map that blend with a stranger to the left or above.
fn beside_strangers(backend: &mut dyn Backend, [width, height]: [usize; 2]) -> Result<f64> {
    let scene = backend.scene().clone();
    let [mut strange, mut valid] = [0; 2];
    for rows in mapped_bands(scene.mesh(), [width, height]) {
        let above = rows.start.saturating_sub(1);
        let hits = backend.texels([width, height], above..rows.end)?;
        let hit = |x: usize, y: usize| hits[(y - above) * width + x].as_ref();
        let blends = |(x, y, own): &(usize, usize, &TexelHit)| {
            let left = x.checked_sub(1).and_then(|left| hit(left, *y));
            let above = y.checked_sub(1).and_then(|above| hit(*x, above));
            [left, above].into_iter().flatten().any(|other| are_strangers(scene.mesh(), [width, height], [own, other]))
        };
        let texels = || {
            let of_row = |y: usize| (0..width).filter_map(move |x| Some((x, y, hit(x, y)?)));
            rows.clone().into_par_iter().flat_map_iter(of_row)
        };
        valid += texels().count();
        strange += texels().filter(blends).count();
    }
    Ok(strange as f64 / valid.max(1) as f64)
}

/// Whether two hits of a texel map, in texels beside each other, are apart on the surface, though one of them is
/// blended with the other: what lies beyond a texel's centre is.
fn are_strangers(mesh: &Mesh, size: [usize; 2], texels: [&TexelHit; 2]) -> bool {
    if !texels.iter().any(|texel| texel.inside) {
        return false;
    }
    let hits = texels.map(TexelHit::hit);
    let [a, b] = hits.map(|hit| hit.interpolate(mesh.corners(hit.triangle)));
    let [facing, other] = hits.map(|hit| hit.interpolate(mesh.corner_normals(hit.triangle)));
    let step = hits.map(|hit| step(mesh, size, hit.triangle)).into_iter().fold(0.0, f32::max);
    a.distance(b) > STEPS * step || facing.dot(other) < 0.0
}

/// How far it is on the surface, metres, from one texel of a triangle to the next where that is farthest.
fn step(mesh: &Mesh, [width, height]: [usize; 2], triangle: u32) -> f32 {
    let size = Vec2::new(width as f32, height as f32);
    let (corners, uvs) = (mesh.corners(triangle), mesh.corner_uvs(triangle));
    let along = |[from, to]: [usize; 2]| corners[from].distance(corners[to]) / ((uvs[to] - uvs[from]) * size).length();
    [[0, 1], [1, 2], [2, 0]].map(along).into_iter().fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::cpu::CpuBackend;
    use crate::scene::Scene;

    /// Squares of a metre, from left to right in the atlas, where they are `gap` apart: at `corners`, with sides along
    /// `x` and z.
    fn squares(squares: &[(Vec3, Vec3)], gap: f32) -> Mesh {
        let mut mesh = Mesh::default();
        for (k, (corner, x)) in (0_u8..).zip(squares) {
            let left = 0.125 + f32::from(k) * (0.25 + gap);
            let base = mesh.positions.len() as u32;
            for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                mesh.positions.push(corner + u * x + v * Vec3::Z);
                mesh.normals.push(x.cross(Vec3::Z));
                mesh.uvs.push(Vec2::new(left + 0.25 * u, 0.25 + 0.25 * v));
            }
            mesh.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| base + i)));
        }
        mesh
    }

    fn share(mesh: &Mesh, side: usize) -> f64 {
        beside_strangers(&mut CpuBackend::new(Scene::new(mesh.clone()).unwrap()), [side; 2]).unwrap()
    }

    #[test]
    fn charts_are_crowded_where_what_touches_in_the_map_is_apart_on_the_surface() {
        let (here, far) = ((Vec3::ZERO, Vec3::X), (Vec3::new(5.0, 0.0, 0.0), Vec3::X));
        // A column of the 32 × 16 texels that two squares have, and of the ring that they touch.
        let column = 16.0 / (32.0 * 16.0 + 2.0 * (32.0 + 16.0));
        assert_eq!(share(&squares(&[here, far], 0.0), 64), column);
        // The back of a sheet lies beside its front.
        assert_eq!(share(&squares(&[here, (Vec3::new(1.0, 1e-4, 0.0), Vec3::NEG_X)], 0.0), 64), column);
        // Two texels apart they are not, nor is a surface that goes on: straight on, around a corner, finer.
        assert_eq!(share(&squares(&[here, far], 2.0 / 64.0), 64), 0.0);
        assert_eq!(share(&squares(&[here, (Vec3::X, Vec3::X)], 0.0), 64), 0.0);
        assert_eq!(share(&squares(&[here, (Vec3::X, Vec3::Y)], 0.0), 64), 0.0);
        assert_eq!(share(&squares(&[here, (Vec3::X, 0.5 * Vec3::X)], 0.0), 64), 0.0);
    }

    #[test]
    fn it_is_told_where_a_map_is_too_small() {
        let mesh = squares(&[(Vec3::ZERO, Vec3::X), (Vec3::new(5.0, 0.0, 0.0), Vec3::X)], 1.0 / 64.0);
        let mut backend = CpuBackend::new(Scene::new(mesh).unwrap());
        let mut told = |side: usize| crowded(&mut backend, [side; 2]).unwrap();
        let crowded = told(16).unwrap();
        assert!(crowded.contains("% of the texels of a map of 16×16"), "{crowded}");
        assert_eq!(told(128), None);
    }
}
