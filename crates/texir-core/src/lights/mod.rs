//! Light sources of a TBL as a sampled set: the triangles that shine, in clusters whose share of the samples depends on
//! where the sampled light arrives.
//!
//! The scene's surface is cut into cells, by position and by the way it faces. Each has a table over the clusters,
//! learned from a few shadow rays (`learn.rs`), so that samples do not go to lamps of other rooms. Any set and any
//! tables give an unbiased gather: what they leave out is found by the cosine samples, and the balance heuristic weighs
//! both.

mod cluster;
mod learn;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::atlas::Atlas;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::raster::{Rgb, luminance};
use crate::scene::Scene;
use crate::surface::SurfacePoint;

/// A triangle counts as a light when its mean luminance is this many times the mean over the scene's surface: direct
/// light of a smaller contrast is found well enough by cosine samples.
pub(crate) const CONTRAST: f32 = 3.0;

/// Texels at most that tables of lights are learned at: hundreds for every one that there can be.
const CHOSEN: usize = 1 << 20;

/// A sampled triangle.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LightTriangle {
    /// Index in the mesh.
    pub triangle: u32,
    /// Probability, within the cluster, of this triangle and those before it.
    pub cumulative: f32,
}

/// How densely a mesh triangle is sampled.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LightDensity {
    /// Density, per square metre, of points on the triangle once its cluster is chosen; 0 for what is no light.
    pub per_area: f32,
    /// The triangle's cluster; 0 for what is no light.
    pub cluster: u32,
    /// 1 where its back is black, as a light's is, and that of all surfaces of an authored scene; 0 where either side
    /// shows the same radiance.
    pub front_only: u32,
}

/// Which table belongs to which part of the surface: cubic cells times six facings.
#[derive(Clone, Debug, PartialEq)]
pub struct LightGrid {
    /// The smallest corner of the first cell, metres.
    pub origin: Vec3,
    /// Cells per metre: 1 / their edge.
    pub per_metre: f32,
    /// Cells along each axis.
    pub size: [u32; 3],
    /// Per cell (x fastest) and facing, six to a cell: the number of its table. 0, the table for everywhere, where
    /// nothing was learned.
    pub tables: Vec<u32>,
}

/// The sampled light sources of one TBL.
#[derive(Clone, Debug, PartialEq)]
pub struct Lights {
    /// The triangles that shine, cluster by cluster; empty when nothing stands out.
    pub triangles: Vec<LightTriangle>,
    /// The first of each cluster's triangles, and at last their number.
    pub clusters: Vec<u32>,
    /// Per mesh triangle.
    pub density: Vec<LightDensity>,
    /// Where which table holds.
    pub grid: LightGrid,
    /// Tables of a number per cluster: the probability of it and those before it. The first is by power alone.
    pub tables: Vec<f32>,
}

impl Lights {
    /// No lights: a gather that samples the cosine alone.
    pub fn none(mesh: &Mesh) -> Self {
        let grid = LightGrid { origin: Vec3::ZERO, per_metre: 0.0, size: [0; 3], tables: Vec::new() };
        let density = vec![LightDensity::default(); mesh.triangles.len()];
        Self { triangles: Vec::new(), clusters: vec![0], density, grid, tables: Vec::new() }
    }

    /// The triangles that stand out in `radiance`, sampled where they are seen. Errors unless `atlas` has its size, and
    /// is one of the scene's mesh.
    pub fn find(scene: &Scene, atlas: &Atlas, radiance: &Rgb) -> Result<Self> {
        let [own, others] = [(atlas.width, atlas.height), (radiance.width, radiance.height)];
        if own != others || radiance.data.len() != radiance.width * radiance.height {
            return Err(Error::invalid(format!("the radiance has {others:?} texels; expected the atlas's {own:?}")));
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
        for cluster in cluster::clusters(mesh, shining, &power) {
            let weights: Vec<f32> = cluster.iter().map(|&t| power(t)).collect();
            let sum: f32 = weights.iter().sum();
            for (&triangle, cumulative) in cluster.iter().zip(cumulative(&weights)) {
                let per_area = luminance[triangle as usize] / sum;
                lights.density[triangle as usize] =
                    LightDensity { per_area, cluster: powers.len() as u32, front_only: 1 };
                lights.triangles.push(LightTriangle { triangle, cumulative });
            }
            lights.clusters.push(lights.triangles.len() as u32);
            powers.push(sum);
        }
        lights.tables = cumulative(&powers);
        lights
    }

    /// Whether there is nothing to sample.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Whether every index of one part lies within another, and no cluster is empty. Only lights made by hand, field by
    /// field, may not be.
    pub fn is_consistent(&self) -> bool {
        let clusters = self.clusters.len().saturating_sub(1);
        let ascending = self.clusters.first() == Some(&0)
            && self.clusters.is_sorted_by(|a, b| a < b)
            && self.clusters.last().is_some_and(|&n| n as usize == self.triangles.len());
        let whole = if clusters == 0 { self.tables.is_empty() } else { self.tables.len().is_multiple_of(clusters) };
        let tables = self.tables.len().checked_div(clusters).unwrap_or(0);
        let [x, y, z] = self.grid.size.map(|n| n as usize);
        ascending
            && whole
            && (clusters == 0 || tables > 0)
            && self.density.iter().all(|d| d.per_area == 0.0 || (d.cluster as usize) < clusters)
            && self.grid.tables.len() == 6 * x * y * z
            && (clusters == 0 || self.grid.tables.iter().all(|&table| (table as usize) < tables))
    }

    /// The table for light that arrives at a point of the surface with this normal.
    pub fn table(&self, position: Vec3, normal: Vec3) -> &[f32] {
        let clusters = self.clusters.len() - 1;
        let number = self.grid.cell(position, normal).map_or(0, |cell| self.grid.tables[cell]);
        &self.tables[number as usize * clusters..][..clusters]
    }

    /// A cluster's share of the power of all lights.
    fn power(&self, cluster: usize) -> f32 {
        self.tables[cluster] - if cluster > 0 { self.tables[cluster - 1] } else { 0.0 }
    }

    /// The triangle of `cluster` at `u` of its cumulative probability, and how far `u` lies within the triangle's
    /// share.
    pub fn triangle(&self, cluster: usize, u: f32) -> (u32, f32) {
        let members = &self.triangles[self.clusters[cluster] as usize..self.clusters[cluster + 1] as usize];
        let (i, rest) = invert(members.len(), |i| members[i].cumulative, u);
        (members[i].triangle, rest)
    }
}

impl LightGrid {
    /// Index of the cell and facing of a point of the surface.
    fn cell(&self, position: Vec3, normal: Vec3) -> Option<usize> {
        let [x, y, z] = ((position - self.origin) * self.per_metre).floor().to_array();
        let inside = |q: f32, size: u32| q >= 0.0 && q < size as f32;
        let [nx, ny, nz] = self.size;
        let cell = || (z as usize * ny as usize + y as usize) * nx as usize + x as usize;
        (inside(x, nx) && inside(y, ny) && inside(z, nz)).then(|| 6 * cell() + facing(normal))
    }
}

/// Which of the six axis directions a normal is nearest to.
fn facing(normal: Vec3) -> usize {
    let [x, y, z] = normal.abs().to_array();
    let axis = if x > y && x > z { 0 } else { 1 + usize::from(z >= y) };
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// The item at `u` in [0, 1) of cumulative probabilities, and how far `u` lies within its share, in [0, 1): what is
/// left of a number that chose an item is still uniform, so that well-spread points stay so within each item.
pub fn invert(items: usize, cumulative: impl Fn(usize) -> f32, u: f32) -> (usize, f32) {
    let (mut low, mut high) = (0, items - 1);
    while low < high {
        let middle = (low + high) / 2;
        if cumulative(middle) <= u {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    let before = if low > 0 { cumulative(low - 1) } else { 0.0 };
    (low, ((u - before) / (cumulative(low) - before)).clamp(0.0, BELOW_ONE))
}

/// The largest number below 1 with 24 bits.
const BELOW_ONE: f32 = 1.0 - 1.0 / 16_777_216.0;

/// Running sums of weights over their total; 1 from the last weight above 0 on, whatever was rounded.
pub(crate) fn cumulative(weights: &[f32]) -> Vec<f32> {
    let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
    let last = weights.iter().rposition(|&w| w > 0.0).unwrap_or(0);
    let mut sum = 0.0;
    let up_to = |(i, &weight): (usize, &f32)| {
        sum += f64::from(weight);
        if i < last { (sum / total) as f32 } else { 1.0 }
    };
    weights.iter().enumerate().map(up_to).collect()
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
        let sums = vec![(0.0, 0); scene.mesh.triangles.len()];
        Self { scene, radiance, sums, chosen: Vec::new(), every: texels.div_ceil(CHOSEN).max(1), taken: 0 }
    }

    /// Takes note of the texels that come next. Errors on those of another mesh or map.
    pub fn take(&mut self, points: &[SurfacePoint]) -> Result<()> {
        let triangles = self.sums.len();
        for point in points {
            let (sum, radiance) =
                (self.sums.get_mut(point.triangle as usize), self.radiance.data.get(point.sequence as usize));
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

    /// The lights of surfaces of which nothing is seen from behind: what is no light is black there as well. A sheet
    /// lets no light through, and what its front reflects does not leave its back.
    pub fn one_sided(self) -> Lights {
        let mut lights = self.find();
        lights.density.iter_mut().for_each(|density| density.front_only = 1);
        lights
    }

    /// See [`Lights::find`].
    pub fn find(self) -> Lights {
        let mut luminance = self.mean_luminance();
        let mesh = &self.scene.mesh;
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
            let [a, b, c] = self.scene.mesh.corner_uvs(t);
            luminance(&self.radiance.data[self.radiance.nearest((a + b + c) / 3.0)])
        };
        let mean = |(t, &(sum, count)): (u32, &(f64, u32))| {
            if count > 0 { (sum / f64::from(count)) as f32 } else { centre(t) }
        };
        (0u32..).zip(&self.sums).map(mean).collect()
    }
}

#[cfg(test)]
mod tests;
