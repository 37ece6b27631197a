//! The atlas as surface points: which texels hold a piece of the mesh, and where in the world they are.

use glam::Vec2;
use rayon::prelude::*;

use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::raster::Raster;
use crate::scene::Scene;
use crate::surface::{Hit, SurfacePoint};
use crate::texture::{Pyramid, Tap};

/// How far a texel that its triangle only touches moves from the triangle's edge towards its middle: on the edge itself,
/// where rounding decides on which side of the neighbouring surface a ray starts, half of its rays would leave the room.
const OFF_EDGE: f32 = 1e-3;

/// The texel map of a mesh: the valid texels of a `width × height` atlas and their surface points, in atlas order.
#[derive(Clone, Debug)]
pub struct Atlas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Atlas index (row · width + column) of each valid texel, ascending.
    pub texels: Vec<u32>,
    /// The surface point of each valid texel, on the front side of its triangle; its sequence is the texel's index.
    pub points: Vec<SurfacePoint>,
    /// Texels whose centre lies in a triangle (the others are only touched by one), per valid texel.
    pub inside: Vec<bool>,
}

impl Atlas {
    /// Maps every texel to the mesh. Errors when no texel is covered.
    pub fn new(backend: &mut dyn Backend, scene: &Scene, width: usize, height: usize) -> Result<Self> {
        if width == 0 || height == 0 {
            return Err(Error::invalid(format!("the atlas is {width}×{height} texels; expected at least 1×1")));
        }
        let hits = backend.texels(width, height)?;
        let covered = || hits.iter().enumerate().filter(|(_, h)| h.is_hit());
        let point =
            |(i, hit)| SurfacePoint { sequence: i as u32, ..SurfacePoint::new(&scene.mesh, &off_edge(hit), None) };
        let atlas = Self {
            width,
            height,
            texels: covered().map(|(i, _)| i as u32).collect(),
            points: covered().map(point).collect(),
            inside: covered().map(|(_, h): (_, &Hit)| h.t > 0.0).collect(),
        };
        if atlas.texels.is_empty() {
            return Err(Error::invalid(format!(
                "no texel of the {width}×{height} atlas is covered by the mesh: its texture coordinates are missing, \
                 degenerate, or outside [0, 1]"
            )));
        }
        Ok(atlas)
    }

    /// One flag per atlas texel: does it hold a piece of the mesh?
    pub fn valid(&self) -> Vec<bool> {
        let mut valid = vec![false; self.width * self.height];
        self.texels.iter().for_each(|&t| valid[t as usize] = true);
        valid
    }

    /// The mip pyramid over the valid texels.
    pub fn pyramid(&self) -> Pyramid {
        Pyramid::new(self.width, self.height, &self.valid())
    }

    /// Area on the surface, m², of a texel on `triangle`; 0 for a triangle without area in the atlas.
    pub fn texel_area(&self, mesh: &Mesh, triangle: u32) -> f32 {
        let [a, b, c] = mesh.corners(triangle);
        let [ua, ub, uc] = mesh.corner_uvs(triangle);
        let world = (b - a).cross(c - a).length();
        let texels = (ub - ua).perp_dot(uc - ua).abs() * (self.width * self.height) as f32;
        if texels > 0.0 { world / texels } else { 0.0 }
    }

    /// Edge of the median texel on the surface, metres.
    pub fn typical_texel(&self, mesh: &Mesh) -> f32 {
        let mut areas: Vec<f32> = self.points.par_iter().map(|p| self.texel_area(mesh, p.triangle)).collect();
        let middle = areas.len() / 2;
        areas.select_nth_unstable_by(middle, f32::total_cmp).1.sqrt()
    }

    /// Puts one value per valid texel into the atlas, `empty` elsewhere.
    pub fn scatter<T: Copy>(&self, values: &[T], empty: T) -> Raster<T> {
        let mut raster = Raster::filled(self.width, self.height, empty);
        self.texels.iter().zip(values).for_each(|(&t, &v)| raster.data[t as usize] = v);
        raster
    }

    /// [`Atlas::scatter`] of the values flagged `known`, then `rings` times the empty texels next to filled ones take
    /// their first filled neighbour's value, so that lookups just outside find what is just inside.
    pub fn scatter_padded<T: Copy>(&self, values: &[T], known: &[bool], empty: T, rings: usize) -> Raster<T> {
        let mut raster = Raster::filled(self.width, self.height, empty);
        let mut filled = vec![false; self.width * self.height];
        for ((&texel, &value), _) in self.texels.iter().zip(values).zip(known).filter(|(_, known)| **known) {
            raster.data[texel as usize] = value;
            filled[texel as usize] = true;
        }
        for _ in 0..rings {
            let before = filled.clone();
            for y in 0..self.height {
                for x in 0..self.width {
                    if before[y * self.width + x] {
                        continue;
                    }
                    let neighbours = [(1, 1), (0, 1), (2, 1), (1, 0), (1, 2), (0, 0), (2, 0), (0, 2), (2, 2)]
                        .into_iter()
                        .filter_map(|(dx, dy)| {
                            let (nx, ny) = ((x + dx).checked_sub(1)?, (y + dy).checked_sub(1)?);
                            (nx < self.width && ny < self.height).then_some(ny * self.width + nx)
                        });
                    if let Some(from) = neighbours.into_iter().find(|&n| before[n]) {
                        raster.data[y * self.width + x] = raster.data[from];
                        filled[y * self.width + x] = true;
                    }
                }
            }
        }
        raster
    }
}

/// See [`OFF_EDGE`].
fn off_edge(hit: &Hit) -> Hit {
    if hit.t > 0.0 {
        return *hit;
    }
    let inwards = |v: f32| v + (1.0 / 3.0 - v) * OFF_EDGE;
    Hit { u: inwards(hit.u), v: inwards(hit.v), ..*hit }
}

/// Finds the valid texels at atlas positions, by their index in [`Atlas::texels`].
pub struct TexelIndex {
    width: usize,
    height: usize,
    index: Vec<u32>,
}

impl TexelIndex {
    const EMPTY: u32 = u32::MAX;

    /// The index of an atlas.
    pub fn new(atlas: &Atlas) -> Self {
        let mut index = vec![Self::EMPTY; atlas.width * atlas.height];
        for (i, &texel) in atlas.texels.iter().enumerate() {
            index[texel as usize] = i as u32;
        }
        Self { width: atlas.width, height: atlas.height, index }
    }

    /// The valid texel in column `x` and row `y`.
    pub fn at(&self, x: i64, y: i64) -> Option<u32> {
        let inside = x >= 0 && y >= 0 && x < self.width as i64 && y < self.height as i64;
        let texel = if inside { self.index[y as usize * self.width + x as usize] } else { Self::EMPTY };
        (texel != Self::EMPTY).then_some(texel)
    }

    /// The valid texel that `uv` lies in.
    pub fn nearest(&self, uv: Vec2) -> Option<u32> {
        let p = (uv * Vec2::new(self.width as f32, self.height as f32)).floor();
        self.at(p.x as i64, p.y as i64)
    }

    /// Bilinear shares of the valid texels around `uv`; they are not normalised.
    pub fn bilinear(&self, uv: Vec2) -> impl Iterator<Item = Tap> + use<'_> {
        let p = uv * Vec2::new(self.width as f32, self.height as f32) - 0.5;
        let base = p.floor();
        let f = p - base;
        [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().filter_map(move |(dx, dy)| {
            let weight = (if dx == 0 { 1.0 - f.x } else { f.x }) * (if dy == 0 { 1.0 - f.y } else { f.y });
            let x = (base.x as i64 + dx).clamp(0, self.width as i64 - 1);
            let y = (base.y as i64 + dy).clamp(0, self.height as i64 - 1);
            self.at(x, y).filter(|_| weight > 0.0).map(|texel| Tap { texel, weight })
        })
    }
}
