//! Albedo as one sparse, robust least-squares problem over all views, for given roughness.
//!
//! A pixel's row says Σ_t w_t (E_t/E_p) a_t = (I − S) π/(E_p d), with S the specular radiance, d the diffuse model's
//! factor and E_p = Σ w_t E_t; both sides are albedos. A metal has no diffuse part, and its albedo is F0: with
//! S = F0 P + Q, the row is Σ_t w_t (π P/E_p) a_t = (I − Q) π/E_p, of the same unit, so that misfits compare. A row's weight is
//! that of a Cauchy loss (residuals e beyond twice the noise σ count less), 1/(1 + (e/2σ)²), over (σ/σ_0)². Neighbours
//! in a segment are drawn together by a Cauchy loss as well, so that edges survive, and every texel weakly to its
//! segment's mean. Solved by conjugate gradients with Jacobi preconditioning, the weights taken anew between runs
//! (iteratively re-weighted least squares).

pub mod palette;

use std::borrow::Cow;
use std::f32::consts::{FRAC_1_PI, PI};

use glam::{DVec3, DVec4, Vec3A, Vec4};
use rayon::prelude::*;

use self::palette::Palettes;
use crate::brdf::DIELECTRIC_F0;
use crate::diffuse::DiffuseModel;
use crate::fit::adjacency::{Adjacency, NONE};
use crate::fit::full::observations::Observations;
use crate::fit::full::observations::packed_tap::{PackedTap, of_strata};
use crate::fit::full::partition::Partition;
use crate::fit::settings::{AlbedoSettings, PaletteSettings};
use crate::specular_table::{PackedCurve, STRATA, node};

/// Items per task of a parallel loop.
const BLOCK: usize = 4096;

/// The roughness that albedo is sought for.
pub enum Roughness<'a> {
    /// That of one node everywhere.
    Node(usize),
    /// One for each texel, interpolated between them.
    Texels(&'a [f32]),
}

/// What the edge weights of the smoothness prior are computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeGuide {
    /// The albedo itself. So while roughness is sought: what highlights leave in it is to show.
    Albedo,
    /// Its five-point median: a texel that differs from all around it is smoothed as noise, unless pixels hold it.
    Median,
}

/// The right-hand side at some roughness: κ_p π/E_p Σ_t w_t s_t a_t = albedo_p, where s_t is the texel's
/// [`AlbedoProblem::texel_scale`].
pub struct Target {
    /// Right-hand sides, as albedos.
    pub albedo: Vec<Vec3A>,
    /// κ: 1/π for a dielectric, 0 for a pixel that says nothing. Empty where all are dielectrics.
    scale: Vec<Vec3A>,
}

impl Target {
    fn scale(&self, pixel: usize) -> Vec3A {
        self.scale.get(pixel).copied().unwrap_or(Vec3A::splat(FRAC_1_PI))
    }
}

/// The problem, apart from roughness.
pub struct AlbedoProblem<'a> {
    /// The data.
    pub seen: &'a Observations,
    /// Irradiance of each texel.
    pub irradiance: &'a [Vec3A],
    /// Who is beside whom.
    pub adjacency: &'a Adjacency,
    /// Segments of the texels.
    pub segment: Partition<'a>,
    /// How diffuse radiance depends on the direction to the camera.
    pub diffuse: DiffuseModel,
    /// Which texels are metal; empty where metals are not sought.
    pub metal: Vec<bool>,
    /// Weights.
    pub settings: &'a AlbedoSettings,
    /// π/E of each pixel.
    pub pi_over_e: Vec<Vec3A>,
}

impl<'a> AlbedoProblem<'a> {
    /// Sets the problem up.
    pub fn new(
        seen: &'a Observations,
        irradiance: &'a [Vec3A],
        adjacency: &'a Adjacency,
        segment: Partition<'a>,
        diffuse: DiffuseModel,
        settings: &'a AlbedoSettings,
    ) -> Self {
        let (metal, pi_over_e) = (Vec::new(), Vec::new());
        let mut problem = Self { seen, irradiance, adjacency, segment, diffuse, metal, settings, pi_over_e };
        // A pixel in complete darkness says nothing: its weight vanishes with E.
        let bright = irradiance.iter().map(|e| e.max_element()).fold(0.0, f32::max);
        let floor = Vec3A::splat((1e-6 * bright).max(f32::MIN_POSITIVE));
        let pi_over_e = |p| {
            let e: Vec3A = seen.rows.row(p).iter().map(|share| irradiance[share.texel as usize] * share.weight()).sum();
            PI / e.max(floor)
        };
        problem.pi_over_e = (0..seen.len()).into_par_iter().with_min_len(BLOCK).map(pi_over_e).collect();
        problem
    }

    /// What the views say without any solving: the mean over each texel's pixels of I π/E, 0 to 1; segment means
    /// elsewhere.
    pub fn start(&self) -> Vec<Vec3A> {
        let apparent = |p: usize| (self.seen.radiance[p] * self.pi_over_e[p]).clamp(Vec3A::ZERO, Vec3A::ONE);
        // The sum of the weights comes last.
        let sums = self.seen.bands.sum(
            &self.seen.rows,
            Vec4::ZERO,
            |p| apparent(p).extend(1.0),
            |sum, share, apparent| *sum += *apparent * share.weight(),
        );
        let mean = |t: usize| (sums[t].w > 0.0).then(|| Vec3A::from_vec4(sums[t]) / sums[t].w);
        let means = self.segment_means(mean);
        (0..sums.len()).zip(self.segment.of).map(|(t, s)| mean(t).unwrap_or(means[*s as usize])).collect()
    }

    fn segment_means(&self, value: impl Fn(usize) -> Option<Vec3A> + Sync) -> Vec<Vec3A> {
        // The number of texels comes last.
        let of_texel = |t: usize| value(t).map(|value| value.extend(1.0).as_dvec4().to_array());
        let sums = self.segment.sums(of_texel).into_iter().map(DVec4::from_array);
        let sums: Vec<DVec4> = sums.collect();
        let all: DVec4 = sums.iter().sum();
        let mean = |sum: &DVec4| (sum.w > 0.0).then(|| (sum.truncate() / sum.w).as_vec3a());
        let otherwise = mean(&all).unwrap_or(Vec3A::splat(0.5));
        sums.iter().map(|sum| mean(sum).unwrap_or(otherwise)).collect()
    }

    /// What each pixel says at the roughness that its surface has. One that sees metal and something else says nothing.
    pub fn target(&self, roughness: &Roughness<'_>) -> Target {
        let all = (0..self.seen.len()).into_par_iter().with_min_len(BLOCK);
        if self.metal.is_empty() {
            return Target { albedo: all.map(|p| self.diffuse_albedo(roughness, p)).collect(), scale: Vec::new() };
        }
        let (albedo, scale) = all
            .map(|p| match self.is_metal(p) {
                Some(false) => (self.diffuse_albedo(roughness, p), Vec3A::splat(FRAC_1_PI)),
                Some(true) => {
                    let f0 = DIELECTRIC_F0 as f32;
                    let specular = self.along(roughness, self.seen.curve(p), p);
                    let scale = (self.along(roughness, self.seen.white_curve(p), p) - specular) / (1.0 - f0);
                    let grazing = specular - f0 * scale;
                    ((self.seen.radiance[p] - grazing) * self.pi_over_e[p], scale)
                }
                None => (Vec3A::ZERO, Vec3A::ZERO),
            })
            .unzip();
        Target { albedo, scale }
    }

    /// What a pixel says of a dielectric's albedo.
    fn diffuse_albedo(&self, roughness: &Roughness<'_>, pixel: usize) -> Vec3A {
        let specular = self.along(roughness, self.seen.curve(pixel), pixel);
        let factor = self.diffuse.factor(self.seen.cosine[pixel], self.mean(roughness, pixel));
        (self.seen.radiance[pixel] - specular) * self.pi_over_e[pixel] / factor
    }

    /// The mean roughness of what a pixel sees.
    fn mean(&self, roughness: &Roughness<'_>, pixel: usize) -> f32 {
        match roughness {
            Roughness::Node(k) => node(*k),
            Roughness::Texels(r) => {
                self.seen.rows.row(pixel).iter().map(|share| r[share.texel as usize] * share.weight()).sum()
            }
        }
    }

    /// A pixel's curve at the roughness of what its strata see.
    fn along(&self, roughness: &Roughness<'_>, curve: &PackedCurve, pixel: usize) -> Vec3A {
        match roughness {
            Roughness::Node(k) => curve.at_node(*k).into(),
            Roughness::Texels(r) => {
                let row = self.seen.rows.row(pixel);
                let at = |roughness: f32| Vec3A::from(curve.at(roughness).0);
                let of = |share: &PackedTap| r[share.texel as usize];
                match row {
                    [first, others @ ..] if others.iter().all(|share| of(share) == of(first)) => at(of(first)),
                    _ => of_strata(row, |t| r[t as usize]).map(at).iter().sum::<Vec3A>() / STRATA as f32,
                }
            }
        }
    }

    /// Whether a pixel sees metal; `None` for one that sees both.
    fn is_metal(&self, pixel: usize) -> Option<bool> {
        let mut seen = self.seen.rows.row(pixel).iter().map(|share| self.metal[share.texel as usize]);
        let first = seen.next().unwrap_or(false);
        seen.all(|metal| metal == first).then_some(first)
    }

    /// s_t, what a texel's albedo is multiplied by in the rows: E, or 1 for metal, whose reflection differs from pixel to
    /// pixel.
    pub fn texel_scale(&self, texel: usize) -> Vec3A {
        if self.metal.get(texel) == Some(&true) { Vec3A::ONE } else { self.irradiance[texel] }
    }

    /// A row's factor κ π/E.
    fn row_scale(&self, target: &Target, pixel: usize) -> Vec3A {
        target.scale(pixel) * self.pi_over_e[pixel]
    }

    /// The forward model of a pixel: Σ_t w_t s_t a_t.
    fn forward(&self, albedo: &[Vec3A], pixel: usize) -> Vec3A {
        let of_share =
            |share: &PackedTap| albedo[share.texel as usize] * self.texel_scale(share.texel as usize) * share.weight();
        self.seen.rows.row(pixel).iter().map(of_share).sum()
    }

    /// The forward model Σ_t w_t s_t a_t of all pixels, the same at any roughness; [`AlbedoProblem::solve`] keeps it.
    pub fn predicted(&self, albedo: &[Vec3A]) -> Vec<Vec3A> {
        (0..self.seen.len()).into_par_iter().with_min_len(BLOCK).map(|p| self.forward(albedo, p)).collect()
    }

    /// Left-hand side − target: the residual of a pixel of this forward model, in albedo.
    pub fn residual(&self, predicted: &[Vec3A], target: &Target, pixel: usize) -> Vec3A {
        predicted[pixel] * self.row_scale(target, pixel) - target.albedo[pixel]
    }

    /// The colours of the segments, from the texels that are seen.
    pub fn palettes(&self, albedo: &[Vec3A], settings: &PaletteSettings) -> Palettes {
        let seen = |t: usize| self.seen.is_seen[t];
        Palettes::find(albedo, self.segment, seen, settings)
    }

    /// The noise σ of each pixel, in albedo: `noise` + `share` · I π/E (mean over the channels).
    pub fn noise(&self, share: f32) -> Vec<f32> {
        let noise = |(i, per): (&Vec3A, &Vec3A)| self.settings.noise + share * (*i * *per).element_sum() / 3.0;
        self.seen.radiance.par_iter().zip(&self.pi_over_e).map(noise).collect()
    }

    /// [`AlbedoProblem::noise`] where roughness is known: what is taken off a dielectric's pixel for a highlight may be
    /// wrong by a share of itself.
    pub fn noise_at(&self, roughness: &Roughness<'_>) -> Vec<f32> {
        let share = self.settings.specular_noise;
        let mut noise = self.noise(self.settings.image_noise);
        noise.par_iter_mut().enumerate().with_min_len(BLOCK).for_each(|(p, noise)| {
            if self.metal.is_empty() || self.is_metal(p) == Some(false) {
                let specular = self.along(roughness, self.seen.curve(p), p) * self.pi_over_e[p];
                *noise = noise.hypot(share * specular.element_sum() / 3.0);
            }
        });
        noise
    }

    /// Improves `albedo` at a known roughness of every texel by `rounds` runs of the solver. A roughness list passed by
    /// value is freed before solving.
    pub fn solve_at(&self, albedo: &mut [Vec3A], roughness: impl AsRef<[f32]>, rounds: u32, edges: EdgeGuide) {
        let of_texels = Roughness::Texels(roughness.as_ref());
        let (target, sigma) = (self.target(&of_texels), self.noise_at(&of_texels));
        drop(roughness);
        let mut predicted = self.predicted(albedo);
        self.solve((albedo, &mut predicted), (&target, &sigma), rounds, self.settings.iterations, edges);
    }

    /// Improves `albedo`, and keeps its `predicted` pixels in step, for the given target by `rounds` runs of `iterations`
    /// steps of conjugate gradients.
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
    fn steps(&self, albedo: &[Vec3A], t: usize) -> [Option<f32>; 2] {
        let (segment, beside) = (self.segment.of, self.adjacency.beside[t]);
        [beside[1], beside[3]].map(|n| {
            (n != NONE && segment[n as usize] == segment[t]).then(|| {
                let difference = albedo[t] - albedo[n as usize];
                difference.length_squared() / 3.0 / self.settings.edge_scale.powi(2)
            })
        })
    }

    /// How much the albedo of each segment varies: the mean of ln(1 + |Δa|²/s²), the loss of the smoothness prior, over
    /// the pairs of neighbours that both `count`; 0 without any.
    pub fn variation(&self, albedo: &[Vec3A], count: &[bool]) -> Vec<f64> {
        let counts = |t: u32| t != NONE && count[t as usize];
        let of_texel = |t: usize| {
            let beside = self.adjacency.beside[t];
            let steps = self.steps(albedo, t).into_iter().zip([beside[1], beside[3]]);
            let counting = steps.filter(|(_, n)| counts(t as u32) && counts(*n)).filter_map(|(step, _)| step);
            Some(counting.fold([0.0; 2], |[sum, pairs], step| [sum + f64::from(step.ln_1p()), pairs + 1.0]))
        };
        let sums = self.segment.sums(of_texel);
        sums.into_iter().map(|[sum, pairs]| if pairs > 0.0 { sum / pairs } else { 0.0 }).collect()
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
    /// A x, and x A x.
    fn apply(&self, x: &[Vec3A]) -> (Vec<Vec3A>, [f64; 3]) {
        let p = self.problem;
        let weighted = |i: usize| {
            let gain = p.row_scale(self.target, i);
            p.forward(x, i) * gain * gain * self.weight[i]
        };
        let mut out =
            p.seen.bands.sum(&p.seen.rows, Vec3A::ZERO, weighted, |sum, share, v| *sum += *v * share.weight());
        let product = sum(&mut out, |t, out| {
            *out = *out * p.texel_scale(t) + p.settings.segment_prior * x[t] + self.laplacian(x, t);
            *out * x[t]
        });
        (out, product)
    }

    /// The residual of the normal equations at `x`, whose forward model is `predicted`, and the inverse diagonal, in one
    /// pass over the pixels.
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
    for _ in 0..iterations {
        let (a_direction, curvature) = system.apply(&direction);
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
