//! Denoising of irradiance in the atlas: what is noise is told from what is shadow by two estimates that err
//! differently.
//!
//! Every texel takes a local quadratic fit of its neighbours on the surface (regression keeps gradients, and curvature
//! as far as noise lets it be seen), weighted by distance and by how much their irradiance differs beyond noise. Each
//! half of the samples is fitted with weights that the other half gave, so that a texel's noise does not choose its own
//! neighbours (Rousselle, Knaus and Zwicker, "Adaptive Rendering with Non-Local Means Filtering", SIGGRAPH Asia 2012;
//! regression after Bitterli et al., "Nonlinearly Weighted First-order Regression for Denoising Monte Carlo
//! Renderings", EGSR 2016). And what both halves have beyond their fits is no noise: it stays, which keeps shadows too
//! thin for the fit to see.
//!
//! Where few samples carry most of the light (fireflies), each half takes the other's for noise and loses them. The
//! mean loss of texels of similar brightness, as far as it is significant, is therefore added back to them.
//!
//! The pass is [`Backend::denoise`](crate::backend::Backend::denoise); this is what its implementations share.

#[cfg(feature = "oidn")]
pub mod oidn;

use crate::error::{Error, Result};
use crate::surface::SurfacePoint;

/// Radius of the fit, texels.
pub const RADIUS: f32 = 10.0;
/// Radius within which the guide is smoothed, texels.
pub const GUIDE_RADIUS: f32 = 1.6;
/// Radius within which noise is measured, texels: so wide that a texel's own noise hardly sets how much it is smoothed,
/// which would keep dark texels dark and not bright ones bright.
pub const NOISE_RADIUS: f32 = 3.2;
/// Radius over which the residual that the fits miss is pooled, texels.
pub const RESIDUAL_RADIUS: f32 = 2.5;
/// How far away a point may be that has a say in what becomes of another, texels.
pub(crate) const REACH: f32 = RADIUS + RESIDUAL_RADIUS + RADIUS + GUIDE_RADIUS;
/// Edge of the cells that neighbours are looked for in, texels.
pub const CELL: f32 = RADIUS / 3.0;
// What looks no further than a cell's edge goes through the columns within one cell alone.
const _: () = assert!(GUIDE_RADIUS <= CELL && NOISE_RADIUS <= CELL && RESIDUAL_RADIUS <= CELL);
/// A neighbour's weight falls to a quarter where its difference beyond noise is this many times the noise.
pub const TOLERANCE: f32 = 2.0;
/// How much curvature is expected: standard deviation of the quadratic coefficients over the fit's radius, as a share
/// of the value. Noise makes the fit as linear as this lets it.
pub const CURVATURE: f32 = 0.5;
/// The halves' residual covariance counts as signal as far as it exceeds this many times the residual's variance:
/// halves that are parts of one lattice are correlated, where independent ones are not.
pub const RESIDUAL_THRESHOLD: f32 = 1.25;
/// What is lost on average is given back as far as it is more than this many of its standard errors.
pub const LOSS_SIGMAS: f32 = 2.0;
/// The regression's ridge, as a share of the weight: keeps a fit along a line of texels solvable.
pub const RIDGE: f32 = 1e-3;

/// Two estimates of a quantity per point from as many samples each, linear RGB. Their mean is the estimate, half of
/// their difference its standard error if they are independent, and more than that if they are parts of one sequence.
pub type Halves<'a> = [&'a [[f32; 3]]; 2];

/// What is to be denoised.
#[derive(Clone, Copy, Debug)]
pub struct Noisy<'a> {
    /// Where on the surface. Their indices are to differ: processors take points of different ones at once.
    pub points: &'a [SurfacePoint],
    /// What was found there.
    pub halves: Halves<'a>,
    /// Points that are not to be mixed with the others (inside other geometry).
    pub apart: &'a [bool],
    /// Edge of a typical texel, metres, above 0.
    pub texel: f32,
}

impl Noisy<'_> {
    /// Whether there is one of everything for every point, and texels have a size.
    pub fn check(&self) -> Result<()> {
        let [a, b] = self.halves;
        if [a.len(), b.len(), self.apart.len()] != [self.points.len(); 3] {
            return Err(Error::invalid(format!(
                "{} points to denoise, with halves of {} and {} estimates and {} flags",
                self.points.len(),
                a.len(),
                b.len(),
                self.apart.len()
            )));
        }
        if let Some(i) =
            a.iter().zip(b).position(|halves| [halves.0, halves.1].iter().any(|e| !e.iter().all(|c| c.is_finite())))
        {
            return Err(Error::invalid(format!(
                "point {i} to denoise: {:?} and {:?}; expected finite irradiance",
                a[i], b[i]
            )));
        }
        if self.texel > 0.0 && self.texel.is_finite() {
            return Ok(());
        }
        Err(Error::invalid(format!("texels of {} m to denoise; expected a size above 0", self.texel)))
    }
}
