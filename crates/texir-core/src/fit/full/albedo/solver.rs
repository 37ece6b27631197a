//! The solver: conjugate gradients on the normal equations, weights taken anew between runs (iteratively re-weighted
//! least squares), smoothed along edge weights.

use std::borrow::Cow;

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{AlbedoProblem, BLOCK, EdgeGuide, Target};
use crate::fit::full::observations::packed_tap::PackedTap;
use crate::fit::index::NONE;

impl AlbedoProblem<'_> {
    /// Improves `albedo`, and keeps its `predicted` pixels in step, for the given target by `rounds` runs of
    /// `iterations` steps of conjugate gradients.
    pub fn solve(
        &self,
        (albedo, predicted): (&mut [Vec3A], &mut [Vec3A]),
        (target, sigma): (&Target, &[f32]),
        rounds: u32,
        iterations: u32,
        edges: EdgeGuide,
    ) {
        for _ in 0..rounds {
            let base = self.settings.noise;
            let weight = |(p, s): (usize, &f32)| {
                let e = self.residual(predicted, target, p);
                (base / s).powi(2) / (1.0 + e.length_squared() / 3.0 / (2.0 * s).powi(2))
            };
            let weight = sigma.par_iter().enumerate().with_min_len(BLOCK).map(weight).collect();
            let system = System { problem: self, target, weight, edges: self.edge_weights(albedo, edges) };
            conjugate_gradients(&system, (albedo, predicted), iterations);
            albedo.par_iter_mut().for_each(|a| *a = a.clamp(Vec3A::ZERO, Vec3A::ONE));
            let shows = |(p, predicted): (usize, &mut Vec3A)| *predicted = self.forward(albedo, p);
            predicted.par_iter_mut().enumerate().with_min_len(BLOCK).for_each(shows);
        }
    }

    /// λ/(1 + |Δa|²/s²) to the right and to the lower neighbour; 0 across segments.
    fn edge_weights(&self, albedo: &[Vec3A], edges: EdgeGuide) -> Vec<[f32; 2]> {
        let smoothness = self.settings.smoothness;
        let albedo = match edges {
            EdgeGuide::Albedo => Cow::Borrowed(albedo),
            EdgeGuide::Median => Cow::Owned(self.without_specks(albedo)),
        };
        let of_texel = |t: usize| self.steps(&albedo, t).map(|step| step.map_or(0.0, |step| smoothness / (1.0 + step)));
        (0..albedo.len()).into_par_iter().map(of_texel).collect()
    }

    /// The median of each texel and the four beside it, which keeps edges, and lines of a texel's width. At the rim of
    /// a segment the neighbour of the other side counts twice.
    fn without_specks(&self, albedo: &[Vec3A]) -> Vec<Vec3A> {
        let (segment, beside) = (self.segment.of, &self.adjacency.beside);
        let of_texel = |t: usize| {
            let [left, right, up, down] =
                beside[t].map(|n| (n != NONE && segment[n as usize] == segment[t]).then(|| albedo[n as usize]));
            let pair = |a: Option<Vec3A>, b: Option<Vec3A>| Some([a.or(b)?, b.or(a)?]);
            let (along, across) = (pair(left, right), pair(up, down));
            match [along.or(across), across.or(along)] {
                [Some(along), Some(across)] => median_of_five(albedo[t], along, across),
                _ => albedo[t],
            }
        };
        (0..albedo.len()).into_par_iter().with_min_len(BLOCK).map(of_texel).collect()
    }

    /// |Δa|²/s² to the right and to the lower neighbour; `None` across segments.
    pub(super) fn steps(&self, albedo: &[Vec3A], t: usize) -> [Option<f32>; 2] {
        let (segment, beside) = (self.segment.of, self.adjacency.beside[t]);
        [beside[1], beside[3]].map(|n| {
            (n != NONE && segment[n as usize] == segment[t]).then(|| {
                let difference = albedo[t] - albedo[n as usize];
                difference.length_squared() / 3.0 / self.settings.edge_scale.powi(2)
            })
        })
    }
}

/// The normal equations of one re-weighting: A a = WᵀΩ target + prior.
struct System<'a> {
    problem: &'a AlbedoProblem<'a>,
    target: &'a Target,
    /// Ω: per pixel.
    weight: Vec<f32>,
    /// To the right and lower neighbour, per texel.
    edges: Vec<[f32; 2]>,
}

/// The solver's state of a texel.
#[derive(Clone, Copy)]
struct CgState {
    /// WᵀΩ target + prior − A x.
    residual: Vec3A,
    /// Inverse of A's diagonal, the preconditioner.
    inverse: Vec3A,
}

impl CgState {
    fn preconditioned(&self) -> Vec3A {
        self.residual * self.inverse
    }
}

impl System<'_> {
    /// Writes A x to `out`; returns x A x.
    fn apply(&self, x: &[Vec3A], out: &mut [Vec3A]) -> [f64; 3] {
        let p = self.problem;
        let weighted = |i: usize| {
            let gain = p.row_scale(self.target, i);
            p.forward(x, i) * gain * gain * self.weight[i]
        };
        let add = |sum: &mut Vec3A, share: &PackedTap, v: &Vec3A| *sum += *v * share.weight();
        p.seen.bands.sum_into(out, &p.seen.rows, Vec3A::ZERO, weighted, add);
        sum(out, |t, out| {
            *out = *out * p.texel_scale(t) + p.settings.segment_prior * x[t] + self.laplacian(x, t);
            *out * x[t]
        })
    }

    /// The residual of the normal equations at `x`, whose forward model is `predicted`, and the inverse diagonal, in
    /// one pass over the pixels.
    fn initial_state(&self, x: &[Vec3A], predicted: &[Vec3A]) -> Vec<CgState> {
        let p = self.problem;
        let means = p.segment_means(|t| p.seen.is_seen[t].then(|| x[t]));
        let of_pixel = |i: usize| {
            let (gain, weight) = (p.row_scale(self.target, i), self.weight[i]);
            (p.residual(predicted, self.target, i) * gain * -weight, gain * gain * weight)
        };
        // The diagonal is summed where its inverse will be.
        let zero = CgState { residual: Vec3A::ZERO, inverse: Vec3A::ZERO };
        let add = |sum: &mut CgState, share: &PackedTap, (residual, square): &(Vec3A, Vec3A)| {
            sum.residual += *residual * share.weight();
            sum.inverse += *square * share.weight().powi(2);
        };
        let mut out = p.seen.bands.sum(&p.seen.rows, zero, of_pixel, add);
        out.par_iter_mut().enumerate().with_min_len(BLOCK).for_each(|(t, out)| {
            let (strength, prior) = (p.texel_scale(t), p.settings.segment_prior);
            let drawn = prior * (means[p.segment.of[t] as usize] - x[t]);
            out.residual = out.residual * strength + drawn - self.laplacian(x, t);
            let links: f32 = self.links(t).map(|(_, weight)| weight).sum();
            let diagonal = out.inverse * strength * strength + prior + links;
            out.inverse = 1.0 / diagonal.max(Vec3A::splat(1e-12));
        });
        out
    }

    /// The weighted graph Laplacian of `x` at a texel.
    fn laplacian(&self, x: &[Vec3A], t: usize) -> Vec3A {
        self.links(t).map(|(n, weight)| weight * (x[t] - x[n as usize])).sum()
    }

    /// Neighbours of a texel with their weights.
    fn links(&self, t: usize) -> impl Iterator<Item = (u32, f32)> + '_ {
        let [left, right, up, down] = self.problem.adjacency.beside[t];
        let back = |n: u32, side: usize| if n == NONE { 0.0 } else { self.edges[n as usize][side] };
        [(left, back(left, 0)), (right, self.edges[t][0]), (up, back(up, 1)), (down, self.edges[t][1])]
            .into_iter()
            .filter(|(n, weight)| *n != NONE && *weight > 0.0)
    }
}

/// Jacobi-preconditioned conjugate gradients, the three channels side by side, from `x` on, whose forward model is
/// `predicted`. A step takes longer for all texels than for the pixels, so that texels are gone through three times a
/// step, not more.
fn conjugate_gradients(system: &System<'_>, (x, predicted): (&mut [Vec3A], &[Vec3A]), iterations: u32) {
    let mut state = system.initial_state(x, predicted);
    let mut direction: Vec<Vec3A> = state.par_iter().map(CgState::preconditioned).collect();
    let rho_term = |state: &CgState| state.residual * state.preconditioned();
    let mut rho = sum(&mut state, |_, state| rho_term(state));
    // One list for all steps: a fresh one is paged in anew at every step.
    let mut a_direction = vec![Vec3A::ZERO; direction.len()];
    for _ in 0..iterations {
        let curvature = system.apply(&direction, &mut a_direction);
        let alpha = ratio(rho, curvature);
        let next = sum((&mut state, &mut *x), |t, (state, x)| {
            *x += alpha * direction[t];
            state.residual -= alpha * a_direction[t];
            rho_term(state)
        });
        let beta = ratio(next, rho);
        rho = next;
        (&mut direction, &state).into_par_iter().for_each(|(d, of)| *d = of.preconditioned() + beta * *d);
    }
}

/// The median of a, b, c, d and e, per channel.
fn median_of_five(a: Vec3A, [b, c]: [Vec3A; 2], [d, e]: [Vec3A; 2]) -> Vec3A {
    // What is neither below both pairs' smaller ones nor above both their larger ones, between those.
    let low = b.min(c).max(d.min(e));
    let high = b.max(c).min(d.max(e));
    low.min(high).max(a.min(low.max(high)))
}

/// The sum over the items, per channel, block by block in a fixed order; `of` may change them on the way.
fn sum<I: IntoParallelIterator>(items: I, of: impl Fn(usize, I::Item) -> Vec3A + Sync) -> [f64; 3]
where
    I::Iter: IndexedParallelIterator,
{
    let terms = items.into_par_iter().enumerate().map(|(i, item)| of(i, item));
    let blocks: Vec<Vec3A> = terms.fold_chunks(BLOCK, || Vec3A::ZERO, |sum, term| sum + term).collect();
    blocks.into_iter().map(Vec3A::as_dvec3).sum::<DVec3>().to_array()
}

/// a / b per channel; 0 where b is: nothing is left to do there.
fn ratio(a: [f64; 3], b: [f64; 3]) -> Vec3A {
    Vec3A::from_array(std::array::from_fn(|c| if b[c] > 0.0 { (a[c] / b[c]) as f32 } else { 0.0 }))
}
