//! A bake at a quarter of the points, for what has to know light only roughly.

use glam::Vec3;

use super::{Baked, Quality, Texels, bake_texels};
use crate::atlas::{Atlas, TexelIndex};
use crate::backend::{Backend, Gather};
use crate::checkpoint::Checkpoints;
use crate::error::Result;
use crate::progress::Progress;
use crate::surface::SurfacePoint;

/// Texels whose normals' cosine is less do not share a point: the light on them differs.
const SAME_WAY: f32 = 0.95;
/// Nor do those that are farther apart, in typical texels: they are parts of different charts.
const APART: f32 = 4.0;

/// [`super::denoised`] at one point of each square of 2 × 2 texels that lie beside each other on one surface; they have
/// its irradiance.
pub fn thinned(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    let Thin { points, of } = Thin::new(atlas, APART * atlas.typical_texel(backend.scene().mesh()));
    let texels = Texels::of_points([atlas.width.div_ceil(2), atlas.height.div_ceil(2)], points);
    let baked = bake_texels(backend, &texels, &Quality::denoised(gather), checkpoints, progress)?.into_baked()?;
    Ok(Baked {
        irradiance: of.iter().map(|&point| baked.irradiance[point as usize]).collect(),
        buried: of.iter().map(|&point| baked.buried[point as usize]).collect(),
        standard_error: None,
        rays: baked.rays,
    })
}

/// Some of an atlas's points, in its order.
struct Thin {
    /// As texels of a map of half its width and height.
    points: Vec<SurfacePoint>,
    /// Which of them each valid texel of the atlas has.
    of: Vec<u32>,
}

impl Thin {
    fn new(atlas: &Atlas, apart: f32) -> Self {
        let index = TexelIndex::new(atlas);
        let columns = atlas.width.div_ceil(2) as u32;
        let alike = |a: &SurfacePoint, b: &SurfacePoint| {
            let near = Vec3::from(a.position).distance(b.position.into()) <= apart;
            near && Vec3::from(a.normal).dot(b.normal.into()) >= SAME_WAY
        };
        let mut thin = Self { points: Vec::new(), of: Vec::with_capacity(atlas.points.len()) };
        for point in &atlas.points {
            let [x, y] = [point.index % atlas.width as u32, point.index / atlas.width as u32];
            // Those of its square that came before.
            let before = [[0, 0], [1, 0], [0, 1]]
                .into_iter()
                .filter(|[dx, dy]| [*dy, *dx] < [y % 2, x % 2])
                .filter_map(|[dx, dy]| index.at(i64::from(x / 2 * 2 + dx), i64::from(y / 2 * 2 + dy)));
            let shared =
                before.map_while(|t| thin.of.get(t as usize)).find(|of| alike(&thin.points[**of as usize], point));
            let of = shared.copied().unwrap_or_else(|| {
                thin.points.push(SurfacePoint { index: y / 2 * columns + x / 2, ..*point });
                thin.points.len() as u32 - 1
            });
            thin.of.push(of);
        }
        thin
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{lit, two_sheets};
    use super::*;
    use crate::bake;
    use crate::progress::Silent;

    const SIDE: usize = 64;

    #[test]
    fn a_quarter_of_the_rays_tells_nearly_the_same() {
        let (scene, radiance) = two_sheets();
        let mut backend = lit(&scene, &radiance);
        let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
        let gather = Gather::new(256, 0, 3);
        let none = Checkpoints::none();
        let all = bake::denoised(&mut backend, &atlas, gather, &none, &Silent).unwrap();
        let thin = thinned(&mut backend, &atlas, gather, &none, &Silent).unwrap();
        assert_eq!(thin.irradiance.len(), atlas.texels.len());
        let share = thin.rays as f64 / all.rays as f64;
        assert!((0.25..0.3).contains(&share), "{share} of the rays");
        let off = |(thin, all): (&[f32; 3], &[f32; 3])| ((thin[0] - all[0]) / all[0].max(1e-3)).powi(2);
        let texels = atlas.texels.len() as f32;
        let rms = (thin.irradiance.iter().zip(&all.irradiance).map(off).sum::<f32>() / texels).sqrt();
        // Negative control: that of other texels is not nearly the same.
        let others = thin.irradiance.iter().cycle().skip(20).zip(&all.irradiance);
        let rms_of_others = (others.map(off).sum::<f32>() / texels).sqrt();
        assert!(rms < 0.05 && rms_of_others > 3.0 * rms, "{rms} off, {rms_of_others} from others");
    }

    #[test]
    fn texels_of_one_surface_share_a_point_within_their_square() {
        let point = |index: u32, x: f32, normal: f32| SurfacePoint {
            position: [x, 0.0, 0.0],
            triangle: 0,
            normal: [0.0, 0.0, normal],
            index,
        };
        // Two rows of five. Of the first square, the lower left texel is not there and the lower right one faces away;
        // of the second, the lower right one lies elsewhere; the last has one texel.
        let points = vec![
            point(0, 0.0, 1.0),
            point(1, 1.0, 1.0),
            point(2, 2.0, 1.0),
            point(4, 4.0, 1.0),
            point(6, 1.0, -1.0),
            point(7, 2.0, 1.0),
            point(8, 40.0, 1.0),
        ];
        let texels = points.iter().map(|point| point.index).collect();
        let atlas = Atlas { width: 5, height: 2, texels, inside: vec![true; points.len()], points };
        let Thin { points, of } = Thin::new(&atlas, 4.0);
        assert_eq!(of, [0, 0, 1, 2, 3, 1, 4]);
        let known: Vec<(u32, f32)> = points.iter().map(|point| (point.index, point.position[0])).collect();
        assert_eq!(known, [(0, 0.0), (1, 2.0), (2, 4.0), (0, 1.0), (1, 40.0)]);
    }
}
