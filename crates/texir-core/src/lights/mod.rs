//! Light sources of a TBL as a sampled set: the triangles that shine, in clusters whose share of the samples depends on
//! where the sampled light arrives.
//!
//! The scene's surface is cut into cells, by position and by the way it faces. Each has a table over the clusters,
//! learned from a few shadow rays (`learn.rs`), so that samples do not go to lamps of other rooms. Any set and any
//! tables give an unbiased gather: what they leave out is found by the cosine samples, and the balance heuristic weighs
//! both.

mod cluster;
pub(crate) mod find;
mod learn;

use std::hash::{Hash, Hasher};

use bytemuck::{Pod, Zeroable, cast_slice};
use glam::Vec3;

use crate::distribution::sample_cdf;
use crate::mesh::Mesh;
use crate::real::{Real, V3};
use crate::surface::facing;

/// A triangle counts as a light when its mean luminance is this many times the mean over the scene's surface: direct
/// light of a smaller contrast is found well enough by cosine samples.
pub(crate) const CONTRAST: f32 = 3.0;

/// A sampled triangle.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LightTriangle {
    /// Index in the mesh.
    pub triangle: u32,
    /// The cluster that it is of.
    pub cluster: u32,
    /// Probability, within the cluster, of this triangle and those before it.
    pub cdf: f32,
    /// Density, per square metre, of points on the triangle once its cluster is chosen.
    pub pdf_area: f32,
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
    /// Per cell (x fastest) and facing, six to a cell: which of [`Lights::tables`] holds there; 0, the global one,
    /// where nothing was learned.
    pub tables: Vec<u32>,
}

/// The sampled light sources of one TBL.
#[derive(Clone, Debug, PartialEq)]
pub struct Lights {
    /// The triangles that shine, cluster by cluster; empty when nothing stands out.
    pub triangles: Vec<LightTriangle>,
    /// The first of each cluster's triangles, and at last their number.
    pub clusters: Vec<u32>,
    /// Per mesh triangle: 1 + its index in `triangles`, 0 for what is no light.
    pub light_of_triangle: Vec<u32>,
    /// Whether all backs are black, as those of lights always are; else what is no light shows the same radiance on
    /// either side.
    pub one_sided: bool,
    /// Where which table holds.
    pub grid: LightGrid,
    /// Tables of a number per cluster: the probability of it and those before it. The first is by power alone.
    pub tables: Vec<f32>,
}

impl Hash for Lights {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { triangles, clusters, light_of_triangle, one_sided, grid, tables } = self;
        (cast_slice::<_, u8>(triangles), clusters, light_of_triangle, one_sided).hash(state);
        let LightGrid { origin, per_metre, size, tables: of_cells } = grid;
        (origin.to_array().map(f32::to_bits), per_metre.to_bits(), size, of_cells).hash(state);
        cast_slice::<_, u8>(tables).hash(state);
    }
}

impl Lights {
    /// No lights: a gather that samples the cosine alone.
    pub fn none(mesh: &Mesh) -> Self {
        let grid = LightGrid { origin: Vec3::ZERO, per_metre: 0.0, size: [0; 3], tables: Vec::new() };
        let light_of_triangle = vec![0; mesh.triangles.len()];
        Self { triangles: Vec::new(), clusters: vec![0], light_of_triangle, one_sided: false, grid, tables: Vec::new() }
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
        let numbered = |(number, light): (u32, &LightTriangle)| {
            self.light_of_triangle.get(light.triangle as usize) == Some(&number) && (light.cluster as usize) < clusters
        };
        ascending
            && whole
            && (clusters == 0 || tables > 0)
            && (1..).zip(&self.triangles).all(numbered)
            && self.light_of_triangle.iter().all(|&number| number as usize <= self.triangles.len())
            && self.grid.tables.len() == 6 * x * y * z
            && (clusters == 0 || self.grid.tables.iter().all(|&table| (table as usize) < tables))
    }

    /// What a mesh triangle is sampled as; `None` for what is no light.
    pub fn of(&self, triangle: u32) -> Option<&LightTriangle> {
        let number = self.light_of_triangle[triangle as usize] as usize;
        number.checked_sub(1).map(|index| &self.triangles[index])
    }

    /// Whether the back of a mesh triangle is black.
    pub fn is_black_behind(&self, triangle: u32) -> bool {
        self.one_sided || self.light_of_triangle[triangle as usize] > 0
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

    /// The triangle of `cluster` at `u` of its CDF, and how far `u` lies within the triangle's
    /// share.
    pub fn triangle(&self, cluster: usize, u: f32) -> (u32, f32) {
        let members = &self.triangles[self.clusters[cluster] as usize..self.clusters[cluster + 1] as usize];
        let (i, rest) = sample_cdf(members.len(), |i| members[i].cdf, u);
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

/// A uniform point of a triangle, by the square-root map.
pub fn point_on<R: Real>(mesh: &Mesh, triangle: u32, [u, v]: [f32; 2]) -> V3<R> {
    let [a, b, c] = mesh.corners(triangle).map(|p| V3::of(p.to_array()));
    let root = R::of(f64::from(u)).sqrt();
    let v = R::of(f64::from(v));
    a * (R::of(1.0) - root) + b * (root * (R::of(1.0) - v)) + c * (root * v)
}

#[cfg(test)]
mod tests;
