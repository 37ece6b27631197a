use super::*;
use crate::atlas::Atlas;
use crate::bake::tests::{lit, two_sheets};
use crate::progress::Silent;
use crate::raster::Rgb;

const SIDE: usize = 48;
const GATHER: Gather = Gather { cosine: 512, light: 0, seed: 3, part: 0 };
/// Relative error at which texels stop: above what some of them have at last, below what any has at first.
const TARGET: f32 = 0.25;

/// A floor below a ceiling of which a small part shines, gathered by cosine samples alone: mostly nothing, rarely much.
struct Noisy {
    points: Vec<SurfacePoint>,
    texel: f32,
    /// Luminance of E, nearly without noise.
    truth: Vec<f32>,
    sample: Box<dyn Fn(Gather, Option<f32>) -> Estimate>,
}

fn noisy() -> Noisy {
    let (scene, radiance) = two_sheets();
    let (scene, width) = (&*Box::leak(Box::new(scene)), radiance.width);
    let shines = |i: usize| (10..13).contains(&(i % width)) && (6..10).contains(&(i / width));
    let data = (0..radiance.data.len()).map(|i| [f32::from(u8::from(shines(i))); 3]).collect();
    let radiance = Rgb { data, ..radiance };
    let atlas = Atlas::new(&mut lit(scene, &radiance), scene, SIDE, SIDE).unwrap();
    let texel = atlas.typical_texel(&scene.mesh);
    let points: Vec<SurfacePoint> = atlas.points.into_iter().filter(|p| p.normal[2] > 0.0).collect();
    let gathered = lit(scene, &radiance).irradiance(&points, Gather { cosine: 2048, ..GATHER }, &Silent).unwrap();
    let truth = gathered.iter().map(|g| luminance(&g.irradiance)).collect();
    let floor = points.clone();
    let sample = move |gather, error| {
        let mut backend = lit(scene, &radiance);
        Estimate::sample(&mut backend, &floor, texel, gather, error, &Checkpoints::none(), &Silent).unwrap()
    };
    Noisy { points, texel, truth, sample: Box::new(sample) }
}

#[test]
fn texels_stop_without_bias() {
    let noisy = noisy();
    let n = noisy.points.len();
    let truth: f32 = noisy.truth.iter().sum();
    let (mut adaptive, mut by_own, mut rays, seeds) = (0.0, 0.0, 0, 6);
    for seed in 0..seeds {
        let gather = Gather { seed, ..GATHER };
        let estimate = (noisy.sample)(gather, Some(TARGET));
        adaptive += (0..n).map(|i| estimate.luminance(i)).sum::<f32>();
        rays += estimate.rays();
        // Negative control: texels that stop after the first round where their own halves agree.
        let [first, all] = [2 * FIRST, gather.cosine].map(|cosine| (noisy.sample)(Gather { cosine, ..gather }, None));
        let agrees = |i: usize| first.difference(i, first.floor()) <= TARGET;
        by_own += (0..n).map(|i| if agrees(i) { first.luminance(i) } else { all.luminance(i) }).sum::<f32>();
    }
    let share = rays as f32 / (n as u64 * u64::from(seeds) * u64::from(GATHER.cosine)) as f32;
    assert!((0.1..0.9).contains(&share), "{share} of the rays");
    let [adaptive, by_own] = [adaptive, by_own].map(|sum| sum / (seeds as f32 * truth));
    assert!((adaptive - 1.0).abs() < 0.01, "{adaptive} of the light");
    assert!(by_own < 0.95, "{by_own} of the light where texels decide for themselves");
}

#[test]
fn standard_errors_are_those_that_estimates_have() {
    let noisy = noisy();
    for error in [0.0, TARGET] {
        let estimate = (noisy.sample)(GATHER, Some(error));
        let errors = estimate.standard_errors(&noisy.points, noisy.texel);
        let squares = |value: &dyn Fn(usize) -> f32| (0..errors.len()).map(|i| value(i).powi(2)).sum::<f32>().sqrt();
        let told = squares(&|i| errors[i]) / squares(&|i| estimate.luminance(i) - noisy.truth[i]);
        assert!((0.85..1.15).contains(&told), "standard errors are {told} times the errors");
        let (floor, n) = (estimate.floor(), errors.len());
        let missed = (0..n).filter(|&i| errors[i] > TARGET * 1.3 * estimate.luminance(i).max(floor)).count();
        let capped = (0..n).filter(|&i| estimate.rays[i] == GATHER.cosine).count();
        assert!(missed <= capped, "{missed} texels missed the target, {capped} of them had all rays");
    }
}

#[test]
fn rounds_double_up_to_all_rays() {
    for (cosine, light, expected) in [(512, 512, 256), (100, 50, 50), (2, 2, 1), (33, 0, 16), (1000, 24, 500)] {
        let gather = Gather { cosine, light, ..GATHER };
        let rounds = rounds(gather, true);
        let mut sum = 0;
        for round in &rounds {
            assert!(round.part == u32::from(sum > 0) && (sum == 0 || round.cosine == sum), "{rounds:?}");
            sum += round.cosine;
        }
        assert!(sum <= expected && sum + (1 << rounds.len()) > expected, "{rounds:?}");
        assert_eq!(super::rounds(gather, false).len(), 1);
    }
}
