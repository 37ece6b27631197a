//! Settings of paper mode.

use serde::{Deserialize, Serialize};

use super::checks::{Check, at_least_one, not_negative, positive, share};
use crate::backend::{MAX_SAMPLES, RoughnessGradient};

/// Paper mode; defaults are the paper's where it states them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperSettings {
    /// Specular samples per pixel and step.
    pub specular_samples: u32,
    /// Take diffuse light from the irradiance that was baked. Otherwise every step gathers it anew, with as
    /// many cosine-distributed rays per pixel as `specular_samples` (the paper's source TBL, Figure 8).
    pub precomputed_irradiance: bool,
    /// Which roughness gradient the adjoint uses.
    pub gradient: RoughnessGradient,
    /// Sub-pixel footprints per pixel and axis: the images are box-filtered, so a pixel sees more than its centre.
    pub footprint_samples: usize,
    /// Adam and its schedule.
    pub optimiser: OptimiserSettings,
    /// Where the parameters start and may go.
    pub parameters: ParameterSettings,
    /// Stage I: albedo under diffuse lighting.
    pub stage_one: StageOneSettings,
    /// Stage II: roughness at virtual highlights, propagated within the class.
    pub stage_two: StageTwoSettings,
    /// Stage III: albedo and roughness together.
    pub stage_three: StageThreeSettings,
}

/// Adam and its schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserSettings {
    /// Step size of the first epochs.
    pub learning_rate: f32,
    /// Factor on the step size every `decay_epochs`.
    pub decay: f32,
    /// Epochs between two decays. The paper's 20 leave a last step of 0.02, which is seen as noise in the textures; 5
    /// end at 0.005.
    pub decay_epochs: u32,
    /// Passes over the views, per stage.
    pub epochs: u32,
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the root of the second moment. Losses are means over a view's pixels, so gradients per texel are of the
    /// order 1e-6: an ε that is small against image gradients is not small against these.
    pub epsilon: f32,
}

/// Where the parameters start and may go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ParameterSettings {
    /// Initial albedo.
    pub albedo_start: f32,
    /// Initial roughness.
    pub roughness_start: f32,
    /// Smallest and largest albedo. The paper has no upper bound; without one, a few texels whose irradiance is
    /// underestimated grow without limit.
    pub albedo_range: [f32; 2],
    /// Smallest and largest roughness.
    pub roughness_range: [f32; 2],
}

/// Stage I: mean|T(aE/π) − T(I)| + weight · mean|a − mean_class(a)|.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StageOneSettings {
    /// Run this stage.
    pub enabled: bool,
    /// β_ssa. The authors' code weighs a mean over 49 classes with 20.
    pub semantic_weight: f32,
}

/// Stage II: mean over virtual-highlight pixels of |T(L_o) − T(I)| + weight · mean|r − Q_q(r on them in the class)|.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StageTwoSettings {
    /// Run this stage.
    pub enabled: bool,
    /// β_sp.
    pub propagation_weight: f32,
    /// q: which quantile of the class's virtual-highlight roughness the rest of the class follows.
    pub quantile: f32,
}

/// Stage III: mean|T(L_o) − T(I)| + weight · mean|r − mean_(class ∧ room)(r)|.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StageThreeSettings {
    /// Run this stage.
    pub enabled: bool,
    /// β_ssr.
    pub smoothness_weight: f32,
}

impl Default for PaperSettings {
    fn default() -> Self {
        Self {
            specular_samples: 16,
            precomputed_irradiance: true,
            gradient: RoughnessGradient::Exact,
            footprint_samples: 2,
            optimiser: OptimiserSettings::default(),
            parameters: ParameterSettings::default(),
            stage_one: StageOneSettings::default(),
            stage_two: StageTwoSettings::default(),
            stage_three: StageThreeSettings::default(),
        }
    }
}

impl Default for OptimiserSettings {
    fn default() -> Self {
        Self { learning_rate: 3e-2, decay: 0.8, decay_epochs: 5, epochs: 41, beta1: 0.9, beta2: 0.999, epsilon: 1e-8 }
    }
}

impl Default for ParameterSettings {
    fn default() -> Self {
        Self { albedo_start: 0.5, roughness_start: 0.1, albedo_range: [0.0, 1.0], roughness_range: [0.01, 0.8] }
    }
}

impl Default for StageOneSettings {
    fn default() -> Self {
        Self { enabled: true, semantic_weight: 20.0 / 49.0 }
    }
}

impl Default for StageTwoSettings {
    fn default() -> Self {
        Self { enabled: true, propagation_weight: 0.2, quantile: 0.4 }
    }
}

impl Default for StageThreeSettings {
    fn default() -> Self {
        Self { enabled: true, smoothness_weight: 0.2 }
    }
}

impl PaperSettings {
    pub(super) fn checks(&self) -> Vec<Check> {
        let (o, p) = (&self.optimiser, &self.parameters);
        let within = |value: f32, range: [f32; 2]| value >= range[0] && value <= range[1];
        vec![
            (
                "paper.specular_samples",
                self.specular_samples as f32,
                (1..=MAX_SAMPLES).contains(&self.specular_samples),
                "1 to 1048576",
            ),
            (
                "paper.footprint_samples",
                self.footprint_samples as f32,
                (1..=8).contains(&self.footprint_samples),
                "1 to 8",
            ),
            positive("paper.optimiser.learning_rate", o.learning_rate),
            ("paper.optimiser.decay", o.decay, o.decay > 0.0 && o.decay <= 1.0, "in (0, 1]"),
            at_least_one("paper.optimiser.decay_epochs", o.decay_epochs),
            ("paper.optimiser.beta1", o.beta1, (0.0..1.0).contains(&o.beta1), "in [0, 1)"),
            ("paper.optimiser.beta2", o.beta2, (0.0..1.0).contains(&o.beta2), "in [0, 1)"),
            positive("paper.optimiser.epsilon", o.epsilon),
            not_negative("paper.parameters.albedo_range[0]", p.albedo_range[0]),
            (
                "paper.parameters.albedo_range[1]",
                p.albedo_range[1],
                p.albedo_range[1] > p.albedo_range[0] && p.albedo_range[1].is_finite(),
                "above the lower bound",
            ),
            (
                "paper.parameters.albedo_start",
                p.albedo_start,
                within(p.albedo_start, p.albedo_range),
                "within paper.parameters.albedo_range",
            ),
            (
                "paper.parameters.roughness_range[0]",
                p.roughness_range[0],
                p.roughness_range[0] >= 0.005,
                "at least 0.005",
            ),
            (
                "paper.parameters.roughness_range[1]",
                p.roughness_range[1],
                p.roughness_range[1] > p.roughness_range[0] && p.roughness_range[1] <= 1.0,
                "above the lower bound, at most 1",
            ),
            (
                "paper.parameters.roughness_start",
                p.roughness_start,
                within(p.roughness_start, p.roughness_range),
                "within paper.parameters.roughness_range",
            ),
            not_negative("paper.stage_one.semantic_weight", self.stage_one.semantic_weight),
            not_negative("paper.stage_two.propagation_weight", self.stage_two.propagation_weight),
            not_negative("paper.stage_three.smoothness_weight", self.stage_three.smoothness_weight),
            share("paper.stage_two.quantile", self.stage_two.quantile),
        ]
    }
}
