//! Where light passes through an authored scene: what rays meet of its triangles.

use glam::Vec2;
use rayon::prelude::*;

use super::gltf::{Face, Model};
use super::opacity::{Cover, Opacity, longest};
use crate::error::listed;
use crate::rng::hash2;
use crate::scene::TriangleOpacity;

/// Parts of triangles in the whole scene: 8 MiB of bits, told in some seconds. What has more is cut into coarser parts.
const MOST_PARTS: f64 = (1u64 << 26) as f64;

impl Model {
    /// Tells what rays meet of every part's triangles, and the user where they go through. The mesh must have the
    /// lightmap's coordinates.
    pub(super) fn find_openings(&mut self) -> Option<String> {
        let opacity_of = |part: usize| -> &Opacity { &self.shading[self.shading_of(&self.parts[part])].opacity };
        let places: Vec<(u32, Face)> =
            (0..).zip(self.faces()).filter(|(_, face)| !opacity_of(face.part).is_opaque()).collect();
        let size = Vec2::new(self.size[0] as f32, self.size[1] as f32);
        let cover = |&(on_mesh, Face { part, triangle, .. }): &(u32, Face)| {
            let (uvs, corners) = (&self.parts[part].uvs, self.parts[part].triangles[triangle]);
            let of_set = move |set: usize| uvs.get(set).map(|uvs| corners.map(|i| uvs[i as usize])).unwrap_or_default();
            let on_map = self.mesh.corner_uvs(on_mesh).map(|uv| uv * size);
            Cover { corners: of_set, texels: longest(on_map) }
        };
        let sides: Vec<u32> =
            places.par_iter().map(|place| opacity_of(place.1.part).side(&cover(place), &self.images)).collect();
        let parts: f64 = sides.iter().map(|&side| f64::from(side).powi(2)).sum();
        let coarser = (MOST_PARTS / parts).sqrt().min(1.0);
        let opacity: Vec<TriangleOpacity> = places
            .par_iter()
            .zip(sides)
            .map(|(place @ (_, Face { part, triangle, .. }), side)| {
                let side = (f64::from(side) * coarser).ceil() as u32;
                let seed = hash2(*triangle as u32, *part as u32);
                opacity_of(*part).over(&cover(place), (side, seed), &self.images)
            })
            .collect();
        for ((_, face), opacity) in places.into_iter().zip(opacity) {
            self.parts[face.part].opacity.push(opacity);
        }
        let mut open = Vec::new();
        for part in &mut self.parts {
            if part.opacity.iter().all(|opacity| *opacity == TriangleOpacity::Opaque) {
                part.opacity = Vec::new();
            } else {
                open.push(format!("\"{}\"", part.name));
            }
        }
        (!open.is_empty()).then(|| {
            format!(
                "{} primitives are transparent, or in parts, and let light through untinted: {}",
                open.len(),
                listed(&open)
            )
        })
    }
}
