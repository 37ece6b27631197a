//! Albedo as one sparse, robust least-squares problem over all views, for given roughness.
//!
//! A pixel's row says Σ_t w_t (E_t/E_p) a_t = (I − S) π/(E_p d), with S the specular radiance, d the diffuse model's
//! factor and E_p = Σ w_t E_t; both sides are albedos. A metal has no diffuse part, and its albedo is F0. As its
//! specular radiance is S = F0 P + Q, its row is Σ_t w_t (π P/E_p) a_t = (I − Q) π/E_p, of the same unit, so that
//! misfits compare. A row's weight is that of a Cauchy loss (residuals e beyond twice the noise σ count less), 1/(1 +
//! (e/2σ)²), over (σ/σ_0)². Neighbours in a segment are drawn together by a Cauchy loss as well, so that edges survive,
//! and every texel weakly to its segment's mean. Solved by conjugate gradients with Jacobi preconditioning, the weights
//! taken anew between runs (iteratively re-weighted least squares; [`solver`]).

pub mod palette;
mod solver;

use std::f32::consts::{FRAC_1_PI, PI};

use glam::{DVec4, Vec3A, Vec4};
use rayon::prelude::*;

use self::palette::Palettes;
use crate::brdf::DIELECTRIC_F0;
use crate::diffuse::DiffuseModel;
use crate::fit::adjacency::Adjacency;
use crate::fit::full::observations::Observations;
use crate::fit::full::observations::packed_tap::{PackedTap, of_strata};
use crate::fit::full::partition::Partition;
use crate::fit::index::NONE;
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
        let of_all = |value: Vec3A, count: usize| vec![value; count];
        let mut target = Target {
            albedo: of_all(Vec3A::ZERO, self.seen.len()),
            scale: of_all(Vec3A::splat(FRAC_1_PI), if self.metal.is_empty() { 0 } else { self.seen.len() }),
        };
        self.retarget(&mut target, roughness, |_| true);
        target
    }

    /// Makes the `target` that of another roughness at those pixels that `change`.
    pub fn retarget(&self, target: &mut Target, roughness: &Roughness<'_>, change: impl Fn(usize) -> bool + Sync) {
        let Target { albedo, scale } = target;
        if self.metal.is_empty() {
            let pixels = albedo.par_iter_mut().enumerate().with_min_len(BLOCK).filter(|(p, _)| change(*p));
            pixels.for_each(|(p, albedo)| *albedo = self.diffuse_albedo(roughness, p));
        } else {
            let pixels = albedo.par_iter_mut().zip(scale).enumerate().with_min_len(BLOCK).filter(|(p, _)| change(*p));
            pixels.for_each(|(p, (albedo, scale))| (*albedo, *scale) = self.albedo_and_scale(roughness, p));
        }
    }

    /// What a pixel says where there are metals, and its κ.
    fn albedo_and_scale(&self, roughness: &Roughness<'_>, pixel: usize) -> (Vec3A, Vec3A) {
        match self.is_metal(pixel) {
            Some(false) => (self.diffuse_albedo(roughness, pixel), Vec3A::splat(FRAC_1_PI)),
            Some(true) => {
                let f0 = DIELECTRIC_F0 as f32;
                let specular = self.along(roughness, self.seen.curve(pixel), pixel);
                let scale = (self.along(roughness, self.seen.white_curve(pixel), pixel) - specular) / (1.0 - f0);
                let grazing = specular - f0 * scale;
                ((self.seen.radiance[pixel] - grazing) * self.pi_over_e[pixel], scale)
            }
            None => (Vec3A::ZERO, Vec3A::ZERO),
        }
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

    /// s_t, what a texel's albedo is multiplied by in the rows: E, or 1 for metal, whose reflection differs from pixel
    /// to pixel.
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
