//! The few colours that a flat surface is painted in: of a rug on a floor, but neither of its pattern nor of the shine
//! of a window on it. Colour is that of the HDR texture under its irradiance.

use glam::Vec3A;
use rayon::prelude::*;

use crate::fit::adjacency::Adjacency;
use crate::fit::full::albedo::palette::Palettes;
use crate::fit::full::partition::Partition;
use crate::fit::full::segments::votes;
use crate::fit::settings::PaletteSettings;

/// What is one colour.
const ON_A_SURFACE: PaletteSettings =
    PaletteSettings { bandwidth: 0.25, colours: 8, min_share: 0.03, strength: 0.0, reach: 1.0 };
/// Colours are blurred by this standard deviation before, metres.
const BLUR: f32 = 0.05;

/// The colours of texels. Lists are per texel.
pub struct Colours {
    /// Albedo, blurred over the texel's flat surface.
    pub albedo: Vec<Vec3A>,
    /// Which of the colours of its flat surface a texel has.
    pub colour: Vec<usize>,
}

impl Colours {
    /// Finds the colours of every flat `surface`, by the texels of it that are `seen`. `albedo` may be as rough as
    /// π · radiance / irradiance; `texel` is the edge of a typical texel, metres.
    pub fn find(
        adjacency: &Adjacency,
        surface: &[u32],
        albedo: &[Vec3A],
        seen: impl Fn(usize) -> bool + Sync,
        texel: f32,
    ) -> Self {
        let together = |a: u32, b: u32| {
            let (a, b) = (a as usize, b as usize);
            surface[a] == surface[b] && seen(a) && seen(b)
        };
        let albedo = blurred(adjacency, together, albedo, texel);
        let surfaces = Partition { of: surface, count: surface.iter().max().map_or(0, |last| *last as usize + 1) };
        let palettes = Palettes::find(&albedo, surfaces, &seen, &ON_A_SURFACE);
        let colour = (surface, &albedo).into_par_iter().map(|(s, a)| palettes.nearest(*s, *a)).collect();
        Self { albedo, colour }
    }
}

/// Albedo averaged over neighbours that belong together.
fn blurred(
    adjacency: &Adjacency,
    together: impl Fn(u32, u32) -> bool + Sync,
    albedo: &[Vec3A],
    texel: f32,
) -> Vec<Vec3A> {
    let mut albedo = albedo.to_vec();
    for _ in 0..votes::rounds(BLUR, texel) {
        let mean = |t: u32| {
            let own = (albedo[t as usize], 1.0);
            let around = adjacency.around(t).filter(|&n| together(t, n));
            let (sum, count) = around.fold(own, |(sum, count), n| (sum + albedo[n as usize], count + 1.0));
            sum / count
        };
        albedo = (0..albedo.len() as u32).into_par_iter().map(mean).collect();
    }
    albedo
}
