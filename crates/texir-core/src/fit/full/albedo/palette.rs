//! The colours that a segment is painted with.
//!
//! What limits albedo is irradiance, whose error at the scale of texels reads as albedo (a darker spot or a shadow?).
//! People paint, tile and weave in few colours: where the texels of a segment gather around some, a texel near one of
//! them is more likely to be lit differently than painted differently.

use std::collections::BTreeMap;
use std::iter::once;

use glam::{DVec3, IVec3, Vec3A};
use rayon::prelude::*;

use crate::fit::full::partition::Partition;
use crate::fit::settings::PaletteSettings;

/// Keeps the logarithm of black finite.
const BLACK: f32 = 0.01;
/// Steps of mean shift from each seed.
const STEPS: usize = 30;
/// Seeds: the fullest cells of a segment.
const SEEDS: usize = 32;

/// The colours of every segment, as logarithms, those with the most texels first.
pub struct Palettes(Vec<Vec<Vec3A>>);

impl Palettes {
    /// Finds the colours of the texels that are `seen`: modes of their density in ln a, by mean shift (Comaniciu and
    /// Meer, "Mean Shift: A Robust Approach Toward Feature Space Analysis", 2002).
    pub fn find(
        albedo: &[Vec3A],
        segment: Partition<'_>,
        seen: impl Fn(usize) -> bool,
        settings: &PaletteSettings,
    ) -> Self {
        // In single precision, sums of millions would stop growing.
        let mut cells: Vec<BTreeMap<[i32; 3], (DVec3, u32)>> = vec![BTreeMap::new(); segment.count];
        for (t, &s) in segment.of.iter().enumerate().filter(|(t, _)| seen(*t)) {
            let colour = log(albedo[t]);
            let key: IVec3 = (colour / (0.5 * settings.bandwidth)).floor().as_ivec3();
            let (sum, count) = cells[s as usize].entry(key.to_array()).or_default();
            *sum += colour.as_dvec3();
            *count += 1;
        }
        let modes = |cells: &BTreeMap<[i32; 3], (DVec3, u32)>| {
            let cell = |&(sum, count): &(DVec3, u32)| ((sum / f64::from(count)).as_vec3a(), count as f32);
            modes(&cells.values().map(cell).collect::<Vec<_>>(), settings)
        };
        Self(cells.par_iter().map(modes).collect())
    }

    /// Which colour of its segment a texel is nearest to; 0 for a segment without any.
    pub fn nearest(&self, segment: u32, albedo: Vec3A) -> usize {
        let colour = log(albedo);
        let distance = |i: &usize| self.0[segment as usize][*i].distance_squared(colour);
        (0..self.0[segment as usize].len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// The nearest colour of every texel's segment, numbered as [`Palettes::starts`] says.
    pub fn numbered(&self, segment: Partition<'_>, albedo: &[Vec3A]) -> Vec<u32> {
        let starts = self.starts();
        let of_texel = |(s, a): (&u32, &Vec3A)| starts[*s as usize] + self.nearest(*s, *a) as u32;
        (segment.of, albedo).into_par_iter().map(of_texel).collect()
    }

    /// The albedo drawn towards its segment's nearest colour: all of [`PaletteSettings::strength`] on the colour
    /// itself, less the further it is away, in units of [`PaletteSettings::reach`].
    pub fn drawn(&self, segment: u32, albedo: Vec3A, settings: &PaletteSettings) -> Vec3A {
        let Some(mode) = self.0[segment as usize].get(self.nearest(segment, albedo)) else { return albedo };
        let colour = log(albedo);
        let distance = (*mode - colour).length() / settings.reach;
        let pull = settings.strength * (-0.5 * distance * distance).exp();
        let exp = |c: Vec3A| Vec3A::new(c.x.exp(), c.y.exp(), c.z.exp()) - BLACK;
        exp(colour + pull * (*mode - colour)).clamp(Vec3A::ZERO, Vec3A::ONE)
    }

    /// Offsets of the segments' colours in one numbering of all, and at last their count. A segment without any counts
    /// as one.
    pub fn starts(&self) -> Vec<u32> {
        let ends = self.0.iter().scan(0, |end, colours| {
            *end += colours.len().max(1) as u32;
            Some(*end)
        });
        once(0).chain(ends).collect()
    }
}

/// Colour as it is compared: the logarithm of albedo.
pub fn log(albedo: Vec3A) -> Vec3A {
    let a = albedo + BLACK;
    Vec3A::new(a.x.ln(), a.y.ln(), a.z.ln())
}

/// Modes of a density given as weighted cells.
fn modes(cells: &[(Vec3A, f32)], settings: &PaletteSettings) -> Vec<Vec3A> {
    let h2 = settings.bandwidth.powi(2);
    let kernel = |a: Vec3A, b: Vec3A| (-0.5 * a.distance_squared(b) / h2).exp();
    let mut seeds: Vec<(Vec3A, f32)> = cells.to_vec();
    seeds.sort_by(|a, b| b.1.total_cmp(&a.1));
    seeds.truncate(SEEDS);
    let mut found: Vec<(Vec3A, f32)> = Vec::new();
    for (seed, _) in seeds {
        let mut mode = seed;
        for _ in 0..STEPS {
            let (sum, weight) = cells.iter().fold((Vec3A::ZERO, 0.0), |(sum, weight), (colour, count)| {
                let w = kernel(mode, *colour) * count;
                (sum + *colour * w, weight + w)
            });
            if weight <= 0.0 {
                break;
            }
            mode = sum / weight;
        }
        if found.iter().all(|(other, _)| other.distance_squared(mode) > h2) {
            found.push((mode, 0.0));
        }
    }
    let all: f32 = cells.iter().map(|(_, count)| count).sum();
    for (colour, count) in cells {
        let near =
            found.iter_mut().min_by(|a, b| a.0.distance_squared(*colour).total_cmp(&b.0.distance_squared(*colour)));
        if let Some((_, share)) = near {
            *share += count / all;
        }
    }
    found.retain(|(_, share)| *share >= settings.min_share);
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.truncate(settings.colours);
    found.into_iter().map(|(mode, _)| mode).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn palettes_gather_what_is_painted_alike_and_leave_the_rest() {
        let settings = PaletteSettings::default();
        // Two paints, each texel off by up to 6 %, and one texel of neither.
        let off = |t: usize| 1.0 + 0.06 * ((t * 7 % 13) as f32 / 6.0 - 1.0);
        let (red, blue, odd) = (Vec3A::new(0.6, 0.2, 0.1), Vec3A::new(0.1, 0.2, 0.5), Vec3A::new(0.9, 0.9, 0.1));
        let mut albedo: Vec<Vec3A> = (0..200).map(|t| if t % 3 == 0 { red } else { blue } * off(t)).collect();
        albedo.push(odd);
        let palettes = Palettes::find(&albedo, Partition { of: &vec![0; 201], count: 1 }, |_| true, &settings);
        assert_eq!(palettes.starts(), [0, 2]);
        let spread = |albedo: &dyn Fn(usize) -> Vec3A| {
            (0..200).map(|t| (albedo(t) / if t % 3 == 0 { red } else { blue } - 1.0).abs().max_element()).sum::<f32>()
        };
        let drawn = |t: usize| palettes.drawn(0, albedo[t], &settings);
        assert!(spread(&drawn) < 0.5 * spread(&|t| albedo[t]), "{} {}", spread(&drawn), spread(&|t| albedo[t]));
        assert!((drawn(200) - odd).abs().max_element() < 0.01, "{}", drawn(200));
        let none = PaletteSettings { strength: 0.0, ..settings };
        assert!((palettes.drawn(0, albedo[5], &none) - albedo[5]).abs().max_element() < 1e-5);
    }
}
