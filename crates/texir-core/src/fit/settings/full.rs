//! Settings of full mode.

use serde::{Deserialize, Serialize};

use super::checks::{Check, counts, not_negative, positive, roughness, share};
use crate::brdf::Masking;
use crate::diffuse::DiffuseModel;
use crate::rng::hash2;
use crate::specular_table::TableSampling;

/// Full mode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FullSettings {
    /// Whether light sources of a given HDR texture are made to explain the pixels that show them, as those of one
    /// built from the views are.
    pub resolve_sources: bool,
    /// Number of alternations: irradiance is gathered anew from the light that surfaces send by the materials found so
    /// far (without highlights, also where no view sees), and all is fitted again. 0: the HDR texture as it is.
    pub alternations: u32,
    /// Pixels of one flat surface share their light samples in blocks about this wide, degrees.
    pub block_angle: f32,
    /// Light samples of each of a block's four points, per lobe of five.
    pub lobe_samples: u32,
    /// Cosine-distributed light samples of each of a block's four points.
    pub cosine_samples: u32,
    /// Light samples of each of a block's four points to the light sources.
    pub light_samples: u32,
    /// σ of the kernel that averages blocks' specular curves, as a share of a lobe's width α; 0: no averaging.
    pub curve_filter_width: f32,
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
    /// Pixels that a segment must have.
    pub min_pixels: u32,
    /// Roughness up to which metal can be told from a dielectric.
    pub max_roughness: f32,
}

impl Default for MetallicSettings {
    fn default() -> Self {
        Self { enabled: false, gain: 0.3, min_pixels: 100, max_roughness: 0.5 }
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

    /// For rounds that only give the light surfaces send and the diffuse model: a third of the light samples, blocks
    /// twice as wide, half the nodes, no joints.
    fn coarse(&self) -> Self {
        let mut coarse = self.clone();
        for samples in [&mut coarse.lobe_samples, &mut coarse.cosine_samples, &mut coarse.light_samples] {
            *samples = samples.div_ceil(3);
        }
        coarse.block_angle *= 2.0;
        coarse.roughness.node_stride *= 2;
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
pub struct FinishSettings {
    /// Edge of a block, metres.
    pub block: f32,
    /// Held-out gain (fall of the log mean cost) at which a second finish is trusted half: one half of the views
    /// estimates its shares, the other half is scored.
    pub gain: f32,
    /// Pixels at which that gain counts half.
    pub half_pixels: f32,
    /// Pixels that each finish must have, at least.
    pub min_pixels: u32,
}

impl Default for FinishSettings {
    fn default() -> Self {
        Self { block: 0.3, gain: 0.07, half_pixels: 1000.0, min_pixels: 500 }
    }
}

/// Similarity prior of segments: the weight that one has in another's prediction, 1 for two of one class, room and
/// colour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimilaritySettings {
    /// σ of the Gaussian in the difference of mean albedos, in ln a.
    pub colour_sigma: f32,
    /// Weight of the same class in another room.
    pub other_room: f32,
    /// Weight of another class.
    pub other_class: f32,
}

impl Default for SimilaritySettings {
    fn default() -> Self {
        Self { colour_sigma: 0.25, other_room: 0.3, other_class: 0.2 }
    }
}

/// When a part of a segment gets a roughness of its own, by two-fold cross-validation over the views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AcceptanceSettings {
    /// Weight of the segment's roughness as a prior.
    pub prior: f32,
    /// Held-out gain (fall of the log mean cost of the part's pixels) at which it is trusted half: each half of the
    /// views asks for one, scored on the other.
    pub gain: f32,
    /// Pixels at which that gain counts half; it counts less with fewer.
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
    /// Detectors of straight lines, in order: the first that finds enough is taken.
    pub straight: Vec<Straight>,
    /// By how much lines of any course are darker or brighter than what is around them, in ln a, where a segment has no
    /// straight ones.
    pub contrast: f32,
    /// How long those must be, metres, counted in texels that touch.
    pub length: f32,
    /// Share of a segment's texels that its darker or its brighter lines must have.
    pub min_share: f32,
    /// When they get a roughness of their own.
    pub acceptance: AcceptanceSettings,
}

impl Default for JointSettings {
    fn default() -> Self {
        Self {
            width: 0.03,
            straight: vec![Straight { reach: 3.0, contrast: 0.08 }, Straight { reach: 0.4, contrast: 0.1 }],
            contrast: 0.15,
            length: 0.04,
            min_share: 0.02,
            acceptance: AcceptanceSettings { prior: 0.03, gain: 0.02, half_pixels: 1000.0 },
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
    pub min_share: f32,
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

/// Roughness by a scan, and priors of groups: a prior of weight p adds p (2 (r − r_prior))² to the log mean cost, so
/// that a weight of 0.1 costs 0.5 away as much as a mean cost 10 % higher.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RoughnessSettings {
    /// Prior mean of all roughness: what is expected without any evidence.
    pub prior_mean: f32,
    /// σ of a pixel's albedo in the scan: the albedo's `noise`, and this share of the apparent albedo.
    pub image_noise: f32,
    /// Weight of the deviations of a residual's channels from their mean, which has 1.
    pub colour_weight: f32,
    /// Steps of conjugate gradients per roughness.
    pub iterations: u32,
    /// Stride of the tabulated roughnesses that are solved; those between are interpolated.
    pub node_stride: u32,
    /// Pixels seen at a smaller cosine do not count: models of grazing reflectance differ most.
    pub min_cosine: f32,
    /// Pixels within this angle, degrees (a pixel at least, unless 0), of an excluded one do not count: they may hold a
    /// sliver of a light source.
    pub exclusion_margin: f32,
    /// Largest roughness: beyond it lobes cannot be told apart.
    pub cap: f32,
    /// Weight of the roughness of everything as a prior of a class.
    pub class_prior: f32,
    /// Weight of a class as a prior of its part in a room.
    pub room_prior: f32,
    /// Weight of a class in a room as a prior of its segments.
    pub segment_prior: f32,
    /// Trust in n pixels of a segment is n/(n + this); also the similarity prior's pseudo-count.
    pub segment_pixels: f32,
    /// The similarity prior.
    pub similarity: SimilaritySettings,
    /// When a colour of a segment gets a roughness of its own.
    pub colours: AcceptanceSettings,
    /// Two finishes within a segment.
    pub finishes: FinishSettings,
    /// Joints between boards and tiles.
    pub joints: JointSettings,
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
            curve_filter_width: 0.3,
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
        Self { strength: 0.8, bandwidth: 0.08, reach: 0.3, colours: 6, min_share: 0.02 }
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
            prior_mean: 0.5,
            image_noise: 0.05,
            colour_weight: 2.0,
            iterations: 4,
            node_stride: 1,
            min_cosine: 0.3,
            exclusion_margin: 0.7,
            cap: 0.88,
            class_prior: 0.1,
            room_prior: 0.15,
            segment_prior: 0.3,
            segment_pixels: 100.0,
            similarity: SimilaritySettings::default(),
            colours: AcceptanceSettings { prior: 0.1, gain: 0.02, half_pixels: 1000.0 },
            finishes: FinishSettings::default(),
            joints: JointSettings::default(),
        }
    }
}

impl FullSettings {
    /// How the light samples of view `view` are drawn in a run of seed `seed`.
    pub fn sampling(&self, seed: u32, view: u32) -> TableSampling {
        let Self { lobe_samples: lobe, cosine_samples: cosine, light_samples: light, masking, .. } = *self;
        TableSampling { lobe, cosine, light, masking, seed: hash2(seed, view) }
    }

    /// Tables that light samples are weighed into, each from samples of its own: of a dielectric, and where metals are
    /// sought, of a white one.
    pub fn tables(&self) -> u64 {
        1 + u64::from(self.metallic.enabled)
    }

    pub(super) fn checks(&self) -> Vec<Check> {
        let (a, r, p) = (&self.albedo, &self.roughness, &self.palette);
        let mut checks = vec![
            ("full.alternations", self.alternations as f32, self.alternations <= 16, "at most 16"),
            ("full.block_angle", self.block_angle, (0.0..=10.0).contains(&self.block_angle), "in [0, 10]"),
            counts("full.lobe_samples", self.lobe_samples),
            ("full.cosine_samples", self.cosine_samples as f32, self.cosine_samples <= 1024, "at most 1024"),
            ("full.light_samples", self.light_samples as f32, self.light_samples <= 1024, "at most 1024"),
            not_negative("full.curve_filter_width", self.curve_filter_width),
            positive("full.albedo.noise", a.noise),
            not_negative("full.albedo.image_noise", a.image_noise),
            not_negative("full.albedo.specular_noise", a.specular_noise),
            not_negative("full.albedo.smoothness", a.smoothness),
            positive("full.albedo.edge_scale", a.edge_scale),
            positive("full.albedo.segment_prior", a.segment_prior),
            counts("full.albedo.rounds", a.rounds),
            counts("full.albedo.iterations", a.iterations),
            roughness("full.roughness.prior_mean", r.prior_mean),
            not_negative("full.roughness.image_noise", r.image_noise),
            not_negative("full.roughness.colour_weight", r.colour_weight),
            counts("full.roughness.iterations", r.iterations),
            counts("full.roughness.node_stride", r.node_stride),
            ("full.roughness.min_cosine", r.min_cosine, (0.0..1.0).contains(&r.min_cosine), "in [0, 1)"),
            (
                "full.roughness.exclusion_margin",
                r.exclusion_margin,
                (0.0..=10.0).contains(&r.exclusion_margin),
                "in [0, 10] degrees",
            ),
            roughness("full.roughness.cap", r.cap),
            not_negative("full.roughness.class_prior", r.class_prior),
            not_negative("full.roughness.room_prior", r.room_prior),
            not_negative("full.roughness.segment_prior", r.segment_prior),
            positive("full.roughness.segment_pixels", r.segment_pixels),
            positive("full.roughness.similarity.colour_sigma", r.similarity.colour_sigma),
            share("full.roughness.similarity.other_room", r.similarity.other_room),
            share("full.roughness.similarity.other_class", r.similarity.other_class),
            not_negative("full.roughness.colours.prior", r.colours.prior),
            positive("full.roughness.colours.gain", r.colours.gain),
            not_negative("full.roughness.colours.half_pixels", r.colours.half_pixels),
            positive("full.roughness.finishes.block", r.finishes.block),
            positive("full.roughness.finishes.gain", r.finishes.gain),
            not_negative("full.roughness.finishes.half_pixels", r.finishes.half_pixels),
            ("full.roughness.joints.width", r.joints.width, (0.0..=0.5).contains(&r.joints.width), "in [0, 0.5]"),
            positive("full.roughness.joints.contrast", r.joints.contrast),
            positive("full.roughness.joints.length", r.joints.length),
            share("full.roughness.joints.min_share", r.joints.min_share),
            not_negative("full.roughness.joints.acceptance.prior", r.joints.acceptance.prior),
            positive("full.roughness.joints.acceptance.gain", r.joints.acceptance.gain),
            not_negative("full.roughness.joints.acceptance.half_pixels", r.joints.acceptance.half_pixels),
            share("full.palette.strength", p.strength),
            positive("full.palette.bandwidth", p.bandwidth),
            ("full.palette.colours", p.colours as f32, (1..=256).contains(&p.colours), "1 to 256"),
            positive("full.palette.reach", p.reach),
            share("full.palette.min_share", p.min_share),
            not_negative("full.metallic.gain", self.metallic.gain),
            roughness("full.metallic.max_roughness", self.metallic.max_roughness),
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
