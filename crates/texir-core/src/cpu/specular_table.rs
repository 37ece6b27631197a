//! Specular tables, twin of `specular_table.wgsl`: light samples of a pixel drawn once, weighed at every tabulated
//! roughness.

use arrayvec::ArrayVec;
use pulp::{Arch, NullaryFnOnce};

use super::light_sampling::{light_pdf, light_point};
use super::lighting::{Lighting, TOGETHER};
use super::lobe::sample_lobe;
use super::sampling::{Frame, cosine_direction};
use crate::backend::ShadePoint;
use crate::brdf::{Masking, fresnel_weight, ndf_from_sin2};
use crate::lights::Lights;
use crate::real::{Real, V3};
use crate::rng::{hash2, sobol2};
use crate::scene::trace::{Trace, TraceHit};
use crate::specular_table::{LOBES, NODES, STRATA, TableSampling, node};

/// S(r_k) = Σ L f_s(r_k) nl / Σ_j n_j p_j at every node k, the mean over the strata: the balance heuristic (Veach and
/// Guibas 1995) over all lobes, the cosine and the lights. Every node uses every sample. Technique j draws from the
/// Sobol sequence of `hash2(hash2(seed, index), j)`, stratum t its samples `[t n_j, (t+1) n_j)`.
pub fn specular_table<'a, R: Real, T: Trace<R>>(
    lighting: &'a Lighting<'a, T>,
    lights: &'a Lights,
    strata: &'a [ShadePoint; STRATA],
    f0: f32,
    sampling: TableSampling,
) -> [V3<R>; NODES] {
    let seed = hash2(sampling.seed, strata[0].index);
    let sampling = TableSampling { light: if lights.is_empty() { 0 } else { sampling.light }, ..sampling };
    let mut sums = [[R::of(0.0); NODES]; 3];
    let widest = Arch::new();
    let nodes: [R; NODES] = std::array::from_fn(|k| R::of(f64::from(node(k))));
    for (stratum, point) in strata.iter().enumerate() {
        let (frame, view) = (Frame::of(V3::<R>::of(point.normal)), V3::of(point.view));
        let nv = frame.normal.dot(view).max(R::of(0.0)).min(R::of(1.0));
        let seen = nodes.map(|r| sampling.masking.at(nv, r) * R::of(0.25));
        let table = lights.table(point.position.into(), point.normal.into());
        let drawn = Drawn { lighting, lights, table, point, f0, sampling };
        let mut batch = ArrayVec::<Sample<'_, R>, TOGETHER>::new();
        let mut weigh = |batch: &mut ArrayVec<Sample<'_, R>, TOGETHER>| {
            let samples: ArrayVec<_, TOGETHER> = batch.drain(..).map(|sample| (sample.light(), sample.lobe)).collect();
            let masking = sampling.masking;
            widest.dispatch(AtEveryNode { samples: &samples, masking, nodes: &nodes, seen: &seen, sums: &mut sums });
        };
        let mut add = |sample: Option<Sample<'a, R>>| {
            batch.extend(sample);
            if batch.is_full() {
                weigh(&mut batch);
            }
        };
        let sequence = |technique: usize, samples: u32| {
            let first = stratum as u32 * samples;
            (first..first + samples).map(move |i| (i, hash2(seed, technique as u32)))
        };
        for (technique, lobe) in LOBES.iter().enumerate() {
            for (i, seed) in sequence(technique, sampling.lobe) {
                let lobe = R::of(f64::from(*lobe));
                add(drawn.towards(sample_lobe(&frame, view, lobe, sobol2(i, seed)).direction, None));
            }
        }
        for (i, seed) in sequence(LOBES.len(), sampling.cosine) {
            add(drawn.towards(frame.to_world(cosine_direction(sobol2(i, seed))), None));
        }
        for (i, seed) in sequence(LOBES.len() + 1, sampling.light) {
            let (triangle, target) = light_point(lighting.tracer.mesh(), lights, table, sobol2(i, seed));
            add(drawn.towards((target - V3::of(point.position)).normalize(), Some(triangle)));
        }
        weigh(&mut batch);
    }
    std::array::from_fn(|k| V3(sums.map(|sums| sums[k])) * R::of(1.0 / STRATA as f64))
}

/// One stratum's point and what directions are drawn with.
struct Drawn<'a, T> {
    lighting: &'a Lighting<'a, T>,
    lights: &'a Lights,
    /// Of the lights, at this point.
    table: &'a [f32],
    point: &'a ShadePoint,
    f0: f32,
    sampling: TableSampling,
}

/// What a direction brings.
struct Sample<'a, R> {
    radiance: &'a [f32; 3],
    /// F nl / Σ_j n_j p_j.
    weight: R,
    lobe: Lobe<R>,
}

impl<R: Real> Sample<'_, R> {
    fn light(&self) -> V3<R> {
        V3::of(*self.radiance) * self.weight
    }
}

impl<'a, T> Drawn<'a, T> {
    /// Traces a direction. A light sample counts only where it reaches its own triangle.
    fn towards<R: Real>(&self, direction: V3<R>, aimed_at: Option<u32>) -> Option<Sample<'a, R>>
    where
        T: Trace<R>,
    {
        let (zero, one) = (R::of(0.0), R::of(1.0));
        let (normal, view) = (V3::of(self.point.normal), V3::of(self.point.view));
        let (nl, nv) = (normal.dot(direction), normal.dot(view));
        if !(nl > zero && nv > zero) {
            return None;
        }
        let half = (direction + view).normalize();
        let across = normal.cross(half);
        let lobe = Lobe {
            nl: nl.min(one),
            nh: normal.dot(half).max(zero).min(one),
            vh: view.dot(half).max(R::of(1e-6)).min(one),
            sin2: across.dot(across),
        };
        let hit = self.lighting.tracer.closest(V3::of(self.point.position), direction)?;
        if aimed_at.is_some_and(|triangle| triangle != hit.triangle) {
            return None;
        }
        let fresnel = fresnel_weight(lobe.vh);
        let fresnel = R::of(f64::from(self.f0)) * (one - fresnel) + fresnel;
        let weight = lobe.nl * fresnel / self.density(&lobe, &hit, direction);
        Some(Sample { radiance: self.lighting.radiance_at(&hit), weight, lobe })
    }

    /// Σ_j n_j p_j: how densely all techniques together draw a direction, per solid angle.
    fn density<R: Real>(&self, lobe: &Lobe<R>, hit: &TraceHit<R>, direction: V3<R>) -> R
    where
        T: Trace<R>,
    {
        let n = |samples: u32| R::of(f64::from(samples));
        let lobes = LOBES.iter().map(|&r| lobe.pdf(R::of(f64::from(r)))).fold(R::of(0.0), |sum, p| sum + p);
        n(self.sampling.lobe) * lobes
            + n(self.sampling.cosine) * lobe.nl * R::of(std::f64::consts::FRAC_1_PI)
            + n(self.sampling.light) * light_pdf(self.lighting.tracer.mesh(), self.lights, self.table, hit, direction)
    }
}

/// Adds what every node reflects of some samples: several nodes at once, by the widest instructions that the processor
/// has.
struct AtEveryNode<'a, R> {
    /// The light that each brings, and its directions.
    samples: &'a [(V3<R>, Lobe<R>)],
    masking: Masking,
    /// Roughness of every node.
    nodes: &'a [R; NODES],
    /// g(nv)/4 at every node.
    seen: &'a [R; NODES],
    sums: &'a mut [[R; NODES]; 3],
}

impl<R: Real> NullaryFnOnce for AtEveryNode<'_, R> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { samples, masking, nodes, seen, sums } = self;
        for (V3(light), lobe) in samples {
            let mut reflected = [R::of(0.0); NODES];
            for k in 0..NODES {
                // f_s / F = D g(nl) g(nv) / 4.
                reflected[k] = ndf_from_sin2(lobe.sin2, nodes[k]) * masking.at(lobe.nl, nodes[k]) * seen[k];
            }
            for (sums, light) in sums.iter_mut().zip(light) {
                for k in 0..NODES {
                    sums[k] = sums[k] + *light * reflected[k];
                }
            }
        }
    }
}

/// A pair of directions as the lobes see it: cosines, and sin²θ_h.
struct Lobe<R> {
    nl: R,
    nh: R,
    vh: R,
    sin2: R,
}

impl<R: Real> Lobe<R> {
    /// Density of the direction under half-vector sampling: D nh / (4 vh).
    fn pdf(&self, r: R) -> R {
        ndf_from_sin2(self.sin2, r) * self.nh / (R::of(4.0) * self.vh)
    }
}
