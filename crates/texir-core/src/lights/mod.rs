//! Light sources of a TBL as a sampled set: the triangles that shine, or those of their parts that do, in clusters
//! whose share of the samples depends on where the sampled light arrives.
//!
//! The scene's surface is cut into cells, by position and by the way it faces. Each has a table over the clusters,
//! learned from a few shadow rays (`learn.rs`), so that samples do not go to lamps of other rooms. Any set and any
//! tables give an unbiased gather: what they leave out is found by the cosine samples, and the balance heuristic weighs
//! both.

mod cluster;
pub(crate) mod find;
mod learn;
mod part;

use std::hash::{Hash, Hasher};

use bytemuck::{Pod, Zeroable, cast_slice};
use glam::Vec3;

pub use self::part::Part;
use crate::distribution::sample_cdf;
use crate::mesh::Mesh;
use crate::real::{Real, V3};
use crate::surface::facing;

/// What has this many times the mean luminance of the scene's surface counts as a light: direct light of a smaller
/// contrast is found well enough by cosine samples.
pub(crate) const CONTRAST: f32 = 3.0;

/// A part of a triangle, as it is sampled.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LightPart {
    /// Index in the mesh.
    pub triangle: u32,
    /// Which part of the triangle.
    pub part: Part,
    /// The cluster that it is of; 0 for what is no light.
    pub cluster: u32,
    /// Density, per square metre, of points on the part once its cluster is chosen; 0 for what is no light.
    pub pdf_area: f32,
}

/// Where the parts of a triangle are among all: the first, and how often its edges are halved.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct Cut(u32);

impl Cut {
    /// Of a triangle that is no light: the first of all parts stands for it.
    pub const NONE: Self = Self(0);

    /// As `shared/light_sampling.wgsl` has it: the level in the last four bits.
    fn new(first: u32, level: u32) -> Self {
        Self(first << 4 | level)
    }

    fn first(self) -> usize {
        (self.0 >> 4) as usize
    }

    fn level(self) -> u32 {
        self.0 & 0xf
    }
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
    /// What stands for all triangles that are no light; then, triangle by triangle, the parts of those that shine
    /// somewhere, dark parts included, by [`Part::number`].
    pub parts: Vec<LightPart>,
    /// Per mesh triangle, where its parts are.
    pub cuts: Vec<Cut>,
    /// The parts that shine, cluster by cluster, as indices into `parts`; empty when nothing stands out.
    pub members: Vec<u32>,
    /// Per member, the probability, within its cluster, of it and those before it.
    pub cdf: Vec<f32>,
    /// The first of each cluster's members, and at last their number.
    pub clusters: Vec<u32>,
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
        let Self { parts, cuts, members, cdf, clusters, one_sided, grid, tables } = self;
        (cast_slice::<_, u8>(parts), cuts, members, cast_slice::<_, u8>(cdf), clusters, one_sided).hash(state);
        let LightGrid { origin, per_metre, size, tables: of_cells } = grid;
        (origin.to_array().map(f32::to_bits), per_metre.to_bits(), size, of_cells).hash(state);
        cast_slice::<_, u8>(tables).hash(state);
    }
}

impl Lights {
    /// No lights: a gather that samples the cosine alone.
    pub fn none(mesh: &Mesh) -> Self {
        Self {
            parts: vec![LightPart { triangle: 0, part: Part::WHOLE, cluster: 0, pdf_area: 0.0 }],
            cuts: vec![Cut::NONE; mesh.triangles.len()],
            members: Vec::new(),
            cdf: Vec::new(),
            clusters: vec![0],
            one_sided: false,
            grid: LightGrid { origin: Vec3::ZERO, per_metre: 0.0, size: [0; 3], tables: Vec::new() },
            tables: Vec::new(),
        }
    }

    /// Whether there is nothing to sample.
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// Whether every index of one field lies within another, parts are where their triangles' cuts say, and no cluster
    /// is empty. Only lights made by hand, field by field, may not be.
    pub fn is_consistent(&self) -> bool {
        let clusters = self.clusters.len().saturating_sub(1);
        let ascending = self.clusters.first() == Some(&0)
            && self.clusters.is_sorted_by(|a, b| a < b)
            && self.clusters.last().is_some_and(|&n| n as usize == self.members.len());
        let whole = if clusters == 0 { self.tables.is_empty() } else { self.tables.len().is_multiple_of(clusters) };
        let tables = self.tables.len().checked_div(clusters).unwrap_or(0);
        let [x, y, z] = self.grid.size.map(|n| n as usize);
        let placed = |(triangle, cut): (u32, &Cut)| {
            *cut == Cut::NONE
                || (Part::all(cut.level()).zip(cut.first()..)).all(|(part, index)| {
                    self.parts.get(index).is_some_and(|of| of.triangle == triangle && of.part == part)
                })
        };
        // Those of a cut are there, as `placed` says.
        let is_of_its_triangle = |&member: &u32| {
            let cut = self.parts.get(member as usize).and_then(|part| self.cuts.get(part.triangle as usize));
            cut.is_some_and(|cut| {
                *cut != Cut::NONE && (cut.first()..cut.first() + (1 << (2 * cut.level()))).contains(&(member as usize))
            })
        };
        let known = |part: &LightPart| (part.cluster as usize) < clusters.max(1);
        ascending
            && whole
            && (clusters == 0 || tables > 0)
            && self.cdf.len() == self.members.len()
            && self.members.iter().all(is_of_its_triangle)
            && self.parts.first().is_some_and(|none| none.pdf_area == 0.0)
            && self.parts.iter().all(known)
            && (0..).zip(&self.cuts).all(placed)
            && self.grid.tables.len() == 6 * x * y * z
            && (clusters == 0 || self.grid.tables.iter().all(|&table| (table as usize) < tables))
    }

    /// What a place of a mesh triangle, by barycentric coordinates of its second and third corner, is sampled as;
    /// `None` for what is no light.
    pub fn at(&self, triangle: u32, barycentric: [f32; 2]) -> Option<&LightPart> {
        let cut = self.cuts[triangle as usize];
        if cut == Cut::NONE {
            return None;
        }
        let part = &self.parts[cut.first() + Part::at(cut.level(), barycentric).number() as usize];
        (part.pdf_area > 0.0).then_some(part)
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

    /// The part of `cluster` at `u` of its CDF, and how far `u` lies within the part's share.
    pub fn part(&self, cluster: usize, u: f32) -> (&LightPart, f32) {
        let range = self.clusters[cluster] as usize..self.clusters[cluster + 1] as usize;
        let cdf = &self.cdf[range.clone()];
        let (i, rest) = sample_cdf(cdf.len(), |i| cdf[i], u);
        (&self.parts[self.members[range][i] as usize], rest)
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

impl LightPart {
    /// A uniform point of it, by the square-root map.
    pub fn point<R: Real>(&self, mesh: &Mesh, [u, v]: [f32; 2]) -> V3<R> {
        let [a, b, c] = mesh.corners(self.triangle).map(|p| V3::of(p.to_array()));
        let root = R::of(f64::from(u)).sqrt();
        let v = R::of(f64::from(v));
        let (start, slope, scale) = self.part.placement();
        let of = |start: f32, x: R| (R::of(f64::from(start)) + R::of(f64::from(slope)) * x) * R::of(f64::from(scale));
        a + (b - a) * of(start[0], root * (R::of(1.0) - v)) + (c - a) * of(start[1], root * v)
    }
}

#[cfg(test)]
mod tests;
