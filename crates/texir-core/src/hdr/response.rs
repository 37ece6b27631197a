//! The camera's response: which share of full-scale light an encoded value stands for.
//!
//! Debevec and Malik, "Recovering High Dynamic Range Radiance Maps from Photographs" (SIGGRAPH 1997), equation 3, with
//! three deviations: the unknown is the *difference* of ln f⁻¹ to that of sRGB, on few knots, so that smoothness does
//! not fight the logarithm's pole at black; pixels weigh by their noise instead of a hat; the pixels' own radiances are
//! eliminated from the normal equations, so that thousands of pixels cost no more than their brackets, and shots that
//! do not fit (something moved) lose their weight over a few rounds.

use super::{BLACK, CLIPPED, sensor_variance};
use crate::cholesky;
use crate::error::{Error, Result};
use crate::image_io::TransferCurve;

/// Knots of the estimated difference, evenly spaced over the encoded values.
const KNOTS: usize = 48;
/// Weight of the squared second differences, as a share of the samples' weight per knot.
const SMOOTHNESS: f64 = 1e-2;
/// Rounds of reweighting, each with the difference of ln radiance between two shots that is forgiven beside noise: at
/// first much, because the response is not known yet; in the end only what is not a change of the scene.
const ROUNDS: [f64; 6] = [1.0, 0.5, 0.2, 0.1, 0.05, 0.05];
/// Standard deviations of noise that are forgiven.
const DEVIATIONS: f64 = 3.0;
/// Relative error of light that no noise explains: stray light, exposure times that are not what they say.
const MODEL_ERROR: f64 = 0.02;
/// Entries of the tables.
const TABLE: usize = 4096;

/// The inverse response per channel: light as a share of full scale, by encoded value in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Response {
    light: [Vec<f32>; 3],
}

impl Response {
    /// A known curve, the same for all channels.
    pub(super) fn known(curve: TransferCurve) -> Self {
        let table: Vec<f32> = (0..TABLE).map(|i| curve.decode(i as f32 / (TABLE - 1) as f32)).collect();
        Self { light: [table.clone(), table.clone(), table] }
    }

    /// From the brackets of some pixels, `[pixel][shot]`. Between the channels, and absolutely, the scale is sRGB's at
    /// the middle of the encoded range.
    pub(super) fn estimate(samples: &[Vec<[f32; 3]>], exposures: &[f64]) -> Result<Self> {
        let channel = |c: usize| estimate(samples, exposures, c);
        Ok(Self { light: [channel(0)?, channel(1)?, channel(2)?] })
    }

    /// Light of an encoded value, and how fast it grows with the value.
    pub(super) fn light(&self, channel: usize, value: f32) -> (f32, f32) {
        let table = &self.light[channel];
        let at = value.clamp(0.0, 1.0) * (TABLE - 1) as f32;
        let low = (at as usize).min(TABLE - 2);
        let (a, b) = (table[low], table[low + 1]);
        (a + (at - low as f32) * (b - a), (b - a) * (TABLE - 1) as f32)
    }
}

/// A sample on the knots: knot `low` with weight 1 − t, the next with t.
#[derive(Clone, Copy)]
struct Term {
    low: usize,
    t: f64,
    /// ln of sRGB's light, less ln of the exposure: ln of the radiance if the response were sRGB's.
    known: f64,
    weight: f64,
}

fn knot(value: f64) -> (usize, f64) {
    let at = value * (KNOTS - 1) as f64;
    let low = (at as usize).min(KNOTS - 2);
    (low, at - low as f64)
}

fn at(difference: &[f64], low: usize, t: f64) -> f64 {
    difference[low] + t * (difference[low + 1] - difference[low])
}

fn estimate(samples: &[Vec<[f32; 3]>], exposures: &[f64], channel: usize) -> Result<Vec<f32>> {
    let usable = |sample: &Vec<[f32; 3]>| -> Vec<Term> {
        let seen = sample.iter().zip(exposures);
        let seen = seen.map(|(v, exposure)| (v[channel], *exposure)).filter(|(v, _)| *v > BLACK && *v < CLIPPED);
        let term = |(value, exposure): (f32, f64)| {
            let light = f64::from(TransferCurve::Srgb.decode(value));
            let (low, t) = knot(f64::from(value));
            let variance = sensor_variance(light) / (light * light) + MODEL_ERROR * MODEL_ERROR;
            Term { low, t, known: light.ln() - exposure.ln(), weight: 1.0 / variance }
        };
        seen.map(term).collect()
    };
    // A pixel tells something about the response when two shots see it.
    let pixels: Vec<Vec<Term>> = samples.iter().map(usable).filter(|terms| terms.len() >= 2).collect();
    if pixels.is_empty() {
        return Err(Error::invalid(
            "no pixel is neither black nor clipped in two shots: the response cannot be estimated; take exposures that are \
             closer together, or name the response with --response",
        ));
    }
    let mut difference = vec![0.0; KNOTS];
    for forgiven in ROUNDS {
        difference = solve(&pixels, &difference, forgiven)?;
    }
    let middle = TABLE / 2;
    let mut table: Vec<f64> = (0..TABLE)
        .map(|i| {
            let value = i as f64 / (TABLE - 1) as f64;
            let (low, t) = knot(value);
            f64::from(TransferCurve::Srgb.decode(value as f32)) * at(&difference, low, t).exp()
        })
        .collect();
    // More light never gives a smaller value.
    for i in 1..TABLE {
        table[i] = table[i].max(table[i - 1]);
    }
    let scale = f64::from(TransferCurve::Srgb.decode(middle as f32 / (TABLE - 1) as f32)) / table[middle];
    Ok(table.into_iter().map(|v| (v * scale) as f32).collect())
}

/// One round: the difference that makes the shots of every pixel agree best, residuals of the last round in mind.
fn solve(pixels: &[Vec<Term>], last: &[f64], forgiven: f64) -> Result<Vec<f64>> {
    let mut matrix = vec![vec![0.0; KNOTS]; KNOTS];
    let mut right = vec![0.0; KNOTS];
    let mut total = 0.0;
    for terms in pixels {
        let estimate = |term: &Term| at(last, term.low, term.t) + term.known;
        let sum: f64 = terms.iter().map(|t| t.weight).sum();
        // The heaviest half decides what the pixel shows: a robust centre for few values.
        let mut sorted: Vec<&Term> = terms.iter().collect();
        sorted.sort_by(|a, b| estimate(a).total_cmp(&estimate(b)));
        let mut passed = 0.0;
        let centre = sorted.iter().find(|t| {
            passed += t.weight;
            passed >= 0.5 * sum
        });
        let centre = centre.map_or(0.0, |t| estimate(t));
        // Geman and McClure's weight: what is far off counts for nothing.
        let robust = |term: &Term| {
            let scale = DEVIATIONS / term.weight.sqrt() + forgiven;
            let off = (estimate(term) - centre) / scale;
            term.weight / (1.0 + off * off).powi(2)
        };
        // Σ w (b − b̄)(b − b̄)ᵀ with b̄ the weighted mean: the pixel's radiance is eliminated.
        let (mut sum, mut mean, mut mean_known) = (0.0, [0.0; KNOTS], 0.0);
        for term in terms {
            let weight = robust(term);
            sum += weight;
            mean[term.low] += weight * (1.0 - term.t);
            mean[term.low + 1] += weight * term.t;
            mean_known += weight * term.known;
            let basis = [(term.low, 1.0 - term.t), (term.low + 1, term.t)];
            for (i, a) in basis {
                right[i] -= weight * a * term.known;
                for (j, b) in basis {
                    matrix[i][j] += weight * a * b;
                }
            }
        }
        total += sum;
        let touched: Vec<usize> = (0..KNOTS).filter(|i| mean[*i] != 0.0).collect();
        for &i in &touched {
            right[i] += mean[i] * mean_known / sum;
            for &j in &touched {
                matrix[i][j] -= mean[i] * mean[j] / sum;
            }
        }
    }
    let per_knot = total / KNOTS as f64;
    let smoothness = SMOOTHNESS * per_knot * (KNOTS * KNOTS) as f64 / 100.0;
    for i in 1..KNOTS - 1 {
        let stencil = [(i - 1, 1.0), (i, -2.0), (i + 1, 1.0)];
        for (a, x) in stencil {
            for (b, y) in stencil {
                matrix[a][b] += smoothness * x * y;
            }
        }
    }
    // Absolutely the difference is free: it is 0 in the middle.
    matrix[KNOTS / 2][KNOTS / 2] += per_knot;
    // Where no sample is, it goes on straight, and stays small.
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] += 1e-6 * per_knot;
    }
    let mut solution: Vec<[f64; 1]> = right.into_iter().map(|b| [b]).collect();
    cholesky::solve(&mut matrix.concat(), &mut solution)
        .ok_or_else(|| Error::invalid("the response cannot be estimated from these shots: name it with --response"))?;
    Ok(solution.into_iter().flatten().collect())
}
