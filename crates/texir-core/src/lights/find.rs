//! Which triangles are light sources, told by the HDR texture.

use super::{CONTRAST, LightTriangle, Lights, cluster, learn};
use crate::atlas::Atlas;
use crate::distribution::cdf;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::raster::{Rgb, luminance, times};
use crate::scene::Scene;
use crate::surface::SurfacePoint;

/// Texels at most that tables of lights are learned at: hundreds for every one that there can be.
const CHOSEN: usize = 1 << 20;

impl Lights {
    /// The triangles with more than three times the scene's mean luminance in `radiance`, with cluster tables learned
    /// by shadow rays. What is transparent is none, whatever radiance it has: no ray meets it. Errors unless `atlas`
    /// has the size of `radiance` and is one of the scene's mesh.
    pub fn find(scene: &Scene, atlas: &Atlas, radiance: &Rgb) -> Result<Self> {
        let (own, others) = ([atlas.width, atlas.height], radiance.size());
        if own != others || radiance.data.len() != radiance.width * radiance.height {
            return Err(Error::invalid(format!(
                "the radiance has {} texels; expected the atlas's {}",
                times(others),
                times(own)
            )));
        }
        let mut finder = Finder::new(scene, radiance, atlas.points.len());
        finder.take(&atlas.points)?;
        Ok(finder.find())
    }

    /// The triangles whose `luminance` (one number per mesh triangle) is above 0, sampled in proportion to luminance ×
    /// area everywhere.
    ///
    /// # Panics
    /// With fewer numbers than triangles.
    pub fn by_power(mesh: &Mesh, luminance: &[f32]) -> Self {
        let power = |t: u32| luminance[t as usize] * mesh.area(t);
        let shining = (0..mesh.triangles.len() as u32).filter(|&t| power(t) > 0.0 && power(t).is_finite()).collect();
        let mut lights = Self::none(mesh);
        let mut powers = Vec::new();
        for (cluster, members) in (0..).zip(cluster::clusters(mesh, shining, &power)) {
            let weights: Vec<f32> = members.iter().map(|&t| power(t)).collect();
            let sum = weights.iter().map(|&weight| f64::from(weight)).sum::<f64>() as f32;
            for (&triangle, cdf) in members.iter().zip(cdf(&weights)) {
                let pdf_area = luminance[triangle as usize] / sum;
                lights.triangles.push(LightTriangle { triangle, cluster, cdf, pdf_area });
                lights.light_of_triangle[triangle as usize] = lights.triangles.len() as u32;
            }
            lights.clusters.push(lights.triangles.len() as u32);
            powers.push(sum);
        }
        lights.tables = cdf(&powers);
        lights
    }
}

/// Finds lights among texels that come some at a time.
pub(crate) struct Finder<'a> {
    scene: &'a Scene,
    radiance: &'a Rgb,
    /// Sum of the luminance of each triangle's texels, and how many there are.
    sums: Vec<(f64, u32)>,
    /// Some of the texels, evenly chosen: one of `every`.
    chosen: Vec<SurfacePoint>,
    every: usize,
    taken: usize,
}

impl<'a> Finder<'a> {
    /// Of the lights in `radiance`, a map of which `texels` are valid.
    pub fn new(scene: &'a Scene, radiance: &'a Rgb, texels: usize) -> Self {
        let sums = vec![(0.0, 0); scene.mesh().triangles.len()];
        Self { scene, radiance, sums, chosen: Vec::new(), every: texels.div_ceil(CHOSEN).max(1), taken: 0 }
    }

    /// Takes note of the texels that come next. Errors on those of another mesh or map.
    pub fn take(&mut self, points: &[SurfacePoint]) -> Result<()> {
        let triangles = self.sums.len();
        for point in points {
            let (sum, radiance) =
                (self.sums.get_mut(point.triangle as usize), self.radiance.data.get(point.index as usize));
            let ((sum, count), radiance) = sum.zip(radiance).ok_or_else(|| {
                Error::invalid(format!(
                    "a texel lies on triangle {} of a mesh of {triangles}; expected texels of the backend's mesh, and a map of their size",
                    point.triangle
                ))
            })?;
            *sum += f64::from(luminance(radiance));
            *count += 1;
        }
        let first = self.taken.next_multiple_of(self.every) - self.taken;
        self.chosen.extend(points.iter().skip(first).step_by(self.every));
        self.taken += points.len();
        Ok(())
    }

    /// [`Self::find`] for scenes in which all back faces are black, not those of lights alone: a sheet lets no light
    /// through, and reflects it from its front only.
    pub fn one_sided(self) -> Lights {
        Lights { one_sided: true, ..self.find() }
    }

    /// See [`Lights::find`].
    pub fn find(self) -> Lights {
        let mut luminance = self.mean_luminance();
        luminance.iter_mut().zip(self.scene.is_solid()).filter(|(_, solid)| !solid).for_each(|(l, _)| *l = 0.0);
        let mesh = self.scene.mesh();
        let area: Vec<f32> = (0..mesh.triangles.len() as u32).map(|t| mesh.area(t)).collect();
        let total_area: f64 = area.iter().map(|&a| f64::from(a)).sum();
        let total: f64 = luminance.iter().zip(&area).map(|(&l, &a)| f64::from(l * a)).sum();
        let threshold = CONTRAST * (total / total_area) as f32;
        luminance.iter_mut().filter(|l| !(**l > threshold)).for_each(|l| *l = 0.0);
        learn::learn(Lights::by_power(mesh, &luminance), self.scene, &self.chosen)
    }

    /// Mean luminance of each triangle's texels; of a triangle smaller than a texel, what a ray that hits it would see.
    fn mean_luminance(&self) -> Vec<f32> {
        let centre = |t: u32| {
            let [a, b, c] = self.scene.mesh().corner_uvs(t);
            self.radiance.nearest((a + b + c) / 3.0).map_or(0.0, luminance)
        };
        let mean = |(t, &(sum, count)): (u32, &(f64, u32))| {
            if count > 0 { (sum / f64::from(count)) as f32 } else { centre(t) }
        };
        (0u32..).zip(&self.sums).map(mean).collect()
    }
}
