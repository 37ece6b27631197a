//! Which segments are metal. A smooth metal mirrors its surroundings with up to twenty-five times a dielectric's
//! strength and in its own colour, which no dielectric can; a rough one looks like any diffuse surface, and is not told
//! from one.

use super::evidence::Tally;
use crate::fit::settings::MetallicSettings;
use crate::specular_table::{NODES, node};

/// The segments that metal explains better than a dielectric by `settings.gain`, at a roughness at which it can be
/// told; of those with enough pixels. The segments' tallies are given twice: as dielectrics, and as metals.
pub fn find([dielectric, metal]: [&[Tally]; 2], settings: &MetallicSettings) -> Vec<bool> {
    let least = |tally: &Tally| -> (f32, usize) {
        let misfit = tally.misfit();
        let best = (0..NODES).min_by(|a, b| misfit[*a].total_cmp(&misfit[*b])).unwrap_or(0);
        (misfit[best], best)
    };
    let is_metal = |(dielectric, metal): (&Tally, &Tally)| {
        let ((as_dielectric, _), (as_metal, best)) = (least(dielectric), least(metal));
        metal.pixels >= f64::from(settings.min_pixels)
            && as_dielectric - as_metal > settings.gain
            && node(best) <= settings.max_roughness
    };
    dielectric.iter().zip(metal).map(is_metal).collect()
}
