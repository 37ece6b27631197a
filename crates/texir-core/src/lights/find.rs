//! Which triangles are light sources, or which of their parts, told by the HDR texture.

use glam::Vec2;
use rayon::prelude::*;

use super::cluster::{Shining, clusters};
use super::part::MAX_LEVEL;
use super::{CONTRAST, Cut, LightPart, Lights, Part, learn};
use crate::atlas::Atlas;
use crate::distribution::cdf;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::raster::{Rgb, luminance, times};
use crate::scene::Scene;
use crate::surface::{SurfacePoint, facing};

/// Texels at most that tables of lights are learned at: hundreds for every one that there can be.
const CHOSEN: usize = 1 << 20;
/// A triangle is cut until its parts shine evenly: until samples of them have at most this many times the second moment
/// of samples in proportion to radiance.
const UNEVEN: f64 = 1.5;
/// How often the edges of the smallest parts are halved again to sample their luminance: a part that a lamp touches is
/// to be known for one, as what is no light is left to cosine samples.
const FINER: u32 = 2;
/// Most halvings of a triangle's edges where its luminance is sampled.
const FINEST: u32 = 12;
/// Most parts per texel, as which its luminance is sampled, of a triangle that has more than [`NARROW`] parts.
const PER_TEXEL: f32 = 16.0;
/// Parts as which the luminance of any triangle may be sampled.
const NARROW: f32 = 1024.0;
/// Most parts of all triangles that are cut: 16 MiB.
const MAX_PARTS: u64 = 1 << 20;

impl Lights {
    /// What has more than three times the scene's mean luminance in `radiance`: triangles, or parts of those that do
    /// not shine evenly, down to a texel's size or 1/256 of their edges; with cluster tables learned by shadow rays.
    /// What is transparent is none, whatever radiance it has: no ray meets it. Errors unless `atlas` has the size of
    /// `radiance` and is one of the scene's mesh.
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
        let shines = |t: &u32| {
            let power = luminance[*t as usize] * mesh.area(*t);
            power > 0.0 && power.is_finite()
        };
        let whole = |triangle: u32| (triangle, vec![luminance[triangle as usize]]);
        Self::by_parts(mesh, (0..mesh.triangles.len() as u32).filter(shines).map(whole))
    }

    /// Triangles with the luminance of their parts, by number, sampled likewise.
    fn by_parts(mesh: &Mesh, triangles: impl Iterator<Item = (u32, Vec<f32>)>) -> Self {
        let mut lights = Self::none(mesh);
        let (mut shining, mut luminances) = (Vec::new(), Vec::new());
        for (triangle, luminance) in triangles {
            let level = luminance.len().ilog(4);
            lights.cuts[triangle as usize] = Cut::new(lights.parts.len() as u32, level);
            let (area, facing) = (mesh.area(triangle) / luminance.len() as f32, facing(mesh.face_normal(triangle)));
            for (part, luminance) in Part::all(level).zip(luminance) {
                if luminance > 0.0 {
                    lights.members.push(lights.parts.len() as u32);
                    luminances.push(luminance);
                    shining.push(Shining {
                        corners: part.corners(mesh.corners(triangle)),
                        facing,
                        power: luminance * area,
                    });
                }
                lights.parts.push(LightPart { triangle, part, cluster: 0, pdf_area: 0.0 });
            }
        }
        let part_of = std::mem::take(&mut lights.members);
        let mut powers = Vec::new();
        for (cluster, members) in (0..).zip(clusters(&shining)) {
            let weights: Vec<f32> = members.iter().map(|&m| shining[m as usize].power).collect();
            let sum = weights.iter().map(|&weight| f64::from(weight)).sum::<f64>() as f32;
            for &member in &members {
                let part = &mut lights.parts[part_of[member as usize] as usize];
                (part.cluster, part.pdf_area) = (cluster, luminances[member as usize] / sum);
            }
            lights.members.extend(members.iter().map(|&member| part_of[member as usize]));
            lights.cdf.extend(cdf(&weights));
            lights.clusters.push(lights.members.len() as u32);
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
    /// Some of the texels, evenly chosen: one of `every`.
    chosen: Vec<SurfacePoint>,
    every: usize,
    taken: usize,
}

impl<'a> Finder<'a> {
    /// Of the lights in `radiance`, a map of which `texels` are valid.
    pub fn new(scene: &'a Scene, radiance: &'a Rgb, texels: usize) -> Self {
        Self { scene, radiance, chosen: Vec::new(), every: texels.div_ceil(CHOSEN).max(1), taken: 0 }
    }

    /// Takes note of the texels that come next. Errors on those of another mesh or map.
    pub fn take(&mut self, points: &[SurfacePoint]) -> Result<()> {
        let (triangles, texels) = (self.scene.mesh().triangles.len(), self.radiance.data.len());
        let known = |p: &SurfacePoint| (p.triangle as usize) < triangles && (p.index as usize) < texels;
        if let Some(point) = points.iter().find(|point| !known(point)) {
            return Err(Error::invalid(format!(
                "a texel lies on triangle {} of a mesh of {triangles}; expected texels of the backend's mesh, and a map of their size",
                point.triangle
            )));
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
        let mesh = self.scene.mesh();
        let is_solid = self.scene.is_solid();
        let (means, brightest): (Vec<f32>, Vec<f32>) = (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| if is_solid[t] { self.mean_and_brightest(t as u32) } else { (0.0, 0.0) })
            .unzip();
        let area = |t: usize| f64::from(mesh.area(t as u32));
        let (total, total_area) = (means.iter().enumerate())
            .fold((0.0, 0.0), |(sum, areas), (t, &mean)| (sum + f64::from(mean) * area(t), areas + area(t)));
        let threshold = CONTRAST * (total / total_area) as f32;
        let lit = (0..).zip(&brightest).filter(|(t, brightest)| **brightest > threshold && mesh.area(*t) > 0.0);
        let mut cuts: Vec<(u32, u32)> = lit.map(|(triangle, _)| (triangle, 0)).collect();
        cuts.par_iter_mut().for_each(|(triangle, level)| *level = self.even_level(*triangle, threshold));
        let parts = |most: u32| cuts.iter().map(|(_, level)| 1u64 << (2 * most.min(*level))).sum::<u64>();
        let most = (1..=MAX_LEVEL).rev().find(|&level| parts(level) <= MAX_PARTS).unwrap_or(0);
        let luminances: Vec<_> = (cuts.into_par_iter())
            .map(|(triangle, level)| (triangle, self.shining(triangle, level.min(most), threshold)))
            .collect();
        learn::learn(Lights::by_parts(mesh, luminances.into_iter()), self.scene, &self.chosen)
    }

    /// [`texel_level`] of a triangle of the mesh.
    fn texel_level(&self, triangle: u32) -> u32 {
        // What is beyond the map is looked up at its edge.
        let size = Vec2::from(self.radiance.size().map(|n| n as f32));
        texel_level(self.scene.mesh().corner_uvs(triangle).map(|uv| uv.clamp(Vec2::ZERO, Vec2::ONE) * size))
    }

    /// Luminance that rays meet on a triangle, at the centres of its parts.
    fn samples(&self, triangle: u32, level: u32) -> impl Iterator<Item = (Part, f32)> {
        let [a, b, c] = self.scene.mesh().corner_uvs(triangle);
        Part::all(level).map(move |part| {
            let centre = part.centre();
            let uv = a + (b - a) * centre.x + (c - a) * centre.y;
            (part, self.radiance.nearest(uv).map_or(0.0, luminance))
        })
    }

    fn mean_and_brightest(&self, triangle: u32) -> (f32, f32) {
        let (sum, brightest, count) = (self.samples(triangle, self.texel_level(triangle)))
            .fold((0.0, 0.0f32, 0u32), |(sum, brightest, n), (_, l)| (sum + f64::from(l), brightest.max(l), n + 1));
        ((sum / f64::from(count)) as f32, brightest)
    }

    /// What is bright of a triangle, in parts of the finest level that may be sampled.
    fn bright(&self, triangle: u32, threshold: f32) -> Vec<Bright> {
        let texel = self.texel_level(triangle);
        let level = texel.min(MAX_LEVEL);
        let mut bright = vec![Bright::default(); 1 << (2 * level)];
        for (part, luminance) in self.samples(triangle, (texel + FINER).min(FINEST)) {
            let of_part = &mut bright[part.within(level).number() as usize];
            let luminance = if luminance > threshold { f64::from(luminance) } else { 0.0 };
            of_part.add(Bright { samples: 1, sum: luminance, squares: luminance * luminance });
        }
        bright
    }

    /// How often a triangle's edges are to be halved for its parts to shine evenly where they are bright.
    fn even_level(&self, triangle: u32, threshold: f32) -> u32 {
        let bright = self.bright(triangle, threshold);
        let finest = bright.len().ilog(4);
        let best: f64 = bright.iter().map(|part| part.sum).sum();
        let square = |part: &Bright| if part.sum > 0.0 { part.squares / part.mean() } else { 0.0 };
        let is_even = |level: &u32| coarser(&bright, *level).iter().map(square).sum::<f64>() <= UNEVEN * best;
        (0..finest).find(is_even).unwrap_or(finest)
    }

    /// What is bright of the luminance of a triangle's parts: the mean of it over each, by number.
    fn shining(&self, triangle: u32, level: u32, threshold: f32) -> Vec<f32> {
        coarser(&self.bright(triangle, threshold), level).iter().map(|part| part.mean() as f32).collect()
    }
}

/// How often the edges of a triangle, here in texels, are halved until they are no longer than one; less often where it
/// is so narrow that this would be many times more parts than it has texels.
fn texel_level([a, b, c]: [Vec2; 3]) -> u32 {
    let longest = (b - a).length().max((c - a).length()).max((c - b).length());
    let most = PER_TEXEL * 0.5 * (b - a).perp_dot(c - a).abs() + NARROW;
    longest.log2().ceil().min(most.log2() / 2.0).clamp(0.0, FINEST as f32) as u32
}

/// Samples of a part's luminance, those that are not bright as 0.
#[derive(Clone, Copy, Default)]
struct Bright {
    samples: u32,
    sum: f64,
    squares: f64,
}

impl Bright {
    fn add(&mut self, Self { samples, sum, squares }: Self) {
        self.samples += samples;
        self.sum += sum;
        self.squares += squares;
    }

    fn mean(&self) -> f64 {
        self.sum / f64::from(self.samples)
    }
}

/// Parts of a triangle as the parts of a coarser level, both by number.
fn coarser(parts: &[Bright], level: u32) -> Vec<Bright> {
    let mut coarse = vec![Bright::default(); 1 << (2 * level)];
    for (part, bright) in Part::all(parts.len().ilog(4)).zip(parts) {
        coarse[part.within(level).number() as usize].add(*bright);
    }
    coarse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn luminance_is_sampled_once_per_texel_but_not_across_slivers() {
        let level = |x: f32, y: f32| texel_level([Vec2::ZERO, Vec2::new(x, 0.0), Vec2::new(0.0, y)]);
        for (side, expected) in [(0.3, 0), (1.0, 1), (2.5, 2), (90.0, 7), (700.0, 10), (1e9, FINEST)] {
            assert_eq!(level(side, side), expected, "{side} texels");
        }
        // 4,000 texels in a row: 32² parts and not 4,096².
        assert_eq!(level(4000.0, 1e-3), 5);
        assert_eq!(level(4000.0, 2.0), 7);
        assert_eq!(texel_level([Vec2::NAN; 3]), 0);
    }
}
