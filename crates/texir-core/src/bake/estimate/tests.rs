use std::sync::Arc;

use super::*;
use crate::atlas::Atlas;
use crate::bake::tests::{lit, two_sheets};
use crate::progress::Silent;
use crate::raster::Rgb;
use crate::scene::Scene;

const SIDE: usize = 48;
const GATHER: Gather = Gather::new(512, 0, 3);
/// Relative error at which texels stop: above what some of them have at last, below what any has at first.
const TARGET: f32 = 0.25;

/// A floor below a ceiling of which a small part shines, gathered by cosine samples alone: mostly nothing, rarely much.
struct Noisy {
    scene: Arc<Scene>,
    radiance: Rgb,
    floor: Atlas,
    /// Luminance of E, nearly without noise.
    truth: Vec<f32>,
}

impl Noisy {
    fn new() -> Self {
        let (scene, radiance) = two_sheets();
        let width = radiance.width;
        let shines = |i: usize| (10..13).contains(&(i % width)) && (6..10).contains(&(i / width));
        let data = (0..radiance.data.len()).map(|i| [f32::from(u8::from(shines(i))); 3]).collect();
        let radiance = Rgb { data, ..radiance };
        let mut floor = Atlas::new(&mut lit(&scene, &radiance), [SIDE, SIDE]).unwrap();
        floor.points.retain(|p| p.normal[2] > 0.0);
        floor.texels = floor.points.iter().map(|p| p.index).collect();
        let gather = Gather { cosine: 2048, ..GATHER };
        let gathered = lit(&scene, &radiance).irradiance(&floor.points, gather, &Silent).unwrap();
        let truth = gathered.iter().map(|g| luminance(&g.irradiance)).collect();
        Self { scene, radiance, floor, truth }
    }

    /// Samples, and looks at what was found.
    fn sample<T>(
        &self,
        gather: Gather,
        error: Option<f32>,
        look: impl FnOnce(&Estimate, &SpatialBlocks<'_>, &EstimateAt<'_>) -> T,
    ) -> T {
        let texels = Texels::of(&self.floor);
        let surface = SpatialBlocks::new(&texels, self.scene.mesh(), RADIUS).unwrap();
        let mut backend = lit(&self.scene, &self.radiance);
        let found = Estimate::sample(&mut backend, &surface, gather, error, &Checkpoints::none(), &Silent).unwrap();
        look(&found, &surface, &found.known(&Items::Range(0..self.truth.len())).unwrap())
    }
}

#[test]
fn texels_stop_without_bias() {
    let noisy = Noisy::new();
    let n = noisy.truth.len();
    let truth: f32 = noisy.truth.iter().sum();
    let (mut adaptive, mut by_own, mut rays, seeds) = (0.0, 0.0, 0, 6);
    for seed in 0..seeds {
        let gather = Gather { seed, ..GATHER };
        noisy.sample(gather, Some(TARGET), |estimate, _, known| {
            adaptive += (0..n).map(|i| known.luminance(i)).sum::<f32>();
            rays += estimate.rays().unwrap();
        });
        // Negative control: texels that stop after the first round where their own halves agree.
        let all: Vec<f32> = noisy.sample(gather, None, |_, _, all| (0..n).map(|i| all.luminance(i)).collect());
        by_own += noisy.sample(Gather { cosine: 2 * FIRST, ..gather }, None, |_, _, first| {
            (0..n).map(|i| if first.difference(i) <= TARGET { first.luminance(i) } else { all[i] }).sum::<f32>()
        });
    }
    let share = rays as f32 / (n as u64 * u64::from(seeds) * u64::from(GATHER.cosine)) as f32;
    assert!((0.1..0.9).contains(&share), "{share} of the rays");
    let [adaptive, by_own] = [adaptive, by_own].map(|sum| sum / (seeds as f32 * truth));
    assert!((adaptive - 1.0).abs() < 0.01, "{adaptive} of the light");
    assert!(by_own < 0.95, "{by_own} of the light where texels decide for themselves");
}

#[test]
fn standard_errors_are_those_that_estimates_have() {
    let noisy = Noisy::new();
    for error in [0.0, TARGET] {
        noisy.sample(GATHER, Some(error), |estimate, surface, known| {
            let errors = estimate.standard_errors(surface, &Silent).unwrap().into_vec().unwrap();
            let n = errors.len();
            let squares = |value: &dyn Fn(usize) -> f32| (0..n).map(|i| value(i).powi(2)).sum::<f32>().sqrt();
            let told = squares(&|i| errors[i]) / squares(&|i| known.luminance(i) - noisy.truth[i]);
            assert!((0.85..1.15).contains(&told), "standard errors are {told} times the errors");
            let allowed = |i: usize| TARGET * 1.3 * known.luminance(i).max(known.floor);
            let all_missed = (0..n).filter(|&i| errors[i] > allowed(i)).count();
            let capped = (0..n).filter(|&i| known.rays[i] == GATHER.cosine).count();
            assert!(all_missed <= capped, "{all_missed} texels missed the target, {capped} of them had all rays");
            // Of those that stopped before, few miss it.
            let stopped = || (0..n).filter(|&i| known.rays[i] < GATHER.cosine);
            let missed = stopped().filter(|&i| errors[i] > allowed(i)).count();
            assert_eq!(stopped().count() > 0, error > 0.0);
            assert!(
                missed * 20 <= stopped().count(),
                "{missed} of {} texels stopped before the target",
                stopped().count()
            );
        });
    }
}

#[test]
fn rounds_double_up_to_all_rays() {
    for (cosine, light, expected) in [(512, 512, 256), (100, 50, 50), (2, 2, 1), (33, 0, 16), (1000, 24, 500)] {
        let gather = Gather { cosine, light, ..GATHER };
        let rounds = rounds(gather, Some(TARGET), SIDE);
        let mut sum = 0;
        for [a, b] in &rounds {
            let part = Sequences::Own { part: u32::from(sum > 0) };
            assert!(a.sequences == part && (sum == 0 || a.cosine == sum), "{rounds:?}");
            assert!(*b == Gather { seed: b.seed, ..*a } && a.seed != b.seed, "{rounds:?}");
            sum += a.cosine;
            assert_eq!(a.light > 0, light > 0, "{rounds:?}");
        }
        assert!(sum <= expected && sum + (1 << rounds.len()) > expected, "{rounds:?}");
    }
}

#[test]
fn halves_are_parts_of_one_gather_unless_their_difference_is_the_error() {
    let half = Gather::new(GATHER.cosine / 2, GATHER.light / 2, GATHER.seed);
    let [together] = rounds(GATHER, None, SIDE)[..] else { panic!("one round") };
    assert_eq!(together, [0, 1].map(|part| half.shared_in_parts(SIDE, [part, 2])));
    let [[a, b]] = rounds(GATHER, Some(0.0), SIDE)[..] else { panic!("one round") };
    assert_eq!(a, half.shared(SIDE));
    assert!(b == Gather { seed: b.seed, ..a } && b.seed != a.seed);
}
