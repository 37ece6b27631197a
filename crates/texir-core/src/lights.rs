//! Light sources of a TBL as a sampled set: an alias table over the triangles that shine.
//!
//! Any set gives an unbiased gather: triangles that are not in it are found by the cosine samples, and the balance
//! heuristic weighs both. A good set holds the few triangles that carry most of the variance.

use bytemuck::{Pod, Zeroable};

use crate::atlas::Atlas;
use crate::mesh::Mesh;
use crate::raster::Rgb;

/// A triangle counts as a light when its mean luminance is this many times the mean over the scene's surface: direct light
/// of a smaller contrast is found well enough by cosine samples.
const CONTRAST: f32 = 3.0;

/// One slot of the alias table (Walker 1977, built by Vose's method).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct AliasSlot {
    /// The light of this slot: a triangle index.
    pub triangle: u32,
    /// The light taken instead with probability 1 − `keep`: a triangle index.
    pub alias: u32,
    /// Probability of the slot's own light.
    pub keep: f32,
    /// Keeps the 16-byte layout of the WGSL struct.
    pub pad: f32,
}

/// The sampled light sources of one TBL.
#[derive(Clone, Debug, PartialEq)]
pub struct Lights {
    /// Slots, each drawn with the same probability; empty when nothing stands out.
    pub slots: Vec<AliasSlot>,
    /// Per mesh triangle: the density, per square metre, with which [`Lights::slots`] picks a point on it.
    pub density: Vec<f32>,
}

impl Lights {
    /// No lights: a gather that samples the cosine alone.
    pub fn none(mesh: &Mesh) -> Self {
        Self { slots: Vec::new(), density: vec![0.0; mesh.triangles.len()] }
    }

    /// The triangles that stand out in `radiance` (in the atlas's size), drawn in proportion to luminance × area.
    pub fn find(mesh: &Mesh, atlas: &Atlas, radiance: &Rgb) -> Self {
        let luminance = |c: &[f32; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
        let triangles = mesh.triangles.len();
        let (mut sum, mut count) = (vec![0.0f32; triangles], vec![0u32; triangles]);
        for (texel, point) in atlas.texels.iter().zip(&atlas.points) {
            sum[point.triangle as usize] += luminance(&radiance.data[*texel as usize]);
            count[point.triangle as usize] += 1;
        }
        let area: Vec<f32> = (0..triangles as u32)
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                0.5 * (b - a).cross(c - a).length()
            })
            .collect();
        let mean: Vec<f32> = (0..triangles)
            .map(|t| {
                if count[t] > 0 {
                    return sum[t] / count[t] as f32;
                }
                // Smaller than a texel: what a ray that hits it would see.
                let [a, b, c] = mesh.corner_uvs(t as u32);
                let uv = (a + b + c) / 3.0;
                let texel = |x: f32, size: usize| ((x * size as f32).max(0.0) as usize).min(size - 1);
                luminance(radiance.at(texel(uv.x, radiance.width), texel(uv.y, radiance.height)))
            })
            .collect();
        let total_area: f64 = area.iter().map(|&a| f64::from(a)).sum();
        let total: f64 = mean.iter().zip(&area).map(|(&l, &a)| f64::from(l * a)).sum();
        let threshold = CONTRAST * (total / total_area) as f32;
        let chosen: Vec<u32> =
            (0..triangles).filter(|&t| mean[t] > threshold && area[t] > 0.0).map(|t| t as u32).collect();
        let power: Vec<f64> =
            chosen.iter().map(|&t| f64::from(mean[t as usize]) * f64::from(area[t as usize])).collect();
        let all: f64 = power.iter().sum();
        let mut lights = Self::none(mesh);
        if all > 0.0 && all.is_finite() {
            for (&t, p) in chosen.iter().zip(&power) {
                lights.density[t as usize] = (p / all) as f32 / area[t as usize];
            }
            lights.slots = alias_table(&chosen, &power, all);
        }
        lights
    }
}

/// Vose's alias method over `weights` that sum to `total`.
fn alias_table(items: &[u32], weights: &[f64], total: f64) -> Vec<AliasSlot> {
    let n = items.len();
    let mut share: Vec<f64> = weights.iter().map(|w| w / total * n as f64).collect();
    let mut slots: Vec<AliasSlot> =
        items.iter().map(|&t| AliasSlot { triangle: t, alias: t, keep: 1.0, pad: 0.0 }).collect();
    let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..n).partition(|&i| share[i] < 1.0);
    while let (Some(&s), Some(&l)) = (small.last(), large.last()) {
        small.pop();
        slots[s].keep = share[s] as f32;
        slots[s].alias = items[l];
        share[l] -= 1.0 - share[s];
        if share[l] < 1.0 {
            large.pop();
            small.push(l);
        }
    }
    slots
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_alias_table_draws_in_proportion() {
        let (items, weights) = ([3u32, 5, 8, 9], [0.1, 2.0, 0.7, 1.2]);
        let slots = alias_table(&items, &weights, 4.0);
        for (item, weight) in items.iter().zip(weights) {
            let own: f64 = slots.iter().filter(|s| s.triangle == *item).map(|s| f64::from(s.keep)).sum();
            let lent: f64 = slots.iter().filter(|s| s.alias == *item).map(|s| 1.0 - f64::from(s.keep)).sum();
            assert!(((own + lent) / 4.0 - weight / 4.0).abs() < 1e-6, "item {item}: {own} + {lent}");
        }
    }
}
