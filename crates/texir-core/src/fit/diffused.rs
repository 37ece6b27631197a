//! Light without highlights: the HDR texture once the materials are known.
//!
//! What a texel of it holds is what the views saw there, reflections of lamps and windows included, as if the surface sent that
//! everywhere. A surface that is known sends (a + s) E/π on average over all directions: a E/π is what the fit explains of the
//! views by diffuse reflection, and s what a dielectric reflects specularly of uniform light. A fit under that light relaxes
//! TexIR's assumption that what is captured is diffuse (Li et al. 2023, section 6).

use std::f32::consts::FRAC_1_PI;

use super::Materials;
use crate::atlas::Atlas;
use crate::bake::PADDING;
use crate::capture::{Coverage, Tbl};
use crate::raster::{Mask, Rgb};

/// What a dielectric (F0 = 0.04) reflects specularly of uniform light, ∫ F D G / (4 cos_o cos_i) cos_i dω averaged over cos_o:
/// from 0.04 (rough) to 0.08 (smooth).
const SPECULAR: f32 = 0.06;

/// Radiance of every texel without highlights. Light sources, metals and what no view sees keep theirs.
pub fn radiance(atlas: &Atlas, tbl: &Tbl, materials: &Materials, emitters: &Mask) -> Rgb {
    let sent = |&t: &u32| -> [f32; 3] {
        let t = t as usize;
        let is_metal = materials.metallic.as_ref().is_some_and(|metallic| metallic.data[t] > 0.0);
        if emitters.data[t] || is_metal || tbl.coverage.data[t] != Coverage::Seen {
            return tbl.radiance.data[t];
        }
        let (albedo, irradiance) = (materials.albedo.data[t], materials.irradiance.data[t]);
        std::array::from_fn(|c| (albedo[c] + SPECULAR) * irradiance[c] * FRAC_1_PI)
    };
    let sent: Vec<[f32; 3]> = atlas.texels.iter().map(sent).collect();
    atlas.scatter_padded(&sent, &vec![true; sent.len()], [0.0; 3], PADDING)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::Masking;
    use crate::diffuse::DiffuseModel;
    use crate::raster::{Gray, Raster};

    #[test]
    fn highlights_are_not_sent_on_but_lamps_metals_and_what_is_unseen_are() {
        let atlas = Atlas { width: 4, height: 1, texels: (0..4).collect(), points: Vec::new(), inside: Vec::new() };
        let row = |data: Vec<f32>| Gray { width: 4, height: 1, data };
        let map = |data: [f32; 4]| Rgb { width: 4, height: 1, data: data.map(|v| [v; 3]).to_vec() };
        let tbl = Tbl {
            radiance: map([5.0, 7.0, 3.0, 2.0]),
            coverage: Raster {
                width: 4,
                height: 1,
                data: vec![Coverage::Seen, Coverage::Seen, Coverage::Seen, Coverage::Inpainted],
            },
        };
        let materials = Materials {
            albedo: map([0.44; 4]),
            roughness: row(vec![0.1; 4]),
            metallic: Some(row(vec![0.0, 0.0, 1.0, 0.0])),
            irradiance: map([std::f32::consts::TAU; 4]),
            diffuse: DiffuseModel::default(),
            masking: Masking::default(),
            confidence: None,
        };
        let emitters = Mask { width: 4, height: 1, data: vec![false, true, false, false] };
        let sent = radiance(&atlas, &tbl, &materials, &emitters);
        for (found, expected) in sent.data.iter().zip([1.0, 7.0, 3.0, 2.0]) {
            assert!((found[0] - expected).abs() < 1e-5, "{:?}", sent.data);
        }
    }
}
