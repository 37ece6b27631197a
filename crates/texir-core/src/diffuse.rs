//! Diffuse models: how the radiance that a surface scatters depends on the direction to the camera.
//!
//! Irradiance is precomputed without directions, so a model acts as a factor on a E/π: its directional albedo under
//! uniform light, over that of a Lambertian.

use std::f32::consts::PI;
use std::fmt::{self, Display, Formatter};
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

/// A diffuse model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DiffuseModel {
    /// The same from everywhere, as in the paper.
    #[default]
    Lambert,
    /// Retro-reflection of rough surfaces (Burley, "Physically Based Shading at Disney", 2012, section 5.3).
    Burley,
}

impl Display for DiffuseModel {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Lambert => "Lambert",
            Self::Burley => "Burley",
        })
    }
}

impl DiffuseModel {
    /// Radiance towards cosine `nv`, over that of a Lambertian of the same albedo, at perceptual roughness `r`.
    pub fn factor(self, nv: f32, r: f32) -> f32 {
        match self {
            Self::Lambert => 1.0,
            Self::Burley => BURLEY.at(nv, r),
        }
    }

    /// What is scattered into all directions together, over that of a Lambertian of the same albedo, at perceptual
    /// roughness `r`: the mean of [`DiffuseModel::factor`] by the cosine, 2 ∫ factor cosθ d(cosθ).
    pub fn albedo_factor(self, r: f32) -> f32 {
        // By the midpoint rule.
        let term = |i: usize| {
            let cosine = (i as f32 + 0.5) / SIZE as f32;
            2.0 * cosine * self.factor(cosine, r) / SIZE as f32
        };
        match self {
            Self::Lambert => 1.0,
            Self::Burley => (0..SIZE).map(term).sum(),
        }
    }
}

/// Columns (n·v) and rows (r) of the table.
const SIZE: usize = 33;
/// Quadrature points per axis.
const STEPS: usize = 64;

/// Directional albedo of Burley's model over n·v and r, both from 0 to 1.
struct DirectionalAlbedo(Vec<f32>);

static BURLEY: LazyLock<DirectionalAlbedo> = LazyLock::new(|| {
    let at = |i: usize| i as f32 / (SIZE - 1) as f32;
    DirectionalAlbedo((0..SIZE * SIZE).map(|i| burley(at(i % SIZE), at(i / SIZE))).collect())
});

impl DirectionalAlbedo {
    /// Bilinear.
    fn at(&self, nv: f32, r: f32) -> f32 {
        let split = |x: f32| {
            let x = x.clamp(0.0, 1.0) * (SIZE - 1) as f32;
            let i = (x as usize).min(SIZE - 2);
            (i, x - i as f32)
        };
        let ((x, fx), (y, fy)) = (split(nv), split(r));
        let row = |y: usize| self.0[y * SIZE + x] * (1.0 - fx) + self.0[y * SIZE + x + 1] * fx;
        row(y) * (1.0 - fy) + row(y + 1) * fy
    }
}

/// ∫ (1 + (F90−1)(1−nl)⁵)(1 + (F90−1)(1−nv)⁵) nl/π dω with F90 = 1/2 + 2 r (l·h)², by the midpoint rule in nl² and φ.
fn burley(nv: f32, r: f32) -> f32 {
    let sin_v = (1.0 - nv * nv).max(0.0).sqrt();
    let view = (1.0 - nv).powi(5);
    let mut sum = 0.0;
    for i in 0..STEPS {
        let nl = ((i as f32 + 0.5) / STEPS as f32).sqrt();
        let sin_l = (1.0 - nl * nl).max(0.0).sqrt();
        for j in 0..STEPS {
            let phi = PI * (j as f32 + 0.5) / STEPS as f32;
            // (l·h)² = (1 + l·v)/2.
            let f90 = 0.5 + r * (1.0 + sin_v * sin_l * phi.cos() + nv * nl);
            sum += (1.0 + (f90 - 1.0) * (1.0 - nl).powi(5)) * (1.0 + (f90 - 1.0) * view);
        }
    }
    sum / (STEPS * STEPS) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn burley_brightens_rough_and_darkens_smooth_surfaces_towards_the_rim() {
        let model = DiffuseModel::Burley;
        assert!(model.factor(0.1, 1.0) > 1.2 && model.factor(0.1, 0.05) < 0.8);
        assert!((model.factor(1.0, 0.5) - 1.0).abs() < 0.05);
        assert_eq!(DiffuseModel::Lambert.factor(0.1, 1.0), 1.0);
    }

    #[test]
    fn rough_surfaces_of_burleys_scatter_more_than_lambertians_and_smooth_ones_less() {
        for r in [0.1, 0.5, 1.0] {
            // ∫ factor 2c dc by the trapezoidal rule in c.
            let steps = 1000;
            let term = |i: usize| {
                let c = i as f32 / steps as f32;
                let weight = if i == 0 || i == steps { 0.5 } else { 1.0 };
                weight * 2.0 * c * DiffuseModel::Burley.factor(c, r) / steps as f32
            };
            let (found, expected) = (DiffuseModel::Burley.albedo_factor(r), (0..=steps).map(term).sum::<f32>());
            assert!((found / expected - 1.0).abs() < 2e-3, "{r}: {found} for {expected}");
        }
        assert!(DiffuseModel::Burley.albedo_factor(1.0) > 1.02 && DiffuseModel::Burley.albedo_factor(0.1) < 0.98);
        assert_eq!(DiffuseModel::Lambert.albedo_factor(0.3), 1.0);
    }

    #[test]
    fn the_factor_is_the_lobes_integral() {
        // Over vectors l and h themselves, by spherical angles, in double precision.
        let integral = |nv: f64, r: f64| {
            let (v, steps) = ([(1.0 - nv * nv).sqrt(), 0.0, nv], 400);
            let mut sum = 0.0;
            for i in 0..steps {
                let theta = std::f64::consts::FRAC_PI_2 * (f64::from(i) + 0.5) / f64::from(steps);
                for j in 0..steps {
                    let phi = std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(steps);
                    let l = [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()];
                    let h = [l[0] + v[0], l[1] + v[1], l[2] + v[2]];
                    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                    let f90 = 0.5 + 2.0 * r * dot(l, h).powi(2) / dot(h, h);
                    let towards = |cosine: f64| 1.0 + (f90 - 1.0) * (1.0 - cosine).powi(5);
                    sum += towards(l[2]) * towards(nv) * l[2] * theta.sin();
                }
            }
            // ∫ … dω/π, in cells of (π/2)(2π)/steps².
            sum * std::f64::consts::PI / f64::from(steps * steps)
        };
        for nv in [0.1, 0.2, 0.5, 1.0] {
            for r in [0.1, 0.5, 1.0] {
                let [found, expected] = [f64::from(DiffuseModel::Burley.factor(nv, r)), integral(nv.into(), r.into())];
                // The table is coarse towards the rim.
                let bound = if nv == 1.0 { 1e-3 } else { 0.01 };
                assert!(
                    (found / expected - 1.0).abs() < bound,
                    "at a cosine of {nv}, roughness {r}: {found} for {expected}"
                );
            }
        }
    }
}
