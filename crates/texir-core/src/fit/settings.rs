//! Every weight and switch of the fit by name, as one TOML file.

use bytesize::ByteSize;
use serde::{Deserialize, Serialize};

use crate::atlas::LARGEST_SIDE;
use crate::backend::{MOST_SAMPLES, RoughnessGradient};
use crate::brdf::Masking;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::rng::hash2;
use crate::specular_table::TableSampling;

/// Rays per texel at the least: two halves, whose difference tells the noise, of two kinds.
const LEAST_RAYS: u32 = 4;

/// How materials are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The paper's three stages of gradient descent.
    Paper,
    /// Robust least squares and a scan over roughness, on light samples drawn beforehand.
    #[default]
    Full,
}

impl Mode {
    /// The fields of [`FitSettings`] that this mode alone reads.
    pub fn own_settings(self) -> &'static [&'static str] {
        match self {
            Self::Paper => &[
                "specular_samples",
                "precomputed_irradiance",
                "gradient",
                "footprint_samples",
                "optimiser",
                "parameters",
                "stage_one",
                "stage_two",
                "stage_three",
            ],
            Self::Full => &["full"],
        }
    }
}

/// Settings of the fit; in paper mode the defaults are the paper's where it states them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitSettings {
    /// Seed of every random choice.
    pub seed: u32,
    /// How materials are found.
    pub mode: Mode,
    /// Side of the square atlas that is fitted, texels; 0 takes the HDR texture's size, or without one what suits the
    /// views ([`crate::fit::memory::default_side`]).
    pub atlas_size: usize,
    /// Rays per texel of the irradiance bake, half of them to the light sources; 0 lets them follow the texels' area,
    /// see [`FitSettings::irradiance_rays`].
    pub irradiance_samples: u32,
    /// What the fit may have in memory, such as "2 GiB": views are read at a lower resolution to keep to it.
    pub max_memory: ByteSize,
    /// Specular samples per pixel and step.
    pub specular_samples: u32,
    /// Paper mode: take diffuse light from the irradiance that was baked. Otherwise every step gathers it anew, with as
    /// many cosine-distributed rays per pixel as `specular_samples` (the paper's source TBL, Figure 8).
    pub precomputed_irradiance: bool,
    /// A texel is a light source where its radiance exceeds what an albedo of this value would reflect, L > ratio ·
    /// E/π, and its room's mean radiance as many times.
    pub emitter_ratio: f32,
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
    /// Full mode.
    pub full: FullSettings,
}

/// Full mode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FullSettings {
    /// Whether light sources of a given HDR texture are made to explain the pixels that show them, as those of one
    /// built from the views are.
    pub resolve_sources: bool,
    /// How often irradiance is gathered anew, and everything fitted to it, under the light that surfaces send by the
    /// materials found so far: without highlights, and where no view sees as well. 0: the HDR texture is taken as it
    /// is.
    pub alternations: u32,
    /// Pixels of one flat surface share their light samples in blocks about this wide, degrees.
    pub block_angle: f32,
    /// Light samples of each of a block's four points, per lobe of five.
    pub lobe_samples: u32,
    /// Cosine-distributed light samples of each of a block's four points.
    pub cosine_samples: u32,
    /// Light samples of each of a block's four points to the light sources.
    pub light_samples: u32,
    /// Blocks lend each other their light samples while what they reflect turns by little beside this share of a lobe's
    /// width α; 0: not at all.
    pub curve_sharing: f32,
    /// How the microfacets of highlights hide each other: `smith`, as engines have it, or `schlick`, as the paper does.
    pub masking: Masking,
    /// How diffuse radiance depends on the direction to the camera: `auto`, `lambert` or `burley`.
    pub diffuse: DiffuseChoice,
    /// Albedo by least squares.
    pub albedo: AlbedoSettings,
    /// Roughness by a scan.
    pub roughness: RoughnessSettings,
    /// Few colours per segment.
    pub palette: PaletteSettings,
    /// Segments of metal.
    pub metallic: MetallicSettings,
}

/// Which segments are metal: with F0 = albedo and nothing diffuse. It takes a second set of light samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MetallicSettings {
    /// Look for metals; without, everything is a dielectric.
    pub enabled: bool,
    /// By how much metal must explain a segment better than a dielectric: the fall of the logarithm of its mean cost.
    /// Few things in a room are bare metal.
    pub gain: f32,
    /// Roughness up to which metal can be told from a dielectric.
    pub roughest: f32,
}

impl Default for MetallicSettings {
    fn default() -> Self {
        Self { enabled: false, gain: 0.3, roughest: 0.5 }
    }
}

/// Which diffuse model is fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DiffuseChoice {
    /// The one under which least is left to explain at grazing angles.
    #[default]
    Auto,
    /// [`DiffuseModel::Lambert`].
    Lambert,
    /// [`DiffuseModel::Burley`].
    Burley,
}

impl From<DiffuseModel> for DiffuseChoice {
    fn from(model: DiffuseModel) -> Self {
        match model {
            DiffuseModel::Lambert => Self::Lambert,
            DiffuseModel::Burley => Self::Burley,
        }
    }
}

impl FullSettings {
    /// The settings of each round.
    pub fn rounds(&self) -> Vec<Self> {
        let mut rounds = vec![self.coarse(); self.alternations as usize];
        rounds.push(self.clone());
        rounds
    }

    /// For a round that only has to tell what light surfaces send, and by which diffuse model: a third of the light
    /// samples for blocks twice as wide, no joints.
    fn coarse(&self) -> Self {
        let mut coarse = self.clone();
        for samples in [&mut coarse.lobe_samples, &mut coarse.cosine_samples, &mut coarse.light_samples] {
            *samples = samples.div_ceil(3);
        }
        coarse.block_angle *= 2.0;
        coarse.roughness.every *= 2;
        coarse.roughness.joints.width = 0.0;
        coarse
    }
}

impl DiffuseChoice {
    /// The models that come into question.
    pub fn candidates(self) -> Vec<DiffuseModel> {
        match self {
            Self::Auto => vec![DiffuseModel::Lambert, DiffuseModel::Burley],
            Self::Lambert => vec![DiffuseModel::Lambert],
            Self::Burley => vec![DiffuseModel::Burley],
        }
    }
}

/// Roughness that varies within a surface, of which blocks have a share of each of two finishes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalSettings {
    /// Edge of a block, metres.
    pub block: f32,
    /// By how much a second finish must explain what half of the views see, where the other half asks for it, to be
    /// believed half: the fall of the logarithm of the mean cost.
    pub gain: f32,
    /// Pixels that must see it for half of that gain to count.
    pub half_pixels: f32,
    /// Pixels that each finish must have.
    pub pixels: u32,
}

impl Default for LocalSettings {
    fn default() -> Self {
        Self { block: 0.3, gain: 0.07, half_pixels: 1000.0, pixels: 500 }
    }
}

/// How much segments say about each other's roughness: two of one class, room and colour 1, others less.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KinSettings {
    /// Standard deviation of the differences between the mean albedos of what is of one material, in ln a.
    pub colour: f32,
    /// What those of one class in different rooms count.
    pub other_room: f32,
    /// What those of different classes count.
    pub other_class: f32,
}

impl Default for KinSettings {
    fn default() -> Self {
        Self { colour: 0.25, other_room: 0.3, other_class: 0.2 }
    }
}

/// When a part of a segment is believed to have a roughness of its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnSettings {
    /// Pull of the segment's on it.
    pub pull: f32,
    /// By how much it must explain the part's pixels better to be believed half, where each half of the views judges by
    /// the one that the other half asks for: the fall of the logarithm of the mean cost.
    pub agreement: f32,
    /// Pixels with which that fall counts half; it counts less with fewer.
    pub half_pixels: f32,
}

/// Straight lines along the rows and columns of the atlas.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Straight {
    /// Distance over which they are followed, metres.
    pub reach: f32,
    /// By how much they are darker or brighter than what is beside them, on average, in ln a.
    pub contrast: f32,
}

/// Lines that divide a surface, as joints do boards and grout does tiles, and have a roughness of their own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointSettings {
    /// How wide lines may be, metres; 0: joints are not looked for.
    pub width: f32,
    /// How straight lines are told: a segment has those of the first kind of which it has enough.
    pub straight: Vec<Straight>,
    /// By how much lines of any course are darker or brighter than what is around them, in ln a, where a segment has no
    /// straight ones.
    pub contrast: f32,
    /// How long those must be, metres, counted in texels that touch.
    pub length: f32,
    /// Share of a segment's texels that its darker or its brighter lines must have.
    pub least_share: f32,
    /// When they are believed to have one.
    pub own: OwnSettings,
}

impl Default for JointSettings {
    fn default() -> Self {
        Self {
            width: 0.03,
            straight: vec![Straight { reach: 3.0, contrast: 0.08 }, Straight { reach: 0.4, contrast: 0.1 }],
            contrast: 0.15,
            length: 0.04,
            least_share: 0.02,
            own: OwnSettings { pull: 0.03, agreement: 0.02, half_pixels: 1000.0 },
        }
    }
}

/// The prior that segments are painted in few colours.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaletteSettings {
    /// How far albedo is drawn to the nearest colour of its segment: 0 not at all, 1 all the way.
    pub strength: f32,
    /// Width of the kernel in ln a: colours that differ less are one.
    pub bandwidth: f32,
    /// Distance in ln a at which the pull has fallen to 61 %.
    pub reach: f32,
    /// Colours of a segment, at most.
    pub colours: usize,
    /// Share of a segment's texels that a colour must have.
    pub least_share: f32,
}

/// Albedo by robust least squares.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlbedoSettings {
    /// σ of every pixel's albedo, to which `image_noise` and `specular_noise` add.
    pub noise: f32,
    /// σ of a pixel's albedo as a share of its apparent albedo I π/E.
    pub image_noise: f32,
    /// σ of a pixel's albedo, once roughness is known, as a share of the specular radiance that is taken off, as an
    /// albedo: where highlights are bright, what is left is known badly.
    pub specular_noise: f32,
    /// Weight of the difference between neighbours, where a pixel of least noise has 1.
    pub smoothness: f32,
    /// Albedo difference from which an edge is believed.
    pub edge_scale: f32,
    /// Weight of the segment's mean on every texel.
    pub segment_prior: f32,
    /// Re-weightings.
    pub rounds: u32,
    /// Steps of conjugate gradients between two.
    pub iterations: u32,
}

/// Roughness by a scan, and how groups follow their parents: pulls weigh (2 (r − r_parent))² against the logarithm of
/// the mean cost, so that a pull of 0.1 holds what is 0.5 away as a tenth more of misfit would.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RoughnessSettings {
    /// Roughness of what nothing is known about.
    pub start: f32,
    /// σ of a pixel's albedo in the scan: the albedo's `noise`, and this share of the apparent albedo.
    pub image_noise: f32,
    /// What residuals count for by which channels differ, where what they have in common counts 1.
    pub colour_weight: f32,
    /// Steps of conjugate gradients per roughness.
    pub iterations: u32,
    /// Every how many-th of the tabulated roughnesses is solved; those between are interpolated.
    pub every: u32,
    /// Pixels seen at a smaller cosine do not count: models of grazing reflectance differ most.
    pub min_cosine: f32,
    /// Pixels within this angle, degrees, of one that is left out do not count, nor does the one beside it: it may hold
    /// a sliver of a light source.
    pub rim: f32,
    /// Largest roughness: beyond it lobes cannot be told apart.
    pub cap: f32,
    /// Pull of everything on a class.
    pub class_pull: f32,
    /// Pull of a class on its part in a room.
    pub room_pull: f32,
    /// Pull of a class in a room on its segments.
    pub segment_pull: f32,
    /// Pixels that a segment must have to be believed half; what it is akin to is worth as many.
    pub segment_pixels: f32,
    /// What segments are akin to.
    pub kin: KinSettings,
    /// Between the colours of a segment.
    pub colours: OwnSettings,
    /// Within colours.
    pub local: LocalSettings,
    /// Between boards and tiles.
    pub joints: JointSettings,
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

impl Default for FitSettings {
    fn default() -> Self {
        Self {
            seed: 0,
            mode: Mode::default(),
            atlas_size: 0,
            irradiance_samples: 0,
            max_memory: ByteSize::gib(8),
            specular_samples: 16,
            precomputed_irradiance: true,
            emitter_ratio: 3.0,
            gradient: RoughnessGradient::Exact,
            footprint_samples: 2,
            optimiser: OptimiserSettings::default(),
            parameters: ParameterSettings::default(),
            stage_one: StageOneSettings::default(),
            stage_two: StageTwoSettings::default(),
            stage_three: StageThreeSettings::default(),
            full: FullSettings::default(),
        }
    }
}

impl Default for FullSettings {
    fn default() -> Self {
        Self {
            resolve_sources: true,
            alternations: 1,
            block_angle: 0.7,
            lobe_samples: 6,
            cosine_samples: 2,
            light_samples: 12,
            curve_sharing: 0.3,
            masking: Masking::Smith,
            diffuse: DiffuseChoice::default(),
            albedo: AlbedoSettings::default(),
            roughness: RoughnessSettings::default(),
            palette: PaletteSettings::default(),
            metallic: MetallicSettings::default(),
        }
    }
}

impl Default for PaletteSettings {
    fn default() -> Self {
        Self { strength: 0.8, bandwidth: 0.08, reach: 0.3, colours: 6, least_share: 0.02 }
    }
}

impl Default for AlbedoSettings {
    fn default() -> Self {
        Self {
            noise: 0.02,
            image_noise: 0.1,
            specular_noise: 1.0,
            smoothness: 0.03,
            edge_scale: 0.03,
            segment_prior: 1e-3,
            rounds: 2,
            iterations: 12,
        }
    }
}

impl Default for RoughnessSettings {
    fn default() -> Self {
        Self {
            start: 0.5,
            image_noise: 0.05,
            colour_weight: 2.0,
            iterations: 4,
            every: 1,
            min_cosine: 0.3,
            rim: 0.7,
            cap: 0.88,
            class_pull: 0.1,
            room_pull: 0.15,
            segment_pull: 0.3,
            segment_pixels: 100.0,
            kin: KinSettings::default(),
            colours: OwnSettings { pull: 0.1, agreement: 0.02, half_pixels: 1000.0 },
            local: LocalSettings::default(),
            joints: JointSettings::default(),
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

/// A setting's name, its value, whether it is allowed, and what is.
type Check = (&'static str, f32, bool, &'static str);

fn not_negative(name: &'static str, value: f32) -> Check {
    (name, value, value >= 0.0 && value.is_finite(), "at least 0")
}

fn positive(name: &'static str, value: f32) -> Check {
    (name, value, value > 0.0 && value.is_finite(), "above 0")
}

fn counts(name: &'static str, value: u32) -> Check {
    (name, value as f32, (1..=1024).contains(&value), "1 to 1024")
}

fn at_least_one(name: &'static str, value: u32) -> Check {
    (name, value as f32, value > 0, "at least 1")
}

fn share(name: &'static str, value: f32) -> Check {
    (name, value, (0.0..=1.0).contains(&value), "in [0, 1]")
}

fn roughness(name: &'static str, value: f32) -> Check {
    (name, value, (0.03..=1.0).contains(&value), "in [0.03, 1]")
}

impl FullSettings {
    /// How the light samples of view `view` are drawn in a run of seed `seed`.
    pub fn sampling(&self, seed: u32, view: u32) -> TableSampling {
        let Self { lobe_samples: lobe, cosine_samples: cosine, light_samples: light, masking, .. } = *self;
        TableSampling { lobe, cosine, light, masking, seed: hash2(seed, view) }
    }

    fn checks(&self) -> Vec<Check> {
        let (a, r, p) = (&self.albedo, &self.roughness, &self.palette);
        let mut checks = vec![
            ("full.alternations", self.alternations as f32, self.alternations <= 16, "at most 16"),
            ("full.block_angle", self.block_angle, (0.0..=10.0).contains(&self.block_angle), "in [0, 10]"),
            counts("full.lobe_samples", self.lobe_samples),
            ("full.cosine_samples", self.cosine_samples as f32, self.cosine_samples <= 1024, "at most 1024"),
            ("full.light_samples", self.light_samples as f32, self.light_samples <= 1024, "at most 1024"),
            not_negative("full.curve_sharing", self.curve_sharing),
            positive("full.albedo.noise", a.noise),
            not_negative("full.albedo.image_noise", a.image_noise),
            not_negative("full.albedo.specular_noise", a.specular_noise),
            not_negative("full.albedo.smoothness", a.smoothness),
            positive("full.albedo.edge_scale", a.edge_scale),
            positive("full.albedo.segment_prior", a.segment_prior),
            counts("full.albedo.rounds", a.rounds),
            counts("full.albedo.iterations", a.iterations),
            roughness("full.roughness.start", r.start),
            not_negative("full.roughness.image_noise", r.image_noise),
            not_negative("full.roughness.colour_weight", r.colour_weight),
            counts("full.roughness.iterations", r.iterations),
            counts("full.roughness.every", r.every),
            ("full.roughness.min_cosine", r.min_cosine, (0.0..1.0).contains(&r.min_cosine), "in [0, 1)"),
            ("full.roughness.rim", r.rim, (0.0..=10.0).contains(&r.rim), "in [0, 10] degrees"),
            roughness("full.roughness.cap", r.cap),
            not_negative("full.roughness.class_pull", r.class_pull),
            not_negative("full.roughness.room_pull", r.room_pull),
            not_negative("full.roughness.segment_pull", r.segment_pull),
            positive("full.roughness.segment_pixels", r.segment_pixels),
            positive("full.roughness.kin.colour", r.kin.colour),
            share("full.roughness.kin.other_room", r.kin.other_room),
            share("full.roughness.kin.other_class", r.kin.other_class),
            not_negative("full.roughness.colours.pull", r.colours.pull),
            positive("full.roughness.colours.agreement", r.colours.agreement),
            not_negative("full.roughness.colours.half_pixels", r.colours.half_pixels),
            positive("full.roughness.local.block", r.local.block),
            positive("full.roughness.local.gain", r.local.gain),
            not_negative("full.roughness.local.half_pixels", r.local.half_pixels),
            ("full.roughness.joints.width", r.joints.width, (0.0..=0.5).contains(&r.joints.width), "in [0, 0.5]"),
            positive("full.roughness.joints.contrast", r.joints.contrast),
            positive("full.roughness.joints.length", r.joints.length),
            share("full.roughness.joints.least_share", r.joints.least_share),
            not_negative("full.roughness.joints.own.pull", r.joints.own.pull),
            positive("full.roughness.joints.own.agreement", r.joints.own.agreement),
            not_negative("full.roughness.joints.own.half_pixels", r.joints.own.half_pixels),
            share("full.palette.strength", p.strength),
            positive("full.palette.bandwidth", p.bandwidth),
            ("full.palette.colours", p.colours as f32, (1..=256).contains(&p.colours), "1 to 256"),
            positive("full.palette.reach", p.reach),
            share("full.palette.least_share", p.least_share),
            not_negative("full.metallic.gain", self.metallic.gain),
            roughness("full.metallic.roughest", self.metallic.roughest),
        ];
        checks.extend(r.joints.straight.iter().flat_map(|straight| {
            [
                positive("full.roughness.joints.straight.reach", straight.reach),
                positive("full.roughness.joints.straight.contrast", straight.contrast),
            ]
        }));
        checks
    }
}

impl FitSettings {
    /// Rays per texel of the irradiance bake, for texels of the given edge in metres. Irradiance varies over surfaces,
    /// not over texels, and the denoiser gathers from those around: 256 rays for texels of about 2.5 cm and more, 128
    /// or 64 for finer ones.
    pub fn irradiance_rays(&self, texel: f32) -> u32 {
        match self.irradiance_samples {
            0 => 256 >> (2.0 * (0.025 / texel).log2()).round().clamp(0.0, 2.0) as u32,
            samples => samples,
        }
    }

    /// How often irradiance is baked: once for each round of full mode, but for the last at a quarter of the texels
    /// ([`thinned`](crate::bake::thinned)).
    pub fn bakes(&self) -> usize {
        if self.mode == Mode::Full { self.full.rounds().len() } else { 1 }
    }

    /// Checks every value; the error names the setting, its value and what is allowed.
    pub fn validate(&self) -> Result<()> {
        let p = &self.parameters;
        let o = &self.optimiser;
        let within = |value: f32, range: [f32; 2]| value >= range[0] && value <= range[1];
        let checks = [
            ("atlas_size", self.atlas_size as f32, self.atlas_size <= LARGEST_SIDE, "at most 16384"),
            (
                "irradiance_samples",
                self.irradiance_samples as f32,
                self.irradiance_samples == 0 || (LEAST_RAYS..=MOST_SAMPLES).contains(&self.irradiance_samples),
                "0, or 4 to 1048576",
            ),
            (
                "specular_samples",
                self.specular_samples as f32,
                (1..=MOST_SAMPLES).contains(&self.specular_samples),
                "1 to 1048576",
            ),
            ("footprint_samples", self.footprint_samples as f32, (1..=8).contains(&self.footprint_samples), "1 to 8"),
            positive("emitter_ratio", self.emitter_ratio),
            positive("optimiser.learning_rate", o.learning_rate),
            ("optimiser.decay", o.decay, o.decay > 0.0 && o.decay <= 1.0, "in (0, 1]"),
            at_least_one("optimiser.decay_epochs", o.decay_epochs),
            ("optimiser.beta1", o.beta1, (0.0..1.0).contains(&o.beta1), "in [0, 1)"),
            ("optimiser.beta2", o.beta2, (0.0..1.0).contains(&o.beta2), "in [0, 1)"),
            positive("optimiser.epsilon", o.epsilon),
            not_negative("parameters.albedo_range[0]", p.albedo_range[0]),
            (
                "parameters.albedo_range[1]",
                p.albedo_range[1],
                p.albedo_range[1] > p.albedo_range[0] && p.albedo_range[1].is_finite(),
                "above the lower bound",
            ),
            (
                "parameters.albedo_start",
                p.albedo_start,
                within(p.albedo_start, p.albedo_range),
                "within parameters.albedo_range",
            ),
            ("parameters.roughness_range[0]", p.roughness_range[0], p.roughness_range[0] >= 0.005, "at least 0.005"),
            (
                "parameters.roughness_range[1]",
                p.roughness_range[1],
                p.roughness_range[1] > p.roughness_range[0] && p.roughness_range[1] <= 1.0,
                "above the lower bound, at most 1",
            ),
            (
                "parameters.roughness_start",
                p.roughness_start,
                within(p.roughness_start, p.roughness_range),
                "within parameters.roughness_range",
            ),
            not_negative("stage_one.semantic_weight", self.stage_one.semantic_weight),
            not_negative("stage_two.propagation_weight", self.stage_two.propagation_weight),
            not_negative("stage_three.smoothness_weight", self.stage_three.smoothness_weight),
            share("stage_two.quantile", self.stage_two.quantile),
        ];
        if self.mode == Mode::Paper && self.full.metallic.enabled {
            return Err(Error::invalid(
                "setting full.metallic.enabled is true, but mode is paper, in which everything is a dielectric; use mode full",
            ));
        }
        match checks.iter().chain(&self.full.checks()).find(|(_, _, ok, _)| !ok) {
            Some((name, value, _, allowed)) => {
                Err(Error::invalid(format!("setting {name} is {value}; it must be {allowed}")))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Projection};

    #[test]
    fn diffuse_models_are_chosen_by_name() {
        for choice in [DiffuseChoice::Auto, DiffuseChoice::Lambert, DiffuseChoice::Burley] {
            let name = serde_json::to_string(&choice).unwrap();
            assert_eq!(serde_json::from_str::<DiffuseChoice>(&name).unwrap(), choice);
        }
        let error = serde_json::from_str::<DiffuseChoice>("\"lambrt\"").unwrap_err().to_string();
        for part in ["`lambrt`", "`auto`", "`lambert`", "`burley`"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
    }

    #[test]
    fn irradiance_takes_fewer_rays_for_finer_texels() {
        let rays = |irradiance_samples: u32, texel: f32| {
            FitSettings { irradiance_samples, ..FitSettings::default() }.irradiance_rays(texel)
        };
        assert_eq!([0.1, 0.025, 0.018, 0.0125, 0.001].map(|texel| rays(0, texel)), [256, 256, 128, 64, 64]);
        assert_eq!([0.1, 0.001].map(|texel| rays(4, texel)), [4, 4]);
    }

    #[test]
    fn rounds_before_the_last_are_coarse() {
        let bakes = |mode: Mode, alternations: u32| {
            let full = FullSettings { alternations, ..FullSettings::default() };
            FitSettings { mode, full, ..FitSettings::default() }.bakes()
        };
        assert_eq!([0, 1, 2].map(|alternations| bakes(Mode::Full, alternations)), [1, 2, 3]);
        assert_eq!(bakes(Mode::Paper, 1), 1);

        let settings = FullSettings::default();
        let rounds = settings.rounds();
        assert!(rounds.len() == 2 && rounds[1] == settings);
        // By pixels that are 1.4°, 0.7° and 0.35° wide: the last round's rays, 176 per block of 0.7° at least, and the
        // first's, 60 per block of twice that.
        let per_pixel = |projection: Projection, width: usize| {
            let camera = Camera { projection, width, height: width / 2, world_from_camera: glam::Mat4::IDENTITY };
            assert!(rounds[0].squares(&camera).count() <= rounds[1].squares(&camera).count());
            settings.rays(&camera) as f32 / camera.pixels() as f32
        };
        for (width, expected) in [(256, 176.0 + 60.0), (512, 176.0 + 60.0 / 4.0), (1024, 176.0 / 4.0 + 60.0 / 16.0)] {
            let focal = width as f32 / std::f32::consts::TAU;
            let photo = Projection::Pinhole { fx: focal, fy: focal, cx: 0.0, cy: 0.0 };
            assert_eq!(per_pixel(photo, width), expected);
            // Two thirds of a panorama would do to look everywhere; blocks are of whole pixels.
            let share = per_pixel(Projection::Equirectangular, width) / expected;
            assert!((0.63..0.9).contains(&share), "{share} of {width} columns");
        }
    }

    /// The places of all numbers of a table, as paths of keys and indices.
    fn numbers(value: &toml::Value, path: &[String], found: &mut Vec<Vec<String>>) {
        let below = |key: String, value: &toml::Value, found: &mut Vec<_>| {
            numbers(value, &[path, &[key]].concat(), found);
        };
        match value {
            toml::Value::Integer(_) | toml::Value::Float(_) => found.push(path.to_vec()),
            toml::Value::Table(table) => table.iter().for_each(|(key, value)| below(key.clone(), value, found)),
            toml::Value::Array(array) => {
                array.iter().enumerate().for_each(|(i, value)| below(i.to_string(), value, found));
            }
            _ => {}
        }
    }

    fn place<'a>(value: &'a mut toml::Value, path: &[String]) -> &'a mut toml::Value {
        path.iter().fold(value, |value, key| match value {
            toml::Value::Array(array) => &mut array[key.parse::<usize>().unwrap()],
            table => &mut table[key],
        })
    }

    #[test]
    fn every_number_is_checked() {
        let defaults = FitSettings::default();
        defaults.validate().unwrap();
        let table = toml::Value::try_from(&defaults).unwrap();
        let mut paths = Vec::new();
        numbers(&table, &[], &mut paths);
        assert!(paths.len() > 60, "{}", paths.len());
        for path in paths {
            let refused = |with: toml::Value| {
                let mut changed = table.clone();
                *place(&mut changed, &path) = with;
                // Integers that are none, or negative, are refused as they are read.
                FitSettings::deserialize(changed).map_or(true, |settings| settings.validate().is_err())
            };
            for wrong in [f64::NAN, f64::INFINITY, -1.0] {
                assert!(refused(toml::Value::Float(wrong)), "{path:?} = {wrong}");
            }
            // Negative control: what it is.
            assert!(!refused(place(&mut table.clone(), &path).clone()), "{path:?}");
        }
    }
}
